//! What a page shows of a vessel that branches.

use super::rows::engine_row;
use crate::branching::{BranchReport, BranchesReport, CylinderBranchReport, CylinderBranchesReport};

pub(super) fn summary_rows(report: &BranchesReport) -> Vec<(&'static str, String)> {
    let of_branch = |(number, branch): (usize, &BranchReport)| {
        let sweep = &branch.sweep;
        let from = from(branch.parent);
        format!("{number}: {:.0} mm of {:.1} mm radius{from}", sweep.length_mm, sweep.contour_radius_mm)
    };
    let branches: Vec<String> = report.branches.iter().enumerate().map(of_branch).collect();
    let mut rows = vec![
        ("method", "sweep of every branch, joined".into()),
        ("branches", branches.join("; ")),
        ("vessel", format!("{} nodes, {} of them supported", report.nodes, report.supported)),
    ];
    if let Some(first) = report.branches.first() {
        rows.push(("engine", engine_row(&first.sweep.engine, first.sweep.threads)));
    }
    rows.push((
        "time",
        format!("{:.0} ms: branches, their sweeps, joining, fitting where they meet", report.total_s() * 1e3),
    ));
    rows
}

pub(super) fn cylinder_summary_rows(report: &CylinderBranchesReport) -> Vec<(&'static str, String)> {
    let of_branch = |(number, branch): (usize, &CylinderBranchReport)| {
        let (cylinders, from) = (branch.cylinders.cylinders, from(branch.parent));
        format!("{number}: {:.0} mm, {cylinders} cylinders{from}", branch.length_mm)
    };
    let branches: Vec<String> = report.branches.iter().enumerate().map(of_branch).collect();
    let mut rows = vec![
        ("method", "cylinders of every branch, merged and joined".into()),
        ("branches", branches.join("; ")),
        ("vessel", format!("{} nodes, {} of them supported", report.nodes, report.supported)),
    ];
    if let Some(first) = report.branches.first() {
        rows.push(("engine", engine_row(&first.cylinders.engine, first.cylinders.threads)));
    }
    rows.push((
        "time",
        format!(
            "{:.0} ms: branches, their cylinders, joining, fitting where they meet",
            report.total_s() * 1e3
        ),
    ));
    rows
}

fn from(parent: Option<usize>) -> String {
    parent.map_or_else(String::new, |parent| format!(", from branch {parent}"))
}
