//! Timing on a device.

use super::{DeviceRow, EndToEnd, PassRow, RADIUS_MM, Times};
use crate::Result;
use crate::cylinders::Tube;
use crate::cylinders::fit::gpu::{FitWorkspace, GpuEngine, PASSES};
use crate::cylinders::fit::{Engine, group};
use crate::cylinders::passes::Section;
use crate::gpu::shader::shader;
use crate::gpu::{Job, Pipeline, Shader, dispatch_size};
use crate::settings::Settings;
use std::collections::BTreeMap;

/// Copies a buffer.
static COPY: Shader = shader!("bench", "copy", 256, [], ["source": Read, "destination": Write], {});

/// A device to be timed.
#[non_exhaustive]
pub struct Device {
    /// The engine, its pipelines built.
    pub engine: GpuEngine,
    /// Bytes read and written per second when the device's copy command copies a large buffer.
    pub copy_bytes_per_s: f64,
    /// The same when a pass copies it.
    pub pass_copy_bytes_per_s: f64,
    /// Seconds to the first result: adapter, device, shaders, a small fit.
    pub cold_start_s: f64,
}

impl Device {
    /// Starts a device and measures its copy bandwidth.
    ///
    /// # Errors
    /// As [`GpuEngine::new`].
    pub fn new(adapter: Option<&str>) -> Result<Self> {
        let start = std::time::Instant::now();
        let engine = GpuEngine::new(adapter)?;
        let small = Section { r: vec![RADIUS_MM as f32], theta: vec![0.0], z: vec![0.0], gated: 0 };
        engine.fit_section(&small, RADIUS_MM, &Settings::default())?;
        let cold_start_s = start.elapsed().as_secs_f64();
        engine.warm_up()?;
        let mut device = Self { engine, copy_bytes_per_s: 0.0, pass_copy_bytes_per_s: 0.0, cold_start_s };
        device.measure_copies()?;
        Ok(device)
    }

    /// Measures how fast the device copies a large buffer, by its copy command and by a pass.
    fn measure_copies(&mut self) -> Result<()> {
        const BYTES: u64 = 256 << 20;
        const COPIES: u64 = 8;
        let device = self.engine.device();
        let limits = device.limits();
        let size = BYTES.min(limits.max_buffer_size).min(limits.max_storage_buffer_binding_size);
        let buffer = |label| {
            use wgpu::BufferUsages as Usage;
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: Usage::COPY_SRC | Usage::COPY_DST | Usage::STORAGE,
                mapped_at_creation: false,
            })
        };
        let (from, to) = (buffer("from"), buffer("to"));
        let pipeline = Pipeline::new(device, &COPY)?;
        let bound = pipeline.bind(device, |name| match name {
            "source" => from.as_entire_binding(),
            _ => to.as_entire_binding(),
        })?;
        let compute = pipeline.get(device, 0)?;
        let [x, y] = dispatch_size((size / 16).div_ceil(u64::from(COPY.workgroup_size)) as u32);
        let per_second = |times: Times| 2.0 * (COPIES * size) as f64 / (times.min_ms * 1e-3);
        let by_command = Times::measure_warm(5, || {
            self.submit(|encoder| {
                for _ in 0..COPIES {
                    encoder.copy_buffer_to_buffer(&from, 0, &to, 0, Some(size));
                }
            })
        })?;
        let by_pass = Times::measure_warm(5, || {
            self.submit(|encoder| {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(compute);
                pass.set_bind_group(0, &bound, &[]);
                for _ in 0..COPIES {
                    pass.dispatch_workgroups(x, y, 1);
                }
            })
        })?;
        self.copy_bytes_per_s = per_second(by_command);
        self.pass_copy_bytes_per_s = per_second(by_pass);
        Ok(())
    }

    /// Submits what is recorded and waits for it.
    fn submit(&self, record: impl FnOnce(&mut wgpu::CommandEncoder)) -> Result<()> {
        self.engine.runner().run(Job { bytes: 0, rounds: 1 }, &[], |encoder, _| {
            record(encoder);
            Ok(())
        })?;
        Ok(())
    }

    pub(super) fn time(
        &self,
        section: &Section<f32>,
        settings: &Settings,
        repeats: usize,
    ) -> Result<DeviceRow> {
        let engine = &self.engine;
        let mut spent = Vec::new();
        engine.runner().take_spent();
        let end_to_end = Times::measure_warm(repeats, || {
            let fit = engine.fit_section(section, RADIUS_MM, settings)?;
            spent.push(engine.runner().take_spent());
            Ok(fit)
        })?;
        let of_it = EndToEnd::of(&spent[spent.len().saturating_sub(repeats.max(1))..]);
        let prepare = || engine.prepare(section.len() as u32, RADIUS_MM, settings);
        let making_memory = Times::measure(repeats, prepare)?;
        let workspace = prepare()?;
        let upload = Times::measure_warm(repeats, || {
            self.write(&workspace, section)?;
            self.submit(|_| ())
        })?;
        let resident = Times::measure_warm(repeats, || engine.run_resident(&workspace))?;
        let readback = Times::measure_warm(repeats, || {
            Ok(engine.runner().run(Job { bytes: 0, rounds: 1 }, &[workspace.radii()], |_, _| Ok(()))?)
        })?;
        let iteration = self.time_iteration(&workspace, section, settings, repeats)?;
        let passes = self.time_passes(&workspace, section, settings, repeats)?;
        Ok(DeviceRow { end_to_end, of_it, making_memory, upload, resident, readback, iteration, passes })
    }

    /// Writes the points of a section to a workspace.
    fn write(&self, workspace: &FitWorkspace, section: &Section<f32>) -> Result<()> {
        let parts = [&section.r, &section.theta, &section.z].map(|of_all| bytemuck::cast_slice(of_all));
        Ok(self.engine.runner().context.write_parts(workspace.section(), &parts)?)
    }

    /// Device time of one more iteration.
    fn time_iteration(
        &self,
        workspace: &FitWorkspace,
        section: &Section<f32>,
        settings: &Settings,
        repeats: usize,
    ) -> Result<Option<Times>> {
        const MORE: u32 = 10;
        let engine = &self.engine;
        if !engine.device().features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Ok(None);
        }
        let more = settings.clone().with_iterations(settings.iterations + MORE);
        let longer = engine.prepare(section.len() as u32, RADIUS_MM, &more)?;
        self.write(&longer, section)?;
        let mut seconds = Vec::new();
        Times::measure_warm(repeats, || {
            let [short_s, long_s] = [engine.device_time_s(workspace)?, engine.device_time_s(&longer)?];
            seconds.push((long_s - short_s) / f64::from(MORE));
            Ok(())
        })?;
        Ok(Some(Times::of(seconds.split_off(seconds.len().saturating_sub(repeats.max(1))))))
    }

    /// Device time of each pass over a fit.
    fn time_passes(
        &self,
        workspace: &FitWorkspace,
        section: &Section<f32>,
        settings: &Settings,
        repeats: usize,
    ) -> Result<Vec<PassRow>> {
        let mut samples: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
        for _ in 0..repeats.max(1) {
            let (_, passes) = self.engine.runner().timed(|| self.engine.run_resident(workspace))?;
            for (name, seconds) in passes {
                samples.entry(name).or_default().push(seconds);
            }
        }
        let work = Work::of(workspace, section, settings);
        Ok(PASSES
            .iter()
            .filter_map(|pass| {
                let (bytes, flops) = work.of_pass(pass.shader.name);
                let median_ms = Times::of(samples.remove(pass.shader.name)?).median_ms;
                let share = bytes as f64 / (median_ms * 1e-3) / self.pass_copy_bytes_per_s;
                let row = PassRow {
                    name: pass.shader.name,
                    median_ms,
                    bytes,
                    flops,
                    share_of_copy_bandwidth: share,
                };
                // Passes without work are left out.
                (bytes > 0).then_some(row)
            })
            .collect())
    }
}

