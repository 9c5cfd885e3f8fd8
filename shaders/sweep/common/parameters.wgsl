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
    // Distances of rings, and of nodes on a tube of the median radius, mm.
    step: f32,
    arc: f32,
    // Radius from which those of the wall and of the echoes are measured, mm.
    start: f32,
    // 2π/N, rad.
    step_theta: f32,
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
    // Square of the share of the right-hand side at which the solver stops, and its largest number of steps.
    tolerance_square: f32,
    max_steps: u32,
    // How far beyond a triangle slopes are taken: nodes to either side, and rings.
    slope_nodes: u32,
    slope_rings: u32,
    // Weights of the relaxations of a grid: of the first and the last, and of those between. A driver would regroup
    // products with constants.
    first_relaxation: f32,
    second_relaxation: f32,
    // 1 where small grids have low tiles, which many workgroups share.
    low_tiles: u32,
}

// A grid of the multigrid cycle, the finest first.
struct Level {
    rings: u32,
    nodes: u32,
    count: u32,
    // Its first node in the buffers that hold the nodes of all grids.
    first: u32,
    // The number of coarser grids.
    coarser: u32,
    // λ times the bending along the axis, about it, and the twist, per node.
    along: f32,
    around: f32,
    // A binding may begin at every 256 bytes.
    @size(228) twist: f32,
}

fn finest() -> Level {
    return Level(
        parameters.rings,
        parameters.nodes,
        parameters.node_count,
        0u,
        0u,
        parameters.along,
        parameters.around,
        parameters.twist,
    );
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

// State.done: the residual is small enough, the equations are not positive definite or not finite, or the steps ran out.
const CONVERGED = 1u;
const BROKEN = 2u;
const EXHAUSTED = 3u;
// The largest number of f32.
const MAX_F32 = 3.4028234e38;

// Values that pass from pass to pass.
struct State {
    // The known digits of the median, its rank among the residuals that share them, and the number of known
    // digits.
    prefix: u32,
    rank: u32,
    digits: u32,
    // How conjugate gradients ended (0 while they go on, CONVERGED, BROKEN or EXHAUSTED), the number of their steps, and the
    // square of the residual, in the preconditioner's norm, before the last of them.
    done: u32,
    steps: u32,
    residual_square: f32,
    // Square of the residual at which they end.
    max_residual_square: f32,
}

// What all workgroups of `apply` find before a step of conjugate gradients, and those of `cg_step` go by: as the state, but
// no pass reads what it writes.
struct NextStep {
    // How they end, 0 while they go on; the residual's square; the share of the last direction in the next.
    ends: u32,
    square: f32,
    beta: f32,
}

// Whether there is a solution to go on with.
fn is_solved(done: u32) -> bool {
    return done == CONVERGED || done == EXHAUSTED;
}
