//! Stenoses and aneurysms of a profile of areas along a vessel.

use super::sections::LumenSection;
use crate::numerics::robust::{median, robust_sd};
use crate::setters::setters;
use crate::{Error, Result};
use serde::Serialize;
use std::f64::consts::PI;
use std::ops::Range;

/// What counts as a lesion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LesionRules {
    /// Least diameter stenosis, %: 25, as "mild" of CAD-RADS begins.
    pub stenosis_percent: f64,
    /// Least ratio of diameter to reference of an aneurysm: 1.5, as vascular surgery has it.
    pub aneurysm_ratio: f64,
    /// A lesion ends at its shoulders, where the diameter is within so many per cent of the reference.
    pub shoulder_percent: f64,
    /// Half the length over which the reference is fitted, in median diameters. More than a lesion's length, or it is
    /// taken for the vessel.
    pub reference_diameters: f64,
}

impl Default for LesionRules {
    fn default() -> Self {
        Self { stenosis_percent: 25.0, aneurysm_ratio: 1.5, shoulder_percent: 5.0, reference_diameters: 10.0 }
    }
}

setters!(LesionRules {
    with_stenosis_percent => stenosis_percent: f64,
    with_aneurysm_ratio => aneurysm_ratio: f64,
    with_shoulder_percent => shoulder_percent: f64,
    with_reference_diameters => reference_diameters: f64,
});

impl LesionRules {
    /// # Errors
    /// [`Error::Setting`] for values out of their ranges.
    pub fn validate(&self) -> Result<()> {
        let within = |name, value: f64, low, high| match (low..=high).contains(&value) {
            true => Ok(()),
            false => Err(Error::setting(name, value.to_string(), format!("{low} to {high}"))),
        };
        within("stenosis_percent", self.stenosis_percent, 5.0, 99.0)?;
        within("aneurysm_ratio", self.aneurysm_ratio, 1.05, 10.0)?;
        within("shoulder_percent", self.shoulder_percent, 0.5, 50.0)?;
        within("reference_diameters", self.reference_diameters, 1.0, 1000.0)
    }
}

/// A number with its interval of 95 %, as far as the standard errors of the nodes are known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Interval {
    /// The number.
    pub value: f64,
    /// The lower end; NaN where it is not known.
    pub low: f64,
    /// The upper end; NaN where it is not known.
    pub high: f64,
}

impl Interval {
    /// A number with the ends of its interval.
    pub fn between(value: f64, [low, high]: [f64; 2]) -> Self {
        Self { value, low, high }
    }

    /// The part of it that is no less than a bound.
    fn at_least(self, bound: f64) -> Self {
        Self { low: if self.low < bound { bound } else { self.low }, ..self }
    }

    fn of(value: f64, standard_error: f64) -> Self {
        const Z: f64 = 1.96;
        Self { value, low: value - Z * standard_error, high: value + Z * standard_error }
    }
}

/// Which way a lesion departs from the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LesionKind {
    /// Narrower.
    Stenosis,
    /// Wider.
    Aneurysm,
}

impl LesionKind {
    /// 1 where the diameter is less than the reference, -1 where it is more.
    fn sign(self) -> f64 {
        match self {
            LesionKind::Stenosis => 1.0,
            LesionKind::Aneurysm => -1.0,
        }
    }
}

/// Rounds of finding lesions and fitting the reference to the rest.
const ROUNDS: usize = 8;

/// A narrow or wide part of a vessel. Diameters are circular-equivalent.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Lesion {
    /// Narrower or wider.
    pub kind: LesionKind,
    /// Where the area is least, or largest of an aneurysm, mm along the axis.
    pub at_mm: f64,
    /// Shoulders: where it begins, mm. The first section, where the vessel begins within the lesion.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Its length, mm; a shoulder is known to half a step on both sides.
    pub length_mm: Interval,
    /// Minimal lumen area (the largest of an aneurysm), mm².
    pub area_mm2: Interval,
    /// Circular-equivalent diameter there, mm.
    pub diameter_mm: Interval,
    /// Area of the reference there, mm².
    pub reference_area_mm2: Interval,
    /// Diameter of the reference there, mm.
    pub reference_diameter_mm: Interval,
    /// Diameter stenosis: how much the diameter lacks of the reference, %; negative of an aneurysm.
    pub diameter_stenosis_percent: Interval,
    /// Area stenosis, %; negative of an aneurysm.
    pub area_stenosis_percent: Interval,
    /// Volume of the lumen between the shoulders, mm³.
    pub volume_mm3: f64,
    /// What is doubtful about it.
    pub remark: Option<String>,
}

