//! The echoes between two rings, at most a fixed number of them, and their sums.

use super::running_median::RunningMedian;
use crate::numerics::robust::huber_weight;
use crate::sweep::prepare::axis::Axis;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::{Corners, WallGrid};
use crate::sweep::support::Tally;
use crate::sweep::wall::equations::Equations;
use crate::sweep::wall::residual::{ResidualModel, gate, is_inlier, measure_on_tube};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::ops::Range;

/// Largest number of echoes kept in a cell of the grid; more are merged.
const MAX_PER_CELL: usize = 40;

/// An echo, or several that were merged into one.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Sample {
    pub echo: Echo,
    pub point_mm: DVec3,
    /// The image plane's normal in the world.
    pub image_normal: DVec3,
    /// Number of echoes that it represents, less for old ones.
    pub weight: f64,
    /// Their weighted squared residuals about their mean, mm².
    pub scatter_mm2: f64,
    /// The bin of its residual in the running median of all.
    pub bin: Option<u16>,
    /// Whether it represents several echoes: their residuals stay in the median as they were when they arrived.
    pub is_merged: bool,
}

/// The equation of a sample for the wall.
struct BandEquation {
    corners: Corners,
    /// 0 off the wall.
    weight: f64,
    /// The robust part of the weight: 1 near the wall, 0 off it.
    robust: f64,
    value_mm: f64,
    on_wall: bool,
}

impl Sample {
    /// Projects it onto the wall in two steps, since the wall is not flat.
    fn project(&mut self, model: ResidualModel) {
        for _ in 0..2 {
            model.measure(&mut self.echo, true);
        }
    }

    /// The cell of its band that it lies in.
    fn cell(&self, nodes: usize) -> usize {
        (self.echo.node as usize).min(nodes - 1)
    }

    /// Finds its coordinates about an axis that moved, and its band; the search starts at ring `near`. `None` where it
    /// lies beyond the axis's ends.
    fn place_again(&mut self, axis: &Axis, near: usize, nodes: usize) -> Option<usize> {
        let place = axis.place(self.point_mm, near)?;
        let before = self.echo;
        self.echo = Echo::new(&place, self.image_normal, before.frame, nodes);
        self.echo.keep_projection_of(&before);
        Some(place.ring as usize)
    }

    fn equation(&mut self, model: ResidualModel, warm_up: bool) -> BandEquation {
        let ResidualModel { grid, noise_mm, .. } = model;
        if warm_up {
            let measured = measure_on_tube(&mut self.echo);
            let (ring, node) = self.echo.projection();
            let (weight, value_mm) = (self.weight * measured.weight, measured.wall_mm);
            let corners = grid.corners(ring, node);
            return BandEquation { corners, weight, robust: 1.0, value_mm, on_wall: true };
        }
        let (ring, node) = self.echo.projection();
        let measured = model.measure(&mut self.echo, true);
        let residual = self.echo.residual_mm.abs();
        let on_wall = residual <= gate(noise_mm, measured.wall_mm);
        // Merged echoes too: they are alike in their noise, which does not make them more likely to be the wall's.
        let robust = if on_wall { huber_weight(noise_mm, residual) } else { 0.0 };
        let weight = robust * measured.weight * self.weight;
        let value_mm = measured.wall_mm + measured.radial_mm;
        BandEquation { corners: grid.corners(ring, node), weight, robust, value_mm, on_wall }
    }

    /// Replaces its residual in the running median of all.
    fn count(&mut self, residuals: &mut RunningMedian) {
        if !self.is_merged {
            if let Some(bin) = self.bin {
                residuals.remove(bin);
            }
            self.bin = Some(residuals.add(self.echo.residual_mm.abs()));
        }
    }
}

/// The echoes between two rings.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct EchoBand {
    cells: Vec<Vec<Sample>>,
    /// Number of echoes that arrived, merged or not.
    pub count: usize,
    /// Number of samples that are kept.
    pub kept: usize,
    /// Rings that the sums cover: those about the projections.
    pub rings: Range<usize>,
    pub equations: Equations,
    pub tally: Tally,
    /// Upper bound of a node's displacement since the residuals were evaluated, mm.
    pub travel_mm: f64,
    /// Time of the last echo, s.
    pub latest_s: f64,
    /// Whether the echoes have been projected onto the wall.
    is_projected: bool,
}

impl EchoBand {
    pub fn new(grid: &WallGrid, ring: usize) -> Self {
        Self {
            cells: vec![Vec::new(); grid.nodes],
            count: 0,
            kept: 0,
            rings: ring..ring,
            equations: Equations::over(grid, ring..ring),
            tally: Tally::new(0),
            travel_mm: 0.0,
            latest_s: f64::NEG_INFINITY,
            is_projected: false,
        }
    }

