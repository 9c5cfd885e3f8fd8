//! The growing curve of the axis.

use crate::geometry::polyline::{nearest, resampled};
use crate::numerics::banded::Pentadiagonal;
use crate::sweep::prepare::centreline::{NODES_PER_RADIUS, SMOOTHNESS, centreline};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The curve extends straight beyond the centres by this many nodes: echoes of tilted frames lie there.
const BEYOND: usize = 6;
/// Nodes farther than this from both ends of the centres are fixed.
const SETTLED: usize = 4;
/// Centres farther than this from the curve, in lumen radii, show that its end took a wrong course; at most
/// [`MAX_RELEASED`] of its settled nodes are then fitted again.
const WRONG_COURSE_RADII: f64 = 0.5;
const MAX_RELEASED: usize = 8;
/// Centres farther than this from the curve, in lumen radii, are outliers: not of this vessel, or not yet.
const OUTLIER_RADII: f64 = 2.0;
/// Smaller changes of the curve, in lumen radii, are not applied.
const TOLERANCE_RADII: f64 = 0.05;
/// Nodes that move by less, in lumen radii, keep their place while others move, so that fewer echoes must be placed again.
const STILL_RADII: f64 = 0.002;
/// This many successive outliers show that the vessel continues there.
const MAX_OUTLIERS: usize = 12;
/// Settled nodes that guide the new course of an end.
const GUIDES: usize = 16;
/// Stiffness of fixed nodes, in units of the curve's.
const FIXED_STIFFNESS: f64 = 1e6;

/// A smooth curve through the centres of contours, with a node every R/4, that grows at both ends; nodes behind them are
/// fixed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Curve {
    radius_mm: f64,
    pub nodes_mm: Vec<DVec3>,
    /// Clusters of the centres about the ends, each within a spacing of its mean: their sums and numbers.
    clusters: Vec<(DVec3, f64)>,
    /// Nodes that are fixed.
    settled: Option<Range<usize>>,
    /// The last successive outliers.
    outliers_mm: Vec<DVec3>,
}

/// The change of the curve by a centre.
#[derive(Debug, PartialEq)]
pub(super) enum Growth {
    /// It lies too far away.
    Outlier,
    /// No node moved.
    None,
    /// `before` nodes were added in front; after that, the nodes `moved` have moved or are new.
    Moved { before: usize, moved: Range<usize> },
}

impl Curve {
    /// A curve along points that centres follow for at least the lumen's radius.
    pub fn along(points_mm: &[DVec3], centres_mm: &[DVec3], radius_mm: f64) -> Self {
        let nodes_mm = resampled(points_mm, radius_mm / NODES_PER_RADIUS);
        let mut curve =
            Self { radius_mm, nodes_mm, clusters: Vec::new(), settled: None, outliers_mm: Vec::new() };
        curve.extend_front(BEYOND);
        curve.extend_back(BEYOND);
        centres_mm.iter().for_each(|&centre| curve.gather(centre));
        curve.nodes_mm = curve.fitted(0..curve.nodes_mm.len());
        curve.settle();
        curve
    }

    /// Whether it can go on after it was read from a file.
    pub fn is_sound(&self) -> bool {
        let all = self.nodes_mm.len();
        let within = |settled: &Range<usize>| settled.start + 2 <= settled.end && settled.end + BEYOND <= all;
        0.0 < self.radius_mm
            && self.radius_mm.is_finite()
            && all > 2 * BEYOND + 2
            && self.settled.as_ref().is_none_or(within)
            && self.outliers_mm.len() < MAX_OUTLIERS
            && self.nodes_mm.iter().all(|node| node.is_finite())
    }

    /// Adds a centre to its cluster.
    fn gather(&mut self, centre_mm: DVec3) {
        let distance = |(sum, count): &(DVec3, f64)| centre_mm.distance(*sum / *count);
        let nearest = self.clusters.iter_mut().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        match nearest.filter(|cluster| distance(cluster) < self.radius_mm / NODES_PER_RADIUS) {
            Some(cluster) => *cluster = (cluster.0 + centre_mm, cluster.1 + 1.0),
            None => self.clusters.push((centre_mm, 1.0)),
        }
    }

    /// Distance of two nodes, mm.
    pub fn spacing_mm(&self) -> f64 {
        self.radius_mm / NODES_PER_RADIUS
    }

    /// How far it extends beyond the outermost centres, mm.
    pub fn beyond_mm(&self) -> f64 {
        BEYOND as f64 * self.spacing_mm()
    }

    /// Length between the first node and the last, mm.
    pub fn length_mm(&self) -> f64 {
        (self.nodes_mm.len() - 1) as f64 * self.spacing_mm()
    }