/// A vessel's profile and its lesions.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Profile {
    /// Where sections have areas, mm along the axis.
    pub at_mm: Vec<f64>,
    /// Circular-equivalent diameter there, mm.
    pub diameter_mm: Vec<f64>,
    /// Diameter that the vessel would have there without lesions, mm.
    pub reference_diameter_mm: Vec<f64>,
    /// Standard error of the reference, mm.
    pub reference_error_mm: f64,
    /// The smallest area, mm², with its interval.
    pub minimal_area_mm2: Option<Interval>,
    /// Where it is, mm along the axis.
    pub minimal_area_at_mm: Option<f64>,
    /// Volume of the lumen between the first and the last section, mm³: areas times the length between them.
    pub volume_mm3: f64,
    /// Longest part of it without a section that has an area, mm.
    pub longest_gap_mm: f64,
    /// The lesions, in their order along the vessel.
    pub lesions: Vec<Lesion>,
    /// The rules.
    pub rules: LesionRules,
}

/// One section of a profile.
#[derive(Debug, Clone, Copy)]
struct Station {
    at: f64,
    area: f64,
    area_error: f64,
    diameter: f64,
    measured: f64,
}

impl Profile {
    /// The profile of sections across an axis, in their order along it. Sections without an area are left out.
    ///
    /// # Errors
    /// As [`LesionRules::validate`].
    pub fn of(sections: &[LumenSection], rules: &LesionRules) -> Result<Self> {
        rules.validate()?;
        let station = |section: &LumenSection| {
            let area = section.measures.area_mm2;
            (area > 0.0).then_some(Station {
                at: section.at_mm?,
                area,
                area_error: section.standard_errors.map_or(f64::NAN, |errors| errors.area_mm2),
                diameter: section.measures.equivalent_diameter_mm,
                measured: section.measured_share.unwrap_or(1.0),
            })
        };
        let stations: Vec<Station> = sections.iter().filter_map(station).collect();
        let diameters: Vec<f64> = stations.iter().map(|s| s.diameter).collect();
        let reach = rules.reference_diameters * median(&mut diameters.clone());
        // Lesions are found with a reference, and the reference is fitted to what lies outside of them.
        let mut is_lesion = vec![false; stations.len()];
        let mut reference = Vec::new();
        for _ in 0..ROUNDS {
            reference = reference_mm(&stations, &is_lesion, reach);
            let found = lesions(&diameters, &reference, rules);
            let mut now = vec![false; stations.len()];
            found.iter().for_each(|(_, within, _)| now[within.clone()].fill(true));
            let is_settled = now == is_lesion;
            is_lesion = now;
            if is_settled {
                break;
            }
        }
        let outside = (0..stations.len()).filter(|&k| !is_lesion[k]);
        let mut residuals: Vec<f64> = outside.map(|k| (diameters[k] - reference[k]).abs()).collect();
        // Of a median of about so many independent sections: their errors are alike over half a diameter.
        let independent = (residuals.len() as f64).min(4.0 * rules.reference_diameters).max(2.0);
        let reference_error_mm = robust_sd(&mut residuals) * (PI / 2.0 / independent).sqrt();
        let least = stations.iter().min_by(|a, b| a.area.total_cmp(&b.area));
        let gaps = stations.windows(2).map(|pair| pair[1].at - pair[0].at);
        let mut profile = Self {
            at_mm: stations.iter().map(|s| s.at).collect(),
            minimal_area_mm2: least.map(|s| Interval::of(s.area, s.area_error)),
            minimal_area_at_mm: least.map(|s| s.at),
            volume_mm3: volume_mm3(&stations),
            longest_gap_mm: gaps.fold(0.0, f64::max),
            diameter_mm: diameters,
            reference_diameter_mm: reference,
            reference_error_mm,
            lesions: Vec::new(),
            rules: *rules,
        };
        let lack = |k: usize| 1.0 - profile.diameter_mm[k] / profile.reference_diameter_mm[k];
        let found = lesions(&profile.diameter_mm, &profile.reference_diameter_mm, rules);
        let lesion = |(kind, within, peak): (LesionKind, Range<usize>, usize)| {
            profile.lesion(kind, &stations, within, peak, &|k| kind.sign() * lack(k))
        };
        profile.lesions = found.into_iter().map(lesion).collect();
        profile.lesions.sort_by(|a, b| a.at_mm.total_cmp(&b.at_mm));
        Ok(profile)
    }

