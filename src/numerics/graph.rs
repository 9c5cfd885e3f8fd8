//! Points near a place, and the shortest paths between points that are connected.

use glam::{DVec3, I64Vec3};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

/// Points by the cube of space that they lie in, so that those near a place are found without looking at all.
pub(crate) struct Places {
    edge_mm: f64,
    cubes: HashMap<I64Vec3, Vec<usize>>,
}

impl Places {
    pub(crate) fn new(edge_mm: f64) -> Self {
        Self { edge_mm, cubes: HashMap::new() }
    }

    fn cube(&self, point_mm: DVec3) -> I64Vec3 {
        // Where the edge is so short that cubes have no number, they share the last one.
        const FARTHEST: DVec3 = DVec3::splat(1e15);
        (point_mm / self.edge_mm).floor().clamp(-FARTHEST, FARTHEST).as_i64vec3()
    }

    /// Adds a point.
    pub(crate) fn add(&mut self, number: usize, point_mm: DVec3) {
        self.cubes.entry(self.cube(point_mm)).or_default().push(number);
    }

    /// All points within an edge of a place, and some more.
    pub(crate) fn near(&self, point_mm: DVec3) -> impl Iterator<Item = usize> + '_ {
        let home = self.cube(point_mm);
        let around = (0..27).map(move |k| home + I64Vec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1));
        around.filter_map(|cube| self.cubes.get(&cube)).flatten().copied()
    }
}

/// A point that Dijkstra's algorithm may settle next: the nearest first, then the lowest number.
#[derive(PartialEq)]
struct Reached {
    distance_mm: f64,
    point: usize,
}

impl Eq for Reached {}

impl Ord for Reached {
    fn cmp(&self, other: &Self) -> Ordering {
        // A heap gives the greatest first.
        other.distance_mm.total_cmp(&self.distance_mm).then(other.point.cmp(&self.point))
    }
}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Dijkstra's algorithm: the distance of each point from the nearest of `starts`, and its predecessor on the way from there.
pub(crate) fn shortest_paths(
    points_mm: &[DVec3],
    neighbours: &[Vec<usize>],
    starts: &[usize],
) -> (Vec<f64>, Vec<Option<usize>>) {
    let count = points_mm.len();
    let (mut distance, mut before) = (vec![f64::INFINITY; count], vec![None; count]);
    let mut settled = vec![false; count];
    starts.iter().for_each(|&start| distance[start] = 0.0);
    let mut open: BinaryHeap<Reached> =
        starts.iter().map(|&point| Reached { distance_mm: 0.0, point }).collect();
    while let Some(Reached { point: here, .. }) = open.pop() {
        if std::mem::replace(&mut settled[here], true) {
            continue;
        }
        for &next in &neighbours[here] {
            let through = distance[here] + points_mm[here].distance(points_mm[next]);
            if through < distance[next] {
                distance[next] = through;
                before[next] = Some(here);
                open.push(Reached { distance_mm: through, point: next });
            }
        }
    }
    (distance, before)
}
