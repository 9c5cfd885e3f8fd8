//! Simulated vessels, and how far reconstructions of them lie from the truth.

use glam::DVec3;
use lumenmesh::evaluate::{Closest, Locator};
use lumenmesh::recording::Recording;
use lumenmesh::simulate::{self, Phantom, Shape, Simulation};
use lumenmesh::surface::Surface;

/// A recording of a phantom.
pub fn simulated(shape: &str, settings: &simulate::SimulationSettings) -> Simulation {
    let vessel = Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap();
    Simulation::run(vessel, settings).unwrap()
}

/// Mean distance and mean signed distance from a surface's nodes to a vessel's wall, and the largest distance, mm. Nodes
/// beyond the wall's own open ends are left out.
pub fn errors_mm(surface: &Surface, wall: &Surface) -> (f64, f64, f64) {
    let closest = Locator::new(wall).unwrap().closest_all(&surface.nodes_mm);
    let inside: Vec<_> = closest.iter().filter(|c| !c.on_rim).collect();
    let mean = |of: &dyn Fn(&Closest) -> f64| inside.iter().map(|c| of(c)).sum::<f64>() / inside.len() as f64;
    let largest = inside.iter().map(|c| c.distance_mm).fold(0.0, f64::max);
    (mean(&|c| c.distance_mm), mean(&|c| c.signed_distance_mm), largest)
}

/// Mean distance from a surface's nodes to a vessel's wall, mm, as [`errors_mm`] has it.
pub fn mean_error_mm(surface: &Surface, wall: &Surface) -> f64 {
    errors_mm(surface, wall).0
}

/// Share of a recording's wall points within 1 mm of a surface.
pub fn coverage(surface: &Surface, truth: &Recording) -> f64 {
    let points: Vec<DVec3> = truth
        .frames
        .iter()
        .flat_map(|f| f.echoes_mm().map(|p| f.world_from_sensor.transform_point(p.extend(0.0))))
        .collect();
    let closest = Locator::new(surface).unwrap().closest_all(&points);
    closest.iter().filter(|c| c.distance_mm < 1.0).count() as f64 / points.len() as f64
}

/// All of a surface; numbers that are none are equal.
pub fn bits(surface: &Surface) -> impl PartialEq + use<> {
    let nodes: Vec<[u64; 3]> = surface.nodes_mm.iter().map(|p| p.to_array().map(f64::to_bits)).collect();
    let values = |of: &[f64]| of.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
    let arrays: Vec<_> = surface.arrays.iter().map(|a| (a.name.clone(), values(&a.values))).collect();
    (nodes, surface.triangles.clone(), arrays)
}