    /// Adds a centre, and fits the curve's ends again where that moves them.
    pub fn push(&mut self, centre_mm: DVec3) -> Growth {
        let all = 0..self.nodes_mm.len();
        let place = self.station(centre_mm);
        let on_curve = (0.0..=(all.end - 1) as f64).contains(&place);
        if !on_curve || self.at_line(place).distance(centre_mm) > OUTLIER_RADII * self.radius_mm {
            self.outliers_mm.push(centre_mm);
            return if self.outliers_mm.len() < MAX_OUTLIERS { Growth::Outlier } else { self.rejoin() };
        }
        self.outliers_mm.clear();
        let mut node = place.round() as usize;
        let is_wrong = self.nodes_mm[node].distance(centre_mm) > WRONG_COURSE_RADII * self.radius_mm;
        if let Some(settled) = self.settled.as_mut().filter(|_| is_wrong) {
            // The end is released.
            if node >= settled.end.saturating_sub(MAX_RELEASED) {
                settled.end = settled.end.min(node.saturating_sub(SETTLED)).max(settled.start + 2);
            } else if node < settled.start + MAX_RELEASED {
                settled.start = settled.start.max(node + SETTLED).min(settled.end - 2);
            }
        }
        if self.settled.as_ref().is_some_and(|settled| settled.contains(&node)) {
            return Growth::None;
        }
        self.gather(centre_mm);
        let at_front = self.settled.as_ref().is_some_and(|settled| node < settled.start);
        let old = self.nodes_mm.clone();
        let more = BEYOND.saturating_sub(node);
        self.extend_front(more);
        node += more;
        self.extend_back((node + BEYOND + 1).saturating_sub(self.nodes_mm.len()));

        let free = match &self.settled {
            None => 0..self.nodes_mm.len(),
            Some(settled) if at_front => 0..settled.start,
            Some(settled) => settled.end..self.nodes_mm.len(),
        };
        let mut free = free;
        let fitted = self.fitted(free.clone());
        self.nodes_mm[free.clone()].copy_from_slice(&fitted);
        if self.settled.is_some() {
            let still = |k: usize| {
                let was_mm = k.checked_sub(more).and_then(|k| old.get(k));
                was_mm.is_some_and(|was| was.distance(self.nodes_mm[k]) <= STILL_RADII * self.radius_mm)
            };
            let kept = if at_front {
                let end = free.clone().rev().find(|&k| !still(k)).map_or(free.start, |k| k + 1);
                free.end = end;
                end..self.settled.as_ref().map_or(end, |settled| settled.start)
            } else {
                let start = free.clone().find(|&k| !still(k)).unwrap_or(free.end);
                let kept = free.start..start;
                free.start = start;
                kept
            };
            for k in kept {
                self.nodes_mm[k] = old[k - more];
            }
        }
        if free.is_empty() {
            return Growth::None;
        }
        if self.nodes_mm.len() == old.len() {
            let travel = old.iter().zip(&self.nodes_mm).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            if travel <= TOLERANCE_RADII * self.radius_mm {
                self.nodes_mm = old;
                return Growth::None;
            }
        }
        self.settle();
        Growth::Moved { before: more, moved: free }
    }

    /// Connects the end that the catheter left with its centres since then, as the sweep of a whole recording would. The
    /// vessel's middle stays: outliers there belong to another branch.
    fn rejoin(&mut self) -> Growth {
        let outliers_mm = std::mem::take(&mut self.outliers_mm);
        let Some(settled) = self.settled.clone() else { return Growth::Outlier };
        let place = self.station(outliers_mm[0]);
        let at_back = place >= settled.end.saturating_sub(MAX_RELEASED) as f64;
        if !at_back && place > (settled.start + MAX_RELEASED) as f64 {
            return Growth::Outlier;
        }
        let old = self.nodes_mm.len();
        if !at_back {
            self.reverse();
        }
        let moved = self.rejoin_back(&outliers_mm);
        if !at_back {
            self.reverse();
        }
        let all = self.nodes_mm.len();
        match moved {
            None => Growth::Outlier,
            Some(moved) if at_back => Growth::Moved { before: 0, moved },
            Some(moved) => Growth::Moved { before: all - old, moved: all - moved.end..all - moved.start },
        }
    }

    /// Reverses the order of the nodes.
    fn reverse(&mut self) {
        self.nodes_mm.reverse();
        let all = self.nodes_mm.len();
        self.settled = self.settled.take().map(|settled| all - settled.end..all - settled.start);
    }

