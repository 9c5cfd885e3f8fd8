//! Meshes to simulate flow in.

use crate::support::vessel::simulated;
use crate::support::{lumenmesh, names, python_with, shared, skipped, tube};
use glam::DVec3;
use lumenmesh::evaluate::closed_volume_mm3;
use lumenmesh::flow::{EdgeLength, Extension, FaceKind, FlowMesh, FlowMeshSettings, WALL};
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{self, Insertion, Phantom, Shape};
use lumenmesh::surface::Surface;
use std::f64::consts::PI;
use std::path::Path;
use std::process::Command;

fn capped() -> FlowMeshSettings {
    FlowMeshSettings::default().with_cap(true)
}

/// The wall of a phantom.
fn phantom(shape: &str) -> Surface {
    Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap().surface().clone()
}

fn refusal(vessel: &Surface, settings: &FlowMeshSettings) -> String {
    FlowMesh::of(vessel, settings).unwrap_err().to_string()
}

#[test]
fn a_tube_becomes_a_closed_mesh_of_even_triangles() {
    let vessel = tube(40, 30, 10.0, 60.0);
    let mesh = FlowMesh::of(&vessel, &capped().with_edge(EdgeLength::Uniform(1.5))).unwrap();
    let topology = mesh.surface.topology();
    assert!(topology.is_closed() && topology.is_oriented_manifold());
    assert_eq!((topology.components, topology.euler_characteristic), (1, 2));
    let [wall, first, second] = &mesh.faces[..] else { panic!("{:?}", mesh.faces) };
    assert_eq!((wall.id, wall.kind), (WALL, FaceKind::Wall));
    for (cap, id, z) in [(first, 2, -30.0), (second, 3, 30.0)] {
        assert_eq!((cap.id, cap.kind), (id, FaceKind::Cap));
        // A polygon of 40 corners, which edges of 1.5 mm cut: at most 2π²/3 in the square of their number, 42.
        let area = 0.5 * 40.0 * 100.0 * (2.0 * PI / 40.0).sin();
        assert!((-0.006..1e-9).contains(&(cap.area_mm2 / area - 1.0)), "{cap:?}");
        assert!(DVec3::from_array(cap.centre_mm).distance(DVec3::Z * z) < 1.0, "{cap:?}");
        assert!(DVec3::from_array(cap.normal).dot(DVec3::Z * z.signum()) > 0.9999, "{cap:?}");
        let cut = cap.cut_off_mm.unwrap();
        assert!((0.1..2.0).contains(&cut), "{cut}");
    }
    let cut: f64 = mesh.faces.iter().filter_map(|face| face.cut_off_mm).sum();
    let volume = closed_volume_mm3(&mesh.surface).unwrap();
    assert!((volume / (first.area_mm2 * (60.0 - cut)) - 1.0).abs() < 0.005, "{volume}");
    let quality = mesh.quality;
    assert!(quality.min_angle_deg > 25.0 && quality.max_aspect < 2.5, "{quality:?}");
    assert!((quality.median_edge_mm / 1.5 - 1.0).abs() < 0.1, "{quality:?}");
    assert!(quality.max_deviation_mm < 0.1, "{quality:?}");
    assert!(mesh.measured.is_none() && mesh.measured_share().is_none());
    // Each face is written by itself, and all of them are the whole.
    let parts: usize = mesh.faces.iter().map(|face| mesh.face(face.id, 1.0).triangles.len()).sum();
    assert_eq!(parts, mesh.surface.triangles.len());
    // Without caps the ends stay open.
    let open = FlowMesh::of(&vessel, &FlowMeshSettings::default()).unwrap();
    assert_eq!((open.surface.topology().boundary_loops, open.faces.len()), (2, 1));
}

