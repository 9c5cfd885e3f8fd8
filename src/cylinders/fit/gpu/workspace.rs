//! The buffers of a batch and the recording of its passes.

use super::pass::{Items, LANES, Pass, Stage};
use super::{CpuStages, ReadyPass};
use crate::cylinders::passes::{DeviceCylinder, DevicePair, FitParameters, LIST_HEAD};
use crate::gpu::{Buffers, Context, GpuError, LARGE_WORKGROUP, NARROW_WORKGROUP, Timer, dispatch_size};
use crate::settings::Settings;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The source of a batch's points.
pub(super) enum Points<'a> {
    /// That many points in their probes' planes, and the pairs whose transforms bring them into tubes.
    Pairs { points: usize, pairs: &'a [DevicePair] },
    /// That many points of one tube, in its coordinates.
    Section { count: u32 },
}

/// The device memory of a batch of cylinders that are fitted together.
///
/// [`GpuEngine::record`](super::GpuEngine::record) puts the whole fit into a command encoder. It submits nothing, waits
/// for nothing and reads nothing back, and it can record again for as many new points.
pub struct FitWorkspace {
    parameters: FitParameters,
    iterations: u32,
    classes: Classes,
    /// Whether faces have so many points that several workgroups share the distances of each.
    shared_faces: bool,
    /// Whether workgroups of [`LARGE_WORKGROUP`] invocations are used: a device that has them and is no program, for which
    /// each invocation that waits is work.
    wide: bool,
    middle_groups: u32,
    narrow_groups: u32,
    long_groups: u32,
    buffers: Buffers,
    /// Bind groups by pass: `update`'s by iteration, those of the passes before it for the last iteration and for
    /// the others.
    bind_groups: BTreeMap<&'static str, Vec<wgpu::BindGroup>>,
    travel_stride: u64,
    /// Radii of the primitive tubes, which the device holds.
    radii_mm: Vec<f64>,
}

