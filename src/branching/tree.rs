//! Which branches a catheter visited, and which frames belong to each.
//!
//! The centres of the contours lie in the lumen, so a branch that was entered shows as centres outside the lumen that is
//! known from the others. Centres are grouped into clusters whose size follows the lumen's, and clusters that touch are
//! connected. The longest of all shortest paths is the first part of a tree; as long as some cluster lies outside the lumen
//! about the tree, its shortest path to the tree is added. Where three arms or more meet, the two that continue each other
//! best, by direction and size, become one branch and the others end.

use crate::geometry::Pose;
use crate::geometry::polyline::Searched;
use crate::numerics::graph::{Places, shortest_paths};
use crate::numerics::robust::median;
use crate::recording::Frame;
use crate::sweep::{Axis, Outlines};
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

/// Radius of a cluster, and the distance at which two clusters touch, in lumen radii. Lumens that are apart have centres two
/// radii apart or more.
const CLUSTER_RADII: f64 = 0.7;
const TOUCH_RADII: f64 = 0.85;
/// Clusters of successive frames that do not touch are connected up to this many lumen radii: the catheter moves without
/// jumps, but a recording may be interrupted.
const STRIDE_RADII: f64 = 2.0;
/// How far outside the lumen about the tree a branch must have been seen, in its own radii, and in how many frames.
const LEAST_DEPTH_RADII: f64 = 1.0;
const LEAST_FRAMES: usize = 3;
/// Directions at a parting are taken over this many lumen radii.
const ARM_RADII: f64 = 2.5;
/// Frames whose centres lie within this share of the lumen about a branch belong to it rather than to branches that end there.
const WITHIN_THROUGH: f64 = 0.75;
/// What it costs, as a cosine, that neither of the two arms comes from the start of the recording.
const AWAY_FROM_START: f64 = 0.5;

/// The branches of a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BranchTree {
    /// The branches; the first is that in which the recording begins, and a branch comes after its parent.
    pub branches: Vec<BranchPath>,
    /// Of each frame: its branch, as a place in `branches`; `None` for a frame whose contour has no centre.
    pub frame_branch: Vec<Option<usize>>,
    /// Paths that were looked at and are no branches.
    pub dismissed: Vec<Dismissed>,
}

/// One branch.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BranchPath {
    /// The branch from which it was entered, as a place in [`BranchTree::branches`]; `None` for the first.
    pub parent: Option<usize>,
    /// Where it meets that, mm; `None` for the first.
    pub parting_mm: Option<DVec3>,
    /// The branches that its first and its last point lie in; `None` at an end of the vessel.
    pub joined: [Option<usize>; 2],
    /// Points of its middle, mm, coarsely.
    pub middle_mm: Vec<DVec3>,
    /// Median radius of the contours at each point, mm.
    pub radii_mm: Vec<f64>,
    /// How far beyond the wall of the branches before it contours were seen, mm; for the first its length.
    pub depth_mm: f64,
    /// Frames that belong to it.
    pub frames: usize,
}

/// A path outside the lumen that was not taken for a branch.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Dismissed {
    /// Where it ends, mm.
    pub tip_mm: DVec3,
    /// How far it lies beyond the wall, mm.
    pub depth_mm: f64,
    /// Frames whose centres lie beyond the wall.
    pub frames: usize,
    /// Why it is none.
    pub reason: String,
}

/// Centre and size of the lumen in one frame.
#[derive(Debug, Clone, Copy)]
struct Sight {
    centre_mm: DVec3,
    radius_mm: f64,
}

/// Sights near each other.
struct Cluster {
    centre_mm: DVec3,
    radius_mm: f64,
    sights: usize,
}

impl BranchTree {
    /// Finds the branches that the frames of a recording lie in. Contours that are not star-shaped about their centres are
    /// left out.
    pub fn of(frames: &[Frame], sensor_from_probe: &Pose) -> Self {
        Self::with_outlines(frames, &Outlines::of(frames), sensor_from_probe)
    }

