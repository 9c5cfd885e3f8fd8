//! Every setting of a reconstruction, with its default, its limits and a TOML form.
//!
//! ```
//! use lumenmesh::settings::{Method, Settings, SweepSettings};
//!
//! let sweep = SweepSettings::default().with_roughness(0.1).with_keep_unsupported(true);
//! let settings = Settings::default().with_method(Method::Sweep).with_sweep(sweep);
//! settings.validate()?;
//! # Ok::<(), lumenmesh::Error>(())
//! ```

use crate::geometry::Pose;
use crate::recording::Conventions;
pub use crate::recording::UnfitFrames;
use crate::setters::setters;
use crate::{Error, Result};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How the wall is reconstructed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Method {
    /// One smooth tube swept along the estimated centreline, fitted to all echoes at once.
    #[default]
    Sweep,
    /// The published method: local cylinders, stitched (or blended).
    Cylinders,
}

/// How cylinders are merged into one vessel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Merge {
    /// A new cylinder replaces the rings that it overlaps (published).
    #[default]
    Stitch,
    /// Overlapping cylinders are averaged, weighted by the points that support them.
    Blend,
}

/// Where the fit is computed, and in which precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Backend {
    /// Wherever the work at hand is likely to be done first.
    #[default]
    Auto,
    /// On the CPU: cylinders in f32, a sweep in f64.
    Cpu,
    /// On the CPU in f64: the reference that the others are compared with.
    Reference,
    /// On the GPU, or on a software driver that stands in for one. A build without the feature `gpu` refuses it.
    Gpu,
}

/// The error of the backend `gpu` in a build without one.
pub(crate) fn no_gpu_engine() -> Error {
    Error::setting("backend", "gpu", "auto, cpu or reference: this build has no GPU engine (feature `gpu`)")
}

/// Which distances of a triangle are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Outliers {
    /// Box plot: keep what lies within 1.5 interquartile ranges of the quartiles, bounds included.
    #[default]
    Iqr,
    /// Keep what differs from the mean by at most 30 % of it (Kwon & Mun 2022).
    Deviation,
    /// Keep everything.
    None,
}

/// The statistic of the kept distances of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Statistic {
    /// Their mean (published).
    #[default]
    Mean,
    /// Their median.
    Median,
}

/// `eTi`, the probe in the tracker sensor's frame: a constant of the catheter (thesis, Eq. 11).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Calibration {
    /// Origin of the probe in the sensor's frame, mm.
    pub position_mm: [f64; 3],
    /// Rotation from the probe's to the sensor's axes, unit quaternion (x, y, z, w).
    pub quaternion: [f64; 4],
}

impl Default for Calibration {
    fn default() -> Self {
        Self { position_mm: [0.0; 3], quaternion: [0.0, 0.0, 0.0, 1.0] }
    }
}

setters!(Calibration {
    with_position_mm => position_mm: [f64; 3],
    with_quaternion => quaternion: [f64; 4],
});

impl Calibration {
    /// The transform `eTi`.
    pub fn sensor_from_probe(&self) -> Pose {
        if *self == Self::default() {
            return Pose::IDENTITY;
        }
        let quaternion = DQuat::from_array(self.quaternion).normalize();
        Pose::from_quaternion(DVec3::from_array(self.position_mm), quaternion)
    }
}

/// What becomes of a vessel that branches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Branches {
    /// Every branch that the catheter visited is reconstructed by itself, and all are joined. A vessel in which one is found
    /// is reconstructed as with `off`.
    #[default]
    Auto,
    /// One tube. A sweep follows the longest path through the vessel, and what lies beside it counts as wrong echoes; cylinders
    /// are merged as they were recorded, whichever branches they lie in.
    Off,
}

/// What becomes of the shifts of single frames that a sweep finds ([`CorrectedShifts`](crate::sweep::CorrectedShifts)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum FrameShifts {
    /// Each against the frames about it, they are taken off the poses where the wall is expected to gain by it.
    #[default]
    Auto,
    /// The frames stay where they are.
    Off,
}

