use super::{MergedVessel, VesselRing};
use crate::cylinders::fit::FittedCylinder;
use crate::geometry::{Pose, transported};
use glam::{DMat3, DVec2, DVec3, Vec3Swizzles};
use std::f64::consts::TAU;

/// One vessel from successive cylinders, the mean of those that overlap (`docs/method.md`, "Merging").
///
/// Rings lie along the origins of the cylinders, one level's height apart. A ray runs from a ring's middle through each
/// of its nodes; its intersection with a cylinder's wall is that cylinder's contribution to the node. The contribution is
/// weighted by the points that support the wall there and by a factor that falls to zero at the cylinder's ends. Cylinders
/// can be added in any order and anywhere along the vessel; each changes only the rings that it overlaps.
///
/// All cylinders have the same number of nodes per ring.
#[derive(Debug, Clone, Default)]
pub struct Blend {
    stations: Vec<Station>,
}

/// A ring with the sums of the contributions to its nodes.
#[derive(Debug, Clone)]
struct Station {
    /// The last frame whose cylinder contributed to it.
    frame: usize,
    /// Its axes: nodes lie in the plane of x and y, the first on x; z points along the vessel.
    world_from_ring: Pose,
    /// Largest radius of a node, mm: farther out, the planes of neighbouring rings cross.
    reach_mm: f64,
    /// Sums of the contributions, one per node.
    sums: Vec<Sums>,
}

/// Weighted sums over intersections with the walls of cylinders.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    weight: f64,
    radius_mm: f64,
    support: f64,
    residual_mm: f64,
}

/// Smallest radius of a bend, in lumen radii: rings do not cross nearer than that, and the published gate excludes points
/// farther out.
const TIGHTEST_BEND_RADII: f64 = 1.5;
/// An end of the vessel farther than this from the axis of a later cylinder, in radii, is removed.
const BESIDE_RADII: f64 = 0.5;
/// Weight of a node with points whose neighbours have none: half of its triangles are interpolated.
const HALF_SEEN: f64 = 0.01;
/// Smallest sin² of the angle between a ray and a cylinder's axis: a ray along the wall does not locate it.
const MIN_SINE_SQUARED: f64 = 0.25;
/// Fixed-point iterations of the intersection: for walls with a slope below 1:2 against the axis they reduce the error of
/// the first guess to 2 %.
const RAY_STEPS: usize = 6;

