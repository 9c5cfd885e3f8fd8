//! Mouths of branches that were seen but not entered.

use crate::support::lumenmesh;
use lumenmesh::branching::Mouth;
use lumenmesh::evaluate::Locator;
use lumenmesh::glam::DVec3;
use lumenmesh::reconstruction::{Lumen, Reconstructor};
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{
    Centreline, FaultKind, Insertion, Noise, Phantom, Shape, SimulatedVessel, Simulation, SimulationSettings,
    Visit,
};
use rayon::prelude::*;

fn swept(recording: &Recording) -> Lumen {
    Reconstructor::new(Settings::default()).run(recording).unwrap()
}

/// A round tube about a part of a centreline.
struct Tube<'a> {
    middle: &'a Centreline,
    from_mm: f64,
    until_mm: f64,
    radius_mm: f64,
}

impl<'a> Tube<'a> {
    fn of(middle: &'a Centreline, radius_mm: f64) -> Self {
        Self { middle, from_mm: 0.0, until_mm: middle.length_mm(), radius_mm }
    }

    fn within(self, from_mm: f64, until_mm: f64) -> Self {
        Self { from_mm, until_mm, ..self }
    }

    /// Distance of a point outside, and where along the centreline the nearest place is, mm.
    fn outside_mm(&self, p: DVec3) -> (f64, f64) {
        let count = ((self.until_mm - self.from_mm) / 0.5).ceil() as usize;
        let at = |i: usize| self.from_mm + (self.until_mm - self.from_mm) * i as f64 / count as f64;
        let away = |s: f64| self.middle.at(s).0.distance(p);
        let nearest = (0..=count).map(at).min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
        let fine = (-10..=10).map(|k| (nearest + f64::from(k) * 0.05).clamp(self.from_mm, self.until_mm));
        let nearest = fine.min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
        (away(nearest) - self.radius_mm, nearest)
    }
}

/// A mouth as the tubes of a phantom make it.
#[derive(Debug)]
struct TrueMouth {
    centre_mm: DVec3,
    area_mm2: f64,
    direction: DVec3,
}

/// The part of the wall of some tubes that lies within another.
fn true_mouth(parents: &[Tube], branch: &Tube) -> TrueMouth {
    let (mut area_mm2, mut moment) = (0.0, DVec3::ZERO);
    for (number, tube) in parents.iter().enumerate() {
        let (step_mm, around) = (0.4, 120);
        let place = |s: f64, j: i32| {
            let frame = tube.middle.frame(s);
            let (sin, cos) = (f64::from(j) / f64::from(around) * std::f64::consts::TAU).sin_cos();
            frame.transform_point(DVec3::new(cos, sin, 0.0) * tube.radius_mm)
        };
        let count = ((tube.until_mm - tube.from_mm) / step_mm) as usize;
        for i in 0..count {
            let s = tube.from_mm + i as f64 * step_mm;
            for j in 0..around {
                let [a, b, c, d] =
                    [place(s, j), place(s, j + 1), place(s + step_mm, j + 1), place(s + step_mm, j)];
                let middle = (a + b + c + d) / 4.0;
                let is_wall = parents
                    .iter()
                    .enumerate()
                    .all(|(k, other)| k == number || other.outside_mm(middle).0 > 0.0);
                if is_wall && branch.outside_mm(middle).0 < 0.0 {
                    let area = 0.5 * (c - a).cross(d - b).length();
                    area_mm2 += area;
                    moment += middle * area;
                }
            }
        }
    }
    let centre_mm = moment / area_mm2;
    let direction = branch.middle.at(branch.outside_mm(centre_mm).1).1;
    TrueMouth { centre_mm, area_mm2, direction }
}

/// A vessel with its mouths, seen from its first branch.
struct Case {
    name: &'static str,
    shape: Shape,
    mouths: fn(&SimulatedVessel) -> Vec<TrueMouth>,
    /// Whether the mouths are much smaller than the lumen: those of partings into two of like size are long, and found less
    /// exactly.
    is_side: bool,
}

fn side(trunk_radius_mm: f64, branch_radius_mm: f64, angle_deg: f64) -> Shape {
    Shape::SideBranch { trunk_radius_mm, branch_radius_mm, angle_deg, length_mm: 100.0 }
}

fn of_side(vessel: &SimulatedVessel, trunk_mm: f64, branch_mm: f64) -> Vec<TrueMouth> {
    let lines = vessel.branches();
    vec![true_mouth(&[Tube::of(&lines[0], trunk_mm)], &Tube::of(&lines[1], branch_mm))]
}

