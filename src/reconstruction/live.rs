//! A vessel that grows while the recording goes on: a frame comes, the mesh is brought up to date, in bounded time.
//!
//! ```
//! use lumenmesh::reconstruction::Live;
//! use lumenmesh::settings::Settings;
//! # use lumenmesh::simulate::{self, Insertion, Phantom, Shape, Simulation};
//! # let vessel = Phantom::from("cylinder".parse::<Shape>()?).vessel()?;
//! # let settings = simulate::SimulationSettings::default().with_insertion(Insertion::steady());
//! # let frames = Simulation::run(vessel, &settings)?.recording.frames;
//!
//! let mut live = Live::new(&Settings::default())?;
//! for frame in &frames {
//!     let change = live.push(frame)?;
//!     for rings in change.changed {
//!         let part = live.part(rings);
//!         // … to the buffers of whoever shows it
//! #       assert!(part.check().is_ok());
//!     }
//! }
//! live.surface().write("vessel.vtp".as_ref())?;
//! # std::fs::remove_file("vessel.vtp").ok();
//! # Ok::<(), lumenmesh::Error>(())
//! ```

use super::{Lumen, Reconstructor};
use crate::cylinders::live::{LiveCylinders, MAX_FRAMES_AT_REST, REST_MM};
use crate::cylinders::{Engine, engine};
use crate::engine::EngineDescription;
use crate::recording::{Cleaning, Frame, Judged, LeftOut, LiveScreening, Reason, Recording};
use crate::settings::{Backend, Calibrate, Method, MotionSettings, Settings, UnfitFrames};
use crate::surface::Surface;
use crate::sweep::{LiveSweep, Step};
use crate::{Error, Result};
use serde::Serialize;
use std::ops::Range;
use std::time::Instant;

/// A vessel that grows frame by frame.
///
/// With the method `cylinders` it is the vessel that [`CylinderReconstruction`](crate::cylinders::CylinderReconstruction) makes of
/// the same frames, to the last bit, as long as the same points of contours are taken for wall, and the catheter has not rested
/// for more than [`MAX_FRAMES_AT_REST`](Self::MAX_FRAMES_AT_REST) frames anywhere. With `sweep` it comes near to
/// [`Sweep::of`](crate::sweep::Sweep::of), which looks at all echoes at once.
pub struct Live {
    pub(super) settings: Settings,
    pub(super) frames: usize,
    /// All frames, for [`finish`](Self::finish), where they are kept.
    pub(super) kept: Option<Recording>,
    pub(super) screening: LiveScreening,
    pub(super) vessel: Vessel,
}

pub(super) enum Vessel {
    Cylinders(Box<LiveCylinders>),
    Sweep(Box<LiveSweep>),
}

impl Vessel {
    fn new(settings: &Settings) -> Result<Self> {
        check_motion(settings)?;
        Ok(match settings.method {
            Method::Cylinders => {
                Vessel::Cylinders(Box::new(LiveCylinders::new(settings, engine(settings)?)?))
            }
            Method::Sweep => {
                check_sweep(settings)?;
                Vessel::Sweep(Box::new(LiveSweep::new(settings)))
            }
        })
    }

    /// Takes frames that are judged, after the last one also what a sweep has put off. A sweep forgets what is taken back.
    fn take(
        &mut self,
        frames: Vec<(usize, Option<Frame>)>,
        taken_back: Vec<usize>,
        is_last: bool,
        change: &mut Change,
    ) -> Result<()> {
        for (number, frame) in frames {
            match self {
                Self::Cylinders(cylinders) => match cylinders.push(frame.as_ref()) {
                    Ok(step) => {
                        let work = Work { echoes: step.echoes, rings: step.rings };
                        change.add(0, step.changed, false, work);
                        change.times.placing_s += step.placing_s;
                        change.times.solving_s += step.solving_s;
                    }
                    Err(error) => change.left_out.push(LeftOut::because(error, Reason::NoCylinder)?),
                },
                Self::Sweep(sweep) => {
                    let Some(frame) = &frame else { continue };
                    change.add_step(sweep.push(number, frame)?);
                }
            }
        }
        match self {
            // Cylinders that were fitted to them stay.
            Self::Cylinders(_) => change.left_out.retain(|one| !taken_back.contains(&one.place)),
            Self::Sweep(sweep) => {
                if !taken_back.is_empty() {
                    change.add_step(sweep.forget(taken_back.into_iter())?);
                }
                if is_last {
                    change.add_step(sweep.flush()?);
                }
            }
        }
        Ok(())
    }

