//! Device memory by name.

use super::{Access, Context, GpuError, ReadyPass, checked};
use std::collections::BTreeMap;

/// The buffers of a job, by the names under which its passes bind them.
pub(crate) struct Buffers {
    by_name: BTreeMap<&'static str, wgpu::Buffer>,
    bytes: u64,
}

impl Buffers {
    /// Buffers of these names and sizes in bytes for some passes. Those that no pass binds are only copied to
    /// and from, and may be larger.
    pub(crate) fn new<Stage, Items>(
        context: &Context,
        passes: &[ReadyPass<Stage, Items>],
        sizes: &[(&'static str, u64)],
    ) -> Result<Self, GpuError> {
        let limits = context.device.limits();
        let bytes = sizes.iter().map(|(_, size)| size).sum();
        let access = |name: &str| {
            let mut bindings = passes.iter().flat_map(|ready| ready.pass.shader.bindings);
            bindings.find(|binding| binding.buffer == name).map(|binding| binding.access)
        };
        let allowed = |name: &str| match access(name) {
            None => limits.max_buffer_size,
            Some(_) => limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
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
                    let usage = match access(name) {
                        Some(Access::Uniform) => Usage::UNIFORM,
                        _ => Usage::STORAGE,
                    };
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
        .map_err(|error| error.with_needed(bytes))?;
        Ok(Self { by_name, bytes })
    }

    /// The buffer of that name.
    pub(crate) fn find(&self, name: &str) -> Option<&wgpu::Buffer> {
        self.by_name.get(name)
    }

    /// Whether they are of like size: large enough for these names and sizes, and not so large in all that
    /// the memory is missed elsewhere.
    pub(crate) fn suit(&self, sizes: &[(&'static str, u64)]) -> bool {
        let needed: u64 = sizes.iter().map(|(_, size)| size).sum();
        let large_enough =
            |&(name, size): &(&str, u64)| self.find(name).is_some_and(|buffer| size <= buffer.size());
        self.bytes <= (2 * needed).max(1 << 20) && sizes.iter().all(large_enough)
    }

    /// Size of all of them, bytes.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl std::ops::Index<&str> for Buffers {
    type Output = wgpu::Buffer;

    /// The buffer that was made under that name.
    fn index(&self, name: &str) -> &wgpu::Buffer {
        &self.by_name[name]
    }
}
