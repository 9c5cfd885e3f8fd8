//! The whole way from a recording to a lumen, by either method.
//!
//! [`Reconstructor`] reconstructs whole recordings, [`Live`] takes frames one at a time.

mod live;
mod snapshot;

pub use live::{Change, Live, Times, Work};

use crate::branching::{
    self, BranchedCylinders, BranchedSweep, BranchesReport, CylinderBranchesReport, Mouth,
};
use crate::cylinders::{CylinderReconstruction, CylindersReport, Engine, FittedCylinder, engine};
use crate::error::unless_cancelled;
use crate::recording::{Recording, Screened, Screening};
use crate::settings::{Branches, Calibrate, Method, Settings};
use crate::surface::Surface;
use crate::sweep::{AtRest, Motion, Outlines, SelfCalibration, Sweep, SweepReport, WallDevice, at_rest};
use crate::{Error, Result};
use serde::Serialize;
use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::OnceLock;

/// Reconstructs the lumen of recordings. The engine that fits the cylinders, and the device that fits walls, are started once
/// and kept for further runs.
///
/// ```no_run
/// use lumenmesh::reconstruction::Reconstructor;
/// use lumenmesh::recording::Recording;
/// use lumenmesh::settings::Settings;
/// use std::ops::ControlFlow;
///
/// let recording = Recording::read("pullback.mat".as_ref())?;
/// let reconstructor = Reconstructor::new(Settings::default())
///     .on_progress(|progress| {
///         eprintln!("{}: {} of {}", progress.stage, progress.done, progress.total);
///         ControlFlow::Continue(())
///     });
/// let lumen = reconstructor.run(&recording)?;
/// lumen.surface().write("vessel.vtp".as_ref())?;
/// # Ok::<(), lumenmesh::Error>(())
/// ```
pub struct Reconstructor<'a> {
    settings: Settings,
    history: bool,
    on_progress: Box<dyn Fn(Progress) -> ControlFlow<()> + Send + Sync + 'a>,
    engine: OnceLock<Box<dyn Engine>>,
    wall_device: WallDevice,
}

/// How far a reconstruction has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Progress {
    /// What is being done, such as `"fitting cylinders"`.
    pub stage: &'static str,
    /// Steps of the stage that are done.
    pub done: usize,
    /// Steps of the stage in all.
    pub total: usize,
}