    /// As [`BranchTree::of`], of frames whose contours have these outlines.
    pub(super) fn with_outlines(frames: &[Frame], outlines: &Outlines, sensor_from_probe: &Pose) -> Self {
        let sights: Vec<Option<Sight>> = frames
            .iter()
            .zip(&outlines.of_frames)
            .map(|(frame, outline)| {
                let outline = outline.as_ref().filter(|outline| outline.is_star_shaped())?;
                let pose = frame.world_from_sensor * *sensor_from_probe;
                let centre_mm = pose.transform_point(outline.centre_mm.extend(0.0));
                (outline.radius_mm > 0.0).then_some(Sight { centre_mm, radius_mm: outline.radius_mm })
            })
            .collect();
        let seen: Vec<Sight> = sights.iter().flatten().copied().collect();
        if seen.is_empty() {
            return Self {
                branches: Vec::new(),
                frame_branch: vec![None; frames.len()],
                dismissed: Vec::new(),
            };
        }
        let clusters = Clusters::of(&seen);
        let (tree, dismissed) = clusters.tree();
        let mut branches = tree.branches(&clusters);
        let middles: Vec<Middle> = branches.iter().map(BranchPath::middle).collect();
        let owner = |sight: &Option<Sight>| sight.as_ref().map(|sight| owner(&branches, &middles, sight));
        let frame_branch: Vec<Option<usize>> = sights.par_iter().map(owner).collect();
        for branch in frame_branch.iter().flatten() {
            branches[*branch].frames += 1;
        }
        Self { branches, frame_branch, dismissed }
    }

    /// Whether there is but one branch.
    pub fn is_single(&self) -> bool {
        self.branches.len() < 2
    }

    /// The frames of a branch, ascending.
    pub fn frames_of(&self, branch: usize) -> Vec<usize> {
        (0..self.frame_branch.len()).filter(|&k| self.frame_branch[k] == Some(branch)).collect()
    }

    /// The tree without one of its branches, whose frames go to its parent, as do the branches that leave it.
    pub(super) fn without(mut self, branch: usize, reason: String) -> Self {
        let gone = self.branches.remove(branch);
        let parent = gone.parent.unwrap_or(0);
        let renumber = |k: usize| if k == branch { parent } else { k - usize::from(k > branch) };
        for other in &mut self.branches {
            other.parent = other.parent.map(renumber);
            other.joined = other.joined.map(|end| end.map(renumber));
        }
        self.frame_branch.iter_mut().for_each(|of| *of = of.map(renumber));
        self.branches[parent].frames += gone.frames;
        self.dismissed.push(Dismissed {
            tip_mm: gone.middle_mm[gone.middle_mm.len() - 1],
            depth_mm: gone.depth_mm,
            frames: gone.frames,
            reason,
        });
        self
    }
}

/// The branch that a frame belongs to: the one whose middle is nearest in lumen radii. Where that ends at another branch, which
/// goes on there, frames within the lumen of the latter belong to it.
fn owner(branches: &[BranchPath], middles: &[Middle], sight: &Sight) -> usize {
    let away: Vec<f64> = middles.iter().map(|middle| middle.radii_away(sight.centre_mm)).collect();
    let mut own = (0..branches.len()).fold(0, |best, k| if away[k] < away[best] { k } else { best });
    let through =
        |own: usize| branches[own].joined.into_iter().flatten().find(|&other| away[other] < WITHIN_THROUGH);
    while let Some(other) = through(own) {
        own = other;
    }
    own
}

impl BranchPath {
    fn middle(&self) -> Middle<'_> {
        Middle::of(&self.middle_mm, &self.radii_mm)
    }

    /// Why it is taken for a branch.
    pub(super) fn reason(&self) -> String {
        match self.parent {
            None => "the recording begins in it".into(),
            Some(parent) => format!(
                "contours lie up to {:.1} mm beyond the wall of branch {parent}, in {} frames",
                self.depth_mm, self.frames
            ),
        }
    }

    /// [`joined`](Self::joined), in the direction of an axis through the branch.
    pub(super) fn joined_along(&self, axis: &Axis) -> [Option<usize>; 2] {
        let (first, last) = (axis.points_mm[0], axis.points_mm[axis.rings() - 1]);
        let [start, end] = [self.middle_mm[0], self.middle_mm[self.middle_mm.len() - 1]];
        let forth = first.distance(start) + last.distance(end);
        let back = first.distance(end) + last.distance(start);
        if back < forth { [self.joined[1], self.joined[0]] } else { self.joined }
    }
}

