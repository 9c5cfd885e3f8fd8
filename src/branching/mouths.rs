//! Mouths of branches that were seen but not entered.
//!
//! A ray that leaves the vessel through a mouth has its echo beyond the wall. Where most rays do, the wall is continued as a
//! plate that bends as little as possible, and a tube is fitted to the branch: every echo about the place should lie on the
//! wall or on the tube. The mouth is the part of the continued wall within the tube.

use super::echoes::{WorldEcho, WorldEchoes};
use super::plate::{Laplacian, conjugate_gradients};
use super::tube::Tube;
use crate::Result;
use crate::cylinders::estimate::local_tube::{Change, LocalTube, PARAMETERS};
use crate::geometry::Pose;
use crate::numerics::cholesky::{Matrix, cholesky, solve};
use crate::numerics::robust::{huber_weight, tukey_weight};
use crate::surface::{Groups, RayCaster, Surface};
use crate::sweep::outward_bias_mm;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

/// A ray leaves the vessel where its echo lies so far beyond the wall: in standard deviations of the noise, and in lumen radii.
const BEYOND_SDS: f64 = 4.0;
const BEYOND_RADII: f64 = 0.15;
/// Echoes are sought so far within the wall, in standard deviations.
const WITHIN_SDS: f64 = 6.0;
/// What a mouth takes at least: echoes beyond the wall, frames that have some, …
const LEAST_ECHOES: usize = 12;
const LEAST_FRAMES: usize = 5;
/// … a part of the wall that does not reach around the lumen: the length of its summed normals by the sum of their lengths,
const LEAST_FACING: f64 = 0.4;
/// … the share of the rays through its middle whose echoes lie so far beyond the wall, in standard deviations, and of the echoes beyond the wall that lie on the branch's,
const LEAVING_SDS: f64 = 1.5;
const LEAST_LEAVING: f64 = 0.75;
const LEAST_ON_TUBE: f64 = 0.7;
/// … sectors of the branch's wall, of eight, in which echoes lie, and the depth to which it was seen, in its radii: a bulge
/// has no wall along its direction,
const SECTORS: usize = 8;
const LEAST_SECTORS: usize = 4;
const LEAST_DEPTH_RADII: f64 = 1.0;
/// … and an area of so many of its standard errors.
const LEAST_AREA_ERRORS: f64 = 3.0;
/// Widest branch, in radii of the lumen that it leaves.
const MAX_RADII: f64 = 1.25;
/// The branch's tube is fitted to the echoes up to this depth, in radii of the suspected mouth and standard deviations.
const DEPTH_RADII: f64 = 3.0;
const DEPTH_SDS: f64 = 10.0;
/// Echoes nearer to the continued wall count as its own, in standard deviations and lumen radii: edges of mouths are rounded. They
/// may lie so far within the tube, in standard deviations.
const EDGE_SDS: f64 = 3.0;
const EDGE_RADII: f64 = 0.12;
const ON_WALL_SDS: f64 = 1.5;
/// The wall is continued over this margin about a mouth, in its radii, and where it still bulges, in standard deviations of the
/// noise and lumen radii; it is known beyond so far at least.
const MARGIN_RADII: f64 = 0.4;
const BULGE_SDS: f64 = 0.5;
const BULGE_RADII: f64 = 0.04;
const KNOWN_RADII: f64 = 0.9;
/// Half the window of the wall farther about, in lumen radii and rad; its places in each direction; and the quantile of their
/// radii that counts, which leaves room for a mouth.
const WINDOW_RADII: f64 = 1.2;
const WINDOW_RAD: f64 = 1.2;
const WINDOW_PLACES: i32 = 4;
const WINDOW_QUANTILE: f64 = 0.4;
/// How often at most the wall is continued across the mouth as it is known, and the tube fitted; and by which share of its
/// nodes the mouth must have grown for another time.
const ROUNDS: usize = 3;
const LEAST_GROWTH: f64 = 0.02;
/// Prior standard deviations of the tube's shape about a straight round one; lengths in radii.
const BEND_SD: f64 = 0.2;
const TAPER_SD: f64 = 0.05;
const OVAL_SD: f64 = 0.1;
const LOBES_SD: f64 = 0.05;
/// Most steps of a fit, and the relative change of its cost that ends it.
const MAX_STEPS: usize = 40;
const ENOUGH: f64 = 1e-5;
/// Most echoes that suspects are looked for in at first, and then about those that are found, so many lumen radii away; and that a
/// tube is fitted to: of more, every second one and so on.
const FEW_SIGHTS: usize = 30_000;
const MOST_SIGHTS: usize = 200_000;
const ABOUT_RADII: f64 = 8.0;
const MOST_ECHOES: usize = 8000;
/// Echoes of the wall, and of the branch, that tell which of several directions are the likeliest, and how many of these are
/// tried with all echoes.
const FEW_ECHOES: usize = 800;
const LIKELIEST: usize = 2;
/// Branches are no tubes: how far their wall lies from one, in radii of the suspected mouth; and what that leaves open of the
/// rim, in radii of the tube, and of the centre's place along the mouth, in half its length.
const SHAPE_RADII: f64 = 0.06;
const RIM_RADII: f64 = 0.03;
const CENTRE_SHARE: f64 = 0.06;
/// Where the catheter was so far behind the flat wall, in radii of a suspect, the vessel itself is wide; and where it was so
/// deep in a tube, in the tube's radii, it is the vessel.
const BEHIND_RADII: [f64; 2] = [0.3, 3.0];
const ENTERED_RADII: f64 = 1.0;
/// Nodes that no ray meets count as those beside them, up to so many lumen radii away.
const GAP_RADII: f64 = 0.1;
/// Steps along edges about a suspect within which echoes beyond the wall are its own, not its neighbour's.
const BESIDE: usize = 2;
/// An echo is off the wall as it was swept where it lies so far beyond, in lumen radii. Of a bulge that the sweep describes
/// fewer of the echoes are; it is a mouth if it is deeper than wide.
const OFF_SWEPT_RADII: f64 = 0.05;
const LEAST_OFF_SWEPT: f64 = 0.3;
/// Groups of frames for the standard errors, and the runs of frames that are dealt out to them.
const GROUPS: usize = 8;
const RUNS: usize = 4 * GROUPS;

