//! Ways of the catheter through a vessel that branches.

use super::centreline::Centreline;
use super::vessel::SimulatedVessel;
use crate::{Error, Result};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// A branch that the catheter goes along, and how far.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct Visit {
    /// Which of the vessel's centrelines, counted from 0.
    pub branch: usize,
    /// How far along that centreline, mm; 5 mm before its end where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_mm: Option<f64>,
}

impl Visit {
    /// A branch up to `to_mm` along it, or up to 5 mm before its end.
    pub fn new(branch: usize, to_mm: Option<f64>) -> Self {
        Self { branch, to_mm }
    }
}

impl FromStr for Visit {
    type Err = Error;

    /// `2`, or `2:40`: branch 2 up to 40 mm.
    fn from_str(text: &str) -> Result<Self> {
        let (branch, to_mm) = match text.split_once(':') {
            None => (text.trim().parse().ok(), Some(None)),
            Some((branch, to)) => (branch.trim().parse().ok(), to.trim().parse().ok().map(Some)),
        };
        match (branch, to_mm) {
            (Some(branch), Some(to_mm)) => Ok(Self { branch, to_mm }),
            _ => Err(Error::setting("insertion.visits", text, "a branch, or branch:mm, as in 0,1:40")),
        }
    }
}

/// Where the catheter truly is in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Place {
    /// Which of the visits, counted from 0.
    pub visit: usize,
    /// The branch whose centreline the catheter follows there, counted from 0. Where several run together, it
    /// is the one that was visited first.
    pub branch: usize,
    /// Length along that branch's own centreline, mm. A bent tip lies beside it.
    pub s_mm: f64,
}

/// A smooth way from the beginning of the vessel to the end of a branch.
///
/// Ways that begin together have the same points there, hence the same positions and frames to the last bit:
/// the catheter passes from one to the other without a jump. See [`Way::common_mm`].
#[derive(Debug, Clone)]
pub(super) struct Way {
    pub line: Centreline,
    stretches: Vec<Stretch>,
}

/// A part of a way that follows one branch, up to the next one.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    from_mm: f64,
    branch: usize,
    /// Length along the branch's own centreline, less that along the way.
    ahead_mm: f64,
}

/// Where a branch leaves a way that it began together with.
struct Parting {
    /// Length along the way.
    way_mm: f64,
    /// Length along the branch.
    branch_mm: f64,
}

impl Way {
    /// The branch's own centreline.
    pub fn along(branch: usize, line: &Centreline) -> Self {
        Self { line: line.clone(), stretches: vec![Stretch { from_mm: 0.0, branch, ahead_mm: 0.0 }] }
    }

    /// The branch at that length, and the length along the branch's own centreline, mm.
    pub fn place(&self, s_mm: f64) -> (usize, f64) {
        let next = self.stretches.partition_point(|stretch| stretch.from_mm <= s_mm);
        let stretch = self.stretches[next.saturating_sub(1)];
        (stretch.branch, s_mm + stretch.ahead_mm)
    }

    /// Length along the way of the place at `s_mm` of the branch that it leads to, mm.
    pub fn station_mm(&self, vessel: &SimulatedVessel, branch: usize, s_mm: f64) -> f64 {
        let own = self.stretches.iter().rev().find(|stretch| stretch.branch == branch);
        match own {
            Some(stretch) if s_mm - stretch.ahead_mm >= stretch.from_mm => s_mm - stretch.ahead_mm,
            // Before the parting the branch has no stretch of its own.
            _ => {
                let guess_mm = own.map_or(s_mm, |stretch| s_mm - stretch.ahead_mm);
                let line = &vessel.branches()[branch];
                let reach_mm = 2.0 * line.inscribed_radius_at_mm(s_mm) + 1.0;
                self.line.nearest_mm(line.at(s_mm).0, guess_mm, reach_mm).max(0.0)
            }
        }
    }

