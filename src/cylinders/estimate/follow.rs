//! What every fit of a tube needs: frames read as rings of wall, frames that do not belong told from those that do,
//! and tubes written as cylinder models.

use super::local_tube::LocalTube;
use crate::geometry::Pose;
use crate::recording::{CylinderModel, Frame, MOST_RADIUS_MM};
use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Wall points of a frame that are looked at, at most.
const MOST_POINTS: usize = 32;

/// After so many successive frames that do not belong, the vessel is where they are: half a second at 12 Hz.
const STRAYS: usize = 6;

/// The standard deviation of a normal distribution in units of its median absolute deviation.
const SD_PER_MAD: f64 = 1.4826;

/// The wall as one frame shows it, in the world.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    pub points_mm: Vec<DVec3>,
    /// Centroid of the contour.
    pub centre_mm: DVec3,
    /// The probe: its z axis is the normal of the image.
    pub world_from_probe: Pose,
    /// Median distance of the points from the centroid, and how much they scatter about it.
    pub radius_mm: f64,
    pub scatter_mm: f64,
    /// Variance of the echoes across their rays, mm².
    pub tangential_mm2: f64,
}

impl Ring {
    /// `None` where the frame shows no wall, or the tracker lost its pose.
    pub fn read(frame: &Frame, sensor_from_probe: &Pose) -> Option<Self> {
        let centroid = frame.centroid_mm()?;
        let echoes: Vec<DVec2> = frame.echoes_mm().collect();
        // An odd number has a middle one.
        let per_sector = echoes.len().div_ceil(MOST_POINTS) | 1;
        let points: Vec<DVec2> =
            echoes.chunks(per_sector).map(|sector| middle_one(sector, centroid)).collect();
        let mut distances: Vec<f64> = points.iter().map(|p| p.distance(centroid)).collect();
        let radius_mm = median(&mut distances);
        distances.iter_mut().for_each(|d| *d = (*d - radius_mm).abs());
        let world_from_probe = frame.world_from_sensor * *sensor_from_probe;
        let world = |p: DVec2| world_from_probe.transform_point(p.extend(0.0));
        let ring = Self {
            points_mm: points.into_iter().map(world).collect(),
            centre_mm: world(centroid),
            world_from_probe,
            radius_mm,
            scatter_mm: SD_PER_MAD * median(&mut distances),
            tangential_mm2: tangential_mm2(&frame.contour_mm),
        };
        let finite = ring.world_from_probe.is_finite() && ring.centre_mm.is_finite();
        (finite && 0.0 < radius_mm && radius_mm <= MOST_RADIUS_MM).then_some(ring)
    }

    /// The tube that this ring alone says: along the probe.
    pub fn tube(&self) -> LocalTube {
        let origin = Pose { translation_mm: self.centre_mm, ..self.world_from_probe };
        LocalTube::straight(origin, self.radius_mm)
    }

    /// The tube described from its place beside the probe, no farther away than two radii.
    pub fn beside(&self, tube: &LocalTube) -> (LocalTube, f64) {
        let probe = tube.world_from_axis.inverse().transform_point(self.world_from_probe.translation_mm);
        let reach = 2.0 * tube.radius_mm;
        let s = tube.station(probe).clamp(-reach, reach);
        (tube.moved(s), s)
    }

    /// Whether a tube's axis can be that of the ring: it leans no more than 60° from the probe, passes within the tube's
    /// radius of the centroid, and the radii differ by no more than a factor of two.
    pub fn is_about(&self, tube: &LocalTube) -> bool {
        let (origin, axis) = (tube.world_from_axis.translation_mm, tube.world_from_axis.rotation.z_axis);
        axis.dot(self.world_from_probe.rotation.z_axis).abs() >= 0.5
            && (self.centre_mm - origin).reject_from(axis).length() <= tube.radius_mm
            && (0.5..=2.0).contains(&(tube.radius_mm / self.radius_mm))
    }

    /// Whether half of the points or more lie on a tube, to a quarter of its radius.
    pub fn is_on(&self, tube: &LocalTube) -> bool {
        let to_axis = tube.world_from_axis.inverse();
        let near = |p: &&DVec3| tube.miss_mm(to_axis.transform_point(**p)).abs() <= 0.25 * tube.radius_mm;
        2 * self.points_mm.iter().filter(near).count() >= self.points_mm.len()
    }
}

/// The echo of a sector whose distance is in the middle: a wrong echo or two move it little.
fn middle_one(sector: &[DVec2], centroid: DVec2) -> DVec2 {
    let mut sector = sector.to_vec();
    let middle = sector.len() / 2;
    let order = |a: &DVec2, b: &DVec2| a.distance_squared(centroid).total_cmp(&b.distance_squared(centroid));
    *sector.select_nth_unstable_by(middle, order).1
}

