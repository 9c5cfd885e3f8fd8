//! The wall's fit on the device: passes over echoes and nodes, whose twins are in [`passes`](super::passes).

mod pass;
mod workspace;

pub use pass::{Items, PASSES, Pass, Stage};
pub use workspace::WallWorkspace;

use crate::Result;
use crate::engine::EngineDescription;
use crate::gpu::{AdapterDescription, Context, GpuError, Job, PassTimes, Runner, Spent};
use crate::numerics::banded::Dissected;
use crate::recording::echo_error::OUT_OF_PLANE;
use crate::sweep::prepare::{echo, grid::WallGrid};
use crate::sweep::wall::bending::LocalSmoothness;
use crate::sweep::wall::fit::{Reweighting, Solution, WallEngine};
use crate::sweep::wall::passes::{CONVERGED, DeviceEcho, Factors, State, WallParameters};
use crate::sweep::wall::solver::{MAX_STEPS, Solved};
use rayon::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Largest relative change of the rings' weights and of λ for which the factors of the preconditioner are kept.
const MAX_CHANGE: f64 = 0.1;

/// Steps of conjugate gradients between two tests of convergence on the CPU. Steps after convergence do
/// nothing.
const STEPS_PER_SUBMISSION: usize = 10;

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
    /// can be compared with its twin on identical inputs. Of buffers that every chunk has, the first chunk's
    /// are meant.
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
            workspace.record(&self.runner.context, [ready], encoder, &mut |_| None)
        });
        Ok(read?)
    }

    /// Runs the passes of some stages, one after the other, after the commands that `prepare` records, and
    /// reads buffers back.
    fn run(
        &self,
        workspace: &WallWorkspace,
        stages: &[Stage],
        buffers: &[&wgpu::Buffer],
        prepare: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        let Runner { context, passes, .. } = &self.runner;
        let of = |stage: Stage| passes.iter().filter(move |ready| ready.pass.stage == stage);
        let job = Job { bytes: workspace.bytes(), rounds: stages.len() as u64 };
        self.runner.run(job, buffers, |encoder, timer| {
            prepare(encoder);
            workspace.record(context, stages.iter().copied().flat_map(of), encoder, timer)
        })
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
        let parameters = WallParameters::new(rings, nodes, start_mm, OUT_OF_PLANE);
        let Runner { context, passes, .. } = &self.runner;
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
        Ok(OnDevice { engine: self, workspace, grid, echoes, start_mm, factored: None, steps: 0 })
    }
}

/// The fit on a device.
pub(in crate::sweep) struct OnDevice<'a> {
    engine: &'a GpuWallEngine,
    workspace: WallWorkspace,
    grid: &'a WallGrid,
    echoes: &'a mut [echo::Echo],
    start_mm: f64,
    /// The weights of the rings and λ, mm², for which the device has the preconditioner's factors.
    factored: Option<(Vec<f64>, f64)>,
    /// Steps that the last equations took.
    steps: usize,
}

