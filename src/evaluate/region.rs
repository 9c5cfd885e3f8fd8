//! Errors by position along a vessel.

use super::Distances;
use crate::{Error, Result};
use glam::DVec3;
use serde::Serialize;

/// The errors of one stretch of a vessel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Region {
    /// Its start along the centreline, mm.
    pub from_mm: f64,
    /// Its end, mm.
    pub to_mm: f64,
    /// The distances of the mesh's nodes there to the truth; none without nodes.
    pub mesh_to_truth: Option<Distances>,
    /// Their signed mean, mm; positive outside the truth.
    pub signed_mean_mm: f64,
}

impl Region {
    /// Splits the nodes of a mesh into stretches of `length_mm` along a centreline and takes the statistics of each.
    ///
    /// `centreline` holds points of it, such as one per mm, each with its length from the start, mm, in rising order. A
    /// node belongs to the stretch of the nearest point.
    ///
    /// # Errors
    /// [`Error::Setting`] for a length below 1 mm.
    pub fn along(
        centreline: &[(f64, DVec3)],
        length_mm: f64,
        nodes_mm: &[DVec3],
        signed_error_mm: &[f64],
    ) -> Result<Vec<Self>> {
        if !(length_mm.is_finite() && length_mm >= 1.0) {
            return Err(Error::Setting {
                name: "region".into(),
                found: length_mm.to_string(),
                expected: "1 mm or more".into(),
            });
        }
        let whole = centreline.last().map_or(0.0, |(s, _)| *s);
        let count = (whole / length_mm).ceil().max(1.0) as usize;
        let mut errors: Vec<Vec<f64>> = vec![Vec::new(); count];
        for (node, error) in nodes_mm.iter().zip(signed_error_mm) {
            let nearest = centreline
                .iter()
                .min_by(|a, b| a.1.distance_squared(*node).total_cmp(&b.1.distance_squared(*node)));
            let s = nearest.map_or(0.0, |station| station.0);
            errors[((s / length_mm) as usize).min(count - 1)].push(*error);
        }
        let region = |(i, errors): (usize, Vec<f64>)| {
            let unsigned: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
            Region {
                from_mm: i as f64 * length_mm,
                to_mm: ((i + 1) as f64 * length_mm).min(whole),
                mesh_to_truth: Distances::of(&unsigned, &vec![1.0; unsigned.len()]),
                signed_mean_mm: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
            }
        };
        Ok(errors.into_iter().enumerate().map(region).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_count_where_they_are() {
        let line: Vec<(f64, DVec3)> = (0..=90).map(f64::from).map(|s| (s, DVec3::Z * s)).collect();
        let nodes = [-3.0, 5.0, 39.0, 41.0, 95.0].map(|z| DVec3::new(5.0, 0.0, z));
        let regions = Region::along(&line, 40.0, &nodes, &[1.0, -3.0, 2.0, -5.0, 7.0]).unwrap();
        let seen: Vec<_> = regions
            .iter()
            .map(|r| (r.from_mm, r.to_mm, r.mesh_to_truth.map(|d| (d.nodes, d.mean_mm)), r.signed_mean_mm))
            .collect();
        assert_eq!(
            seen,
            [
                (0.0, 40.0, Some((3, 2.0)), 0.0),
                (40.0, 80.0, Some((1, 5.0)), -5.0),
                (80.0, 90.0, Some((1, 7.0)), 7.0)
            ]
        );
        assert!(Region::along(&line, 0.0, &nodes, &[0.0; 5]).is_err());
    }
}
