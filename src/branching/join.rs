//! One surface of several tubes that meet.
//!
//! Away from partings the surface has the nodes of the tubes' own grids. Where tubes meet, whole rings of them give way to
//! the surface of the union: the zero of the least of their distances, found by marching tetrahedra in the cells along
//! the walls, cut off half a ring before the first ring that stays, sewn to it, and remeshed at the grids' resolution.

use super::tube::{Spot, Tube};
use crate::Result;
use crate::surface::marching::{Crossings, Lattice};
use crate::surface::remesh::{Patches, remeshed};
use crate::surface::{Groups, Surface, Topology, face_triangles};
use glam::{DVec3, I64Vec3};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Rings whose wall is nearer than this to that of another tube, in edges, give way …
const NEAR_EDGES: f64 = 2.0;
/// … and so many rings beside them.
const BESIDE: usize = 2;
/// How a cut is tried again as long as the union has defects: rings by which zones are widened, and the reach of smoothing
/// in edges. Where two walls lie close to each other at the end of a zone, the cut goes through both; and where they touch
/// again beside the parting, as noisy walls may, there is a tunnel between them, which smoothing closes.
const TRIES: [(usize, f64); 9] =
    [(0, 0.0), (2, 0.0), (4, 0.0), (8, 0.0), (16, 0.0), (0, 2.0), (2, 4.0), (4, 8.0), (8, 12.0)];
/// Steps in which the part of a ring that lies inside another tube is found, and rings over which a tube is narrowed to it.
const SHARES: usize = 10;
const NARROWED: usize = 12;
/// Edge of a cell of the lattice, in edges of the finest grid, or as a share of the coarsest grid's edge, and of the smallest radius
/// at most. The surface's nodes lie closer to each other than a cell's corners.
const FINEST_SHARE: f64 = 1.3;
const COARSEST_SHARE: f64 = 1.0;
const RADIUS_SHARE: f64 = 0.2;
/// Rounds of remeshing.
const ROUNDS: usize = 4;
/// Bounds of the distance that the field gives where a tube has none, in edges.
const FAR_EDGES: f64 = 4.0;

/// Where a node of the joined surface comes from.
#[derive(Debug, Clone, Copy)]
pub(super) enum Origin {
    /// A node of a tube's grid.
    Grid { tube: usize, node: usize },
    /// A place on the wall of a tube, near where tubes meet.
    Parting { tube: usize, spot: Spot },
}

/// The joined surface.
pub(super) struct Joined {
    pub surface: Surface,
    /// Of each node.
    pub origin: Vec<Origin>,
    /// Of each node: the place where tubes meet that it belongs to, counted from 0; `None` on a grid.
    pub parting: Vec<Option<usize>>,
    /// Rings of grids to which no rim of the union was found to sew: the surface is open there.
    pub unsewn: usize,
}

/// Rings of a tube that give way to the union.
#[derive(Debug, Clone)]
struct Zone {
    tube: usize,
    first: usize,
    last: usize,
    /// Tubes and rings near it.
    meets: Vec<(usize, usize)>,
    /// Ends of the vessel in it.
    open_ends: usize,
}

/// Joins tubes. `inner_ends` says which tubes the first and the last ring of each lie in; `None` at an end of the vessel.
/// `is_supported` says whether a tube's echoes support a node of its grid.
pub(super) fn joined(
    tubes: &mut [Tube],
    inner_ends: &[[Option<usize>; 2]],
    is_supported: &dyn Fn(usize, usize) -> bool,
) -> Result<Joined> {
    let narrowed = trim(tubes, inner_ends);
    let tubes = &*tubes;
    let zones = zones(tubes, inner_ends, &narrowed, is_supported);
    let partings = partings(&zones);
    let room = room(tubes, &zones);
    let patch_of = |members: &Vec<usize>| {
        let tried = |(by, smoothed): (usize, f64)| {
            let zone = |&z: &usize| {
                let Zone { first, last, .. } = zones[z];
                let [lowest, highest] = room[z];
                let (first, last) = (first.saturating_sub(by).max(lowest), (last + by).min(highest));
                Zone { first, last, ..zones[z].clone() }
            };
            Cut::of(tubes, members.iter().map(zone).collect(), smoothed)
        };
        let mut cut = tried(TRIES[0]);
        for again in &TRIES[1..] {
            if cut.defects == 0 {
                break;
            }
            let other = tried(*again);
            if other.defects < cut.defects {
                cut = other;
            }
        }
        cut.patch(tubes)
    };
    let patches = partings.par_iter().map(patch_of).collect::<Result<Vec<_>>>()?;
    Ok(assembled(tubes, patches))
}