/// Whether a recording calibrates itself, from the wall that it shows more than once
/// ([`SelfCalibration`](crate::sweep::SelfCalibration)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Calibrate {
    /// It does not.
    #[default]
    Off,
    /// Errors of the calibration are estimated and reported.
    Estimate,
    /// Those that are significant are corrected too.
    Apply,
}

/// A state of a vessel that moves periodically.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PhaseOrName", into = "PhaseOrName")]
#[non_exhaustive]
pub enum MotionState {
    /// The mean over its cycles.
    Mean,
    /// At a phase of all its cycles, each counted from its phase at the first frame, in cycles.
    Phase(f64),
}

/// A state in TOML and JSON.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum PhaseOrName {
    Phase(f64),
    Name(String),
}

/// What a state may be.
const STATES: &str = "mean, or a phase from 0 to 1 in cycles";

impl TryFrom<PhaseOrName> for MotionState {
    type Error = String;

    fn try_from(state: PhaseOrName) -> std::result::Result<Self, String> {
        match state {
            PhaseOrName::Name(name) if name == "mean" => Ok(Self::Mean),
            PhaseOrName::Phase(phase) if (0.0..=1.0).contains(&phase) => Ok(Self::Phase(phase)),
            PhaseOrName::Name(found) => Err(format!("found {found:?}, expected {STATES}")),
            PhaseOrName::Phase(found) => Err(format!("found {found}, expected {STATES}")),
        }
    }
}

impl From<MotionState> for PhaseOrName {
    fn from(state: MotionState) -> Self {
        match state {
            MotionState::Mean => Self::Name("mean".into()),
            MotionState::Phase(phase) => Self::Phase(phase),
        }
    }
}

impl std::str::FromStr for MotionState {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let phase = text.parse().map_or_else(|_| PhaseOrName::Name(text.into()), PhaseOrName::Phase);
        phase.try_into()
    }
}

impl std::fmt::Display for MotionState {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Mean => f.write_str("the mean of its cycles"),
            Self::Phase(phase) => write!(f, "phase {phase} of its cycles"),
        }
    }
}

/// What becomes of a vessel that breathes or beats. By default it is reconstructed as if it did not.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct MotionSettings {
    /// The state that is shown: periodic motions of the whole vessel, and changes of its size, are estimated and removed where
    /// they are significant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shown: Option<MotionState>,
    /// Gating instead: the frames of this window of phases alone are used, from the first to the second, in cycles from the
    /// phase of the first frame; [0.9, 0.1] goes over the start of a cycle. The cycle is that of the longest way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window: Option<[f64; 2]>,
}

setters!(MotionSettings {
    with_shown => shown: Option<MotionState>,
    with_window => window: Option<[f64; 2]>,
});

impl MotionSettings {
    /// Whether the vessel is reconstructed as if it did not move.
    pub(crate) fn is_off(&self) -> bool {
        self.shown.is_none() && self.window.is_none()
    }
}

/// The settings of the method `sweep`. Fields that are `None` are chosen from the recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct SweepSettings {
    /// Nodes per ring, at least 8. By default one for each ray of the probe, as long as there are four echoes per node.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<u32>,
    /// τ: how much the wall is expected to bend relative to its own size, dimensionless. The wall is smoothed with the
    /// weight λ = (noise/τ)².
    pub roughness: f64,
    /// Whether the surface keeps the parts that no echo supports (marked by the node array `supported`).
    pub keep_unsupported: bool,
    /// Whether a small error of every pose is estimated together with the wall and removed. It tells how
    /// noisy the tracker is; the wall gains where smoothing is even, and hardly otherwise. It takes several times as long.
    pub correct_poses: bool,
    /// What becomes of the shifts of single frames. Where `correct_poses` or `even_smoothness` is set, and in a vessel that
    /// branches, frames stay where they are. A live sweep takes shifts off in its last fit, in each wall by itself.
    pub frame_shifts: FrameShifts,
    /// Whether smoothing is the same along the whole vessel, rather than following its roughness and the noise that
    /// neighbouring echoes share.
    pub even_smoothness: bool,
    /// Whether a constant time offset between poses and contours is estimated, and corrected where it is significant.
    /// Frames must have times.
    pub estimate_offset: bool,
    /// Whether errors of the calibration, of the speed of sound and of time are estimated before the reconstruction, and
    /// corrected where they are significant. It is the [`Reconstructor`](crate::reconstruction::Reconstructor) that does so.
    pub calibrate: Calibrate,
    /// For vessels that move, s: the weight of an echo halves for every half-life by which the newest echo between the same
    /// two rings is newer. By default all echoes count alike. Frames without a time are taken to be 1/12 s apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub half_life_s: Option<f64>,
}

