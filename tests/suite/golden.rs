//! The cylinders of an independent f64 implementation of the published method.

use crate::support::shared;
use lumenmesh::fit::{CpuEngine, Engine, FittedCylinder, Job, Track};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Settings, Statistic};
use std::collections::BTreeMap;
use std::path::Path;

/// (frame, iteration, ring, node) → radius in mm.
type Radii = BTreeMap<(usize, usize, usize, usize), f64>;

fn read_golden(path: &Path) -> Radii {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let mut cells = line.split(',');
            let mut index = || cells.next().unwrap().parse::<usize>().unwrap();
            let key = (index(), index(), index(), index());
            (key, cells.next().unwrap().parse().unwrap())
        })
        .collect()
}

fn radii(cylinders: &[FittedCylinder]) -> Radii {
    let mut radii = Radii::new();
    for c in cylinders {
        for (iteration, history) in c.tube.history_mm.iter().enumerate() {
            for (index, radius) in history.iter().enumerate() {
                let nodes = c.tube.tube.nodes;
                radii.insert((c.frame, iteration, index / nodes, index % nodes), *radius);
            }
        }
    }
    radii
}

const CASES: [(&str, &str, u32, u32, Statistic); 3] = [
    ("adult_aorta_clean_n24_l8_mean", "adult_aorta_clean", 24, 8, Statistic::Mean),
    ("adult_aorta_noisy_n12_l5_mean", "adult_aorta_noisy", 12, 5, Statistic::Mean),
    ("adult_aorta_noisy_n12_l5_median", "adult_aorta_noisy", 12, 5, Statistic::Median),
];

#[test]
fn the_reference_gives_the_golden_radii_to_1e_9_mm() {
    for (golden, recording, nodes, levels, statistic) in CASES {
        let (Some(golden), Some(recording)) =
            (shared(&format!("golden/{golden}.csv")), shared(&format!("recordings/{recording}.mat")))
        else {
            return;
        };
        let golden = read_golden(&golden);
        let settings = Settings { nodes, levels, statistic, ..Settings::default() };
        let track = Track::of(&Recording::read(&recording).unwrap(), &settings).unwrap();
        let mut frames: Vec<usize> = golden.keys().map(|k| k.0).collect();
        frames.dedup();
        let job = Job { history: true, ..Job::new(&track, &frames, &settings) };
        let found = radii(&CpuEngine::<f64>::new().fit(&job).unwrap());
        assert_eq!(found.len(), golden.len());
        let worst = golden.iter().map(|(k, r)| (found[k] - r).abs()).fold(0.0, f64::max);
        println!("{worst:e}");
        let fast = radii(&CpuEngine::<f32>::new().fit(&job).unwrap());
        let mut diffs: Vec<f64> = golden.iter().map(|(k, r)| (fast[k] - r).abs()).collect();
        diffs.sort_by(f64::total_cmp);
        println!(
            "f32 {:e} {:e} {}",
            diffs[diffs.len() * 99 / 100],
            diffs[diffs.len() - 1],
            diffs.iter().filter(|d| **d > 1e-3).count()
        );
        assert!(worst <= 1e-9, "{worst:e} mm");
    }
}