/// How far each zone may be widened: its lowest first and its highest last ring. One strip stays before an end of the vessel
/// and between two zones.
fn room(tubes: &[Tube], zones: &[Zone]) -> Vec<[usize; 2]> {
    let of_zone = |(z, zone): (usize, &Zone)| {
        let (low, high) = (*tubes[zone.tube].rings.start(), *tubes[zone.tube].rings.end());
        let beside = |other: Option<&Zone>| other.filter(|other| other.tube == zone.tube).cloned();
        let before = beside(z.checked_sub(1).map(|z| &zones[z]));
        let after = beside(zones.get(z + 1));
        // Each has half of the gap between them.
        let lowest = before.map_or(low + 1, |before| (before.last + zone.first) / 2 + 1);
        let highest = after.map_or(high.saturating_sub(1), |after| (zone.last + after.first) / 2);
        [lowest.min(zone.first), highest.max(zone.last)]
    };
    zones.iter().enumerate().map(of_zone).collect()
}

/// Drops the rings that lie deep inside other tubes: up to the outermost ring that is wholly inside. Where none is, the
/// innermost rings are narrowed until they are. Gives the rings of each tube that were narrowed: no echo shows these.
fn trim(tubes: &mut [Tube], inner_ends: &[[Option<usize>; 2]]) -> Vec<Vec<usize>> {
    let mut narrowed = vec![Vec::new(); tubes.len()];
    for number in 0..tubes.len() {
        for end in [0, 1] {
            let Some(other) = inner_ends[number][end] else { continue };
            let tube = &tubes[number];
            let (first, last) = (*tube.rings.start(), *tube.rings.end());
            let ring = |k: usize| if end == 0 { first + k } else { last - k };
            let margin_mm = -0.5 * tube.edge_mm;
            // The share of a ring's radii that lies inside: the least of its nodes' shares, so that only less is tried.
            let share = |k: usize| -> f64 {
                let origin = tube.axis.points_mm[ring(k)];
                let inside = (0..tube.nodes).try_fold(SHARES, |most, j| {
                    let p = tube.node_mm(ring(k), j);
                    let place = |share: usize| origin.lerp(p, share as f64 / SHARES as f64);
                    (1..=most).rev().find(|&share| tubes[other].outside_mm(place(share)) < margin_mm)
                });
                inside.unwrap_or(0) as f64 / SHARES as f64
            };
            let shares: Vec<f64> = (0..(last - first) / 2).into_par_iter().map(share).collect();
            let whole = shares.iter().rposition(|&share| share == 1.0);
            let most = || (0..shares.len()).max_by(|&a, &b| shares[a].total_cmp(&shares[b]).then(a.cmp(&b)));
            let Some(k) = whole.or_else(most) else { continue };
            let (start, share) = (ring(k), shares[k]);
            let tube = &mut tubes[number];
            tube.rings = if end == 0 { start..=last } else { first..=start };
            for away in 0..if share < 1.0 { NARROWED } else { 0 } {
                let ring = if end == 0 { start + away } else { start - away.min(start) };
                let factor = share + (1.0 - share) * away as f64 / NARROWED as f64;
                let nodes = ring * tube.nodes..(ring + 1) * tube.nodes;
                tube.radii_mm.get_mut(nodes).into_iter().flatten().for_each(|radius| *radius *= factor);
                narrowed[number].push(ring);
            }
        }
    }
    narrowed
}

