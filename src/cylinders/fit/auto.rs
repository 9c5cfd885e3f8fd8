use super::FitProgress;
use super::sealed::Sealed;
use super::{CpuEngine, Engine, Fit, FitRequest, SectionFit};
use crate::Result;
use crate::cylinders::passes::Section;
#[cfg(feature = "gpu")]
use crate::engine;
use crate::engine::WORTH_A_DEVICE_S;
use crate::settings::Settings;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
#[cfg(feature = "gpu")]
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Fits on the engine that is likely to be fastest for the amount of work, and on the CPU where a device fails.
///
/// It estimates the time on the CPU and on a device. Until it has started a device, that takes
/// [`WORTH_A_DEVICE_S`] besides; work that is done sooner on the CPU does not look for one. The best adapter
/// is taken unless it is software, which computes the same on the same cores, only slower.
#[derive(Default)]
pub struct AutoEngine {
    #[cfg(feature = "gpu")]
    device: Mutex<Option<Device>>,
}

/// An amount of work, and the times that it takes. The figures are those of a server's CPU and of an NVIDIA
/// H100, with points that come from the host; they affect the choice of an engine, not a result.
#[derive(Debug, Clone, Copy)]
struct Work {
    points: f64,
    faces: f64,
    cylinders: f64,
    iterations: f64,
}

impl Work {
    /// CPU time of a point and of a face in one iteration, in seconds.
    const CPU_PER_POINT_S: f64 = 40e-9;
    const CPU_PER_FACE_S: f64 = 60e-9;
    /// Points and faces of a cylinder that a thread takes at least.
    const POINTS_PER_THREAD: f64 = 16_384.0;
    const FACES_PER_THREAD: f64 = 8_192.0;
    /// The part of the work that one thread does while the others wait.
    const SEQUENTIAL: f64 = 0.06;

    fn new(points: u64, cylinders: usize, settings: &Settings) -> Self {
        Self {
            points: points as f64,
            faces: cylinders as f64 * f64::from(settings.nodes) * f64::from(settings.levels),
            cylinders: cylinders as f64,
            iterations: f64::from(settings.iterations),
        }
    }

    /// Time on the CPU with that many threads.
    fn cpu_s(&self, threads: usize) -> f64 {
        let an_iteration = self.points * Self::CPU_PER_POINT_S + self.faces * Self::CPU_PER_FACE_S;
        let parts = self.points / Self::POINTS_PER_THREAD + self.faces / Self::FACES_PER_THREAD;
        let threads = (threads as f64).min(parts.max(self.cylinders)).max(1.0);
        // Projecting and grouping cost about as much as one iteration.
        (self.iterations + 1.0) * an_iteration * (1.0 + Self::SEQUENTIAL * (threads - 1.0)) / threads
    }

    /// Time on a started device of that kind.
    #[cfg(feature = "gpu")]
    fn device_s(&self, kind: &str) -> f64 {
        // Measured from host slices to results: 0.24 ms for 60 faces and 1e4 points, 10.6 and 45 ms for 1e7
        // points and 0.26 and 4.2 million faces, three iterations each, of which an iteration is a fiftieth.
        let share = 0.94 + self.iterations / 50.0;
        let discrete = 0.27e-3 + share * (self.points * 1.2e-9 + self.faces * 9e-9);
        // Others have a tenth of the memory bandwidth, but no bus to cross.
        if kind == "discrete GPU" { discrete } else { 5.0 * discrete }
    }
}

/// The device that the last call looked for.
#[cfg(feature = "gpu")]
struct Device {
    /// The setting that names it.
    adapter: Option<String>,
    /// The engine, or why there is none.
    engine: Result<std::sync::Arc<super::gpu::GpuEngine>, String>,
}

