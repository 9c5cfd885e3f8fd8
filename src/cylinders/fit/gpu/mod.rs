//! The fit on the device: WGSL passes, batched over many cylinders, with one submission and one wait per batch.
//!
//! Three layers: [`GpuEngine::fit`](super::Engine::fit) takes a track and returns cylinders;
//! [`GpuEngine::prepare`] makes a [`FitWorkspace`] to which a host writes its points on the device;
//! [`GpuEngine::record`] puts the passes into the host's command encoder.

mod pass;
mod stages;
mod workspace;

pub use pass::{Items, LANES, PASSES, Pass, Stage};
pub use stages::CpuStages;
pub use workspace::FitWorkspace;

use super::cpu::residual_mm;
use super::sealed::Sealed;
use super::{
    DeformedTube, Engine, EngineDescription, Fit, FitRequest, FittedCylinder, SectionFit, check_section,
};
use crate::cylinders::passes::{DeviceCylinder, DevicePair, LIST_HEAD, Section};
use crate::cylinders::track::{NearFrame, empty_section};
use crate::cylinders::tube::Tube;
use crate::error::unless_cancelled;
use crate::gpu::{AdapterDescription, Context, GpuError, Job, Runner, Spent, Timer};
use crate::numerics::Scalar;
use crate::settings::Settings;
use crate::{Error, Result};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use workspace::{Plan, Points};

/// A pass made ready on a device.
type ReadyPass = crate::gpu::ReadyPass<Stage, Items>;

/// Fits cylinders on the device.
pub struct GpuEngine {
    runner: Runner<Stage, Items>,
    cpu_stages: CpuStages,
    subgroups: bool,
    /// Device memory of earlier fits, at most [`MOST_KEPT`] workspaces of [`MOST_KEPT_BYTES`] in all.
    kept: Mutex<Vec<FitWorkspace>>,
}

/// Most workspaces that an engine keeps for later fits: one for each of a few threads.
const MOST_KEPT: usize = 4;
/// Most device memory that an engine keeps for later fits, bytes.
const MOST_KEPT_BYTES: u64 = 1 << 30;

impl GpuEngine {
    /// The engine on the adapter whose name contains `adapter` (without regard to case), or on the best one.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where there is no such adapter or it refuses a shader.
    pub fn new(adapter: Option<&str>) -> Result<Self> {
        Self::on(Context::new(adapter)?)
    }

