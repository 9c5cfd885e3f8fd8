//! The passes `update`, which fills empty triangles too, and `support` against their twins.

use crate::compare::{Tolerance, integers, numbers};
use crate::device::device;
use crate::sections::{RADIUS_MM, recording, seeded};
use lumenmesh::cylinders::{FitRequest, Track, Tube};
use lumenmesh::low_level::cylinders::gpu::FitWorkspace;
use lumenmesh::low_level::cylinders::passes::{Filter, TriangleStatistic, fill, support, update};
use lumenmesh::low_level::numerics::Scalar;
use lumenmesh::settings::Settings;
use rand::RngExt;

/// Statistics of `triangles` triangles, that share of them without points.
fn statistics(triangles: usize, empty: f64, seed: u64) -> Vec<TriangleStatistic<f32>> {
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

/// What the device holds of triangles, face after face.
fn by_face<W>(
    statistics: &[TriangleStatistic<f32>],
    tube: &Tube,
    word: impl Fn(&TriangleStatistic<f32>) -> W,
) -> Vec<W> {
    let faces = tube.face_count();
    let of_cylinder =
        |own: &[_]| (0..faces).flat_map(|face| [word(&own[face]), word(&own[faces + face])]).collect();
    statistics.chunks(2 * faces).flat_map(|own| -> Vec<W> { of_cylinder(own) }).collect()
}

/// Runs `work` on a workspace of three cylinders, for tubes with a number of faces about the 64 invocations of
/// a workgroup, with every share of empty triangles.
fn for_three_cylinders(mut work: impl FnMut(&FitWorkspace, &FitRequest, &Tube, &[TriangleStatistic<f32>])) {
    let Some(device) = device() else { return };
    let recording = recording(30, 40, 41);
    for (nodes, levels) in [(3, 1), (4, 2), (7, 9), (16, 4), (13, 5), (12, 5), (257, 3)] {
        for empty in [0.0, 0.3, 0.9, 1.0] {
            let settings = Settings::default().with_nodes(nodes).with_levels(levels);
            let track = Track::of(&recording, &settings).unwrap();
            let request = FitRequest::new(&track, &[9, 19, 29], &settings);
            let [workspace] = &device.engine.prepare_request(&request).unwrap()[..] else {
                panic!("one batch")
            };
            let tube = Tube::new(&settings);
            work(workspace, &request, &tube, &statistics(6 * tube.face_count(), empty, 43));
        }
    }
}

/// Radii as they were, and the two words of the sum of |travel|, after one `update` by the twin.
fn by_twin(
    statistics: &[TriangleStatistic<f32>],
    tube: &Tube,
    filter: &Filter<f32>,
    radii: &mut [f32],
) -> f32 {
    let mut values = Vec::new();
    fill(statistics, tube, &mut values);
    update(&values, tube, filter, radii)
}

/// The mean |travel| of a cylinder whose sum the device holds.
fn mean_travel(words: &[u32], filter: &Filter<f32>, nodes: usize) -> f32 {
    f32::mean_of(i64::from(words[1]) << 32 | i64::from(words[0]), filter.unit, nodes as u32)
}

#[test]
fn update_is_its_twin() {
    let Some(device) = device() else { return };
    for_three_cylinders(|workspace, request, tube, statistics| {
        let (faces, nodes) = (tube.face_count(), tube.node_count());
        let mut rng = seeded(47);
        let before: Vec<f32> = (0..3 * nodes).map(|_| rng.random_range(9.0..15.0)).collect();
        let words = by_face(statistics, tube, TriangleStatistic::value_word);
        let inputs = [
            ("triangle_values", bytemuck::cast_slice(&words)),
            ("radii", bytemuck::cast_slice(&before)),
            ("travels", bytemuck::cast_slice(&[0_u32; 6])),
        ];
        let [radii, travels] = device.run(workspace, "update", &inputs, ["radii", "travels"]);

        let mut expected = before.clone();
        for (cylinder, &frame) in request.frames.iter().enumerate() {
            let radius_mm = request.track.cylinder(frame).unwrap().radius_mm;
            let filter = Filter::<f32>::new(request.settings, radius_mm);
            let own = &mut expected[cylinder * nodes..(cylinder + 1) * nodes];
            let mean =
                by_twin(&statistics[2 * cylinder * faces..2 * (cylinder + 1) * faces], tube, &filter, own);
            let found = mean_travel(&travels.words[2 * cylinder..], &filter, nodes);
            // Three fillings of two sums and a quotient, then five sums and a quotient, of values of up to 2
            // mm; the sum of their sizes is exact.
            let tolerance = Tolerance::of(device.exact, 24.0, 12.0);
            assert!(tolerance.allows(found, mean), "mean |travel| {found:e}, expected {mean:e}");
        }
        // Where every triangle of a cylinder is empty nothing moves.
        if expected != before {
            numbers(&radii, &expected, Tolerance::of(device.exact, 24.0, 15.0)).unwrap();
        } else {
            assert_eq!(radii.numbers()[..3 * nodes], before);
        }
    });
}

/// More nodes than all of the pass's workgroups have invocations, and travels whose sum needs its second word.
#[test]
fn update_takes_nodes_in_turn() {
    let Some(device) = device() else { return };
    // There are at most 2048 workgroups of 256.
    let sizes =
        [(127, 1), (128, 1), (129, 1), (262_143, 1), (262_144, 1), (262_145, 1), (400_000, 1), (12, 50_000)];
    for (nodes, levels) in sizes {
        let settings = Settings::default().with_nodes(nodes).with_levels(levels);
        let workspace = device.engine.prepare(10, RADIUS_MM, &settings).unwrap();
        let (tube, filter) = (Tube::new(&settings), Filter::<f32>::new(&settings, RADIUS_MM));
        let statistics = statistics(2 * tube.face_count(), 0.2, 211);
        let words = by_face(&statistics, &tube, TriangleStatistic::value_word);
        let before = vec![12.0_f32; tube.node_count()];
        let inputs = [
            ("triangle_values", bytemuck::cast_slice(&words)),
            ("radii", bytemuck::cast_slice(&before)),
            ("travels", bytemuck::cast_slice(&[0_u32; 2])),
        ];
        let [radii, travels] = device.run(&workspace, "update", &inputs, ["radii", "travels"]);
        let mut expected = before;
        let mean = by_twin(&statistics, &tube, &filter, &mut expected);
        let found = mean_travel(&travels.words, &filter, tube.node_count());
        assert!(Tolerance::of(device.exact, 24.0, 12.0).allows(found, mean), "{found:e}, expected {mean:e}");
        numbers(&radii, &expected, Tolerance::of(device.exact, 24.0, 15.0)).unwrap();
    }
}

#[test]
fn support_is_its_twin() {
    let Some(device) = device() else { return };
    for_three_cylinders(|workspace, request, tube, statistics| {
        let faces = tube.face_count();
        let (mut counts, mut residuals, mut tallies) = (Vec::new(), Vec::new(), Vec::new());
        let offsets: Vec<u32> = (0..=3 * faces as u32).map(|face| face * face % 977 + 1000 * face).collect();
        for (cylinder, own) in statistics.chunks(2 * faces).enumerate() {
            let (count, residual) = support(own, tube);
            counts.extend(count);
            residuals.extend(residual);
            tallies.push(own.iter().map(|s| s.kept).sum::<u32>());
            tallies.push(offsets[(cylinder + 1) * faces] - offsets[cylinder * faces]);
        }
        assert_eq!(tallies.len(), 2 * request.frames.len());
        let words = by_face(statistics, tube, TriangleStatistic::support_words);
        let inputs = [
            ("triangle_support", bytemuck::cast_slice(&words)),
            ("offsets", bytemuck::cast_slice(&offsets)),
            ("tallies", bytemuck::cast_slice(&[0_u32; 6])),
        ];
        let [count, residual, tally] =
            device.run(workspace, "support", &inputs, ["support", "residuals", "tallies"]);
        integers(&count, &counts).unwrap();
        // Six products and sums of up to 500 points times 2 mm, divided by at least one of those counts: the
        // mean is of the residuals' own size.
        numbers(&residual, &residuals, Tolerance::of(device.exact, 16.0, 12.0)).unwrap();
        integers(&tally, &tallies).unwrap();
    });
}
