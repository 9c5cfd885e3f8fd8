//! What is wrong with simulated recordings, measured.

use glam::{DQuat, DVec2, DVec3};
use lumenmesh::evaluate::{SystematicErrors, Truth, evaluate};
use lumenmesh::geometry::Pose;
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{
    Artefacts, Burst, CalibrationFaults, ContourFaults, FaultKind, Faults, Insertion, Motion, Move, Noise,
    Phantom, PointOrder, Probe, Sampling, ShadowFill, Shape, Simulation, SimulationSettings, TrackerFaults,
};

/// A tip that rests for so long in the middle of a cylinder of 12 mm, without noise.
fn resting(faults: Faults, duration_s: f64) -> SimulationSettings {
    let insertion = Insertion::default()
        .with_start_mm(40.0)
        .with_moves(vec![Move::Rest { duration_s }])
        .with_repeat(false);
    SimulationSettings::default().with_insertion(insertion).with_noise(Noise::none()).with_faults(faults)
}

fn run(settings: &SimulationSettings) -> Simulation {
    let shape: Shape = "cylinder".parse().unwrap();
    Simulation::run(Phantom::from(shape).vessel().unwrap(), settings).unwrap()
}

fn faulty(faults: Faults, duration_s: f64) -> Simulation {
    run(&resting(faults, duration_s))
}

fn pairs(simulation: &Simulation) -> impl Iterator<Item = (&Frame, &Frame)> {
    simulation.recording.frames.iter().zip(&simulation.truth_recording.frames)
}

/// Of every frame, by how much its pose is off: position, mm, and rotation vector, degrees.
fn pose_errors(simulation: &Simulation) -> Vec<(DVec3, DVec3)> {
    pairs(simulation)
        .map(|(seen, truth)| {
            let (seen, truth) = (seen.world_from_sensor, truth.world_from_sensor);
            let turn = truth.rotation.transpose() * seen.rotation;
            let turn = DQuat::from_mat3(&turn).to_scaled_axis().to_array().map(f64::to_degrees);
            (seen.translation_mm - truth.translation_mm, DVec3::from(turn))
        })
        .collect()
}

