use crate::simulate::{Burst, FaultKind, PointOrder, ShadowFill, SimulatedVessel, SimulationSettings};

/// What is wrong with a simulated recording beside its noise; each flag is the setting of the same meaning.
#[derive(clap::Args)]
#[command(next_help_heading = "Faults")]
pub(super) struct FaultArguments {
    /// Errors that laboratories meet, in sizes that suit the vessel: --list-faults says what they are
    #[arg(long = "fault", value_name = "NAME,...", value_delimiter = ',', hide_possible_values = true,
        value_parser = names())]
    names: Vec<String>,
    /// Contours: standard deviation of an error that neighbours share, mm [default: 0]
    #[arg(long, value_name = "MM")]
    smooth_noise: Option<f64>,
    /// How far along the wall they share it, degrees [default: 30]
    #[arg(long, value_name = "DEG")]
    smooth_angle: Option<f64>,
    /// How long they share it, s; 0: not from frame to frame [default: 1]
    #[arg(long, value_name = "S")]
    smooth_time: Option<f64>,
    /// Width of a sector without wall, degrees [default: 0]
    #[arg(long, value_name = "DEG")]
    shadow: Option<f64>,
    /// What is there instead of the wall: nothing, or a straight line [default: empty]
    #[arg(long, value_name = "FILL", value_enum)]
    shadow_fill: Option<ShadowFill>,
    /// How fast the sector turns, degrees per second [default: 0]
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    shadow_turn: Option<f64>,
    /// Width of an arc of ring-down, degrees [default: 0]
    #[arg(long, value_name = "DEG")]
    ring_down: Option<f64>,
    /// Its distance from the probe, mm [default: 2]
    #[arg(long, value_name = "MM")]
    ring_down_radius: Option<f64>,
    /// How fast the arc turns, degrees per second [default: 0]
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    ring_down_turn: Option<f64>,
    /// Share of the frames whose segmentation failed, in bursts [default: 0]
    #[arg(long, value_name = "SHARE")]
    bursts: Option<f64>,
    /// What was segmented instead of the lumen [default: small]
    #[arg(long, value_name = "KIND", value_enum)]
    burst: Option<Burst>,
    /// Mean length of a burst, s [default: 0.8]
    #[arg(long, value_name = "S")]
    burst_length: Option<f64>,
    /// Tracked position: standard deviation of an error that frames share, mm [default: 0]
    #[arg(long, value_name = "MM")]
    slow_position_noise: Option<f64>,
    /// Tracked orientation: the same, degrees [default: 0]
    #[arg(long, value_name = "DEG")]
    slow_rotation_noise: Option<f64>,
    /// How long frames share both, s [default: 1]
    #[arg(long, value_name = "S")]
    tracker_memory: Option<f64>,
    /// Amplitude of a vibration of the tracked position, mm [default: 0]
    #[arg(long, value_name = "MM")]
    shake: Option<f64>,
    /// Its frequency, Hz [default: 3]
    #[arg(long, value_name = "HZ")]
    shake_rate: Option<f64>,
    /// Number of poses that are thrown aside [default: 0]
    #[arg(long, value_name = "COUNT")]
    glitches: Option<usize>,
    /// How far, mm [default: 30]
    #[arg(long, value_name = "MM")]
    glitch_size: Option<f64>,
    /// Number of times that the pose freezes [default: 0]
    #[arg(long, value_name = "COUNT")]
    freezes: Option<usize>,
    /// For how long, s [default: 2]
    #[arg(long, value_name = "S")]
    freeze_length: Option<f64>,
    /// Poses per second, if fewer than frames; frames have the newest one [default: 0, all]
    #[arg(long, value_name = "HZ")]
    tracker_rate: Option<f64>,
    /// By how much the recorded probe lies beside the true one, mm along its axes
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    offset_error: Option<[f64; 3]>,
    /// By how much it is turned about its axes, degrees (rotation vector)
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    turn_error: Option<[f64; 3]>,
    /// Speed of sound that was assumed, by the true one [default: 1]
    #[arg(long, value_name = "RATIO")]
    sound_speed: Option<f64>,
    /// How far breathing moves vessel and catheter, mm in the world
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    breathing: Option<[f64; 3]>,
    /// Breaths per second [default: 0.25]
    #[arg(long, value_name = "HZ")]
    breathing_rate: Option<f64>,
    /// How far the heart moves them, mm in the world
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    heart_beat: Option<[f64; 3]>,
    /// How often every frame is stored [default: 1]
    #[arg(long, value_name = "COUNT")]
    repeats: Option<usize>,
    /// Order of the points of a contour [default: scan]
    #[arg(long, value_name = "ORDER", value_enum)]
    point_order: Option<PointOrder>,
}