impl Blend {
    /// Adds a cylinder with the given radii: its last ones, or those of another iteration.
    ///
    /// A cylinder beside the vessel, as in a branch that is entered later, does not contribute.
    pub fn append(&mut self, cylinder: &FittedCylinder, radii_mm: &[f64]) {
        let Some(wall) = CylinderWall::new(cylinder, radii_mm) else { return };
        if self.stations.is_empty() {
            self.stations.push(wall.first_station());
        }
        let origin = wall.on_axis(0.0);
        let squared = |s: &Station| s.world_from_ring.translation_mm.distance_squared(origin);
        let order = |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1);
        let nearest = self.stations.iter().map(squared).enumerate().min_by(order).map_or(0, |(at, _)| at);
        let nearest = self.trim_ends(nearest, &wall);
        let (last, _) = self.extend(nearest, &wall, true);
        let (first, laid) = self.extend(nearest, &wall, false);
        self.stations[first..=last + laid].iter_mut().for_each(|station| wall.contribute_to(station));
    }

    /// Removes rings at the ends near ring `nearest` that lie beside the cylinder: a bent tip or the mouth of a branch led
    /// them away from the vessel. Returns the new index of `nearest`.
    fn trim_ends(&mut self, mut nearest: usize, wall: &CylinderWall) -> usize {
        let near = wall.near_rings();
        while self.stations.len() > 1
            && self.stations.len() - nearest <= near
            && self.stations.last().is_some_and(|end| wall.is_beside(end))
        {
            self.stations.pop();
            nearest = nearest.min(self.stations.len() - 1);
        }
        while self.stations.len() > 1
            && nearest < near
            && self.stations.first().is_some_and(|end| wall.is_beside(end))
        {
            self.stations.remove(0);
            nearest = nearest.saturating_sub(1);
        }
        nearest
    }

    /// Adds rings from the end of the vessel near ring `nearest`, or from the edge of a gap, to the cylinder's origin.
    /// Returns the farthest ring that the cylinder can overlap and the number of rings added.
    fn extend(&mut self, nearest: usize, wall: &CylinderWall, forward: bool) -> (usize, usize) {
        let sense = if forward { 1.0 } else { -1.0 };
        let (mut at, mut laid) = (nearest, 0);
        for _ in 0..wall.near_rings() {
            let Pose { rotation, translation_mm: middle_mm } = self.stations[at].world_from_ring;
            let next = if forward { at.checked_add(1) } else { at.checked_sub(1) };
            let next = next.and_then(|next| self.stations.get(next).map(|s| (next, s)));
            let room_mm =
                next.map_or(f64::INFINITY, |(_, s)| s.world_from_ring.translation_mm.distance(middle_mm));
            if let Some((next, _)) = next.filter(|_| room_mm < 1.5 * wall.step_mm()) {
                at = next;
                continue;
            }
            // Away from the vessel, along the cylinder.
            let along = if wall.axis().dot(rotation.z_axis) < 0.0 { -sense } else { sense };
            let z = along * wall.from_world.transform_point(middle_mm).x;
            let [low, high] = wall.seen_along(along);
            let step_mm = wall.step_mm().max(low - z);
            if step_mm > room_mm || z + step_mm > high.min(wall.step_mm() / 2.0) {
                break;
            }
            // Direction of the vessel over its last half radius and on to the origin: more reliable than the axis of one
            // cylinder.
            let back = (wall.radius_mm() / 2.0 / wall.step_mm()).round() as usize;
            let from =
                if forward { at.saturating_sub(back) } else { (at + back).min(self.stations.len() - 1) };
            let way = (wall.on_axis(0.0) - self.stations[from].world_from_ring.translation_mm) * sense;
            let max_rad = (step_mm / (TIGHTEST_BEND_RADII * wall.radius_mm())).atan();
            let heading = turned(rotation.z_axis, way, max_rad);
            let chord = heading * sense * step_mm;
            let mut station = wall.station(Pose {
                rotation: transported(&rotation, chord, heading),
                translation_mm: middle_mm + chord,
            });
            let turn = heading.angle_between(rotation.z_axis);
            station.reach_mm = if turn > 1e-9 { step_mm / turn.tan() } else { f64::INFINITY };
            let here = &mut self.stations[at];
            here.reach_mm = here.reach_mm.min(station.reach_mm);
            at += usize::from(forward);
            self.stations.insert(at, station);
            laid += 1;
        }
        (at, laid)
    }

    /// The current vessel: the rings of which at least half of the nodes have contributions.
    ///
    /// `support` of a node is the mean number of points that support it in the cylinders, at least 1. Nodes without a
    /// contribution have 0 and lie on the circle that fits the others best.
    pub fn vessel(&self) -> MergedVessel {
        MergedVessel {
            rings: self.stations.iter().filter_map(Station::ring).collect(),
            ..MergedVessel::default()
        }
    }
}

impl Station {
    /// The ring; `None` where fewer than half of its nodes have contributions.
    fn ring(&self) -> Option<VesselRing> {
        let count = self.sums.len();
        let seen = |j: usize| Some(self.sums[j]).filter(|sums| sums.weight > 0.0);
        if 2 * (0..count).filter(|&j| seen(j).is_some()).count() < count {
            return None;
        }
        let radius_mm = |sums: &Sums| sums.radius_mm / sums.weight;
        let circle =
            Circle::through((0..count).filter_map(|j| Some(ray(count, j).xy() * radius_mm(&seen(j)?))))?;
        let nodes_mm = (0..count).map(|j| {
            let ray = ray(count, j);
            let radius_mm = seen(j).map_or_else(|| circle.radius_along(ray.xy()), |sums| radius_mm(&sums));
            self.world_from_ring.transform_point(ray * radius_mm)
        });
        Some(VesselRing {
            frame: self.frame,
            nodes_mm: nodes_mm.collect(),
            support: (0..count)
                .map(|j| seen(j).map_or(0, |s| (s.support / s.weight).round().max(1.0) as u32))
                .collect(),
            residual_mm: (0..count).map(|j| seen(j).map_or(f64::NAN, |s| s.residual_mm / s.weight)).collect(),
        })
    }
}

/// A circle that encloses the origin.
struct Circle {
    middle: DVec2,
    radius: f64,
}

impl Circle {
    /// The circle with the least Σ (|p − middle|² − radius²)² (Kåsa, *A circle fitting procedure and its error
    /// analysis*, IEEE Transactions on Instrumentation and Measurement 25(1), 1976); `None` where the origin is not
    /// within it.
    fn through(points: impl Iterator<Item = DVec2>) -> Option<Self> {
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for p in points {
            let row = DVec3::new(2.0 * p.x, 2.0 * p.y, 1.0);
            matrix += DMat3::from_cols(row * row.x, row * row.y, row);
            right += row * p.length_squared();
        }
        let solution = matrix.inverse() * right;
        let radius = (solution.z + solution.xy().length_squared()).sqrt();
        (solution.is_finite() && solution.z > 0.0).then_some(Self { middle: solution.xy(), radius })
    }

