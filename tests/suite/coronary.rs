//! Coronary pullbacks with slit-like lumens: areas of the mesh against those measured by hand.

use crate::support::{lumenmesh, shared};
use glam::DVec2;
use lumenmesh::anatomy::{LumenSection, Sections, read_values};
use lumenmesh::cylinders::CpuEngine;
use lumenmesh::cylinders::CylinderReconstruction;
use lumenmesh::cylinders::estimate::{CylinderEstimator, LocalEstimate, Upright};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::{Frame, Pullback, PullbackOptions, Recording};
use lumenmesh::settings::Settings;
use lumenmesh::surface::SectionOutline;
use lumenmesh::sweep::Sweep;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const PULLBACKS: [(&str, &str); 4] = [
    ("ivus_rest", "diastolic"),
    ("ivus_rest", "systolic"),
    ("ivus_stress", "diastolic"),
    ("ivus_stress", "systolic"),
];

/// The settings of `docs/coronary.md`.
fn settings() -> Settings {
    Settings::read_toml(Path::new("docs/coronary.toml")).unwrap()
}

/// The contours' file and that of the areas measured by hand.
fn files((state, phase): (&str, &str)) -> Option<(PathBuf, PathBuf)> {
    let contours = shared(&format!("data/ivus_narco/{state}/{phase}_contours.csv"))?;
    Some((contours, shared(&format!("data/ivus_narco/{state}/combined_sorted_manual.csv"))?))
}

struct Case {
    name: String,
    pullback: Pullback,
    by_hand_mm2: BTreeMap<u64, f64>,
    /// Largest distance of two points of the outline, by hand.
    longest_mm: BTreeMap<u64, f64>,
}

fn cases() -> impl Iterator<Item = Case> {
    PULLBACKS.into_iter().filter_map(|which| {
        let (contours, by_hand) = files(which)?;
        let pullback = Pullback::read(&contours, &PullbackOptions::default()).unwrap();
        let by_hand_mm2 = read_values(&by_hand, "lumen_area").unwrap();
        // Every frame has its area: none is left out of what follows.
        assert!(pullback.frame_numbers.iter().all(|number| by_hand_mm2.contains_key(number)));
        let longest_mm = read_values(&by_hand, "longest_distance").unwrap();
        Some(Case { name: format!("{} {}", which.0, which.1), pullback, by_hand_mm2, longest_mm })
    })
}

impl Case {
    /// The difference of each frame's area from the one measured by hand, in per cent.
    fn differences(&self, areas_mm2: impl Iterator<Item = f64>) -> Vec<f64> {
        let numbers = self.pullback.frame_numbers.iter();
        numbers.zip(areas_mm2).map(|(number, area)| 100.0 * (area / self.by_hand_mm2[number] - 1.0)).collect()
    }

    fn upright(&self) -> Recording {
        let mut upright = Upright { sensor_from_probe: Pose::IDENTITY };
        let stand = |frame: &Frame| frame.clone().with_cylinder(upright.push(frame));
        Recording { frames: self.pullback.recording.frames.iter().map(stand).collect() }
    }

    fn lumen(&self, recording: &Recording, settings: &Settings) -> (Vec<LumenSection>, Vec<f64>) {
        let engine = CpuEngine::<f32>::new();
        let mesh = CylinderReconstruction::of(recording, settings, &engine).unwrap().vessel.surface();
        let topology = mesh.topology();
        assert!(topology.is_oriented_manifold() && topology.boundary_loops == 2, "{topology:?}");
        let sections = Sections::of(&mesh, None).unwrap().of_frames(recording, Pose::IDENTITY);
        let differences = self.differences(sections.iter().map(|s| s.measures.area_mm2));
        (sections, differences)
    }
}

