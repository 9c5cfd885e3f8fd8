//! No promises about versions: what is here changes with every release.
//!
//! The passes of both methods as plain functions, their tables on the device, and the memory that they work in. It is
//! public for tests that compare every pass with its twin, and for experiments with single passes.

/// Numbers that a pass computes in.
pub mod numerics {
    pub use crate::numerics::{Scalar, inclusive_scan};
}

/// The published method: see [`crate::cylinders`].
pub mod cylinders {
    #[cfg(feature = "gpu")]
    pub use crate::cylinders::fit::gpu;
    pub use crate::cylinders::fit::{Groups, group};
    /// The passes of the fit, twins of `shaders/cylinders/`.
    pub mod passes {
        pub use crate::cylinders::passes::*;
    }
}

/// The sweep: see [`crate::sweep`].
pub mod sweep {
    #[cfg(feature = "gpu")]
    pub use crate::sweep::wall::gpu;
    pub use crate::sweep::wall::passes;
}

/// What both share on the device.
#[cfg(feature = "gpu")]
pub mod gpu {
    pub use crate::gpu::shader::{Access, Binding, Pass, Shader};
}
