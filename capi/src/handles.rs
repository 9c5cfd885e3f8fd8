//! Handles: numbers that look like pointers, so that one which was freed, or is of another kind, can be told.

use crate::status::Failure;
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

/// Numbers of all handles: none is given twice in a process. They are multiples of 16, as pointers are.
static NEXT: AtomicUsize = AtomicUsize::new(16);

/// The things of one kind that hosts hold.
pub struct Handles<T> {
    kind: &'static str,
    held: OnceLock<RwLock<HashMap<usize, Arc<T>>>>,
}

impl<T> Handles<T> {
    pub const fn new(kind: &'static str) -> Self {
        Self { kind, held: OnceLock::new() }
    }

    fn held(&self) -> &RwLock<HashMap<usize, Arc<T>>> {
        self.held.get_or_init(RwLock::default)
    }

    /// Gives a thing to the host.
    pub fn give<Handle>(&self, thing: T) -> *mut Handle {
        let number = NEXT.fetch_add(16, Ordering::Relaxed);
        self.held().write().unwrap_or_else(PoisonError::into_inner).insert(number, Arc::new(thing));
        std::ptr::without_provenance_mut(number)
    }

    /// The thing that a handle stands for.
    ///
    /// # Errors
    /// Where the handle is null, was freed or is of another kind.
    pub fn get<Handle>(&self, handle: *const Handle) -> Result<Arc<T>, Failure> {
        let held = self.held().read().unwrap_or_else(PoisonError::into_inner);
        held.get(&handle.addr()).cloned().ok_or_else(|| self.unknown(handle.addr()))
    }

    /// Takes a thing back; null is left alone.
    ///
    /// # Errors
    /// Where the handle was freed before or is of another kind.
    pub fn free<Handle>(&self, handle: *mut Handle) -> Result<(), Failure> {
        if handle.is_null() {
            return Ok(());
        }
        let thing = self.held().write().unwrap_or_else(PoisonError::into_inner).remove(&handle.addr());
        thing.map(drop).ok_or_else(|| self.unknown(handle.addr()))
    }

    fn unknown(&self, number: usize) -> Failure {
        Failure::argument(match number {
            0 => format!("{}: found null, expected a handle", self.kind),
            _ => format!("{}: found a handle that was freed or is of another kind", self.kind),
        })
    }
}