/// The mouth of a branch that was seen from the vessel but not entered. The surface is open there.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Mouth {
    /// The branch in whose wall it opens, as a place in [`BranchTree::branches`](super::BranchTree::branches); 0 in a vessel
    /// in which one was found.
    pub branch: usize,
    /// Its centre on the continued wall, mm.
    pub centre_mm: DVec3,
    /// Standard error of the centre's place, mm: of its distance from the true one.
    pub centre_standard_error_mm: f64,
    /// Its area on the continued wall, mm².
    pub area_mm2: f64,
    /// Standard error of the area, mm².
    pub area_standard_error_mm2: f64,
    /// Which way the branch leaves: a unit vector.
    pub direction: DVec3,
    /// Standard error of the direction, degrees.
    pub direction_standard_error_deg: f64,
    /// Points of its rim, mm, in order.
    pub rim_mm: Vec<DVec3>,
    /// Frames that look into it.
    pub frames: usize,
    /// Echoes on the branch's wall.
    pub echoes: usize,
    /// How deep the branch was seen, mm beyond the mouth.
    pub depth_mm: f64,
}

/// The wall that mouths are looked for in.
pub(super) struct Wall<'a> {
    /// The whole of it, supported or not, without its bulges.
    pub surface: &'a Surface,
    /// The places of its nodes as they were swept, bulges and all, mm.
    pub swept_mm: &'a [DVec3],
    /// Of each node: its branch, and whether the wall bulged there.
    pub branch: Vec<usize>,
    pub is_bulging: Vec<bool>,
    /// Of each branch: the noise of its echoes, and the median radius of its contours, mm.
    pub noise_mm: Vec<f64>,
    pub radius_mm: Vec<f64>,
    /// Of each branch: the part of the noise along the wall, mm.
    pub along_mm: Vec<f64>,
}

/// The wall of a tube without its bulges, to which the echoes in mouths pull it: the radius of every node of its grid, mm, and
/// whether it is another than before. `lumen_mm` is the radius of the lumen.
pub(super) fn flattened(tube: &Tube, lumen_mm: f64, noise_mm: f64) -> Vec<(f64, bool)> {
    let (rings, nodes) = (tube.axis.rings() as i32, tube.nodes as i32);
    let steps = |half: f64, step: f64| (half / step / f64::from(WINDOW_PLACES)).max(1.0);
    let along = steps(WINDOW_RADII * lumen_mm, tube.axis.step_mm);
    let around = steps(WINDOW_RAD, TAU / f64::from(nodes));
    let offset = |k: i32, step: f64| (f64::from(k) * step).round() as i32;
    let places: Vec<[i32; 2]> = (-WINDOW_PLACES..=WINDOW_PLACES)
        .flat_map(|k| (-WINDOW_PLACES..=WINDOW_PLACES).map(move |j| [offset(k, along), offset(j, around)]))
        .collect();
    let limit_mm = (BULGE_SDS * noise_mm).max(BULGE_RADII * lumen_mm);
    (0..rings * nodes)
        .into_par_iter()
        .map_init(Vec::new, |about: &mut Vec<f64>, node| {
            let (k, j) = (node / nodes, node % nodes);
            let radius = |ring: i32, j: i32| tube.radii_mm[(ring * nodes + j.rem_euclid(nodes)) as usize];
            let within = places.iter().filter(|place| (0..rings).contains(&(k + place[0])));
            about.clear();
            about.extend(within.map(|place| radius(k + place[0], j + place[1])));
            let rank = (WINDOW_QUANTILE * about.len() as f64) as usize;
            let (_, usual, _) = about.select_nth_unstable_by(rank, f64::total_cmp);
            let is_bulging = radius(k, j) > *usual + limit_mm;
            (if is_bulging { *usual } else { radius(k, j) }, is_bulging)
        })
        .collect()
}

/// Finds the mouths in a wall; gives each with the nodes of the wall within its rim.
pub(super) fn find(wall: &Wall, echoes: &WorldEchoes) -> Result<Vec<(Mouth, Vec<u32>)>> {
    let (neighbours, caster) = rayon::join(|| wall.surface.neighbours(), || RayCaster::new(wall.surface));
    let caster = caster?;
    // Most of a vessel has no mouth: a part of the echoes says so.
    let few = sights(wall, &caster, &echoes.at_most(FEW_SIGHTS));
    let places: Vec<(DVec3, f64)> = suspects(wall, &few, &neighbours)
        .iter()
        .map(|suspect| (suspect.centre_mm, ABOUT_RADII * wall.radius_mm[suspect.branch]))
        .collect();
    if places.is_empty() {
        return Ok(Vec::new());
    }
    let mut more = echoes.at_most(MOST_SIGHTS);
    more.retain(|echo| places.iter().any(|(place, reach_mm)| echo.point_mm.distance(*place) < *reach_mm));
    let sights = sights(wall, &caster, &more);
    let mut suspects = suspects(wall, &sights, &neighbours);
    drop_entered(wall, &caster, &sights, &mut suspects);
    if suspects.is_empty() {
        return Ok(Vec::new());
    }
    let scene = Scene::of(wall, &sights, &neighbours, &suspects);
    let found: Vec<_> =
        (0..suspects.len()).into_par_iter().map(|number| scene.mouth(number)).collect::<Result<_>>()?;
    let mut mouths: Vec<(Mouth, Vec<u32>)> = Vec::new();
    let mut tubes: Vec<LocalTube> = Vec::new();
    for (suspect, found) in suspects.iter().zip(found) {
        // Smaller suspects may lie in the mouth of a larger one.
        let is_known = tubes.iter().any(|tube| suspect.is_in(tube));
        if let Some((mouth, nodes, tube)) = found.filter(|_| !is_known) {
            mouths.push((mouth, nodes));
            tubes.push(tube);
        }
    }
    Ok(mouths)
}

/// Where the ray of an echo meets the wall.
#[derive(Debug, Clone, Copy)]
struct Sight {
    echo: WorldEcho,
    /// The nearest node of the wall.
    node: u32,
    /// How far the echo lies beyond the wall, along its normal, mm.
    depth_mm: f64,
}

impl Sight {
    fn is_beyond(&self, wall: &Wall) -> bool {
        let branch = wall.branch[self.node as usize];
        self.depth_mm > (BEYOND_SDS * wall.noise_mm[branch]).max(BEYOND_RADII * wall.radius_mm[branch])
    }
}

/// Where the rays of echoes leave the vessel.
fn sights(wall: &Wall, caster: &RayCaster, echoes: &[WorldEcho]) -> Vec<Sight> {
    let normals = wall.surface.triangle_normals();
    let noise_mm = wall.noise_mm.iter().copied().fold(0.0, f64::max);
    let sight = |echo: &WorldEcho| {
        let Crossing { triangle, at_mm, depth_mm } =
            Crossing::of(caster, &normals, echo, WITHIN_SDS * noise_mm)?;
        let distance = |n: &u32| wall.surface.nodes_mm[*n as usize].distance_squared(at_mm);
        let corners = wall.surface.triangles[triangle as usize];
        let node = corners.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        Some(Sight { echo: *echo, node, depth_mm })
    };
    echoes.par_iter().filter_map(sight).collect()
}

