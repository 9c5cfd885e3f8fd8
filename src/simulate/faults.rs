//! Errors that recordings from a laboratory have beyond independent noise.

use super::within;
use crate::setters::setters;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// What is wrong with a recording beside its [`Noise`](super::Noise), all from the same seed. Nothing by
/// default.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Faults {
    /// Errors of the contours that neighbours share.
    pub contour: ContourFaults,
    /// What a segmentation takes for the wall.
    pub artefacts: Artefacts,
    /// Errors of the tracked poses.
    pub tracker: TrackerFaults,
    /// Errors of the calibration.
    pub calibration: CalibrationFaults,
    /// Motion of the patient.
    pub motion: Motion,
    /// How frames and points are stored.
    pub sampling: Sampling,
}

setters!(Faults {
    with_contour => contour: ContourFaults,
    with_artefacts => artefacts: Artefacts,
    with_tracker => tracker: TrackerFaults,
    with_calibration => calibration: CalibrationFaults,
    with_motion => motion: Motion,
    with_sampling => sampling: Sampling,
});

/// An error of the contour along its rays that neighbouring rays and frames share: a Gaussian field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ContourFaults {
    /// Its standard deviation, mm.
    pub smooth_sd_mm: f64,
    /// Its reach along the wall, degrees: two rays that are so far apart have the correlation exp(-1/2).
    pub smooth_angle_deg: f64,
    /// Its reach in time, s: two frames that are so far apart have the correlation exp(-1). 0: every frame has
    /// its own.
    pub smooth_time_s: f64,
}

setters!(ContourFaults {
    with_smooth_sd_mm => smooth_sd_mm: f64,
    with_smooth_angle_deg => smooth_angle_deg: f64,
    with_smooth_time_s => smooth_time_s: f64,
});

impl Default for ContourFaults {
    fn default() -> Self {
        Self { smooth_sd_mm: 0.0, smooth_angle_deg: 30.0, smooth_time_s: 1.0 }
    }
}

/// What stands in the place of the wall behind a shadow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ShadowFill {
    /// No echoes.
    #[default]
    Empty,
    /// Points on the straight line between the echoes beside the shadow, as a segmentation draws it.
    Chord,
}

/// What a segmentation found in a burst instead of the lumen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Burst {
    /// The contour about its centroid at 0.55 of its size.
    #[default]
    Small,
    /// At 1.45 of its size.
    Large,
    /// Stretched by 1.4 in one direction and shrunk to 0.6 across it.
    Shape,
    /// The media: farther out than the lumen by 0.15 of the contour's mean radius all round.
    Media,
}

/// Structures that are taken for the wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Artefacts {
    /// Width of a sector without wall, as a guide wire or calcium casts it, degrees; 0: none. It begins at
    /// 120°.
    pub shadow_deg: f64,
    /// What stands there instead.
    pub shadow_fill: ShadowFill,
    /// How fast the sector turns about the probe, degrees per second.
    pub shadow_turn_deg_s: f64,
    /// Width of the arc in which ring-down of the transducer is taken for the wall, degrees; 0: none. It begins
    /// at 90°.
    pub ring_down_deg: f64,
    /// Its distance from the probe, mm; it varies by 3 % from ray to ray.
    pub ring_down_mm: f64,
    /// How fast the arc turns about the probe, degrees per second.
    pub ring_down_turn_deg_s: f64,
    /// Share of the frames whose segmentation failed, in bursts; 0: none.
    pub burst_share: f64,
    /// What was found in them.
    pub burst: Burst,
    /// Mean length of a burst, s; from half as long to half as long again.
    pub burst_s: f64,
}

setters!(Artefacts {
    with_shadow_deg => shadow_deg: f64,
    with_shadow_fill => shadow_fill: ShadowFill,
    with_shadow_turn_deg_s => shadow_turn_deg_s: f64,
    with_ring_down_deg => ring_down_deg: f64,
    with_ring_down_mm => ring_down_mm: f64,
    with_ring_down_turn_deg_s => ring_down_turn_deg_s: f64,
    with_burst_share => burst_share: f64,
    with_burst => burst: Burst,
    with_burst_s => burst_s: f64,
});

