//! Large data to the device and back through host memory that is kept between calls: making and first
//! touching it takes longer than filling it.

use super::{Context, GpuError, checked};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Host memory that a context keeps for later calls, at most [`MOST_KEPT_BYTES`] and [`MOST_KEPT`] buffers
/// each way.
#[derive(Default)]
pub(super) struct Transfers {
    /// To the device.
    uploads: Mutex<Vec<Staging>>,
    /// From the device.
    readbacks: Mutex<Vec<wgpu::Buffer>>,
}

/// A buffer to the device, and whether the host may write to it again.
struct Staging {
    buffer: wgpu::Buffer,
    mapped: Arc<AtomicBool>,
}

/// Most bytes of host memory that are kept each way.
const MOST_KEPT_BYTES: u64 = 512 << 20;
/// Most buffers that are kept each way: one for each of a few threads.
const MOST_KEPT: usize = 8;
/// What is smaller goes through the queue's own buffers, whose cost does not matter then.
const LEAST_STAGED: usize = 64 << 10;
/// Bytes that one thread copies at a time.
const PIECE: usize = 1 << 20;

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether a buffer is of like size: large enough, and not so large that its memory is missed elsewhere.
fn suits(buffer: &wgpu::Buffer, bytes: u64) -> bool {
    bytes <= buffer.size() && buffer.size() <= (2 * bytes).max(1 << 20)
}

/// Keeps a buffer where there is room, making room by dropping the oldest ones.
fn keep<T>(kept: &mut Vec<T>, new: T, size: impl Fn(&T) -> u64) {
    kept.push(new);
    while kept.len() > MOST_KEPT || kept.iter().map(&size).sum::<u64>() > MOST_KEPT_BYTES {
        kept.remove(0);
    }
}

/// Copies with all threads.
pub(crate) fn copied(bytes: &[u8]) -> Vec<u8> {
    let mut copy = vec![0; bytes.len()];
    copy.par_chunks_mut(PIECE).zip(bytes.par_chunks(PIECE)).for_each(|(to, from)| to.copy_from_slice(from));
    copy
}

impl Context {
    /// Writes to the beginning of a buffer.
    pub(crate) fn write(&self, buffer: &wgpu::Buffer, bytes: &[u8]) -> Result<(), GpuError> {
        self.write_parts(buffer, &[bytes])
    }

    /// Writes several parts to a buffer, one behind the other.
    pub(crate) fn write_parts(&self, buffer: &wgpu::Buffer, parts: &[&[u8]]) -> Result<(), GpuError> {
        let bytes: usize = parts.iter().map(|part| part.len()).sum();
        if bytes < LEAST_STAGED {
            let mut at = 0;
            for part in parts.iter().filter(|part| !part.is_empty()) {
                self.queue.write_buffer(buffer, at, part);
                at += part.len() as u64;
            }
            return Ok(());
        }
        // Each part begins where a mapping may begin.
        let mut places = Vec::with_capacity(parts.len());
        let mut end = 0;
        for part in parts {
            places.push(end);
            end = (end + part.len() as u64).next_multiple_of(wgpu::MAP_ALIGNMENT);
        }
        let staging = self.staging(end)?;
        let pieces: Vec<(u64, &[u8])> = parts
            .iter()
            .zip(&places)
            .flat_map(|(part, &place)| (place..).step_by(PIECE).zip(part.chunks(PIECE)))
            .collect();
        let filled: Result<(), wgpu::MapRangeError> = pieces.into_par_iter().try_for_each(|(at, piece)| {
            let mut view = staging.buffer.slice(at..at + piece.len() as u64).get_mapped_range_mut()?;
            view.copy_from_slice(piece);
            Ok(())
        });
        filled.map_err(|error| GpuError::Refused { what: "staging".into(), reason: error.to_string() })?;
        self.upload(staging, buffer, places.into_iter().zip(parts.iter().map(|part| part.len() as u64)))
    }

