//! The published method, statement by statement.

use glam::{DQuat, DVec2, DVec3};
use lumenmesh::cylinders::estimate::LocalEstimate;
use lumenmesh::cylinders::merge::MergedVessel;
use lumenmesh::cylinders::{CpuEngine, Engine, FitRequest, FittedCylinder, Track, Tube, merged_frames};
use lumenmesh::cylinders::{CylinderReconstruction, write_cylinders};
use lumenmesh::evaluate::Truth;
use lumenmesh::geometry::Pose;
use lumenmesh::low_level::cylinders::passes::{
    Face, Gate, Section, TubeGrid, TubeTransform, distance, project,
};
use lumenmesh::low_level::numerics::Scalar;
use lumenmesh::recording::{CylinderModel, Frame, Recording};
use lumenmesh::settings::{Merge, Outliers, Settings, Statistic};
use lumenmesh::study::bench::Case;
use lumenmesh::surface::Surface;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::Triangle;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use std::ops::ControlFlow;

fn read(name: &str) -> Option<Recording> {
    Some(Recording::read(&crate::support::shared(&format!("recordings/{name}.mat"))?).unwrap())
}

fn fit<T: Scalar>(track: &Track, frames: &[usize], settings: &Settings) -> Vec<FittedCylinder> {
    let job = FitRequest::new(track, frames, settings).with_history(true);
    CpuEngine::<T>::new().fit(&job).unwrap().cylinders
}

/// Contours every 0.05 mm from z = -5 to 5 whose radius is that of `wall`, then one at z = 0 with a cylinder of radius
/// 10 mm about z: all of its section has been seen.
fn seen_on_both_sides(wall: impl Fn(f64) -> f64) -> Recording {
    let frame = |z: f64, cylinder| {
        Frame::new(
            Pose { translation_mm: DVec3::Z * z, ..Pose::IDENTITY },
            (0..360).map(|j| DVec2::from_angle(f64::from(j) / 360.0 * TAU) * wall(z)).collect(),
        )
        .with_cylinder(cylinder)
    };
    let model = CylinderModel::from_axis(0.0, 0.0, DVec3::Z, 10.0);
    let passing = (0..=200).map(|k| frame(-5.0 + f64::from(k) * 0.05, None));
    Recording { frames: passing.chain([frame(0.0, Some(model))]).collect() }
}

#[test]
fn a_primitive_of_10_mm_lies_on_a_cylinder_of_30_mm_after_one_iteration() {
    let settings = Settings::default().with_gate([0.0, 4.0]);
    let recording = seen_on_both_sides(|_| 30.0);
    let track = Track::of(&recording, &settings).unwrap();
    let fitted = &fit::<f64>(&track, &[recording.frames.len() - 1], &settings)[0].tube;
    assert!(fitted.history_mm[0].iter().all(|&r| r == 10.0));
    for after in &fitted.history_mm[1..] {
        assert!(after.iter().all(|r| (r - 30.0).abs() <= 1e-12), "{after:?}");
    }
}

#[test]
fn on_a_frustum_the_error_falls_and_stays_largest_at_the_ends() {
    let wall = |z: f64| 10.0 + 0.4 * z;
    let settings = Settings::default().with_iterations(10);
    let recording = seen_on_both_sides(wall);
    let track = Track::of(&recording, &settings).unwrap();
    let fitted = &fit::<f64>(&track, &[recording.frames.len() - 1], &settings)[0].tube;
    let tube = fitted.tube;
    let errors = |radii: &[f64]| -> Vec<f64> {
        let error = |(node, r): (usize, &f64)| (r - wall(tube.ring_z_mm(node / tube.nodes))).abs();
        radii.iter().enumerate().map(error).collect()
    };
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let means: Vec<f64> = fitted.history_mm.iter().map(|radii| mean(&errors(radii))).collect();
    println!("mean error, iteration by iteration: {means:.3?} mm");
    assert!(means.windows(2).all(|pair| pair[1] < pair[0]), "{means:?}");
    let last = errors(&fitted.radii_mm);
    let largest = |nodes: &[f64]| nodes.iter().copied().fold(0.0, f64::max);
    let (first_ring, others) = last.split_at(tube.nodes);
    let (inner, last_ring) = others.split_at(others.len() - tube.nodes);
    println!(
        "largest error: {:.3} and {:.3} mm at the ends, {:.3} between",
        largest(first_ring),
        largest(last_ring),
        largest(inner)
    );
    assert!(largest(first_ring).min(largest(last_ring)) > largest(inner));
}

