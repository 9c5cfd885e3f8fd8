//! What every fit of a tube shares: frames read as wall points in the world, the rejection of outlier frames, and tubes
//! written as cylinder models.

use super::local_tube::LocalTube;
use crate::geometry::Pose;
use crate::numerics::robust::{median, robust_sd};
use crate::recording::echo_error::{ANGLE_JUMP_VARIANCE, angle_jumps_mm};
use crate::recording::{CylinderModel, Frame, MAX_RADIUS_MM};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Wall points of a frame that are used.
const MAX_POINTS: usize = 32;

/// After this many successive outlier frames, the vessel is where they are: half a second at 12 Hz.
const MAX_OUTLIERS: usize = 6;

/// The wall as one frame shows it, in the world.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct FrameWall {
    pub points_mm: Vec<DVec3>,
    /// Centroid of the contour.
    pub centre_mm: DVec3,
    /// The probe: its z axis is the normal of the image.
    pub world_from_probe: Pose,
    /// Median distance of the points from the centroid.
    pub radius_mm: f64,
    /// Robust standard deviation of these distances.
    pub scatter_mm: f64,
    /// Variance of the echoes across their rays, mm².
    pub tangential_mm2: f64,
}

impl FrameWall {
    /// `None` where the frame shows no wall, or its pose is not finite.
    pub fn read(frame: &Frame, sensor_from_probe: &Pose) -> Option<Self> {
        let centroid = frame.centroid_mm()?;
        let echoes: Vec<DVec2> = frame.echoes_mm().collect();
        // An odd number of echoes has a middle one.
        let per_sector = echoes.len().div_ceil(MAX_POINTS) | 1;
        let points: Vec<DVec2> =
            echoes.chunks(per_sector).map(|sector| middle_one(sector, centroid)).collect();
        let mut distances: Vec<f64> = points.iter().map(|p| p.distance(centroid)).collect();
        let radius_mm = median(&mut distances);
        distances.iter_mut().for_each(|d| *d = (*d - radius_mm).abs());
        let world_from_probe = frame.world_from_sensor * *sensor_from_probe;
        let world = |p: DVec2| world_from_probe.transform_point(p.extend(0.0));
        let wall = Self {
            points_mm: points.into_iter().map(world).collect(),
            centre_mm: world(centroid),
            world_from_probe,
            radius_mm,
            scatter_mm: robust_sd(&mut distances),
            tangential_mm2: tangential_mm2(&frame.contour_mm),
        };
        wall.is_sound().then_some(wall)
    }

    /// Whether a tube can be fitted to it.
    pub fn is_sound(&self) -> bool {
        self.points_mm.len() >= 3
            && self.points_mm.iter().all(|p| p.is_finite())
            && self.centre_mm.is_finite()
            && self.world_from_probe.is_finite()
            && 0.0 < self.radius_mm
            && self.radius_mm <= MAX_RADIUS_MM
            && (0.0..=f64::MAX).contains(&self.scatter_mm)
            && (0.0..=f64::MAX).contains(&self.tangential_mm2)
    }

    /// The tube that fits this frame alone: along the probe.
    pub fn tube(&self) -> LocalTube {
        let origin = Pose { translation_mm: self.centre_mm, ..self.world_from_probe };
        LocalTube::straight(origin, self.radius_mm)
    }

    /// The tube described from the point of its axis nearest to the probe, at most two radii away; and how far along the
    /// axis that is, mm.
    pub fn beside(&self, tube: &LocalTube) -> (LocalTube, f64) {
        let probe = tube.world_from_axis.inverse().transform_point(self.world_from_probe.translation_mm);
        let reach = 2.0 * tube.radius_mm;
        let s = tube.station(probe).clamp(-reach, reach);
        (tube.moved(s), s)
    }

    /// Whether a tube's axis can be that of this wall: it leans at most 60° from the probe, passes within the tube's
    /// radius of the centroid, and the radii differ by at most a factor of two.
    pub fn is_about(&self, tube: &LocalTube) -> bool {
        let (origin, axis) = (tube.world_from_axis.translation_mm, tube.world_from_axis.rotation.z_axis);
        axis.dot(self.world_from_probe.rotation.z_axis).abs() >= 0.5
            && (self.centre_mm - origin).reject_from(axis).length() <= tube.radius_mm
            && (0.5..=2.0).contains(&(tube.radius_mm / self.radius_mm))
    }

    /// Whether at least half of the points lie within a quarter of the tube's radius from its wall.
    pub fn is_on(&self, tube: &LocalTube) -> bool {
        let to_axis = tube.world_from_axis.inverse();
        let near = |p: &&DVec3| tube.distance_mm(to_axis.transform_point(**p)).abs() <= 0.25 * tube.radius_mm;
        2 * self.points_mm.iter().filter(near).count() >= self.points_mm.len()
    }
}

