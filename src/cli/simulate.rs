use super::faults::FaultArguments;
use super::space::SpaceArgument;
use super::vessel::VesselArguments;
use super::{Shown, print_json, progress, refuse_inputs};
use crate::simulate::{
    Centreline, FaultKind, Faults, Insertion, Noise, Phantom, Probe, ReducedBend, Simulation,
    SimulationSettings, TrackerNoise, Visit,
};
use crate::surface;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Simulate a recording in a vessel of known geometry
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh simulate -o recording/
  lumenmesh simulate --vessel small_arch --truth wall.vtp --truth-centreline middle.csv -o pullback.mat
  lumenmesh simulate --vessel cylinder --noise none --steady -o pullback.mat
  lumenmesh simulate --vessel aorta.stl --centreline aorta_centreline.csv --branch 1 -o recording/
  lumenmesh simulate --vessel tree --branches 0,1,2,3 --truth-branches truth.csv -o recording/
  lumenmesh simulate --vessel bifurcation --branches 0,1:80,0:5 --steady -o there_and_back/
  lumenmesh simulate --list-faults
  lumenmesh simulate --fault ring-down-turning,glitches -o recording/ --truth wall.vtp
  lumenmesh simulate --shadow 60 --shadow-fill chord --sound-speed 1.03 -o recording/
  lumenmesh simulate --config simulation.toml --seed 7 -o recording/ --truth-recording truth/
  lumenmesh simulate --tracker-noise static_sensor.csv --sensor Reference -o recording/

A settings file:
  cylinders = false
  [vessel]
  edge_mm = 1.2
  shape.cylinder = { radius_mm = 12.0, length_mm = 100.0 }
  # shape.tree = { levels = 3, daughter_ratio = 0.7, half_angle_deg = 35.0 }
  [insertion]
  repeat = true
  # visits = [{ branch = 0 }, { branch = 1, to_mm = 60.0 }]
  moves = [{ advance = { distance_mm = 20.0 } }, { bend = { angle_deg = 30.0 } },
           { turn = { angle_deg = 360.0 } }, { bend = { angle_deg = 0.0 } }]
  [probe]
  rays = 90
  range_mm = 30.0
  [noise]
  seed = 1
  contour_sd_mm = 1.0
  dropout_probability = 0.02
  [faults]
  contour = { smooth_sd_mm = 0.5, smooth_angle_deg = 30.0, smooth_time_s = 1.0 }
  artefacts = { shadow_deg = 60.0, shadow_fill = \"chord\", burst_share = 0.05, burst = \"media\" }
  tracker = { slow_position_sd_mm = 1.0, memory_s = 1.0, glitches = 3, rate_hz = 8.0 }
  calibration = { offset_mm = [1.0, 0.0, 0.0], rotation_deg = [0.0, 3.0, 0.0], sound_speed = 1.03 }
  motion = { breathing_mm = [2.0, 0.0, 1.0], heart_beat_mm = [0.5, 0.0, 0.0] }
  sampling = { repeats = 5, point_order = \"shuffled\" }")]
pub(super) struct Arguments {
    /// Recording to write: a .mat file, else a folder of CSV files
    #[arg(short, long, value_name = "REC", required_unless_present = "list_faults")]
    output: Option<PathBuf>,
    /// Say what the errors are that --fault knows, and stop
    #[arg(long)]
    list_faults: bool,
    #[command(flatten)]
    vessel: VesselArguments,
    /// Also write the wall: .vtp, .ply, .stl, .obj or .mat
    #[arg(long, value_name = "MESH")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    space: SpaceArgument,
    /// Also write the centrelines of its branches: CSV
    #[arg(long, value_name = "CSV")]
    truth_centreline: Option<PathBuf>,
    /// Also write which branch the catheter is in in every frame, and where: CSV with frame, time_s, visit,
    /// branch, s_mm
    #[arg(long, value_name = "CSV")]
    truth_branches: Option<PathBuf>,
    /// Also write the recording without any noise
    #[arg(long, value_name = "REC")]
    truth_recording: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArguments,
    #[command(flatten)]
    faults: FaultArguments,
}

