//! The passes `update` and `support` against their twins.

use crate::compare::{Tolerance, integers, numbers};
use crate::device::device;
use crate::fill::{for_three_cylinders, words};
use crate::sections::seeded;
use lumenmesh::low_level::cylinders::passes::{Filter, support, update};
use lumenmesh::low_level::numerics::Scalar;
use rand::RngExt;

#[test]
fn update_is_its_twin() {
    let Some(device) = device() else { return };
    for_three_cylinders(|workspace, request, tube, _| {
        let (faces, nodes) = (tube.face_count(), tube.node_count());
        let mut rng = seeded(47);
        let values: Vec<f32> = (0..6 * faces).map(|_| rng.random_range(-2.0..2.0)).collect();
        let before: Vec<f32> = (0..3 * nodes).map(|_| rng.random_range(9.0..15.0)).collect();
        let inputs = [
            ("values", bytemuck::cast_slice(&values)),
            ("radii", bytemuck::cast_slice(&before)),
            ("travels", bytemuck::cast_slice(&[0_u32; 6])),
        ];
        let [radii, travels] = device.run(workspace, "update", &inputs, ["radii", "travels"]);

        let mut expected = before.clone();
        for (cylinder, &frame) in request.frames.iter().enumerate() {
            let filter =
                Filter::<f32>::new(request.settings, request.track.cylinder(frame).unwrap().radius_mm);
            let own = &mut expected[cylinder * nodes..(cylinder + 1) * nodes];
            let mean = update(&values[2 * cylinder * faces..2 * (cylinder + 1) * faces], tube, &filter, own);
            let [low, high] = [travels.words[2 * cylinder], travels.words[2 * cylinder + 1]];
            let sum = i64::from(high) << 32 | i64::from(low);
            let found = f32::mean_of(sum, filter.unit, nodes as u32);
            // Five sums and a quotient of values of up to 2 mm; the sum of their sizes is exact.
            let tolerance = Tolerance::of(device.exact, 8.0, 12.0);
            assert!(tolerance.allows(found, mean), "mean |travel| {found:e}, expected {mean:e}");
        }
        numbers(&radii, &expected, Tolerance::of(device.exact, 10.0, 15.0)).unwrap();
    });
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
        let words = words(statistics);
        let inputs = [
            ("statistics", bytemuck::cast_slice(&words)),
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
