//! The echoes between two rings, at most a fixed number of them, and their sums.

use super::running_median::RunningMedian;
use super::shared::{Pulls, Signs, signs};
use crate::numerics::robust::huber_weight;
use crate::sweep::prepare::axis::{Axis, Place};
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::{Corners, WallGrid};
use crate::sweep::support::Tally;
use crate::sweep::wall::equations::Equations;
use crate::sweep::wall::residual::{Measured, ResidualModel, gate, is_inlier, measure_on_tube};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::ops::Range;

/// Largest number of echoes kept in a cell of the grid; more are merged.
const MAX_PER_CELL: usize = 40;

/// The wall and the axis that samples are measured about.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub model: ResidualModel<'a>,
    pub axis: &'a Axis,
}

/// An echo, or several that were merged into one.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Sample {
    /// Its coordinates, with the ring counted from the first one of its band: rings that are added in front change nothing.
    pub echo: Echo,
    pub point_mm: DVec3,
    /// The image plane's normal in the world.
    pub image_normal: DVec3,
    /// Number of echoes that it represents, less for old ones.
    pub weight: f64,
    /// Their weighted squared residuals about their mean, mm².
    pub scatter_mm2: f64,
    /// The signs of its frame; of several echoes, the weighted mean.
    signs: Signs,
    /// Their weighted residuals about their mean, times their signs about the mean, mm.
    scattered_mm: Signs,
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
    /// What a millimetre of residual adds to the right-hand side, for each echo.
    pull: f64,
    on_wall: bool,
}

impl Sample {
    /// One that begins at `ring` as its band does.
    pub fn new(place: &Place, point_mm: DVec3, image_normal: DVec3, frame: u32, grid: &WallGrid) -> Self {
        let mut echo = Echo::new(place, image_normal, frame, grid.nodes);
        echo.ring -= place.ring.floor();
        Self {
            echo,
            point_mm,
            image_normal,
            weight: 1.0,
            scatter_mm2: 0.0,
            signs: signs(frame),
            scattered_mm: Signs::default(),
            bin: None,
            is_merged: false,
        }
    }

    /// Evaluates its residual, moves its projection, and returns the equation there; its band begins at `ring`.
    fn measure(&mut self, ring: usize, model: ResidualModel) -> (Corners, Measured) {
        let own = self.echo.ring;
        self.echo.ring += ring as f64;
        let (projected_ring, node) = self.echo.projection();
        let corners = model.grid.corners(projected_ring, node);
        let measured = model.measure(&mut self.echo, true);
        self.echo.ring = own;
        (corners, measured)
    }