impl<'a> Reconstructor<'a> {
    /// A reconstructor with these settings. They are checked by [`run`](Self::run).
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            history: false,
            on_progress: Box::new(|_| ControlFlow::Continue(())),
            engine: OnceLock::new(),
            wall_device: WallDevice::default(),
        }
    }

    /// Calls `report` whenever a step is done, from any thread: the sweep reports its stages, the published method its
    /// cylinders. A call must not block. Where one breaks, [`run`](Self::run) ends with [`Error::Cancelled`]: cylinders after
    /// those that are being fitted, a sweep before its next stage or the next iteration of a fit.
    #[must_use]
    pub fn on_progress(mut self, report: impl Fn(Progress) -> ControlFlow<()> + Send + Sync + 'a) -> Self {
        self.on_progress = Box::new(report);
        self
    }

    /// Keeps the radii of the cylinders after every iteration, not only after the last. The sweep has no such history.
    #[must_use]
    pub fn history(mut self, keep: bool) -> Self {
        self.history = keep;
        self
    }

    /// Reconstructs the lumen of a recording. Frames that a [`Screening`] finds unfit are left out, unless the settings say
    /// otherwise.
    ///
    /// # Errors
    /// Where settings are invalid or ask for a device that is not there, more frames are unfit than
    /// [`Screening::MAX_SHARE`] or any where the settings refuse them, or the contours cover no length of a vessel.
    /// [`Error::Cancelled`] where [`on_progress`](Self::on_progress) asks for that.
    pub fn run(&self, recording: &Recording) -> Result<Lumen> {
        self.settings.validate()?;
        let Screened { mut recording, screening } =
            Screened::of(recording, &self.settings.conventions, self.settings.unfit_frames)?;
        let mut settings = self.settings.clone();
        let mut calibration = None;
        if settings.method == Method::Sweep && settings.sweep.calibrate != Calibrate::Off {
            let tell = |stage, done, total| (self.on_progress)(Progress { stage, done, total });
            let found = SelfCalibration::of(&recording, &settings, &tell)
                .map_err(|error| error.with_number(|frame| recording.number(frame)))?;
            if settings.sweep.calibrate == Calibrate::Apply {
                let (right, its_settings) = found.corrected(&recording, &settings);
                (recording, settings) = (Cow::Owned(right), its_settings);
            }
            calibration = Some(found);
        }
        let (recording, settings) = (&*recording, &settings);
        let moving = match settings.motion.is_off() {
            true => None,
            false => {
                let stage = Progress { stage: "following the motion", done: 0, total: 1 };
                let going_on = || unless_cancelled((self.on_progress)(stage));
                recording.check()?;
                Some(at_rest(recording, settings, &going_on)?)
            }
        };
        let recording = moving.as_ref().and_then(|moving| moving.recording.as_ref()).unwrap_or(recording);
        let named = |error: Error| error.with_number(|frame| recording.number(frame));
        let mut vessel = match settings.method {
            Method::Cylinders => {
                let tell =
                    |done, total| (self.on_progress)(Progress { stage: "fitting cylinders", done, total });
                let engine = self.engine()?;
                let branched = match settings.branches {
                    Branches::Auto => BranchedCylinders::of(recording, settings, engine, self.history, &tell)
                        .map_err(named)?,
                    Branches::Off => None,
                };
                match branched {
                    Some(branched) => Vessel::CylinderBranches(branched),
                    None => Vessel::Cylinders(
                        CylinderReconstruction::run(recording, settings, engine, self.history, &tell)
                            .map_err(named)?,
                    ),
                }
            }
            Method::Sweep => {
                let tell = |stage, done, total| (self.on_progress)(Progress { stage, done, total });
                recording.check()?;
                let outlines = Outlines::of(&recording.frames);
                let device = &self.wall_device;
                let branched = match settings.branches {
                    Branches::Auto => {
                        BranchedSweep::with_device(recording, &outlines, settings, &tell, device)
                            .map_err(named)?
                    }
                    Branches::Off => None,
                };
                match branched {
                    Some(branched) => Vessel::Branches(branched),
                    None => {
                        let mut sweep =
                            Sweep::run_with(recording, outlines, settings, &tell, device).map_err(named)?;
                        let mouths = match settings.branches {
                            Branches::Auto => branching::open_mouths_of(recording, settings, &mut sweep)?,
                            Branches::Off => Vec::new(),
                        };
                        Vessel::Sweep(sweep, mouths)
                    }
                }
            }
        };
        let motion = moving.map(|AtRest { motion, error, .. }| {
            match &mut vessel {
                Vessel::Sweep(sweep, _) => sweep.add_error(&error),
                Vessel::Branches(branched) => branched.add_error(&error),
                Vessel::Cylinders(_) | Vessel::CylinderBranches(_) => {}
            }
            motion
        });
        Ok(Lumen { settings: settings.clone(), screening, calibration, motion, vessel })
    }

    /// The engine that the settings ask for, started by the first call.
    fn engine(&self) -> Result<&dyn Engine> {
        if let Some(engine) = self.engine.get() {
            return Ok(&**engine);
        }
        let started = engine(&self.settings)?;
        Ok(&**self.engine.get_or_init(|| started))
    }
}

/// The lumen of a recording, by the method that the settings name.
#[derive(Debug, Clone)]
pub struct Lumen {
    settings: Settings,
    screening: Screening,
    calibration: Option<SelfCalibration>,
    motion: Option<Motion>,
    vessel: Vessel,
}

/// What either method makes.
// One exists per recording, so the size of the variants is irrelevant.
#[expect(clippy::large_enum_variant)]
#[derive(Debug, Clone)]
enum Vessel {
    Cylinders(CylinderReconstruction),
    CylinderBranches(BranchedCylinders),
    Sweep(Sweep, Vec<Mouth>),
    Branches(BranchedSweep),
}

