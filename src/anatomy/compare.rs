//! Two lumens beside each other: areas along a common axis, and how much of them overlaps.

use super::axis::VesselAxis;
use super::find::VesselTree;
use super::sections::Sections;
use crate::Result;
use crate::surface::{SectionOutline, Surface};
use glam::DVec2;
use rayon::prelude::*;
use serde::Serialize;

/// The sections of two lumens in one plane.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AreaPair {
    /// Where it is, mm along the common axis.
    pub at_mm: f64,
    /// Area of the first lumen, mm²; NaN where no outline of it is closed there.
    pub a_mm2: f64,
    /// Area of the second, mm².
    pub b_mm2: f64,
    /// Area that both hold, mm².
    pub both_mm2: f64,
    /// Second less first, in per cent of the first.
    pub difference_percent: f64,
    /// Why an area is missing.
    pub remark: Option<String>,
}

/// Two lumens along a common axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Overlap {
    /// Planes across the axis.
    pub areas: Vec<AreaPair>,
    /// Planes in which both lumens have an area: those below are over them.
    pub compared: usize,
    /// Dice's coefficient of the lumens: twice the volume that both hold over the sum of their volumes.
    pub dice: f64,
    /// Median of |difference| of the areas, %.
    pub median_absolute_difference_percent: f64,
    /// Volume of the second less that of the first, in per cent of the first.
    pub volume_difference_percent: f64,
}

impl Overlap {
    /// Cuts both surfaces by planes across an axis, in branch 0 of each tree. Planes are taken to stand for equal lengths.
    ///
    /// # Errors
    /// As [`Sections::of`].
    pub fn of(
        a: (&Surface, &VesselTree),
        b: (&Surface, &VesselTree),
        axis: &VesselAxis,
        at_mm: &[f64],
    ) -> Result<Self> {
        let (of_a, of_b) = (Sections::of(a.0, Some(a.1))?, Sections::of(b.0, Some(b.1))?);
        let pair = |&at_mm: &f64| {
            let pose = axis.pose(at_mm);
            let (lumen_a, lumen_b) = (of_a.lumen(&pose, 0), of_b.lumen(&pose, 0));
            let area = |lumen: &std::result::Result<SectionOutline, String>| {
                lumen.as_ref().map_or(f64::NAN, SectionOutline::area_mm2)
            };
            let (a_mm2, b_mm2) = (area(&lumen_a), area(&lumen_b));
            let both_mm2 = match (&lumen_a, &lumen_b) {
                // Lines leave it a hair too large or too small.
                (Ok(a), Ok(b)) => common_area_mm2(a, b).min(a_mm2).min(b_mm2),
                _ => f64::NAN,
            };
            let remark = |name: &str, lumen: std::result::Result<SectionOutline, String>| {
                lumen.err().map(|remark| format!("{name}: {remark}"))
            };
            let remarks: Vec<String> = remark("A", lumen_a).into_iter().chain(remark("B", lumen_b)).collect();
            AreaPair {
                at_mm,
                a_mm2,
                b_mm2,
                both_mm2,
                difference_percent: 100.0 * (b_mm2 / a_mm2 - 1.0),
                remark: (!remarks.is_empty()).then(|| remarks.join("; ")),
            }
        };
        let areas: Vec<AreaPair> = at_mm.par_iter().map(pair).collect();
        let compared: Vec<&AreaPair> = areas.iter().filter(|pair| pair.both_mm2.is_finite()).collect();
        let sum = |of: fn(&AreaPair) -> f64| compared.iter().map(|pair| of(pair)).sum::<f64>();
        let (volume_a, volume_b) = (sum(|p| p.a_mm2), sum(|p| p.b_mm2));
        let mut differences: Vec<f64> = compared.iter().map(|p| p.difference_percent.abs()).collect();
        Ok(Self {
            compared: compared.len(),
            dice: 2.0 * sum(|p| p.both_mm2) / (volume_a + volume_b),
            median_absolute_difference_percent: match differences.is_empty() {
                true => f64::NAN,
                false => crate::numerics::robust::median(&mut differences),
            },
            volume_difference_percent: 100.0 * (volume_b / volume_a - 1.0),
            areas,
        })
    }
}

/// The area inside both outlines, mm², by lines across them: exact but for what happens between two lines.
fn common_area_mm2(a: &SectionOutline, b: &SectionOutline) -> f64 {
    /// Lines across the outlines.
    const LINES: usize = 400;
    let points = || a.points_mm.iter().chain(&b.points_mm);
    let low = points().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let high = points().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max);
    let step = (high - low) / LINES as f64;
    let length = |k: usize| {
        let y = low + step * (k as f64 + 0.5);
        // Where the line enters and leaves each outline.
        let crossings = |outline: &SectionOutline| {
            let points = &outline.points_mm;
            let edges = (0..points.len()).map(|i| (points[i], points[(i + 1) % points.len()]));
            let crossing = |(p, q): (DVec2, DVec2)| {
                ((p.y < y) != (q.y < y)).then(|| p.x + (q.x - p.x) * (y - p.y) / (q.y - p.y))
            };
            let mut xs: Vec<f64> = edges.filter_map(crossing).collect();
            xs.sort_by(f64::total_cmp);
            xs
        };
        let (xs_a, xs_b) = (crossings(a), crossings(b));
        let overlap = |p: &[f64], q: &[f64]| (p[1].min(q[1]) - p[0].max(q[0])).max(0.0);
        let spans = xs_a.chunks_exact(2).flat_map(|p| xs_b.chunks_exact(2).map(move |q| overlap(p, q)));
        spans.sum::<f64>()
    };
    (0..LINES).map(length).sum::<f64>() * step
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn the_common_area_of_two_circles_is_that_of_their_lens() {
        let circle = |x: f64| SectionOutline {
            points_mm: (0..2000)
                .map(|k| DVec2::from_angle(f64::from(k) / 2000.0 * TAU) * 5.0 + DVec2::X * x)
                .collect(),
        };
        for apart in [0.0_f64, 3.0, 8.0, 11.0] {
            let half = (apart / 10.0).min(1.0);
            let lens = 2.0 * 25.0 * (half.acos() - half * (1.0 - half * half).sqrt());
            let found = common_area_mm2(&circle(0.0), &circle(apart));
            assert!((found - lens).abs() < 1e-3 * 25.0 * PI, "{apart}: {found} {lens}");
        }
    }
}
