//! The pass table: the bindings, the workgroup size and the number of workgroups of every pass.

use crate::gpu::constants;
use crate::gpu::shader::shader;
use crate::numerics::ANGLE_COEFFICIENTS;

/// When a pass runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Once, to transform points into tube coordinates.
    Project,
    /// Once, to group them by face and to find the long faces.
    Group,
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
    /// One workgroup, where there are few points and at most 1024 faces in the batch.
    FewPoints,
    /// The same, four times as large, where the device has such workgroups.
    FewPointsWide,
    /// One workgroup per 1024 points before the gate, where there are more than 1024 faces in the batch.
    Tiles,
    /// One workgroup per 1024 points before the gate, where there are not.
    FewTiles,
    /// One invocation per point before the gate, window of places by window.
    Slots,
    /// One workgroup per 1024 faces of the batch; not needed where there is only one.
    SeveralBlocks,
    /// One workgroup; not needed where there is only one block of 1024 faces.
    Spine,
    /// One workgroup per 1024 faces of the batch.
    Blocks,
    /// One invocation per face, cylinder by cylinder, where faces have very few points.
    FewFaces,
    /// [`LANES`] invocations per face, cylinder by cylinder, with subgroups.
    ShortFaces,
    /// The same without subgroups.
    ShortFacesShared,
    /// Workgroups that take the faces of middle size in turn, [`LANES`] invocations per face, with subgroups.
    MiddleFaces,
    /// The same without subgroups.
    MiddleFacesShared,
    /// Subgroups that take faces with more points than those of middle size in turn, on a software device.
    NarrowFaces,
    /// Workgroups that take the long faces in turn, where they have not so many points that `distance` comes
    /// first.
    LongFaces,
    /// One invocation per point, where every face is a long one with very many points.
    Points,
    /// Workgroups that take the long faces in turn after `distance`.
    KeyedFaces,
    /// The same, four times as large, where the device has such workgroups.
    KeyedFacesWide,
    /// One invocation per node, cylinder by cylinder.
    Nodes,
    /// Workgroups that take the nodes in turn, cylinder by cylinder.
    NodesInTurn,
}

/// A row of the pass table.
pub type Pass = crate::gpu::Pass<Stage, Items>;