/// What was done, in numbers, by either method.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(untagged)]
#[non_exhaustive]
pub enum LumenReport<'a> {
    /// By the published method.
    Cylinders(&'a CylindersReport),
    /// By the published method, of a vessel that branches.
    CylinderBranches(&'a CylinderBranchesReport),
    /// By the sweep.
    Sweep(&'a SweepReport),
    /// By the sweep, of a vessel that branches.
    Branches(&'a BranchesReport),
}

/// All that is known of a reconstruction beside its mesh, as `lumenmesh reconstruct --json` prints it.
#[derive(Debug, Clone, Copy, Serialize)]
#[non_exhaustive]
pub struct Summary<'a> {
    /// The settings that it was reconstructed with.
    pub settings: &'a Settings,
    /// The frames that were left out, and why.
    pub screening: &'a Screening,
    /// The motion of the vessel, where the settings ask for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<&'a Motion>,
    /// The mouths of branches that were seen but not entered, where the method looks for them.
    pub mouths: &'a [Mouth],
    /// The errors of the calibration, where the settings ask for them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<&'a SelfCalibration>,
    /// What was done, in numbers; in JSON beside those above.
    #[serde(flatten)]
    pub report: LumenReport<'a>,
}

impl Lumen {
    /// Settings, screening and report as one thing to serialise.
    pub fn summary(&self) -> Summary<'_> {
        Summary {
            settings: &self.settings,
            screening: &self.screening,
            motion: self.motion.as_ref(),
            mouths: self.mouths(),
            calibration: self.calibration(),
            report: self.report(),
        }
    }

    /// The mouths of branches that were seen but not entered; the surface is open there. None of cylinders, and where
    /// branches are not looked for.
    pub fn mouths(&self) -> &[Mouth] {
        match &self.vessel {
            Vessel::Cylinders(_) | Vessel::CylinderBranches(_) => &[],
            Vessel::Sweep(_, mouths) => mouths,
            Vessel::Branches(branched) => &branched.mouths,
        }
    }

    /// The errors of the calibration, as the recording shows them; `None` where the settings do not ask for them.
    pub fn calibration(&self) -> Option<&SelfCalibration> {
        self.calibration.as_ref()
    }

    /// The settings that it was reconstructed with: with the calibration that a recording has corrected.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The frames that were left out, and why.
    pub fn screening(&self) -> &Screening {
        &self.screening
    }

    /// The motion of the vessel; `None` unless the settings ask for it.
    pub fn motion(&self) -> Option<&Motion> {
        self.motion.as_ref()
    }

    /// The lumen as a triangle surface with arrays per node: [`MergedVessel::surface`](crate::cylinders::merge::MergedVessel::surface),
    /// [`BranchedCylinders::surface`], [`Sweep::surface`] and [`BranchedSweep::surface`] say which. Parts of a sweep that no
    /// echo supports are cut off unless the settings keep them.
    pub fn surface(&self) -> Surface {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => cylinders.vessel.surface(),
            Vessel::CylinderBranches(branched) => branched.surface().clone(),
            Vessel::Sweep(sweep, _) => sweep.surface(self.settings.sweep.keep_unsupported),
            Vessel::Branches(branched) => branched.surface(self.settings.sweep.keep_unsupported),
        }
    }

    /// What was done, in numbers.
    pub fn report(&self) -> LumenReport<'_> {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => LumenReport::Cylinders(&cylinders.report),
            Vessel::CylinderBranches(branched) => LumenReport::CylinderBranches(&branched.report),
            Vessel::Sweep(sweep, _) => LumenReport::Sweep(&sweep.report),
            Vessel::Branches(branched) => LumenReport::Branches(&branched.report),
        }
    }

    /// The fitted cylinders and the vessel merged from them; `None` of a sweep, and of a vessel that branches.
    pub fn cylinders(&self) -> Option<&CylinderReconstruction> {
        match &self.vessel {
            Vessel::Cylinders(cylinders) => Some(cylinders),
            Vessel::CylinderBranches(_) | Vessel::Sweep(..) | Vessel::Branches(_) => None,
        }
    }

    /// The branches and their cylinders; `None` of a sweep, and of a vessel in which one branch was found.
    pub fn cylinder_branches(&self) -> Option<&BranchedCylinders> {
        match &self.vessel {
            Vessel::CylinderBranches(branched) => Some(branched),
            Vessel::Cylinders(_) | Vessel::Sweep(..) | Vessel::Branches(_) => None,
        }
    }

    /// All fitted cylinders in the order of their frames; none of a sweep.
    pub fn fitted_cylinders(&self) -> Vec<&FittedCylinder> {
        let mut all: Vec<&FittedCylinder> = match &self.vessel {
            Vessel::Cylinders(cylinders) => cylinders.cylinders.iter().collect(),
            Vessel::CylinderBranches(branched) => {
                branched.reconstructions.iter().flat_map(|branch| &branch.cylinders).collect()
            }
            Vessel::Sweep(..) | Vessel::Branches(_) => Vec::new(),
        };
        all.sort_by_key(|cylinder| cylinder.frame);
        all
    }

    /// Axis, radii and support of the sweep; `None` of cylinders, and of a vessel that branches.
    pub fn sweep(&self) -> Option<&Sweep> {
        match &self.vessel {
            Vessel::Sweep(sweep, _) => Some(sweep),
            Vessel::Cylinders(_) | Vessel::CylinderBranches(_) | Vessel::Branches(_) => None,
        }
    }

    /// The branches and their sweeps; `None` of cylinders, and of a vessel in which one branch was found.
    pub fn branches(&self) -> Option<&BranchedSweep> {
        match &self.vessel {
            Vessel::Branches(branched) => Some(branched),
            Vessel::Cylinders(_) | Vessel::CylinderBranches(_) | Vessel::Sweep(..) => None,
        }
    }
}
