//! Where work is computed, and why there.

#[cfg(feature = "gpu")]
use crate::gpu::{AdapterDescription, GpuError, adapters};
use serde::Serialize;

/// What an engine says of itself.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct EngineDescription {
    /// `cpu`, `reference` or `gpu`.
    pub name: String,
    /// The adapter, for `gpu`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    /// Why this one, where it was not asked for by name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// CPU work, in seconds, from which the backend `auto` looks for a device: starting one takes about as long.
pub const WORTH_A_DEVICE_S: f64 = 0.5;

/// The adapter that large work goes to, of a list with the best first, where none is named.
///
/// # Errors
/// Why the work stays on the CPU: [`GpuError::NoAdapters`] or [`GpuError::SoftwareOnly`].
#[cfg(feature = "gpu")]
pub fn choose(adapters: &[AdapterDescription]) -> Result<&AdapterDescription, GpuError> {
    match adapters.first() {
        None => Err(GpuError::NoAdapters),
        Some(best) if best.is_software() => Err(GpuError::SoftwareOnly { adapter: best.name.clone() }),
        Some(best) => Ok(best),
    }
}

/// An engine made by `new` on the adapter of that name, or on the best one if it is not software.
///
/// # Errors
/// Why the work stays on the CPU: as [`choose`], or what `new` fails with.
#[cfg(feature = "gpu")]
pub(crate) fn start<E>(
    adapter: Option<&str>,
    new: impl FnOnce(Option<&str>) -> crate::Result<E>,
) -> crate::Result<E> {
    if adapter.is_none() {
        choose(&adapters())?;
    }
    new(adapter)
}
