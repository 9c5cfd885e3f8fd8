//! The pass table: the bindings, the workgroup size and the number of workgroups of every pass.

use crate::gpu::constants;
use crate::gpu::shader::shader;
use crate::numerics::ANGLE_COEFFICIENTS;

/// When a pass runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Once, to transform points into tube coordinates.
    Project,
    /// Once, to group them by face.
    Group,
    /// Once, to find the long faces.
    Classify,
    /// In every iteration.
    Iterate,
    /// Once, after the last iteration.
    Support,
}

/// What a pass has one workgroup or one invocation for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// One workgroup per pair of cylinder and frame.
    Pairs,
    /// One invocation per point before the gate.
    Slots,
    /// One workgroup per 1024 faces of the batch.
    Blocks,
    /// One workgroup.
    One,
    /// One invocation per face of the batch.
    AllFaces,
    /// [`LANES`] invocations per face, cylinder by cylinder.
    ShortFaces,
    /// Workgroups that take the long faces in turn.
    LongFaces,
    /// One invocation per face, cylinder by cylinder.
    Faces,
    /// One invocation per node, cylinder by cylinder.
    Nodes,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<Stage, Items>;

const ANGLE: &str = include_str!("../../../../shaders/common/angle.wgsl");
const DISPATCH: &str = include_str!("../../../../shaders/common/dispatch.wgsl");
const SCALAR: &str = include_str!("../../../../shaders/common/scalar.wgsl");
const SCAN: &str = include_str!("../../../../shaders/common/scan.wgsl");
const PARAMETERS: &str = include_str!("../../../../shaders/cylinders/common/parameters.wgsl");
const DISTANCE: &str = include_str!("../../../../shaders/cylinders/common/distance.wgsl");
const FILTER: &str = include_str!("../../../../shaders/cylinders/common/filter.wgsl");

/// A row: name and, where it differs, `in` the file's; stage, items, workgroup size, common files, bindings (a
/// variable is bound to the buffer of its name, or with `=` to another), and `{ field: value }` of optional fields.
macro_rules! pass {
    ($name:literal $(in $file:literal)?, $stage:ident, $items:ident, $size:literal, [$($common:ident),*],
     [$($binding:tt)*], { $($field:tt)* }) => {
        Pass {
            shader: shader!(
                "cylinders", $name $(in $file)?, $size, [PARAMETERS, $($common),*],
                ["parameters": Uniform, $($binding)*], { $($field)* }
            ),
            stage: Stage::$stage,
            items: Items::$items,
        }
    };
    ($($row:tt)*) => {
        pass!($($row)*, {})
    };
}

/// Every pass, in the order in which they run.
pub static PASSES: [Pass; 13] = [
    pass!("project", Project, Pairs, 64, [DISPATCH, ANGLE], [
        "cylinders": Read, "points": Read, "pairs": Read, "section": Write, "owners": Write, "gated": Write,
    ], { preamble: angle_constants }),
    pass!("bin", Group, Slots, 256, [DISPATCH], [
        "section": Read, "owners": Read, "counts": Write, "places": Write,
    ]),
    pass!("scan_reduce", Group, Blocks, 256, [DISPATCH], ["counts": Read, "block_sums": Write]),
    pass!("scan_spine", Group, One, 256, [SCAN], ["block_sums": Write]),
    pass!("scan_downsweep", Group, Blocks, 256, [DISPATCH, SCAN], [
        "counts": Read, "block_sums": Read, "offsets": Write,
    ]),
    pass!("scatter", Group, Slots, 256, [DISPATCH], [
        "section": Read, "places": Read, "offsets": Read, "grouped": Write,
    ]),
    pass!("classify", Classify, AllFaces, 256, [DISPATCH], ["offsets": Read, "long_faces": Write]),
    pass!("measure_short", Iterate, ShortFaces, 128, [DISPATCH, DISTANCE, SCALAR, FILTER], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "statistics": Write,
    ], { variants: Some(("LANES", &LANES)) }),
    pass!("measure_long", Iterate, LongFaces, 256, [DISPATCH, DISTANCE, SCALAR, SCAN, FILTER], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "statistics": Write,
        "long_faces": Write, "keys": Write,
    ]),
    pass!("fill_bottom" in "fill", Iterate, Faces, 64, [DISPATCH], [
        "statistics": Read, "values": Write,
    ], { constants: &[("TOP", 0.0)] }),
    pass!("fill_top" in "fill", Iterate, Faces, 64, [DISPATCH], [
        "statistics": Read, "values": Write,
    ], { constants: &[("TOP", 1.0)] }),
    pass!("update", Iterate, Nodes, 64, [DISPATCH, SCALAR], [
        "cylinders": Read, "values": Read, "radii": Write, "travels": Write,
    ]),
    pass!("support", Support, Nodes, 64, [DISPATCH], [
        "statistics": Read, "support": Write, "residuals": Write, "tallies": Write, "offsets": Read,
    ]),
];

/// Numbers of invocations per short face that `measure_short` is built for.
pub const LANES: [u32; 5] = [2, 4, 8, 16, 32];

/// The constants of the arc tangent.
fn angle_constants() -> String {
    use std::f32::consts::{FRAC_PI_2, PI, TAU};
    let coefficients = (0..).zip(ANGLE_COEFFICIENTS).map(|(i, c)| (format!("ANGLE_{i}"), c));
    let angles = [("ANGLE_HALF_PI", FRAC_PI_2), ("ANGLE_PI", PI), ("ANGLE_TAU", TAU)];
    constants(coefficients.chain(angles.map(|(name, value)| (name.to_owned(), value))))
}
