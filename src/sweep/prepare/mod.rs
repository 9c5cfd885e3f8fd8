//! From contours and poses to the axis, the grid and the echoes of a vessel.

pub(in crate::sweep) mod axis;
pub(in crate::sweep) mod centreline;
pub(in crate::sweep) mod contour;
pub(in crate::sweep) mod echo;
pub(in crate::sweep) mod grid;
pub(in crate::sweep) mod noise;
pub(in crate::sweep) mod resolution;

use crate::geometry::Pose;
use crate::geometry::polyline::lengths;
use crate::numerics::robust::median;
use crate::recording::{Frame, Recording};
use crate::settings::Settings;
use crate::{Error, Result};
use axis::Axis;
use centreline::centreline;
use contour::{Outline, Outlines, echo_count, folded_frames};
use echo::{Echo, age, placed};
use glam::{DVec2, DVec3};
use grid::WallGrid;
use noise::tangential_noise_mm;
use resolution::resolution;

/// The axis extends beyond the centreline by this many contour radii at both ends: echoes of tilted frames lie there.
pub(crate) const BEYOND_RADII: f64 = 1.5;

/// A recording with the axis and the grid of its vessel: the input to the fit of the wall.
pub(in crate::sweep) struct Prepared<'a> {
    pub frames: &'a [Frame],
    /// The contours, frame by frame; empty for a frame that is left out.
    contours_mm: Vec<&'a [DVec2]>,
    /// Frames that are left out, since their contours are not star-shaped about their centres.
    pub folded_frames: Vec<usize>,
    /// Median radius of the contours, mm.
    pub contour_radius_mm: f64,
    pub axis: Axis,
    pub grid: WallGrid,
    sensor_from_probe: Pose,
    half_life_s: Option<f64>,
}

/// The course of a vessel.
struct Course {
    /// Outlines of the contours, without those that are left out.
    outlines: Vec<Option<Outline>>,
    folded_frames: Vec<usize>,
    contour_radius_mm: f64,
    /// The centreline, mm.
    curve: Vec<DVec3>,
}

impl Course {
    fn of(frames: &[Frame], outlines: Outlines, sensor_from_probe: &Pose) -> Result<Self> {
        let mut outlines = outlines.of_frames;
        let folded_frames = folded_frames(&outlines)?;
        folded_frames.iter().for_each(|&k| outlines[k] = None);
        let contour_radius_mm =
            median(&mut outlines.iter().flatten().map(|o| o.radius_mm).collect::<Vec<_>>());
        let centres_mm: Vec<DVec3> = outlines
            .iter()
            .zip(frames)
            .filter_map(|(outline, frame)| {
                let pose = frame.world_from_sensor * *sensor_from_probe;
                Some(pose.transform_point(outline.as_ref()?.centre_mm.extend(0.0)))
            })
            .collect();
        let curve = match contour_radius_mm > 0.0 {
            true => centreline(&centres_mm, contour_radius_mm)?,
            false => None,
        };
        let Some(curve) = curve else {
            return Err(Error::Recording {
                field: "centreline",
                found: format!("contours in {} frames that cover no length", centres_mm.len()),
                expected: "contours along at least a lumen's radius of the vessel".into(),
            });
        };
        Ok(Self { outlines, folded_frames, contour_radius_mm, curve })
    }
}

impl Axis {
    /// The axis of the vessel that some contours lie along, as a sweep has it; of the median radius of the contours, `rings`
    /// makes the distance of its rings and the length by which it goes on beyond the outermost contours, mm.
    ///
    /// # Errors
    /// Where most contours are not star-shaped, or they cover no length of a vessel.
    pub(crate) fn through(
        frames: &[Frame],
        sensor_from_probe: &Pose,
        rings: impl FnOnce(f64) -> [f64; 2],
    ) -> Result<Self> {
        let Course { contour_radius_mm, curve, .. } =
            Course::of(frames, Outlines::of(frames), sensor_from_probe)?;
        let [step_mm, beyond_mm] = rings(contour_radius_mm);
        Ok(Self::along(&curve, step_mm, beyond_mm))
    }
}

impl<'a> Prepared<'a> {
    /// Finds the axis of a recording that passes [`Recording::check`] and whose contours have these outlines.
    ///
    /// # Errors
    /// Where most contours are not star-shaped, they cover no length of a vessel, or the settings ask for too many nodes.
    pub(in crate::sweep) fn of(
        recording: &'a Recording,
        outlines: Outlines,
        settings: &Settings,
    ) -> Result<Self> {
        let frames = &recording.frames;
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let Course { outlines, folded_frames, contour_radius_mm, curve } =
            Course::of(frames, outlines, &sensor_from_probe)?;
        let mut contours_mm: Vec<&[DVec2]> = frames.iter().map(|frame| &frame.contour_mm[..]).collect();
        folded_frames.iter().for_each(|&k| contours_mm[k] = &[]);
        let length_mm = lengths(&curve).last().copied().unwrap_or(0.0);
        let noise_mm = median(&mut outlines.iter().flatten().map(|o| o.noise_mm).collect::<Vec<_>>());
        let (nodes, step_mm) = resolution(&contours_mm, length_mm, contour_radius_mm, noise_mm, settings)?;
        let axis = Axis::along(&curve, step_mm, BEYOND_RADII * contour_radius_mm);
        let grid = WallGrid::new(axis.rings(), nodes, axis.step_mm, contour_radius_mm);
        let half_life_s = settings.sweep.half_life_s;
        Ok(Self {
            frames,
            contours_mm,
            folded_frames,
            contour_radius_mm,
            axis,
            grid,
            sensor_from_probe,
            half_life_s,
        })
    }

    /// The same axis and grid with other contours of the same frames; those that are left out stay so.
    pub(in crate::sweep) fn with_contours<'b>(&self, frames: &'b [Frame]) -> Prepared<'b> {
        let kept = |(frame, contour_mm): (&'b Frame, &&[DVec2])| -> &'b [DVec2] {
            if contour_mm.is_empty() { &[] } else { &frame.contour_mm }
        };
        Prepared {
            frames,
            contours_mm: frames.iter().zip(&self.contours_mm).map(kept).collect(),
            folded_frames: self.folded_frames.clone(),
            axis: self.axis.clone(),
            ..*self
        }
    }

    /// The recorded poses of the sensor.
    pub(in crate::sweep) fn sensors(&self) -> Vec<Pose> {
        self.frames.iter().map(|frame| frame.world_from_sensor).collect()
    }

    /// The echoes about the axis, sorted along it, for poses of the sensor; those beyond the axis's ends are left out.
    pub(in crate::sweep) fn echoes(&self, sensors: &[Pose]) -> Vec<Echo> {
        let poses: Vec<Pose> = sensors.iter().map(|&sensor| sensor * self.sensor_from_probe).collect();
        let mut echoes = placed(self.frames, &self.contours_mm, &poses, &self.axis, self.grid.nodes);
        if let Some(half_life_s) = self.half_life_s {
            age(&mut echoes, self.frames, half_life_s);
        }
        echoes
    }

    /// Wall points of the frames that are not left out.
    pub(in crate::sweep) fn echo_count(&self) -> usize {
        echo_count(&self.contours_mm)
    }

    /// Standard deviation of the contours' noise along the wall, mm.
    pub(in crate::sweep) fn tangential_noise_mm(&self) -> f64 {
        tangential_noise_mm(&self.contours_mm)
    }
}
