//! The wall's fit on the device: passes over echoes and nodes, whose twins are in [`passes`](super::passes).

mod pass;
mod workspace;

pub use pass::{Items, PASSES, Pass};
pub use workspace::Workspace;

use crate::Result;
use crate::engine::EngineDescription;
use crate::gpu::{AdapterDescription, Context, GpuError, Pipeline, checked};
use crate::numerics::banded::Dissected;
use crate::recording::echo_error::OUT_OF_PLANE;
use crate::sweep::prepare::{echo, grid::WallGrid};
use crate::sweep::wall::bending::LocalSmoothness;
use crate::sweep::wall::fit::{Reweighting, Solution, WallEngine};
use crate::sweep::wall::passes::{Echo, Factors, Job, State};
use crate::sweep::wall::solver::MAX_STEPS;
use pass::{PRECONDITION, STEP};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Steps of conjugate gradients between two looks at whether they are near enough. Steps that come too late find that
/// out by themselves and do nothing.
const STEPS_A_SUBMISSION: usize = 10;

/// Five sums a node are counted in u32.
const MOST_NODES: usize = (u32::MAX / 5) as usize;

/// A pass made ready on a device.
struct ReadyPass {
    pass: &'static Pass,
    pipeline: Pipeline,
}

/// Fits walls on a device.
pub struct SweepEngine {
    context: Context,
    passes: Vec<ReadyPass>,
    /// Device time of each pass so far, in seconds, while somebody wants to know.
    times: Mutex<Option<BTreeMap<&'static str, f64>>>,
}

impl SweepEngine {
    /// The engine on the adapter whose name contains `adapter` (without regard to case), or on the best one.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where there is no such adapter or it refuses a shader.
    pub fn new(adapter: Option<&str>) -> Result<Self> {
        Self::on(Context::new(adapter)?)
    }

