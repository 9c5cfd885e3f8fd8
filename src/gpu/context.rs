//! Adapters, devices, and calls whose errors come back as values.

use super::GpuError;
use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

/// A device's memory in use, and how often a submission goes over it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Job {
    /// Bytes of device memory.
    pub bytes: u64,
    /// Rounds, such as the iterations of a fit.
    pub rounds: u64,
}

/// Time that any submission may take: a driver may have to compile its shaders first.
const LEAST_LIMIT: Duration = Duration::from_secs(20);
/// A callback of a finished submission comes within this time.
const CALLBACK_LIMIT: Duration = Duration::from_secs(1);
/// Bytes that the slowest device, a program on one core, goes over in a second, a tenth of what was measured.
const BYTES_PER_SECOND: u64 = 20_000_000;

impl Job {
    /// Longest time that its submission may take.
    fn time_limit(self) -> Duration {
        LEAST_LIMIT + Duration::from_secs(self.bytes.saturating_mul(self.rounds) / BYTES_PER_SECOND)
    }
}

/// An adapter, described for a person.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AdapterDescription {
    /// Its name.
    pub name: String,
    /// discrete GPU, integrated GPU, virtual GPU, CPU or other.
    pub kind: &'static str,
    /// Vulkan, Metal or Dx12.
    pub backend: String,
    /// The driver and its version.
    pub driver: String,
    /// Largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Largest storage binding, bytes.
    pub max_storage_binding_bytes: u64,
    /// Workgroup memory, bytes.
    pub max_workgroup_bytes: u32,
    /// Most invocations per workgroup.
    pub max_workgroup_invocations: u32,
    /// Whether passes can be timed on the device.
    pub timestamps: bool,
}

impl AdapterDescription {
    fn new(adapter: &wgpu::Adapter) -> Self {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        Self {
            name: info.name,
            kind: match info.device_type {
                wgpu::DeviceType::DiscreteGpu => "discrete GPU",
                wgpu::DeviceType::IntegratedGpu => "integrated GPU",
                wgpu::DeviceType::VirtualGpu => "virtual GPU",
                wgpu::DeviceType::Cpu => "CPU",
                wgpu::DeviceType::Other => "other",
            },
            backend: format!("{:?}", info.backend),
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            max_buffer_bytes: limits.max_buffer_size,
            max_storage_binding_bytes: limits.max_storage_buffer_binding_size,
            max_workgroup_bytes: limits.max_compute_workgroup_storage_size,
            max_workgroup_invocations: limits.max_compute_invocations_per_workgroup,
            timestamps: adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY),
        }
    }

    /// Whether the adapter is a program on the CPU.
    pub fn is_software(&self) -> bool {
        self.kind == "CPU"
    }

    /// Real GPUs before software, discrete before integrated.
    fn preference(&self) -> usize {
        ["discrete GPU", "integrated GPU", "virtual GPU", "other", "CPU"]
            .iter()
            .position(|kind| *kind == self.kind)
            .unwrap_or(usize::MAX)
    }
}

/// The adapters of this machine, best first. Engines take the first unless another is named.
pub fn adapters() -> Vec<AdapterDescription> {
    enumerate().into_iter().map(|(description, _)| description).collect()
}

fn enumerate() -> Vec<(AdapterDescription, wgpu::Adapter)> {
    // Not GL: few of its drivers are tested with compute shaders.
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let mut found: Vec<_> = pollster::block_on(instance.enumerate_adapters(backends))
        .into_iter()
        .map(|adapter| (AdapterDescription::new(&adapter), adapter))
        .collect();
    found.sort_by_key(|(description, _)| description.preference());
    found
}

/// The requirements of the engines on a device, for hosts that request their own.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Requirements {
    /// Features: none beyond the standard's.
    pub features: wgpu::Features,
    /// Limits: WebGPU's defaults.
    pub limits: wgpu::Limits,
}

impl Requirements {
    /// The requirements of every job.
    pub fn new() -> Self {
        Self { features: wgpu::Features::empty(), limits: wgpu::Limits::default() }
    }

    /// The same with room for larger jobs: buffers and bindings as large as the adapter allows, and
    /// timestamps of passes where it has them.
    #[must_use]
    pub fn with_all_room(mut self, adapter: &wgpu::Adapter) -> Self {
        let has = adapter.limits();
        self.limits.max_buffer_size = has.max_buffer_size;
        self.limits.max_storage_buffer_binding_size = has.max_storage_buffer_binding_size;
        self.features |= adapter.features() & wgpu::Features::TIMESTAMP_QUERY;
        self
    }

    /// A host's device descriptor, extended by these requirements.
    #[must_use]
    pub fn merged_into<'a>(&self, mut host: wgpu::DeviceDescriptor<'a>) -> wgpu::DeviceDescriptor<'a> {
        host.required_features |= self.features;
        host.required_limits = host.required_limits.or_better_values_from(&self.limits);
        host
    }
}

impl Default for Requirements {
    fn default() -> Self {
        Self::new()
    }
}

/// A device and its queue.
pub(crate) struct Context {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) adapter: Option<AdapterDescription>,
    /// The first error that a device of our own reported outside any call.
    report: Arc<Mutex<Option<String>>>,
}