fn sorted_sizes(differences: &[f64]) -> Vec<f64> {
    let mut sizes: Vec<f64> = differences.iter().map(|d| d.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    assert!(sizes.iter().all(|d| d.is_finite()), "{sizes:?}");
    sizes
}

fn median(differences: &[f64]) -> f64 {
    let sizes = sorted_sizes(differences);
    (sizes[(sizes.len() - 1) / 2] + sizes[sizes.len() / 2]) / 2.0
}

fn largest(differences: &[f64]) -> f64 {
    sorted_sizes(differences).pop().unwrap()
}

#[test]
fn the_lumen_area_is_that_measured_by_hand() {
    for case in cases() {
        let recording = case.upright();
        let (sections, differences) = case.lumen(&recording, &settings());
        println!("{}: number, by hand, mesh mm², difference; diameters mm", case.name);
        for (k, s) in sections.iter().enumerate() {
            let number = case.pullback.frame_numbers[k];
            let [least, greatest] = [s.measures.least_diameter_mm, s.measures.greatest_diameter_mm];
            println!(
                "  {number:4} {:6.2} {:7.3} {:+5.1} %  {least:.2} to {greatest:.2}",
                case.by_hand_mm2[&number], s.measures.area_mm2, differences[k]
            );
        }
        println!("  median {:.2} %, largest {:.2} %", median(&differences), largest(&differences));
        assert!(median(&differences) <= 10.0);
        // What it should be is much less: a polygon of 48 corners in an ellipse lacks 0.3 %, some more where it bends.
        assert!(median(&differences) <= 1.0 && largest(&differences) <= 3.0);
    }
}

#[test]
fn the_contours_themselves_have_the_areas_measured_by_hand() {
    for case in cases() {
        let outline = |frame: &Frame| SectionOutline { points_mm: frame.contour_mm.clone() };
        let floor = case.differences(case.pullback.recording.frames.iter().map(|f| outline(f).area_mm2()));
        println!("{}: the floor is {:.3} %, largest {:.3} %", case.name, median(&floor), largest(&floor));
        // Areas are given to a hundredth of mm², of 4 mm² at least.
        assert!(largest(&floor) <= 0.2);
    }
}

#[test]
fn the_published_settings_do_not_hold_a_slit() {
    // The negative control of the comparison, and the reason for settings of its own.
    for case in cases() {
        let published = Settings::default().with_every(1);
        let (_, differences) = case.lumen(&case.upright(), &published);
        println!("{}: median {:.1} %", case.name, median(&differences));
        assert!(median(&differences) > 10.0);
    }
}

/// Whether every ray from a contour's centroid meets it once: what a mesh of radii can hold.
fn is_star_shaped(frame: &Frame) -> bool {
    let centroid = frame.centroid_mm().unwrap();
    let points: Vec<DVec2> = frame.contour_mm.iter().map(|p| p - centroid).collect();
    let turns: Vec<f64> =
        (0..points.len()).map(|i| points[i].perp_dot(points[(i + 1) % points.len()])).collect();
    turns.iter().all(|&t| t > 0.0) || turns.iter().all(|&t| t < 0.0)
}

#[test]
fn every_lumen_is_star_shaped_about_its_centroid() {
    for case in cases() {
        let slit = |frame: &Frame| {
            let centroid = frame.centroid_mm().unwrap();
            let radii = || frame.contour_mm.iter().map(|p| p.distance(centroid));
            radii().fold(0.0, f64::max) / radii().fold(f64::INFINITY, f64::min)
        };
        let frames = &case.pullback.recording.frames;
        let narrowest = frames.iter().map(slit).fold(0.0, f64::max);
        println!("{}: greatest over least radius up to {narrowest:.1}", case.name);
        assert!(frames.iter().all(is_star_shaped) && narrowest > 4.0);
    }
    // Negative control: a horseshoe.
    let arc = |radius: f64, j: i32| DVec2::from_angle(f64::from(j) * 0.05) * radius;
    let contour_mm = (0..=100).map(|j| arc(3.0, j)).chain((0..=100).rev().map(|j| arc(2.0, j))).collect();
    let horseshoe = Frame::new(Pose::IDENTITY, contour_mm);
    assert!(!is_star_shaped(&horseshoe));
}

/// Why the commands of `docs/coronary.md` import with `--upright`: slits jump from frame to frame, and the usual estimate
/// leans in some of them.
#[test]
fn the_usual_estimate_leans_in_single_frames() {
    for case in cases() {
        let recording = &case.pullback.recording;
        let mut estimate = LocalEstimate::default();
        let lean = |frame: &Frame| {
            let model = estimate.push(frame).unwrap();
            model.sensor_from_cylinder().rotation.x_axis.z.acos().to_degrees()
        };
        let leans: Vec<f64> = recording.frames.iter().map(lean).collect();
        let (_, differences) = case.lumen(recording, &settings());
        println!(
            "{}: leans by {:.1} degrees (median), {:.1} at most; area off by {:.2} % (median), {:.1} % at most",
            case.name,
            median(&leans),
            largest(&leans),
            median(&differences),
            largest(&differences)
        );
        assert!(median(&differences) <= 10.0 && largest(&leans) > 1.0 && median(&leans) < 5.0);
    }
}

fn absolute(path: &Path) -> String {
    path.canonicalize().unwrap().display().to_string()
}

#[test]
fn the_commands_of_the_guide_work() {
    let Some((contours, by_hand)) = files(PULLBACKS[0]) else { return };
    let (contours, by_hand) = (absolute(&contours), absolute(&by_hand));
    let config = absolute(Path::new("docs/coronary.toml"));
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let (status, said, errors) = lumenmesh(arguments, folder.path());
        assert_eq!((status, errors.as_str()), (0, ""), "{arguments:?}");
        said
    };
    run(&["import", "pullback", &contours, "-o", "pullback.mat", "--upright"]);
    run(&["reconstruct", "pullback.mat", "-o", "vessel.vtp", "--method", "cylinders", "--config", &config]);
    let measure = ["sections", "vessel.vtp", "pullback.mat"];
    let against = ["--against", &by_hand, "--numbers", &contours];
    let said = run(&[&measure[..], &against, &["--csv", "sections.csv"]].concat());
    assert!(
        said.ends_with("over 20 frames with an area, of 20 with a value in the table and 20 in all\n"),
        "{said}"
    );
    let csv = std::fs::read_to_string(folder.path().join("sections.csv")).unwrap();
    assert!(csv.starts_with("frame,area_mm2,perimeter_mm,least_diameter_mm,"), "{csv}");
    assert_eq!(csv.lines().count(), 21);

    let json: serde_json::Value =
        serde_json::from_str(&run(&[&measure[..], &against, &["--json"]].concat())).unwrap();
    assert!(json["median_absolute_difference_percent"].as_f64().unwrap() <= 1.0);
    let first = &json["sections"][0];
    assert_eq!((first["number"].as_u64(), first["against_mm2"].as_f64()), (Some(18), Some(18.9)));
    assert!((first["area_mm2"].as_f64().unwrap() - 18.9).abs() < 0.2);
    // Without a comparison nothing is said about one.
    let json: serde_json::Value = serde_json::from_str(&run(&[&measure[..], &["--json"]].concat())).unwrap();
    assert!(json.get("median_absolute_difference_percent").is_none());
    assert!(json["sections"][0].get("number").is_none());

    // Frames counted from 0 meet a number of the table by chance: that is said.
    let (status, _, said) = lumenmesh(&[&measure[..], &["--against", &by_hand]].concat(), folder.path());
    assert!(status == 0 && said.contains("values for 2 of the recording's 20 frames"), "{said}");
    std::fs::write(folder.path().join("far.csv"), "frame,lumen_area\n1000,5\n").unwrap();
    std::fs::write(folder.path().join("twice.csv"), "frame,lumen_area\n1,5\n1,6\n").unwrap();
    for (arguments, status, expected) in [
        (
            vec!["--against", "far.csv"],
            1,
            "far.csv: frame: found none of the recording's, expected the number",
        ),
        (vec!["--against", "twice.csv"], 1, "twice.csv: line 3: frame: found 1, expected each frame once"),
        (
            vec!["--against", "far.csv", "--column", "area"],
            1,
            "far.csv: area: found columns frame, lumen_area",
        ),
        (vec!["--numbers", &contours], 2, "--against"),
    ] {
        let (found, _, said) = lumenmesh(&[&measure[..], &arguments].concat(), folder.path());
        assert!(found == status && said.contains(expected), "{found} {said}");
    }
}

