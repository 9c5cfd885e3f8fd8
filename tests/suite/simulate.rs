//! Simulated recordings against the settings and vessels that they were made from.

use crate::support::shared;
use glam::{DQuat, DVec3};
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::simulate::{
    Centreline, ContourNoise, Insertion, Move, Noise, Phantom, Probe, Shape, SimulatedVessel, Simulation,
    SimulationSettings, TrackerNoise, Tree, Visit,
};
use lumenmesh::surface::Surface;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;

fn phantom(name: &str) -> SimulatedVessel {
    let shape: Shape = name.parse().expect("a phantom's name");
    Phantom::from(shape).vessel().expect("a phantom")
}

/// A run in which the tip rests, so that every frame has the same truth.
fn resting(noise: Noise) -> SimulationSettings {
    SimulationSettings::default()
        .with_insertion(
            Insertion::default()
                .with_start_mm(40.0)
                .with_moves(vec![Move::Rest { duration_s: 100.0 }])
                .with_repeat(false),
        )
        .with_noise(noise)
}

fn noise_free(insertion: Insertion) -> SimulationSettings {
    SimulationSettings::default().with_insertion(insertion).with_noise(Noise::none())
}

fn pairs(simulation: &Simulation) -> impl Iterator<Item = (&Frame, &Frame)> {
    simulation.recording.frames.iter().zip(&simulation.truth_recording.frames)
}

fn position_errors(simulation: &Simulation) -> Vec<f64> {
    pairs(simulation)
        .flat_map(|(seen, truth)| {
            (seen.world_from_sensor.translation_mm - truth.world_from_sensor.translation_mm).to_array()
        })
        .collect()
}

fn rotation_errors_deg(simulation: &Simulation) -> Vec<f64> {
    pairs(simulation)
        .flat_map(|(seen, truth)| {
            let turn = truth.world_from_sensor.rotation.transpose() * seen.world_from_sensor.rotation;
            DQuat::from_mat3(&turn).to_scaled_axis().to_array().map(f64::to_degrees)
        })
        .collect()
}

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    (mean, variance.sqrt())
}

/// Whether the values look drawn with mean 0 and that standard deviation: 5 standard errors either way, which a
/// sound generator leaves once in two million draws. The seeds are fixed, so it does so never or always.
fn drawn_with_sd(values: &[f64], sd: f64) -> bool {
    let n = values.len() as f64;
    let (mean, measured) = mean_and_sd(values);
    mean.abs() < 5.0 * sd / n.sqrt() && (measured - sd).abs() < 5.0 * sd / (2.0 * n).sqrt()
}

#[test]
fn the_comparer_of_spreads_tells_one_from_another() {
    let errors = position_errors(&Simulation::run(phantom("cylinder"), &resting(Noise::default())).unwrap());
    assert!(drawn_with_sd(&errors, 0.3));
    assert!(!drawn_with_sd(&errors, 0.33));
    assert!(!drawn_with_sd(&errors.iter().map(|e| e + 0.05).collect::<Vec<_>>(), 0.3));
}

#[test]
fn noise_has_the_spread_that_was_asked_for() {
    let noise = Noise::default().with_position_sd_mm(0.4).with_rotation_sd_deg(0.7).with_contour_sd_mm(0.2);
    let simulation = Simulation::run(phantom("aorta"), &resting(noise)).unwrap();
    assert!(drawn_with_sd(&position_errors(&simulation), 0.4));
    assert!(drawn_with_sd(&rotation_errors_deg(&simulation), 0.7));
    let (mut radial, mut across) = (Vec::new(), Vec::new());
    for (seen, truth) in pairs(&simulation) {
        for (p, q) in seen.contour_mm.iter().zip(&truth.contour_mm) {
            let ray = q.normalize();
            radial.push((p - q).dot(ray));
            across.push((p - q).perp_dot(ray));
        }
    }
    assert!(drawn_with_sd(&radial, 0.2));
    assert!(drawn_with_sd(&across, 0.2));
}

#[test]
fn radial_noise_stays_on_its_ray() {
    let noise = Noise::default().with_contour(ContourNoise::Radial);
    let simulation = Simulation::run(phantom("cylinder"), &resting(noise)).unwrap();
    let mut radial = Vec::new();
    for (seen, truth) in pairs(&simulation) {
        for (p, q) in seen.contour_mm.iter().zip(&truth.contour_mm) {
            assert!(p.perp_dot(q.normalize()).abs() < 1e-12);
            radial.push(p.length() - q.length());
        }
    }
    assert!(drawn_with_sd(&radial, 1.0));
}

#[test]
fn echoes_drop_out_and_spike_as_often_as_asked_for() {
    let noise =
        Noise::default().with_contour_sd_mm(0.0).with_dropout_probability(0.1).with_spike_probability(0.05);
    let simulation = Simulation::run(phantom("cylinder"), &resting(noise)).unwrap();
    let (mut rays, mut missing, mut spikes) = (0, 0, 0);
    for (seen, truth) in pairs(&simulation) {
        assert_eq!(truth.missing_echoes(), 0);
        rays += seen.contour_mm.len();
        missing += seen.missing_echoes();
        spikes +=
            seen.contour_mm.iter().zip(&truth.contour_mm).filter(|(p, q)| p.distance(**q) > 1e-9).count();
    }
    // Counts are binomial. A spike shows only where its ray did not drop out as well.
    let about = |count: usize, p: f64| {
        (count as f64 - rays as f64 * p).abs() < 5.0 * (rays as f64 * p * (1.0 - p)).sqrt()
    };
    assert!(about(missing, 0.1), "{missing} of {rays}");
    assert!(about(spikes, 0.05 * 0.9), "{spikes} of {rays}");
    assert!(!about(missing, 0.11), "the comparer takes 10 % for 11 %");
}

