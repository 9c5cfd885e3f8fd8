// Signed distance of a point to the nearer triangle of its face. Twin: fit/passes/distance.rs.

struct Face {
    b: f32,
    b_above: f32,
    a_above: f32,
}

struct Nearer {
    distance: f32,
    top: bool,
}

struct Closest {
    q: vec3f,
    normal: vec3f,
}

// Written out, so that the order of the sums is the twin's.
fn dot3(p: vec3f, q: vec3f) -> f32 {
    return p.x * q.x + p.y * q.y + p.z * q.z;
}

fn cross3(p: vec3f, q: vec3f) -> vec3f {
    return vec3f(p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x);
}

fn closest(p: vec3f, b: vec3f, c: vec3f) -> Closest {
    let normal = cross3(b, c);
    let from_b = p - b;
    let from_c = p - c;
    let d1 = dot3(b, p);
    let d2 = dot3(c, p);
    let d3 = dot3(b, from_b);
    let d4 = dot3(c, from_b);
    let d5 = dot3(b, from_c);
    let d6 = dot3(c, from_c);
    let area_c = dot3(normal, cross3(b, p));
    let area_b = dot3(normal, cross3(p, c));
    let area_a = dot3(normal, cross3(from_b, from_c));

    var over_b = area_b;
    var over_c = area_c;
    var under = area_a + area_b + area_c;
    let e = d4 - d3;
    let f = d5 - d6;
    if (area_a <= 0.0 && e >= 0.0 && f >= 0.0) {
        over_b = f;
        over_c = e;
        under = e + f;
    }
    if (area_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
        over_b = 0.0;
        over_c = d2;
        under = d2 - d6;
    }
    if (d6 >= 0.0 && d5 <= d6) {
        over_b = 0.0;
        over_c = d2;
        under = d2;
    }
    if (area_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0) {
        over_b = d1;
        over_c = 0.0;
        under = d1 - d3;
    }
    if (d3 >= 0.0 && d4 <= d3) {
        over_b = d1;
        over_c = 0.0;
        under = d1;
    }
    if (d1 <= 0.0 && d2 <= 0.0) {
        over_b = 0.0;
        over_c = 0.0;
        under = 1.0;
    }

    let s = over_b / under;
    let t = over_c / under;
    let q = vec3f(b.x * s + c.x * t, b.y * s + c.y * t, b.z * s + c.z * t);
    return Closest(q, normal);
}

fn distance_to_face(p: vec3f, face: Face, step_theta: f32, step_z: f32) -> Nearer {
    let b = vec3f(face.b, step_theta, 0.0);
    let b_above = vec3f(face.b_above, step_theta, step_z);
    let a_above = vec3f(face.a_above, 0.0, step_z);
    let bottom = closest(p, b, b_above);
    let top = closest(p, b_above, a_above);
    let e1 = p - bottom.q;
    let e2 = p - top.q;
    let is_top = dot3(top.q - bottom.q, e1 + e2) > 0.0;
    let squared = select(dot3(e1, e1), dot3(e2, e2), is_top);
    let side = select(dot3(e1, bottom.normal), dot3(e2, top.normal), is_top);
    let distance = sqrt(squared);
    return Nearer(select(distance, -distance, side < 0.0), is_top);
}