    /// Projects it onto the wall in two steps, since the wall is not flat.
    fn project(&mut self, ring: usize, model: ResidualModel) {
        for _ in 0..2 {
            self.measure(ring, model);
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
        self.echo.ring -= place.ring.floor();
        self.echo.keep_projection_of(&before);
        Some(place.ring as usize)
    }

    fn equation(&mut self, ring: usize, model: ResidualModel, warm_up: bool) -> BandEquation {
        let ResidualModel { grid, noise_mm, .. } = model;
        if warm_up {
            let measured = measure_on_tube(&mut self.echo);
            let (weight, value_mm) = (self.weight * measured.weight, measured.wall_mm);
            let corners = grid.corners(self.echo.ring + ring as f64, self.echo.node);
            return BandEquation { corners, weight, robust: 1.0, value_mm, pull: 0.0, on_wall: true };
        }
        let (corners, measured) = self.measure(ring, model);
        let residual = self.echo.residual_mm.abs();
        let on_wall = residual <= gate(noise_mm, measured.wall_mm);
        // Merged echoes too: they are alike in their noise, which does not make them more likely to be the wall's.
        let robust = if on_wall { huber_weight(noise_mm, residual) } else { 0.0 };
        let weight = robust * measured.weight * self.weight;
        let value_mm = measured.wall_mm + measured.radial_mm;
        BandEquation { corners, weight, robust, value_mm, pull: robust * measured.weight.sqrt(), on_wall }
    }

    /// Its residual times each of its signs, times its weight, mm.
    fn signed_mm(&self) -> Signs {
        let residual_mm = (self.weight * self.echo.residual_mm) as f32;
        std::array::from_fn(|k| residual_mm * self.signs[k] + self.scattered_mm[k])
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

/// What the samples of a band add up to, over the rings about their projections.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Sums {
    pub rings: Range<usize>,
    pub equations: Equations,
    pub pulls: Pulls,
    pub tally: Tally,
}

impl Sums {
    fn none(grid: &WallGrid, ring: usize) -> Self {
        let equations = Equations::over(grid, ring..ring);
        Self { rings: ring..ring, equations, pulls: Pulls::default(), tally: Tally::new(0) }
    }

    /// Whether they are those of a band of this grid.
    fn is_sound(&self, grid: &WallGrid) -> bool {
        let Self { rings, equations, pulls, tally } = self;
        rings.start <= rings.end
            && rings.end <= grid.rings
            && (rings.is_empty() || equations.covers(rings, grid))
            && pulls.are_sound(rings.len() * grid.nodes)
            && tally.covers(rings.len() * grid.nodes)
    }

    /// Adds a sample.
    fn add(&mut self, sample: &Sample, equation: &BandEquation, grid: &WallGrid) {
        let ring = equation.corners.nodes.into_iter().min().unwrap_or(0) / grid.nodes;
        self.cover(ring..ring + 2, grid);
        if equation.weight > 0.0 {
            self.equations.add(&equation.corners, equation.weight, equation.value_mm);
            let signed_mm = sample.signed_mm();
            for (node, share) in equation.corners.nodes.into_iter().zip(equation.corners.weights) {
                let pull = (equation.pull * share) as f32;
                let sums = &mut self.pulls.0[node - self.rings.start * grid.nodes];
                sums.iter_mut().zip(signed_mm).for_each(|(sum, signed)| *sum += pull * signed);
            }
        }
        let residual = sample.echo.residual_mm;
        let squares_mm2 = sample.scatter_mm2 + sample.weight * residual * residual;
        let node = equation.corners.nearest() - self.rings.start * grid.nodes;
        self.tally.add(node, equation.on_wall, sample.weight, squares_mm2, sample.echo.frame);
    }

    /// Widens them to cover `rings`.
    fn cover(&mut self, rings: Range<usize>, grid: &WallGrid) {
        if self.rings.is_empty() {
            self.rings = rings;
            self.equations = Equations::over(grid, self.rings.clone());
            self.pulls = Pulls::new(self.rings.len() * grid.nodes);
            self.tally = Tally::new(self.rings.len() * grid.nodes);
        } else if rings.start < self.rings.start || rings.end > self.rings.end {
            let wider = rings.start.min(self.rings.start)..rings.end.max(self.rings.end);
            let mut equations = Equations::over(grid, wider.clone());
            equations.merge(&self.equations);
            let first = (self.rings.start - wider.start) * grid.nodes;
            let mut pulls = Pulls::new(wider.len() * grid.nodes);
            pulls.merge(first, &self.pulls);
            let mut tally = Tally::new(wider.len() * grid.nodes);
            tally.merge(first, &self.tally, 0);
            *self = Self { rings: wider, equations, pulls, tally };
        }
    }

    /// Shifts ring numbers by `rings` new rings in front.
    fn renumber(&mut self, rings: usize, nodes: usize) {
        self.rings = self.rings.start + rings..self.rings.end + rings;
        self.equations.renumber(rings * nodes);
    }

    /// Changes them where the rings `moved` have moved, and the radii at their nodes by `shift_mm` with them.
    fn follow(&mut self, moved: &Range<usize>, shift_mm: &[f64], nodes: usize) {
        if self.rings.is_empty() || self.rings.start >= moved.end || moved.start >= self.rings.end {
            return;
        }
        let shift_of = |ring: usize| match moved.contains(&ring) {
            true => &shift_mm[(ring - moved.start) * nodes..(ring - moved.start + 1) * nodes],
            false => &[],
        };
        let mut shifts_mm = vec![0.0; self.rings.len() * nodes];
        for (ring, shifts_mm) in self.rings.clone().zip(shifts_mm.chunks_exact_mut(nodes)) {
            let shift_mm = shift_of(ring);
            shifts_mm[..shift_mm.len()].copy_from_slice(shift_mm);
        }
        self.equations.shift(&shifts_mm, nodes);
    }

    /// Multiplies the weights of all samples.
    fn scale(&mut self, factor: f64) {
        self.equations.scale(factor);
        self.pulls.scale(factor);
        self.tally.scale(factor);
    }
}

/// Sums that are being computed anew, cell by cell, over several frames if need be.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Renewal {
    /// The next cell.
    cell: usize,
    sums: Sums,
    /// Whether the axis had moved since the samples were placed.
    places: bool,
    /// Whether the samples have never been projected onto the wall.
    projects: bool,
}

/// The echoes between two rings.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct EchoBand {
    /// The first of the two.
    ring: usize,
    cells: Vec<Vec<Sample>>,
    /// Number of echoes that arrived, merged or not.
    pub count: usize,
    pub sums: Sums,
    renewal: Option<Renewal>,
    /// Upper bound of a node's displacement since the residuals were evaluated, mm.
    pub travel_mm: f64,
    /// The number of the last renewal, of all bands together; 0 where one is overdue.
    pub turn: u64,
    /// Time of the last echo, s.
    pub latest_s: f64,
    /// Whether the axis has moved since the samples were placed.
    pub is_misplaced: bool,
    /// Whether the samples have been projected onto the wall.
    is_projected: bool,
}

