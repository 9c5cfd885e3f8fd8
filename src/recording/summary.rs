use super::finding::{Finding, Findings};
use super::screening::{Cleaning, Reason, Screening};
use super::{Frame, Recording};
use serde::Serialize;
use std::fmt;

/// A recording in numbers, and its defects.
///
/// It accepts recordings that fail [`Recording::check`]: unusable frames are left out of the statistics that they would
/// distort and are listed among the [`defects`](Self::defects).
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Summary {
    /// Frames.
    pub frames: usize,
    /// From the first known time to the last, s.
    pub duration_s: Option<f64>,
    /// One over the median time between frames, 1/s.
    pub frame_rate_hz: Option<f64>,
    /// Rays per frame.
    pub rays: Option<MinMedianMax>,
    /// Wall points, without missing echoes.
    pub points: usize,
    /// Rays without an echo.
    pub missing_echoes: usize,
    /// Length of the sensor's path, mm.
    pub path_length_mm: f64,
    /// Distance between the sensor's positions in consecutive frames, mm.
    pub step_mm: Option<MinMedianMax>,
    /// Angle between the sensor's orientations in consecutive frames, rad.
    pub turn_rad: Option<MinMedianMax>,
    /// Frames whose rotations were rounded to so few digits in their file that the reader made them
    /// orthonormal.
    pub rounded_rotations: usize,
    /// Distance of the wall points from their contour's centroid, mm.
    pub contour_radius_mm: Option<MinMedianMax>,
    /// Frames with a cylinder model.
    pub cylinders: usize,
    /// Radius of the cylinder models, mm.
    pub cylinder_radius_mm: Option<MinMedianMax>,
    /// Frames that a reconstruction leaves out.
    pub left_out: usize,
    /// What it does to the points of contours before.
    #[serde(flatten)]
    pub cleaning: Cleaning,
    /// Defects and what is suspicious, one entry per kind.
    pub defects: Vec<Finding>,
}

/// Smallest, middle and largest of some numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MinMedianMax {
    /// The smallest.
    pub min: f64,
    /// The middle one; of an even number of them, the upper middle one.
    pub median: f64,
    /// The largest.
    pub max: f64,
}

impl Summary {
    /// Summarises a recording.
    pub fn of(recording: &Recording) -> Self {
        let frames = &recording.frames;
        let screening = Screening::of(recording);
        let mut findings = Findings::new(frames.len());
        if frames.is_empty() {
            findings.add_whole("frames", "at least 1", true, "0 frames".into(), None);
        }
        for (k, frame) in frames.iter().enumerate() {
            for defect in frame.defects() {
                findings.add(defect.field, defect.expected.into(), true, k, defect.found);
            }
        }
        for one in screening.left_out.iter().filter(|one| one.reason != Reason::Defect) {
            findings.add(one.field, one.expected.clone(), false, one.place, one.found.clone());
        }
        let mut defects = findings.named(recording);
        defects.extend(screening.suspicions);

        let steps = between(frames, |a, b| {
            a.world_from_sensor.translation_mm.distance(b.world_from_sensor.translation_mm)
        });
        let turns = between(frames, |a, b| a.world_from_sensor.turn_rad(&b.world_from_sensor));
        let times: Vec<(usize, f64)> = frames
            .iter()
            .enumerate()
            .filter_map(|(k, f)| Some((k, f.time_s.filter(|t| t.is_finite())?)))
            .collect();
        let intervals = times.windows(2).map(|pair| (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0) as f64);
        let interval_s = min_median_max(intervals).map(|s| s.median);
        let contour_radius_mm = min_median_max(frames.iter().flat_map(|f| {
            let centre = f.centroid_mm();
            f.echoes_mm().filter_map(move |p| Some(p.distance(centre?)))
        }));

        Self {
            frames: frames.len(),
            duration_s: times.first().zip(times.last()).map(|(first, last)| last.1 - first.1),
            frame_rate_hz: interval_s.filter(|&s| s > 0.0).map(f64::recip),
            rays: min_median_max(frames.iter().map(|f| f.contour_mm.len() as f64)),
            points: frames.iter().map(|f| f.echoes_mm().count()).sum(),
            missing_echoes: frames.iter().map(Frame::missing_echoes).sum(),
            path_length_mm: steps.iter().sum::<f64>() + 0.0,
            step_mm: min_median_max(steps.iter().copied()),
            turn_rad: min_median_max(turns),
            rounded_rotations: frames.iter().filter(|f| f.rotation_error.is_some()).count(),
            contour_radius_mm,
            cylinders: frames.iter().filter(|f| f.cylinder.is_some()).count(),
            cylinder_radius_mm: min_median_max(
                frames.iter().filter_map(|f| Some(f.cylinder.as_ref()?.radius_mm)),
            ),
            defects,
            left_out: screening.left_out.len(),
            cleaning: screening.cleaning,
        }
    }
}

