//! The passes on the device: what each binds and how many invocations a workgroup has, written once.

use super::GpuError;
use crate::fit::passes::ANGLE_COEFFICIENTS;
use std::fmt::Write;
use std::sync::OnceLock;

/// How a pass uses a buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// A uniform block.
    Uniform,
    /// Storage, read only.
    Read,
    /// Storage, read and written.
    Write,
}

/// When a pass runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Once, to bring points into tubes.
    Project,
    /// Once, to group them by face.
    Group,
    /// Once, to find the long faces.
    Classify,
    /// In every iteration.
    Iterate,
    /// Once, after the last iteration.
    Support,
}

/// What a pass has a workgroup or an invocation for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// A workgroup a pair of cylinder and frame.
    Pairs,
    /// An invocation a point before the gate.
    Slots,
    /// A workgroup for every 1024 faces of the batch.
    Blocks,
    /// One workgroup.
    One,
    /// An invocation a face of the batch.
    AllFaces,
    /// [`LANES`] invocations a face, cylinder by cylinder.
    ShortFaces,
    /// A workgroup a long face at a time.
    LongFaces,
    /// An invocation a face, cylinder by cylinder.
    Faces,
    /// An invocation a node, cylinder by cylinder.
    Nodes,
}

/// A row of the pass table.
#[derive(Debug)]
pub struct Pass {
    /// Name of the pass and of its file in `shaders/`.
    pub name: &'static str,
    /// Its WGSL, without what it shares with others.
    pub own_source: &'static str,
    /// Files of `shaders/common/` that it needs, by content.
    pub common: &'static [&'static str],
    /// Its buffers in the order of their binding numbers.
    pub bindings: &'static [(&'static str, Access)],
    /// Invocations a workgroup.
    pub workgroup_size: u32,
    /// When it runs.
    pub stage: Stage,
    /// What its workgroups are for.
    pub items: Items,
}

const JOB: &str = include_str!("../../../shaders/common/job.wgsl");
const ANGLE: &str = include_str!("../../../shaders/common/angle.wgsl");
const DISTANCE: &str = include_str!("../../../shaders/common/distance.wgsl");
const FILTER: &str = include_str!("../../../shaders/common/filter.wgsl");

macro_rules! pass {
    ($name:literal, $stage:ident, $items:ident, $size:literal, [$($common:ident),*],
     [$($binding:literal: $access:ident),* $(,)?]) => {
        Pass {
            name: $name,
            own_source: include_str!(concat!("../../../shaders/", $name, ".wgsl")),
            common: &[JOB, $($common),*],
            bindings: &[("job", Access::Uniform), $(($binding, Access::$access)),*],
            workgroup_size: $size,
            stage: Stage::$stage,
            items: Items::$items,
        }
    };
}

/// Every pass, in the order in which they run.
pub static PASSES: [Pass; 13] = [
    pass!("project", Project, Pairs, 64, [ANGLE], [
        "cylinders": Read, "points": Read, "pairs": Read, "section": Write, "owners": Write, "gated": Write,
    ]),
    pass!("bin", Group, Slots, 256, [], ["section": Read, "owners": Read, "counts": Write, "places": Write]),
    pass!("scan_reduce", Group, Blocks, 256, [], ["counts": Read, "block_sums": Write]),
    pass!("scan_spine", Group, One, 256, [], ["block_sums": Write]),
    pass!("scan_downsweep", Group, Blocks, 256, [], ["counts": Read, "block_sums": Read, "offsets": Write]),
    pass!("scatter", Group, Slots, 256, [], ["section": Read, "places": Read, "offsets": Read, "grouped": Write]),
    pass!("classify", Classify, AllFaces, 256, [], ["offsets": Read, "long_faces": Write]),
    pass!("measure_short", Iterate, ShortFaces, 128, [DISTANCE, FILTER], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "statistics": Write,
    ]),
    pass!("measure_long", Iterate, LongFaces, 256, [DISTANCE, FILTER], [
        "cylinders": Read, "offsets": Read, "grouped": Read, "radii": Read, "statistics": Write,
        "long_faces": Write, "keys": Write,
    ]),
    pass!("fill_bottom", Iterate, Faces, 64, [], ["statistics": Read, "values": Write]),
    pass!("fill_top", Iterate, Faces, 64, [], ["statistics": Read, "values": Write]),
    pass!("update", Iterate, Nodes, 64, [FILTER], ["cylinders": Read, "values": Read, "radii": Write, "travels": Write]),
    pass!("support", Support, Nodes, 64, [], [
        "statistics": Read, "support": Write, "residuals": Write, "tallies": Write,
        "offsets": Read,
    ]),
];