/// The grid of a tube 10 mm high.
fn grid<T: Scalar>(nodes: usize, levels: usize) -> TubeGrid<T> {
    TubeGrid::new(&Tube { nodes, levels, height_mm: 10.0 })
}

/// A face and its corners as points (r, θ, z) less corner a.
fn some_face(rng: &mut ChaCha8Rng, grid: &TubeGrid<f64>) -> (Face<f64>, [DVec3; 4]) {
    let mut radius = || rng.random_range(-3.0..3.0);
    let (b, b_above, a_above) = (radius(), radius(), radius());
    let TubeGrid { step_theta, step_z, .. } = *grid;
    let corners = [
        DVec3::ZERO,
        DVec3::new(b, step_theta, 0.0),
        DVec3::new(b_above, step_theta, step_z),
        DVec3::new(a_above, 0.0, step_z),
    ];
    (Face::new([b, b_above, a_above], grid), corners)
}

/// Points about a face: over its inside, its edges and its corners, near and far.
fn some_points(rng: &mut ChaCha8Rng, corners: &[DVec3; 4]) -> Vec<DVec3> {
    let mut points = corners.to_vec();
    for reach in [0.1, 1.0, 10.0, 100.0] {
        for _ in 0..6 {
            let (u, v): (f64, f64) = (rng.random_range(-1.0..2.0), rng.random_range(-1.0..2.0));
            let r = rng.random_range(-1.0..1.0) * reach;
            points.push(DVec3::new(r, u * corners[2].y, v * corners[2].z));
            let [x, y, z] = [(); 3].map(|()| rng.random_range(-1.0..1.0));
            points.push(corners[2] * 0.5 + DVec3::new(x, y, z) * reach);
        }
    }
    points
}

#[test]
fn the_signed_distance_is_that_to_the_nearer_triangle() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut regions, mut tops) = ([0; 7], 0);
    let mut tested = 0;
    for (nodes, levels) in [(3, 1), (12, 5), (24, 8), (360, 100), (2048, 512), (2048, 1)] {
        let grid = grid(nodes, levels);
        for _ in 0..1500 {
            let (face, corners) = some_face(&mut rng, &grid);
            let [a, b, b_above, a_above] = corners;
            let bottom = Triangle::new(a, b, b_above);
            let top = Triangle::new(a, b_above, a_above);
            for p in some_points(&mut rng, &corners) {
                let (found, nearer_top) = distance(p.to_array(), &face, &grid);
                let nearest = |t: &Triangle| t.project_local_point(p, false).point;
                let (q1, q2) = (nearest(&bottom), nearest(&top));
                let (d1, d2) = (p.distance(q1), p.distance(q2));
                // parry's own rounding, with the slivers' condition on top.
                let slack = 1e-9 * (1.0 + p.length());
                assert!((found.abs() - d1.min(d2)).abs() <= slack, "{found} {d1} {d2}: {p} {face:?}");
                if (d1 - d2).abs() > slack {
                    assert_eq!(nearer_top, d2 < d1, "{d1} {d2}: {p} {face:?}");
                }
                let (q, normal) = match nearer_top {
                    true => (q2, (b_above - a).cross(a_above - a)),
                    false => (q1, (b - a).cross(b_above - a)),
                };
                let side = (p - q).dot(normal.normalize());
                if side.abs() > slack {
                    assert_eq!(found < 0.0, side < 0.0, "{side}: {p} {face:?}");
                }
                regions[region(&bottom, q1)] += 1;
                tops += usize::from(nearer_top);
                tested += 1;
            }
        }
    }
    println!("{tested} points; bottom's inside, edges and corners {regions:?}; {tops} nearer to the top");
    assert!(regions.iter().all(|&count| count > 1000) && tops > tested / 5);
}

/// Where on a triangle a point lies: 0 inside, 1 to 3 an edge, 4 to 6 a corner.
fn region(t: &Triangle, q: DVec3) -> usize {
    let corners = [t.a, t.b, t.c];
    if let Some(k) = corners.iter().position(|c| c.distance(q) < 1e-9) {
        return 4 + k;
    }
    let on = |k: usize| {
        let (from, to) = (corners[k], corners[(k + 1) % 3]);
        (q - from).reject_from(to - from).length() < 1e-9
    };
    (0..3).find(|&k| on(k)).map_or(0, |k| 1 + k)
}

