//! Speed of the engines: the same work on the CPU and on a device, whose results are compared before it is
//! timed.
//!
//! Times are medians with their range; upload, passes, readback and the whole are timed separately. The bytes
//! of a pass are those that it must read and write, and are compared with the copy bandwidth that the same
//! process measures.

#[cfg(feature = "gpu")]
pub mod device;
mod sweep;

pub use sweep::{SweepCase, SweepDeviceRow, SweepPassRow, SweepRow, run_sweep};

use crate::cylinders::fit::{CpuEngine, DeformedTube, Engine};
use crate::cylinders::passes::Section;
use crate::settings::Settings;
use crate::{Error, Result};
use rand::{RngExt, SeedableRng};
use serde::Serialize;
use std::fmt;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// Work of that long precedes a timing on a device: a card raises its clock under load only.
const WARM_UP: Duration = Duration::from_millis(500);

/// The radius of the tube that is fitted, mm.
const RADIUS_MM: f64 = 12.0;

/// The distribution of the points over the tube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PointPattern {
    /// All over the tube.
    Even,
    /// All in 1 % of the faces.
    Crowded,
    /// In one half of the faces.
    Half,
}

/// One size of work: `512x512x1e6`, optionally `:crowded` or `:half`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Case {
    /// N.
    pub nodes: u32,
    /// L.
    pub levels: u32,
    /// Number of points.
    pub points: usize,
    /// Their distribution.
    #[serde(rename = "spread")]
    pub pattern: PointPattern,
}

impl FromStr for Case {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (size, pattern) = match text.split_once(':') {
            None => (text, PointPattern::Even),
            Some((size, "crowded")) => (size, PointPattern::Crowded),
            Some((size, "half")) => (size, PointPattern::Half),
            Some((_, other)) => return Err(Error::setting("case", other, "crowded or half after the colon")),
        };
        let parts: Vec<&str> = size.split('x').collect();
        let [nodes, levels, points] = parts[..] else {
            return Err(Error::setting("case", text, "NODESxLEVELSxPOINTS, such as 12x5x1e4"));
        };
        let number = |part: &str| {
            let whole = part.parse().ok().filter(|x: &f64| x.fract() == 0.0 && (1.0..=4e9).contains(x));
            whole.ok_or_else(|| Error::setting("case", part, "a whole number from 1 to 4e9"))
        };
        Ok(Self {
            nodes: number(nodes)? as u32,
            levels: number(levels)? as u32,
            points: number(points)? as usize,
            pattern,
        })
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}x{} {:.0e}", self.nodes, self.levels, self.points as f64)?;
        match self.pattern {
            PointPattern::Even => Ok(()),
            PointPattern::Crowded => write!(f, " crowded"),
            PointPattern::Half => write!(f, " half"),
        }
    }
}

impl Case {
    /// The settings of the case: three iterations, the rest as published.
    pub fn settings(&self) -> Settings {
        Settings { nodes: self.nodes, levels: self.levels, ..Settings::default() }
    }

    /// Points on a wavy wall with a noise of 0.5 mm and 2 % outliers of 5 mm, the same for the same seed.
    pub fn section(&self, seed: u64) -> Section<f32> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let height = Settings::default().height_mm;
        let (z_share, theta_share) = match self.pattern {
            PointPattern::Even => (1.0, 1.0),
            PointPattern::Crowded => (0.1, 0.1),
            PointPattern::Half => (1.0, 0.5),
        };
        let mut section = Section::default();
        for _ in 0..self.points {
            let theta = rng.random_range(0.0..std::f64::consts::TAU) * theta_share;
            let z = (rng.random_range(0.0..1.0) * z_share - 0.5) * height;
            let noise: f64 = rng.sample(rand_distr::StandardNormal);
            let mut r = RADIUS_MM * (1.1 + 0.05 * (2.0 * theta).sin() + 0.05 * f64::sin(z)) + 0.5 * noise;
            if rng.random_bool(0.02) {
                let outlier: f64 = rng.sample(rand_distr::StandardNormal);
                r += 5.0 * outlier;
            }
            section.r.push(r.abs() as f32);
            section.theta.push(theta as f32);
            section.z.push(z as f32);
        }
        section
    }
}

/// Some times in ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Times {
    /// Median.
    pub median_ms: f64,
    /// Shortest.
    pub min_ms: f64,
    /// Longest.
    pub max_ms: f64,
}