    /// The engine on a host's device, which must meet [`Requirements`](crate::gpu::Requirements). No handler of the
    /// host's is replaced.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses a shader.
    pub fn on_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        Self::on(Context::of_host(device, queue))
    }

    fn on(context: Context) -> Result<Self> {
        let passes = PASSES
            .iter()
            .map(|pass| Ok(ReadyPass { pass, pipeline: Pipeline::new(&context.device, &pass.shader)? }))
            .collect::<Result<Vec<_>, GpuError>>()?;
        Ok(Self { context, passes, times: Mutex::default() })
    }

    /// The adapter, where the engine chose it.
    pub fn adapter(&self) -> Option<&AdapterDescription> {
        self.context.adapter.as_ref()
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.context.device
    }

    /// What it is, for a report.
    pub fn describe(&self) -> EngineDescription {
        let adapter = self.adapter().map(|a| format!("{} ({}, {})", a.name, a.backend, a.driver));
        EngineDescription { name: "gpu".into(), adapter, why: None }
    }

    /// Builds every pipeline now rather than when it is first needed.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where the device refuses one.
    pub fn warm_up(&self) -> Result<()> {
        Ok(self.passes.iter().try_for_each(|ready| ready.pipeline.warm_up(&self.context.device))?)
    }

    /// Does some work and tells the device time of each pass in it, in seconds, in the order of their names; nothing
    /// where the device cannot time passes.
    ///
    /// # Errors
    /// The work's.
    pub fn timed<R>(&self, work: impl FnOnce(&Self) -> Result<R>) -> Result<(R, Vec<(&'static str, f64)>)> {
        let can = self.context.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        *self.times() = can.then(BTreeMap::new);
        let done = work(self);
        let times = self.times().take().unwrap_or_default();
        Ok((done?, times.into_iter().collect()))
    }

    fn times(&self) -> MutexGuard<'_, Option<BTreeMap<&'static str, f64>>> {
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Device memory for a wall and the echoes about it.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where they do not fit the device.
    pub fn prepare(&self, job: &Job, echoes: &[Echo]) -> Result<Workspace> {
        Ok(Workspace::new(&self.context, &self.passes, job, echoes)?)
    }

    /// Runs one pass of a workspace alone on given buffer contents, and reads buffers back: how a pass is
    /// compared with its twin on identical inputs. Buffers that every chunk has are the first chunk's.
    ///
    /// Outputs that are not among the inputs are filled with ones before, so that what a pass leaves out shows.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) where there is no such pass or buffer, or the device fails.
    pub fn run_pass(
        &self,
        workspace: &Workspace,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: &[&str],
    ) -> Result<Vec<Vec<u8>>> {
        let find = |name: &str| {
            workspace
                .find(name)
                .ok_or_else(|| GpuError::Refused { what: name.into(), reason: "no such buffer".into() })
        };
        let outputs = outputs.iter().map(|name| find(name)).collect::<Result<Vec<_>, _>>()?;
        let write = |buffer: &wgpu::Buffer, bytes: &[u8]| {
            checked(&self.context.device, "input", || self.context.write(buffer, bytes))
        };
        for buffer in &outputs {
            write(buffer, &vec![0xff; buffer.size() as usize])?;
        }
        for (name, bytes) in inputs {
            write(find(name)?, bytes)?;
        }
        Ok(self.run(workspace, &[pass], &outputs, |_| ())?)
    }

    /// Runs some passes, one after the other, behind what `prepare` records, and reads buffers back.
    fn run(
        &self,
        workspace: &Workspace,
        passes: &[&str],
        buffers: &[&wgpu::Buffer],
        prepare: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        let find = |name: &str| {
            let ready = workspace::row(name).and_then(|row| self.passes.get(row));
            ready.ok_or_else(|| GpuError::Refused { what: name.into(), reason: "no such pass".into() })
        };
        let passes = passes.iter().map(|name| find(name)).collect::<Result<Vec<_>, GpuError>>()?;
        if self.times().is_some() && !passes.is_empty() {
            return self.run_timed(workspace, &passes, buffers, prepare);
        }
        self.context.run(workspace.bytes(), buffers, |encoder| {
            prepare(encoder);
            let mut compute = encoder.begin_compute_pass(&Default::default());
            passes.iter().try_for_each(|ready| workspace.dispatch(&self.context, ready, &mut compute))
        })
    }

    /// As [`run`](Self::run), each pass in a compute pass of its own between two timestamps.
    fn run_timed(
        &self,
        workspace: &Workspace,
        passes: &[&ReadyPass],
        buffers: &[&wgpu::Buffer],
        prepare: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        let device = &self.context.device;
        let count = 2 * passes.len() as u32;
        let queries = device.create_query_set(&wgpu::QuerySetDescriptor {
            label: None,
            ty: wgpu::QueryType::Timestamp,
            count,
        });
        let resolved = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: 8 * u64::from(count),
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let mut read = self.context.run(workspace.bytes(), &[buffers, &[&resolved]].concat(), |encoder| {
            prepare(encoder);
            for (ready, first) in passes.iter().zip((0..count).step_by(2)) {
                let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: Some(ready.pass.shader.name),
                    timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                        query_set: &queries,
                        beginning_of_pass_write_index: Some(first),
                        end_of_pass_write_index: Some(first + 1),
                    }),
                });
                workspace.dispatch(&self.context, ready, &mut compute)?;
            }
            encoder.resolve_query_set(&queries, 0..count, &resolved, 0);
            Ok(())
        })?;
        let ticks: Vec<u64> =
            read.pop().map(|bytes| bytemuck::pod_collect_to_vec(&bytes)).unwrap_or_default();
        let period_s = f64::from(self.context.queue.get_timestamp_period()) * 1e-9;
        if let Some(times) = self.times().as_mut() {
            for (ready, ticks) in passes.iter().zip(ticks.chunks_exact(2)) {
                *times.entry(ready.pass.shader.name).or_default() +=
                    ticks[1].saturating_sub(ticks[0]) as f64 * period_s;
            }
        }
        Ok(read)
    }

    /// A wall and echoes on the device.
    pub(in crate::sweep) fn wall<'a>(
        &'a self,
        grid: &'a WallGrid,
        echoes: &'a mut [echo::Echo],
        start_mm: f64,
    ) -> Result<OnDevice<'a>> {
        if grid.node_count() > MOST_NODES {
            let what = format!("a wall of {} nodes", grid.node_count());
            return Err(GpuError::Refused { what, reason: format!("{MOST_NODES} at most") }.into());
        }
        let (rings, nodes) = (grid.rings as u32, grid.nodes as u32);
        let job = Job::new(rings, nodes, start_mm, OUT_OF_PLANE);
        let of_device: Vec<Echo> = echoes.iter().map(|echo| echo.for_device(grid, start_mm)).collect();
        let workspace = self.prepare(&job, &of_device)?;
        Ok(OnDevice { engine: self, workspace, grid, echoes, start_mm })
    }
}

/// The fit on a device.
pub(in crate::sweep) struct OnDevice<'a> {
    engine: &'a SweepEngine,
    workspace: Workspace,
    grid: &'a WallGrid,
    echoes: &'a mut [echo::Echo],
    start_mm: f64,
}

