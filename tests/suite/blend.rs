//! One vessel as the mean of the cylinders that overlap.

use glam::{DMat3, DVec3};
use lumenmesh::cylinders::Tube;
use lumenmesh::cylinders::merge::{Blend, MergedVessel, VesselRing};
use lumenmesh::cylinders::{
    CpuEngine, DeformedTube, Engine, FitRequest, FittedCylinder, Track, merged_frames,
};
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::geometry::Pose;
use lumenmesh::settings::{Merge, Settings};
use lumenmesh::simulate::{self, Phantom, Shape, Simulation};

const RADIUS_MM: f64 = 8.0;
const TUBE: Tube = Tube { nodes: 16, levels: 5, height_mm: 10.0 };

/// A round cylinder; `support(z, j)` points behind the node at that height.
fn cylinder(
    frame: usize,
    origin_mm: DVec3,
    axis: DVec3,
    support: impl Fn(f64, usize) -> u32,
) -> FittedCylinder {
    let y = axis.any_orthonormal_vector();
    let world_from_cylinder =
        Pose { rotation: DMat3::from_cols(axis, y, axis.cross(y)), translation_mm: origin_mm };
    let support: Vec<u32> = (0..TUBE.node_count())
        .map(|node| support(TUBE.ring_z_mm(node / TUBE.nodes), node % TUBE.nodes))
        .collect();
    let mut tube = DeformedTube::primitive(TUBE, RADIUS_MM);
    tube.residual_mm = support.iter().map(|&n| if n > 0 { 0.25 } else { f64::NAN }).collect();
    tube.support = support;
    tube.points = 1000;
    FittedCylinder::new(frame, world_from_cylinder, tube)
}

fn seen_all_round(_: f64, _: usize) -> u32 {
    50
}

/// Cylinders along z.
fn straight(heights_mm: impl Iterator<Item = f64>) -> Vec<FittedCylinder> {
    heights_mm.enumerate().map(|(k, z)| cylinder(k, DVec3::Z * z, DVec3::Z, seen_all_round)).collect()
}

fn middle(ring: &VesselRing) -> DVec3 {
    ring.nodes_mm.iter().sum::<DVec3>() / ring.nodes_mm.len() as f64
}

/// The normal of a ring's plane.
fn normal(ring: &VesselRing) -> DVec3 {
    let middle = middle(ring);
    let quarter = ring.nodes_mm.len() / 4;
    (ring.nodes_mm[0] - middle).cross(ring.nodes_mm[quarter] - middle).normalize()
}

/// Whether every ring lies wholly before the next one.
fn in_order(rings: &[VesselRing]) -> bool {
    rings.windows(2).all(|pair| {
        let [(a, n), (b, m)] = [&pair[0], &pair[1]].map(|ring| (middle(ring), normal(ring)));
        pair[1].nodes_mm.iter().all(|p| (p - a).dot(n) > 0.0)
            && pair[0].nodes_mm.iter().all(|p| (p - b).dot(m) < 0.0)
    })
}

#[test]
fn equal_cylinders_give_their_tube() {
    // Steps that do not fit the rings: partly overlapping weights must still sum to one.
    let vessel = MergedVessel::of(&straight((0..40).map(|k| 0.7 * f64::from(k))), Merge::Blend);
    assert!(vessel.rings.len() > 12, "{}", vessel.rings.len());
    assert!(in_order(&vessel.rings));
    for ring in &vessel.rings {
        for (p, q) in ring.nodes_mm.iter().zip(&vessel.rings[0].nodes_mm) {
            assert!((p.x.hypot(p.y) - RADIUS_MM).abs() < 1e-9);
            assert!(p.truncate().distance(q.truncate()) < 1e-9, "twisted");
        }
        assert!(ring.support.iter().all(|&n| n == 50), "{:?}", ring.support);
        assert!(ring.residual_mm.iter().all(|r| (r - 0.25).abs() < 1e-12));
    }
}