impl AutoEngine {
    /// Does work on the engine that suits it; returns with its result why there.
    fn run<R>(
        &self,
        work: Work,
        settings: &Settings,
        fit: impl Fn(&dyn Engine) -> Result<R>,
    ) -> Result<(R, String)> {
        let on_cpu = |why: String| Ok((fit(&CpuEngine::<f32>::new())?, why));
        let threads = rayon::current_num_threads();
        let cpu_s = work.cpu_s(threads);
        let of_cpu = format!("the work is about {} on the CPU with {threads} threads", in_words(cpu_s));
        #[cfg(feature = "gpu")]
        {
            let started = self.started(settings.adapter.as_deref());
            if started.is_none() && cpu_s < WORTH_A_DEVICE_S {
                return on_cpu(format!("{of_cpu}, less than starting a device takes"));
            }
            let gpu = match started.map_or_else(|| self.start(settings.adapter.as_deref()), Ok) {
                Err(why) => return on_cpu(why),
                Ok(gpu) => gpu,
            };
            let device_s = work.device_s(gpu.adapter().map_or("", |adapter| adapter.kind));
            let compared = format!("{of_cpu}, {} on the device", in_words(device_s));
            if cpu_s < device_s {
                return on_cpu(compared);
            }
            match fit(&*gpu) {
                Err(crate::Error::Gpu(failure)) => {
                    // It may be lost: the next call looks for one again.
                    *locked(&self.device) = None;
                    on_cpu(format!("the device failed: {failure}"))
                }
                done => Ok((done?, compared)),
            }
        }
        #[cfg(not(feature = "gpu"))]
        {
            let _ = settings;
            on_cpu(match cpu_s < WORTH_A_DEVICE_S {
                true => format!("{of_cpu}, less than starting a device takes"),
                false => "this build has no GPU engine".into(),
            })
        }
    }

    /// The device of that name, or the best one, where the last call that looked for it started it.
    #[cfg(feature = "gpu")]
    fn started(&self, adapter: Option<&str>) -> Option<std::sync::Arc<super::gpu::GpuEngine>> {
        let device = locked(&self.device);
        let named = device.as_ref().filter(|device| device.adapter.as_deref() == adapter)?;
        named.engine.as_ref().ok().cloned()
    }

    /// The device of that name, or the best one. It is started once and kept for later calls with the same name.
    #[cfg(feature = "gpu")]
    fn start(&self, adapter: Option<&str>) -> Result<std::sync::Arc<super::gpu::GpuEngine>, String> {
        let mut device = locked(&self.device);
        if let Some(device) = device.as_ref().filter(|d| d.adapter.as_deref() == adapter) {
            return device.engine.clone();
        }
        let engine = engine::start(adapter, super::gpu::GpuEngine::new)
            .map(std::sync::Arc::new)
            .map_err(|reason| reason.to_string());
        *device = Some(Device { adapter: adapter.map(str::to_owned), engine: engine.clone() });
        engine
    }
}

/// A time for a person.
fn in_words(seconds: f64) -> String {
    if seconds < 0.1 { format!("{:.1} ms", seconds * 1e3) } else { format!("{seconds:.1} s") }
}

#[cfg(feature = "gpu")]
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Progress of work that one engine may begin and another repeat: each cylinder is reported once.
struct Tally<'a> {
    reported: AtomicUsize,
    report: &'a FitProgress<'a>,
}

impl<'a> Tally<'a> {
    fn new(report: &'a FitProgress<'a>) -> Self {
        Self { reported: AtomicUsize::new(0), report }
    }

    /// The progress of an engine that begins.
    fn attempt(&self) -> impl Fn(usize) -> ControlFlow<()> + Sync + '_ {
        let ready = AtomicUsize::new(0);
        move |newly| {
            let ready = ready.fetch_add(newly, Ordering::Relaxed) + newly;
            let reported = self.reported.fetch_max(ready, Ordering::Relaxed);
            match ready.checked_sub(reported) {
                Some(newly) if newly > 0 => (self.report)(newly),
                _ => ControlFlow::Continue(()),
            }
        }
    }
}

impl Sealed for AutoEngine {}

impl Engine for AutoEngine {
    fn fit(&self, request: &FitRequest) -> Result<Fit> {
        let mut points = 0;
        for &frame in request.frames {
            points += request
                .track
                .near(frame, request.settings)?
                .map(|near| near.echoes.len() as u64)
                .sum::<u64>();
        }
        let work = Work::new(points, request.frames.len(), request.settings);
        let tally = Tally::new(request.progress);
        let (mut fit, why) = self.run(work, request.settings, |engine| {
            engine.fit(&FitRequest { progress: &tally.attempt(), ..*request })
        })?;
        fit.engine.why = Some(why);
        Ok(fit)
    }

