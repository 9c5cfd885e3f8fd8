//! The vessel's centreline, from the contours' centres.
//!
//! A catheter that stops, circles and goes back makes a tangle of frames, but the centres of its contours stay near
//! the vessel's axis. The centres are grouped into clusters and the clusters connected where they touch; along the longest
//! of all shortest paths, a penalised smooth curve is fitted to the centres.

use crate::geometry::polyline::{Searched, lengths, resampled, station};
use crate::numerics::banded::Pentadiagonal;
use crate::numerics::graph::{Places, shortest_paths};
use crate::numerics::robust::median;
use crate::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// Clusters within this many cluster radii of each other touch.
const TOUCH: f64 = 1.7;
/// Centreline nodes per median lumen radius.
pub(in crate::sweep) const NODES_PER_RADIUS: f64 = 4.0;
/// Bends of the centres that are shorter than this many lumen radii are left to the wall.
const MIN_BEND_RADII: f64 = 2.0;
/// λ of the curve: with one centre per node, a bend of the shortest wavelength keeps a fifth of its amplitude.
pub(in crate::sweep) const SMOOTHNESS: f64 = {
    let wavelength = MIN_BEND_RADII * NODES_PER_RADIUS / std::f64::consts::TAU;
    let square = wavelength * wavelength;
    4.0 * (square * square)
};
/// How often the centres are projected onto the curve and the curve is fitted again.
const ROUNDS: usize = 4;
/// Largest number of the curve's nodes.
const MAX_NODES: f64 = 1e6;
/// Robust reweightings in each round.
const REWEIGHTINGS: usize = 5;

/// A smooth curve through `centres_mm`, as points at equal steps of its length to within a percent; `None` where the
/// centres cover no length. The lumen's radius `radius_mm` sets the scale.
///
/// # Errors
/// [`Error::Surface`] where the centres are so far apart for the radius that no vessel explains it.
pub(in crate::sweep) fn centreline(centres_mm: &[DVec3], radius_mm: f64) -> Result<Option<Vec<DVec3>>> {
    let mut curve = principal_path(centres_mm, radius_mm);
    if curve.len() < 2 {
        return Ok(None);
    }
    for _ in 0..ROUNDS {
        // Positions are bounded, but nothing ties them to the lumen's radius.
        let length_mm = lengths(&curve).last().copied().unwrap_or(0.0);
        let max_mm = MAX_NODES * radius_mm / NODES_PER_RADIUS;
        if !length_mm.is_finite() || length_mm > max_mm {
            return Err(Error::Surface {
                what: "centreline".into(),
                found: format!("{length_mm:.0} mm through the contours' centres"),
                expected: format!("at most {max_mm:.0} mm for a lumen of {radius_mm:.3} mm radius"),
            });
        }
        let Some(smooth) = smoothed(&resampled(&curve, radius_mm / NODES_PER_RADIUS), centres_mm, radius_mm)
        else {
            return Ok(None);
        };
        curve = smooth;
    }
    Ok(Some(curve))
}

/// The longest of the shortest paths between clusters of centres, starting at the end nearer to the first centre.
fn principal_path(centres: &[DVec3], radius: f64) -> Vec<DVec3> {
    let (clusters, of_centre) = clusters(centres, radius);
    let count = clusters.len();
    // A catheter moves without jumps: clusters of successive frames are connected however far apart they are.
    let mut places = Places::new(TOUCH * radius);
    clusters.iter().enumerate().for_each(|(k, &cluster)| places.add(k, cluster));
    let mut neighbours: Vec<Vec<usize>> = (0..count)
        .map(|a| {
            let touches = |&b: &usize| b != a && clusters[a].distance(clusters[b]) < TOUCH * radius;
            let mut touching: Vec<usize> = places.near(clusters[a]).filter(touches).collect();
            touching.sort_unstable();
            touching
        })
        .collect();
    for pair in of_centre.windows(2) {
        if pair[0] != pair[1] {
            neighbours[pair[0]].push(pair[1]);
            neighbours[pair[1]].push(pair[0]);
        }
    }
    let farthest = |distances: &[f64]| {
        (0..count).fold(0, |best, k| if distances[k] > distances[best] { k } else { best })
    };
    let one_end = farthest(&shortest_paths(&clusters, &neighbours, &[0]).0);
    let (distances, before) = shortest_paths(&clusters, &neighbours, &[one_end]);
    let mut path = vec![farthest(&distances)];
    while let Some(previous) = path.last().and_then(|&k| before[k]) {
        path.push(previous);
    }
    let start = centres[0];
    let ends = [path[0], path[path.len() - 1]].map(|k| clusters[k].distance_squared(start));
    if ends[1] < ends[0] {
        path.reverse();
    }
    path.into_iter().map(|k| clusters[k]).collect()
}

