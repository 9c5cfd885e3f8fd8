//! The closest point of a surface, and where rays meet it.

use crate::geometry::triangle::{Feature, closest_on_triangle, ray_meets};
use crate::surface::Surface;
use crate::{Error, Result};
use glam::{DVec3, Vec3A};
use parry3d::bounding_volume::Aabb;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use rayon::prelude::*;
use std::cell::Cell;

/// Queries that one thread answers in order, each search starting from the triangle of the query before it. A fixed
/// number, so that no result depends on the number of threads.
const RUN: usize = 256;

/// The closest point of a surface to a query.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Closest {
    /// Where it is, mm.
    pub point_mm: DVec3,
    /// Its distance, mm; NaN for a query that is not finite.
    pub distance_mm: f64,
    /// The same with a sign: positive where the query lies on the side that the surface's normals point to. The normal
    /// at an edge is the sum of its triangles' normals, at a node their sum weighted by angle, which gives the right
    /// sign everywhere about a closed, consistently oriented surface (Bærentzen and Aanæs, 2005).
    pub signed_distance_mm: f64,
    /// The triangle that it lies on.
    pub triangle: u32,
    /// Whether it lies on an edge that belongs to one triangle only.
    pub on_rim: bool,
}

/// Finds where rays meet a surface, through parry's tree of bounding boxes over its triangles.
///
/// The boxes are in single precision and a little too large; which triangle is nearest is decided in double precision.
/// Triangles without area are left out: they have no normal, and their points lie on their neighbours' edges too.
#[derive(Debug, Clone)]
pub(crate) struct RayCaster {
    boxes: Boxes,
    corners_mm: Vec<[DVec3; 3]>,
    /// Which triangle of the surface each one is, ascending.
    original: Vec<u32>,
}

/// Finds the closest point of a surface, and where rays meet it. Triangles without area are left out.
#[derive(Debug, Clone)]
pub struct Locator {
    triangles: RayCaster,
    /// The nodes of each triangle.
    nodes: Vec<[u32; 3]>,
    face_normals: Vec<DVec3>,
    edge_normals: Vec<[DVec3; 3]>,
    node_normals: Vec<DVec3>,
    rim_edges: Vec<[bool; 3]>,
    rim_nodes: Vec<bool>,
}

impl RayCaster {
    /// Builds the tree.
    ///
    /// # Errors
    /// As [`Locator::new`].
    pub(crate) fn new(surface: &Surface) -> Result<Self> {
        surface.check()?;
        Self::with_normals(surface, &surface.triangle_normals())
    }

    fn with_normals(surface: &Surface, normals: &[DVec3]) -> Result<Self> {
        let original: Vec<u32> =
            (0..surface.triangles.len() as u32).filter(|&t| normals[t as usize] != DVec3::ZERO).collect();
        if original.is_empty() {
            return Err(Error::Surface {
                what: "triangles with an area".into(),
                found: "none".into(),
                expected: "at least one".into(),
            });
        }
        // Of triangles in one place the first is the nearest: the others would be searched in vain.
        let distinct = surface.distinct_triangles();
        let of_original = |t: &u32| original.binary_search(t).ok();
        let leaves: Vec<usize> = distinct.par_iter().filter_map(of_original).collect();
        let corners_mm: Vec<[DVec3; 3]> =
            original.par_iter().map(|&t| surface.corners_mm(t as usize)).collect();
        Ok(Self { boxes: Boxes::about(&corners_mm, &leaves), corners_mm, original })
    }

    /// The triangle that a ray meets first and the distance to it in lengths of `direction`; `None` where that is not
    /// less than `range`.
    pub(crate) fn cast(&self, origin_mm: DVec3, direction: DVec3, range: f64) -> Option<(u32, f64)> {
        self.cast_from(None, origin_mm, direction, range)
    }

    /// As [`RayCaster::cast`], sooner if the ray meets a triangle named before it meets most others.
    pub(crate) fn cast_from(
        &self,
        likely: Option<u32>,
        origin_mm: DVec3,
        direction: DVec3,
        range: f64,
    ) -> Option<(u32, f64)> {
        let meets = |triangle: u32| ray_meets(origin_mm, direction, self.corners_mm[triangle as usize]);
        let likely = likely.and_then(|t| self.original.binary_search(&t).ok()).and_then(|t| {
            let distance = meets(t as u32).filter(|distance| *distance < range)?;
            Some((distance, Some(t as u32)))
        });
        let first = Cell::new(likely.unwrap_or((range, None)));
        let ray = Ray::new(self.boxes.place(origin_mm), direction * self.boxes.per_mm);
        self.boxes.find_best(
            Boxes::reach(first.get().0),
            |node| ray.entry(node),
            |triangle| {
                let distance = meets(triangle)?;
                if (distance, Some(triangle)) < first.get() {
                    first.set((distance, Some(triangle)));
                }
                Some(Boxes::reach(distance))
            },
        );
        let (distance, triangle) = first.get();
        triangle.filter(|_| distance < range).map(|triangle| (self.original[triangle as usize], distance))
    }
}

