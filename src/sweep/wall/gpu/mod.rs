//! The wall's fit on the device: passes over echoes and nodes, whose twins are in [`passes`](super::passes).

mod pass;
mod workspace;

pub use pass::{Items, PASSES, Pass, Stage};
pub use workspace::WallWorkspace;

use crate::Result;
use crate::engine::EngineDescription;
use crate::gpu::{AdapterDescription, Context, GpuError, Job, PassTimes, Runner, Spent, Timer};
use crate::recording::echo_error::OUT_OF_PLANE;
use crate::sweep::prepare::{echo, grid::WallGrid};
use crate::sweep::wall::fit::{Reweighting, Solution, WallEngine};
use crate::sweep::wall::passes::{CONVERGED, DeviceEcho, State, WallParameters};
use crate::sweep::wall::solver::{MAX_STEPS, Solved};
use rayon::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Steps of conjugate gradients that are submitted at once: where nothing is known of how many it takes, and at most. Steps
/// after convergence do nothing, but cost a few microseconds for each of their passes.
const USUAL_STEPS: usize = 10;
const MOST_STEPS: usize = 32;

/// Stages that are recorded before the device begins with them: some three steps of the solver.
const STAGES_PER_SUBMISSION: usize = 40;

/// Echoes or nodes that a thread reads at a time.
const PIECE: usize = 8192;

/// Indices of the sums are u32, five per node.
const MAX_NODES: usize = (u32::MAX / 5) as usize;

/// A pass made ready on a device.
type ReadyPass = crate::gpu::ReadyPass<Stage, Items>;

/// Fits walls on a device.
pub struct GpuWallEngine {
    runner: Runner<Stage, Items>,
    /// Device memory of earlier walls, at most [`MOST_KEPT`] workspaces of [`MOST_KEPT_BYTES`] in all.
    kept: Mutex<Vec<WallWorkspace>>,
}

/// Most workspaces that an engine keeps for later walls: one for each of a few threads.
const MOST_KEPT: usize = 4;
/// Most device memory that an engine keeps for later walls, bytes.
const MOST_KEPT_BYTES: u64 = 1 << 30;

impl GpuWallEngine {
    /// The engine on the adapter whose name contains `adapter` (without regard to case), or on the best one.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where there is no such adapter or it refuses a shader.
    pub fn new(adapter: Option<&str>) -> Result<Self> {
        Self::on(Context::new(adapter)?)
    }