impl Default for SweepSettings {
    fn default() -> Self {
        Self {
            nodes: None,
            roughness: 0.125,
            keep_unsupported: false,
            correct_poses: false,
            frame_shifts: FrameShifts::Auto,
            even_smoothness: false,
            estimate_offset: false,
            calibrate: Calibrate::Off,
            half_life_s: None,
        }
    }
}

setters!(SweepSettings {
    with_nodes => nodes: Option<u32>,
    with_roughness => roughness: f64,
    with_keep_unsupported => keep_unsupported: bool,
    with_correct_poses => correct_poses: bool,
    with_frame_shifts => frame_shifts: FrameShifts,
    with_even_smoothness => even_smoothness: bool,
    with_estimate_offset => estimate_offset: bool,
    with_calibrate => calibrate: Calibrate,
    with_half_life_s => half_life_s: Option<f64>,
});

/// The settings of a reconstruction. Those of the method `cylinders` are the published ones by default (thesis, chapter 3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Settings {
    /// How the wall is reconstructed.
    pub method: Method,
    /// Where it is computed.
    pub backend: Backend,
    /// Name, or part of the name, of the adapter that the backend `gpu` uses, and `auto` for large work. By default the
    /// best one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    /// What becomes of a vessel that branches. A live reconstruction by cylinders follows the frames as they come.
    pub branches: Branches,
    /// N: nodes per ring, at least 3.
    pub nodes: u32,
    /// L: levels of faces, at least 1; a tube has L + 1 rings.
    pub levels: u32,
    /// H: height of a tube, mm, from 0.001 to 10,000.
    pub height_mm: f64,
    /// Iterations of the fit, at most 10,000.
    pub iterations: u32,
    /// Radial gate, in radii of the cylinder: points between `gate[0]` and `gate[1]` are used; at most 1000.
    pub gate: [f64; 2],
    /// Which distances of a triangle are kept.
    pub outliers: Outliers,
    /// The statistic of the kept distances of a triangle.
    pub statistic: Statistic,
    /// A cylinder is fitted and merged every so many frames.
    pub every: u32,
    /// How cylinders are merged into one vessel.
    pub merge: Merge,
    /// The settings of the method `sweep`.
    pub sweep: SweepSettings,
    /// What becomes of a vessel that breathes or beats.
    #[serde(skip_serializing_if = "MotionSettings::is_off")]
    pub motion: MotionSettings,
    /// `eTi`, the probe in the tracker sensor's frame.
    pub calibration: Calibration,
    /// What is done with frames that are unfit.
    pub unfit_frames: UnfitFrames,
    /// The conventions of the program that wrote the recording.
    pub conventions: Conventions,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            method: Method::Sweep,
            backend: Backend::Auto,
            adapter: None,
            branches: Branches::Auto,
            nodes: 12,
            levels: 5,
            height_mm: 10.0,
            iterations: 3,
            gate: [0.5, 1.5],
            outliers: Outliers::Iqr,
            statistic: Statistic::Mean,
            every: 10,
            merge: Merge::Stitch,
            sweep: SweepSettings::default(),
            motion: MotionSettings::default(),
            calibration: Calibration::default(),
            unfit_frames: UnfitFrames::default(),
            conventions: Conventions::default(),
        }
    }
}