/// Mean of the products of values `lag` apart, by that of their squares.
fn correlation(values: &[f64], lag: usize) -> f64 {
    let products = values.iter().zip(&values[lag..]).map(|(a, b)| a * b).sum::<f64>();
    let squares = values.iter().map(|a| a * a).sum::<f64>();
    products / (values.len() - lag) as f64 * values.len() as f64 / squares
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn near(found: f64, expected: f64, within: f64) -> bool {
    (found - expected).abs() < within
}

#[test]
fn a_smooth_contour_error_has_its_size_and_its_reach_along_the_wall_and_in_time() {
    let field = |contour: ContourFaults| {
        let simulation = faulty(Faults::default().with_contour(contour), 400.0);
        let radial = |(seen, truth): (&Frame, &Frame)| {
            let rays = seen.contour_mm.iter().zip(&truth.contour_mm);
            rays.map(|(p, q)| p.length() - q.length()).collect::<Vec<_>>()
        };
        pairs(&simulation).map(radial).collect::<Vec<_>>()
    };
    let errors = field(
        ContourFaults::default().with_smooth_sd_mm(0.6).with_smooth_angle_deg(40.0).with_smooth_time_s(1.0),
    );
    // 400 s hold some 200 independent fields of 4 independent values: 4 % of the size, 0.05 of a correlation.
    assert!(near(rms(&errors.concat()), 0.6, 0.06), "{}", rms(&errors.concat()));
    let along = |errors: &[Vec<f64>], rays: usize| {
        let products: f64 =
            errors.iter().map(|e| (0..90).map(|j| e[j] * e[(j + rays) % 90]).sum::<f64>()).sum();
        products / errors.concat().iter().map(|e| e * e).sum::<f64>()
    };
    // 40° are 10 rays.
    assert!(near(along(&errors, 10), (-0.5_f64).exp(), 0.08), "{}", along(&errors, 10));
    assert!(near(along(&errors, 20), (-2.0_f64).exp(), 0.08), "{}", along(&errors, 20));
    let in_time = |errors: &[Vec<f64>], frames: usize| {
        let rays = (0..90).map(|j| correlation(&errors.iter().map(|e| e[j]).collect::<Vec<_>>(), frames));
        rays.sum::<f64>() / 90.0
    };
    assert!(near(in_time(&errors, 12), (-1.0_f64).exp(), 0.1), "{}", in_time(&errors, 12));
    // Without a reach in time every frame has its own; a shorter one along the wall is told from this one.
    let other = field(
        ContourFaults::default().with_smooth_sd_mm(0.6).with_smooth_angle_deg(20.0).with_smooth_time_s(0.0),
    );
    assert!(near(in_time(&other, 1), 0.0, 0.05), "{}", in_time(&other, 1));
    assert!(!near(along(&other, 10), (-0.5_f64).exp(), 0.08), "the comparer takes 20° for 40°");
    assert!(near(along(&other, 5), (-0.5_f64).exp(), 0.05), "{}", along(&other, 5));
}

/// Angles of the rays whose echoes are not on the wall, degrees.
fn off_the_wall(seen: &Frame, truth: &Frame) -> Vec<f64> {
    let rays = seen.contour_mm.iter().zip(&truth.contour_mm).enumerate();
    rays.filter(|(_, (p, q))| p.is_nan() || p.distance(**q) > 1e-9).map(|(j, _)| j as f64 * 4.0).collect()
}

#[test]
fn shadows_are_as_wide_as_asked_for_fixed_or_turning_empty_or_closed_by_a_chord() {
    let shadow = |turn: f64, fill: ShadowFill| {
        let artefacts =
            Artefacts::default().with_shadow_deg(60.0).with_shadow_turn_deg_s(turn).with_shadow_fill(fill);
        faulty(Faults::default().with_artefacts(artefacts), 5.0)
    };
    for (turn, fill) in [(0.0, ShadowFill::Empty), (20.0, ShadowFill::Empty), (-20.0, ShadowFill::Chord)] {
        for (k, (seen, truth)) in pairs(&shadow(turn, fill)).enumerate() {
            let angles = off_the_wall(seen, truth);
            assert_eq!(angles.len(), 15, "60° of rays every 4°, frame {k}");
            let start = 120.0 + turn * k as f64 / 12.0;
            for angle in angles {
                assert!((angle - start + 1e-9).rem_euclid(360.0) < 60.0 + 1e-6, "frame {k}: {angle}");
            }
            let missing = if fill == ShadowFill::Empty { 15 } else { 0 };
            assert_eq!(seen.missing_echoes(), missing);
        }
    }
    // Points of the chord lie on the line between the echoes beside the shadow: rays 29 and 45.
    let simulation = shadow(0.0, ShadowFill::Chord);
    let contour = &simulation.recording.frames[7].contour_mm;
    let (a, b) = (contour[29], contour[45]);
    for p in &contour[30..45] {
        assert!((b - a).perp_dot(*p - a).abs() < 1e-9 && (b - a).dot(*p - a) > 0.0);
        assert!(p.length() < 12.0 - 0.1);
    }
}

#[test]
fn ring_down_has_its_radius_and_its_arc() {
    let artefacts =
        Artefacts::default().with_ring_down_deg(70.0).with_ring_down_mm(4.0).with_ring_down_turn_deg_s(10.0);
    let simulation = faulty(Faults::default().with_artefacts(artefacts), 20.0);
    let mut radii = Vec::new();
    for (k, (seen, truth)) in pairs(&simulation).enumerate() {
        let angles = off_the_wall(seen, truth);
        assert!((17..=18).contains(&angles.len()), "70° of rays every 4°");
        let start = 90.0 + 10.0 * k as f64 / 12.0;
        for angle in angles {
            assert!((angle - start + 1e-9).rem_euclid(360.0) < 70.0 + 1e-6, "frame {k}: {angle}");
            radii.push(seen.contour_mm[(angle / 4.0).round() as usize].length() / 4.0 - 1.0);
        }
    }
    let mean = radii.iter().sum::<f64>() / radii.len() as f64;
    assert!(near(mean, 0.0, 0.003) && near(rms(&radii), 0.03, 0.002), "{mean} {}", rms(&radii));
}

#[test]
fn bursts_take_their_share_of_the_frames_and_have_their_shape() {
    let bursts = |burst: Burst| {
        let artefacts = Artefacts::default().with_burst_share(0.2).with_burst_s(1.0).with_burst(burst);
        faulty(Faults::default().with_artefacts(artefacts), 1000.0)
    };
    for (burst, ratios) in [
        (Burst::Small, [0.55; 2]),
        (Burst::Large, [1.45; 2]),
        (Burst::Media, [1.15; 2]),
        (Burst::Shape, [1.4, 0.6]),
    ] {
        let simulation = bursts(burst);
        let failed: Vec<bool> =
            pairs(&simulation).map(|(seen, truth)| off_the_wall(seen, truth).len() > 45).collect();
        let share = failed.iter().filter(|&&f| f).count() as f64 / failed.len() as f64;
        // Some 200 bursts: one standard error is 1.3 %.
        assert!(near(share, 0.2, 0.05), "{burst:?}: {share}");
        let starts = failed.windows(2).filter(|f| !f[0] && f[1]).count();
        let length_s = share * 1000.0 / starts as f64;
        assert!(near(length_s, 1.0, 0.15), "{burst:?}: {length_s} s");
        let k = failed.iter().position(|&f| f).unwrap();
        let sizes = simulation.recording.frames[k].contour_mm.iter().map(|p| p.length() / 12.0);
        let (low, high) = sizes.fold((9.0_f64, 0.0_f64), |(low, high), s| (low.min(s), high.max(s)));
        let [most, least] = ratios;
        assert!(near(high, most, 0.02) && near(low, least, 0.02), "{burst:?}: {low} to {high}");
    }
}

#[test]
fn slow_tracker_errors_have_their_size_and_their_memory() {
    let tracker = TrackerFaults::default()
        .with_slow_position_sd_mm(0.8)
        .with_slow_rotation_sd_deg(1.5)
        .with_memory_s(1.0);
    let settings = resting(Faults::default().with_tracker(tracker), 2000.0);
    let errors = pose_errors(&run(&settings.with_probe(Probe::default().with_rays(1))));
    for axis in 0..3 {
        let shifts: Vec<f64> = errors.iter().map(|(p, _)| p[axis]).collect();
        let turns: Vec<f64> = errors.iter().map(|(_, r)| r[axis]).collect();
        // 1000 independent values: 2 to 3 % of the size, 0.03 of a correlation.
        assert!(
            near(rms(&shifts), 0.8, 0.08) && near(rms(&turns), 1.5, 0.15),
            "{} {}",
            rms(&shifts),
            rms(&turns)
        );
        for (frames, expected) in
            [(1, (-1.0_f64 / 12.0).exp()), (12, (-1.0_f64).exp()), (36, (-3.0_f64).exp())]
        {
            assert!(near(correlation(&shifts, frames), expected, 0.1), "{}", correlation(&shifts, frames));
            assert!(near(correlation(&turns, frames), expected, 0.1), "{}", correlation(&turns, frames));
        }
        assert!(!near(correlation(&shifts, 12), (-0.5_f64).exp(), 0.1), "the comparer takes 1 s for 2 s");
    }
}

#[test]
fn shakes_glitches_freezes_and_slow_trackers_do_what_they_say() {
    let errors = |tracker: TrackerFaults| {
        let tip = resting(Faults::default().with_tracker(tracker), 50.0);
        pose_errors(&run(&tip)).into_iter().map(|(p, _)| p).collect::<Vec<_>>()
    };
    let shake = errors(TrackerFaults::default().with_shake_mm(0.7).with_shake_hz(1.0));
    // At 12 frames a second, frame 3 of a vibration of 1 Hz is at one end and frame 9 at the other.
    assert!(shake[0].length() < 1e-12 && near(shake[3].length(), 0.7, 1e-9));
    assert!((shake[3] + shake[9]).length() < 1e-9);

    let glitches = errors(TrackerFaults::default().with_glitches(5).with_glitch_mm(20.0));
    let thrown: Vec<f64> = glitches.iter().map(|p| p.length()).filter(|&d| d > 1e-9).collect();
    assert!(thrown.len() == 5 && thrown.iter().all(|&d| near(d, 20.0, 1e-9)), "{thrown:?}");
    let all = errors(TrackerFaults::default().with_glitches(10_000));
    assert!(all[0].length() < 1e-9 && all[1..].iter().all(|p| near(p.length(), 30.0, 1e-9)));

    let advancing = |tracker: TrackerFaults| {
        let settings = SimulationSettings::default()
            .with_insertion(Insertion::steady())
            .with_faults(Faults::default().with_tracker(tracker));
        run(&settings).recording.frames
    };
    // Poses repeat to the last bit, with their noise; contours do not.
    let repeats = |frames: &[Frame]| -> Vec<usize> {
        let same = |w: &[Frame]| w[0].world_from_sensor == w[1].world_from_sensor;
        assert!(frames.windows(2).all(|w| w[0].contour_mm != w[1].contour_mm));
        frames.windows(2).enumerate().filter(|(_, w)| same(w)).map(|(k, _)| k).collect()
    };
    assert!(repeats(&advancing(TrackerFaults::default())).is_empty());
    let frozen = repeats(&advancing(TrackerFaults::default().with_freezes(1).with_freeze_s(2.0)));
    assert!(frozen.len() == 24 && frozen.windows(2).all(|k| k[1] == k[0] + 1), "{frozen:?}");
    let slow = repeats(&advancing(TrackerFaults::default().with_rate_hz(4.0)));
    let expected: Vec<usize> =
        (0..advancing(TrackerFaults::default()).len() - 1).filter(|k| k % 3 != 2).collect();
    assert_eq!(slow, expected, "of three frames two have the pose of the first");
}

#[test]
fn wrong_calibrations_are_wrong_by_what_was_asked_for() {
    let calibration = CalibrationFaults::default()
        .with_offset_mm([1.0, -2.0, 0.5])
        .with_rotation_deg([0.0, 3.0, 0.0])
        .with_sound_speed(1.05);
    let settings = resting(Faults::default().with_calibration(calibration), 2.0);
    let bent = settings.insertion.clone().with_moves(vec![Move::Bend { angle_deg: 20.0 }]);
    for (k, (seen, truth)) in pairs(&run(&settings.with_insertion(bent))).enumerate() {
        // In the probe's own axes, whichever way it looks.
        let off = truth.world_from_sensor.inverse() * seen.world_from_sensor;
        assert!(off.translation_mm.abs_diff_eq(DVec3::new(1.0, -2.0, 0.5), 1e-9), "frame {k}");
        let turn = DQuat::from_mat3(&off.rotation).to_scaled_axis();
        assert!(turn.abs_diff_eq(DVec3::Y * 3_f64.to_radians(), 1e-9), "frame {k}");
        for (p, q) in seen.contour_mm.iter().zip(&truth.contour_mm) {
            assert!(p.abs_diff_eq(*q * 1.05, 1e-9));
        }
    }
}

#[test]
fn the_size_of_what_a_recording_cannot_show_is_that_of_the_error() {
    let vessel = || Phantom::from("arch".parse::<Shape>().unwrap()).vessel().unwrap();
    let base = || {
        SimulationSettings::default()
            .with_insertion(Insertion::steady().with_frame_rate_hz(6.0))
            .with_noise(Noise::none())
    };
    let wall =
        |recording: &Recording| Reconstructor::new(Settings::default()).run(recording).unwrap().surface();
    let clean = Simulation::run(vessel(), &base()).unwrap();
    let truth = Truth::new(clean.vessel.surface().clone()).unwrap();
    let sizes =
        SystematicErrors::of(&clean.recording, Pose::IDENTITY, &wall(&clean.recording)).unwrap().unwrap();
    let moved = |calibration: CalibrationFaults| {
        let settings = base().with_faults(Faults::default().with_calibration(calibration));
        let recording = Simulation::run(vessel(), &settings).unwrap().recording;
        // At its ends the wall reaches beyond the truth, or not so far.
        let errors = evaluate(&wall(&recording), &truth).unwrap().error_mm;
        let inner = &errors[errors.len() / 10..errors.len() * 9 / 10];
        rms(inner)
    };
    let usual = CalibrationFaults::default;
    let offset = |axis: usize, size: f64| {
        let mut offset_mm = [0.0; 3];
        offset_mm[axis] = size;
        moved(usual().with_offset_mm(offset_mm))
    };
    for (found, predicted) in [
        (offset(0, 1.0), sizes.offset_mm_per_mm[0]),
        (offset(1, 1.0), sizes.offset_mm_per_mm[1]),
        (moved(usual().with_rotation_deg([3.0, 0.0, 0.0])), 3.0 * sizes.rotation_mm_per_deg[0]),
        (moved(usual().with_sound_speed(1.03)), 3.0 * sizes.sound_speed_mm_per_percent),
    ] {
        assert!(near(found, predicted, 0.1 * predicted + 0.02), "{found} mm, {predicted} mm predicted");
    }
    // Along the vessel and about its axis a round tube moves into itself.
    assert!(sizes.offset_mm_per_mm[2] < 0.05 && sizes.rotation_mm_per_deg[2] < 0.01, "{sizes:?}");
    assert!(near(sizes.offset_mm_per_mm[0], 0.5_f64.sqrt(), 0.05), "half of the wall faces x: {sizes:?}");
    assert!(near(sizes.sound_speed_mm_per_percent, 0.1, 0.005), "1 % of 10 mm: {sizes:?}");
    assert!(!near(offset(0, 2.0), sizes.offset_mm_per_mm[0], 0.1), "the comparer takes 2 mm for 1");
    // A recording that has nothing to do with the wall says nothing.
    let elsewhere =
        Simulation::run(Phantom::from("frustum".parse::<Shape>().unwrap()).vessel().unwrap(), &base());
    let mut elsewhere = elsewhere.unwrap().recording;
    elsewhere.frames.iter_mut().for_each(|f| f.world_from_sensor.translation_mm.y += 500.0);
    assert_eq!(SystematicErrors::of(&elsewhere, Pose::IDENTITY, clean.vessel.surface()).unwrap(), None);
}

#[test]
fn breath_and_heart_move_vessel_and_catheter_together() {
    let motion = Motion::default()
        .with_breathing_mm([3.0, 0.0, 1.0])
        .with_breathing_hz(0.25)
        .with_heart_beat_mm([0.0, 0.8, 0.0]);
    let mut settings = resting(Faults::default().with_motion(motion), 8.0);
    settings.noise.pulsation_rate_hz = 1.0;
    let simulation = run(&settings);
    let off: Vec<DVec3> = pose_errors(&simulation).into_iter().map(|(p, _)| p).collect();
    // A breath takes 48 frames and a beat 12: frame 24 is at the breath's end and between two beats.
    assert!(off[0].length() < 1e-12 && off[48].length() < 1e-9);
    assert!(off[24].abs_diff_eq(DVec3::new(3.0, 0.0, 1.0), 1e-9), "{}", off[24]);
    assert!(near(off[6].y, 0.8, 1e-9) && near(off[12].y, 0.0, 1e-9));
    assert!(pairs(&simulation).all(|(seen, truth)| seen.contour_mm == truth.contour_mm));
}

#[test]
fn frames_are_repeated_and_points_put_in_another_order() {
    let sampled = |sampling: Sampling| faulty(Faults::default().with_sampling(sampling), 3.0);
    let plain = sampled(Sampling::default());
    let repeated = sampled(Sampling::default().with_repeats(5));
    assert_eq!(repeated.recording.frames.len(), 5 * plain.recording.frames.len());
    assert_eq!(repeated.places.len(), repeated.recording.frames.len());
    for (k, frame) in repeated.recording.frames.iter().enumerate() {
        let source = &plain.recording.frames[k / 5];
        assert_eq!(
            (&frame.contour_mm, frame.world_from_sensor),
            (&source.contour_mm, source.world_from_sensor)
        );
        assert!(near(frame.time_s.unwrap(), k as f64 / 60.0, 1e-9));
    }
    let reversed = sampled(Sampling::default().with_point_order(PointOrder::Reversed));
    let shuffled = sampled(Sampling::default().with_point_order(PointOrder::Shuffled));
    let sorted = |frame: &Frame| {
        let mut points: Vec<[u64; 2]> =
            frame.contour_mm.iter().map(|p| p.to_array().map(f64::to_bits)).collect();
        points.sort_unstable();
        points
    };
    for (k, frame) in plain.recording.frames.iter().enumerate() {
        let back: Vec<DVec2> = reversed.recording.frames[k].contour_mm.iter().rev().copied().collect();
        assert_eq!(back, frame.contour_mm);
        assert_ne!(shuffled.recording.frames[k].contour_mm, frame.contour_mm);
        assert_eq!(sorted(&shuffled.recording.frames[k]), sorted(frame));
    }
    let order = |k: usize| shuffled.recording.frames[k].contour_mm.clone();
    assert_ne!(order(3), order(4), "another order in every frame");
}

#[test]
fn every_kind_changes_the_recording_alone_and_does_not_depend_on_threads() {
    let steady = || {
        SimulationSettings::default()
            .with_insertion(Insertion::steady())
            .with_probe(Probe::default().with_rays(36))
    };
    let plain = run(&steady());
    let text = |recording: &Recording| format!("{recording:?}");
    for kind in FaultKind::ALL {
        let mut settings = steady();
        kind.apply(&mut settings, 12.0);
        let with_threads = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&settings))
        };
        let (one, three) = (with_threads(1), with_threads(3));
        assert_eq!(text(&one.recording), text(&three.recording), "{}", kind.name);
        assert_ne!(text(&one.recording), text(&plain.recording), "{}", kind.name);
        if !["repeated-frames", "few-rays", "many-rays"].contains(&kind.name) {
            assert_eq!(text(&one.truth_recording), text(&plain.truth_recording), "{}", kind.name);
        }
        assert!(!kind.what.is_empty() && FaultKind::named(kind.name).is_some());
    }
    assert!(FaultKind::named("none").is_none());
}