    /// Forgets all frames; the engine stays.
    fn reset(&mut self) {
        match self {
            Vessel::Cylinders(cylinders) => cylinders.reset(),
            Vessel::Sweep(sweep) => sweep.reset(),
        }
    }
}

/// What a frame changed. Rings are numbered along the vessel; ring k has the nodes from k times [`Live::nodes`] on.
///
/// Two changes are equal if all but their [`times`](Self::times) are: the same frames make equal changes on every machine.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Change {
    /// The frame's number: how many were taken before it.
    pub frame: usize,
    /// New rings in front of all others: what was ring k is ring k + `before` now.
    pub before: usize,
    /// Rings whose nodes or values changed or are new, in ascending order, apart from each other.
    pub changed: Vec<Range<usize>>,
    /// Rings of the vessel now. Fewer than before, less the new ones: the last were dropped.
    pub rings: usize,
    /// Whether the frame lies outside of a swept vessel's lumen. Its echoes wait until the axis reaches them, or until enough
    /// such frames show another branch.
    pub off_axis: bool,
    /// Frames that were found unfit now, and why; a [`Screening`](crate::recording::Screening) says what for. Also frames of the
    /// published method whose cylinder was due and could not be fitted. Frames of a burst of wrong contours may have been used
    /// before it was over: a sweep has forgotten their echoes then.
    pub left_out: Vec<LeftOut>,
    /// Frames that wait: they jump off the path of the others, and later ones will tell whether the sensor was moved; or it is
    /// not their turn yet, since the vessel began anew.
    pub waiting: usize,
    /// Whether the vessel began anew, because what was shown before came from frames that are left out now, or from
    /// [points that are no wall](Live::cleaning). All rings are new; frames follow from the first on, some at a time.
    pub restarted: bool,
    /// How much was computed.
    pub work: Work,
    /// How long that took.
    pub times: Times,
}

impl PartialEq for Change {
    fn eq(&self, other: &Self) -> bool {
        let Self { frame, before, changed, rings, off_axis, left_out, waiting, restarted, work, times: _ } =
            self;
        let others = (&other.frame, &other.before, &other.changed, &other.rings, &other.off_axis);
        (frame, before, changed, rings, off_axis) == others
            && (left_out, waiting, restarted, work)
                == (&other.left_out, &other.waiting, &other.restarted, &other.work)
    }
}

impl Eq for Change {}

impl Change {
    /// Adds what another frame changed after this.
    fn add(&mut self, before: usize, changed: Vec<Range<usize>>, off_axis: bool, work: Work) {
        self.before += before;
        self.changed.iter_mut().for_each(|range| *range = range.start + before..range.end + before);
        self.changed.extend(changed);
        self.off_axis |= off_axis;
        self.work.echoes += work.echoes;
        self.work.rings += work.rings;
    }

    /// Adds a step of a sweep.
    fn add_step(&mut self, step: Step) {
        let work = Work { echoes: step.echoes, rings: step.rings };
        self.add(step.before, step.changed, step.off_axis, work);
        self.times.axis_s += step.axis_s;
        self.times.placing_s += step.placing_s;
        self.times.solving_s += step.solving_s;
    }