    /// The engine on a host's device, which must meet [`Requirements`](crate::gpu::Requirements). No handler of the host's is replaced.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses a shader.
    pub fn on_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        Self::on(Context::of_host(device, queue))
    }

    fn on(context: Context) -> Result<Self> {
        Ok(Self {
            runner: Runner::new(context, &PASSES)?,
            cpu_stages: CpuStages::None,
            subgroups: true,
            kept: Mutex::default(),
        })
    }

    /// The same engine, but [`fit`](Engine::fit) and [`fit_section`](Engine::fit_section) compute the first
    /// stages on the CPU. Where a device's result differs from the CPU's, the first stage that has to run on the
    /// CPU for the results to agree is the one that diverges.
    #[must_use]
    pub fn with_cpu_stages(mut self, stages: CpuStages) -> Self {
        self.cpu_stages = stages;
        self
    }

    /// The same engine, but where the device has subgroups they are not used. The results are the same, later.
    #[must_use]
    pub fn without_subgroups(mut self) -> Self {
        self.subgroups = false;
        self
    }

    /// The least number of invocations in a subgroup, where the device has subgroups and the engine uses them.
    pub fn subgroup_width(&self) -> Option<u32> {
        self.runner.context.subgroup_width().filter(|_| self.subgroups)
    }

    /// The adapter, where the engine chose it.
    pub fn adapter(&self) -> Option<&AdapterDescription> {
        self.runner.adapter()
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.runner.context.device
    }

    /// The queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.runner.context.queue
    }

    /// The device and its passes.
    pub(crate) fn runner(&self) -> &Runner<Stage, Items> {
        &self.runner
    }

    /// Builds every pipeline that the engine can use now rather than when it is first needed.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses one.
    pub fn warm_up(&self) -> Result<()> {
        let width = self.subgroup_width();
        let enough = |lanes: u32| width.is_some_and(|width| lanes <= width);
        Ok(self.runner.warm_up(|shader, lanes| shader.subgroups == enough(lanes))?)
    }

    /// Device memory for a tube of that radius and that many points, which the host writes to
    /// [`FitWorkspace::section`].
    ///
    /// # Errors
    /// Where settings are invalid, and [`Error::Gpu`](crate::Error::Gpu) where the tube does not fit the device.
    pub fn prepare(&self, points: u32, radius_mm: f64, settings: &Settings) -> Result<FitWorkspace> {
        settings.validate()?;
        check_section(&Section::default(), radius_mm)?;
        let points = Points::Section { count: points };
        let plan = Plan::new(&self.runner.context, settings, 1, &points, false, self.subgroups)?;
        Ok(FitWorkspace::new(&self.runner.context, &self.runner.passes, plan, &[radius_mm], settings, None)?)
    }

    fn kept(&self) -> MutexGuard<'_, Vec<FitWorkspace>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Device memory for a batch, from an earlier one of like size where there is some.
    fn workspace(
        &self,
        settings: &Settings,
        radii_mm: &[f64],
        points: &Points,
        history: bool,
    ) -> Result<FitWorkspace, GpuError> {
        let Runner { context, passes, .. } = &self.runner;
        let cylinders = radii_mm.len() as u32;
        let plan = Plan::new(context, settings, cylinders, points, history, self.subgroups)?;
        let kept = {
            let mut kept = self.kept();
            let place = kept.iter().position(|kept| kept.suits(&plan, settings.iterations));
            place.map(|place| kept.remove(place))
        };
        FitWorkspace::new(context, passes, plan, radii_mm, settings, kept)
    }

    /// Keeps the memory of a batch that is done, and drops the oldest where that is too much.
    fn keep(&self, workspace: FitWorkspace) {
        let mut kept = self.kept();
        kept.push(workspace);
        while kept.len() > MOST_KEPT || kept.iter().map(FitWorkspace::bytes).sum::<u64>() > MOST_KEPT_BYTES {
            kept.remove(0);
        }
    }

    /// Records the whole fit of a workspace into a command encoder. Nothing is submitted.
    ///
    /// Nothing is read back either, so that [`GpuError::Unfinished`] is not detected: a host on a software driver
    /// keeps its faces below a million points, or fits through [`Engine`].
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses a pipeline.
    pub fn record(&self, workspace: &FitWorkspace, encoder: &mut wgpu::CommandEncoder) -> Result<()> {
        Ok(workspace.record(
            &self.runner.context,
            &self.runner.passes,
            encoder,
            CpuStages::None,
            false,
            &mut |_| None,
        )?)
    }

    /// As [`GpuEngine::record`], each pass in a compute pass of its own with the timestamps that `timer` gives
    /// for its name.
    ///
    /// # Errors
    /// As [`GpuEngine::record`].
    pub fn record_timed<'a>(
        &self,
        workspace: &FitWorkspace,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut (dyn FnMut(&'static str) -> Option<wgpu::ComputePassTimestampWrites<'a>> + 'a),
    ) -> Result<()> {
        let timer: &mut Timer<'a> = timer;
        Ok(workspace.record(
            &self.runner.context,
            &self.runner.passes,
            encoder,
            CpuStages::None,
            false,
            timer,
        )?)
    }

    /// Device memory for the cylinders of a request, one workspace per batch, with the points on the device.
    ///
    /// # Errors
    /// Where settings are invalid or a frame has no cylinder, and [`Error::Gpu`](crate::Error::Gpu) where a cylinder does not fit
    /// the device.
    pub fn prepare_request(&self, request: &FitRequest) -> Result<Vec<FitWorkspace>> {
        request.settings.validate()?;
        let mut workspaces = Vec::new();
        let without = self.each_batch(request, |batch| {
            workspaces.push(self.workspace_of(request, &batch)?);
            Ok(())
        })?;
        without.into_iter().next().map_or(Ok(workspaces), Err)
    }

    /// Runs one pass of a workspace alone on given buffer contents, and reads buffers back, so that a pass can be
    /// compared with its twin on identical inputs.
    ///
    /// Bytes of an output that the pass does not write, and that is no input, are 0x5a.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where there is no such pass or buffer, or the device fails.
    pub fn run_pass(
        &self,
        workspace: &FitWorkspace,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: &[&str],
    ) -> Result<Vec<Vec<u8>>> {
        let find = |name: &str| workspace.find(name);
        let read = self.runner.run_pass(pass, inputs, outputs, workspace.bytes(), find, |ready, encoder| {
            workspace.record_one(&self.runner.context, ready, encoder)
        });
        Ok(read?)
    }

    /// Runs the whole fit of a workspace and waits for it. Nothing is read back.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device fails.
    pub(crate) fn run_resident(&self, workspace: &FitWorkspace) -> Result<()> {
        let Runner { context, passes, .. } = &self.runner;
        let job = Job { bytes: workspace.bytes(), rounds: u64::from(workspace.iterations()) + 1 };
        self.runner.run(job, &[], |encoder, timer| {
            workspace.record(context, passes, encoder, CpuStages::None, false, timer)
        })?;
        Ok(())
    }

    /// The time that the whole fit of a workspace takes on the device, s.
    pub(crate) fn device_time_s(&self, workspace: &FitWorkspace) -> Result<f64> {
        let Runner { context, passes, .. } = &self.runner;
        let job = Job { bytes: workspace.bytes(), rounds: u64::from(workspace.iterations()) + 1 };
        Ok(self.runner.device_time_s(job, |encoder| {
            workspace.record(context, passes, encoder, CpuStages::None, false, &mut |_| None)
        })?)
    }

    /// Runs a workspace and reads its tubes back. With the sections of its cylinders, the CPU's stages run first.
    fn tubes(
        &self,
        workspace: &FitWorkspace,
        settings: &Settings,
        radii_mm: &[f64],
        history: bool,
        sections: Option<&[Section<f32>]>,
    ) -> Result<Vec<DeformedTube>, GpuError> {
        let Runner { context, passes, .. } = &self.runner;
        let done = match sections {
            None => CpuStages::None,
            Some(_) => self.cpu_stages.up_to(settings.iterations),
        };
        let progress = match sections {
            None => Vec::new(),
            Some(sections) => {
                stages::run_on_cpu(context, workspace, done, settings, radii_mm, history, sections)?
            }
        };
        let tube = Tube::new(settings);
        let (count, iterations) = (tube.node_count(), u64::from(settings.iterations));
        let cylinders = radii_mm.len() as u64;
        let nodes = cylinders * count as u64;
        let parts = [
            ("radii", 4 * nodes),
            ("support", 4 * nodes),
            ("residuals", 4 * nodes),
            ("travels", workspace.travel_stride() * iterations),
            ("tallies", 8 * cylinders),
            ("gated", 4 * cylinders),
            ("listed_faces", 4 * LIST_HEAD as u64),
            ("history", if history { 4 * nodes * (iterations + 1) } else { 0 }),
        ];
        let parts = parts.map(|(name, bytes)| (workspace.buffer(name), bytes));
        let job = Job { bytes: workspace.bytes(), rounds: iterations + 1 };
        let record = |encoder: &mut wgpu::CommandEncoder, timer: &mut Timer| {
            workspace.record(context, passes, encoder, done, history, timer)
        };
        let read = |views: &[&[u8]]| {
            // Every face with many points must have been measured in every iteration of the device.
            let [long, finished, narrow] = [0, 1, 3].map(|i| bytemuck::cast_slice::<u8, u32>(views[6])[i]);
            let expected = (long + narrow).wrapping_mul(settings.iterations - done.iterations());
            match finished == expected {
                true => {
                    Ok(Results::new(views, count, workspace.travel_stride()).tubes(tube, settings, radii_mm))
                }
                false => Err(GpuError::Unfinished { finished, expected }),
            }
        };
        let mut tubes = self.runner.run_and_read(job, &parts, record, read)??;
        for (tube, progress) in tubes.iter_mut().zip(progress) {
            progress.copy_into(tube);
        }
        Ok(tubes)
    }
}