/// A quantity of each two consecutive frames with finite poses.
fn between(frames: &[Frame], of: impl Fn(&Frame, &Frame) -> f64) -> Vec<f64> {
    frames
        .iter()
        .zip(frames.iter().skip(1))
        .map(|(a, b)| of(a, b))
        .filter(|value| value.is_finite())
        .collect()
}

pub(super) fn min_median_max(numbers: impl IntoIterator<Item = f64>) -> Option<MinMedianMax> {
    let mut numbers: Vec<f64> = numbers.into_iter().filter(|x| x.is_finite()).collect();
    let min = numbers.iter().copied().min_by(f64::total_cmp)?;
    let max = numbers.iter().copied().max_by(f64::total_cmp)?;
    let middle = numbers.len() / 2;
    let (_, median, _) = numbers.select_nth_unstable_by(middle, f64::total_cmp);
    Some(MinMedianMax { min, median: *median, max })
}

impl fmt::Display for MinMedianMax {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(3);
        write!(f, "{:.digits$} to {:.digits$}, median {:.digits$}", self.min, self.max, self.median)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let or_unknown = |s: Option<MinMedianMax>, unit: &str| {
            s.map_or_else(|| "none".to_owned(), |s| format!("{s:.3} {unit}"))
        };
        match (self.frame_rate_hz, self.duration_s) {
            (Some(rate), Some(s)) => {
                writeln!(f, "frames          {} ({rate:.2} per second, {s:.2} s)", self.frames)?
            }
            _ => writeln!(f, "frames          {} (no times)", self.frames)?,
        }
        if let Some(rays) = self.rays {
            writeln!(f, "rays per frame  {rays:.0}")?;
        }
        writeln!(f, "points          {} and {} missing echoes", self.points, self.missing_echoes)?;
        writeln!(f, "path            {:.2} mm", self.path_length_mm)?;
        writeln!(f, "steps           {}", or_unknown(self.step_mm, "mm"))?;
        let degrees = |s: MinMedianMax| MinMedianMax {
            min: s.min.to_degrees(),
            median: s.median.to_degrees(),
            max: s.max.to_degrees(),
        };
        writeln!(f, "turns           {}", or_unknown(self.turn_rad.map(degrees), "degrees"))?;
        if self.rounded_rotations > 0 {
            writeln!(
                f,
                "rotations       {} made orthonormal, rounded as they are in the file",
                self.rounded_rotations
            )?;
        }
        writeln!(f, "contour radius  {}", or_unknown(self.contour_radius_mm, "mm"))?;
        write!(f, "cylinders       {}", self.cylinders)?;
        if let Some(radius) = self.cylinder_radius_mm {
            write!(f, ", radius {radius:.3} mm")?;
        }
        writeln!(f)?;
        for (label, found) in self.cleaning.lines() {
            writeln!(f, "{label:<16}{found}")?;
        }
        if self.left_out > 0 {
            writeln!(f, "left out        {} frames, by a reconstruction", self.left_out)?;
        }
        if self.defects.is_empty() {
            return writeln!(f, "defects         none");
        }
        self.defects.iter().try_for_each(|finding| write!(f, "{finding}"))?;
        Ok(())
    }
}
