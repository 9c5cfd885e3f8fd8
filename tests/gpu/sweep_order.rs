//! A sweep on the device does not depend on the order in which echoes come, on how they are cut into chunks, or on the
//! threads that run.

use crate::device::POISON;
use crate::sections::seeded;
use crate::sweep_passes::{device, echoes, parameters};
use lumenmesh::gpu::Requirements;
use lumenmesh::low_level::sweep::gpu::GpuWallEngine;
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Backend, Settings, SweepSettings};
use lumenmesh::simulate::{self, Phantom, Shape, Simulation};
use lumenmesh::sweep::Sweep;
use rand::seq::SliceRandom;
use std::process::Command;

fn stenosis() -> Recording {
    let vessel = Phantom::from("stenosis".parse::<Shape>().unwrap()).vessel().unwrap();
    Simulation::run(vessel, &simulate::SimulationSettings::default()).unwrap().recording
}

#[test]
fn permuted_echoes_give_the_same_sums() {
    let Some(device) = device() else { return };
    let parameters = parameters(40, 50);
    let (wall, echoes, shifts) = echoes(&parameters, 30_000, 3);
    let sums = |order: &[usize]| {
        let echoes: Vec<_> = order.iter().map(|&i| echoes[i]).collect();
        let shifts: Vec<_> = order.iter().map(|&i| shifts[i]).collect();
        let workspace = device.engine.prepare(&parameters, &echoes).unwrap();
        let none = vec![0_u32; 5 * parameters.node_count as usize];
        let inputs = [
            ("wall", bytemuck::cast_slice(&wall)),
            ("shifts", bytemuck::cast_slice(&shifts)),
            ("sums_low", bytemuck::cast_slice(&none)),
            ("sums_high", bytemuck::cast_slice(&none)),
        ];
        device.engine.run_pass(&workspace, "accumulate", &inputs, &["sums_low", "sums_high"]).unwrap()
    };
    let mut order: Vec<usize> = (0..echoes.len()).collect();
    let first = sums(&order);
    assert!(first[0].iter().any(|&b| b != 0) && first[0] != vec![POISON as u8; first[0].len()]);
    for seed in 0..3 {
        order.shuffle(&mut seeded(seed));
        assert!(sums(&order) == first);
    }
    // Another echo makes other sums.
    order[0] = order[1];
    assert!(sums(&order) != first);
}

#[test]
fn a_device_with_little_room_sweeps_the_same_bits_chunk_by_chunk() {
    let Some(device) = device() else { return };
    let adapter_name = device.engine.adapter().unwrap().name.clone();
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.enumerate_adapters(backends))
        .into_iter()
        .find(|adapter| adapter.get_info().name == adapter_name)
        .unwrap();
    let mut limits = Requirements::new().limits;
    limits.max_storage_buffer_binding_size = 1 << 20;
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    let (small, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
    let small = GpuWallEngine::on_device(small, queue).unwrap();

    let recording = stenosis();
    let settings = Settings::default().with_adapter(Some(adapter_name));
    let whole = Sweep::on_device(&recording, &settings, &device.engine).unwrap();
    let again = Sweep::on_device(&recording, &settings, &device.engine).unwrap();
    assert_eq!(again.radii_mm, whole.radii_mm);
    // 36 bytes an echo.
    assert!(whole.report.echoes > (1 << 20) / 36, "one chunk");
    let in_chunks = Sweep::on_device(&recording, &settings, &small).unwrap();
    assert_eq!(in_chunks.radii_mm, whole.radii_mm);
    assert_eq!(in_chunks.support.echoes, whole.support.echoes);
    assert_eq!(in_chunks.support.supported, whole.support.supported);
    assert_eq!(in_chunks.report.noise_mm, whole.report.noise_mm);
}

#[test]
fn memory_that_a_larger_wall_left_changes_nothing() {
    let Some(device) = device() else { return };
    let recording = stenosis();
    let adapter = device.engine.adapter().unwrap().name.clone();
    let sweep = |engine: &GpuWallEngine, nodes| {
        let settings = Settings::default().with_sweep(SweepSettings::default().with_nodes(Some(nodes)));
        Sweep::on_device(&recording, &settings, engine).unwrap()
    };
    let [used, fresh] = [(); 2].map(|()| GpuWallEngine::new(Some(&adapter)).unwrap());
    let larger = sweep(&used, 66);
    let found = sweep(&used, 64);
    let expected = sweep(&fresh, 64);
    assert!(larger.radii_mm.len() > found.radii_mm.len());
    assert_eq!(found.radii_mm, expected.radii_mm);
    assert_eq!(found.support.standard_error_mm, expected.support.standard_error_mm);
    assert_eq!(found.report.solver_steps, expected.report.solver_steps);
}

#[test]
fn any_number_of_threads_sweeps_the_same_bytes() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let pullback = folder.path().join("pullback");
    stenosis().write(&pullback).unwrap();
    let name = &device.engine.adapter().unwrap().name;
    // The threads of Mesa's software device; another device ignores it.
    let written = ["1", "2", "8"].map(|threads| {
        let mesh = folder.path().join(format!("{threads}.ply"));
        let done = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
            .env("LP_NUM_THREADS", threads)
            .arg("reconstruct")
            .arg(&pullback)
            .args(["--method", "sweep", "--backend", "gpu", "--adapter", name, "-o"])
            .arg(&mesh)
            .output()
            .unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        assert!(String::from_utf8_lossy(&done.stdout).contains("gpu on"));
        std::fs::read(mesh).unwrap()
    });
    assert!(!written[0].is_empty());
    assert!(written[1..].iter().all(|w| *w == written[0]));
}

#[test]
fn auto_says_where_it_fitted_and_why() {
    let settings = Settings::default().with_backend(Backend::Auto);
    let report = Sweep::of(&stenosis(), &settings).unwrap().report;
    assert_eq!(report.engine.name, "cpu");
    assert!(report.engine.why.unwrap().contains("less than starting a device takes"));
}
