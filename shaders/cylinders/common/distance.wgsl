// Signed distance of a point to the nearer triangle of its face. Twin: cylinders/passes/distance.rs.

// r of the corners b, b' and a' less that of a, and the inverse squares of the lengths of the edges (a to b, a to
// a', a to b', b' to b, b' to a') and of the two normals.
struct Face {
    b: f32,
    b_above: f32,
    a_above: f32,
    per_ab: f32,
    per_aa: f32,
    per_diagonal: f32,
    per_bb: f32,
    per_across: f32,
    per_bottom: f32,
    per_top: f32,
}

struct Nearer {
    distance: f32,
    top: bool,
}

fn bottom_normal(b: f32, b_above: f32) -> vec3f {
    let theta = parameters.step_theta;
    let z = parameters.step_z;
    return vec3f(theta * z, -(b * z), theta * (b - b_above));
}

fn top_normal(b_above: f32, a_above: f32) -> vec3f {
    let theta = parameters.step_theta;
    let z = parameters.step_z;
    return vec3f(theta * z, z * (a_above - b_above), -(theta * a_above));
}

// Written out, because `dot` does not fix the order of its sums.
fn square(e: vec3f) -> f32 {
    return e.x * e.x + e.y * e.y + e.z * e.z;
}

fn face_of_corners(b: f32, b_above: f32, a_above: f32) -> Face {
    let theta = parameters.step_theta;
    let z = parameters.step_z;
    let to_b = b - b_above;
    let to_a = a_above - b_above;
    return Face(
        b,
        b_above,
        a_above,
        1.0 / (b * b + theta * theta),
        1.0 / (a_above * a_above + z * z),
        1.0 / (b_above * b_above + theta * theta + z * z),
        1.0 / (to_b * to_b + z * z),
        1.0 / (to_a * to_a + theta * theta),
        1.0 / square(bottom_normal(b, b_above)),
        1.0 / square(top_normal(b_above, a_above)),
    );
}

fn within_one(t: f32) -> f32 {
    return min(max(t, 0.0), 1.0);
}

fn distance_to_face(p: vec3f, face: Face) -> Nearer {
    let x = p.x;
    let y = p.y;
    let z = p.z;
    let theta = parameters.step_theta;
    let height = parameters.step_z;
    let b = face.b;
    let b_above = face.b_above;
    let a_above = face.a_above;
    let n1 = bottom_normal(b, b_above);
    let n2 = top_normal(b_above, a_above);

    // Feet on the planes.
    let side1 = n1.x * x + n1.y * y + n1.z * z;
    let side2 = n2.x * x + n2.y * y + n2.z * z;
    let k1 = side1 * face.per_bottom;
    let k2 = side2 * face.per_top;
    let theta1 = y - n1.y * k1;
    let z1 = z - n1.z * k1;
    let theta2 = y - n2.y * k2;
    let z2 = z - n2.z * k2;
    let inside1 = z1 >= 0.0 && theta1 <= theta && theta1 * height >= z1 * theta;
    let inside2 = theta2 >= 0.0 && z2 <= height && z2 * theta >= theta2 * height;
    let to_b = b - b_above;
    let to_a = a_above - b_above;
    let r1 = theta1 * (b * parameters.faces_per_rad) - z1 * (to_b * parameters.faces_per_mm);
    let r2 = z2 * (a_above * parameters.faces_per_mm) - theta2 * (to_a * parameters.faces_per_rad);
    let foot1 = square(vec3f(x - r1, y - theta1, z - z1));
    let foot2 = square(vec3f(x - r2, y - theta2, z - z2));

    // Edges from a, then from b'.
    let t_ab = within_one((b * x + theta * y) * face.per_ab);
    let on_ab = square(vec3f(x - t_ab * b, y - t_ab * theta, z));
    let t_aa = within_one((a_above * x + height * z) * face.per_aa);
    let on_aa = square(vec3f(x - t_aa * a_above, y, z - t_aa * height));
    let t_diagonal = within_one((b_above * x + theta * y + height * z) * face.per_diagonal);
    let on_diagonal = square(vec3f(x - t_diagonal * b_above, y - t_diagonal * theta, z - t_diagonal * height));
    let u = x - b_above;
    let v = y - theta;
    let w = z - height;
    let t_bb = within_one((to_b * u - height * w) * face.per_bb);
    let on_bb = square(vec3f(u - t_bb * to_b, v, w + t_bb * height));
    let t_across = within_one((to_a * u - theta * v) * face.per_across);
    let across = square(vec3f(u - t_across * to_a, v + t_across * theta, w));

    let bottom = select(min(on_ab, on_bb), foot1, inside1);
    let top = select(min(on_aa, across), foot2, inside2);
    let beats_diagonal = inside2 || top < on_diagonal;
    let beats_bottom = top < bottom || (top <= bottom && inside2 && !inside1);
    let is_top = beats_diagonal && beats_bottom;
    let squared = select(min(bottom, on_diagonal), top, is_top);
    let side = select(side1, side2, is_top);
    let distance = sqrt(squared);
    return Nearer(select(distance, -distance, side < 0.0), is_top);
}