#[test]
fn drift_grows_with_the_root_of_time() {
    let (vessel, mut ends) = (phantom("cylinder"), Vec::new());
    for seed in 0..60 {
        let noise = Noise::none().with_seed(seed).with_position_drift_mm_per_sqrt_s(0.1);
        let settings = resting(noise).with_probe(Probe::default().with_rays(1));
        let errors = position_errors(&Simulation::run(vessel.clone(), &settings).unwrap());
        assert_eq!(errors[..3], [0.0; 3], "the walk starts at the truth");
        ends.extend_from_slice(&errors[errors.len() - 3..]);
    }
    // 100 s at 0.1 mm/√s.
    assert!(drawn_with_sd(&ends, 1.0), "{:?}", mean_and_sd(&ends));
}

#[test]
fn latency_shifts_the_poses_back_along_the_way() {
    let noise = Noise::none().with_latency_s(0.25);
    let settings = SimulationSettings::default().with_insertion(Insertion::steady()).with_noise(noise);
    let simulation = Simulation::run(phantom("cylinder"), &settings).unwrap();
    // 0.25 s are 0.6 mm at 2.4 mm/s, and 3 frames at 12 Hz.
    for (k, (seen, truth)) in pairs(&simulation).enumerate().skip(3) {
        let lag = truth.world_from_sensor.translation_mm - seen.world_from_sensor.translation_mm;
        assert!(lag.abs_diff_eq(DVec3::Z * 0.6, 1e-9), "frame {k}: {lag}");
        assert_eq!(seen.contour_mm, truth.contour_mm);
    }
}

#[test]
fn a_pulsating_cylinder_widens_by_the_fraction_asked_for() {
    let noise = Noise::none().with_pulsation_fraction(0.1).with_pulsation_rate_hz(1.0);
    let simulation = Simulation::run(phantom("cylinder"), &resting(noise)).unwrap();
    let ratio = |k: usize| {
        let (seen, truth) = pairs(&simulation).nth(k).unwrap();
        seen.contour_mm[7].length() / truth.contour_mm[7].length()
    };
    // At 12 Hz and 60 beats a minute, frame 3 sees the peak and frame 9 the trough.
    assert!(
        (ratio(0) - 1.0).abs() < 1e-12 && (ratio(3) - 1.1).abs() < 1e-12 && (ratio(9) - 0.9).abs() < 1e-12
    );
}

#[test]
fn a_bent_tip_stays_inside_when_the_vessel_narrows() {
    let shape = Shape::Cylinder { radius_mm: 6.0, length_mm: 60.0 };
    let noise = Noise::none().with_pulsation_fraction(0.4);
    let settings = SimulationSettings::default().with_noise(noise);
    let simulation = Simulation::run(Phantom::from(shape).vessel().unwrap(), &settings).unwrap();
    assert!(!simulation.reduced_bends.is_empty());
    for (k, frame) in simulation.recording.frames.iter().enumerate() {
        let off_mm = frame.world_from_sensor.translation_mm.truncate().length();
        let wall_mm = 6.0 * (1.0 - 0.4);
        assert!(off_mm < wall_mm, "frame {k}: {off_mm} mm off the middle of a tube of {wall_mm} mm");
    }
}

#[test]
fn the_number_of_threads_changes_nothing_and_the_seed_does() {
    let run = |threads: usize, seed: u64| {
        let noise = Noise::default()
            .with_seed(seed)
            .with_dropout_probability(0.02)
            .with_position_drift_mm_per_sqrt_s(0.1);
        let settings = SimulationSettings::default().with_noise(noise).with_cylinders(true);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Simulation::run(phantom("arch"), &settings).unwrap().recording)
    };
    // Missing echoes are NaN, which equals nothing: compare what is printed.
    let (one, three, other) = (run(1, 7), run(3, 7), run(1, 8));
    assert_eq!(format!("{one:?}"), format!("{three:?}"));
    assert_ne!(format!("{one:?}"), format!("{other:?}"));
}

#[test]
fn switching_one_fault_on_leaves_the_others_as_they_are() {
    let plain = Simulation::run(phantom("cylinder"), &resting(Noise::default())).unwrap();
    let noise = Noise::default().with_dropout_probability(0.3).with_cylinder_radius_sd_mm(1.0);
    let dropped = Simulation::run(phantom("cylinder"), &resting(noise)).unwrap();
    for (a, b) in plain.recording.frames.iter().zip(&dropped.recording.frames) {
        assert_eq!(a.world_from_sensor, b.world_from_sensor);
        for (p, q) in a.contour_mm.iter().zip(&b.contour_mm) {
            assert!(q.is_nan() || p == q);
        }
    }
}

#[test]
fn every_noise_free_wall_point_lies_on_the_wall_and_every_tip_inside() {
    for name in Shape::NAMES {
        let simulation = Simulation::run(phantom(name), &noise_free(Insertion::default())).unwrap();
        let surface = simulation.vessel.surface();
        let wall = TriMesh::new(surface.nodes_mm.clone(), surface.triangles.clone()).unwrap();
        let (mut points, mut missing) = (0, 0);
        for frame in &simulation.recording.frames {
            let tip = frame.world_from_sensor;
            assert!(wall.distance_to_local_point(tip.translation_mm, false) >= 0.5, "{name}");
            missing += frame.missing_echoes();
            for p in frame.echoes_mm() {
                let world = tip.transform_point(p.extend(0.0));
                let distance = wall.distance_to_local_point(world, false);
                assert!(distance < 1e-9, "{name}: {distance} mm off the wall");
                points += 1;
            }
        }
        assert!(missing * 20 < points, "{name}: {missing} rays without and {points} with an echo");
    }
}