/// Where a ray meets a surface from within.
struct Crossing {
    triangle: u32,
    at_mm: DVec3,
    depth_mm: f64,
}

impl Crossing {
    fn of(caster: &RayCaster, normals: &[DVec3], echo: &WorldEcho, within_mm: f64) -> Option<Self> {
        let (direction, length_mm) = echo.ray()?;
        let (triangle, distance_mm) = caster.cast(echo.origin_mm, direction, length_mm + within_mm)?;
        let normal = normals[triangle as usize];
        let at_mm = echo.origin_mm + direction * distance_mm;
        (direction.dot(normal) > 0.0).then(|| Self {
            triangle,
            at_mm,
            depth_mm: (echo.point_mm - at_mm).dot(normal),
        })
    }
}

/// A place where most rays leave the vessel.
struct Suspect {
    branch: usize,
    nodes: Vec<u32>,
    centre_mm: DVec3,
    area_mm2: f64,
    /// Mean normal of the wall there.
    outward: DVec3,
}

/// Nodes that no ray meets, as on a grid that is finer than the rays are dense, take the majority of those beside them.
fn fill_gaps(wall: &Wall, neighbours: &[Vec<u32>], leaving: &mut [i32], mut is_met: Vec<bool>) {
    let edge_mm = (wall.surface.area_mm2() / wall.surface.triangles.len().max(1) as f64 * 2.0).sqrt();
    let least_mm = wall.radius_mm.iter().copied().fold(f64::INFINITY, f64::min);
    for _ in 0..(GAP_RADII * least_mm / edge_mm) as usize {
        let votes = |n: usize| -> Option<i32> {
            let mut beside = neighbours[n].iter().filter(|&&k| is_met[k as usize]).peekable();
            beside.peek()?;
            Some(beside.map(|&k| leaving[k as usize].signum()).sum::<i32>().signum())
        };
        let open = (0..neighbours.len()).into_par_iter().filter(|&n| !is_met[n]);
        let filled: Vec<(usize, i32)> = open.filter_map(|n| Some((n, votes(n)?))).collect();
        if filled.is_empty() {
            break;
        }
        for (n, vote) in filled {
            (leaving[n], is_met[n]) = (vote, true);
        }
    }
}

/// The places where most rays leave the vessel, the largest first.
fn suspects(wall: &Wall, sights: &[Sight], neighbours: &[Vec<u32>]) -> Vec<Suspect> {
    let count = wall.surface.nodes_mm.len();
    // Rays that leave, less those that do not.
    let mut leaving = vec![0_i32; count];
    let mut is_met = vec![false; count];
    for sight in sights {
        leaving[sight.node as usize] += if sight.is_beyond(wall) { 1 } else { -1 };
        is_met[sight.node as usize] = true;
    }
    fill_gaps(wall, neighbours, &mut leaving, is_met);
    let about = |n: usize| leaving[n] + neighbours[n].iter().map(|&k| leaving[k as usize]).sum::<i32>();
    let is_open: Vec<bool> = (0..count).into_par_iter().map(|n| about(n) > 0).collect();
    let mut groups = Groups::new(count);
    for node in (0..count).filter(|&n| is_open[n]) {
        for &other in neighbours[node].iter().filter(|&&k| is_open[k as usize]) {
            groups.join(node as u32, other);
        }
    }
    let mut nodes: std::collections::BTreeMap<u32, Vec<u32>> = std::collections::BTreeMap::new();
    for node in (0..count as u32).filter(|&n| is_open[n as usize]) {
        nodes.entry(groups.root(node)).or_default().push(node);
    }
    if nodes.is_empty() {
        return Vec::new();
    }
    let (areas, normals) = (wall.surface.node_areas_mm2(), wall.surface.node_normals());
    let suspect = |nodes: Vec<u32>| {
        let area_mm2: f64 = nodes.iter().map(|&n| areas[n as usize]).sum();
        let mean = |of: &[DVec3]| {
            nodes.iter().map(|&n| of[n as usize] * areas[n as usize]).sum::<DVec3>() / area_mm2
        };
        let (centre_mm, facing) = (mean(&wall.surface.nodes_mm), mean(&normals));
        let middle = nodes.iter().copied().min_by(|&a, &b| {
            let distance = |n: u32| wall.surface.nodes_mm[n as usize].distance_squared(centre_mm);
            distance(a).total_cmp(&distance(b))
        })?;
        let branch = wall.branch[middle as usize];
        (facing.length() > LEAST_FACING).then(|| Suspect {
            branch,
            nodes,
            centre_mm,
            area_mm2,
            outward: facing.normalize(),
        })
    };
    let mut suspects: Vec<Suspect> = nodes.into_values().filter_map(suspect).collect();
    suspects.sort_by(|a, b| b.area_mm2.total_cmp(&a.area_mm2));
    suspects
}

/// Where the probe looks from, of each frame.
fn origins(sights: &[Sight]) -> Vec<DVec3> {
    sights.chunk_by(|a, b| a.echo.frame == b.echo.frame).map(|of| of[0].echo.origin_mm).collect()
}

/// Drops the suspects behind which the catheter was: there the lumen itself is wider than the flat wall.
fn drop_entered(wall: &Wall, caster: &RayCaster, sights: &[Sight], suspects: &mut Vec<Suspect>) {
    let (origins_mm, normals) = (origins(sights), wall.surface.triangle_normals());
    suspects.retain(|suspect| {
        let nodes: BTreeSet<u32> = suspect.nodes.iter().copied().collect();
        let radius_mm = suspect.radius_mm();
        let is_behind = |origin_mm: &&DVec3| {
            let inward = -suspect.outward;
            caster.cast(**origin_mm, inward, BEHIND_RADII[1] * radius_mm).is_some_and(
                |(triangle, distance_mm)| {
                    distance_mm > BEHIND_RADII[0] * radius_mm
                        && normals[triangle as usize].dot(inward) < 0.0
                        && wall.surface.triangles[triangle as usize].iter().any(|n| nodes.contains(n))
                },
            )
        };
        origins_mm.par_iter().filter(is_behind).count() < LEAST_FRAMES
    });
}

/// The wall about a mouth, continued across it.
struct Patch {
    surface: Surface,
    /// Nodes of the whole wall.
    nodes: Vec<u32>,
}

