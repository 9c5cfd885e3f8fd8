//! What every function returns, and the text of the last error.

use lumenmesh_core::Error;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What a function returns. The text is in `lumenmesh_last_error()`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum LumenmeshStatus {
    /// Done.
    Ok = 0,
    /// A pointer is null, a handle was freed or is of another kind, a text is not UTF-8, or there is no such name.
    InvalidArgument = 1,
    /// A buffer is too small; the message has both sizes.
    BufferTooSmall = 2,
    /// A setting, a frame, a recording or a surface cannot be used.
    InvalidInput = 3,
    /// A file could not be read or written.
    File = 4,
    /// The device failed.
    Device = 5,
    /// An error of this library, which should never occur.
    Internal = 6,
    /// The host's progress callback asked to end.
    Cancelled = 7,
}

/// Why a function fails.
pub struct Failure {
    status: LumenmeshStatus,
    message: String,
}

impl Failure {
    pub fn argument(message: impl Into<String>) -> Self {
        Self { status: LumenmeshStatus::InvalidArgument, message: message.into() }
    }

    pub fn too_small(what: &str, found: usize, expected: usize) -> Self {
        let message = format!("{what}: found a buffer for {found}, expected one for {expected}");
        Self { status: LumenmeshStatus::BufferTooSmall, message }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::Read { .. } | Error::Write { .. } | Error::Output { .. } => LumenmeshStatus::File,
            Error::Gpu(_) => LumenmeshStatus::Device,
            Error::Cancelled => LumenmeshStatus::Cancelled,
            _ => LumenmeshStatus::InvalidInput,
        };
        Self { status, message: error.to_string() }
    }
}

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

fn remember(message: &str) {
    let message = CString::new(message.replace('\0', "\u{fffd}")).unwrap_or_default();
    LAST_ERROR.with(|last| *last.borrow_mut() = message);
}

/// Runs the body of a function: no panic leaves it, and what went wrong is remembered.
pub fn border(body: impl FnOnce() -> Result<(), Failure>) -> LumenmeshStatus {
    // What a body changes lies behind locks, which a panic poisons.
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => LumenmeshStatus::Ok,
        Ok(Err(Failure { status, message })) => {
            remember(&message);
            status
        }
        Err(panic) => {
            let said = panic
                .downcast_ref::<&str>()
                .map(|text| (*text).to_owned())
                .or_else(|| panic.downcast_ref::<String>().cloned());
            remember(&format!("an error of lumenmesh itself: {}", said.unwrap_or_default()));
            LumenmeshStatus::Internal
        }
    }
}

/// What went wrong in the last call of this thread that failed; empty where none did. The text is there until the next call
/// of this thread that fails.
#[unsafe(no_mangle)]
pub extern "C" fn lumenmesh_last_error() -> *const c_char {
    LAST_ERROR.with(|last| last.borrow().as_ptr())
}