#[test]
fn switching_one_fault_on_leaves_another_as_it_is() {
    let slow = TrackerFaults::default().with_slow_position_sd_mm(0.5);
    let alone = faulty(Faults::default().with_tracker(slow.clone()), 20.0);
    let artefacts = Artefacts::default().with_burst_share(0.3).with_ring_down_deg(40.0);
    let sampling = Sampling::default().with_point_order(PointOrder::Shuffled);
    let more = Faults::default()
        .with_tracker(slow.with_glitches(3))
        .with_artefacts(artefacts)
        .with_sampling(sampling)
        .with_contour(ContourFaults::default().with_smooth_sd_mm(0.3));
    let together = faulty(more, 20.0);
    let poses = alone.recording.frames.iter().zip(&together.recording.frames);
    let thrown = poses.filter(|(a, b)| a.world_from_sensor != b.world_from_sensor).count();
    assert_eq!(thrown, 3);
}

#[test]
fn faults_out_of_range_are_refused_by_name() {
    let message = |text: &str| {
        let settings = toml::from_str::<SimulationSettings>(text);
        match settings {
            Ok(settings) => settings.validate().map_or_else(|e| e.to_string(), |()| String::new()),
            Err(error) => error.to_string(),
        }
    };
    assert_eq!(message("[faults.tracker]\nglitches = 3\n"), "");
    for (text, named) in [
        ("[faults.contour]\nsmooth_sd_mm = nan\n", "faults.contour.smooth_sd_mm"),
        ("[faults.contour]\nsmooth_angle_deg = 0.0\n", "faults.contour.smooth_angle_deg"),
        ("[faults.artefacts]\nburst_share = 1.0\n", "faults.artefacts.burst_share"),
        ("[faults.artefacts]\nshadow_fill = \"full\"\n", "shadow_fill"),
        ("[faults.tracker]\nfreeze_s = -1.0\n", "faults.tracker.freeze_s"),
        ("[faults.calibration]\noffset_mm = [1.0, 2.0]\n", "offset_mm"),
        ("[faults.calibration]\nsound_speed = 0.0\n", "faults.calibration.sound_speed"),
        ("[faults.motion]\nbreathing_mm = [0.0, inf, 0.0]\n", "faults.motion"),
        ("[faults.sampling]\nrepeats = 0\n", "faults.sampling.repeats: found 0"),
        ("[faults.other]\n", "other"),
    ] {
        assert!(message(text).contains(named), "{text}: {}", message(text));
    }
    let endless = resting(Faults::default().with_sampling(Sampling::default().with_repeats(100)), 9e4);
    let vessel = Phantom::from("cylinder".parse::<Shape>().unwrap()).vessel().unwrap();
    let error = Simulation::run(vessel, &endless).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("probe.rays") && error.contains("points in all"), "{error}");
}

