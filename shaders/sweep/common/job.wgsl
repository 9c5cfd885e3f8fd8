// What every pass of the sweep's wall knows. Rust twin: sweep/passes/job.rs; a test holds the two together.

struct Job {
    rings: u32,
    nodes: u32,
    node_count: u32,
    // Echoes of this chunk.
    echoes: u32,
    // Whether feet are moved, and far echoes left out.
    feet: u32,
    gated: u32,
    // Blocks that the rings are cut into, and the rings of each but the last.
    blocks: u32,
    block_rings: u32,
    // What the wall's and the echoes' radii are measured from, mm.
    start: f32,
    // 2π/N, rad, and 1/N.
    step_theta: f32,
    per_node: f32,
    // Share of the noise's variance that the image planes have to themselves.
    in_plane: f32,
    noise: f32,
    per_noise: f32,
    // Farthest foot, gate and Huber's bound, mm, and the gate in radii.
    farthest_foot: f32,
    gate: f32,
    gate_radii: f32,
    huber: f32,
    // Steps of the fixed-point sums of weights and of ways, and their inverses.
    weight_scale: f32,
    weight_unit: f32,
    way_scale: f32,
    way_unit: f32,
    // λ times the bending along, around and across, per node.
    along: f32,
    around: f32,
    twist: f32,
    // Square of the residual that is left.
    enough: f32,
    // Factors of N that transforms go through one after the other.
    short: u32,
    long: u32,
}

struct Echo {
    // Along the axis: ring below, and the part of the way to the next; about it: node before, and the part.
    ring: u32,
    ring_part: f32,
    node: u32,
    node_part: f32,
    // Radius less `start`, mm.
    rise: f32,
    // Distance of two rings there, mm.
    step: f32,
    // The image plane's normal: away from the axis, about it, along it.
    normal_x: f32,
    normal_y: f32,
    normal_z: f32,
}

// What goes from pass to pass.
struct State {
    // The digits of the median that are known, the rank among those that share them, how many digits these are.
    prefix: u32,
    rest: u32,
    round: u32,
    // Whether conjugate gradients have come near enough, and after how many steps.
    done: u32,
    steps: u32,
    // Square of the residual, length of a step and turn of its direction.
    size: f32,
    length: f32,
    turn: f32,
}

// Workgroups are laid out in two dimensions, because one holds 65,535 at most.
fn workgroup_index(group: vec3u, groups: vec3u) -> u32 {
    return group.y * groups.x + group.x;
}