    /// The engine on a host's device, which must meet [`Requirements`](crate::gpu::Requirements). The host's
    /// error handlers stay in place.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses a shader.
    pub fn on_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        Self::on(Context::of_host(device, queue))
    }

    fn on(context: Context) -> Result<Self> {
        Ok(Self { runner: Runner::new(context, &PASSES)?, kept: Mutex::default() })
    }

    /// The adapter, where the engine chose it.
    pub fn adapter(&self) -> Option<&AdapterDescription> {
        self.runner.adapter()
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.runner.context.device
    }

    /// The engine's description for a report.
    pub fn describe(&self) -> EngineDescription {
        EngineDescription { name: "gpu".into(), adapter: self.runner.describe(), why: None }
    }

    /// Builds every pipeline now rather than when it is first needed.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses one.
    pub fn warm_up(&self) -> Result<()> {
        Ok(self.runner.warm_up(|_, _| true)?)
    }

    /// Does some work and returns with it the device time of each of its passes, in seconds, in the order of
    /// their names. There are no times where the device has no timestamps.
    ///
    /// # Errors
    /// The work's.
    pub fn timed<R>(&self, work: impl FnOnce(&Self) -> Result<R>) -> Result<(R, PassTimes)> {
        self.runner.timed(|| work(self))
    }

    /// What the work of this engine took since this was last asked.
    pub(crate) fn take_spent(&self) -> Spent {
        self.runner.take_spent()
    }

    /// Device memory for a wall and the echoes about it.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where they do not fit the device.
    pub fn prepare(&self, parameters: &WallParameters, echoes: &[DeviceEcho]) -> Result<WallWorkspace> {
        let Runner { context, passes, .. } = &self.runner;
        let workspace = WallWorkspace::new(context, passes, parameters, echoes.len(), None)?;
        workspace.write_echoes(context, echoes, |echo| *echo)?;
        Ok(workspace)
    }

    fn kept(&self) -> MutexGuard<'_, Vec<WallWorkspace>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps the memory of a wall that is done, and drops the oldest where that is too much.
    fn keep(&self, workspace: WallWorkspace) {
        let mut kept = self.kept();
        kept.push(workspace);
        while kept.len() > MOST_KEPT || kept.iter().map(WallWorkspace::bytes).sum::<u64>() > MOST_KEPT_BYTES {
            kept.remove(0);
        }
    }

    /// Runs one pass of a workspace alone on given buffer contents, and reads buffers back, so that a pass
    /// can be compared with its twin on identical inputs. A pass over the grids of the multigrid cycle runs on each of
    /// them, the finest first. Of buffers that every chunk has, the first chunk's are meant.
    ///
    /// Bytes of an output that the pass does not write, and that is no input, are 0x5a.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where there is no such pass or buffer, or the device fails.
    pub fn run_pass(
        &self,
        workspace: &WallWorkspace,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: &[&str],
    ) -> Result<Vec<Vec<u8>>> {
        let find = |name: &str| workspace.find(name);
        let read = self.runner.run_pass(pass, inputs, outputs, workspace.bytes(), find, |ready, encoder| {
            let levels = workspace.levels_of(ready.pass.items);
            let passes = levels.map(|level| (ready, level));
            workspace.record(&self.runner.context, passes, encoder, &mut |_| None)
        });
        Ok(read?)
    }

    /// The passes of stages over grids, in their order.
    fn passes(&self, stages: &[(Stage, usize)]) -> impl Iterator<Item = (&ReadyPass, usize)> {
        let of = |&(stage, level): &(Stage, usize)| {
            let passes = self.runner.passes.iter().filter(move |ready| ready.pass.stage == stage);
            passes.map(move |ready| (ready, level))
        };
        stages.iter().flat_map(of).collect::<Vec<_>>().into_iter()
    }

    /// A wall and echoes on the device.
    pub(in crate::sweep) fn wall<'a>(
        &'a self,
        grid: &'a WallGrid,
        echoes: &'a mut [echo::Echo],
        start_mm: f64,
    ) -> Result<OnDevice<'a>> {
        if grid.node_count() > MAX_NODES {
            let what = format!("a wall of {} nodes", grid.node_count());
            return Err(GpuError::Refused { what, reason: format!("{MAX_NODES} at most") }.into());
        }
        let (rings, nodes) = (grid.rings as u32, grid.nodes as u32);
        let Runner { context, passes, .. } = &self.runner;
        let parameters = WallParameters {
            // A program on the CPU has few threads. A host's device says what it is, too: sums must not depend on who made it.
            low_tiles: u32::from(context.device.adapter_info().device_type != wgpu::DeviceType::Cpu),
            ..WallParameters::new([rings, nodes], [grid.step_mm, grid.arc_mm], start_mm, OUT_OF_PLANE)
        };
        let start = Instant::now();
        let kept = {
            let mut kept = self.kept();
            let place = kept.iter().position(|kept| kept.suits(context, &parameters, echoes.len()));
            place.map(|place| kept.remove(place))
        };
        let workspace = WallWorkspace::new(context, passes, &parameters, echoes.len(), kept)?;
        let memory_s = start.elapsed().as_secs_f64();
        workspace.write_echoes(context, echoes, |echo| echo.for_device(grid, start_mm))?;
        let filling_s = start.elapsed().as_secs_f64() - memory_s;
        self.runner.spend(Spent { memory_s, filling_s, ..Spent::default() });
        Ok(OnDevice { engine: self, workspace, grid, echoes, start_mm, steps: USUAL_STEPS })
    }
}

/// The fit on a device.
pub(in crate::sweep) struct OnDevice<'a> {
    engine: &'a GpuWallEngine,
    workspace: WallWorkspace,
    grid: &'a WallGrid,
    echoes: &'a mut [echo::Echo],
    start_mm: f64,
    /// Steps of the solver to submit at first.
    steps: usize,
}

