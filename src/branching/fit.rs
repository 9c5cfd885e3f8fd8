//! The last fit of the joined surface to the echoes where tubes meet.
//!
//! No tube describes a parting: its wall is not star-shaped about an axis. The nodes there are moved along their normals by
//! u, which minimises `Σ w (d - u)² + λ ∫ (Δu)² dA`: d are the distances of the echoes to the surface, w Tukey's weights
//! and λ the weight of bending in the sweeps, so that u is as smooth as they are. u is 0 where the grids begin.

use super::echoes::{WorldEcho, WorldEchoes};
use super::join::{Joined, Origin};
use super::plate::{Laplacian, conjugate_gradients};
use super::tube::Tube;
use crate::Result;
use crate::numerics::robust::{median, tukey_weight};
use crate::surface::crossing::crossings;
use crate::surface::{RayCaster, Surface};
use crate::sweep::{MAX_ERROR_MEDIANS, MAX_ERROR_RADII, MAX_OFF_WALL, outward_bias_mm};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// How often the echoes are projected and the nodes moved.
const ROUNDS: usize = 3;
/// Cut-off of Tukey's weights, and the largest distance of an echo on the wall, in standard deviations of the noise.
const CUT_OFF: f64 = 4.685;
const ON_WALL: f64 = 3.0;
/// Least cosine between a ray and the normal of the wall that it meets: along a wall a ray says nothing of its place.
const LEAST_COSINE: f64 = 0.2;
/// Largest movement of a node in one round, in edges.
const MAX_EDGES: f64 = 1.5;
/// Rounds in which crossings are undone, those of them that go half way back, and rings of nodes about a crossing that move.
const UNTANGLING: usize = 24;
const HALVINGS: usize = 4;
const RINGS_ABOUT: usize = 2;

/// What is known of a tube's fit.
pub(super) struct TubeFit<'a> {
    /// Standard deviation of an echo about the wall, and along it, mm.
    pub noise_mm: f64,
    pub along_wall_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// Standard error of each node of its grid, mm, and whether it is supported.
    pub standard_error_mm: &'a [f64],
    pub supported: &'a [bool],
}

/// What the echoes say of a node where tubes meet.
#[derive(Debug, Clone, Copy)]
pub(super) struct NodeSupport {
    pub echoes: f64,
    pub residual_mm: f64,
    pub standard_error_mm: f64,
    pub last_frame: Option<u32>,
    pub supported: bool,
}

/// Moves the nodes where tubes meet; gives what supports each of them, `None` for those of the grids.
pub(super) fn fit(
    joined: &mut Joined,
    tubes: &[Tube],
    fits: &[TubeFit],
    echoes: &WorldEchoes,
) -> Result<Vec<Option<NodeSupport>>> {
    let mut support = vec![None; joined.origin.len()];
    let partings = joined.parting.iter().flatten().max().map_or(0, |last| last + 1);
    // Partings meet in grids only, whose nodes stay.
    let of_joined = &*joined;
    let fitted = |parting| -> Result<Option<(Part, Vec<NodeSupport>)>> {
        let Some(mut part) = Part::of(of_joined, parting, tubes, fits) else { return Ok(None) };
        let (near, mut hits) = part.near(echoes)?;
        let before = part.surface.nodes_mm.clone();
        for round in 0..ROUNDS {
            if round > 0 {
                part.cast_again(&near, &mut hits)?;
            }
            part.move_nodes(&part.seen(&near, &hits));
        }
        part.untangle(&before);
        part.cast_again(&near, &mut hits)?;
        let of_nodes = part.support(&part.seen(&near, &hits), of_joined, fits);
        Ok(Some((part, of_nodes)))
    };
    let parts = (0..partings).into_par_iter().map(fitted).collect::<Result<Vec<_>>>()?;
    for (part, of_nodes) in parts.into_iter().flatten() {
        for (local, &node) in part.nodes.iter().enumerate().filter(|(local, _)| part.is_free[*local]) {
            joined.surface.nodes_mm[node as usize] = part.surface.nodes_mm[local];
            support[node as usize] = Some(of_nodes[local]);
        }
    }
    Ok(support)
}

/// The surface about one parting.
struct Part {
    surface: Surface,
    /// Nodes of the joined surface.
    nodes: Vec<u32>,
    is_free: Vec<bool>,
    /// Of each node: the radius of the lumen, mm, and how far noise along the wall moves the mean echo out.
    radius_mm: Vec<f64>,
    bias_mm: Vec<f64>,
    noise_mm: f64,
    smoothness_mm2: f64,
    edge_mm: f64,
}