/// The middle of a branch, or of a path, with the radii of its lumen.
struct Middle<'a> {
    line: Searched<'a>,
    radii_mm: &'a [f64],
}

impl<'a> Middle<'a> {
    fn of(middle_mm: &'a [DVec3], radii_mm: &'a [f64]) -> Self {
        Self { line: Searched::of(middle_mm), radii_mm }
    }

    /// Distance of a point to it, and the radius there, mm.
    fn nearest_mm(&self, point_mm: DVec3) -> [f64; 2] {
        let Some((segment, share, distance_mm)) = self.line.nearest_within(point_mm) else {
            return [f64::INFINITY, self.radii_mm[0]];
        };
        let next = (segment + 1).min(self.radii_mm.len() - 1);
        [distance_mm, self.radii_mm[segment] + share * (self.radii_mm[next] - self.radii_mm[segment])]
    }

    /// How far outside the lumen about it a point lies, mm.
    fn outside_mm(&self, point_mm: DVec3) -> f64 {
        let [distance_mm, radius_mm] = self.nearest_mm(point_mm);
        distance_mm - radius_mm
    }

    /// Distance of a point to it, in the radii there.
    fn radii_away(&self, point_mm: DVec3) -> f64 {
        let [distance_mm, radius_mm] = self.nearest_mm(point_mm);
        distance_mm / radius_mm
    }
}

/// Clusters of sights, and which of them are connected.
struct Clusters {
    all: Vec<Cluster>,
    neighbours: Vec<Vec<usize>>,
    centres_mm: Vec<DVec3>,
}

impl Clusters {
    fn of(seen: &[Sight]) -> Self {
        // A single contour that is far too large must not swallow the vessel.
        let mut radii: Vec<f64> = seen.iter().map(|s| s.radius_mm).collect();
        radii.sort_unstable_by(f64::total_cmp);
        let largest_mm = radii.get(radii.len() * 9 / 10).copied().unwrap_or(1.0) * 1.2;
        let own_mm = |sight: &Sight| CLUSTER_RADII * sight.radius_mm.min(largest_mm);
        let mut places = Places::new(CLUSTER_RADII * largest_mm);
        let mut seeds: Vec<Sight> = Vec::new();
        let mut members: Vec<Vec<Sight>> = Vec::new();
        let mut of_sight = Vec::with_capacity(seen.len());
        for sight in seen {
            let distance = |k: usize| sight.centre_mm.distance(seeds[k].centre_mm);
            let within = |&k: &usize| distance(k) < own_mm(&seeds[k]).min(own_mm(sight) * 1.5);
            let near = places.near(sight.centre_mm).filter(within);
            let nearest = near.min_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
            let cluster = nearest.unwrap_or_else(|| {
                places.add(seeds.len(), sight.centre_mm);
                seeds.push(*sight);
                members.push(Vec::new());
                seeds.len() - 1
            });
            members[cluster].push(*sight);
            of_sight.push(cluster);
        }
        let all: Vec<Cluster> = members
            .iter()
            .map(|members| Cluster {
                centre_mm: members.iter().map(|s| s.centre_mm).sum::<DVec3>() / members.len() as f64,
                radius_mm: median(
                    &mut members.iter().map(|s| s.radius_mm.min(largest_mm)).collect::<Vec<_>>(),
                ),
                sights: members.len(),
            })
            .collect();
        let centres_mm = all.iter().map(|c| c.centre_mm).collect();
        let mut clusters = Self { neighbours: vec![Vec::new(); all.len()], all, centres_mm };
        clusters.connect(&of_sight, largest_mm);
        clusters
    }