    /// Writes what each of `items` is converted to, to the beginning of a buffer, without a copy of all of it in host
    /// memory.
    pub(crate) fn write_converted<T: Sync, U: bytemuck::NoUninit + Send>(
        &self,
        buffer: &wgpu::Buffer,
        items: &[T],
        convert: impl Fn(&T) -> U + Sync,
    ) -> Result<(), GpuError> {
        let bytes = items.len() * size_of::<U>();
        if bytes < LEAST_STAGED {
            let converted: Vec<U> = items.iter().map(convert).collect();
            return self.write(buffer, bytemuck::cast_slice(&converted));
        }
        // Each piece begins where a mapping may begin, whatever the size of an item.
        let count = PIECE / size_of::<U>() / wgpu::MAP_ALIGNMENT as usize * wgpu::MAP_ALIGNMENT as usize;
        let staging = self.staging(bytes as u64)?;
        let filled: Result<(), wgpu::MapRangeError> =
            items.par_chunks(count).enumerate().try_for_each_init(Vec::new, |converted, (piece, items)| {
                converted.clear();
                converted.extend(items.iter().map(&convert));
                let from: &[u8] = bytemuck::cast_slice(converted);
                let at = (piece * count * size_of::<U>()) as u64;
                staging
                    .buffer
                    .slice(at..at + from.len() as u64)
                    .get_mapped_range_mut()?
                    .copy_from_slice(from);
                Ok(())
            });
        filled.map_err(|error| GpuError::Refused { what: "staging".into(), reason: error.to_string() })?;
        self.upload(staging, buffer, std::iter::once((0, bytes as u64)))
    }

    /// Copies parts of filled host memory, each given by its place and size, to a buffer, one behind the other.
    fn upload(
        &self,
        staging: Staging,
        buffer: &wgpu::Buffer,
        parts: impl Iterator<Item = (u64, u64)>,
    ) -> Result<(), GpuError> {
        checked(&self.device, "upload", || {
            staging.buffer.unmap();
            staging.mapped.store(false, Ordering::Release);
            let mut encoder = self.device.create_command_encoder(&Default::default());
            let mut to = 0;
            for (place, bytes) in parts.filter(|(_, bytes)| *bytes > 0) {
                encoder.copy_buffer_to_buffer(&staging.buffer, place, buffer, to, Some(bytes));
                to += bytes;
            }
            self.queue.submit([encoder.finish()]);
        })?;
        let mapped = Arc::clone(&staging.mapped);
        staging.buffer.slice(..).map_async(wgpu::MapMode::Write, move |done| {
            mapped.store(done.is_ok(), Ordering::Release);
        });
        keep(&mut locked(&self.transfers.uploads), staging, |kept| kept.buffer.size());
        Ok(())
    }

    /// Host memory to the device that may be written to.
    fn staging(&self, bytes: u64) -> Result<Staging, GpuError> {
        let take = || {
            let mut kept = locked(&self.transfers.uploads);
            let is_free = |kept: &Staging| suits(&kept.buffer, bytes) && kept.mapped.load(Ordering::Acquire);
            kept.iter().position(is_free).map(|place| kept.remove(place))
        };
        if let Some(staging) = take() {
            return Ok(staging);
        }
        let make = || {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("staging"),
                size: bytes.next_multiple_of(wgpu::MAP_ALIGNMENT),
                usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: true,
            })
        };
        let buffer = checked(&self.device, "staging", make).map_err(|error| error.with_needed(bytes))?;
        Ok(Staging { buffer, mapped: Arc::new(AtomicBool::new(true)) })
    }

    /// Host memory from the device.
    pub(super) fn readback(&self, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        let mut kept = locked(&self.transfers.readbacks);
        if let Some(place) = kept.iter().position(|buffer| suits(buffer, bytes)) {
            return Ok(kept.remove(place));
        }
        drop(kept);
        checked(&self.device, "readback", || {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes.next_multiple_of(wgpu::MAP_ALIGNMENT),
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
        .map_err(|error| error.with_needed(bytes))
    }

    /// Keeps host memory that was read and is mapped no longer.
    pub(super) fn keep_readback(&self, buffer: wgpu::Buffer) {
        keep(&mut locked(&self.transfers.readbacks), buffer, wgpu::Buffer::size);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_bounded_in_number_and_size() {
        let mut kept = Vec::new();
        for size in 0..20_u64 {
            keep(&mut kept, size, |size| *size);
        }
        assert_eq!(kept, (12..20).collect::<Vec<u64>>());
        keep(&mut kept, MOST_KEPT_BYTES - 30, |size| *size);
        assert_eq!(kept, [19, MOST_KEPT_BYTES - 30]);
        keep(&mut kept, MOST_KEPT_BYTES + 1, |size| *size);
        assert!(kept.is_empty());
    }

    #[test]
    fn copies_of_any_length_are_equal() {
        for length in [0, 1, PIECE - 1, PIECE, PIECE + 1, 3 * PIECE + 5] {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 31 % 251) as u8).collect();
            assert_eq!(copied(&bytes), bytes);
        }
    }
}
