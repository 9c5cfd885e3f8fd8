//! Intersection of a surface with a plane.

use super::Surface;
use crate::Result;
use crate::geometry::{Pose, polygon};
use glam::{DVec2, DVec3};
use parry3d::bounding_volume::Aabb;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use std::collections::BTreeMap;

/// The curves in which a plane cuts a surface.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct Cut {
    /// The closed curves.
    pub outlines: Vec<SectionOutline>,
    /// Of each closed curve and each of its points: the edge of the surface that it lies on.
    pub on_edges: Vec<Vec<OnEdge>>,
    /// Number of curves that are not closed: the plane crosses an opening of the surface, or more than two triangles meet
    /// in an edge.
    pub open: usize,
}

/// A point on an edge of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnEdge {
    /// The edge's nodes.
    pub nodes: [u32; 2],
    /// How far from the first node to the second, 0 to 1.
    pub share: f64,
}

impl OnEdge {
    /// The value there of a node array, interpolated.
    pub fn value(&self, array: &[f64]) -> f64 {
        let [low, high] = self.nodes.map(|node| array[node as usize]);
        low + (high - low) * self.share
    }
}

/// A straight line across an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Chord {
    pub length_mm: f64,
    pub ends_mm: [DVec2; 2],
}

/// A closed polygon in a plane, in the plane's own coordinates; the last point joins the first.
#[derive(Debug, Clone, PartialEq)]
pub struct SectionOutline {
    /// Its points, mm.
    pub points_mm: Vec<DVec2>,
}

impl Surface {
    /// Cuts the surface by the xy-plane of a pose; outlines are in that plane's coordinates.
    ///
    /// A node in the plane counts as above it, so that every triangle is cut along a whole segment or not at all.
    ///
    /// # Errors
    /// As [`Surface::check`].
    pub fn cut(&self, world_from_plane: &Pose) -> Result<Cut> {
        self.check()?;
        Ok(self.cut_among(&self.triangles, world_from_plane))
    }

    /// Cuts some of the triangles. The surface is valid.
    fn cut_among<'a>(
        &self,
        triangles: impl IntoIterator<Item = &'a [u32; 3]>,
        world_from_plane: &Pose,
    ) -> Cut {
        let plane_from_world = world_from_plane.inverse();
        let in_plane = |node: u32| plane_from_world.transform_point(self.nodes_mm[node as usize]);
        let above = |node: u32| in_plane(node).z >= 0.0;

        // Every cut edge gives a point of the curves, and every cut triangle joins two of them.
        let mut points_mm: Vec<DVec2> = Vec::new();
        let mut on_edges: Vec<OnEdge> = Vec::new();
        let mut joined: Vec<Vec<usize>> = Vec::new();
        let mut by_edge: BTreeMap<[u32; 2], usize> = BTreeMap::new();
        for &[a, b, c] in triangles {
            let mut ends = [0; 2];
            let mut found = 0;
            for [p, q] in [[a, b], [b, c], [c, a]].into_iter().filter(|&[p, q]| above(p) != above(q)) {
                let edge = [p.min(q), p.max(q)];
                ends[found] = *by_edge.entry(edge).or_insert_with(|| {
                    let [low, high] = edge.map(in_plane);
                    let share = low.z / (low.z - high.z);
                    points_mm.push(low.lerp(high, share).truncate());
                    on_edges.push(OnEdge { nodes: edge, share });
                    joined.push(Vec::new());
                    points_mm.len() - 1
                });
                found += 1;
            }
            if found == 2 {
                joined[ends[0]].push(ends[1]);
                joined[ends[1]].push(ends[0]);
            }
        }

        let mut cut = Cut::default();
        let mut seen = vec![false; points_mm.len()];
        for start in 0..points_mm.len() {
            if seen[start] {
                continue;
            }
            let curve = curve_from(start, &joined, &mut seen);
            if curve.len() > 2 && curve.iter().all(|&p| joined[p].len() == 2) {
                cut.outlines
                    .push(SectionOutline { points_mm: curve.iter().map(|&p| points_mm[p]).collect() });
                cut.on_edges.push(curve.iter().map(|&p| on_edges[p]).collect());
            } else {
                cut.open += 1;
            }
        }
        cut
    }
}