/// Where a ray meets the part: a triangle, and the distance from the probe, mm.
type Hit = (u32, f64);

/// An echo on a triangle of the part.
#[derive(Debug, Clone, Copy)]
struct Seen {
    triangle: u32,
    shares: [f64; 3],
    /// Distance to the wall, mm; positive outside.
    distance_mm: f64,
    frame: u32,
}

impl Part {
    fn of(joined: &Joined, parting: usize, tubes: &[Tube], fits: &[TubeFit]) -> Option<Self> {
        let is_free = |n: u32| joined.parting[n as usize] == Some(parting);
        let (surface, nodes) = joined.surface.part(|t| t.iter().any(|&n| is_free(n)));
        let mut members: Vec<usize> = Vec::new();
        let (mut radius_mm, mut bias_mm) = (Vec::new(), Vec::new());
        for &n in &nodes {
            let (tube, ring, theta_rad) = match joined.origin[n as usize] {
                Origin::Grid { tube, node } => {
                    let (ring, j) = (node / tubes[tube].nodes, node % tubes[tube].nodes);
                    (tube, ring as f64, TAU * j as f64 / tubes[tube].nodes as f64)
                }
                Origin::Parting { tube, spot } => (tube, spot.ring, spot.theta_rad),
            };
            let radius = tubes[tube].radius_mm(ring, theta_rad);
            radius_mm.push(radius);
            bias_mm.push(outward_bias_mm(radius, fits[tube].along_wall_mm));
            members.push(tube);
        }
        members.sort_unstable();
        members.dedup();
        let largest =
            |value: fn(&TubeFit) -> f64| members.iter().map(|&t| value(&fits[t])).fold(0.0, f64::max);
        (!nodes.is_empty()).then(|| Self {
            is_free: nodes.iter().map(|&n| is_free(n)).collect(),
            surface,
            radius_mm,
            bias_mm,
            noise_mm: largest(|fit| fit.noise_mm),
            smoothness_mm2: members.iter().map(|&t| fits[t].smoothness_mm2).fold(f64::INFINITY, f64::min),
            edge_mm: members.iter().map(|&t| tubes[t].edge_mm).fold(f64::INFINITY, f64::min),
            nodes,
        })
    }

    /// The echoes that may lie on it, now or once its nodes have moved, and where the rays to them meet it. Most of the echoes
    /// beside a parting lie on the grids about it.
    fn near(&self, echoes: &WorldEchoes) -> Result<(Vec<WorldEcho>, Vec<Option<Hit>>)> {
        let Some([low, high]) = self.surface.bounding_box_mm() else { return Ok(Default::default()) };
        let reach = DVec3::splat(CUT_OFF * self.noise_mm);
        let caster = RayCaster::new(&self.surface)?;
        let beyond_mm = CUT_OFF * self.noise_mm + ROUNDS as f64 * MAX_EDGES * self.edge_mm;
        let met = echoes.within([low - reach, high + reach]).into_par_iter().filter_map(|echo| {
            let (direction, length_mm) = echo.ray()?;
            let hit = caster.cast(echo.origin_mm, direction, length_mm + beyond_mm)?;
            Some((echo, Some(hit)))
        });
        Ok(met.unzip())
    }

    /// Updates where the rays to the echoes meet it, once its nodes have moved.
    fn cast_again(&self, echoes: &[WorldEcho], hits: &mut [Option<Hit>]) -> Result<()> {
        let caster = RayCaster::new(&self.surface)?;
        echoes.par_iter().zip(hits).for_each(|(echo, hit)| {
            *hit = echo.ray().and_then(|(direction, length_mm)| {
                let likely = hit.map(|(triangle, _)| triangle);
                let range_mm = length_mm + CUT_OFF * self.noise_mm;
                caster.cast_from(likely, echo.origin_mm, direction, range_mm)
            });
        });
        Ok(())
    }