/// The size of a batch, in all its terms.
pub(super) struct Plan {
    parameters: FitParameters,
    classes: Classes,
    /// Invocations of a subgroup, where one measures a face by itself.
    narrow: Option<u32>,
    shared_faces: bool,
    travel_stride: u64,
    sizes: Vec<(&'static str, u64)>,
}

impl Plan {
    /// Of a batch of so many cylinders. `subgroups` says whether they are used where the device has them.
    pub(super) fn new(
        context: &Context,
        settings: &Settings,
        cylinders: u32,
        points: &Points,
        history: bool,
        subgroups: bool,
    ) -> Result<Self, GpuError> {
        let faces = u64::from(settings.nodes) * u64::from(settings.levels) * u64::from(cylinders);
        let (slots, point_count, pairs) = match points {
            Points::Pairs { points, pairs } => {
                let slots = pairs.last().map_or(0, |p| u64::from(p.first_slot) + u64::from(p.count));
                (slots, *points, Some(pairs.len() as u32))
            }
            Points::Section { count } => (u64::from(*count), 0, None),
        };
        let width = context.subgroup_width().filter(|_| subgroups);
        let narrow = context.narrow_width().filter(|_| subgroups);
        let classes = Classes::new(slots, faces, width, narrow, context.is_software());
        // Slots are numbered in u32, whatever the device could hold.
        let slot_count = u32::try_from(slots).map_err(|_| GpuError::TooLarge {
            name: "section".into(),
            needed: 12 * slots,
            allowed: 12 * u64::from(u32::MAX),
        })?;
        let mut parameters = FitParameters::new(settings, cylinders, slot_count, pairs, classes.lanes());
        if narrow.is_some() {
            let twice_mean = (2 * slots / faces.max(1)).clamp(LEAST_NARROW, MOST_NARROW);
            // Few points make no long face, so that no workgroup has to look for one.
            parameters.max_narrow = if slots <= MOST_NARROW { MOST_NARROW } else { twice_mean } as u32;
            parameters.most_long = most_above(&parameters, parameters.max_narrow) as u32;
        }
        // One window where the points fit a cache anyhow, or the device is a program that has no more than
        // the CPU's.
        if slot_count > WINDOW && !context.is_software() {
            let windows = slot_count.div_ceil(WINDOW).min(MOST_WINDOWS);
            parameters.window = parameters.window.div_ceil(windows);
        }
        let alignment = u64::from(context.device.limits().min_storage_buffer_offset_alignment);
        let travel_stride = (8 * u64::from(cylinders)).next_multiple_of(alignment);
        let sizes = sizes(&parameters, point_count, settings.iterations, history, travel_stride);
        // A program on the CPU has no idle processors that could share them.
        let shared_faces = !classes.few
            && classes.short.lanes == 0
            && slots >= SHARED_FACE * faces
            && !context.is_software();
        Ok(Self { parameters, classes, narrow, shared_faces, travel_stride, sizes })
    }
}

/// Bind groups by pass: `update`'s by iteration, those of the passes before it for the last iteration and for the
/// others.
fn bind_groups(
    context: &Context,
    passes: &[ReadyPass],
    buffers: &Buffers,
    iterations: u32,
    travel_stride: u64,
) -> Result<BTreeMap<&'static str, Vec<wgpu::BindGroup>>, GpuError> {
    let mut bind_groups = BTreeMap::new();
    for ReadyPass { pass, pipeline } in passes {
        let name = pass.shader.name;
        let repeats = match pass.stage {
            Stage::Iterate if name == "update" => iterations,
            Stage::Iterate => 2,
            _ => 1,
        };
        let groups = (0..repeats)
            .map(|place| {
                let part = |name, offset, size| {
                    let buffer = &buffers[name];
                    wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size })
                };
                pipeline.bind(&context.device, |name| match name {
                    "travels" => part(name, travel_stride * u64::from(place), None),
                    "parameters" => {
                        let is_other = repeats == 2 && pass.shader.name != "update" && place == 1;
                        let offset = if is_other { PARAMETERS_STRIDE } else { 0 };
                        part(name, offset, wgpu::BufferSize::new(size_of::<FitParameters>() as u64))
                    }
                    _ => buffers[name].as_entire_binding(),
                })
            })
            .collect::<Result<Vec<_>, GpuError>>()?;
        bind_groups.insert(name, groups);
    }
    Ok(bind_groups)
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
        // For the last iteration and all other stages, then for the iterations before.
        ("parameters", PARAMETERS_STRIDE + size_of::<FitParameters>() as u64),
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
        ("grouped", 16 * slots),
        (
            "listed_faces",
            4 * (LIST_HEAD as u64
                + u64::from(parameters.most_long)
                + most_above(parameters, parameters.max_short)),
        ),
        // Some passes take four at a time.
        ("keys", if slots > u64::from(parameters.max_short) { 4 * slots.next_multiple_of(4) } else { 16 }),
        ("primitive", 4 * nodes),
        ("radii", 4 * nodes),
        // Two triangles each.
        ("triangle_values", 8 * faces),
        ("triangle_support", 16 * faces),
        ("travels", travel_stride * u64::from(iterations.max(1))),
        ("support", 4 * nodes),
        ("residuals", 4 * nodes),
        ("tallies", 8 * cylinders),
        ("history", if history { 4 * nodes * (u64::from(iterations) + 1) } else { 4 }),
    ]
}

/// Most faces of a batch that can have more than so many points.
fn most_above(parameters: &FitParameters, points: u32) -> u64 {
    let faces = u64::from(parameters.cylinders) * u64::from(parameters.faces);
    faces.min(u64::from(parameters.slots) / (u64::from(points) + 1))
}

/// How the faces of a class are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Class {
    /// Invocations per face, each with eight of its points; 0 where there is no such class.
    lanes: u32,
    /// Whether they exchange values in subgroups.
    subgroups: bool,
}

/// The classes of faces below the long ones, by their number of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Classes {
    /// Whether faces have so few points on average that an invocation measures a short one with up to 16.
    few: bool,
    short: Class,
    /// Those of which there are few.
    middle: Class,
}

/// Points of the longest face that one invocation measures, in eights.
const EIGHTS_OF_FEW: u32 = 2;

