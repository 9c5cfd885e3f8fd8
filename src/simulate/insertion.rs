//! Motion of the catheter.

use super::centreline::Centreline;
use super::route::{Place, Visit, Way, ways};
use super::vessel::SimulatedVessel;
use super::within;
use crate::geometry::Pose;
use crate::setters::setters;
use crate::{Error, Result};
use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// One move of the catheter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Move {
    /// Goes forward along the centreline, up to the end of the insertion.
    Advance {
        /// How far.
        distance_mm: f64,
    },
    /// Goes back along the centreline, down to the start of the insertion.
    Withdraw {
        /// How far.
        distance_mm: f64,
    },
    /// Bends the tip to an angle; 0 straightens it.
    Bend {
        /// Angle between the tip and the catheter before its bending segment, 0 to 90 degrees.
        angle_deg: f64,
    },
    /// Turns the plane in which the tip bends.
    Turn {
        /// By how much, degrees; positive from x towards y of the centreline's frame.
        angle_deg: f64,
    },
    /// Stays.
    Rest {
        /// For how long.
        duration_s: f64,
    },
}

/// A catheter and its motion through a vessel, along one branch or several.
///
/// The catheter follows the centreline. Its bending segment, just before the tip, adds a constant curvature to
/// the centreline's own, in a plane that is fixed in the rotation-minimising frame; so a bent tip in a straight
/// vessel is an arc of a circle, and an unbent tip lies on the centreline. Sensor and probe sit at the tip: x
/// and y across the catheter, z along it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Insertion {
    /// Which of the vessel's centrelines, counted from 0.
    pub branch: usize,
    /// Start of the tip along the centreline, mm.
    pub start_mm: f64,
    /// End of the insertion along the centreline, mm; 5 mm before the end of the centreline where absent.
    pub end_mm: Option<f64>,
    /// Branches to visit one after the other in one recording, instead of `branch` up to `end_mm`.
    ///
    /// Each is visited by the moves. Then the tip is straightened and withdrawn to where the centreline of the
    /// next one parts from the way it came, or to the depth of the next visit where that lies on the way.
    /// Centrelines either begin together, or within that of their parent. `[0, 1]` enters two branches, `[0,
    /// 0:5, 0]` passes one three times.
    pub visits: Vec<Visit>,
    /// Whether frames are recorded while the catheter is withdrawn from one visit to the next. Time goes on
    /// without them.
    pub record_withdrawals: bool,
    /// The moves, in order, of every visit.
    pub moves: Vec<Move>,
    /// Whether the moves are repeated until the tip has reached the end of the insertion, or of the visit.
    pub repeat: bool,
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// Speed along the centreline, mm/s.
    pub speed_mm_s: f64,
    /// How fast the tip bends, degrees per second.
    pub bend_rate_deg_s: f64,
    /// How fast the bending plane turns, degrees per second.
    pub turn_rate_deg_s: f64,
    /// Length of the bending segment, mm.
    pub bending_length_mm: f64,
    /// Smallest distance of the tip from the wall, mm. A bend that would bring it nearer, in any plane, is
    /// reduced.
    pub clearance_mm: f64,
}

setters!(Insertion {
    with_branch => branch: usize,
    with_start_mm => start_mm: f64,
    with_end_mm => end_mm: Option<f64>,
    with_visits => visits: Vec<Visit>,
    with_record_withdrawals => record_withdrawals: bool,
    with_moves => moves: Vec<Move>,
    with_repeat => repeat: bool,
    with_frame_rate_hz => frame_rate_hz: f64,
    with_speed_mm_s => speed_mm_s: f64,
    with_bend_rate_deg_s => bend_rate_deg_s: f64,
    with_turn_rate_deg_s => turn_rate_deg_s: f64,
    with_bending_length_mm => bending_length_mm: f64,
    with_clearance_mm => clearance_mm: f64,
});

impl Default for Insertion {
    /// The sequence of the thesis: 20 mm forward at 2.4 mm/s, the tip bent by 30° at 4.8°/s, its plane turned
    /// through a full circle, the tip straightened, again along the whole vessel; 12 frames a second. The
    /// thesis leaves the speed of the turn and the bending segment open: 24°/s and 15 mm here.
    fn default() -> Self {
        Self {
            branch: 0,
            start_mm: 5.0,
            end_mm: None,
            visits: Vec::new(),
            record_withdrawals: true,
            moves: vec![
                Move::Advance { distance_mm: 20.0 },
                Move::Bend { angle_deg: 30.0 },
                Move::Turn { angle_deg: 360.0 },
                Move::Bend { angle_deg: 0.0 },
            ],
            repeat: true,
            frame_rate_hz: 12.0,
            speed_mm_s: 2.4,
            bend_rate_deg_s: 4.8,
            turn_rate_deg_s: 24.0,
            bending_length_mm: 15.0,
            clearance_mm: 0.5,
        }
    }
}

