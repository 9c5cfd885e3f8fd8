// Signed distance of a point to the nearer triangle of its face.
// Twin: cylinders/passes/distance.rs.

struct Face {
    b: f32,
    b_above: f32,
    a_above: f32,
}

struct Nearer {
    distance: f32,
    top: bool,
}

// Written out, because `dot` does not fix the order of its sums.
fn dot3(p: vec3f, q: vec3f) -> f32 {
    return p.x * q.x + p.y * q.y + p.z * q.z;
}

// Weights of b and c in the closest point of the triangle (0, b, c): products of b and c with p, p - b and
// p - c, and the areas opposite a, b and c.
fn closest(from_a: vec2f, from_b: vec2f, from_c: vec2f, areas: vec3f) -> vec2f {
    let d1 = from_a.x;
    let d2 = from_a.y;
    let d3 = from_b.x;
    let d4 = from_b.y;
    let d5 = from_c.x;
    let d6 = from_c.y;
    var over = areas.yz;
    var under = areas.x + areas.y + areas.z;
    let e = d4 - d3;
    let f = d5 - d6;
    if (areas.x <= 0.0 && e >= 0.0 && f >= 0.0) {
        over = vec2f(f, e);
        under = e + f;
    }
    if (areas.y <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
        over = vec2f(0.0, d2);
        under = d2 - d6;
    }
    if (d6 >= 0.0 && d5 <= d6) {
        over = vec2f(0.0, d2);
        under = d2;
    }
    if (areas.z <= 0.0 && d1 >= 0.0 && d3 <= 0.0) {
        over = vec2f(d1, 0.0);
        under = d1 - d3;
    }
    if (d3 >= 0.0 && d4 <= d3) {
        over = vec2f(d1, 0.0);
        under = d1;
    }
    if (d1 <= 0.0 && d2 <= 0.0) {
        over = vec2f(0.0);
        under = 1.0;
    }
    return vec2f(over.x / under, over.y / under);
}

fn distance_to_face(p: vec3f, face: Face, dt: f32, dz: f32) -> Nearer {
    let x = p.x;
    let y = p.y;
    let z = p.z;
    let u = face.b;
    let v = face.b_above;
    let w = face.a_above;
    let corner_b = vec3f(u, dt, 0.0);
    let corner_b_above = vec3f(v, dt, dz);
    let corner_a_above = vec3f(w, 0.0, dz);
    let from_b = vec3f(x - u, y - dt, z);
    let from_b_above = vec3f(x - v, y - dt, z - dz);
    let from_a_above = vec3f(x - w, y, z - dz);
    let diagonal = dot3(corner_b_above, p);
    let beyond_diagonal = dot3(corner_b_above, from_b_above);
    let n_r = dt * dz;

    let n1 = vec3f(n_r, -(u * dz), dt * (u - v));
    let bb_r = v - u;
    let bottom = closest(
        vec2f(dot3(corner_b, p), diagonal),
        vec2f(dot3(corner_b, from_b), dot3(corner_b_above, from_b)),
        vec2f(dot3(corner_b, from_b_above), beyond_diagonal),
        vec3f(
            dot3(n1, vec3f(-(dz * from_b.y), dz * from_b.x - bb_r * z, bb_r * from_b.y)),
            dot3(n1, vec3f(y * dz - z * dt, z * v - x * dz, x * dt - y * v)),
            dot3(n1, vec3f(dt * z, -(u * z), u * y - dt * x)),
        ),
    );
    let q1 = vec3f(u * bottom.x + v * bottom.y, dt * (bottom.x + bottom.y), dz * bottom.y);

    let aa_r = w - v;
    let n2 = vec3f(n_r, dz * aa_r, -(dt * w));
    let top = closest(
        vec2f(diagonal, dot3(corner_a_above, p)),
        vec2f(beyond_diagonal, dot3(corner_a_above, from_b_above)),
        vec2f(dot3(corner_b_above, from_a_above), dot3(corner_a_above, from_a_above)),
        vec3f(
            dot3(n2, vec3f(
                -(dt * from_b_above.z),
                -(aa_r * from_b_above.z),
                aa_r * from_b_above.y + dt * from_b_above.x,
            )),
            dot3(n2, vec3f(y * dz, z * w - x * dz, -(y * w))),
            dot3(n2, vec3f(dt * z - dz * y, dz * x - v * z, v * y - dt * x)),
        ),
    );
    let q2 = vec3f(v * top.x + w * top.y, dt * top.x, dz * (top.x + top.y));

    let e1 = p - q1;
    let e2 = p - q2;
    let is_top = dot3(q2 - q1, e1 + e2) > 0.0;
    let squared = select(dot3(e1, e1), dot3(e2, e2), is_top);
    let side = select(dot3(e1, n1), dot3(e2, n2), is_top);
    let distance = sqrt(squared);
    return Nearer(select(distance, -distance, side < 0.0), is_top);
}
