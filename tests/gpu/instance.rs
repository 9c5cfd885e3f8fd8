//! Adapters and engines may be opened, listed and dropped on any thread, in any order.

use crate::cylinders::assert_same;
use crate::device::device;
use crate::sections::{RADIUS_MM, wall};
use lumenmesh::cylinders::{AutoEngine, Engine};
use lumenmesh::gpu::{adapters, instance};
use lumenmesh::low_level::cylinders::gpu::GpuEngine;
use lumenmesh::low_level::sweep::gpu::GpuWallEngine;
use lumenmesh::settings::Settings;
use std::process::Command;
use std::thread;

#[test]
fn there_is_one_instance_on_all_threads() {
    let here: *const wgpu::Instance = instance();
    let there = thread::spawn(|| std::ptr::from_ref(instance()) as usize).join().unwrap();
    assert_eq!(here as usize, there);
}

#[test]
fn adapters_are_listed_on_threads_that_end() {
    let here = adapters();
    for _ in 0..3 {
        let there: Vec<_> = (0..4).map(|_| thread::spawn(adapters)).collect();
        for thread in there {
            assert_eq!(thread.join().unwrap(), here);
        }
    }
}

#[test]
fn engines_open_and_are_dropped_on_threads_that_end() {
    let Some(device) = device() else { return };
    let name = device.engine.adapter().unwrap().name.clone();
    let section = wall(500, 227);
    let settings = Settings::default();
    let expected = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    for _ in 0..2 {
        let found = thread::scope(|scope| {
            let threads: Vec<_> = (0..2)
                .map(|_| {
                    scope.spawn(|| {
                        let engine = GpuEngine::new(Some(&name)).unwrap();
                        drop(GpuWallEngine::new(Some(&name)).unwrap());
                        engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube
                    })
                })
                .collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
        });
        found.iter().for_each(|tube| assert_same(tube, &expected));
    }
    // Opened here, dropped there.
    let engine = GpuEngine::new(Some(&name)).unwrap();
    thread::spawn(move || drop(engine)).join().unwrap();
    assert_same(&device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube, &expected);
}

/// Work that is large enough for a device to be looked for, on a thread that ends before the process does.
#[test]
fn auto_looks_for_a_device_on_a_thread_that_ends() {
    let settings = Settings::default().with_nodes(1000).with_levels(800).with_iterations(30);
    let description = thread::spawn(move || {
        // One thread, for which the work is large however many cores there are.
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        one.install(|| {
            AutoEngine::default().fit_section(&wall(2_000, 229), RADIUS_MM, &settings).unwrap().engine
        })
    });
    let why = description.join().unwrap().why.unwrap();
    assert!(!why.contains("less than starting"), "{why}");
}

/// A process of its own, in which no other thread holds a device when these end.
#[test]
fn a_process_that_did_all_this_ends_well() {
    if std::env::var_os("LUMENMESH_INSTANCE_CHILD").is_some() {
        return;
    }
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["instance::", "--test-threads", "1"])
        .env("LUMENMESH_INSTANCE_CHILD", "1")
        .output()
        .unwrap();
    assert!(child.status.success(), "{:?}\n{}", child.status, String::from_utf8_lossy(&child.stderr));
    assert!(String::from_utf8_lossy(&child.stdout).contains("5 passed"));
}
