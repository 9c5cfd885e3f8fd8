//! Adapters, devices, and calls whose errors come back as values.

use super::GpuError;
use super::transfers::Transfers;
use serde::Serialize;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, mpsc};
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

/// Not GL: few of its drivers are tested with compute shaders.
const BACKENDS: wgpu::Backends =
    wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// The one instance of this process, from which every adapter and device of the crate comes.
///
/// It is never dropped: the last instance takes the driver's library with it, and where that happens on a
/// thread other than the main one, NVIDIA's driver ends the process when the thread ends. A host with an
/// instance of its own keeps it as long, or takes this one.
pub fn instance() -> &'static wgpu::Instance {
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: BACKENDS,
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        })
    })
}

/// The adapters of this machine, best first. Engines take the first unless another is named.
pub fn adapters() -> Vec<AdapterDescription> {
    enumerate().into_iter().map(|(description, _)| description).collect()
}

fn enumerate() -> Vec<(AdapterDescription, wgpu::Adapter)> {
    let mut found: Vec<_> = pollster::block_on(instance().enumerate_adapters(BACKENDS))
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

/// Most invocations of a workgroup that a pass makes use of.
pub(crate) const LARGE_WORKGROUP: u32 = 1024;

/// Invocations of a workgroup that consists of one subgroup, or of a few.
pub(crate) const NARROW_WORKGROUP: u32 = 32;

impl Requirements {
    /// The requirements of every job.
    pub fn new() -> Self {
        Self { features: wgpu::Features::empty(), limits: wgpu::Limits::default() }
    }

    /// The same with all that the adapter can do for the engines: buffers and bindings as large as it allows, and
    /// where it has them workgroups of up to 1024 invocations and subgroups, which some passes are faster with, and
    /// timestamps of passes.
    #[must_use]
    pub fn with_all_room(mut self, adapter: &wgpu::Adapter) -> Self {
        let has = adapter.limits();
        self.limits.max_buffer_size = has.max_buffer_size;
        self.limits.max_storage_buffer_binding_size = has.max_storage_buffer_binding_size;
        let invocations = has.max_compute_invocations_per_workgroup.min(has.max_compute_workgroup_size_x);
        self.limits.max_compute_invocations_per_workgroup = invocations.min(LARGE_WORKGROUP);
        self.limits.max_compute_workgroup_size_x = invocations.min(LARGE_WORKGROUP);
        self.features |= adapter.features() & (wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::SUBGROUP);
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
    pub(super) transfers: Transfers,
}

/// What the host's part and the waits of some work took, in seconds.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Spent {
    /// Device memory: making it, or finding some that was kept.
    pub(crate) memory_s: f64,
    /// The input's way into host memory that the device copies from.
    pub(crate) filling_s: f64,
    /// Recording and submitting commands.
    pub(crate) recording_s: f64,
    /// From then until they were done, copies from and to host memory included.
    pub(crate) waiting_s: f64,
    /// Reading results from host memory that the device copied to.
    pub(crate) reading_s: f64,
    /// Submissions that were waited for.
    pub(crate) waits: u32,
}

impl std::ops::AddAssign for Spent {
    fn add_assign(&mut self, more: Self) {
        self.memory_s += more.memory_s;
        self.filling_s += more.filling_s;
        self.recording_s += more.recording_s;
        self.waiting_s += more.waiting_s;
        self.reading_s += more.reading_s;
        self.waits += more.waits;
    }
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
        Ok(Self { device, queue, adapter: Some(description), report, transfers: Transfers::default() })
    }

    /// On a host's device, whose error handlers stay the host's.
    pub(crate) fn of_host(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        Self { device, queue, adapter: None, report: Arc::default(), transfers: Transfers::default() }
    }

    /// Whether the device has workgroups of that many invocations.
    pub(crate) fn has_workgroups_of(&self, invocations: u32) -> bool {
        let limits = self.device.limits();
        invocations <= limits.max_compute_invocations_per_workgroup.min(limits.max_compute_workgroup_size_x)
    }

    /// The least number of invocations in a subgroup of the device, `None` where it was made without subgroups.
    pub(crate) fn subgroup_width(&self) -> Option<u32> {
        // Workgroups of 128 consist of full subgroups, whichever of these sizes a pass gets.
        let of = self.device.adapter_info();
        let usable = 4 <= of.subgroup_min_size && of.subgroup_max_size <= 128;
        (self.device.features().contains(wgpu::Features::SUBGROUP) && usable).then_some(of.subgroup_min_size)
    }

    /// The number of invocations in every subgroup, where the device is a program on the CPU, has subgroups of one size, and a
    /// workgroup of [`NARROW_WORKGROUP`] consists of them.
    pub(crate) fn narrow_width(&self) -> Option<u32> {
        let of = self.device.adapter_info();
        let is_known =
            of.subgroup_min_size == of.subgroup_max_size && of.subgroup_max_size <= NARROW_WORKGROUP;
        self.subgroup_width().filter(|_| self.is_software() && is_known)
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

    /// Submits what `record` records, waits for it, and lets `read` read that many bytes of each of some
    /// buffers. Returns with its result what all took.
    pub(crate) fn run_and_read<R>(
        &self,
        job: Job,
        parts: &[(&wgpu::Buffer, u64)],
        record: impl FnOnce(&mut wgpu::CommandEncoder) -> Result<(), GpuError>,
        read: impl FnOnce(&[&[u8]]) -> R,
    ) -> Result<(R, Spent), GpuError> {
        self.alive()?;
        let start = Instant::now();
        let mut places = Vec::with_capacity(parts.len());
        let mut bytes = 0;
        for &(_, size) in parts {
            places.push(bytes as usize..(bytes + size) as usize);
            bytes = (bytes + size).next_multiple_of(wgpu::MAP_ALIGNMENT);
        }
        let copy = if parts.is_empty() { None } else { Some(self.readback(bytes.max(wgpu::MAP_ALIGNMENT))?) };
        let submission = checked(&self.device, "submission", || -> Result<_, GpuError> {
            let mut encoder = self.device.create_command_encoder(&Default::default());
            record(&mut encoder)?;
            for (&(from, size), place) in parts.iter().zip(&places) {
                if let (Some(copy), true) = (&copy, size > 0) {
                    encoder.copy_buffer_to_buffer(from, 0, copy, place.start as u64, Some(size));
                }
            }
            Ok(self.queue.submit([encoder.finish()]))
        })
        .map_err(|error| error.with_needed(job.bytes))??;
        let recording_s = start.elapsed().as_secs_f64();
        let (sender, receiver) = mpsc::channel();
        if let Some(copy) = &copy {
            copy.slice(..bytes.max(wgpu::MAP_ALIGNMENT)).map_async(wgpu::MapMode::Read, move |mapped| {
                // The receiver is gone only where the wait below has failed already.
                let _ = sender.send(mapped);
            });
        }
        let limit = job.time_limit();
        let deadline = Instant::now() + limit;
        self.wait(submission, limit)?;
        let lost = |error: &dyn std::fmt::Display| GpuError::Lost { reason: error.to_string() };
        if copy.is_some() {
            // Where several threads use the device, another thread's wait may call our callback, a moment
            // after ours has returned.
            let left = deadline.saturating_duration_since(Instant::now()).max(CALLBACK_LIMIT);
            match receiver.recv_timeout(left) {
                Ok(Ok(())) => {}
                Ok(Err(error)) => return Err(lost(&error)),
                Err(_) => return Err(self.timed_out(limit)),
            }
        }
        let waiting_s = start.elapsed().as_secs_f64() - recording_s;
        let done = match copy {
            None => read(&[]),
            Some(copy) => {
                let slice = copy.slice(..bytes.max(wgpu::MAP_ALIGNMENT));
                let view = slice.get_mapped_range().map_err(|error| lost(&error))?;
                let views: Vec<&[u8]> = places.into_iter().map(|place| &view[place]).collect();
                let done = read(&views);
                drop(views);
                drop(view);
                copy.unmap();
                self.keep_readback(copy);
                done
            }
        };
        let reading_s = start.elapsed().as_secs_f64() - recording_s - waiting_s;
        Ok((done, Spent { recording_s, waiting_s, reading_s, waits: 1, ..Spent::default() }))
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