#[test]
fn a_cylinder_is_seen_with_its_radius() {
    let simulation = Simulation::run(phantom("cylinder"), &noise_free(Insertion::steady())).unwrap();
    // The wall is a prism of 1.2 mm wide facets: between its in-circle and the circle of 12 mm.
    let sides = (std::f64::consts::TAU * 12.0 / 1.2_f64).ceil();
    let inner = 12.0 * (std::f64::consts::PI / sides).cos();
    for frame in &simulation.recording.frames {
        assert_eq!(frame.contour_mm.len(), 90);
        for p in &frame.contour_mm {
            assert!((inner - 1e-9..12.0 + 1e-9).contains(&p.length()), "{}", p.length());
        }
    }
}

#[test]
fn the_default_insertion_goes_at_the_published_speeds() {
    let simulation = Simulation::run(phantom("cylinder"), &noise_free(Insertion::default())).unwrap();
    let tips: Vec<_> = simulation.recording.frames.iter().map(|f| f.world_from_sensor).collect();
    // 20 mm at 2.4 mm/s and 12 Hz take 100 frames, then 30° at 4.8°/s take 75.
    for pair in tips[..100].windows(2) {
        assert!((pair[0].translation_mm.distance(pair[1].translation_mm) - 0.2).abs() < 1e-9);
    }
    let bend_deg = |k: usize| {
        let z = tips[k].rotation.z_axis;
        z.truncate().length().atan2(z.z).to_degrees()
    };
    assert!(
        bend_deg(100) < 1e-9 && (bend_deg(101) - 0.4).abs() < 1e-9 && (bend_deg(175) - 30.0).abs() < 1e-9
    );
    // How far the end of an arc of 15 mm that turns by 30° lies off the straight way.
    let angle = 30_f64.to_radians();
    let off = tips[175].translation_mm.truncate().length();
    assert!((off - 15.0 / angle * (1.0 - angle.cos())).abs() < 1e-3, "{off}");
    assert_eq!(simulation.recording.frames[12].time_s, Some(1.0));
}

#[test]
fn a_bend_that_does_not_fit_is_reduced_and_said() {
    let shape = Shape::Cylinder { radius_mm: 3.0, length_mm: 60.0 };
    let vessel = Phantom::from(shape).vessel().unwrap();
    let simulation = Simulation::run(vessel, &noise_free(Insertion::default())).unwrap();
    let reduced = simulation.reduced_bends[0];
    // 15/α (1 - cos α) = 3 - 0.5 at α = 19.3°. The wall's facets lie up to 0.06 mm inside of 3 mm, and 0.04 mm are
    // kept for what lies between the planes that were tried: 0.8° less.
    assert!((18.3..19.4).contains(&reduced.used_deg), "{reduced:?}");
    assert_eq!(reduced.asked_deg, 30.0);
}

#[test]
fn withdrawing_goes_back_to_the_start_and_rest_stays() {
    let moves = vec![
        Move::Advance { distance_mm: 24.0 },
        Move::Rest { duration_s: 1.0 },
        Move::Withdraw { distance_mm: 24.0 },
    ];
    let insertion = Insertion::default().with_moves(moves).with_repeat(false);
    let frames = Simulation::run(phantom("arch"), &noise_free(insertion)).unwrap().recording.frames;
    let at = |k: usize| frames[k].world_from_sensor.translation_mm;
    assert_eq!(frames.len(), 120 + 12 + 120 + 1);
    assert!(at(120).abs_diff_eq(at(132), 1e-9));
    assert!(at(0).distance(at(120)) > 20.0);
    assert!(at(252).abs_diff_eq(at(0), 1e-9));
}

#[test]
fn simulated_cylinders_are_the_phantom() {
    let settings = noise_free(Insertion::default()).with_cylinders(true);
    let frames = Simulation::run(phantom("cylinder"), &settings).unwrap().recording.frames;
    for frame in &frames {
        let model = frame.cylinder.expect("a cylinder");
        let world_from_cylinder = frame.world_from_sensor * model.sensor_from_cylinder();
        assert!(world_from_cylinder.rotation.x_axis.abs_diff_eq(DVec3::Z, 1e-9));
        assert!(world_from_cylinder.translation_mm.truncate().length() < 1e-9);
        assert!((model.radius_mm - 12.0).abs() < 1e-12);
    }
    let plain = Simulation::run(phantom("cylinder"), &noise_free(Insertion::steady())).unwrap();
    assert!(plain.recording.frames.iter().all(|f| f.cylinder.is_none()));
}

