//! Results do not depend on the order in which points come or threads run.

use crate::cylinders::assert_same;
use crate::device::device;
use crate::sections::{RADIUS_MM, recording, seeded, wall};
use lumenmesh::cylinders::Engine;
use lumenmesh::low_level::cylinders::passes::Section;
use lumenmesh::settings::{Outliers, Settings, Statistic};
use rand::seq::SliceRandom;
use std::process::Command;

fn permuted(section: &Section<f32>, seed: u64) -> Section<f32> {
    let mut order: Vec<usize> = (0..section.len()).collect();
    order.shuffle(&mut seeded(seed));
    let of = |values: &[f32]| order.iter().map(|&i| values[i]).collect();
    Section { r: of(&section.r), theta: of(&section.theta), z: of(&section.z), gated: section.gated }
}

#[test]
fn permuted_points_give_the_same_bits() {
    let Some(device) = device() else { return };
    // Short faces, long ones, and both.
    for (nodes, levels, points) in [(64, 48, 20_000), (12, 5, 60_000), (12, 5, 9_000)] {
        for outliers in [Outliers::Iqr, Outliers::Deviation, Outliers::None] {
            for statistic in [Statistic::Mean, Statistic::Median] {
                let settings = Settings::default()
                    .with_nodes(nodes)
                    .with_levels(levels)
                    .with_outliers(outliers)
                    .with_statistic(statistic);
                let section = wall(points, 53);
                let first = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
                for seed in 0..2 {
                    let again = device
                        .engine
                        .fit_section(&permuted(&section, seed), RADIUS_MM, &settings)
                        .unwrap()
                        .tube;
                    assert_same(&again, &first);
                }
            }
        }
    }
}

#[test]
fn threads_can_share_an_engine() {
    let Some(device) = device() else { return };
    let settings = Settings::default();
    let section = wall(300, 163);
    let alone = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..25 {
                    assert_same(
                        &device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube,
                        &alone,
                    );
                }
            });
        }
    });
}

#[test]
fn any_number_of_threads_writes_the_same_bytes() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let pullback = folder.path().join("pullback");
    recording(120, 300, 59).write(&pullback).unwrap();
    let name = &device.engine.adapter().unwrap().name;
    // The threads of Mesa's software device; another device ignores it.
    let written = ["1", "2", "8"].map(|threads| {
        let mesh = folder.path().join(format!("{threads}.ply"));
        let cylinders = folder.path().join(format!("{threads}.csv"));
        let done = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
            .env("LP_NUM_THREADS", threads)
            .arg("reconstruct")
            .arg(&pullback)
            .args(["--backend", "gpu", "--adapter", name])
            .args(["--method", "cylinders", "--nodes", "24", "--levels", "8"])
            .arg("--cylinders")
            .arg(&cylinders)
            .arg("-o")
            .arg(&mesh)
            .output()
            .unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        assert!(String::from_utf8_lossy(&done.stdout).contains("gpu on"));
        (std::fs::read(mesh).unwrap(), std::fs::read(cylinders).unwrap())
    });
    assert!(!written[0].0.is_empty());
    assert!(written[1..].iter().all(|w| *w == written[0]));
}