/// The results of a batch in memory that the device wrote.
struct Results<'a> {
    radii: &'a [f32],
    support: &'a [u32],
    residuals: &'a [f32],
    travels: &'a [u32],
    tallies: &'a [u32],
    gated: &'a [u32],
    /// After each iteration those of all cylinders; empty unless asked for.
    history: &'a [f32],
    /// Nodes of a cylinder.
    count: usize,
    /// Words of `travels` per iteration.
    stride: usize,
}

/// Nodes that one thread converts at a time.
const PIECE: usize = 1 << 16;

fn to_f64(radii: &[f32]) -> Vec<f64> {
    radii.par_iter().with_min_len(PIECE).map(|&r| f64::from(r)).collect()
}

impl<'a> Results<'a> {
    fn new(views: &[&'a [u8]], count: usize, travel_stride: u64) -> Self {
        let (words, numbers) = (bytemuck::cast_slice::<u8, u32>, bytemuck::cast_slice::<u8, f32>);
        Self {
            radii: numbers(views[0]),
            support: words(views[1]),
            residuals: numbers(views[2]),
            travels: words(views[3]),
            tallies: words(views[4]),
            gated: words(views[5]),
            history: numbers(views[7]),
            count,
            stride: travel_stride as usize / 4,
        }
    }

    fn tubes(&self, tube: Tube, settings: &Settings, radii_mm: &[f64]) -> Vec<DeformedTube> {
        let of = |(cylinder, &radius_mm): (usize, &f64)| self.tube(cylinder, tube, settings, radius_mm);
        radii_mm.par_iter().enumerate().map(of).collect()
    }

    fn tube(&self, cylinder: usize, tube: Tube, settings: &Settings, radius_mm: f64) -> DeformedTube {
        let nodes = cylinder * self.count..(cylinder + 1) * self.count;
        let unit = DeviceCylinder::new(settings, radius_mm).unit;
        let [kept, points] = [0, 1].map(|i| u64::from(self.tallies[2 * cylinder + i]));
        let travel = |of_iteration: &[u32]| {
            let sum = i64::from(of_iteration[2 * cylinder + 1]) << 32 | i64::from(of_iteration[2 * cylinder]);
            f64::from(<f32 as Scalar>::mean_of(sum, unit, self.count as u32))
        };
        let (support, residuals) = (&self.support[nodes.clone()], &self.residuals[nodes.clone()]);
        let residuals = support.par_chunks(PIECE).zip(residuals.par_chunks(PIECE));
        DeformedTube {
            tube,
            radius_mm,
            radii_mm: to_f64(&self.radii[nodes.clone()]),
            history_mm: self
                .history
                .chunks(self.radii.len().max(1))
                .map(|of_iteration| to_f64(&of_iteration[nodes.clone()]))
                .collect(),
            travel_mm: self.travels.chunks(self.stride).map(travel).collect(),
            support: support.to_vec(),
            residual_mm: residuals.flat_map_iter(|(n, r)| residual_mm(n, r)).collect(),
            points,
            gated: u64::from(self.gated[cylinder]),
            rejected: if settings.iterations == 0 { 0 } else { points - kept },
        }
    }
}

/// Cylinders that are fitted together, and their pairs with frames.
#[derive(Default)]
struct Batch {
    /// Their frames.
    frames: Vec<usize>,
    radii_mm: Vec<f64>,
    pairs: Vec<DevicePair>,
    /// Points of all pairs.
    slots: u64,
    /// The track's points that its pairs refer to.
    points: Range<usize>,
}

/// Most pairs of a batch: 112 MB of them.
const MAX_PAIRS: usize = 1 << 20;
/// Cylinders whose pairs are found at a time, on all cores.
const FRAMES_AT_A_TIME: usize = 64;

impl Batch {
    fn add(&mut self, frame: usize, radius_mm: f64, pairs: &[NearFrame]) {
        let cylinder = self.frames.len() as u32;
        for pair in pairs {
            let (first, count) = (pair.echoes.start as u32, pair.echoes.len() as u32);
            // A batch of 2³² slots fits no device; the workspace refuses it.
            let slot = u32::try_from(self.slots).unwrap_or(u32::MAX);
            self.pairs.push(DevicePair::new(&pair.cylinder_from_probe, cylinder, first, count, slot));
            self.slots += u64::from(count);
        }
        self.frames.push(frame);
        self.radii_mm.push(radius_mm);
    }

