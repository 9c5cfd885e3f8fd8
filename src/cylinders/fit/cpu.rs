//! The fit on the CPU: f32 as the device computes it, or f64 as the reference.

use super::groups::{Groups, converted_and_grouped};
use super::sealed::Sealed;
use super::{
    DeformedTube, Engine, EngineDescription, Fit, FitRequest, FittedCylinder, SectionFit, check_section,
};
use crate::cylinders::passes::{
    Face, Filter, Section, TriangleStatistic, TubeGrid, distance, fill, measure_long, measure_short, support,
    update,
};
use crate::cylinders::tube::Tube;
use crate::error::unless_cancelled;
use crate::numerics::Scalar;
use crate::settings::Settings;
use crate::{Error, Result};
use rayon::prelude::*;
use std::marker::PhantomData;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Fits cylinders on the CPU, on all threads of the current rayon pool.
///
/// `CpuEngine<f32>` is the engine `cpu`, `CpuEngine<f64>` the engine `reference`.
#[derive(Debug, Clone, Copy, Default)]
pub struct CpuEngine<T>(PhantomData<T>);

impl<T> CpuEngine<T> {
    /// The engine.
    pub fn new() -> Self {
        Self(PhantomData)
    }
}

impl<T: Scalar> CpuEngine<T> {
    /// `reference` in f64, `cpu` in f32.
    pub fn describe(&self) -> EngineDescription {
        let name = if size_of::<T>() == size_of::<f64>() { "reference" } else { "cpu" };
        EngineDescription { name: name.into(), ..EngineDescription::default() }
    }
}

impl<T> Sealed for CpuEngine<T> {}

impl<T: Scalar> Engine for CpuEngine<T> {
    fn fit(&self, request: &FitRequest) -> Result<Fit> {
        let fit = |&frame: &usize| {
            let cylinder = request.track.cylinder(frame)?;
            let section = request.track.section::<T>(frame, request.settings)?;
            let tube = deform::<_, T>(&section, cylinder.radius_mm, request.settings, request.history);
            Ok(FittedCylinder { frame, world_from_cylinder: cylinder.world_from_cylinder, tube })
        };
        let cancelled = AtomicBool::new(false);
        let fitted: Vec<Result<FittedCylinder>> = request
            .frames
            .par_iter()
            .map(|frame| {
                if cancelled.load(Ordering::Relaxed) {
                    return Err(Error::Cancelled);
                }
                let fitted = fit(frame);
                let asked = (request.progress)(1);
                cancelled.fetch_or(asked.is_break(), Ordering::Relaxed);
                unless_cancelled(asked)?;
                fitted
            })
            .collect();
        Fit::of(fitted, self.describe())
    }

    fn fit_section(&self, section: &Section<f32>, radius_mm: f64, settings: &Settings) -> Result<SectionFit> {
        settings.validate()?;
        check_section(section, radius_mm)?;
        Ok(SectionFit { tube: deform::<_, T>(section, radius_mm, settings, false), engine: self.describe() })
    }
}

/// The whole fit of one tube (docs/method.md, "Local cylinder fit").
fn deform<S: Scalar, T: Scalar>(
    section: &Section<S>,
    radius_mm: f64,
    settings: &Settings,
    history: bool,
) -> DeformedTube {
    let mut deformation = Deformation::<T>::of(section, radius_mm, settings, history);
    for _ in 0..settings.iterations {
        deformation.iterate();
    }
    deformation.into_tube()
}

/// The fit of one tube after some of its iterations.
pub(super) struct Deformation<T> {
    tube: Tube,
    radius_mm: f64,
    filter: Filter<T>,
    chunks: Vec<Range<usize>>,
    gated: u64,
    keep_history: bool,
    values: Vec<T>,
    /// The section's points, face after face.
    pub(super) groups: Groups<T>,
    /// Radii of the nodes.
    pub(super) radii: Vec<T>,
    /// The statistic of each triangle in the last iteration.
    pub(super) statistics: Vec<TriangleStatistic<T>>,
    /// Mean |travel| of each iteration, mm.
    pub(super) travel_mm: Vec<f64>,
    /// Radii before the first iteration and after each, mm; empty unless asked for.
    pub(super) history_mm: Vec<Vec<f64>>,
}

impl<T: Scalar> Deformation<T> {
    /// Groups a section's points about the primitive tube.
    #[cfg(feature = "gpu")]
    pub(super) fn new(section: &Section<T>, radius_mm: f64, settings: &Settings, history: bool) -> Self {
        Self::of(section, radius_mm, settings, history)
    }

    /// Groups a section's points about the primitive tube; numbers of another type are rounded first.
    fn of<S: Scalar>(section: &Section<S>, radius_mm: f64, settings: &Settings, history: bool) -> Self {
        let tube = Tube::new(settings);
        let groups = converted_and_grouped(section, &tube);
        let radii = vec![T::from_f64(radius_mm); tube.node_count()];
        Self {
            tube,
            radius_mm,
            filter: Filter::new(settings, radius_mm),
            chunks: chunks(&groups, tube.face_count()),
            gated: section.gated,
            keep_history: history,
            values: Vec::new(),
            groups,
            statistics: vec![TriangleStatistic::default(); 2 * tube.face_count()],
            travel_mm: Vec::new(),
            history_mm: if history { vec![to_f64(&radii)] } else { Vec::new() },
            radii,
        }
    }

