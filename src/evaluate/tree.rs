//! A tree of bounding boxes over triangles, eight children to a branch and four triangles to a leaf, so that one query
//! meets a branch's boxes, or a leaf's triangles, side by side in vector registers.
//!
//! Boxes are in single precision and a little too large, triangles in double: which triangle is nearest is decided in
//! double precision alone. `benches/distance.rs` has this against parry3d, whose binary tree is the reason for an own
//! one: in double precision it takes longer per query than in single.

use glam::DVec3;

const BRANCHING: usize = 8;
const LEAF: usize = 4;

/// Set in a child's number where it is a leaf.
const IS_LEAF: u32 = 1 << 31;
const NO_CHILD: u32 = u32::MAX;

/// Share of the surface's size by which boxes are too large: the rounding to single precision of coordinates up to four
/// times that size from its centre is a quarter of it.
const BOX_SLACK: f64 = 1e-6;
/// Share by which a bound in single precision is too large: beyond four times the size, rounding is relative to the
/// distance, and below this by a factor of four.
const BOUND_SLACK: f32 = 1.0 + 4e-6;

/// Child boxes by axis and child.
#[repr(align(64))]
struct Branch {
    low: [[f32; BRANCHING]; 3],
    high: [[f32; BRANCHING]; 3],
    children: [u32; BRANCHING],
}

/// Corners by axis and lane; lanes to spare repeat the first triangle. No more than that: waiting for memory takes
/// longer than working out normals and lengths anew.
#[repr(align(64))]
#[derive(Default)]
struct Leaf {
    a: [[f64; LEAF]; 3],
    b: [[f64; LEAF]; 3],
    c: [[f64; LEAF]; 3],
    triangles: [u32; LEAF],
}

/// Where a triangle is: its leaf and its lane in it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slot {
    leaf: u32,
    lane: u32,
}

/// Children to visit yet and their squared distances, kept from query to query for its memory.
pub(super) type Stack = Vec<(f32, u32)>;

pub(super) struct Tree {
    centre: DVec3,
    size: f64,
    branches: Vec<Branch>,
    leaves: Vec<Leaf>,
}

impl Tree {
    /// At least one triangle, each with an area.
    pub(super) fn new(corners: &[[DVec3; 3]]) -> Self {
        let low = corners.iter().flatten().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = corners.iter().flatten().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let centre = low.midpoint(high);
        let mut tree = Self { centre, size: low.distance(high), branches: Vec::new(), leaves: Vec::new() };
        let centroids: Vec<DVec3> = corners.iter().map(|[a, b, c]| *a + *b + *c).collect();
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        tree.grow(corners, &centroids, &mut order);
        tree
    }

    /// Adds the branch over these triangles and all below it; gives its number.
    fn grow(&mut self, corners: &[[DVec3; 3]], centroids: &[DVec3], triangles: &mut [u32]) -> u32 {
        let number = self.branches.len();
        self.branches.push(Branch {
            low: [[f32::INFINITY; BRANCHING]; 3],
            high: [[f32::NEG_INFINITY; BRANCHING]; 3],
            children: [NO_CHILD; BRANCHING],
        });
        let mut groups = vec![triangles];
        while groups.len() < BRANCHING && groups.iter().any(|group| group.len() > LEAF) {
            groups = groups.into_iter().flat_map(|group| halves(centroids, group)).collect();
        }
        for (k, group) in groups.into_iter().enumerate() {
            let members = || group.iter().flat_map(|&t| corners[t as usize]);
            let low = members().fold(DVec3::INFINITY, DVec3::min) - self.centre - BOX_SLACK * self.size;
            let high = members().fold(DVec3::NEG_INFINITY, DVec3::max) - self.centre + BOX_SLACK * self.size;
            let child = if group.len() <= LEAF {
                self.leaves.push(Leaf::new(corners, group));
                (self.leaves.len() - 1) as u32 | IS_LEAF
            } else {
                self.grow(corners, centroids, group)
            };
            let branch = &mut self.branches[number];
            for axis in 0..3 {
                branch.low[axis][k] = low[axis] as f32;
                branch.high[axis][k] = high[axis] as f32;
            }
            branch.children[k] = child;
        }
        number as u32
    }

    /// The corners of a triangle, mm.
    #[inline(always)]
    pub(super) fn corners_mm(&self, slot: Slot) -> [DVec3; 3] {
        let (leaf, lane) = (&self.leaves[slot.leaf as usize], slot.lane as usize % LEAF);
        let of = |v: &[[f64; LEAF]; 3]| DVec3::new(v[0][lane], v[1][lane], v[2][lane]);
        [of(&leaf.a), of(&leaf.b), of(&leaf.c)]
    }

    /// Its number.
    #[inline(always)]
    pub(super) fn triangle(&self, slot: Slot) -> usize {
        self.leaves[slot.leaf as usize].triangles[slot.lane as usize % LEAF] as usize
    }