setters!(Settings {
    with_unfit_frames => unfit_frames: UnfitFrames,
    with_conventions => conventions: Conventions,
    with_method => method: Method,
    with_backend => backend: Backend,
    with_adapter => adapter: Option<String>,
    with_branches => branches: Branches,
    with_nodes => nodes: u32,
    with_levels => levels: u32,
    with_height_mm => height_mm: f64,
    with_iterations => iterations: u32,
    with_gate => gate: [f64; 2],
    with_outliers => outliers: Outliers,
    with_statistic => statistic: Statistic,
    with_every => every: u32,
    with_merge => merge: Merge,
    with_sweep => sweep: SweepSettings,
    with_motion => motion: MotionSettings,
    with_calibration => calibration: Calibration,
});

impl Settings {
    /// Reads settings from a TOML file; settings that it does not name keep their defaults.
    ///
    /// # Errors
    /// Where the file cannot be read, is not TOML, names an unknown setting or fails [`Settings::validate`].
    pub fn read_toml(path: &Path) -> Result<Self> {
        let text =
            std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        let settings = Self::parse(&text).map_err(|e| Error::settings(path, &text, &e))?;
        settings.validate().map_err(|e| match e {
            Error::Setting { name, found, expected } => Error::input(path, name, found, expected),
            other => other,
        })?;
        Ok(settings)
    }

    /// Settings out of TOML, unchecked.
    pub(crate) fn parse(text: &str) -> std::result::Result<Self, toml::de::Error> {
        let Ok(mut table) = text.parse::<toml::Table>() else { return toml::from_str(text) };
        let of_sweep = table.get_mut("sweep").and_then(toml::Value::as_table_mut);
        match of_sweep.and_then(|sweep| sweep.remove(BRANCHES)) {
            // The whole text, so that an error names its line.
            None => toml::from_str(text),
            Some(branches) => {
                table.entry(BRANCHES).or_insert(branches);
                table.try_into()
            }
        }
    }

    /// Sets one setting by its name, in words: `set("method", "cylinders")`, `set("sweep.nodes", "64")`,
    /// `set("gate", "[0.5, 1.5]")`. Names, values and limits are those of the TOML file; a text needs no quotes. `none` gives
    /// a setting that may be absent back to the recording.
    ///
    /// # Errors
    /// [`Error::Setting`] where there is no such setting or the value is not one for it; the settings are then as before.
    pub fn set(&mut self, name: &str, value: &str) -> Result<()> {
        let parsed = toml::from_str::<toml::Table>(&format!("value = {value}")).ok();
        let parsed = parsed.filter(|table| table.len() == 1).and_then(|mut table| table.remove("value"));
        let value_of_toml = parsed.unwrap_or_else(|| toml::Value::String(value.trim().into()));
        let invalid = |error: &dyn std::fmt::Display| {
            // Such as "unknown field `node`, expected one of `method`, …".
            let message = error.to_string();
            let message = message.trim_end();
            match message.rsplit_once(", expected ") {
                Some((found, expected)) if found.starts_with("unknown field") => {
                    Error::setting(name.to_owned(), "no setting of that name", expected)
                }
                Some((_, expected)) => Error::setting(name.to_owned(), format!("{value:?}"), expected),
                None => Error::setting(name.to_owned(), format!("{value:?}"), message),
            }
        };
        let mut table = toml::Table::try_from(&*self).map_err(|e| invalid(&e))?;
        let path = if name == OLD_BRANCHES { BRANCHES } else { name };
        let mut parents: Vec<&str> = path.split('.').collect();
        let last = parents.pop().unwrap_or(path);
        let mut inner = &mut table;
        for parent in parents {
            inner = inner
                .entry(parent)
                .or_insert_with(|| toml::Value::Table(toml::Table::new()))
                .as_table_mut()
                .ok_or_else(|| {
                    Error::setting(name.to_owned(), format!("{parent} is one value"), "a group")
                })?;
        }
        let is_none = value.trim() == "none" && name_of_optional(name);
        match is_none {
            true => drop(inner.remove(last)),
            false => drop(inner.insert(last.to_owned(), value_of_toml)),
        }
        let changed: Self = table.try_into().map_err(|e: toml::de::Error| invalid(&e.message()))?;
        changed.validate()?;
        *self = changed;
        Ok(())
    }

