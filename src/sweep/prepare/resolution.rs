//! How fine the grid of a wall may be.

use super::contour::echo_count;
use super::grid::CELL_NOISE;
use crate::numerics::robust::median;
use crate::settings::Settings;
use crate::{Error, Result};
use glam::DVec2;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

/// Mean number of echoes per node: few where they are exact, more where noise hides what lies between.
const ECHOES_PER_NODE: RangeInclusive<f64> = 1.0..=4.0;
/// Distance of nodes that is short enough in any noise, in its standard deviations: noise along the wall blurs bends shorter
/// than 2π of them.
const SHORT_SDS: f64 = 0.3;
/// Nodes that fit into the memory of an ordinary machine.
const MAX_NODES: f64 = 5e7;
/// Largest distance of two rings, in lumen radii: beyond, the wall between them would be invented.
const MAX_STEP_RADII: f64 = 2.0;
/// Nodes per ring, where the settings do not give them.
const NODES_PER_RING: RangeInclusive<usize> = 16..=256;

/// Nodes per ring, and the distance of two rings in mm, that the echoes along a vessel can determine. Contours of frames
/// that are left out are empty; a noise that is not known is infinite.
pub(in crate::sweep) fn resolution(
    contours_mm: &[&[DVec2]],
    length_mm: f64,
    radius_mm: f64,
    noise_mm: f64,
    settings: &Settings,
) -> Result<(usize, f64)> {
    let with_echoes = contours_mm.iter().filter(|contour_mm| contour_mm.iter().any(|p| !p.is_nan())).count();
    // More than two rings per frame would have no data.
    let min_step_mm = length_mm / with_echoes as f64 / 2.0;
    let nodes = match settings.sweep.nodes {
        Some(nodes) => nodes as usize,
        None => {
            let nodes = |echoes_per_node: f64| {
                let affordable = echo_count(contours_mm) as f64 / echoes_per_node;
                let even = (affordable * TAU * radius_mm / length_mm).sqrt();
                even.max(affordable * min_step_mm / length_mm)
            };
            // Triangles that deviate from the wall by less than the noise need not be smaller.
            let wanted = TAU * radius_mm * CELL_NOISE * settings.sweep.roughness / noise_mm;
            let used = contours_mm.iter().filter(|contour_mm| !contour_mm.is_empty());
            let rays = median(&mut used.map(|contour_mm| contour_mm.len() as f64).collect::<Vec<_>>());
            let enough =
                if noise_mm.is_finite() { TAU * radius_mm / (SHORT_SDS * noise_mm) } else { f64::INFINITY };
            let min = nodes(*ECHOES_PER_NODE.end()).min(rays).min(enough);
            let max = nodes(*ECHOES_PER_NODE.start()).min(2.0 * rays);
            (wanted.min(max).max(min) as usize & !1).clamp(*NODES_PER_RING.start(), *NODES_PER_RING.end())
        }
    };
    let step_mm = (TAU * radius_mm / nodes as f64).max(min_step_mm);
    if step_mm > MAX_STEP_RADII * radius_mm {
        return Err(Error::Recording {
            field: "frames",
            found: format!("{with_echoes} along {length_mm:.0} mm with contours of {radius_mm:.2} mm radius"),
            expected: format!("one every {:.0} radii at least", 2.0 * MAX_STEP_RADII),
        });
    }
    if length_mm / step_mm * nodes as f64 > MAX_NODES {
        return Err(Error::Setting {
            name: "sweep.nodes".into(),
            found: format!("{nodes} per ring of {radius_mm:.3} mm radius along {length_mm:.0} mm"),
            expected: format!("at most {MAX_NODES} in all"),
        });
    }
    Ok((nodes, step_mm))
}
