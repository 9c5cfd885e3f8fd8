//! Axes, sections, stenoses: on phantoms whose sections are known, and as a user runs the commands.

use crate::support::vessel::simulated;
use crate::support::{lumenmesh, python_with_vtk, shared, tube};
use glam::{DVec2, DVec3};
use lumenmesh::anatomy::{LesionKind, LesionRules, Profile, Sections, VesselAxis, VesselTree, places};
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{self, Centreline, Insertion, Noise, Phantom, Shape, Visit};
use lumenmesh::surface::Surface;
use std::f64::consts::PI;

fn wall(shape: &str) -> (Surface, Vec<Centreline>) {
    let vessel = Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap();
    (vessel.surface().clone(), vessel.branches().to_vec())
}

/// The largest distance from an axis to a centreline, mm, `margin_mm` from its ends.
fn farthest_mm(axis: &VesselAxis, truth: &Centreline, margin_mm: f64) -> f64 {
    let dense: Vec<DVec3> =
        (0..=4000).map(|i| truth.at(truth.length_mm() * f64::from(i) / 4000.0).0).collect();
    let inner = (0..=200).map(|i| margin_mm + (axis.length_mm() - 2.0 * margin_mm) * f64::from(i) / 200.0);
    inner
        .map(|s| axis.pose(s).translation_mm)
        .map(|p| dense.iter().map(|q| p.distance(*q)).fold(f64::INFINITY, f64::min))
        .fold(0.0, f64::max)
}

#[test]
fn the_axis_of_a_phantom_is_its_centreline() {
    // The middle of the lumen leaves the centreline where the wall bulges to one side (aneurysm) or is thicker outside a
    // bend.
    for (shape, most_mm) in
        [("cylinder", 0.05), ("stenosis", 0.05), ("ellipse", 0.05), ("arch", 0.8), ("aorta", 1.0)]
    {
        let (surface, centrelines) = wall(shape);
        let tree = VesselTree::of(&surface).unwrap();
        assert_eq!(tree.axes.len(), 1, "{shape}");
        let off = farthest_mm(&tree.axes[0], &centrelines[0], 2.0);
        let length = tree.axes[0].length_mm() / centrelines[0].length_mm();
        println!("{shape}: {off:.3} mm off, {length:.4} of the length");
        assert!(off < most_mm, "{shape}: {off}");
        assert!((0.97..1.005).contains(&length), "{shape}: {length}");
    }
}