    /// The settings as TOML, such that [`Settings::read_toml`] reads them back.
    ///
    /// # Errors
    /// [`Error::Setting`] where a value has no TOML form.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| Error::Setting {
            name: "settings".into(),
            found: e.to_string(),
            expected: "values that TOML can hold".into(),
        })
    }

    /// Checks every setting against its limits.
    ///
    /// # Errors
    /// [`Error::Setting`] with the first one that fails.
    pub fn validate(&self) -> Result<()> {
        // Triangle and node indices are u32 on the device. The other bounds are far beyond any vessel and keep every
        // product of lengths within f32.
        const MAX_FACES: u64 = 1 << 28;
        let fail =
            |name: &'static str, found: String, expected: &str| Err(Error::setting(name, found, expected));
        if self.backend == Backend::Gpu && cfg!(not(feature = "gpu")) {
            return Err(no_gpu_engine());
        }
        if self.nodes < 3 {
            return fail("nodes", self.nodes.to_string(), "at least 3");
        }
        if self.levels < 1 {
            return fail("levels", self.levels.to_string(), "at least 1");
        }
        if u64::from(self.nodes) * u64::from(self.levels) > MAX_FACES {
            let faces = u64::from(self.nodes) * u64::from(self.levels);
            return fail("nodes * levels", faces.to_string(), "at most 268435456 faces");
        }
        if !(0.001..=10_000.0).contains(&self.height_mm) {
            return fail("height_mm", format!("{:?}", self.height_mm), "0.001 to 10000 mm");
        }
        if self.iterations > 10_000 {
            return fail("iterations", self.iterations.to_string(), "at most 10000");
        }
        let [low, high] = self.gate;
        if !(0.0 <= low && low < high && high <= 1000.0) {
            return fail("gate", format!("[{low:?}, {high:?}]"), "0 <= low < high <= 1000");
        }
        if self.every < 1 {
            return fail("every", self.every.to_string(), "at least 1");
        }
        if let Some(nodes) = self.sweep.nodes.filter(|n| !(8..=65536).contains(n)) {
            return fail("sweep.nodes", nodes.to_string(), "8 to 65536");
        }
        // Beyond, the wall is a tube or follows every echo, and f32 and f64 lose the bending beside the echoes.
        if !(1e-6..=1e3).contains(&self.sweep.roughness) {
            return fail("sweep.roughness", format!("{:?}", self.sweep.roughness), "1e-6 to 1000");
        }
        if let Some(half_life_s) = self.sweep.half_life_s.filter(|s| !(1e-3..=1e9).contains(s)) {
            return fail("sweep.half_life_s", format!("{half_life_s:?}"), "0.001 to 1e9 s");
        }
        if let Some(MotionState::Phase(phase)) = self.motion.shown
            && !(0.0..=1.0).contains(&phase)
        {
            return fail("motion.shown", format!("{phase:?}"), STATES);
        }
        if let Some([from, to]) = self.motion.window {
            if ![from, to].iter().all(|phase| (0.0..=1.0).contains(phase)) || from == to {
                return fail(
                    "motion.window",
                    format!("[{from:?}, {to:?}]"),
                    "two different phases from 0 to 1",
                );
            }
            if self.motion.shown.is_some() {
                return fail(
                    "motion.window",
                    format!("[{from:?}, {to:?}]"),
                    "none where motion.shown is set",
                );
            }
        }
        let norm = DQuat::from_array(self.calibration.quaternion).length();
        if !norm.is_finite() || (norm - 1.0).abs() >= 1e-3 {
            return fail(
                "calibration.quaternion",
                format!("norm {norm}"),
                "a unit quaternion (norm 1 ± 0.001)",
            );
        }
        // Between sensor and probe lies a catheter's tip.
        if !self.calibration.position_mm.iter().all(|x| x.abs() <= 10_000.0) {
            return fail(
                "calibration.position_mm",
                format!("{:?}", self.calibration.position_mm),
                "at most 10000 mm in each axis",
            );
        }
        if !self.conventions.contour_centre_mm.iter().all(|x| x.abs() <= 10_000.0) {
            return fail(
                "conventions.contour_centre_mm",
                format!("{:?}", self.conventions.contour_centre_mm),
                "at most 10000 mm in each axis",
            );
        }
        Ok(())
    }
}

