//! Plates: functions on a triangle surface that bend as little as possible.

use crate::surface::Surface;
use glam::DVec3;
use std::ops::{Add, AddAssign, Div, Mul, Sub, SubAssign};

/// What a plate has at each node: a number, or a place.
pub(super) trait Value:
    Copy
    + Default
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + SubAssign
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    /// The product, summed over the coordinates.
    fn dot(self, other: Self) -> f64;
}

impl Value for f64 {
    fn dot(self, other: Self) -> f64 {
        self * other
    }
}

impl Value for DVec3 {
    fn dot(self, other: Self) -> f64 {
        DVec3::dot(self, other)
    }
}

/// Steps of the conjugate gradients, and their relative accuracy.
const MAX_STEPS: usize = 400;
const ACCURACY: f64 = 1e-3;

/// The Laplacian of a triangle surface by cotangents, times the area of the nodes.
pub(super) struct Laplacian {
    edges: Vec<([u32; 2], f64)>,
    pub area_mm2: Vec<f64>,
}

/// Least weight of an edge: obtuse angles must not make it negative.
const LEAST_WEIGHT: f64 = 0.05;

impl Laplacian {
    pub(super) fn of(surface: &Surface) -> Self {
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
    pub(super) fn apply<V: Value>(&self, u: &[V]) -> Vec<V> {
        let mut sum = vec![V::default(); u.len()];
        for &([a, b], weight) in &self.edges {
            let flow = (u[b as usize] - u[a as usize]) * weight;
            sum[a as usize] += flow;
            sum[b as usize] -= flow;
        }
        sum
    }

    /// The diagonal of λ Lᵀ A⁻¹ L.
    pub(super) fn squared_diagonal(&self, smoothness_mm2: f64) -> Vec<f64> {
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
    pub(super) fn spread(&self, mut values: Vec<f64>, rounds: usize) -> Vec<f64> {
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
pub(super) fn conjugate_gradients<V: Value>(
    apply: &dyn Fn(&[V]) -> Vec<V>,
    right: &[V],
    diagonal: &[f64],
) -> Vec<V> {
    let dot = |a: &[V], b: &[V]| a.iter().zip(b).map(|(x, y)| x.dot(*y)).sum::<f64>();
    let per: Vec<f64> = diagonal.iter().map(|d| d.max(f64::MIN_POSITIVE)).collect();
    let conditioned = |r: &[V]| -> Vec<V> { r.iter().zip(&per).map(|(r, d)| *r / *d).collect() };
    let mut x = vec![V::default(); right.len()];
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
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += *d * step);
        residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= *i * step);
        z = conditioned(&residual);
        let next = dot(&residual, &z);
        let ratio = next / rho;
        rho = next;
        direction.iter_mut().zip(&z).for_each(|(d, z)| *d = *z + *d * ratio);
    }
    x
}