/// Lets the rings beside those that give way do so too, up to the last of the next `most` that lacks support while the one behind
/// it has it. Between two rings that give way all do, if one lacks support and they are at most twice as many.
fn extend(gives_way: &mut [bool], has_support: &[bool], most: usize) {
    let mut runs: Vec<Range<usize>> = Vec::new();
    let mut start = 0;
    for run in gives_way.chunk_by(|a, b| a == b) {
        if !run[0] {
            runs.push(start..start + run.len());
        }
        start += run.len();
    }
    for run in runs {
        let (after, before) = (run.start > 0, run.end < gives_way.len());
        if after && before && run.len() <= 2 * most && has_support[run.clone()].contains(&false) {
            gives_way[run].fill(true);
            continue;
        }
        let is_last =
            |k: usize, behind: usize| run.contains(&behind) && !has_support[k] && has_support[behind];
        if after {
            let mut near = (run.start..(run.start + most).min(run.end)).rev();
            if let Some(last) = near.find(|&k| is_last(k, k + 1)) {
                gives_way[run.start..=last].fill(true);
            }
        }
        if before {
            let mut near = run.end.saturating_sub(most).max(run.start)..run.end;
            if let Some(last) = near.find(|&k| k > 0 && is_last(k, k - 1)) {
                gives_way[last..run.end].fill(true);
            }
        }
    }
}

/// The rings of all tubes that come near another tube or were narrowed, and those beside them that the echoes of their branch do
/// not support: those of another branch may.
fn zones(
    tubes: &[Tube],
    inner_ends: &[[Option<usize>; 2]],
    narrowed: &[Vec<usize>],
    is_supported: &dyn Fn(usize, usize) -> bool,
) -> Vec<Zone> {
    let mut zones: Vec<Zone> = Vec::new();
    for (number, tube) in tubes.iter().enumerate() {
        let (first, last) = (*tube.rings.start(), *tube.rings.end());
        let meets: Vec<Vec<(usize, usize)>> = (first..=last)
            .into_par_iter()
            .map(|k| {
                let mut meets = Vec::new();
                let own = &tube.radii_mm[k * tube.nodes..(k + 1) * tube.nodes];
                let (middle_mm, radius_mm) =
                    (tube.axis.points_mm[k], own.iter().copied().fold(0.0, f64::max));
                let others: Vec<(usize, &Tube)> = tubes
                    .iter()
                    .enumerate()
                    .filter(|(o, other)| *o != number && other.may_reach(middle_mm, radius_mm))
                    .collect();
                for j in 0..if others.is_empty() { 0 } else { tube.nodes } {
                    let p = tube.node_mm(k, j);
                    for &(o, other) in &others {
                        let margin_mm = NEAR_EDGES * tube.edge_mm.max(other.edge_mm);
                        if let Some(spot) = other.spot(p).filter(|spot| spot.outside_mm < margin_mm) {
                            meets.push((o, spot.ring.round() as usize));
                        }
                    }
                }
                meets.sort_unstable();
                meets.dedup();
                meets
            })
            .collect();
        let mut gives_way: Vec<bool> = meets.iter().map(|meets| !meets.is_empty()).collect();
        for ring in narrowed[number].iter().filter(|ring| (first..=last).contains(*ring)) {
            gives_way[ring - first] = true;
        }
        let has_support: Vec<bool> = (first..=last)
            .map(|k| (k * tube.nodes..(k + 1) * tube.nodes).all(|node| is_supported(number, node)))
            .collect();
        let most = (tube.median_radius_mm() / tube.axis.step_mm) as usize;
        extend(&mut gives_way, &has_support, most);
        let mut k = first;
        while k <= last {
            if !gives_way[k - first] {
                k += 1;
                continue;
            }
            let start = k;
            let mut end = k;
            // Short stretches between two zones belong to them.
            while let Some(next) =
                (end + 1..=(end + 2 * BESIDE + 2).min(last)).rev().find(|&k| gives_way[k - first])
            {
                end = next;
            }
            let (mut zone_first, mut zone_last) =
                (start.saturating_sub(BESIDE).max(first), (end + BESIDE).min(last));
            if inner_ends[number][0].is_some()
                && zones.last().is_none_or(|z| z.tube != number)
                && start < first + (last - first) / 2
            {
                zone_first = first;
            }
            if inner_ends[number][1].is_some() && end + BESIDE >= last {
                zone_last = last;
            }
            let mut near: Vec<(usize, usize)> = meets[start - first..=end - first].concat();
            near.sort_unstable();
            near.dedup();
            let is_open =
                |end: usize, ring: usize, limit: usize| ring == limit && inner_ends[number][end].is_none();
            let open_ends =
                usize::from(is_open(0, zone_first, first)) + usize::from(is_open(1, zone_last, last));
            zones.push(Zone { tube: number, first: zone_first, last: zone_last, meets: near, open_ends });
            k = end + 1;
        }
    }
    zones
}

