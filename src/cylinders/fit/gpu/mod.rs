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
use crate::cylinders::passes::{DeviceCylinder, DevicePair, Section};
use crate::cylinders::track::{NearFrame, empty_section};
use crate::cylinders::tube::Tube;
use crate::gpu::{AdapterDescription, Context, GpuError, Job, Runner, Timer};
use crate::settings::Settings;
use crate::{Error, Result};
use rayon::prelude::*;
use std::ops::Range;
use workspace::Points;

/// A pass made ready on a device.
type ReadyPass = crate::gpu::ReadyPass<Stage, Items>;

/// Fits cylinders on the device.
pub struct GpuEngine {
    runner: Runner<Stage, Items>,
    cpu_stages: CpuStages,
}

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
        Ok(Self { runner: Runner::new(context, &PASSES)?, cpu_stages: CpuStages::None })
    }

    /// The same engine, but [`fit`](Engine::fit) and [`fit_section`](Engine::fit_section) compute the first
    /// stages on the CPU. Where a device's result differs from the CPU's, the first stage that has to run on the
    /// CPU for the results to agree is the one that diverges.
    #[must_use]
    pub fn with_cpu_stages(mut self, stages: CpuStages) -> Self {
        self.cpu_stages = stages;
        self
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

    /// Builds every pipeline now rather than when it is first needed.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses one.
    pub fn warm_up(&self) -> Result<()> {
        Ok(self.runner.warm_up()?)
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
        Ok(FitWorkspace::new(
            &self.runner.context,
            &self.runner.passes,
            settings,
            &[radius_mm],
            &points,
            false,
        )?)
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
        self.run(workspace, &[], |encoder, timer| {
            workspace.record(context, passes, encoder, CpuStages::None, false, timer)
        })?;
        Ok(())
    }

    /// Submits what `record` records and reads some of a workspace's buffers back, whole.
    fn run(
        &self,
        workspace: &FitWorkspace,
        names: &[&str],
        record: impl FnOnce(&mut wgpu::CommandEncoder, &mut Timer) -> Result<(), GpuError>,
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        let buffers: Vec<&wgpu::Buffer> = names.iter().map(|name| workspace.buffer(name)).collect();
        let job = Job { bytes: workspace.bytes(), rounds: u64::from(workspace.iterations()) + 1 };
        self.runner.run(job, &buffers, record)
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
        let done = match sections {
            None => CpuStages::None,
            Some(_) => self.cpu_stages.up_to(settings.iterations),
        };
        let progress = match sections {
            None => Vec::new(),
            Some(sections) => stages::run_on_cpu(
                &self.runner.context,
                workspace,
                done,
                settings,
                radii_mm,
                history,
                sections,
            )?,
        };
        let names = ["radii", "support", "residuals", "travels", "tallies", "gated", "long_faces", "history"];
        let names = if history { &names[..] } else { &names[..7] };
        let read = self.run(workspace, names, |encoder, timer| {
            workspace.record(&self.runner.context, &self.runner.passes, encoder, done, history, timer)
        })?;
        let words = |k: usize| bytemuck::pod_collect_to_vec::<u8, u32>(&read[k]);
        let numbers = |k: usize| bytemuck::pod_collect_to_vec::<u8, f32>(&read[k]);
        let (radii, support, residuals) = (numbers(0), words(1), numbers(2));
        let (travels, tallies, gated) = (words(3), words(4), words(5));
        let history_radii = if history { numbers(7) } else { Vec::new() };
        // Every long face must have been measured in every iteration of the device.
        let long_faces = words(6);
        let (listed, finished) = (long_faces[0], long_faces[long_faces.len() - 1]);
        let expected = listed.wrapping_mul(settings.iterations - done.iterations());
        if finished != expected {
            return Err(GpuError::Unfinished { finished, expected });
        }
        let tube = Tube::new(settings);
        let (count, iterations) = (tube.node_count(), settings.iterations as usize);
        let stride = workspace.travel_stride() as usize / 4;
        let to_f64 = |r: &[f32]| r.iter().map(|&r| f64::from(r)).collect::<Vec<f64>>();
        let mut tubes: Vec<DeformedTube> = radii_mm
            .iter()
            .enumerate()
            .map(|(c, &radius_mm)| {
                let nodes = c * count..(c + 1) * count;
                let unit = DeviceCylinder::new(settings, radius_mm).unit;
                let (kept, points) = (u64::from(tallies[2 * c]), u64::from(tallies[2 * c + 1]));
                let travel = |i: usize| {
                    let (low, high) = (travels[i * stride + 2 * c], travels[i * stride + 2 * c + 1]);
                    let sum = i64::from(high) << 32 | i64::from(low);
                    f64::from(<f32 as crate::numerics::Scalar>::mean_of(sum, unit, count as u32))
                };
                DeformedTube {
                    tube,
                    radius_mm,
                    radii_mm: to_f64(&radii[nodes.clone()]),
                    history_mm: if history {
                        let all = radii_mm.len() * count;
                        (0..=iterations).map(|i| to_f64(&history_radii[i * all..][nodes.clone()])).collect()
                    } else {
                        Vec::new()
                    },
                    travel_mm: (0..iterations).map(travel).collect(),
                    support: support[nodes.clone()].to_vec(),
                    residual_mm: residual_mm(&support[nodes.clone()], &residuals[nodes]),
                    points,
                    gated: u64::from(gated[c]),
                    rejected: if iterations == 0 { 0 } else { points - kept },
                }
            })
            .collect();
        for (tube, progress) in tubes.iter_mut().zip(progress) {
            progress.copy_into(tube);
        }
        Ok(tubes)
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
        // The largest buffer of each kind: 12 bytes per slot, 24 per face, 4 per node and iteration of the
        // history, and those of the pairs and their frames' points.
        let history = if request.history { 4 * (u64::from(request.settings.iterations) + 1) } else { 4 };
        let fits = |slots: u64, cylinders: u64, pairs: usize, points: &Range<usize>| {
            12 * slots <= max_bytes
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
        let points: Vec<[f32; 2]> = request.track.echoes_mm()[batch.points.clone()]
            .iter()
            .map(|p| [p.x as f32, p.y as f32])
            .collect();
        let points = Points::Pairs { points: &points, pairs: &batch.pairs };
        let (context, passes) = (&self.runner.context, &self.runner.passes);
        Ok(FitWorkspace::new(context, passes, request.settings, &batch.radii_mm, &points, request.history)?)
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
            (request.progress)(batch.frames.len());
            Ok(())
        })?;
        if !without.is_empty() {
            (request.progress)(without.len());
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
        let workspace = self.prepare(count, radius_mm, settings)?;
        let rows: Vec<[f32; 3]> =
            (0..section.len()).map(|i| [section.r[i], section.theta[i], section.z[i]]).collect();
        workspace.write(&self.runner.context, "section", bytemuck::cast_slice(&rows));
        let sections = (self.cpu_stages != CpuStages::None).then(|| std::slice::from_ref(section));
        let mut tubes = self.tubes(&workspace, settings, &[radius_mm], false, sections)?;
        let Some(mut tube) = tubes.pop() else {
            return Err(GpuError::Lost { reason: "no result".into() }.into());
        };
        tube.gated = section.gated;
        Ok(SectionFit { tube, engine: self.describe() })
    }
}