    /// Distance from the origin to the circle along a unit direction.
    fn radius_along(&self, direction: DVec2) -> f64 {
        let across = direction.perp_dot(self.middle);
        direction.dot(self.middle) + (self.radius * self.radius - across * across).max(0.0).sqrt()
    }
}

/// The direction of node j in its ring's axes.
fn ray(count: usize, j: usize) -> DVec3 {
    DVec2::from_angle(TAU * j as f64 / count as f64).extend(0.0)
}

/// The unit vector `from`, turned towards `to` by at most an angle below a quarter turn.
fn turned(from: DVec3, to: DVec3, max_rad: f64) -> DVec3 {
    let Some(to) = to.try_normalize() else { return from };
    if from.dot(to) >= max_rad.cos() {
        return to;
    }
    let across = to.reject_from_normalized(from).normalize_or_zero();
    (from * max_rad.cos() + across * max_rad.sin()).normalize()
}

/// The wall of one cylinder.
struct CylinderWall<'a> {
    cylinder: &'a FittedCylinder,
    radii_mm: &'a [f64],
    from_world: Pose,
    /// Range along the axis in which points support at least half of a ring, mm.
    seen_mm: [f64; 2],
    /// Per node: smallest support of the node and its neighbours.
    certainty: Vec<f64>,
}

impl<'a> CylinderWall<'a> {
    /// `None` where no ring is supported by points.
    fn new(cylinder: &'a FittedCylinder, radii_mm: &'a [f64]) -> Option<Self> {
        let (tube, support) = (&cylinder.tube.tube, &cylinder.tube.support);
        let rings = 0..=tube.levels;
        let seen = |ring: &usize| {
            let row = &support[ring * tube.nodes..(ring + 1) * tube.nodes];
            2 * row.iter().filter(|&&n| n > 0).count() >= tube.nodes
        };
        let seen_mm =
            [rings.clone().find(seen)?, rings.clone().rfind(seen)?].map(|ring| tube.ring_z_mm(ring));
        let least = |ring: usize, j: usize| {
            let about = ring.saturating_sub(1)..=(ring + 1).min(tube.levels);
            let columns = [tube.previous(j), j, tube.next(j)];
            about.flat_map(|r| columns.map(|k| support[r * tube.nodes + k])).min().map_or(0.0, f64::from)
        };
        Some(Self {
            cylinder,
            radii_mm,
            from_world: cylinder.world_from_cylinder.inverse(),
            seen_mm,
            certainty: rings.flat_map(|ring| (0..tube.nodes).map(move |j| least(ring, j))).collect(),
        })
    }

    fn axis(&self) -> DVec3 {
        self.cylinder.world_from_cylinder.rotation.x_axis
    }

    fn radius_mm(&self) -> f64 {
        self.cylinder.tube.radius_mm
    }

    /// From ring to ring.
    fn step_mm(&self) -> f64 {
        self.cylinder.tube.tube.height_mm / self.cylinder.tube.tube.levels as f64
    }

    /// Rings of the vessel along a cylinder, tilted ones included.
    fn near_rings(&self) -> usize {
        2 * self.cylinder.tube.tube.levels
    }

    /// `seen_mm`, with z along the axis or against it.
    fn seen_along(&self, sense: f64) -> [f64; 2] {
        let [low, high] = self.seen_mm;
        if sense > 0.0 { [low, high] } else { [-high, -low] }
    }

    /// A place on the axis, in the world.
    fn on_axis(&self, z_mm: f64) -> DVec3 {
        self.cylinder.world_from_cylinder.transform_point(DVec3::new(z_mm, 0.0, 0.0))
    }

    /// The level at a height, and the position in it, from 0 to 1.
    fn level(&self, z_mm: f64) -> (usize, f64) {
        let tube = &self.cylinder.tube.tube;
        let levels = tube.levels as f64;
        let u = ((z_mm / tube.height_mm + 0.5) * levels).clamp(0.0, levels);
        let level = (u as usize).min(tube.levels - 1);
        (level, u - level as f64)
    }

    /// A ring without contributions.
    fn station(&self, world_from_ring: Pose) -> Station {
        let sums = vec![Sums::default(); self.cylinder.tube.tube.nodes];
        Station { frame: self.cylinder.frame, world_from_ring, reach_mm: f64::INFINITY, sums }
    }

    /// A ring in the plane of the cylinder's rings, at its origin.
    fn first_station(&self) -> Station {
        let DMat3 { x_axis, y_axis, z_axis } = self.cylinder.world_from_cylinder.rotation;
        let rotation = DMat3::from_cols(-z_axis, y_axis, x_axis);
        self.station(Pose { rotation, translation_mm: self.on_axis(0.0) })
    }

