//! The wall as a triangle surface.

use super::prepare::axis::Axis;
use super::support::Support;
use crate::surface::{Surface, face_triangles};
use std::f64::consts::TAU;
use std::ops::Range;

/// The triangles between `rings` rings, by nodes of the first ring on.
fn triangles(nodes: usize, rings: usize) -> impl Iterator<Item = [u32; 3]> {
    (0..rings.saturating_sub(1))
        .flat_map(move |ring| (0..nodes).map(move |j| (ring * nodes + j, ring * nodes + (j + 1) % nodes)))
        .flat_map(move |(a, b)| face_triangles(a as u32, b as u32, (b + nodes) as u32, (a + nodes) as u32))
}

fn is_supported(triangle: &[u32; 3], first: usize, support: &Support) -> bool {
    triangle.iter().all(|&n| support.supported[first + n as usize])
}

/// Whether echoes support any triangle of a wall.
pub(super) fn has_support(nodes: usize, rings: usize, support: &Support) -> bool {
    triangles(nodes, rings).any(|triangle| is_supported(&triangle, 0, support))
}

/// Some rings of a wall as triangles, normals outward: the supported ones, which meet along edges and not in single nodes, or
/// all with `keep_unsupported`, whose nodes are those of the grid in order. Arrays:
/// `support` (echoes), `residual_mm`, `standard_error_mm`, `error_reach_mm`, `frame` (the last one), `supported` (1 or 0).
pub(super) fn surface(
    axis: &Axis,
    nodes: usize,
    rings: Range<usize>,
    support: &Support,
    is_supported: impl Fn(usize) -> bool,
    radius_mm: impl Fn(usize) -> f64,
    keep_unsupported: bool,
) -> Surface {
    let first = rings.start * nodes;
    let supported: Vec<bool> = (first..rings.end * nodes).map(is_supported).collect();
    let mut triangles: Vec<[u32; 3]> = triangles(nodes, rings.len())
        .filter(|triangle| keep_unsupported || triangle.iter().all(|&n| supported[n as usize]))
        .collect();
    let mut index = vec![if keep_unsupported { 0 } else { u32::MAX }; rings.len() * nodes];
    triangles.iter().flatten().for_each(|&n| index[n as usize] = 0);
    let kept: Vec<usize> = (0..index.len()).filter(|&n| index[n] == 0).collect();
    kept.iter().zip(0..).for_each(|(&n, new)| index[n] = new);
    triangles.iter_mut().flatten().for_each(|n| *n = index[*n as usize]);
    let kept: Vec<usize> = kept.into_iter().map(|n| first + n).collect();
    let position =
        |&n: &usize| axis.point_mm(n / nodes, TAU * (n % nodes) as f64 / nodes as f64, radius_mm(n));
    let mut surface =
        Surface { nodes_mm: kept.iter().map(position).collect(), triangles, arrays: Vec::new() };
    let Support { echoes, residual_mm, standard_error_mm, error_reach_mm, last_frame, supported: _ } =
        support;
    let mut array = |name, value: &dyn Fn(usize) -> f64| {
        surface.set_array(name, kept.iter().map(|&n| value(n)).collect());
    };
    array("support", &|n| f64::from(echoes[n]));
    array("residual_mm", &|n| residual_mm[n]);
    array("standard_error_mm", &|n| standard_error_mm[n]);
    array("error_reach_mm", &|n| error_reach_mm[n]);
    array("frame", &|n| last_frame[n].map_or(f64::NAN, f64::from));
    array("supported", &|n| f64::from(u8::from(supported[n - first])));
    if keep_unsupported { surface } else { surface.with_touching_parts_split() }
}
