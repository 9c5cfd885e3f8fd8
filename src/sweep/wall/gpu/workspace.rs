//! The device memory of a wall's fit and the recording of its passes.

use super::pass::{Items, Pass};
use super::{PASSES, ReadyPass};
use crate::gpu::{Buffers, Context, GpuError};
use crate::sweep::wall::passes::{Echo, Job, State, waves};
use std::collections::BTreeMap;

/// The device memory of a wall and the echoes about it.
///
/// Echoes lie in chunks, each in buffers of its own, since no binding is larger than a device allows. Passes over echoes
/// run once a chunk; all others see the first chunk's job, which differs from the others' in the number of echoes alone.
pub struct Workspace {
    job: Job,
    buffers: Buffers,
    chunks: Vec<Chunk>,
}

struct Chunk {
    echoes: u32,
    buffers: Buffers,
    bind_groups: BTreeMap<&'static str, wgpu::BindGroup>,
}

/// Bytes that an echo takes in the largest of its buffers.
const ECHO_BYTES: u64 = size_of::<Echo>() as u64;

/// Name and size in bytes of the buffers that belong to no chunk.
fn sizes(job: &Job) -> Vec<(&'static str, u64)> {
    let [nodes, rings, around, blocks] = [job.node_count, job.rings, job.nodes, job.blocks].map(u64::from);
    let frequencies = around / 2 + 1;
    vec![
        ("state", size_of::<State>() as u64),
        ("counts", 4 * 256),
        ("wall", 4 * nodes),
        ("sums_low", 20 * nodes),
        ("sums_high", 20 * nodes),
        ("rows", 16 * nodes),
        ("ring_weights", 4 * rings),
        ("waves", 8 * around),
        ("factors", 20 * rings * frequencies),
        ("joints", 32 * (blocks - 1) * frequencies),
        ("pulls", 16 * blocks * around),
        ("residual", 4 * nodes),
        ("parts", 8 * nodes),
        ("spectrum", 4 * nodes),
        ("preconditioned", 4 * nodes),
        ("direction", 4 * nodes),
        ("product", 4 * nodes),
        ("change", 4 * nodes),
        ("partials", 4 * nodes.div_ceil(256).max(u64::from(wave_groups(job)))),
    ]
}

/// Workgroups that join waves: 256 frequencies each.
fn wave_groups(job: &Job) -> u32 {
    (job.rings * (job.nodes / 2 + 1)).div_ceil(256)
}

impl Workspace {
    pub(super) fn new(
        context: &Context,
        passes: &[ReadyPass],
        job: &Job,
        echoes: &[Echo],
    ) -> Result<Self, GpuError> {
        let limits = context.device.limits();
        let most_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        // No chunk needs more than 2³² of anything.
        let most_echoes = (most_bytes / ECHO_BYTES).clamp(1, u64::from(u32::MAX / 16)) as usize;
        let buffers = Buffers::new(context, &sizes(job), &[])?;
        let chunk = |echoes: &[Echo]| {
            let count = echoes.len() as u64;
            let job_bytes = size_of::<Job>() as u64;
            let sizes = [
                ("job", job_bytes),
                ("echoes", ECHO_BYTES * count),
                ("shifts", 8 * count),
                ("misses", 4 * count),
            ];
            let own = Buffers::new(context, &sizes, &[])?;
            let bind_groups = passes
                .iter()
                .map(|ready| {
                    let find = |name| own.find(name).unwrap_or_else(|| &buffers[name]).as_entire_binding();
                    Ok((ready.pass.shader.name, ready.pipeline.bind(&context.device, find)?))
                })
                .collect::<Result<_, GpuError>>()?;
            context.write(&own["echoes"], bytemuck::cast_slice(echoes));
            Ok(Chunk { echoes: echoes.len() as u32, buffers: own, bind_groups })
        };
        // Without an echo there is one chunk without one.
        let chunks = match echoes {
            [] => vec![chunk(&[])?],
            _ => echoes.chunks(most_echoes).map(chunk).collect::<Result<_, GpuError>>()?,
        };
        let mut workspace = Self { job: *job, buffers, chunks };
        context.write(workspace.shared("waves"), bytemuck::cast_slice(&waves(job.nodes)));
        workspace.set_job(context, job);
        Ok(workspace)
    }

    /// What the passes know of the job.
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// How many chunks the echoes lie in.
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Device memory of all buffers, bytes.
    pub fn bytes(&self) -> u64 {
        self.buffers.bytes() + self.chunks.iter().map(|chunk| chunk.buffers.bytes()).sum::<u64>()
    }

    /// A buffer by its name in the pass table; of those that every chunk has, the first chunk's.
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

    /// How many echoes each chunk has.
    pub(super) fn echo_counts(&self) -> impl Iterator<Item = usize> {
        self.chunks.iter().map(|chunk| chunk.echoes as usize)
    }

    /// Workgroups that join waves.
    pub(super) fn wave_groups(&self) -> usize {
        wave_groups(&self.job) as usize
    }

    /// Tells the passes of a job on the same grid.
    pub(super) fn set_job(&mut self, context: &Context, job: &Job) {
        for chunk in &self.chunks {
            let job = Job { echoes: chunk.echoes, ..*job };
            context.write(&chunk.buffers["job"], bytemuck::bytes_of(&job));
        }
        self.job = Job { echoes: self.chunks.first().map_or(0, |chunk| chunk.echoes), ..*job };
    }

    /// Puts a pass into a compute pass, over all chunks where it goes over echoes.
    pub(super) fn dispatch(
        &self,
        context: &Context,
        ready: &ReadyPass,
        compute: &mut wgpu::ComputePass,
    ) -> Result<(), GpuError> {
        let Pass { shader, items, .. } = ready.pass;
        compute.set_pipeline(ready.pipeline.get(&context.device, 0)?);
        for chunk in &self.chunks {
            let (job, size) = (&self.job, shader.workgroup_size);
            let count = match items {
                Items::Echoes => chunk.echoes.div_ceil(size),
                Items::EchoBlocks => chunk.echoes.div_ceil(4096),
                Items::One => 1,
                Items::Nodes => job.node_count.div_ceil(size),
                Items::Rings => job.rings,
                Items::Frequencies => wave_groups(job),
                Items::BlockWaves => (job.blocks * job.nodes).div_ceil(size),
                Items::Waves => job.nodes.div_ceil(size),
            };
            // A dimension holds 65,535 at most.
            let rows = count.div_ceil(65_535).max(1);
            if count > 0 {
                compute.set_bind_group(0, &chunk.bind_groups[shader.name], &[]);
                compute.dispatch_workgroups(count.div_ceil(rows), rows, 1);
            }
            if !matches!(items, Items::Echoes | Items::EchoBlocks) {
                break;
            }
        }
        Ok(())
    }
}

/// The row of a pass.
pub(super) fn row(name: &str) -> Option<usize> {
    PASSES.iter().position(|pass| pass.shader.name == name)
}