/// The narrowest place is the one measured by hand, and as narrow; the largest distances across are those too.
fn has_the_narrowest_place(case: &Case, sections: &[LumenSection]) {
    let numbers = || case.pullback.frame_numbers.iter().copied();
    let least = |areas: &mut dyn Iterator<Item = f64>| {
        areas.zip(numbers()).min_by(|p, q| p.0.total_cmp(&q.0)).unwrap()
    };
    let (area, frame) = least(&mut sections.iter().map(|s| s.measures.area_mm2));
    let (by_hand, frame_by_hand) = least(&mut numbers().map(|number| case.by_hand_mm2[&number]));
    println!("{}: least {area:.3} mm² in {frame}, by hand {by_hand:.2} in {frame_by_hand}", case.name);
    assert_eq!(frame, frame_by_hand);
    // 0.3 % in three of the four; 3.4 % in the fourth, where a frame of 5.9 mm² lies 0.4 mm beside it.
    assert!((area / by_hand - 1.0).abs() <= 0.04, "{area} {by_hand}");
    let feret = sections.iter().map(|s| s.measures.feret_diameter_mm);
    let longest: Vec<f64> = feret
        .zip(numbers())
        .map(|(feret, number)| 100.0 * (feret / case.longest_mm[&number] - 1.0))
        .collect();
    println!("  longest distance: median {:.2} %, largest {:.2} %", median(&longest), largest(&longest));
    assert!(median(&longest) <= 1.0);
}