impl FaultArguments {
    /// Puts the faults into the settings.
    pub(super) fn apply(&self, settings: &mut SimulationSettings, vessel: &SimulatedVessel) {
        fn set<T: Copy>(field: &mut T, flag: Option<T>) {
            if let Some(value) = flag {
                *field = value;
            }
        }
        let first = settings.insertion.visits.first().map_or(settings.insertion.branch, |visit| visit.branch);
        let radius_mm = vessel.branches().get(first).map_or(1.0, |line| line.median_radius_mm());
        for kind in self.names.iter().filter_map(|name| FaultKind::named(name)) {
            kind.apply(settings, radius_mm);
        }
        let faults = &mut settings.faults;
        set(&mut faults.contour.smooth_sd_mm, self.smooth_noise);
        set(&mut faults.contour.smooth_angle_deg, self.smooth_angle);
        set(&mut faults.contour.smooth_time_s, self.smooth_time);
        set(&mut faults.artefacts.shadow_deg, self.shadow);
        set(&mut faults.artefacts.shadow_fill, self.shadow_fill);
        set(&mut faults.artefacts.shadow_turn_deg_s, self.shadow_turn);
        set(&mut faults.artefacts.ring_down_deg, self.ring_down);
        set(&mut faults.artefacts.ring_down_mm, self.ring_down_radius);
        set(&mut faults.artefacts.ring_down_turn_deg_s, self.ring_down_turn);
        set(&mut faults.artefacts.burst_share, self.bursts);
        set(&mut faults.artefacts.burst, self.burst);
        set(&mut faults.artefacts.burst_s, self.burst_length);
        set(&mut faults.tracker.slow_position_sd_mm, self.slow_position_noise);
        set(&mut faults.tracker.slow_rotation_sd_deg, self.slow_rotation_noise);
        set(&mut faults.tracker.memory_s, self.tracker_memory);
        set(&mut faults.tracker.shake_mm, self.shake);
        set(&mut faults.tracker.shake_hz, self.shake_rate);
        set(&mut faults.tracker.glitches, self.glitches);
        set(&mut faults.tracker.glitch_mm, self.glitch_size);
        set(&mut faults.tracker.freezes, self.freezes);
        set(&mut faults.tracker.freeze_s, self.freeze_length);
        set(&mut faults.tracker.rate_hz, self.tracker_rate);
        set(&mut faults.calibration.offset_mm, self.offset_error);
        set(&mut faults.calibration.rotation_deg, self.turn_error);
        set(&mut faults.calibration.sound_speed, self.sound_speed);
        set(&mut faults.motion.breathing_mm, self.breathing);
        set(&mut faults.motion.breathing_hz, self.breathing_rate);
        set(&mut faults.motion.heart_beat_mm, self.heart_beat);
        set(&mut faults.sampling.repeats, self.repeats);
        set(&mut faults.sampling.point_order, self.point_order);
    }
}

fn names() -> clap::builder::PossibleValuesParser {
    FaultKind::ALL.map(|kind| kind.name).into()
}

/// Three numbers with commas between them.
fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text.split(',').map_while(|part| part.trim().parse().ok()).collect();
    let count = text.split(',').count();
    match <[f64; 3]>::try_from(numbers) {
        Ok(three) if count == 3 => Ok(three),
        _ => Err("expected three numbers with commas between them, as in 1,0,-0.5".into()),
    }
}
