//! The truth: a vessel's wall and the centrelines of its branches.

use super::centreline::Centreline;
use crate::evaluate::Locator;
use crate::surface::Surface;
use crate::{Error, Result};
use glam::DVec3;

/// A vessel of known geometry: its wall and the centrelines of its branches.
///
/// The wall is one piece with open ends; its triangles run counter-clockwise seen from outside.
#[derive(Debug, Clone)]
pub struct SimulatedVessel {
    surface: Surface,
    branches: Vec<Centreline>,
    notes: Vec<String>,
    /// Casts rays on the wall, and measures distances to it.
    wall: Locator,
}

impl SimulatedVessel {
    /// A vessel from any triangle surface and at least one centreline.
    ///
    /// Two faults are repaired and listed in [`SimulatedVessel::notes`]: pieces beside the largest one are
    /// dropped, and triangles are turned so that their normals point out of the lumen.
    ///
    /// # Errors
    /// [`Error::Surface`] for an empty surface, indices without a node, coordinates that are not finite, a size
    /// that can not be in mm, and a centreline that leaves the vessel.
    pub fn new(mut surface: Surface, branches: Vec<Centreline>) -> Result<Self> {
        check_nodes(&surface)?;
        let mut notes = Vec::new();
        orient(&mut surface, &mut notes);
        if branches.is_empty() {
            return Err(wrong("centreline", "none", "at least one branch"));
        }
        let wall = Locator::new(&surface)?;
        let mut vessel = Self { surface, branches, notes, wall };
        vessel.turn_outward()?;
        vessel.check_centrelines()?;
        Ok(vessel)
    }

    /// The wall.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// The centrelines.
    pub fn branches(&self) -> &[Centreline] {
        &self.branches
    }

    /// Repairs and doubts, in words; empty for a sound vessel.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Distance from `origin_mm` to the first wall along the unit `direction`, mm; `None` beyond `range_mm`.
    pub fn cast_mm(&self, origin_mm: DVec3, direction: DVec3, range_mm: f64) -> Option<f64> {
        let cast = |direction| self.wall.cast(origin_mm, direction, range_mm).map(|(_, distance)| distance);
        // A ray that meets an edge exactly can slip between its two triangles in rounding. A ray a hair beside
        // it does not, and meets the wall at the same distance to far below a nanometre.
        cast(direction).or_else(|| {
            let (x, y) = direction.any_orthonormal_pair();
            cast(direction + (x * 0.6 + y * 0.8) * 1e-12)
        })
    }

    /// Distance from a point to the wall, mm, never negative.
    pub fn distance_mm(&self, point_mm: DVec3) -> f64 {
        self.wall.distance_mm(point_mm)
    }

    /// Whether the segment between two points meets the wall.
    pub(super) fn wall_between(&self, from_mm: DVec3, to_mm: DVec3) -> bool {
        let way = to_mm - from_mm;
        way.try_normalize().is_some_and(|direction| self.cast_mm(from_mm, direction, way.length()).is_some())
    }

    /// Numbers of rays across the centreline at `s_mm` that meet the wall from its inside and from its outside.
    fn rays_across(&self, branch: &Centreline, s_mm: f64) -> (usize, usize) {
        let frame = branch.frame(s_mm);
        let (mut inside, mut outside) = (0, 0);
        for i in 0..RAYS_ACROSS {
            // A turn of half a step keeps the rays off the edges of a regular grid of triangles.
            let angle = (i as f64 + 0.5) / RAYS_ACROSS as f64 * std::f64::consts::TAU;
            let direction = frame.rotation.x_axis * angle.cos() + frame.rotation.y_axis * angle.sin();
            if let Some((triangle, _)) = self.wall.cast(frame.translation_mm, direction, f64::MAX) {
                let [a, b, c] = self.surface.corners_mm(triangle as usize);
                if (b - a).cross(c - a).dot(direction) > 0.0 {
                    inside += 1;
                } else {
                    outside += 1;
                }
            }
        }
        (inside, outside)
    }

    /// Reverses all triangles where more rays from the centrelines meet the wall from outside than from inside.
    fn turn_outward(&mut self) -> Result<()> {
        let (inside, outside) = self
            .branches
            .iter()
            .flat_map(|branch| stations(branch).map(move |s| (branch, s)))
            .map(|(branch, s)| self.rays_across(branch, s))
            .fold((0, 0), |sum, n| (sum.0 + n.0, sum.1 + n.1));
        if outside > inside {
            // Which corner comes first decides the last digit of a ray's length: it is another for rays than
            // for files.
            self.surface.triangles.iter_mut().for_each(|t| t.swap(0, 1));
            self.wall = Locator::new(&self.surface)?;
            self.surface.triangles.iter_mut().for_each(|t| t.rotate_left(1));
            self.notes.push("normals pointed into the lumen: turned outward".into());
        }
        Ok(())
    }

    fn check_centrelines(&self) -> Result<()> {
        for (b, branch) in self.branches.iter().enumerate() {
            for s in stations(branch) {
                let (inside, _) = self.rays_across(branch, s);
                if 2 * inside <= RAYS_ACROSS {
                    return Err(wrong(
                        &format!("centreline branch {b} at {s:.1} mm ({:.1})", branch.at(s).0),
                        format!(
                            "outside the vessel: {inside} of {RAYS_ACROSS} rays across meet the wall from inside"
                        ),
                        "inside the vessel",
                    ));
                }
            }
        }
        Ok(())
    }
}

