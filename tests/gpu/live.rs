//! A vessel that grows on the device.

use crate::device::device;
use lumenmesh::cylinders::{CylinderReconstruction, engine};
use lumenmesh::gpu::Requirements;
use lumenmesh::low_level::cylinders::gpu::GpuEngine;
use lumenmesh::reconstruction::{Live, LumenReport};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Backend, Method, Settings};
use lumenmesh::simulate::{Insertion, Phantom, Shape, Simulation, SimulationSettings};
use lumenmesh::surface::Surface;

fn recording() -> Recording {
    let vessel = Phantom::from("stenosis".parse::<Shape>().unwrap()).vessel().unwrap();
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    Simulation::run(vessel, &settings).unwrap().recording
}

/// Also what is not a number is compared.
fn bytes(surface: &Surface) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.vtp");
    surface.write(&path).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn live_cylinders_on_the_device_are_those_of_the_batch_there() {
    if device().is_none() {
        return;
    }
    let settings = Settings::default().with_method(Method::Cylinders).with_backend(Backend::Gpu);
    let recording = recording();
    let batch = CylinderReconstruction::of(&recording, &settings, &*engine(&settings).unwrap()).unwrap();
    let whole = bytes(&batch.vessel.surface());
    let of_settings = Live::new(&settings).unwrap();
    let of_host = Live::with_engine(&settings, engine(&settings).unwrap()).unwrap();
    for mut live in [of_settings, of_host] {
        for round in 0..2 {
            // The engine stays when all frames are forgotten.
            live.reset();
            for frame in &recording.frames[..if round == 0 { 30 } else { recording.frames.len() }] {
                live.push(frame).unwrap();
            }
            assert_eq!(bytes(&live.surface()) == whole, round == 1);
        }
    }
}

/// A host's own device, made as the example does: the vessel is that of a device of ours.
#[test]
fn live_cylinders_on_a_hosts_own_device_are_the_same() {
    if device().is_none() {
        return;
    }
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let adapter = pollster::block_on(instance.enumerate_adapters(backends)).into_iter().next().unwrap();
    let own = wgpu::DeviceDescriptor { label: Some("the host's device"), ..Default::default() };
    let request = Requirements::new().merged_into(own);
    let (device, queue) = pollster::block_on(adapter.request_device(&request)).unwrap();
    let name = adapter.get_info().name;

    let settings = Settings::default().with_method(Method::Cylinders).with_backend(Backend::Gpu);
    let ours = settings.clone().with_adapter(Some(name));
    let engine = GpuEngine::on_device(device.clone(), queue.clone()).unwrap();
    let mut of_host = Live::with_engine(&settings, Box::new(engine)).unwrap();
    let mut of_settings = Live::new(&ours).unwrap();
    assert_eq!(of_host.engine(), None);
    for frame in &recording().frames {
        let change = of_host.push(frame).unwrap();
        assert_eq!(change, of_settings.push(frame).unwrap());
    }
    let engine = of_host.engine().unwrap();
    // The host knows its adapter.
    assert_eq!((engine.name.as_str(), engine.adapter), ("gpu", None));
    assert!(of_host.rings() > 50, "{}", of_host.rings());
    assert!(bytes(&of_host.surface()) == bytes(&of_settings.surface()));
    // The device stays the host's: it may go on with work of its own.
    queue.submit([]);
    drop(of_host);
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
}

/// A frame is computed on the CPU whatever the backend, and the engine says so; all frames at once are on the device.
#[test]
fn a_live_sweep_with_the_backend_gpu_says_that_it_is_computed_on_the_cpu() {
    let vessel = |backend| {
        let mut live = Live::new(&Settings::default().with_backend(backend)).unwrap();
        live.keep_frames().unwrap();
        recording().frames.iter().for_each(|frame| drop(live.push(frame).unwrap()));
        live
    };
    let (on_device, on_cpu) = (vessel(Backend::Gpu), vessel(Backend::Cpu));
    assert!(bytes(&on_device.surface()) == bytes(&on_cpu.surface()));
    let [of_device, of_cpu] = [&on_device, &on_cpu].map(|live| live.engine().unwrap());
    assert_eq!((of_cpu.name.as_str(), of_cpu.why), ("cpu", None));
    assert_eq!(of_device.name, "cpu");
    assert!(of_device.why.unwrap().contains("less time than a device needs to answer"));
    if device().is_some() {
        let whole = on_device.finish().unwrap();
        let LumenReport::Sweep(report) = whole.report() else { panic!("the method is the sweep") };
        assert_eq!(report.engine.name, "gpu");
    }
}

#[test]
fn a_live_sweep_takes_no_engine_of_the_hosts() {
    let engine = engine(&Settings::default().with_backend(Backend::Cpu)).unwrap();
    let refused = Live::with_engine(&Settings::default(), engine).err().unwrap().to_string();
    assert_eq!(refused, "setting method: found sweep, expected cylinders for an engine of the host's");
}
