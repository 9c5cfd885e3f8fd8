use super::CylinderModel;
use crate::recording::Frame;

/// Finds the local cylinder of each frame from the contours and poses seen so far.
///
/// Frames are shown in the order in which they arrive; an estimate uses that frame and earlier ones only, so
/// that it is there while the catheter still moves.
pub trait CylinderEstimator {
    /// Takes the next frame and returns its cylinder; `None` where the frame shows no wall.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel>;
}

/// A simple estimate.
#[derive(Debug, Clone, Default)]
pub struct LocalEstimate;
impl LocalEstimate {
    /// New.
    pub fn new(_sensor_from_probe: crate::geometry::Pose) -> Self {
        Self
    }
}
impl CylinderEstimator for LocalEstimate {
    fn push(&mut self, _frame: &Frame) -> Option<CylinderModel> {
        todo!()
    }
}