    fn fit_section(&self, section: &Section<f32>, radius_mm: f64, settings: &Settings) -> Result<SectionFit> {
        let work = Work::new(section.len() as u64, 1, settings);
        let (mut fit, why) =
            self.run(work, settings, |engine| engine.fit_section(section, radius_mm, settings))?;
        fit.engine.why = Some(why);
        Ok(fit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn work(points: u64, nodes: u32, levels: u32) -> Work {
        Work::new(points, 1, &Settings::default().with_nodes(nodes).with_levels(levels))
    }

    /// Within a factor of three of what was measured on a server with 16 cores, in ms.
    #[test]
    fn estimates_are_those_of_the_machine_that_was_measured() {
        let near = |estimate_s: f64, measured_ms: f64| {
            let ratio = estimate_s * 1e3 / measured_ms;
            assert!((1.0 / 3.0..3.0).contains(&ratio), "{estimate_s} s, measured {measured_ms} ms");
        };
        near(work(10_000, 12, 5).cpu_s(16), 1.1);
        near(work(1_000_000, 12, 5).cpu_s(1), 61.0);
        near(work(1_000_000, 512, 512).cpu_s(1), 207.0);
        near(work(10_000_000, 512, 512).cpu_s(1), 1766.0);
        #[cfg(feature = "gpu")]
        for (work, measured_ms) in [
            (work(10_000, 12, 5), 0.24),
            (work(1_000_000, 12, 5), 1.1),
            (work(1_000_000, 512, 512), 1.9),
            (work(10_000_000, 512, 512), 10.6),
            (work(10_000_000, 2048, 2048), 45.0),
        ] {
            near(work.device_s("discrete GPU"), measured_ms);
            assert!(work.device_s("integrated GPU") > work.device_s("discrete GPU"));
        }
    }

    #[test]
    fn more_threads_take_less_time_and_never_more_than_there_is_work_for() {
        let large = work(10_000_000, 512, 512);
        let times: Vec<f64> = [1, 2, 4, 8, 16, 64].map(|threads| large.cpu_s(threads)).to_vec();
        assert!(times.windows(2).all(|pair| pair[1] < pair[0]), "{times:?}");
        assert!((8.0..9.0).contains(&(times[0] / times[4])));
        let small = work(10_000, 12, 5);
        assert_eq!(small.cpu_s(1), small.cpu_s(16));
    }

    /// A device that is there already is worth it far earlier than one that has to be started.
    #[cfg(feature = "gpu")]
    #[test]
    fn a_started_device_takes_what_it_is_faster_with() {
        for threads in [1, 2, 16, 64] {
            let small = work(10_000, 12, 5);
            assert!(small.device_s("discrete GPU") < small.cpu_s(threads));
            assert!(small.cpu_s(threads) < WORTH_A_DEVICE_S);
            let tiny = work(500, 12, 5);
            assert!(tiny.cpu_s(threads) < tiny.device_s("discrete GPU"));
        }
    }

    #[test]
    fn cylinders_that_a_second_engine_repeats_are_told_of_once() {
        let told = AtomicUsize::new(0);
        let tell = |newly| {
            assert!(newly > 0, "told of nothing");
            told.fetch_add(newly, Ordering::Relaxed);
            if newly == 13 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let tally = Tally::new(&tell);
        let on_device = tally.attempt();
        assert!(on_device(30).is_continue() && on_device(20).is_continue());
        assert_eq!(told.load(Ordering::Relaxed), 50);
        let on_cpu = tally.attempt();
        assert!((0..50).all(|_| on_cpu(1).is_continue()));
        assert_eq!(told.load(Ordering::Relaxed), 50);
        assert!((50..80).all(|_| on_cpu(1).is_continue()));
        assert_eq!(told.load(Ordering::Relaxed), 80);
        assert!(on_cpu(13).is_break());
    }
}