    /// Connects the last end; the nodes that moved or are new, or `None` where centres and curve do not form one line.
    fn rejoin_back(&mut self, outliers_mm: &[DVec3]) -> Option<Range<usize>> {
        let (old, settled) = (self.nodes_mm.len(), self.settled.clone()?);
        let place = self.station(outliers_mm[0]).min(settled.end as f64) as usize;
        let end = place.saturating_sub(SETTLED).max(settled.end.saturating_sub(MAX_RELEASED));
        let end = end.clamp(settled.start + 2, settled.end.max(settled.start + 2));
        let guides_mm = &self.nodes_mm[end.saturating_sub(GUIDES).max(settled.start)..end];
        // The clusters beyond, in the order of the curve.
        let mut found: Vec<(f64, DVec3)> = self
            .clusters
            .iter()
            .map(|(sum, count)| *sum / *count)
            .map(|mean| (self.station(mean), mean))
            .filter(|(place, _)| *place > end as f64)
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let centres_mm: Vec<DVec3> = guides_mm
            .iter()
            .copied()
            .chain(found.into_iter().map(|(_, mean)| mean))
            .chain(outliers_mm.iter().copied())
            .collect();
        let line_mm = resampled(&centreline(&centres_mm, self.radius_mm).ok()??, self.spacing_mm());
        let from = self.nodes_mm[end - 1];
        let distance = |k: usize| line_mm[k].distance(from);
        let joint = (0..line_mm.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)))?;
        if distance(joint) > self.radius_mm || joint + 2 > line_mm.len() {
            return None;
        }
        self.nodes_mm.truncate(end);
        self.nodes_mm.extend(&line_mm[joint + 1..]);
        let extended = (self.nodes_mm.len() + BEYOND).max(old);
        self.extend_back(extended - self.nodes_mm.len());
        self.settled = Some(settled.start..end);
        outliers_mm.iter().for_each(|&centre| self.gather(centre));
        for _ in 0..2 {
            let fitted = self.fitted(end..extended);
            self.nodes_mm.truncate(end);
            self.nodes_mm.extend(fitted);
        }
        Some(end..extended)
    }

    fn extend_back(&mut self, count: usize) {
        for _ in 0..count {
            let next = beyond(self.nodes_mm.iter().rev());
            self.nodes_mm.push(next);
        }
    }

    fn extend_front(&mut self, count: usize) {
        for _ in 0..count {
            let next = beyond(self.nodes_mm.iter());
            self.nodes_mm.insert(0, next);
        }
        if let Some(settled) = &mut self.settled {
            *settled = settled.start + count..settled.end + count;
        }
    }

    /// Fixes the nodes well within the centres, and forgets the clusters about them.
    fn settle(&mut self) {
        let all = 0..self.nodes_mm.len();
        let place = |(sum, count): &(DVec3, f64)| self.station(*sum / *count);
        let places: Vec<f64> = self.clusters.iter().map(place).collect();
        let settled = (BEYOND + SETTLED)..(all.end - BEYOND).saturating_sub(SETTLED);
        self.settled = match self.settled.take() {
            Some(before) => Some(before.start.min(settled.start)..before.end.max(settled.end)),
            None => (settled.start + 2 <= settled.end).then_some(settled),
        };
        if let Some(settled) = &self.settled {
            // The next ones are needed where an end is released.
            let (low, high) = (settled.start + MAX_RELEASED, settled.end.saturating_sub(MAX_RELEASED));
            let mut places = places.into_iter();
            self.clusters.retain(|_| places.next().is_none_or(|p| p < low as f64 || p > high as f64));
        }
    }

    /// Positions of the nodes `free` with all others fixed: the minimum of `Σ|pᵢ - c(sᵢ)|² + λ Σ|Δ²c|²` over the clusters'
    /// means pᵢ, then moved along the curve to even distances.
    fn fitted(&self, free: Range<usize>) -> Vec<DVec3> {
        let window = free.start.saturating_sub(2)..(free.end + 2).min(self.nodes_mm.len());
        let mut equations = Pentadiagonal::second_differences(window.len(), SMOOTHNESS);
        let mut right = vec![DVec3::ZERO; window.len()];
        let (low, high) = (window.start as f64, (window.end - 1) as f64);
        let places: Vec<(usize, f64, DVec3)> = self
            .clusters
            .iter()
            .map(|(sum, count)| (*sum / *count, self.station(*sum / *count)))
            .filter(|(_, place)| (low..=high).contains(place))
            .map(|(mean, place)| {
                let row = ((place - low) as usize).min(window.len() - 2);
                (row, place - low - row as f64, mean)
            })
            .collect();
        let nearest = |&(row, share, _): &(usize, f64, DVec3)| row + usize::from(share >= 0.5);
        let mut here = vec![0.0; window.len()];
        places.iter().for_each(|place| here[nearest(place)] += 1.0);
        for place in &places {
            let (row, share, mean) = *place;
            let weight = 1.0 / here[nearest(place)];
            equations.add_pair(row, weight, [1.0 - share, share]);
            right[row] += mean * (weight * (1.0 - share));
            right[row + 1] += mean * (weight * share);
        }
        for node in window.clone().filter(|node| !free.contains(node)) {
            equations.add_diagonal(node - window.start, FIXED_STIFFNESS * SMOOTHNESS);
            right[node - window.start] += self.nodes_mm[node] * (FIXED_STIFFNESS * SMOOTHNESS);
        }
        let Some(factored) = equations.factored() else { return self.nodes_mm[free].to_vec() };
        let solution = factored.solve(right);
        // From a fixed node, where there is one.
        if free.end < window.end {
            let back: Vec<DVec3> = solution[..=free.end - window.start].iter().rev().copied().collect();
            let mut even = evenly(&back, self.spacing_mm(), free.len());
            even.reverse();
            even
        } else if free.start > window.start {
            evenly(&solution[free.start - 1 - window.start..], self.spacing_mm(), free.len())
        } else {
            // From the first centre, so that the curve extends as far before it as behind the last.
            let first = places.iter().map(|(row, share, _)| *row as f64 + share).fold(high, f64::min);
            let row = (first as usize).min(solution.len() - 2);
            let anchor = solution[row].lerp(solution[row + 1], first - row as f64);
            let front: Vec<DVec3> =
                std::iter::once(anchor).chain(solution[..=row].iter().rev().copied()).collect();
            let back: Vec<DVec3> =
                std::iter::once(anchor).chain(solution[row + 1..].iter().copied()).collect();
            let mut even = evenly(&front, self.spacing_mm(), BEYOND);
            even.reverse();
            even.push(anchor);
            even.extend(evenly(&back, self.spacing_mm(), free.len() - BEYOND - 1));
            even
        }
    }

    /// The place along the curve, counted in nodes, that is nearest to a point; the end segments are extended.
    fn station(&self, point: DVec3) -> f64 {
        nearest(&self.nodes_mm, point).map_or(0.0, |(node, share)| node as f64 + share)
    }

    /// The point of the polyline over the nodes.
    fn at_line(&self, place: f64) -> DVec3 {
        let node = (place.max(0.0) as usize).min(self.nodes_mm.len() - 2);
        self.nodes_mm[node].lerp(self.nodes_mm[node + 1], place - node as f64)
    }

    /// Point and unit tangent of the uniform cubic B-spline over the nodes, `place` counted in nodes. A node moves it no
    /// farther than two nodes away.
    pub fn at(&self, place: f64) -> (DVec3, DVec3) {
        let last = self.nodes_mm.len() - 1;
        let k = (place.max(0.0) as usize).min(last - 1);
        let t = place - k as f64;
        let (q, r) = (self.nodes_mm[k], self.nodes_mm[k + 1]);
        let p = if k == 0 { q * 2.0 - r } else { self.nodes_mm[k - 1] };
        let s = if k + 1 == last { r * 2.0 - q } else { self.nodes_mm[k + 2] };
        let (t2, t3) = (t * t, t * t * t);
        let point = (p * (1.0 - t).powi(3)
            + q * (3.0 * t3 - 6.0 * t2 + 4.0)
            + r * (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0)
            + s * t3)
            / 6.0;
        let slope = p * (-0.5 * (1.0 - t).powi(2))
            + q * (1.5 * t2 - 2.0 * t)
            + r * (-1.5 * t2 + t + 0.5)
            + s * (0.5 * t2);
        (point, slope.normalize_or(DVec3::Z))
    }
}

/// The mirror image of the second of two points about the first.
fn beyond<'a>(mut points: impl Iterator<Item = &'a DVec3>) -> DVec3 {
    match (points.next(), points.next()) {
        (Some(&end), Some(&inner)) => end * 2.0 - inner,
        _ => DVec3::ZERO,
    }
}

/// `count` points along a polyline at equal distances from its first point, which is not among them; straight beyond its
/// end.
fn evenly(line: &[DVec3], spacing: f64, count: usize) -> Vec<DVec3> {
    let mut points = Vec::with_capacity(count);
    let (mut segment, mut passed) = (0, 0.0);
    for i in 1..=count {
        let goal = spacing * i as f64;
        while segment + 2 < line.len() && passed + line[segment].distance(line[segment + 1]) <= goal {
            passed += line[segment].distance(line[segment + 1]);
            segment += 1;
        }
        let along = (line[segment + 1] - line[segment]).normalize_or_zero();
        points.push(line[segment] + along * (goal - passed));
    }
    points
}