    /// The echoes on the wall that the probe sees in their directions: not on the nearest, which across a thin wall between
    /// two branches may be the other branch's.
    fn seen(&self, echoes: &[WorldEcho], hits: &[Option<Hit>]) -> Vec<Seen> {
        let normals = self.surface.triangle_normals();
        let seen = echoes.par_iter().zip(hits).filter_map(|(echo, hit)| {
            let (direction, length_mm) = echo.ray()?;
            let (triangle, distance_mm) = (*hit)?;
            let normal = normals[triangle as usize];
            if distance_mm >= length_mm + CUT_OFF * self.noise_mm || direction.dot(normal) < LEAST_COSINE {
                return None;
            }
            let corners = self.surface.triangles[triangle as usize];
            let there = echo.origin_mm + direction * distance_mm;
            let shares = barycentric(corners.map(|n| self.surface.nodes_mm[n as usize]), there);
            let bias: f64 =
                corners.iter().zip(shares).map(|(&n, share)| share * self.bias_mm[n as usize]).sum();
            let distance_mm = (echo.point_mm - there).dot(normal) - bias;
            Some(Seen { triangle, shares, distance_mm, frame: echo.frame })
        });
        seen.collect()
    }

    /// Moves the free nodes along their normals.
    fn move_nodes(&mut self, seen: &[Seen]) {
        let count = self.nodes.len();
        // Sums over the echoes of each triangle, in the echoes' order.
        let mut matrix = vec![[0.0; 6]; self.surface.triangles.len()];
        let mut right = vec![0.0; count];
        let cut_off = CUT_OFF * self.noise_mm.max(1e-9 * self.edge_mm);
        for echo in seen {
            let weight = tukey_weight(echo.distance_mm / cut_off);
            let [p, q, r] = echo.shares;
            let products = [p * p, q * q, r * r, p * q, q * r, r * p];
            matrix[echo.triangle as usize].iter_mut().zip(products).for_each(|(sum, x)| *sum += weight * x);
            let corners = self.surface.triangles[echo.triangle as usize];
            for (&n, share) in corners.iter().zip(echo.shares) {
                right[n as usize] += weight * share * echo.distance_mm;
            }
        }
        let laplacian = Laplacian::of(&self.surface);
        let hold = |x: &mut [f64]| {
            x.iter_mut().zip(&self.is_free).filter(|(_, free)| !**free).for_each(|(x, _)| *x = 0.0)
        };
        let apply = |u: &[f64]| -> Vec<f64> {
            let bent: Vec<f64> = laplacian
                .apply(u)
                .iter()
                .zip(&laplacian.area_mm2)
                .map(|(x, area)| x * self.smoothness_mm2 / area)
                .collect();
            let mut sum = laplacian.apply(&bent);
            for (&[a, b, c], [aa, bb, cc, ab, bc, ca]) in self.surface.triangles.iter().zip(&matrix) {
                let [a, b, c] = [a, b, c].map(|n| n as usize);
                sum[a] += aa * u[a] + ab * u[b] + ca * u[c];
                sum[b] += bb * u[b] + bc * u[c] + ab * u[a];
                sum[c] += cc * u[c] + ca * u[a] + bc * u[b];
            }
            hold(&mut sum);
            sum
        };
        let mut diagonal = laplacian.squared_diagonal(self.smoothness_mm2);
        for (&[a, b, c], sums) in self.surface.triangles.iter().zip(&matrix) {
            [a, b, c].iter().zip(sums).for_each(|(&n, sum)| diagonal[n as usize] += sum);
        }
        hold(&mut right);
        let u = conjugate_gradients(&apply, &right, &diagonal);
        let normals = self.surface.node_normals();
        let most = MAX_EDGES * self.edge_mm;
        for (node, normal) in normals.into_iter().enumerate() {
            if self.is_free[node] && u[node].is_finite() {
                self.surface.nodes_mm[node] += normal * u[node].clamp(-most, most);
            }
        }
    }

    /// Takes back what makes the surface cross itself, as where a septum between two branches is thinner than the noise:
    /// nodes about a crossing go back half way to where they were `before`, a number of times, then all the way, and then to
    /// the middle of their neighbours.
    fn untangle(&mut self, before: &[DVec3]) {
        let neighbours = self.surface.neighbours();
        for round in 0..UNTANGLING {
            let crossing = crossings(&self.surface);
            if crossing.is_empty() {
                break;
            }
            let mut about: Vec<u32> =
                crossing.into_iter().flatten().flat_map(|t| self.surface.triangles[t as usize]).collect();
            for _ in 0..RINGS_ABOUT {
                about.sort_unstable();
                about.dedup();
                about.extend(about.clone().into_iter().flat_map(|n| neighbours[n as usize].clone()));
            }
            about.sort_unstable();
            about.dedup();
            about.retain(|&n| self.is_free[n as usize]);
            let at = &self.surface.nodes_mm;
            let moved: Vec<DVec3> = about
                .iter()
                .map(|&n| match round {
                    0..HALVINGS => 0.5 * (at[n as usize] + before[n as usize]),
                    HALVINGS => before[n as usize],
                    _ => {
                        let of = &neighbours[n as usize];
                        of.iter().map(|&k| at[k as usize]).sum::<DVec3>() / of.len() as f64
                    }
                })
                .collect();
            about.iter().zip(moved).for_each(|(&n, p)| self.surface.nodes_mm[n as usize] = p);
        }
    }

