/// Errors of the device.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter, or none of that name.
    #[error("no GPU adapter {wanted}; found {found}")]
    #[non_exhaustive]
    NoAdapter {
        /// The adapter that was asked for.
        wanted: String,
        /// The adapters of this machine.
        found: String,
    },
    /// The machine has no adapter at all.
    #[error("there is no GPU adapter")]
    NoAdapters,
    /// The best adapter is a software driver, which is slower than the engines of the CPU.
    #[error("the best adapter, {adapter}, is software")]
    #[non_exhaustive]
    SoftwareOnly {
        /// The adapter.
        adapter: String,
    },
    /// The adapter gave no device.
    #[error("adapter {adapter} gives no device: {reason}")]
    #[non_exhaustive]
    NoDevice {
        /// The adapter.
        adapter: String,
        /// The driver's message.
        reason: String,
    },
    /// A buffer would exceed what the device allows.
    #[error("the job needs {needed} bytes for {name}, the device allows {allowed} at most")]
    #[non_exhaustive]
    TooLarge {
        /// The buffer.
        name: String,
        /// Bytes needed.
        needed: u64,
        /// Bytes allowed.
        allowed: u64,
    },
    /// The device has no memory left.
    #[error("the device is out of memory; the job needs {needed} bytes: {reason}")]
    #[non_exhaustive]
    OutOfMemory {
        /// Bytes that the whole job needs.
        needed: u64,
        /// The driver's message.
        reason: String,
    },
    /// A shader or a call that the device refuses: a defect of this program or of the driver.
    #[error("the device refuses {what}: {reason}")]
    #[non_exhaustive]
    Refused {
        /// The pass or the call.
        what: String,
        /// The driver's message.
        reason: String,
    },
    /// The device did not finish in time.
    #[error("the device did not finish within {seconds} s")]
    #[non_exhaustive]
    Timeout {
        /// The limit, in seconds.
        seconds: u64,
    },
    /// The device did not measure every face to the end: some drivers cut long loops short.
    #[error(
        "the device measured {finished} of {expected} faces with many points to the end; use the CPU for these"
    )]
    #[non_exhaustive]
    Unfinished {
        /// Faces that were measured, over all iterations.
        finished: u32,
        /// Faces that there are, over all iterations.
        expected: u32,
    },
    /// The device computed an impossible value: a defect of this program or of the driver.
    #[error("the device computed {found} for the {what}; use the CPU for these")]
    #[non_exhaustive]
    Wrong {
        /// The quantity.
        what: &'static str,
        /// The value.
        found: String,
    },
    /// The device is gone.
    #[error("the device was lost: {reason}")]
    #[non_exhaustive]
    Lost {
        /// The driver's message.
        reason: String,
    },
}

impl GpuError {
    /// The same error in a job that needs so many bytes of the device's memory.
    pub(crate) fn with_needed(self, bytes: u64) -> Self {
        match self {
            Self::OutOfMemory { reason, .. } => Self::OutOfMemory { needed: bytes, reason },
            other => other,
        }
    }
}