/// Additions and multiplications of a distance to both triangles of a face.
const FLOPS_PER_DISTANCE: u64 = 140;

/// The amount of work of the passes of a fit.
struct Work {
    points: u64,
    /// Those in short faces, in faces of middle size, and in long ones that a subgroup measures, or a workgroup.
    short: u64,
    middle: u64,
    narrow: u64,
    long: u64,
    faces: u64,
    nodes: u64,
    iterations: u64,
}

impl Work {
    fn of(workspace: &FitWorkspace, section: &Section<f32>, settings: &Settings) -> Self {
        let job = workspace.parameters();
        let groups = group(section, &Tube::new(settings));
        let counts = groups.offsets.windows(2).map(|w| w[1] - w[0]);
        let above = |most: u32| -> u64 { counts.clone().filter(|&n| n > most).map(u64::from).sum() };
        let points = section.len() as u64;
        let (short, long) = (points - above(job.max_short), above(job.max_narrow));
        let narrow = above(job.max_middle) - long;
        Self {
            points,
            short,
            middle: points - short - narrow - long,
            narrow,
            long,
            faces: u64::from(job.faces),
            nodes: u64::from(job.node_count),
            iterations: u64::from(settings.iterations),
        }
    }

    /// Bytes and floating-point operations of a pass over a fit.
    fn of_pass(&self, pass: &str) -> (u64, u64) {
        let Self { points, short, middle, narrow, long, faces, nodes, iterations } = *self;
        let flops = |points: u64| iterations * FLOPS_PER_DISTANCE * points;
        match pass {
            "bin" | "bin_few" => ((8 + 8) * points + 4 * faces, 0),
            // The points are read twice.
            "group_few" | "group_few_wide" => ((2 * 12 + 16) * points + 4 * faces, 0),
            "scan_reduce" => (4 * faces, 0),
            "scan_downsweep" => (8 * faces, 0),
            "scatter" => ((12 + 8 + 16) * points + 4 * faces, 0),
            // The support is written in one iteration only.
            "measure_few" | "measure_short" | "measure_short_shared" if short > 0 => {
                (iterations * (16 * short + (4 + 8) * faces + 4 * nodes) + 16 * faces, flops(short))
            }
            "measure_middle" | "measure_middle_shared" => (iterations * 16 * middle, flops(middle)),
            // Keys are written once, and counted as read in six rounds, for the extremes and for the sums.
            "measure_narrow" => (iterations * (16 + 4 + 8 * 4) * narrow, flops(narrow)),
            // Keys are written once, and read in each of four rounds and for the sums.
            "measure_long" => (iterations * (16 + 4 + 6 * 4) * long, flops(long)),
            "distance" => (iterations * (16 + 4) * points, flops(points)),
            "measure_long_keyed" | "measure_long_wide" => (iterations * 6 * 4 * long, 0),
            "update" => (iterations * (8 * faces + 8 * nodes), 0),
            "support" => (16 * faces + 8 * nodes, 0),
            _ => (0, 0),
        }
    }
}
