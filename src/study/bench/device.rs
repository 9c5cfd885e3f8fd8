//! Timing on a device.

use super::{DeviceRow, PassRow, RADIUS_MM, Times};
use crate::Result;
use crate::cylinders::Tube;
use crate::cylinders::fit::gpu::{FitWorkspace, GpuEngine, PASSES};
use crate::cylinders::fit::{Engine, group};
use crate::cylinders::passes::Section;
use crate::gpu::Job;
use crate::settings::Settings;
use std::collections::BTreeMap;

/// A device to be timed.
#[non_exhaustive]
pub struct Device {
    /// The engine, its pipelines built.
    pub engine: GpuEngine,
    /// Bytes read and written per second when the device copies a large buffer.
    pub copy_bytes_per_s: f64,
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
        let mut device = Self { engine, copy_bytes_per_s: 0.0, cold_start_s };
        device.copy_bytes_per_s = device.measure_copy()?;
        Ok(device)
    }

    fn measure_copy(&self) -> Result<f64> {
        const BYTES: u64 = 256 << 20;
        let size = BYTES.min(self.engine.device().limits().max_buffer_size);
        let buffer = |label| {
            self.engine.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let (from, to) = (buffer("from"), buffer("to"));
        let copies = 8;
        let times = Times::measure(5, || {
            self.submit(|encoder| {
                for _ in 0..copies {
                    encoder.copy_buffer_to_buffer(&from, 0, &to, 0, Some(size));
                }
            })
        })?;
        Ok(2.0 * (copies * size) as f64 / (times.min_ms * 1e-3))
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
        let end_to_end = Times::measure(repeats, || engine.fit_section(section, RADIUS_MM, settings))?;
        let workspace = engine.prepare(section.len() as u32, RADIUS_MM, settings)?;
        let rows: Vec<[f32; 3]> =
            (0..section.len()).map(|i| [section.r[i], section.theta[i], section.z[i]]).collect();
        let upload = Times::measure(repeats, || {
            engine.queue().write_buffer(workspace.section(), 0, bytemuck::cast_slice(&rows));
            self.submit(|_| ())
        })?;
        let resident = Times::measure(repeats, || engine.run_resident(&workspace))?;
        let readback = Times::measure(repeats, || {
            Ok(engine.runner().run(Job { bytes: 0, rounds: 1 }, &[workspace.radii()], |_, _| Ok(()))?)
        })?;
        let passes = self.time_passes(&workspace, section, settings, repeats)?;
        Ok(DeviceRow { end_to_end, upload, resident, readback, passes })
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
                let share = bytes as f64 / (median_ms * 1e-3) / self.copy_bytes_per_s;
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

/// The amount of work of the passes of a fit.
struct Work {
    points: u64,
    /// Those in short faces, which several invocations share, and those in long faces, each of one workgroup.
    short: u64,
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
        let long: u64 = counts.filter(|&n| n > job.max_short).map(u64::from).sum();
        let points = section.len() as u64;
        Self {
            points,
            short: points - long,
            long,
            faces: u64::from(job.faces),
            nodes: u64::from(job.node_count),
            iterations: u64::from(settings.iterations),
        }
    }

    /// Bytes and floating-point operations of a pass over a fit.
    fn of_pass(&self, pass: &str) -> (u64, u64) {
        let Self { points, short, long, faces, nodes, iterations } = *self;
        match pass {
            "bin" => ((8 + 8) * points + 4 * faces, 0),
            "scan_reduce" | "classify" => (4 * faces, 0),
            "scan_downsweep" => (8 * faces, 0),
            "scatter" => ((12 + 8 + 12) * points + 4 * faces, 0),
            "measure_short" if short > 0 => {
                (iterations * (12 * short + (4 + 24) * faces + 4 * nodes), iterations * 250 * short)
            }
            // Keys are written once, and read in each of four rounds and for the sums.
            "measure_long" => (iterations * (12 + 4 + 5 * 4) * long, iterations * 250 * long),
            "fill_bottom" | "fill_top" => (iterations * (12 + 4) * faces, 0),
            "update" => (iterations * (8 * faces + 8 * nodes), 0),
            "support" => (24 * faces + 8 * nodes, 0),
            _ => (0, 0),
        }
    }
}