    fn apart_radii(&self, a: usize, b: usize) -> f64 {
        let [a, b] = [a, b].map(|k| &self.all[k]);
        a.centre_mm.distance(b.centre_mm) / (a.radius_mm + b.radius_mm)
    }

    fn join(&mut self, a: usize, b: usize) {
        if a != b && !self.neighbours[a].contains(&b) {
            self.neighbours[a].push(b);
            self.neighbours[b].push(a);
        }
    }

    fn connect(&mut self, of_sight: &[usize], largest_mm: f64) {
        let count = self.all.len();
        let mut places = Places::new(2.0 * TOUCH_RADII * largest_mm);
        (0..count).for_each(|k| places.add(k, self.centres_mm[k]));
        for a in 0..count {
            let mut touching: Vec<usize> = places
                .near(self.centres_mm[a])
                .filter(|&b| b > a && self.apart_radii(a, b) < TOUCH_RADII)
                .collect();
            touching.sort_unstable();
            touching.into_iter().for_each(|b| self.join(a, b));
        }
        for pair in of_sight.windows(2) {
            if self.apart_radii(pair[0], pair[1]) < STRIDE_RADII {
                self.join(pair[0], pair[1]);
            }
        }
        self.bridge();
    }

    /// Connects what is still apart by the shortest gaps.
    fn bridge(&mut self) {
        loop {
            let distances = shortest_paths(&self.centres_mm, &self.neighbours, &[0]).0;
            let (here, there): (Vec<usize>, Vec<usize>) =
                (0..self.all.len()).partition(|&k| distances[k].is_finite());
            let gaps = there.par_iter().filter_map(|&b| {
                let gap = |a: usize| self.centres_mm[a].distance_squared(self.centres_mm[b]);
                let a = here.iter().copied().min_by(|&p, &q| gap(p).total_cmp(&gap(q)).then(p.cmp(&q)))?;
                Some((gap(a), a, b))
            });
            let shortest = gaps.min_by(|p, q| p.0.total_cmp(&q.0).then((p.1, p.2).cmp(&(q.1, q.2))));
            match shortest {
                Some((_, a, b)) => self.join(a, b),
                None => break,
            }
        }
    }

    /// The tree of paths, the longest first, and what is no part of it.
    fn tree(&self) -> (Tree, Vec<Dismissed>) {
        let count = self.all.len();
        let mut dismissed = Vec::new();
        let mut tree = Tree { links: vec![Vec::new(); count], start: 0, paths: Vec::new() };
        if count == 0 {
            return (tree, dismissed);
        }
        let farthest = |distances: &[f64]| {
            (0..count).fold(0, |best, k| if distances[k] > distances[best] { k } else { best })
        };
        let one_end = farthest(&shortest_paths(&self.centres_mm, &self.neighbours, &[0]).0);
        let (distances, before) = shortest_paths(&self.centres_mm, &self.neighbours, &[one_end]);
        tree.paths.push(path_from(farthest(&distances), &before));
        let mut refused = vec![false; count];
        loop {
            let on_tree: Vec<usize> = tree.paths.iter().flatten().copied().collect();
            let (distances, before) = shortest_paths(&self.centres_mm, &self.neighbours, &on_tree);
            // How far outside the lumen about the tree, mm.
            let middles = tree.paths.iter().map(|path| {
                let radius_mm = |&c: &usize| self.all[c].radius_mm;
                (path.iter().map(|&c| self.centres_mm[c]).collect(), path.iter().map(radius_mm).collect())
            });
            let middles: Vec<(Vec<DVec3>, Vec<f64>)> = middles.collect();
            let middles: Vec<Middle> =
                middles.iter().map(|(middle, radii)| Middle::of(middle, radii)).collect();
            let depth_mm = |k: usize| {
                let away = middles.iter().map(|middle| middle.outside_mm(self.centres_mm[k]));
                away.fold(f64::INFINITY, f64::min)
            };
            let depth_mm: Vec<f64> = (0..count).into_par_iter().map(depth_mm).collect();
            let is_outside =
                |&k: &usize| !refused[k] && depth_mm[k] > LEAST_DEPTH_RADII * self.all[k].radius_mm;
            let candidates = (0..count).filter(is_outside);
            let Some(tip) = candidates.max_by(|&a, &b| distances[a].total_cmp(&distances[b]).then(b.cmp(&a)))
            else {
                break;
            };
            let path = path_from(tip, &before);
            let beyond = path.iter().filter(|&&k| depth_mm[k] > 0.0);
            let frames: usize = beyond.map(|&k| self.all[k].sights).sum();
            if frames < LEAST_FRAMES {
                refused[tip] = true;
                let reason = "too few frames lie beyond the wall".into();
                dismissed.push(Dismissed {
                    tip_mm: self.centres_mm[tip],
                    depth_mm: depth_mm[tip],
                    frames,
                    reason,
                });
                continue;
            }
            tree.paths.push(path);
        }
        for path in &tree.paths {
            for pair in path.windows(2) {
                tree.links[pair[0]].push(pair[1]);
                tree.links[pair[1]].push(pair[0]);
            }
        }
        // The first frame may lie some way into the vessel: the nearest end counts.
        let from_first = shortest_paths(&self.centres_mm, &self.neighbours, &[0]).0;
        let is_end = |&k: &usize| tree.links[k].len() == 1;
        let nearest = |&a: &usize, &b: &usize| from_first[a].total_cmp(&from_first[b]).then(a.cmp(&b));
        tree.start = (0..count).filter(is_end).min_by(nearest).unwrap_or(tree.paths[0][0]);
        (tree, dismissed)
    }
}

