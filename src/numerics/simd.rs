//! Code for the vector instructions that the processor has.

use pulp::{Arch, NullaryFnOnce};

/// Runs a task, compiled for the widest vectors that the processor has. What is not inlined into the task is compiled for the
/// narrowest: its own closure and those functions whose time counts need `#[inline(always)]`.
#[inline(always)]
pub(crate) fn vectorized<R>(task: impl FnMut() -> R) -> R {
    Arch::new().dispatch(Task(task))
}

/// Calls a closure through `FnMut`. Through `FnOnce` the compiler calls what may run more than once by way of a function of its
/// own, which is not inlined where the closure is long.
struct Task<F>(F);

impl<R, F: FnMut() -> R> NullaryFnOnce for Task<F> {
    type Output = R;

    #[inline(always)]
    fn call(mut self) -> R {
        (self.0)()
    }
}