#[test]
fn a_cylinder_of_another_size_leaves_no_step() {
    let mut cylinders = straight((0..40).map(|k| 0.7 * f64::from(k)));
    cylinders[20].tube.radii_mm.fill(RADIUS_MM + 1.0);
    let vessel = MergedVessel::of(&cylinders, Merge::Blend);
    // Rings lie at even heights; the large cylinder reaches from 9 to 19.
    let excess = |z: f64| {
        let ring = vessel.rings.iter().find(|r| (middle(r).z - z).abs() < 1e-6).unwrap();
        ring.nodes_mm[3].truncate().length() - RADIUS_MM
    };
    // About eleven cylinders overlap at any place.
    assert!((0.05..0.15).contains(&excess(14.0)), "{}", excess(14.0));
    // Rings that were laid later know nothing of it, those that were there rise over a level.
    let share = excess(10.0) / excess(14.0);
    assert!((0.3..0.7).contains(&share), "{share}");
    assert!(excess(8.0).abs() < 1e-9 && excess(20.0).abs() < 1e-9);
}

/// Cylinders along a quarter circle with that radius.
fn bent(bend_mm: f64) -> Vec<FittedCylinder> {
    let length = bend_mm * std::f64::consts::FRAC_PI_2;
    (0..(length / 0.8) as usize)
        .map(|k| {
            let (sin, cos) = (0.8 * k as f64 / bend_mm).sin_cos();
            let origin = DVec3::new(bend_mm * (1.0 - cos), 0.0, bend_mm * sin);
            cylinder(k, origin, DVec3::new(sin, 0.0, cos), seen_all_round)
        })
        .collect()
}

#[test]
fn a_bend_keeps_its_rings_in_order_and_its_nodes_in_line() {
    let bend_mm = 30.0;
    let vessel = MergedVessel::of(&bent(bend_mm), Merge::Blend);
    assert!(vessel.rings.len() > 18 && in_order(&vessel.rings));
    let mut folded = vessel.rings.clone();
    folded.swap(5, 6);
    assert!(!in_order(&folded), "the comparer finds nothing");
    let from_axis = |p: &DVec3| {
        let in_plane = DVec3::new(p.x - bend_mm, 0.0, p.z);
        (in_plane.length() - bend_mm).hypot(p.y)
    };
    for pair in vessel.rings.windows(2) {
        // A straight cylinder of 10 mm leaves the bend by at most 5²/2/30 = 0.42 mm, weighed down towards its ends.
        assert!(pair[1].nodes_mm.iter().all(|p| (from_axis(p) - RADIUS_MM).abs() < 0.2));
        for (j, p) in pair[1].nodes_mm.iter().enumerate() {
            let near = |k: &usize| pair[0].nodes_mm[*k].distance(*p);
            let nearest = (0..TUBE.nodes).min_by(|a, b| near(a).total_cmp(&near(b)));
            assert_eq!(nearest, Some(j), "twisted");
        }
    }
}

#[test]
fn a_catheter_that_rests_and_goes_back_leaves_the_same_tube() {
    let there = (0..40).map(|k| 0.7 * f64::from(k));
    let back = (0..30).map(|k| 20.0 - 0.9 * f64::from(k));
    let heights = there.chain(std::iter::repeat_n(27.3, 50)).chain(back).chain((0..50).map(f64::from));
    let vessel = MergedVessel::of(&straight(heights), Merge::Blend);
    assert!(in_order(&vessel.rings));
    let [first, last] = [0, vessel.rings.len() - 1].map(|k| middle(&vessel.rings[k]).z);
    // From the farthest origin on either side, give or take a level.
    assert!((-8.1..-4.0).contains(&first) && (47.0..51.1).contains(&last), "{first} {last}");
    let radii = vessel.rings.iter().flat_map(|r| r.nodes_mm.iter().map(|p| p.truncate().length()));
    assert!(radii.into_iter().all(|r| (r - RADIUS_MM).abs() < 1e-9));
}

#[test]
fn a_cylinder_can_be_added_at_any_time_and_changes_what_it_overlaps() {
    let cylinders = bent(40.0);
    let mut blend = Blend::default();
    for (k, cylinder) in cylinders.iter().enumerate() {
        let before = blend.vessel();
        blend.append(cylinder, &cylinder.tube.radii_mm);
        let after = blend.vessel();
        let origin = cylinder.world_from_cylinder.translation_mm;
        let far = |ring: &&VesselRing| middle(ring).distance(origin) > TUBE.height_mm + RADIUS_MM;
        let [kept, left] = [&before, &after].map(|v| v.rings.iter().filter(far).cloned().collect::<Vec<_>>());
        assert_eq!(kept, left, "cylinder {k}");
        assert_ne!(before.rings, after.rings, "cylinder {k} had no say");
    }
    assert_eq!(blend.vessel(), MergedVessel::of(&cylinders, Merge::Blend));
}