/// The commonest settings as flags; a settings file has them all.
#[derive(clap::Args)]
#[command(next_help_heading = "Settings")]
struct SettingsArguments {
    /// Read settings from a TOML file; flags override it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Go through this branch of the vessel, counted from 0 [default: 0]
    #[arg(long, value_name = "N")]
    branch: Option<usize>,
    /// Visit several branches, each up to 5 mm before its end or to a length along it, mm
    #[arg(long, value_name = "N[:MM],...", value_delimiter = ',', conflicts_with_all = ["branch", "end"])]
    branches: Vec<Visit>,
    /// Record while the catheter is withdrawn from one branch to the next, too [default: yes]
    #[arg(long, value_name = "yes|no", value_parser = clap::builder::BoolishValueParser::new())]
    record_withdrawals: Option<bool>,
    /// Only advance, without bending the tip
    #[arg(long)]
    steady: bool,
    /// Start at this length along the centreline, mm [default: 5]
    #[arg(long, value_name = "MM")]
    start: Option<f64>,
    /// Stop at this length along the centreline, mm [default: 5 before its end]
    #[arg(long, value_name = "MM")]
    end: Option<f64>,
    /// Rays per frame [default: 90]
    #[arg(long, value_name = "COUNT")]
    rays: Option<usize>,
    /// Range of the probe, mm [default: 30]
    #[arg(long, value_name = "MM")]
    range: Option<f64>,
    /// Give every frame its local cylinder
    #[arg(long)]
    cylinders: bool,
    /// Give every frame the phase of the heart, as from an ECG
    #[arg(long)]
    heart_phase: bool,
    /// Seed of the random numbers [default: 1]
    #[arg(long)]
    seed: Option<u64>,
    /// Levels of noise: the thesis's or none [default: thesis]
    #[arg(long, value_enum)]
    noise: Option<Level>,
    /// Tracked position: standard deviation in each axis, mm [default: 0.3]
    #[arg(long, value_name = "MM")]
    position_noise: Option<f64>,
    /// Tracked orientation: standard deviation in each axis, degrees [default: 0.5]
    #[arg(long, value_name = "DEG")]
    rotation_noise: Option<f64>,
    /// Take both from a CSV of poses of a tracker's sensor that lay still
    #[arg(long, value_name = "CSV", conflicts_with_all = ["position_noise", "rotation_noise"])]
    tracker_noise: Option<PathBuf>,
    /// The sensor in that file
    #[arg(long, value_name = "NAME", requires = "tracker_noise")]
    sensor: Option<String>,
    /// Contour points: standard deviation in x and in y, mm [default: 1]
    #[arg(long, value_name = "MM")]
    contour_noise: Option<f64>,
    /// Probability that a ray loses its echo [default: 0]
    #[arg(long, value_name = "P")]
    dropouts: Option<f64>,
    /// Probability that a ray has a wrong echo [default: 0]
    #[arg(long, value_name = "P")]
    spikes: Option<f64>,
    /// Drift of the tracked position, mm per square root of a second [default: 0]
    #[arg(long, value_name = "MM")]
    drift: Option<f64>,
    /// Drift of the tracked orientation, degrees per square root of a second [default: 0]
    #[arg(long, value_name = "DEG")]
    rotation_drift: Option<f64>,
    /// How much older than its contour a pose is, s [default: 0]
    #[arg(long, value_name = "S", allow_hyphen_values = true)]
    latency: Option<f64>,
    /// How much the vessel widens with the heart, as a fraction [default: 0]
    #[arg(long, value_name = "FRACTION")]
    pulsation: Option<f64>,
    /// Heart rate, Hz [default: 1.2]
    #[arg(long, value_name = "HZ")]
    heart_rate: Option<f64>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Level {
    Thesis,
    None,
}

/// A settings file.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Config {
    vessel: Option<Phantom>,
    insertion: Insertion,
    probe: Probe,
    noise: Noise,
    faults: Faults,
    cylinders: bool,
    heart_phase: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary<'a> {
    recording: Shown<'a>,
    vessel: &'a str,
    triangles: usize,
    branches: usize,
    branch_length_mm: f64,
    frames: usize,
    duration_s: f64,
    rays: usize,
    echoes: usize,
    missing_echoes: usize,
    repairs: &'a [String],
    reduced_bends: &'a [ReducedBend],
    tracker: &'a Option<TrackerNoise>,
    settings: &'a SimulationSettings,
    truth: Option<Shown<'a>>,
    truth_centreline: Option<Shown<'a>>,
    truth_branches: Option<Shown<'a>>,
    truth_recording: Option<Shown<'a>>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let output = match (self.list_faults, &self.output) {
            (false, Some(output)) => output,
            // Without an output the command line asks for the list.
            _ => {
                for FaultKind { name, what, .. } in FaultKind::ALL {
                    println!("{name:22} {what}");
                }
                println!("R is the median radius of the vessel along the first branch that is visited");
                return Ok(());
            }
        };
        if let Some(path) = &self.truth {
            surface::check_ending(path)?;
        }
        let [surface, centreline] = self.vessel.inputs();
        refuse_inputs(
            [
                Some(&**output),
                self.truth.as_deref(),
                self.truth_centreline.as_deref(),
                self.truth_branches.as_deref(),
                self.truth_recording.as_deref(),
            ],
            [surface, centreline, self.settings.config.as_deref(), self.settings.tracker_noise.as_deref()],
        )?;
        let config = self.settings.config()?;
        let (name, vessel) = self.vessel.vessel(config.vessel)?;
        let mut settings = SimulationSettings {
            insertion: config.insertion,
            probe: config.probe,
            noise: config.noise,
            faults: config.faults,
            cylinders: config.cylinders,
            heart_phase: config.heart_phase,
        };
        let tracker = self.settings.override_settings(&mut settings, &|settings| {
            self.faults.apply(settings, &vessel);
        })?;

        let bar = progress::bar("simulating frames", 0);
        let done = Simulation::run_and_tell(vessel, &settings, &|done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        let simulation = done?;

        simulation.recording.write(output)?;
        if let Some(path) = &self.truth {
            self.space.write(simulation.vessel.surface(), path)?;
        }
        if let Some(path) = &self.truth_centreline {
            Centreline::write_branches(simulation.vessel.branches(), path)?;
        }
        if let Some(path) = &self.truth_branches {
            simulation.write_places(path)?;
        }
        if let Some(path) = &self.truth_recording {
            simulation.truth_recording.write(path)?;
        }
        let frames = &simulation.recording.frames;
        let missing_echoes = frames.iter().map(|f| f.missing_echoes()).sum();
        let vessel = &simulation.vessel;
        let summary = Summary {
            recording: Shown(output),
            vessel: &name,
            triangles: vessel.surface().triangles.len(),
            branches: vessel.branches().len(),
            branch_length_mm: vessel
                .branches()
                .get(settings.insertion.branch)
                .map_or(0.0, Centreline::length_mm),
            frames: frames.len(),
            duration_s: frames.last().and_then(|f| f.time_s).unwrap_or_default(),
            rays: settings.probe.rays,
            echoes: frames.iter().map(|f| f.contour_mm.len()).sum::<usize>() - missing_echoes,
            missing_echoes,
            repairs: vessel.notes(),
            reduced_bends: &simulation.reduced_bends,
            tracker: &tracker,
            settings: &settings,
            truth: self.truth.as_deref().map(Shown),
            truth_centreline: self.truth_centreline.as_deref().map(Shown),
            truth_branches: self.truth_branches.as_deref().map(Shown),
            truth_recording: self.truth_recording.as_deref().map(Shown),
        };
        if self.json {
            return print_json(&summary);
        }
        summary.print();
        Ok(())
    }
}