/// Some nodes, and those within a number of steps along edges between such as `may` names.
fn spread(
    nodes: &BTreeSet<u32>,
    neighbours: &[Vec<u32>],
    steps: usize,
    may: impl Fn(u32) -> bool,
) -> BTreeSet<u32> {
    let (mut all, mut last) = (nodes.clone(), nodes.clone());
    for _ in 0..steps {
        let next = last.iter().flat_map(|&n| neighbours[n as usize].iter().copied());
        last = next.filter(|n| !all.contains(n) && may(*n)).collect();
        all.extend(&last);
    }
    all
}

impl Patch {
    /// The wall about some nodes, which lie on a mouth of that radius.
    fn about(scene: &Scene, mouth: &BTreeSet<u32>, radius_mm: f64) -> Self {
        let Scene { wall, neighbours, .. } = scene;
        let steps = |radii: f64| scene.steps(mouth, radii * radius_mm);
        let bulging = spread(mouth, neighbours, steps(1.0), |n| wall.is_bulging[n as usize]);
        let open = spread(&bulging, neighbours, steps(MARGIN_RADII), |_| true);
        let known = spread(&open, neighbours, steps(KNOWN_RADII), |_| true);
        let mut is_known = vec![false; neighbours.len()];
        known.iter().for_each(|&n| is_known[n as usize] = true);
        let (mut surface, nodes) = scene.surface.part(|t| t.iter().all(|&n| is_known[n as usize]));
        let border: BTreeSet<u32> = surface.rims().into_iter().flatten().collect();
        let is_free: Vec<bool> =
            nodes.iter().zip(0..).map(|(n, local)| open.contains(n) && !border.contains(&local)).collect();
        continue_across(&mut surface, &is_free);
        Self { surface, nodes }
    }
}

/// Moves the free nodes of a surface so that it bends as little as possible.
fn continue_across(surface: &mut Surface, is_free: &[bool]) {
    // Beyond two triangles from a free node nothing bends otherwise than before.
    let marked = |is: &[bool]| -> Vec<bool> {
        let mut near = is.to_vec();
        for t in surface.triangles.iter().filter(|t| t.iter().any(|&n| is[n as usize])) {
            t.iter().for_each(|&n| near[n as usize] = true);
        }
        near
    };
    let bends = marked(is_free);
    let (about, original) = surface.part(|t| t.iter().any(|&n| bends[n as usize]));
    let is_free: Vec<bool> = original.iter().map(|&n| is_free[n as usize]).collect();
    let laplacian = Laplacian::of(&about);
    let bent = |u: &[DVec3]| -> Vec<DVec3> {
        let mut curved = laplacian.apply(u);
        curved.iter_mut().zip(&laplacian.area_mm2).for_each(|(x, area)| *x /= *area);
        let mut sum = laplacian.apply(&curved);
        sum.iter_mut().zip(&is_free).filter(|(_, free)| !**free).for_each(|(x, _)| *x = DVec3::ZERO);
        sum
    };
    let diagonal = laplacian.squared_diagonal(1.0);
    let right: Vec<DVec3> = bent(&about.nodes_mm).iter().map(|x| -*x).collect();
    let shift = conjugate_gradients(&bent, &right, &diagonal);
    original.iter().zip(shift).for_each(|(&n, by)| surface.nodes_mm[n as usize] += by);
}

/// An echo near a mouth.
#[derive(Debug, Clone, Copy)]
struct Look {
    point_mm: DVec3,
    image_normal: DVec3,
    /// Where its ray meets the continued wall, and how far it lies beyond that.
    at_mm: DVec3,
    depth_mm: f64,
    /// Whether that is too far for an echo of the wall, its rounded edges included.
    is_beyond: bool,
    /// Whether it is also too far from the wall as it was swept.
    is_off_swept: bool,
    frame: u32,
    weight: f64,
}

/// Distance of a point outside a tube, mm.
fn outside_mm(tube: &LocalTube, point_mm: DVec3) -> f64 {
    tube.distance_mm(tube.world_from_axis.inverse().transform_point(point_mm))
}

/// A tube fitted to the branch behind a mouth.
struct Branch<'a> {
    looks: &'a [Look],
    noise_mm: f64,
    along_mm: f64,
    /// Radius of the suspected mouth and its centre.
    radius_mm: f64,
    centre_mm: DVec3,
}

/// What a tube says of an echo.
struct Residual {
    /// Distance outside its wall, mm; of an echo on the continued wall, which may lie anywhere outside, how far it is inside
    /// all the same.
    distance_mm: f64,
    /// Its variance in units of the noise's.
    variance: f64,
    gain: Change,
}

impl<'a> Branch<'a> {
    fn of(looks: &'a [Look], wall: &Wall, suspect: &Suspect) -> Self {
        let radius_mm = suspect.radius_mm();
        let noise_mm = wall.noise_mm[suspect.branch].max(SHAPE_RADII * radius_mm);
        let along_mm = wall.along_mm[suspect.branch];
        Self { looks, noise_mm, along_mm, radius_mm, centre_mm: suspect.centre_mm }
    }

    fn residual(&self, tube: &LocalTube, to_axis: &Pose, look: &Look) -> Residual {
        let (p, normal) = (to_axis.transform_point(look.point_mm), to_axis.rotation * look.image_normal);
        let residual = tube.residual_of(p, normal, 3.0 * self.noise_mm);
        let (distance_mm, variance) = match look.is_beyond {
            true => {
                (residual.distance_mm - outward_bias_mm(tube.radius_mm, self.along_mm), residual.variance)
            }
            false => ((residual.distance_mm + ON_WALL_SDS * self.noise_mm).min(0.0), 1.0),
        };
        Residual { distance_mm, variance, gain: residual.gain }
    }

    fn priors(&self, tube: &LocalTube) -> [(usize, f64, f64); 7] {
        let r = self.radius_mm;
        [
            (4, tube.bend_per_mm.x, BEND_SD / r),
            (5, tube.bend_per_mm.y, BEND_SD / r),
            (7, tube.taper, TAPER_SD),
            (8, tube.oval_mm.x, OVAL_SD * r),
            (9, tube.oval_mm.y, OVAL_SD * r),
            (10, tube.lobes_mm.x, LOBES_SD * r),
            (11, tube.lobes_mm.y, LOBES_SD * r),
        ]
    }

