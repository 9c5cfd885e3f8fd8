//! Errors that laboratories meet, by name.

use super::SimulationSettings;
use super::faults::{Burst, PointOrder, ShadowFill};

/// An error that laboratories meet, as settings of a simulation. Lengths go with the vessel's radius R, and
/// what a kind does not name is left as it is.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct FaultKind {
    /// What it is called.
    pub name: &'static str,
    /// What is wrong.
    pub what: &'static str,
    apply: fn(&mut SimulationSettings, f64),
}

impl FaultKind {
    /// All kinds.
    pub const ALL: [Self; 35] = KINDS;

    /// The kind of that name.
    pub fn named(name: &str) -> Option<Self> {
        KINDS.into_iter().find(|kind| kind.name == name)
    }

    /// Puts the fault into a simulation in a vessel of that radius.
    pub fn apply(&self, settings: &mut SimulationSettings, radius_mm: f64) {
        (self.apply)(settings, radius_mm);
    }
}

const fn kind(name: &'static str, what: &'static str, apply: fn(&mut SimulationSettings, f64)) -> FaultKind {
    FaultKind { name, what, apply }
}

const KINDS: [FaultKind; 35] = [
    kind("smooth", "contour error of R/20 over 30° and 1 s", |s, r| {
        s.faults.contour.smooth_sd_mm = r / 20.0
    }),
    kind("smooth-frames", "the same, new in every frame", |s, r| {
        s.faults.contour.smooth_sd_mm = r / 20.0;
        s.faults.contour.smooth_time_s = 0.0;
    }),
    kind("dropouts", "30 % of the rays without an echo", |s, _| s.noise.dropout_probability = 0.3),
    kind("spikes", "5 % of the rays with an echo from anywhere", |s, _| s.noise.spike_probability = 0.05),
    kind("shadow", "60° without wall, fixed in the image", |s, _| s.faults.artefacts.shadow_deg = 60.0),
    kind("shadow-turning", "60° without wall, turning by 20°/s", |s, _| {
        s.faults.artefacts.shadow_deg = 60.0;
        s.faults.artefacts.shadow_turn_deg_s = 20.0;
    }),
    kind("shadow-chord", "60° closed by a straight line, fixed", |s, _| {
        s.faults.artefacts.shadow_deg = 60.0;
        s.faults.artefacts.shadow_fill = ShadowFill::Chord;
    }),
    kind("shadow-chord-turning", "the same, turning by 20°/s", |s, _| {
        s.faults.artefacts.shadow_deg = 60.0;
        s.faults.artefacts.shadow_fill = ShadowFill::Chord;
        s.faults.artefacts.shadow_turn_deg_s = 20.0;
    }),
    kind("ring-down", "70° at 0.4 R, fixed", |s, r| {
        s.faults.artefacts.ring_down_deg = 70.0;
        s.faults.artefacts.ring_down_mm = 0.4 * r;
    }),
    kind("ring-down-turning", "the same, turning by 10°/s", |s, r| {
        s.faults.artefacts.ring_down_deg = 70.0;
        s.faults.artefacts.ring_down_mm = 0.4 * r;
        s.faults.artefacts.ring_down_turn_deg_s = 10.0;
    }),
    kind("burst-small", "6 % of the frames at 0.55 of their size, in bursts", |s, _| burst(s, Burst::Small)),
    kind("burst-large", "6 % of the frames at 1.45 of their size, in bursts", |s, _| burst(s, Burst::Large)),
    kind("burst-shape", "6 % of the frames stretched to an oval, in bursts", |s, _| burst(s, Burst::Shape)),
    kind("burst-media", "6 % of the frames show the media, in bursts", |s, _| burst(s, Burst::Media)),
    kind("tracker-white", "tracker: R/12 and 1°, independent", |s, r| {
        s.noise.position_sd_mm = r / 12.0;
        s.noise.rotation_sd_deg = 1.0;
    }),
    kind("tracker-1s", "tracker: R/12 and 1°, forgotten over 1 s", |s, r| slow(s, r / 12.0, 1.0, 1.0)),
    kind("tracker-5s", "tracker: R/24 and 0.5°, forgotten over 5 s", |s, r| slow(s, r / 24.0, 0.5, 5.0)),
    kind("drift", "tracker: a random walk of R/100 per root of a second", |s, r| {
        s.noise.position_drift_mm_per_sqrt_s = r / 100.0;
    }),
    kind("shake", "tracker: R/12 at 3 Hz", |s, r| s.faults.tracker.shake_mm = r / 12.0),
    kind("glitch", "one pose 6 R aside", |s, r| {
        s.faults.tracker.glitches = 1;
        s.faults.tracker.glitch_mm = 6.0 * r;
    }),
    kind("glitches", "12 poses 5 R aside", |s, r| {
        s.faults.tracker.glitches = 12;
        s.faults.tracker.glitch_mm = 5.0 * r;
    }),
    kind("freezes", "the pose freezes 3 times for 2 s", |s, _| s.faults.tracker.freezes = 3),
    kind("stale", "4 poses per second", |s, _| s.faults.tracker.rate_hz = 4.0),
    kind("latency", "poses 0.2 s older than contours", |s, _| s.noise.latency_s = 0.2),
    kind("calibration-offset", "probe R/8 beside the calibrated one, in x", |s, r| {
        s.faults.calibration.offset_mm = [r / 8.0, 0.0, 0.0];
    }),
    kind("calibration-rotation", "probe turned by 3° about its x", |s, _| {
        s.faults.calibration.rotation_deg = [3.0, 0.0, 0.0];
    }),
    kind("sound-speed", "sound 3 % slower than assumed", |s, _| s.faults.calibration.sound_speed = 1.03),
    kind("breathing", "the vessel moves by R/4 with every breath", |s, r| {
        s.faults.motion.breathing_mm = [0.2 * r, 0.0, 0.15 * r];
    }),
    kind("heart-beat", "the vessel moves by R/10 with every beat", |s, r| {
        s.faults.motion.heart_beat_mm = [0.06 * r, 0.08 * r, 0.0];
    }),
    kind("pulsation", "the vessel widens by 8 % with every beat", |s, _| s.noise.pulsation_fraction = 0.08),
    kind("repeated-frames", "every frame 5 times", |s, _| s.faults.sampling.repeats = 5),
    kind("few-rays", "8 rays in a frame", |s, _| s.probe.rays = 8),
    kind("many-rays", "500 rays in a frame", |s, _| s.probe.rays = 500),
    kind("reversed-points", "points in the other order", |s, _| {
        s.faults.sampling.point_order = PointOrder::Reversed;
    }),
    kind("unordered-points", "points in random order", |s, _| {
        s.faults.sampling.point_order = PointOrder::Shuffled;
    }),
];

fn burst(settings: &mut SimulationSettings, burst: Burst) {
    settings.faults.artefacts.burst_share = 0.06;
    settings.faults.artefacts.burst = burst;
}

fn slow(settings: &mut SimulationSettings, position_mm: f64, rotation_deg: f64, memory_s: f64) {
    let tracker = &mut settings.faults.tracker;
    tracker.slow_position_sd_mm = position_mm;
    tracker.slow_rotation_sd_deg = rotation_deg;
    tracker.memory_s = memory_s;
}
