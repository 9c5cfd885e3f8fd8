//! A pass table made ready on a device: what the engines of both methods share.

use super::shader::Pass;
use super::transfers::copied;
use super::{AdapterDescription, Context, GpuError, Job, Pipeline, Shader, Spent, checked};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Most workgroups in a dimension of a dispatch.
const MAX_WORKGROUPS: u32 = 65_535;

/// Most passes of a submission that are timed: two timestamps each, and a set holds 4096.
const MAX_TIMED_PASSES: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;

/// The first two dimensions of a dispatch of `count` workgroups, or of a few more.
pub(crate) fn dispatch_size(count: u32) -> [u32; 2] {
    match count.div_ceil(MAX_WORKGROUPS) {
        0 => [0, 0],
        rows => [count.div_ceil(rows), rows],
    }
}

/// Gives the timestamps that a pass writes, by the pass's name; `None` where it is not timed.
pub(crate) type Timer<'a> = dyn FnMut(&'static str) -> Option<wgpu::ComputePassTimestampWrites<'a>> + 'a;

/// A pass made ready on a device.
pub(crate) struct ReadyPass<Stage: 'static, Items: 'static> {
    pub(crate) pass: &'static Pass<Stage, Items>,
    pub(crate) pipeline: Pipeline,
}

/// The name of each pass and its time on the device, s.
pub type PassTimes = Vec<(&'static str, f64)>;

/// A device and the passes of a table made ready on it.
pub(crate) struct Runner<Stage: 'static, Items: 'static> {
    pub(crate) context: Context,
    /// In the order of the table.
    pub(crate) passes: Vec<ReadyPass<Stage, Items>>,
    /// Device time of each pass so far, in seconds; `None` while passes are not timed.
    times: Mutex<Option<BTreeMap<&'static str, f64>>>,
    spent: Mutex<Spent>,
}

impl<Stage, Items> Runner<Stage, Items> {
    /// Compiles every shader of a table that the device can run.
    pub(crate) fn new(context: Context, table: &'static [Pass<Stage, Items>]) -> Result<Self, GpuError> {
        let passes = table
            .iter()
            .filter(|pass| !pass.shader.subgroups || context.subgroup_width().is_some())
            // Workgroups within the standard's limits are not left out but refused by a device that has less.
            .filter(|Pass { shader, .. }| {
                shader.workgroup_size <= wgpu::Limits::default().max_compute_invocations_per_workgroup
                    || context.has_workgroups_of(shader.workgroup_size)
            })
            .map(|pass| Ok(ReadyPass { pass, pipeline: Pipeline::new(&context.device, &pass.shader)? }))
            .collect::<Result<_, GpuError>>()?;
        Ok(Self { context, passes, times: Mutex::default(), spent: Mutex::default() })
    }

    /// The adapter, where it was chosen here and not by a host.
    pub(crate) fn adapter(&self) -> Option<&AdapterDescription> {
        self.context.adapter.as_ref()
    }

    /// The adapter in words.
    pub(crate) fn describe(&self) -> Option<String> {
        self.adapter().map(|a| format!("{} ({}, {})", a.name, a.backend, a.driver))
    }

    /// Builds pipelines now rather than when they are first needed: all, or of passes with variants those
    /// that are `used`, by the pass's shader and the variant's value.
    pub(crate) fn warm_up(&self, used: impl Fn(&Shader, u32) -> bool) -> Result<(), GpuError> {
        self.passes.iter().try_for_each(|ready| {
            let used = |value| used(ready.pipeline.shader, value);
            ready.pipeline.warm_up(&self.context.device, used)
        })
    }

    /// A pass by its name.
    pub(crate) fn find(&self, name: &str) -> Result<&ReadyPass<Stage, Items>, GpuError> {
        let unknown = || GpuError::Refused { what: name.into(), reason: "no such pass".into() };
        self.passes.iter().find(|ready| ready.pass.shader.name == name).ok_or_else(unknown)
    }

    /// Does some work and returns with it the device time of each of its passes, in seconds, in the order of
    /// their names. There are no times where the device has no timestamps.
    pub(crate) fn timed<R, E>(&self, work: impl FnOnce() -> Result<R, E>) -> Result<(R, PassTimes), E> {
        let can = self.context.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        *self.times() = can.then(BTreeMap::new);
        let done = work();
        let times = self.times().take().unwrap_or_default();
        Ok((done?, times.into_iter().collect()))
    }

    fn times(&self) -> MutexGuard<'_, Option<BTreeMap<&'static str, f64>>> {
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Submits what `record` records, waits for it, and reads some buffers back, whole. `record` gets the
    /// timer of its passes: where that gives timestamps, the pass needs a compute pass of its own.
    pub(crate) fn run(
        &self,
        job: Job,
        buffers: &[&wgpu::Buffer],
        record: impl FnOnce(&mut wgpu::CommandEncoder, &mut Timer) -> Result<(), GpuError>,
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        let whole: Vec<_> = buffers.iter().map(|buffer| (*buffer, buffer.size())).collect();
        self.run_and_read(job, &whole, record, |views| views.iter().map(|view| copied(view)).collect())
    }

    /// As [`Runner::run`], but lets `read` read that many bytes of each of some buffers.
    pub(crate) fn run_and_read<R>(
        &self,
        job: Job,
        parts: &[(&wgpu::Buffer, u64)],
        record: impl FnOnce(&mut wgpu::CommandEncoder, &mut Timer) -> Result<(), GpuError>,
        read: impl FnOnce(&[&[u8]]) -> R,
    ) -> Result<R, GpuError> {
        if self.times().is_none() {
            let record = |encoder: &mut wgpu::CommandEncoder| record(encoder, &mut |_| None);
            let (done, spent) = self.context.run_and_read(job, parts, record, read)?;
            self.spend(spent);
            return Ok(done);
        }
        let queries = self.context.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: None,
            ty: wgpu::QueryType::Timestamp,
            count: 2 * MAX_TIMED_PASSES as u32,
        });
        let resolved = self.context.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: 16 * MAX_TIMED_PASSES as u64,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let mut names = Vec::new();
        let parts = [parts, &[(&resolved, resolved.size())]].concat();
        let record = |encoder: &mut wgpu::CommandEncoder| {
            record(encoder, &mut |name| {
                let first = 2 * names.len() as u32;
                names.push(name);
                (names.len() <= MAX_TIMED_PASSES).then_some(wgpu::ComputePassTimestampWrites {
                    query_set: &queries,
                    beginning_of_pass_write_index: Some(first),
                    end_of_pass_write_index: Some(first + 1),
                })
            })?;
            if names.len() > MAX_TIMED_PASSES {
                let reason = format!("{} passes, {MAX_TIMED_PASSES} at most", names.len());
                return Err(GpuError::Refused { what: "timestamps".into(), reason });
            }
            if !names.is_empty() {
                encoder.resolve_query_set(&queries, 0..2 * names.len() as u32, &resolved, 0);
            }
            Ok(())
        };
        let read = |views: &[&[u8]]| match views.split_last() {
            Some((ticks, views)) => (read(views), bytemuck::pod_collect_to_vec::<u8, u64>(ticks)),
            None => (read(&[]), Vec::new()),
        };
        let ((done, ticks), spent) = self.context.run_and_read(job, &parts, record, read)?;
        self.spend(spent);
        let period_s = f64::from(self.context.queue.get_timestamp_period()) * 1e-9;
        if let Some(times) = self.times().as_mut() {
            for (name, ticks) in names.into_iter().zip(ticks.chunks_exact(2)) {
                *times.entry(name).or_default() += ticks[1].saturating_sub(ticks[0]) as f64 * period_s;
            }
        }
        Ok(done)
    }

    /// The time between timestamps before and after what `record` records, s, on a device that has timestamps.
    pub(crate) fn device_time_s(
        &self,
        job: Job,
        record: impl FnOnce(&mut wgpu::CommandEncoder) -> Result<(), GpuError>,
    ) -> Result<f64, GpuError> {
        let device = &self.context.device;
        let queries = device.create_query_set(&wgpu::QuerySetDescriptor {
            label: None,
            ty: wgpu::QueryType::Timestamp,
            count: 2,
        });
        let resolved = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: 16,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        // An empty pass that ends before the work begins, and one that begins after it.
        let stamp = |encoder: &mut wgpu::CommandEncoder, begin: Option<u32>, end: Option<u32>| {
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: None,
                timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                    query_set: &queries,
                    beginning_of_pass_write_index: begin,
                    end_of_pass_write_index: end,
                }),
            });
        };
        let record = |encoder: &mut wgpu::CommandEncoder| {
            stamp(encoder, None, Some(0));
            record(encoder)?;
            stamp(encoder, Some(1), None);
            encoder.resolve_query_set(&queries, 0..2, &resolved, 0);
            Ok(())
        };
        let read = |views: &[&[u8]]| bytemuck::pod_read_unaligned::<[u64; 2]>(views[0]);
        let ([before, after], spent) = self.context.run_and_read(job, &[(&resolved, 16)], record, read)?;
        self.spend(spent);
        let period_s = f64::from(self.context.queue.get_timestamp_period()) * 1e-9;
        Ok(after.saturating_sub(before) as f64 * period_s)
    }

    /// Adds to what the engine's work took.
    pub(crate) fn spend(&self, more: Spent) {
        *self.spent.lock().unwrap_or_else(PoisonError::into_inner) += more;
    }

    /// What the engine's work took since this was last asked.
    pub(crate) fn take_spent(&self) -> Spent {
        std::mem::take(&mut *self.spent.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Runs one pass alone on given buffer contents, and reads buffers back. `find` finds a buffer by its
    /// name, `record` records the pass.
    ///
    /// The pass runs twice, on outputs that hold two different fillings where they are not inputs too; bytes that it does not
    /// write are 0x5a in the result.
    pub(crate) fn run_pass<'a>(
        &self,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: &[&str],
        bytes: u64,
        find: impl Fn(&str) -> Option<&'a wgpu::Buffer>,
        record: impl Fn(&ReadyPass<Stage, Items>, &mut wgpu::CommandEncoder) -> Result<(), GpuError>,
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        let ready = self.find(pass)?;
        let find = |name: &str| {
            find(name).ok_or_else(|| GpuError::Refused { what: name.into(), reason: "no such buffer".into() })
        };
        let inputs: Vec<(&wgpu::Buffer, &[u8])> =
            inputs.iter().map(|(name, bytes)| Ok((find(name)?, *bytes))).collect::<Result<_, GpuError>>()?;
        let outputs = outputs.iter().map(|name| find(name)).collect::<Result<Vec<_>, _>>()?;
        let write = |buffer: &wgpu::Buffer, bytes: &[u8]| {
            checked(&self.context.device, "input", || self.context.write(buffer, bytes))?
        };
        let run = |poison: u8| {
            for buffer in &outputs {
                write(buffer, &vec![poison; buffer.size() as usize])?;
            }
            for &(buffer, bytes) in &inputs {
                write(buffer, bytes)?;
            }
            self.run(Job { bytes, rounds: 1 }, &outputs, |encoder, _| record(ready, encoder))
        };
        // A value that is one poison by chance is not the other. Whole words are compared: where a result depends on the
        // order of invocations, single bytes of two runs may well be these two.
        let (mut read, other) = (run(POISON)?, run(OTHER_POISON)?);
        for (bytes, others) in read.iter_mut().zip(&other) {
            for (word, other) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(others.as_chunks::<4>().0) {
                if (*word, *other) == ([POISON; 4], [OTHER_POISON; 4]) {
                    *word = *other;
                }
            }
        }
        Ok(read)
    }
}

/// What outputs hold before a pass runs alone, so that what it does not write shows …
const POISON: u8 = 0xff;
/// … and what they hold when it runs again.
const OTHER_POISON: u8 = 0x5a;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dispatch_has_a_workgroup_for_each_item_and_no_dimension_too_large() {
        for count in [0, 1, 65_535, 65_536, 131_070, 131_071, 4_000_000_000] {
            let [x, y] = dispatch_size(count);
            assert!(x <= MAX_WORKGROUPS && y <= MAX_WORKGROUPS);
            assert!(u64::from(x) * u64::from(y) >= u64::from(count));
            assert!(u64::from(x) * u64::from(y) < u64::from(count) + u64::from(y.max(1)));
        }
    }
}