/// From a cluster along its predecessors.
fn path_from(tip: usize, before: &[Option<usize>]) -> Vec<usize> {
    let mut path = vec![tip];
    while let Some(previous) = path.last().and_then(|&k| before[k]) {
        path.push(previous);
    }
    path
}

/// Clusters connected as a tree.
struct Tree {
    links: Vec<Vec<usize>>,
    /// The end where the recording begins.
    start: usize,
    paths: Vec<Vec<usize>>,
}

impl Tree {
    /// Cuts the tree into branches.
    fn branches(&self, clusters: &Clusters) -> Vec<BranchPath> {
        let Some(first) = self.paths.first() else { return Vec::new() };
        if first.len() < 2 {
            return vec![branch(clusters, first, None, &[])];
        }
        // The neighbour nearer to the start, cluster by cluster.
        let (distances, inward) = shortest_paths(&clusters.centres_mm, &self.links, &[self.start]);
        let mut order: Vec<usize> = (0..self.links.len()).filter(|&k| self.links[k].len() > 2).collect();
        order.sort_by(|&a, &b| distances[a].total_cmp(&distances[b]).then(a.cmp(&b)));
        // At a parting, the two arms that are one branch.
        let mut through = std::collections::BTreeMap::new();
        for &parting in &order {
            through.insert(parting, self.straightest(clusters, parting, inward[parting]));
        }
        let mut branches: Vec<BranchPath> = Vec::new();
        let mut paths: Vec<Vec<usize>> = Vec::new();
        // Arms that a branch begins with: the parting, the first cluster, and the parent.
        let mut waiting = std::collections::VecDeque::from([(None, self.start, None)]);
        let mut done = std::collections::BTreeSet::new();
        while let Some((parting, next, parent)) = waiting.pop_front() {
            if parting.is_some_and(|p: usize| done.contains(&(p, next))) {
                continue;
            }
            let path = self.path_through(parting, next, &through);
            for pair in path.windows(2) {
                done.insert((pair[0], pair[1]));
                done.insert((pair[1], pair[0]));
            }
            let number = branches.len();
            branches.push(branch(clusters, &path, parent.zip(parting), &branches));
            for &cluster in &path {
                if self.links[cluster].len() > 2 {
                    for &arm in &self.links[cluster] {
                        if !done.contains(&(cluster, arm)) {
                            waiting.push_back((Some(cluster), arm, Some(number)));
                        }
                    }
                }
            }
            paths.push(path);
        }
        // The branch that goes on where another one ends.
        let passes =
            |cluster: usize| paths.iter().position(|path| path[1..path.len() - 1].contains(&cluster));
        for (branch, path) in branches.iter_mut().zip(&paths) {
            branch.joined = [path[0], path[path.len() - 1]].map(passes);
        }
        branches
    }

