//! The device memory of a wall's fit, and the recording of its passes.

use super::ReadyPass;
use super::pass::{Items, Pass};
use crate::gpu::{Buffers, Context, GpuError, Timer, checked, dispatch_size};
use crate::sweep::wall::passes::{
    APPLY_COLUMNS, ASCEND_COLUMNS, DeviceEcho, Level, MOST_OF_ONE, NextStep, State, WallParameters,
    tile_count,
};
use std::collections::BTreeMap;
use std::ops::Range;

/// The device memory of a wall and the echoes about it.
///
/// Echoes lie in chunks, each in buffers of its own, since devices limit the size of a binding. Passes over
/// echoes run once per chunk. All other passes bind the parameters of the first chunk, which differ from
/// those of the others in the number of echoes only.
pub struct WallWorkspace {
    parameters: WallParameters,
    levels: Vec<Level>,
    buffers: Buffers,
    chunks: Vec<Chunk>,
    /// Of the passes that process no echoes, for each grid where a pass takes grids.
    bind_groups: BTreeMap<&'static str, Vec<wgpu::BindGroup>>,
}

struct Chunk {
    echoes: u32,
    buffers: Buffers,
    bind_groups: BTreeMap<&'static str, wgpu::BindGroup>,
}

/// Bytes from one grid to the next: a binding may begin at every one.
const LEVEL_BYTES: u64 = size_of::<Level>() as u64;

/// Bytes per echo in the largest of its buffers.
const ECHO_BYTES: u64 = size_of::<DeviceEcho>() as u64;

/// Name and size in bytes of the buffers that belong to no chunk.
fn sizes(parameters: &WallParameters) -> Vec<(&'static str, u64)> {
    let nodes = u64::from(parameters.node_count);
    let levels = parameters.levels();
    let all = levels.iter().map(|level| u64::from(level.count)).sum::<u64>();
    let tiles = |columns| u64::from(tile_count(parameters, &levels[0], columns));
    vec![
        ("state", size_of::<State>() as u64),
        ("next_step", size_of::<NextStep>() as u64),
        ("counts", 4 * 256),
        ("levels", LEVEL_BYTES * levels.len() as u64),
        ("wall", 4 * nodes),
        ("sums_low", 20 * nodes),
        ("sums_high", 20 * nodes),
        ("rows", 16 * nodes),
        ("own", 8 * all),
        ("rights", 4 * all),
        ("values", 4 * all),
        ("results", 4 * all),
        ("direction", 4 * nodes),
        ("product", 4 * nodes),
        ("change", 4 * nodes),
        ("squares", 4 * tiles(ASCEND_COLUMNS)),
        ("curvatures", 4 * tiles(APPLY_COLUMNS)),
        ("travels", 8 * nodes.div_ceil(256)),
    ]
}

/// The numbers of echoes of the chunks that a device holds them in. Without echoes there is one empty chunk.
fn chunks(context: &Context, echoes: usize) -> Vec<u32> {
    let limits = context.device.limits();
    let max_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    // No chunk needs more than 2³² of anything.
    let most = (max_bytes / ECHO_BYTES).clamp(1, u64::from(u32::MAX / 16)) as usize;
    (0..echoes.max(1)).step_by(most).map(|first| most.min(echoes - first) as u32).collect()
}

/// Whether a pass runs once per chunk of echoes.
fn is_of_echoes(items: Items) -> bool {
    matches!(items, Items::Echoes | Items::EchoBlocks)
}