#[cfg(feature = "cli")]
#[test]
fn flags_and_settings_files_make_the_same_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| crate::support::lumenmesh(arguments, folder.path());
    let settings = "[insertion]\nmoves = [{ advance = { distance_mm = 20.0 } }]\n[faults]\n\
        contour = { smooth_sd_mm = 0.5, smooth_angle_deg = 35.0, smooth_time_s = 0.7 }\n\
        artefacts = { shadow_deg = 50.0, shadow_fill = \"chord\", shadow_turn_deg_s = -5.0, ring_down_deg = 30.0, \
        ring_down_mm = 3.0, ring_down_turn_deg_s = 4.0, burst_share = 0.1, burst = \"media\", burst_s = 0.5 }\n\
        tracker = { slow_position_sd_mm = 0.6, slow_rotation_sd_deg = 0.9, memory_s = 2.0, shake_mm = 0.2, shake_hz = 2.5, \
        glitches = 2, glitch_mm = 25.0, freezes = 1, freeze_s = 1.5, rate_hz = 6.0 }\n\
        calibration = { offset_mm = [1.0, 0.0, -0.5], rotation_deg = [0.0, -2.0, 0.0], sound_speed = 1.02 }\n\
        motion = { breathing_mm = [1.0, 0.0, 2.0], breathing_hz = 0.3, heart_beat_mm = [-0.5, 0.0, 0.0] }\n\
        sampling = { repeats = 2, point_order = \"reversed\" }\n";
    std::fs::write(folder.path().join("settings.toml"), settings).unwrap();
    let flags = "simulate --vessel cylinder --steady --smooth-noise 0.5 --smooth-angle 35 --smooth-time 0.7 --shadow 50 \
        --shadow-fill chord --shadow-turn -5 --ring-down 30 --ring-down-radius 3 --ring-down-turn 4 --bursts 0.1 \
        --burst media --burst-length 0.5 --slow-position-noise 0.6 --slow-rotation-noise 0.9 --tracker-memory 2 \
        --shake 0.2 --shake-rate 2.5 --glitches 2 --glitch-size 25 --freezes 1 --freeze-length 1.5 --tracker-rate 6 \
        --offset-error 1,0,-0.5 --turn-error 0,-2,0 --sound-speed 1.02 --breathing 1,0,2 --breathing-rate 0.3 \
        --heart-beat -0.5,0,0 --repeats 2 --point-order reversed -o flags";
    let (status, _, err) = run(&flags.split_whitespace().collect::<Vec<_>>());
    assert_eq!((status, err.as_str()), (0, ""));
    let (status, _, err) =
        run(&["simulate", "--vessel", "cylinder", "--config", "settings.toml", "-o", "file"]);
    assert_eq!((status, err.as_str()), (0, ""));
    let bytes = |name: &str, file: &str| std::fs::read(folder.path().join(name).join(file)).unwrap();
    for file in ["poses.csv", "contours.csv"] {
        assert!(bytes("flags", file) == bytes("file", file), "{file}");
    }
    // Each flag matters: without one of them the bytes are others.
    let (status, ..) = run(&[
        "simulate",
        "--vessel",
        "cylinder",
        "--config",
        "settings.toml",
        "--shake",
        "0",
        "-o",
        "other",
    ]);
    assert!(status == 0 && bytes("other", "poses.csv") != bytes("file", "poses.csv"));

    let (status, out, _) = run(&["simulate", "--list-faults"]);
    assert!(status == 0 && FaultKind::ALL.iter().all(|kind| out.contains(kind.what)), "{out}");
    let (status, _, err) = run(&[
        "simulate",
        "--vessel",
        "cylinder",
        "--steady",
        "--fault",
        "glitch,unordered-points",
        "-o",
        "two",
    ]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert_eq!(run(&["simulate", "--fault", "gremlins", "-o", "no"]).0, 2);
    assert_eq!(run(&["simulate", "--breathing", "1,2", "-o", "no"]).0, 2);
    assert_eq!(run(&["simulate"]).0, 2, "an output is needed");
    assert!(!folder.path().join("no").exists());
}
