//! The host's memory: the only place that reads or writes it.

use crate::status::Failure;
use std::ffi::{CStr, c_char};

/// An array of the host.
///
/// # Safety
/// `from` is null or points to `count` values that nobody changes during the call.
///
/// # Errors
/// Where it is null though there are values.
pub unsafe fn array<'a, T>(what: &str, from: *const T, count: usize) -> Result<&'a [T], Failure> {
    if count == 0 {
        return Ok(&[]);
    }
    if from.is_null() {
        return Err(Failure::argument(format!("{what}: found null, expected {count} values")));
    }
    if !from.is_aligned() || count.checked_mul(size_of::<T>()).is_none_or(|bytes| bytes > isize::MAX as usize)
    {
        return Err(Failure::argument(format!("{what}: found {count} values at {from:?}, which cannot be")));
    }
    // SAFETY: not null, aligned and of a possible size; the caller answers for the rest.
    Ok(unsafe { std::slice::from_raw_parts(from, count) })
}

/// A text of the host.
///
/// # Safety
/// `from` is null or points to a text that ends with a zero.
///
/// # Errors
/// Where it is null or not UTF-8.
pub unsafe fn text<'a>(what: &str, from: *const c_char) -> Result<&'a str, Failure> {
    if from.is_null() {
        return Err(Failure::argument(format!("{what}: found null, expected a text")));
    }
    // SAFETY: not null; the caller answers for the rest.
    let text = unsafe { CStr::from_ptr(from) };
    text.to_str().map_err(|_| Failure::argument(format!("{what}: found bytes that are not UTF-8")))
}

/// Writes a result.
///
/// # Safety
/// `to` is null or points to room for a value.
///
/// # Errors
/// Where it is null.
pub unsafe fn put<T>(what: &str, to: *mut T, value: T) -> Result<(), Failure> {
    if to.is_null() {
        return Err(Failure::argument(format!("{what}: found null, expected a place for the result")));
    }
    // SAFETY: not null; the caller answers for the rest. What was there is not dropped: it may be nothing.
    unsafe { to.write_unaligned(value) };
    Ok(())
}

/// Refuses a result's place that is null before any work is done for it.
///
/// # Errors
/// Where it is null.
pub fn check_place<T>(what: &str, to: *const T) -> Result<(), Failure> {
    match to.is_null() {
        true => Err(Failure::argument(format!("{what}: found null, expected a place for the result"))),
        false => Ok(()),
    }
}

/// Copies values into a buffer of the host, which has room for `capacity` of them.
///
/// # Safety
/// `to` is null or points to room for `capacity` values.
///
/// # Errors
/// Where the buffer is null or too small.
pub unsafe fn copy<T: Copy>(what: &str, values: &[T], to: *mut T, capacity: usize) -> Result<(), Failure> {
    if values.is_empty() {
        return Ok(());
    }
    if to.is_null() {
        return Err(Failure::argument(format!("{what}: found null, expected a buffer for {}", values.len())));
    }
    if capacity < values.len() {
        return Err(Failure::too_small(what, capacity, values.len()));
    }
    if !to.is_aligned() {
        return Err(Failure::argument(format!("{what}: found a buffer at {to:?}, which cannot be")));
    }
    // SAFETY: not null, aligned, and large enough as the caller answers for; a host's buffer is none of ours.
    unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), to, values.len()) };
    Ok(())
}

/// Copies a text with a zero at its end, and says how many bytes it has, that zero included. With a null buffer it says
/// only that.
///
/// # Safety
/// `to` is null or points to room for `capacity` bytes, and `length` is null or points to room for a number.
///
/// # Errors
/// Where the buffer is too small, or both are null.
pub unsafe fn copy_text(
    what: &str,
    text: &str,
    to: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> Result<(), Failure> {
    let bytes: Vec<c_char> = text.bytes().filter(|&b| b != 0).chain([0]).map(|b| b as c_char).collect();
    if to.is_null() && length.is_null() {
        return Err(Failure::argument(format!(
            "{what}: found null, expected a buffer or a place for its size"
        )));
    }
    if !length.is_null() {
        // SAFETY: as this function demands.
        unsafe { put(what, length, bytes.len())? };
    }
    match to.is_null() {
        true => Ok(()),
        // SAFETY: as this function demands.
        false => unsafe { copy(what, &bytes, to, capacity) },
    }
}

/// As [`copy_text`], of a value that was made JSON.
///
/// # Errors
/// As [`copy_text`], and where the value has no JSON.
pub unsafe fn copy_json(
    what: &str,
    json: serde_json::Result<String>,
    to: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> Result<(), Failure> {
    let json = json.map_err(|error| Failure::argument(format!("{what}: {error}")))?;
    // SAFETY: as this function demands.
    unsafe { copy_text(what, &json, to, capacity, length) }
}