#[test]
fn over_the_fold_the_triangles_tie_and_the_point_goes_to_bottom() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut ties = 0;
    for (nodes, levels) in [(12, 5), (24, 8), (2048, 512)] {
        let (grid, single_grid) = (grid(nodes, levels), grid::<f32>(nodes, levels));
        for _ in 0..20_000 {
            let (face, [a, b, b_above, a_above]) = some_face(&mut rng, &grid);
            // Into each triangle, square to the diagonal.
            let diagonal = b_above - a;
            let into = |corner: DVec3| corner.reject_from(diagonal).normalize();
            let (into_bottom, into_top) = (into(b), into(a_above));
            let mut weight = || rng.random_range(0.05..1.0);
            let away = -(into_bottom * weight() + into_top * weight()).normalize();
            if away.dot(into_bottom) > -1e-3 || away.dot(into_top) > -1e-3 {
                continue;
            }
            let foot = diagonal * rng.random_range(0.05..0.95);
            let p = foot + away * rng.random_range(0.01..5.0);
            ties += 1;
            let (found, nearer_top) = distance(p.to_array(), &face, &grid);
            assert!((found.abs() - p.distance(foot)).abs() < 1e-12 && !nearer_top, "f64: {p} {face:?}");
            let single = |x: f64| x as f32;
            let face = Face::new([b.x, b_above.x, a_above.x].map(single), &single_grid);
            assert!(!distance(p.to_array().map(single), &face, &single_grid).1, "f32: {p} {face:?}");
        }
    }
    println!("{ties} ties");
    assert!(ties > 10_000);
}

/// Of random points about random faces, the share whose nearer triangle is another one in f32 than in f64.
#[test]
fn rounding_decides_few_of_the_choices_between_two_triangles() {
    const POINTS: usize = 100_000;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    // Nodes and levels, how far corners and points lie from a along r (mm), and the most choices that may differ.
    for (nodes, levels, corners_mm, points_mm, most) in [
        (12, 5, 0.0, 0.5, 0),
        (2048, 2048, 0.0, 0.5, 0),
        (12, 5, 0.5, 0.5, 3),
        (512, 512, 0.05, 0.5, 3),
        (2048, 2048, 0.5, 0.5, 3),
        (4096, 5, 5.0, 5.0, 3),
        (30, 300, 0.001, 5.0, 150),
    ] {
        let single = grid::<f32>(nodes, levels);
        let (step_theta, step_z) = (f64::from(single.step_theta), f64::from(single.step_z));
        let (faces_per_rad, faces_per_mm) = (1.0 / step_theta, 1.0 / step_z);
        let double = TubeGrid { step_theta, step_z, faces_per_rad, faces_per_mm, ..grid(nodes, levels) };
        let mut differ = 0;
        for _ in 0..POINTS {
            let mut within = |reach: f32| rng.random_range(-1.0..=1.0_f32) * reach;
            let corners = [(); 3].map(|()| within(corners_mm));
            let [r, y, z] = [within(points_mm), within(0.5) + 0.5, within(0.5) + 0.5];
            let p = [r, y * single.step_theta, z * single.step_z];
            let (_, top) = distance(p, &Face::new(corners, &single), &single);
            let (_, exact) = distance(p.map(f64::from), &Face::new(corners.map(f64::from), &double), &double);
            differ += usize::from(top != exact);
        }
        println!("{nodes}x{levels}, corners within {corners_mm} mm: {differ} of {POINTS}");
        assert!(differ <= most, "{nodes}x{levels}, corners within {corners_mm} mm: {differ}");
    }
}

/// The frames up to and including one, that one last and the others in any order, points of each in any order.
fn shuffled(recording: &Recording, frame: usize, rng: &mut ChaCha8Rng) -> Recording {
    let mut frames = recording.frames[..frame].to_vec();
    frames.shuffle(rng);
    frames.push(recording.frames[frame].clone());
    frames.iter_mut().for_each(|f| f.contour_mm.shuffle(rng));
    Recording { frames }
}

