use super::sealed::Sealed;
use super::{CpuEngine, Engine, Fit, FitRequest, SectionFit};
use crate::Result;
use crate::cylinders::passes::Section;
#[cfg(feature = "gpu")]
use crate::engine;
use crate::engine::WORTH_A_DEVICE_S;
use crate::settings::Settings;
use std::sync::atomic::{AtomicUsize, Ordering};
#[cfg(feature = "gpu")]
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Fits on the engine that is likely to be fastest for the amount of work, and on the CPU where a device fails.
///
/// The work on the CPU is estimated from the number of points, faces and iterations. Below
/// [`WORTH_A_DEVICE_S`] no device is looked for, because starting one takes longer; above, the best
/// adapter is taken unless it is software, which computes the same on the same cores, only slower.
#[derive(Default)]
pub struct AutoEngine {
    #[cfg(feature = "gpu")]
    device: Mutex<Option<Device>>,
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
    /// CPU time of a point and of a face in one iteration, in seconds: about twice that of `benches/fit.rs` on one
    /// core of a server processor, since slower ones are common. They affect the choice of an engine, not a result.
    const SECONDS_PER_POINT: f64 = 25e-9;
    const SECONDS_PER_FACE: f64 = 60e-9;

    fn cpu_seconds(points: u64, cylinders: usize, settings: &Settings) -> f64 {
        let faces = cylinders as f64 * f64::from(settings.nodes) * f64::from(settings.levels);
        let an_iteration = points as f64 * Self::SECONDS_PER_POINT + faces * Self::SECONDS_PER_FACE;
        // Projecting and grouping cost about as much as one iteration.
        f64::from(settings.iterations + 1) * an_iteration / rayon::current_num_threads() as f64
    }

    /// Runs work that would take the CPU `cpu_seconds` on the engine that suits it; returns with its result why there.
    fn run<R>(
        &self,
        cpu_seconds: f64,
        settings: &Settings,
        work: impl Fn(&dyn Engine) -> Result<R>,
    ) -> Result<(R, String)> {
        let on_cpu = |why: String| Ok((work(&CpuEngine::<f32>::new())?, why));
        if cpu_seconds < WORTH_A_DEVICE_S {
            let ms = (cpu_seconds * 1e3).ceil();
            return on_cpu(format!(
                "the work is about {ms} ms on the CPU, less than starting a device takes"
            ));
        }
        #[cfg(feature = "gpu")]
        {
            match self.device(settings.adapter.as_deref()) {
                Err(why) => on_cpu(why),
                Ok(gpu) => match work(&*gpu) {
                    Err(crate::Error::Gpu(failure)) => {
                        // It may be lost: the next call looks for one again.
                        *locked(&self.device) = None;
                        on_cpu(format!("the device failed: {failure}"))
                    }
                    done => Ok((done?, format!("the work is about {cpu_seconds:.1} s on the CPU"))),
                },
            }
        }
        #[cfg(not(feature = "gpu"))]
        {
            let _ = settings;
            on_cpu("this build has no GPU engine".into())
        }
    }

    /// The device of that name, or the best one. It is started once and kept for later calls with the same name.
    #[cfg(feature = "gpu")]
    fn device(&self, adapter: Option<&str>) -> Result<std::sync::Arc<super::gpu::GpuEngine>, String> {
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

#[cfg(feature = "gpu")]
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Progress of work that one engine may begin and another repeat: each cylinder is reported once.
struct Tally<'a> {
    reported: AtomicUsize,
    report: &'a (dyn Fn(usize) + Sync),
}

impl<'a> Tally<'a> {
    fn new(report: &'a (dyn Fn(usize) + Sync)) -> Self {
        Self { reported: AtomicUsize::new(0), report }
    }

    /// The progress of an engine that begins.
    fn attempt(&self) -> impl Fn(usize) + Sync + '_ {
        let ready = AtomicUsize::new(0);
        move |newly| {
            let ready = ready.fetch_add(newly, Ordering::Relaxed) + newly;
            let reported = self.reported.fetch_max(ready, Ordering::Relaxed);
            if ready > reported {
                (self.report)(ready - reported);
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
        let seconds = Self::cpu_seconds(points, request.frames.len(), request.settings);
        let tally = Tally::new(request.progress);
        let (mut fit, why) = self.run(seconds, request.settings, |engine| {
            engine.fit(&FitRequest { progress: &tally.attempt(), ..*request })
        })?;
        fit.engine.why = Some(why);
        Ok(fit)
    }

    fn fit_section(&self, section: &Section<f32>, radius_mm: f64, settings: &Settings) -> Result<SectionFit> {
        let seconds = Self::cpu_seconds(section.len() as u64, 1, settings);
        let (mut fit, why) =
            self.run(seconds, settings, |engine| engine.fit_section(section, radius_mm, settings))?;
        fit.engine.why = Some(why);
        Ok(fit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cylinders_that_a_second_engine_repeats_are_told_of_once() {
        let told = AtomicUsize::new(0);
        let tell = |newly| {
            assert!(newly > 0, "told of nothing");
            told.fetch_add(newly, Ordering::Relaxed);
        };
        let tally = Tally::new(&tell);
        let on_device = tally.attempt();
        on_device(30);
        on_device(20);
        assert_eq!(told.load(Ordering::Relaxed), 50);
        let on_cpu = tally.attempt();
        (0..50).for_each(|_| on_cpu(1));
        assert_eq!(told.load(Ordering::Relaxed), 50);
        (50..80).for_each(|_| on_cpu(1));
        assert_eq!(told.load(Ordering::Relaxed), 80);
    }
}