impl Times {
    fn of(mut seconds: Vec<f64>) -> Self {
        seconds.sort_by(f64::total_cmp);
        let at = |i: usize| seconds.get(i).copied().unwrap_or(f64::NAN) * 1e3;
        Self { median_ms: at(seconds.len() / 2), min_ms: at(0), max_ms: at(seconds.len().saturating_sub(1)) }
    }

    /// Times some repeats of some work, after half a second of it.
    ///
    /// # Errors
    /// The work's.
    pub fn measure_warm<R>(repeats: usize, mut work: impl FnMut() -> Result<R>) -> Result<Self> {
        let start = Instant::now();
        while start.elapsed() < WARM_UP {
            work()?;
        }
        Self::measure(repeats, work)
    }

    /// Times some repeats of some work.
    ///
    /// # Errors
    /// The work's.
    pub fn measure<R>(repeats: usize, mut work: impl FnMut() -> Result<R>) -> Result<Self> {
        let mut seconds = Vec::with_capacity(repeats);
        for _ in 0..repeats.max(1) {
            let start = Instant::now();
            let done = work()?;
            seconds.push(start.elapsed().as_secs_f64());
            drop(done);
        }
        Ok(Self::of(seconds))
    }
}

/// Times of a case on the CPU.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct CpuRow {
    /// The whole fit on one thread.
    pub one_thread: Times,
    /// The whole fit on all threads.
    pub all_threads: Times,
    /// The number of threads.
    pub threads: usize,
}

/// Times of a case on the device, each after half a second of the same work: a card that idles runs at a
/// fraction of its clock.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct DeviceRow {
    /// From host slices to the tube, with an engine that has fitted as many points before.
    pub end_to_end: Times,
    /// Where that time went.
    pub of_it: EndToEnd,
    /// Making device memory for the case.
    pub making_memory: Times,
    /// The points' way to the device, until they are there.
    pub upload: Times,
    /// All passes, with the points on the device, until it is done.
    pub resident: Times,
    /// The radii's transfer back.
    pub readback: Times,
    /// One more iteration, on the device: a tenth of the difference between a fit of ten more iterations and one of
    /// as many as `resident` has, without gaps for timestamps within them. `None` where the device has no timestamps.
    pub iteration: Option<Times>,
    /// Each pass, timed alone on the device, as the sum over a fit; absent where the device has no timestamps. Starting
    /// and ending a pass for its timestamps takes some microseconds.
    pub passes: Vec<PassRow>,
}

/// The parts of work from host slices to host slices, which add up to nearly all of it.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct EndToEnd {
    /// Device memory: making it, or finding some that was kept.
    pub memory: Times,
    /// The points' way into host memory that the device copies from.
    pub filling: Times,
    /// Recording and submitting commands.
    pub recording: Times,
    /// Waiting for the device: its copy of the points, all passes, its copy of the results.
    pub waiting: Times,
    /// Reading the results from host memory that the device copied to.
    pub reading: Times,
    /// Submissions that were waited for.
    pub waits: u32,
}

#[cfg(feature = "gpu")]
impl EndToEnd {
    /// The parts of some repeats.
    fn of(spent: &[crate::gpu::Spent]) -> Self {
        let of = |part: fn(&crate::gpu::Spent) -> f64| Times::of(spent.iter().map(part).collect());
        Self {
            memory: of(|spent| spent.memory_s),
            filling: of(|spent| spent.filling_s),
            recording: of(|spent| spent.recording_s),
            waiting: of(|spent| spent.waiting_s),
            reading: of(|spent| spent.reading_s),
            waits: spent.last().map_or(0, |spent| spent.waits),
        }
    }
}

/// A pass over a whole fit.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct PassRow {
    /// The pass.
    pub name: &'static str,
    /// Median of its device time over a fit, ms.
    pub median_ms: f64,
    /// Bytes that it must read and write in a fit, each input once and each output once.
    pub bytes: u64,
    /// Floating-point operations in a fit: 250 for each distance; those of other passes are not counted.
    pub flops: u64,
    /// Those bytes per second over the bandwidth of a copying pass, measured in this process.
    pub share_of_copy_bandwidth: f64,
}

/// A case on all engines.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct BenchRow {
    /// The case.
    pub case: Case,
    /// On the CPU, unless it was not to be timed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu: Option<CpuRow>,
    /// On the device, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<DeviceRow>,
    /// How the results were compared before anything was timed.
    pub parity: Parity,
}