impl SettingsArguments {
    fn config(&self) -> Result<Config> {
        let Some(path) = &self.config else {
            return Ok(Config::default());
        };
        let text =
            std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.clone(), source })?;
        toml::from_str(&text).map_err(|e| Error::settings(path, &text, &e))
    }

    /// Overrides the settings by the flags; returns the measured noise of a tracker, if one was asked for.
    ///
    /// `add_faults` comes after the levels of noise and before single values.
    fn override_settings(
        &self,
        settings: &mut SimulationSettings,
        add_faults: &dyn Fn(&mut SimulationSettings),
    ) -> Result<Option<TrackerNoise>> {
        fn set<T: Copy>(field: &mut T, flag: Option<T>) {
            if let Some(value) = flag {
                *field = value;
            }
        }
        let SimulationSettings { insertion, probe, noise, cylinders, heart_phase, .. } = &mut *settings;
        set(&mut insertion.branch, self.branch);
        if !self.branches.is_empty() {
            insertion.visits = self.branches.clone();
            (insertion.branch, insertion.end_mm) = (0, None);
        }
        set(&mut insertion.record_withdrawals, self.record_withdrawals);
        if self.steady {
            insertion.moves = Insertion::steady().moves;
            insertion.repeat = true;
        }
        set(&mut insertion.start_mm, self.start);
        insertion.end_mm = self.end.or(insertion.end_mm);
        set(&mut probe.rays, self.rays);
        set(&mut probe.range_mm, self.range);
        *cylinders |= self.cylinders;
        *heart_phase |= self.heart_phase;
        match self.noise {
            Some(Level::None) => *noise = Noise { seed: noise.seed, ..Noise::none() },
            Some(Level::Thesis) => *noise = Noise { seed: noise.seed, ..Noise::default() },
            None => (),
        }
        add_faults(settings);
        let noise = &mut settings.noise;
        set(&mut noise.seed, self.seed);
        set(&mut noise.position_sd_mm, self.position_noise);
        set(&mut noise.rotation_sd_deg, self.rotation_noise);
        set(&mut noise.contour_sd_mm, self.contour_noise);
        set(&mut noise.dropout_probability, self.dropouts);
        set(&mut noise.spike_probability, self.spikes);
        set(&mut noise.position_drift_mm_per_sqrt_s, self.drift);
        set(&mut noise.rotation_drift_deg_per_sqrt_s, self.rotation_drift);
        set(&mut noise.latency_s, self.latency);
        set(&mut noise.pulsation_fraction, self.pulsation);
        set(&mut noise.pulsation_rate_hz, self.heart_rate);
        let Some(path) = &self.tracker_noise else {
            return Ok(None);
        };
        let tracker = TrackerNoise::read(path, self.sensor.as_deref())?;
        tracker.apply(noise);
        Ok(Some(tracker))
    }
}

