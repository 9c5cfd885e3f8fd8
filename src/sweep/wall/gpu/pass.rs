//! The passes of the wall's fit on the device: what each binds and what its workgroups are for, written once.

use crate::gpu::shader::shader;

/// What a pass has a workgroup or an invocation for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// An invocation an echo of a chunk.
    Echoes,
    /// A workgroup for every 4096 echoes of a chunk.
    EchoBlocks,
    /// One workgroup.
    One,
    /// An invocation a node.
    Nodes,
    /// A workgroup a ring.
    Rings,
    /// An invocation a frequency of each ring.
    Frequencies,
    /// An invocation a wave of a block of rings.
    BlockWaves,
    /// An invocation a wave.
    Waves,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<(), Items>;

const JOB: &str = include_str!("../../../../shaders/sweep/common/job.wgsl");
const ECHO: &str = include_str!("../../../../shaders/sweep/common/echo.wgsl");
const BENDING: &str = include_str!("../../../../shaders/sweep/common/bending.wgsl");
const BLOCKS: &str = include_str!("../../../../shaders/sweep/common/blocks.wgsl");
const COUPLED: &str = include_str!("../../../../shaders/sweep/common/coupled.wgsl");
const PARTIALS: &str = include_str!("../../../../shaders/sweep/common/partials.wgsl");
const SUM: &str = include_str!("../../../../shaders/sweep/common/sum.wgsl");
const JOIN: &str = include_str!("../../../../shaders/sweep/common/join.wgsl");
const PART: &str = include_str!("../../../../shaders/sweep/common/part.wgsl");
const EXACT: &str = include_str!("../../../../shaders/common/scalar.wgsl");

macro_rules! pass {
    ($name:literal $(in $file:literal)?, $items:ident, $size:literal, [$($common:ident),*], [$($binding:tt)*]) => {
        Pass {
            shader: shader!(
                "sweep", $name $(in $file)?, $size, [JOB, $($common),*], ["job": Uniform, $($binding)*], {}
            ),
            stage: (),
            items: Items::$items,
        }
    };
}

/// Every pass, in the order in which they run: `count_misses` and `pick_digit` four times, those from `part_residual` to
/// `advance` once for each step of conjugate gradients.
pub static PASSES: [Pass; 20] = [
    pass!("measure", Echoes, 256, [ECHO], ["echoes": Read, "wall": Read, "shifts": Write, "misses": Write]),
    pass!("count_misses", EchoBlocks, 256, [], ["misses": Read, "state": Read, "counts": Write]),
    pass!("pick_digit", One, 256, [], ["counts": Write, "state": Write]),
    pass!("accumulate", Echoes, 256, [ECHO, EXACT], [
        "echoes": Read, "wall": Read, "shifts": Read, "sums_low": Write, "sums_high": Write,
    ]),
    pass!("assemble", Nodes, 256, [BENDING, EXACT], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Write, "product": Write, "change": Write,
        "direction": Write,
    ]),
    pass!("aim", Nodes, 256, [COUPLED, EXACT], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Read, "residual": Write,
    ]),
    pass!("weigh_rings", Rings, 256, [SUM], ["rows": Read, "ring_weights": Write]),
    pass!("part_residual", Nodes, 256, [PART], [
        "state": Read, "waves": Read, "residual": Read, "parts": Write,
    ]),
    pass!("join_waves", Frequencies, 256, [JOIN], [
        "state": Read, "waves": Read, "parts": Read, "spectrum": Write,
    ]),
    pass!("eliminate", BlockWaves, 64, [BLOCKS], [
        "state": Read, "factors": Read, "spectrum": Write, "pulls": Write,
    ]),
    pass!("couple", Waves, 64, [BLOCKS], [
        "state": Read, "joints": Read, "pulls": Read, "spectrum": Write,
    ]),
    pass!("substitute", BlockWaves, 64, [BLOCKS], ["state": Read, "factors": Read, "spectrum": Write]),
    pass!("part_waves", Nodes, 256, [PART], [
        "state": Read, "waves": Read, "spectrum": Read, "parts": Write,
    ]),
    pass!("join_values", Frequencies, 256, [JOIN, SUM], [
        "state": Read, "waves": Read, "parts": Read, "residual": Read, "preconditioned": Write, "partials": Write,
    ]),
    pass!("turn", One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("redirect", Nodes, 256, [], ["state": Read, "preconditioned": Read, "direction": Write]),
    pass!("apply", Nodes, 256, [BENDING, COUPLED, SUM], [
        "state": Read, "rows": Read, "direction": Read, "product": Write, "partials": Write,
    ]),
    pass!("stride", One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("advance", Nodes, 256, [], [
        "state": Read, "direction": Read, "product": Read, "change": Write, "residual": Write,
    ]),
    pass!("move_wall", Nodes, 256, [SUM], ["change": Read, "wall": Write, "partials": Write]),
];

/// The passes of the preconditioner, and those that follow it in a step of conjugate gradients.
pub(super) const PRECONDITION: [&str; 7] =
    ["part_residual", "join_waves", "eliminate", "couple", "substitute", "part_waves", "join_values"];
pub(super) const STEP: [&str; 5] = ["turn", "redirect", "apply", "stride", "advance"];