/// Cuts one surface by many planes: a tree of boxes over its triangles finds those that a plane can cross, so that a cut
/// takes time for the curve rather than for the surface.
pub struct Cutter<'a> {
    surface: &'a Surface,
    tree: Bvh,
    /// Boxes are in single precision, about the surface's centre and in units of its size.
    centre_mm: DVec3,
    size_mm: f64,
}

/// By how much boxes are too large on each side: more than the rounding of their coordinates.
const SLACK: f64 = 1e-6;

impl<'a> Cutter<'a> {
    /// Builds the tree.
    ///
    /// # Errors
    /// As [`Surface::check`].
    pub fn new(surface: &'a Surface) -> Result<Self> {
        surface.check()?;
        let (low, high) = surface
            .nodes_mm
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        let (centre_mm, size_mm) = (low.midpoint(high), low.distance(high).max(f64::MIN_POSITIVE));
        let around = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|node| (surface.nodes_mm[node as usize] - centre_mm) / size_mm);
            let (low, high) = (a.min(b).min(c) - SLACK, a.max(b).max(c) + SLACK);
            Aabb::new(low.as_vec3(), high.as_vec3())
        };
        let boxes: Vec<Aabb> = surface.triangles.iter().map(around).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        Ok(Self { surface, tree, centre_mm, size_mm })
    }

    /// The cut of [`Surface::cut`].
    pub fn cut(&self, world_from_plane: &Pose) -> Cut {
        let normal = world_from_plane.rotation.z_axis;
        let offset = (world_from_plane.translation_mm - self.centre_mm).dot(normal) / self.size_mm;
        let crosses = |node: &BvhNode| {
            let (low, high) = (node.mins().as_dvec3(), node.maxs().as_dvec3());
            let reach = (high - low).dot(normal.abs()) / 2.0;
            (low.midpoint(high).dot(normal) - offset).abs() <= reach + SLACK
        };
        let mut triangles: Vec<u32> = self.tree.leaves(crosses).collect();
        // The order in which the surface has them.
        triangles.sort_unstable();
        let triangles = triangles.iter().map(|&t| &self.surface.triangles[t as usize]);
        self.surface.cut_among(triangles, world_from_plane)
    }
}

/// All points connected with one, in their order along the curve where each has two neighbours.
fn curve_from(start: usize, joined: &[Vec<usize>], seen: &mut [bool]) -> Vec<usize> {
    let mut curve = Vec::new();
    let mut next = vec![start];
    while let Some(point) = next.pop() {
        if !std::mem::replace(&mut seen[point], true) {
            curve.push(point);
            next.extend(joined[point].iter().filter(|&&p| !seen[p]));
        }
    }
    curve
}