impl Summary<'_> {
    fn print(&self) {
        let (insertion, noise) = (&self.settings.insertion, &self.settings.noise);
        println!("vessel     {}: {} triangles", self.vessel, self.triangles);
        for repair in self.repairs {
            println!("           {repair}");
        }
        if insertion.visits.is_empty() {
            println!(
                "insertion  branch {} (of {}), {:.1} mm long, from {:.1} to {:.1} mm",
                insertion.branch,
                self.branches,
                self.branch_length_mm,
                insertion.start_mm,
                insertion.end_in_mm(self.branch_length_mm)
            );
        } else {
            let visits = insertion.visits.iter().map(|visit| match visit.to_mm {
                None => visit.branch.to_string(),
                Some(to) => format!("{} up to {to} mm", visit.branch),
            });
            println!("insertion  branches {} (of {})", visits.collect::<Vec<_>>().join(", "), self.branches);
        }
        if let Some(least) = self.reduced_bends.iter().min_by(|a, b| a.used_deg.total_cmp(&b.used_deg)) {
            println!(
                "           {} bends reduced to keep the tip in the lumen, the most at {:.0} mm: {}° to {:.1}°",
                self.reduced_bends.len(),
                least.s_mm,
                least.asked_deg,
                least.used_deg
            );
        }
        println!("frames     {} at {} Hz, {:.1} s", self.frames, insertion.frame_rate_hz, self.duration_s);
        println!(
            "echoes     {} recorded, {} missing, {} rays per frame",
            self.echoes, self.missing_echoes, self.rays
        );
        println!(
            "noise      seed {}: position {} mm, rotation {}°, contour {} mm (standard deviations)",
            noise.seed,
            rounded(noise.position_sd_mm),
            rounded(noise.rotation_sd_deg),
            rounded(noise.contour_sd_mm)
        );
        let faults = &self.settings.faults;
        let usual = Faults::default();
        let groups = [
            ("contour", faults.contour != usual.contour),
            ("artefacts", faults.artefacts != usual.artefacts),
            ("tracker", faults.tracker != usual.tracker),
            ("calibration", faults.calibration != usual.calibration),
            ("motion", faults.motion != usual.motion),
            ("sampling", faults.sampling != usual.sampling),
        ];
        let groups: Vec<&str> = groups.iter().filter(|(_, set)| *set).map(|&(name, _)| name).collect();
        if !groups.is_empty() {
            println!("faults     {}; --json has their settings", groups.join(", "));
        }
        if let Some(tracker) = self.tracker {
            println!(
                "           position and rotation from {} poses of sensor {}",
                tracker.poses, tracker.sensor
            );
        }
        println!("recording  {}", self.recording.display());
        if let Some(path) = &self.truth {
            println!("truth      {}", path.display());
        }
        if let Some(path) = &self.truth_centreline {
            println!("centreline {}", path.display());
        }
        if let Some(path) = &self.truth_branches {
            println!("branches   {}", path.display());
        }
        if let Some(path) = &self.truth_recording {
            println!("truth      {}", path.display());
        }
    }
}

/// At most four decimals, and no more than there are.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
