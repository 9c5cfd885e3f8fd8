//! The table of passes of the wall's fit on the device.

use crate::gpu::shader::shader;

/// The part of the fit to which a pass belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The residual and the projection of every echo.
    Measure,
    /// A digit of the median of the residuals: four times.
    MedianDigit,
    /// The equations of a reweighting.
    Equations,
    /// Their right-hand side for whole radii.
    RightHandSide,
    /// The preconditioner, in each step of conjugate gradients.
    Precondition,
    /// The rest of each step of conjugate gradients.
    Step,
    /// The move of the wall by their solution.
    Move,
}

/// The items that the workgroups or invocations of a pass process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// One invocation per echo of a chunk.
    Echoes,
    /// One workgroup per 4096 echoes of a chunk.
    EchoBlocks,
    /// One workgroup.
    One,
    /// One invocation per node.
    Nodes,
    /// One workgroup per ring.
    Rings,
    /// One invocation per frequency of each ring.
    Frequencies,
    /// One invocation per Hartley coefficient of each block of rings.
    BlockCoefficients,
    /// One invocation per Hartley coefficient.
    Coefficients,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<Stage, Items>;

const PARAMETERS: &str = include_str!("../../../../shaders/sweep/common/parameters.wgsl");
const WALL_RESIDUAL: &str = include_str!("../../../../shaders/sweep/common/wall_residual.wgsl");
const BENDING: &str = include_str!("../../../../shaders/sweep/common/bending.wgsl");
const BLOCKS: &str = include_str!("../../../../shaders/sweep/common/blocks.wgsl");
const COUPLED: &str = include_str!("../../../../shaders/sweep/common/coupled.wgsl");
const PARTIALS: &str = include_str!("../../../../shaders/sweep/common/partials.wgsl");
const SUM: &str = include_str!("../../../../shaders/sweep/common/sum.wgsl");
const HARTLEY_SECOND: &str = include_str!("../../../../shaders/sweep/common/hartley_second.wgsl");
const DISPATCH: &str = include_str!("../../../../shaders/common/dispatch.wgsl");
const SCALAR: &str = include_str!("../../../../shaders/common/scalar.wgsl");
const SCAN: &str = include_str!("../../../../shaders/common/scan.wgsl");

/// A row: name and, where it differs, `in` the file's; stage, items, workgroup size, common files and
/// bindings.
macro_rules! pass {
    ($name:literal $(in $file:literal)?, $stage:ident, $items:ident, $size:literal, [$($common:ident),*],
     [$($binding:tt)*]) => {
        Pass {
            shader: shader!(
                "sweep", $name $(in $file)?, $size, [PARAMETERS, DISPATCH, $($common),*],
                ["parameters": Uniform, $($binding)*], {}
            ),
            stage: Stage::$stage,
            items: Items::$items,
        }
    };
}

/// Every pass, in the order in which they run.
pub static PASSES: [Pass; 20] = [
    pass!("measure", Measure, Echoes, 256, [WALL_RESIDUAL], [
        "echoes": Read, "wall": Read, "shifts": Write, "residuals": Write,
    ]),
    pass!("count_residuals", MedianDigit, EchoBlocks, 256, [], ["residuals": Read, "state": Read, "counts": Write]),
    pass!("pick_digit", MedianDigit, One, 256, [SCAN], ["counts": Write, "state": Write]),
    pass!("accumulate", Equations, Echoes, 256, [WALL_RESIDUAL, SCALAR], [
        "echoes": Read, "wall": Read, "shifts": Read, "sums_low": Write, "sums_high": Write,
    ]),
    pass!("assemble", Equations, Nodes, 256, [BENDING, SCALAR], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Write, "product": Write, "change": Write,
        "direction": Write,
    ]),
    pass!("weigh_rings", Equations, Rings, 256, [SUM], ["rows": Read, "ring_weights": Write]),
    pass!("assemble_rhs", RightHandSide, Nodes, 256, [COUPLED, SCALAR], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Read, "cg_residual": Write,
    ]),
    pass!("hartley_first_residual" in "hartley_first", Precondition, Nodes, 256, [], [
        "state": Read, "twiddles": Read, "values" = "cg_residual": Read, "intermediate": Write,
    ]),
    pass!("hartley_second_spectrum", Precondition, Frequencies, 256, [HARTLEY_SECOND], [
        "state": Read, "twiddles": Read, "intermediate": Read, "spectrum": Write,
    ]),
    pass!("eliminate", Precondition, BlockCoefficients, 64, [BLOCKS], [
        "state": Read, "factors": Read, "spectrum": Write, "updates": Write,
    ]),
    pass!("couple", Precondition, Coefficients, 64, [BLOCKS], [
        "state": Read, "separators": Read, "updates": Read, "spectrum": Write,
    ]),
    pass!("substitute", Precondition, BlockCoefficients, 64, [BLOCKS], [
        "state": Read, "factors": Read, "spectrum": Write,
    ]),
    pass!("hartley_first_spectrum" in "hartley_first", Precondition, Nodes, 256, [], [
        "state": Read, "twiddles": Read, "values" = "spectrum": Read, "intermediate": Write,
    ]),
    pass!("hartley_second_values", Precondition, Frequencies, 256, [HARTLEY_SECOND, SUM], [
        "state": Read, "twiddles": Read, "intermediate": Read, "cg_residual": Read, "preconditioned": Write,
        "partials": Write,
    ]),
    pass!("cg_beta", Step, One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("cg_direction", Step, Nodes, 256, [], ["state": Read, "preconditioned": Read, "direction": Write]),
    pass!("apply", Step, Nodes, 256, [BENDING, COUPLED, SUM], [
        "state": Read, "rows": Read, "direction": Read, "product": Write, "partials": Write,
    ]),
    pass!("cg_alpha", Step, One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("cg_step", Step, Nodes, 256, [], [
        "state": Read, "direction": Read, "product": Read, "change": Write, "cg_residual": Write,
    ]),
    pass!("move_wall", Move, Nodes, 256, [SUM], ["change": Read, "rows": Read, "wall": Write, "partials": Write]),
];