    /// Up to which length two ways are the same, bit by bit, mm; infinite for the same way.
    pub fn common_mm(&self, other: &Self) -> f64 {
        let (a, b) = (self.line.points_mm(), other.line.points_mm());
        let same = a.iter().zip(b).take_while(|(a, b)| a == b).count();
        if same == a.len() && same == b.len() {
            return f64::INFINITY;
        }
        // A point has its slope from both neighbours, and a frame is taken from the nearest of its grid.
        match same.checked_sub(2) {
            Some(last) => (self.line.arc_length_mm()[last] - self.line.frame_step_mm()).max(0.0),
            None => 0.0,
        }
    }

    /// Length along the way beside a point in the tube about it, mm.
    fn beside_mm(&self, point_mm: DVec3) -> Option<f64> {
        let apart = |s: f64| self.line.at(s).0.distance(point_mm);
        let every = self.line.every_mm().into_iter().map(|(s, _)| s);
        let guess_mm = every.min_by(|&a, &b| apart(a).total_cmp(&apart(b)))?;
        let s = self.line.nearest_mm(point_mm, guess_mm, 2.0).clamp(0.0, self.line.length_mm());
        (apart(s) <= self.line.inscribed_radius_at_mm(s)).then_some(s)
    }

    /// Where a branch leaves the way for good; `None` where it does not begin in the tube about the way.
    fn parting(&self, line: &Centreline) -> Option<Parting> {
        let mut way_mm = self.beside_mm(line.at(0.0).0)?;
        let mut parting = Parting { way_mm, branch_mm: 0.0 };
        let steps = (line.length_mm() / STEP_MM).ceil().clamp(1.0, 1e5) as usize;
        let step_mm = line.length_mm() / steps as f64;
        for i in 0..=steps {
            let branch_mm = i as f64 * step_mm;
            let point = line.at(branch_mm).0;
            way_mm =
                self.line.nearest_mm(point, way_mm, 2.0 * step_mm + 0.5).clamp(0.0, self.line.length_mm());
            let apart_mm = self.line.at(way_mm).0.distance(point);
            let radius_mm = self.line.inscribed_radius_at_mm(way_mm);
            if apart_mm <= TOGETHER * radius_mm {
                parting = Parting { way_mm, branch_mm };
            } else if apart_mm > 2.0 * radius_mm {
                break;
            }
        }
        Some(parting)
    }

    /// Goes along this way, and then along the branch: a cubic leads from one centreline to the other.
    fn then(&self, vessel: &SimulatedVessel, branch: usize, parting: &Parting) -> Result<Self> {
        let line = &vessel.branches()[branch];
        let reach_mm = self.line.inscribed_radius_at_mm(parting.way_mm);
        let leave_mm = parting.way_mm - reach_mm;
        let arrive_mm = parting.branch_mm + reach_mm;
        if arrive_mm >= line.length_mm() {
            // It ends before it leaves.
            return Ok(self.clone());
        }
        let mut points = Vec::new();
        let mut radii = Vec::new();
        let own = self.line.points_mm().iter().zip(self.line.arc_length_mm());
        for ((&point, &s), &radius) in own.zip(self.line.inscribed_radius_mm()) {
            if s < leave_mm - APART_MM {
                points.push(point);
                radii.push(radius);
            }
        }
        if points.len() < 3 {
            return Err(Error::Setting {
                name: "insertion.visits".into(),
                found: format!(
                    "branch {branch}, which leaves the way of another at {:.1} mm",
                    parting.way_mm
                ),
                expected: format!("a way together of more than {reach_mm:.1} mm (a radius) before they part"),
            });
        }
        let [(from, out), (to, onward)] = [self.line.at(leave_mm), line.at(arrive_mm)];
        let chord_mm = from.distance(to);
        let steps = (chord_mm / 0.5).ceil().clamp(4.0, 1e4) as usize;
        let middle = points.len() + steps / 2;
        for i in 0..=steps {
            let u = i as f64 / steps as f64;
            let (u2, u3) = (u * u, u * u * u);
            let point = from * (2.0 * u3 - 3.0 * u2 + 1.0)
                + out * chord_mm * (u3 - 2.0 * u2 + u)
                + to * (3.0 * u2 - 2.0 * u3)
                + onward * chord_mm * (u3 - u2);
            points.push(point);
            radii.push(vessel.distance_mm(point).max(1e-3));
        }
        let arrived = points.len() - 1;
        let rest = line.points_mm().iter().zip(line.arc_length_mm());
        for ((&point, &s), &radius) in rest.zip(line.inscribed_radius_mm()) {
            if s > arrive_mm + APART_MM {
                points.push(point);
                radii.push(radius);
            }
        }
        let line = Centreline::with_frame_step_mm(points, radii, self.line.frame_step_mm())?;
        let (from_mm, arrived_mm) = (line.arc_length_mm()[middle], line.arc_length_mm()[arrived]);
        let mut stretches: Vec<Stretch> =
            self.stretches.iter().copied().filter(|stretch| stretch.from_mm < from_mm).collect();
        stretches.push(Stretch { from_mm, branch, ahead_mm: arrive_mm - arrived_mm });
        Ok(Self { line, stretches })
    }
}

