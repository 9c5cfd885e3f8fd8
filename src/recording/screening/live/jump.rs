//! Jumps from one frame to the next, of the pose or of the contour's shape: what a single frame tells.

use crate::numerics::robust::median;
use crate::recording::Frame;
use crate::recording::screening::path::{JUMP_PRICE, Limits, Place, usual};
use crate::recording::screening::{LeftOut, Reason};
use serde::{Deserialize, Serialize};

/// A shape step is a jump where it is larger than this many usual ones and than this: 13 % of the radius. A segmentation that
/// follows the media instead of the lumen is off by some 15 %.
const SHAPE_JUMP_STEPS: f64 = 5.0;
const JUMP_SHAPE: f64 = 0.12;
/// Contours that lie farther apart than this share of the median radius may differ as they like.
const SHAPE_WITHIN_RADII: f64 = 0.5;
/// The price of a jump of the shape, in frames, which anatomy may have too.
const SHAPE_JUMP_PRICE: f64 = 12.0;

/// What jumps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Jump {
    Pose,
    Shape,
}

impl Jump {
    /// What a run of frames must be longer than to be used: the price of the jump to it, in frames, and where it is one of the
    /// shape of that back from it, because a burst of wrong contours ends.
    pub fn price(self) -> f64 {
        match self {
            Jump::Pose => JUMP_PRICE,
            Jump::Shape => 2.0 * SHAPE_JUMP_PRICE,
        }
    }
}

/// What a frame is compared by.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Look {
    pub place: Place,
    /// Logarithms of eight quantiles of the distances of the echoes from the contour's centroid.
    shape: Option<[f64; 8]>,
}

impl Look {
    pub fn of(frame: &Frame) -> Self {
        let shape = frame.centroid_mm().and_then(|centre| {
            let mut distances: Vec<f64> = frame.echoes_mm().map(|p| p.distance(centre)).collect();
            distances.sort_unstable_by(f64::total_cmp);
            let count = distances.len();
            let shape: [f64; 8] = std::array::from_fn(|i| distances[(2 * i + 1) * count / 16].ln());
            (count >= 8 && shape.iter().all(|s| s.is_finite())).then_some(shape)
        });
        Self { place: Place::of(frame), shape }
    }

    /// The median change of the shape, quantile by quantile, so that neither a turn of the probe nor a branch in a few rays
    /// counts.
    pub fn shape_step(&self, other: &Self) -> Option<f64> {
        let (a, b) = self.shape.as_ref().zip(other.shape.as_ref())?;
        Some(median(&mut std::array::from_fn::<f64, 8, _>(|i| (a[i] - b[i]).abs())))
    }
}

/// Steps that are larger than these are jumps. Those of the shape say something only where the frames lie so near to each other
/// that the wall cannot have changed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steps {
    pub pose: Limits,
    /// The usual shape step.
    usual_shape: f64,
    /// Larger shape steps are jumps.
    jump_shape: f64,
}

impl Steps {
    /// The limits that a median radius and steps show.
    pub fn new(radius_mm: f64, pose_steps_mm: Vec<f64>, shape_steps: Vec<f64>) -> Self {
        let usual_shape = usual(shape_steps);
        let jump_shape = (SHAPE_JUMP_STEPS * usual_shape).max(JUMP_SHAPE);
        Self { pose: Limits::new(radius_mm, pose_steps_mm), usual_shape, jump_shape }
    }

    /// The kind of jump, if any, from a frame to one that was taken `gap` frames later: sensor and wall go on meanwhile, one
    /// usual step for each frame.
    pub fn jump(&self, a: &Look, b: &Look, gap: usize) -> Option<Jump> {
        if self.pose.is_jump(&a.place, &b.place, gap) {
            return Some(Jump::Pose);
        }
        let near = self.pose.step_mm(&a.place, &b.place) <= SHAPE_WITHIN_RADII * self.pose.radius_mm();
        let shape = a.shape_step(b).filter(|_| near);
        let meanwhile = self.usual_shape * gap.saturating_sub(1) as f64;
        shape.is_some_and(|step| step > self.jump_shape + meanwhile).then_some(Jump::Shape)
    }

    /// What of a run, from its first frame to its last, is off the path beside it: its shape, where either end is near enough.
    pub fn jump_of(&self, ends: [&Look; 2], on_path: &[&Look]) -> Jump {
        let on_path: Vec<&Place> = on_path.iter().map(|look| &look.place).collect();
        let are_away = ends.iter().all(|end| self.pose.is_away(&end.place, &on_path));
        if are_away { Jump::Pose } else { Jump::Shape }
    }

    /// Why a frame of a run that jumps so is left out, told by the nearest frames on the path.
    pub fn why(&self, frame: usize, look: &Look, jump: Jump, on_path: &[&Look]) -> LeftOut {
        if jump == Jump::Pose || look.shape.is_none() {
            let on_path: Vec<&Place> = on_path.iter().map(|look| &look.place).collect();
            return self.pose.why(frame, &look.place, &on_path);
        }
        let radius_mm = |look: &Look| look.place.radius_mm().unwrap_or(0.0);
        let beside_mm = on_path.first().map_or(0.0, |look| radius_mm(look));
        LeftOut {
            place: frame,
            frame,
            reason: Reason::OffShape,
            field: "contour",
            found: format!(
                "a median radius of {:.2} mm, {beside_mm:.2} mm in the frames beside it",
                radius_mm(look)
            ),
            expected: format!(
                "radii that change by less than {:.0} % from frame to frame",
                100.0 * self.jump_shape.exp_m1()
            ),
        }
    }
}