#[test]
fn phantoms_are_open_manifolds_with_outward_normals() {
    for name in Shape::NAMES {
        let vessel = phantom(name);
        let surface = vessel.surface();
        let topology = surface.topology();
        assert!(topology.is_oriented_manifold(), "{name}: {topology:?}");
        assert_eq!((topology.components, topology.degenerate_triangles), (1, 0), "{name}");
        // A sphere has 2, each opening takes 1: a tube has one branch and two openings.
        let openings = vessel.branches().len() + 1;
        assert_eq!(topology.boundary_loops, openings, "{name}");
        assert_eq!(topology.euler_characteristic, 2 - openings as i64, "{name}");
        let middle: Vec<DVec3> = vessel.branches().iter().flat_map(|b| b.points_mm()).copied().collect();
        for triangle in surface.triangles.iter().step_by(13) {
            let [a, b, c] = triangle.map(|n| surface.nodes_mm[n as usize]);
            let inside = (a + b + c) / 3.0 - (b - a).cross(c - a).normalize() * 0.01;
            // From behind the wall nothing of the centreline can be seen.
            let sees = |p: &DVec3| {
                let way = *p - inside;
                vessel.cast_mm(inside, way.normalize(), way.length()).is_none()
            };
            assert!(middle.iter().any(sees), "{name}: a normal into the lumen at {inside}");
        }
    }
}

/// The cylinder phantom after something was done to its wall.
fn damaged(damage: impl FnOnce(&mut Surface)) -> lumenmesh::Result<SimulatedVessel> {
    let vessel = phantom("cylinder");
    let mut surface = vessel.surface().clone();
    damage(&mut surface);
    SimulatedVessel::new(surface, vessel.branches().to_vec())
}

#[test]
fn repairs_restore_the_surface_and_are_said() {
    let whole = phantom("cylinder");
    let flipped = damaged(|s| s.triangles.iter_mut().for_each(|t| t.swap(1, 2))).unwrap();
    assert!(flipped.notes()[0].contains("turned outward"), "{:?}", flipped.notes());
    assert_eq!(flipped.surface(), whole.surface());
    let mixed = damaged(|s| s.triangles.iter_mut().step_by(9).for_each(|t| t.swap(1, 2))).unwrap();
    assert!(mixed.notes()[0].contains("the other way round"), "{:?}", mixed.notes());
    assert_eq!(mixed.surface(), whole.surface());
    let littered = damaged(|s| {
        let first = s.nodes_mm.len() as u32;
        s.nodes_mm.extend([DVec3::splat(50.0), DVec3::splat(51.0), DVec3::new(50.0, 51.0, 50.0)]);
        s.triangles.push([first, first + 1, first + 2]);
    })
    .unwrap();
    assert!(littered.notes()[0].contains("2 separate pieces"), "{:?}", littered.notes());
    assert_eq!(littered.surface(), whole.surface());
}

#[test]
fn vessels_that_cannot_be_used_are_refused_with_a_reason() {
    let message = |r: lumenmesh::Result<SimulatedVessel>| r.unwrap_err().to_string();
    let metres = message(damaged(|s| s.nodes_mm.iter_mut().for_each(|p| *p *= 1e-3)));
    assert!(metres.contains("looks like metres"), "{metres}");
    let moved = message(damaged(|s| s.nodes_mm.iter_mut().for_each(|p| p.x += 40.0)));
    assert!(moved.contains("branch 0 at 0.5 mm") && moved.contains("outside the vessel"), "{moved}");
    let sheet = message(damaged(|s| s.nodes_mm.iter_mut().for_each(|p| p.x = 15.0)));
    assert!(sheet.contains("outside the vessel"), "not a tube: {sheet}");
    assert!(message(damaged(|s| s.triangles.clear())).contains("triangles: found none"));
    assert!(message(damaged(|s| s.triangles[3] = [0, 1, 4_000_000])).contains("triangle 3"));
    assert!(message(damaged(|s| s.nodes_mm[5].y = f64::NAN)).contains("node 5"));
    let vessel = phantom("cylinder");
    assert!(
        message(SimulatedVessel::new(vessel.surface().clone(), vec![])).contains("centreline: found none")
    );
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    let message = |s: SimulationSettings| Simulation::run(phantom("cylinder"), &s).unwrap_err().to_string();
    let noise = |noise: Noise| message(SimulationSettings::default().with_noise(noise));
    let insertion = |insertion: Insertion| message(noise_free(insertion));
    let usual = Insertion::default;
    assert!(noise(Noise::none().with_contour_sd_mm(f64::NAN)).contains("noise.contour_sd_mm"));
    assert!(noise(Noise::none().with_dropout_probability(1.5)).contains("noise.dropout_probability"));
    assert!(insertion(usual().with_branch(3)).contains("insertion.branch: found 3"));
    assert!(insertion(usual().with_start_mm(500.0)).contains("100.0 mm"));
    assert!(insertion(usual().with_moves(vec![])).contains("insertion.moves"));
    let backwards = vec![Move::Advance { distance_mm: 5.0 }, Move::Withdraw { distance_mm: 6.0 }];
    assert!(insertion(usual().with_moves(backwards)).contains("-1 mm forward"));
    assert!(insertion(usual().with_clearance_mm(20.0)).contains("catheter tip at 5.0 mm"));
}

#[test]
fn settings_are_read_with_defaults_and_without_strangers() {
    let error = toml::from_str::<SimulationSettings>("[noise]\nposition_sd = 0.1\n").unwrap_err().to_string();
    assert!(error.contains("position_sd"), "{error}");
    let text =
        "[insertion]\nmoves = [{ advance = { distance_mm = 5.0 } }, { rest = { duration_s = 1.0 } }]\n";
    let settings: SimulationSettings = toml::from_str(text).unwrap();
    assert_eq!(settings.insertion.moves[1], Move::Rest { duration_s: 1.0 });
    assert_eq!(settings.noise, Noise::default());
    let back: SimulationSettings = toml::from_str(&toml::to_string(&settings).unwrap()).unwrap();
    assert_eq!(back, settings);
}