#[test]
fn edges_follow_the_radius_and_extensions_end_in_circles() {
    let settings =
        capped().with_edge(EdgeLength::OfRadius(0.2)).with_extension(Some(Extension::Diameters(2.0)));
    let vessel = phantom("frustum");
    let mesh = FlowMesh::of(&vessel, &settings).unwrap();
    let edge = |face: u32| {
        let part = mesh.face(face, 1.0);
        let lengths = part
            .triangles
            .iter()
            .map(|t| part.nodes_mm[t[0] as usize].distance(part.nodes_mm[t[1] as usize]));
        lengths.sum::<f64>() / part.triangles.len() as f64
    };
    let [_, first, second] = &mesh.faces[..] else { panic!("{:?}", mesh.faces) };
    let diameter = |face: &lumenmesh::flow::FlowFace| face.equivalent_diameter_mm.unwrap();
    let ratio = diameter(first) / diameter(second);
    assert!(!(0.8..1.25).contains(&ratio), "the ends differ: {ratio}");
    assert!((edge(first.id) / edge(second.id) / ratio - 1.0).abs() < 0.2, "{ratio}");
    // The wall reaches two diameters beyond the ends on both sides.
    let [low, high] = vessel.bounding_box_mm().unwrap();
    let [from, to] = mesh.surface.bounding_box_mm().unwrap();
    let added = (to - from).max_element() - (high - low).max_element();
    let expected = 2.0 * (diameter(first) + diameter(second));
    assert!((added / expected - 1.0).abs() < 0.1, "{added} {expected}");

    // An ellipse becomes a circle of the same area.
    let settings = settings.with_extension(Some(Extension::Millimetres(30.0)));
    let mesh = FlowMesh::of(&phantom("ellipse"), &settings).unwrap();
    for face in &mesh.faces[1..] {
        let part = mesh.face(face.id, 1.0);
        let centre = DVec3::from_array(face.centre_mm);
        let farthest = part.nodes_mm.iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
        assert!((2.0 * farthest / diameter(face) - 1.0).abs() < 0.03, "{farthest} {face:?}");
    }
}

#[test]
fn what_was_not_measured_is_told() {
    let settings = simulate::SimulationSettings::default().with_insertion(Insertion::steady());
    let recording = simulated("stenosis", &settings).recording;
    let lumen = Reconstructor::new(Settings::default()).run(&recording).unwrap();
    let mut vessel = lumen.surface();
    let whole = FlowMesh::of(&vessel, &capped()).unwrap();
    assert_eq!(whole.measured_share(), Some(1.0));
    // Caps are never measured.
    let measured = whole.measured.as_ref().unwrap();
    assert!(measured.iter().zip(&whole.face_of).all(|(&m, &face)| m == (face == WALL)));
    let error = whole.surface.array("standard_error_mm").unwrap();
    assert!(error.iter().filter(|e| e.is_finite()).all(|e| (0.0..1.0).contains(e)));
    assert!(error.iter().filter(|e| e.is_finite()).count() * 2 > error.len());

    // A stretch that no echo supports stays in the mesh, marked.
    let supported =
        vessel.nodes_mm.iter().map(|p| f64::from(u8::from(!(60.0..70.0).contains(&p.z)))).collect();
    vessel.set_array("supported", supported);
    let mesh = FlowMesh::of(&vessel, &capped()).unwrap();
    let share = mesh.measured_share().unwrap();
    assert!((share - (1.0 - 10.0 / 93.0)).abs() < 0.04, "{share}");
    let unmeasured: Vec<DVec3> = (0..mesh.face_of.len())
        .filter(|&t| mesh.is_given[t] && !mesh.measured.as_ref().unwrap()[t])
        .map(|t| mesh.surface.nodes_mm[mesh.surface.triangles[t][0] as usize])
        .collect();
    assert!(!unmeasured.is_empty() && unmeasured.iter().all(|p| (57.0..73.0).contains(&p.z)));
}

/// A tube without the triangles about some places of its wall.
fn with_holes(places: &[DVec3], radius_mm: f64) -> Surface {
    let mut vessel = tube(60, 60, 10.0, 60.0);
    let nodes = vessel.nodes_mm.clone();
    vessel.triangles.retain(|t| {
        let centre = t.iter().map(|&n| nodes[n as usize]).sum::<DVec3>() / 3.0;
        places.iter().all(|p| p.distance(centre) > radius_mm)
    });
    vessel
}