/// A bend that was reduced because the tip would have left the lumen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ReducedBend {
    /// Where along the centreline, mm.
    pub s_mm: f64,
    /// The angle asked for, degrees.
    pub asked_deg: f64,
    /// The largest angle, to 0.1°, that keeps its clearance in every plane.
    pub used_deg: f64,
}

/// What the catheter is doing at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
struct State {
    visit: usize,
    s_mm: f64,
    bend_rad: f64,
    plane_rad: f64,
}

/// A part of the motion at even speeds, from where the one before it ended.
#[derive(Debug, Clone, Copy)]
struct Leg {
    until_s: f64,
    to: State,
    is_recorded: bool,
}

/// The moves over time.
#[derive(Debug)]
pub(super) struct Path<'a> {
    insertion: &'a Insertion,
    ways: Vec<Way>,
    /// Of each visit, the number of its way.
    way_of_visit: Vec<usize>,
    /// The first one has no length: it is where the catheter starts.
    legs: Vec<Leg>,
    min_scale: f64,
    pub reduced_bends: Vec<ReducedBend>,
}

impl Insertion {
    /// One steady advance along the whole branch, nothing else.
    pub fn steady() -> Self {
        Self { moves: vec![Move::Advance { distance_mm: 20.0 }], ..Self::default() }
    }