    /// One iteration.
    pub(super) fn iterate(&mut self) {
        let Self { tube, filter, groups, radii, statistics, values, .. } = self;
        measure(groups, tube, filter, radii, &self.chunks, statistics);
        fill(statistics, tube, values);
        self.travel_mm.push(update(values, tube, filter, radii).to_f64());
        if self.keep_history {
            self.history_mm.push(to_f64(radii));
        }
    }

    fn into_tube(self) -> DeformedTube {
        let points = self.groups.points.len() as u64;
        let kept: u64 = self.statistics.iter().map(|s| u64::from(s.kept)).sum();
        let (support, residuals) = support(&self.statistics, &self.tube);
        DeformedTube {
            tube: self.tube,
            radius_mm: self.radius_mm,
            radii_mm: to_f64(&self.radii),
            rejected: if self.travel_mm.is_empty() { 0 } else { points - kept },
            history_mm: self.history_mm,
            travel_mm: self.travel_mm,
            residual_mm: residual_mm(&support, &residuals),
            support,
            points,
            gated: self.gated,
        }
    }
}

fn to_f64<T: Scalar>(radii: &[T]) -> Vec<f64> {
    radii.iter().map(|r| r.to_f64()).collect()
}

/// Residuals as a tube reports them: NaN where there are no points.
pub(super) fn residual_mm<T: Scalar>(support: &[u32], residuals: &[T]) -> Vec<f64> {
    support.iter().zip(residuals).map(|(&n, r)| if n == 0 { f64::NAN } else { r.to_f64() }).collect()
}

/// Runs of faces with enough points each to pay for a thread.
fn chunks<T: Scalar>(groups: &Groups<T>, faces: usize) -> Vec<Range<usize>> {
    const POINTS: u32 = 16_384;
    const FACES: usize = 8_192;
    let mut chunks = Vec::new();
    let mut first = 0;
    for face in 0..faces {
        let points = groups.offsets[face + 1] - groups.offsets[first];
        if points >= POINTS || face + 1 - first >= FACES || face + 1 == faces {
            chunks.push(first..face + 1);
            first = face + 1;
        }
    }
    chunks
}

/// Distances and statistics of all faces: the statistic of every triangle.
fn measure<T: Scalar>(
    groups: &Groups<T>,
    tube: &Tube,
    filter: &Filter<T>,
    radii: &[T],
    chunks: &[Range<usize>],
    statistics: &mut [TriangleStatistic<T>],
) {
    let (mut bottoms, mut tops) = statistics.split_at_mut(tube.face_count());
    let mut work = Vec::with_capacity(chunks.len());
    for faces in chunks {
        let (bottom, rest) = bottoms.split_at_mut(faces.len());
        bottoms = rest;
        let (top, rest) = tops.split_at_mut(faces.len());
        tops = rest;
        work.push(Chunk { groups, tube, filter, radii, faces: faces.clone(), bottom, top });
    }
    // The widest vectors that the processor has. They all give the same results, since nothing is fused.
    let arch = pulp::Arch::new();
    if work.len() == 1 {
        work.into_iter().for_each(|chunk| arch.dispatch(chunk));
    } else {
        work.into_par_iter().for_each(|chunk| arch.dispatch(chunk));
    }
}

/// Up to this many distances of a triangle are sorted by insertion; above, order statistics are selected.
const MAX_SHORT: usize = 24;

/// The statistic of a triangle's signed distances, by the method that is faster for their number.
#[inline(always)]
fn statistic<T: Scalar>(distances: &[T], filter: &Filter<T>, keys: &mut Vec<T::Key>) -> TriangleStatistic<T> {
    if distances.len() <= MAX_SHORT {
        measure_short(distances, filter, keys)
    } else {
        measure_long(distances, filter, keys)
    }
}

/// A run of faces and where their statistics go.
struct Chunk<'a, T> {
    groups: &'a Groups<T>,
    tube: &'a Tube,
    filter: &'a Filter<T>,
    radii: &'a [T],
    faces: Range<usize>,
    bottom: &'a mut [TriangleStatistic<T>],
    top: &'a mut [TriangleStatistic<T>],
}

/// Points whose distances are computed together.
const BLOCK: usize = 256;

/// Room for a batch of points and their distances, component by component, so that the compiler can vectorise
/// the distances.
struct Batch<T> {
    p: [[T; BLOCK]; 3],
    /// The [numbers](Face::numbers) of each point's face.
    faces: [[T; BLOCK]; 10],
    distance: Vec<T>,
    /// 1 where the top triangle is the nearer one, else 0.
    top: Vec<u8>,
}