impl WallEngine for OnDevice<'_> {
    fn measure(&mut self, noise_mm: f64, feet: bool) -> Result<f64> {
        let context = &self.engine.context;
        let job = Job { feet: u32::from(feet), ..self.workspace.job().with_noise(noise_mm) };
        self.workspace.set_job(context, &job);
        let state = State { rest: (self.echoes.len() / 2) as u32, ..State::default() };
        let of_device = self.workspace.shared("state");
        context.write(of_device, bytemuck::bytes_of(&state));
        let digit = ["count_misses", "pick_digit"];
        let passes = [&["measure"][..], &digit, &digit, &digit, &digit].concat();
        let read = self.engine.run(&self.workspace, &passes, &[of_device], |_| ())?;
        let state: State = bytemuck::pod_read_unaligned(&read[0]);
        let miss_mm = f32::from_bits(state.prefix);
        if state.round != 4 || !miss_mm.is_finite() {
            return Err(GpuError::Wrong { what: "median miss", found: format!("{miss_mm} mm") }.into());
        }
        Ok(f64::from(miss_mm))
    }

    fn solve(&mut self, round: &Reweighting) -> Result<Solution> {
        let (engine, context, grid) = (self.engine, &self.engine.context, self.grid);
        let job = Job { gated: u32::from(!round.warm_up), ..*self.workspace.job() }
            .with_noise(round.noise_mm)
            .with_smoothness(round.smoothness_mm2, grid.step_mm, grid.arc_mm);
        self.workspace.set_job(context, &job);
        let sums = ["sums_low", "sums_high"].map(|name| self.workspace.shared(name));
        let ring_weights = self.workspace.shared("ring_weights");
        let passes = ["accumulate", "assemble", "weigh_rings"];
        let read = engine.run(&self.workspace, &passes, &[ring_weights], |encoder| {
            sums.iter().for_each(|sums| encoder.clear_buffer(sums, 0, None));
        })?;
        let ring_weights: Vec<f64> = bytemuck::pod_collect_to_vec::<u8, f32>(&read[0])
            .into_iter()
            .take(grid.rings)
            .map(f64::from)
            .collect();

        // In f64 and on the CPU, where nearly singular systems keep their sign: where no echo lies, only the wall's
        // bending holds a ring.
        let weight: f64 = ring_weights.iter().sum();
        let factors = factors(grid, &job, ring_weights, round.smoothness_mm2);
        let factors =
            factors.ok_or(GpuError::Wrong { what: "weights of the rings", found: weight.to_string() })?;
        context.write(self.workspace.shared("factors"), bytemuck::cast_slice(&factors.rings));
        context.write(self.workspace.shared("joints"), bytemuck::cast_slice(&factors.joints));
        // The residual of a wall without radius: that of the wall is compared with it.
        context.write(self.workspace.shared("state"), bytemuck::bytes_of(&State::default()));
        let whole =
            self.sum_of_partials(&[&["aim"], &PRECONDITION[..]].concat(), self.workspace.wave_groups())?;
        let enough = round.tolerance * round.tolerance * whole;
        self.workspace.set_job(context, &Job { enough: enough as f32, ..job });
        let solver_steps = self.conjugate_gradients()?;

        let count = grid.node_count();
        let travel_mm = self.sum_of_partials(&["move_wall"], count.div_ceil(256))? / count as f64;
        if !travel_mm.is_finite() {
            return Err(GpuError::Wrong { what: "travel of the nodes", found: travel_mm.to_string() }.into());
        }
        Ok(Solution { travel_mm, solver_steps })
    }

    fn finish(self) -> Result<Vec<f64>> {
        let (shifts, misses) = (self.workspace.of_chunks("shifts"), self.workspace.of_chunks("misses"));
        let chunks = self.workspace.chunk_count();
        let wall = [self.workspace.shared("wall")];
        let read = self.engine.run(&self.workspace, &[], &[&wall[..], &shifts, &misses].concat(), |_| ())?;
        let (shifts, misses) = read[1..].split_at(chunks);
        let mut echoes = self.echoes.iter_mut();
        for ((shifts, misses), count) in shifts.iter().zip(misses).zip(self.workspace.echo_counts()) {
            let shifts: Vec<[f32; 2]> = bytemuck::pod_collect_to_vec(shifts);
            let misses: Vec<f32> = bytemuck::pod_collect_to_vec(misses);
            for ((echo, shift), miss) in echoes.by_ref().take(count).zip(shifts).zip(misses) {
                echo.set_residual(shift.map(f64::from), f64::from(miss));
            }
        }
        let wall: Vec<f32> = bytemuck::pod_collect_to_vec(&read[0]);
        let radii = wall.into_iter().take(self.grid.node_count());
        Ok(radii.map(|rise| self.start_mm + f64::from(rise)).collect())
    }
}

