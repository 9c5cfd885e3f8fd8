//! The buffers of a batch and the recording of its passes.

use super::pass::{Items, LANES, Pass, Stage};
use super::{CpuStages, DeviceCylinder, DeviceJob, DevicePair, ReadyPass};
use crate::gpu::{Buffers, Context, GpuError, Timer, dispatch_size};
use crate::settings::Settings;
use std::collections::BTreeMap;

/// Where a batch's points come from.
pub(super) enum Points<'a> {
    /// Points in their probes' planes and the pairs that bring them into tubes.
    Pairs { points: &'a [[f32; 2]], pairs: &'a [DevicePair] },
    /// So many points of one tube, in its coordinates, written to the section buffer by whoever records.
    Section { count: u32 },
}

/// The device memory of a batch of cylinders that are fitted together.
///
/// [`GpuEngine::record`](super::GpuEngine::record) puts the whole fit into a command encoder: nothing is submitted,
/// waited for or read back behind the caller's back, and it can be recorded again for new points of the same number.
pub struct Workspace {
    job: DeviceJob,
    iterations: u32,
    lanes: u32,
    long_groups: u32,
    buffers: Buffers,
    /// Bind groups by pass, `update`'s by iteration.
    bind_groups: BTreeMap<&'static str, Vec<wgpu::BindGroup>>,
    travel_stride: u64,
}

/// The name and the size in bytes of every buffer of a job.
pub(super) fn sizes(
    job: &DeviceJob,
    points: usize,
    iterations: u32,
    history: bool,
    travel_stride: u64,
) -> Vec<(&'static str, u64)> {
    let [slots, faces, nodes, cylinders] = [
        u64::from(job.slots),
        u64::from(job.cylinders) * u64::from(job.faces),
        u64::from(job.cylinders) * u64::from(job.node_count),
        u64::from(job.cylinders),
    ];
    let paired = job.single == 0;
    vec![
        ("job", size_of::<DeviceJob>() as u64),
        ("cylinders", 16 * cylinders),
        ("points", 8 * points as u64),
        ("pairs", size_of::<DevicePair>() as u64 * u64::from(job.pairs)),
        ("section", 12 * slots),
        ("owners", if paired { 4 * slots } else { 4 }),
        ("gated", 4 * cylinders),
        ("counts", 4 * faces),
        ("places", 8 * slots),
        ("block_sums", 4 * faces.div_ceil(1024)),
        ("offsets", 4 * (faces + 1)),
        ("grouped", 12 * slots),
        // Their number, the faces, and how many of them were measured to the end.
        ("long_faces", 4 * (2 + slots / u64::from(job.short_most + 1))),
        ("keys", if slots > u64::from(job.short_most) { 4 * slots } else { 4 }),
        ("primitive", 4 * nodes),
        ("radii", 4 * nodes),
        ("statistics", 24 * faces),
        ("values", 8 * faces),
        ("travels", travel_stride * u64::from(iterations.max(1))),
        ("support", 4 * nodes),
        ("residuals", 4 * nodes),
        ("tallies", 8 * cylinders),
        ("history", if history { 4 * nodes * (u64::from(iterations) + 1) } else { 4 }),
    ]
}

/// The number of invocations that measure a short face: about half as many as it has points on average.
pub(super) fn lanes(slots: u64, faces: u64) -> u32 {
    let half = slots.div_ceil(2 * faces.max(1));
    LANES.into_iter().find(|&l| u64::from(l) >= half).unwrap_or(LANES[LANES.len() - 1])
}

/// How many workgroups share the long faces, of which there are `long_most` at most: enough to fill a GPU, and
/// on software, where a workgroup costs microseconds even if nothing is left for it to do, a few for each thread.
///
/// None gets more than 128 faces: llvmpipe ends an invocation's loops, without a word, after 65,535 rounds of
/// all of them together, and a face takes about a hundred beside those over its points.
fn long_groups(context: &Context, long_most: u64) -> u64 {
    let groups = if context.is_software() { 2 * rayon::current_num_threads() as u64 } else { 1024 };
    groups.max(long_most.div_ceil(128)).min(long_most)
}