    /// The clusters of the branch that contains an arm, from the parting or, where the arm is one of two that are one branch,
    /// from that branch's beginning.
    fn path_through(
        &self,
        parting: Option<usize>,
        next: usize,
        through: &std::collections::BTreeMap<usize, [usize; 2]>,
    ) -> Vec<usize> {
        let goes_on = |here: usize, from: usize| -> Option<usize> {
            match through.get(&here) {
                Some(&[a, b]) if a == from => Some(b),
                Some(&[a, b]) if b == from => Some(a),
                Some(_) => None,
                None => self.links[here].iter().copied().find(|&k| k != from),
            }
        };
        let walk = |mut from: usize, mut here: usize| {
            let mut path = vec![from, here];
            while let Some(next) = goes_on(here, from) {
                (from, here) = (here, next);
                path.push(here);
            }
            path
        };
        let Some(parting) = parting else {
            let Some(&second) = self.links[next].first() else { return vec![next] };
            return walk(next, second);
        };
        let mut path = walk(parting, next);
        if let Some(other) = goes_on(parting, next) {
            let mut before = walk(parting, other);
            before.reverse();
            before.pop();
            before.append(&mut path);
            path = before;
        }
        path
    }

    /// The two arms of a parting that continue each other best.
    fn straightest(&self, clusters: &Clusters, parting: usize, inward: Option<usize>) -> [usize; 2] {
        let here = &clusters.all[parting];
        let arms: Vec<(usize, DVec3, f64)> = self.links[parting]
            .iter()
            .map(|&arm| {
                let (mut from, mut at, mut length) =
                    (parting, arm, here.centre_mm.distance(clusters.centres_mm[arm]));
                while length < ARM_RADII * here.radius_mm && self.links[at].len() == 2 {
                    let Some(&next) = self.links[at].iter().find(|&&k| k != from) else { break };
                    length += clusters.centres_mm[at].distance(clusters.centres_mm[next]);
                    (from, at) = (at, next);
                }
                let direction = (clusters.centres_mm[at] - here.centre_mm).normalize_or_zero();
                (arm, direction, clusters.all[at].radius_mm)
            })
            .collect();
        let mut best = (f64::INFINITY, [arms[0].0, arms[1].0]);
        for (i, a) in arms.iter().enumerate() {
            for b in &arms[i + 1..] {
                let from_start = inward.is_some_and(|arm| arm == a.0 || arm == b.0);
                let cost =
                    a.1.dot(b.1) + (a.2 / b.2).ln().abs() + if from_start { 0.0 } else { AWAY_FROM_START };
                if cost < best.0 {
                    best = (cost, [a.0, b.0]);
                }
            }
        }
        best.1
    }
}

/// A branch along clusters, with its parent and the cluster where it meets that.
fn branch(
    clusters: &Clusters,
    path: &[usize],
    parent: Option<(usize, usize)>,
    earlier: &[BranchPath],
) -> BranchPath {
    let middle_mm: Vec<DVec3> = path.iter().map(|&k| clusters.centres_mm[k]).collect();
    let radii_mm: Vec<f64> = path.iter().map(|&k| clusters.all[k].radius_mm).collect();
    let earlier: Vec<Middle> = earlier.iter().map(BranchPath::middle).collect();
    let beyond = |p: &DVec3| earlier.iter().map(|other| other.outside_mm(*p)).fold(f64::INFINITY, f64::min);
    let depth_mm = match parent {
        Some(_) => middle_mm.iter().map(beyond).fold(0.0, f64::max),
        None => middle_mm.windows(2).map(|pair| pair[0].distance(pair[1])).sum(),
    };
    let (parent, parting_mm) = parent.map(|(parent, parting)| (parent, clusters.centres_mm[parting])).unzip();
    BranchPath { parent, parting_mm, joined: [None; 2], middle_mm, radii_mm, depth_mm, frames: 0 }
}