#[test]
fn every_shared_vessel_can_be_simulated_in() {
    let vessels = [
        "aorta_adult_full_steve",
        "aorta_arch_coarctation_bpm120",
        "aorto_iliac_bifurcation_vmtk",
        "coronary_tree_phantom_vukicevic",
    ];
    for name in vessels {
        let (Some(surface), Some(centreline)) =
            (shared(&format!("data/{name}.stl")), shared(&format!("data/{name}_centreline.csv")))
        else {
            continue;
        };
        let branches = Centreline::read_branches(&centreline).unwrap();
        let vessel = SimulatedVessel::new(Surface::read(&surface).unwrap(), branches).unwrap();
        assert_eq!(vessel.notes(), [] as [&str; 0], "{name}: these surfaces are sound");
        for branch in 0..vessel.branches().len() {
            let settings = noise_free(Insertion::default().with_branch(branch).with_frame_rate_hz(2.0));
            let simulation = Simulation::run(vessel.clone(), &settings).unwrap();
            let frame = &simulation.recording.frames[simulation.recording.frames.len() / 2];
            for p in frame.echoes_mm() {
                let world = frame.world_from_sensor.transform_point(p.extend(0.0));
                assert!(vessel.distance_mm(world) < 1e-9, "{name}");
            }
        }
    }
}

/// A vessel of the shared data with all its centrelines; `None` where the data are not at hand.
fn shared_vessel(name: &str) -> Option<SimulatedVessel> {
    let (surface, centreline) =
        (shared(&format!("data/{name}.stl"))?, shared(&format!("data/{name}_centreline.csv"))?);
    let branches = Centreline::read_branches(&centreline).unwrap();
    Some(SimulatedVessel::new(Surface::read(&surface).unwrap(), branches).unwrap())
}

/// The first thing that is wrong with a noise-free recording of several branches: an echo off the wall, a jump, or a label
/// that does not lie on the branch that it names.
fn fault_of_a_route(simulation: &Simulation, step_mm: f64, turn_deg: f64) -> Option<String> {
    let vessel = &simulation.vessel;
    let frames = &simulation.recording.frames;
    let rate_hz =
        1.0 / frames.windows(2).map(|f| f[1].time_s.unwrap() - f[0].time_s.unwrap()).fold(9.9, f64::min);
    for (k, (frame, place)) in frames.iter().zip(&simulation.places).enumerate() {
        let tip = frame.world_from_sensor;
        for p in frame.echoes_mm().step_by(7) {
            let off = vessel.distance_mm(tip.transform_point(p.extend(0.0)));
            if off > 1e-9 {
                return Some(format!("frame {k}: an echo {off} mm off the wall"));
            }
        }
        if frame.missing_echoes() * 2 > frame.contour_mm.len() {
            return Some(format!("frame {k}: {} echoes are missing", frame.missing_echoes()));
        }
        let line = &vessel.branches()[place.branch];
        let (middle, tangent) = line.at(place.s_mm);
        let radius = line.inscribed_radius_at_mm(place.s_mm);
        let off = middle.distance(tip.translation_mm);
        if off > 0.3 * radius || tangent.dot(tip.rotation.z_axis) < 0.7 {
            return Some(format!("frame {k}: {place:?} is {off} mm from the tip, of a radius of {radius}"));
        }
        let Some(next) = frames.get(k + 1) else { break };
        let ticks = (next.time_s.unwrap() - frame.time_s.unwrap()) * rate_hz;
        if ticks > 1.5 {
            continue;
        }
        let moved = tip.translation_mm.distance(next.world_from_sensor.translation_mm);
        let turned = tip.turn_rad(&next.world_from_sensor).to_degrees();
        if moved > step_mm || turned > turn_deg {
            return Some(format!("frame {k}: a jump of {moved} mm and {turned}° at {place:?}"));
        }
    }
    None
}

/// Steady visits at 2 mm a frame.
fn visiting(visits: &[&str]) -> Insertion {
    Insertion::steady()
        .with_visits(visits.iter().map(|v| v.parse().unwrap()).collect())
        .with_frame_rate_hz(2.4)
        .with_speed_mm_s(2.4)
}

#[test]
fn a_route_through_branches_is_smooth_and_its_labels_are_right() {
    let mut vessels: Vec<(&str, SimulatedVessel)> =
        ["bifurcation", "side_branch", "tree", "deep_tree"].map(|name| (name, phantom(name))).into();
    for name in
        ["aorta_arch_coarctation_bpm120", "aorto_iliac_bifurcation_vmtk", "coronary_tree_phantom_vukicevic"]
    {
        vessels.extend(shared_vessel(name).map(|vessel| (name, vessel)));
    }
    for (name, vessel) in vessels {
        let branches: Vec<usize> = (0..vessel.branches().len()).collect();
        let back: Vec<usize> = branches.iter().rev().copied().collect();
        for order in [branches, back] {
            let visits = order.iter().map(|&branch| Visit::new(branch, None)).collect();
            let insertion = visiting(&[]).with_visits(visits);
            let simulation = Simulation::run(vessel.clone(), &noise_free(insertion)).unwrap();
            // 1 mm a frame; the tightest way, into the smallest branch of a coronary tree, turns by 40° over its radius.
            assert_eq!(fault_of_a_route(&simulation, 1.01, 40.0), None, "{name} {order:?}");
            // Every branch is reached up to 5 mm before its end, and labelled.
            for (visit, &branch) in order.iter().enumerate() {
                let deepest = simulation.places.iter().filter(|p| p.visit == visit && p.branch == branch);
                let deepest = deepest.map(|p| p.s_mm).fold(0.0, f64::max);
                let end = vessel.branches()[branch].length_mm() - 5.0;
                assert!((end - 1.0..end + 1e-6).contains(&deepest), "{name} {branch}: {deepest} of {end} mm");
            }
        }
    }
}

