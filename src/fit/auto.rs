use super::passes::Section;
use super::{CpuEngine, DeformedTube, Engine, EngineDescription, FittedCylinder, Job};
use crate::Result;
use crate::settings::Settings;
use std::sync::{Mutex, PoisonError};

/// Fits on whatever is likely to be fastest for the work at hand, and on the CPU where a device fails.
///
/// The work on the CPU is estimated from the number of points, faces and iterations. Below
/// [`AutoEngine::WORTH_A_DEVICE_S`] no device is looked for, because starting one takes longer; above, the best
/// adapter is taken unless it is software, which computes the same on the same cores, only slower.
#[derive(Default)]
pub struct AutoEngine {
    last: Mutex<EngineDescription>,
    #[cfg(feature = "gpu")]
    device: std::sync::OnceLock<Result<super::gpu::GpuEngine, String>>,
}

impl AutoEngine {
    /// CPU work, in seconds, from which a device is worth its start.
    pub const WORTH_A_DEVICE_S: f64 = 0.5;

    /// CPU time of a point and of a face in one iteration, in seconds: the medians of `benches/fit.rs` on one
    /// core of a server processor, rounded up. They steer a choice, not a result.
    const SECONDS_PER_POINT: f64 = 25e-9;
    const SECONDS_PER_FACE: f64 = 60e-9;

    /// The adapter that large work goes to, of a list with the best first, where none is named.
    ///
    /// # Errors
    /// Why the work stays on the CPU.
    #[cfg(feature = "gpu")]
    pub fn choose(
        adapters: &[super::gpu::AdapterDescription],
    ) -> Result<&super::gpu::AdapterDescription, String> {
        match adapters.first() {
            None => Err("there is no GPU adapter".into()),
            Some(best) if best.is_software() => Err(format!("the best adapter, {}, is software", best.name)),
            Some(best) => Ok(best),
        }
    }

    fn cpu_seconds(points: u64, cylinders: usize, settings: &Settings) -> f64 {
        let faces = cylinders as f64 * f64::from(settings.nodes) * f64::from(settings.levels);
        let an_iteration = points as f64 * Self::SECONDS_PER_POINT + faces * Self::SECONDS_PER_FACE;
        // Projecting and grouping cost about as much as one iteration.
        f64::from(settings.iterations + 1) * an_iteration / rayon::current_num_threads() as f64
    }

    /// Runs work that takes the CPU so many seconds on the engine that suits it.
    fn run<R>(
        &self,
        cpu_seconds: f64,
        settings: &Settings,
        work: impl Fn(&dyn Engine) -> Result<R>,
    ) -> Result<R> {
        let cpu = CpuEngine::<f32>::new();
        let on_cpu = |why: String| {
            self.note(EngineDescription { why: Some(why), ..cpu.describe() });
            work(&cpu)
        };
        if cpu_seconds < Self::WORTH_A_DEVICE_S {
            let ms = (cpu_seconds * 1e3).ceil();
            return on_cpu(format!(
                "the work is about {ms} ms on the CPU, less than starting a device takes"
            ));
        }
        #[cfg(feature = "gpu")]
        {
            let device = self.device.get_or_init(|| {
                if settings.adapter.is_none() {
                    Self::choose(&super::gpu::adapters())?;
                }
                super::gpu::GpuEngine::new(settings.adapter.as_deref()).map_err(|e| e.to_string())
            });
            match device {
                Err(why) => on_cpu(why.clone()),
                Ok(gpu) => match work(gpu) {
                    Err(crate::Error::Gpu(failure)) => on_cpu(format!("the device failed: {failure}")),
                    done => {
                        let why = format!("the work is about {cpu_seconds:.1} s on the CPU");
                        self.note(EngineDescription { why: Some(why), ..gpu.describe() });
                        done
                    }
                },
            }
        }
        #[cfg(not(feature = "gpu"))]
        {
            let _ = settings;
            on_cpu("this build has no GPU engine".into())
        }
    }

    fn note(&self, description: EngineDescription) {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = description;
    }
}

impl Engine for AutoEngine {
    fn describe(&self) -> EngineDescription {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn fit(&self, job: &Job) -> Result<Vec<FittedCylinder>> {
        let mut points = 0;
        for &frame in job.frames {
            points += job.track.near(frame, job.settings)?.map(|near| near.echoes.len() as u64).sum::<u64>();
        }
        let seconds = Self::cpu_seconds(points, job.frames.len(), job.settings);
        self.run(seconds, job.settings, |engine| engine.fit(job))
    }

    fn fit_section(
        &self,
        section: &Section<f32>,
        radius_mm: f64,
        settings: &Settings,
    ) -> Result<DeformedTube> {
        let seconds = Self::cpu_seconds(section.len() as u64, 1, settings);
        self.run(seconds, settings, |engine| engine.fit_section(section, radius_mm, settings))
    }
}
