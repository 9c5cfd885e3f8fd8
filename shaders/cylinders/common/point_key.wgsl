// The key of a point's distance to its face. The including shader binds `radii`.

// A face among those of all cylinders: r of its corner a, and its shape.
struct Corners {
    a: f32,
    shape: Face,
}

fn corners_of(face_of_all: u32, cylinder: u32) -> Corners {
    let face = face_of_all - cylinder * parameters.faces;
    let level = face / parameters.nodes;
    let j = face - level * parameters.nodes;
    let k = select(j + 1u, 0u, j + 1u == parameters.nodes);
    let row = cylinder * parameters.node_count + level * parameters.nodes;
    let above = row + parameters.nodes;
    let a = radii[row + j];
    return Corners(a, face_of_corners(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a));
}

// The key of a point as `scatter` groups it.
fn key_of_point(point: vec4u, corners: Corners, scale: f32) -> u32 {
    let p = bitcast<vec3f>(point.xyz);
    let nearer = distance_to_face(vec3f(p.x - corners.a, p.yz), corners.shape);
    return packed_key(nearer.distance, nearer.top, scale);
}