#[test]
fn what_no_point_supports_does_not_count_as_measured() {
    // Behind the probe only, and not in a sector of three nodes.
    let seen = |z: f64, j: usize| if z < 0.0 && !(4..7).contains(&j) { 50 } else { 0 };
    let cylinders: Vec<_> = (0..30).map(|k| cylinder(k, DVec3::Z * k as f64, DVec3::Z, seen)).collect();
    let vessel = MergedVessel::of(&cylinders, Merge::Blend);
    assert!(vessel.rings.len() > 10);
    for ring in &vessel.rings {
        // No point lies ahead of the last origin.
        assert!(middle(ring).z <= 29.0);
        assert_eq!(ring.support[5], 0);
        assert_eq!(ring.support[12], 50);
        for (support, residual) in ring.support.iter().zip(&ring.residual_mm) {
            assert_eq!(*support == 0, residual.is_nan());
        }
        // The circle through the others.
        assert!((ring.nodes_mm[5].truncate().length() - RADIUS_MM).abs() < 1e-9);
    }
    // Wrong where nobody looked: no trace of it.
    let mut wrong = cylinders;
    for c in &mut wrong {
        let unseen = c.tube.support.iter().enumerate().filter(|(_, n)| **n == 0);
        let nodes: Vec<usize> =
            unseen.map(|(node, _)| node).filter(|node| TUBE.ring_z_mm(node / TUBE.nodes) > 0.0).collect();
        nodes.into_iter().for_each(|node| c.tube.radii_mm[node] = 3.0);
    }
    let radii = |vessel: &MergedVessel| -> Vec<f64> {
        vessel.rings.iter().map(|r| r.nodes_mm[12].truncate().length()).collect()
    };
    assert!(radii(&MergedVessel::of(&wrong, Merge::Blend)).iter().all(|r| (r - RADIUS_MM).abs() < 1e-9));
    let none: Vec<_> = (0..3).map(|k| cylinder(k, DVec3::ZERO, DVec3::Z, |_, _| 0)).collect();
    assert!(MergedVessel::of(&none, Merge::Blend).rings.is_empty());
}

#[test]
fn rings_in_a_branch_that_was_not_taken_go_away() {
    let mut cylinders = straight((0..30).map(f64::from));
    let lean = DVec3::new(0.5, 0.0, 1.0).normalize();
    let branch = |sense: f64| {
        let axis = DVec3::new(sense * lean.x, 0.0, lean.z);
        (1..40).map(move |k| cylinder(100 + k, DVec3::Z * 29.0 + axis * k as f64, axis, seen_all_round))
    };
    cylinders.extend(branch(-1.0).take(8));
    cylinders.extend(branch(1.0));
    let vessel = MergedVessel::of(&cylinders, Merge::Blend);
    let end = middle(&vessel.rings[vessel.rings.len() - 1]);
    assert!(end.distance(DVec3::Z * 29.0 + lean * 39.0) < 3.0, "{end}");
}

#[test]
fn blending_is_nearer_to_the_truth_than_stitching() {
    for (shape, seed, noise) in [("stenosis", 3, 1.0), ("small_arch", 4, 1.0), ("stenosis", 5, 0.0)] {
        let vessel = Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap();
        let noise =
            if noise > 0.0 { simulate::Noise::default().with_seed(seed) } else { simulate::Noise::none() };
        let settings = simulate::SimulationSettings::default().with_noise(noise);
        let simulation = Simulation::run(vessel, &settings).unwrap();
        let truth = Truth::new(simulation.vessel.surface().clone()).unwrap();
        let settings = Settings::default();
        let track = Track::of(&simulation.recording, &settings).unwrap();
        let frames = merged_frames(track.len(), &settings);
        let cylinders =
            CpuEngine::<f32>::new().fit(&FitRequest::new(&track, &frames, &settings)).unwrap().cylinders;
        let [stitched, blended] = [Merge::Stitch, Merge::Blend].map(|merge| {
            let surface = MergedVessel::of(&cylinders, merge).surface();
            surface.check().unwrap();
            evaluate(&surface, &truth).unwrap().mesh_to_truth.mean_mm
        });
        println!("{shape}: stitched {stitched:.3} mm, blended {blended:.3} mm");
        assert!(blended < stitched, "{shape}: {blended} {stitched}");
    }
}