#[test]
fn areas_of_a_swept_vessel_agree_too() {
    for case in cases() {
        let recording = &case.pullback.recording;
        let swept = |settings: &Settings, keep_unsupported: bool| {
            let mesh = Sweep::of(recording, settings).unwrap().surface(keep_unsupported);
            let sections = Sections::of(&mesh, None).unwrap().of_frames(recording, Pose::IDENTITY);
            if keep_unsupported {
                has_the_narrowest_place(&case, &sections);
            }
            let differences = case.differences(sections.iter().map(|s| s.measures.area_mm2));
            // An outline that is cut open counts as off without bound.
            let open = differences.iter().filter(|d| d.is_nan()).count();
            let bounded = differences.iter().map(|d| if d.is_nan() { f64::MAX } else { *d });
            (bounded.collect::<Vec<_>>(), open)
        };
        let (whole, open) = swept(&settings(), true);
        assert_eq!(open, 0);
        let (cut, open) = swept(&settings(), false);
        println!(
            "{}: swept, {:.2} % (median), {:.1} % (largest); {:.2} % where what is not supported is cut, {open} open",
            case.name,
            median(&whole),
            largest(&whole),
            median(&cut),
        );
        assert!(median(&whole) < 1.0 && largest(&whole) < 5.0);
        assert!(median(&cut) < 1.0 && open <= cut.len() / 5);
        // Without any settings the ends of some slits are cut off as too uncertain, but the areas hold.
        let (plain, _) = swept(&Settings::default(), true);
        println!("  without settings {:.2} % (median), {:.1} % (largest)", median(&plain), largest(&plain));
        assert!(median(&plain) < 1.0 && largest(&plain) < 5.0);
    }
}