/// Centres grouped with the nearest cluster seed within `radius`: the clusters' means, and each centre's cluster.
fn clusters(centres: &[DVec3], radius: f64) -> (Vec<DVec3>, Vec<usize>) {
    let (mut seeds, mut sums): (Vec<DVec3>, Vec<(DVec3, f64)>) = Default::default();
    let mut of_centre = Vec::with_capacity(centres.len());
    let mut places = Places::new(radius);
    for &centre in centres {
        let squared = |k: usize| centre.distance_squared(seeds[k]);
        let nearest = places
            .near(centre)
            .min_by(|&a, &b| squared(a).total_cmp(&squared(b)).then(a.cmp(&b)))
            .filter(|&k| centre.distance(seeds[k]) < radius);
        let cluster = nearest.unwrap_or_else(|| {
            places.add(seeds.len(), centre);
            seeds.push(centre);
            sums.push((DVec3::ZERO, 0.0));
            seeds.len() - 1
        });
        sums[cluster].0 += centre;
        sums[cluster].1 += 1.0;
        of_centre.push(cluster);
    }
    (sums.into_iter().map(|(sum, n)| sum / n).collect(), of_centre)
}

/// The curve c that minimises `Σ wᵢ|pᵢ - c(sᵢ)|² + λ Σ|c'' |²`, sᵢ being the station of the previous curve
/// nearest to centre pᵢ.
///
/// Weights compensate for the time that the catheter spent at each place, and decrease for distant centres (Cauchy).
fn smoothed(curve: &[DVec3], centres: &[DVec3], radius: f64) -> Option<Vec<DVec3>> {
    let lengths = lengths(curve);
    let searched = Searched::of(curve);
    let stations: Vec<f64> =
        centres.par_iter().map(|&p| station(curve, &lengths, searched.nearest(p))).collect();
    let low = stations.iter().copied().fold(f64::INFINITY, f64::min);
    let high = stations.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let length = high - low;
    let nodes = (length * NODES_PER_RADIUS / radius).ceil() as usize + 1;
    if !length.is_finite() || nodes < 5 {
        return None;
    }
    let step = length / (nodes - 1) as f64;
    let places: Vec<(usize, f64)> = stations
        .iter()
        .map(|s| {
            let u = (s - low) / step;
            let node = (u as usize).min(nodes - 2);
            (node, u - node as f64)
        })
        .collect();
    let nearest = |&(node, share): &(usize, f64)| node + usize::from(share >= 0.5);
    let mut here = vec![0.0; nodes];
    places.iter().for_each(|place| here[nearest(place)] += 1.0);

    let mut weights = vec![1.0; centres.len()];
    let mut nodes_mm = Vec::new();
    for _ in 0..REWEIGHTINGS {
        let mut equations = Pentadiagonal::second_differences(nodes, SMOOTHNESS);
        let mut right = vec![DVec3::ZERO; nodes];
        for ((place, &centre), weight) in places.iter().zip(centres).zip(&weights) {
            let (node, share) = *place;
            let w = weight / here[nearest(place)];
            equations.add_pair(node, w, [1.0 - share, share]);
            right[node] += centre * (w * (1.0 - share));
            right[node + 1] += centre * (w * share);
        }
        nodes_mm = equations.factored()?.solve(right);
        let distances: Vec<f64> = places
            .iter()
            .zip(centres)
            .map(|(&(node, share), p)| p.distance(nodes_mm[node].lerp(nodes_mm[node + 1], share)))
            .collect();
        let scale = 1.5 * median(&mut distances.clone()) + 1e-9 * radius;
        weights = distances.iter().map(|distance| (distance / scale).max(1.0).powi(-2)).collect();
    }
    Some(nodes_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tangle_of_centres_is_drawn_as_one_curve() {
        // Half a circle of radius 40, walked forth, half way back and forth again, with a rest and with scatter.
        let angle = |step: usize| match step {
            0..200 => step as f64 / 200.0 * 2.0,
            200..300 => 2.0,
            300..400 => 2.0 - (step - 300) as f64 / 100.0,
            _ => 1.0 + (step - 400) as f64 / 100.0,
        };
        let centres: Vec<DVec3> = (0..600)
            .map(|step| {
                let scatter = DVec3::new((step as f64 * 1.7).sin(), (step as f64 * 2.3).sin(), 0.0) * 0.5;
                DVec3::new(angle(step).cos(), angle(step).sin(), 0.0) * 40.0 + scatter
            })
            .collect();
        let curve = centreline(&centres, 8.0).unwrap().unwrap();
        let lengths = lengths(&curve);
        let total = lengths[lengths.len() - 1];
        assert!((total - 120.0).abs() < 2.0, "{total}");
        assert!(curve.iter().all(|p| (p.length() - 40.0).abs() < 0.5));
        assert!(curve[0].distance(centres[0]) < 1.0, "it starts where the catheter did");
        let step = total / (curve.len() - 1) as f64;
        assert!(lengths.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() < 0.02 * step));
    }

    #[test]
    fn centres_without_length_have_no_curve() {
        assert!(centreline(&[DVec3::X], 8.0).unwrap().is_none());
        assert!(centreline(&[DVec3::X; 20], 8.0).unwrap().is_none());
        assert!(centreline(&[DVec3::X, DVec3::X * 3.0], 8.0).unwrap().is_none());
    }
}