    /// Brings the ranges of changed rings in order, apart from each other.
    fn tidy(&mut self, rings: usize) {
        let mut ranges = std::mem::take(&mut self.changed);
        ranges.sort_by_key(|range| range.start);
        for range in ranges {
            let range = range.start.min(rings)..range.end.min(rings);
            match self.changed.last_mut() {
                Some(last) if range.start <= last.end => last.end = last.end.max(range.end),
                _ if range.is_empty() => {}
                _ => self.changed.push(range),
            }
        }
        self.rings = rings;
    }
}

/// How much was computed for a frame. It has an upper bound, whatever the length of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct Work {
    /// Echoes that were looked at: the frame's own and older ones.
    pub echoes: usize,
    /// Rings whose radii were computed.
    pub rings: usize,
}

/// How long the stages of a frame took, in seconds of wall-clock time.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Times {
    /// Judging whether the frame is fit for use.
    pub screening_s: f64,
    /// Drawing the axis of a swept vessel anew, and placing older echoes about it; 0 of cylinders.
    pub axis_s: f64,
    /// Placing the frame and its echoes; of cylinders also the estimate of the frame's cylinder.
    pub placing_s: f64,
    /// Solving for the wall, or fitting a cylinder and stitching it to the vessel.
    pub solving_s: f64,
    /// All of the frame.
    pub total_s: f64,
}

impl Live {
    /// Frames that a cylinder looks at in one place, the newest: within [`REST_MM`](Self::REST_MM) of a frame's centre
    /// older ones are forgotten.
    pub const MAX_FRAMES_AT_REST: usize = MAX_FRAMES_AT_REST;
    /// Radius of such a place, mm.
    pub const REST_MM: f64 = REST_MM;

    /// A vessel of no frames yet.
    ///
    /// # Errors
    /// Where settings are invalid, ask for a device that is not there, or for what is done to whole recordings only:
    /// blended cylinders, or a sweep's corrections of the tracker.
    pub fn new(settings: &Settings) -> Result<Self> {
        settings.validate()?;
        Ok(Self::of(settings, Vessel::new(settings)?))
    }

    /// As [`new`](Self::new) for the method `cylinders`, whose fits an engine of the host's computes, such as a `GpuEngine` on
    /// the host's own device.
    ///
    /// # Errors
    /// As [`new`](Self::new), and where the settings have another method: a live sweep has no engine to choose.
    pub fn with_engine(settings: &Settings, engine: Box<dyn Engine>) -> Result<Self> {
        settings.validate()?;
        if settings.method != Method::Cylinders {
            return Err(Error::setting("method", "sweep", "cylinders for an engine of the host's"));
        }
        Ok(Self::of(settings, Vessel::Cylinders(Box::new(LiveCylinders::new(settings, engine)?))))
    }

    fn of(settings: &Settings, vessel: Vessel) -> Self {
        let screening = LiveScreening::default();
        Self { settings: settings.clone(), frames: 0, kept: None, screening, vessel }
    }

    /// Keeps all frames from now on, for [`finish`](Self::finish): 16 bytes for each point of a contour, and some 200 more for
    /// each frame. Without this, the first 1024 are kept for a while, and memory grows with the vessel's length, by 16 bytes with
    /// each frame too.
    ///
    /// # Errors
    /// [`Error::Recording`] where frames have come already.
    pub fn keep_frames(&mut self) -> Result<()> {
        if self.kept.is_none() && self.frames > 0 {
            return Err(Error::Recording {
                field: "frames of a live vessel",
                found: format!("{} that were not kept", self.frames),
                expected: "none before the first one that is kept".into(),
            });
        }
        self.kept.get_or_insert_default();
        Ok(())
    }