    /// The negative logarithm of the tube's likelihood, but for a constant.
    fn unlikeliness(&self, tube: &LocalTube) -> f64 {
        let to_axis = tube.world_from_axis.inverse();
        let of_look = |look: &Look| {
            let Residual { distance_mm, variance, .. } = self.residual(tube, &to_axis, look);
            let sds = distance_mm.abs() / (self.noise_mm * variance.sqrt());
            let weight = huber_weight(1.0, sds);
            look.weight * (sds * sds * weight * (1.0 - 0.5 * weight) + 0.5 * variance.ln())
        };
        let prior = |(_, value, sd): (usize, f64, f64)| 0.5 * (value / sd).powi(2);
        self.looks.iter().map(of_look).sum::<f64>() + self.priors(tube).into_iter().map(prior).sum::<f64>()
    }

    /// The tube that fits the echoes of some groups best, from a first one on: Gauss-Newton's steps with Huber's weights.
    fn fitted(&self, start: LocalTube, counts: &dyn Fn(&Look) -> bool) -> Option<LocalTube> {
        // Its origin stays beside the mouth.
        let beside = |tube: LocalTube| {
            tube.moved(tube.station(tube.world_from_axis.inverse().transform_point(self.centre_mm)))
        };
        let is_sound = |tube: &LocalTube| {
            tube.is_sound()
                && (0.2..5.0).contains(&(tube.radius_mm / self.radius_mm))
                && tube.taper.abs() < 0.6
        };
        let looks: Vec<&Look> = self.looks.iter().filter(|look| counts(look)).collect();
        let mut tube = Some(start).filter(is_sound)?;
        let mut damping = 1e-2;
        for _ in 0..MAX_STEPS {
            let to_axis = tube.world_from_axis.inverse();
            let mut normal: Matrix<PARAMETERS> = [[0.0; PARAMETERS]; PARAMETERS];
            let mut right: Change = [0.0; PARAMETERS];
            let mut weights = Vec::with_capacity(looks.len());
            let mut squares = 0.0;
            for look in &looks {
                let Residual { distance_mm, variance, gain } = self.residual(&tube, &to_axis, look);
                let sd_mm = self.noise_mm * variance.sqrt();
                let weight = look.weight * huber_weight(sd_mm, distance_mm.abs()) / (sd_mm * sd_mm);
                weights.push(weight);
                squares += weight * distance_mm * distance_mm;
                if distance_mm == 0.0 {
                    continue;
                }
                for i in 0..PARAMETERS {
                    let g = weight * gain[i];
                    normal[i][..=i].iter_mut().zip(&gain).for_each(|(sum, other)| *sum += g * other);
                    right[i] += g * distance_mm;
                }
            }
            for (i, value, sd) in self.priors(&tube) {
                normal[i][i] += 1.0 / (sd * sd);
                right[i] -= value / (sd * sd);
            }
            let of_priors = |tube: &LocalTube| self.priors(tube).map(|(_, value, sd)| (value / sd).powi(2));
            let cost = squares + of_priors(&tube).iter().sum::<f64>();
            // The weights stay while a step is sought: their variances must not draw the tube towards large ones.
            let cost_of = |tube: &LocalTube| {
                let to_axis = tube.world_from_axis.inverse();
                let of_look = |(look, weight): (&&Look, &f64)| {
                    weight * self.residual(tube, &to_axis, look).distance_mm.powi(2)
                };
                looks.iter().zip(&weights).map(of_look).sum::<f64>() + of_priors(tube).iter().sum::<f64>()
            };
            let mut better = None;
            while better.is_none() && damping < 1e6 {
                let mut damped = normal;
                (0..PARAMETERS).for_each(|i| damped[i][i] *= 1.0 + damping);
                let root = cholesky(&damped)?;
                let next = Some(beside(tube.changed(&solve(&root, right)))).filter(is_sound);
                better = next.map(|next| (next, cost_of(&next))).filter(|(_, of)| *of < cost);
                damping *= if better.is_some() { 0.3 } else { 5.0 };
            }
            let Some((next, of_next)) = better else { break };
            tube = next;
            if cost - of_next < ENOUGH * cost {
                break;
            }
        }
        Some(tube)
    }
}

/// A mouth as a tube cuts it out of the continued wall.
struct Measured {
    area_mm2: f64,
    centre_mm: DVec3,
    rim_mm: Vec<DVec3>,
    direction: DVec3,
}

impl Patch {
    /// The part within a tube; `None` where that is none, in several pieces, or reaches the patch's border.
    fn within(&self, tube: &LocalTube, centre_mm: DVec3) -> Option<Measured> {
        let inside: Vec<f64> = self.surface.nodes_mm.iter().map(|p| -outside_mm(tube, *p)).collect();
        let whole = self.surface.clipped(&inside);
        // The tube goes on backwards, and may meet other parts of the wall.
        let mut groups = Groups::new(whole.nodes_mm.len());
        whole.triangles.iter().for_each(|&[a, b, c]| {
            groups.join(a, b);
            groups.join(b, c);
        });
        let near = |t: &&[u32; 3]| whole.nodes_mm[t[0] as usize].distance_squared(centre_mm);
        let nearest = whole.triangles.iter().min_by(|a, b| near(a).total_cmp(&near(b)))?[0];
        let root = groups.root(nearest);
        let (part, original) = whole.part(|t| groups.root(t[0]) == root);
        let border: BTreeSet<u32> = self.surface.rims().into_iter().flatten().collect();
        if original.iter().any(|n| border.contains(n)) {
            return None;
        }
        let areas = part.triangle_areas_mm2();
        let area_mm2: f64 = areas.iter().sum();
        let centre = |t: usize| part.corners_mm(t).iter().sum::<DVec3>() / 3.0 * areas[t];
        let centre_mm = (0..areas.len()).map(centre).sum::<DVec3>() / area_mm2;
        let mut rims = part.rims();
        let rim = rims.pop().filter(|_| rims.is_empty() && area_mm2 > 0.0)?;
        Some(Measured {
            area_mm2,
            centre_mm,
            rim_mm: rim.into_iter().map(|n| part.nodes_mm[n as usize]).collect(),
            direction: tube.world_from_axis.rotation.z_axis,
        })
    }
}

/// What all suspects share.
struct Scene<'a> {
    wall: &'a Wall<'a>,
    sights: &'a [Sight],
    neighbours: &'a [Vec<u32>],
    suspects: &'a [Suspect],
    /// The wall with the bulges about the suspects made flat, and no others.
    surface: Surface,
    /// Of each node: the suspect that it is part of, and the one that it lies at.
    suspect: Vec<Option<usize>>,
    beside: Vec<Option<usize>>,
    /// Where the probe looks from, of each frame.
    origins_mm: Vec<DVec3>,
}

