use super::estimate::{CylinderEstimator, LocalEstimate};
use super::passes::{Gate, Section, TubeTransform, project};
use crate::geometry::Pose;
use crate::numerics::Scalar;
use crate::recording::{CylinderModel, Frame, Recording};
use crate::settings::Settings;
use crate::{Error, Result};
use glam::{DVec2, DVec3, I64Vec3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

/// Frames placed in the world, in the order of their arrival: the source of the points of every fit.
///
/// Appending a frame does not change earlier ones, and a cylinder uses only its own frame and earlier ones, so that
/// cylinders can be fitted while the catheter still moves.
#[derive(Serialize, Deserialize)]
pub struct Track {
    sensor_from_probe: Pose,
    #[serde(skip, default = "no_estimate")]
    estimator: Box<dyn CylinderEstimator + Send + Sync>,
    /// By number, without dropped frames.
    frames: BTreeMap<usize, PlacedFrame>,
    /// Number of frames that were appended.
    count: usize,
    estimated: usize,
    /// Where the frames lie: it follows from them.
    #[serde(skip)]
    places: HashMap<Option<I64Vec3>, Place>,
    echoes_mm: Vec<DVec2>,
    /// Number of echoes of frames that were not dropped.
    kept: usize,
    missing: u64,
}

/// Edge of a [`Place`], mm.
const PLACE_MM: f64 = 8.0;
/// Echoes of dropped frames that may stay in the store before it is compacted.
const MIN_WASTE: usize = 100_000;
/// Frames whose centre or size exceeds this share one place, mm.
const MAX_DISTANCE_MM: f64 = 1e6;

/// Estimates nothing.
struct NoEstimate;

impl CylinderEstimator for NoEstimate {
    fn push(&mut self, _: &Frame) -> Option<CylinderModel> {
        None
    }
}

fn no_estimate() -> Box<dyn CylinderEstimator + Send + Sync> {
    Box::new(NoEstimate)
}

/// The frames whose centres lie in one cube of the world.
#[derive(Debug, Default)]
struct Place {
    /// Their numbers, ascending.
    frames: Vec<usize>,
    /// Largest [`PlacedFrame::reach_mm`] of the frames that were placed there.
    reach_mm: f64,
}

/// A frame in the world.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct PlacedFrame {
    /// `wTi`.
    world_from_probe: Pose,
    cylinder: Option<PlacedCylinder>,
    /// Its wall points in the track's store.
    echoes: Range<usize>,
    /// Centre and radius of a circle in the probe's plane that holds all points of the frame; a sphere in the world.
    centre_in_probe_mm: DVec3,
    reach_mm: f64,
}

impl PlacedFrame {
    fn centre_mm(&self) -> DVec3 {
        self.world_from_probe.transform_point(self.centre_in_probe_mm)
    }

    /// The place it lies in.
    fn place(&self) -> Option<I64Vec3> {
        let centre = self.centre_mm();
        (self.reach_mm < MAX_DISTANCE_MM && centre.abs().max_element() < MAX_DISTANCE_MM)
            .then(|| (centre / PLACE_MM).floor().as_i64vec3())
    }
}

/// The local cylinder of a frame, in the world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PlacedCylinder {
    /// `wTcyl`; the long axis is x.
    pub world_from_cylinder: Pose,
    /// Radius of the primitive, mm.
    pub radius_mm: f64,
    /// Whether the cylinder was estimated because the recording has none.
    pub estimated: bool,
}

/// A frame whose points can lie in a cylinder's section.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct NearFrame {
    /// Its points, as a range of [`Track::echoes_mm`].
    pub echoes: Range<usize>,
    /// `cylTi`, from its probe to the cylinder.
    pub cylinder_from_probe: Pose,
}

