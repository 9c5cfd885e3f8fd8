use super::numbers;
use crate::Result;
use crate::recording::{
    Conventions, LengthUnit, QuaternionOrder, ReadOptions, Recording, TimeUnit, Timestamps,
};
use std::path::{Path, PathBuf};

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
    /// Of a sequence file: the pose, by the name of a transform or of a chain of them and their inverses
    /// [default: the only one, or ProbeToTracker]. Of an MCAP file: ChildToParent
    #[arg(long, value_name = "NAME")]
    transform: Option<String>,
    /// Of an MCAP file: the topic of the poses [default: the only one]
    #[cfg(feature = "mcap")]
    #[arg(long, value_name = "NAME")]
    topic: Option<String>,
    /// Of an MCAP file: the topic of the contours [default: the only one]
    #[cfg(feature = "mcap")]
    #[arg(long, value_name = "NAME")]
    contour_topic: Option<String>,
    /// Of a sequence file: which times count [default: filtered]
    #[arg(long, value_enum, value_name = "KIND")]
    timestamps: Option<Timestamps>,
    /// Of a sequence file without contours: a CSV file of them, with columns frame, x_mm, y_mm
    #[arg(long, value_name = "CSV")]
    contours: Option<PathBuf>,
    /// Of a sequence file: a PLUS configuration with more transforms
    #[arg(long, value_name = "XML")]
    plus_config: Option<PathBuf>,
}

impl ConventionArguments {
    /// Reads a recording, unchecked.
    pub(super) fn read(&self, path: &Path) -> Result<Recording> {
        Recording::read_with(path, &self.reading())
    }

    /// What the recording's file leaves open.
    pub(super) fn reading(&self) -> ReadOptions {
        let options = ReadOptions::default();
        #[cfg(feature = "mcap")]
        let options = options.with_topic(self.topic.clone()).with_contour_topic(self.contour_topic.clone());
        options
            .with_pose_columns(self.pose_columns.clone())
            .with_contour_columns(self.contour_columns.clone())
            .with_transform(self.transform.clone())
            .with_timestamps(self.timestamps.unwrap_or_default())
            .with_contours(self.contours.clone())
            .with_plus_config(self.plus_config.clone())
    }

    /// The files that are read beside the recording.
    pub(super) fn inputs(&self) -> [Option<&Path>; 2] {
        [self.contours.as_deref(), self.plus_config.as_deref()]
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
