//! The passes `fill_bottom` and `fill_top` against their twin.

use crate::compare::{Tolerance, numbers};
use crate::device::{Readback, device};
use crate::sections::{recording, seeded};
use lumenmesh::cylinders::Tube;
use lumenmesh::cylinders::{Job, Track};
use lumenmesh::low_level::cylinders::passes::{TriangleStatistic, fill};
use lumenmesh::settings::Settings;
use rand::RngExt;

/// Statistics of `triangles` triangles, that share of them without points.
pub fn statistics(triangles: usize, empty: f64, seed: u64) -> Vec<TriangleStatistic<f32>> {
    let mut rng = seeded(seed);
    (0..triangles)
        .map(|_| match rng.random_range(0.0..1.0) < empty {
            true => TriangleStatistic::default(),
            false => TriangleStatistic {
                value: rng.random_range(-2.0..2.0),
                kept: rng.random_range(1..500),
                residual: rng.random_range(0.0..2.0),
            },
        })
        .collect()
}

/// As the device holds them.
pub fn words(statistics: &[TriangleStatistic<f32>]) -> Vec<[u32; 3]> {
    statistics.iter().map(|s| [s.value.to_bits(), s.kept, s.residual.to_bits()]).collect()
}

/// Runs `work` on a workspace of three cylinders, for tubes with a number of faces about the 64 invocations of
/// a workgroup, with every share of empty triangles.
pub fn for_three_cylinders(
    mut work: impl FnMut(&lumenmesh::low_level::cylinders::gpu::Workspace, &Job, &Tube, &[TriangleStatistic<f32>]),
) {
    let Some(device) = device() else { return };
    let recording = recording(30, 40, 41);
    for (nodes, levels) in [(3, 1), (4, 2), (7, 9), (16, 4), (13, 5), (12, 5), (257, 3)] {
        for empty in [0.0, 0.3, 0.9, 1.0] {
            let settings = Settings::default().with_nodes(nodes).with_levels(levels);
            let track = Track::of(&recording, &settings).unwrap();
            let job = Job::new(&track, &[9, 19, 29], &settings);
            let [workspace] = &device.engine.prepare_job(&job).unwrap()[..] else { panic!("one batch") };
            let tube = Tube::new(&settings);
            work(workspace, &job, &tube, &statistics(6 * tube.face_count(), empty, 43));
        }
    }
}

#[test]
fn fill_is_its_twin() {
    let Some(device) = device() else { return };
    for_three_cylinders(|workspace, _, tube, statistics| {
        let faces = tube.face_count();
        let mut expected = Vec::new();
        for own in statistics.chunks(2 * faces) {
            let mut values = Vec::new();
            fill(own, tube, &mut values);
            expected.extend(values);
        }
        // Two sums and a quotient of three values of up to 2 mm.
        let tolerance = Tolerance::of(device.exact, 4.0, 6.0);
        let of = |half: usize| (0..6 * faces).filter(|i| (i / faces) % 2 == half).collect::<Vec<usize>>();
        let pick = |places: &[usize]| places.iter().map(|&i| expected[i]).collect::<Vec<f32>>();
        let (bottoms, tops) = (of(0), of(1));
        let words = words(statistics);
        let statistics = ("statistics", bytemuck::cast_slice(&words));

        let [found] = device.run(workspace, "fill_bottom", &[statistics], ["values"]);
        numbers(&found.at(&bottoms), &pick(&bottoms), tolerance).unwrap();
        let unwritten: Readback = found.at(&tops);
        assert_eq!(unwritten.words, unwritten.before);

        let mut half: Vec<u32> = found.before.clone();
        bottoms.iter().for_each(|&i| half[i] = expected[i].to_bits());
        let inputs = [statistics, ("values", bytemuck::cast_slice(&half))];
        let [found] = device.run(workspace, "fill_top", &inputs, ["values"]);
        numbers(&found.at(&tops), &pick(&tops), tolerance).unwrap();
        let untouched = found.at(&bottoms);
        assert_eq!(untouched.words, untouched.before);
    });
}