/// The error of a section without points.
pub(in crate::cylinders) fn empty_section(
    frame: usize,
    radius_mm: f64,
    gated: u64,
    settings: &Settings,
) -> Error {
    let [low, high] = settings.gate.map(|g| g * radius_mm);
    Error::Frame {
        frame,
        field: "section",
        found: format!("0 points ({gated} outside the radial gate)"),
        expected: format!(
            "at least 1 within {} mm of height and a radius of {low:.2} to {high:.2} mm",
            settings.height_mm
        ),
    }
}

impl Track {
    /// An empty track. `estimator` receives every frame and gives those without a cylinder model theirs.
    pub fn new(sensor_from_probe: Pose, estimator: Box<dyn CylinderEstimator + Send + Sync>) -> Self {
        Self {
            sensor_from_probe,
            estimator,
            frames: BTreeMap::new(),
            count: 0,
            estimated: 0,
            places: HashMap::new(),
            echoes_mm: Vec::new(),
            kept: 0,
            missing: 0,
        }
    }

    /// A track of a whole recording, with the simple local estimate for frames without a cylinder.
    ///
    /// The cylinders equal those of [`Track::push`]. The estimator does not receive the frames after the last one without
    /// a model, so that a recording in which every frame has a model costs no estimate. Use [`Track::new`] for a track that
    /// grows.
    ///
    /// # Errors
    /// As [`Track::push`].
    pub fn of(recording: &Recording, settings: &Settings) -> Result<Self> {
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let estimator = LocalEstimate::new(sensor_from_probe);
        let mut track = Self::new(sensor_from_probe, Box::new(estimator));
        let last_without = recording.frames.iter().rposition(|frame| frame.cylinder.is_none());
        let (shown, rest) = recording.frames.split_at(last_without.map_or(0, |last| last + 1));
        shown.iter().try_for_each(|frame| track.push(frame))?;
        rest.iter().try_for_each(|frame| track.place(frame, |_| None))?;
        Ok(track)
    }

    /// A track whose frames are appended by [`push_with`](Self::push_with).
    pub(in crate::cylinders) fn without_estimator(sensor_from_probe: Pose) -> Self {
        Self::new(sensor_from_probe, no_estimate())
    }

    /// Appends a frame with the estimate of its cylinder, for where it has none of its own.
    pub(in crate::cylinders) fn push_with(
        &mut self,
        frame: &Frame,
        estimate: Option<CylinderModel>,
    ) -> Result<()> {
        self.place(frame, |_| estimate)
    }

    /// What a track that was read from a file needs beside its content; `false` where that does not fit together.
    pub(in crate::cylinders) fn complete(&mut self) -> bool {
        let (mut kept, mut end) = (0, 0);
        for (&number, frame) in &self.frames {
            let follows = end <= frame.echoes.start && frame.echoes.start <= frame.echoes.end;
            end = frame.echoes.end;
            if !follows || end > self.echoes_mm.len() || number >= self.count {
                return false;
            }
            kept += frame.echoes.len();
            let place = self.places.entry(frame.place()).or_default();
            place.frames.push(number);
            place.reach_mm = place.reach_mm.max(frame.reach_mm);
        }
        kept == self.kept
    }

    /// Appends a frame. Its own cylinder model takes precedence over the estimate.
    ///
    /// # Errors
    /// [`Error::Frame`] where [`Frame::check`] refuses it; the track is then as before.
    pub fn push(&mut self, frame: &Frame) -> Result<()> {
        self.place(frame, |estimator| estimator.push(frame))
    }