/// The passes that evaluate the residuals.
const MEASURING: [(Stage, usize); 5] = [
    (Stage::Measure, 0),
    (Stage::MedianDigit, 0),
    (Stage::MedianDigit, 0),
    (Stage::MedianDigit, 0),
    (Stage::MedianDigit, 0),
];

impl WallEngine for OnDevice<'_> {
    fn measure(&mut self, noise_mm: f64, project: bool) -> Result<f64> {
        let parameters = WallParameters {
            project: u32::from(project),
            ..self.workspace.parameters().with_noise(noise_mm)
        };
        // The wall is given.
        self.begin(&parameters, CONVERGED)?;
        let (state, _) = self.run(&[], &MEASURING)?;
        median(&state)
    }

    fn solve(&mut self, reweighting: &Reweighting) -> Result<Solution> {
        let parameters = WallParameters {
            gated: u32::from(!reweighting.warm_up),
            project: u32::from(reweighting.project),
            tolerance_square: (reweighting.tolerance * reweighting.tolerance) as f32,
            max_steps: MAX_STEPS as u32,
            ..*self.workspace.parameters()
        }
        .with_noise(reweighting.noise_mm)
        .with_smoothness(reweighting.smoothness_mm2);
        self.begin(&parameters, 0)?;
        let coarsen = (0..self.workspace.level_count() - 1).map(|level| (Stage::Coarsen, level));
        let cycle = self.cycle();
        let before: Vec<_> = std::iter::once((Stage::Equations, 0))
            .chain(coarsen)
            .chain([(Stage::RightHandSide, 0)])
            .chain(cycle.iter().copied())
            .chain([(Stage::Limit, 0)])
            .collect();
        let steps = |count: usize| {
            let step = [&cycle[..], &[(Stage::Step, 0)]].concat();
            // These do nothing where more steps are needed.
            [&step.repeat(count)[..], &[(Stage::Move, 0)], &MEASURING].concat()
        };
        let mut submitted = self.steps;
        let (mut state, mut travels) = self.run(&before, &steps(submitted))?;
        // The last step only tests whether the one before sufficed.
        while state.done == 0 && submitted <= MAX_STEPS {
            submitted += USUAL_STEPS;
            (state, travels) = self.run(&[], &steps(USUAL_STEPS))?;
        }
        let taken = state.steps as usize;
        if !state.is_solved() {
            let found = format!("residual square {} after {taken} steps", state.residual_square);
            return Err(GpuError::Wrong { what: "wall equations", found }.into());
        }
        self.steps = (taken + 2).min(MOST_STEPS);
        let [travel, weight] = travels
            .chunks_exact(2)
            .fold([0.0; 2], |[a, b], pair| [a + f64::from(pair[0]), b + f64::from(pair[1])]);
        let travel_mm = travel / weight.max(f64::MIN_POSITIVE);
        if !travel_mm.is_finite() {
            return Err(GpuError::Wrong { what: "travel of the nodes", found: travel_mm.to_string() }.into());
        }
        let solved = Solved { steps: taken, converged: state.done == CONVERGED };
        Ok(Solution { travel_mm, solved, residual_mm: median(&state)? })
    }

    fn finish(self) -> Result<Vec<f64>> {
        let Self { engine, workspace, grid, echoes, start_mm, .. } = self;
        let of_each = |name, bytes: u64| {
            let buffers = workspace.of_chunks(name).into_iter();
            buffers.zip(workspace.echo_counts()).map(move |(buffer, count)| (buffer, bytes * count as u64))
        };
        let parts: Vec<(&wgpu::Buffer, u64)> =
            std::iter::once((workspace.shared("wall"), 4 * grid.node_count() as u64))
                .chain(of_each("shifts", 8))
                .chain(of_each("residuals", 4))
                .collect();
        let job = Job { bytes: workspace.bytes(), rounds: 1 };
        let radii_mm = engine.runner.run_and_read(
            job,
            &parts,
            |_, _| Ok(()),
            |views| {
                let (shifts, residuals) = views[1..].split_at(workspace.chunk_count());
                let mut left = &mut echoes[..];
                for ((shifts, residuals), count) in shifts.iter().zip(residuals).zip(workspace.echo_counts())
                {
                    let echoes = left.split_off_mut(..count).unwrap_or_default();
                    let shifts = shifts.par_chunks(8 * PIECE);
                    let residuals = residuals.par_chunks(4 * PIECE);
                    echoes.par_chunks_mut(PIECE).zip(shifts).zip(residuals).for_each(|((echoes, s), r)| {
                        for ((echo, shift), residual) in
                            echoes.iter_mut().zip(s.chunks_exact(8)).zip(r.chunks_exact(4))
                        {
                            let shift: [f32; 2] = bytemuck::pod_read_unaligned(shift);
                            let residual: f32 = bytemuck::pod_read_unaligned(residual);
                            echo.set_residual(shift, f64::from(residual));
                        }
                    });
                }
                let rise = |bytes| f64::from(bytemuck::pod_read_unaligned::<f32>(bytes));
                views[0].par_chunks_exact(4).with_min_len(PIECE).map(|bytes| start_mm + rise(bytes)).collect()
            },
        )?;
        engine.keep(workspace);
        Ok(radii_mm)
    }
}