impl SectionOutline {
    fn edges(&self) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
        let points = &self.points_mm;
        points.iter().copied().zip(points.iter().copied().cycle().skip(1))
    }

    /// The area inside, mm².
    pub fn area_mm2(&self) -> f64 {
        self.twice_area_and_moment().0.abs() / 2.0
    }

    /// The centroid of the area inside, mm; NaN where there is no area.
    pub fn centroid_mm(&self) -> DVec2 {
        let (twice_area, moment) = self.twice_area_and_moment();
        self.points_mm.first().map_or(DVec2::NAN, |&origin| origin + moment / (3.0 * twice_area))
    }

    fn twice_area_and_moment(&self) -> (f64, DVec2) {
        polygon::twice_area_and_moment(self.points_mm.iter().copied())
    }

    /// Its length, mm.
    pub fn perimeter_mm(&self) -> f64 {
        self.edges().map(|(p, q)| p.distance(q)).sum()
    }

    /// Whether a point lies inside.
    pub fn contains(&self, point_mm: DVec2) -> bool {
        self.crossings(point_mm, DVec2::X).filter(|&t| t > 0.0).count() % 2 == 1
    }

    /// The distance from a point to the curve, mm.
    pub fn distance_mm(&self, point_mm: DVec2) -> f64 {
        let distance = |(p, q): (DVec2, DVec2)| {
            let (edge, to) = (q - p, point_mm - p);
            let share = (to.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
            // Of no length: its end.
            to.distance(edge * if share.is_nan() { 0.0 } else { share })
        };
        self.edges().map(distance).fold(f64::INFINITY, f64::min)
    }

    /// The shortest and the longest chord through the centroid, mm, among directions half a degree apart. A chord ends
    /// at its first intersections with the curve. `None` where the centroid lies outside.
    pub fn diameters_mm(&self) -> Option<[f64; 2]> {
        Some(self.chords()?.map(|chord| chord.length_mm))
    }

    /// The chords of [`diameters_mm`](Self::diameters_mm).
    pub(crate) fn chords(&self) -> Option<[Chord; 2]> {
        const DIRECTIONS: u32 = 360;
        let centroid = self.centroid_mm();
        if !self.contains(centroid) {
            return None;
        }
        let chord = |i: u32| {
            let direction = DVec2::from_angle(std::f64::consts::PI * f64::from(i) / f64::from(DIRECTIONS));
            let (mut forth, mut back) = (f64::INFINITY, f64::INFINITY);
            for t in self.crossings(centroid, direction) {
                let side = if t > 0.0 { &mut forth } else { &mut back };
                *side = side.min(t.abs());
            }
            let ends_mm = [centroid + direction * forth, centroid - direction * back];
            (forth + back).is_finite().then_some(Chord { length_mm: forth + back, ends_mm })
        };
        let mut extremes = [chord(0)?; 2];
        for i in 1..DIRECTIONS {
            let chord = chord(i)?;
            if chord.length_mm < extremes[0].length_mm {
                extremes[0] = chord;
            }
            if chord.length_mm > extremes[1].length_mm {
                extremes[1] = chord;
            }
        }
        Some(extremes)
    }

    /// The largest distance of two of its points (Feret's diameter).
    pub(crate) fn feret(&self) -> Chord {
        let mut farthest = Chord { length_mm: 0.0, ends_mm: [DVec2::NAN; 2] };
        let points = &self.points_mm;
        for (i, &p) in points.iter().enumerate() {
            for &q in &points[i + 1..] {
                let length_mm = p.distance(q);
                if length_mm > farthest.length_mm {
                    farthest = Chord { length_mm, ends_mm: [p, q] };
                }
            }
        }
        farthest
    }

    /// Intersections of the line through a point with the curve, as distances along a unit direction, mm.
    fn crossings(&self, point_mm: DVec2, direction: DVec2) -> impl Iterator<Item = f64> + '_ {
        self.edges().filter_map(move |(p, q)| {
            let (p, q) = (p - point_mm, q - point_mm);
            let (left_p, left_q) = (direction.perp_dot(p), direction.perp_dot(q));
            let crosses = (left_p >= 0.0) != (left_q >= 0.0);
            crosses.then(|| p.lerp(q, left_p / (left_p - left_q)).dot(direction))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DQuat};
    use std::f64::consts::TAU;

    /// A tube about z of 200 nodes per ring and the given radii at z = 0, 1, 2, …, squeezed by half along y.
    fn tube(radii_mm: &[f64]) -> Surface {
        let mut surface = Surface::default();
        for (z, r) in radii_mm.iter().enumerate() {
            surface.nodes_mm.extend((0..200).map(|j| {
                let p = DVec2::from_angle(f64::from(j) / 200.0 * TAU) * *r;
                DVec3::new(p.x, p.y / 2.0, z as f64)
            }));
        }
        for ring in 0..radii_mm.len() as u32 - 1 {
            for j in 0..200 {
                let (a, b) = (ring * 200 + j, ring * 200 + (j + 1) % 200);
                surface.triangles.extend([[a, b, b + 200], [a, b + 200, a + 200]]);
            }
        }
        surface
    }

    fn at(z: f64) -> Pose {
        Pose { translation_mm: DVec3::Z * z, ..Pose::IDENTITY }
    }

    #[test]
    fn an_ellipse_has_its_area_and_diameters() {
        // Also through a ring's own nodes, from a turned and shifted plane.
        let turned = Pose::from_quaternion(DVec3::new(0.4, 0.1, 1.25), DQuat::from_rotation_z(0.7));
        for plane in [at(1.0), at(1.5), turned] {
            let cut = tube(&[4.0; 4]).cut(&plane).unwrap();
            assert_eq!((cut.outlines.len(), cut.open), (1, 0));
            let outline = &cut.outlines[0];
            // A polygon of 200 corners lacks a thousandth at most.
            let area = TAU / 2.0 * 4.0 * 2.0;
            assert!((outline.area_mm2() / area - 1.0).abs() < 1e-3, "{}", outline.area_mm2());
            let [least, greatest] = outline.diameters_mm().unwrap();
            assert!((least - 4.0).abs() < 4e-3 && (greatest - 8.0).abs() < 8e-3, "{least} {greatest}");
            let centre = plane.inverse().transform_point(DVec3::ZERO).truncate();
            assert!(outline.centroid_mm().abs_diff_eq(centre, 1e-9) && outline.contains(centre));
            assert!((outline.distance_mm(centre) - 2.0).abs() < 1e-3);
            // Ramanujan.
            let perimeter = TAU / 2.0 * (3.0 * 6.0 - (14.0_f64 * 10.0).sqrt());
            assert!((outline.perimeter_mm() / perimeter - 1.0).abs() < 1e-3, "{}", outline.perimeter_mm());
        }
    }

    #[test]
    fn a_plane_beside_a_surface_and_through_its_opening() {
        let tube = tube(&[4.0, 5.0]);
        assert_eq!(tube.cut(&at(1.5)).unwrap(), Cut::default());
        let along = Pose::from_quaternion(DVec3::Z * 0.5, DQuat::from_rotation_x(1.0));
        let cut = tube.cut(&along).unwrap();
        assert_eq!((cut.outlines.len(), cut.open), (0, 2));
    }

    #[test]
    fn two_parts_give_two_outlines() {
        let mut two = tube(&[1.0, 1.0]);
        let other = tube(&[2.0, 2.0]);
        let count = two.nodes_mm.len() as u32;
        two.nodes_mm.extend(other.nodes_mm.iter().map(|&n| n + DVec3::X * 10.0));
        two.triangles.extend(other.triangles.iter().map(|t| t.map(|n| n + count)));
        let outlines = two.cut(&at(0.5)).unwrap().outlines;
        assert_eq!(outlines.len(), 2);
        assert!(outlines[0].contains(DVec2::ZERO) && !outlines[1].contains(DVec2::ZERO));
        assert!((outlines[1].distance_mm(DVec2::ZERO) - 8.0).abs() < 1e-9);
    }

    #[test]
    fn a_cutter_cuts_as_the_surface_does() {
        let surface = tube(&[4.0, 5.0, 3.0, 6.0, 2.0, 4.0]);
        let cutter = Cutter::new(&surface).unwrap();
        let mut cuts = 0;
        for k in 0..200 {
            let angle = 0.37 * f64::from(k);
            let plane = Pose {
                rotation: DMat3::from_rotation_x(angle) * DMat3::from_rotation_y(1.3 * angle),
                translation_mm: DVec3::new(angle.sin() * 3.0, angle.cos() * 3.0, f64::from(k % 7)),
            };
            let cut = surface.cut(&plane).unwrap();
            cuts += cut.outlines.len() + cut.open;
            assert_eq!(cutter.cut(&plane), cut);
        }
        assert!(cuts > 100, "{cuts}");
        // A plane through nodes, and one that misses.
        for z in [0.0, 1.0, 1e3] {
            let plane = Pose { translation_mm: DVec3::Z * z, ..Pose::IDENTITY };
            assert_eq!(cutter.cut(&plane), surface.cut(&plane).unwrap());
        }
    }

    #[test]
    fn an_index_out_of_range_is_an_error() {
        let surface = Surface { triangles: vec![[0, 1, 2]], ..Surface::default() };
        assert!(surface.cut(&Pose::IDENTITY).is_err());
    }
}