    /// Whether it can go on after it was read from a file, as a band of this grid.
    pub fn is_sound(&self, grid: &WallGrid) -> bool {
        let covers = |rings: &Range<usize>| {
            rings.start <= rings.end
                && rings.end <= grid.rings
                && self.equations.covers(rings, grid)
                && self.tally.covers(rings.len() * grid.nodes)
        };
        self.cells.len() == grid.nodes
            && self.kept == self.cells.iter().map(Vec::len).sum::<usize>()
            && self.cells.iter().all(|cell| cell.len() <= MAX_PER_CELL)
            && self.count < usize::MAX / 2
            && (covers(&self.rings) || self.rings.start == self.rings.end && self.rings.end <= grid.rings)
    }

    /// The bins of its samples in the running median of all.
    pub fn bins(&self) -> impl Iterator<Item = u16> + '_ {
        let counted = |sample: &&Sample| !sample.is_merged;
        self.cells.iter().flatten().filter(counted).filter_map(|sample| sample.bin)
    }

    /// Whether there are too few echoes yet to determine a wall.
    fn is_warming_up(&self) -> bool {
        self.count < self.cells.len()
    }

    /// Shifts ring numbers by `rings` new rings in front.
    pub fn renumber(&mut self, rings: usize) {
        self.rings = self.rings.start + rings..self.rings.end + rings;
        self.equations.renumber(rings * self.cells.len());
        self.samples().for_each(|sample| sample.echo.renumber(rings));
    }

    fn samples(&mut self) -> impl Iterator<Item = &mut Sample> {
        self.cells.iter_mut().flatten()
    }

    /// Places the samples of this band, which begins at `ring`, about an axis that moved. Those of other cells now leave,
    /// with the numbers of their bands; those beyond the axis's ends are dropped. The sums stay as they are.
    pub fn place_again(&mut self, axis: &Axis, ring: usize) -> Vec<(usize, Sample)> {
        let nodes = self.cells.len();
        let mut leaving = Vec::new();
        for (node, cell) in self.cells.iter_mut().enumerate() {
            let mut bands = Vec::new();
            let gone = cell.extract_if(.., |sample| {
                let band = sample.place_again(axis, ring, nodes);
                let stays = band == Some(ring) && sample.cell(nodes) == node;
                if !stays {
                    bands.push(band);
                }
                !stays
            });
            let gone: Vec<Sample> = gone.collect();
            self.kept -= gone.len();
            self.count = self.count.saturating_sub(gone.len());
            leaving.extend(bands.into_iter().zip(gone).filter_map(|(band, sample)| Some((band?, sample))));
        }
        leaving
    }

    /// Keeps a sample that left another cell. The sums that have it travelled by `travel_mm`.
    pub fn take_in(&mut self, mut sample: Sample, model: ResidualModel, axis: &Axis, travel_mm: f64) {
        self.travel_mm = self.travel_mm.max(travel_mm);
        let warm_up = self.counts_up();
        let equation = sample.equation(model, warm_up);
        self.keep(sample, &equation, model, axis);
    }

    /// Changes the sums where the rings `moved` have moved, and the radii at all nodes by `shift_mm` with them.
    pub fn move_sums(&mut self, moved: &Range<usize>, shift_mm: &[f64], grid: &WallGrid) {
        if !self.rings.is_empty() && self.rings.start < moved.end && moved.start < self.rings.end {
            let nodes = self.rings.start * grid.nodes..self.rings.end * grid.nodes;
            self.equations.shift(&shift_mm[nodes], grid.nodes);
        }
    }

    /// Counts an echo that arrives; whether there are still too few to determine a wall.
    fn counts_up(&mut self) -> bool {
        let was_warming_up = self.is_warming_up();
        self.count += 1;
        let warm_up = self.is_warming_up();
        if was_warming_up && !warm_up {
            // From now on there is a wall to evaluate all residuals on.
            self.travel_mm = f64::INFINITY;
        }
        warm_up
    }

    /// Ages the samples: their weights decrease by `factor`.
    pub fn age(&mut self, factor: f64) {
        for sample in self.samples() {
            sample.weight *= factor;
            sample.scatter_mm2 *= factor;
        }
        self.equations.scale(factor);
        self.tally.scale(factor);
    }

    /// Adds a new sample of this band; in a full cell it is merged with the sample of the most similar direction of view.
    ///
    /// Returns the ring of its projection, and whether it lies on the wall.
    pub fn insert(
        &mut self,
        mut sample: Sample,
        model: ResidualModel,
        axis: &Axis,
        residuals: &mut RunningMedian,
    ) -> (f64, bool) {
        let warm_up = self.counts_up();
        if !warm_up {
            sample.project(model);
        }
        let equation = sample.equation(model, warm_up);
        if !warm_up {
            sample.count(residuals);
        }
        let ring = sample.echo.projection().0;
        self.add(&sample, &equation, model.grid);
        self.keep(sample, &equation, model, axis);
        (ring, equation.on_wall)
    }

    /// Adds a sample to the sums.
    fn add(&mut self, sample: &Sample, equation: &BandEquation, grid: &WallGrid) {
        let ring = equation.corners.nodes.into_iter().min().unwrap_or(0) / grid.nodes;
        self.cover(ring..ring + 2, grid);
        if equation.weight > 0.0 {
            self.equations.add(&equation.corners, equation.weight, equation.value_mm);
        }
        let residual = sample.echo.residual_mm;
        let squares_mm2 = sample.scatter_mm2 + sample.weight * residual * residual;
        let node = equation.corners.nearest() - self.rings.start * grid.nodes;
        self.tally.add(node, equation.on_wall, sample.weight, squares_mm2, sample.echo.frame);
    }

    /// Widens the sums to cover `rings`.
    fn cover(&mut self, rings: Range<usize>, grid: &WallGrid) {
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

    /// Keeps a sample, or merges it with another of its cell.
    fn keep(&mut self, sample: Sample, equation: &BandEquation, model: ResidualModel, axis: &Axis) {
        let node = sample.cell(self.cells.len());
        let cell = &mut self.cells[node];
        if cell.len() < MAX_PER_CELL {
            cell.push(sample);
            self.kept += 1;
            return;
        }
        let is_on_wall = |other: &Sample| is_inlier(&other.echo, model.noise_mm);
        if !equation.on_wall {
            // Off the wall, the newest echoes replace the oldest.
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
                if let Some(merged) = merged(&cell[partner], &sample, equation.robust, model.grid, axis) {
                    cell[partner] = merged;
                }
            }
            None => cell[0] = sample,
        }
    }

    /// Evaluates all residuals again and computes the sums. [`count_residuals`](Self::count_residuals) has to follow.
    pub fn measure(&mut self, model: ResidualModel, warm_up: bool) {
        let warm_up = warm_up || self.is_warming_up();
        let mut cells = std::mem::take(&mut self.cells);
        let project = !warm_up && !std::mem::replace(&mut self.is_projected, !warm_up);
        let empty = self.rings.start..self.rings.start;
        (self.rings, self.tally) = (empty, Tally::new(0));
        for sample in cells.iter_mut().flatten() {
            if project {
                sample.project(model);
            }
            let equation = sample.equation(model, warm_up);
            self.add(sample, &equation, model.grid);
        }
        self.cells = cells;
        self.travel_mm = 0.0;
    }

    /// Replaces the residuals in the running median of all, unless there is no wall yet.
    pub fn count_residuals(&mut self, residuals: &mut RunningMedian, warm_up: bool) {
        if !(warm_up || self.is_warming_up()) {
            self.samples().for_each(|sample| sample.count(residuals));
        }
    }
}