impl<'a> Scene<'a> {
    fn of(wall: &'a Wall, sights: &'a [Sight], neighbours: &'a [Vec<u32>], suspects: &'a [Suspect]) -> Self {
        let triangles = wall.surface.triangles.clone();
        let surface = Surface { nodes_mm: wall.swept_mm.to_vec(), triangles, arrays: Vec::new() };
        let suspect = vec![None; neighbours.len()];
        let (beside, origins_mm) = (suspect.clone(), origins(sights));
        let mut scene = Self { wall, sights, neighbours, suspects, surface, suspect, beside, origins_mm };
        for (number, suspect) in suspects.iter().enumerate() {
            let nodes: BTreeSet<u32> = suspect.nodes.iter().copied().collect();
            nodes.iter().for_each(|&n| scene.suspect[n as usize] = Some(number));
            let steps = scene.steps(&nodes, suspect.radius_mm());
            for n in spread(&nodes, neighbours, steps, |n| wall.is_bulging[n as usize]) {
                scene.surface.nodes_mm[n as usize] = wall.surface.nodes_mm[n as usize];
            }
        }
        scene.beside.clone_from(&scene.suspect);
        for _ in 0..BESIDE {
            let of = |n: usize| {
                scene.beside[n].or_else(|| neighbours[n].iter().find_map(|&k| scene.beside[k as usize]))
            };
            scene.beside = (0..neighbours.len()).into_par_iter().map(of).collect();
        }
        scene
    }

    /// Steps along the edges about some nodes that lead so far.
    fn steps(&self, nodes: &BTreeSet<u32>, distance_mm: f64) -> usize {
        let place = |n: u32| self.wall.surface.nodes_mm[n as usize];
        let edges = nodes.iter().flat_map(|&n| self.neighbours[n as usize].iter().map(move |&k| (n, k)));
        let (sum_mm, count) =
            edges.fold((0.0, 0), |(sum, count), (n, k)| (sum + place(n).distance(place(k)), count + 1));
        2 + (distance_mm * f64::from(count.max(1)) / sum_mm.max(f64::MIN_POSITIVE)).round() as usize
    }

    /// The mouth at a suspect with the nodes of the wall within it, if it is one.
    fn mouth(&self, number: usize) -> Result<Option<(Mouth, Vec<u32>, LocalTube)>> {
        let (wall, suspect) = (self.wall, &self.suspects[number]);
        let lumen_mm = wall.radius_mm[suspect.branch];
        let radius_mm = suspect.radius_mm();
        let own = self.sights.iter().filter(|sight| self.suspect[sight.node as usize] == Some(number));
        let own: Vec<&WorldEcho> =
            own.filter(|sight| sight.is_beyond(wall)).map(|sight| &sight.echo).collect();
        let frames: BTreeSet<u32> = own.iter().map(|echo| echo.frame).collect();
        if own.len() < LEAST_ECHOES || frames.len() < LEAST_FRAMES {
            return Ok(None);
        }
        let away = own.iter().map(|echo| echo.point_mm).sum::<DVec3>() / own.len() as f64 - suspect.centre_mm;
        let mut open: BTreeSet<u32> = suspect.nodes.iter().copied().collect();
        let mut found: Option<(Patch, Vec<Look>, LocalTube, Vec<u32>)> = None;
        // From the second time on the wall is continued across the mouth that was found.
        for _ in 0..ROUNDS {
            let patch = Patch::about(self, &open, radius_mm);
            let tube = found.as_ref().map(|(_, _, tube, _)| *tube);
            let looks = self.looks(&patch, number, tube.as_ref())?;
            let branch = Branch::of(&looks, wall, suspect);
            let all = |_: &Look| true;
            let starts = tube.map_or_else(
                || {
                    // A part of the echoes tells which way it goes.
                    let looks = thinned(&looks, FEW_ECHOES);
                    let branch = Branch::of(&looks, wall, suspect);
                    let fits =
                        suspect.starts(away).into_par_iter().filter_map(|start| branch.fitted(start, &all));
                    let mut fits: Vec<_> = fits.map(|tube| (branch.unlikeliness(&tube), tube)).collect();
                    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
                    fits.into_iter().map(|(_, tube)| tube).take(LIKELIEST).collect()
                },
                |tube| vec![tube],
            );
            let fits = starts.into_iter().filter_map(|start| branch.fitted(start, &all));
            let fits = fits.map(|tube| (branch.unlikeliness(&tube), tube));
            let Some((_, tube)) = fits.min_by(|a, b| a.0.total_cmp(&b.0)) else {
                return Ok(None);
            };
            let inside = patch.surface.nodes_mm.iter().map(|p| outside_mm(&tube, *p) < 0.0);
            let inside: Vec<u32> =
                inside.zip(&patch.nodes).filter(|(is_in, _)| *is_in).map(|(_, n)| *n).collect();
            let before = open.len();
            open.extend(&inside);
            found = Some((patch, looks, tube, inside));
            if ((open.len() - before) as f64) < LEAST_GROWTH * open.len() as f64 {
                break;
            }
        }
        let Some((patch, looks, tube, inside)) = found else { return Ok(None) };
        let branch = Branch::of(&looks, wall, suspect);
        let Some(Measured { area_mm2, centre_mm, rim_mm, direction }) =
            patch.within(&tube, suspect.centre_mm)
        else {
            return Ok(None);
        };
        let Some(seen) = branch.seen(&tube, centre_mm) else { return Ok(None) };
        if tube.radius_mm > MAX_RADII * lumen_mm || direction.dot(suspect.outward) < 0.0 {
            return Ok(None);
        }
        if self.has_entered(&tube, centre_mm, seen.depth_mm) {
            return Ok(None);
        }
        let Some(errors) = branch.errors(&patch, &tube) else { return Ok(None) };
        if area_mm2 < LEAST_AREA_ERRORS * errors.area_mm2 {
            return Ok(None);
        }
        let mouth = Mouth {
            branch: suspect.branch,
            centre_mm,
            centre_standard_error_mm: errors.centre_mm,
            area_mm2,
            area_standard_error_mm2: errors.area_mm2,
            direction,
            direction_standard_error_deg: errors.direction_deg,
            rim_mm,
            frames: seen.frames,
            echoes: seen.echoes,
            depth_mm: seen.depth_mm,
        };
        Ok(Some((mouth, inside, tube)))
    }

