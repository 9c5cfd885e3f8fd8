use super::conventions::ConventionArguments;
use super::numbers;
use crate::recording::Recording;
use crate::settings::{
    Backend, Branches, Calibrate, FrameShifts, Merge, Method, MotionState, Outliers, Settings, Statistic,
    UnfitFrames,
};
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Of a command that reconstructs live: leaves settings out of its help that are refused there.
pub(super) fn hidden_if_not_live(argument: clap::Arg) -> clap::Arg {
    const NOT_LIVE: [&str; 5] = ["calibrate", "correct_poses", "estimate_offset", "motion", "phase_window"];
    if NOT_LIVE.contains(&argument.get_id().as_str()) { argument.hide(true) } else { argument }
}

/// The settings as flags, one for each; they override a settings file, which overrides the defaults.
#[derive(clap::Args, Default)]
#[command(next_help_heading = "Settings")]
pub(super) struct SettingsArguments {
    /// Read settings from a TOML file; flags override it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// How the wall is reconstructed [default: sweep]
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// Where it is computed [default: auto]
    #[arg(long, value_enum)]
    backend: Option<Backend>,
    /// Adapter of the backend gpu, and of auto for large work, by name or a part of it [default: the best;
    /// see lumenmesh devices]
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// What becomes of a vessel that branches [default: auto]
    #[arg(long, value_enum)]
    branches: Option<Branches>,
    /// Of cylinders: nodes per ring [default: 12]
    #[arg(long, value_name = "N")]
    nodes: Option<u32>,
    /// Of cylinders: levels of faces [default: 5]
    #[arg(long, value_name = "L")]
    levels: Option<u32>,
    /// Of cylinders: height [default: 10]
    #[arg(long, value_name = "MM")]
    height: Option<f64>,
    /// Of cylinders: iterations of the fit [default: 3]
    #[arg(long, value_name = "COUNT")]
    iterations: Option<u32>,
    /// Of cylinders: radial gate, in radii [default: 0.5,1.5]
    #[arg(long, value_name = "LOW,HIGH", value_parser = numbers::<2>, allow_hyphen_values = true)]
    gate: Option<[f64; 2]>,
    /// Of cylinders: which distances of a triangle count [default: iqr]
    #[arg(long, value_enum)]
    outliers: Option<Outliers>,
    /// Of cylinders: statistic of the distances of a triangle [default: mean]
    #[arg(long, value_enum)]
    statistic: Option<Statistic>,
    /// Of cylinders: frames from one fitted cylinder to the next [default: 10]
    #[arg(long, value_name = "FRAMES")]
    every: Option<u32>,
    /// Of cylinders: how they become one vessel [default: stitch]
    #[arg(long, value_enum)]
    merge: Option<Merge>,
    /// Of a sweep: nodes per ring [default: one for each ray, as far as echoes suffice]
    #[arg(long, value_name = "N")]
    sweep_nodes: Option<u32>,
    /// Of a sweep: how much a wall is expected to bend within its own size [default: 0.125]
    #[arg(long, value_name = "TAU")]
    roughness: Option<f64>,
    /// Of a sweep: keep the parts that no echo supports
    #[arg(long)]
    keep_unsupported: bool,
    /// Of a sweep: estimate a small error of every pose along with the wall and correct it
    #[arg(long)]
    correct_poses: bool,
    /// Of a sweep: what becomes of the shifts of single frames against those about them; auto: correct them where the wall gains
    /// by it [default: auto]
    #[arg(long, value_name = "WHAT", value_enum)]
    frame_shifts: Option<FrameShifts>,
    /// Of a sweep: smooth evenly, rather than as the vessel's roughness and its noise ask for
    #[arg(long)]
    even_smoothness: bool,
    /// Of a sweep: estimate how much older poses are than contours, and correct it where significant
    #[arg(long)]
    estimate_offset: bool,
    /// Of a sweep: estimate errors of the probe's calibration, of the speed of sound and of time from the wall that is seen
    /// more than once; with apply, correct those that are significant [default: off; estimate without a value]
    #[arg(long, value_name = "WHAT", value_enum, num_args = 0..=1, default_missing_value = "estimate")]
    calibrate: Option<Calibrate>,
    /// Of a sweep, for a vessel that moves: halve an echo's weight per this many seconds of newer echoes around it
    /// [default: all count alike]
    #[arg(long, value_name = "S")]
    half_life: Option<f64>,
    /// Of a vessel that breathes or beats: estimate its periodic motion, and show it as it is in the mean, or at this phase in
    /// cycles, 0 as in the first frame
    #[arg(long, value_name = "mean|PHASE")]
    motion: Option<MotionState>,
    /// Of the same: use the frames of these phases only
    #[arg(long, value_name = "FROM,TO", value_parser = numbers::<2>, allow_hyphen_values = true, conflicts_with = "motion")]
    phase_window: Option<[f64; 2]>,
    /// Probe in the tracker sensor's frame: position in mm and unit quaternion [default: 0,0,0,0,0,0,1]
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", value_parser = numbers::<7>, allow_hyphen_values = true)]
    calibration: Option<[f64; 7]>,
    /// Refuse a recording with unfit frames, such as a lost sensor's, instead of leaving them out
    #[arg(long, conflicts_with = "keep")]
    strict: bool,
    /// Use frames that seem unfit, instead of leaving them out
    #[arg(long)]
    keep: bool,
    #[command(flatten)]
    conventions: ConventionArguments,
}