    /// The lumen of all frames at once, as [`Reconstructor::run`] makes it of a recording of them: more accurate than a
    /// swept vessel that grew. The vessel stays as it is, and more frames may follow.
    ///
    /// # Errors
    /// [`Error::Recording`] where frames were not [kept](Self::keep_frames), and as [`Reconstructor::run`].
    pub fn finish(&self) -> Result<Lumen> {
        let kept = self.kept.as_ref().ok_or_else(|| Error::Recording {
            field: "frames of a live vessel",
            found: format!("{} that were not kept", self.frames),
            expected: "frames that are kept from the first on".into(),
        })?;
        Reconstructor::new(self.settings.clone()).run(kept)
    }

    /// Forgets all frames: the next one begins a new vessel with the same settings.
    pub fn reset(&mut self) {
        self.frames = 0;
        self.kept = self.kept.take().map(|_| Recording::default());
        self.screening = LiveScreening::default();
        self.vessel.reset();
    }

    /// Takes the next frame and brings the mesh up to date. What is done with an unfit frame, the settings say.
    ///
    /// # Errors
    /// [`Error::Frame`] where the frame is unfit and the settings refuse it, or it has a [defect](Frame::defects) and they
    /// keep unfit frames: the vessel is then as before. Also where the device fails.
    pub fn push(&mut self, frame: &Frame) -> Result<Change> {
        let start = Instant::now();
        let number = self.frames;
        let as_it_came = frame;
        let frame = self.settings.conventions.apply_to(frame);
        let judged = match self.settings.unfit_frames {
            UnfitFrames::Keep => {
                frame.check(number)?;
                Judged { frames: vec![(number, Some(frame))], ..Judged::default() }
            }
            _ => self.screening.push(&frame),
        };
        self.frames += 1;
        if let Some(kept) = &mut self.kept {
            kept.frames.push(as_it_came.clone());
        }
        self.take(number, judged, start, false)
    }

    /// Ends the waiting. After the last frame: frames that jump off the path of the others are left out, and a sweep fits its
    /// whole wall to all echoes, those included that frames had no time for. That takes longer than a frame does.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn flush(&mut self) -> Result<Change> {
        let start = Instant::now();
        let judged = self.screening.flush();
        self.take(self.frames.saturating_sub(1), judged, start, true)
    }

    /// Takes the frames that are judged, after the last one also what a sweep has put off; the screening began at `start`.
    fn take(&mut self, number: usize, judged: Judged, start: Instant, is_last: bool) -> Result<Change> {
        let Judged { restart, frames, left_out, taken_back } = judged;
        let mut change = Change { frame: number, restarted: restart, left_out, ..Change::default() };
        change.times.screening_s = start.elapsed().as_secs_f64();
        if restart {
            self.vessel.reset();
        }
        // A frame has many short tasks, and each that a thread of the host's hands out costs two switches of threads.
        rayon::scope(|_| self.vessel.take(frames, taken_back, is_last, &mut change))?;
        if restart {
            change.before = 0;
            change.changed = std::iter::once(0..self.rings()).collect();
        }
        change.tidy(self.rings());
        change.waiting = self.screening.waiting();
        change.times.total_s = start.elapsed().as_secs_f64();
        let unfit = change.left_out.iter().find(|one| one.reason.is_unfit());
        match unfit.filter(|_| self.settings.unfit_frames == UnfitFrames::Refuse) {
            Some(unfit) => Err(unfit.clone().into_error()),
            None => Ok(change),
        }
    }

    /// Where frames are computed, and why there. Settings with the backend `gpu` have the frames of cylinders computed on the
    /// device, those of a sweep on the CPU, and the lumen of all frames ([`finish`](Self::finish)) on the device by either
    /// method. `None` before the first cylinder.
    pub fn engine(&self) -> Option<EngineDescription> {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => cylinders.fitted_by().cloned(),
            Vessel::Sweep(_) => Some(sweep_engine(&self.settings)),
        }
    }

    /// What was done to the points of contours so far. Later frames may show more of it, and the vessel then
    /// [begins anew](Change::restarted).
    pub fn cleaning(&self) -> &Cleaning {
        self.screening.cleaning()
    }

    /// The settings that it was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Frames taken.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Rings of the vessel.
    pub fn rings(&self) -> usize {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => cylinders.vessel().rings.len(),
            Vessel::Sweep(sweep) => sweep.rings(),
        }
    }

    /// Number of branches that have a wall: the vessel that was seen first, and each that the catheter entered since. The array
    /// `branch` of a swept vessel says which one a node belongs to; the rings of a branch follow those of the ones before,
    /// and no triangles connect them.
    pub fn branches(&self) -> usize {
        match &self.vessel {
            Vessel::Cylinders(_) => 1,
            Vessel::Sweep(sweep) => sweep.branches(),
        }
    }

    /// Nodes per ring; 0 as long as there is no ring.
    pub fn nodes(&self) -> usize {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => {
                cylinders.vessel().rings.first().map_or(0, |ring| ring.nodes_mm.len())
            }
            Vessel::Sweep(sweep) => sweep.nodes(),
        }
    }

    /// The vessel so far, with the arrays of [`MergedVessel::surface`](crate::cylinders::merge::MergedVessel::surface) or
    /// [`Sweep::surface`](crate::sweep::Sweep::surface). A swept one lacks what is not supported, unless the settings keep
    /// it; a vessel that has not begun has no nodes.
    pub fn surface(&self) -> Surface {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => cylinders.vessel().surface(),
            Vessel::Sweep(sweep) => sweep.surface(0..sweep.rings(), self.settings.sweep.keep_unsupported),
        }
    }

    /// Some rings, those that are there, with all their nodes in order and the triangles between them; of a swept vessel
    /// also what is not supported, as the array `supported` says. It takes time for these rings only.
    pub fn part(&self, rings: Range<usize>) -> Surface {
        let end = rings.end.min(self.rings());
        let rings = rings.start.min(end)..end;
        match &self.vessel {
            Vessel::Cylinders(cylinders) => cylinders.vessel().part(rings),
            Vessel::Sweep(sweep) => sweep.surface(rings, true),
        }
    }
}