impl Classes {
    /// The classes for a number of points and faces. Points are spread over the faces about evenly more often
    /// than not: two standard deviations of such a spread still fit a short face, and more faces would be listed
    /// if it were less. `width` is that of the device's subgroups, `narrow` where one measures a face by itself.
    fn new(slots: u64, faces: u64, width: Option<u32>, narrow: Option<u32>, software: bool) -> Self {
        let mean = slots as f64 / faces.max(1) as f64;
        let most = mean + 2.0 * mean.sqrt();
        let short = LANES.into_iter().find(|&lanes| f64::from(8 * lanes) >= most).unwrap_or(0);
        // On a software device lanes without points take as long as others, and more than a subgroup has wait for each other.
        let (growth, most) = narrow.map_or((8, 32), |width| (2, width));
        let short = if short <= most { short } else { 0 };
        let middle = match short {
            0 => 0,
            lanes if lanes == most => 0,
            lanes => (growth * lanes).min(most),
        };
        let class = |lanes| Class { lanes, subgroups: width.is_some_and(|width| lanes <= width) };
        // On a software device the barriers cost more than the distances that they save.
        match short == 1 && !software {
            true => Self { few: true, short: class(0), middle: class(middle) },
            false => Self { few: false, short: class(short), middle: class(middle) },
        }
    }

    fn lanes(&self) -> [u32; 2] {
        match self.few {
            true => [EIGHTS_OF_FEW, self.middle.lanes],
            false => [self.short.lanes, self.middle.lanes],
        }
    }
}

/// Bytes between the parameters of the last iteration and those of the others: a multiple of every device's
/// alignment.
const PARAMETERS_STRIDE: u64 = 256;

/// Points that `scatter` writes at a time, about: 67 MB of them, most of which a large cache holds.
const WINDOW: u32 = 1 << 22;

/// Points of the largest face that a subgroup measures: twice the mean, within these bounds.
const LEAST_NARROW: u64 = 1 << 10;
const MOST_NARROW: u64 = 1 << 15;

/// Most points of the faces that a subgroup measures in turn: some 44 / 32 rounds of its loops for each at worst, of which
/// llvmpipe allows 65,535 in all. With fewer faces more subgroups have none, and take as long as for one.
const NARROW_POINTS: u32 = 40_000;

/// Points per face on average from which several workgroups share a face's distances.
const SHARED_FACE: u64 = 2048;

/// Most points before the gate that one workgroup groups: with more it takes longer than three passes of many workgroups.
const FEW_POINTS: u32 = 1 << 14;

/// Most windows: each of them reads all places.
const MOST_WINDOWS: u32 = 64;

/// Most workgroups of `update` in all: each adds to the two words of its cylinder's travel once.
const MOST_UPDATE_GROUPS: u32 = 2048;

/// The number of workgroups that take so many long faces, or blocks of others, in turn: enough to fill a GPU,
/// and a few per thread on software, where even an idle workgroup costs microseconds.
///
/// No workgroup gets more than 128 faces, or blocks of faces of middle size: llvmpipe ends an invocation's loops, without an error, after 65,535 rounds
/// in all, and a face takes about a hundred rounds besides those over its points.
fn groups_in_turn(context: &Context, most: u64) -> u64 {
    let groups = if context.is_software() { 2 * rayon::current_num_threads() as u64 } else { 1024 };
    groups.max(most.div_ceil(128)).min(most)
}

impl FitWorkspace {
    /// Iterations of its fit.
    pub(super) fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Device memory for a batch, that of `kept` where it is of like size. The caller writes the points.
    pub(super) fn new(
        context: &Context,
        passes: &[ReadyPass],
        plan: Plan,
        radii_mm: &[f64],
        settings: &Settings,
        kept: Option<Self>,
    ) -> Result<Self, GpuError> {
        let Plan { parameters, classes, narrow, shared_faces, travel_stride, sizes } = plan;
        let iterations = settings.iterations;
        let known = kept.as_ref().is_some_and(|kept| {
            kept.radii_mm == radii_mm && kept.parameters.node_count == parameters.node_count
        });
        let (buffers, bind_groups) = match kept {
            Some(kept) => (kept.buffers, kept.bind_groups),
            None => {
                let buffers = Buffers::new(context, passes, &sizes)?;
                let bind_groups = bind_groups(context, passes, &buffers, iterations, travel_stride)?;
                (buffers, bind_groups)
            }
        };
        let middle_blocks = match classes.middle.lanes {
            0 => 0,
            lanes => most_above(&parameters, parameters.max_short).div_ceil(u64::from(128 / lanes)),
        };
        let workspace = Self {
            parameters,
            iterations,
            classes,
            shared_faces,
            wide: context.has_workgroups_of(LARGE_WORKGROUP) && !context.is_software(),
            middle_groups: groups_in_turn(context, middle_blocks) as u32,
            narrow_groups: narrow.map_or(0, |width| {
                let faces = NARROW_WORKGROUP / width * (NARROW_POINTS / parameters.max_narrow);
                most_above(&parameters, parameters.max_middle).div_ceil(u64::from(faces)) as u32
            }),
            long_groups: groups_in_turn(context, most_above(&parameters, parameters.max_narrow)) as u32,
            buffers,
            bind_groups,
            travel_stride,
            radii_mm: radii_mm.to_vec(),
        };
        let before = FitParameters { last: 0, ..parameters };
        let mut both = vec![0; PARAMETERS_STRIDE as usize + size_of::<FitParameters>()];
        both[..size_of::<FitParameters>()].copy_from_slice(bytemuck::bytes_of(&parameters));
        both[PARAMETERS_STRIDE as usize..].copy_from_slice(bytemuck::bytes_of(&before));
        workspace.write(context, "parameters", &both)?;
        if !known {
            let count = parameters.node_count as usize;
            let repeated = |&radius: &f64| rayon::iter::repeat_n(radius as f32, count);
            let primitive: Vec<f32> = radii_mm.par_iter().flat_map(repeated).collect();
            workspace.write(context, "primitive", bytemuck::cast_slice(&primitive))?;
        }
        let device_cylinders: Vec<DeviceCylinder> =
            radii_mm.iter().map(|&r| DeviceCylinder::new(settings, r)).collect();
        workspace.write(context, "cylinders", bytemuck::cast_slice(&device_cylinders))?;
        Ok(workspace)
    }

