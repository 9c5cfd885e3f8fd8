//! What the passes know of a fit, and the statistic that they exchange. The shaders' structures are in
//! `shaders/cylinders/common/parameters.wgsl`; a test compares the layouts.

use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;
use crate::settings::{Outliers, Settings, Statistic};
use bytemuck::{Pod, Zeroable};

/// The mark of a point that belongs to no face, because it did not pass the gate.
pub const NONE: u32 = u32::MAX;

/// The steps of a tube's grid, as every pass uses them.
#[derive(Debug, Clone, Copy)]
pub struct TubeGrid<T> {
    /// N: nodes per ring.
    pub nodes: u32,
    /// L: levels of faces.
    pub levels: u32,
    /// H/2, mm.
    pub half_height: T,
    /// 2π/N, rad.
    pub step_theta: T,
    /// H/L, mm.
    pub step_z: T,
    /// N/2π, 1/rad.
    pub faces_per_rad: T,
    /// L/H, 1/mm.
    pub faces_per_mm: T,
}

impl<T: Scalar> TubeGrid<T> {
    /// The grid of a tube.
    pub fn new(tube: &Tube) -> Self {
        let (n, l, h) = (tube.nodes as f64, tube.levels as f64, tube.height_mm);
        Self {
            nodes: tube.nodes as u32,
            levels: tube.levels as u32,
            half_height: T::from_f64(h / 2.0),
            step_theta: T::from_f64(std::f64::consts::TAU / n),
            step_z: T::from_f64(h / l),
            faces_per_rad: T::from_f64(n / std::f64::consts::TAU),
            faces_per_mm: T::from_f64(l / h),
        }
    }

    /// N·L.
    pub fn face_count(&self) -> u32 {
        self.nodes * self.levels
    }

    /// Level and node of the face that holds a point with that angle (rad) and height (mm).
    #[inline(always)]
    pub fn face(&self, theta: T, z: T) -> (u32, u32) {
        let level = ((z + self.half_height) * self.faces_per_mm).floor_to_u32().min(self.levels - 1);
        let node = (theta * self.faces_per_rad).floor_to_u32().min(self.nodes - 1);
        (level, node)
    }

    /// A point, r (mm), θ (rad) and z (mm), from corner a of its face.
    #[inline(always)]
    pub fn from_corner(&self, [r, theta, z]: [T; 3], level: u32, node: u32) -> [T; 3] {
        [
            r,
            theta - T::from_count(node) * self.step_theta,
            (z + self.half_height) - T::from_count(level) * self.step_z,
        ]
    }
}

/// Which points of a tube count: |z| up to half the height, r between two bounds, all in mm.
#[derive(Debug, Clone, Copy)]
pub struct Gate<T> {
    /// H/2.
    pub half_height: T,
    /// Least radius.
    pub low: T,
    /// Greatest radius.
    pub high: T,
}

impl<T: Scalar> Gate<T> {
    /// The gate of a cylinder of that radius.
    pub fn new(settings: &Settings, radius_mm: f64) -> Self {
        Self {
            half_height: T::from_f64(settings.height_mm / 2.0),
            low: T::from_f64(settings.gate[0] * radius_mm),
            high: T::from_f64(settings.gate[1] * radius_mm),
        }
    }
}

/// How a triangle's distances become one value, with the constants of the fixed-point sums.
#[derive(Debug, Clone, Copy)]
pub struct Filter<T> {
    /// Which distances count.
    pub outliers: Outliers,
    /// Which statistic of them is the triangle's value.
    pub statistic: Statistic,
    /// Steps per mm of the fixed-point sums.
    pub scale: T,
    /// 1/scale, mm.
    pub unit: T,
}

impl<T: Scalar> Filter<T> {
    /// The filter of a cylinder of that radius.
    ///
    /// No distance exceeds the larger of a gated point's and a node's radius, since the nearer triangle is at
    /// most as far as the surface is along r; twice the gate leaves room.
    pub fn new(settings: &Settings, radius_mm: f64) -> Self {
        let scale = T::fixed_point_scale(2.0 * settings.gate[1].max(1.0) * radius_mm);
        Self {
            outliers: settings.outliers,
            statistic: settings.statistic,
            scale,
            unit: T::from_f64(1.0 / scale.to_f64()),
        }
    }
}

/// The statistic of a triangle's distances.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TriangleStatistic<T> {
    /// Mean or median of the kept signed distances, mm; 0 where there are none.
    pub value: T,
    /// Number of kept distances.
    pub kept: u32,
    /// Mean of the kept |distances|, mm; 0 where there are none.
    pub residual: T,
}