/// Enough for a majority to be clear beside the mouth of a side branch.
const RAYS_ACROSS: usize = 24;

/// Where a centreline is checked: about every mm, a little inside of both ends.
fn stations(branch: &Centreline) -> impl Iterator<Item = f64> {
    let length = branch.length_mm();
    let n = length.ceil().clamp(1.0, 1e5) as usize;
    (0..n).map(move |i| (i as f64 + 0.5) / n as f64 * length)
}

fn check_nodes(surface: &Surface) -> Result<()> {
    if surface.triangles.is_empty() {
        return Err(wrong("triangles", "none", "a triangle surface"));
    }
    if let Some((i, p)) = surface.nodes_mm.iter().enumerate().find(|(_, p)| !p.is_finite()) {
        return Err(wrong(&format!("node {i}"), p, "three finite numbers in mm"));
    }
    surface.check()?;
    let size = surface.bounding_box_mm().map_or(0.0, |[low, high]| (high - low).max_element());
    if size < 1.0 {
        return Err(wrong(
            "size",
            format!("{size:.4} mm across"),
            "a vessel in mm; this one looks like metres: multiply its coordinates by 1000",
        ));
    }
    Ok(())
}

/// Keeps the largest piece and makes its triangles agree on which side is out.
fn orient(surface: &mut Surface, notes: &mut Vec<String>) {
    let edges = edges(&surface.triangles);
    let mut neighbours: Vec<Vec<(usize, bool)>> = vec![Vec::new(); surface.triangles.len()];
    let mut crowded = 0;
    for shared in edges.chunk_by(|a, b| a.ends == b.ends) {
        crowded += usize::from(shared.len() > 2);
        for pair in shared.windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            // Two triangles that agree run along their shared edge in opposite directions. Where more meet,
            // nothing tells which ones belong together.
            let agree = shared.len() > 2 || a.forward != b.forward;
            neighbours[a.triangle].push((b.triangle, agree));
            neighbours[b.triangle].push((a.triangle, agree));
        }
    }
    if crowded > 0 {
        notes.push(format!("{crowded} edges are shared by more than two triangles: left as they are"));
    }
    let mut piece: Vec<Option<(usize, bool)>> = vec![None; surface.triangles.len()];
    let (mut sizes, mut turns): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
    for seed in 0..surface.triangles.len() {
        if piece[seed].is_some() {
            continue;
        }
        let this = sizes.len();
        sizes.push(0);
        turns.push(0);
        piece[seed] = Some((this, false));
        let mut open = vec![seed];
        while let Some(t) = open.pop() {
            let turned = piece[t].is_some_and(|(_, turned)| turned);
            sizes[this] += 1;
            turns[this] += usize::from(turned);
            for &(other, agree) in &neighbours[t] {
                if piece[other].is_none() {
                    piece[other] = Some((this, turned == agree));
                    open.push(other);
                }
            }
        }
    }
    let largest = (0..sizes.len()).max_by_key(|&i| (sizes[i], usize::MAX - i)).unwrap_or(0);
    if sizes.len() > 1 {
        let dropped = surface.triangles.len() - sizes[largest];
        notes.push(format!(
            "{} separate pieces: kept the largest, dropped {dropped} of {} triangles",
            sizes.len(),
            surface.triangles.len()
        ));
    }
    // The centrelines decide later whether the majority points outward; here the minority is made to agree with
    // it.
    let minority_is_turned = 2 * turns[largest] <= sizes[largest];
    let odd = turns[largest].min(sizes[largest] - turns[largest]);
    if odd > 0 {
        notes.push(format!("{odd} triangles ran the other way round than their neighbours: turned"));
    }
    let mut kept = Vec::with_capacity(sizes[largest]);
    for (&triangle, which) in surface.triangles.iter().zip(&piece) {
        if let &Some((this, turned)) = which
            && this == largest
        {
            let [a, b, c] = triangle;
            kept.push(if turned == minority_is_turned { [a, c, b] } else { triangle });
        }
    }
    surface.triangles = kept;
    if sizes.len() > 1 {
        *surface = std::mem::take(surface).without_loose_nodes();
    }
}

struct Edge {
    ends: (u32, u32),
    triangle: usize,
    forward: bool,
}

fn edges(triangles: &[[u32; 3]]) -> Vec<Edge> {
    let mut edges: Vec<Edge> = triangles
        .iter()
        .enumerate()
        .flat_map(|(triangle, &[a, b, c])| {
            [(a, b), (b, c), (c, a)].map(|(from, to)| Edge {
                ends: (from.min(to), from.max(to)),
                triangle,
                forward: from < to,
            })
        })
        .collect();
    edges.sort_by_key(|e| (e.ends, e.triangle));
    edges
}

fn wrong(what: &str, found: impl ToString, expected: impl ToString) -> Error {
    Error::Surface { what: what.into(), found: found.to_string(), expected: expected.to_string() }
}