#[test]
fn the_comparer_of_routes_notices_what_is_wrong() {
    let visits = visiting(&["0", "1"]);
    let sound = Simulation::run(phantom("bifurcation"), &noise_free(visits.clone())).unwrap();
    assert_eq!(fault_of_a_route(&sound, 1.01, 10.0), None);
    let fault = |damage: &dyn Fn(&mut Simulation)| {
        let mut simulation = sound.clone();
        damage(&mut simulation);
        fault_of_a_route(&simulation, 1.01, 10.0).unwrap_or_default()
    };
    let off = fault(&|s| s.recording.frames[30].world_from_sensor.translation_mm.x += 1e-6);
    assert!(off.contains("off the wall"), "{off}");
    let turn = fault(&|s| s.recording.frames.truncate(40));
    assert_eq!(turn, "", "a shorter recording is no fault");
    let gap = fault(&|s| {
        let frames = &mut s.recording.frames;
        frames.drain(20..40);
        frames.iter_mut().enumerate().for_each(|(k, f)| f.time_s = Some(k as f64));
        s.places.drain(20..40);
    });
    assert!(gap.contains("a jump of"), "{gap}");
    let label =
        fault(&|s| s.places.iter_mut().filter(|p| p.s_mm > 90.0).for_each(|p| p.branch = 1 - p.branch));
    assert!(label.contains("from the tip"), "{label}");
}

#[test]
fn ways_back_are_recorded_or_not_and_frames_are_the_same() {
    let visits = visiting(&["0:80", "1:80", "0:5"]);
    let run = |insertion: &Insertion| {
        let settings = SimulationSettings::default().with_insertion(insertion.clone());
        Simulation::run(phantom("bifurcation"), &settings).unwrap()
    };
    let (all, again) = (run(&visits), run(&visits));
    assert_eq!(format!("{:?}", all.recording), format!("{:?}", again.recording), "the same seed");
    let some = run(&visits.clone().with_record_withdrawals(false));
    let times = |s: &Simulation| s.recording.frames.iter().map(|f| f.time_s.unwrap()).collect::<Vec<_>>();
    assert!(times(&some).iter().all(|time| times(&all).contains(time)));
    for (frame, place) in some.recording.frames.iter().zip(&some.places) {
        let k = times(&all).iter().position(|&time| Some(time) == frame.time_s).unwrap();
        assert_eq!((frame, place), (&all.recording.frames[k], &all.places[k]));
    }
    // Recorded, the catheter comes back to 5 mm; unrecorded, no frame goes back within a visit.
    assert!((all.places.last().unwrap().s_mm - 5.0).abs() < 0.5);
    let backward = |s: &Simulation| {
        s.places.windows(2).filter(|p| p[0].visit == p[1].visit && p[1].s_mm < p[0].s_mm - 1e-9).count()
    };
    assert!(backward(&all) > 80 && backward(&some) <= 1, "{} {}", backward(&all), backward(&some));
}

#[test]
fn a_single_visit_is_the_insertion_into_its_branch() {
    let run = |insertion: Insertion| {
        let settings = SimulationSettings::default().with_insertion(insertion);
        Simulation::run(phantom("side_branch"), &settings).unwrap().recording
    };
    let visits = Insertion::default().with_visits(vec![Visit::new(1, Some(70.0))]);
    let branch = Insertion::default().with_branch(1).with_end_mm(Some(70.0));
    assert_eq!(format!("{:?}", run(visits)), format!("{:?}", run(branch)));
}

#[test]
fn a_branch_whose_centreline_begins_in_its_parent_is_entered_through_it() {
    // The centrelines of the phantom, cut off where they part, as other programs write them; and beside the middle.
    let whole = phantom("side_branch");
    let side = &whole.branches()[1];
    for (shift_mm, begin) in [(0.0, 36), (2.0, 36)] {
        let points: Vec<DVec3> = side.points_mm()[begin..].iter().map(|p| *p + DVec3::Y * shift_mm).collect();
        let radii = side.inscribed_radius_mm()[begin..].iter().map(|r| r - shift_mm).collect();
        let lines = vec![whole.branches()[0].clone(), Centreline::new(points, radii).unwrap()];
        let vessel = SimulatedVessel::new(whole.surface().clone(), lines).unwrap();
        for visits in [["0", "1"], ["1", "0"]] {
            let simulation = Simulation::run(vessel.clone(), &noise_free(visiting(&visits))).unwrap();
            assert_eq!(fault_of_a_route(&simulation, 1.01, 20.0), None, "{visits:?} {shift_mm}");
            let first = simulation.places[0];
            assert_eq!((first.branch, first.s_mm), (0, 5.0), "the way begins in the trunk");
        }
    }
}