impl Default for Artefacts {
    fn default() -> Self {
        Self {
            shadow_deg: 0.0,
            shadow_fill: ShadowFill::Empty,
            shadow_turn_deg_s: 0.0,
            ring_down_deg: 0.0,
            ring_down_mm: 2.0,
            ring_down_turn_deg_s: 0.0,
            burst_share: 0.0,
            burst: Burst::Small,
            burst_s: 0.8,
        }
    }
}

/// Errors of the tracked poses that frames share, and poses that are none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct TrackerFaults {
    /// Standard deviation in each axis of a position error that frames share, mm.
    pub slow_position_sd_mm: f64,
    /// Standard deviation in each component of an orientation error that frames share, degrees.
    pub slow_rotation_sd_deg: f64,
    /// Reach of both in time, s: frames that are so far apart have the correlation exp(-1) (autoregressive,
    /// order 1).
    pub memory_s: f64,
    /// Amplitude of a vibration of the position, mm, in a direction of its own.
    pub shake_mm: f64,
    /// Its frequency, Hz.
    pub shake_hz: f64,
    /// Number of frames that are thrown aside.
    pub glitches: usize,
    /// How far, mm.
    pub glitch_mm: f64,
    /// Number of times that the pose freezes.
    pub freezes: usize,
    /// For how long, s.
    pub freeze_s: f64,
    /// Poses per second, if the tracker is slower than the probe: frames have the newest one. 0: one for each
    /// frame.
    pub rate_hz: f64,
}

setters!(TrackerFaults {
    with_slow_position_sd_mm => slow_position_sd_mm: f64,
    with_slow_rotation_sd_deg => slow_rotation_sd_deg: f64,
    with_memory_s => memory_s: f64,
    with_shake_mm => shake_mm: f64,
    with_shake_hz => shake_hz: f64,
    with_glitches => glitches: usize,
    with_glitch_mm => glitch_mm: f64,
    with_freezes => freezes: usize,
    with_freeze_s => freeze_s: f64,
    with_rate_hz => rate_hz: f64,
});

impl Default for TrackerFaults {
    fn default() -> Self {
        Self {
            slow_position_sd_mm: 0.0,
            slow_rotation_sd_deg: 0.0,
            memory_s: 1.0,
            shake_mm: 0.0,
            shake_hz: 3.0,
            glitches: 0,
            glitch_mm: 30.0,
            freezes: 0,
            freeze_s: 2.0,
            rate_hz: 0.0,
        }
    }
}

/// A calibration that is not the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct CalibrationFaults {
    /// By how much the recorded probe lies beside the true one, mm along its x, y and z.
    pub offset_mm: [f64; 3],
    /// By how much it is turned: a rotation vector in its own axes, degrees.
    pub rotation_deg: [f64; 3],
    /// Speed of sound that was assumed by the true one: ranges come out too long by this factor.
    pub sound_speed: f64,
}

setters!(CalibrationFaults {
    with_offset_mm => offset_mm: [f64; 3],
    with_rotation_deg => rotation_deg: [f64; 3],
    with_sound_speed => sound_speed: f64,
});

impl Default for CalibrationFaults {
    fn default() -> Self {
        Self { offset_mm: [0.0; 3], rotation_deg: [0.0; 3], sound_speed: 1.0 }
    }
}

/// Shifts of the vessel, which carries the catheter along; [`Noise`](super::Noise) has its pulsation and the
/// heart rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Motion {
    /// How far breathing moves the vessel, mm in x, y and z of the world: from its rest, where a recording
    /// begins, to there and back, as (1 - cos)/2.
    pub breathing_mm: [f64; 3],
    /// Breaths per second.
    pub breathing_hz: f64,
    /// How far the heart moves it, likewise, at the rate of the pulsation.
    pub heart_beat_mm: [f64; 3],
}

