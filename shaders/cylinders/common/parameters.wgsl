// What every pass knows of the fit. Twin: cylinders/passes/parameters.rs; a test compares the layouts.

struct FitParameters {
    nodes: u32,
    levels: u32,
    faces: u32,
    node_count: u32,
    cylinders: u32,
    slots: u32,
    outliers: u32,
    statistic: u32,
    half_height: f32,
    step_theta: f32,
    step_z: f32,
    faces_per_rad: f32,
    faces_per_mm: f32,
    // 1: every slot belongs to cylinder 0 and passed the gate.
    single: u32,
    // Largest number of points of a short face, and of one of middle size.
    max_short: u32,
    max_middle: u32,
    // Largest number of points of a face that a subgroup measures, and the largest possible number of long faces, which
    // have more. Where no subgroup measures faces by itself: `max_middle`, and 0.
    max_narrow: u32,
    most_long: u32,
    pairs: u32,
    // Faces whose points are grouped at a time.
    window: u32,
    // 1 in the last iteration.
    last: u32,
}

struct Cylinder {
    gate_low: f32,
    gate_high: f32,
    // Steps per mm of the fixed-point sums, and its inverse.
    scale: f32,
    unit: f32,
}

// The points that a triangle's value comes from: their number, and the mean of their |distances|, mm.
struct TriangleSupport {
    kept: u32,
    residual: f32,
}

// A triangle's value as the passes exchange it: the complement of its bits, so that memory which was cleared
// holds no values.
const NO_VALUE: u32 = 0u;

fn value_word(value: f32) -> u32 {
    return ~bitcast<u32>(value);
}

// In front of the list of faces that are not short: the number of long ones, the number of those that were
// measured to the end, the number of faces of middle size, and the number of those that a subgroup measures. Long faces
// follow, behind room for all of them those of a subgroup; the others are listed from the end of the buffer backwards.
const LONG_COUNT: u32 = 0u;
const LONG_DONE: u32 = 1u;
const MIDDLE_COUNT: u32 = 2u;
const NARROW_COUNT: u32 = 3u;
const FIRST_LISTED: u32 = 4u;

const NONE: u32 = 0xffffffffu;
const OUTLIERS_IQR: u32 = 0u;
const OUTLIERS_DEVIATION: u32 = 1u;
const OUTLIERS_NONE: u32 = 2u;
const STATISTIC_MEAN: u32 = 0u;
const STATISTIC_MEDIAN: u32 = 1u;