    /// With its pairs' points counted from the batch's first.
    fn finished(mut self) -> Self {
        self.pairs.iter_mut().for_each(|pair| pair.first_point -= self.points.start as u32);
        self
    }
}

/// A cylinder's pairs: points of the track, and `cylTi`.
type Pairs = Vec<NearFrame>;

impl GpuEngine {
    /// Cuts a request into batches that fit the device, and hands them over one by one: where a catheter rests, each cylinder
    /// pairs with every frame before it, so that all pairs together can exceed any memory. Returns why frames have none.
    fn each_batch(
        &self,
        request: &FitRequest,
        mut hand_over: impl FnMut(Batch) -> Result<()>,
    ) -> Result<Vec<Error>> {
        let limits = self.runner.context.device.limits();
        let max_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let tube = Tube::new(request.settings);
        // The largest buffer of each kind: 16 bytes per slot and per face, 4 per node and iteration of the
        // history, and those of the pairs and their frames' points.
        let history = if request.history { 4 * (u64::from(request.settings.iterations) + 1) } else { 4 };
        let fits = |slots: u64, cylinders: u64, pairs: usize, points: &Range<usize>| {
            16 * slots <= max_bytes
                && 24 * cylinders * tube.face_count() as u64 <= max_bytes
                && history * cylinders * tube.node_count() as u64 <= limits.max_buffer_size
                && (size_of::<DevicePair>() * pairs) as u64 <= max_bytes
                && pairs <= MAX_PAIRS
                && 8 * points.len() as u64 <= max_bytes
                && cylinders <= 65_535
        };
        let span = |a: &Range<usize>, b: &Range<usize>| match (a.is_empty(), b.is_empty()) {
            (true, _) => b.clone(),
            (_, true) => a.clone(),
            _ => a.start.min(b.start)..a.end.max(b.end),
        };
        let near = |&frame: &usize| -> Result<(f64, Pairs)> {
            let radius_mm = request.track.cylinder(frame)?.radius_mm;
            Ok((radius_mm, request.track.near(frame, request.settings)?.collect()))
        };
        let mut without = Vec::new();
        let mut batch = Batch::default();
        for frames in request.frames.chunks(FRAMES_AT_A_TIME) {
            let near: Vec<Result<(f64, Pairs)>> = frames.par_iter().map(near).collect();
            for (&frame, near) in frames.iter().zip(near) {
                let (radius_mm, pairs) = match near {
                    Ok(near) => near,
                    Err(why) => {
                        without.push(why);
                        continue;
                    }
                };
                let own: u64 = pairs.iter().map(|p| p.echoes.len() as u64).sum();
                let own_points = pairs.iter().fold(0..0, |all, p| span(&all, &p.echoes));
                let cylinders = batch.frames.len() as u64 + 1;
                let all_points = span(&batch.points, &own_points);
                if !batch.frames.is_empty()
                    && !fits(batch.slots + own, cylinders, batch.pairs.len() + pairs.len(), &all_points)
                {
                    hand_over(std::mem::take(&mut batch).finished())?;
                }
                batch.add(frame, radius_mm, &pairs);
                batch.points = span(&batch.points, &own_points);
            }
        }
        if !batch.frames.is_empty() {
            hand_over(batch.finished())?;
        }
        Ok(without)
    }