#[test]
fn holes_are_refused_with_their_places_or_closed_by_faces_of_their_own() {
    let vessel = with_holes(&[DVec3::X * 10.0, DVec3::new(0.0, 10.0, 15.0)], 4.0);
    let said = refusal(&vessel, &capped());
    assert!(
        said.contains("2 holes")
            && said.contains("--fill-holes")
            && said.contains("8.0 mm across at (9.55, 0.00, 0.00) mm"),
        "{said}"
    );
    let fine = capped().with_edge(EdgeLength::Uniform(0.8));
    let mesh = FlowMesh::of(&vessel, &fine.with_fill_holes(true)).unwrap();
    assert!(mesh.surface.topology().is_closed());
    let [_, _, _, first, second] = &mesh.faces[..] else { panic!("{:?}", mesh.faces) };
    for (hole, place) in [(first, DVec3::X * 10.0), (second, DVec3::new(0.0, 10.0, 15.0))] {
        assert_eq!(hole.kind, FaceKind::FilledHole);
        assert!(DVec3::from_array(hole.centre_mm).distance(place) < 1.5, "{hole:?}");
        assert!((8.0 - hole.equivalent_diameter_mm.unwrap()).abs() < 0.5, "{hole:?}");
    }
    // A hole that is cut off with an end needs no filling.
    let mesh = FlowMesh::of(&with_holes(&[DVec3::new(10.0, 0.0, 30.0)], 4.0), &capped()).unwrap();
    assert!((3.5..5.5).contains(&mesh.faces[2].cut_off_mm.unwrap()), "{:?}", mesh.faces);
    // One that is smaller than an edge leaves no face.
    let small = with_holes(&[DVec3::X * 10.0], 0.8);
    let mesh =
        FlowMesh::of(&small, &capped().with_fill_holes(true).with_edge(EdgeLength::Uniform(4.0))).unwrap();
    assert_eq!(mesh.closed_holes + mesh.faces.len(), 4, "{:?}", mesh.faces);
}

#[test]
fn vessels_that_make_no_mesh_are_refused_with_the_place() {
    let good = tube(40, 30, 10.0, 60.0);
    // A third triangle at an edge, and one that is turned round.
    let mut more = good.clone();
    more.nodes_mm.push(DVec3::new(20.0, 0.0, -28.0));
    let [_, a, b] = more.triangles[0];
    more.triangles.push([a, b, 40 * 31]);
    let said = refusal(&more, &capped());
    assert!(said.contains("3 triangles") && said.contains("edge at (9.88"), "{said}");
    let mut turned = good.clone();
    turned.triangles[100].swap(0, 1);
    assert!(refusal(&turned, &capped()).contains("opposite normals"));
    // A bend whose legs the extensions of one end join: it runs into itself.
    let bend = bent_tube(1.5 * PI);
    assert!(FlowMesh::of(&bend, &capped()).is_ok());
    let said = refusal(&bend, &capped().with_extension(Some(Extension::Millimetres(60.0))));
    assert!(said.contains("crosses itself") && said.contains("mesh at ("), "{said}");
    // Values out of range name the setting.
    for (settings, name) in [
        (capped().with_edge(EdgeLength::Uniform(0.0)), "edge"),
        (capped().with_edge(EdgeLength::OfRadius(f64::NAN)), "edge_per_radius"),
        (capped().with_extension(Some(Extension::Millimetres(-1.0))), "flow_extensions"),
    ] {
        assert!(refusal(&good, &settings).contains(&format!("setting {name}: ")));
    }
    // More triangles than a machine holds are refused before they are made.
    let said = refusal(&good, &capped().with_edge(EdgeLength::Uniform(0.001)));
    assert!(said.contains("million triangles") && said.contains("at most 30 million"), "{said}");
    let none = Surface { triangles: Vec::new(), ..good };
    assert!(refusal(&none, &capped()).contains("triangles"));
}

/// A tube about an arc of a circle of 30 mm radius.
fn bent_tube(angle_rad: f64) -> Surface {
    let mut bend = tube(30, 60, 8.0, 1.0);
    for p in &mut bend.nodes_mm {
        let (radius, angle) = (30.0 + p.x, (p.z + 0.5) * angle_rad);
        *p = DVec3::new(radius * angle.cos(), p.y, radius * angle.sin());
    }
    bend.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    bend
}

#[test]
fn the_same_vessel_gives_the_same_mesh_on_any_number_of_threads() {
    let vessel = phantom("bifurcation");
    let settings = capped().with_extension(Some(Extension::Diameters(1.0)));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| FlowMesh::of(&vessel, &settings).unwrap())
    };
    assert_eq!(on(1), on(5));
}

