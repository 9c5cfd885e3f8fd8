// The points of a batch: the face of each, and the form in which they are grouped. The including shader binds `section`
// and `owners`.

// The face of a point among those of all cylinders; NONE where it did not pass the gate.
fn face_of(slot: u32) -> u32 {
    if (slot >= parameters.slots) {
        return NONE;
    }
    var owner = 0u;
    if (parameters.single == 0u) {
        owner = owners[slot];
    }
    if (owner == NONE) {
        return NONE;
    }
    let theta = section[parameters.slots + slot];
    let z = section[2u * parameters.slots + slot];
    let level = min(u32((z + parameters.half_height) * parameters.faces_per_mm), parameters.levels - 1u);
    let node = min(u32(theta * parameters.faces_per_rad), parameters.nodes - 1u);
    return owner * parameters.faces + level * parameters.nodes + node;
}

// The bits of r, θ - θⱼ and z - zₗ of a point, which stay small and so preserve f32 precision, and its face.
fn grouped_point(slot: u32, face_of_all: u32) -> vec4u {
    let face = face_of_all % parameters.faces;
    let level = face / parameters.nodes;
    let theta = section[parameters.slots + slot];
    let height = section[2u * parameters.slots + slot] + parameters.half_height;
    return vec4u(
        bitcast<u32>(section[slot]),
        bitcast<u32>(theta - f32(face - level * parameters.nodes) * parameters.step_theta),
        bitcast<u32>(height - f32(level) * parameters.step_z),
        face_of_all,
    );
}
