//! How long frames take, and how often that is too long.

use crate::reconstruction::Times;
use serde::Serialize;

/// The times of a frame, s.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct FrameTimes {
    /// From its arrival, or from when it was due, until it was taken.
    pub waiting_s: f64,
    /// Of the reconstruction.
    pub stages: Times,
    /// Handing the change to whoever follows the vessel.
    pub showing_s: f64,
}

impl FrameTimes {
    /// From the frame's arrival until the vessel was up to date everywhere, s.
    pub(crate) fn latency_s(&self) -> f64 {
        self.waiting_s + self.stages.total_s + self.showing_s
    }
}

/// Percentiles by nearest rank.
#[derive(Debug, Serialize)]
pub(crate) struct Percentiles {
    pub p50: f64,
    pub p95: f64,
    pub p99: f64,
    pub max: f64,
}

impl Percentiles {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let rank = (share * values.len() as f64).ceil() as usize;
            values.get(rank.max(1) - 1).copied().unwrap_or(0.0)
        };
        Self { p50: rank(0.5), p95: rank(0.95), p99: rank(0.99), max: rank(1.0) }
    }
}

/// The times of all frames.
#[derive(Debug, Serialize)]
pub(crate) struct TimesReport {
    /// Of the reconstruction, by frame, ms.
    pub push_ms: Percentiles,
    /// The same of each stage, and what comes before and after it.
    pub stages_ms: Stages,
    /// From a frame's arrival until the vessel was up to date everywhere, ms.
    pub latency_ms: Percentiles,
    /// Frames whose latency was longer than one interval at these rates.
    pub missed_deadlines: MissedDeadlines,
}

/// What a frame's time consists of.
#[derive(Debug, Serialize)]
pub(crate) struct Stages {
    pub waiting: Percentiles,
    pub screening: Percentiles,
    pub axis: Percentiles,
    pub placing: Percentiles,
    pub solving: Percentiles,
    pub showing: Percentiles,
}

#[derive(Debug, Serialize)]
pub(crate) struct MissedDeadlines {
    #[serde(rename = "12_hz")]
    pub at_12_hz: usize,
    #[serde(rename = "30_hz")]
    pub at_30_hz: usize,
    #[serde(rename = "60_hz")]
    pub at_60_hz: usize,
}

impl TimesReport {
    pub(crate) fn of(times: &[FrameTimes]) -> Self {
        let ms =
            |of: &dyn Fn(&FrameTimes) -> f64| Percentiles::of(times.iter().map(|t| of(t) * 1e3).collect());
        let missed = |rate_hz: f64| times.iter().filter(|t| t.latency_s() > 1.0 / rate_hz).count();
        Self {
            push_ms: ms(&|t| t.stages.total_s),
            stages_ms: Stages {
                waiting: ms(&|t| t.waiting_s),
                screening: ms(&|t| t.stages.screening_s),
                axis: ms(&|t| t.stages.axis_s),
                placing: ms(&|t| t.stages.placing_s),
                solving: ms(&|t| t.stages.solving_s),
                showing: ms(&|t| t.showing_s),
            },
            latency_ms: ms(&FrameTimes::latency_s),
            missed_deadlines: MissedDeadlines {
                at_12_hz: missed(12.0),
                at_30_hz: missed(30.0),
                at_60_hz: missed(60.0),
            },
        }
    }
}

/// The most memory that this process has had at a time, bytes, where the system says so.
pub(crate) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_are_missed_by_those_that_take_longer() {
        let frame = |latency_ms: f64| FrameTimes {
            waiting_s: 0.25e-3 * latency_ms,
            showing_s: 0.25e-3 * latency_ms,
            stages: Times { total_s: 0.5e-3 * latency_ms, ..Times::default() },
        };
        let report = TimesReport::of(&(0..100).map(|k| frame(f64::from(k))).collect::<Vec<_>>());
        let MissedDeadlines { at_12_hz, at_30_hz, at_60_hz } = report.missed_deadlines;
        assert_eq!([at_12_hz, at_30_hz, at_60_hz], [16, 66, 83]);
        let Percentiles { p50, p95, p99, max } = report.latency_ms;
        for (value, expected) in [(p50, 49.0), (p95, 94.0), (p99, 98.0), (max, 99.0)] {
            assert!((value - expected).abs() < 1e-9, "{value}");
        }
        assert!(
            (report.push_ms.max - 49.5).abs() < 1e-9 && (report.stages_ms.waiting.max - 24.75).abs() < 1e-9
        );
        assert!(TimesReport::of(&[]).push_ms.max == 0.0);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_peak_of_memory_is_known() {
        let before = peak_memory_bytes().unwrap();
        let block = vec![1_u8; 1 << 26];
        assert!(std::hint::black_box(&block).iter().all(|b| *b == 1));
        assert!(peak_memory_bytes().unwrap() >= (before / 2).max(1 << 26));
    }
}