impl Workspace {
    pub(super) fn new(
        context: &Context,
        passes: &[ReadyPass],
        settings: &Settings,
        radii_mm: &[f64],
        points: &Points,
        history: bool,
    ) -> Result<Self, GpuError> {
        let faces = u64::from(settings.nodes) * u64::from(settings.levels) * radii_mm.len() as u64;
        let (slots, point_count, pairs) = match points {
            Points::Pairs { points, pairs } => {
                let slots = pairs.last().map_or(0, |p| u64::from(p.first_slot) + u64::from(p.count));
                (slots, points.len(), Some(pairs.len() as u32))
            }
            Points::Section { count } => (u64::from(*count), 0, None),
        };
        let lanes = lanes(slots, faces);
        let cylinders = radii_mm.len() as u32;
        // Slots are numbered in u32, whatever the device could hold.
        let slot_count = u32::try_from(slots).map_err(|_| GpuError::TooLarge {
            name: "section".into(),
            needed: 12 * slots,
            allowed: 12 * u64::from(u32::MAX),
        })?;
        let job = DeviceJob::new(settings, cylinders, slot_count, pairs, lanes);
        let limits = context.device.limits();
        let alignment = u64::from(limits.min_storage_buffer_offset_alignment);
        let travel_stride = (8 * u64::from(cylinders)).next_multiple_of(alignment);
        let sizes = sizes(&job, point_count, settings.iterations, history, travel_stride);
        let buffers = Buffers::new(context, passes, &sizes)?;

        let mut bind_groups = BTreeMap::new();
        for ReadyPass { pass, pipeline } in passes {
            let name = pass.shader.name;
            let repeats = if name == "update" { settings.iterations } else { 1 };
            let groups = (0..repeats)
                .map(|iteration| {
                    pipeline.bind(&context.device, |name| match name {
                        "travels" => wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                            buffer: &buffers[name],
                            offset: travel_stride * u64::from(iteration),
                            size: None,
                        }),
                        _ => buffers[name].as_entire_binding(),
                    })
                })
                .collect::<Result<Vec<_>, GpuError>>()?;
            bind_groups.insert(name, groups);
        }

        let long_most = slots / u64::from(job.short_most + 1);
        let workspace = Self {
            job,
            iterations: settings.iterations,
            lanes,
            long_groups: long_groups(context, long_most) as u32,
            buffers,
            bind_groups,
            travel_stride,
        };
        let device_cylinders: Vec<DeviceCylinder> =
            radii_mm.iter().map(|&r| DeviceCylinder::new(settings, r)).collect();
        let primitive: Vec<f32> =
            radii_mm.iter().flat_map(|&r| std::iter::repeat_n(r as f32, job.node_count as usize)).collect();
        workspace.write(context, "job", bytemuck::bytes_of(&job));
        workspace.write(context, "cylinders", bytemuck::cast_slice(&device_cylinders));
        workspace.write(context, "primitive", bytemuck::cast_slice(&primitive));
        if let Points::Pairs { points, pairs } = points {
            workspace.write(context, "points", bytemuck::cast_slice(points));
            workspace.write(context, "pairs", bytemuck::cast_slice(pairs));
        }
        Ok(workspace)
    }

    pub(super) fn write(&self, context: &Context, name: &str, bytes: &[u8]) {
        context.write(&self.buffers[name], bytes);
    }

    /// The buffer of that name, where there is one.
    pub(super) fn find(&self, name: &str) -> Option<&wgpu::Buffer> {
        self.buffers.find(name)
    }

    /// A buffer by its name in the pass table.
    pub(super) fn buffer(&self, name: &str) -> &wgpu::Buffer {
        &self.buffers[name]
    }

    /// Bytes that each iteration's travels take in their buffer.
    pub(super) fn travel_stride(&self) -> u64 {
        self.travel_stride
    }

    /// What the passes know of the job.
    pub fn job(&self) -> &DeviceJob {
        &self.job
    }

    /// Device memory of all buffers, bytes.
    pub fn bytes(&self) -> u64 {
        self.buffers.bytes()
    }

    /// r (mm), θ (rad) and z (mm) of each point, f32 ×3, where a host writes its points.
    pub fn section(&self) -> &wgpu::Buffer {
        &self.buffers["section"]
    }

    /// The nodes' radii, mm, f32, ring after ring: the result.
    pub fn radii(&self) -> &wgpu::Buffer {
        &self.buffers["radii"]
    }

    /// How many workgroups a pass needs: two dimensions and the cylinders.
    fn groups(&self, pass: &Pass) -> [u32; 3] {
        let (job, size) = (&self.job, pass.shader.workgroup_size);
        let all_faces = job.cylinders * job.faces;
        let (count, layers) = match pass.items {
            Items::Pairs => (job.pairs, 1),
            Items::Slots => (job.slots.div_ceil(size), 1),
            Items::Blocks => (all_faces.div_ceil(1024), 1),
            Items::One => (1, 1),
            Items::AllFaces => (all_faces.div_ceil(size), 1),
            Items::ShortFaces => (job.faces.div_ceil(size / self.lanes), job.cylinders),
            Items::LongFaces => (self.long_groups, 1),
            Items::Faces => (job.faces.div_ceil(size), job.cylinders),
            Items::Nodes => (job.node_count.div_ceil(size), job.cylinders),
        };
        let [x, y] = dispatch_size(count);
        [x, y, layers]
    }

    /// Puts one pass into a compute pass; one without work is left out.
    fn dispatch(
        &self,
        context: &Context,
        ready: &ReadyPass,
        iteration: u32,
        compute: &mut wgpu::ComputePass,
    ) -> Result<(), GpuError> {
        let [x, y, z] = self.groups(ready.pass);
        let bind_groups = &self.bind_groups[ready.pass.shader.name];
        // All but `update` bind the same in every iteration.
        if x > 0
            && let Some(bind_group) = bind_groups.get(iteration as usize).or(bind_groups.first())
        {
            compute.set_pipeline(ready.pipeline.get(&context.device, self.lanes)?);
            compute.set_bind_group(0, bind_group, &[]);
            compute.dispatch_workgroups(x, y, z);
        }
        Ok(())
    }

    /// Records one pass alone (`update` as of the first iteration), on what the buffers hold.
    pub(super) fn record_one(
        &self,
        context: &Context,
        ready: &ReadyPass,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<(), GpuError> {
        self.dispatch(context, ready, 0, &mut encoder.begin_compute_pass(&Default::default()))
    }

    /// Records the fit behind the stages that ran on the CPU and whose results the buffers hold: grouping, all
    /// iterations, support. With [`CpuStages::None`] the section buffer of a single tube must hold its points.
    pub(super) fn record(
        &self,
        context: &Context,
        passes: &[ReadyPass],
        encoder: &mut wgpu::CommandEncoder,
        done: CpuStages,
        history: bool,
        timer: &mut Timer,
    ) -> Result<(), GpuError> {
        for name in ["counts", "travels", "tallies"] {
            encoder.clear_buffer(&self.buffers[name], 0, None);
        }
        let long_faces = &self.buffers["long_faces"];
        encoder.clear_buffer(long_faces, 0, Some(4));
        encoder.clear_buffer(long_faces, long_faces.size() - 4, None);
        if done < CpuStages::Project {
            encoder.clear_buffer(&self.buffers["gated"], 0, None);
        }
        if done.iterations() == 0 {
            encoder.clear_buffer(&self.buffers["statistics"], 0, None);
            let radii_bytes = self.buffers["radii"].size();
            encoder.copy_buffer_to_buffer(&self.buffers["primitive"], 0, self.radii(), 0, Some(radii_bytes));
        }
        let keep = |encoder: &mut wgpu::CommandEncoder, iteration: u32| {
            if history {
                let bytes = 4 * u64::from(self.job.cylinders) * u64::from(self.job.node_count);
                let to = bytes * u64::from(iteration);
                encoder.copy_buffer_to_buffer(self.radii(), 0, &self.buffers["history"], to, Some(bytes));
            }
        };
        keep(encoder, 0);
        let is_done = |stage: Stage| match stage {
            Stage::Project => self.job.single == 1 || done >= CpuStages::Project,
            Stage::Group => done >= CpuStages::Group,
            _ => false,
        };
        let of = |stage: Stage| passes.iter().filter(move |p| p.pass.stage == stage && !is_done(stage));
        let before = [Stage::Project, Stage::Group, Stage::Classify].into_iter().flat_map(of).map(|p| (p, 0));
        let iterations = done.iterations()..self.iterations;
        let iterated = iterations.flat_map(|i| of(Stage::Iterate).map(move |p| (p, i)));
        let after = of(Stage::Support).map(|p| (p, 0));

        let mut steps = before.chain(iterated).chain(after).peekable();
        while let Some((first, _)) = steps.peek() {
            let timestamp_writes = timer(first.pass.shader.name);
            let timed = timestamp_writes.is_some();
            let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("lumenmesh fit"),
                timestamp_writes,
            });
            let mut finished = None;
            for (ready, iteration) in steps.by_ref() {
                self.dispatch(context, ready, iteration, &mut compute)?;
                let ends_iteration = ready.pass.shader.name == "update";
                finished = ends_iteration.then_some(iteration + 1);
                // A timed pass stands alone; the history is copied between iterations.
                if timed || (history && ends_iteration) {
                    break;
                }
            }
            drop(compute);
            if let Some(iteration) = finished {
                keep(encoder, iteration);
            }
        }
        Ok(())
    }
}