const ANGLE: &str = include_str!("../../../../shaders/common/angle.wgsl");
const DISPATCH: &str = include_str!("../../../../shaders/common/dispatch.wgsl");
const SCALAR: &str = include_str!("../../../../shaders/common/scalar.wgsl");
const SCAN: &str = include_str!("../../../../shaders/common/scan.wgsl");
const PARAMETERS: &str = include_str!("../../../../shaders/cylinders/common/parameters.wgsl");
const DISTANCE: &str = include_str!("../../../../shaders/cylinders/common/distance.wgsl");
const FILL: &str = include_str!("../../../../shaders/cylinders/common/fill.wgsl");
const STATISTIC: &str = include_str!("../../../../shaders/cylinders/common/statistic.wgsl");
const EIGHT_KEYS: &str = include_str!("../../../../shaders/cylinders/common/eight_keys.wgsl");
const MEASURE_SHORT: &str = include_str!("../../../../shaders/cylinders/common/measure_short.wgsl");
const LISTING: &str = include_str!("../../../../shaders/cylinders/common/listing.wgsl");
const POINTS: &str = include_str!("../../../../shaders/cylinders/common/points.wgsl");
const FILTER: &str = include_str!("../../../../shaders/cylinders/common/filter.wgsl");
const POINT_KEY: &str = include_str!("../../../../shaders/cylinders/common/point_key.wgsl");

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
pub static PASSES: [Pass; 21] = [
    pass!("project", Project, Pairs, 64, [DISPATCH, ANGLE], [
        "cylinders": Read, "points": Read, "pairs": Read, "section": Write, "owners": Write, "gated": Write,
    ], { preamble: angle_constants }),
    pass!("group_few", Group, FewPoints, 256, [SCAN, POINTS, LISTING], [
        "section": Read, "owners": Read, "offsets": Write, "listed_faces": Write, "grouped": Write,
    ], { constants: &[("THREADS", 256.0)] }),
    pass!("group_few_wide" in "group_few", Group, FewPointsWide, 1024, [SCAN, POINTS, LISTING], [
        "section": Read, "owners": Read, "offsets": Write, "listed_faces": Write, "grouped": Write,
    ], { constants: &[("THREADS", 1024.0)] }),
    pass!("bin", Group, Tiles, 256, [DISPATCH, POINTS], [
        "section": Read, "owners": Read, "counts": Write, "places": Write,
    ], { constants: &[("FEW", 0.0)] }),
    pass!("bin_few" in "bin", Group, FewTiles, 256, [DISPATCH, POINTS], [
        "section": Read, "owners": Read, "counts": Write, "places": Write,
    ], { constants: &[("FEW", 1.0)] }),
    pass!("scan_reduce", Group, SeveralBlocks, 256, [DISPATCH], ["counts": Read, "block_sums": Write]),
    pass!("scan_spine", Group, Spine, 256, [SCAN], ["block_sums": Write]),
    pass!("scan_downsweep", Group, Blocks, 256, [DISPATCH, SCAN, LISTING], [
        "counts": Read, "block_sums": Read, "offsets": Write, "listed_faces": Write,
    ]),
    pass!("scatter", Group, Slots, 256, [DISPATCH, POINTS], [
        "section": Read, "owners": Read, "places": Read, "offsets": Read, "grouped": Write,
    ]),
    pass!("measure_few", Iterate, FewFaces, 128, [DISPATCH, DISTANCE, SCALAR, FILTER, POINT_KEY, STATISTIC, EIGHT_KEYS], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write,
    ]),
    pass!("measure_short", Iterate, ShortFaces, 128, [
        DISPATCH, DISTANCE, SCALAR, FILTER, POINT_KEY, STATISTIC, EIGHT_KEYS, MEASURE_SHORT
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Read,
    ], { constants: &[("MIDDLE", 0.0)], variants: Some(("LANES", &LANES)), subgroups: true }),
    pass!("measure_short_shared", Iterate, ShortFacesShared, 128, [
        DISPATCH, DISTANCE, SCALAR, FILTER, POINT_KEY, STATISTIC, EIGHT_KEYS, MEASURE_SHORT
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Read,
    ], { constants: &[("MIDDLE", 0.0)], variants: Some(("LANES", &LANES)) }),
    pass!("measure_middle" in "measure_short", Iterate, MiddleFaces, 128, [
        DISPATCH, DISTANCE, SCALAR, FILTER, POINT_KEY, STATISTIC, EIGHT_KEYS, MEASURE_SHORT
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Read,
    ], { constants: &[("MIDDLE", 1.0)], variants: Some(("LANES", &MIDDLE_LANES)), subgroups: true }),
    pass!("measure_middle_shared" in "measure_short_shared", Iterate, MiddleFacesShared, 128, [
        DISPATCH, DISTANCE, SCALAR, FILTER, POINT_KEY, STATISTIC, EIGHT_KEYS, MEASURE_SHORT
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Read,
    ], { constants: &[("MIDDLE", 1.0)], variants: Some(("LANES", &MIDDLE_LANES)) }),
    pass!("measure_narrow", Iterate, NarrowFaces, 32, [
        DISPATCH, DISTANCE, SCALAR, FILTER, POINT_KEY, EIGHT_KEYS, STATISTIC
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Write, "keys": Write,
    ], { subgroups: true }),
    pass!("measure_long", Iterate, LongFaces, 256, [DISPATCH, DISTANCE, SCALAR, SCAN, FILTER, POINT_KEY], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Write, "keys": Write,
    ], { constants: &[("KEYED", 0.0), ("THREADS", 256.0)] }),
    pass!("distance", Iterate, Points, 256, [DISPATCH, DISTANCE, FILTER, POINT_KEY], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "keys": Write,
    ]),
    pass!("measure_long_keyed" in "measure_long", Iterate, KeyedFaces, 256, [
        DISPATCH, DISTANCE, SCALAR, SCAN, FILTER, POINT_KEY
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Write, "keys": Write,
    ], { constants: &[("KEYED", 1.0), ("THREADS", 256.0)] }),
    pass!("measure_long_wide" in "measure_long", Iterate, KeyedFacesWide, 1024, [
        DISPATCH, DISTANCE, SCALAR, SCAN, FILTER, POINT_KEY
    ], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "triangle_values": Write,
        "triangle_support": Write, "listed_faces": Write, "keys": Write,
    ], { constants: &[("KEYED", 1.0), ("THREADS", 1024.0)] }),
    pass!("update", Iterate, NodesInTurn, 256, [DISPATCH, SCALAR, FILL], [
        "cylinders": Read, "triangle_values": Read, "radii": Write, "travels": Write,
    ]),
    pass!("support", Support, Nodes, 64, [DISPATCH], [
        "triangle_support": Read, "support": Write, "residuals": Write, "tallies": Write, "offsets": Read,
    ]),
];

/// Numbers of invocations per short face that `measure_short` is built for. Each has eight of the face's
/// points.
pub const LANES: [u32; 6] = [1, 2, 4, 8, 16, 32];

/// The same for `measure_middle`.
const MIDDLE_LANES: [u32; 5] = [2, 4, 8, 16, 32];

/// The constants of the arc tangent.
fn angle_constants() -> String {
    use std::f32::consts::{FRAC_PI_2, PI, TAU};
    let coefficients = (0..).zip(ANGLE_COEFFICIENTS).map(|(i, c)| (format!("ANGLE_{i}"), c));
    let angles = [("ANGLE_HALF_PI", FRAC_PI_2), ("ANGLE_PI", PI), ("ANGLE_TAU", TAU)];
    constants(coefficients.chain(angles.map(|(name, value)| (name.to_owned(), value))))
}