#[test]
fn routes_that_can_not_be_gone_are_refused_with_a_reason() {
    let message = |vessel: &SimulatedVessel, insertion: Insertion| {
        Simulation::run(vessel.clone(), &noise_free(insertion)).unwrap_err().to_string()
    };
    let two = phantom("bifurcation");
    assert!(message(&two, visiting(&["0", "2"])).contains("insertion.visits: found branch 2"));
    assert!(message(&two, visiting(&["0", "1:500"])).contains("a way forward within the branch's"));
    assert!(message(&two, visiting(&["0", "1"]).with_start_mm(60.0)).contains("parts from the one before"));
    assert!(message(&two, visiting(&["0"]).with_branch(1)).contains("insertion.branch or insertion.end_mm"));
    assert!(message(&two, visiting(&["0:NaN"])).contains("insertion.visits.to_mm"));
    for text in ["", "a", "1:", "1:x", "-1", "1:2:3"] {
        assert!(text.parse::<Visit>().unwrap_err().to_string().contains("insertion.visits"), "{text}");
    }
    // The far half of a branch of the tree and another branch do not begin together.
    let tree = phantom("tree");
    let far = &tree.branches()[3];
    let (points, radii) = (far.points_mm()[90..].to_vec(), far.inscribed_radius_mm()[90..].to_vec());
    let lines = vec![tree.branches()[0].clone(), Centreline::new(points, radii).unwrap()];
    let apart = SimulatedVessel::new(tree.surface().clone(), lines).unwrap();
    let found = message(&apart, visiting(&["0", "1"]));
    assert!(found.contains("branch 1, which begins at") && found.contains("begins together"), "{found}");
}

#[test]
fn trees_have_murrays_radii_and_angles() {
    for (levels, ratio, angle_deg) in [(1, 1.0, None), (2, 0.8, None), (3, 0.85, None), (2, 0.7, Some(35.0))]
    {
        let tree = Tree::default()
            .with_levels(levels)
            .with_root_radius_mm(10.0)
            .with_daughter_ratio(ratio)
            .with_half_angle_deg(angle_deg);
        let vessel = Phantom::from(Shape::Tree(tree.clone())).vessel().unwrap();
        assert_eq!(vessel.notes(), [] as [&str; 0]);
        let topology = vessel.surface().topology();
        let ends = 1 << levels;
        assert_eq!(vessel.branches().len(), ends);
        assert!(topology.is_oriented_manifold() && topology.degenerate_triangles == 0);
        assert_eq!(
            (topology.components, topology.boundary_loops),
            (1, ends + 1),
            "levels {levels}, ratio {ratio}"
        );
        // At their ends the tubes are straight and far from others: the wall's facets lie within 0.1 mm of the radius.
        let radius = |branch: usize| {
            let line = &vessel.branches()[branch];
            line.inscribed_radius_at_mm(line.length_mm() - 3.0)
        };
        let cubes: f64 = (0..ends).map(|branch| radius(branch).powi(3)).sum();
        assert!((cubes.cbrt() - 10.0).abs() < 1e-6, "levels {levels}, ratio {ratio}: {}", cubes.cbrt());
        assert!((radius(1) / radius(0) - ratio).abs() < 1e-9);
        let line = &vessel.branches()[0];
        let near_end = line.frame(line.length_mm() - 3.0);
        for p in Probe::default().ranges_mm(&vessel, &near_end) {
            assert!((p - radius(0)).abs() < 0.15, "{p} mm, {} expected", radius(0));
        }
        // The angle between two sisters.
        let [a, b] = [0, 1].map(|branch| {
            let line = &vessel.branches()[branch];
            line.at(line.length_mm()).1
        });
        let cube = 1.0 + ratio.powi(3);
        let own = [1.0 / cube.cbrt(), ratio / cube.cbrt()];
        let murray =
            |r: f64, other: f64| ((1.0 + r.powi(4) - other.powi(4)) / (2.0 * r * r)).acos().to_degrees();
        let expected = angle_deg.map_or(murray(own[0], own[1]) + murray(own[1], own[0]), |angle| 2.0 * angle);
        let between = a.angle_between(b).to_degrees();
        assert!((between - expected).abs() < 0.1, "{between}°, {expected}° expected");
    }
}

#[test]
fn trees_that_can_not_be_are_refused() {
    let message = |tree: Tree| Phantom::from(Shape::Tree(tree)).vessel().map(|_| ()).unwrap_err().to_string();
    assert!(message(Tree::default().with_levels(4)).contains("levels: found 4, expected 1 to 3"));
    assert!(message(Tree::default().with_levels(0)).contains("levels: found 0"));
    assert!(message(Tree::default().with_daughter_ratio(0.2)).contains("daughter_ratio"));
    assert!(message(Tree::default().with_root_radius_mm(2.0).with_levels(3)).contains("smallest radius"));
    assert!(message(Tree::default().with_half_angle_deg(Some(80.0))).contains("half_angle_deg"));
    // A lattice too coarse for the smallest tubes tears them.
    let coarse = Phantom::from(Shape::Tree(Tree::default().with_levels(3))).with_edge_mm(10.0);
    let torn = coarse.vessel().map(|_| ()).unwrap_err().to_string();
    assert!(torn.contains("vessel.shape.tree: found a wall of"), "{torn}");
    let text = "shape.tree = { levels = 3, half_angle_deg = 35.0 }\n";
    let phantom: Phantom = toml::from_str(text).unwrap();
    assert_eq!(phantom.shape, Shape::Tree(Tree::default().with_levels(3).with_half_angle_deg(Some(35.0))));
}

