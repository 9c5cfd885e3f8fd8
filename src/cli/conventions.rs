use super::numbers;
use crate::Result;
use crate::recording::{Columns, Conventions, LengthUnit, QuaternionOrder, Recording, TimeUnit};
use std::path::Path;

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
    /// Names of the columns of poses.csv, where it has no line of them
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pose_columns: Option<Vec<String>>,
    /// Names of the columns of contours.csv, where it has no line of them
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    contour_columns: Option<Vec<String>>,
}

impl ConventionArguments {
    /// Reads a recording, unchecked.
    pub(super) fn read(&self, path: &Path) -> Result<Recording> {
        Recording::read_with_columns(path, &self.columns())
    }

    /// The columns of CSV files without a line of names.
    pub(super) fn columns(&self) -> Columns {
        Columns::default().with_poses(self.pose_columns.clone()).with_contours(self.contour_columns.clone())
    }

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
