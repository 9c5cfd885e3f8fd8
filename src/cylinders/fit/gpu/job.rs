//! What is handed to the device. The shaders' structures are in `shaders/cylinders/common/job.wgsl` and `project.wgsl`;
//! a test compares the layouts.

use crate::cylinders::Tube;
use crate::cylinders::fit::passes::{Filter, Gate, Grid, TubeTransform};
use crate::geometry::Pose;
use crate::settings::{Outliers, Settings, Statistic};
use bytemuck::{Pod, Zeroable};

/// `Job` of the shaders.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceJob {
    /// N.
    pub nodes: u32,
    /// L.
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
    /// N/2π.
    pub faces_per_rad: f32,
    /// L/H.
    pub faces_per_mm: f32,
    /// 1 where every slot belongs to cylinder 0 and passed the gate.
    pub single: u32,
    /// Most points of a face that is measured by a few invocations.
    pub short_most: u32,
    /// Pairs of cylinder and frame.
    pub pairs: u32,
}

impl DeviceJob {
    /// The job of a batch; `lanes` invocations measure a short face.
    pub fn new(settings: &Settings, cylinders: u32, slots: u32, pairs: Option<u32>, lanes: u32) -> Self {
        let tube = Tube::new(settings);
        let grid = Grid::<f32>::new(&tube);
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
            short_most: 8 * lanes,
            pairs: pairs.unwrap_or(0),
        }
    }
}

/// `Cylinder` of the shaders.
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

/// `Pair` of the shaders: the points of one frame and their way into one cylinder.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct DevicePair {
    /// Image of the probe's x axis on the tube's X, Y, Z.
    pub x: [f32; 3],
    /// Image of the probe's y axis.
    pub y: [f32; 3],
    /// Image of the probe's origin, mm.
    pub origin: [f32; 3],
    /// The cylinder in the batch.
    pub cylinder: u32,
    /// Its frame's first point.
    pub first_point: u32,
    /// Its frame's number of points.
    pub count: u32,
    /// Where its points go.
    pub first_slot: u32,
    /// To a multiple of 16 bytes.
    pub unused: [u32; 3],
}

impl DevicePair {
    /// The pair of a cylinder and a frame with `count` points from `first_point` on.
    pub fn new(
        cylinder_from_probe: &Pose,
        cylinder: u32,
        first_point: u32,
        count: u32,
        first_slot: u32,
    ) -> Self {
        let TubeTransform { x, y, origin } = TubeTransform::<f32>::new(cylinder_from_probe);
        Self { x, y, origin, cylinder, first_point, count, first_slot, unused: [0; 3] }
    }
}