    /// Whether the memory of this workspace will do for another batch.
    pub(super) fn suits(&self, plan: &Plan, iterations: u32) -> bool {
        let bound = self.bind_groups.get("update").map_or(0, Vec::len);
        self.travel_stride == plan.travel_stride
            && bound >= iterations as usize
            && self.buffers.suit(&plan.sizes)
    }

    pub(super) fn write(&self, context: &Context, name: &str, bytes: &[u8]) -> Result<(), GpuError> {
        context.write(&self.buffers[name], bytes)
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

    /// The buffer that a host writes its points to: r (mm) of all of them, then θ (rad) of all, then z (mm),
    /// f32.
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
        let blocks = (parameters.cylinders * parameters.faces).div_ceil(1024);
        let (count, layers) = match pass.items {
            Items::Pairs => (parameters.pairs, 1),
            Items::Tiles | Items::FewTiles => (parameters.slots.div_ceil(1024), 1),
            Items::Slots => {
                let all_faces = parameters.cylinders * parameters.faces;
                (parameters.slots.div_ceil(size), all_faces.div_ceil(parameters.window))
            }
            Items::SeveralBlocks | Items::Blocks => (blocks, 1),
            Items::Spine | Items::FewPoints | Items::FewPointsWide => (1, 1),
            Items::FewFaces => (parameters.faces.div_ceil(size), parameters.cylinders),
            Items::ShortFaces | Items::ShortFacesShared => {
                (parameters.faces.div_ceil(size / self.classes.short.lanes.max(1)), parameters.cylinders)
            }
            Items::MiddleFaces | Items::MiddleFacesShared => (self.middle_groups, 1),
            Items::NarrowFaces => (self.narrow_groups, 1),
            Items::LongFaces | Items::KeyedFaces | Items::KeyedFacesWide => (self.long_groups, 1),
            Items::Points => (parameters.slots.div_ceil(size), 1),
            Items::Nodes => (parameters.node_count.div_ceil(size), parameters.cylinders),
            Items::NodesInTurn => {
                let most = MOST_UPDATE_GROUPS.div_ceil(parameters.cylinders);
                (parameters.node_count.div_ceil(size).min(most), parameters.cylinders)
            }
        };
        let [x, y] = dispatch_size(count);
        [x, y, layers]
    }

    /// Whether one workgroup groups the points.
    fn has_few_points(&self) -> bool {
        self.parameters.cylinders * self.parameters.faces <= 1024 && self.parameters.slots <= FEW_POINTS
    }