    fn place(
        &mut self,
        frame: &Frame,
        estimate: impl FnOnce(&mut dyn CylinderEstimator) -> Option<CylinderModel>,
    ) -> Result<()> {
        frame.check(self.count)?;
        let first = self.echoes_mm.len();
        self.echoes_mm.extend(frame.echoes_mm());
        self.kept += self.echoes_mm.len() - first;
        self.missing += frame.missing_echoes() as u64;
        let echoes = &self.echoes_mm[first..];
        let (low, high) = echoes
            .iter()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
        let centre = if echoes.is_empty() { DVec2::ZERO } else { (low + high) / 2.0 };
        let reach_mm = echoes.iter().fold(0.0_f64, |reach, p| reach.max(p.distance(centre)));

        let estimate = estimate(&mut *self.estimator);
        let cylinder = frame.cylinder.or(estimate).map(|model| PlacedCylinder {
            world_from_cylinder: frame.world_from_sensor * model.sensor_from_cylinder(),
            radius_mm: model.radius_mm,
            estimated: frame.cylinder.is_none(),
        });
        self.estimated += usize::from(cylinder.is_some_and(|c| c.estimated));
        let placed = PlacedFrame {
            world_from_probe: frame.world_from_sensor * self.sensor_from_probe,
            cylinder,
            echoes: first..self.echoes_mm.len(),
            centre_in_probe_mm: centre.extend(0.0),
            reach_mm,
        };
        let place = self.places.entry(placed.place()).or_default();
        place.frames.push(self.count);
        place.reach_mm = place.reach_mm.max(reach_mm);
        self.frames.insert(self.count, placed);
        self.count += 1;
        Ok(())
    }