setters!(Motion {
    with_breathing_mm => breathing_mm: [f64; 3],
    with_breathing_hz => breathing_hz: f64,
    with_heart_beat_mm => heart_beat_mm: [f64; 3],
});

impl Default for Motion {
    fn default() -> Self {
        Self { breathing_mm: [0.0; 3], breathing_hz: 0.25, heart_beat_mm: [0.0; 3] }
    }
}

/// The order in which the points of a contour are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum PointOrder {
    /// As they were scanned, from x towards y.
    #[default]
    Scan,
    /// The other way round.
    Reversed,
    /// At random, another one in every frame.
    Shuffled,
}

/// How frames and points are stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Sampling {
    /// How often every frame is stored, poses and contours alike: 5 for a recorder of 60 Hz behind a probe of
    /// 12 Hz.
    pub repeats: usize,
    /// The order of the points.
    pub point_order: PointOrder,
}

setters!(Sampling {
    with_repeats => repeats: usize,
    with_point_order => point_order: PointOrder,
});

impl Default for Sampling {
    fn default() -> Self {
        Self { repeats: 1, point_order: PointOrder::Scan }
    }
}

impl Faults {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn validate(&self) -> Result<()> {
        let Self { contour, artefacts, tracker, calibration, motion, sampling } = self;
        within("faults.contour.smooth_sd_mm", contour.smooth_sd_mm, 0.0, 100.0)?;
        within("faults.contour.smooth_angle_deg", contour.smooth_angle_deg, 5.0, 180.0)?;
        within("faults.contour.smooth_time_s", contour.smooth_time_s, 0.0, 1e5)?;
        within("faults.artefacts.shadow_deg", artefacts.shadow_deg, 0.0, 350.0)?;
        within("faults.artefacts.shadow_turn_deg_s", artefacts.shadow_turn_deg_s, -1e4, 1e4)?;
        within("faults.artefacts.ring_down_deg", artefacts.ring_down_deg, 0.0, 360.0)?;
        within("faults.artefacts.ring_down_mm", artefacts.ring_down_mm, 0.01, 1000.0)?;
        within("faults.artefacts.ring_down_turn_deg_s", artefacts.ring_down_turn_deg_s, -1e4, 1e4)?;
        within("faults.artefacts.burst_share", artefacts.burst_share, 0.0, 0.9)?;
        within("faults.artefacts.burst_s", artefacts.burst_s, 0.01, 1e4)?;
        within("faults.tracker.slow_position_sd_mm", tracker.slow_position_sd_mm, 0.0, 100.0)?;
        within("faults.tracker.slow_rotation_sd_deg", tracker.slow_rotation_sd_deg, 0.0, 90.0)?;
        within("faults.tracker.memory_s", tracker.memory_s, 0.0, 1e5)?;
        within("faults.tracker.shake_mm", tracker.shake_mm, 0.0, 100.0)?;
        within("faults.tracker.shake_hz", tracker.shake_hz, 0.0, 1e3)?;
        within("faults.tracker.glitch_mm", tracker.glitch_mm, 0.0, 1e4)?;
        within("faults.tracker.freeze_s", tracker.freeze_s, 0.0, 1e5)?;
        within("faults.tracker.rate_hz", tracker.rate_hz, 0.0, 1e5)?;
        for offset in calibration.offset_mm {
            within("faults.calibration.offset_mm", offset, -100.0, 100.0)?;
        }
        for angle in calibration.rotation_deg {
            within("faults.calibration.rotation_deg", angle, -180.0, 180.0)?;
        }
        within("faults.calibration.sound_speed", calibration.sound_speed, 0.5, 2.0)?;
        for shift in motion.breathing_mm.into_iter().chain(motion.heart_beat_mm) {
            within("faults.motion: breathing_mm, heart_beat_mm", shift, -100.0, 100.0)?;
        }
        within("faults.motion.breathing_hz", motion.breathing_hz, 0.0, 100.0)?;
        match sampling.repeats {
            1..=100 => Ok(()),
            found => Err(Error::setting("faults.sampling.repeats", found, "1 to 100")),
        }
    }
}