/// Differences between two engines' results.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Parity {
    /// The two engines.
    pub engines: [String; 2],
    /// Nodes whose radii differ in any bit.
    pub differing: usize,
    /// Nodes.
    pub nodes: usize,
    /// Median of |Δr| over all nodes, mm.
    pub median_mm: f64,
    /// 99th percentile of |Δr|, mm.
    pub p99_mm: f64,
}

impl Parity {
    /// Largest median of |Δr|, mm: a few decisions at boundaries may differ, most must not.
    const MAX_MEDIAN_MM: f64 = 1e-4;

    /// Compares two results.
    ///
    /// # Errors
    /// [`Error::Surface`] where they fitted different numbers of points or their median difference is too large.
    pub fn check(names: [&str; 2], a: &DeformedTube, b: &DeformedTube) -> Result<Self> {
        if a.points != b.points {
            return Self::fail(names, "points", b.points.to_string(), a.points.to_string());
        }
        Self::of(names, &a.radii_mm, &b.radii_mm)
    }

    fn fail<R>(names: [&str; 2], what: &str, found: String, expected: String) -> Result<R> {
        Err(Error::Surface { what: format!("{} against {}: {what}", names[0], names[1]), found, expected })
    }

    /// Compares the radii of two results, mm.
    ///
    /// # Errors
    /// [`Error::Surface`] where the numbers of nodes differ or the median difference is too large.
    pub fn of(names: [&str; 2], a: &[f64], b: &[f64]) -> Result<Self> {
        if a.len() != b.len() {
            return Self::fail(names, "nodes", b.len().to_string(), a.len().to_string());
        }
        let mut apart: Vec<f64> = a.iter().zip(b).map(|(p, q)| (p - q).abs()).collect();
        apart.sort_by(f64::total_cmp);
        let rank = |share: f64| apart[((apart.len() - 1) as f64 * share) as usize];
        let parity = Self {
            engines: names.map(str::to_owned),
            differing: apart.iter().filter(|d| **d != 0.0).count(),
            nodes: apart.len(),
            median_mm: rank(0.5),
            p99_mm: rank(0.99),
        };
        // A NaN fails too.
        if parity.median_mm <= Self::MAX_MEDIAN_MM {
            Ok(parity)
        } else {
            let limit = format!("at most {} mm", Self::MAX_MEDIAN_MM);
            Self::fail(names, "median difference of the radii", format!("{} mm", parity.median_mm), limit)
        }
    }
}

/// Times a case, after comparing the device with the CPU, or without a device the CPU with its f64 reference.
/// `time_cpu` says whether the CPU is timed too; it always computes what the device is compared with.
///
/// # Errors
/// Where two engines disagree, or one fails. No time is taken then.
pub fn run(
    case: Case,
    repeats: usize,
    time_cpu: bool,
    #[cfg(feature = "gpu")] device: Option<&device::Device>,
) -> Result<BenchRow> {
    let settings = case.settings();
    settings.validate()?;
    let section = case.section(1);
    let engine = CpuEngine::<f32>::new();
    let fit = || engine.fit_section(&section, RADIUS_MM, &settings).map(|fit| fit.tube);
    let expected = fit()?;
    #[cfg(feature = "gpu")]
    let (parity, device) = match device {
        Some(device) => {
            let found = device.engine.fit_section(&section, RADIUS_MM, &settings)?.tube;
            let parity = Parity::check(["cpu", "gpu"], &expected, &found)?;
            (parity, Some(device.time(&section, &settings, repeats)?))
        }
        None => (against_reference(&section, &settings, &expected)?, None),
    };
    #[cfg(not(feature = "gpu"))]
    let (parity, device) = (against_reference(&section, &settings, &expected)?, None);
    let mut cpu = None;
    if time_cpu {
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let one = one.map_err(|e| Error::setting("threads", e, 1))?;
        cpu = Some(CpuRow {
            one_thread: one.install(|| Times::measure(repeats, fit))?,
            all_threads: Times::measure(repeats, fit)?,
            threads: rayon::current_num_threads(),
        });
    }
    Ok(BenchRow { case, cpu, device, parity })
}

fn against_reference(section: &Section<f32>, settings: &Settings, found: &DeformedTube) -> Result<Parity> {
    let reference = CpuEngine::<f64>::new().fit_section(section, RADIUS_MM, settings)?.tube;
    Parity::check(["reference", "cpu"], &reference, found)
}
