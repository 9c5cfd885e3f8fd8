//! The device memory of a wall's fit, and the recording of its passes.

use super::ReadyPass;
use super::pass::{Items, Pass};
use crate::gpu::{Buffers, Context, GpuError, Timer, dispatch_size};
use crate::sweep::wall::passes::{DeviceEcho, State, WallParameters, twiddles};
use std::collections::BTreeMap;

/// The device memory of a wall and the echoes about it.
///
/// Echoes lie in chunks, each in buffers of its own, since devices limit the size of a binding. Passes over
/// echoes run once per chunk. All other passes bind the parameters of the first chunk, which differ from
/// those of the others in the number of echoes only.
pub struct WallWorkspace {
    parameters: WallParameters,
    buffers: Buffers,
    chunks: Vec<Chunk>,
}

struct Chunk {
    echoes: u32,
    buffers: Buffers,
    bind_groups: BTreeMap<&'static str, wgpu::BindGroup>,
}

/// Bytes per echo in the largest of its buffers.
const ECHO_BYTES: u64 = size_of::<DeviceEcho>() as u64;

/// Name and size in bytes of the buffers that belong to no chunk.
fn sizes(parameters: &WallParameters) -> Vec<(&'static str, u64)> {
    let [nodes, rings, around, blocks] =
        [parameters.node_count, parameters.rings, parameters.nodes, parameters.blocks].map(u64::from);
    let frequencies = around / 2 + 1;
    vec![
        ("state", size_of::<State>() as u64),
        ("counts", 4 * 256),
        ("wall", 4 * nodes),
        ("sums_low", 20 * nodes),
        ("sums_high", 20 * nodes),
        ("rows", 16 * nodes),
        ("ring_weights", 4 * rings),
        ("twiddles", 8 * around),
        ("factors", 20 * rings * frequencies),
        ("separators", 32 * (blocks - 1) * frequencies),
        ("updates", 16 * blocks * around),
        ("cg_residual", 4 * nodes),
        ("intermediate", 8 * nodes),
        ("spectrum", 4 * nodes),
        ("preconditioned", 4 * nodes),
        ("direction", 4 * nodes),
        ("product", 4 * nodes),
        ("change", 4 * nodes),
        ("partials", 4 * (2 * nodes.div_ceil(256)).max(u64::from(frequency_groups(parameters)))),
    ]
}

/// Workgroups of the second stage of a transform: 256 frequencies each.
fn frequency_groups(parameters: &WallParameters) -> u32 {
    (parameters.rings * (parameters.nodes / 2 + 1)).div_ceil(256)
}

impl WallWorkspace {
    pub(super) fn new(
        context: &Context,
        passes: &[ReadyPass],
        parameters: &WallParameters,
        echoes: &[DeviceEcho],
    ) -> Result<Self, GpuError> {
        let limits = context.device.limits();
        let max_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        // No chunk needs more than 2³² of anything.
        let max_echoes = (max_bytes / ECHO_BYTES).clamp(1, u64::from(u32::MAX / 16)) as usize;
        let buffers = Buffers::new(context, passes, &sizes(parameters))?;
        let chunk = |echoes: &[DeviceEcho]| {
            let count = echoes.len() as u64;
            let parameters_bytes = size_of::<WallParameters>() as u64;
            let sizes = [
                ("parameters", parameters_bytes),
                ("echoes", ECHO_BYTES * count),
                ("shifts", 8 * count),
                ("residuals", 4 * count),
            ];
            let own = Buffers::new(context, passes, &sizes)?;
            let bind_groups = passes
                .iter()
                .map(|ready| {
                    let find = |name| own.find(name).unwrap_or_else(|| &buffers[name]).as_entire_binding();
                    Ok((ready.pass.shader.name, ready.pipeline.bind(&context.device, find)?))
                })
                .collect::<Result<_, GpuError>>()?;
            context.write(&own["echoes"], bytemuck::cast_slice(echoes))?;
            Ok(Chunk { echoes: echoes.len() as u32, buffers: own, bind_groups })
        };
        // Without echoes there is one empty chunk.
        let chunks = match echoes {
            [] => vec![chunk(&[])?],
            _ => echoes.chunks(max_echoes).map(chunk).collect::<Result<_, GpuError>>()?,
        };
        let mut workspace = Self { parameters: *parameters, buffers, chunks };
        context.write(workspace.shared("twiddles"), bytemuck::cast_slice(&twiddles(parameters.nodes)))?;
        workspace.set_parameters(context, parameters)?;
        Ok(workspace)
    }