/// Zones that meet, by their numbers.
fn partings(zones: &[Zone]) -> Vec<Vec<usize>> {
    let mut groups = Groups::new(zones.len());
    for (a, zone) in zones.iter().enumerate() {
        for &(tube, ring) in &zone.meets {
            let b = zones.iter().position(|z| z.tube == tube && (z.first..=z.last).contains(&ring));
            if let Some(b) = b {
                groups.join(a as u32, b as u32);
            }
        }
    }
    let mut partings: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for zone in 0..zones.len() {
        partings.entry(groups.root(zone as u32)).or_default().push(zone);
    }
    partings.into_values().collect()
}

/// The union's surface about one parting, up to the rings that stay.
struct Patch {
    zones: Vec<Zone>,
    surface: Surface,
    origin: Vec<(usize, Spot)>,
    unsewn: usize,
}

/// The same as it was found and cut off, before its triangles are made even.
struct Cut {
    zones: Vec<Zone>,
    /// The tubes that meet.
    members: Vec<usize>,
    edge_mm: f64,
    surface: Surface,
    /// The nodes of the rings that it is sewn to.
    fixed: Vec<u32>,
    /// Rings without a rim to sew to.
    unsewn: usize,
    /// These, rims that belong to no ring and no end of the vessel, and tunnels.
    defects: usize,
}

/// A ring of a grid that a patch is sewn to.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Seam {
    tube: usize,
    ring: usize,
    /// Whether the patch lies on the side of the lower rings.
    below: bool,
}

/// The tube with the nearest wall, and the place there.
fn nearest(tubes: &[Tube], members: &[usize], p: DVec3) -> Option<(usize, Spot)> {
    let spots = members.iter().filter_map(|&t| Some((t, tubes[t].spot(p)?)));
    spots.min_by(|a, b| a.1.outside_mm.total_cmp(&b.1.outside_mm).then(a.0.cmp(&b.0)))
}

/// The least of some distances, less by up to a quarter of the reach where the next is within that; far where there is none.
fn smooth_least(distances_mm: impl Iterator<Item = f64>, reach_mm: f64) -> f64 {
    let [least, next] =
        distances_mm.fold(
            [f64::INFINITY; 2],
            |[least, next], d| {
                if d < least { [d, least] } else { [least, next.min(d)] }
            },
        );
    let near = if reach_mm > 0.0 { (1.0 - (next - least) / reach_mm).max(0.0) } else { 0.0 };
    if near > 0.0 { least - 0.25 * reach_mm * near * near } else { least }
}