impl TriangleStatistic<f32> {
    /// Its value as the device's passes exchange it: the complement of its bits, 0 without points.
    pub fn value_word(&self) -> u32 {
        if self.kept == 0 { 0 } else { !self.value.to_bits() }
    }

    /// `TriangleSupport` of the shaders: the number of points, and the bits of their mean |distance|, mm.
    pub fn support_words(&self) -> [u32; 2] {
        [self.kept, self.residual.to_bits()]
    }
}

/// `FitParameters` of the shaders: the settings and sizes of a batch of cylinders.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct FitParameters {
    /// N: nodes per ring.
    pub nodes: u32,
    /// L: levels of faces.
    pub levels: u32,
    /// N·L.
    pub faces: u32,
    /// N·(L + 1).
    pub node_count: u32,
    /// Cylinders in the batch.
    pub cylinders: u32,
    /// Points before the gate.
    pub slots: u32,
    /// 0 iqr, 1 deviation, 2 none.
    pub outliers: u32,
    /// 0 mean, 1 median.
    pub statistic: u32,
    /// H/2, mm.
    pub half_height: f32,
    /// 2π/N, rad.
    pub step_theta: f32,
    /// H/L, mm.
    pub step_z: f32,
    /// N/2π, 1/rad.
    pub faces_per_rad: f32,
    /// L/H, 1/mm.
    pub faces_per_mm: f32,
    /// 1 where every slot belongs to cylinder 0 and passed the gate.
    pub single: u32,
    /// Largest number of points of a short face. 0: every face with points is a long one.
    pub max_short: u32,
    /// Largest number of points of a face of middle size.
    pub max_middle: u32,
    /// Largest number of points of a face that a subgroup measures by itself; `max_middle` where none does. A whole workgroup
    /// measures a face with more, a long one.
    pub max_narrow: u32,
    /// Largest possible number of long faces; 0 where no subgroup measures faces by itself.
    pub most_long: u32,
    /// Pairs of cylinder and frame.
    pub pairs: u32,
    /// Faces of the batch whose points `scatter` writes at a time.
    pub window: u32,
    /// 1 in the last iteration, whose support is used.
    pub last: u32,
}

impl FitParameters {
    /// The parameters of a batch; `lanes` invocations measure a short face and one of middle size, 0 where there
    /// are none. Without `pairs` the batch is one tube, and its points already are in tube coordinates. `scatter`
    /// writes the points of all faces at a time.
    pub fn new(
        settings: &Settings,
        cylinders: u32,
        slots: u32,
        pairs: Option<u32>,
        [short_lanes, middle_lanes]: [u32; 2],
    ) -> Self {
        let tube = Tube::new(settings);
        let grid = TubeGrid::<f32>::new(&tube);
        let max_middle = 8 * short_lanes.max(middle_lanes);
        Self {
            nodes: grid.nodes,
            levels: grid.levels,
            faces: tube.face_count() as u32,
            node_count: tube.node_count() as u32,
            cylinders,
            slots,
            outliers: match settings.outliers {
                Outliers::Iqr => 0,
                Outliers::Deviation => 1,
                Outliers::None => 2,
            },
            statistic: match settings.statistic {
                Statistic::Mean => 0,
                Statistic::Median => 1,
            },
            half_height: grid.half_height,
            step_theta: grid.step_theta,
            step_z: grid.step_z,
            faces_per_rad: grid.faces_per_rad,
            faces_per_mm: grid.faces_per_mm,
            single: u32::from(pairs.is_none()),
            max_short: 8 * short_lanes,
            max_middle,
            max_narrow: max_middle,
            most_long: 0,
            pairs: pairs.unwrap_or(0),
            window: cylinders.saturating_mul(tube.face_count() as u32).max(1),
            last: 1,
        }
    }
}

/// `Cylinder` of the shaders: the gate and the filter of one cylinder.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceCylinder {
    /// Least radius that passes the gate, mm.
    pub gate_low: f32,
    /// Greatest radius that passes the gate, mm.
    pub gate_high: f32,
    /// Steps per mm of the fixed-point sums.
    pub scale: f32,
    /// 1/scale, mm.
    pub unit: f32,
}

impl DeviceCylinder {
    /// The cylinder of that radius.
    pub fn new(settings: &Settings, radius_mm: f64) -> Self {
        let gate = Gate::<f32>::new(settings, radius_mm);
        let filter = Filter::<f32>::new(settings, radius_mm);
        Self { gate_low: gate.low, gate_high: gate.high, scale: filter.scale, unit: filter.unit }
    }
}
