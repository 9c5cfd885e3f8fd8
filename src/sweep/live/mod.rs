//! The sweep while the recording goes on: every frame changes the wall about it, in bounded time.
//!
//! Instead of all echoes at once, it fits a window of rings about the newest echoes, and a background window that moves
//! along the vessel to bring earlier results to the current noise and smoothness. Within a window, residuals are evaluated
//! again where the wall has moved most since (as iSAM2 relinearises: Kaess et al., IJRR 31(2), 2012), and the wall is
//! solved for with all rings outside fixed. A branch that the catheter enters has a wall of its own from then on; every
//! frame goes to one wall. See `docs/method.md`, "Live".

mod band;
mod curve;
mod running_median;
mod shared;
mod vessel;
mod wall;

use super::prepare::contour::{MAX_FOLDED, Outline};
use crate::Result;
use crate::recording::{FRAME_INTERVAL_S, Frame};
use crate::settings::{Branches, Settings};
use crate::surface::Surface;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::ops::Range;
use vessel::PlacedFrame;
pub(crate) use vessel::Step;
use wall::LiveWall;

/// Frames whose centres lie within this share of the lumen about the wall that a branch leaves belong to that wall.
const WITHIN_PARENT: f64 = 0.75;
/// A frame belongs to a branch that was entered but has no wall yet where it lies this near to one of the branch's frames, in
/// lumen radii.
const STRIDE_RADII: f64 = 2.0;
/// Branches that were entered and have no wall yet; of more, the oldest is forgotten.
const MAX_ENTERED: usize = 8;

/// A vessel swept along the centrelines of its branches while the recording goes on.
#[derive(Serialize, Deserialize)]
pub(crate) struct LiveSweep {
    #[serde(skip)]
    settings: Settings,
    frames: usize,
    clock_s: f64,
    /// When the frames were taken, by their numbers; `None` for those that are left out.
    times_s: Vec<Option<f64>>,
    /// The wall that was seen first, and those of branches, in the order in which they were found.
    walls: Vec<LiveWall>,
    /// Branches that were entered and are too short for a wall yet, the oldest first.
    entered: Vec<LiveWall>,
}

/// Where a frame belongs.
enum Place {
    Wall(usize),
    Entered(usize),
    New,
}

impl LiveSweep {
    pub fn new(settings: &Settings) -> Self {
        let first = LiveWall::new(None);
        Self {
            settings: settings.clone(),
            frames: 0,
            clock_s: 0.0,
            times_s: Vec::new(),
            walls: vec![first],
            entered: Vec::new(),
        }
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        *self = Self::new(&self.settings);
    }