impl Cut {
    /// The union's surface about the zones of one parting, smoothed over so many edges.
    fn of(tubes: &[Tube], zones: Vec<Zone>, smoothed: f64) -> Self {
        let mut members: Vec<usize> = zones.iter().map(|zone| zone.tube).collect();
        members.sort_unstable();
        members.dedup();
        let edge_mm = cell_edge_mm(members.iter().map(|&t| &tubes[t]));
        let far_mm = FAR_EDGES * edge_mm;
        let nearest = |p: DVec3| nearest(tubes, &members, p);
        let smoothed_mm = smoothed * edge_mm;
        // Smoothing moves the wall by a quarter of its reach at most.
        let around = 1 + (0.25 * smoothed).ceil() as i64;
        let field = |p: DVec3| {
            let distances = members.iter().filter_map(|&t| Some(tubes[t].spot(p)?.outside_mm));
            smooth_least(distances, smoothed_mm).clamp(-far_mm, far_mm)
        };

        let first = &zones[0];
        let tube = &tubes[first.tube];
        let lattice = Lattice { origin_mm: tube.node_mm(first.first, 0), step_mm: DVec3::splat(edge_mm) };
        let mut cells: Vec<I64Vec3> = zones
            .par_iter()
            .flat_map_iter(|zone| {
                let tube = &tubes[zone.tube];
                let low = zone.first.saturating_sub(2).max(*tube.rings.start());
                let high = (zone.last + 2).min(*tube.rings.end());
                // As close as the cells, where those of a finer grid are smaller than a coarser grid's.
                let parts = 2 * (tube.edge_mm / edge_mm).ceil() as usize;
                let places = (parts * low..=parts * high)
                    .flat_map(move |k| (0..parts * tube.nodes).map(move |j| (k, j)));
                let mut cells: Vec<I64Vec3> = places
                    .map(|(k, j)| {
                        let ring = k as f64 / parts as f64;
                        let theta_rad = TAU * j as f64 / (parts * tube.nodes) as f64;
                        lattice.cell(tube.axis.point_between_mm(
                            ring,
                            theta_rad,
                            tube.radius_mm(ring, theta_rad),
                        ))
                    })
                    .collect();
                cells.sort_unstable_by_key(I64Vec3::to_array);
                cells.dedup();
                cells
            })
            .flat_map_iter(|cell| {
                let side = 2 * around + 1;
                let offset = move |k: i64| I64Vec3::new(k % side, k / side % side, k / side / side) - around;
                (0..side * side * side).map(move |k| cell + offset(k))
            })
            .collect();
        cells.par_sort_unstable_by_key(I64Vec3::to_array);
        cells.dedup();
        let whole = lattice.zero_surface(&cells, Crossings::FalsePosition, field);

        // Rings within the zones, and half a ring off those that stay.
        let within = |(tube, spot): (usize, Spot)| -> f64 {
            let of_tube = zones.iter().filter(|zone| zone.tube == tube);
            let inside = of_tube.map(|zone| {
                let low = if zone.first == *tubes[tube].rings.start() {
                    f64::INFINITY
                } else {
                    spot.ring - zone.first as f64 - 0.5
                };
                let end = zone.last as f64 - 0.5;
                low.min(end - spot.ring)
            });
            inside.fold(-1.0, f64::max)
        };
        let inside: Vec<f64> = whole.nodes_mm.par_iter().map(|p| nearest(*p).map_or(-1.0, within)).collect();
        let mut surface = largest_part(&whole.clipped(&inside));
        let mut seams: Vec<Seam> = Vec::new();
        for zone in &zones {
            let rings = &tubes[zone.tube].rings;
            if zone.first > *rings.start() {
                seams.push(Seam { tube: zone.tube, ring: zone.first, below: false });
            }
            if zone.last < *rings.end() {
                seams.push(Seam { tube: zone.tube, ring: zone.last, below: true });
            }
        }
        let mut fixed = Vec::new();
        let mut rims = surface.rims();
        let mut unsewn = 0;
        for seam in seams {
            let edge = if seam.below { seam.ring as f64 - 0.5 } else { seam.ring as f64 + 0.5 };
            let at = |node: u32| {
                let spot = nearest(surface.nodes_mm[node as usize]);
                spot.is_some_and(|(tube, spot)| tube == seam.tube && (spot.ring - edge).abs() < 0.25)
            };
            // Beside the rim there may be small holes.
            let at_seam = rims.iter().map(|rim| rim.iter().filter(|&&n| at(n)).count()).enumerate();
            let most = at_seam.max_by(|a, b| a.1.cmp(&b.1).then(b.0.cmp(&a.0)));
            let Some((which, _)) = most.filter(|&(which, count)| 2 * count > rims[which].len()) else {
                unsewn += 1;
                continue;
            };
            let rim = rims.swap_remove(which);
            let theta: Vec<f64> = rim
                .iter()
                .map(|&n| {
                    tubes[seam.tube].spot(surface.nodes_mm[n as usize]).map_or(0.0, |spot| spot.theta_rad)
                })
                .collect();
            fixed.extend(sew(&mut surface, &tubes[seam.tube], seam, &rim, &theta));
        }
        let open_ends: usize = zones.iter().map(|zone| zone.open_ends).sum();
        let holes = rims.len().saturating_sub(open_ends);
        let Topology { components, boundary_loops, euler_characteristic, .. } = surface.topology();
        let of_tunnels = 2 * components as i64 - boundary_loops as i64 - euler_characteristic;
        let defects = unsewn + holes + (of_tunnels.max(0) / 2) as usize;
        Self { zones, members, edge_mm, surface, fixed, unsewn, defects }
    }

