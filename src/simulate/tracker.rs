//! Noise of a real tracker.

use super::noise::Noise;
use crate::{Error, Result};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::Path;

/// The noise of a tracker, measured on a sensor that lay still.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TrackerNoise {
    /// The sensor's name in the file.
    pub sensor: String,
    /// Valid poses.
    pub poses: usize,
    /// Standard deviation of the position about its mean, mm: root mean square of the three axes.
    pub position_sd_mm: f64,
    /// Standard deviation of the orientation about its mean, degrees: root mean square of the three components
    /// of the rotation vector.
    pub rotation_sd_deg: f64,
}

#[derive(Deserialize)]
struct Row {
    sensor: String,
    #[serde(default = "valid")]
    ok: u8,
    x_mm: f64,
    y_mm: f64,
    z_mm: f64,
    qx: f64,
    qy: f64,
    qz: f64,
    qw: f64,
}

fn valid() -> u8 {
    1
}

/// A sensor that lies still stays within a box of this size, mm: the noise of trackers in use is smaller.
const STILL_MM: f64 = 5.0;

impl TrackerNoise {
    /// Measures the noise in a CSV file of poses with the columns `sensor`, `x_mm`, `y_mm`, `z_mm`, `qx`, `qy`,
    /// `qz`, `qw` and optionally `ok` (0: no valid pose).
    ///
    /// `sensor` may be left out where the file has one sensor, or one that lies still.
    ///
    /// # Errors
    /// [`Error::Read`], and [`Error::Input`] for rows that cannot be read, a sensor that is not there, has fewer
    /// than three valid poses or moves by more than 5 mm, and for several sensors to choose from.
    pub fn read(path: &Path, sensor: Option<&str>) -> Result<Self> {
        let file = std::fs::File::open(path).map_err(|source| Error::Read { path: path.into(), source })?;
        let mut rows = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .from_reader(file)
            .into_deserialize()
            .collect::<Result<Vec<Row>, csv::Error>>()
            .map_err(|e| Error::input(path, "rows", e, "columns sensor, x_mm, y_mm, z_mm, qx, qy, qz, qw"))?;
        rows.retain(|row| row.ok != 0);
        let names: BTreeSet<&str> = rows.iter().map(|row| row.sensor.as_str()).collect();
        let list = names.iter().copied().collect::<Vec<_>>().join(", ");
        let measured = |name: &str| Self::measure(path, name, &rows);
        if let Some(name) = sensor {
            return match names.contains(name) {
                true => measured(name),
                false => Err(Error::input(path, "sensor", format!("no {name:?}"), format!("one of {list}"))),
            };
        }
        if let [only] = Vec::from_iter(&names)[..] {
            return measured(only);
        }
        let still: Vec<Self> = names.iter().filter_map(|name| measured(name).ok()).collect();
        let found = match still.len() {
            0 => "none that lies still".to_owned(),
            n => format!("{n} that lie still"),
        };
        match <[Self; 1]>::try_from(still) {
            Ok([noise]) => Ok(noise),
            Err(_) => Err(Error::input(path, "sensor", found, format!("a choice of one of {list}"))),
        }
    }

    fn measure(path: &Path, name: &str, rows: &[Row]) -> Result<Self> {
        let rows: Vec<&Row> = rows.iter().filter(|row| row.sensor == name).collect();
        let wrong =
            |found: String, expected: &str| Error::input(path, format!("sensor {name}"), found, expected);
        if rows.len() < 3 {
            return Err(wrong(format!("{} valid poses", rows.len()), "at least 3"));
        }
        let positions: Vec<DVec3> = rows.iter().map(|r| DVec3::new(r.x_mm, r.y_mm, r.z_mm)).collect();
        let quaternions: Vec<DQuat> = rows.iter().map(|r| DQuat::from_xyzw(r.qx, r.qy, r.qz, r.qw)).collect();
        let sound = |q: &DQuat| (q.length() - 1.0).abs() < 1e-2;
        if !positions.iter().all(|p| p.is_finite()) || !quaternions.iter().all(sound) {
            return Err(wrong("a pose that is none".into(), "finite positions and unit quaternions"));
        }
        let low = positions.iter().copied().reduce(DVec3::min).unwrap_or_default();
        let high = positions.iter().copied().reduce(DVec3::max).unwrap_or_default();
        let travel = (high - low).max_element();
        if travel > STILL_MM {
            return Err(wrong(
                format!("positions {travel:.1} mm apart"),
                "a sensor that lies still (within 5 mm)",
            ));
        }
        let mean_position = mean(&positions);
        // q and -q are the same rotation: all are brought to the side of the first before they are averaged.
        let mean_rotation = quaternions
            .iter()
            .map(|&q| if q.dot(quaternions[0]) < 0.0 { -q } else { q })
            .fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, q| sum + q)
            .normalize();
        let shifts = positions.iter().map(|&p| p - mean_position);
        let turns = quaternions.iter().map(|&q| {
            let turn = mean_rotation.inverse() * q.normalize();
            (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis()
        });
        Ok(Self {
            sensor: name.into(),
            poses: rows.len(),
            position_sd_mm: pooled_sd(shifts),
            rotation_sd_deg: pooled_sd(turns).to_degrees(),
        })
    }

    /// Puts the measured levels into a simulation's noise.
    pub fn apply(&self, noise: &mut Noise) {
        noise.position_sd_mm = self.position_sd_mm;
        noise.rotation_sd_deg = self.rotation_sd_deg;
    }
}

fn mean(vectors: &[DVec3]) -> DVec3 {
    vectors.iter().sum::<DVec3>() / vectors.len() as f64
}

/// Root mean square over three axes of the standard deviation in each, for deviations from the mean.
fn pooled_sd(deviations: impl ExactSizeIterator<Item = DVec3>) -> f64 {
    let n = deviations.len() as f64;
    (deviations.map(DVec3::length_squared).sum::<f64>() / (3.0 * (n - 1.0))).sqrt()
}
