// The residual of an echo along its error ellipsoid, at its projection onto the wall.

struct WallResidual {
    // The triangle's corners a, b, b' or a, a', b', and the projection's barycentric weights.
    corners: vec3u,
    weights: vec3f,
    bottom: bool,
    // The wall's radius at the projection less `start`, and the length of a node's arc there, mm.
    wall: f32,
    arc: f32,
    // The likeliest direction of an error: the ellipsoid's matrix times the wall's normal n. The variance
    // along n, in units of the noise. The radial part of n.
    likeliest: vec3f,
    variance: f32,
    normal_x: f32,
    // Distance along n, and the standardised residual, in mm of noise along the likeliest direction.
    normal_distance: f32,
    residual: f32,
}

// Projections are at most this many cells away, so that integers hold their cells.
const MAX_CELLS: f32 = 16777216.0;

fn residual_to_wall(echo: Echo, shift: vec2f) -> WallResidual {
    let ring = echo.ring_part + shift.x;
    let rings_up = clamp(floor(ring), -MAX_CELLS, MAX_CELLS);
    let wanted = i32(echo.ring) + i32(rings_up);
    let last = i32(parameters.rings) - 2;
    let level = u32(clamp(wanted, 0, last));
    var up = clamp(ring - rings_up, 0.0, 1.0);
    if (wanted < 0) {
        up = 0.0;
    }
    if (wanted > last) {
        up = 1.0;
    }
    let node = echo.node_part + shift.y;
    let nodes_on = clamp(floor(node), -MAX_CELLS, MAX_CELLS);
    let nodes = i32(parameters.nodes);
    let j = u32(((i32(echo.node) + i32(nodes_on)) % nodes + nodes) % nodes);
    let round = clamp(node - nodes_on, 0.0, 1.0);
    let next = select(j + 1u, 0u, j + 1u == parameters.nodes);

    var to_wall: WallResidual;
    let row = level * parameters.nodes;
    let a = row + j;
    let b_above = row + parameters.nodes + next;
    to_wall.bottom = round >= up;
    to_wall.corners = vec3u(a, select(row + parameters.nodes + j, row + next, to_wall.bottom), b_above);
    to_wall.weights = select(
        vec3f(1.0 - up, up - round, round),
        vec3f(1.0 - round, round - up, up),
        to_wall.bottom,
    );
    let r0 = wall[to_wall.corners.x];
    let r1 = wall[to_wall.corners.y];
    let r2 = wall[to_wall.corners.z];
    // Slopes within the triangle.
    let per_node = select(r2 - r1, r1 - r0, to_wall.bottom);
    let per_ring = select(r1 - r0, r2 - r1, to_wall.bottom);
    to_wall.wall = r0 + round * per_node + up * per_ring;
    to_wall.arc = parameters.step_theta * (parameters.start + to_wall.wall);

    // Those over the noise's reach.
    let reach = parameters.slope_nodes;
    let behind = (j + parameters.nodes - reach) % parameters.nodes;
    let ahead = (j + 1u + reach) % parameters.nodes;
    let round_row = select(row + parameters.nodes, row, to_wall.bottom);
    let around = (wall[round_row + ahead] - wall[round_row + behind]) / f32(2u * reach + 1u);
    let low = level - min(level, parameters.slope_rings);
    let high = min(level + 1u + parameters.slope_rings, parameters.rings - 1u);
    let column = select(j, next, to_wall.bottom);
    let along = (wall[high * parameters.nodes + column] - wall[low * parameters.nodes + column])
        / f32(high - low);
    let y = -(around / to_wall.arc);
    let z = -(along / echo.step);
    let length = sqrt(1.0 + y * y + z * z);
    let normal = vec3f(1.0 / length, y / length, z / length);
    let image = vec3f(echo.normal_x, echo.normal_y, echo.normal_z);
    let tilt = normal.x * image.x + normal.y * image.y + normal.z * image.z;
    let along_image = parameters.in_plane * tilt;
    let likeliest = vec3f(
        normal.x - image.x * along_image,
        normal.y - image.y * along_image,
        normal.z - image.z * along_image,
    );
    to_wall.likeliest = likeliest;
    to_wall.variance = normal.x * likeliest.x + normal.y * likeliest.y + normal.z * likeliest.z;
    to_wall.normal_x = normal.x;
    to_wall.normal_distance = normal.x * (echo.rise - to_wall.wall) - normal.y * (shift.y * to_wall.arc)
        - normal.z * (shift.x * echo.step);
    to_wall.residual = to_wall.normal_distance / sqrt(to_wall.variance);
    return to_wall;
}