/// Independent readers: VTK's feature edges, trimesh, and MeshLab's search for triangles that cross. Prints nothing but ok.
const CHECKER: &str = "
import sys, json, numpy as np, vtk, trimesh, pymeshlab
from vtk.util.numpy_support import vtk_to_numpy as array
reader = vtk.vtkXMLPolyDataReader(); reader.SetFileName(sys.argv[1]); reader.Update()
mesh = reader.GetOutput()
points = array(mesh.GetPoints().GetData())
faces = array(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3)
ids = array(mesh.GetCellData().GetArray('ModelFaceID'))
about = json.load(open(sys.argv[2]))
assert sorted(set(ids)) == [face['id'] for face in about['faces']], set(ids)
assert [int((ids == face['id']).sum()) for face in about['faces']] == [face['triangles'] for face in about['faces']]
edges = vtk.vtkFeatureEdges(); edges.SetInputData(mesh)
edges.FeatureEdgesOff(); edges.ManifoldEdgesOff(); edges.BoundaryEdgesOn(); edges.NonManifoldEdgesOn(); edges.Update()
assert edges.GetOutput().GetNumberOfCells() == 0
solid = trimesh.Trimesh(points, faces, process=False)
assert solid.is_watertight and solid.is_winding_consistent
assert abs(solid.volume / about['volume_mm3'] - 1) < 1e-9 and solid.volume > 0
angles = np.degrees(solid.face_angles.min())
assert abs(angles - about['quality']['min_angle_deg']) < 1e-6 and angles > 10, angles
def crossing(points):
    lab = pymeshlab.MeshSet(); lab.add_mesh(pymeshlab.Mesh(points, faces))
    lab.compute_selection_by_self_intersections_per_face()
    return lab.current_mesh().selected_face_number()
assert crossing(points) == 0, crossing(points)
# The search finds what is there: a node that is pulled through the wall opposite.
pulled = points.copy(); middle = points.mean(0)
far = int(np.argmax(np.linalg.norm(points - middle, axis=1)))
pulled[far] = 2 * middle - points[far] + 1.0
assert crossing(pulled) > 0
print('ok')
";

#[test]
fn meshes_are_closed_for_independent_readers_and_gmsh_fills_them() {
    let python = python_with("numpy, vtk, trimesh, pymeshlab");
    let has_gmsh = Command::new("gmsh").arg("--version").output().is_ok();
    if !has_gmsh {
        skipped("gmsh is missing: no volume mesh is made", "LUMENMESH_REQUIRE_TOOLS");
    }
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let (status, said, errors) = lumenmesh(arguments, folder.path());
        assert!(status == 0, "{arguments:?}\n{said}{errors}");
        said
    };
    run(&["simulate", "--vessel", "aorta", "-o", "aorta.mat"]);
    run(&["reconstruct", "aorta.mat", "-o", "aorta.vtp"]);
    let mut cases = vec![("aorta.vtp".to_owned(), vec!["--flow-extensions", "3d"])];
    if let Some(coarctation) = shared("data/aorta_arch_coarctation_bpm120.stl") {
        cases.push((absolute(&coarctation).to_str().unwrap().to_owned(), vec![]));
    }
    if let Some(contours) = shared("data/ivus_narco/ivus_rest/diastolic_contours.csv") {
        run(&["import", "pullback", absolute(&contours).to_str().unwrap(), "-o", "narco.mat"]);
        run(&["reconstruct", "narco.mat", "-o", "narco.vtp"]);
        cases.push(("narco.vtp".into(), vec!["--edge-per-radius", "0.4"]));
    }
    for (vessel, options) in cases {
        let mut arguments = vec!["mesh", &vessel, "--cap", "-o", "flow.vtp"];
        arguments.extend(options);
        let said = run(&arguments);
        assert!(said.contains("closed") && said.contains("cap_2"), "{said}");
        if let Some(python) = &python {
            let said = python
                .run(CHECKER, &[&folder.path().join("flow.vtp"), &folder.path().join("flow.faces.json")]);
            assert_eq!(said.trim(), "ok", "{vessel}");
        }
        if has_gmsh {
            tetrahedra(folder.path());
        }
    }
}

fn absolute(path: &Path) -> std::path::PathBuf {
    path.canonicalize().unwrap()
}