impl EchoBand {
    pub fn new(grid: &WallGrid, ring: usize) -> Self {
        Self {
            ring,
            cells: vec![Vec::new(); grid.nodes],
            count: 0,
            sums: Sums::none(grid, ring),
            renewal: None,
            travel_mm: 0.0,
            turn: 0,
            latest_s: f64::NEG_INFINITY,
            is_misplaced: false,
            is_projected: false,
        }
    }

    /// Whether it can go on after it was read from a file, as the band of a grid that begins at `ring`.
    pub fn is_sound(&self, grid: &WallGrid, ring: usize) -> bool {
        let renewal = self.renewal.as_ref();
        self.ring == ring
            && self.cells.len() == grid.nodes
            && self.cells.iter().all(|cell| cell.len() <= MAX_PER_CELL)
            && self.count < usize::MAX / 2
            && self.sums.is_sound(grid)
            && renewal.is_none_or(|renewal| renewal.cell < grid.nodes && renewal.sums.is_sound(grid))
    }

    /// The bins of its samples in the running median of all.
    pub fn bins(&self) -> impl Iterator<Item = u16> + '_ {
        let counted = |sample: &&Sample| !sample.is_merged;
        self.cells.iter().flatten().filter(counted).filter_map(|sample| sample.bin)
    }

    /// Its samples, as [`Echo`]s of the whole grid with their weights, and whether each represents several.
    pub fn echoes(&self) -> impl Iterator<Item = (Echo, bool)> + '_ {
        let of_grid = |sample: &Sample| Echo {
            ring: sample.echo.ring + self.ring as f64,
            weight: sample.weight as f32,
            ..sample.echo
        };
        self.cells.iter().flatten().map(move |sample| (of_grid(sample), sample.is_merged))
    }

    /// Its samples where each frame is moved by so much, mm; those that represent several echoes stay.
    pub fn moved<'a>(&'a self, moves_mm: &'a [DVec3], axis: &'a Axis) -> impl Iterator<Item = Echo> + 'a {
        let nodes = self.cells.len();
        let placed = move |sample: &Sample| {
            let move_mm = if sample.is_merged { DVec3::ZERO } else { moves_mm[sample.echo.frame as usize] };
            let place = axis.place(sample.point_mm + move_mm, self.ring)?;
            let echo = Echo::new(&place, sample.image_normal, sample.echo.frame, nodes);
            Some(Echo { weight: sample.weight as f32, ..echo })
        };
        self.cells.iter().flatten().filter_map(placed)
    }

    /// Whether there are too few echoes yet to determine a wall.
    fn is_warming_up(&self) -> bool {
        self.count < self.cells.len()
    }

    /// The sums, and those that are to take their place.
    fn all_sums(&mut self) -> impl Iterator<Item = &mut Sums> {
        std::iter::once(&mut self.sums).chain(self.renewal.as_mut().map(|renewal| &mut renewal.sums))
    }

    /// Shifts ring numbers by `rings` new rings in front.
    pub fn renumber(&mut self, rings: usize) {
        let nodes = self.cells.len();
        self.ring += rings;
        self.all_sums().for_each(|sums| sums.renumber(rings, nodes));
    }

    /// Keeps a sample that left another cell. The sums that have it travelled by `travel_mm`.
    pub fn take_in(&mut self, mut sample: Sample, scene: Scene, travel_mm: f64) {
        self.travel_mm = self.travel_mm.max(travel_mm);
        let warm_up = self.counts_up();
        let equation = sample.equation(self.ring, scene.model, warm_up);
        self.add(sample, &equation, scene);
    }

    /// Changes the sums where the rings `moved` have moved, and the radii at their nodes by `shift_mm` with them: to first
    /// order they keep their meaning.
    pub fn follow(&mut self, moved: &Range<usize>, shift_mm: &[f64]) {
        let nodes = self.cells.len();
        self.all_sums().for_each(|sums| sums.follow(moved, shift_mm, nodes));
    }

    /// Counts an echo that arrives; whether there are still too few to determine a wall.
    fn counts_up(&mut self) -> bool {
        let was_warming_up = self.is_warming_up();
        self.count += 1;
        let warm_up = self.is_warming_up();
        if was_warming_up && !warm_up {
            // From now on there is a wall to evaluate all residuals on.
            (self.travel_mm, self.turn) = (f64::INFINITY, 0);
        }
        warm_up
    }

    /// Ages the samples: their weights decrease by `factor`.
    pub fn age(&mut self, factor: f64) {
        for sample in self.cells.iter_mut().flatten() {
            sample.weight *= factor;
            sample.scatter_mm2 *= factor;
            sample.scattered_mm.iter_mut().for_each(|scattered| *scattered *= factor as f32);
        }
        self.all_sums().for_each(|sums| sums.scale(factor));
    }

    /// Adds a new sample of this band; in a full cell it is merged with the sample of the most similar direction of view.
    ///
    /// Returns the ring of its projection, and whether it lies on the wall.
    pub fn insert(&mut self, mut sample: Sample, scene: Scene, residuals: &mut RunningMedian) -> (f64, bool) {
        let warm_up = self.counts_up();
        if !warm_up {
            sample.project(self.ring, scene.model);
        }
        let equation = sample.equation(self.ring, scene.model, warm_up);
        if !warm_up {
            sample.count(residuals);
        }
        let (ring, on_wall) = (self.ring as f64 + sample.echo.projection().0, equation.on_wall);
        self.add(sample, &equation, scene);
        (ring, on_wall)
    }

    /// Adds a sample to the sums, and keeps it.
    fn add(&mut self, sample: Sample, equation: &BandEquation, scene: Scene) {
        let (cell, grid) = (sample.cell(self.cells.len()), scene.model.grid);
        self.sums.add(&sample, equation, grid);
        // Cells that are still to come will be added with all that they hold.
        if let Some(renewal) = self.renewal.as_mut().filter(|renewal| cell < renewal.cell) {
            renewal.sums.add(&sample, equation, grid);
        }
        self.keep(sample, equation, scene);
    }

    /// Keeps a sample, or merges it with another of its cell.
    fn keep(&mut self, sample: Sample, equation: &BandEquation, scene: Scene) {
        let node = sample.cell(self.cells.len());
        let cell = &mut self.cells[node];
        if cell.len() < MAX_PER_CELL {
            cell.push(sample);
            return;
        }
        let is_on_wall = |other: &Sample| is_inlier(&other.echo, scene.model.noise_mm);
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
                if let Some(merged) = merged(&cell[partner], &sample, equation.robust, self.ring, scene) {
                    cell[partner] = merged;
                }
            }
            None => cell[0] = sample,
        }
    }

    /// Forgets the samples of some frames, but those that represent several echoes; whether there were any. Its sums are overdue
    /// then.
    pub fn forget(&mut self, frames: &BTreeSet<u32>, residuals: &mut RunningMedian) -> bool {
        let mut forgotten = 0;
        let mut is_kept = |sample: &Sample| {
            let is_kept = sample.is_merged || !frames.contains(&sample.echo.frame);
            if !is_kept {
                forgotten += 1;
                sample.bin.into_iter().for_each(|bin| residuals.remove(bin));
            }
            is_kept
        };
        self.cells.iter_mut().for_each(|cell| cell.retain(&mut is_kept));
        if forgotten == 0 {
            return false;
        }
        self.count = self.count.saturating_sub(forgotten);
        if let Some(renewal) = self.renewal.take() {
            self.is_misplaced |= renewal.places;
            self.is_projected &= !renewal.projects;
        }
        (self.travel_mm, self.turn) = (f64::INFINITY, 0);
        true
    }

    /// Whether its sums are being computed anew.
    pub fn is_in_renewal(&self) -> bool {
        self.renewal.is_some()
    }

    /// Evaluates the residuals of some samples again, cell by cell from where the last call ended, after they were placed
    /// about the axis where that has moved. The new sums take the place of the old ones once all cells are done. The samples
    /// are subtracted from `budget`.
    ///
    /// Returns the samples that lie in other cells now, with the numbers of their bands; those beyond the axis's ends are
    /// dropped.
    pub fn renew(
        &mut self,
        scene: Scene,
        residuals: &mut RunningMedian,
        warm_up: bool,
        budget: &mut usize,
    ) -> Vec<(usize, Sample)> {
        let (ring, nodes) = (self.ring, self.cells.len());
        let warm_up = warm_up || self.is_warming_up();
        let mut renewal = self.renewal.take().unwrap_or_else(|| {
            self.travel_mm = 0.0;
            Renewal {
                cell: 0,
                sums: Sums::none(scene.model.grid, ring),
                places: std::mem::take(&mut self.is_misplaced),
                projects: !warm_up && !std::mem::replace(&mut self.is_projected, !warm_up),
            }
        });
        let mut leaving = Vec::new();
        while renewal.cell < nodes && *budget > 0 {
            let cell = &mut self.cells[renewal.cell];
            *budget = budget.saturating_sub(cell.len().max(1));
            if renewal.places || self.is_misplaced {
                let mut k = 0;
                while k < cell.len() {
                    let band = cell[k].place_again(scene.axis, ring, nodes);
                    if band == Some(ring) && cell[k].cell(nodes) == renewal.cell {
                        k += 1;
                        continue;
                    }
                    self.count = self.count.saturating_sub(1);
                    let sample = cell.remove(k);
                    leaving.extend(band.map(|band| (band, sample)));
                }
            }
            for sample in cell {
                if renewal.projects {
                    sample.project(ring, scene.model);
                }
                let equation = sample.equation(ring, scene.model, warm_up);
                renewal.sums.add(sample, &equation, scene.model.grid);
                if !warm_up {
                    sample.count(residuals);
                }
            }
            renewal.cell += 1;
        }
        match renewal.cell < nodes {
            true => self.renewal = Some(renewal),
            false => self.sums = renewal.sums,
        }
        leaving
    }
}