impl Locator {
    /// Builds the tree.
    ///
    /// # Errors
    /// [`Error::Surface`] where an index is out of range, a node is not finite or no triangle has an area.
    pub fn new(surface: &Surface) -> Result<Self> {
        surface.check()?;
        let normals = surface.triangle_normals();
        let triangles = RayCaster::with_normals(surface, &normals)?;
        let original = &triangles.original;
        let nodes: Vec<[u32; 3]> = original.iter().map(|&t| surface.triangles[t as usize]).collect();
        let mut locator = Self {
            face_normals: original.iter().map(|&t| normals[t as usize]).collect(),
            edge_normals: vec![[DVec3::ZERO; 3]; nodes.len()],
            node_normals: surface.node_normals(),
            rim_edges: vec![[false; 3]; nodes.len()],
            rim_nodes: vec![false; surface.nodes_mm.len()],
            nodes,
            triangles,
        };
        locator.find_edge_normals();
        Ok(locator)
    }

    fn find_edge_normals(&mut self) {
        let mut edges: Vec<([u32; 2], u32, usize)> = Vec::with_capacity(3 * self.nodes.len());
        for (t, nodes) in self.nodes.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (nodes[k], nodes[(k + 1) % 3]);
                edges.push(([a.min(b), a.max(b)], t as u32, k));
            }
        }
        edges.sort_unstable();
        for edge in edges.chunk_by(|p, q| p.0 == q.0) {
            let normal: DVec3 = edge.iter().map(|&(_, t, _)| self.face_normals[t as usize]).sum();
            for &([a, b], t, k) in edge {
                self.edge_normals[t as usize][k] = normal;
                if edge.len() == 1 {
                    self.rim_edges[t as usize][k] = true;
                    self.rim_nodes[a as usize] = true;
                    self.rim_nodes[b as usize] = true;
                }
            }
        }
    }

    /// The unsigned distance, mm; NaN for a query that is not finite.
    pub fn distance_mm(&self, query_mm: DVec3) -> f64 {
        self.closest(query_mm).distance_mm
    }

    /// The closest point to one query.
    pub fn closest(&self, query_mm: DVec3) -> Closest {
        self.nearest(query_mm, 0).map_or(Closest::NONE, |nearest| self.describe(query_mm, nearest))
    }

    /// The closest points to many queries, in the queries' order, on all threads of the current pool.
    ///
    /// Queries that do not come one near the other are visited along a space-filling curve: each then lies near its
    /// predecessor, whose triangle bounds the search.
    pub fn closest_all(&self, queries_mm: &[DVec3]) -> Vec<Closest> {
        let order = match are_neighbours(queries_mm) {
            true => (0..queries_mm.len() as u32).collect(),
            false => along_a_curve(queries_mm),
        };
        let along = |run: &[u32]| -> Vec<Closest> {
            let mut start = 0;
            let mut next = |query_mm| {
                self.nearest(query_mm, start).map_or(Closest::NONE, |nearest| {
                    start = nearest.triangle;
                    self.describe(query_mm, nearest)
                })
            };
            run.iter().map(|&query| next(queries_mm[query as usize])).collect()
        };
        let found: Vec<Vec<Closest>> = order.par_chunks(RUN).map(along).collect();
        let mut closest = vec![Closest::NONE; queries_mm.len()];
        for (&query, found) in order.iter().zip(found.into_iter().flatten()) {
            closest[query as usize] = found;
        }
        closest
    }

    /// The nearest triangle, the first of equally near ones, whichever triangle the search starts from. `None` for a
    /// query that is not finite.
    fn nearest(&self, query_mm: DVec3, start: u32) -> Option<Nearest> {
        if !query_mm.is_finite() {
            return None;
        }
        let RayCaster { boxes, corners_mm, .. } = &self.triangles;
        let measure = |triangle: u32| {
            let (point_mm, feature) = closest_on_triangle(query_mm, corners_mm[triangle as usize]);
            Nearest { squared_mm2: query_mm.distance_squared(point_mm), triangle, point_mm, feature }
        };
        let nearest = Cell::new(measure(start));
        let query = boxes.place(query_mm).as_vec3a().clamp(-Boxes::FAR, Boxes::FAR);
        boxes.find_best(
            boxes.bound(nearest.get().squared_mm2),
            |node| squared_distance(node, query),
            |triangle| {
                if triangle == start {
                    return None;
                }
                let found = measure(triangle);
                if found.is_before(nearest.get()) {
                    nearest.set(found);
                }
                Some(boxes.bound(found.squared_mm2))
            },
        );
        Some(nearest.get())
    }

    /// The triangle that a ray meets first and the distance to it in lengths of `direction`; `None` where that is not
    /// less than `range`.
    pub(crate) fn cast(&self, origin_mm: DVec3, direction: DVec3, range: f64) -> Option<(u32, f64)> {
        self.triangles.cast(origin_mm, direction, range)
    }

    fn describe(&self, query_mm: DVec3, nearest: Nearest) -> Closest {
        let t = nearest.triangle as usize;
        let (normal, on_rim) = match nearest.feature {
            Feature::Face => (self.face_normals[t], false),
            Feature::Edge(k) => (self.edge_normals[t][k], self.rim_edges[t][k]),
            Feature::Corner(k) => {
                let node = self.nodes[t][k] as usize;
                (self.node_normals[node], self.rim_nodes[node])
            }
        };
        let distance_mm = nearest.squared_mm2.sqrt();
        let is_behind = (query_mm - nearest.point_mm).dot(normal) < 0.0;
        Closest {
            point_mm: nearest.point_mm,
            distance_mm,
            signed_distance_mm: if is_behind { -distance_mm } else { distance_mm },
            triangle: self.triangles.original[t],
            on_rim,
        }
    }
}