impl Context {
    /// A device of our own on the adapter whose name contains `name`, or on the best one.
    pub(crate) fn new(name: Option<&str>) -> Result<Self, GpuError> {
        let found = enumerate();
        let names = found.iter().map(|(d, _)| format!("{:?}", d.name)).collect::<Vec<_>>().join(", ");
        let wanted = |description: &AdapterDescription| {
            name.is_none_or(|name| description.name.to_lowercase().contains(&name.to_lowercase()))
        };
        let Some((description, adapter)) = found.into_iter().find(|(d, _)| wanted(d)) else {
            return Err(GpuError::NoAdapter {
                wanted: name.map_or("that computes".into(), |name| format!("named {name:?}")),
                found: if names.is_empty() { "none".into() } else { names },
            });
        };
        let requirements = Requirements::new().with_all_room(&adapter);
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("lumenmesh"),
            required_features: requirements.features,
            required_limits: requirements.limits,
            ..Default::default()
        }))
        .map_err(|e| GpuError::NoDevice { adapter: description.name.clone(), reason: e.to_string() })?;
        let report = Arc::new(Mutex::new(None));
        let note = |text: String, report: &Mutex<Option<String>>| {
            report.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(text);
        };
        let lost = Arc::clone(&report);
        device.set_device_lost_callback(move |reason, message| note(format!("{reason:?}: {message}"), &lost));
        let uncaptured = Arc::clone(&report);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(error.to_string(), &uncaptured)));
        Ok(Self { device, queue, adapter: Some(description), report })
    }

    /// On a host's device, whose error handlers stay the host's.
    pub(crate) fn of_host(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        Self { device, queue, adapter: None, report: Arc::default() }
    }

    /// Whether the device is known to be a program on the CPU.
    pub(crate) fn is_software(&self) -> bool {
        self.adapter.as_ref().is_some_and(AdapterDescription::is_software)
    }

    /// Fails where the device has reported something outside any call.
    pub(crate) fn alive(&self) -> Result<(), GpuError> {
        match self.report.lock().unwrap_or_else(PoisonError::into_inner).clone() {
            Some(reason) => Err(GpuError::Lost { reason }),
            None => Ok(()),
        }
    }

    /// Submits what `record` records, waits for it, and reads some buffers back, whole.
    pub(crate) fn run(
        &self,
        job: Job,
        buffers: &[&wgpu::Buffer],
        record: impl FnOnce(&mut wgpu::CommandEncoder) -> Result<(), GpuError>,
    ) -> Result<Vec<Vec<u8>>, GpuError> {
        self.alive()?;
        let device = &self.device;
        let mut copies = Vec::new();
        let submission = checked(device, "submission", || -> Result<_, GpuError> {
            let mut encoder = device.create_command_encoder(&Default::default());
            record(&mut encoder)?;
            for from in buffers {
                let copy = device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("readback"),
                    size: from.size(),
                    usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                    mapped_at_creation: false,
                });
                encoder.copy_buffer_to_buffer(from, 0, &copy, 0, Some(from.size()));
                copies.push(copy);
            }
            Ok(self.queue.submit([encoder.finish()]))
        })
        .map_err(|error| error.with_needed(job.bytes))??;
        let (sender, receiver) = mpsc::channel();
        for copy in &copies {
            let sender = sender.clone();
            copy.slice(..).map_async(wgpu::MapMode::Read, move |mapped| {
                // The receiver is gone only where the wait below has failed already.
                let _ = sender.send(mapped);
            });
        }
        let limit = job.time_limit();
        let deadline = Instant::now() + limit;
        self.wait(submission, limit)?;
        for _ in &copies {
            // Where several threads use the device, another thread's wait may call our callbacks, a moment
            // after ours has returned.
            let left = deadline.saturating_duration_since(Instant::now()).max(CALLBACK_LIMIT);
            match receiver.recv_timeout(left) {
                Ok(Ok(())) => {}
                Ok(Err(error)) => return Err(GpuError::Lost { reason: error.to_string() }),
                Err(_) => return Err(self.timed_out(limit)),
            }
        }
        copies
            .iter()
            .map(|copy| match copy.slice(..).get_mapped_range() {
                Ok(view) => Ok(view.to_vec()),
                Err(error) => Err(GpuError::Lost { reason: error.to_string() }),
            })
            .collect()
    }

    /// Waits for a submission, at most so long.
    fn wait(&self, submission: wgpu::SubmissionIndex, limit: Duration) -> Result<(), GpuError> {
        let poll = self
            .device
            .poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(limit) });
        self.alive()?;
        match poll {
            Ok(_) => Ok(()),
            Err(wgpu::PollError::Timeout) => Err(self.timed_out(limit)),
            Err(other) => Err(GpuError::Lost { reason: other.to_string() }),
        }
    }

    /// What hangs once is not waited for again: every later call fails at once.
    fn timed_out(&self, limit: Duration) -> GpuError {
        let error = GpuError::Timeout { seconds: limit.as_secs() };
        self.report.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error.to_string());
        error
    }
}

/// Makes calls on the device and returns their result, unless the device refuses one.
pub(crate) fn checked<T>(
    device: &wgpu::Device,
    what: &str,
    calls: impl FnOnce() -> T,
) -> Result<T, GpuError> {
    let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory]
        .map(|filter| device.push_error_scope(filter));
    let made = calls();
    let mut refused = None;
    for scope in scopes.into_iter().rev() {
        refused = refused.or(pollster::block_on(scope.pop()));
    }
    match refused {
        None => Ok(made),
        Some(wgpu::Error::OutOfMemory { source }) => {
            Err(GpuError::OutOfMemory { needed: 0, reason: format!("{what}: {source}") })
        }
        Some(error) => Err(GpuError::Refused { what: what.into(), reason: error.to_string() }),
    }
}
