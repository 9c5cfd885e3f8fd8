//! The echoes between two rings, as many as are worth keeping, and their sums.

use super::median::Median;
use crate::sweep::prepare::axis::Axis;
use crate::sweep::support::Tally;
use crate::sweep::wall::HUBER;
use crate::sweep::wall::echo::{Echo, Held, gate};
use crate::sweep::wall::grid::{Corners, Equations, Grid};
use glam::DVec3;
use std::f64::consts::TAU;
use std::ops::Range;

/// Echoes that are kept apart above a face of the grid; more are merged.
const MOST_PER_CELL: usize = 40;

/// An echo, or several that were merged into one.
#[derive(Debug, Clone)]
pub(super) struct Sample {
    pub echo: Echo,
    pub point_mm: DVec3,
    /// The image plane's normal in the world.
    pub image_normal: DVec3,
    /// How many echoes it stands for.
    pub weight: f64,
    /// Their weighted squared misses about their mean, mm².
    pub scatter_mm2: f64,
    /// Where its miss is counted among all.
    pub bin: Option<u16>,
    /// Whether it stands for several: their misses stay counted as they were when they came.
    pub is_merged: bool,
}

/// What a sample says about the wall.
struct Said {
    corners: Corners,
    /// Zero where it lies off the wall.
    weight: f64,
    /// How far it is trusted: 1 near the wall, 0 off it.
    robust: f64,
    value_mm: f64,
    on_wall: bool,
}

impl Sample {
    /// Finds its foot, and from there once more: the wall is not flat.
    fn find_foot(&mut self, held: Held) {
        for _ in 0..2 {
            self.echo.measure(held, true);
        }
    }

    fn say(&mut self, held: Held, rough: bool) -> Said {
        let Held { grid, noise_mm, .. } = held;
        if rough {
            let measured = self.echo.measure_straight();
            let (ring, node) = self.echo.foot();
            let (weight, value_mm) = (self.weight * measured.weight, measured.wall_mm);
            return Said { corners: grid.corners(ring, node), weight, robust: 1.0, value_mm, on_wall: true };
        }
        let (ring, node) = self.echo.foot();
        let measured = self.echo.measure(held, true);
        let miss = self.echo.miss_mm.abs();
        let on_wall = miss <= gate(noise_mm, measured.wall_mm);
        // Also of merged ones: what they have in common is where noise put them, not that they are the wall's.
        let robust = (HUBER * noise_mm / miss.max(f64::MIN_POSITIVE)).min(1.0);
        let robust = if on_wall { robust } else { 0.0 };
        let weight = robust * measured.weight * self.weight;
        let value_mm = measured.wall_mm + measured.radial_mm;
        Said { corners: grid.corners(ring, node), weight, robust, value_mm, on_wall }
    }

    /// Counts its miss among all, and no longer the one before.
    fn count(&mut self, misses: &mut Median) {
        if !self.is_merged {
            if let Some(bin) = self.bin {
                misses.take(bin);
            }
            self.bin = Some(misses.add(self.echo.miss_mm.abs()));
        }
    }
}

/// The echoes between two rings.
#[derive(Debug, Clone)]
pub(super) struct Level {
    cells: Vec<Vec<Sample>>,
    /// How many echoes came, kept apart or not.
    pub count: usize,
    /// How many are kept.
    pub kept: usize,
    /// Rings that the sums cover: those about the feet.
    pub rings: Range<usize>,
    pub equations: Equations,
    pub tally: Tally,
    /// Farthest that a node here has travelled since the echoes were measured, mm.
    pub travel_mm: f64,
    /// When the last echo came, s.
    pub latest_s: f64,
    /// Whether the echoes have looked for their feet.
    has_feet: bool,
}

impl Level {
    pub fn new(grid: &Grid, level: usize) -> Self {
        Self {
            cells: vec![Vec::new(); grid.nodes],
            count: 0,
            kept: 0,
            rings: level..level,
            equations: Equations::over(grid, level..level),
            tally: Tally::new(0),
            travel_mm: 0.0,
            latest_s: f64::NEG_INFINITY,
            has_feet: false,
        }
    }

    /// Whether there are too few echoes yet to know where the wall is.
    fn is_rough(&self) -> bool {
        self.count < self.cells.len()
    }

    /// Counts rings from one that lies `rings` before.
    pub fn renumber(&mut self, rings: usize) {
        self.rings = self.rings.start + rings..self.rings.end + rings;
        self.equations.renumber(rings * self.cells.len());
        self.samples().for_each(|sample| sample.echo.renumber(rings));
    }

    fn samples(&mut self) -> impl Iterator<Item = &mut Sample> {
        self.cells.iter_mut().flatten()
    }

    /// Takes all echoes out.
    pub fn drain(&mut self, grid: &Grid, level: usize) -> Vec<Sample> {
        let samples = self.cells.iter_mut().flat_map(std::mem::take).collect();
        let (latest_s, has_feet) = (self.latest_s, self.has_feet);
        *self = Self { latest_s, has_feet, ..Self::new(grid, level) };
        samples
    }

    /// Makes what is there older: its weights shrink by `factor`.
    pub fn age(&mut self, factor: f64) {
        for sample in self.samples() {
            sample.weight *= factor;
            sample.scatter_mm2 *= factor;
        }
        self.equations.scale(factor);
        self.tally.scale(factor);
    }