    /// Whether the catheter was in a tube, deeper than its radius beyond the mouth: then it is the vessel itself.
    fn has_entered(&self, tube: &LocalTube, mouth_mm: DVec3, depth_mm: f64) -> bool {
        let to_axis = tube.world_from_axis.inverse();
        let mouth_at_mm = tube.station(to_axis.transform_point(mouth_mm));
        let is_in = |origin_mm: &&DVec3| {
            let p = to_axis.transform_point(**origin_mm);
            let depth = tube.station(p) - mouth_at_mm;
            (ENTERED_RADII * tube.radius_mm..depth_mm).contains(&depth) && tube.distance_mm(p) < 0.0
        };
        self.origins_mm.iter().filter(is_in).count() >= LEAST_FRAMES
    }

    /// The echoes whose rays meet the continued wall of a patch, but those in other suspects, unless these lie in the tube
    /// that is known so far.
    fn looks(&self, patch: &Patch, number: usize, tube: Option<&LocalTube>) -> Result<Vec<Look>> {
        let suspect = &self.suspects[number];
        let (noise_mm, lumen_mm) = (self.wall.noise_mm[suspect.branch], self.wall.radius_mm[suspect.branch]);
        let radius_mm = suspect.radius_mm();
        let is_other: Vec<bool> = (0..self.suspects.len())
            .map(|other| other != number && !tube.is_some_and(|tube| self.suspects[other].is_in(tube)))
            .collect();
        let mut is_near = vec![false; self.neighbours.len()];
        patch.nodes.iter().for_each(|&n| is_near[n as usize] = true);
        let near: Vec<&Sight> = self.sights.iter().filter(|sight| is_near[sight.node as usize]).collect();
        let caster = RayCaster::new(&patch.surface)?;
        let normals = patch.surface.triangle_normals();
        // The same wall as it was swept, bulges and all.
        let swept = Surface {
            nodes_mm: patch.nodes.iter().map(|&n| self.wall.swept_mm[n as usize]).collect(),
            triangles: patch.surface.triangles.clone(),
            arrays: Vec::new(),
        };
        let (swept_caster, swept_normals) = (RayCaster::new(&swept)?, swept.triangle_normals());
        let deepest_mm = (DEPTH_RADII * radius_mm).max(DEPTH_SDS * noise_mm);
        let edge_mm = (EDGE_SDS * noise_mm).max(EDGE_RADII * lumen_mm);
        let off_mm = (EDGE_SDS * noise_mm).max(OFF_SWEPT_RADII * lumen_mm);
        let is_off_swept = |echo: &WorldEcho| {
            Crossing::of(&swept_caster, &swept_normals, echo, 0.0).is_some_and(|c| c.depth_mm > off_mm)
        };
        let every = near.len().div_ceil(MOST_ECHOES).max(1);
        let look = |sight: &&Sight| {
            let echo = &sight.echo;
            let Crossing { at_mm, depth_mm, .. } =
                Crossing::of(&caster, &normals, echo, WITHIN_SDS * noise_mm)?;
            let share = depth_mm.max(0.0) / deepest_mm;
            let is_beyond = depth_mm > edge_mm;
            let is_others = is_beyond && self.beside[sight.node as usize].is_some_and(|of| is_other[of]);
            (share < 1.0 && !is_others).then(|| Look {
                point_mm: echo.point_mm,
                image_normal: echo.image_normal,
                at_mm,
                depth_mm,
                is_beyond,
                is_off_swept: is_beyond && is_off_swept(echo),
                frame: echo.frame,
                // Those that noise alone may have moved so far count little.
                weight: match is_beyond {
                    true => tukey_weight(share) * (depth_mm / edge_mm - 1.0).min(1.0),
                    false => 1.0,
                },
            })
        };
        Ok(near.into_par_iter().step_by(every).filter_map(|sight| look(&sight)).collect())
    }
}

impl Suspect {
    fn radius_mm(&self) -> f64 {
        (self.area_mm2 / PI).sqrt()
    }

    /// Whether it lies in the mouth of a branch. Backwards, the branch's tube goes on to the wall across from the mouth, which
    /// faces the other way, and may have a mouth of its own.
    fn is_in(&self, tube: &LocalTube) -> bool {
        outside_mm(tube, self.centre_mm) < 0.0 && self.outward.dot(tube.world_from_axis.rotation.z_axis) > 0.0
    }

    /// Tubes to begin the fit with: straight out, towards the echoes, and aslant.
    fn starts(&self, away: DVec3) -> Vec<LocalTube> {
        let radius_mm = self.radius_mm();
        let (across, other) = self.outward.any_orthonormal_pair();
        let tilted = (0..4).map(|k| {
            let (sin, cos) = (f64::from(k) / 4.0 * TAU).sin_cos();
            self.outward + across * cos + other * sin
        });
        let directions = [self.outward, away].into_iter().chain(tilted);
        let of = |direction: DVec3| {
            let z = direction.try_normalize().filter(|z| z.dot(self.outward) > 0.0)?;
            let (x, y) = z.any_orthonormal_pair();
            let pose = Pose { rotation: DMat3::from_cols(x, y, z), translation_mm: self.centre_mm };
            Some(LocalTube::straight(pose, radius_mm * z.dot(self.outward).sqrt()))
        };
        directions.filter_map(of).collect()
    }
}

/// A part of the echoes that weighs as much as all: so many of the wall and of the branch at most.
fn thinned(looks: &[Look], most: usize) -> Vec<Look> {
    let of = |is_beyond: bool| {
        let looks: Vec<&Look> = looks.iter().filter(|look| look.is_beyond == is_beyond).collect();
        let every = looks.len().div_ceil(most).max(1);
        let weighted = |look: &Look| Look { weight: look.weight * every as f64, ..*look };
        looks.into_iter().step_by(every).map(weighted).collect::<Vec<_>>()
    };
    [of(false), of(true)].concat()
}

/// What was seen of a branch.
struct Seen {
    frames: usize,
    echoes: usize,
    depth_mm: f64,
}

/// Standard errors of a mouth.
struct Errors {
    centre_mm: f64,
    area_mm2: f64,
    direction_deg: f64,
}

