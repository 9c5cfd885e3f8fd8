//! The passes on the device: what each binds and how many invocations a workgroup has, written once.

use crate::gpu::constants;
use crate::gpu::shader::shader;
use crate::numerics::ANGLE_COEFFICIENTS;

/// When a pass runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Once, to bring points into tubes.
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

/// What a pass has a workgroup or an invocation for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// A workgroup a pair of cylinder and frame.
    Pairs,
    /// An invocation a point before the gate.
    Slots,
    /// A workgroup for every 1024 faces of the batch.
    Blocks,
    /// One workgroup.
    One,
    /// An invocation a face of the batch.
    AllFaces,
    /// [`LANES`] invocations a face, cylinder by cylinder.
    ShortFaces,
    /// A workgroup a long face at a time.
    LongFaces,
    /// An invocation a face, cylinder by cylinder.
    Faces,
    /// An invocation a node, cylinder by cylinder.
    Nodes,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<Stage, Items>;

const JOB: &str = include_str!("../../../../shaders/cylinders/common/job.wgsl");
const ANGLE: &str = include_str!("../../../../shaders/cylinders/common/angle.wgsl");
const DISTANCE: &str = include_str!("../../../../shaders/cylinders/common/distance.wgsl");
const EXACT: &str = include_str!("../../../../shaders/common/exact.wgsl");
const FILTER: &str = include_str!("../../../../shaders/cylinders/common/filter.wgsl");

/// A row: name and, where it differs, `in` the file's, stage, items, workgroup size, common files, bindings (a variable is
/// bound to the buffer of its name, or `=` to that of another), and `{ field: value }` of what few shaders have.
macro_rules! pass {
    ($name:literal $(in $file:literal)?, $stage:ident, $items:ident, $size:literal, [$($common:ident),*],
     [$($binding:tt)*], { $($field:tt)* }) => {
        Pass {
            shader: shader!(
                "cylinders", $name $(in $file)?, $size, [JOB, $($common),*], ["job": Uniform, $($binding)*],
                { preamble: angle_constants, $($field)* }
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
    pass!("project", Project, Pairs, 64, [ANGLE], [
        "cylinders": Read, "points": Read, "pairs": Read, "section": Write, "owners": Write, "gated": Write,
    ]),
    pass!("bin", Group, Slots, 256, [], ["section": Read, "owners": Read, "counts": Write, "places": Write]),
    pass!("scan_reduce", Group, Blocks, 256, [], ["counts": Read, "block_sums": Write]),
    pass!("scan_spine", Group, One, 256, [], ["block_sums": Write]),
    pass!("scan_downsweep", Group, Blocks, 256, [], ["counts": Read, "block_sums": Read, "offsets": Write]),
    pass!("scatter", Group, Slots, 256, [], ["section": Read, "places": Read, "offsets": Read, "grouped": Write]),
    pass!("classify", Classify, AllFaces, 256, [], ["offsets": Read, "long_faces": Write]),
    pass!("measure_short", Iterate, ShortFaces, 128, [DISTANCE, EXACT, FILTER], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "statistics": Write,
    ], { variants: Some(("LANES", &LANES)) }),
    pass!("measure_long", Iterate, LongFaces, 256, [DISTANCE, EXACT, FILTER], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "statistics": Write,
        "long_faces": Write, "keys": Write,
    ]),
    pass!("fill_bottom", Iterate, Faces, 64, [], ["statistics": Read, "values": Write]),
    pass!("fill_top", Iterate, Faces, 64, [], ["statistics": Read, "values": Write]),
    pass!("update", Iterate, Nodes, 64, [EXACT], ["cylinders": Read, "values": Read, "radii": Write, "travels": Write]),
    pass!("support", Support, Nodes, 64, [], [
        "statistics": Read, "support": Write, "residuals": Write, "tallies": Write,
        "offsets": Read,
    ]),
];

/// Invocations a short face that `measure_short` is built for.
pub const LANES: [u32; 5] = [2, 4, 8, 16, 32];

/// The constants of the arc tangent.
fn angle_constants() -> String {
    use std::f32::consts::{FRAC_PI_2, PI, TAU};
    let coefficients = (0..).zip(ANGLE_COEFFICIENTS).map(|(i, c)| (format!("ANGLE_{i}"), c));
    let angles = [("ANGLE_HALF_PI", FRAC_PI_2), ("ANGLE_PI", PI), ("ANGLE_TAU", TAU)];
    constants(coefficients.chain(angles.map(|(name, value)| (name.to_owned(), value))))
}