/// Invocations a short face that `measure_short` is built for.
pub const LANES: [u32; 5] = [2, 4, 8, 16, 32];

impl Pass {
    /// The whole WGSL text.
    pub fn source(&self) -> String {
        let mut source = String::new();
        if self.common.contains(&ANGLE) {
            source.push_str(&angle_constants());
        }
        for common in self.common {
            source.push_str(common);
        }
        source.push_str(self.own_source);
        source
    }
}

/// The constants of the arc tangent, from their one home in Rust. An f32 printed as f64 comes back exactly.
fn angle_constants() -> String {
    use std::f32::consts::{FRAC_PI_2, PI, TAU};
    let mut text = String::new();
    let mut constant = |name: String, value: f32| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "const {name}: f32 = {:?};", f64::from(value));
    };
    for (i, c) in ANGLE_COEFFICIENTS.into_iter().enumerate() {
        constant(format!("ANGLE_{i}"), c);
    }
    constant("ANGLE_HALF_PI".into(), FRAC_PI_2);
    constant("ANGLE_PI".into(), PI);
    constant("ANGLE_TAU".into(), TAU);
    text
}

/// A pass made ready on a device.
pub struct Pipeline {
    /// Its row in the table.
    pub pass: &'static Pass,
    /// Layout of its one bind group.
    pub layout: wgpu::BindGroupLayout,
    /// One variant, or for `measure_short` one for each of [`LANES`], made when first needed.
    variants: [OnceLock<wgpu::ComputePipeline>; LANES.len()],
    module: wgpu::ShaderModule,
    pipeline_layout: wgpu::PipelineLayout,
}

impl Pipeline {
    /// Compiles the shader of a pass.
    pub(super) fn new(device: &wgpu::Device, pass: &'static Pass) -> Result<Self, GpuError> {
        super::context::checked(device, pass.name, || {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(pass.name),
                source: wgpu::ShaderSource::Wgsl(pass.source().into()),
            });
            let entries: Vec<_> = pass
                .bindings
                .iter()
                .enumerate()
                .map(|(binding, (_, access))| wgpu::BindGroupLayoutEntry {
                    binding: binding as u32,
                    visibility: wgpu::ShaderStages::COMPUTE,
                    ty: wgpu::BindingType::Buffer {
                        ty: match access {
                            Access::Uniform => wgpu::BufferBindingType::Uniform,
                            Access::Read => wgpu::BufferBindingType::Storage { read_only: true },
                            Access::Write => wgpu::BufferBindingType::Storage { read_only: false },
                        },
                        has_dynamic_offset: false,
                        min_binding_size: None,
                    },
                    count: None,
                })
                .collect();
            let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(pass.name),
                entries: &entries,
            });
            let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(pass.name),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            Self { pass, layout, variants: Default::default(), module, pipeline_layout }
        })
    }

    /// The pipeline itself; `lanes` matters to `measure_short` alone.
    pub(super) fn get(&self, device: &wgpu::Device, lanes: u32) -> Result<&wgpu::ComputePipeline, GpuError> {
        let many = self.pass.items == Items::ShortFaces;
        let variant = if many { LANES.iter().position(|&l| l == lanes).unwrap_or(0) } else { 0 };
        let cell = &self.variants[variant];
        if let Some(pipeline) = cell.get() {
            return Ok(pipeline);
        }
        let constants = [("LANES", f64::from(LANES[variant]))];
        let pipeline = super::context::checked(device, self.pass.name, || {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(self.pass.name),
                layout: Some(&self.pipeline_layout),
                module: &self.module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: if many { &constants } else { &[] },
                    // Every pass sets what it reads.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        })?;
        Ok(cell.get_or_init(|| pipeline))
    }
}