#[test]
fn centreline_files_read_back_equal_or_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let message = |text: &str| {
        let path = folder.path().join("centreline.csv");
        std::fs::write(&path, text).unwrap();
        Centreline::read_branches(&path).unwrap_err().to_string()
    };
    let lacking = message("branch,x_mm,y_mm,z_mm\n0,1,2,3\n");
    assert!(lacking.contains("r_inscribed_mm: found columns branch, x_mm, y_mm, z_mm"), "{lacking}");
    assert!(message("0,1,2,3,4\n").contains("branch: found no line of column names"));
    assert!(message("branch,x_mm,y_mm,z_mm,r_inscribed_mm\n").contains("rows: found none"));
    let branches = phantom("bifurcation").branches().to_vec();
    let written = folder.path().join("written.csv");
    Centreline::write_branches(&branches, &written).unwrap();
    assert_eq!(Centreline::read_branches(&written).unwrap(), branches);
    let one = message("branch,x_mm,y_mm,z_mm,r_inscribed_mm\n4,1,2,3,1\n");
    assert!(one.contains("branch 4: centreline: found 1 points"), "{one}");
    let word = message("branch,x_mm,y_mm,z_mm,r_inscribed_mm\n0,1,2,3,1\n0,here,2,3,1\n");
    assert!(word.contains("line 3: x_mm: found \"here\", expected a number"), "{word}");
}

#[test]
fn tracker_noise_is_that_of_the_sensor_that_lay_still() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses.csv");
    // Two poses of a sensor at ±1 mm in x and ±0.01 rad about z, twice, one given as -q; one pose is not valid.
    let (sin, cos) = 0.005_f64.sin_cos();
    let text = format!(
        "sensor,ok,x_mm,y_mm,z_mm,qx,qy,qz,qw\n\
         still,1,9,5,0,0,0,{sin},{cos}\nstill,1,11,5,0,0,0,-{sin},{cos}\n\
         still,1,9,5,0,0,0,-{sin},-{cos}\nstill,1,11,5,0,0,0,-{sin},{cos}\nstill,0,0,0,0,0,0,0,1\n\
         moved,1,0,0,0,0,0,0,1\nmoved,1,50,0,0,0,0,0,1\nmoved,1,0,0,0,0,0,0,1\n"
    );
    std::fs::write(&path, text).unwrap();
    let noise = TrackerNoise::read(&path, None).unwrap();
    assert_eq!((noise.sensor.as_str(), noise.poses), ("still", 4));
    // Squares of 4 deviations of 1 over 3 axes and 3 degrees of freedom.
    let sd = (4.0_f64 / 9.0).sqrt();
    assert!((noise.position_sd_mm - sd).abs() < 1e-12, "{noise:?}");
    assert!((noise.rotation_sd_deg - (0.01 * sd).to_degrees()).abs() < 1e-9, "{noise:?}");
    let message = |sensor: &str| TrackerNoise::read(&path, Some(sensor)).unwrap_err().to_string();
    assert!(message("moved").contains("positions 50.0 mm apart"), "{}", message("moved"));
    assert!(message("other").contains("one of moved, still"), "{}", message("other"));
}

#[cfg(feature = "cli")]
#[test]
fn the_command_writes_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| crate::support::lumenmesh(arguments, folder.path());
    let (status, out, err) = run(&[
        "simulate",
        "--vessel",
        "cylinder",
        "--steady",
        "--seed",
        "5",
        "--dropouts",
        "0.1",
        "--cylinders",
        "-o",
        "pullback",
        "--truth",
        "wall.vtp",
        "--truth-recording",
        "truth.mat",
        "--json",
    ]);
    assert_eq!((status, err.as_str()), (0, ""));
    let summary: serde_json::Value = serde_json::from_str(&out).unwrap();
    let recording = Recording::read(&folder.path().join("pullback")).unwrap();
    let missing: usize = recording.frames.iter().map(Frame::missing_echoes).sum();
    assert_eq!(summary["frames"], recording.frames.len());
    assert_eq!(summary["missing_echoes"], missing);
    assert_eq!(summary["settings"]["noise"]["seed"], 5);
    assert!(recording.frames.iter().all(|f| f.cylinder.is_some()));
    let truth = Recording::read(&folder.path().join("truth.mat")).unwrap();
    assert_eq!(truth.frames.len(), recording.frames.len());
    assert_eq!(&Surface::read(&folder.path().join("wall.vtp")).unwrap(), phantom("cylinder").surface());

    let visits = "simulate --vessel bifurcation --steady --branches 0:70,1:75 --record-withdrawals no --truth-branches b.csv";
    let (status, out, err) = run(&[visits.split(' ').collect(), vec!["-o", "two.mat"]].concat());
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains("branches 0 up to 70 mm, 1 up to 75 mm (of 2)"), "{out}");
    let places = std::fs::read_to_string(folder.path().join("b.csv")).unwrap();
    let frames = Recording::read(&folder.path().join("two.mat")).unwrap().frames.len();
    assert!(places.starts_with("frame,time_s,visit,branch,s_mm\n0,0,0,0,5\n"), "{places}");
    assert_eq!(places.lines().count(), frames + 1);
    assert!(places.lines().last().unwrap().contains(",1,1,7"), "{places}");
    let (status, _, err) = run(&["simulate", "--branches", "0,x", "-o", "other"]);
    assert!(status == 2 && err.contains("found x, expected a branch"), "{err}");

    std::fs::write(folder.path().join("settings.toml"), "[noise]\nsed = 5\n").unwrap();
    let (status, _, err) = run(&["simulate", "--config", "settings.toml", "-o", "other"]);
    assert!(status == 1 && err.contains("settings.toml") && err.contains("sed"), "{err}");
    let (status, _, err) = run(&["simulate", "--vessel", "tube", "-o", "other"]);
    assert!(status == 1 && err.contains("found tube, expected one of aorta"), "{err}");
    let (status, _, err) = run(&["simulate", "--vessel", "wall.vtp", "-o", "other"]);
    assert!(status == 1 && err.contains("--centreline"), "{err}");
    assert!(!folder.path().join("other").exists());
}