fn cases() -> Vec<Case> {
    let of_bifurcation = |vessel: &SimulatedVessel| {
        let lines = vessel.branches();
        let trunk = Tube::of(&lines[0], 9.0).within(0.0, 55.0);
        vec![true_mouth(&[trunk, Tube::of(&lines[0], 7.0)], &Tube::of(&lines[1], 7.0))]
    };
    // Radii by Murray's law, lengths as the tree has them.
    let of_tree = |vessel: &SimulatedVessel| {
        let lines = vessel.branches();
        let larger = (1.0_f64 + 0.8_f64.powi(3)).cbrt().recip();
        let [first, second] = [8.0 * larger, 8.0 * larger * larger];
        let parents = || {
            let end = lines[0].length_mm();
            let of = |radius, from, until| Tube::of(&lines[0], radius).within(from, until);
            [of(8.0, 0.0, 32.0), of(first, 32.0, 79.9), of(second, 79.9, end)]
        };
        let branch =
            |k: usize, radius: f64, from: f64| Tube::of(&lines[k], radius).within(from, lines[k].length_mm());
        vec![
            true_mouth(&parents(), &branch(2, 0.8 * first, 32.0)),
            true_mouth(&parents(), &branch(1, 0.8 * second, 79.9)),
        ]
    };
    let case = |name, shape, is_side, mouths| Case { name, shape, mouths, is_side };
    vec![
        case("side branch at 60°", side(11.0, 6.0, 60.0), true, |v| of_side(v, 11.0, 6.0)),
        case("side branch at 90°", side(11.0, 6.0, 90.0), true, |v| of_side(v, 11.0, 6.0)),
        case("side branch at 45°", side(9.0, 6.5, 45.0), true, |v| of_side(v, 9.0, 6.5)),
        case("bifurcation", "bifurcation".parse().unwrap(), false, of_bifurcation),
        case("tree", "tree".parse().unwrap(), false, of_tree),
    ]
}

/// How far a mouth is from the true one.
struct Off {
    centre_mm: f64,
    area: f64,
    area_errors: f64,
    direction_deg: f64,
}

impl Off {
    fn of(mouth: &Mouth, truth: &TrueMouth) -> Self {
        let area_mm2 = mouth.area_mm2 - truth.area_mm2;
        Self {
            centre_mm: mouth.centre_mm.distance(truth.centre_mm),
            area: area_mm2 / truth.area_mm2,
            area_errors: area_mm2 / mouth.area_standard_error_mm2,
            direction_deg: mouth.direction.angle_between(truth.direction).to_degrees(),
        }
    }

    /// Within 1 mm, and in area within a fifth or two standard errors.
    fn is_close(&self) -> bool {
        self.centre_mm < 1.0 && (self.area.abs() < 0.2 || self.area_errors.abs() < 2.0)
    }
}

#[test]
fn branches_that_were_not_entered_have_mouths() {
    for Case { name, shape, mouths, is_side } in cases() {
        let vessel = Phantom::from(shape).vessel().unwrap();
        let truths = mouths(&vessel);
        for (way, insertion) in [("bending", Insertion::default()), ("steady", Insertion::steady())] {
            let settings = SimulationSettings::default()
                .with_insertion(insertion)
                .with_noise(Noise::default().with_seed(3));
            let simulation = Simulation::run(vessel.clone(), &settings).unwrap();
            let lumen = swept(&simulation.recording);
            assert_eq!(lumen.mouths().len(), truths.len(), "{name}, {way}");
            for truth in &truths {
                let away = |mouth: &&Mouth| mouth.centre_mm.distance(truth.centre_mm);
                let nearest = lumen.mouths().iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
                let off = Off::of(nearest, truth);
                println!(
                    "{name}, {way}: {:.2} ± {:.2} mm off; area {:.0} ± {:.0} of {:.0} mm² ({:+.0} %, {:+.1} standard \
                     errors); direction {:.0} ± {:.0}° off",
                    off.centre_mm,
                    nearest.centre_standard_error_mm,
                    nearest.area_mm2,
                    nearest.area_standard_error_mm2,
                    truth.area_mm2,
                    100.0 * off.area,
                    off.area_errors,
                    off.direction_deg,
                    nearest.direction_standard_error_deg,
                );
                assert!(!is_side || off.is_close(), "{name}, {way}");
                assert!(off.direction_deg < 20.0, "{name}, {way}: {}", off.direction_deg);
                let elsewhere = TrueMouth { centre_mm: truth.centre_mm + DVec3::Y * 2.5, ..*truth };
                assert!(!Off::of(nearest, &elsewhere).is_close());
            }
            // The surface is open there.
            let surface = lumen.surface();
            let middles: Vec<DVec3> = lumen.mouths().iter().map(|mouth| mouth.centre_mm).collect();
            for (mouth, closest) in
                lumen.mouths().iter().zip(Locator::new(&surface).unwrap().closest_all(&middles))
            {
                let radius_mm = (mouth.area_mm2 / std::f64::consts::PI).sqrt();
                assert!(closest.distance_mm > 0.5 * radius_mm, "{name}, {way}: {}", closest.distance_mm);
                assert!(mouth.rim_mm.iter().all(|p| p.distance(mouth.centre_mm) > 0.4 * radius_mm));
            }
        }
    }
}

