use super::numbers;
use crate::recording::{Conventions, LengthUnit, QuaternionOrder, TimeUnit};

/// The conventions of the program that wrote the recording, where they are not this one's. `lumenmesh info` names those
/// that fit better.
#[derive(clap::Args, Default)]
#[command(next_help_heading = "Conventions of the recording")]
pub(super) struct ConventionArguments {
    /// Order of the quaternions' components [default: xyzw]
    #[arg(long, value_enum, value_name = "ORDER")]
    quaternion: Option<QuaternionOrder>,
    /// Poses are the world in the sensor's frame, instead of the sensor in the world
    #[arg(long)]
    inverse: bool,
    /// Unit of the sensor's positions [default: mm]
    #[arg(long, value_enum, value_name = "UNIT")]
    units: Option<LengthUnit>,
    /// Unit of the contours [default: mm]
    #[arg(long, value_enum, value_name = "UNIT")]
    contour_units: Option<LengthUnit>,
    /// Where the probe lies in the contours' coordinates, mm [default: 0,0]
    #[arg(long, value_name = "X,Y", value_parser = numbers::<2>, allow_hyphen_values = true)]
    contour_centre: Option<[f64; 2]>,
    /// The contours' y runs down, as in images
    #[arg(long)]
    flip_y: bool,
    /// Unit of the times [default: s]
    #[arg(long, value_enum, value_name = "UNIT")]
    time_unit: Option<TimeUnit>,
}

impl ConventionArguments {
    /// These on top of others.
    pub(super) fn over(&self, mut conventions: Conventions) -> Conventions {
        conventions.quaternion = self.quaternion.unwrap_or(conventions.quaternion);
        conventions.inverse |= self.inverse;
        conventions.units = self.units.unwrap_or(conventions.units);
        conventions.contour_units = self.contour_units.unwrap_or(conventions.contour_units);
        conventions.contour_centre_mm = self.contour_centre.unwrap_or(conventions.contour_centre_mm);
        conventions.flip_y |= self.flip_y;
        conventions.time_unit = self.time_unit.unwrap_or(conventions.time_unit);
        conventions
    }
}
