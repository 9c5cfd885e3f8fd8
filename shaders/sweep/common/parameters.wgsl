// The structures of the wall's passes. A test compares their layouts with those of the Rust twin.

struct WallParameters {
    rings: u32,
    nodes: u32,
    node_count: u32,
    // Echoes of this chunk.
    echoes: u32,
    // 1 where projections are moved, and where far echoes are left out.
    project: u32,
    gated: u32,
    // Blocks that the rings are cut into, and the rings of each but the last.
    blocks: u32,
    block_rings: u32,
    // Radius from which those of the wall and of the echoes are measured, mm.
    start: f32,
    // 2π/N, rad, and 1/N.
    step_theta: f32,
    per_node: f32,
    // Share of the noise's variance that lies within the image planes only.
    in_plane: f32,
    noise: f32,
    per_noise: f32,
    // Farthest projection, gate, Huber's bound, mm; and the gate in radii.
    max_projection: f32,
    gate: f32,
    gate_radii: f32,
    huber: f32,
    // Steps per unit of the fixed-point sums of weights and of right-hand sides, and their inverses.
    weight_scale: f32,
    weight_unit: f32,
    rhs_scale: f32,
    rhs_unit: f32,
    // λ times the bending along the axis, about it, and the twist, per node.
    along: f32,
    around: f32,
    twist: f32,
    // Square of the residual at which the solver stops.
    max_residual_square: f32,
    // Factors of N for the two stages of a transform.
    short_factor: u32,
    long_factor: u32,
}

struct Echo {
    // Along the axis: the ring below, and the fraction of a cell above it. About it: the node before, and the
    // fraction.
    ring: u32,
    ring_part: f32,
    node: u32,
    node_part: f32,
    // Radius less `start`, mm.
    rise: f32,
    // Distance between two rings there, mm.
    step: f32,
    // The image plane's normal: radial, about the axis, along it.
    normal_x: f32,
    normal_y: f32,
    normal_z: f32,
}

// State.done: the residual is small enough, or the equations are not positive definite or not finite.
const CONVERGED = 1u;
const BROKEN = 2u;
// The largest number of f32.
const MAX_F32 = 3.4028234e38;

// Values that pass from pass to pass.
struct State {
    // The known digits of the median, its rank among the residuals that share them, and the number of known
    // digits.
    prefix: u32,
    rank: u32,
    digits: u32,
    // How conjugate gradients ended (0 while they go on, CONVERGED or BROKEN), and the number of their steps.
    done: u32,
    steps: u32,
    // Square of the residual in the preconditioner's norm, length of a step, and share of the last direction
    // in the next.
    residual_square: f32,
    alpha: f32,
    beta: f32,
}
