//! Conventions of other programs, and the way from them to this project's.

use super::{Frame, Recording};
use crate::geometry::Pose;
use crate::setters::setters;
use glam::{DMat3, DQuat, DVec2};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// How the program that wrote a recording gives poses, contours and times, where that is not how this project does:
/// `wTe` with unit quaternions (x, y, z, w), positions and contours in mm about the probe, times in s.
///
/// Nothing is converted unless it is asked for. [`Screening`](super::Screening) names a convention that fits a recording
/// better.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Conventions {
    /// Order of the components of quaternions.
    pub quaternion: QuaternionOrder,
    /// Whether poses are given the other way round, `eTw`: the world in the sensor's frame.
    pub inverse: bool,
    /// Unit of the sensor's positions.
    pub units: LengthUnit,
    /// Unit of the contours.
    pub contour_units: LengthUnit,
    /// Where the probe lies in the contours' coordinates, mm: (0, 0), unless they are given from an image's corner.
    pub contour_centre_mm: [f64; 2],
    /// Whether y runs down in contours, as in images, where the probe's runs up.
    pub flip_y: bool,
    /// Unit of times.
    pub time_unit: TimeUnit,
}

setters!(Conventions {
    with_quaternion => quaternion: QuaternionOrder,
    with_inverse => inverse: bool,
    with_units => units: LengthUnit,
    with_contour_units => contour_units: LengthUnit,
    with_contour_centre_mm => contour_centre_mm: [f64; 2],
    with_flip_y => flip_y: bool,
    with_time_unit => time_unit: TimeUnit,
});

/// Order of a quaternion's components.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum QuaternionOrder {
    /// x, y, z, w.
    #[default]
    Xyzw,
    /// w, x, y, z.
    Wxyz,
}

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum LengthUnit {
    /// Micrometres.
    Um,
    /// Millimetres.
    #[default]
    Mm,
    /// Centimetres.
    Cm,
    /// Metres.
    M,
}

impl LengthUnit {
    /// In mm.
    pub fn mm(self) -> f64 {
        match self {
            LengthUnit::Um => 1e-3,
            LengthUnit::Mm => 1.0,
            LengthUnit::Cm => 10.0,
            LengthUnit::M => 1e3,
        }
    }
}

/// A unit of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum TimeUnit {
    /// Nanoseconds.
    Ns,
    /// Microseconds.
    Us,
    /// Milliseconds.
    Ms,
    /// Seconds.
    #[default]
    S,
}

impl TimeUnit {
    /// In s.
    pub fn s(self) -> f64 {
        match self {
            TimeUnit::Ns => 1e-9,
            TimeUnit::Us => 1e-6,
            TimeUnit::Ms => 1e-3,
            TimeUnit::S => 1.0,
        }
    }
}

impl Conventions {
    /// The recording in this project's conventions. Cylinder models are dropped where poses or contours change.
    pub fn apply<'a>(&self, recording: &'a Recording) -> Cow<'a, Recording> {
        if *self == Self::default() {
            return Cow::Borrowed(recording);
        }
        Cow::Owned(Recording { frames: recording.frames.iter().map(|frame| self.apply_to(frame)).collect() })
    }

    /// As [`apply`](Self::apply), of one frame.
    pub fn apply_to(&self, frame: &Frame) -> Frame {
        let mut frame = frame.clone();
        frame.time_s = frame.time_s.map(|t| t * self.time_unit.s());
        if *self == Self::default().with_time_unit(self.time_unit) {
            return frame;
        }
        frame.cylinder = None;
        frame.world_from_sensor = self.pose(&frame.world_from_sensor);
        let (scale, centre) = (self.contour_units.mm(), DVec2::from_array(self.contour_centre_mm));
        for p in &mut frame.contour_mm {
            *p = *p * scale - centre;
            if self.flip_y {
                p.y = -p.y;
            }
        }
        frame
    }

    fn pose(&self, given: &Pose) -> Pose {
        let mut pose = *given;
        if self.quaternion == QuaternionOrder::Wxyz {
            let q = DQuat::from_mat3(&pose.rotation);
            pose.rotation = DMat3::from_quat(DQuat::from_xyzw(q.y, q.z, q.w, q.x));
        }
        pose.translation_mm *= self.units.mm();
        if self.inverse { pose.inverse() } else { pose }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn every_convention_is_undone() {
        let pose = Pose::from_quaternion(
            DVec3::new(10.0, -20.0, 300.0),
            DQuat::from_xyzw(0.1, -0.2, 0.3, 0.4).normalize(),
        );
        let contour = vec![DVec2::new(1.0, 2.0), DVec2::NAN];
        let frame = Frame::new(pose, contour.clone()).with_time_s(Some(1.5));
        // As a program with the other conventions writes it.
        let q = pose.quaternion();
        let given = Frame::new(
            Pose::from_quaternion(pose.translation_mm / 1e3, DQuat::from_xyzw(q.w, q.x, q.y, q.z)).inverse(),
            contour.iter().map(|p| DVec2::new(p.x + 5.0, 6.0 - p.y) / 10.0).collect(),
        )
        .with_time_s(Some(1500.0));
        // The inverse was taken after the quaternion was misread: undone in the other order.
        let turned = Conventions::default().with_inverse(true).apply_to(&given);
        let conventions = Conventions::default()
            .with_quaternion(QuaternionOrder::Wxyz)
            .with_units(LengthUnit::M)
            .with_contour_units(LengthUnit::Cm)
            .with_contour_centre_mm([5.0, 6.0])
            .with_flip_y(true)
            .with_time_unit(TimeUnit::Ms);
        let back = conventions.apply_to(&turned);
        assert!(back.world_from_sensor.translation_mm.abs_diff_eq(pose.translation_mm, 1e-9));
        assert!(back.world_from_sensor.rotation.abs_diff_eq(pose.rotation, 1e-12));
        assert!(back.contour_mm[0].abs_diff_eq(contour[0], 1e-12) && back.contour_mm[1].is_nan());
        assert_eq!(back.time_s, Some(1.5));
        assert_eq!(Conventions::default().apply_to(&frame).world_from_sensor, pose);
    }
}