    /// Makes the triangles even.
    fn patch(self, tubes: &[Tube]) -> Result<Patch> {
        let Self { zones, members, edge_mm, surface, fixed, unsewn, .. } = self;
        let nearest = |p: DVec3| nearest(tubes, &members, p);
        let triangles = surface.triangles.len();
        let patches = Patches {
            nodes_mm: surface.nodes_mm,
            triangles: surface.triangles,
            patch: vec![0; triangles],
            fixed,
        };
        let wanted = |p: DVec3| nearest(p).map_or(edge_mm, |(t, _)| tubes[t].edge_mm);
        let even = remeshed(&patches, &wanted, ROUNDS)?.surface();
        let fallback = (members[0], Spot { ring: 0.0, theta_rad: 0.0, outside_mm: 0.0 });
        let origin = even.nodes_mm.par_iter().map(|p| nearest(*p).unwrap_or(fallback)).collect();
        Ok(Patch { zones, surface: even, origin, unsewn })
    }
}

/// Edge of a cell of the lattice, mm: nearly that of the coarsest grid, but not too long for the smallest lumen. Remeshing
/// makes shorter edges where the grids have them.
fn cell_edge_mm<'a>(tubes: impl Iterator<Item = &'a Tube<'a>> + Clone) -> f64 {
    let edges = tubes.clone().map(|tube| tube.edge_mm);
    let (finest, coarsest) =
        edges.fold((f64::INFINITY, 0.0_f64), |(low, high), edge| (low.min(edge), high.max(edge)));
    let radius_mm = tubes.map(Tube::median_radius_mm).fold(f64::INFINITY, f64::min);
    (FINEST_SHARE * finest).max((COARSEST_SHARE * coarsest).min(RADIUS_SHARE * radius_mm))
}

/// The part with most triangles, and the nodes that it uses.
fn largest_part(surface: &Surface) -> Surface {
    let mut groups = Groups::new(surface.nodes_mm.len());
    for &[a, b, c] in &surface.triangles {
        groups.join(a, b);
        groups.join(b, c);
    }
    let mut sizes: BTreeMap<u32, usize> = BTreeMap::new();
    surface.triangles.iter().for_each(|t| *sizes.entry(groups.root(t[0])).or_default() += 1);
    let largest = sizes.iter().max_by(|a, b| a.1.cmp(b.1).then(b.0.cmp(a.0))).map(|(&root, _)| root);
    surface.part(|t| Some(groups.root(t[0])) == largest).0
}

/// Adds the nodes of a ring and the triangles between it and a rim; gives the ring's nodes.
fn sew(surface: &mut Surface, tube: &Tube, seam: Seam, rim: &[u32], theta_rad: &[f64]) -> Vec<u32> {
    let first = surface.nodes_mm.len() as u32;
    surface.nodes_mm.extend((0..tube.nodes).map(|j| tube.node_mm(seam.ring, j)));
    // The rim in ascending angle, unwrapped from its lowest.
    let turn = |a: f64, b: f64| (b - a + PI).rem_euclid(TAU) - PI;
    let count = rim.len();
    let winding: f64 = (0..count).map(|i| turn(theta_rad[i], theta_rad[(i + 1) % count])).sum();
    let mut order: Vec<usize> = (0..count).collect();
    if winding < 0.0 {
        order.reverse();
    }
    let lowest =
        (0..count).fold(0, |best, i| if theta_rad[order[i]] < theta_rad[order[best]] { i } else { best });
    order.rotate_left(lowest);
    let mut angles = vec![theta_rad[order[0]]];
    for pair in order.windows(2) {
        angles.push(angles[angles.len() - 1] + turn(theta_rad[pair[0]], theta_rad[pair[1]]));
    }
    angles.push(angles[0] + TAU);
    let rim_at = |i: usize| rim[order[i % count]];
    let ring_at = |j: usize| first + (j % tube.nodes) as u32;
    let ring_angle = |j: usize| TAU * j as f64 / tube.nodes as f64;
    let (mut i, mut j) = (0, 0);
    while i < count || j < tube.nodes {
        let advance_rim = j == tube.nodes || (i < count && angles[i + 1] < ring_angle(j + 1));
        let triangle = if advance_rim {
            [rim_at(i), rim_at(i + 1), ring_at(j)]
        } else {
            [rim_at(i), ring_at(j + 1), ring_at(j)]
        };
        surface.triangles.push(if seam.below { triangle } else { [triangle[0], triangle[2], triangle[1]] });
        if advance_rim { i += 1 } else { j += 1 }
    }
    (first..first + tube.nodes as u32).collect()
}

