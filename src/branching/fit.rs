//! The last fit of the joined surface to the echoes where tubes meet.
//!
//! No tube describes a parting: its wall is not star-shaped about an axis. The nodes there are moved along their normals by
//! u, which minimises `Σ w (d - u)² + λ ∫ (Δu)² dA`: d are the distances of the echoes to the surface, w Tukey's weights
//! and λ the weight of bending in the sweeps, so that u is as smooth as they are. u is 0 where the grids begin.

use super::join::{Joined, Origin};
use super::tube::Tube;
use crate::Result;
use crate::numerics::robust::{median, tukey_weight};
use crate::surface::crossing::crossings;
use crate::surface::{Locator, Surface};
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
/// Steps of the conjugate gradients, and their relative accuracy.
const MAX_STEPS: usize = 400;
const ACCURACY: f64 = 1e-4;
/// Largest movement of a node in one round, in edges.
const MAX_EDGES: f64 = 1.5;
/// Rounds in which crossings are undone, those of them that go half way back, and rings of nodes about a crossing that move.
const UNTANGLING: usize = 24;
const HALVINGS: usize = 4;
const RINGS_ABOUT: usize = 2;
/// What is known of a tube's fit.
pub(super) struct TubeFit<'a> {
    /// Standard deviation of an echo about the wall, mm, and the part of it along the wall.
    pub noise_mm: f64,
    pub tangential_noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// Standard error of each node of its grid, mm, and whether it is supported.
    pub standard_error_mm: &'a [f64],
    pub supported: &'a [bool],
}