impl Branch<'_> {
    /// What was seen of a branch; `None` where it is not seen well enough to be one.
    fn seen(&self, tube: &LocalTube, mouth_mm: DVec3) -> Option<Seen> {
        let to_axis = tube.world_from_axis.inverse();
        let mouth_at_mm = tube.station(to_axis.transform_point(mouth_mm));
        let (mut through, mut leaving, mut beyond) = (0, 0, 0);
        let (mut sectors, mut depths, mut frames) = ([0_usize; SECTORS], Vec::new(), BTreeSet::new());
        let (mut off_swept, mut beyond_wall_mm) = (0, Vec::new());
        for look in self.looks {
            if outside_mm(tube, look.at_mm) < -0.3 * tube.radius_mm {
                through += 1;
                leaving += usize::from(look.depth_mm > LEAVING_SDS * self.noise_mm);
            }
            if !look.is_beyond {
                continue;
            }
            beyond += 1;
            let p = to_axis.transform_point(look.point_mm);
            let Residual { distance_mm, variance, .. } = self.residual(tube, &to_axis, look);
            if distance_mm.abs() < 3.0 * self.noise_mm * variance.sqrt() {
                sectors[sector(p)] += 1;
                off_swept += usize::from(look.is_off_swept);
                beyond_wall_mm.push(look.depth_mm);
                depths.push(tube.station(p) - mouth_at_mm);
                frames.insert(look.frame);
            }
        }
        let largest = |values: &mut Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() * 9 / 10).copied().unwrap_or(0.0)
        };
        let (depth_mm, beyond_wall_mm) = (largest(&mut depths), largest(&mut beyond_wall_mm));
        let is_bulge = (off_swept as f64) < LEAST_OFF_SWEPT * depths.len() as f64;
        let is_one = leaving as f64 >= LEAST_LEAVING * f64::from(through)
            && depths.len() as f64 >= LEAST_ON_TUBE * f64::from(beyond)
            && sectors.iter().filter(|&&n| n > 1).count() >= LEAST_SECTORS
            && depth_mm >= LEAST_DEPTH_RADII * tube.radius_mm
            && (!is_bulge || beyond_wall_mm >= LEAST_DEPTH_RADII * tube.radius_mm)
            && depths.len() >= LEAST_ECHOES
            && frames.len() >= LEAST_FRAMES;
        is_one.then_some(Seen { frames: frames.len(), echoes: depths.len(), depth_mm })
    }

    /// Standard errors by a jackknife over groups of frames, or over sectors of the branch where that gives more: a branch
    /// is no tube, and its own shape is alike in all frames; with what its shape leaves open of the rim. `None` where there is
    /// no mouth without one of the groups of frames.
    fn errors(&self, patch: &Patch, tube: &LocalTube) -> Option<Errors> {
        let frames: BTreeSet<u32> = self.looks.iter().map(|look| look.frame).collect();
        let frames: Vec<u32> = frames.into_iter().collect();
        let run = frames.len().div_ceil(RUNS).max(1);
        let of_frame = |look: &Look| frames.partition_point(|&other| other < look.frame) / run % GROUPS;
        let by_frames: Vec<Measured> =
            self.without_each(patch, tube, GROUPS, &of_frame).into_iter().collect::<Option<_>>()?;
        let to_axis = tube.world_from_axis.inverse();
        let of_sector = |look: &Look| sector(to_axis.transform_point(look.point_mm));
        let by_sectors: Vec<Measured> =
            self.without_each(patch, tube, SECTORS, &of_sector).into_iter().flatten().collect();
        let [of_frames, of_sectors] = [by_frames, by_sectors].map(|without| Errors::of(&without));
        // Where the branch leaves aslant, a little of its radius is much of the rim.
        let by_mm = RIM_RADII * tube.radius_mm;
        let [narrow, wide] = [-by_mm, by_mm]
            .map(|by_mm| LocalTube { radius_mm: tube.radius_mm + by_mm, ..*tube })
            .map(|tube| patch.within(&tube, self.centre_mm));
        let (narrow, wide) = (narrow?, wide?);
        let of_rim_mm = 0.5 * wide.centre_mm.distance(narrow.centre_mm);
        let of_shape_mm = CENTRE_SHARE * 0.5 * (wide.area_mm2 + narrow.area_mm2) / (PI * tube.radius_mm);
        let of_rim_mm2 = 0.5 * (wide.area_mm2 - narrow.area_mm2);
        Some(Errors {
            centre_mm: of_frames.centre_mm.max(of_sectors.centre_mm).hypot(of_rim_mm).hypot(of_shape_mm),
            area_mm2: of_frames.area_mm2.max(of_sectors.area_mm2).hypot(of_rim_mm2),
            direction_deg: of_frames.direction_deg.max(of_sectors.direction_deg),
        })
    }

    /// The mouth without each of some groups of echoes.
    fn without_each(
        &self,
        patch: &Patch,
        tube: &LocalTube,
        groups: usize,
        group: &(dyn Fn(&Look) -> usize + Sync),
    ) -> Vec<Option<Measured>> {
        (0..groups)
            .into_par_iter()
            .map(|left_out| {
                let tube = self.fitted(*tube, &|look| group(look) != left_out)?;
                patch.within(&tube, self.centre_mm)
            })
            .collect()
    }
}

/// The sector of a branch that a point lies in, given in its tube's coordinates.
fn sector(p: DVec3) -> usize {
    ((p.y.atan2(p.x).rem_euclid(TAU) / TAU * SECTORS as f64) as usize).min(SECTORS - 1)
}

impl Errors {
    /// The jackknife's standard errors from the mouths without each of the groups: none of less than two.
    fn of(without: &[Measured]) -> Self {
        let count = without.len().max(1) as f64;
        let error = |squares: f64| ((count - 1.0) / count * squares).sqrt();
        let area_mm2 = without.iter().map(|m| m.area_mm2).sum::<f64>() / count;
        let centre_mm = without.iter().map(|m| m.centre_mm).sum::<DVec3>() / count;
        let direction = without.iter().map(|m| m.direction).sum::<DVec3>().normalize_or_zero();
        let sum = |of: &dyn Fn(&Measured) -> f64| without.iter().map(of).sum::<f64>();
        Self {
            centre_mm: error(sum(&|m| m.centre_mm.distance_squared(centre_mm))),
            area_mm2: error(sum(&|m| (m.area_mm2 - area_mm2).powi(2))),
            direction_deg: error(sum(&|m| m.direction.angle_between(direction).to_degrees().powi(2))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mouth_across_the_vessel_is_another_one() {
        let suspect = |centre_mm: DVec3, outward: DVec3| Suspect {
            branch: 0,
            nodes: Vec::new(),
            centre_mm,
            area_mm2: 10.0,
            outward,
        };
        // A branch of 4 mm radius that leaves the vessel at y = 8 mm.
        let rotation = DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y);
        let pose = Pose { rotation, translation_mm: 8.0 * DVec3::Y };
        let tube = LocalTube::straight(pose, 4.0);
        assert!(suspect(DVec3::new(3.0, 8.0, 0.0), DVec3::Y).is_in(&tube));
        assert!(!suspect(DVec3::new(5.0, 8.0, 0.0), DVec3::Y).is_in(&tube));
        assert!(!suspect(-8.0 * DVec3::Y, -DVec3::Y).is_in(&tube));
    }
}
