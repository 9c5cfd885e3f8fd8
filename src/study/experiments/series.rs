//! Tables 4 to 7 and the figures that go with them: one recording, its cylinders one by one and merged.

use crate::Result;
use crate::cylinders::fit::{Engine, FittedCylinder};
use crate::cylinders::merge::MergedVessel;
use crate::cylinders::{CylinderReconstruction, PointCounts};
use crate::evaluate::{Coverage, Evaluation, Locator, Truth, evaluate_covered};
use crate::recording::Recording;
use crate::settings::Settings;
use crate::surface::Surface;
use glam::DVec3;
use serde::Serialize;
use std::ops::ControlFlow;

/// The fitting errors of one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Series {
    /// Frames of the recording.
    pub frames: usize,
    /// Where its points went.
    pub points: PointCounts,
    /// The frame of each cylinder.
    pub cylinder_frames: Vec<usize>,
    /// By iteration, 0 before the fit, then by cylinder: mean distance of its nodes to the truth, mm.
    pub cylinder_error_mm: Vec<Vec<f64>>,
    /// By iteration: the spread of these errors over the cylinders.
    pub cylinder_spread: Vec<Spread>,
    /// Mean |travel| of the nodes in each iteration, over all cylinders, mm.
    pub mean_travel_mm: Vec<f64>,
    /// The cylinders as they were before the fit, merged.
    pub original: Merged,
    /// The fitted cylinders, merged.
    pub deformed: Merged,
}

/// Cylinders merged into one mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Merged {
    /// Rings of the mesh.
    pub rings: usize,
    /// Mean distance to the truth of all nodes of all cylinders, each cylinder whole: not merged, mm.
    pub not_merged_mean_mm: f64,
    /// Mean distance to the truth of the mesh's nodes after each cylinder that was merged, mm.
    pub growth_mean_mm: Vec<f64>,
    /// Distance of each node of the whole mesh, mm.
    pub node_error_mm: Vec<f64>,
    /// Their spread.
    pub node_spread: Spread,
    /// The whole mesh against the truth.
    pub evaluation: Evaluation,
}

/// Distribution of some numbers, mm. Quartiles by nearest rank.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Spread {
    /// How many.
    pub count: usize,
    /// Mean.
    pub mean_mm: f64,
    /// Standard deviation, of the sample.
    pub sd_mm: f64,
    /// The smallest.
    pub min_mm: f64,
    /// First quartile.
    pub lower_quartile_mm: f64,
    /// Median.
    pub median_mm: f64,
    /// Third quartile.
    pub upper_quartile_mm: f64,
    /// Third less first quartile.
    pub iqr_mm: f64,
    /// First quartile less 1.5 of these: the lower limit of the thesis's violins.
    pub lower_limit_mm: f64,
    /// Third quartile and 1.5 of these.
    pub upper_limit_mm: f64,
    /// 95th percentile.
    pub p95_mm: f64,
    /// The largest.
    pub max_mm: f64,
}

impl Spread {
    /// The spread of some numbers; all zero without any.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let (Some(&min_mm), Some(&max_mm)) = (sorted.first(), sorted.last()) else {
            return Self::default();
        };
        let n = sorted.len() as f64;
        let mean_mm = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|v| (v - mean_mm).powi(2)).sum();
        let rank = |share: f64| sorted[((share * n).ceil() as usize).clamp(1, sorted.len()) - 1];
        let iqr_mm = rank(0.75) - rank(0.25);
        Self {
            count: sorted.len(),
            iqr_mm,
            lower_limit_mm: rank(0.25) - 1.5 * iqr_mm,
            upper_limit_mm: rank(0.75) + 1.5 * iqr_mm,
            mean_mm,
            sd_mm: if sorted.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 },
            min_mm,
            lower_quartile_mm: rank(0.25),
            median_mm: rank(0.5),
            upper_quartile_mm: rank(0.75),
            p95_mm: rank(0.95),
            max_mm,
        }
    }
}