    /// Drops the oldest frames within `within_mm` of the newest one's centre until `max_frames` are left: a catheter at
    /// rest records the same wall again and again. Earlier cylinders do not change; later ones do not use the dropped
    /// frames' points.
    pub(crate) fn drop_oldest_near(&mut self, within_mm: f64, max_frames: usize) {
        let Some((_, newest)) = self.frames.last_key_value() else { return };
        let (centre, Some(home)) = (newest.centre_mm(), newest.place()) else { return };
        let step = (within_mm / PLACE_MM).ceil() as i64;
        let steps = move || -step..=step;
        let mut near: Vec<(usize, I64Vec3)> = Vec::new();
        for place in
            steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| I64Vec3::new(x, y, z))))
        {
            let place = home + place;
            let frames = self.places.get(&Some(place)).map_or(&[][..], |place| &place.frames);
            let is_near = |number: &usize| {
                self.frames.get(number).is_some_and(|frame| frame.centre_mm().distance(centre) <= within_mm)
            };
            near.extend(frames.iter().filter(|number| is_near(number)).map(|&number| (number, place)));
        }
        near.sort_unstable_by_key(|&(number, _)| number);
        for &(number, place) in &near[..near.len().saturating_sub(max_frames)] {
            self.kept -= self.frames.remove(&number).map_or(0, |frame| frame.echoes.len());
            if let Some(place) = self.places.get_mut(&Some(place)) {
                place.frames.retain(|&other| other != number);
            }
        }
        if self.echoes_mm.len() > 2 * self.kept + MIN_WASTE {
            self.compact();
        }
    }

    /// Takes the echoes of dropped frames out of the store, in place: a store that is allocated anew each time lets the heap
    /// grow over many frames.
    fn compact(&mut self) {
        let mut end = 0;
        for frame in self.frames.values_mut() {
            // Frames lie in the store in their order.
            let count = frame.echoes.len();
            self.echoes_mm.copy_within(frame.echoes.clone(), end);
            frame.echoes = end..end + count;
            end += count;
        }
        self.echoes_mm.truncate(end);
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of wall points in all frames.
    pub fn echo_count(&self) -> usize {
        self.kept
    }

    /// Number of rays without an echo in all frames.
    pub fn missing_count(&self) -> u64 {
        self.missing
    }

    /// Number of frames whose cylinder was estimated.
    pub fn estimated_count(&self) -> usize {
        self.estimated
    }

    /// The local cylinder of a frame.
    ///
    /// # Errors
    /// [`Error::Frame`] where the track has no such frame, or where the frame shows no wall that a cylinder
    /// could be estimated from.
    pub fn cylinder(&self, frame: usize) -> Result<PlacedCylinder> {
        let fail = |field, found: &str, expected: String| {
            Err(Error::Frame { frame, field, found: found.into(), expected })
        };
        match self.frames.get(&frame) {
            None => fail("frame", "no such frame", format!("less than {}", self.count)),
            Some(PlacedFrame { cylinder: None, echoes, .. }) => fail(
                "cylinder",
                &format!("no model and {} wall points", echoes.len()),
                "a cylinder model or at least 3 wall points".into(),
            ),
            Some(PlacedFrame { cylinder: Some(cylinder), .. }) => Ok(*cylinder),
        }
    }

    /// The wall points of all frames in their probes' planes, mm, frame after frame.
    pub fn echoes_mm(&self) -> &[DVec2] {
        &self.echoes_mm
    }

    /// The frames 0..=`frame` that may have wall points in the section of `frame`'s cylinder: all but those of which no
    /// point of the bounding circle can pass the gate.
    ///
    /// # Errors
    /// As [`Track::cylinder`].
    pub fn near(&self, frame: usize, settings: &Settings) -> Result<impl Iterator<Item = NearFrame>> {
        let cylinder = self.cylinder(frame)?;
        let cylinder_from_world = cylinder.world_from_cylinder.inverse();
        let half_height = settings.height_mm / 2.0;
        let greatest_radius = settings.gate[1] * cylinder.radius_mm;
        let origin = cylinder.world_from_cylinder.translation_mm;
        let mut numbers: Vec<usize> = self
            .places
            .iter()
            .filter(|(place, Place { reach_mm, .. })| {
                let Some(place) = place else { return true };
                // No frame of a place is farther from its middle than half its diagonal. The test of each frame below
                // is at least as strict.
                let middle = (place.as_dvec3() + 0.5) * PLACE_MM;
                let reach =
                    (half_height + 2.0 * reach_mm + 1.0).hypot(greatest_radius + 2.0 * reach_mm + 1.0);
                middle.distance(origin) <= reach + PLACE_MM
            })
            .flat_map(|(_, place)| place.frames.iter().copied().take_while(|&number| number <= frame))
            .collect();
        // The map has no order.
        numbers.sort_unstable();
        Ok(numbers.into_iter().filter_map(move |number| {
            let placed = self.frames.get(&number)?;
            if placed.echoes.is_empty() {
                return None;
            }
            let cylinder_from_probe = cylinder_from_world * placed.world_from_probe;
            let centre = cylinder_from_probe.transform_point(placed.centre_in_probe_mm);
            // Extent of the circle along the axis and across it, with a margin so that rounding cannot exclude a point
            // on the gate.
            let tilt = &cylinder_from_probe.rotation;
            let slack = 1e-6 * (1.0 + placed.reach_mm);
            let along = placed.reach_mm * tilt.x_axis.x.hypot(tilt.y_axis.x) + slack;
            let across = placed.reach_mm + slack;
            let near =
                centre.x.abs() <= half_height + along && centre.y.hypot(centre.z) <= greatest_radius + across;
            near.then(|| NearFrame { echoes: placed.echoes.clone(), cylinder_from_probe })
        }))
    }

    /// The points of a frame's section in tube coordinates (`docs/method.md`, "Local cylinder fit").
    ///
    /// # Errors
    /// As [`Track::cylinder`], and where no point at all lies in the section.
    pub fn section<T: Scalar>(&self, frame: usize, settings: &Settings) -> Result<Section<T>> {
        let radius_mm = self.cylinder(frame)?.radius_mm;
        let gate = Gate::new(settings, radius_mm);
        let mut section = Section::default();
        for NearFrame { echoes, cylinder_from_probe } in self.near(frame, settings)? {
            project(&self.echoes_mm[echoes], &TubeTransform::new(&cylinder_from_probe), &gate, &mut section);
        }
        if section.is_empty() {
            return Err(empty_section(frame, radius_mm, section.gated, settings));
        }
        Ok(section)
    }
}