fn does_not_depend_on_the_order_of_points<T: Scalar>(recording: &Recording) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (outliers, statistic) in [
        (Outliers::Iqr, Statistic::Mean),
        (Outliers::Deviation, Statistic::Median),
        (Outliers::None, Statistic::Mean),
    ] {
        let settings = Settings::default().with_outliers(outliers).with_statistic(statistic);
        for frame in [99, 444] {
            let of = |recording: &Recording| {
                fit::<T>(&Track::of(recording, &settings).unwrap(), &[frame], &settings).remove(0).tube
            };
            let (forth, back) = (of(recording), of(&shuffled(recording, frame, &mut rng)));
            assert_eq!(bits(&forth.radii_mm), bits(&back.radii_mm));
            assert_eq!(bits(&forth.residual_mm), bits(&back.residual_mm));
            assert_eq!((forth.support, forth.rejected), (back.support, back.rejected));
        }
    }
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|x| x.to_bits()).collect()
}

#[test]
fn the_order_of_points_does_not_matter_to_the_last_bit() {
    let Some(recording) = read("adult_aorta_noisy") else { return };
    does_not_depend_on_the_order_of_points::<f32>(&recording);
    does_not_depend_on_the_order_of_points::<f64>(&recording);
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let Some(recording) = read("adult_aorta_noisy") else { return };
    let settings = Settings::default();
    let folder = tempfile::tempdir().unwrap();
    for (name, engine) in
        [("cpu", &CpuEngine::<f32>::new() as &dyn Engine), ("reference", &CpuEngine::<f64>::new())]
    {
        let bytes = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let done = pool
                .install(|| {
                    CylinderReconstruction::run(&recording, &settings, engine, true, &|_, _| {
                        ControlFlow::Continue(())
                    })
                })
                .unwrap();
            let (mesh, cylinders) = (folder.path().join("mesh.vtp"), folder.path().join("cylinders.csv"));
            done.vessel.surface().write(&mesh).unwrap();
            write_cylinders(&done.cylinders, &cylinders).unwrap();
            (std::fs::read(mesh).unwrap(), std::fs::read(cylinders).unwrap())
        };
        let one = bytes(1);
        for threads in [2, 3, 8] {
            assert!(bytes(threads) == one, "{threads} threads, {name}");
        }
    }
}

/// A tube that every step of the fit is split over threads for.
#[test]
fn the_number_of_threads_changes_no_bit_of_a_large_tube() {
    let case: Case = "300x200x4e5".parse().unwrap();
    let (section, settings) = (case.section(5), case.settings());
    let fit = |engine: &dyn Engine, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let tube = pool.install(|| engine.fit_section(&section, 12.0, &settings)).unwrap().tube;
        let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        (bits(&tube.radii_mm), bits(&tube.residual_mm), bits(&tube.travel_mm), tube.support, tube.rejected)
    };
    for engine in [&CpuEngine::<f32>::new() as &dyn Engine, &CpuEngine::<f64>::new()] {
        let one = fit(engine, 1);
        assert!(one.4 > 0);
        for threads in [2, 3, 8] {
            assert!(fit(engine, threads) == one, "{threads} threads");
        }
    }
}

#[test]
fn a_cylinder_can_be_asked_for_while_frames_come_in() {
    let Some(mut recording) = read("adult_aorta_noisy") else { return };
    // Half of the cylinders estimated: the estimate too looks back only.
    recording.frames.iter_mut().skip(300).for_each(|f| f.cylinder = None);
    let settings = Settings::default();
    let whole = Track::of(&recording, &settings).unwrap();
    let frames = merged_frames(whole.len(), &settings);
    let batch = fit::<f32>(&whole, &frames, &settings);
    let mut track = Track::new(Pose::IDENTITY, Box::new(LocalEstimate::new(Pose::IDENTITY)));
    let mut vessel = MergedVessel::default();
    for (k, frame) in recording.frames.iter().enumerate() {
        track.push(frame).unwrap();
        if let Ok(at) = frames.binary_search(&k) {
            let now = fit::<f32>(&track, &[k], &settings).remove(0);
            same_cylinder(&now, &batch[at]);
            vessel.stitch(&now, &now.tube.radii_mm);
        }
    }
    for (at, &k) in frames.iter().enumerate() {
        same_cylinder(&fit::<f32>(&track, &[k], &settings)[0], &batch[at]);
    }
    let of_all = MergedVessel::of(&batch, Merge::Stitch);
    let positions = |vessel: &MergedVessel| -> Vec<DVec3> {
        vessel.rings.iter().flat_map(|r| r.nodes_mm.iter().copied()).collect()
    };
    assert_eq!(positions(&vessel), positions(&of_all));
}