    fn workspace_of(&self, request: &FitRequest, batch: &Batch) -> Result<FitWorkspace> {
        let to_f32 = |p: &glam::DVec2| [p.x as f32, p.y as f32];
        let echoes = &request.track.echoes_mm()[batch.points.clone()];
        let points: Vec<[f32; 2]> = echoes.par_iter().with_min_len(PIECE).map(to_f32).collect();
        let of_batch = Points::Pairs { points: points.len(), pairs: &batch.pairs };
        let workspace = self.workspace(request.settings, &batch.radii_mm, &of_batch, request.history)?;
        workspace.write(&self.runner.context, "points", bytemuck::cast_slice(&points))?;
        workspace.write(&self.runner.context, "pairs", bytemuck::cast_slice(&batch.pairs))?;
        Ok(workspace)
    }

    /// The sections of a batch's cylinders, from the CPU.
    fn sections(&self, request: &FitRequest, batch: &Batch) -> Result<Vec<Section<f32>>> {
        batch.frames.par_iter().map(|&k| request.track.section(k, request.settings)).collect()
    }

    fn fit_batch(&self, request: &FitRequest, batch: &Batch) -> Result<Vec<Result<FittedCylinder>>> {
        let workspace = self.workspace_of(request, batch)?;
        let sections = match self.cpu_stages {
            CpuStages::None => None,
            _ => Some(self.sections(request, batch)?),
        };
        let (settings, radii_mm) = (request.settings, &batch.radii_mm);
        let tubes = self.tubes(&workspace, settings, radii_mm, request.history, sections.as_deref())?;
        self.keep(workspace);
        let fitted = tubes.into_iter().zip(&batch.frames).map(|(tube, &frame)| {
            if tube.points == 0 {
                return Err(empty_section(frame, tube.radius_mm, tube.gated, request.settings));
            }
            let world_from_cylinder = request.track.cylinder(frame)?.world_from_cylinder;
            Ok(FittedCylinder { frame, world_from_cylinder, tube })
        });
        Ok(fitted.collect())
    }
}

impl GpuEngine {
    /// `gpu`, and its adapter unless the device is a host's.
    pub fn describe(&self) -> EngineDescription {
        EngineDescription { name: "gpu".into(), adapter: self.runner.describe(), why: None }
    }
}

impl Sealed for GpuEngine {}

impl Engine for GpuEngine {
    fn fit(&self, request: &FitRequest) -> Result<Fit> {
        let mut fitted = Vec::with_capacity(request.frames.len());
        let without = self.each_batch(request, |batch| {
            fitted.extend(self.fit_batch(request, &batch)?);
            unless_cancelled((request.progress)(batch.frames.len()))
        })?;
        if !without.is_empty() {
            unless_cancelled((request.progress)(without.len()))?;
        }
        Fit::of(fitted.into_iter().chain(without.into_iter().map(Err)), self.describe())
    }

