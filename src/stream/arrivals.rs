//! What is irregular about the frames that come. It is counted; frames are taken in the order in which they
//! come, whatever their times, as they would stand in a recording.

use crate::recording::Frame;
use serde::Serialize;
use std::collections::VecDeque;
use std::time::Instant;

/// Intervals that tell the frame rate, the newest ones, and how many it takes at least.
const INTERVALS: usize = 64;
const MIN_INTERVALS: usize = 8;
/// From so many usual intervals on, there is a gap.
const GAP: f64 = 2.5;
/// A frame is late that comes so much later than the quickest one did, s, by their own times.
const LATE_S: f64 = 0.25;

/// What is irregular so far.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct ArrivalsReport {
    /// Frames that came.
    pub frames: usize,
    /// Frames without a pose.
    pub without_pose: usize,
    /// Frames without an echo.
    pub without_echoes: usize,
    /// Frames whose time is before that of an earlier one.
    pub out_of_order: usize,
    /// Frames with the time, or with the pose and the contour, of the frame before.
    pub repeated: usize,
    /// Times without a frame for at least 2.5 usual intervals.
    pub gaps: usize,
    /// The longest of them, s.
    pub longest_gap_s: f64,
    /// Frames that came more than 0.25 s later than the quickest one, by their own times.
    pub late: usize,
}

/// Watches the frames.
#[derive(Debug, Default)]
pub(crate) struct Arrivals {
    report: ArrivalsReport,
    newest_s: Option<f64>,
    before: Option<Frame>,
    intervals_s: VecDeque<f64>,
    start: Option<Instant>,
    least_delay_s: Option<f64>,
}

impl Arrivals {
    /// Takes a frame and when it came.
    pub(crate) fn take(&mut self, frame: &Frame, came: Instant) {
        let report = &mut self.report;
        report.frames += 1;
        report.without_pose += usize::from(!frame.world_from_sensor.is_finite());
        report.without_echoes += usize::from(frame.echoes_mm().next().is_none());
        let same_time = |before: &Frame| frame.time_s.is_some() && before.time_s == frame.time_s;
        let same_content = |before: &Frame| {
            before.world_from_sensor == frame.world_from_sensor
                && before.contour_mm.len() == frame.contour_mm.len()
                && before
                    .contour_mm
                    .iter()
                    .zip(&frame.contour_mm)
                    .all(|(a, b)| a == b || a.is_nan() && b.is_nan())
        };
        let is_repeated =
            self.before.as_ref().is_some_and(|before| same_time(before) || same_content(before));
        report.repeated += usize::from(is_repeated);
        self.before = Some(frame.clone());
        let Some(time_s) = frame.time_s.filter(|t| t.is_finite()) else { return };
        let start = *self.start.get_or_insert(came);
        let delay_s = came.saturating_duration_since(start).as_secs_f64() - time_s;
        let least_s = self.least_delay_s.map_or(delay_s, |least| least.min(delay_s));
        self.least_delay_s = Some(least_s);
        report.late += usize::from(delay_s > least_s + LATE_S);
        let Some(newest_s) = self.newest_s.replace(self.newest_s.map_or(time_s, |newest| newest.max(time_s)))
        else {
            return;
        };
        report.out_of_order += usize::from(time_s < newest_s);
        let interval_s = time_s - newest_s;
        if interval_s <= 0.0 {
            return;
        }
        if self.intervals_s.len() >= MIN_INTERVALS && interval_s >= GAP * self.usual_s() {
            self.report.gaps += 1;
            self.report.longest_gap_s = self.report.longest_gap_s.max(interval_s);
        } else {
            self.intervals_s.push_back(interval_s);
            if self.intervals_s.len() > INTERVALS {
                self.intervals_s.pop_front();
            }
        }
    }

    fn usual_s(&self) -> f64 {
        let mut sorted: Vec<f64> = self.intervals_s.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    pub(crate) fn report(&self) -> &ArrivalsReport {
        &self.report
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use glam::{DVec2, DVec3};
    use std::time::Duration;

    /// A frame every 0.1 s that advances by 1 mm.
    fn frames(count: usize) -> Vec<(Frame, f64)> {
        let frame = |k: usize| {
            let pose = Pose { translation_mm: DVec3::Z * k as f64, ..Pose::IDENTITY };
            let time_s = 100.0 + 0.1 * k as f64;
            (Frame::new(pose, vec![DVec2::X, DVec2::NAN]).with_time_s(Some(time_s)), time_s - 100.0)
        };
        (0..count).map(frame).collect()
    }

    fn report(frames: &[(Frame, f64)]) -> ArrivalsReport {
        let (start, mut arrivals) = (Instant::now(), Arrivals::default());
        for (frame, came_s) in frames {
            arrivals.take(frame, start + Duration::from_secs_f64(*came_s));
        }
        arrivals.report().clone()
    }

    #[test]
    fn regular_frames_are_only_counted() {
        let report = report(&frames(50));
        let ArrivalsReport {
            frames, without_pose, without_echoes, out_of_order, repeated, gaps, late, ..
        } = report;
        assert_eq!(frames, 50);
        assert_eq!([without_pose, without_echoes, out_of_order, repeated, gaps, late], [0; 6]);
    }

    #[test]
    fn whatever_is_irregular_is_counted() {
        let mut all = frames(50);
        all[10].0.world_from_sensor = Pose::LOST;
        all[12].0.contour_mm = vec![DVec2::NAN; 3];
        // Two that are exchanged: the second of them is out of order.
        let (earlier, later) = (all[20].0.clone(), all[21].0.clone());
        (all[20].0, all[21].0) = (later, earlier);
        // The same again, with another time; and another one with the same time.
        let time_s = all[26].0.time_s;
        all[26].0 = all[25].0.clone().with_time_s(time_s);
        all[28].0.time_s = all[27].0.time_s;
        all[30].1 += 0.4;
        // Five frames are missing.
        all.drain(40..45);
        let report = report(&all);
        assert_eq!((report.frames, report.without_pose, report.without_echoes), (45, 1, 1));
        assert_eq!((report.out_of_order, report.repeated, report.late, report.gaps), (1, 2, 1, 1));
        assert!((report.longest_gap_s - 0.6).abs() < 1e-9, "{}", report.longest_gap_s);
    }
}