/// Lets Gmsh fill `flow.vtp` with tetrahedra whose volume is the mesh's.
fn tetrahedra(folder: &Path) {
    let (status, said, errors) = lumenmesh(&["convert", "flow.vtp", "-o", "flow.stl"], folder);
    assert_eq!(status, 0, "{said}{errors}");
    let volume = closed_volume_mm3(&Surface::read(&folder.join("flow.stl")).unwrap().joined()).unwrap();
    std::fs::write(
        folder.join("flow.geo"),
        "Merge \"flow.stl\";\nSurface Loop(1) = {1};\nVolume(1) = {1};\nMesh.MeshSizeExtendFromBoundary = 1;\n\
         Plugin(MeshVolume).Run;\nMesh 3;\nPlugin(MeshVolume).Dimension = 3;\nPlugin(MeshVolume).Run;\n",
    )
    .unwrap();
    let output = Command::new("gmsh")
        .args(["-3", "-v", "4", "flow.geo", "-o", "flow.msh", "-format", "msh2"])
        .current_dir(folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && !said.contains("Error"), "{said}");
    let mesh = std::fs::read_to_string(folder.join("flow.msh")).unwrap();
    let mut lines = mesh.lines();
    let mut numbers = |mark: &str, skip: usize| -> Vec<Vec<f64>> {
        lines.by_ref().find(|line| *line == mark).unwrap();
        let count: usize = lines.next().unwrap().parse().unwrap();
        let of = |line: &str| line.split_whitespace().skip(skip).map(|n| n.parse().unwrap()).collect();
        lines.by_ref().take(count).map(of).collect()
    };
    let nodes: Vec<DVec3> = numbers("$Nodes", 1).iter().map(|p| DVec3::new(p[0], p[1], p[2])).collect();
    // Type 4: a tetrahedron; its nodes are the last four numbers.
    let elements = numbers("$Elements", 1);
    let filled: f64 = elements
        .iter()
        .filter(|element| element[0] == 4.0)
        .map(|element| {
            let [a, b, c, d] = [4, 3, 2, 1].map(|k| nodes[element[element.len() - k] as usize - 1]);
            ((b - a).cross(c - a).dot(d - a) / 6.0).abs()
        })
        .sum();
    assert!((filled / volume - 1.0).abs() < 1e-3, "{filled} {volume}\n{said}");
}

#[test]
fn the_command_writes_a_mesh_its_faces_and_their_names() {
    let folder = tempfile::tempdir().unwrap();
    phantom("stenosis").write(&folder.path().join("vessel.stl")).unwrap();
    let run = |arguments: &[&str]| lumenmesh(arguments, folder.path());
    let (status, said, errors) = run(&[
        "mesh",
        "vessel.stl",
        "--cap",
        "--out",
        "flow.vtp",
        "--units",
        "cm",
        "--stl-per-face",
        "--space",
        "lps",
    ]);
    assert!(status == 0 && errors.is_empty(), "{said}{errors}");
    assert!(
        said.contains("does not say which wall was measured") && said.contains("smallest angle"),
        "{said}"
    );
    assert_eq!(
        names(folder.path()),
        ["flow.faces.json", "flow.vtp", "flow_cap_1.stl", "flow_cap_2.stl", "flow_wall.stl", "vessel.stl"]
    );
    let (mesh, space) = Surface::read_with_space(&folder.path().join("flow.vtp")).unwrap();
    assert_eq!(space.unwrap().to_string(), "LPS");
    // 100 mm long, in cm.
    let [low, high] = mesh.bounding_box_mm().unwrap();
    assert!(((high - low).max_element() / 10.0 - 1.0).abs() < 0.03);
    let text = std::fs::read_to_string(folder.path().join("flow.faces.json")).unwrap();
    let about: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(about["units"], "cm");
    assert_eq!(about["faces"][0]["name"], "wall");
    assert_eq!(about["faces"][2]["id"], 3);
    assert!(about["measured_share"].is_null());
    let parts: usize = ["wall", "cap_1", "cap_2"]
        .map(|name| Surface::read(&folder.path().join(format!("flow_{name}.stl"))).unwrap().triangles.len())
        .iter()
        .sum();
    assert_eq!(parts, mesh.triangles.len());

    for (arguments, words) in [
        (vec!["--edge", "0"], "setting edge: found 0"),
        (vec!["--flow-extensions", "far"], "a length in mm, or in diameters, such as 5d"),
        (vec!["--edge", "1", "--edge-per-radius", "0.1"], "cannot be used with"),
    ] {
        let mut all = vec!["mesh", "vessel.stl", "-o", "no.vtp"];
        all.extend(arguments);
        let (status, said, errors) = run(&all);
        assert!(status != 0 && said.is_empty() && errors.contains(words), "{errors}");
    }
    // Nor is the vessel overwritten by the file of a face.
    let wall = folder.path().join("new_wall.stl");
    std::fs::copy(folder.path().join("vessel.stl"), &wall).unwrap();
    let before = std::fs::read(&wall).unwrap();
    let (status, _, errors) = run(&["mesh", "new_wall.stl", "-o", "new.vtp", "--stl-per-face"]);
    assert!(status == 1 && errors.contains("new_wall.stl"), "{errors}");
    assert!(std::fs::read(&wall).unwrap() == before && !folder.path().join("new.vtp").exists());
    let (status, _, errors) = run(&["mesh", "vessel.stl", "-o", "no.gmsh"]);
    assert!(status == 1 && errors.contains("unknown ending"), "{errors}");
    assert!(!folder.path().join("no.vtp").exists() && !folder.path().join("no.faces.json").exists());
}