    fn fit_section(&self, section: &Section<f32>, radius_mm: f64, settings: &Settings) -> Result<SectionFit> {
        check_section(section, radius_mm)?;
        let count = u32::try_from(section.len()).map_err(|_| GpuError::TooLarge {
            name: "section".into(),
            needed: 12 * section.len() as u64,
            allowed: 12 * u64::from(u32::MAX),
        })?;
        settings.validate()?;
        let start = Instant::now();
        let points = Points::Section { count };
        let workspace = self.workspace(settings, &[radius_mm], &points, false)?;
        let memory_s = start.elapsed().as_secs_f64();
        let coordinates = [&section.r, &section.theta, &section.z].map(|of_all| bytemuck::cast_slice(of_all));
        self.runner.context.write_parts(workspace.section(), &coordinates)?;
        let filling_s = start.elapsed().as_secs_f64() - memory_s;
        self.runner.spend(Spent { memory_s, filling_s, ..Spent::default() });
        let sections = (self.cpu_stages != CpuStages::None).then(|| std::slice::from_ref(section));
        let mut tubes = self.tubes(&workspace, settings, &[radius_mm], false, sections)?;
        self.keep(workspace);
        let Some(mut tube) = tubes.pop() else {
            return Err(GpuError::Lost { reason: "no result".into() }.into());
        };
        tube.gated = section.gated;
        Ok(SectionFit { tube, engine: self.describe() })
    }
}