    /// Whether a ring within the supported range lies far from the axis.
    fn is_beside(&self, station: &Station) -> bool {
        let middle = station.world_from_ring.translation_mm;
        let z = self.from_world.transform_point(middle).x;
        (self.seen_mm[0]..=self.seen_mm[1]).contains(&z)
            && self.on_axis(z).distance(middle) > BESIDE_RADII * self.radius_mm()
    }

    /// Adds the contributions of this wall to the nodes of a ring.
    fn contribute_to(&self, station: &mut Station) {
        let cylinder_from_ring = self.from_world * station.world_from_ring;
        let count = station.sums.len();
        for (j, sums) in station.sums.iter_mut().enumerate() {
            let ray = cylinder_from_ring.rotation * ray(count, j);
            if let Some(found) = self.intersection(cylinder_from_ring.translation_mm, ray, station.reach_mm) {
                sums.add(1.0, &found);
                station.frame = self.cylinder.frame;
            }
        }
    }

    /// Intersection of a ray from inside, given in {cyl}, with the wall; `radius_mm` is its length along the ray. `None`
    /// where no point supports the wall, and beyond the cylinder's ends.
    fn intersection(&self, from: DVec3, ray: DVec3, reach_mm: f64) -> Option<Sums> {
        let (across, offset) = (ray.yz(), from.yz());
        let a = across.length_squared();
        if a < MIN_SINE_SQUARED {
            return None;
        }
        let b = across.dot(offset);
        let (mut wall, mut length_mm) =
            (Sums { weight: 1.0, radius_mm: self.radius_mm(), ..Sums::default() }, 0.0);
        for _ in 0..RAY_STEPS {
            // Intersection with the round tube of that radius.
            let radius_mm = wall.radius_mm / wall.weight;
            let c = offset.length_squared() - radius_mm * radius_mm;
            if c >= 0.0 {
                return None;
            }
            length_mm = ((b * b - a * c).sqrt() - b) / a;
            let p = from + ray * length_mm;
            wall = self.at(p.y.atan2(-p.z), p.x)?;
        }
        let z_mm = from.x + ray.x * length_mm;
        // The weight falls to zero over the last level, so that the vessel has no step where a cylinder ends. It is
        // smaller for rays that meet the wall at a slant, which locate it less precisely.
        let fade = ((self.cylinder.tube.tube.height_mm / 2.0 - z_mm.abs()) / self.step_mm()).min(1.0);
        if fade <= 0.0 || length_mm > reach_mm {
            return None;
        }
        let mut found = Sums::default();
        found.add(fade * a, &Sums { radius_mm: length_mm * wall.weight, ..wall });
        Some(found)
    }

    /// The wall at an angle and a height, linear between nodes; heights beyond an end are clamped to it. `None` without
    /// points.
    fn at(&self, theta_rad: f64, z_mm: f64) -> Option<Sums> {
        let tube = &self.cylinder.tube.tube;
        let (ring, above) = self.level(z_mm);
        let v = (theta_rad / TAU).rem_euclid(1.0) * tube.nodes as f64;
        let (j, beside) = (v as usize % tube.nodes, v.fract());
        let (mut certainty, mut radius_mm, mut half_seen) = (0.0, 0.0, Sums::default());
        for (ring, above) in [(ring, 1.0 - above), (ring + 1, above)] {
            for (j, beside) in [(j, 1.0 - beside), (tube.next(j), beside)] {
                let (node, share) = (ring * tube.nodes + j, above * beside);
                certainty += share * self.certainty[node];
                radius_mm += share * self.radii_mm[node];
                let points = self.cylinder.tube.support[node];
                if points > 0 {
                    let support = f64::from(points);
                    let residual_mm = self.cylinder.tube.residual_mm[node];
                    let one = Sums { weight: 1.0, radius_mm: self.radii_mm[node], support, residual_mm };
                    half_seen.add(share * support, &one);
                }
            }
        }
        // The interpolated wall where all neighbours have points, else the mean of the nodes that have some.
        let mut wall = Sums::default();
        wall.add(HALF_SEEN + certainty / half_seen.weight, &half_seen);
        wall.radius_mm = HALF_SEEN * half_seen.radius_mm + certainty * radius_mm;
        (half_seen.weight > 0.0).then_some(wall)
    }
}

impl Sums {
    fn add(&mut self, weight: f64, other: &Self) {
        self.weight += weight * other.weight;
        self.radius_mm += weight * other.radius_mm;
        self.support += weight * other.support;
        self.residual_mm += weight * other.residual_mm;
    }
}