/// Equal to the bit, NaN in the residuals included.
fn same_cylinder(a: &FittedCylinder, b: &FittedCylinder) {
    assert_eq!((a.frame, a.world_from_cylinder), (b.frame, b.world_from_cylinder));
    let numbers = |c: &FittedCylinder| {
        let history = c.tube.history_mm.iter().flat_map(|radii| bits(radii)).collect::<Vec<_>>();
        (history, bits(&c.tube.residual_mm), bits(&c.tube.travel_mm), c.tube.support.clone())
    };
    assert!(numbers(a) == numbers(b), "frame {}", a.frame);
}

fn no_point_is_lost<T: Scalar>(recording: &Recording, settings: &Settings) {
    let track = Track::of(recording, settings).unwrap();
    let (mut looked_at, mut all) = (0, 0);
    for frame in merged_frames(track.len(), settings) {
        let cylinder = track.cylinder(frame).unwrap();
        let gate = Gate::new(settings, cylinder.radius_mm);
        let mut by_force = Section::<T>::default();
        for earlier in &recording.frames[..=frame] {
            let world_from_probe = earlier.world_from_sensor * settings.calibration.sensor_from_probe();
            let cylinder_from_probe = cylinder.world_from_cylinder.inverse() * world_from_probe;
            let points: Vec<DVec2> = earlier.echoes_mm().collect();
            project(&points, &TubeTransform::new(&cylinder_from_probe), &gate, &mut by_force);
        }
        let culled = track.section::<T>(frame, settings).unwrap();
        assert_eq!(points_of(&culled), points_of(&by_force), "frame {frame}");
        looked_at += track.near(frame, settings).unwrap().count();
        all += frame + 1;
    }
    println!("{looked_at} of {all} frames looked at");
    // Otherwise the test would hold for a cull that culls nothing.
    assert!(looked_at < all / 2);
}

/// A section's points as a multiset.
fn points_of<T: Scalar>(section: &Section<T>) -> Vec<[u64; 3]> {
    let bits = |x: T| x.to_f64().to_bits();
    let point = |i: usize| [bits(section.r[i]), bits(section.theta[i]), bits(section.z[i])];
    let mut points: Vec<_> = (0..section.len()).map(point).collect();
    points.sort_unstable();
    points
}

#[test]
fn leaving_out_far_frames_loses_no_point() {
    for name in ["adult_aorta_clean", "adult_aorta_noisy"] {
        let Some(recording) = read(name) else { return };
        let wide = Settings::default().with_gate([0.0, 3.0]).with_height_mm(14.0).with_every(25);
        for settings in [Settings::default(), wide] {
            no_point_is_lost::<f32>(&recording, &settings);
            no_point_is_lost::<f64>(&recording, &settings);
        }
    }
}

/// Turned and shifted frames of a few points each: no order in it that the cull could profit from.
#[test]
fn leaving_out_far_frames_loses_no_point_of_a_disorderly_recording() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut frame = || {
        let mut number = |reach: f64| rng.random_range(-reach..reach);
        let turn = DQuat::from_xyzw(number(1.0), number(1.0), number(1.0), number(1.0)).normalize();
        let place = DVec3::new(number(60.0), number(60.0), number(60.0));
        let away = DVec2::new(number(20.0), number(20.0));
        let contour_mm = (0..7).map(|_| away + DVec2::new(number(5.0), number(5.0))).collect();
        let lean = DVec3::new(number(1.0), number(1.0), 1.0);
        let cylinder = Some(CylinderModel::from_axis(number(5.0), number(5.0), lean, 8.0 + number(4.0)));
        Frame::new(Pose::from_quaternion(place, turn), contour_mm).with_cylinder(cylinder)
    };
    let recording = Recording { frames: (0..1500).map(|_| frame()).collect() };
    let settings = Settings::default().with_gate([0.0, 2.5]).with_every(100);
    no_point_is_lost::<f32>(&recording, &settings);
    no_point_is_lost::<f64>(&recording, &settings);
}

fn truth() -> Option<Truth> {
    let surface = Surface::read(&crate::support::shared("data/aorta_adult_full_steve.stl")?).unwrap();
    Some(Truth::new(surface).unwrap())
}