/// Noise as little as 0.3 mm on the contours, and none.
fn little_noise() -> [Noise; 2] {
    [Noise::default().with_contour_sd_mm(0.3).with_seed(3), Noise::none()]
}

#[test]
fn mouths_are_found_where_there_is_little_noise_or_none() {
    for angle_deg in [60.0, 90.0] {
        let vessel = Phantom::from(side(11.0, 6.0, angle_deg)).vessel().unwrap();
        let truth = of_side(&vessel, 11.0, 6.0).remove(0);
        for noise in little_noise() {
            let settings =
                SimulationSettings::default().with_insertion(Insertion::steady()).with_noise(noise.clone());
            let lumen = swept(&Simulation::run(vessel.clone(), &settings).unwrap().recording);
            let [mouth] = lumen.mouths() else { panic!("{angle_deg}°: {} mouths", lumen.mouths().len()) };
            let is_right = |truth: &TrueMouth| {
                let off = Off::of(mouth, truth);
                off.centre_mm < 0.4 && off.area.abs() < 0.1 && off.direction_deg < 5.0
            };
            assert!(is_right(&truth), "{angle_deg}°: {mouth:?}, {truth:?}");
            let elsewhere = TrueMouth { centre_mm: truth.centre_mm + DVec3::Y, ..truth };
            assert!(!is_right(&elsewhere));
        }
    }
}

#[test]
fn a_wide_place_of_the_vessel_itself_is_no_mouth() {
    // Where the contours reach into a branch, their centres move towards it, and the wall across from it seems to bulge; at a
    // bifurcation the daughter that the catheter enters does.
    let mut found = 0;
    for Case { name, shape, mouths, .. } in cases() {
        if !["side branch at 45°", "bifurcation"].contains(&name) {
            continue;
        }
        let vessel = Phantom::from(shape).vessel().unwrap();
        let truth = mouths(&vessel).remove(0);
        for insertion in [Insertion::default(), Insertion::steady()] {
            for noise in little_noise() {
                let settings =
                    SimulationSettings::default().with_insertion(insertion.clone()).with_noise(noise);
                let lumen = swept(&Simulation::run(vessel.clone(), &settings).unwrap().recording);
                for mouth in lumen.mouths() {
                    let away_mm = mouth.centre_mm.distance(truth.centre_mm);
                    assert!(away_mm < 5.0, "{name}: {away_mm} mm");
                    found += 1;
                }
            }
        }
    }
    // Of 8 recordings with one true mouth each.
    assert!(found >= 4, "{found}");
}

#[test]
fn a_branch_that_was_entered_has_no_mouth() {
    let visits = vec![Visit::new(0, None), Visit::new(1, None)];
    let settings = SimulationSettings::default().with_insertion(Insertion::default().with_visits(visits));
    for shape in ["bifurcation", "side_branch"] {
        let vessel = Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap();
        let lumen = swept(&Simulation::run(vessel, &settings).unwrap().recording);
        assert_eq!(lumen.branches().unwrap().sweeps.len(), 2, "{shape}");
        assert!(lumen.mouths().is_empty(), "{shape}: {:?}", lumen.mouths());
    }
}

#[test]
fn one_branch_entered_and_another_seen() {
    // Of the tree's four ends, the second is not visited.
    let visits = [0, 2, 3].map(|branch| Visit::new(branch, None)).to_vec();
    let settings = SimulationSettings::default().with_insertion(Insertion::default().with_visits(visits));
    let vessel = Phantom::from("tree".parse::<Shape>().unwrap()).vessel().unwrap();
    let middle = vessel.branches()[1].clone();
    let lumen = swept(&Simulation::run(vessel, &settings).unwrap().recording);
    assert_eq!(lumen.branches().unwrap().sweeps.len(), 3);
    let [mouth] = lumen.mouths() else { panic!("{} mouths", lumen.mouths().len()) };
    assert_eq!(mouth.branch, 0);
    let away =
        middle.every_mm().into_iter().map(|(_, p)| p.distance(mouth.centre_mm)).fold(f64::MAX, f64::min);
    assert!(away < 3.0, "{away}");
}

