// The way of an echo to the wall under its foot. Twin: sweep/passes/echo.rs, statement by statement.

struct Way {
    // The triangle's corners a, b, b' or a, a', b', and the weights of the foot there.
    corners: vec3u,
    weights: vec3f,
    bottom: bool,
    // Radius of the wall at the foot, less `start`, and length of a node's arc there, mm.
    wall: f32,
    arc: f32,
    // The likeliest way, and its variance; the normal's part away from the axis.
    likeliest: vec3f,
    variance: f32,
    normal_x: f32,
    // Along the normal, and in units of the noise along the likeliest way, mm.
    across: f32,
    miss: f32,
}

// Of feet that lie farther off than this nothing is left.
const FARTHEST_CELL: f32 = 16777216.0;

fn way_to_wall(echo: Echo, shift: vec2f) -> Way {
    let ring = echo.ring_part + shift.x;
    let rings_up = clamp(floor(ring), -FARTHEST_CELL, FARTHEST_CELL);
    let wanted = i32(echo.ring) + i32(rings_up);
    let last = i32(job.rings) - 2;
    let level = u32(clamp(wanted, 0, last));
    var up = clamp(ring - rings_up, 0.0, 1.0);
    if (wanted < 0) {
        up = 0.0;
    }
    if (wanted > last) {
        up = 1.0;
    }
    let node = echo.node_part + shift.y;
    let nodes_on = clamp(floor(node), -FARTHEST_CELL, FARTHEST_CELL);
    let nodes = i32(job.nodes);
    let j = u32(((i32(echo.node) + i32(nodes_on)) % nodes + nodes) % nodes);
    let round = clamp(node - nodes_on, 0.0, 1.0);
    let next = select(j + 1u, 0u, j + 1u == job.nodes);

    var way: Way;
    let row = level * job.nodes;
    let a = row + j;
    let b_above = row + job.nodes + next;
    way.bottom = round >= up;
    way.corners = vec3u(a, select(row + job.nodes + j, row + next, way.bottom), b_above);
    way.weights = select(
        vec3f(1.0 - up, up - round, round),
        vec3f(1.0 - round, round - up, up),
        way.bottom,
    );
    let r0 = wall[way.corners.x];
    let r1 = wall[way.corners.y];
    let r2 = wall[way.corners.z];
    // Slopes within the triangle.
    let per_node = select(r2 - r1, r1 - r0, way.bottom);
    let per_ring = select(r1 - r0, r2 - r1, way.bottom);
    way.wall = r0 + round * per_node + up * per_ring;
    way.arc = job.step_theta * (job.start + way.wall);

    let y = -(per_node / way.arc);
    let z = -(per_ring / echo.step);
    let length = sqrt(1.0 + y * y + z * z);
    let normal = vec3f(1.0 / length, y / length, z / length);
    let image = vec3f(echo.normal_x, echo.normal_y, echo.normal_z);
    let tilt = normal.x * image.x + normal.y * image.y + normal.z * image.z;
    let along_image = job.in_plane * tilt;
    let likeliest = vec3f(
        normal.x - image.x * along_image,
        normal.y - image.y * along_image,
        normal.z - image.z * along_image,
    );
    way.likeliest = likeliest;
    way.variance = normal.x * likeliest.x + normal.y * likeliest.y + normal.z * likeliest.z;
    way.normal_x = normal.x;
    way.across = normal.x * (echo.rise - way.wall) - normal.y * (shift.y * way.arc)
        - normal.z * (shift.x * echo.step);
    way.miss = way.across / sqrt(way.variance);
    return way;
}