    /// Adds a sample that has been placed here. Where its cell is full, it is merged with the one that was seen from the
    /// most similar direction.
    ///
    /// Where its foot is along the axis, and whether it lies on the wall.
    pub fn insert(
        &mut self,
        mut sample: Sample,
        held: Held,
        axis: &Axis,
        misses: &mut Median,
        new: bool,
    ) -> (f64, bool) {
        let was_rough = self.is_rough();
        self.count += 1;
        let rough = self.is_rough();
        if was_rough && !rough {
            // From now on there is a wall to hold all of them against.
            self.travel_mm = f64::INFINITY;
        }
        if new && !rough {
            sample.find_foot(held);
        }
        let said = sample.say(held, rough);
        if !rough {
            sample.count(misses);
        }
        let foot = sample.echo.foot().0;
        self.add(&sample, &said, held.grid);
        self.keep(sample, &said, held, axis);
        (foot, said.on_wall)
    }

    /// Adds to the sums.
    fn add(&mut self, sample: &Sample, said: &Said, grid: &Grid) {
        let level = said.corners.nodes.into_iter().min().unwrap_or(0) / grid.nodes;
        self.cover(level..level + 2, grid);
        if said.weight > 0.0 {
            self.equations.add(&said.corners, said.weight, said.value_mm);
        }
        let miss = sample.echo.miss_mm;
        let squares_mm2 = sample.scatter_mm2 + sample.weight * miss * miss;
        let node = said.corners.nearest() - self.rings.start * grid.nodes;
        self.tally.add(node, said.on_wall, sample.weight, squares_mm2, sample.echo.frame);
    }

    /// Widens the sums to rings.
    fn cover(&mut self, rings: Range<usize>, grid: &Grid) {
        if self.rings.is_empty() {
            self.rings = rings;
            self.equations = Equations::over(grid, self.rings.clone());
            self.tally = Tally::new(self.rings.len() * grid.nodes);
        } else if rings.start < self.rings.start || rings.end > self.rings.end {
            let wider = rings.start.min(self.rings.start)..rings.end.max(self.rings.end);
            let mut equations = Equations::over(grid, wider.clone());
            equations.merge(&self.equations);
            let mut tally = Tally::new(wider.len() * grid.nodes);
            tally.merge((self.rings.start - wider.start) * grid.nodes, &self.tally, 0);
            (self.rings, self.equations, self.tally) = (wider, equations, tally);
        }
    }

    fn keep(&mut self, sample: Sample, said: &Said, held: Held, axis: &Axis) {
        let node = (sample.echo.place().1 as usize).min(self.cells.len() - 1);
        let cell = &mut self.cells[node];
        if cell.len() < MOST_PER_CELL {
            cell.push(sample);
            self.kept += 1;
            return;
        }
        let is_on_wall = |other: &Sample| other.echo.is_inlier(held.noise_mm);
        if !said.on_wall {
            // Off the wall, the newest say as much as the oldest.
            if let Some(oldest) = cell.iter().position(|other| !is_on_wall(other)) {
                cell.remove(oldest);
                cell.push(sample);
            }
            return;
        }
        let likeness = |other: &Sample| other.image_normal.dot(sample.image_normal).abs();
        let partner = (0..cell.len())
            .filter(|&k| is_on_wall(&cell[k]))
            .max_by(|&a, &b| likeness(&cell[a]).total_cmp(&likeness(&cell[b])));
        match partner {
            Some(partner) => {
                if let Some(merged) = merged(&cell[partner], &sample, said.robust, held.grid, axis) {
                    cell[partner] = merged;
                }
            }
            None => cell[0] = sample,
        }
    }

    /// Measures all echoes anew and draws up their sums.
    pub fn measure(&mut self, held: Held, misses: &mut Median, rough: bool) {
        let rough = rough || self.is_rough();
        let mut cells = std::mem::take(&mut self.cells);
        let first_feet = !rough && !std::mem::replace(&mut self.has_feet, !rough);
        let empty = self.rings.start..self.rings.start;
        (self.rings, self.tally) = (empty, Tally::new(0));
        for sample in cells.iter_mut().flatten() {
            if first_feet {
                sample.find_foot(held);
            }
            let said = sample.say(held, rough);
            if !rough {
                sample.count(misses);
            }
            self.add(sample, &said, held.grid);
        }
        self.cells = cells;
        self.travel_mm = 0.0;
    }
}

/// One sample for two of a cell; `share` is how far the second is trusted. `None` where their mean has no place.
fn merged(a: &Sample, b: &Sample, share: f64, grid: &Grid, axis: &Axis) -> Option<Sample> {
    let added = b.weight * share;
    let weight = a.weight + added;
    let t = added / weight;
    let ((ring_a, node_a), (ring_b, node_b)) = (a.echo.place(), b.echo.place());
    let (ring, node) = (ring_a + (ring_b - ring_a) * t, node_a + (node_b - node_a) * t);
    let radius_mm = a.echo.radius_mm + (b.echo.radius_mm - a.echo.radius_mm) * t;
    let point_mm = axis.point_between_mm(ring, TAU * node / grid.nodes as f64, radius_mm);
    let other = if a.image_normal.dot(b.image_normal) < 0.0 { -b.image_normal } else { b.image_normal };
    let image_normal = a.image_normal.lerp(other, t).try_normalize()?;
    let place = axis.place(point_mm, ring as usize)?;
    let apart = a.echo.miss_mm - b.echo.miss_mm;
    let mut echo = Echo::new(&place, image_normal, a.echo.frame.max(b.echo.frame), grid.nodes);
    echo.keep_foot_of(&a.echo);
    let scatter_mm2 = a.scatter_mm2 + b.scatter_mm2 + a.weight * t * apart * apart;
    Some(Sample { echo, point_mm, image_normal, weight, scatter_mm2, bin: None, is_merged: true })
}