/// The echo of a sector with the median distance from the centroid: one or two wrong echoes hardly change it.
fn middle_one(sector: &[DVec2], centroid: DVec2) -> DVec2 {
    let mut sector = sector.to_vec();
    let middle = sector.len() / 2;
    let order = |a: &DVec2, b: &DVec2| a.distance_squared(centroid).total_cmp(&b.distance_squared(centroid));
    *sector.select_nth_unstable_by(middle, order).1
}

/// Variance of a contour's noise across the probe's rays, mm².
fn tangential_mm2(contour_mm: &[DVec2]) -> f64 {
    let mut jumps: Vec<f64> = angle_jumps_mm(contour_mm).filter(|jump| jump.is_finite()).collect();
    robust_sd(&mut jumps).powi(2) / ANGLE_JUMP_VARIANCE
}

/// An estimate of the tube from the frames so far.
pub(super) trait TubeFit {
    /// The estimate from the first frame.
    fn start(wall: &FrameWall) -> Self;
    /// The current tube.
    fn tube(&self) -> &LocalTube;
    /// Adds the next frame; `None` where the numerical solution fails.
    fn add(&mut self, wall: FrameWall) -> Option<()>;
    /// Variance of the echoes across their rays, mm². It biases the radius outwards by half of it over the radius.
    fn tangential_mm2(&self) -> f64;
}

/// Follows a vessel from frame to frame.
///
/// An outlier frame, whose wall does not lie on the current tube (a tracker's glitch, the mouth of a branch), is compared
/// with other outliers only. After [`MAX_OUTLIERS`] of them in a row, their tube becomes the current one.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Follower<F> {
    sensor_from_probe: Pose,
    known: Option<F>,
    /// The tube through the last outliers, and their number.
    outlier: Option<(F, usize)>,
}

impl<F: TubeFit> Follower<F> {
    pub fn new(sensor_from_probe: Pose) -> Self {
        Self { sensor_from_probe, known: None, outlier: None }
    }

    /// The fits that it compares with.
    pub fn fits(&self) -> impl Iterator<Item = &F> {
        self.known.iter().chain(self.outlier.iter().map(|(fit, _)| fit))
    }

    /// The current fit.
    #[cfg(test)]
    pub fn known(&self) -> Option<&F> {
        self.known.as_ref()
    }

    pub fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        let wall = FrameWall::read(frame, &self.sensor_from_probe)?;
        if let Some(known) = self.known.take_if(|known| !wall.is_on(&wall.beside(known.tube()).0)) {
            let (mut outlier, count) = match self.outlier.take() {
                Some((fit, count)) if wall.is_on(&wall.beside(fit.tube()).0) => (fit, count + 1),
                _ => (F::start(&wall), 1),
            };
            add(&mut outlier, wall.clone());
            let model = self.model(frame, &outlier, &wall);
            if count < MAX_OUTLIERS {
                (self.known, self.outlier) = (Some(known), Some((outlier, count)));
            } else {
                self.known = Some(outlier);
            }
            return model;
        }
        self.outlier = None;
        let mut fit = self.known.take().unwrap_or_else(|| F::start(&wall));
        add(&mut fit, wall.clone());
        let model = self.model(frame, &fit, &wall);
        self.known = Some(fit);
        model
    }

    /// The tube beside the probe as a cylinder in `{e}`. Where it cannot be about this frame's wall, the tube of the frame
    /// alone replaces it: a cylinder that leans too far has none of the frame's points between its ends.
    fn model(&self, frame: &Frame, fit: &F, wall: &FrameWall) -> Option<CylinderModel> {
        let about = Some(fit.tube()).filter(|tube| wall.is_about(tube));
        about
            .and_then(|tube| self.written(frame, tube, fit.tangential_mm2()))
            .or_else(|| self.written(frame, &wall.tube(), wall.tangential_mm2))
    }

    /// A tube as a cylinder in `{e}`; `None` where its axis is parallel to the plane z = 0, or its radius is out of
    /// range.
    fn written(&self, frame: &Frame, tube: &LocalTube, tangential_mm2: f64) -> Option<CylinderModel> {
        let sensor_from_axis = frame.world_from_sensor.inverse() * tube.world_from_axis;
        let (middle, axis) = (sensor_from_axis.translation_mm, sensor_from_axis.rotation.z_axis);
        let along_probe = axis.dot(self.sensor_from_probe.rotation.z_axis) >= 0.0;
        let axis = if along_probe { axis } else { -axis };
        let on_plane = middle - axis * (middle.z / axis.z);
        let radius_mm = tube.radius_mm - tangential_mm2 / (2.0 * tube.radius_mm);
        let model = CylinderModel::from_axis(on_plane.x, on_plane.y, axis, radius_mm);
        (axis.z.abs() > 1e-3 && model.is_finite() && (0.0 < radius_mm && radius_mm <= MAX_RADIUS_MM))
            .then_some(model)
    }
}

/// Adds a frame; where its wall then does not lie on the tube, the fit starts again from this frame.
fn add<F: TubeFit>(fit: &mut F, wall: FrameWall) {
    let alone = F::start(&wall);
    let newest = wall.clone();
    if fit.add(wall).is_none() || !newest.is_on(fit.tube()) {
        *fit = alone;
    }
}
