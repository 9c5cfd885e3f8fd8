//! What a page shows of a reconstruction by the sweep.

use super::page::Page;
use super::plot::{Line, Mark, Room, lines};
use super::rows::{engine_row, facts, share};
use crate::Result;
use crate::sweep::{AlikeErrors, Sweep, SweepReport};

pub(super) fn summary_rows(report: &SweepReport) -> Vec<(&'static str, String)> {
    let seconds = &report.seconds;
    let milliseconds = seconds.total() * 1e3;
    vec![
        ("method", "sweep".into()),
        ("vessel", format!("{:.0} mm, {} rings, {} nodes", report.length_mm, report.rings, report.nodes)),
        ("engine", engine_row(&report.engine, report.threads)),
        (
            "time",
            format!(
                "{milliseconds:.0} ms: axis, placing echoes, fitting, estimating errors, computing support"
            ),
        ),
    ]
}

/// A value of every ring along the axis, from its nodes' values.
fn along(sweep: &Sweep, name: &str, of: impl Fn(std::ops::Range<usize>) -> f64) -> Line {
    let point =
        |ring: usize| [ring as f64 * sweep.axis.step_mm, of(ring * sweep.nodes..(ring + 1) * sweep.nodes)];
    Line { name: name.into(), points: (0..sweep.axis.rings()).map(point).collect(), mark: Mark::Line }
}

/// Mean of the finite values; NaN without any.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.filter(|v| v.is_finite()).fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    sum / count
}

pub(super) fn coverage(page: &mut Page, sweep: &Sweep) -> Result<()> {
    let support = &sweep.support;
    page.heading("Coverage");
    let supported = support.supported.iter().filter(|s| **s).count();
    page.paragraph(&format!(
        "{} of {} nodes are supported by echoes around them. The others lie beyond the echoes or in the mouths of \
         branches, and are cut from the surface unless they are asked for.",
        share(supported as u64, support.supported.len() as u64),
        support.supported.len()
    ));
    let echoes = |ring: std::ops::Range<usize>| mean(support.echoes[ring].iter().map(|&n| f64::from(n)));
    let percent = |ring: std::ops::Range<usize>| {
        100.0 * mean(support.supported[ring].iter().map(|&s| f64::from(u8::from(s))))
    };
    let echoes = lines(
        Room::Half,
        "along the axis (mm)",
        "echoes of a node",
        &[along(sweep, "mean of a ring", echoes)],
    )?;
    let percent = lines(
        Room::Half,
        "along the axis (mm)",
        "nodes supported (%)",
        &[along(sweep, "of a ring", percent)],
    )?;
    page.plots([
        (&echoes, "Echoes nearest to each node, ring by ring."),
        (&percent, "Share of each ring's nodes that are supported."),
    ]);
    Ok(())
}

/// How long errors stay alike.
fn alike(errors: &AlikeErrors) -> String {
    if errors.correlation_s > 0.0 { format!(", for {:.2} s", errors.correlation_s) } else { String::new() }
}

pub(super) fn noise(page: &mut Page, sweep: &Sweep) -> Result<()> {
    let Sweep { report, support, .. } = sweep;
    page.heading("Noise");
    let echoes = report.echoes as u64;
    let mut rows = vec![
        ("noise across the wall (standard deviation)", format!("{:.3} mm", report.noise_mm)),
        ("noise along the wall", format!("{:.3} mm", report.tangential_noise_mm)),
        ("rays without an echo", share(report.missing as u64, echoes + report.missing as u64)),
        ("echoes off the wall", share(report.off_wall as u64, echoes)),
        ("echoes beyond the ends", share(report.beyond_ends as u64, echoes)),
        ("frames left out", share(report.folded_frames.len() as u64, report.frames as u64)),
    ];
    if let Some(errors) = &report.errors {
        rows.push(("errors of each echo for itself", format!("{:.3} mm", errors.rays_mm)));
        for shift in &errors.shifts {
            rows.push(("shifts of whole frames", format!("{:.3} mm an axis{}", shift.sd_mm, alike(shift))));
        }
        if let Some(corrected) = errors.corrected {
            rows.push((
                "shifts of single frames, corrected",
                format!("{} frames, {:.3} mm an axis (rms)", corrected.frames, corrected.rms_mm),
            ));
        }
        for contour in &errors.contours {
            let width_deg = contour.width_deg.unwrap_or(0.0);
            let value = format!("{:.3} mm, alike over {width_deg:.0}°{}", contour.sd_mm, alike(contour));
            rows.push(("errors of the contours", value));
        }
        for beat in &errors.beats {
            let what =
                if beat.is_shift { "shifts of whole frames, beating" } else { "the lumen's radius, beating" };
            rows.push((what, format!("{:.3} mm at {:.2} Hz", beat.sd_mm, beat.frequency_hz)));
        }
        if let Some(mm) = errors.rest_mm() {
            rows.push((
                "place at the ends of a beat",
                format!("{mm:.3} mm an axis beside the mean, which the wall is of"),
            ));
        }
        let hidden = format!("that last longer than {:.1} s, for which a place was seen", errors.seen_for_s);
        rows.push(("errors that do not show", hidden));
        rows.push(("roughness of the wall", format!("{:.3}", errors.roughness)));
    }
    page.table(&facts(rows));
    let of_supported = |values: &[f64], ring: std::ops::Range<usize>| {
        mean(ring.filter(|&n| support.supported[n]).map(|n| values[n]))
    };
    let residual = along(sweep, "residual", |ring| of_supported(&support.residual_mm, ring));
    let error = along(sweep, "standard error", |ring| of_supported(&support.standard_error_mm, ring));
    if residual.points.iter().any(|p| p[1].is_finite()) {
        let residual = lines(Room::Half, "along the axis (mm)", "residual (mm)", &[residual])?;
        let error = lines(Room::Half, "along the axis (mm)", "standard error (mm)", &[error])?;
        page.plots([
            (&residual, "Root mean square distance of the echoes from the wall about each supported node."),
            (&error, "Standard error of the radius at each supported node."),
        ]);
    }
    Ok(())
}