impl WallEngine for OnDevice<'_> {
    fn measure(&mut self, noise_mm: f64, project: bool) -> Result<f64> {
        let context = &self.engine.runner.context;
        let parameters = WallParameters {
            project: u32::from(project),
            ..self.workspace.parameters().with_noise(noise_mm)
        };
        self.workspace.set_parameters(context, &parameters)?;
        let state = State { rank: (self.echoes.len() / 2) as u32, ..State::default() };
        let of_device = self.workspace.shared("state");
        context.write(of_device, bytemuck::bytes_of(&state))?;
        let digit = Stage::MedianDigit;
        let stages = [Stage::Measure, digit, digit, digit, digit];
        let read = self.engine.run(&self.workspace, &stages, &[of_device], |_| ())?;
        let state: State = bytemuck::pod_read_unaligned(&read[0]);
        let residual_mm = f32::from_bits(state.prefix);
        if state.digits != 4 || !residual_mm.is_finite() {
            return Err(
                GpuError::Wrong { what: "median residual", found: format!("{residual_mm} mm") }.into()
            );
        }
        Ok(f64::from(residual_mm))
    }

    fn solve(&mut self, reweighting: &Reweighting) -> Result<Solution> {
        let (engine, context, grid) = (self.engine, &self.engine.runner.context, self.grid);
        let parameters =
            WallParameters { gated: u32::from(!reweighting.warm_up), ..*self.workspace.parameters() }
                .with_noise(reweighting.noise_mm)
                .with_smoothness(reweighting.smoothness_mm2, grid.step_mm, grid.arc_mm);
        self.workspace.set_parameters(context, &parameters)?;
        let sums = ["sums_low", "sums_high"].map(|name| self.workspace.shared(name));
        let ring_weights = self.workspace.shared("ring_weights");
        let read = engine.run(&self.workspace, &[Stage::Equations], &[ring_weights], |encoder| {
            sums.iter().for_each(|sums| encoder.clear_buffer(sums, 0, None));
        })?;
        let ring_weights: Vec<f64> = bytemuck::pod_collect_to_vec::<u8, f32>(&read[0])
            .into_iter()
            .take(grid.rings)
            .map(f64::from)
            .collect();

        // In f64 and on the CPU, where nearly singular systems stay positive definite: without echoes on a
        // ring, only the wall's bending determines it.
        let smoothness_mm2 = reweighting.smoothness_mm2;
        if !self.factored.as_ref().is_some_and(|(weights, smoothness)| {
            alike(&[*smoothness], &[smoothness_mm2]) && alike(weights, &ring_weights)
        }) {
            let factors = factors(grid, &parameters, ring_weights.clone(), smoothness_mm2);
            let weight = || ring_weights.iter().sum::<f64>().to_string();
            let factors =
                factors.ok_or_else(|| GpuError::Wrong { what: "weights of the rings", found: weight() })?;
            context.write(self.workspace.shared("factors"), bytemuck::cast_slice(&factors.rings))?;
            context.write(self.workspace.shared("separators"), bytemuck::cast_slice(&factors.separators))?;
            self.factored = Some((ring_weights, smoothness_mm2));
        }
        // The right-hand side for whole radii, in the preconditioner's norm: the reference of the relative
        // residual.
        context.write(self.workspace.shared("state"), bytemuck::bytes_of(&State::default()))?;
        let stages = [Stage::RightHandSide, Stage::Precondition];
        let partials = self.partials(&stages, self.workspace.frequency_groups())?;
        let whole: f64 = partials.into_iter().map(f64::from).sum();
        let max_residual_square = (reweighting.tolerance * reweighting.tolerance * whole) as f32;
        self.workspace.set_parameters(context, &WallParameters { max_residual_square, ..parameters })?;
        let solved = self.conjugate_gradients()?;
        self.steps = solved.steps;

        let partials = self.partials(&[Stage::Move], 2 * grid.node_count().div_ceil(256))?;
        let [travel, weight] = partials
            .chunks_exact(2)
            .fold([0.0; 2], |[a, b], pair| [a + f64::from(pair[0]), b + f64::from(pair[1])]);
        let travel_mm = travel / weight.max(f64::MIN_POSITIVE);
        if !travel_mm.is_finite() {
            return Err(GpuError::Wrong { what: "travel of the nodes", found: travel_mm.to_string() }.into());
        }
        Ok(Solution { travel_mm, solved })
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
                            echo.set_residual(shift.map(f64::from), f64::from(residual));
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
    /// Runs stages and returns the partial sums of the last pass.
    fn partials(&self, stages: &[Stage], count: usize) -> Result<Vec<f32>> {
        let read = self.engine.run(&self.workspace, stages, &[self.workspace.shared("partials")], |_| ())?;
        let mut partials = bytemuck::pod_collect_to_vec::<u8, f32>(&read[0]);
        partials.truncate(count);
        Ok(partials)
    }

    /// Conjugate gradients until convergence, or until the steps run out.
    fn conjugate_gradients(&self) -> Result<Solved> {
        let [state, residual, product] =
            ["state", "cg_residual", "product"].map(|name| self.workspace.shared(name));
        let mut submitted = 0;
        while submitted < MAX_STEPS {
            let first = submitted == 0;
            // At first as many as the last equations took and a test of convergence, so that one look suffices.
            let wanted = if first { self.steps + 1 } else { 0 };
            let more = wanted.clamp(STEPS_PER_SUBMISSION, MAX_STEPS).min(MAX_STEPS - submitted);
            submitted += more;
            let steps = [Stage::Precondition, Stage::Step].repeat(more);
            let read = self.engine.run(&self.workspace, &steps, &[state], |encoder| {
                if first {
                    // `assemble` has written it there.
                    encoder.copy_buffer_to_buffer(product, 0, residual, 0, Some(product.size()));
                }
            })?;
            let state: State = bytemuck::pod_read_unaligned(&read[0]);
            let steps = state.steps as usize;
            match state.done {
                0 if steps < MAX_STEPS => {}
                0 => break,
                CONVERGED => return Ok(Solved { steps, converged: true }),
                _ => {
                    let found = format!("residual square {} after {steps} steps", state.residual_square);
                    return Err(GpuError::Wrong { what: "wall equations", found }.into());
                }
            }
        }
        Ok(Solved { steps: MAX_STEPS, converged: false })
    }
}

/// Whether weights are so like those that the preconditioner was made for that it is as good for them.
fn alike(before: &[f64], now: &[f64]) -> bool {
    before.iter().zip(now).all(|(before, now)| (now - before).abs() <= MAX_CHANGE * before)
}

