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
    /// Defects, one entry per kind.
    pub defects: Vec<Defects>,
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

/// Frames with one kind of defect.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Defects {
    /// The quantity.
    pub field: &'static str,
    /// What it should be.
    pub expected: String,
    /// Whether [`Recording::check`] refuses it; else it is suspicious only.
    pub fatal: bool,
    /// How many frames have it; 0 where it is about the recording as a whole.
    pub frames: usize,
    /// The first of them, at most [`Summary::MAX_EXAMPLES`], or the recording's one.
    pub examples: Vec<Example>,
}

/// One occurrence of a defect.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Example {
    /// The frame (0-based); `None`: the recording as a whole.
    pub frame: Option<usize>,
    /// What was there.
    pub found: String,
}

impl Summary {
    /// Frames listed per kind of defect.
    pub const MAX_EXAMPLES: usize = 10;
    /// No step is a jump below this, mm.
    pub const MIN_JUMP_MM: f64 = 5.0;
    /// No turn is a jump below this, rad.
    pub const MIN_JUMP_RAD: f64 = 0.35;
    /// A step or turn is a jump above this multiple of the median one.
    pub const JUMP_FACTOR: f64 = 10.0;

    /// Summarises a recording.
    pub fn of(recording: &Recording) -> Self {
        let frames = &recording.frames;
        let mut list = DefectList(Vec::new());
        for (k, frame) in frames.iter().enumerate() {
            for defect in frame.defects() {
                list.add(defect.field, defect.expected.into(), true, Some(k), defect.found);
            }
        }
        for (k, frame) in frames.iter().enumerate() {
            let (points, missing) = (frame.echoes_mm().count(), frame.missing_echoes());
            if points < MIN_POINTS {
                let found = format!("{points} ({missing} missing echoes)");
                list.add("wall points", format!("at least {MIN_POINTS}"), false, Some(k), found);
            }
        }
        if frames.is_empty() {
            list.add("frames", "at least 1".into(), true, None, "0 frames".into());
        }

        let steps = between(frames, |a, b| {
            a.world_from_sensor.translation_mm.distance(b.world_from_sensor.translation_mm)
        });
        let turns = between(frames, |a, b| {
            let turn = a.world_from_sensor.rotation.transpose() * b.world_from_sensor.rotation;
            ((turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0) / 2.0).clamp(-1.0, 1.0).acos()
        });
        let (step_mm, turn_rad) = (of_steps(&steps), of_steps(&turns));
        let jump = |least: f64, spread: Option<MinMedianMax>| {
            spread.map_or(least, |s| least.max(Self::JUMP_FACTOR * s.median))
        };
        let max_mm = jump(Self::MIN_JUMP_MM, step_mm);
        for &(k, step) in steps.iter().filter(|s| s.1 > max_mm) {
            let expected = format!("steps of at most {max_mm:.2} mm");
            list.add("position jump", expected, false, Some(k), format!("{step:.2} mm"));
        }
        let max_rad = jump(Self::MIN_JUMP_RAD, turn_rad);
        for &(k, turn) in turns.iter().filter(|t| t.1 > max_rad) {
            let expected = format!("turns of at most {:.1} degrees", max_rad.to_degrees());
            list.add("rotation jump", expected, false, Some(k), format!("{:.1} degrees", turn.to_degrees()));
        }

        let times: Vec<(usize, f64)> =
            frames.iter().enumerate().filter_map(|(k, f)| Some((k, f.time_s?))).collect();
        let mut intervals = Vec::new();
        for pair in times.windows(2) {
            let &[(j, earlier), (k, later)] = pair else { continue };
            if later <= earlier {
                let found = format!("{later} s after {earlier} s");
                list.add("time", "times that rise".into(), false, Some(k), found);
            }
            intervals.push((later - earlier) / (k - j) as f64);
        }
        let interval_s = min_median_max(intervals).map(|s| s.median);

        let contour_radius_mm = min_median_max(frames.iter().flat_map(|f| {
            let centre = f.centroid_mm();
            f.echoes_mm().filter_map(move |p| Some(p.distance(centre?)))
        }));
        if let Some(MinMedianMax { median, .. }) = contour_radius_mm
            && !LUMEN_RADII_MM.contains(&median)
        {
            let guess = if median < LUMEN_RADII_MM.start { "metres" } else { "micrometres or pixels" };
            let found = format!("median {median:.4} mm: are the lengths {guess}?");
            let expected = format!("{} to {} mm", LUMEN_RADII_MM.start, LUMEN_RADII_MM.end);
            list.add("contour radius", expected, false, None, found);
        }

        Self {
            frames: frames.len(),
            duration_s: times.first().zip(times.last()).map(|(first, last)| last.1 - first.1),
            frame_rate_hz: interval_s.filter(|&s| s > 0.0).map(f64::recip),
            rays: min_median_max(frames.iter().map(|f| f.contour_mm.len() as f64)),
            points: frames.iter().map(|f| f.echoes_mm().count()).sum(),
            missing_echoes: frames.iter().map(Frame::missing_echoes).sum(),
            path_length_mm: steps.iter().map(|s| s.1).sum(),
            step_mm,
            turn_rad,
            rounded_rotations: frames.iter().filter(|f| f.rotation_error.is_some()).count(),
            contour_radius_mm,
            cylinders: frames.iter().filter(|f| f.cylinder.is_some()).count(),
            cylinder_radius_mm: min_median_max(
                frames.iter().filter_map(|f| Some(f.cylinder.as_ref()?.radius_mm)),
            ),
            defects: list.0,
        }
    }
}