    /// The nearest triangle, of equally near ones the one with the lowest number, so that it does not depend on `near`:
    /// the squared distance of some triangle.
    #[inline(always)]
    pub(super) fn nearest(&self, query: DVec3, near: f64, stack: &mut Stack) -> Option<Slot> {
        // Room for the last bits, in which a leaf's own formula may differ.
        let mut best = near * (1.0 + 1e-9) + (1e-13 * self.size).powi(2);
        let mut found = None;
        let q = (query - self.centre).as_vec3().to_array();
        stack.clear();
        let mut bound = best as f32 * BOUND_SLACK;
        let mut next = 0;
        loop {
            if next & IS_LEAF == 0 {
                let branch = &self.branches[next as usize];
                let distances = branch.squared_distances(q);
                let first = stack.len();
                for (&child, distance) in branch.children.iter().zip(distances) {
                    if distance <= bound && child != NO_CHILD {
                        // Nearest last, to be taken first.
                        let mut at = stack.len();
                        stack.push((distance, child));
                        while at > first && stack[at - 1].0 < distance {
                            stack.swap(at, at - 1);
                            at -= 1;
                        }
                    }
                }
            } else {
                let number = next & !IS_LEAF;
                let leaf = &self.leaves[number as usize];
                let distances = leaf.squared_distances(query.to_array());
                for (lane, distance) in (0..).zip(distances) {
                    let slot = Slot { leaf: number, lane };
                    let lower = |other| self.triangle(slot) < self.triangle(other);
                    if distance < best || (distance == best && found.is_none_or(lower)) {
                        (best, found) = (distance, Some(slot));
                        bound = best as f32 * BOUND_SLACK;
                    }
                }
            }
            loop {
                match stack.pop() {
                    Some((distance, child)) if distance <= bound => {
                        next = child;
                        break;
                    }
                    Some(_) => {}
                    None => return found,
                }
            }
        }
    }
}

/// Two halves along the longest side of their centroids' box, the first a whole number of leaves.
fn halves<'a>(centroids: &[DVec3], group: &'a mut [u32]) -> Vec<&'a mut [u32]> {
    if group.len() <= LEAF {
        return vec![group];
    }
    let at = |t: u32| centroids[t as usize];
    let low = group.iter().fold(DVec3::INFINITY, |low, &t| low.min(at(t)));
    let high = group.iter().fold(DVec3::NEG_INFINITY, |high, &t| high.max(at(t)));
    let axis = (high - low).max_position();
    let middle = (group.len() / 2).next_multiple_of(LEAF).min(group.len() - 1);
    group.select_nth_unstable_by(middle, |&s, &t| at(s)[axis].total_cmp(&at(t)[axis]).then(s.cmp(&t)));
    let (low, high) = group.split_at_mut(middle);
    vec![low, high]
}

impl Branch {
    #[inline(always)]
    fn squared_distances(&self, q: [f32; 3]) -> [f32; BRANCHING] {
        let mut sum = [0.0; BRANCHING];
        for ((low, high), q) in self.low.iter().zip(&self.high).zip(q) {
            for ((sum, low), high) in sum.iter_mut().zip(low).zip(high) {
                let (below, above) = (low - q, q - high);
                let outside = if below > above { below } else { above };
                let outside = if outside > 0.0 { outside } else { 0.0 };
                *sum += outside * outside;
            }
        }
        sum
    }
}

impl Leaf {
    fn new(corners: &[[DVec3; 3]], group: &[u32]) -> Self {
        let mut leaf = Self::default();
        for lane in 0..LEAF {
            let triangle = group.get(lane).copied().unwrap_or(group[0]);
            let [a, b, c] = corners[triangle as usize];
            for axis in 0..3 {
                leaf.a[axis][lane] = a[axis];
                leaf.b[axis][lane] = b[axis];
                leaf.c[axis][lane] = c[axis];
            }
            leaf.triangles[lane] = triangle;
        }
        leaf
    }

    /// To the plane where the foot of the perpendicular lies inside, else the least to a side: without a branch, so that
    /// the lanes stay together.
    #[inline(always)]
    fn squared_distances(&self, q: [f64; 3]) -> [f64; LEAF] {
        let mut squared = [0.0; LEAF];
        for (lane, squared) in squared.iter_mut().enumerate() {
            let of = |v: &[[f64; LEAF]; 3]| [v[0][lane], v[1][lane], v[2][lane]];
            let dot = |u: [f64; 3], v: [f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
            let less = |u: [f64; 3], t: f64, v: [f64; 3]| [u[0] - t * v[0], u[1] - t * v[1], u[2] - t * v[2]];
            let at_most = |x: f64, y: f64| if x < y { x } else { y };
            let share = |x: f64| if x > 0.0 { at_most(x, 1.0) } else { 0.0 };
            let (a, b, c) = (of(&self.a), of(&self.b), of(&self.c));
            let (ab, ac, bc) = (less(b, 1.0, a), less(c, 1.0, a), less(c, 1.0, b));
            let (ap, bp) = (less(q, 1.0, a), less(q, 1.0, b));
            let (p1, p2) = (dot(ap, ab), dot(ap, ac));
            let (g11, g12, g22) = (dot(ab, ab), dot(ab, ac), dot(ac, ac));
            let to_side = |p: [f64; 3], along: f64, side: [f64; 3], length: f64| {
                let rest = less(p, share(along / length), side);
                dot(rest, rest)
            };
            let sides = at_most(
                at_most(to_side(ap, p1, ab, g11), to_side(ap, p2, ac, g22)),
                to_side(bp, dot(bp, bc), bc, dot(bc, bc)),
            );
            // Barycentric coordinates, but for a positive factor.
            let v = g22 * p1 - g12 * p2;
            let w = g11 * p2 - g12 * p1;
            let u = (g11 * g22 - g12 * g12) - v - w;
            let normal =
                [ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]];
            let height = dot(ap, normal);
            let inside = (v >= 0.0) & (w >= 0.0) & (u >= 0.0);
            let to_plane = height * height / dot(normal, normal);
            *squared = if inside { at_most(to_plane, sides) } else { sides };
        }
        squared
    }
}