impl Series {
    /// Reconstructs a recording and measures it. The mesh that comes with it carries `error_mm` and
    /// `signed_error_mm`.
    ///
    /// # Errors
    /// As [`CylinderReconstruction::run`] and [`evaluate_covered`].
    pub fn measure(
        recording: &Recording,
        (truth, coverage): (&Truth, &Coverage),
        settings: &Settings,
        engine: &dyn Engine,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<(Self, Surface)> {
        let reconstruction = CylinderReconstruction::run(recording, settings, engine, true, progress)?;
        let cylinders = &reconstruction.cylinders;
        let node_errors: Vec<Vec<Vec<f64>>> = (0..=settings.iterations as usize)
            .map(|iteration| node_errors_mm(cylinders, iteration, truth.locator()))
            .collect();
        let cylinder_error_mm: Vec<Vec<f64>> =
            node_errors.iter().map(|cylinders| cylinders.iter().map(|c| mean(c)).collect()).collect();
        let (original, _) = Merged::measure(cylinders, 0, &node_errors[0], (truth, coverage))?;
        let last = node_errors.len() - 1;
        let (deformed, mesh) = Merged::measure(cylinders, last, &node_errors[last], (truth, coverage))?;
        let series = Self {
            frames: reconstruction.report.frames,
            points: reconstruction.report.points,
            cylinder_frames: cylinders.iter().map(|c| c.frame).collect(),
            cylinder_spread: cylinder_error_mm.iter().map(|errors| Spread::of(errors)).collect(),
            cylinder_error_mm,
            mean_travel_mm: reconstruction.report.mean_travel_mm,
            original,
            deformed,
        };
        Ok((series, mesh))
    }
}

/// By cylinder and node, after some iterations: distance to the truth, mm.
fn node_errors_mm(cylinders: &[FittedCylinder], iteration: usize, truth: &Locator) -> Vec<Vec<f64>> {
    let nodes: Vec<DVec3> =
        cylinders.iter().flat_map(|c| c.nodes_mm(&c.tube.history_mm[iteration])).collect();
    let errors: Vec<f64> = truth.closest_all(&nodes).iter().map(|c| c.distance_mm).collect();
    let per_cylinder = cylinders.first().map_or(1, |c| c.tube.tube.node_count());
    errors.chunks_exact(per_cylinder).map(<[f64]>::to_vec).collect()
}

impl Merged {
    /// Merges the cylinders with their radii of one iteration. `errors_mm` has the distance of every node.
    fn measure(
        cylinders: &[FittedCylinder],
        iteration: usize,
        errors_mm: &[Vec<f64>],
        (truth, coverage): (&Truth, &Coverage),
    ) -> Result<(Self, Surface)> {
        let mut vessel = MergedVessel::default();
        // Of each ring of the vessel: its first node, by which it is known again, and the mean error of its nodes.
        let mut known: Vec<(DVec3, f64)> = Vec::new();
        let mut growth_mean_mm = Vec::with_capacity(cylinders.len());
        for (cylinder, errors) in cylinders.iter().zip(errors_mm) {
            vessel.stitch(cylinder, &cylinder.tube.history_mm[iteration]);
            let first_new = vessel.rings.len().saturating_sub(cylinder.tube.tube.levels + 1);
            let mut kept = vessel.rings[..first_new].iter().map(|ring| ring.nodes_mm[0]).peekable();
            known.retain(|(node, _)| kept.next_if_eq(node).is_some());
            let new = vessel.rings[first_new..].iter().map(|ring| ring.nodes_mm[0]);
            known.extend(new.zip(errors.chunks_exact(cylinder.tube.tube.nodes).map(mean)));
            growth_mean_mm.push(known.iter().map(|(_, error)| error).sum::<f64>() / known.len() as f64);
        }
        let mut mesh = vessel.surface();
        let evaluation = evaluate_covered(&mesh, truth, coverage)?;
        evaluation.colour(&mut mesh);
        let merged = Self {
            rings: vessel.rings.len(),
            not_merged_mean_mm: mean(&errors_mm.concat()),
            growth_mean_mm,
            node_error_mm: evaluation.error_mm.clone(),
            node_spread: Spread::of(&evaluation.error_mm),
            evaluation,
        };
        Ok((merged, mesh))
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_that_of_its_numbers() {
        let spread = Spread::of(&[4.0, 1.0, 3.0, 2.0]);
        assert_eq!((spread.count, spread.mean_mm, spread.min_mm, spread.max_mm), (4, 2.5, 1.0, 4.0));
        assert_eq!((spread.lower_quartile_mm, spread.median_mm, spread.upper_quartile_mm), (1.0, 2.0, 3.0));
        assert!((spread.sd_mm - (5.0_f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(Spread::of(&[]), Spread::default());
    }
}