    /// Goes on with a state that was read from a file; what follows it there. `None` where it is not sound, or of other
    /// settings: then nothing changes.
    pub fn go_on<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let (state, rest) = postcard::take_from_bytes::<Self>(bytes).ok()?;
        state
            .is_sound(&self.settings)
            .then(|| *self = Self { settings: std::mem::take(&mut self.settings), ..state })?;
        Some(rest)
    }

    /// Whether this state, read from a file, may be used without a look at each index and number again.
    fn is_sound(&self, settings: &Settings) -> bool {
        let Some(first) = self.walls.first() else { return false };
        self.clock_s.is_finite()
            && self.times_s.iter().flatten().all(|time_s| time_s.is_finite())
            && self.entered.len() <= MAX_ENTERED
            && self.walls.iter().enumerate().all(|(k, wall)| {
                wall.is_sound(settings)
                    && (k == 0 || wall.has_begun())
                    && (!wall.has_begun() || wall.nodes() == first.nodes())
                    && wall.parent.is_some() == (k > 0)
                    && wall.parent.is_none_or(|parent| parent < k)
            })
            && self.entered.iter().all(|wall| {
                wall.is_sound(settings)
                    && !wall.has_begun()
                    && wall.parent.is_some_and(|parent| parent < self.walls.len())
            })
    }

    /// Adds a frame that passes [`Frame::check`]; its number is higher than those before.
    pub fn push(&mut self, number: usize, frame: &Frame) -> Result<Step> {
        let after = self.clock_s + if self.frames == 0 { 0.0 } else { FRAME_INTERVAL_S };
        self.clock_s = frame.time_s.unwrap_or(after);
        self.times_s.resize(number + 1, None);
        self.times_s[number] = Some(self.clock_s);
        let world_from_probe = frame.world_from_sensor * self.settings.calibration.sensor_from_probe();
        let mut placed = PlacedFrame {
            number: number as u32,
            time_s: self.clock_s,
            world_from_probe,
            frame: frame.clone(),
            outline: Outline::of(frame),
        };
        if placed.outline.is_some_and(|outline| outline.folded_share > MAX_FOLDED) {
            // Not star-shaped about its centre.
            placed.frame.contour_mm.clear();
            placed.outline = None;
        }
        self.frames += 1;
        let nodes = self.walls[0].has_begun().then(|| self.nodes());
        match self.place_of(&placed) {
            Place::Wall(k) => {
                let step = self.walls[k].push(placed, nodes, &self.settings)?;
                Ok(self.in_all(k, step))
            }
            Place::Entered(k) => self.enter(k, placed, nodes),
            Place::New => {
                if self.entered.len() == MAX_ENTERED {
                    self.entered.remove(0);
                }
                self.entered.push(LiveWall::new(placed.centre_mm().map(|centre| self.nearest_wall(centre))));
                self.enter(self.entered.len() - 1, placed, nodes)
            }
        }
    }

    /// The wall about which a point lies best, in the radii there.
    fn nearest_wall(&self, point_mm: DVec3) -> usize {
        let away = |wall: &LiveWall| wall.about(point_mm).map_or(f64::INFINITY, |about| about.radii_away);
        let away: Vec<f64> = self.walls.iter().map(away).collect();
        (0..away.len()).fold(0, |best, k| if away[k] < away[best] { k } else { best })
    }

    /// Where a frame belongs: to the wall about it, or to that which this one leaves as long as it is well within its lumen.
    /// Outside of all lumens it lengthens a wall at its ends, and lies in another branch elsewhere.
    fn place_of(&self, frame: &PlacedFrame) -> Place {
        let Some(centre_mm) = frame.centre_mm() else {
            return Place::Wall(frame.echo_mm().map_or(0, |echo| self.nearest_wall(echo)));
        };
        if !self.walls[0].has_begun() || self.settings.branches == Branches::Off {
            return Place::Wall(0);
        }
        let mut own = self.nearest_wall(centre_mm);
        let Some(about) = self.walls[own].about(centre_mm) else { return Place::Wall(0) };
        if about.radii_away > 1.0 {
            let radius_mm = frame.outline.map_or(0.0, |outline| outline.radius_mm);
            let near = |wall: &LiveWall| wall.has_waiting_near(centre_mm, STRIDE_RADII * radius_mm);
            return match self.entered.iter().position(near) {
                Some(k) => Place::Entered(k),
                None if about.is_at_end => Place::Wall(own),
                None => Place::New,
            };
        }
        while let Some(parent) = self.walls[own].parent {
            let within = self.walls[parent].about(centre_mm).is_some_and(|p| p.radii_away < WITHIN_PARENT);
            if !within {
                break;
            }
            own = parent;
        }
        Place::Wall(own)
    }

    /// Adds a frame to a branch that was entered, which becomes a wall once it is long enough and lies outside the others.
    fn enter(&mut self, k: usize, frame: PlacedFrame, nodes: Option<usize>) -> Result<Step> {
        let outside = frame.centre_mm().zip(frame.outline).map_or(0.0, |(centre_mm, outline)| {
            let outside_mm = |wall: &LiveWall| wall.about(centre_mm).map_or(0.0, |about| about.outside_mm);
            self.walls.iter().map(outside_mm).fold(f64::INFINITY, f64::min) / outline.radius_mm
        });
        let wall = &mut self.entered[k];
        wall.depth_radii = wall.depth_radii.max(outside);
        let step = wall.push(frame, nodes, &self.settings)?;
        if !wall.has_begun() {
            return Ok(Step { off_axis: true, ..step });
        }
        let wall = self.entered.remove(k);
        self.walls.push(wall);
        Ok(self.in_all(self.walls.len() - 1, step))
    }

    /// A step of one wall with rings numbered through all walls. A wall that grew moves the numbers of the rings behind it:
    /// these count as changed.
    fn in_all(&self, k: usize, step: Step) -> Step {
        let offset: usize = self.walls[..k].iter().map(LiveWall::rings).sum();
        let in_all = |range: Range<usize>| range.start + offset..range.end + offset;
        let mut changed: Vec<Range<usize>> = step.changed.iter().cloned().map(in_all).collect();
        let all = self.rings();
        if k > 0 && step.before > 0 {
            changed.push(offset..all);
        } else if step.before + step.behind > 0 {
            changed.push(offset + self.walls[k].rings()..all);
        }
        if self.walls.len() > 1 {
            changed.extend(step.changed.iter().flat_map(|range| self.rings_beside(k, range)));
        }
        Step { before: if k == 0 { step.before } else { 0 }, changed, ..step }
    }

    /// The rings of other walls that lie within reach of some rings of one: whether these are hidden by it may have changed.
    fn rings_beside(&self, k: usize, rings: &Range<usize>) -> Vec<Range<usize>> {
        let mut offset = 0;
        let mut beside = Vec::new();
        for (other, wall) in self.walls.iter().enumerate() {
            if other != k
                && let Some(range) = wall.rings_within(&self.walls[k], rings)
            {
                beside.push(range.start + offset..range.end + offset);
            }
            offset += wall.rings();
        }
        beside
    }

    /// Forgets the echoes of some frames, and fits the walls about them again.
    pub fn forget(&mut self, numbers: impl Iterator<Item = usize>) -> Result<Step> {
        let frames: BTreeSet<u32> = numbers.map(|number| number as u32).collect();
        let first = frames.first().and_then(|first| *self.times_s.get(*first as usize)?);
        let since_s = first.unwrap_or(f64::NEG_INFINITY);
        self.entered.iter_mut().for_each(|wall| wall.forget_waiting(&frames));
        let mut all = Step::default();
        for k in 0..self.walls.len() {
            let step = self.walls[k].forget(&frames, since_s)?;
            let step = self.in_all(k, step);
            all.add(step);
        }
        Ok(all)
    }

    /// Adds what still waits for its wall, and fits all walls. After the last frame: it takes longer than a frame may. Frames
    /// of branches that never became long enough for a wall are not used: they lie outside of all lumens.
    pub fn flush(&mut self) -> Result<Step> {
        self.entered.clear();
        let mut all = Step::default();
        for k in 0..self.walls.len() {
            let step = self.walls[k].flush(&self.times_s, &self.settings)?;
            let step = self.in_all(k, step);
            all.add(step);
        }
        Ok(all)
    }

    /// Number of rings of all walls.
    pub fn rings(&self) -> usize {
        self.walls.iter().map(LiveWall::rings).sum()
    }

    /// Nodes per ring.
    pub fn nodes(&self) -> usize {
        self.walls[0].nodes()
    }

    /// Number of walls: the first, and one for each branch that the catheter entered.
    pub fn branches(&self) -> usize {
        self.walls.len()
    }

    /// Some rings as a surface, each wall by itself. What lies within the lumen of another wall is not supported.
    pub fn surface(&self, rings: Range<usize>, keep_unsupported: bool) -> Surface {
        let mut whole = Surface::default();
        let mut offset = 0;
        for (k, wall) in self.walls.iter().enumerate() {
            let end = offset + wall.rings();
            let own = rings.start.clamp(offset, end) - offset..rings.end.clamp(offset, end) - offset;
            offset = end;
            if own.is_empty() {
                continue;
            }
            let others: Vec<(&LiveWall, bool)> = self
                .walls
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != k)
                .map(|(other, wall)| (wall, other < k))
                .collect();
            let mut part = wall.surface(own, &others, keep_unsupported);
            part.set_array("branch", vec![k as f64; part.nodes_mm.len()]);
            whole.append(part);
        }
        whole
    }
}