    /// How far along a branch of that length the tip may go, mm.
    pub fn end_in_mm(&self, branch_length_mm: f64) -> f64 {
        self.end_mm.unwrap_or(branch_length_mm - 5.0)
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn validate(&self) -> Result<()> {
        within("insertion.start_mm", self.start_mm, 0.0, 1e5)?;
        if let Some(end) = self.end_mm {
            within("insertion.end_mm", end, self.start_mm, 1e5)?;
        }
        within("insertion.frame_rate_hz", self.frame_rate_hz, 0.01, 1e4)?;
        within("insertion.speed_mm_s", self.speed_mm_s, 0.01, 1e3)?;
        within("insertion.bend_rate_deg_s", self.bend_rate_deg_s, 0.01, 1e4)?;
        within("insertion.turn_rate_deg_s", self.turn_rate_deg_s, 0.01, 1e4)?;
        within("insertion.bending_length_mm", self.bending_length_mm, 0.1, 1e3)?;
        within("insertion.clearance_mm", self.clearance_mm, 0.0, 1e2)?;
        if !self.visits.is_empty() && (self.branch != 0 || self.end_mm.is_some()) {
            let found = "insertion.branch or insertion.end_mm beside them";
            return Err(Error::setting("insertion.visits", found, "branches and ends in the visits alone"));
        }
        for to_mm in self.visits.iter().filter_map(|visit| visit.to_mm) {
            within("insertion.visits.to_mm", to_mm, 0.0, 1e5)?;
        }
        for step in &self.moves {
            match *step {
                Move::Advance { distance_mm } => within("insertion.moves.advance", distance_mm, 0.01, 1e5)?,
                Move::Withdraw { distance_mm } => within("insertion.moves.withdraw", distance_mm, 0.01, 1e5)?,
                Move::Bend { angle_deg } => within("insertion.moves.bend", angle_deg, 0.0, 90.0)?,
                Move::Turn { angle_deg } => within("insertion.moves.turn", angle_deg, -3600.0, 3600.0)?,
                Move::Rest { duration_s } => within("insertion.moves.rest", duration_s, 0.0, 1e5)?,
            }
        }
        let forward: f64 = self
            .moves
            .iter()
            .map(|step| match *step {
                Move::Advance { distance_mm } => distance_mm,
                Move::Withdraw { distance_mm } => -distance_mm,
                _ => 0.0,
            })
            .sum();
        if self.moves.is_empty() || (self.repeat && forward <= 0.0) {
            return Err(Error::Setting {
                name: "insertion.moves".into(),
                found: format!("{} moves that go {forward} mm forward in all", self.moves.len()),
                expected: "at least one move, and more than 0 mm forward where they are repeated".into(),
            });
        }
        Ok(())
    }

    /// Plans the moves through a vessel that shrinks to `min_scale` of its size at times. The settings are
    /// taken to be valid.
    pub(super) fn plan<'a>(&'a self, vessel: &SimulatedVessel, min_scale: f64) -> Result<Path<'a>> {
        let only = [Visit::new(self.branch, self.end_mm)];
        let visits = if self.visits.is_empty() { &only } else { self.visits.as_slice() };
        let (ways, way_of_visit) = match (self.visits.is_empty(), vessel.branches().get(self.branch)) {
            (true, None) => {
                return Err(Error::Setting {
                    name: "insertion.branch".into(),
                    found: self.branch.to_string(),
                    expected: format!("below {}, the number of branches", vessel.branches().len()),
                });
            }
            (true, Some(line)) => (vec![Way::along(self.branch, line)], vec![0]),
            (false, _) => ways(vessel, visits)?,
        };
        let start = State { visit: 0, s_mm: self.start_mm, bend_rad: 0.0, plane_rad: 0.0 };
        let mut path = Path {
            insertion: self,
            ways,
            way_of_visit,
            legs: vec![Leg { until_s: 0.0, to: start, is_recorded: true }],
            min_scale,
            reduced_bends: Vec::new(),
        };
        let mut state = start;
        for (number, visit) in visits.iter().enumerate() {
            let length = vessel.branches()[visit.branch].length_mm();
            let to_mm = visit.to_mm.unwrap_or(length - 5.0);
            let end_mm = match self.visits.is_empty() {
                true => to_mm,
                false => path.way_to(number).station_mm(vessel, visit.branch, to_mm),
            };
            if to_mm > length || self.start_mm > end_mm || (number == 0 && self.start_mm == end_mm) {
                return Err(Error::Setting {
                    name: match self.visits.is_empty() {
                        true => "insertion.end_mm".into(),
                        false => format!("insertion.visits: visit {number}").into(),
                    },
                    found: format!("{:.1} to {end_mm:.1} mm", self.start_mm),
                    expected: format!("a way forward within the branch's {length:.1} mm"),
                });
            }
            if let Some(before) = number.checked_sub(1) {
                let common_mm = path.way_to(before).common_mm(path.way_to(number));
                if common_mm < self.start_mm {
                    return Err(Error::Setting {
                        name: "insertion.start_mm".into(),
                        found: format!("{:.1} mm", self.start_mm),
                        expected: format!(
                            "less than {common_mm:.1} mm, where the way to branch {} parts from the one before",
                            visit.branch
                        ),
                    });
                }
                path.withdraw(&mut state, common_mm.min(end_mm));
                state.visit = number;
                path.go(&mut state, 0.0, true);
            }
            if number == 0 || state.s_mm < end_mm {
                path.advance(vessel, &mut state, end_mm)?;
            }
        }
        Ok(path)
    }
}

