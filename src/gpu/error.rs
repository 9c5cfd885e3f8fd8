/// What can go wrong on the device.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter, or none of that name.
    #[error("no GPU adapter {wanted}; found {found}")]
    NoAdapter {
        /// What was asked for.
        wanted: String,
        /// The adapters that are there.
        found: String,
    },
    /// The adapter gave no device.
    #[error("adapter {adapter} gives no device: {reason}")]
    NoDevice {
        /// The adapter.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// A buffer would exceed what the device allows.
    #[error("the job needs {needed} bytes for {name}, the device allows {allowed} at most")]
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
    OutOfMemory {
        /// Bytes that the whole job needs.
        needed: u64,
        /// What the driver said.
        reason: String,
    },
    /// A shader or a call that the device refuses: a defect of this program or of the driver.
    #[error("the device refuses {what}: {reason}")]
    Refused {
        /// The pass or the call.
        what: String,
        /// What the driver said.
        reason: String,
    },
    /// The device did not finish in time.
    #[error("the device did not finish within {seconds} s")]
    Timeout {
        /// How long was waited, in seconds.
        seconds: u64,
    },
    /// The device did not measure every face to the end: a driver that cuts long loops short.
    #[error(
        "the device measured {finished} of {expected} faces with many points to the end; use the CPU for these"
    )]
    Unfinished {
        /// Faces that were measured, over all iterations.
        finished: u32,
        /// Faces that should have been.
        expected: u32,
    },
    /// The device computed something that cannot be: a defect of this program or of the driver.
    #[error("the device computed {found} for the {what}; use the CPU for these")]
    Wrong {
        /// What it computed.
        what: &'static str,
        /// The value.
        found: String,
    },
    /// The device is gone.
    #[error("the device was lost: {reason}")]
    Lost {
        /// What the driver said.
        reason: String,
    },
}

impl GpuError {
    /// The error of a call for a job that takes so many bytes of the device's memory.
    pub(crate) fn of_a_job(self, bytes: u64) -> Self {
        match self {
            Self::OutOfMemory { reason, .. } => Self::OutOfMemory { needed: bytes, reason },
            other => other,
        }
    }
}