/// One sample for two of a cell of the band at `ring`; `share` is the robust weight of the second. `None` where their mean
/// has no coordinates.
fn merged(a: &Sample, b: &Sample, share: f64, ring: usize, scene: Scene) -> Option<Sample> {
    let Scene { model: ResidualModel { grid, .. }, axis } = scene;
    let added = b.weight * share;
    let weight = a.weight + added;
    let t = added / weight;
    // The first may have been placed about the axis as it was before.
    let (there, here) = (axis.place(a.point_mm, ring)?, &b.echo);
    let node_a = there.theta_rad / TAU * grid.nodes as f64;
    let around = (here.node - node_a + grid.nodes as f64 / 2.0).rem_euclid(grid.nodes as f64);
    let node = node_a + (around - grid.nodes as f64 / 2.0) * t;
    let mean_ring = there.ring + (ring as f64 + here.ring - there.ring) * t;
    let radius_mm = there.radius_mm + (here.radius_mm - there.radius_mm) * t;
    let point_mm = axis.point_between_mm(mean_ring, TAU * node / grid.nodes as f64, radius_mm);
    let other = if a.image_normal.dot(b.image_normal) < 0.0 { -b.image_normal } else { b.image_normal };
    let image_normal = a.image_normal.lerp(other, t).try_normalize()?;
    let place = axis.place(point_mm, mean_ring.max(0.0) as usize)?;
    let apart = a.echo.residual_mm - b.echo.residual_mm;
    let mut echo = Echo::new(&place, image_normal, a.echo.frame.max(b.echo.frame), grid.nodes);
    echo.ring -= ring as f64;
    echo.keep_projection_of(&a.echo);
    let scatter_mm2 = a.scatter_mm2 + b.scatter_mm2 + a.weight * t * apart * apart;
    let scattered_mm = std::array::from_fn(|k| {
        let own = (a.weight * t * apart) as f32 * (a.signs[k] - b.signs[k]);
        a.scattered_mm[k] + b.scattered_mm[k] + own
    });
    let signs = std::array::from_fn(|k| a.signs[k] + (b.signs[k] - a.signs[k]) * t as f32);
    let (bin, is_merged) = (None, true);
    Some(Sample { echo, point_mm, image_normal, weight, scatter_mm2, signs, scattered_mm, bin, is_merged })
}