impl Path<'_> {
    /// Adds a leg that ends in `state`.
    fn go(&mut self, state: &mut State, duration_s: f64, is_recorded: bool) {
        let until_s = self.end_s() + duration_s;
        self.legs.push(Leg { until_s, to: *state, is_recorded });
    }

    /// Straightens the tip and goes back to `to_mm`, if the catheter is beyond.
    fn withdraw(&mut self, state: &mut State, to_mm: f64) {
        if state.s_mm <= to_mm {
            return;
        }
        let (angle_deg, way) = (state.bend_rad.to_degrees(), state.s_mm - to_mm);
        let recorded = self.insertion.record_withdrawals;
        state.bend_rad = 0.0;
        self.go(state, angle_deg / self.insertion.bend_rate_deg_s, recorded);
        state.s_mm = to_mm;
        self.go(state, way / self.insertion.speed_mm_s, recorded);
    }

    /// Goes forward by the moves.
    fn advance(&mut self, vessel: &SimulatedVessel, state: &mut State, end_mm: f64) -> Result<()> {
        let insertion = self.insertion;
        let mut arrived = false;
        loop {
            for step in &insertion.moves {
                let duration_s = match *step {
                    Move::Advance { distance_mm } => {
                        let to = (state.s_mm + distance_mm).min(end_mm);
                        arrived |= to >= end_mm;
                        let way = to - state.s_mm;
                        state.s_mm = to;
                        way / insertion.speed_mm_s
                    }
                    Move::Withdraw { distance_mm } => {
                        let to = (state.s_mm - distance_mm).max(insertion.start_mm);
                        let way = state.s_mm - to;
                        state.s_mm = to;
                        way / insertion.speed_mm_s
                    }
                    Move::Bend { angle_deg } => {
                        let used_deg = self.largest_bend_deg(vessel, *state, angle_deg);
                        if used_deg < angle_deg {
                            self.reduced_bends.push(ReducedBend {
                                s_mm: state.s_mm,
                                asked_deg: angle_deg,
                                used_deg,
                            });
                        }
                        let way = used_deg - state.bend_rad.to_degrees();
                        state.bend_rad = used_deg.to_radians();
                        way.abs() / insertion.bend_rate_deg_s
                    }
                    Move::Turn { angle_deg } => {
                        state.plane_rad += angle_deg.to_radians();
                        angle_deg.abs() / insertion.turn_rate_deg_s
                    }
                    Move::Rest { duration_s } => duration_s,
                };
                self.go(state, duration_s, true);
            }
            if self.end_s() * insertion.frame_rate_hz > MAX_FRAMES {
                return Err(Error::Setting {
                    name: "insertion.frame_rate_hz".into(),
                    found: format!("more than 10 million frames over {:.0} s", self.end_s()),
                    expected: "a shorter insertion or fewer frames".into(),
                });
            }
            if !insertion.repeat || arrived {
                return Ok(());
            }
        }
    }

    fn end_s(&self) -> f64 {
        self.legs.last().map_or(0.0, |leg| leg.until_s)
    }

    fn way_to(&self, visit: usize) -> &Way {
        &self.ways[self.way_of_visit[visit]]
    }

    /// How often the recorder's clock ticks from the first frame to the last, both counted.
    pub fn ticks(&self) -> usize {
        // A leg that ends on a frame ends there in spite of rounding.
        (self.end_s() * self.insertion.frame_rate_hz + 1e-6).floor() as usize + 1
    }

    /// Whether the recorder records a frame at a tick.
    pub fn is_recorded(&self, tick: usize) -> bool {
        let leg = self.leg(self.time_s(tick)).min(self.legs.len() - 1);
        self.legs[leg].is_recorded
    }

    /// The number of the leg at a time; that of legs after the end.
    fn leg(&self, time_s: f64) -> usize {
        self.legs.partition_point(|leg| leg.until_s <= time_s)
    }

    pub fn time_s(&self, tick: usize) -> f64 {
        tick as f64 / self.insertion.frame_rate_hz
    }

    /// The curve that the catheter follows.
    pub fn line(&self, time_s: f64) -> &Centreline {
        &self.way_to(self.state(time_s).visit).line
    }

    pub fn bending_length_mm(&self) -> f64 {
        self.insertion.bending_length_mm
    }

    /// How far along the curve the tip is, mm, but for its bend.
    pub fn station_mm(&self, time_s: f64) -> f64 {
        self.state(time_s).s_mm
    }

    /// Which branch the catheter is in, and where.
    pub fn place(&self, time_s: f64) -> Place {
        let state = self.state(time_s);
        let (branch, s_mm) = self.way_to(state.visit).place(state.s_mm);
        Place { visit: state.visit, branch, s_mm }
    }

    /// Pose of the tip in the world.
    pub fn tip(&self, time_s: f64) -> Pose {
        self.tip_in(self.state(time_s))
    }

    /// Refuses a tip outside the lumen or nearer to the wall than the clearance.
    pub fn check(&self, vessel: &SimulatedVessel, time_s: f64) -> Result<()> {
        let state = self.state(time_s);
        let Place { branch, s_mm, .. } = self.place(time_s);
        self.wall_too_near(vessel, state, self.insertion.clearance_mm).map_or(Ok(()), |distance_mm| {
            Err(Error::Surface {
                what: format!(
                    "catheter tip at {s_mm:.1} mm of branch {branch}, bent {:.1}°",
                    state.bend_rad.to_degrees()
                ),
                found: match distance_mm {
                    Some(d) => format!("{d:.2} mm from the wall"),
                    None => "outside the lumen".into(),
                },
                expected: format!("inside, at least {} mm from the wall", self.insertion.clearance_mm),
            })
        })
    }

    fn state(&self, time_s: f64) -> State {
        let next = self.leg(time_s);
        match (next.checked_sub(1).map(|i| self.legs[i]), self.legs.get(next)) {
            (Some(Leg { until_s: t0, to: from, .. }), Some(&Leg { until_s: t1, to, .. })) => {
                let u = (time_s - t0) / (t1 - t0);
                let mix = |a: f64, b: f64| a + (b - a) * u;
                State {
                    // A leg lies within one visit: the next one begins with a leg that takes no time.
                    visit: from.visit,
                    s_mm: mix(from.s_mm, to.s_mm),
                    bend_rad: mix(from.bend_rad, to.bend_rad),
                    plane_rad: mix(from.plane_rad, to.plane_rad),
                }
            }
            (Some(last), None) => last.to,
            (None, _) => self.legs[0].to,
        }
    }

    fn tip_in(&self, state: State) -> Pose {
        let line = &self.way_to(state.visit).line;
        let tip = line.frame(state.s_mm);
        if state.bend_rad == 0.0 {
            return tip;
        }
        let length = self.insertion.bending_length_mm;
        let axis = DVec3::new(-state.plane_rad.sin(), state.plane_rad.cos(), 0.0);
        let half_turn = Pose {
            rotation: DMat3::from_quat(DQuat::from_axis_angle(axis, 0.5 * state.bend_rad / BENDING_STEPS)),
            translation_mm: DVec3::ZERO,
        };
        let mut along = line.frame(state.s_mm - length);
        let mut bent = along;
        for i in 1..=BENDING_STEPS as usize {
            let next = line.frame(state.s_mm - length * (1.0 - i as f64 / BENDING_STEPS));
            bent = bent * half_turn * (along.inverse() * next) * half_turn;
            along = next;
        }
        bent
    }

    /// `None`: the tip keeps `clearance_mm` from the wall. Else how near the wall is, or nothing where it was
    /// passed.
    fn wall_too_near(
        &self,
        vessel: &SimulatedVessel,
        state: State,
        clearance_mm: f64,
    ) -> Option<Option<f64>> {
        let middle = self.way_to(state.visit).line.at(state.s_mm).0;
        // In a smaller vessel the tip is further out: enlarging its way from the middle has the same effect.
        let tip = middle + (self.tip_in(state).translation_mm - middle) / self.min_scale;
        if vessel.wall_between(middle, tip) {
            return Some(None);
        }
        let distance_mm = vessel.distance_mm(tip) * self.min_scale;
        (distance_mm < clearance_mm).then_some(Some(distance_mm))
    }

    /// The largest angle up to `asked_deg` that keeps its clearance in every plane.
    fn largest_bend_deg(&self, vessel: &SimulatedVessel, state: State, asked_deg: f64) -> f64 {
        // Halfway between two of the planes that are tried, the tip is so far from both of its neighbours at
        // most; the wall can be nearer by no more than that.
        let between_mm = |angle_deg: f64| {
            self.insertion.bending_length_mm * angle_deg.to_radians() * 0.5 * TAU / f64::from(PLANES) * 0.5
        };
        let clear = |angle_deg: f64| {
            (0..PLANES).all(|i| {
                let plane_rad = f64::from(i) / f64::from(PLANES) * TAU;
                BENDING_STAGES.iter().all(|stage| {
                    let angle_deg = stage * angle_deg;
                    let bent = State { bend_rad: angle_deg.to_radians(), plane_rad, ..state };
                    let clearance_mm = self.insertion.clearance_mm + between_mm(angle_deg);
                    self.wall_too_near(vessel, bent, clearance_mm).is_none()
                })
            })
        };
        if clear(asked_deg) {
            return asked_deg;
        }
        let (mut low, mut high) = (0, (asked_deg * 10.0).ceil() as u32);
        while low + 1 < high {
            let middle = low + (high - low) / 2;
            *(if clear(f64::from(middle) / 10.0) { &mut low } else { &mut high }) = middle;
        }
        f64::from(low) / 10.0
    }
}

/// The longest recording.
const MAX_FRAMES: f64 = 1e7;

/// Straight pieces that stand for the bending segment; 1/64 of 90° differs from an arc by 2e-4 of its length.
const BENDING_STEPS: f64 = 32.0;

/// Planes in which a bend is tried.
const PLANES: u32 = 180;

/// Parts of the whole angle that the tip passes through and that are tried.
const BENDING_STAGES: [f64; 4] = [1.0, 0.75, 0.5, 0.25];