    /// What supports the nodes. Errors are those of a thin plate, in units of those that the sweeps found beside it.
    fn support(&self, seen: &[Seen], joined: &Joined, fits: &[TubeFit]) -> Vec<NodeSupport> {
        let count = self.nodes.len();
        // Echoes on the wall and off it, squares and sums of their distances.
        let mut sums = vec![[0.0; 4]; count];
        let mut last_frame: Vec<Option<u32>> = vec![None; count];
        for echo in seen {
            let corners = self.surface.triangles[echo.triangle as usize];
            let largest = (0..3).fold(0, |best, k| if echo.shares[k] > echo.shares[best] { k } else { best });
            let node = corners[largest] as usize;
            if echo.distance_mm.abs() <= ON_WALL * self.noise_mm {
                sums[node][0] += 1.0;
                sums[node][2] += echo.distance_mm * echo.distance_mm;
                sums[node][3] += echo.distance_mm;
                last_frame[node] = last_frame[node].max(Some(echo.frame));
            } else {
                sums[node][1] += 1.0;
            }
        }
        let area_mm2 = self.surface.node_areas_mm2();
        let laplacian = Laplacian::of(&self.surface);
        // An echo acts over ℓ = (λ/ρ)^¼.
        let on_wall: f64 = sums.iter().map(|s| s[0]).sum();
        let density = on_wall / area_mm2.iter().sum::<f64>();
        let reach_mm = (self.smoothness_mm2 / density.max(f64::MIN_POSITIVE)).powf(0.25);
        let rounds = (reach_mm / self.edge_mm).powi(2).ceil().clamp(1.0, 40.0) as usize;
        let about = |k: usize| laplacian.spread(sums.iter().map(|s| s[k]).collect(), rounds);
        let (own, off, squares, distances) = (about(0), about(1), about(2), about(3));
        let area = laplacian.spread(area_mm2, rounds);
        let plate = |n: usize| {
            let noise_mm2 = squares[n] / own[n];
            (noise_mm2 / (8.0 * (self.smoothness_mm2 * own[n] / area[n]).sqrt())).sqrt()
        };
        // A carina is sharper than the plate: its echoes then lie on one side, by more than their noise explains.
        let bias = |n: usize| {
            let mean_mm = distances[n] / own[n];
            let of_noise_mm2 = squares[n] / own[n] / own[n];
            (mean_mm * mean_mm - of_noise_mm2).max(0.0).sqrt()
        };
        let plates: Vec<f64> =
            (0..count).map(|n| if own[n] > 0.0 { plate(n) } else { f64::INFINITY }).collect();
        let mut ratios: Vec<f64> = (0..count)
            .filter_map(|n| match joined.origin[self.nodes[n] as usize] {
                Origin::Grid { tube, node } if fits[tube].supported[node] => {
                    Some(fits[tube].standard_error_mm[node] / plates[n]).filter(|ratio| ratio.is_finite())
                }
                _ => None,
            })
            .collect();
        let ratio = if ratios.is_empty() { 1.0 } else { median(&mut ratios).max(1.0) };
        let mut known: Vec<f64> = plates.iter().copied().filter(|x| x.is_finite()).collect();
        let most = (MAX_ERROR_MEDIANS * median(&mut known))
            .max(MAX_ERROR_RADII / ratio * median(&mut self.radius_mm.clone()));
        (0..count)
            .map(|n| NodeSupport {
                echoes: sums[n][0],
                residual_mm: (squares[n] / own[n]).sqrt(),
                standard_error_mm: (plates[n] * ratio).hypot(bias(n)),
                last_frame: last_frame[n],
                supported: plates[n] <= most && off[n] <= MAX_OFF_WALL * (off[n] + own[n]),
            })
            .collect()
    }
}

/// Barycentric coordinates of a point of a triangle.
pub(super) fn barycentric([a, b, c]: [DVec3; 3], p: DVec3) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let square = normal.length_squared().max(f64::MIN_POSITIVE);
    let share = |q: DVec3, r: DVec3| ((q - p).cross(r - p).dot(normal) / square).clamp(0.0, 1.0);
    let (u, v) = (share(b, c), share(c, a));
    [u, v, (1.0 - u - v).max(0.0)]
}