/// The recordings of vessels without mouths, with every so many of the errors that laboratories meet on top of a share of the
/// usual noise, in which one is found.
fn false_mouths(shapes: &[&str], every: usize, seeds: u64, noise: f64) -> usize {
    let vessel = |shape: &str| Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap();
    let vessels: Vec<SimulatedVessel> = shapes.iter().map(|shape| vessel(shape)).collect();
    let recordings: Vec<(usize, u64, FaultKind)> = (0..shapes.len())
        .flat_map(|shape| (0..seeds).map(move |seed| (shape, seed)))
        .flat_map(|(shape, seed)| {
            let kinds = FaultKind::ALL.into_iter().skip(seed as usize % every).step_by(every);
            kinds.map(move |kind| (shape, seed, kind))
        })
        .collect();
    // Whether there is a mouth; `None` of a recording that is refused.
    let has_mouth = |&(shape, seed, kind): &(usize, u64, FaultKind)| {
        let vessel = vessels[shape].clone();
        let radius_mm = vessel.branches()[0].median_radius_mm();
        let usual = Noise::default();
        let share = usual
            .clone()
            .with_seed(seed + 100)
            .with_position_sd_mm(noise * usual.position_sd_mm)
            .with_rotation_sd_deg(noise * usual.rotation_sd_deg)
            .with_contour_sd_mm(noise * usual.contour_sd_mm);
        let mut settings = SimulationSettings::default().with_noise(share);
        kind.apply(&mut settings, radius_mm);
        let simulation = Simulation::run(vessel, &settings).unwrap();
        let lumen = Reconstructor::new(Settings::default()).run(&simulation.recording).ok()?;
        if !lumen.mouths().is_empty() {
            println!("{}, {}, seed {seed}: {:?}", shapes[shape], kind.name, lumen.mouths());
        }
        Some(!lumen.mouths().is_empty())
    };
    // One recording on each thread: much of a small one is not done side by side.
    let found: Vec<bool> = recordings.par_iter().with_max_len(1).filter_map(has_mouth).collect();
    let wrong = found.iter().filter(|is| **is).count();
    println!("{wrong} of {} recordings with a mouth that is none", found.len());
    assert!(found.len() > recordings.len() / 2);
    wrong
}

#[test]
fn no_mouth_is_invented() {
    assert_eq!(false_mouths(&["small_arch", "ellipse"], 6, 1, 1.0), 0);
    assert_eq!(false_mouths(&["aneurysm", "stenosis"], 12, 1, 0.2), 0);
}

#[test]
#[ignore = "takes many minutes"]
fn no_mouth_is_invented_in_hundreds_of_recordings() {
    let shapes = ["arch", "small_arch", "aneurysm", "ellipse", "stenosis"];
    assert_eq!(false_mouths(&shapes, 1, 3, 1.0), 0);
    assert_eq!(false_mouths(&shapes, 1, 1, 0.2), 0);
}

#[test]
fn mouths_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let (status, said, errors) = lumenmesh(arguments, folder.path());
        assert!(status == 0, "{arguments:?}\n{said}{errors}");
        said
    };
    run(&["simulate", "--vessel", "side_branch", "--steady", "-o", "one.mat"]);
    let said = run(&["reconstruct", "one.mat", "-o", "one.vtp"]);
    assert!(said.contains("mouth      at (") && said.contains("not entered"), "{said}");
    let json = run(&["reconstruct", "one.mat", "-o", "one.vtp", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    let mouths = report["mouths"].as_array().unwrap();
    assert_eq!(mouths.len(), 1);
    for name in
        ["area_mm2", "area_standard_error_mm2", "centre_standard_error_mm", "direction_standard_error_deg"]
    {
        assert!(mouths[0][name].as_f64().unwrap() > 0.0, "{name}");
    }
    let json = run(&["reconstruct", "one.mat", "-o", "off.vtp", "--json", "--branches", "off"]);
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["mouths"].as_array().unwrap().len(), 0);
    run(&["report", "one.mat", "-o", "one.html"]);
    let page = std::fs::read_to_string(folder.path().join("one.html")).unwrap();
    assert!(page.contains("<h2>Mouths</h2>"));
}

#[test]
fn mouths_do_not_depend_on_the_threads() {
    let vessel = Phantom::from("side_branch".parse::<Shape>().unwrap()).vessel().unwrap();
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let recording = Simulation::run(vessel, &settings).unwrap().recording;
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| swept(&recording).mouths().to_vec())
    };
    let one = on(1);
    assert!(!one.is_empty() && one == on(5));
}
