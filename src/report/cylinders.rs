//! What a page shows of a reconstruction by cylinders.

use super::page::Page;
use super::plot::{Line, Mark, Room, lines};
use super::rows::{engine_row, facts, share};
use crate::Result;
use crate::cylinders::merge::VesselRing;
use crate::cylinders::{CylinderReconstruction, CylindersReport};
use crate::evaluate::{Evaluation, Truth};
use glam::DVec3;

pub(super) fn summary_rows(report: &CylindersReport) -> Vec<(&'static str, String)> {
    let cylinders = match report.estimated_cylinders {
        0 => format!("{}, as the recording places them", report.cylinders),
        _ => format!("{}, placed by the contours", report.cylinders),
    };
    let seconds = &report.seconds;
    let milliseconds = (seconds.track + seconds.fit + seconds.merge) * 1e3;
    vec![
        ("method", "cylinders".into()),
        ("cylinders fitted", cylinders),
        ("vessel", format!("{} rings, {} nodes, {} triangles", report.rings, report.nodes, report.triangles)),
        ("engine", engine_row(&report.engine, report.threads)),
        ("time", format!("{milliseconds:.0} ms: placing frames, fitting, merging")),
    ]
}

pub(super) fn convergence(
    page: &mut Page,
    reconstruction: &CylinderReconstruction,
    measured: Option<(&Truth, &Evaluation)>,
) -> Result<()> {
    let travel = &reconstruction.report.mean_travel_mm;
    if travel.is_empty() {
        return Ok(());
    }
    page.heading("Convergence");
    let both = |name: &str, points: Vec<[f64; 2]>| Line { name: name.into(), points, mark: Mark::Both };
    let travelled = travel.iter().enumerate().map(|(i, t)| [i as f64 + 1.0, *t]).collect();
    let travelled = lines(Room::Half, "iteration", "mean |travel| (mm)", &[both("travel", travelled)])?;
    let travel_caption = "How far the nodes of the single cylinders moved in each iteration.";
    match measured.map(|(truth, _)| errors_by_iteration(reconstruction, truth)) {
        Some(errors) if !errors.is_empty() => {
            let svg = lines(Room::Half, "iteration", "mean error (mm)", &[both("error", errors)])?;
            let caption = "Mean distance of their nodes to the truth; iteration 0 is before the fit.";
            page.plots([(&travelled, travel_caption), (&svg, caption)]);
        }
        _ => drop(page.plot(&travelled, travel_caption)),
    }
    Ok(())
}

/// Mean distance of the single cylinders' nodes to the truth after each iteration of their history.
fn errors_by_iteration(reconstruction: &CylinderReconstruction, truth: &Truth) -> Vec<[f64; 2]> {
    let cylinders = &reconstruction.cylinders;
    let iterations = cylinders.iter().map(|c| c.tube.history_mm.len()).min().unwrap_or(0);
    (0..iterations)
        .map(|i| {
            let nodes: Vec<DVec3> =
                cylinders.iter().flat_map(|c| c.nodes_mm(&c.tube.history_mm[i])).collect();
            let sum: f64 = truth.locator().closest_all(&nodes).iter().map(|c| c.distance_mm).sum();
            [i as f64, sum / nodes.len() as f64]
        })
        .collect()
}

/// Length along the vessel up to each ring's middle, mm.
fn along_mm(rings: &[VesselRing]) -> Vec<f64> {
    let middles: Vec<DVec3> =
        rings.iter().map(|r| r.nodes_mm.iter().sum::<DVec3>() / r.nodes_mm.len().max(1) as f64).collect();
    let mut s = 0.0;
    (0..middles.len())
        .map(|i| {
            s += i.checked_sub(1).map_or(0.0, |before| middles[before].distance(middles[i]));
            s
        })
        .collect()
}

fn along_the_vessel(rings: &[VesselRing], name: &str, of: impl Fn(&VesselRing) -> f64) -> Line {
    let points = along_mm(rings).into_iter().zip(rings).map(|(s, ring)| [s, of(ring)]).collect();
    Line { name: name.into(), points, mark: Mark::Line }
}

pub(super) fn coverage(page: &mut Page, rings: &[VesselRing]) -> Result<()> {
    page.heading("Coverage");
    let nodes: usize = rings.iter().map(|r| r.support.len()).sum();
    let bare = rings.iter().flat_map(|r| &r.support).filter(|&&n| n == 0).count();
    page.paragraph(&format!(
        "{bare} of {nodes} nodes ({:.1} %) have no point on any of their triangles; their positions are interpolated from \
         their neighbours.",
        100.0 * bare as f64 / nodes.max(1) as f64
    ));
    let mean = |ring: &VesselRing| {
        ring.support.iter().map(|&n| f64::from(n)).sum::<f64>() / ring.support.len() as f64
    };
    let least = |ring: &VesselRing| ring.support.iter().copied().min().map_or(f64::NAN, f64::from);
    let svg = lines(
        Room::Whole,
        "along the vessel (mm)",
        "points per node",
        &[
            along_the_vessel(rings, "mean of a ring", mean),
            along_the_vessel(rings, "minimum of a ring", least),
        ],
    )?;
    page.plot(&svg, "Points on the triangles about a node, ring by ring.");
    Ok(())
}

pub(super) fn noise(page: &mut Page, reconstruction: &CylinderReconstruction) -> Result<()> {
    let report = &reconstruction.report;
    let points = &report.points;
    page.heading("Noise");
    let in_sections = points.used + points.rejected;
    page.table(&facts(vec![
        ("rays without an echo", share(points.missing, points.recorded + points.missing)),
        ("points rejected as outliers", share(points.rejected, in_sections)),
        ("points outside the radial gate", share(points.gated, in_sections + points.gated)),
    ]));
    page.paragraph("Points count once in every cylinder that they lie in.");
    let rings = &reconstruction.vessel.rings;
    let mean = |ring: &VesselRing| {
        let seen = || ring.residual_mm.iter().filter(|r| r.is_finite());
        seen().sum::<f64>() / seen().count() as f64
    };
    if rings.iter().any(|ring| mean(ring).is_finite()) {
        let line = along_the_vessel(rings, "residual", mean);
        let svg = lines(Room::Whole, "along the vessel (mm)", "mean residual (mm)", &[line])?;
        page.plot(
            &svg,
            "Mean distance of the points from the mesh about them, ring by ring: contour and tracker noise, \
             and what the mesh does not follow.",
        );
    }
    Ok(())
}