/// One sample for two of a cell; `share` is the robust weight of the second. `None` where their mean has no coordinates.
fn merged(a: &Sample, b: &Sample, share: f64, grid: &WallGrid, axis: &Axis) -> Option<Sample> {
    let added = b.weight * share;
    let weight = a.weight + added;
    let t = added / weight;
    let ((ring_a, node_a), (ring_b, node_b)) = ((a.echo.ring, a.echo.node), (b.echo.ring, b.echo.node));
    let (ring, node) = (ring_a + (ring_b - ring_a) * t, node_a + (node_b - node_a) * t);
    let radius_mm = a.echo.radius_mm + (b.echo.radius_mm - a.echo.radius_mm) * t;
    let point_mm = axis.point_between_mm(ring, TAU * node / grid.nodes as f64, radius_mm);
    let other = if a.image_normal.dot(b.image_normal) < 0.0 { -b.image_normal } else { b.image_normal };
    let image_normal = a.image_normal.lerp(other, t).try_normalize()?;
    let place = axis.place(point_mm, ring as usize)?;
    let apart = a.echo.residual_mm - b.echo.residual_mm;
    let mut echo = Echo::new(&place, image_normal, a.echo.frame.max(b.echo.frame), grid.nodes);
    echo.keep_projection_of(&a.echo);
    let scatter_mm2 = a.scatter_mm2 + b.scatter_mm2 + a.weight * t * apart * apart;
    Some(Sample { echo, point_mm, image_normal, weight, scatter_mm2, bin: None, is_merged: true })
}
