//! Whole recordings.

#[path = "../support/required.rs"]
mod required;

pub use required::shared;

use crate::cylinders::{assert_all_agree, assert_same};
use crate::device::device;
use crate::sections::recording;
use lumenmesh::cylinders::merge::MergedVessel;
use lumenmesh::cylinders::{CpuEngine, Engine, FitRequest, Track, merged_frames};
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Outliers, Settings, Statistic};
use lumenmesh::surface::Surface;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

#[test]
fn a_recording_fits_as_on_the_cpu_with_every_rule_and_grid() {
    let Some(device) = device() else { return };
    let recording = recording(60, 200, 107);
    for (nodes, levels) in [(12, 5), (3, 1), (64, 64)] {
        for outliers in [Outliers::Iqr, Outliers::Deviation, Outliers::None] {
            for statistic in [Statistic::Mean, Statistic::Median] {
                let settings = Settings::default()
                    .with_nodes(nodes)
                    .with_levels(levels)
                    .with_outliers(outliers)
                    .with_statistic(statistic);
                let track = Track::of(&recording, &settings).unwrap();
                let frames = merged_frames(track.len(), &settings);
                let ready = AtomicUsize::new(0);
                let count = |n: usize| {
                    ready.fetch_add(n, Ordering::Relaxed);
                    ControlFlow::Continue(())
                };
                let request =
                    FitRequest::new(&track, &frames, &settings).with_history(true).with_progress(&count);
                let found = device.engine.fit(&request).unwrap().cylinders;
                assert_eq!(ready.load(Ordering::Relaxed), frames.len());
                let expected = CpuEngine::<f32>::new()
                    .fit(&request.with_progress(&|_| ControlFlow::Continue(())))
                    .unwrap()
                    .cylinders;
                assert_all_agree(device, &found, &expected, &recording, &settings);
            }
        }
    }
}

/// Golden file, recording, nodes, levels, statistic.
const GOLDEN: [(&str, &str, u32, u32, Statistic); 3] = [
    ("adult_aorta_clean_n24_l8_mean", "adult_aorta_clean", 24, 8, Statistic::Mean),
    ("adult_aorta_noisy_n12_l5_mean", "adult_aorta_noisy", 12, 5, Statistic::Mean),
    ("adult_aorta_noisy_n12_l5_median", "adult_aorta_noisy", 12, 5, Statistic::Median),
];

#[test]
fn golden_cylinders_come_out_to_the_precision_of_f32() {
    let Some(device) = device() else { return };
    for (golden, recording, nodes, levels, statistic) in GOLDEN {
        let (Some(golden), Some(recording)) =
            (shared(&format!("golden/{golden}.csv")), shared(&format!("recordings/{recording}.mat")))
        else {
            return;
        };
        // frame, iteration, ring, node, radius in mm.
        let mut radii: BTreeMap<(usize, usize), Vec<f64>> = BTreeMap::new();
        for line in std::fs::read_to_string(golden).unwrap().lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let key = (cells[0].parse().unwrap(), cells[1].parse().unwrap());
            radii.entry(key).or_default().push(cells[4].parse().unwrap());
        }
        let mut frames: Vec<usize> = radii.keys().map(|key| key.0).collect();
        frames.dedup();
        let settings = Settings::default().with_nodes(nodes).with_levels(levels).with_statistic(statistic);
        let recording = Recording::read(&recording).unwrap();
        let track = Track::of(&recording, &settings).unwrap();
        let request = FitRequest::new(&track, &frames, &settings).with_history(true);
        let found = device.engine.fit(&request).unwrap().cylinders;
        let expected = CpuEngine::<f32>::new().fit(&request).unwrap().cylinders;
        assert_all_agree(device, &found, &expected, &recording, &settings);

        let mut differences: Vec<f64> = Vec::new();
        for cylinder in &found {
            for (iteration, history) in cylinder.tube.history_mm.iter().enumerate() {
                let golden = &radii[&(cylinder.frame, iteration)];
                assert_eq!(history.len(), golden.len());
                differences.extend(history.iter().zip(golden).map(|(a, b)| (a - b).abs()));
            }
        }
        differences.sort_by(f64::total_cmp);
        let percentile = |share: f64| differences[((differences.len() - 1) as f64 * share) as usize];
        println!(
            "|Δr| to the f64 golden radii, mm: median {:.1e}, p99 {:.1e}, max {:.1e}",
            percentile(0.5),
            percentile(0.99),
            percentile(1.0)
        );
        // Rounding leaves micrometres; a few points choose the other triangle or fall out of the fences.
        assert!(percentile(0.5) <= 1e-5 && percentile(0.99) <= 1e-3, "{:e}", percentile(0.99));
    }
}

#[test]
fn the_fitting_error_is_the_cpu_s() {
    let Some(device) = device() else { return };
    for name in ["adult_aorta_clean", "adult_aorta_noisy"] {
        let (Some(recording), Some(truth)) =
            (shared(&format!("recordings/{name}.mat")), shared("data/aorta_adult_full_steve.stl"))
        else {
            return;
        };
        let settings = Settings::default();
        let track = Track::of(&Recording::read(&recording).unwrap(), &settings).unwrap();
        let frames = merged_frames(track.len(), &settings);
        let request = FitRequest::new(&track, &frames, &settings);
        let truth = Truth::new(Surface::read(&truth).unwrap()).unwrap();
        let [found, expected] = [&device.engine as &dyn Engine, &CpuEngine::<f32>::new()].map(|engine| {
            let vessel = MergedVessel::of(&engine.fit(&request).unwrap().cylinders, settings.merge);
            evaluate(&vessel.surface(), &truth).unwrap().mesh_to_truth.mean_mm
        });
        println!("{name}: fitting error {found:.6} mm on the device, {expected:.6} mm on the CPU");
        assert!((found - expected).abs() <= 1e-3);
    }
}

#[test]
fn a_second_run_gives_the_same_bits() {
    let Some(device) = device() else { return };
    let settings = Settings::default().with_nodes(24).with_levels(8);
    let track = Track::of(&recording(40, 500, 109), &settings).unwrap();
    let request = FitRequest::new(&track, &[9, 19, 29, 39], &settings);
    let first = device.engine.fit(&request).unwrap().cylinders;
    for (a, b) in device.engine.fit(&request).unwrap().cylinders.iter().zip(&first) {
        assert_same(&a.tube, &b.tube);
    }
}