    fn lesion(
        &self,
        kind: LesionKind,
        stations: &[Station],
        within: Range<usize>,
        peak: usize,
        size: &dyn Fn(usize) -> f64,
    ) -> Lesion {
        let Station { at, area, area_error, diameter, .. } = stations[peak];
        let reference = self.reference_diameter_mm[peak];
        let shoulder = self.rules.shoulder_percent / 100.0;
        // Between the last section in the lesion and the first outside, where the profile crosses the shoulder.
        let crossing = |inside: usize, outside: Option<usize>| match outside {
            Some(outside) if outside < stations.len() => {
                let share = (size(inside) - shoulder) / (size(inside) - size(outside));
                stations[inside].at + (stations[outside].at - stations[inside].at) * share.clamp(0.0, 1.0)
            }
            _ => stations[inside].at,
        };
        let last = within.end - 1;
        let from_mm = crossing(within.start, within.start.checked_sub(1));
        let to_mm = crossing(last, Some(within.end));
        // How far a shoulder moves with the error of the diameter there, plus half a step for what lies between sections.
        let slope = |k: usize| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(stations.len() - 1));
            ((size(b) - size(a)) / (stations[b].at - stations[a].at)).abs().max(1e-9)
        };
        let step = |k: usize| {
            (stations[(k + 1).min(stations.len() - 1)].at - stations[k.saturating_sub(1)].at) / 2.0
        };
        let shoulder_error = |k: usize| {
            let diameter_error = 2.0 * stations[k].area_error / (PI * stations[k].diameter);
            let size_error = diameter_error.hypot(self.reference_error_mm) / self.reference_diameter_mm[k];
            (size_error / slope(k)).hypot(step(k) / 2.0)
        };
        let length_error = shoulder_error(within.start).hypot(shoulder_error(last));
        let diameter_error = 2.0 * area_error / (PI * diameter);
        let reference_error = self.reference_error_mm;
        let ratio = diameter / reference;
        let ratio_error = ratio * (diameter_error / diameter).hypot(reference_error / reference);
        let mut remarks = Vec::new();
        if within.start == 0 || within.end == stations.len() {
            remarks.push("the vessel ends within it: the reference there is extrapolated".to_owned());
        }
        let measured = stations[within.clone()].iter().map(|s| s.measured).fold(1.0, f64::min);
        if measured < 0.9 {
            remarks.push(format!("as little as {:.0} % of an outline in it is measured", 100.0 * measured));
        }
        let gap = stations[within.start.saturating_sub(1)..(within.end + 1).min(stations.len())]
            .windows(2)
            .map(|pair| pair[1].at - pair[0].at)
            .fold(0.0, f64::max);
        if gap > 0.25 * (to_mm - from_mm).max(diameter) {
            remarks.push(format!("no sections over {gap:.1} mm of it"));
        }
        Lesion {
            kind,
            at_mm: at,
            from_mm,
            to_mm,
            length_mm: Interval::of(to_mm - from_mm, length_error).at_least(0.0),
            area_mm2: Interval::of(area, area_error),
            diameter_mm: Interval::of(diameter, diameter_error),
            reference_area_mm2: Interval::of(
                PI * reference * reference / 4.0,
                PI * reference * reference_error / 2.0,
            ),
            reference_diameter_mm: Interval::of(reference, reference_error),
            diameter_stenosis_percent: Interval::of(100.0 * (1.0 - ratio), 100.0 * ratio_error),
            area_stenosis_percent: Interval::of(100.0 * (1.0 - ratio * ratio), 200.0 * ratio * ratio_error),
            volume_mm3: volume_mm3(&stations[within]),
            remark: (!remarks.is_empty()).then(|| remarks.join("; ")),
        }
    }
}

/// Areas times lengths by the trapezium rule, mm³.
fn volume_mm3(stations: &[Station]) -> f64 {
    stations.windows(2).map(|pair| (pair[1].at - pair[0].at) * (pair[0].area + pair[1].area) / 2.0).sum()
}

/// The lesions of some diameters: kind, sections, and the section that departs most from the reference.
fn lesions(
    diameter_mm: &[f64],
    reference_mm: &[f64],
    rules: &LesionRules,
) -> Vec<(LesionKind, Range<usize>, usize)> {
    let shoulder = rules.shoulder_percent / 100.0;
    let count = diameter_mm.len();
    let mut found = Vec::new();
    for (kind, least) in [
        (LesionKind::Stenosis, rules.stenosis_percent / 100.0),
        (LesionKind::Aneurysm, rules.aneurysm_ratio - 1.0),
    ] {
        let size = |k: usize| kind.sign() * (1.0 - diameter_mm[k] / reference_mm[k]);
        let mut k = 0;
        while k < count {
            let first = k;
            while k < count && size(k) > shoulder {
                k += 1;
            }
            let peak = (first..k).fold(first, |best, i| if size(i) > size(best) { i } else { best });
            if k > first && size(peak) >= least {
                found.push((kind, first..k, peak));
            }
            k = k.max(first + 1);
        }
    }
    found
}