impl SettingsArguments {
    /// The files that are read beside the recording.
    pub(super) fn inputs(&self) -> [Option<&Path>; 3] {
        let [contours, plus_config] = self.conventions.inputs();
        [self.config.as_deref(), contours, plus_config]
    }

    /// Reads a recording, unchecked.
    pub(super) fn read(&self, recording: &Path) -> Result<Recording> {
        self.conventions.read(recording)
    }

    /// What of the command line beside the settings changes how a recording is read, as text.
    pub(super) fn reading(&self) -> String {
        format!("{:?}", self.conventions.reading())
    }

    /// The settings of the file, or the defaults, with the flags on top.
    pub(super) fn settings(&self) -> Result<Settings> {
        let mut settings = match &self.config {
            Some(path) => Settings::read_toml(path)?,
            None => Settings::default(),
        };
        fn set<T: Copy>(field: &mut T, flag: Option<T>) {
            if let Some(value) = flag {
                *field = value;
            }
        }
        set(&mut settings.method, self.method);
        set(&mut settings.backend, self.backend);
        if self.adapter.is_some() {
            settings.adapter.clone_from(&self.adapter);
        }
        set(&mut settings.branches, self.branches);
        set(&mut settings.nodes, self.nodes);
        set(&mut settings.levels, self.levels);
        set(&mut settings.height_mm, self.height);
        set(&mut settings.iterations, self.iterations);
        set(&mut settings.gate, self.gate);
        set(&mut settings.outliers, self.outliers);
        set(&mut settings.statistic, self.statistic);
        set(&mut settings.every, self.every);
        set(&mut settings.merge, self.merge);
        if self.sweep_nodes.is_some() {
            settings.sweep.nodes = self.sweep_nodes;
        }
        set(&mut settings.sweep.roughness, self.roughness);
        settings.sweep.keep_unsupported |= self.keep_unsupported;
        settings.sweep.correct_poses |= self.correct_poses;
        set(&mut settings.sweep.frame_shifts, self.frame_shifts);
        settings.sweep.even_smoothness |= self.even_smoothness;
        settings.sweep.estimate_offset |= self.estimate_offset;
        set(&mut settings.sweep.calibrate, self.calibrate);
        if self.half_life.is_some() {
            settings.sweep.half_life_s = self.half_life;
        }
        if self.motion.is_some() {
            (settings.motion.shown, settings.motion.window) = (self.motion, None);
        }
        if self.phase_window.is_some() {
            (settings.motion.shown, settings.motion.window) = (None, self.phase_window);
        }
        if let Some([x, y, z, qx, qy, qz, qw]) = self.calibration {
            settings.calibration.position_mm = [x, y, z];
            settings.calibration.quaternion = [qx, qy, qz, qw];
        }
        if self.strict {
            settings.unfit_frames = UnfitFrames::Refuse;
        }
        if self.keep {
            settings.unfit_frames = UnfitFrames::Keep;
        }
        settings.conventions = self.conventions.over(settings.conventions);
        settings.validate()?;
        self.check_method(settings.method)?;
        Ok(settings)
    }

    /// Refuses flags that the method does not use.
    fn check_method(&self, method: Method) -> Result<()> {
        let of_cylinders = [
            ("nodes", self.nodes.is_some()),
            ("levels", self.levels.is_some()),
            ("height_mm", self.height.is_some()),
            ("iterations", self.iterations.is_some()),
            ("gate", self.gate.is_some()),
            ("outliers", self.outliers.is_some()),
            ("statistic", self.statistic.is_some()),
            ("every", self.every.is_some()),
            ("merge", self.merge.is_some()),
        ];
        let of_sweep = [
            ("sweep.nodes", self.sweep_nodes.is_some()),
            ("sweep.roughness", self.roughness.is_some()),
            ("sweep.keep_unsupported", self.keep_unsupported),
            ("sweep.correct_poses", self.correct_poses),
            ("sweep.frame_shifts", self.frame_shifts.is_some()),
            ("sweep.even_smoothness", self.even_smoothness),
            ("sweep.estimate_offset", self.estimate_offset),
            ("sweep.calibrate", self.calibrate.is_some()),
            ("sweep.half_life_s", self.half_life.is_some()),
        ];
        let (flags, found, expected) = match method {
            Method::Sweep => (&of_cylinders[..], "a flag for the method sweep", "--method cylinders with it"),
            Method::Cylinders => (&of_sweep[..], "a flag for the method cylinders", "--method sweep with it"),
        };
        match flags.iter().find(|(_, given)| *given) {
            None => Ok(()),
            Some((name, _)) => {
                Err(Error::Setting { name: (*name).into(), found: found.into(), expected: expected.into() })
            }
        }
    }
}
