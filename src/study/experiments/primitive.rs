//! Tables 1 to 3: one tube and a wall that is known by a formula.

use super::thesis::THESIS;
use crate::Result;
use crate::cylinders::fit::{CpuEngine, Engine};
use crate::cylinders::passes::Section;
use crate::settings::Settings;
use serde::Serialize;
use std::f64::consts::{PI, TAU};

/// How a tube approaches a wall of revolution about its own axis, iteration by iteration.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Convergence {
    /// Radius of the tube before the fit, mm.
    pub primitive_radius_mm: f64,
    /// Radius of the wall at the lower end of the tube, mm.
    pub start_radius_mm: f64,
    /// Radius of the wall at its upper end, mm.
    pub end_radius_mm: f64,
    /// Points on the wall, evenly spread.
    pub points: usize,
    /// The settings of the fit, but for its iterations.
    pub settings: Settings,
    /// Before the fit, and after each iteration.
    pub iterations: Vec<Iteration>,
}

/// A tube after some iterations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Iteration {
    /// Mean distance of the nodes to the wall, mm: the fitting error.
    pub mean_mm: f64,
    /// Mean distance of the nodes to the wall along their radii, mm.
    pub radial_mean_mm: f64,
    /// The largest, mm.
    pub max_mm: f64,
    /// Mean over the two end rings, mm.
    pub end_rings_mean_mm: f64,
    /// Mean |travel| of the nodes in this iteration, mm; 0 before the fit.
    pub travel_mm: f64,
}

/// Table 1: a tube of 10 mm radius inside a cylinder of 30 mm. The radial gate is opened to 4 radii, or the wall
/// would lie outside it.
///
/// # Errors
/// As [`Engine::fit_section`].
pub fn larger_cylinder(settings: &Settings, iterations: u32) -> Result<Convergence> {
    Convergence::measure(10.0, [30.0; 2], &Settings { gate: [0.5, 4.0], ..settings.clone() }, iterations)
}

/// Tables 2 and 3: a tube of 10 mm radius in a wall about it that tapers by 1.44 mm of radius a level, as late iterations
/// of the thesis's suggest, and whose mean radial distance from the tube is the thesis's, 4.9406 mm. The thesis does not give
/// its dimensions: the rest is our choice. The radial gate is opened to 4 radii.
///
/// # Errors
/// As [`Engine::fit_section`].
pub fn frustum(settings: &Settings, iterations: u32) -> Result<Convergence> {
    let middle = 10.0 + THESIS.tables_2_and_3_mm[0];
    let half = 1.44 * settings.levels as f64 / 2.0;
    let settings = Settings { gate: [0.5, 4.0], ..settings.clone() };
    Convergence::measure(10.0, [middle + half, middle - half], &settings, iterations)
}

/// Points around and along the wall; no multiple of them falls on the edges of a usual grid of faces.
const AROUND: usize = 360;
const ALONG: usize = 201;

impl Convergence {
    fn measure(
        primitive_radius_mm: f64,
        wall_mm: [f64; 2],
        settings: &Settings,
        iterations: u32,
    ) -> Result<Self> {
        let height = settings.height_mm;
        let slope = (wall_mm[1] - wall_mm[0]) / height;
        let wall_at = |z: f64| wall_mm[0] + slope * (z + height / 2.0);
        let mut section = Section::<f32>::default();
        for i in 0..ALONG {
            let z = height * ((i as f64 + 0.5) / ALONG as f64 - 0.5);
            for j in 0..AROUND {
                section.r.push(wall_at(z) as f32);
                section.theta.push((TAU * (j as f64 + 0.5) / AROUND as f64) as f32);
                section.z.push(z as f32);
            }
        }
        // Across the wall, not along r.
        let cosine = slope.atan().cos();
        let steps = (0..=iterations).map(|iterations| {
            let settings = Settings { iterations, ..settings.clone() };
            let tube = CpuEngine::<f64>::new().fit_section(&section, primitive_radius_mm, &settings)?.tube;
            let error_mm: Vec<f64> = tube
                .radii_mm
                .iter()
                .enumerate()
                .map(|(node, r)| (r - wall_at(tube.tube.ring_z_mm(node / tube.tube.nodes))).abs() * cosine)
                .collect();
            let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
            let n = tube.tube.nodes;
            let ends = [mean(&error_mm[..n]), mean(&error_mm[error_mm.len() - n..])];
            Ok(Iteration {
                mean_mm: mean(&error_mm),
                radial_mean_mm: mean(&error_mm) / cosine,
                max_mm: error_mm.iter().copied().fold(0.0, f64::max),
                end_rings_mean_mm: mean(&ends),
                travel_mm: tube.travel_mm.last().copied().unwrap_or_default(),
            })
        });
        Ok(Self {
            primitive_radius_mm,
            start_radius_mm: wall_mm[0],
            end_radius_mm: wall_mm[1],
            points: section.len(),
            settings: settings.clone(),
            iterations: steps.collect::<Result<_>>()?,
        })
    }

    /// Half the angle of the cone, degrees; 0 for a cylinder.
    pub fn taper_deg(&self) -> f64 {
        let slope = (self.start_radius_mm - self.end_radius_mm) / self.settings.height_mm;
        slope.atan().abs() / PI * 180.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_iteration_reaches_the_larger_cylinder() {
        let table = larger_cylinder(&Settings::default(), 3).unwrap();
        assert_eq!(table.iterations[0].mean_mm, 20.0);
        assert!(table.iterations[1].max_mm < 1e-12, "{:?}", table.iterations[1]);
    }

    #[test]
    fn the_frustum_is_approached_from_its_middle() {
        let table = frustum(&Settings::default(), 10).unwrap();
        assert!(table.iterations.windows(2).all(|pair| pair[1].mean_mm < pair[0].mean_mm));
        assert!(table.iterations.iter().all(|i| i.end_rings_mean_mm > i.mean_mm));
        // Not only because nothing moves.
        assert!(table.iterations[3].mean_mm < 0.5 * table.iterations[0].mean_mm);
        let thesis = THESIS.tables_2_and_3_mm;
        assert!((table.iterations[0].radial_mean_mm - thesis[0]).abs() < 1e-9, "{:?}", table.iterations[0]);
        println!("{:?}", table.iterations.iter().map(|i| i.radial_mean_mm).collect::<Vec<_>>());
    }
}