impl OnDevice<'_> {
    /// Sets the parameters of the passes, and a state in which the solver has ended as `done` says.
    fn begin(&mut self, parameters: &WallParameters, done: u32) -> Result<()> {
        let context = &self.engine.runner.context;
        self.workspace.set_parameters(context, parameters)?;
        let state = State { rank: (self.echoes.len() / 2) as u32, done, ..State::default() };
        Ok(context.write(self.workspace.shared("state"), bytemuck::bytes_of(&state))?)
    }

    /// Runs the passes of `equations`, which leave their residual where `apply` leaves products, hands that to the solver,
    /// and runs those of `stages`; without equations the latter only. Returns the state and the partial sums of what nodes travelled.
    fn run(&self, equations: &[(Stage, usize)], stages: &[(Stage, usize)]) -> Result<(State, Vec<f32>)> {
        let Self { engine, workspace, .. } = self;
        let context = &engine.runner.context;
        let nodes = workspace.parameters().node_count;
        let [state, travels, product, rights] =
            ["state", "travels", "product", "rights"].map(|name| workspace.shared(name));
        let parts = [(state, size_of::<State>() as u64), (travels, 8 * u64::from(nodes.div_ceil(256)))];
        let job = Job { bytes: workspace.bytes(), rounds: (equations.len() + stages.len()) as u64 };
        let record = |encoder: &mut wgpu::CommandEncoder, timer: &mut Timer| {
            if !equations.is_empty() {
                for name in ["sums_low", "sums_high"] {
                    encoder.clear_buffer(workspace.shared(name), 0, None);
                }
                workspace.record(context, engine.passes(equations), encoder, timer)?;
                encoder.copy_buffer_to_buffer(product, 0, rights, 0, Some(4 * u64::from(nodes)));
            }
            for stages in stages.chunks(STAGES_PER_SUBMISSION) {
                // The device begins with what is recorded while the CPU records what follows.
                let next = context.device.create_command_encoder(&Default::default());
                context.queue.submit([std::mem::replace(encoder, next).finish()]);
                workspace.record(context, engine.passes(stages), encoder, timer)?;
            }
            Ok(())
        };
        let read = |views: &[&[u8]]| {
            (bytemuck::pod_read_unaligned(views[0]), bytemuck::pod_collect_to_vec(views[1]))
        };
        Ok(engine.runner.run_and_read(job, &parts, record, read)?)
    }

    /// The multigrid cycle.
    fn cycle(&self) -> Vec<(Stage, usize)> {
        let large = self.workspace.large_levels();
        let descend = (0..large).map(|level| (Stage::Descend, level));
        let ascend = (0..large).rev().map(|level| (Stage::Ascend, level));
        descend.chain([(Stage::Coarse, large)]).chain(ascend).collect()
    }
}

/// The median of |residual| that a state has, mm.
fn median(state: &State) -> Result<f64> {
    let residual_mm = f32::from_bits(state.prefix);
    if state.digits != 4 || !residual_mm.is_finite() {
        let found = format!("{residual_mm} mm");
        return Err(GpuError::Wrong { what: "median residual", found }.into());
    }
    Ok(f64::from(residual_mm))
}