#[test]
fn an_axis_is_found_whatever_the_surface_is_like() {
    let closed = |mut surface: Surface, nodes: u32, levels: u32| {
        for (ring, turned) in [(0, true), (levels, false)] {
            let centre = surface.nodes_mm.len() as u32;
            let rim = ring * nodes..(ring + 1) * nodes;
            let mean = rim.clone().map(|n| surface.nodes_mm[n as usize]).sum::<DVec3>() / f64::from(nodes);
            surface.nodes_mm.push(mean);
            let next = |n: u32| if n + 1 == rim.end { rim.start } else { n + 1 };
            surface.triangles.extend(
                rim.clone().map(|n| if turned { [centre, next(n), n] } else { [centre, n, next(n)] }),
            );
        }
        surface
    };
    let open = tube(16, 1, 3.0, 60.0);
    let scattered = Surface {
        // Every triangle with nodes of its own, as some exporters write them.
        nodes_mm: open.triangles.iter().flatten().map(|&n| open.nodes_mm[n as usize]).collect(),
        triangles: (0..open.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        ..Surface::default()
    };
    for (name, surface) in [
        ("two rings", open.clone()),
        ("closed", closed(open.clone(), 16, 1)),
        ("closed, fine", closed(tube(40, 60, 3.0, 60.0), 40, 60)),
        ("no shared nodes", scattered),
    ] {
        let tree = VesselTree::of(&surface.joined()).unwrap();
        let axis = &tree.axes[0];
        assert_eq!(tree.axes.len(), 1, "{name}");
        // At a closed end the direction is known to a part of the diameter, 6 mm, only.
        assert!((axis.length_mm() - 60.0).abs() < 2.0, "{name}: {} mm", axis.length_mm());
        let middle = axis.pose(axis.length_mm() / 2.0);
        assert!(middle.translation_mm.truncate().length() < 0.05, "{name}: {middle:?}");
        assert!(middle.rotation.z_axis.z.abs() > 0.999, "{name}: {middle:?}");
    }
    let flat = Surface {
        nodes_mm: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
        triangles: vec![[0, 1, 2]],
        arrays: vec![],
    };
    assert!(VesselTree::of(&flat).unwrap_err().to_string().contains("a tube, or a tree of tubes"));
    assert!(VesselTree::of(&Surface::default()).is_err());
}

/// Distance of the nearest end of an axis to each end of a tree's centrelines, mm, the root's first.
fn ends_off_mm(tree: &VesselTree, centrelines: &[Centreline]) -> Vec<f64> {
    let found: Vec<DVec3> = tree
        .axes
        .iter()
        .flat_map(|axis| [0.0, axis.length_mm()].map(|at| axis.pose(at).translation_mm))
        .collect();
    let root = centrelines[0].at(0.0).0;
    let ends = [root].into_iter().chain(centrelines.iter().map(|line| line.at(line.length_mm()).0));
    ends.map(|end| found.iter().map(|p| p.distance(end)).fold(f64::INFINITY, f64::min)).collect()
}

#[test]
fn every_opening_of_a_tree_has_an_axis_that_leads_to_it() {
    let visits = (0..4).map(|branch| Visit::new(branch, None)).collect();
    let settings = simulate::SimulationSettings::default()
        .with_insertion(Insertion::steady().with_visits(visits).with_record_withdrawals(false));
    let simulation = simulated("tree", &settings);
    let lumen = Reconstructor::new(Settings::default()).run(&simulation.recording).unwrap();
    let (tree, deep_tree) = (wall("tree"), wall("deep_tree"));
    // The last plane across an axis that is closed lies within half a lumen of the opening; the catheter turns back 5 mm before.
    for (name, surface, centrelines, most_mm) in [
        ("wall of a tree", &tree.0, &tree.1, 5.0),
        ("wall of a deep tree", &deep_tree.0, &deep_tree.1, 5.0),
        ("reconstructed tree", &lumen.surface(), &tree.1, 9.0),
    ] {
        let found = VesselTree::of(surface).unwrap();
        let off_mm = ends_off_mm(&found, centrelines);
        println!("{name}: {} axes, {off_mm:.1?} mm off", found.axes.len());
        assert_eq!(found.axes.len(), centrelines.len(), "{name}");
        assert!(off_mm.iter().all(|&mm| mm < most_mm), "{name}: {off_mm:?}");
        // Without one of them an end has none.
        let without = VesselTree::with_axes(found.axes[..found.axes.len() - 1].to_vec(), 0);
        assert!(ends_off_mm(&without, centrelines).iter().any(|&mm| mm > most_mm), "{name}");
    }
}

#[test]
fn axes_are_numbered_as_the_nodes_are() {
    let visits = (0..2).map(|branch| Visit::new(branch, None)).collect();
    let settings =
        simulate::SimulationSettings::default().with_insertion(Insertion::steady().with_visits(visits));
    let simulation = simulated("bifurcation", &settings);
    let mut surface = Reconstructor::new(Settings::default()).run(&simulation.recording).unwrap().surface();
    let branch_at = |surface: &Surface, p: DVec3| {
        let squared = |n: &usize| surface.nodes_mm[*n].distance_squared(p);
        let nearest = (0..surface.nodes_mm.len()).min_by(|a, b| squared(a).total_cmp(&squared(b))).unwrap();
        surface.array("branch").unwrap()[nearest]
    };
    let ends = |surface: &Surface| -> Vec<f64> {
        let tree = VesselTree::of(surface).unwrap();
        tree.axes.iter().map(|axis| branch_at(surface, axis.pose(axis.length_mm()).translation_mm)).collect()
    };
    assert_eq!(ends(&surface), [0.0, 1.0]);
    let root = VesselTree::of(&surface).unwrap().axes[0].pose(0.0).translation_mm;
    assert_eq!(branch_at(&surface, root), 0.0);
    // The other daughter goes on from the trunk where the numbers say so.
    let daughter = VesselTree::of(&surface).unwrap().axes[1].clone();
    let far = daughter.pose(daughter.length_mm()).translation_mm;
    let x = far.x.signum();
    let numbers = surface.nodes_mm.iter().map(|p| f64::from(u8::from(p.z > 80.0 && p.x * x < 0.0)));
    let numbers = numbers.collect();
    surface.set_array("branch", numbers);
    let axis = &VesselTree::of(&surface).unwrap().axes[0];
    let end = axis.pose(axis.length_mm()).translation_mm;
    assert!(end.distance(far) < 3.0, "{end} {far}");
    // Numbers that fit no openings are not followed.
    let without = Surface { arrays: Vec::new(), ..surface.clone() };
    surface.set_array("branch", vec![0.0; surface.nodes_mm.len()]);
    assert_eq!(VesselTree::of(&surface).unwrap(), VesselTree::of(&without).unwrap());
}

#[test]
fn branches_are_told_apart_and_no_section_runs_into_one() {
    for (shape, count) in [("side_branch", 2), ("bifurcation", 2)] {
        let (surface, _) = wall(shape);
        let tree = VesselTree::of(&surface).unwrap();
        assert_eq!(tree.axes.len(), count, "{shape}");
        let sections = Sections::of(&surface, Some(&tree)).unwrap();
        let axis = &tree.axes[0];
        let found = sections.across(axis, 0, &places(0.0, axis.length_mm(), 1.0).unwrap());
        let named =
            found.iter().filter(|s| s.remark.as_ref().is_some_and(|r| r.contains("runs into branch 1")));
        assert!(named.clone().all(|s| s.parting == Some(1)), "{shape}");
        assert!(found.iter().all(|s| s.parting.is_none() || s.measures.area_mm2.is_nan()), "{shape}");
        assert!(named.count() >= 5, "{shape}");
        // The trunk's and the daughter's radii bound what is measured; a mouth in it would be half as large again.
        let most = PI * if shape == "side_branch" { 11.6_f64 } else { 11.5 }.powi(2);
        for s in found.iter().filter(|s| s.measures.area_mm2.is_finite()) {
            assert!(s.measures.area_mm2 < most, "{shape}: {:?}", s);
        }
        assert!(
            found.iter().filter(|s| s.measures.area_mm2.is_finite()).count() > found.len() / 2,
            "{shape}"
        );
    }
}

#[test]
fn a_slit_has_its_measures_and_a_hole_is_named() {
    // An elliptic tube of half axes 6 and 1.5, with a hole beyond z = 15.
    let mut surface = tube(200, 80, 1.0, 40.0);
    surface.nodes_mm.iter_mut().for_each(|p| (p.x, p.y) = (6.0 * p.x, 1.5 * p.y));
    let nodes = surface.nodes_mm.clone();
    let is_hole = |n: u32| (10.0..13.0).contains(&nodes[n as usize].z) && nodes[n as usize].x > 4.0;
    surface.triangles.retain(|t| !t.iter().all(|&n| is_hole(n)));
    let axis = VesselAxis::through(&[DVec3::Z * -20.0, DVec3::Z * 20.0]).unwrap();
    let sections = Sections::of(&surface, None).unwrap();
    let found = sections.across(&axis, 0, &[20.0, 31.5, 50.0]);
    let m = &found[0].measures;
    for (value, expected) in [
        (m.area_mm2, PI * 9.0),
        (m.least_diameter_mm, 3.0),
        (m.greatest_diameter_mm, 12.0),
        (m.feret_diameter_mm, 12.0),
        (m.inscribed_diameter_mm, 3.0),
        (m.equivalent_diameter_mm, 6.0),
        (m.eccentricity, 0.75),
    ] {
        assert!((value / expected - 1.0).abs() < 2e-3, "{value} {expected}");
    }
    assert!(DVec2::new(m.x_mm, m.y_mm).length() < 1e-9 && m.z_mm.abs() < 1e-9);
    assert!(found[0].standard_errors.is_none() && found[0].measured_share.is_none());
    assert!(found[1].measures.area_mm2.is_nan());
    assert!(found[1].remark.as_ref().unwrap().contains("the wall has a hole there"), "{:?}", found[1]);
    assert!(found[2].remark.as_ref().unwrap().contains("misses"), "{:?}", found[2]);
}

/// A stenosis as the thesis's noise shows it, reconstructed; its axis is z.
fn stenosis(seed: u64) -> Surface {
    let settings = simulate::SimulationSettings::default()
        .with_insertion(Insertion::steady())
        .with_noise(Noise::default().with_seed(seed));
    let simulation = simulated("stenosis", &settings);
    Reconstructor::new(Settings::default()).run(&simulation.recording).unwrap().surface()
}

/// Radius of the phantom, mm.
fn radius_mm(z: f64) -> f64 {
    10.0 - 4.5 * (-0.5 * ((z - 50.0) / 7.0).powi(2)).exp()
}

struct Seen {
    /// Error of each area, as a share of it, and in its standard errors.
    areas: Vec<[f64; 2]>,
    profile: Profile,
}

fn seen(seed: u64) -> Seen {
    let mesh = stenosis(seed);
    let axis = VesselAxis::through(&[DVec3::Z * 6.0, DVec3::Z * 94.0]).unwrap();
    let sections = Sections::of(&mesh, None).unwrap();
    let found = sections.across(&axis, 0, &places(2.0, 86.0, 1.0).unwrap());
    let truth = |at: f64| PI * radius_mm(6.0 + at).powi(2);
    let areas = found.iter().map(|s| {
        let off = s.measures.area_mm2 - truth(s.at_mm.unwrap());
        [off / truth(s.at_mm.unwrap()), off / s.standard_errors.unwrap().area_mm2]
    });
    let profile = Profile::of(&found, &LesionRules::default()).unwrap();
    Seen { areas: areas.collect(), profile }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn a_stenosis_is_measured_as_it_is() {
    let least_area = PI * 5.5_f64.powi(2);
    let (mut least_off, mut off) = (Vec::new(), Vec::new());
    for seed in 1..=5 {
        let Seen { areas, profile } = seen(seed);
        off.extend(areas.iter().map(|a| a[0].abs()));
        let least = profile.minimal_area_mm2.unwrap();
        least_off.push(least.value / least_area - 1.0);
        let [lesion] = &profile.lesions[..] else { panic!("{:?}", profile.lesions) };
        assert_eq!(lesion.kind, LesionKind::Stenosis);
        assert!((lesion.diameter_stenosis_percent.value - 45.0).abs() <= 2.0, "{lesion:?}");
        assert!(
            (lesion.area_stenosis_percent.value - 100.0 * (1.0 - 0.55 * 0.55)).abs() <= 2.0,
            "{lesion:?}"
        );
        assert!((lesion.at_mm + 6.0 - 50.0).abs() <= 2.0, "{lesion:?}");
        // 5 % of the reference: 4.5 e^(-z²/98) = 0.5, 14.7 mm on both sides.
        assert!((lesion.length_mm.value - 29.3).abs() <= 3.0, "{lesion:?}");
    }
    // Of single recordings it is 0.35 to 0.73 %, as their noise has it.
    let off = median(off);
    assert!(off <= 0.005, "{off}");
    println!("areas {off:.4} off, as a share; minimal area less the truth, as a share: {least_off:.4?}");
    assert!(least_off.iter().all(|off| off.abs() <= 0.02), "{least_off:?}");
}

#[test]
#[ignore = "200 reconstructions"]
fn intervals_hold_the_truth_in_200_seeds() {
    let (mut held, mut all, mut least_held, mut stenosis_held, mut worst) = (0, 0, 0, 0, 0.0_f64);
    let mut errors = Vec::new();
    let mut squares = 0.0;
    for seed in 1..=200 {
        let Seen { areas, profile } = seen(seed);
        all += areas.len();
        held += areas.iter().filter(|a| a[1].abs() <= 1.96).count();
        squares += areas.iter().map(|a| a[1] * a[1]).sum::<f64>();
        errors.push(median(areas.iter().map(|a| a[0].abs()).collect()));
        let least = profile.minimal_area_mm2.unwrap();
        let truth = PI * 5.5_f64.powi(2);
        let off = (least.value / truth - 1.0).abs();
        if off > 0.02 {
            println!(
                "seed {seed}: the minimal area is {:.2} % off, at {:.1} mm",
                100.0 * off,
                profile.minimal_area_at_mm.unwrap()
            );
        }
        worst = worst.max(off);
        least_held += usize::from((least.low..=least.high).contains(&truth));
        let percent = profile.lesions.first().map(|l| l.diameter_stenosis_percent);
        stenosis_held += usize::from(percent.is_some_and(|p| (p.low..=p.high).contains(&45.0)));
    }
    let share = held as f64 / all as f64;
    println!(
        "areas: {:.1} % in their intervals, errors {:.2} standard errors (root mean square), {:.3} % (median of medians); \
         minimal area in {least_held} of 200 (worst {:.2} % off), diameter stenosis in {stenosis_held} of 200",
        100.0 * share,
        (squares / all as f64).sqrt(),
        100.0 * median(errors),
        100.0 * worst
    );
    assert!((0.90..=0.98).contains(&share), "{share}");
}

#[test]
fn vtk_reads_the_axis_with_the_arrays_of_vmtk() {
    let Some(python) = python_with_vtk() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (surface, _) = wall("bifurcation");
    surface.write(&folder.path().join("vessel.stl")).unwrap();
    let (status, said, _) = lumenmesh(&["axis", "vessel.stl", "-o", "axis.vtp"], folder.path());
    assert!(status == 0 && said.contains("branch 1"), "{said}");
    let script = "
import sys, vtk
from vtk.util.numpy_support import vtk_to_numpy as array
reader = vtk.vtkXMLPolyDataReader(); reader.SetFileName(sys.argv[1]); reader.Update()
lines = reader.GetOutput(); data = lines.GetPointData()
names = ['MaximumInscribedSphereRadius', 'Abscissas', 'CenterlineSectionArea', 'Curvature', 'Torsion', 'BranchId']
radius, arc, area, curvature, torsion, branch = (array(data.GetArray(n)) for n in names)
assert lines.GetNumberOfLines() == 2 and set(branch) == {0, 1}, lines
assert array(lines.GetCellData().GetArray('BranchId')).tolist() == [0, 1]
assert array(data.GetArray('ParallelTransportNormals')).shape == (len(arc), 3)
print(radius.min(), radius.max(), arc.max())
";
    let said = python.run(script, &[&folder.path().join("axis.vtp")]);
    let numbers: Vec<f64> = said.split_whitespace().map(|n| n.parse().unwrap()).collect();
    assert!(numbers[0] > 3.0 && numbers[1] < 11.0 && numbers[2] > 90.0, "{said}");
    // It is an axis to measure along, too.
    let (status, said, errors) =
        lumenmesh(&["sections", "vessel.stl", "--axis", "axis.vtp", "--step", "10"], folder.path());
    assert!(status == 0 && errors.is_empty() && said.contains("minimal lumen area"), "{said}{errors}");
}

#[test]
fn sections_along_the_axis_as_a_user_asks_for_them() {
    let folder = tempfile::tempdir().unwrap();
    wall("stenosis").0.write(&folder.path().join("vessel.stl")).unwrap();
    let run =
        |arguments: &[&str]| lumenmesh(&[&["sections", "vessel.stl"], arguments].concat(), folder.path());
    let (status, said, errors) = run(&["--csv", "ours.csv"]);
    assert_eq!((status, errors.as_str()), (0, ""));
    assert!(said.contains("stenosis") && said.contains("% less than the reference"), "{said}");
    let csv = std::fs::read_to_string(folder.path().join("ours.csv")).unwrap();
    assert!(csv.starts_with("at_mm,area_mm2,perimeter_mm,least_diameter_mm,"), "{csv}");
    assert_eq!(csv.lines().count(), 102);
    let (status, ..) = run(&["--csv", "theirs.csv", "--columns", "holorama", "--from", "20", "--to", "30"]);
    assert_eq!(status, 0);
    let csv = std::fs::read_to_string(folder.path().join("theirs.csv")).unwrap();
    assert!(csv.starts_with("frame,position,phase,lumen_area,lumen_circumf,longest_distance,"), "{csv}");
    assert_eq!(csv.lines().count(), 12);
    let (_, json, _) = run(&["--json", "--at", "50,10"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let area = |k: usize| json["sections"][k]["area_mm2"].as_f64().unwrap();
    assert!((area(0) / (PI * 5.5 * 5.5) - 1.0).abs() < 0.01 && (area(1) / (PI * 100.0) - 1.0).abs() < 0.01);
    for (arguments, status, expected) in [
        (&["--step", "0"][..], 1, "setting step"),
        (&["--step", "nan"], 1, "setting step"),
        (&["--step", "1e-9"], 1, "at most a million"),
        (&["--from", "50", "--to", "20"], 1, "setting from, to: found 50 to 20 mm"),
        (&["--at", "400"], 1, "setting at: found 400 mm"),
        (&["--branch", "3"], 1, "setting branch: found 3, expected a branch below 1"),
        (&["--axis", "vessel.stl"], 1, "unknown ending \"stl\", expected one of .vtp"),
        (&["--stenosis", "0"], 1, "setting stenosis_percent"),
        (&["--against", "x.csv"], 2, "<REC>"),
        (&["--columns", "holorama"], 2, "--csv"),
    ] {
        let (found, _, said) = run(arguments);
        assert!(found == status && said.contains(expected), "{arguments:?}: {found} {said}");
    }
}

#[test]
fn every_branch_has_sections_along_its_own_axis() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let (status, said, errors) = lumenmesh(arguments, folder.path());
        assert!(status == 0, "{arguments:?}\n{said}{errors}");
        said
    };
    wall("side_branch").0.write(&folder.path().join("side.vtp")).unwrap();
    let said = run(&["sections", "side.vtp", "--csv", "all.csv"]);
    assert!(said.starts_with("branch") && said.contains("\nparting             branch 1, from"), "{said}");
    assert_eq!(said.matches("minimal lumen area").count(), 2, "{said}");
    let json: serde_json::Value = serde_json::from_str(&run(&["sections", "side.vtp", "--json"])).unwrap();
    let sections = json["sections"].as_array().unwrap();
    // Radii of the phantom.
    for (branch, radius_mm) in [(0, 11.0), (1, 6.0)] {
        let own = sections.iter().filter(|s| s["branch"] == branch);
        let areas: Vec<f64> = own.clone().filter_map(|s| s["area_mm2"].as_f64()).collect();
        let expected = PI * f64::powi(radius_mm, 2);
        let middle = median(areas.clone());
        assert!((middle / expected - 1.0).abs() < 0.05, "branch {branch}: {middle} against {expected}");
        // The same as when it is asked for alone.
        let number = branch.to_string();
        let alone = run(&["sections", "side.vtp", "--branch", &number, "--json"]);
        let alone: serde_json::Value = serde_json::from_str(&alone).unwrap();
        assert!(alone["branches"].is_null() && alone["sections"][0]["branch"].is_null());
        let of_alone: Vec<f64> =
            alone["sections"].as_array().unwrap().iter().filter_map(|s| s["area_mm2"].as_f64()).collect();
        assert_eq!(of_alone, areas);
        assert_eq!(json["branches"][branch]["profile"], alone["profile"]);
        assert_eq!(json["branches"][branch]["axis_length_mm"], alone["axis_length_mm"]);
    }
    let parting = &json["branches"][0]["partings"][0];
    assert_eq!(parting["branch"], 1);
    let within = |s: &serde_json::Value| {
        s["branch"] == 0
            && (parting["from_mm"].as_f64()..=parting["to_mm"].as_f64()).contains(&s["at_mm"].as_f64())
    };
    assert!(sections.iter().filter(|s| within(s)).all(|s| s["parting"] == 1 && s["area_mm2"].is_null()));
    let table = std::fs::read_to_string(folder.path().join("all.csv")).unwrap();
    assert!(table.starts_with("branch,parting,at_mm,area_mm2"), "{table}");
    assert_eq!(table.lines().count(), sections.len() + 1);
    // One axis only where places along it are asked for.
    let said = run(&["sections", "side.vtp", "--at", "10,20"]);
    assert!(said.starts_with("  at mm"), "{said}");
}

#[test]
fn a_real_vessel_keeps_its_sections_apart_from_its_branches() {
    let Some(path) = shared("data/aorta_arch_coarctation_bpm120.stl") else { return };
    let surface = Surface::read(&path).unwrap();
    let tree = VesselTree::of(&surface).unwrap();
    assert_eq!(tree.axes.len(), 4);
    assert!((tree.axes[0].length_mm() - 129.0).abs() < 4.0, "{}", tree.axes[0].length_mm());
    let sections = Sections::of(&surface, Some(&tree)).unwrap();
    let found = sections.across(&tree.axes[0], 0, &places(0.0, tree.axes[0].length_mm(), 0.5).unwrap());
    // The arch's own area; with the mouth of a branch it would be far more.
    for s in
        found.iter().filter(|s| (20.0..48.0).contains(&s.at_mm.unwrap()) && s.measures.area_mm2.is_finite())
    {
        assert!(s.measures.area_mm2 < 100.0, "{s:?}");
    }
    let profile = Profile::of(&found, &LesionRules::default()).unwrap();
    let least = profile.minimal_area_mm2.unwrap().value;
    // The stenosis's inscribed radius is given as 1.1 mm.
    assert!((PI * 1.1 * 1.1..PI * 2.0 * 2.0).contains(&least), "{least}");
}

#[test]
fn two_vessels_are_compared_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, surface: &Surface| surface.write(&folder.path().join(name)).unwrap();
    write("a.stl", &tube(200, 60, 10.0, 60.0));
    write("b.stl", &tube(200, 60, 11.0, 60.0));
    let mut aside = tube(200, 60, 10.0, 60.0);
    aside.nodes_mm.iter_mut().for_each(|p| p.x += 5.0);
    write("aside.stl", &aside);
    aside.nodes_mm.iter_mut().for_each(|p| p.x += 100.0);
    write("far.stl", &aside);
    let compare = |arguments: &[&str]| lumenmesh(&[&["compare"], arguments].concat(), folder.path());
    let json = |arguments: &[&str]| -> serde_json::Value {
        let (status, said, errors) = compare(&[arguments, &["--json"]].concat());
        assert_eq!((status, errors.as_str()), (0, ""));
        serde_json::from_str(&said).unwrap()
    };
    let is = |value: &serde_json::Value, expected: f64, within: f64| {
        let found = value.as_f64().unwrap();
        assert!((found - expected).abs() <= within, "{found}, expected {expected}");
    };
    let same = json(&["a.stl", "a.stl"]);
    is(&same["hausdorff_mm"], 0.0, 1e-9);
    is(&same["overlap"]["dice"], 1.0, 1e-4);
    let wider = json(&["a.stl", "b.stl", "--out", "map.vtp"]);
    is(&wider["a_to_b"]["mean_mm"], 1.0, 2e-3);
    is(&wider["signed_mean_mm"], -1.0, 2e-3);
    is(&wider["overlap"]["dice"], 2.0 * 100.0 / 221.0, 1e-3);
    is(&wider["overlap"]["volume_difference_percent"], 21.0, 0.05);
    let map = Surface::read(&folder.path().join("map.vtp")).unwrap();
    assert!(map.array("signed_error_mm").unwrap().iter().all(|e| (e + 1.0).abs() < 0.01));
    // Two circles whose centres are half a radius apart.
    let beside = json(&["a.stl", "aside.stl"]);
    is(&beside["overlap"]["dice"], 2.0 / PI * (0.25_f64.acos() - 0.25 * 0.9375_f64.sqrt()), 2e-3);
    let (status, said, _) = compare(&["a.stl", "b.stl"]);
    assert!(status == 0 && said.contains("Hausdorff") && said.contains("+21.00 % from A to B"), "{said}");
    for (arguments, expected) in [
        (&["a.stl", "far.stl"][..], "far.stl: lumen: found no plane"),
        (&["a.stl", "b.stl", "--out", "map.stl"], "unknown ending"),
        (&["a.stl", "b.stl", "--step", "0"], "setting step"),
    ] {
        let (status, _, said) = compare(arguments);
        assert!(status == 1 && said.contains(expected), "{said}");
    }
}