/// The ways to the branches of a list, each branch once, in the order of the list. `numbers[i]` is the way of
/// visit i.
pub(super) fn ways(vessel: &SimulatedVessel, visits: &[Visit]) -> Result<(Vec<Way>, Vec<usize>)> {
    let mut found: Vec<(usize, Way)> = Vec::new();
    let mut numbers = Vec::with_capacity(visits.len());
    for visit in visits {
        if visit.branch >= vessel.branches().len() {
            return Err(Error::Setting {
                name: "insertion.visits".into(),
                found: format!("branch {}", visit.branch),
                expected: format!("below {}, the number of branches", vessel.branches().len()),
            });
        }
        add_way(vessel, visit.branch, &mut found, &mut Vec::new())?;
        numbers.extend(found.iter().position(|&(branch, _)| branch == visit.branch));
    }
    Ok((found.into_iter().map(|(_, way)| way).collect(), numbers))
}

/// Adds the way to a branch, and before it those to the branches that it leads through; `open` are those that
/// wait for it.
fn add_way(
    vessel: &SimulatedVessel,
    branch: usize,
    found: &mut Vec<(usize, Way)>,
    open: &mut Vec<usize>,
) -> Result<()> {
    if found.iter().any(|&(known, _)| known == branch) {
        return Ok(());
    }
    open.push(branch);
    let line = &vessel.branches()[branch];
    // A branch whose centreline begins within another one is reached through that one.
    let parent = (0..vessel.branches().len()).filter(|other| !open.contains(other)).find(|&other| {
        let way = Way::along(other, &vessel.branches()[other]);
        way.beside_mm(line.at(0.0).0).is_some_and(|s| s > way.line.inscribed_radius_at_mm(s))
    });
    if let Some(parent) = parent {
        add_way(vessel, parent, found, open)?;
    }
    let partings = found.iter().filter_map(|(_, way)| way.parting(line).map(|parting| (way, parting)));
    // The way that the branch follows longest.
    let longest = partings.reduce(|a, b| if b.1.branch_mm > a.1.branch_mm { b } else { a });
    let way = match longest {
        Some((way, parting)) => way.then(vessel, branch, &parting)?,
        None if found.is_empty() => Way::along(branch, line),
        None => {
            return Err(Error::Setting {
                name: "insertion.visits".into(),
                found: format!("branch {branch}, which begins at {:.1}", line.at(0.0).0),
                expected: "a centreline that begins together with that of another branch, or within it"
                    .into(),
            });
        }
    };
    open.pop();
    found.push((branch, way));
    Ok(())
}

/// Step of the search for partings, mm.
const STEP_MM: f64 = 0.25;

/// Centrelines that are nearer to each other than this share of the radius run together.
const TOGETHER: f64 = 0.1;

/// Points of a way that follow each other are farther apart than this, mm, where one centreline passes into
/// another.
const APART_MM: f64 = 0.1;