/// The diameter without lesions at each section: the line through the diameters outside of lesions within `reach` on both
/// sides, which those of fewer than half of the sections cannot bend (repeated medians: A. F. Siegel, *Robust regression
/// using repeated medians*, Biometrika 69, 1982). A vessel may taper.
fn reference_mm(stations: &[Station], is_lesion: &[bool], reach: f64) -> Vec<f64> {
    // So many sections decide: more add nothing but time.
    const MOST: usize = 120;
    let outside: Vec<&Station> =
        stations.iter().zip(is_lesion).filter(|(_, l)| !**l).map(|(s, _)| s).collect();
    let line = |at: f64| {
        let near: Vec<&Station> = outside.iter().copied().filter(|s| (s.at - at).abs() <= reach).collect();
        let near = if near.len() < 3 { &outside } else { &near };
        let every = near.len().div_ceil(MOST).max(1);
        let near: Vec<&Station> = near.iter().copied().step_by(every).collect();
        let slope_about = |a: &Station| {
            let slopes =
                near.iter().filter(|b| b.at != a.at).map(|b| (b.diameter - a.diameter) / (b.at - a.at));
            median(&mut slopes.collect::<Vec<_>>())
        };
        let slope = median(&mut near.iter().map(|s| slope_about(s)).collect::<Vec<_>>());
        let heights = near.iter().map(|s| s.diameter - slope * (s.at - at));
        median(&mut heights.collect::<Vec<_>>()).max(f64::MIN_POSITIVE)
    };
    stations.iter().map(|s| line(s.at)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::sections::LumenSection;

    fn sections(diameter: impl Fn(f64) -> f64) -> Vec<LumenSection> {
        (0..=200)
            .map(|k| f64::from(k) * 0.5)
            .map(|at| {
                let mut section = LumenSection::without(String::new());
                section.at_mm = Some(at);
                section.measures.equivalent_diameter_mm = diameter(at);
                section.measures.area_mm2 = PI / 4.0 * diameter(at).powi(2);
                section
            })
            .collect()
    }

    #[test]
    fn two_lesions_of_a_tapering_vessel_are_found_with_their_sizes() {
        let taper = |at: f64| 12.0 - 0.04 * at;
        let bell = |at: f64, middle: f64, sd: f64| (-0.5 * ((at - middle) / sd).powi(2)).exp();
        let diameter = |at: f64| taper(at) * (1.0 - 0.5 * bell(at, 30.0, 4.0) + 0.7 * bell(at, 70.0, 5.0));
        let profile = Profile::of(&sections(diameter), &LesionRules::default()).unwrap();
        let kinds: Vec<LesionKind> = profile.lesions.iter().map(|l| l.kind).collect();
        assert_eq!(kinds, [LesionKind::Stenosis, LesionKind::Aneurysm]);
        let [stenosis, aneurysm] = &profile.lesions[..] else { panic!() };
        assert!((stenosis.at_mm - 30.0).abs() < 0.6 && (aneurysm.at_mm - 70.0).abs() < 0.6);
        assert!((stenosis.diameter_stenosis_percent.value - 50.0).abs() < 1.0, "{stenosis:?}");
        assert!((stenosis.area_stenosis_percent.value - 75.0).abs() < 1.0);
        assert!((stenosis.reference_diameter_mm.value - taper(30.0)).abs() < 0.1);
        // A bell of half the diameter is down to a twentieth at √(2 ln 10) standard deviations.
        assert!(
            (stenosis.length_mm.value - 2.0 * 4.0 * (2.0 * 10.0_f64.ln()).sqrt()).abs() < 1.0,
            "{stenosis:?}"
        );
        assert!((aneurysm.diameter_stenosis_percent.value + 70.0).abs() < 1.5, "{aneurysm:?}");
        // A plain taper is no lesion.
        assert!(Profile::of(&sections(taper), &LesionRules::default()).unwrap().lesions.is_empty());
        let none = Profile::of(&[], &LesionRules::default()).unwrap();
        assert!(none.lesions.is_empty() && none.minimal_area_mm2.is_none());
        assert!(Profile::of(&[], &LesionRules::default().with_stenosis_percent(0.0)).is_err());
    }
}