/// Name and size in bytes of the buffers of a chunk.
fn chunk_sizes(echoes: u32) -> [(&'static str, u64); 4] {
    let count = u64::from(echoes);
    let parameters = size_of::<WallParameters>() as u64;
    [
        ("parameters", parameters),
        ("echoes", ECHO_BYTES * count),
        ("shifts", 8 * count),
        ("residuals", 4 * count),
    ]
}

impl WallWorkspace {
    pub(super) fn new(
        context: &Context,
        passes: &[ReadyPass],
        parameters: &WallParameters,
        echoes: usize,
        kept: Option<Self>,
    ) -> Result<Self, GpuError> {
        let counts = chunks(context, echoes);
        if let Some(mut kept) = kept.filter(|kept| kept.suits(context, parameters, echoes)) {
            kept.chunks.iter_mut().zip(counts).for_each(|(chunk, count)| chunk.echoes = count);
            kept.start(context, parameters)?;
            return Ok(kept);
        }
        let buffers = Buffers::new(context, passes, &sizes(parameters))?;
        let chunk = |echoes: u32| {
            let own = Buffers::new(context, passes, &chunk_sizes(echoes))?;
            let bind_groups = passes
                .iter()
                .filter(|ready| is_of_echoes(ready.pass.items))
                .map(|ready| {
                    let find = |name| own.find(name).unwrap_or_else(|| &buffers[name]).as_entire_binding();
                    Ok((ready.pass.shader.name, ready.pipeline.bind(&context.device, find)?))
                })
                .collect::<Result<_, GpuError>>()?;
            Ok(Chunk { echoes, buffers: own, bind_groups })
        };
        let chunks: Vec<Chunk> = counts.into_iter().map(chunk).collect::<Result<_, GpuError>>()?;
        let levels = parameters.levels();
        let bind = |ready: &ReadyPass, level: usize| {
            ready.pipeline.bind(&context.device, |name| {
                let buffer = chunks[0].buffers.find(name).unwrap_or_else(|| &buffers[name]);
                let offset = if name == "levels" { LEVEL_BYTES * level as u64 } else { 0 };
                wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size: None })
            })
        };
        let bind_groups = passes
            .iter()
            .filter(|ready| !is_of_echoes(ready.pass.items))
            .map(|ready| {
                let shader = &ready.pass.shader;
                let takes_levels = shader.bindings.iter().any(|binding| binding.buffer == "levels");
                let count = if takes_levels { levels.len() } else { 1 };
                let of_each = (0..count).map(|level| bind(ready, level)).collect::<Result<_, GpuError>>()?;
                Ok((shader.name, of_each))
            })
            .collect::<Result<_, GpuError>>()?;
        let mut workspace = Self { parameters: *parameters, levels, buffers, chunks, bind_groups };
        workspace.start(context, parameters)?;
        Ok(workspace)
    }

    /// Whether the memory is of like size as a wall and that many echoes need.
    pub(super) fn suits(&self, context: &Context, parameters: &WallParameters, echoes: usize) -> bool {
        let counts = chunks(context, echoes);
        self.buffers.suit(&sizes(parameters))
            && self.chunks.len() == counts.len()
            && self.chunks.iter().zip(counts).all(|(chunk, count)| chunk.buffers.suit(&chunk_sizes(count)))
    }

    /// The state before the first pass: a tube, and echoes that are their own projections.
    fn start(&mut self, context: &Context, parameters: &WallParameters) -> Result<(), GpuError> {
        let mut encoder = context.device.create_command_encoder(&Default::default());
        let zeroed = ["wall", "counts"].map(|name| self.shared(name));
        for buffer in zeroed.into_iter().chain(self.of_chunks("shifts")) {
            encoder.clear_buffer(buffer, 0, None);
        }
        checked(&context.device, "start of a wall", || context.queue.submit([encoder.finish()]))?;
        self.set_parameters(context, parameters)
    }

    /// Writes what each of some items is converted to: as many as there are echoes.
    pub(super) fn write_echoes<T: Sync>(
        &self,
        context: &Context,
        items: &[T],
        convert: impl Fn(&T) -> DeviceEcho + Sync,
    ) -> Result<(), GpuError> {
        let mut left = items;
        for chunk in &self.chunks {
            let (items, others) = left.split_at(chunk.echoes as usize);
            context.write_converted(&chunk.buffers["echoes"], items, &convert)?;
            left = others;
        }
        Ok(())
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

    /// The number of grids that are too large for one workgroup, the finest always among them.
    pub fn large_levels(&self) -> usize {
        let all = self.levels.last().map_or(0, |coarsest| coarsest.first + coarsest.count);
        self.levels.iter().skip(1).take_while(|level| all - level.first > MOST_OF_ONE).count() + 1
    }

    /// The grids that a pass over grids can run on; passes that do not take any run once.
    pub(super) fn levels_of(&self, items: Items) -> Range<usize> {
        match items {
            Items::LevelTiles(_) | Items::CoarserNodes => 0..self.levels.len() - 1,
            Items::CoarseGrids => self.large_levels()..self.large_levels() + 1,
            _ => 0..1,
        }
    }

    /// The number of grids.
    pub(super) fn level_count(&self) -> usize {
        self.levels.len()
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
        self.levels = parameters.levels();
        context.write(self.shared("levels"), bytemuck::cast_slice(&self.levels))?;
        self.parameters =
            WallParameters { echoes: self.chunks.first().map_or(0, |chunk| chunk.echoes), ..*parameters };
        Ok(())
    }

    /// Puts a pass over a grid into a compute pass; where it processes echoes, over all chunks of them.
    fn dispatch(
        &self,
        context: &Context,
        (ready, level): (&ReadyPass, usize),
        compute: &mut wgpu::ComputePass,
    ) -> Result<(), GpuError> {
        let Pass { shader, items, .. } = ready.pass;
        compute.set_pipeline(ready.pipeline.get(&context.device, 0)?);
        let mut dispatch = |bind_group: &wgpu::BindGroup, count: u32| {
            let [x, y] = dispatch_size(count);
            if count > 0 {
                compute.set_bind_group(0, bind_group, &[]);
                compute.dispatch_workgroups(x, y, 1);
            }
        };
        let count = match items {
            Items::Echoes | Items::EchoBlocks => {
                let size = if *items == Items::Echoes { shader.workgroup_size } else { 4096 };
                for chunk in &self.chunks {
                    dispatch(&chunk.bind_groups[shader.name], chunk.echoes.div_ceil(size));
                }
                return Ok(());
            }
            Items::One | Items::CoarseGrids => 1,
            Items::NodeBlocks => self.parameters.node_count.div_ceil(1024),
            Items::Nodes => self.parameters.node_count.div_ceil(shader.workgroup_size),
            Items::Tiles(columns) | Items::LevelTiles(columns) => {
                self.levels.get(level).map_or(0, |level| tile_count(&self.parameters, level, *columns))
            }
            Items::CoarserNodes => {
                let count = self.levels.get(level + 1).map_or(0, |level| level.count);
                count.div_ceil(shader.workgroup_size)
            }
        };
        let of_levels = &self.bind_groups[shader.name];
        dispatch(of_levels.get(level).unwrap_or(&of_levels[0]), count);
        Ok(())
    }

    /// Records passes over grids one after the other, each in a compute pass of its own where `timer` gives timestamps.
    pub(super) fn record<'a>(
        &self,
        context: &Context,
        passes: impl IntoIterator<Item = (&'a ReadyPass, usize)>,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
    ) -> Result<(), GpuError> {
        let mut passes = passes.into_iter().peekable();
        while let Some((first, _)) = passes.peek() {
            let timestamp_writes = timer(first.pass.shader.name);
            let timed = timestamp_writes.is_some();
            let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("lumenmesh wall"),
                timestamp_writes,
            });
            for pass in passes.by_ref() {
                self.dispatch(context, pass, &mut compute)?;
                if timed {
                    break;
                }
            }
        }
        Ok(())
    }
}