    /// Whether a fit of this size needs a pass.
    fn needs(&self, pass: &Pass) -> bool {
        let several_blocks = self.parameters.cylinders * self.parameters.faces > 1024;
        let work = match pass.items {
            Items::Pairs => self.parameters.single == 0,
            // The sum before the only block is 0, which its buffer holds.
            Items::SeveralBlocks | Items::Spine | Items::Tiles => several_blocks,
            Items::FewTiles => !several_blocks && !self.has_few_points(),
            Items::Blocks | Items::Slots => !self.has_few_points(),
            Items::FewPoints => self.has_few_points() && !self.wide,
            Items::FewPointsWide => self.has_few_points() && self.wide,
            Items::LongFaces => !self.shared_faces,
            Items::Points => self.shared_faces,
            Items::KeyedFaces => self.shared_faces && !self.wide,
            Items::KeyedFacesWide => self.shared_faces && self.wide,
            Items::FewFaces => self.classes.few,
            Items::ShortFaces => self.classes.short.lanes > 0 && self.classes.short.subgroups,
            Items::ShortFacesShared => self.classes.short.lanes > 0 && !self.classes.short.subgroups,
            Items::MiddleFaces => self.classes.middle.subgroups,
            Items::MiddleFacesShared => !self.classes.middle.subgroups,
            _ => true,
        };
        work && self.groups(pass)[0] > 0
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
        let place = match ready.pass.shader.name {
            "update" => iteration as usize,
            _ => usize::from(iteration + 1 < self.iterations),
        };
        // Only the passes of an iteration bind other buffers in some of them.
        if x > 0
            && let Some(bind_group) = bind_groups.get(place).or(bind_groups.first())
        {
            let class = match ready.pass.items {
                Items::MiddleFaces | Items::MiddleFacesShared => self.classes.middle,
                _ => self.classes.short,
            };
            compute.set_pipeline(ready.pipeline.get(&context.device, class.lanes)?);
            compute.set_bind_group(0, bind_group, &[]);
            compute.dispatch_workgroups(x, y, z);
        }
        Ok(())
    }

    /// Records one pass alone on the contents of the buffers, as in the last iteration (`update` as in the first).
    pub(super) fn record_one(
        &self,
        context: &Context,
        ready: &ReadyPass,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<(), GpuError> {
        let iteration = if ready.pass.shader.name == "update" { 0 } else { self.iterations };
        self.dispatch(context, ready, iteration, &mut encoder.begin_compute_pass(&Default::default()))
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
        let all_faces = u64::from(self.parameters.cylinders) * u64::from(self.parameters.faces);
        let all_nodes = u64::from(self.parameters.cylinders) * u64::from(self.parameters.node_count);
        let travels = self.travel_stride * u64::from(self.iterations.max(1));
        let tallies = 8 * u64::from(self.parameters.cylinders);
        // Kept buffers may be larger than this batch needs.
        for (name, bytes) in [("travels", travels), ("tallies", tallies)] {
            encoder.clear_buffer(&self.buffers[name], 0, Some(bytes));
        }
        // The CPU lists the faces where it groups the points, and one workgroup that does clears the list itself.
        if done < CpuStages::Group && !self.has_few_points() {
            encoder.clear_buffer(&self.buffers["counts"], 0, Some(4 * all_faces));
            encoder.clear_buffer(&self.buffers["listed_faces"], 0, Some(4 * LIST_HEAD as u64));
        }
        if done < CpuStages::Project && self.parameters.single == 0 {
            encoder.clear_buffer(&self.buffers["gated"], 0, None);
        }
        if done.iterations() == 0 {
            // Elsewhere every triangle's is written.
            if !(self.classes.few || self.classes.short.lanes > 0) || self.iterations == 0 {
                encoder.clear_buffer(&self.buffers["triangle_values"], 0, Some(8 * all_faces));
                encoder.clear_buffer(&self.buffers["triangle_support"], 0, Some(16 * all_faces));
            }
            let radii = 4 * all_nodes;
            encoder.copy_buffer_to_buffer(&self.buffers["primitive"], 0, self.radii(), 0, Some(radii));
        }
        let keep = |encoder: &mut wgpu::CommandEncoder, iteration: u32| {
            if history {
                let bytes = 4 * all_nodes;
                let to = bytes * u64::from(iteration);
                encoder.copy_buffer_to_buffer(self.radii(), 0, &self.buffers["history"], to, Some(bytes));
            }
        };
        keep(encoder, 0);
        let is_done = |stage: Stage| match stage {
            Stage::Project => done >= CpuStages::Project,
            Stage::Group => done >= CpuStages::Group,
            _ => false,
        };
        let of = |stage: Stage| {
            passes.iter().filter(move |p| p.pass.stage == stage && !is_done(stage) && self.needs(p.pass))
        };
        let before = [Stage::Project, Stage::Group].into_iter().flat_map(of).map(|p| (p, 0));
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