impl OnDevice<'_> {
    /// Runs passes and adds up what the workgroups of the last one have summed up.
    fn sum_of_partials(&self, passes: &[&str], count: usize) -> Result<f64> {
        let read = self.engine.run(&self.workspace, passes, &[self.workspace.shared("partials")], |_| ())?;
        let partials = bytemuck::pod_collect_to_vec::<u8, f32>(&read[0]);
        Ok(partials.into_iter().take(count).map(f64::from).sum())
    }

    /// Conjugate gradients, until the device says that it is near enough; returns the number of steps.
    fn conjugate_gradients(&self) -> Result<usize> {
        let [state, residual, product] =
            ["state", "residual", "product"].map(|name| self.workspace.shared(name));
        let steps = [&PRECONDITION[..], &STEP].concat().repeat(STEPS_A_SUBMISSION);
        for submission in 0..MAX_STEPS.div_ceil(STEPS_A_SUBMISSION) {
            let read = self.engine.run(&self.workspace, &steps, &[state], |encoder| {
                if submission == 0 {
                    // Where `assemble` has left it.
                    encoder.copy_buffer_to_buffer(product, 0, residual, 0, Some(product.size()));
                }
            })?;
            let state: State = bytemuck::pod_read_unaligned(&read[0]);
            if state.done != 0 || state.steps as usize >= MAX_STEPS {
                return Ok(state.steps as usize);
            }
        }
        Ok(MAX_STEPS)
    }
}

/// The preconditioner's systems, factored; `None` where the weights are no numbers.
fn factors(grid: &WallGrid, job: &Job, ring_weights: Vec<f64>, smoothness_mm2: f64) -> Option<Factors> {
    let weights = grid.even_weights(ring_weights);
    let (rings, frequencies) = (grid.rings, grid.nodes / 2 + 1);
    let systems: Vec<Dissected> = (0..frequencies)
        .into_par_iter()
        .map(|frequency| {
            let system = grid.system(frequency, &weights, smoothness_mm2, LocalSmoothness::EVEN);
            system.dissected(job.blocks as usize, job.block_rings as usize)
        })
        .collect::<Option<_>>()?;
    let mut factors = Factors::zeroed(job);
    factors.rings.par_chunks_mut(frequencies).enumerate().for_each(|(k, plane)| {
        let (part, ring) = (k / rings, k % rings);
        plane.iter_mut().zip(&systems).for_each(|(factor, system)| *factor = system.rows[ring][part] as f32);
    });
    for (joint, row) in factors.joints.chunks_mut(frequencies).enumerate() {
        row.iter_mut()
            .zip(&systems)
            .for_each(|(factors, s)| *factors = s.separators[joint].map(|x| x as f32));
    }
    Some(factors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::wall::passes::{couple, eliminate, join_values, join_waves, part, substitute, waves};
    use crate::sweep::wall::solver::Solver;

    /// Uneven weights, and rings before, amid and behind them without any.
    fn ring_weights(rings: usize) -> Vec<f64> {
        let empty =
            |ring: usize| ring < 20 || (rings / 2..rings / 2 + 9).contains(&ring) || ring + 25 > rings;
        (0..rings).map(|ring| if empty(ring) { 0.0 } else { 300.0 + 100.0 * (ring as f64).sin() }).collect()
    }

    #[test]
    fn systems_in_blocks_have_the_solutions_of_whole_ones() {
        for (rings, nodes, smoothness) in [(9, 8, 1.0), (100, 9, 1e-3), (300, 24, 60.0), (301, 24, 60.0)] {
            let grid = WallGrid::new(rings, nodes, 1.1, 4.0);
            let job = Job::new(rings as u32, nodes as u32, 4.0, 0.1);
            let factors = factors(&grid, &job, ring_weights(rings), smoothness).unwrap();
            let waves = waves(nodes as u32);
            let values: Vec<f32> =
                (0..grid.node_count()).map(|i| (0.37 * (i * i % 977) as f32).sin()).collect();
            let mut spectrum = join_waves(&job, &waves, &part(&job, &waves, &values));
            let pulls = eliminate(&job, &factors, &mut spectrum);
            couple(&job, &factors, &pulls, &mut spectrum);
            substitute(&job, &factors, &mut spectrum);
            let (found, _) = join_values(&job, &waves, &part(&job, &waves, &spectrum), &values);

            let mut expected: Vec<f64> = values.iter().map(|&x| f64::from(x)).collect();
            Solver::new(grid).precondition_evenly(ring_weights(rings), smoothness, &mut expected);
            let scale = expected.iter().map(|x| x.abs()).fold(0.0, f64::max);
            let apart =
                found.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
            // Ends that no echo holds are held by the bending alone: there rounding counts most.
            assert!(apart < 2e-3 * scale, "{rings} rings of {nodes}: {apart:e} of {scale:e}");
        }
    }

    #[test]
    fn weights_that_are_no_numbers_have_no_factors() {
        let grid = WallGrid::new(100, 9, 1.1, 4.0);
        assert!(factors(&grid, &Job::new(100, 9, 4.0, 0.1), vec![f64::NAN; 100], 1.0).is_none());
    }
}