/// The rings that stay, and the patches.
fn assembled(tubes: &[Tube], patches: Vec<Patch>) -> Joined {
    let mut joined = Joined {
        surface: Surface::default(),
        origin: Vec::new(),
        parting: Vec::new(),
        unsewn: patches.iter().map(|patch| patch.unsewn).sum(),
    };
    let mut at_place: HashMap<[u64; 3], u32> = HashMap::new();
    let place = |p: DVec3| p.to_array().map(f64::to_bits);
    for (number, tube) in tubes.iter().enumerate() {
        let zones = patches.iter().flat_map(|patch| &patch.zones);
        let of_tube: Vec<&Zone> = zones.filter(|zone| zone.tube == number).collect();
        // Whether the strip between a ring and the next stays.
        let stays = |k: usize| !of_tube.iter().any(|zone| zone.first <= k && k < zone.last);
        let rings = tube.rings.clone();
        let (low, high) = (*rings.start(), *rings.end());
        let mut starts: BTreeMap<usize, u32> = BTreeMap::new();
        for k in rings {
            if (k > low && stays(k - 1)) || (k < high && stays(k)) {
                starts.insert(k, joined.surface.nodes_mm.len() as u32);
                for j in 0..tube.nodes {
                    let p = tube.node_mm(k, j);
                    at_place.insert(place(p), joined.surface.nodes_mm.len() as u32);
                    joined.surface.nodes_mm.push(p);
                    joined.origin.push(Origin::Grid { tube: number, node: k * tube.nodes + j });
                    joined.parting.push(None);
                }
            }
        }
        for k in low..high {
            if !stays(k) {
                continue;
            }
            let (below, above) = (starts[&k], starts[&(k + 1)]);
            let n = tube.nodes as u32;
            for j in 0..n {
                let next = (j + 1) % n;
                joined.surface.triangles.extend(face_triangles(
                    below + j,
                    below + next,
                    above + next,
                    above + j,
                ));
            }
        }
    }
    for (parting, patch) in patches.into_iter().enumerate() {
        let nodes: Vec<u32> = patch
            .surface
            .nodes_mm
            .iter()
            .zip(&patch.origin)
            .map(|(p, &(tube, spot))| {
                if let Some(&node) = at_place.get(&place(*p)) {
                    return node;
                }
                joined.surface.nodes_mm.push(*p);
                joined.origin.push(Origin::Parting { tube, spot });
                joined.parting.push(Some(parting));
                (joined.surface.nodes_mm.len() - 1) as u32
            })
            .collect();
        let triangles = patch.surface.triangles.iter().map(|t| t.map(|n| nodes[n as usize]));
        joined.surface.triangles.extend(triangles);
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_without_support_beside_those_that_give_way_do_so_too() {
        // x gives way, - lacks support.
        let extended = |rings: &str| {
            let mut gives_way: Vec<bool> = rings.chars().map(|c| c == 'x').collect();
            let has_support: Vec<bool> = rings.chars().map(|c| c != '-').collect();
            extend(&mut gives_way, &has_support, 3);
            gives_way.into_iter().map(|gives_way| if gives_way { 'x' } else { '.' }).collect::<String>()
        };
        // Up to the support, also behind a ring that has some.
        assert_eq!(extended("xx--+++++"), "xxxx.....");
        assert_eq!(extended("xx+--++++"), "xxxxx....");
        assert_eq!(extended("++++--xx"), "....xxxx");
        // Too many, and none behind them: there the vessel ends.
        assert_eq!(extended("xx----+++"), "xx.......");
        assert_eq!(extended("xx---"), "xx...");
        assert_eq!(extended("---xx"), "...xx");
        // Between two that give way, of which each may take as many.
        assert_eq!(extended("x--++-x"), "xxxxxxx");
        assert_eq!(extended("x--++--+x"), "xxx..xxxx");
        assert_eq!(extended("x+++x"), "x...x");
    }
}