impl Closest {
    const NONE: Self = Self {
        point_mm: DVec3::NAN,
        distance_mm: f64::NAN,
        signed_distance_mm: f64::NAN,
        triangle: 0,
        on_rim: false,
    };
}

/// The closest point of one triangle to a query.
#[derive(Clone, Copy)]
struct Nearest {
    squared_mm2: f64,
    triangle: u32,
    point_mm: DVec3,
    feature: Feature,
}

impl Nearest {
    fn is_before(self, other: Self) -> bool {
        (self.squared_mm2, self.triangle) < (other.squared_mm2, other.triangle)
    }
}

/// Boxes about triangles in single precision, from the surface's centre and in units of its size.
#[derive(Debug, Clone)]
struct Boxes {
    /// The tree of the parts.
    tree: Bvh,
    /// Triangles near each other, with a tree of their own: they are built on all threads.
    parts: Vec<Part>,
    centre_mm: DVec3,
    per_mm: f64,
}

#[derive(Debug, Clone)]
struct Part {
    tree: Bvh,
    triangles: Vec<u32>,
}

impl Part {
    /// Triangles of at most this number are one part.
    const MOST: usize = 1 << 13;

    /// The parts of some triangles, halved along the longest extent until they are few.
    fn split(triangles: &mut [(u32, Aabb)]) -> Vec<Self> {
        if triangles.len() <= Self::MOST {
            let boxes = triangles.iter().map(|(_, about)| *about).enumerate();
            let tree = Bvh::from_iter(BvhBuildStrategy::Binned, boxes);
            return vec![Self { tree, triangles: triangles.iter().map(|(t, _)| *t).collect() }];
        }
        let centres = Aabb::from_points(triangles.iter().map(|(_, about)| about.center()));
        let axis = centres.extents().max_position();
        let place = |(t, about): &(u32, Aabb)| (about.center()[axis], *t);
        let middle = triangles.len() / 2;
        triangles.select_nth_unstable_by(middle, |a, b| {
            let (a, b) = (place(a), place(b));
            a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
        });
        let (before, after) = triangles.split_at_mut(middle);
        let (mut parts, after) = rayon::join(|| Self::split(before), || Self::split(after));
        parts.extend(after);
        parts
    }
}

impl Boxes {
    /// By how much boxes are too large on each side: twice the rounding of coordinates up to four sizes from the centre,
    /// and of their differences.
    const SLACK: f64 = 1e-6;
    /// Factor by which a bound is too large: farther away, rounding is relative to the distance and takes a quarter of
    /// it.
    const BOUND_SLACK: f32 = 1.0 + 4e-6;
    /// Coordinates of queries are clamped to this, so that squares stay finite; that brings them nearer to every box.
    const FAR: Vec3A = Vec3A::splat(1e18);

