//! The table of passes of the wall's fit on the device.

use crate::gpu::shader::{constants, shader};
use crate::sweep::wall::passes::{
    APPLY_COLUMNS, ASCEND_COLUMNS, DESCEND_COLUMNS, FLOOR, LOW_TILE_RINGS, MANY_NODES, MOST_COARSEST,
    MOST_OF_ONE, TILE_COLUMNS, TILE_RINGS,
};
use std::fmt::Write;

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
    /// One workgroup per 1024 nodes.
    NodeBlocks,
    /// One workgroup per tile of the finest grid with that many columns.
    Tiles(u32),
    /// One workgroup per tile of a grid that has a coarser one.
    LevelTiles(u32),
    /// One invocation per node of the next coarser one.
    CoarserNodes,
    /// One workgroup for all grids that it suffices for.
    CoarseGrids,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<Stage, Items>;

const PARAMETERS: &str = include_str!("../../../../shaders/sweep/common/parameters.wgsl");
const WALL_RESIDUAL: &str = include_str!("../../../../shaders/sweep/common/wall_residual.wgsl");
const STENCIL: &str = include_str!("../../../../shaders/sweep/common/stencil.wgsl");
const STENCIL_AT: &str = include_str!("../../../../shaders/sweep/common/stencil_at.wgsl");
const CLIMB: &str = include_str!("../../../../shaders/sweep/common/climb.wgsl");
const TILE: &str = include_str!("../../../../shaders/sweep/common/tile.wgsl");
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

/// The constants of the solver.
fn solver_constants() -> String {
    let mut text = constants([("FLOOR", FLOOR)]);
    for (name, value) in [
        ("MOST_COARSEST", MOST_COARSEST as u32),
        ("MOST_OF_ONE", MOST_OF_ONE),
        ("TILE_RINGS", TILE_RINGS),
        ("LOW_TILE_RINGS", LOW_TILE_RINGS),
        ("MANY_NODES", MANY_NODES),
        ("TILE_COLUMNS", TILE_COLUMNS),
        ("DESCEND_COLUMNS", DESCEND_COLUMNS),
        ("ASCEND_COLUMNS", ASCEND_COLUMNS),
        ("APPLY_COLUMNS", APPLY_COLUMNS),
    ] {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "const {name}: u32 = {value}u;");
    }
    text
}

/// A row: name and, where it differs, `in` the file's; stage, items, workgroup size, common files and
/// bindings.
macro_rules! pass {
    ($name:literal $(in $file:literal)?, $stage:ident, $items:ident $(($columns:ident))?, $size:literal, [$($common:ident),*],
     [$($binding:tt)*]) => {
        Pass {
            shader: shader!(
                "sweep", $name $(in $file)?, $size, [PARAMETERS, DISPATCH, $($common),*],
                ["parameters": Uniform, $($binding)*], { preamble: solver_constants }
            ),
            stage: Stage::$stage,
            items: Items::$items $(($columns))?,
        }
    };
}

/// Every pass, in the order in which they run; those of the multigrid cycle run grid by grid.
pub static PASSES: [Pass; 15] = [
    pass!("measure", Measure, Echoes, 256, [WALL_RESIDUAL], [
        "state": Read, "echoes": Read, "wall": Read, "shifts": Write, "residuals": Write,
    ]),
    pass!("count_residuals", MedianDigit, EchoBlocks, 256, [], ["residuals": Read, "state": Read, "counts": Write]),
    pass!("pick_digit", MedianDigit, One, 256, [SCAN], ["counts": Write, "state": Write]),
    pass!("accumulate", Equations, Echoes, 256, [WALL_RESIDUAL, SCALAR], [
        "echoes": Read, "wall": Read, "shifts": Read, "sums_low": Write, "sums_high": Write,
    ]),
    pass!("assemble", Equations, Nodes, 256, [STENCIL, STENCIL_AT, BENDING, SCALAR], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Write, "product": Write, "change": Write,
        "direction": Write,
    ]),
    pass!("lump", Equations, Nodes, 256, [STENCIL, STENCIL_AT, COUPLED, DIAGONAL], ["rows": Read, "own": Write]),
    pass!("coarsen", Coarsen, CoarserNodes, 64, [DIAGONAL, TRANSFER, RESTRICTED], ["levels": Read, "own": Write]),
    pass!("assemble_rhs", RightHandSide, Nodes, 256, [STENCIL, STENCIL_AT, COUPLED, SCALAR], [
        "sums_low": Read, "sums_high": Read, "wall": Read, "rows": Read, "cg_residual" = "rights": Write,
    ]),
    pass!("descend", Descend, LevelTiles(DESCEND_COLUMNS), 256, [
        STENCIL, TILE, CLIMB, BENDING, COUPLED, MATRIX, TRANSFER, RESTRICTED
    ], [
        "state": Read, "levels": Read, "rows": Read, "own": Read, "rights": Write, "values": Write,
    ]),
    pass!("coarse_cycle", Coarse, CoarseGrids, 256, [
        STENCIL, STENCIL_AT, BENDING, DIAGONAL, TRANSFER, RESTRICTED, INTERPOLATED
    ], [
        "state": Read, "levels": Read, "own": Read, "rights": Read, "results": Write,
    ]),
    pass!("ascend", Ascend, LevelTiles(ASCEND_COLUMNS), 256, [
        STENCIL, TILE, CLIMB, BENDING, COUPLED, MATRIX, TRANSFER, INTERPOLATED, SUM
    ], [
        "state": Read, "levels": Read, "rows": Read, "own": Read, "rights": Read, "values": Read, "results": Write,
        "squares": Write,
    ]),
    pass!("cg_limit", Limit, One, 256, [TILE, PARTIALS, SUM], ["partials" = "squares": Read, "state": Write]),
    pass!("apply", Step, Tiles(APPLY_COLUMNS), 256, [STENCIL, TILE, CLIMB, BENDING, COUPLED, PARTIALS, SUM], [
        "state": Read, "next_step": Write, "partials" = "squares": Read, "rows": Read, "preconditioned" = "results": Read,
        "direction": Read, "product": Write, "curvatures": Write,
    ]),
    pass!("cg_step", Step, NodeBlocks, 256, [TILE, PARTIALS, SUM], [
        "state": Write, "next_step": Read, "partials" = "curvatures": Read, "preconditioned" = "results": Read, "product": Read,
        "direction": Write, "change": Write, "cg_residual" = "rights": Write,
    ]),
    pass!("move_wall", Move, Nodes, 256, [SUM], [
        "state": Read, "change": Read, "rows": Read, "wall": Write, "travels": Write,
    ]),
];