impl<T: Scalar> Batch<T> {
    fn new() -> Self {
        let zero = T::default();
        Self { p: [[zero; BLOCK]; 3], faces: [[zero; BLOCK]; 10], distance: Vec::new(), top: Vec::new() }
    }

    /// The distances of all points of some faces.
    #[inline(always)]
    fn measure(&mut self, chunk: &Chunk<T>, grid: &TubeGrid<T>, faces: Range<usize>) {
        let offsets = &chunk.groups.offsets;
        let (begin, end) = (offsets[faces.start] as usize, offsets[faces.end] as usize);
        self.distance.resize(end - begin, T::default());
        self.top.resize(end - begin, 0);
        let mut face = faces.start;
        for (block, points) in chunk.groups.points[begin..end].chunks(BLOCK).enumerate() {
            let first = begin + block * BLOCK;
            let here = first - begin..first - begin + points.len();
            let (distances, tops) = (&mut self.distance[here.clone()], &mut self.top[here]);
            let end_of = |face: usize| offsets[face + 1] as usize - first;
            // A block takes whole faces or a part of one long face, whose numbers stay in registers.
            if end_of(face) >= points.len() {
                let shape = spread(&mut self.p, chunk, grid, face, points, 0);
                measure_block(&self.p, |_| shape, grid, distances, tops);
                face += usize::from(end_of(face) == points.len());
                continue;
            }
            let mut filled = 0;
            while filled < points.len() {
                let until = end_of(face).min(points.len());
                let shape = spread(&mut self.p, chunk, grid, face, &points[filled..until], filled);
                for (column, number) in self.faces.iter_mut().zip(shape.numbers()) {
                    column[filled..until].fill(number);
                }
                filled = until;
                face += usize::from(filled == end_of(face));
            }
            let shapes = &self.faces;
            let shape = |i: usize| Face::of_numbers(std::array::from_fn(|number| shapes[number][i]));
            measure_block(&self.p, shape, grid, distances, tops);
        }
    }
}

/// Writes points of one face from place `to` on, less its corner a, and returns the face.
#[inline(always)]
fn spread<T: Scalar>(
    p: &mut [[T; BLOCK]; 3],
    chunk: &Chunk<T>,
    grid: &TubeGrid<T>,
    face: usize,
    points: &[[T; 3]],
    to: usize,
) -> Face<T> {
    let Chunk { tube, radii, .. } = chunk;
    let (row, j) = (face - face % tube.nodes, face % tube.nodes);
    let (below, above) = (&radii[row..row + tube.nodes], &radii[row + tube.nodes..row + 2 * tube.nodes]);
    let k = tube.next(j);
    let a = below[j];
    for (i, point) in points.iter().enumerate() {
        p[0][to + i] = point[0] - a;
        p[1][to + i] = point[1];
        p[2][to + i] = point[2];
    }
    Face::new([below[k] - a, above[k] - a, above[j] - a], grid)
}

/// The distances of a block of points, `face` being that of a point by its place.
#[inline(always)]
fn measure_block<T: Scalar>(
    p: &[[T; BLOCK]; 3],
    face: impl Fn(usize) -> Face<T>,
    grid: &TubeGrid<T>,
    distances: &mut [T],
    tops: &mut [u8],
) {
    let count = distances.len().min(tops.len()).min(BLOCK);
    let (distances, tops) = (&mut distances[..count], &mut tops[..count]);
    for i in 0..count {
        let (signed, top) = distance([p[0][i], p[1][i], p[2][i]], &face(i), grid);
        distances[i] = signed;
        tops[i] = u8::from(top);
    }
}

impl<T: Scalar> pulp::NullaryFnOnce for Chunk<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let offsets = &self.groups.offsets;
        let grid = TubeGrid::new(self.tube);
        let mut batch = Batch::new();
        let mut keys = Vec::new();
        let (mut to_bottom, mut to_top) = (Vec::new(), Vec::new());
        let mut face = self.faces.start;
        while face < self.faces.end {
            // As many whole faces as fit into a block, or one larger face.
            let mut last = face + 1;
            while last < self.faces.end && (offsets[last + 1] - offsets[face]) as usize <= BLOCK {
                last += 1;
            }
            batch.measure(&self, &grid, face..last);
            let mut taken = 0;
            for f in face..last {
                let count = (offsets[f + 1] - offsets[f]) as usize;
                to_bottom.resize(count, T::default());
                to_top.resize(count, T::default());
                // Written to both, since no processor foresees which one takes it.
                let (mut bottoms, mut tops) = (0, 0);
                for (&distance, &top) in batch.distance[taken..][..count].iter().zip(&batch.top[taken..]) {
                    to_bottom[bottoms] = distance;
                    to_top[tops] = distance;
                    bottoms += usize::from(1 - top);
                    tops += usize::from(top);
                }
                taken += count;
                let of_face = f - self.faces.start;
                self.bottom[of_face] = statistic(&to_bottom[..bottoms], self.filter, &mut keys);
                self.top[of_face] = statistic(&to_top[..tops], self.filter, &mut keys);
            }
            face = last;
        }
    }
}
