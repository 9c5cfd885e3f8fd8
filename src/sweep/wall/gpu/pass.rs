//! The table of passes of the wall's fit on the device.

use crate::gpu::shader::{constants, shader};
use crate::sweep::wall::passes::{FLOOR, MOST_COARSEST};

/// The part of the fit to which a pass belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The residual and the projection of every echo.
    Measure,
    /// A digit of the median of the residuals: four times.
    MedianDigit,
    /// The equations of a reweighting.
    Equations,
    /// The weights of each coarser grid.
    Coarsen,
    /// The right-hand side of the equations for whole radii.
    RightHandSide,
    /// The first relaxation of the multigrid cycle.
    Start,
    /// The multigrid cycle on the way to coarser grids: each of the finer ones.
    Descend,
    /// The cycle over all coarser ones.
    Coarse,
    /// The cycle on the way back.
    Ascend,
    /// The residual at which conjugate gradients stop.
    Limit,
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
    /// One invocation per node of a grid of the multigrid cycle.
    LevelNodes,
    /// One invocation per node of a grid that has a coarser one.
    FinerNodes,
    /// One invocation per node of the next coarser one.
    CoarserNodes,
    /// One workgroup for all grids that it suffices for.
    CoarseGrids,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<Stage, Items>;

const PARAMETERS: &str = include_str!("../../../../shaders/sweep/common/parameters.wgsl");
const WALL_RESIDUAL: &str = include_str!("../../../../shaders/sweep/common/wall_residual.wgsl");
const BENDING: &str = include_str!("../../../../shaders/sweep/common/bending.wgsl");
const COUPLED: &str = include_str!("../../../../shaders/sweep/common/coupled.wgsl");
const PARTIALS: &str = include_str!("../../../../shaders/sweep/common/partials.wgsl");
const SUM: &str = include_str!("../../../../shaders/sweep/common/sum.wgsl");
const DIAGONAL: &str = include_str!("../../../../shaders/sweep/common/diagonal.wgsl");
const MATRIX: &str = include_str!("../../../../shaders/sweep/common/matrix.wgsl");
const TRANSFER: &str = include_str!("../../../../shaders/sweep/common/transfer.wgsl");
const RESTRICTED: &str = include_str!("../../../../shaders/sweep/common/restricted.wgsl");
const INTERPOLATED: &str = include_str!("../../../../shaders/sweep/common/interpolated.wgsl");
const DISPATCH: &str = include_str!("../../../../shaders/common/dispatch.wgsl");
const SCALAR: &str = include_str!("../../../../shaders/common/scalar.wgsl");
const SCAN: &str = include_str!("../../../../shaders/common/scan.wgsl");

/// The constants of the multigrid cycle.
fn multigrid_constants() -> String {
    let numbers = constants([("FLOOR", FLOOR)]);
    format!("{numbers}const MOST_COARSEST: u32 = {MOST_COARSEST}u;\n")
}

/// A row: name and, where it differs, `in` the file's; stage, items, workgroup size, common files and
/// bindings.
macro_rules! pass {
    ($name:literal $(in $file:literal)?, $stage:ident, $items:ident, $size:literal, [$($common:ident),*],
     [$($binding:tt)*]) => {
        Pass {
            shader: shader!(
                "sweep", $name $(in $file)?, $size, [PARAMETERS, DISPATCH, $($common),*],
                ["parameters": Uniform, $($binding)*], { preamble: multigrid_constants }
            ),
            stage: Stage::$stage,
            items: Items::$items,
        }
    };
}

/// Every pass, in the order in which they run; those of the multigrid cycle run grid by grid.
pub static PASSES: [Pass; 23] = [
    pass!("measure", Measure, Echoes, 256, [WALL_RESIDUAL], [
        "state": Read, "echoes": Read, "wall": Read, "shifts": Write, "residuals": Write,
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
    pass!("lump", Equations, Nodes, 256, [COUPLED, DIAGONAL], ["rows": Read, "own": Write]),
    pass!("coarsen", Coarsen, CoarserNodes, 64, [DIAGONAL, TRANSFER, RESTRICTED], ["levels": Read, "own": Write]),
    pass!("assemble_rhs", RightHandSide, Nodes, 256, [COUPLED, SCALAR], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Read, "cg_residual" = "rights": Write,
    ]),
    pass!("smooth_zero", Start, Nodes, 256, [], ["state": Read, "own": Read, "rights": Read, "others": Write]),
    pass!("smooth_second" in "smooth", Descend, LevelNodes, 256, [BENDING, COUPLED, MATRIX], [
        "state": Read, "levels": Read, "rows": Read, "own": Read, "rights": Read, "before" = "others": Read,
        "after" = "values": Write,
    ]),
    pass!("remainder", Descend, LevelNodes, 256, [BENDING, COUPLED, MATRIX], [
        "state": Read, "levels": Read, "rows": Read, "own": Read, "rights": Read, "values": Read, "others": Write,
    ]),
    pass!("restrict", Descend, CoarserNodes, 64, [TRANSFER, RESTRICTED], [
        "state": Read, "levels": Read, "own": Read, "rights": Write, "others": Write,
    ]),
    pass!("coarse_cycle", Coarse, CoarseGrids, 256, [BENDING, DIAGONAL, TRANSFER, RESTRICTED, INTERPOLATED], [
        "state": Read, "levels": Read, "own": Read, "rights": Write, "values": Write, "others": Write,
    ]),
    pass!("prolong", Ascend, FinerNodes, 256, [TRANSFER, INTERPOLATED], [
        "state": Read, "levels": Read, "values": Write,
    ]),
    pass!("smooth_last_but_one" in "smooth", Ascend, LevelNodes, 256, [BENDING, COUPLED, MATRIX], [
        "state": Read, "levels": Read, "rows": Read, "own": Read, "rights": Read, "before" = "values": Read,
        "after" = "others": Write,
    ]),
    pass!("smooth_last", Ascend, LevelNodes, 256, [BENDING, COUPLED, MATRIX, SUM], [
        "state": Read, "levels": Read, "rows": Read, "own": Read, "rights": Read, "others": Read, "values": Write,
        "partials": Write,
    ]),
    pass!("cg_limit", Limit, One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("cg_beta", Step, One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("cg_direction", Step, Nodes, 256, [], [
        "state": Read, "preconditioned" = "values": Read, "direction": Write,
    ]),
    pass!("apply", Step, Nodes, 256, [BENDING, COUPLED, SUM], [
        "state": Read, "rows": Read, "direction": Read, "product": Write, "partials": Write,
    ]),
    pass!("cg_alpha", Step, One, 256, [PARTIALS, SUM], ["partials": Read, "state": Write]),
    pass!("cg_step", Step, Nodes, 256, [], [
        "state": Read, "direction": Read, "product": Read, "change": Write, "cg_residual" = "rights": Write,
    ]),
    pass!("move_wall", Move, Nodes, 256, [SUM], [
        "state": Read, "change": Read, "rows": Read, "wall": Write, "partials": Write,
    ]),
];
