//! Motion of the catheter.

use super::centreline::Centreline;
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

/// A catheter and its motion through one branch of a vessel.
///
/// The catheter follows the centreline. Its bending segment, just before the tip, adds a constant curvature to
/// the centreline's own, in a plane that is fixed in the rotation-minimising frame; so a bent tip in a straight
/// vessel is an arc of a circle, and an unbent tip lies on the centreline. Sensor and probe sit at the tip: x and
/// y across the catheter, z along it.
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
    /// The moves, in order.
    pub moves: Vec<Move>,
    /// Whether the moves are repeated until the tip has reached the end of the insertion.
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
    /// Smallest distance of the tip from the wall, mm. A bend that would bring it nearer, in any plane, is reduced.
    pub clearance_mm: f64,
}

setters!(Insertion {
    with_branch => branch: usize,
    with_start_mm => start_mm: f64,
    with_end_mm => end_mm: Option<f64>,
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
    /// through a full circle, the tip straightened, again along the whole vessel; 12 frames a second. The thesis
    /// leaves the speed of the turn and the bending segment open: 24°/s and 15 mm here.
    fn default() -> Self {
        Self {
            branch: 0,
            start_mm: 5.0,
            end_mm: None,
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
    s_mm: f64,
    bend_rad: f64,
    plane_rad: f64,
}

/// The moves over time.
#[derive(Debug)]
pub(super) struct Path<'a> {
    insertion: &'a Insertion,
    centreline: &'a Centreline,
    /// When each leg starts, what it starts from; the last entry ends the last leg.
    legs: Vec<(f64, State)>,
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

    /// Plans the moves through a vessel that shrinks to `min_scale` of its size at times. The settings are taken
    /// to be valid.
    pub(super) fn plan<'a>(&'a self, vessel: &'a SimulatedVessel, min_scale: f64) -> Result<Path<'a>> {
        let Some(centreline) = vessel.branches().get(self.branch) else {
            return Err(Error::Setting {
                name: "insertion.branch".into(),
                found: self.branch.to_string(),
                expected: format!("below {}, the number of branches", vessel.branches().len()),
            });
        };
        let length = centreline.length_mm();
        let end_mm = self.end_in_mm(length);
        if end_mm > length || self.start_mm >= end_mm {
            return Err(Error::Setting {
                name: "insertion.end_mm".into(),
                found: format!("{:.1} to {end_mm:.1} mm", self.start_mm),
                expected: format!("a way forward within the branch's {length:.1} mm"),
            });
        }
        let start = State { s_mm: self.start_mm, bend_rad: 0.0, plane_rad: 0.0 };
        let mut path = Path {
            insertion: self,
            centreline,
            legs: vec![(0.0, start)],
            min_scale,
            reduced_bends: Vec::new(),
        };
        let (mut state, mut time_s, mut arrived) = (start, 0.0, false);
        loop {
            for step in &self.moves {
                let duration_s = match *step {
                    Move::Advance { distance_mm } => {
                        let to = (state.s_mm + distance_mm).min(end_mm);
                        arrived |= to >= end_mm;
                        let way = to - state.s_mm;
                        state.s_mm = to;
                        way / self.speed_mm_s
                    }
                    Move::Withdraw { distance_mm } => {
                        let to = (state.s_mm - distance_mm).max(self.start_mm);
                        let way = state.s_mm - to;
                        state.s_mm = to;
                        way / self.speed_mm_s
                    }
                    Move::Bend { angle_deg } => {
                        let used_deg = path.largest_bend_deg(vessel, state, angle_deg);
                        if used_deg < angle_deg {
                            path.reduced_bends.push(ReducedBend {
                                s_mm: state.s_mm,
                                asked_deg: angle_deg,
                                used_deg,
                            });
                        }
                        let way = used_deg - state.bend_rad.to_degrees();
                        state.bend_rad = used_deg.to_radians();
                        way.abs() / self.bend_rate_deg_s
                    }
                    Move::Turn { angle_deg } => {
                        state.plane_rad += angle_deg.to_radians();
                        angle_deg.abs() / self.turn_rate_deg_s
                    }
                    Move::Rest { duration_s } => duration_s,
                };
                time_s += duration_s;
                path.legs.push((time_s, state));
            }
            if time_s * self.frame_rate_hz > 1e7 {
                return Err(Error::Setting {
                    name: "insertion.frame_rate_hz".into(),
                    found: format!("more than 10 million frames over {time_s:.0} s"),
                    expected: "a shorter insertion or fewer frames".into(),
                });
            }
            if !self.repeat || arrived {
                return Ok(path);
            }
        }
    }
}

impl Path<'_> {
    pub fn frames(&self) -> usize {
        let duration_s = self.legs.last().map_or(0.0, |leg| leg.0);
        // A leg that ends on a frame ends there in spite of rounding.
        (duration_s * self.insertion.frame_rate_hz + 1e-6).floor() as usize + 1
    }

    pub fn time_s(&self, frame: usize) -> f64 {
        frame as f64 / self.insertion.frame_rate_hz
    }

    pub fn centreline(&self) -> &Centreline {
        self.centreline
    }

    pub fn bending_length_mm(&self) -> f64 {
        self.insertion.bending_length_mm
    }

    /// How far along the centreline the tip is, mm, but for its bend.
    pub fn station_mm(&self, time_s: f64) -> f64 {
        self.state(time_s).s_mm
    }

    /// Pose of the tip in the world.
    pub fn tip(&self, time_s: f64) -> Pose {
        self.tip_in(self.state(time_s))
    }

    /// Refuses a tip outside the lumen or nearer to the wall than the clearance.
    pub fn check(&self, vessel: &SimulatedVessel, time_s: f64) -> Result<()> {
        let state = self.state(time_s);
        self.wall_too_near(vessel, state, self.insertion.clearance_mm).map_or(Ok(()), |distance_mm| {
            Err(Error::Surface {
                what: format!(
                    "catheter tip at {:.1} mm of the branch, bent {:.1}°",
                    state.s_mm,
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
        let next = self.legs.partition_point(|leg| leg.0 <= time_s);
        match (next.checked_sub(1).map(|i| self.legs[i]), self.legs.get(next)) {
            (Some((t0, from)), Some(&(t1, to))) => {
                let u = (time_s - t0) / (t1 - t0);
                let mix = |a: f64, b: f64| a + (b - a) * u;
                State {
                    s_mm: mix(from.s_mm, to.s_mm),
                    bend_rad: mix(from.bend_rad, to.bend_rad),
                    plane_rad: mix(from.plane_rad, to.plane_rad),
                }
            }
            (Some((_, last)), None) => last,
            (None, _) => self.legs[0].1,
        }
    }

    fn tip_in(&self, state: State) -> Pose {
        let tip = self.centreline.frame(state.s_mm);
        if state.bend_rad == 0.0 {
            return tip;
        }
        let length = self.insertion.bending_length_mm;
        let axis = DVec3::new(-state.plane_rad.sin(), state.plane_rad.cos(), 0.0);
        let half_turn = Pose {
            rotation: DMat3::from_quat(DQuat::from_axis_angle(axis, 0.5 * state.bend_rad / BENDING_STEPS)),
            translation_mm: DVec3::ZERO,
        };
        let mut along = self.centreline.frame(state.s_mm - length);
        let mut bent = along;
        for i in 1..=BENDING_STEPS as usize {
            let next = self.centreline.frame(state.s_mm - length * (1.0 - i as f64 / BENDING_STEPS));
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
        let middle = self.centreline.at(state.s_mm).0;
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
        // Halfway between two of the planes that are tried, the tip is so far from both of its neighbours at most;
        // the wall can be nearer by no more than that.
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

/// Straight pieces that stand for the bending segment; 1/64 of 90° differs from an arc by 2e-4 of its length.
const BENDING_STEPS: f64 = 32.0;

/// Planes in which a bend is tried.
const PLANES: u32 = 180;

/// Parts of the whole angle that the tip passes through and that are tried.
const BENDING_STAGES: [f64; 4] = [1.0, 0.75, 0.5, 0.25];