/// A probe looks along rays at even angles: second differences of the angle from echo to echo show the noise across
/// the rays alone, and have six times its variance.
fn tangential_mm2(contour_mm: &[DVec2]) -> f64 {
    let polar: Vec<(f64, f64)> = contour_mm.iter().map(|p| (p.y.atan2(p.x), p.length())).collect();
    let turn = |from: f64, to: f64| (to - from + PI).rem_euclid(TAU) - PI;
    let mut jumps: Vec<f64> = polar
        .windows(3)
        .map(|w| (turn(w[1].0, w[2].0) - turn(w[0].0, w[1].0)).abs() * w[1].1)
        .filter(|jump| jump.is_finite())
        .collect();
    (SD_PER_MAD * median(&mut jumps)).powi(2) / 6.0
}

/// The standard deviation of what scatters about 0, from its absolute values.
pub(super) fn robust_sd(sizes: &mut [f64]) -> f64 {
    SD_PER_MAD * median(sizes)
}

/// The upper median; 0 of nothing. Reorders the values.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// What is known of a tube from the rings seen so far.
pub(super) trait TubeFit {
    /// From the first ring.
    fn start(ring: &Ring) -> Self;
    /// The tube as it stands.
    fn tube(&self) -> &LocalTube;
    /// Takes the next ring; `None` where the numbers fail.
    fn add(&mut self, ring: Ring) -> Option<()>;
    /// Variance of the echoes across their rays, mm²: it moves them out by half of that over the radius.
    fn tangential_mm2(&self) -> f64;
}

/// Follows a vessel from frame to frame.
///
/// A ring that does not lie on the tube known so far (a tracker's glitch, the mouth of a branch) is held against
/// other such rings only; when they keep coming, the vessel is where they are.
#[derive(Debug, Clone)]
pub(super) struct Follower<F> {
    sensor_from_probe: Pose,
    known: Option<F>,
    stray: Option<(F, usize)>,
}

impl<F: TubeFit> Follower<F> {
    pub fn new(sensor_from_probe: Pose) -> Self {
        Self { sensor_from_probe, known: None, stray: None }
    }

    /// The fit that the newest ring belongs to.
    #[cfg(test)]
    pub fn known(&self) -> Option<&F> {
        self.known.as_ref()
    }

    pub fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        let ring = Ring::read(frame, &self.sensor_from_probe)?;
        if let Some(known) = self.known.take_if(|known| !ring.is_on(&ring.beside(known.tube()).0)) {
            let (mut stray, count) = match self.stray.take() {
                Some((fit, count)) if ring.is_on(&ring.beside(fit.tube()).0) => (fit, count + 1),
                _ => (F::start(&ring), 1),
            };
            add(&mut stray, ring.clone());
            let model = self.model(frame, &stray, &ring);
            if count < STRAYS {
                (self.known, self.stray) = (Some(known), Some((stray, count)));
            } else {
                self.known = Some(stray);
            }
            return model;
        }
        self.stray = None;
        let mut fit = self.known.take().unwrap_or_else(|| F::start(&ring));
        add(&mut fit, ring.clone());
        let model = self.model(frame, &fit, &ring);
        self.known = Some(fit);
        model
    }

    /// The tube beside the probe as a cylinder in `{e}`. Where it cannot be about the ring, the tube stands in that the
    /// ring alone says: a cylinder that leans too far has none of the frame's points between its ends.
    fn model(&self, frame: &Frame, fit: &F, ring: &Ring) -> Option<CylinderModel> {
        let about = Some(fit.tube()).filter(|tube| ring.is_about(tube));
        about
            .and_then(|tube| self.written(frame, tube, fit.tangential_mm2()))
            .or_else(|| self.written(frame, &ring.tube(), ring.tangential_mm2))
    }

    /// A tube as a cylinder in `{e}`; `None` where its axis runs along the plane z = 0, or its radius is none.
    fn written(&self, frame: &Frame, tube: &LocalTube, tangential_mm2: f64) -> Option<CylinderModel> {
        let sensor_from_axis = frame.world_from_sensor.inverse() * tube.world_from_axis;
        let (middle, axis) = (sensor_from_axis.translation_mm, sensor_from_axis.rotation.z_axis);
        let along_probe = axis.dot(self.sensor_from_probe.rotation.z_axis) >= 0.0;
        let axis = if along_probe { axis } else { -axis };
        let foot = middle - axis * (middle.z / axis.z);
        let radius_mm = tube.radius_mm - tangential_mm2 / (2.0 * tube.radius_mm);
        let model = CylinderModel::from_axis(foot.x, foot.y, axis, radius_mm);
        (axis.z.abs() > 1e-3 && model.is_finite() && (0.0 < radius_mm && radius_mm <= MOST_RADIUS_MM))
            .then_some(model)
    }
}

/// Adds a ring; where the tube then does not pass it, the fit starts afresh.
fn add<F: TubeFit>(fit: &mut F, ring: Ring) {
    let alone = F::start(&ring);
    let newest = ring.clone();
    if fit.add(ring).is_none() || !newest.is_on(fit.tube()) {
        *fit = alone;
    }
}