/// The factored systems of the preconditioner; `None` where the weights are not finite.
fn factors(
    grid: &WallGrid,
    parameters: &WallParameters,
    ring_weights: Vec<f64>,
    smoothness_mm2: f64,
) -> Option<Factors> {
    let weights = grid.even_weights(ring_weights);
    let (rings, frequencies) = (grid.rings, grid.nodes / 2 + 1);
    let systems: Vec<Dissected> = (0..frequencies)
        .into_par_iter()
        .map(|frequency| {
            let system = grid.system(frequency, &weights, smoothness_mm2, LocalSmoothness::EVEN);
            system.dissected(parameters.blocks as usize, parameters.block_rings as usize)
        })
        .collect::<Option<_>>()?;
    let mut factors = Factors::zeroed(parameters);
    factors.rings.par_chunks_mut(frequencies).enumerate().for_each(|(k, plane)| {
        let (part, ring) = (k / rings, k % rings);
        plane.iter_mut().zip(&systems).for_each(|(factor, system)| *factor = system.rows[ring][part] as f32);
    });
    for (separator, row) in factors.separators.chunks_mut(frequencies).enumerate() {
        row.iter_mut()
            .zip(&systems)
            .for_each(|(factors, s)| *factors = s.separators[separator].map(|x| x as f32));
    }
    Some(factors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::wall::passes::{
        couple, eliminate, hartley_first, hartley_second_spectrum, hartley_second_values, substitute,
        twiddles,
    };
    use std::f64::consts::TAU;

    /// Uneven weights, and rings before, amid and behind them without any.
    fn ring_weights(rings: usize) -> Vec<f64> {
        let empty =
            |ring: usize| ring < 20 || (rings / 2..rings / 2 + 9).contains(&ring) || ring + 25 > rings;
        (0..rings).map(|ring| if empty(ring) { 0.0 } else { 300.0 + 100.0 * (ring as f64).sin() }).collect()
    }

    /// The same by sums of cosines and sines, and systems that are solved from one end to the other.
    fn evenly_preconditioned(grid: &WallGrid, smoothness: f64, values: &[f32]) -> Vec<f64> {
        let (rings, nodes) = (grid.rings, grid.nodes);
        let weights = grid.even_weights(ring_weights(rings));
        let mut x = vec![0.0; values.len()];
        for frequency in 0..nodes {
            let nearest = frequency.min(nodes - frequency);
            let system =
                grid.system(nearest, &weights, smoothness, LocalSmoothness::EVEN).factored().unwrap();
            for wave in [f64::cos, f64::sin] {
                let wave = |j: usize| wave(TAU * (frequency * j % nodes) as f64 / nodes as f64);
                let of_ring = |ring: &[f32]| (0..nodes).map(|j| f64::from(ring[j]) * wave(j)).sum::<f64>();
                let column = system.solve(values.chunks_exact(nodes).map(of_ring).collect());
                for (ring, amplitude) in x.chunks_exact_mut(nodes).zip(column) {
                    (0..nodes).for_each(|j| ring[j] += amplitude * wave(j) / nodes as f64);
                }
            }
        }
        x
    }

    #[test]
    fn systems_in_blocks_have_the_solutions_of_whole_ones() {
        for (rings, nodes, smoothness) in [(9, 8, 1.0), (100, 9, 1e-3), (300, 24, 60.0), (301, 24, 60.0)] {
            let grid = WallGrid::new(rings, nodes, 1.1, 4.0);
            let parameters = WallParameters::new(rings as u32, nodes as u32, 4.0, 0.1);
            let factors = factors(&grid, &parameters, ring_weights(rings), smoothness).unwrap();
            let twiddles = twiddles(nodes as u32);
            let values: Vec<f32> =
                (0..grid.node_count()).map(|i| (0.37 * (i * i % 977) as f32).sin()).collect();
            let mut spectrum = hartley_second_spectrum(
                &parameters,
                &twiddles,
                &hartley_first(&parameters, &twiddles, &values),
            );
            let updates = eliminate(&parameters, &factors, &mut spectrum);
            couple(&parameters, &factors, &updates, &mut spectrum);
            substitute(&parameters, &factors, &mut spectrum);
            let (found, _) = hartley_second_values(
                &parameters,
                &twiddles,
                &hartley_first(&parameters, &twiddles, &spectrum),
                &values,
            );

            let expected = evenly_preconditioned(&grid, smoothness, &values);
            let scale = expected.iter().map(|x| x.abs()).fold(0.0, f64::max);
            let apart =
                found.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
            // Without echoes, only the bending determines the ends: rounding matters most there.
            assert!(apart < 2e-3 * scale, "{rings} rings of {nodes}: {apart:e} of {scale:e}");
        }
    }

    #[test]
    fn weights_that_are_no_numbers_have_no_factors() {
        let grid = WallGrid::new(100, 9, 1.1, 4.0);
        assert!(factors(&grid, &WallParameters::new(100, 9, 4.0, 0.1), vec![f64::NAN; 100], 1.0).is_none());
    }
}
