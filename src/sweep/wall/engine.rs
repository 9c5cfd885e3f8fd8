//! The choice of the engine that fits the wall.

use super::cpu::CpuWallEngine;
use super::fit::{self, Aim, Checkpoint, Wall, start_mm};
#[cfg(feature = "gpu")]
use super::gpu::GpuWallEngine;
use crate::engine::{EngineDescription, WORTH_A_DEVICE_S};
use crate::settings::{Backend, Settings};
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;
use crate::{Error, Result};
#[cfg(feature = "gpu")]
use std::sync::{Arc, Mutex, PoisonError};

/// CPU time of an echo in a reweighting and of a node in a step of the solver, in seconds, about twice that of a server
/// processor; reweightings, and steps in each. They affect the choice of [`Backend::Auto`], but no result.
const SECONDS_PER_ECHO: f64 = 200e-9;
const SECONDS_PER_NODE: f64 = 80e-9;
const USUAL_ITERATIONS: f64 = 6.0;
const USUAL_STEPS: f64 = 7.0;

/// The device that walls are fitted on. The first wall that needs it starts it, and all others share it: those of the
/// branches of a vessel, which are fitted side by side, and those of later recordings.
#[derive(Default)]
pub(crate) struct WallDevice {
    #[cfg(feature = "gpu")]
    started: Mutex<Option<Arc<GpuWallEngine>>>,
}

#[cfg(feature = "gpu")]
impl WallDevice {
    /// The engine, started by `start` where there is none yet.
    fn engine(&self, start: impl FnOnce() -> Result<GpuWallEngine>) -> Result<Arc<GpuWallEngine>> {
        let mut started = self.started.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(engine) = &*started {
            return Ok(Arc::clone(engine));
        }
        let engine = Arc::new(start()?);
        *started = Some(Arc::clone(&engine));
        Ok(engine)
    }

    /// Fits a wall on it. After a failure the device is started anew for the next wall.
    fn fit(
        &self,
        engine: &Arc<GpuWallEngine>,
        grid: &WallGrid,
        echoes: &mut [Echo],
        aim: Aim,
        checkpoint: &Checkpoint,
    ) -> Result<Wall> {
        let fitted = fit_on_device(grid, echoes, aim, engine, checkpoint);
        if matches!(fitted, Err(Error::Gpu(_))) {
            let mut started = self.started.lock().unwrap_or_else(PoisonError::into_inner);
            // Another wall may have replaced it already.
            started.take_if(|other| Arc::ptr_eq(other, engine));
        }
        fitted
    }
}

/// Fits the wall on the backend of the settings.
pub(in crate::sweep) fn fit(
    grid: &WallGrid,
    echoes: &mut [Echo],
    settings: &Settings,
    aim: Aim,
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables))] device: &WallDevice,
    checkpoint: &Checkpoint,
) -> Result<(Wall, EngineDescription)> {
    let fit_on_cpu =
        |grid: &WallGrid, echoes: &mut [Echo], why| fit_on_cpu(grid, echoes, aim, why, checkpoint);
    let ages = settings.sweep.half_life_s.is_some();
    match settings.backend {
        Backend::Auto if ages => fit_on_cpu(grid, echoes, Some("devices weigh all echoes alike".into())),
        Backend::Gpu if ages => Err(Error::Setting {
            name: "backend".into(),
            found: "gpu".into(),
            expected: "auto or cpu with sweep.half_life_s: devices weigh all echoes alike".into(),
        }),
        Backend::Cpu => fit_on_cpu(grid, echoes, None),
        // On the CPU the sweep is its own reference.
        Backend::Reference => {
            let (wall, engine) = fit_on_cpu(grid, echoes, None)?;
            Ok((wall, EngineDescription { name: "reference".into(), ..engine }))
        }
        Backend::Auto => {
            let of_echoes = echoes.len() as f64 * SECONDS_PER_ECHO;
            let of_nodes = grid.node_count() as f64 * SECONDS_PER_NODE * USUAL_STEPS;
            let cpu_seconds = USUAL_ITERATIONS * (of_echoes + of_nodes) / rayon::current_num_threads() as f64;
            if cpu_seconds < WORTH_A_DEVICE_S {
                let why = format!(
                    "fitting the wall takes about {} ms on the CPU, less than starting a device takes",
                    (cpu_seconds * 1e3).ceil()
                );
                return fit_on_cpu(grid, echoes, Some(why));
            }
            #[cfg(feature = "gpu")]
            let start = || crate::engine::start(settings.adapter.as_deref(), GpuWallEngine::new);
            #[cfg(feature = "gpu")]
            let why = match device.engine(start) {
                Err(reason) => reason.to_string(),
                Ok(engine) => match device.fit(&engine, grid, echoes, aim, checkpoint) {
                    Ok(wall) => {
                        let why = format!("fitting the wall takes about {cpu_seconds:.1} s on the CPU");
                        return Ok((wall, EngineDescription { why: Some(why), ..engine.describe() }));
                    }
                    Err(Error::Cancelled) => return Err(Error::Cancelled),
                    Err(failure) => format!("the device failed: {failure}"),
                },
            };
            #[cfg(not(feature = "gpu"))]
            let why = "this build has no GPU engine".to_owned();
            fit_on_cpu(grid, echoes, Some(why))
        }
        #[cfg(feature = "gpu")]
        Backend::Gpu => {
            let engine = device.engine(|| GpuWallEngine::new(settings.adapter.as_deref()))?;
            Ok((device.fit(&engine, grid, echoes, aim, checkpoint)?, engine.describe()))
        }
        #[cfg(not(feature = "gpu"))]
        Backend::Gpu => Err(crate::settings::no_gpu_engine()),
    }
}

/// Continues the fit of a wall, on the CPU.
pub(in crate::sweep) fn refit(
    grid: &WallGrid,
    echoes: &mut [Echo],
    roughness: f64,
    wall: Wall,
    checkpoint: &Checkpoint,
) -> Result<Wall> {
    let start_mm = start_mm(echoes);
    let engine = CpuWallEngine::new(grid, echoes, wall.clone());
    fit::reweighted(engine, grid, start_mm, Aim::alone(roughness), wall, checkpoint)
}

fn fit_on_cpu(
    grid: &WallGrid,
    echoes: &mut [Echo],
    aim: Aim,
    why: Option<String>,
    checkpoint: &Checkpoint,
) -> Result<(Wall, EngineDescription)> {
    let start_mm = start_mm(echoes);
    let engine = CpuWallEngine::new(grid, echoes, Wall::tube(grid, start_mm));
    let wall = fit::fit(engine, grid, start_mm, aim, checkpoint)?;
    Ok((wall, EngineDescription { name: "cpu".into(), adapter: None, why }))
}

#[cfg(feature = "gpu")]
pub(in crate::sweep) fn fit_on_device(
    grid: &WallGrid,
    echoes: &mut [Echo],
    aim: Aim,
    engine: &GpuWallEngine,
    checkpoint: &Checkpoint,
) -> Result<Wall> {
    let start_mm = start_mm(echoes);
    let engine = engine.wall(grid, echoes, start_mm)?;
    fit::fit(engine, grid, start_mm, aim, checkpoint)
}
