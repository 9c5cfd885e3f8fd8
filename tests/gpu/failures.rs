//! Failures come in time, with a typed error and no stale result.

use crate::device::{device, open};
use crate::sections::{RADIUS_MM, recording, wall};
use lumenmesh::Error;
use lumenmesh::cylinders::{AutoEngine, CpuEngine, Engine, FitRequest, Track};
use lumenmesh::gpu::GpuError;
use lumenmesh::low_level::cylinders::gpu::GpuEngine;
use lumenmesh::low_level::sweep::gpu::GpuWallEngine;
use lumenmesh::settings::{Backend, Settings, SweepSettings};
use lumenmesh::sweep::Sweep;
use std::sync::mpsc;
use std::time::Duration;

/// Runs work that must not hang.
fn in_time<R: Send + 'static>(work: impl FnOnce() -> R + Send + 'static) -> R {
    let (sender, receiver) = mpsc::channel();
    let thread = std::thread::spawn(move || sender.send(work()));
    let done = receiver.recv_timeout(Duration::from_secs(60)).expect("the device hangs");
    thread.join().unwrap().unwrap();
    done
}

#[test]
fn a_destroyed_device_fails_every_call() {
    let Some(device) = open() else { return };
    let settings = Settings::default();
    let section = wall(1_000, 137);
    device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap();
    let workspace = device.engine.prepare(1_000, RADIUS_MM, &settings).unwrap();
    device.engine.device().destroy();
    in_time(move || {
        let engine = &device.engine;
        let failed = engine.fit_section(&section, RADIUS_MM, &settings).unwrap_err();
        assert!(matches!(failed, Error::Gpu(_)), "{failed}");
        let failed = engine.run_pass(&workspace, "scan_spine", &[], &["radii"]).unwrap_err();
        assert!(matches!(failed, Error::Gpu(_)), "{failed}");
        let failed = engine.prepare(10, RADIUS_MM, &settings).err().expect("a workspace on no device");
        assert!(matches!(failed, Error::Gpu(_)), "{failed}");
        let track = Track::of(&recording(20, 50, 139), &settings).unwrap();
        let failed = engine.fit(&FitRequest::new(&track, &[9, 19], &settings)).unwrap_err();
        assert!(matches!(failed, Error::Gpu(_)), "{failed}");
        println!("{failed}");
    });
}

#[test]
fn a_host_s_destroyed_device_fails_too() {
    let Some(device) = open() else { return };
    let (lost, queue) = (device.engine.device().clone(), device.engine.queue().clone());
    let engine = GpuEngine::on_device(lost.clone(), queue).unwrap();
    lost.destroy();
    in_time(move || {
        let failed = engine.fit_section(&wall(100, 149), RADIUS_MM, &Settings::default()).unwrap_err();
        assert!(matches!(failed, Error::Gpu(_)), "{failed}");
    });
}

#[test]
fn a_sweep_on_a_destroyed_device_fails() {
    let Some(device) = open() else { return };
    let (lost, queue) = (device.engine.device().clone(), device.engine.queue().clone());
    let engine = GpuWallEngine::on_device(lost.clone(), queue).unwrap();
    let pullback = recording(60, 40, 163);
    Sweep::on_device(&pullback, &Settings::default(), &engine).unwrap();
    lost.destroy();
    in_time(move || {
        let failed = Sweep::on_device(&pullback, &Settings::default(), &engine).unwrap_err();
        assert!(matches!(failed, Error::Gpu(_)), "{failed}");
    });
}

#[test]
fn a_large_sweep_falls_back_to_the_cpu_and_says_why() {
    let pullback = recording(150, 300, 167);
    let sweep = SweepSettings::default().with_nodes(Some(512));
    let settings = Settings::default().with_sweep(sweep).with_adapter(Some("no such adapter".into()));
    // On one thread it takes longer than a device needs to start, whatever the machine.
    let fallen_back = on_one_thread(|| Sweep::of(&pullback, &settings)).unwrap();
    let why = fallen_back.report.engine.why.unwrap();
    assert!(fallen_back.report.engine.name == "cpu" && why.contains("no such adapter"), "{why}");
    let settings = settings.with_backend(Backend::Cpu);
    let on_cpu = Sweep::of(&pullback, &settings).unwrap();
    assert_eq!(on_cpu.report.engine.why, None);
    assert_eq!(fallen_back.radii_mm, on_cpu.radii_mm);
    let settings = settings.with_backend(Backend::Gpu);
    let failed = Sweep::of(&pullback, &settings).unwrap_err();
    assert!(matches!(failed, Error::Gpu(GpuError::NoAdapter { .. })), "{failed}");
}

