//! Recording into a host's own encoder: again, several at once, timed, and on a device with little room.

use crate::cylinders::assert_same;
use crate::device::{Device, device, say};
use crate::sections::{RADIUS_MM, coordinates, recording, wall};
use lumenmesh::cylinders::{Engine, FitRequest, Track, merged_frames};
use lumenmesh::gpu::Requirements;
use lumenmesh::low_level::cylinders::gpu::{FitWorkspace, GpuEngine};
use lumenmesh::low_level::cylinders::passes::Section;
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Submits what `record` records and returns the radii of some workspaces.
fn radii<const N: usize>(
    device: &Device,
    workspaces: [&FitWorkspace; N],
    record: impl FnOnce(&mut wgpu::CommandEncoder),
) -> [Vec<f64>; N] {
    let (host, queue) = (device.engine.device(), device.engine.queue());
    let mut encoder = host.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    record(&mut encoder);
    let copies = workspaces.map(|workspace| {
        let radii = workspace.radii();
        let copy = host.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: radii.size(),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        encoder.copy_buffer_to_buffer(radii, 0, &copy, 0, radii.size());
        copy
    });
    let submission = queue.submit([encoder.finish()]);
    copies.map(|copy| {
        let (sender, receiver) = std::sync::mpsc::channel();
        copy.slice(..).map_async(wgpu::MapMode::Read, move |mapped| sender.send(mapped).unwrap());
        let timeout = Some(Duration::from_secs(60));
        host.poll(wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout }).unwrap();
        receiver.recv_timeout(Duration::from_secs(60)).unwrap().unwrap();
        let numbers: Vec<f32> = bytemuck::pod_collect_to_vec(&copy.slice(..).get_mapped_range().unwrap());
        numbers.into_iter().map(f64::from).collect()
    })
}

fn write(device: &Device, workspace: &FitWorkspace, section: &Section<f32>) {
    device.engine.queue().write_buffer(workspace.section(), 0, bytemuck::cast_slice(&coordinates(section)));
}

#[test]
fn a_workspace_can_be_recorded_again_for_new_points() {
    let Some(device) = device() else { return };
    let settings = Settings::default();
    let workspace = device.engine.prepare(4_000, RADIUS_MM, &settings).unwrap();
    for seed in [173, 179, 173] {
        let section = wall(4_000, seed);
        write(device, &workspace, &section);
        let [found] =
            radii(device, [&workspace], |encoder| device.engine.record(&workspace, encoder).unwrap());
        let expected = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
        assert_eq!(found, expected.radii_mm);
    }
}

#[test]
fn an_encoder_can_hold_several_workspaces() {
    let Some(device) = device() else { return };
    let coarse = Settings::default();
    let fine = Settings::default().with_nodes(64).with_levels(32);
    let (a, b) = (wall(3_000, 181), wall(9_000, 191));
    let first = device.engine.prepare(3_000, RADIUS_MM, &coarse).unwrap();
    let second = device.engine.prepare(9_000, RADIUS_MM, &fine).unwrap();
    write(device, &first, &a);
    write(device, &second, &b);
    let found = radii(device, [&first, &second], |encoder| {
        device.engine.record(&first, encoder).unwrap();
        device.engine.record(&second, encoder).unwrap();
    });
    let expected = [(&a, &coarse), (&b, &fine)].map(|(section, settings)| {
        device.engine.fit_section(section, RADIUS_MM, settings).unwrap().tube.radii_mm
    });
    assert_eq!(found, expected);
}

#[test]
fn passes_are_timed_one_by_one_in_their_order() {
    let Some(device) = device() else { return };
    let host = device.engine.device();
    if !host.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
        say("SKIPPED: the device cannot time passes");
        return;
    }
    let settings = Settings::default().with_iterations(2);
    let section = wall(2_000, 193);
    let workspace = device.engine.prepare(2_000, RADIUS_MM, &settings).unwrap();
    write(device, &workspace, &section);
    let queries = host.create_query_set(&wgpu::QuerySetDescriptor {
        label: None,
        ty: wgpu::QueryType::Timestamp,
        count: 64,
    });
    let timed = RefCell::new(Vec::new());
    let mut timer = |name: &'static str| {
        let place = 2 * timed.borrow().len() as u32;
        timed.borrow_mut().push(name);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &queries,
            beginning_of_pass_write_index: Some(place),
            end_of_pass_write_index: Some(place + 1),
        })
    };
    let [found] = radii(device, [&workspace], |encoder| {
        device.engine.record_timed(&workspace, encoder, &mut timer).unwrap();
    });
    assert_eq!(found, device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube.radii_mm);
    // The points of a single tube need no projection, and a few points in a few faces only one pass to group them.
    let is_software = device.engine.adapter().unwrap().is_software();
    let group = match host.limits().max_compute_invocations_per_workgroup >= 1024 && !is_software {
        true => "group_few_wide",
        false => "group_few",
    };
    let measured: &[_] = match device.engine.subgroup_width() {
        Some(8..) if is_software => &["measure_short", "measure_narrow"],
        Some(32..) => &["measure_short", "measure_middle", "measure_long"],
        Some(8..) => &["measure_short", "measure_middle_shared", "measure_long"],
        _ => &["measure_short_shared", "measure_middle_shared", "measure_long"],
    };
    let iterated = [measured, &["update"]].concat();
    assert_eq!(*timed.borrow(), [&[group][..], &iterated, &iterated, &["support"]].concat());
}

#[test]
fn a_device_with_little_room_takes_a_job_in_batches() {
    let Some(device) = device() else { return };
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let name = &device.engine.adapter().unwrap().name;
    let adapter = pollster::block_on(lumenmesh::gpu::instance().enumerate_adapters(backends))
        .into_iter()
        .find(|adapter| adapter.get_info().name == *name)
        .unwrap();
    let mut request =
        wgpu::DeviceDescriptor { required_limits: Requirements::new().limits, ..Default::default() };
    request.required_limits.max_storage_buffer_binding_size = 100_000;
    let (host, queue) = pollster::block_on(adapter.request_device(&request)).unwrap();
    let little = GpuEngine::on_device(host, queue).unwrap();

    // Many points, and many frames with one point or none, whose transforms take more room than they do.
    for (pullback, every) in [(recording(100, 150, 197), 10), (close_together(recording(100, 1, 199)), 2)] {
        let settings = Settings::default().with_every(every);
        let track = Track::of(&pullback, &settings).unwrap();
        let frames = merged_frames(track.len(), &settings);
        let batches = AtomicUsize::new(0);
        let count = |_| {
            batches.fetch_add(1, Ordering::Relaxed);
            ControlFlow::Continue(())
        };
        let request = FitRequest::new(&track, &frames, &settings).with_history(true).with_progress(&count);
        let found = little.fit(&request).unwrap().cylinders;
        let batches = batches.load(Ordering::Relaxed);
        assert!((2..=frames.len()).contains(&batches), "{batches} batches of {} cylinders", frames.len());
        let expected =
            device.engine.fit(&request.with_progress(&|_| ControlFlow::Continue(()))).unwrap().cylinders;
        for (found, expected) in found.iter().zip(&expected) {
            assert_eq!(found.frame, expected.frame);
            assert_same(&found.tube, &expected.tube);
        }
    }
}

/// The same frames on a tenth of the way, so that nearly all are near every later cylinder.
fn close_together(mut recording: Recording) -> Recording {
    for frame in &mut recording.frames {
        frame.world_from_sensor.translation_mm *= 0.1;
    }
    recording
}
