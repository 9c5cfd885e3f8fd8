//! Device memory by name.

use super::{Context, GpuError, checked};
use std::collections::BTreeMap;

/// The buffers of a job, by the names that its passes bind them under.
pub(crate) struct Buffers {
    by_name: BTreeMap<&'static str, wgpu::Buffer>,
    bytes: u64,
}

impl Buffers {
    /// Buffers of these names and sizes in bytes. Those named `job` are uniform blocks; those in `unbound` are copied
    /// to and from, but bound to no pass.
    pub(crate) fn new(
        context: &Context,
        sizes: &[(&'static str, u64)],
        unbound: &[&str],
    ) -> Result<Self, GpuError> {
        let limits = context.device.limits();
        let bytes = sizes.iter().map(|(_, size)| size).sum();
        let allowed = |name: &str| match unbound.contains(&name) {
            true => limits.max_buffer_size,
            false => limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        };
        let too_large = sizes.iter().rev().filter(|(name, size)| *size > allowed(name));
        if let Some((name, needed)) = too_large.max_by_key(|(_, size)| size) {
            return Err(GpuError::TooLarge { name: (*name).into(), needed: *needed, allowed: allowed(name) });
        }
        context.alive()?;
        let by_name = checked(&context.device, "buffers", || {
            sizes
                .iter()
                .map(|&(name, size)| {
                    use wgpu::BufferUsages as Usage;
                    let usage =
                        if matches!(name, "job" | "parameters") { Usage::UNIFORM } else { Usage::STORAGE };
                    let buffer = context.device.create_buffer(&wgpu::BufferDescriptor {
                        label: Some(name),
                        // A binding of no bytes is an error.
                        size: size.max(16).next_multiple_of(4),
                        usage: usage | Usage::COPY_DST | Usage::COPY_SRC,
                        mapped_at_creation: false,
                    });
                    (name, buffer)
                })
                .collect()
        })
        .map_err(|error| error.of_a_job(bytes))?;
        Ok(Self { by_name, bytes })
    }

    /// The buffer of that name.
    pub(crate) fn find(&self, name: &str) -> Option<&wgpu::Buffer> {
        self.by_name.get(name)
    }

    /// Bytes of all of them.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl std::ops::Index<&str> for Buffers {
    type Output = wgpu::Buffer;

    /// A buffer by a name that it was made under.
    fn index(&self, name: &str) -> &wgpu::Buffer {
        &self.by_name[name]
    }
}

impl Context {
    /// Writes to the beginning of a buffer.
    pub(crate) fn write(&self, buffer: &wgpu::Buffer, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.queue.write_buffer(buffer, 0, bytes);
        }
    }
}
