//! The buffers of a batch and the recording of its passes.

use super::pass::{Items, LANES, Pass, Stage};
use super::{CpuStages, ReadyPass};
use crate::cylinders::passes::{DeviceCylinder, DevicePair, FitParameters};
use crate::gpu::{Buffers, Context, GpuError, Timer, dispatch_size};
use crate::settings::Settings;
use std::collections::BTreeMap;

/// The source of a batch's points.
pub(super) enum Points<'a> {
    /// Points in their probes' planes, and the pairs whose transforms bring them into tubes.
    Pairs { points: &'a [[f32; 2]], pairs: &'a [DevicePair] },
    /// That many points of one tube, in its coordinates; the caller writes them to the section buffer.
    Section { count: u32 },
}

/// The device memory of a batch of cylinders that are fitted together.
///
/// [`GpuEngine::record`](super::GpuEngine::record) puts the whole fit into a command encoder. It submits nothing, waits
/// for nothing and reads nothing back, and it can record again for as many new points.
pub struct FitWorkspace {
    parameters: FitParameters,
    iterations: u32,
    lanes: u32,
    long_groups: u32,
    buffers: Buffers,
    /// Bind groups by pass, `update`'s by iteration.
    bind_groups: BTreeMap<&'static str, Vec<wgpu::BindGroup>>,
    travel_stride: u64,
}

/// The name and the size in bytes of every buffer of a batch.
pub(super) fn sizes(
    parameters: &FitParameters,
    points: usize,
    iterations: u32,
    history: bool,
    travel_stride: u64,
) -> Vec<(&'static str, u64)> {
    let [slots, faces, nodes, cylinders] = [
        u64::from(parameters.slots),
        u64::from(parameters.cylinders) * u64::from(parameters.faces),
        u64::from(parameters.cylinders) * u64::from(parameters.node_count),
        u64::from(parameters.cylinders),
    ];
    let paired = parameters.single == 0;
    vec![
        ("parameters", size_of::<FitParameters>() as u64),
        ("cylinders", 16 * cylinders),
        ("points", 8 * points as u64),
        ("pairs", size_of::<DevicePair>() as u64 * u64::from(parameters.pairs)),
        ("section", 12 * slots),
        ("owners", if paired { 4 * slots } else { 4 }),
        ("gated", 4 * cylinders),
        ("counts", 4 * faces),
        ("places", 8 * slots),
        ("block_sums", 4 * faces.div_ceil(1024)),
        ("offsets", 4 * (faces + 1)),
        ("grouped", 12 * slots),
        // Their number, the faces, and the number of those that were measured to the end.
        ("long_faces", 4 * (2 + slots / u64::from(parameters.max_short + 1))),
        ("keys", if slots > u64::from(parameters.max_short) { 4 * slots } else { 4 }),
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

/// The number of workgroups that share the long faces, of which there are at most `max_long`: enough to fill a GPU,
/// and a few per thread on software, where even an idle workgroup costs microseconds.
///
/// No workgroup gets more than 128 faces: llvmpipe ends an invocation's loops, without an error, after 65,535 rounds
/// in all, and a face takes about a hundred rounds besides those over its points.
fn long_groups(context: &Context, max_long: u64) -> u64 {
    let groups = if context.is_software() { 2 * rayon::current_num_threads() as u64 } else { 1024 };
    groups.max(max_long.div_ceil(128)).min(max_long)
}

impl FitWorkspace {
    /// Iterations of its fit.
    pub(super) fn iterations(&self) -> u32 {
        self.iterations
    }

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
        let parameters = FitParameters::new(settings, cylinders, slot_count, pairs, lanes);
        let limits = context.device.limits();
        let alignment = u64::from(limits.min_storage_buffer_offset_alignment);
        let travel_stride = (8 * u64::from(cylinders)).next_multiple_of(alignment);
        let sizes = sizes(&parameters, point_count, settings.iterations, history, travel_stride);
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

        let max_long = slots / u64::from(parameters.max_short + 1);
        let workspace = Self {
            parameters,
            iterations: settings.iterations,
            lanes,
            long_groups: long_groups(context, max_long) as u32,
            buffers,
            bind_groups,
            travel_stride,
        };
        let device_cylinders: Vec<DeviceCylinder> =
            radii_mm.iter().map(|&r| DeviceCylinder::new(settings, r)).collect();
        let primitive: Vec<f32> = radii_mm
            .iter()
            .flat_map(|&r| std::iter::repeat_n(r as f32, parameters.node_count as usize))
            .collect();
        workspace.write(context, "parameters", bytemuck::bytes_of(&parameters));
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

    /// Bytes per iteration in the buffer of travels.
    pub(super) fn travel_stride(&self) -> u64 {
        self.travel_stride
    }

    /// The uniform block of the passes.
    pub fn parameters(&self) -> &FitParameters {
        &self.parameters
    }

    /// Device memory of all buffers, bytes.
    pub fn bytes(&self) -> u64 {
        self.buffers.bytes()
    }

    /// The buffer that a host writes its points to: r (mm), θ (rad) and z (mm) of each, f32 ×3.
    pub fn section(&self) -> &wgpu::Buffer {
        &self.buffers["section"]
    }

    /// The buffer of the result: the nodes' radii, mm, f32, ring after ring.
    pub fn radii(&self) -> &wgpu::Buffer {
        &self.buffers["radii"]
    }

    /// The number of workgroups of a pass: two dimensions and the cylinders.
    fn groups(&self, pass: &Pass) -> [u32; 3] {
        let (parameters, size) = (&self.parameters, pass.shader.workgroup_size);
        let all_faces = parameters.cylinders * parameters.faces;
        let (count, layers) = match pass.items {
            Items::Pairs => (parameters.pairs, 1),
            Items::Slots => (parameters.slots.div_ceil(size), 1),
            Items::Blocks => (all_faces.div_ceil(1024), 1),
            Items::One => (1, 1),
            Items::AllFaces => (all_faces.div_ceil(size), 1),
            Items::ShortFaces => (parameters.faces.div_ceil(size / self.lanes), parameters.cylinders),
            Items::LongFaces => (self.long_groups, 1),
            Items::Faces => (parameters.faces.div_ceil(size), parameters.cylinders),
            Items::Nodes => (parameters.node_count.div_ceil(size), parameters.cylinders),
        };
        let [x, y] = dispatch_size(count);
        [x, y, layers]
    }

    /// Puts one pass into a compute pass, unless it has no work.
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

    /// Records one pass alone on the contents of the buffers (`update` as in the first iteration).
    pub(super) fn record_one(
        &self,
        context: &Context,
        ready: &ReadyPass,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<(), GpuError> {
        self.dispatch(context, ready, 0, &mut encoder.begin_compute_pass(&Default::default()))
    }

    /// Records the stages that the CPU has not `done`: grouping, all iterations, support. The buffers hold the
    /// CPU's results; with [`CpuStages::None`] the section buffer of a single tube must hold its points.
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
                let bytes = 4 * u64::from(self.parameters.cylinders) * u64::from(self.parameters.node_count);
                let to = bytes * u64::from(iteration);
                encoder.copy_buffer_to_buffer(self.radii(), 0, &self.buffers["history"], to, Some(bytes));
            }
        };
        keep(encoder, 0);
        let is_done = |stage: Stage| match stage {
            Stage::Project => self.parameters.single == 1 || done >= CpuStages::Project,
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