fn mean_distance_mm(nodes: impl Iterator<Item = DVec3>, truth: &Truth) -> f64 {
    let distances: Vec<f64> = nodes.map(|node| truth.locator().distance_mm(node)).collect();
    distances.iter().sum::<f64>() / distances.len() as f64
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let n = numbers.len();
    (numbers[(n - 1) / 2] + numbers[n / 2]) / 2.0
}

/// Section 7 of the method: an independent implementation's figures, to the second decimal.
///
/// The error is the mean over a mesh's nodes of the distance to the truth's triangles; its median is taken over the
/// merged cylinders (frames 9, 19, …), iteration by iteration. "Undeformed" stitches the primitives.
#[test]
fn the_published_fitting_errors_come_out() {
    let Some(truth) = truth() else { return };
    for (name, single, rings, stitched, undeformed) in [
        ("adult_aorta_clean", [0.929, 0.728, 0.694, 0.683], 91, 0.331, 0.828),
        ("adult_aorta_noisy", [1.129, 0.919, 0.929, 0.982], 84, 0.636, 0.930),
    ] {
        let Some(recording) = read(name) else { return };
        let settings = Settings::default();
        let track = Track::of(&recording, &settings).unwrap();
        let cylinders = fit::<f64>(&track, &merged_frames(track.len(), &settings), &settings);
        let error_after = |iteration: usize| {
            let error =
                |c: &FittedCylinder| mean_distance_mm(c.nodes_mm(&c.tube.history_mm[iteration]), &truth);
            median(cylinders.iter().map(error).collect())
        };
        let found = [0, 1, 2, 3].map(error_after);
        let vessel_after = |iteration: usize| {
            let mut vessel = MergedVessel::default();
            cylinders.iter().for_each(|c| {
                vessel.stitch(c, &c.tube.history_mm[iteration]);
            });
            vessel
        };
        let error = |vessel: &MergedVessel| {
            mean_distance_mm(vessel.rings.iter().flat_map(|r| r.nodes_mm.iter().copied()), &truth)
        };
        let (vessel, primitives) = (vessel_after(3), vessel_after(0));
        println!(
            "{name}: single cylinders {found:.4?}; {} rings, {:.4} ({:.4}, {} rings)",
            vessel.rings.len(),
            error(&vessel),
            error(&primitives),
            primitives.rings.len()
        );
        let close =
            |found: f64, expected: f64| assert!((found - expected).abs() < 0.005, "{found} {expected}");
        found.iter().zip(single).for_each(|(&found, expected)| close(found, expected));
        assert_eq!(vessel.rings.len(), rings);
        close(error(&vessel), stitched);
        close(error(&primitives), undeformed);
    }
}

#[test]
fn a_stitched_vessel_is_a_tube_with_two_open_ends() {
    for name in ["adult_aorta_clean", "adult_aorta_noisy"] {
        let Some(recording) = read(name) else { return };
        let settings = Settings::default();
        let done = CylinderReconstruction::of(&recording, &settings, &CpuEngine::<f32>::new()).unwrap();
        let surface = done.vessel.surface();
        let topology = surface.topology();
        assert!(topology.is_oriented_manifold(), "{topology:?}");
        assert_eq!((topology.boundary_loops, topology.components), (2, 1));
        assert_eq!((topology.degenerate_triangles, topology.duplicate_triangles), (0, 0));
        assert_eq!(topology.euler_characteristic, 0);
        let share = outward_share(&surface, settings.nodes as usize);
        println!("{name}: {topology:?}; {:.2} % of the triangles look outward", 100.0 * share);
        assert!(share > 0.99);
        // Negative control.
        let mut inside_out = surface;
        inside_out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        assert!(outward_share(&inside_out, settings.nodes as usize) < 0.01);
    }
}

/// The share of triangles whose normal looks away from the middle of the two rings that they join.
fn outward_share(surface: &Surface, ring: usize) -> f64 {
    let middle = |k: usize| surface.nodes_mm[k * ring..(k + 1) * ring].iter().sum::<DVec3>() / ring as f64;
    let outward = surface.triangles.iter().filter(|t| {
        let [a, b, c] = t.map(|n| surface.nodes_mm[n as usize]);
        let below = t.iter().min().unwrap() / ring as u32;
        let middle = (middle(below as usize) + middle(below as usize + 1)) / 2.0;
        (b - a).cross(c - a).dot((a + b + c) / 3.0 - middle) > 0.0
    });
    outward.count() as f64 / surface.triangles.len() as f64
}
