//! A vessel that grows on the device.

use crate::device::device;
use lumenmesh::cylinders::{CylinderReconstruction, engine};
use lumenmesh::reconstruction::Live;
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

#[test]
fn a_live_sweep_on_the_device_is_refused() {
    let settings = Settings::default().with_backend(Backend::Gpu);
    let refused = Live::new(&settings).err().unwrap().to_string();
    assert_eq!(refused, "setting backend: found gpu, expected auto or cpu for a live sweep");
    let engine = engine(&Settings::default().with_backend(Backend::Cpu)).unwrap();
    let refused = Live::with_engine(&Settings::default(), engine).err().unwrap().to_string();
    assert_eq!(refused, "setting method: found sweep, expected cylinders for an engine of the host's");
}