#[test]
fn too_large_a_job_is_refused_with_both_numbers() {
    let Some(device) = device() else { return };
    let limits = device.engine.device().limits();
    let allowed = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    let refused = |points: u32, settings: &Settings| match device.engine.prepare(points, RADIUS_MM, settings)
    {
        Err(Error::Gpu(GpuError::TooLarge { name, needed, allowed: limit, .. })) => {
            assert_eq!(limit, allowed);
            (name, needed)
        }
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("a request of {points} points was accepted"),
    };
    let (name, needed) = refused(u32::MAX, &Settings::default());
    assert_eq!((name.as_str(), needed), ("grouped", 16 * u64::from(u32::MAX)));
    // One point too many: grouped points take 16 bytes each.
    if let Ok(most) = u32::try_from(allowed / 16) {
        refused(most + 1, &Settings::default());
    }
    let faces = 1 << 28;
    let (name, needed) = refused(10, &Settings::default().with_nodes(faces).with_levels(1));
    assert_eq!((name.as_str(), needed), ("triangle_support", 16 * u64::from(faces)));
    let failed = device.engine.prepare(u32::MAX, RADIUS_MM, &Settings::default()).err().unwrap();
    let message = failed.to_string();
    assert!(message.contains(&needed_and_allowed(16 * u64::from(u32::MAX), allowed)), "{message}");
}

fn needed_and_allowed(needed: u64, allowed: u64) -> String {
    format!("needs {needed} bytes for grouped, the device allows {allowed} at most")
}

#[test]
fn an_unknown_adapter_is_answered_with_those_that_are_there() {
    let failed = GpuEngine::new(Some("no such adapter")).err().expect("an adapter of that name");
    let message = failed.to_string();
    assert!(message.contains("\"no such adapter\""), "{message}");
    for adapter in lumenmesh::gpu::adapters() {
        assert!(message.contains(&adapter.name), "{message}");
    }
}

/// Enough work for one thread to look for a device, little enough to do here.
fn large() -> Settings {
    Settings::default().with_nodes(1000).with_levels(800).with_iterations(30)
}

/// Work on one thread, however many cores there are.
fn on_one_thread<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(work)
}

#[test]
fn auto_falls_back_to_the_cpu_and_says_why() {
    let section = wall(2_000, 151);
    let engine = AutoEngine::default();
    let settings = large().with_adapter(Some("no such adapter".into()));
    let fit = on_one_thread(|| engine.fit_section(&section, RADIUS_MM, &settings).unwrap());
    assert_eq!(fit.engine.name, "cpu");
    let why = fit.engine.why.unwrap();
    assert!(why.contains("no such adapter"), "{why}");
    let cpu = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    assert_eq!(fit.tube.radii_mm, cpu.radii_mm);
    // The next call's adapter is looked for anew.
    let settings = large().with_adapter(Some("nor this one".into()));
    let fit = on_one_thread(|| engine.fit_section(&section, RADIUS_MM, &settings).unwrap());
    let why = fit.engine.why.unwrap();
    assert!(why.contains("nor this one"), "{why}");
}

#[test]
fn auto_stays_on_the_cpu_where_a_device_is_not_worth_it() {
    let engine = AutoEngine::default();
    let description = engine.fit_section(&wall(2_000, 151), RADIUS_MM, &Settings::default()).unwrap().engine;
    assert_eq!(description.name, "cpu");
    assert!(description.why.unwrap().contains("less than starting a device takes"));
}

#[test]
fn a_cylinder_without_points_is_an_error_as_on_the_cpu() {
    let Some(device) = device() else { return };
    let mut far = recording(20, 50, 157);
    for frame in &mut far.frames {
        frame.contour_mm.iter_mut().for_each(|p| *p *= 3.0);
    }
    let settings = Settings::default();
    let track = Track::of(&far, &settings).unwrap();
    let request = FitRequest::new(&track, &[9, 19], &settings);
    let found = device.engine.fit(&request).unwrap_err().to_string();
    assert_eq!(found, CpuEngine::<f32>::new().fit(&request).unwrap_err().to_string());
    assert!(found.starts_with("frame 9: section: found 0 points"), "{found}");
}