/// The name of [`Settings::branches`], and the one that it had when it was the sweep's alone, which stays valid.
const BRANCHES: &str = "branches";
const OLD_BRANCHES: &str = "sweep.branches";

/// Whether a setting may be absent.
fn name_of_optional(name: &str) -> bool {
    ["adapter", "sweep.nodes", "sweep.half_life_s", "motion.shown", "motion.window"].contains(&name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_is_set_by_its_name() {
        let mut settings = Settings::default();
        for (name, value) in [
            ("method", "cylinders"),
            ("backend", "\"cpu\""),
            ("nodes", "24"),
            ("height_mm", "12"),
            ("gate", "[0, 2.5]"),
            ("sweep.nodes", "64"),
            ("sweep.correct_poses", "true"),
            ("sweep.frame_shifts", "off"),
            ("sweep.even_smoothness", "true"),
            ("sweep.calibrate", "apply"),
            ("calibration.position_mm", "[1, 2.5, -3]"),
            ("unfit_frames", "keep"),
            ("conventions.units", "cm"),
            ("adapter", "NVIDIA H100"),
        ] {
            settings.set(name, value).unwrap();
        }
        let sweep = SweepSettings::default()
            .with_nodes(Some(64))
            .with_correct_poses(true)
            .with_frame_shifts(FrameShifts::Off)
            .with_even_smoothness(true)
            .with_calibrate(Calibrate::Apply);
        let expected = Settings::default()
            .with_method(Method::Cylinders)
            .with_backend(Backend::Cpu)
            .with_nodes(24)
            .with_height_mm(12.0)
            .with_gate([0.0, 2.5])
            .with_sweep(sweep)
            .with_calibration(Calibration::default().with_position_mm([1.0, 2.5, -3.0]))
            .with_unfit_frames(UnfitFrames::Keep)
            .with_conventions(Conventions::default().with_units(crate::recording::LengthUnit::Cm))
            .with_adapter(Some("NVIDIA H100".into()));
        assert_eq!(settings, expected);
        settings.set("sweep.nodes", "none").unwrap();
        settings.set("adapter", "none").unwrap();
        assert_eq!((settings.sweep.nodes, &settings.adapter), (None, &None));

        // The name that it had as a setting of the sweep.
        settings.set("sweep.branches", "off").unwrap();
        assert_eq!(settings.branches, Branches::Off);
        let old = Settings::parse("[sweep]\nbranches = \"off\"\nnodes = 32\n").unwrap();
        assert_eq!((old.branches, old.sweep.nodes), (Branches::Off, Some(32)));
        let both = Settings::parse("branches = \"auto\"\n[sweep]\nbranches = \"off\"\n").unwrap();
        assert_eq!(both.branches, Branches::Auto);
        assert!(Settings::parse("[sweep]\nbranches = \"all\"\n").is_err());
        assert!(Settings::parse("[sweep]\nbranch = \"off\"\n").is_err());

        let before = settings.clone();
        for (name, value, message) in [
            ("node", "24", "setting node: found no setting of that name, expected one of `method`"),
            (
                "sweep.node",
                "24",
                "setting sweep.node: found no setting of that name, expected one of `nodes`",
            ),
            ("nodes", "many", "setting nodes: found \"many\", expected u32"),
            ("nodes", "-1", "setting nodes: found \"-1\", expected u32"),
            ("nodes", "2", "setting nodes: found 2, expected at least 3"),
            ("sweep.calibrate", "yes", "setting sweep.calibrate: found \"yes\", expected "),
            ("method", "tube", "setting method: found \"tube\", expected `sweep` or `cylinders`"),
            ("nodes", "12\nlevels = 7", "setting nodes: found \"12\\nlevels = 7\", expected u32"),
            ("nodes.deep", "1", "setting nodes.deep: found nodes is one value, expected a group"),
            ("", "1", "setting : found no setting of that name"),
        ] {
            let error = settings.set(name, value).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
            assert_eq!(settings, before);
        }
    }

    #[test]
    fn settings_survive_toml() {
        let settings = Settings {
            nodes: 48,
            statistic: Statistic::Median,
            outliers: Outliers::Deviation,
            gate: [0.0, 8.0],
            sweep: SweepSettings { nodes: Some(64), ..SweepSettings::default() },
            ..Settings::default()
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.toml");
        std::fs::write(&path, settings.to_toml().unwrap()).unwrap();
        assert_eq!(Settings::read_toml(&path).unwrap(), settings);
        std::fs::write(&path, "nodes = 24\n").unwrap();
        assert_eq!(Settings::read_toml(&path).unwrap(), Settings { nodes: 24, ..Settings::default() });
        std::fs::write(&path, "node = 24\n").unwrap();
        let message = Settings::read_toml(&path).unwrap_err().to_string();
        assert!(message.contains("settings.toml") && message.contains("node"), "{message}");
    }

    #[test]
    fn a_settings_file_may_name_a_part_and_is_named_where_it_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.toml");
        std::fs::write(&path, "[calibration]\nposition_mm = [1.0, 2.0, 3.0]\n").unwrap();
        let calibration = Calibration { position_mm: [1.0, 2.0, 3.0], ..Calibration::default() };
        assert_eq!(Settings::read_toml(&path).unwrap(), Settings { calibration, ..Settings::default() });
        std::fs::write(&path, "nodes = 1\n").unwrap();
        let message = Settings::read_toml(&path).unwrap_err().to_string();
        assert!(message.ends_with("settings.toml: nodes: found 1, expected at least 3"), "{message}");
    }

    #[test]
    fn settings_outside_their_limits_are_named() {
        let d = Settings::default;
        for (settings, name) in [
            (Settings { nodes: 2, ..d() }, "nodes"),
            (Settings { levels: 0, ..d() }, "levels"),
            (Settings { height_mm: -1.0, ..d() }, "height_mm"),
            (Settings { height_mm: f64::NAN, ..d() }, "height_mm"),
            (Settings { height_mm: 1e300, ..d() }, "height_mm"),
            (Settings { height_mm: 1e-300, ..d() }, "height_mm"),
            (Settings { iterations: u32::MAX, ..d() }, "iterations"),
            (Settings { gate: [0.5, 1e300], ..d() }, "gate"),
            (Settings { gate: [0.5, 0.5], ..d() }, "gate"),
            (Settings { gate: [0.5, f64::INFINITY], ..d() }, "gate"),
            (Settings { every: 0, ..d() }, "every"),
            (
                Settings { sweep: SweepSettings { nodes: Some(2), ..SweepSettings::default() }, ..d() },
                "sweep.nodes",
            ),
            (
                Settings { sweep: SweepSettings { roughness: f64::NAN, ..SweepSettings::default() }, ..d() },
                "sweep.roughness",
            ),
            (
                Settings { sweep: SweepSettings { roughness: 1e-200, ..SweepSettings::default() }, ..d() },
                "sweep.roughness",
            ),
            (
                Settings { sweep: SweepSettings { roughness: 1e4, ..SweepSettings::default() }, ..d() },
                "sweep.roughness",
            ),
            (
                Settings {
                    sweep: SweepSettings { half_life_s: Some(0.0), ..SweepSettings::default() },
                    ..d()
                },
                "sweep.half_life_s",
            ),
            (Settings { nodes: u32::MAX, levels: u32::MAX, ..d() }, "nodes * levels"),
        ] {
            let message = settings.validate().unwrap_err().to_string();
            assert!(message.starts_with(&format!("setting {name}: found ")), "{message}");
        }
        assert!(d().validate().is_ok());
        assert_eq!(d().with_backend(Backend::Gpu).validate().is_ok(), cfg!(feature = "gpu"));
    }
}