/// Refuses what neither method does live.
fn check_motion(settings: &Settings) -> Result<()> {
    let refused = |name: &'static str, found: String| {
        Err(Error::setting(name, found, "none live: periods show in a whole recording only"))
    };
    match settings.motion {
        MotionSettings { shown: Some(state), .. } => refused("motion.shown", state.to_string()),
        MotionSettings { window: Some([from, to]), .. } => {
            refused("motion.window", format!("[{from:?}, {to:?}]"))
        }
        _ => Ok(()),
    }
}

/// Refuses what the live sweep does not do, rather than leaving it undone without a word.
fn check_sweep(settings: &Settings) -> Result<()> {
    let refused = |name: &'static str, found: &str, expected: &str| {
        Err(Error::setting(name, found, format!("{expected} for a live sweep")))
    };
    if settings.sweep.correct_poses {
        return refused("sweep.correct_poses", "true", "false");
    }
    if settings.sweep.estimate_offset {
        return refused("sweep.estimate_offset", "true", "false");
    }
    if settings.sweep.calibrate != Calibrate::Off {
        return refused("sweep.calibrate", "estimate or apply", "off");
    }
    Ok(())
}

/// Where a live sweep with these settings is computed: always on the CPU, and why so where that was not asked for.
fn sweep_engine(settings: &Settings) -> EngineDescription {
    let of_name = |name: &str| EngineDescription { name: name.into(), ..EngineDescription::default() };
    let why = "a frame of a live sweep solves for some 40 rings, which takes less time than a device needs to answer";
    match settings.backend {
        Backend::Cpu => of_name("cpu"),
        Backend::Reference => of_name("reference"),
        Backend::Auto | Backend::Gpu => EngineDescription { why: Some(why.into()), ..of_name("cpu") },
    }
}
