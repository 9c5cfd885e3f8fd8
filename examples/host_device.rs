//! A host application that has a wgpu device of its own and keeps its points on it.
//!
//! The host merges what the engine needs into its own device request, lets the engine record its passes into
//! the host's command encoder, submits when it likes and reads the radii itself. The engine submits nothing,
//! waits for nothing and replaces no handler behind the host's back.
//!
//! ```sh
//! cargo run --release --example host_device
//! ```

use lumenmesh::cylinders::{CpuEngine, Engine};
use lumenmesh::gpu::Requirements;
use lumenmesh::low_level::cylinders::gpu::GpuEngine;
use lumenmesh::low_level::cylinders::passes::Section;
use lumenmesh::settings::Settings;
use std::error::Error;
use std::time::Duration;

const POINTS: u32 = 20_000;
/// Of the undeformed tube.
pub const RADIUS_MM: f64 = 12.0;

/// What the host found.
#[derive(Debug)]
pub struct Compared {
    /// The adapter.
    pub adapter: String,
    /// Radii of the tube's nodes, mm.
    pub radii_mm: Vec<f64>,
    /// Largest difference between a radius from the device and from the CPU engine, mm.
    pub largest_difference_mm: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let name = std::env::args().nth(1);
    let compared = run(name.as_deref())?;
    println!("{} radii from {}", compared.radii_mm.len(), compared.adapter);
    println!("largest difference to the CPU engine: {:e} mm", compared.largest_difference_mm);
    Ok(())
}

/// Fits a tube to points on the host's device, on the adapter whose name contains `adapter`.
pub fn run(adapter: Option<&str>) -> Result<Compared, Box<dyn Error>> {
    // 1. The host's own instance, adapter and device. Its request asks for what the host itself needs;
    //    the engine's needs are merged in.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let adapter = pollster::block_on(instance.enumerate_adapters(backends))
        .into_iter()
        .find(|a| adapter.is_none_or(|name| a.get_info().name.contains(name)))
        .ok_or("no GPU adapter")?;
    let own = wgpu::DeviceDescriptor { label: Some("the host's device"), ..Default::default() };
    // `with_all_room(&adapter)` would raise buffer sizes to what the adapter has, for large jobs.
    let request = Requirements::new().merged_into(own);
    let (device, queue) = pollster::block_on(adapter.request_device(&request))?;

    // 2. The engine on that device, and device memory for one tube. A workspace is made once and recorded as
    //    often as there are new points; `warm_up` builds all pipelines now, not at the first recording.
    let settings = settings();
    let engine = GpuEngine::on_device(device.clone(), queue.clone())?;
    engine.warm_up()?;
    let workspace = engine.prepare(POINTS, RADIUS_MM, &settings)?;

    // 3. The host's points, resident on the device: r (mm) of all, then θ (rad) of all, then z (mm), f32. A
    // shader of
    //    the host would write them; here they come from memory.
    let section = points();
    let coordinates = [&section.r[..], &section.theta, &section.z].concat();
    let resident = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("the host's points"),
        size: 12 * u64::from(POINTS),
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    queue.write_buffer(&resident, 0, bytemuck::cast_slice(&coordinates));

    // 4. One encoder of the host: its points go in, the engine's passes follow, the radii go out.
    let radii = workspace.radii();
    let readback = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("the host's radii"),
        size: radii.size(),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(&resident, 0, workspace.section(), 0, resident.size());
    engine.record(&workspace, &mut encoder)?;
    encoder.copy_buffer_to_buffer(radii, 0, &readback, 0, radii.size());

    // 5. The host submits and waits as it is used to.
    let submission = queue.submit([encoder.finish()]);
    let (sender, receiver) = std::sync::mpsc::channel();
    readback.slice(..).map_async(wgpu::MapMode::Read, move |mapped| {
        // The receiver lives until the result is there.
        let _ = sender.send(mapped);
    });
    let timeout = Some(Duration::from_secs(60));
    device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout })?;
    receiver.try_recv()??;
    let found: Vec<f32> = bytemuck::pod_collect_to_vec(&readback.slice(..).get_mapped_range()?);

    // 6. The CPU engine computes the same passes in the same f32.
    let expected = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings)?.tube;
    let radii_mm: Vec<f64> = found.into_iter().map(f64::from).collect();
    let difference = |(a, b): (&f64, &f64)| (a - b).abs();
    Ok(Compared {
        adapter: adapter.get_info().name,
        largest_difference_mm: radii_mm.iter().zip(&expected.radii_mm).map(difference).fold(0.0, f64::max),
        radii_mm,
    })
}

/// A tube of 24 nodes around and 8 faces along.
pub fn settings() -> Settings {
    Settings::default().with_nodes(24).with_levels(8)
}

/// A wall with an oval section, in tube coordinates: points on a spiral, so that no random numbers are needed.
pub fn points() -> Section<f32> {
    let mut section = Section::default();
    for i in 0..POINTS {
        let turn = f64::from(i) * 0.618_033_988_749_895;
        let theta = std::f64::consts::TAU * (turn - turn.floor());
        let z = Settings::default().height_mm * (f64::from(i) / f64::from(POINTS) - 0.5);
        section.r.push((RADIUS_MM * (1.05 + 0.1 * (2.0 * theta).cos()) + 0.2 * (37.0 * turn).sin()) as f32);
        section.theta.push(theta as f32);
        section.z.push(z as f32);
    }
    section
}