/// Wall points that enclose an area: with fewer no cylinder can be estimated. A frame with a model may have fewer,
/// because its cylinder uses earlier frames too, so that this is only suspicious.
const MIN_POINTS: usize = 3;

/// Median contour radii that a vessel may have, mm: below lies a vessel in metres, above one in micrometres.
const LUMEN_RADII_MM: std::ops::Range<f64> = 0.2..100.0;

/// A quantity of each two consecutive frames with finite poses, with the second one's number.
fn between(frames: &[Frame], of: impl Fn(&Frame, &Frame) -> f64) -> Vec<(usize, f64)> {
    let pairs = frames.iter().zip(frames.iter().skip(1)).enumerate();
    pairs.map(|(k, (a, b))| (k + 1, of(a, b))).filter(|(_, value)| value.is_finite()).collect()
}

fn of_steps(steps: &[(usize, f64)]) -> Option<MinMedianMax> {
    min_median_max(steps.iter().map(|s| s.1))
}

fn min_median_max(numbers: impl IntoIterator<Item = f64>) -> Option<MinMedianMax> {
    let mut sorted: Vec<f64> = numbers.into_iter().filter(|x| x.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let median = *sorted.get(sorted.len() / 2)?;
    Some(MinMedianMax { min: *sorted.first()?, median, max: *sorted.last()? })
}

struct DefectList(Vec<Defects>);

impl DefectList {
    fn add(
        &mut self,
        field: &'static str,
        expected: String,
        fatal: bool,
        frame: Option<usize>,
        found: String,
    ) {
        let at =
            self.0.iter().position(|d| d.field == field && d.expected == expected).unwrap_or_else(|| {
                self.0.push(Defects { field, expected, fatal, frames: 0, examples: Vec::new() });
                self.0.len() - 1
            });
        if let Some(defects) = self.0.get_mut(at) {
            defects.frames += usize::from(frame.is_some());
            if defects.examples.len() < Summary::MAX_EXAMPLES {
                defects.examples.push(Example { frame, found });
            }
        }
    }
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
        if self.defects.is_empty() {
            return writeln!(f, "defects         none");
        }
        for defects in &self.defects {
            let kind = if defects.fatal { "DEFECT" } else { "SUSPICIOUS" };
            write!(f, "{kind}: {}", defects.field)?;
            if defects.frames > 0 {
                write!(f, " in {} of {} frames", defects.frames, self.frames)?;
            }
            writeln!(f, ", expected {}", defects.expected)?;
            for example in &defects.examples {
                match example.frame {
                    Some(k) => writeln!(f, "  frame {k}: {}", example.found)?,
                    None => writeln!(f, "  {}", example.found)?,
                }
            }
            if defects.frames > defects.examples.len() {
                writeln!(f, "  and {} more", defects.frames - defects.examples.len())?;
            }
        }
        Ok(())
    }
}
