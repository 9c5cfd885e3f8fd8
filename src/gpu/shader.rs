//! The form of a pass: its shader, its bindings and the size of its workgroups.

use super::{GpuError, checked};
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

/// A buffer that a pass binds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Binding {
    /// Name of the variable in the shader.
    pub variable: &'static str,
    /// Name of the buffer: the variable's, unless several passes share a file and bind different buffers.
    pub buffer: &'static str,
    /// How the pass uses it.
    pub access: Access,
}

/// A pass's shader and its requirements.
#[derive(Debug)]
pub struct Shader {
    /// Name of the pass.
    pub name: &'static str,
    /// Name of its WGSL file without the ending: the pass's, unless several passes share the file.
    pub file: &'static str,
    /// Its WGSL, without those files.
    pub own_source: &'static str,
    /// Contents of the files that it shares with others.
    pub common: &'static [&'static str],
    /// Makes the WGSL that comes from Rust and precedes the files, such as constants.
    pub preamble: fn() -> String,
    /// Its buffers in the order of their binding numbers.
    pub bindings: &'static [Binding],
    /// Invocations per workgroup. With more than WebGPU's limit, a device with smaller ones does not get the pass.
    pub workgroup_size: u32,
    /// Values of pipeline constants (`override` in WGSL), the same in every pipeline of the pass.
    pub constants: &'static [(&'static str, f64)],
    /// A pipeline constant and the values that the pass is built for, where there is one.
    pub variants: Option<(&'static str, &'static [u32])>,
    /// Whether it needs subgroups: a device without them does not get the pass.
    pub subgroups: bool,
}

/// A row of a pass table.
#[derive(Debug)]
pub struct Pass<Stage, Items> {
    /// Its shader.
    pub shader: Shader,
    /// The part of the fit to which it belongs.
    pub stage: Stage,
    /// The items that its workgroups or invocations process.
    pub items: Items,
}

/// Makes a [`Shader`] from the file `shaders/FOLDER/NAME.wgsl`, or from another file that several passes
/// share:
///
/// ```text
/// shader!("FOLDER", "NAME" (in "FILE")?, WORKGROUP SIZE, [COMMON, …], ["VARIABLE" (= "BUFFER")?: ACCESS, …],
///     { FIELD: VALUE, … })
/// ```
///
/// The fields at the end are those of [`Shader`] that most passes leave out: `preamble`, `constants`,
/// `variants`, `subgroups`.
macro_rules! shader {
    ($folder:literal, $name:literal in $file:literal, $size:literal, [$($common:expr),* $(,)?],
     [$($variable:literal $(= $buffer:literal)?: $access:ident),* $(,)?],
     { $($field:ident: $value:expr),* $(,)? }) => {
        $crate::gpu::Shader {
            name: $name,
            file: $file,
            own_source: include_str!(concat!(
                env!("CARGO_MANIFEST_DIR"), "/shaders/", $folder, "/", $file, ".wgsl"
            )),
            common: &[$($common),*],
            bindings: &[$($crate::gpu::Binding {
                variable: $variable,
                // The first of the two that is given.
                buffer: [$($buffer,)? $variable][0],
                access: $crate::gpu::Access::$access,
            }),*],
            workgroup_size: $size,
            $($field: $value,)*
            ..$crate::gpu::Shader::EMPTY
        }
    };
    ($folder:literal, $name:literal, $($rest:tt)*) => {
        $crate::gpu::shader::shader!($folder, $name in $name, $($rest)*)
    };
}
pub(crate) use shader;

impl Shader {
    /// A shader without any text.
    pub(crate) const EMPTY: Self = Self {
        name: "",
        file: "",
        own_source: "",
        common: &[],
        preamble: String::new,
        bindings: &[],
        workgroup_size: 1,
        constants: &[],
        variants: None,
        subgroups: false,
    };

    /// The whole WGSL text.
    pub fn source(&self) -> String {
        let mut source = (self.preamble)();
        for common in self.common {
            source.push_str(common);
        }
        source.push_str(self.own_source);
        source
    }
}

/// WGSL of constants that are defined in Rust. An f32 printed as f64 is read back exactly.
pub(crate) fn constants(values: impl IntoIterator<Item = (impl AsRef<str>, f32)>) -> String {
    let mut text = String::new();
    for (name, value) in values {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "const {}: f32 = {:?};", name.as_ref(), f64::from(value));
    }
    text
}

/// The pipelines of a pass.
pub(crate) struct Pipeline {
    pub(crate) shader: &'static Shader,
    layout: wgpu::BindGroupLayout,
    /// One for each of the shader's variants, built when it is first needed.
    variants: Vec<OnceLock<wgpu::ComputePipeline>>,
    module: wgpu::ShaderModule,
    pipeline_layout: wgpu::PipelineLayout,
}

impl Pipeline {
    /// Compiles the shader of a pass.
    pub(crate) fn new(device: &wgpu::Device, shader: &'static Shader) -> Result<Self, GpuError> {
        checked(device, shader.name, || {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(shader.name),
                source: wgpu::ShaderSource::Wgsl(shader.source().into()),
            });
            let entries: Vec<_> = shader
                .bindings
                .iter()
                .enumerate()
                .map(|(binding, Binding { access, .. })| wgpu::BindGroupLayoutEntry {
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
                label: Some(shader.name),
                entries: &entries,
            });
            let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(shader.name),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            let count = shader.variants.map_or(1, |(_, values)| values.len());
            let variants = (0..count).map(|_| OnceLock::new()).collect();
            Self { shader, layout, variants, module, pipeline_layout }
        })
    }

    /// The pipeline itself; `value` is that of the shader's variants, where it has any.
    pub(crate) fn get(&self, device: &wgpu::Device, value: u32) -> Result<&wgpu::ComputePipeline, GpuError> {
        let mut constants = self.shader.constants.to_vec();
        let mut variant = 0;
        if let Some((name, values)) = self.shader.variants {
            variant = values.iter().position(|&v| v == value).unwrap_or(0);
            constants.push((name, f64::from(values[variant])));
        }
        let cell = &self.variants[variant];
        if let Some(pipeline) = cell.get() {
            return Ok(pipeline);
        }
        let pipeline = checked(device, self.shader.name, || {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(self.shader.name),
                layout: Some(&self.pipeline_layout),
                module: &self.module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &constants,
                    // Every pass writes workgroup memory before it reads it.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        })?;
        Ok(cell.get_or_init(|| pipeline))
    }

    /// Builds every variant whose value is among those that are `used`.
    pub(crate) fn warm_up(&self, device: &wgpu::Device, used: impl Fn(u32) -> bool) -> Result<(), GpuError> {
        for &value in self.shader.variants.map_or(&[0][..], |(_, values)| values) {
            if self.shader.variants.is_none() || used(value) {
                self.get(device, value)?;
            }
        }
        Ok(())
    }

    /// Binds buffers to the pass, each found by the buffer's name.
    pub(crate) fn bind<'a>(
        &self,
        device: &wgpu::Device,
        find: impl Fn(&'static str) -> wgpu::BindingResource<'a>,
    ) -> Result<wgpu::BindGroup, GpuError> {
        checked(device, self.shader.name, || {
            let entries: Vec<_> = (0..)
                .zip(self.shader.bindings)
                .map(|(binding, of)| wgpu::BindGroupEntry { binding, resource: find(of.buffer) })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(self.shader.name),
                layout: &self.layout,
                entries: &entries,
            })
        })
    }
}