    /// The parameters of the passes.
    pub fn parameters(&self) -> &WallParameters {
        &self.parameters
    }

    /// The number of chunks of echoes.
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Device memory of all buffers, bytes.
    pub fn bytes(&self) -> u64 {
        self.buffers.bytes() + self.chunks.iter().map(|chunk| chunk.buffers.bytes()).sum::<u64>()
    }

    /// A buffer by its name in the pass table; the first chunk's, where every chunk has one.
    pub fn find(&self, name: &str) -> Option<&wgpu::Buffer> {
        self.buffers.find(name).or_else(|| self.chunks.first()?.buffers.find(name))
    }

    /// A buffer that belongs to no chunk.
    pub(super) fn shared(&self, name: &str) -> &wgpu::Buffer {
        &self.buffers[name]
    }

    /// A buffer of each chunk.
    pub(super) fn of_chunks(&self, name: &str) -> Vec<&wgpu::Buffer> {
        self.chunks.iter().map(|chunk| &chunk.buffers[name]).collect()
    }

    /// The number of echoes of each chunk.
    pub(super) fn echo_counts(&self) -> impl Iterator<Item = usize> {
        self.chunks.iter().map(|chunk| chunk.echoes as usize)
    }

    /// Workgroups of the second stage of a transform: as many as it has partial sums.
    pub(super) fn frequency_groups(&self) -> usize {
        frequency_groups(&self.parameters) as usize
    }

    /// Sets the parameters of the passes; the grid and the number of echoes stay.
    pub(super) fn set_parameters(
        &mut self,
        context: &Context,
        parameters: &WallParameters,
    ) -> Result<(), GpuError> {
        for chunk in &self.chunks {
            let parameters = WallParameters { echoes: chunk.echoes, ..*parameters };
            context.write(&chunk.buffers["parameters"], bytemuck::bytes_of(&parameters))?;
        }
        self.parameters =
            WallParameters { echoes: self.chunks.first().map_or(0, |chunk| chunk.echoes), ..*parameters };
        Ok(())
    }

    /// Puts a pass into a compute pass, over all chunks where it processes echoes.
    fn dispatch(
        &self,
        context: &Context,
        ready: &ReadyPass,
        compute: &mut wgpu::ComputePass,
    ) -> Result<(), GpuError> {
        let Pass { shader, items, .. } = ready.pass;
        compute.set_pipeline(ready.pipeline.get(&context.device, 0)?);
        for chunk in &self.chunks {
            let (parameters, size) = (&self.parameters, shader.workgroup_size);
            let count = match items {
                Items::Echoes => chunk.echoes.div_ceil(size),
                Items::EchoBlocks => chunk.echoes.div_ceil(4096),
                Items::One => 1,
                Items::Nodes => parameters.node_count.div_ceil(size),
                Items::Rings => parameters.rings,
                Items::Frequencies => frequency_groups(parameters),
                Items::BlockCoefficients => (parameters.blocks * parameters.nodes).div_ceil(size),
                Items::Coefficients => parameters.nodes.div_ceil(size),
            };
            if count > 0 {
                let [x, y] = dispatch_size(count);
                compute.set_bind_group(0, &chunk.bind_groups[shader.name], &[]);
                compute.dispatch_workgroups(x, y, 1);
            }
            if !matches!(items, Items::Echoes | Items::EchoBlocks) {
                break;
            }
        }
        Ok(())
    }

    /// Records passes one after the other, each in a compute pass of its own where `timer` gives timestamps.
    pub(super) fn record<'a>(
        &self,
        context: &Context,
        passes: impl IntoIterator<Item = &'a ReadyPass>,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
    ) -> Result<(), GpuError> {
        let mut passes = passes.into_iter().peekable();
        while let Some(first) = passes.peek() {
            let timestamp_writes = timer(first.pass.shader.name);
            let timed = timestamp_writes.is_some();
            let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("lumenmesh wall"),
                timestamp_writes,
            });
            for ready in passes.by_ref() {
                self.dispatch(context, ready, &mut compute)?;
                if timed {
                    break;
                }
            }
        }
        Ok(())
    }
}