/// An echo in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct WorldEcho {
    /// Where the probe looks from.
    pub origin_mm: DVec3,
    pub point_mm: DVec3,
    pub frame: u32,
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
    echoes: &[WorldEcho],
) -> Result<Vec<Option<NodeSupport>>> {
    let mut support = vec![None; joined.origin.len()];
    let partings = joined.parting.iter().flatten().max().map_or(0, |last| last + 1);
    for parting in 0..partings {
        let Some(mut part) = Part::of(joined, parting, tubes, fits) else { continue };
        let near = part.near(echoes);
        let before = part.surface.nodes_mm.clone();
        for _ in 0..ROUNDS {
            let seen = part.project(&near)?;
            part.move_nodes(&seen);
        }
        part.untangle(&before);
        let seen = part.project(&near)?;
        let of_nodes = part.support(&seen, joined, fits);
        for (local, &node) in part.nodes.iter().enumerate() {
            if part.is_free[local] {
                joined.surface.nodes_mm[node as usize] = part.surface.nodes_mm[local];
                support[node as usize] = Some(of_nodes[local]);
            }
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
        let mut number = std::collections::HashMap::new();
        let mut nodes: Vec<u32> = Vec::new();
        let mut surface = Surface::default();
        for &triangle in joined.surface.triangles.iter().filter(|t| t.iter().any(|&n| is_free(n))) {
            surface.triangles.push(triangle.map(|n| {
                *number.entry(n).or_insert_with(|| {
                    nodes.push(n);
                    surface.nodes_mm.push(joined.surface.nodes_mm[n as usize]);
                    (nodes.len() - 1) as u32
                })
            }));
        }
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
            bias_mm.push(outward_bias_mm(radius, fits[tube].tangential_noise_mm));
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

    /// The echoes within reach.
    fn near(&self, echoes: &[WorldEcho]) -> Vec<WorldEcho> {
        let Some([low, high]) = self.surface.bounding_box_mm() else { return Vec::new() };
        let reach = DVec3::splat(CUT_OFF * self.noise_mm);
        let is_near =
            |e: &&WorldEcho| e.point_mm.cmpge(low - reach).all() && e.point_mm.cmple(high + reach).all();
        echoes.iter().filter(is_near).copied().collect()
    }

    /// The echoes on the wall that the probe sees in their directions: not on the nearest, which across a thin wall between
    /// two branches may be the other branch's.
    fn project(&self, echoes: &[WorldEcho]) -> Result<Vec<Seen>> {
        let locator = Locator::new(&self.surface)?;
        let normals = self.surface.triangle_normals();
        let seen = echoes.par_iter().filter_map(|echo| {
            let ray = echo.point_mm - echo.origin_mm;
            let length_mm = ray.length();
            let direction = ray / length_mm;
            let range_mm = length_mm + CUT_OFF * self.noise_mm;
            let (triangle, distance_mm) = locator.cast(echo.origin_mm, direction, range_mm)?;
            let normal = normals[triangle as usize];
            if direction.dot(normal) < LEAST_COSINE {
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
        Ok(seen.collect())
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
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); self.nodes.len()];
        for &[a, b, c] in &self.surface.triangles {
            for (node, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                neighbours[node as usize].extend(others);
            }
        }
        neighbours.iter_mut().for_each(|of| {
            of.sort_unstable();
            of.dedup();
        });
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
        let mut sums = vec![[0.0; 3]; count];
        let mut last_frame: Vec<Option<u32>> = vec![None; count];
        for echo in seen {
            let corners = self.surface.triangles[echo.triangle as usize];
            let largest = (0..3).fold(0, |best, k| if echo.shares[k] > echo.shares[best] { k } else { best });
            let node = corners[largest] as usize;
            if echo.distance_mm.abs() <= ON_WALL * self.noise_mm {
                sums[node][0] += 1.0;
                sums[node][2] += echo.distance_mm * echo.distance_mm;
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
        let (own, off, squares) = (about(0), about(1), about(2));
        let area = laplacian.spread(area_mm2, rounds);
        let plate = |n: usize| {
            let noise_mm2 = squares[n] / own[n];
            (noise_mm2 / (8.0 * (self.smoothness_mm2 * own[n] / area[n]).sqrt())).sqrt()
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
                standard_error_mm: plates[n] * ratio,
                last_frame: last_frame[n],
                supported: plates[n] <= most && off[n] <= MAX_OFF_WALL * (off[n] + own[n]),
            })
            .collect()
    }
}

/// Barycentric coordinates of a point of a triangle.
fn barycentric([a, b, c]: [DVec3; 3], p: DVec3) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let square = normal.length_squared().max(f64::MIN_POSITIVE);
    let share = |q: DVec3, r: DVec3| ((q - p).cross(r - p).dot(normal) / square).clamp(0.0, 1.0);
    let (u, v) = (share(b, c), share(c, a));
    [u, v, (1.0 - u - v).max(0.0)]
}

/// The Laplacian of a triangle surface by cotangents, times the area of the nodes.
struct Laplacian {
    edges: Vec<([u32; 2], f64)>,
    area_mm2: Vec<f64>,
}

/// Least weight of an edge: obtuse angles must not make it negative.
const LEAST_WEIGHT: f64 = 0.05;

impl Laplacian {
    fn of(surface: &Surface) -> Self {
        let mut edges: Vec<([u32; 2], f64)> = Vec::with_capacity(3 * surface.triangles.len());
        for &triangle in &surface.triangles {
            for k in 0..3 {
                let [at, p, q] = [triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
                let [a, b, c] = [at, p, q].map(|n| surface.nodes_mm[n as usize]);
                let (u, v) = (b - a, c - a);
                let cotangent = u.dot(v) / u.cross(v).length().max(f64::MIN_POSITIVE);
                edges.push(([p.min(q), p.max(q)], 0.5 * cotangent.clamp(-3.0, 3.0)));
            }
        }
        edges.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let sum =
            |edge: &[([u32; 2], f64)]| (edge[0].0, edge.iter().map(|e| e.1).sum::<f64>().max(LEAST_WEIGHT));
        let edges = edges.chunk_by(|a, b| a.0 == b.0).map(sum).collect();
        let areas = surface.node_areas_mm2();
        let least = 1e-3 * areas.iter().sum::<f64>() / areas.len() as f64;
        Self { edges, area_mm2: areas.into_iter().map(|area| area.max(least)).collect() }
    }

    /// Sums of differences to the neighbours, weighted.
    fn apply(&self, u: &[f64]) -> Vec<f64> {
        let mut sum = vec![0.0; u.len()];
        for &([a, b], weight) in &self.edges {
            let flow = weight * (u[b as usize] - u[a as usize]);
            sum[a as usize] += flow;
            sum[b as usize] -= flow;
        }
        sum
    }

    /// The diagonal of λ Lᵀ A⁻¹ L.
    fn squared_diagonal(&self, smoothness_mm2: f64) -> Vec<f64> {
        let mut own = vec![0.0; self.area_mm2.len()];
        let mut squared = vec![0.0; self.area_mm2.len()];
        for &([a, b], weight) in &self.edges {
            let [a, b] = [a, b].map(|n| n as usize);
            own[a] += weight;
            own[b] += weight;
            squared[a] += weight * weight / self.area_mm2[b];
            squared[b] += weight * weight / self.area_mm2[a];
        }
        let sum = |n: usize| smoothness_mm2 * (own[n] * own[n] / self.area_mm2[n] + squared[n]);
        (0..own.len()).map(sum).collect()
    }

    /// Values spread to neighbours a number of times; their sum stays.
    fn spread(&self, mut values: Vec<f64>, rounds: usize) -> Vec<f64> {
        let mut neighbours = vec![1.0; values.len()];
        for &([a, b], _) in &self.edges {
            neighbours[a as usize] += 1.0;
            neighbours[b as usize] += 1.0;
        }
        for _ in 0..rounds {
            let share: Vec<f64> = values.iter().zip(&neighbours).map(|(x, n)| x / n).collect();
            values.copy_from_slice(&share);
            for &([a, b], _) in &self.edges {
                values[a as usize] += share[b as usize];
                values[b as usize] += share[a as usize];
            }
        }
        values
    }
}

/// Solves a symmetric positive system, preconditioned by its diagonal.
fn conjugate_gradients(apply: &dyn Fn(&[f64]) -> Vec<f64>, right: &[f64], diagonal: &[f64]) -> Vec<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let conditioned = |r: &[f64]| -> Vec<f64> {
        r.iter().zip(diagonal).map(|(r, d)| r / d.max(f64::MIN_POSITIVE)).collect()
    };
    let mut x = vec![0.0; right.len()];
    let mut residual = right.to_vec();
    let mut z = conditioned(&residual);
    let mut direction = z.clone();
    let mut rho = dot(&residual, &z);
    let enough = ACCURACY * ACCURACY * rho;
    for _ in 0..MAX_STEPS {
        if rho <= enough || rho <= 0.0 {
            break;
        }
        let image = apply(&direction);
        let step = rho / dot(&direction, &image);
        if !step.is_finite() {
            break;
        }
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= step * i);
        z = conditioned(&residual);
        let next = dot(&residual, &z);
        let ratio = next / rho;
        rho = next;
        direction.iter_mut().zip(&z).for_each(|(d, z)| *d = z + ratio * *d);
    }
    x
}
