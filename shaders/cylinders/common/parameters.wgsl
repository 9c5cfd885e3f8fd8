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
    // Largest number of points of a short face.
    max_short: u32,
    pairs: u32,
    // Places among the grouped points that are written at a time.
    window: u32,
}

struct Cylinder {
    gate_low: f32,
    gate_high: f32,
    // Steps per mm of the fixed-point sums, and its inverse.
    scale: f32,
    unit: f32,
}

struct TriangleStatistic {
    value: f32,
    kept: u32,
    residual: f32,
}

const NONE: u32 = 0xffffffffu;
const OUTLIERS_IQR: u32 = 0u;
const OUTLIERS_DEVIATION: u32 = 1u;
const OUTLIERS_NONE: u32 = 2u;
const STATISTIC_MEAN: u32 = 0u;
const STATISTIC_MEDIAN: u32 = 1u;