    /// Boxes about some of the triangles: at least one, each with an area.
    fn about(corners_mm: &[[DVec3; 3]], triangles: &[usize]) -> Self {
        let none = || (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let points = corners_mm.par_iter().flatten_iter();
        let (low, high) = points
            .fold(none, |(low, high), p| (low.min(*p), high.max(*p)))
            .reduce(none, |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (centre_mm, per_mm) = (low.midpoint(high), low.distance(high).recip());
        let mut boxes = Self { tree: Bvh::new(), parts: Vec::new(), centre_mm, per_mm };
        let around = |corners: &[DVec3; 3]| {
            let [a, b, c] = corners.map(|p| boxes.place(p));
            let low = a.min(b).min(c) - Self::SLACK;
            let high = a.max(b).max(c) + Self::SLACK;
            Aabb::new(low.as_vec3(), high.as_vec3())
        };
        let around = |&t: &usize| (t as u32, around(&corners_mm[t]));
        let mut triangles: Vec<(u32, Aabb)> = triangles.par_iter().map(around).collect();
        boxes.parts = Part::split(&mut triangles);
        let of_parts = boxes.parts.iter().map(|part| part.tree.root_aabb()).enumerate();
        boxes.tree = Bvh::from_iter(BvhBuildStrategy::Binned, of_parts);
        boxes
    }

    /// Tries the triangles in boxes whose `cost` is less than `most` and than all that `of_triangle` has found so far.
    fn find_best(&self, most: f32, cost: impl Fn(&BvhNode) -> f32, of_triangle: impl Fn(u32) -> Option<f32>) {
        self.tree.find_best(
            most,
            |node, _| cost(node),
            |part, most| {
                let Part { tree, triangles } = &self.parts[part as usize];
                let found =
                    tree.find_best(most, |node, _| cost(node), |t, _| of_triangle(triangles[t as usize]));
                found.map(|(_, cost)| cost)
            },
        );
    }

    fn place(&self, point_mm: DVec3) -> DVec3 {
        (point_mm - self.centre_mm) * self.per_mm
    }

    /// More than the squared distance of any box that may hold a triangle this near, or nearer.
    fn bound(&self, squared_mm2: f64) -> f32 {
        (squared_mm2 * self.per_mm * self.per_mm) as f32 * Self::BOUND_SLACK + f32::MIN_POSITIVE
    }
}

impl Boxes {
    /// More than the [`entry`] of any box that may hold a triangle which a ray meets at this distance.
    fn reach(distance: f64) -> f32 {
        distance as f32 * Self::BOUND_SLACK + f32::MIN_POSITIVE
    }
}

/// A ray among boxes.
struct Ray {
    origin: DVec3,
    /// Inverse of its direction, axis by axis; not finite where that is 0.
    per: DVec3,
}

impl Ray {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        Self { origin, per: direction.recip() }
    }

    /// How far along the ray it enters a box, 0 inside, in lengths of its direction; infinite where it misses it. The box is
    /// larger than what it holds by more than the rounding here.
    fn entry(&self, node: &BvhNode) -> f32 {
        let (low, high) = (node.mins().as_dvec3(), node.maxs().as_dvec3());
        let (mut to_low, mut to_high) = ((low - self.origin) * self.per, (high - self.origin) * self.per);
        if !self.per.is_finite() {
            // Along an axis in which the ray does not move, it is between the planes all the way, or never.
            for axis in (0..3).filter(|&axis| !self.per[axis].is_finite()) {
                let is_between = (low[axis]..=high[axis]).contains(&self.origin[axis]);
                let from = if is_between { f64::NEG_INFINITY } else { f64::INFINITY };
                (to_low[axis], to_high[axis]) = (from, f64::INFINITY);
            }
        }
        let enter = to_low.min(to_high).max_element().max(0.0);
        let leave = to_low.max(to_high).min_element();
        if enter <= leave { enter as f32 } else { f32::INFINITY }
    }
}

fn squared_distance(node: &BvhNode, query: Vec3A) -> f32 {
    let (low, high) = (Vec3A::from(node.mins()), Vec3A::from(node.maxs()));
    (low - query).max(query - high).max(Vec3A::ZERO).length_squared()
}

/// Whether queries come in an order in which each lies near its predecessor, as the nodes of rings do: on average within a
/// few of the distances that so many would have if they lay on a plane as large as their bounding box.
fn are_neighbours(queries: &[DVec3]) -> bool {
    const DISTANCES: f64 = 4.0;
    let way = |pair: &[DVec3]| pair[0].distance(pair[1]);
    let mean = queries.windows(2).map(way).sum::<f64>() / queries.len() as f64;
    let low = queries.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = queries.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    mean < DISTANCES * low.distance(high) / (queries.len() as f64).sqrt()
}

/// The queries in the order of a Morton curve through their bounding box, a thousand cells a side.
fn along_a_curve(queries: &[DVec3]) -> Vec<u32> {
    let low = queries.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = queries.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let scale = f64::from(1 << 10) / (high - low).max_element();
    // A cell above, a query below.
    let mut keyed: Vec<u64> = (0u64..)
        .zip(queries)
        .map(|(k, &q)| {
            // Casts saturate, and numbers that are not finite become 0 or the far end: the order affects speed only.
            let [x, y, z] =
                ((q - low) * scale).to_array().map(|x| every_third_bit((x as u64).min((1 << 10) - 1)));
            (x | y << 1 | z << 2) << 32 | k
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|key| key as u32).collect()
}

/// Spreads the low 10 bits over every third bit.
fn every_third_bit(x: u64) -> u64 {
    let x = (x | x << 16) & 0x0300_00ff;
    let x = (x | x << 8) & 0x0300_f00f;
    let x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Triangles anywhere in a cube of edge 2, each twice.
    fn triangles(count: u32) -> Surface {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut coordinate = || 2.0 * rng.random::<f64>() - 1.0;
        let nodes_mm =
            (0..3 * count).map(|_| DVec3::from_array(std::array::from_fn(|_| coordinate()))).collect();
        let of_node = |t: u32| [3 * t, 3 * t + 1, 3 * t + 2];
        Surface {
            nodes_mm,
            triangles: (0..2 * count).map(|t| of_node(t % count)).collect(),
            arrays: Vec::new(),
        }
    }

    #[test]
    fn a_ray_meets_the_first_triangle_whichever_is_likely() {
        let surface = triangles(40);
        let caster = RayCaster::new(&surface).unwrap();
        let mut met = 0;
        for k in 0..60 {
            let (sin, cos) = (f64::from(k) * 0.7).sin_cos();
            let (origin, direction) =
                (DVec3::new(-1.5 * cos, -1.5 * sin, 0.01 * f64::from(k)), DVec3::new(cos, sin, 0.1));
            for range in [1.2, 4.0] {
                let all =
                    (0..40).filter_map(|t| Some((ray_meets(origin, direction, surface.corners_mm(t))?, t)));
                let first = all.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(distance, _)| *distance < range);
                let expected = first.map(|(distance, t)| (t as u32, distance));
                met += usize::from(expected.is_some());
                assert_eq!(caster.cast(origin, direction, range), expected);
                for likely in 0..41 {
                    assert_eq!(
                        caster.cast_from(Some(likely), origin, direction, range),
                        expected,
                        "{likely}"
                    );
                }
            }
        }
        assert!(met > 30, "{met}");
    }

    /// More triangles than one part has, and small ones, so that parts are apart.
    #[test]
    fn what_lies_in_several_parts_is_found_as_in_one_list() {
        let mut surface = triangles(3 * Part::MOST as u32);
        surface.triangles.truncate(3 * Part::MOST);
        for corners in surface.nodes_mm.chunks_exact_mut(3) {
            let at = corners[0];
            corners[1..].iter_mut().for_each(|p| *p = at + 0.03 * (*p - at));
        }
        let locator = Locator::new(&surface).unwrap();
        assert!(locator.triangles.boxes.parts.len() >= 4);
        let mut met = 0;
        for k in 0..40 {
            let (sin, cos) = (f64::from(k) * 0.7).sin_cos();
            let (origin, direction) =
                (DVec3::new(0.9 * cos, 0.9 * sin, 0.02 * f64::from(k)), DVec3::new(-sin, cos, 0.0));
            let all = || 0..surface.triangles.len();
            let meets = |t| Some((ray_meets(origin, direction, surface.corners_mm(t))?, t as u32));
            let first = all().filter_map(meets).min_by(|a, b| a.0.total_cmp(&b.0));
            met += usize::from(first.is_some());
            assert_eq!(locator.cast(origin, direction, 9.0), first.map(|(distance, t)| (t, distance)));
            let distance = |t| origin.distance(closest_on_triangle(origin, surface.corners_mm(t)).0);
            let least = all().map(distance).fold(f64::INFINITY, f64::min);
            assert_eq!(locator.closest(origin).distance_mm, least);
        }
        assert!(met > 10, "{met}");
    }
}
