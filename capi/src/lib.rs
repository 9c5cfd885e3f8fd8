//! The C interface of lumenmesh: `include/lumenmesh.h`, made from this source by cbindgen.
//!
//! Everything that is unsafe in lumenmesh is here, and nearly all of it in `memory`.
#![expect(
    clippy::undocumented_unsafe_blocks,
    reason = "every block hands on what the header asks of the host"
)]

mod evaluation;
mod handles;
mod live;
mod lumen;
mod memory;
mod mesh;
mod recording;
mod settings;
mod status;

use std::ffi::c_char;

/// Version of this interface: it changes where a program that was compiled with an older header would not work.
pub const LUMENMESH_ABI_VERSION: u32 = 2;

/// The interface's version of the library that is loaded: compare it with `LUMENMESH_ABI_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn lumenmesh_abi_version() -> u32 {
    LUMENMESH_ABI_VERSION
}

/// The library's version, such as "0.2.0".
#[unsafe(no_mangle)]
pub extern "C" fn lumenmesh_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
