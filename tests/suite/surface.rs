//! Surfaces: what the files hold, and what a surface says about itself.

use crate::support::{python_with_vtk, shared, tetrahedron, tube};
use glam::DVec3;
use lumenmesh::surface::{NodeArray, Space, Surface, Topology};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

const ENDINGS: [&str; 5] = ["vtp", "ply", "stl", "obj", "mat"];

/// A tube whose numbers need every bit of an f64, with arrays that hold the awkward values.
fn awkward_surface() -> Surface {
    let mut surface = tube(7, 5, 11.0 / 3.0, 10.0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for p in &mut surface.nodes_mm {
        *p += DVec3::new(rng.random(), rng.random(), rng.random()) * 1e-3 + DVec3::new(300.1, -200.2, 1e-17);
    }
    let count = surface.nodes_mm.len();
    surface.set_array("residual_mm", (0..count).map(|k| (k as f64).sqrt() - 2.0).collect());
    let mut support = vec![f64::NAN; count];
    (support[0], support[1], support[2]) = (f64::INFINITY, -0.0, f64::MIN_POSITIVE);
    surface.set_array("support", support);
    surface
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

fn assert_same(a: &Surface, b: &Surface) {
    assert_eq!(a.nodes_mm, b.nodes_mm);
    assert_eq!(a.triangles, b.triangles);
    let arrays =
        |s: &Surface| -> Vec<_> { s.arrays.iter().map(|a| (a.name.clone(), bits(&a.values))).collect() };
    assert_eq!(arrays(a), arrays(b));
}

pub fn written(surface: &Surface, folder: &Path, ending: &str) -> PathBuf {
    let path = folder.join(format!("mesh.{ending}"));
    surface.write(&path).unwrap();
    path
}

pub fn read_bytes(ending: &str, bytes: &[u8]) -> lumenmesh::Result<Surface> {
    // One folder for all files of a test: to make one takes longer than to read such a file.
    thread_local!(static FOLDER: tempfile::TempDir = tempfile::tempdir().unwrap());
    let path = FOLDER.with(|folder| folder.path().join(format!("mesh.{ending}")));
    std::fs::write(&path, bytes).unwrap();
    Surface::read(&path)
}

pub fn error_of(ending: &str, bytes: &[u8]) -> String {
    read_bytes(ending, bytes).expect_err("this file must not load").to_string()
}

#[test]
fn vtp_ply_and_mat_keep_positions_and_arrays_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let surface = awkward_surface();
    for ending in ["vtp", "ply", "mat"] {
        assert_same(&Surface::read(&written(&surface, folder.path(), ending)).unwrap(), &surface);
    }
}

#[test]
fn obj_keeps_positions_to_the_bit_and_carries_no_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let mut surface = awkward_surface();
    let read = Surface::read(&written(&surface, folder.path(), "obj")).unwrap();
    surface.arrays.clear();
    assert_same(&read, &surface);
}

#[test]
fn stl_keeps_single_precision_and_welds_back_to_the_same_topology() {
    let folder = tempfile::tempdir().unwrap();
    let surface = awkward_surface();
    let read = Surface::read(&written(&surface, folder.path(), "stl")).unwrap();
    assert_eq!(read.topology(), surface.topology());
    assert!(read.arrays.is_empty());
    // Nodes come in the order in which triangles name them.
    for (a, b) in read.triangles.iter().zip(&surface.triangles) {
        for (a, b) in a.iter().zip(b) {
            let (a, b) = (read.nodes_mm[*a as usize], surface.nodes_mm[*b as usize]);
            assert_eq!(a, b.as_vec3().as_dvec3());
        }
    }
}

#[test]
fn the_same_surface_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let surface = awkward_surface();
    for ending in ENDINGS {
        let first = std::fs::read(written(&surface, folder.path(), ending)).unwrap();
        assert_eq!(first, std::fs::read(written(&surface, folder.path(), ending)).unwrap());
    }
}

/// The corners of all triangles: in an STL nodes have another order.
fn corners(surface: &Surface) -> Vec<[DVec3; 3]> {
    surface.triangles.iter().map(|t| t.map(|n| surface.nodes_mm[n as usize])).collect()
}

#[test]
fn files_name_their_axes_and_are_read_in_those_of_the_tracker() {
    let folder = tempfile::tempdir().unwrap();
    let surface = tetrahedron();
    for ending in ENDINGS {
        let path = folder.path().join(format!("mesh.{ending}"));
        for space in [Space::Ras, Space::Lps] {
            surface.write_in(&path, space).unwrap();
            let (read, marked) = Surface::read_with_space(&path).unwrap();
            assert_eq!((marked, corners(&read)), (Some(space), corners(&surface)), "{ending}");
        }
        // The mark is what makes the difference: without it the numbers are taken as they are.
        let bytes = std::fs::read(&path).unwrap();
        let marks: [(&[u8], &[u8]); 3] =
            [(b"SPACE", b"WHERE"), (b"space", b"where"), (b"SPACE=LPS", b"SPACE=RAS")];
        let mut changed = bytes.clone();
        for (mark, other) in &marks[..2] {
            while let Some(at) = changed.windows(5).position(|w| w == *mark) {
                changed[at..at + 5].copy_from_slice(other);
            }
        }
        assert!(changed != bytes, "{ending}");
        std::fs::write(&path, changed).unwrap();
        let (read, marked) = Surface::read_with_space(&path).unwrap();
        assert_eq!(marked, None, "{ending}");
        assert!(read.nodes_mm.contains(&DVec3::NEG_X) && !read.nodes_mm.contains(&DVec3::X), "{ending}");
    }
    for (ending, text) in [
        (
            "vtk",
            "# vtk DataFile Version 3.0\n3D Slicer output. SPACE=LPS\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n\
                 1 0 0 0 1 0 0 0 1\nPOLYGONS 1 4\n3 0 1 2\n",
        ),
        ("obj", "# 3D Slicer output. SPACE=LPS\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n"),
        (
            "stl",
            "solid 3D Slicer output. SPACE=LPS\nfacet normal 0 0 0\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\n\
                 endloop\nendfacet\nendsolid\n",
        ),
    ] {
        assert_eq!(
            read_bytes(ending, text.as_bytes()).unwrap().nodes_mm,
            [DVec3::NEG_X, DVec3::NEG_Y, DVec3::Z]
        );
    }
}

#[test]
fn meshes_of_matlab_that_cannot_be_used_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.mat");
    let triangle = Surface {
        nodes_mm: vec![DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 1, 2]],
        arrays: vec![NodeArray { name: "é 1".into(), values: vec![1.0, 2.0, 3.0] }],
    };
    triangle.write(&path).unwrap();
    assert_eq!(Surface::read(&path).unwrap().arrays[0].name, "array___1");
    let bytes = std::fs::read(&path).unwrap();
    let changed = |from: &[u8], to: &[u8]| {
        let at = bytes.windows(from.len()).position(|w| w == from).unwrap();
        let mut changed = bytes.clone();
        changed[at..at + to.len()].copy_from_slice(to);
        error_of("mat", &changed)
    };
    let message = changed(b"faces", b"facets"[..5].as_ref());
    assert!(
        message.contains("faces: found variables ") && message.contains("expected vertices (V×3)"),
        "{message}"
    );
    let [three, four] = [3.0_f64, 4.0].map(f64::to_le_bytes);
    let message = changed(&three, &four);
    assert!(message.contains("faces, row 1: found 4, expected a node from 1 to 3"), "{message}");
    let mut twice = triangle.clone();
    twice.set_array("vertices", vec![0.0; 3]);
    let message = twice.write(&path).unwrap_err().to_string();
    assert!(message.contains("two variables would be named \"vertices\""), "{message}");
    assert_eq!(std::fs::read(&path).unwrap(), bytes, "nothing is lost");
}

#[test]
fn a_broken_surface_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut dangling = tetrahedron();
    dangling.triangles[2][1] = 4;
    let mut short = tetrahedron();
    short.set_array("r", vec![1.0; 3]);
    for ending in ENDINGS {
        let path = folder.path().join(format!("mesh.{ending}"));
        let text = dangling.write(&path).unwrap_err().to_string();
        assert_eq!(text, "surface: triangle 2: found node 4, expected a node below 4");
        let text = short.write(&path).unwrap_err().to_string();
        assert_eq!(text, "surface: node array \"r\": found 3 values, expected 4, one per node");
        assert!(!path.exists());
    }
    let text = tetrahedron().write(&folder.path().join("mesh.3mf")).unwrap_err().to_string();
    assert!(
        text.ends_with("mesh.3mf: unknown ending \"3mf\", expected one of .vtp, .ply, .stl, .obj, .mat"),
        "{text}"
    );
}

#[test]
fn a_surface_without_triangles_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let nodes = Surface { triangles: Vec::new(), ..tetrahedron() };
    for ending in ENDINGS {
        let path = folder.path().join(format!("mesh.{ending}"));
        let text = nodes.write(&path).unwrap_err().to_string();
        assert_eq!(text, "surface: triangles: found none, expected at least one");
        assert!(!path.exists());
    }
}

#[test]
fn obj_reads_polygons_and_indices_from_the_end() {
    let text = b"# quad, with slashes\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\ng a\nf 1/1/1 2//1 3/3 4\nf -4 -3 -2\n";
    let surface = read_bytes("obj", text).unwrap();
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
}

#[test]
fn ply_reads_text_and_both_byte_orders_and_passes_over_what_it_does_not_know() {
    let header = |format: &str| {
        format!(
            "ply\r\nformat {format} 1.0\r\ncomment x\r\nelement camera 1\r\nproperty list uchar short k\r\nelement vertex 4\r\n\
             property float x\r\nproperty float y\r\nproperty double z\r\nproperty uchar red\r\nelement face 1\r\n\
             property uchar flag\r\nproperty list uchar uint vertex_index\r\nend_header\r\n"
        )
    };
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0f32]];
    let mut text = header("ascii").into_bytes();
    text.extend(b"2 7 -8\n0 0 0.5 200\n1 0 0.5 201\n1 1 0.5 202\n0 1 0.5 203\n9 4 0 1 2 3");
    let binary = |big: bool| {
        let mut bytes = header(if big { "binary_big_endian" } else { "binary_little_endian" }).into_bytes();
        let mut put = |mut word: Vec<u8>| {
            if !big {
                word.reverse();
            }
            bytes.extend(word);
        };
        put(vec![2]);
        put(7i16.to_be_bytes().into());
        put((-8i16).to_be_bytes().into());
        for (k, [x, y]) in corners.into_iter().enumerate() {
            put(x.to_be_bytes().into());
            put(y.to_be_bytes().into());
            put(0.5f64.to_be_bytes().into());
            put(vec![200 + k as u8]);
        }
        put(vec![9]);
        put(vec![4]);
        (0..4u32).for_each(|n| put(n.to_be_bytes().into()));
        bytes
    };
    for bytes in [text, binary(false), binary(true)] {
        let surface = read_bytes("ply", &bytes).unwrap();
        assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(surface.nodes_mm[2], DVec3::new(1.0, 1.0, 0.5));
        assert_eq!(surface.array("red"), Some([200.0, 201.0, 202.0, 203.0].as_slice()));
    }
}

#[test]
fn stl_text_is_welded_and_degenerate_triangles_are_dropped() {
    let facet = |points: [&str; 3]| {
        let corners: String = points.iter().map(|p| format!("      vertex {p}\n")).collect();
        format!("  facet normal 0 0 0\n    outer loop\n{corners}    endloop\n  endfacet\n")
    };
    let text = format!(
        "solid quad\n{}{}{}endsolid quad\n",
        facet(["0 0 0", "1 0 0", "1 1 0"]),
        facet(["-0 0 0", "1 1 0", "0 1e0 0"]),
        facet(["0 0 0", "1 0 0", "-0 0 -0"])
    );
    let surface = read_bytes("stl", text.as_bytes()).unwrap();
    assert_eq!(surface.nodes_mm.len(), 4);
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn a_binary_stl_may_begin_like_a_text_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = std::fs::read(written(&tetrahedron(), folder.path(), "stl")).unwrap();
    bytes[..6].copy_from_slice(b"solid ");
    assert_eq!(read_bytes("stl", &bytes).unwrap().topology(), tetrahedron().topology());
}

#[test]
fn errors_name_file_field_found_and_expected() {
    let vtp = |polys: &str| {
        format!(
            "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"3\"><Points><DataArray type=\"Float32\" \
             NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 0 1 0</DataArray></Points><Polys>{polys}</Polys></Piece>\
             </PolyData></VTKFile>"
        )
    };
    let cell = |corners: &str, end: &str| {
        vtp(&format!(
            "<DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">{corners}</DataArray>\
             <DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">{end}</DataArray>"
        ))
    };
    assert!(read_bytes("vtp", cell("0 1 2", "3").as_bytes()).is_ok());
    let ply = |rows: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}"
        )
    };
    let cases: [(&str, String, &str); 17] = [
        ("obj", String::new(), "content: found an empty file, expected a surface"),
        ("obj", "v 0 0 0\n".into(), "triangles: found none (nodes: 1), expected at least one"),
        ("obj", "v 0 0 zero\n".into(), "line 1: found zero, expected three coordinates"),
        ("obj", "v 0 0\n".into(), "line 1: found the end of the line, expected three coordinates"),
        (
            "obj",
            "v 0 0 0\nv 1 0 0\nv 0 NaN 0\nf 1 2 3\n".into(),
            "position of node 2: found [0, NaN, 0], expected finite coordinates",
        ),
        ("obj", "v 0 0 0\nf 1 1 7\n".into(), "polygon 0: found node 6, expected a node from 0 to below 1"),
        ("obj", "v 0 0 0\nf 1 1 -2\n".into(), "line 2: found -2, expected an index, 1 or more, or -1 to -1"),
        ("obj", "v 0 0 0\nf 1 1\n".into(), "polygon 0: found 2 corners, expected 3 or more"),
        ("ply", "plain\n".into(), "header line 1: found plain, expected ply"),
        ("ply", "ply\nformat ascii 1.0\n".into(), "header: found the end of the file, expected end_header"),
        (
            "ply",
            ply("0 0 0 1 0 0 0 1 0 3 0 1 3"),
            "polygon 0: found node 3, expected a node from 0 to below 3",
        ),
        ("ply", ply("0 0 0 1 0 0 0 1 x 3 0 1 2"), "vertex 2: z: found x, expected a number"),
        (
            "ply",
            ply("0 0 0 1 0 0 0 1 0 9 0 1 2"),
            "face 0: vertex_indices: found a list of 9, expected a list that the file holds",
        ),
        ("stl", "nothing".into(), "line 1: found nothing, expected solid, which begins a text"),
        ("vtp", cell("0 1 2", "4"), "Polys offset 0: found 4, expected 0 to 3"),
        ("vtp", cell("0 1 -2", "3"), "polygon 0: found node -2, expected a node from 0 to below 3"),
        (
            "vtp",
            "<VTKFile type=\"ImageData\"/>".into(),
            "VTKFile type: found ImageData, expected PolyData or UnstructuredGrid",
        ),
    ];
    for (ending, content, expected) in cases {
        let text = error_of(ending, content.as_bytes());
        assert!(text.contains(&format!("mesh.{ending}: {expected}")), "{ending}: {text}");
    }
    let missing = Surface::read(Path::new("no/such.vtp")).unwrap_err().to_string();
    assert!(missing.starts_with("no/such.vtp: cannot read: "), "{missing}");
}

#[test]
fn a_header_that_promises_too_much_is_refused_before_memory_is_asked_for() {
    let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000000\nproperty double x\nproperty double y\n\
               property double z\nelement face 1\nproperty list uint int vertex_indices\nend_header\n";
    assert!(error_of("ply", ply.as_bytes()).contains("found 0 bytes, expected the 4000000000000 rows"));
    // Rows without properties take no bytes: they must not be walked through either.
    let empty = "ply\nformat ascii 1.0\nelement nothing 18446744073709551615\nend_header\n";
    assert!(error_of("ply", empty.as_bytes()).contains("triangles: found none"));
    let vtp = "<VTKFile type=\"PolyData\" compressor=\"vtkZLibDataCompressor\"><PolyData><Piece NumberOfPoints=\"9999999999\">\
               <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"binary\">AQAAAP///38AAAAABAAAAA==AAAAAA==\
               </DataArray></Points></Piece></PolyData></VTKFile>";
    assert!(error_of("vtp", vtp.as_bytes()).contains("arrays of 4294967294 bytes or more in memory"));
    let mut stl = vec![0u8; 84];
    stl[80..].fill(255);
    assert!(
        error_of("stl", &stl).contains("84 bytes, expected 214748364834 bytes for the 4294967295 triangles")
    );
}

/// Every cut must be noticed: no format of ours is whole without its last byte (but for the line break of a text).
#[test]
fn truncated_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["vtp", "ply", "stl"] {
        let bytes = std::fs::read(written(&awkward_surface(), folder.path(), ending)).unwrap();
        let whole = bytes.trim_ascii_end().len();
        for length in 0..whole {
            let cut = read_bytes(ending, &bytes[..length]);
            // The closing tags after PolyData say nothing more.
            let harmless = ending == "vtp" && length + "</VTKFile>\n".len() >= whole;
            assert!(cut.is_err() || harmless, "{ending} cut to {length} of {whole} bytes still loads");
        }
    }
}

#[test]
fn flipped_bytes_never_panic_and_what_loads_is_sound() {
    let folder = tempfile::tempdir().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut loaded, mut refused) = (0, 0);
    for ending in ENDINGS {
        let bytes = std::fs::read(written(&awkward_surface(), folder.path(), ending)).unwrap();
        for _ in 0..3000 {
            let mut damaged = bytes.clone();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..damaged.len());
                damaged[at] = rng.random();
            }
            match read_bytes(ending, &damaged) {
                Ok(surface) => {
                    surface.check().unwrap();
                    assert!(surface.nodes_mm.iter().all(|p| p.is_finite()));
                    let _ = (surface.topology(), surface.node_normals());
                    loaded += 1;
                }
                Err(_) => refused += 1,
            }
        }
    }
    // Neither branch may be vacuous.
    assert!(loaded > 100 && refused > 100, "{loaded} loaded, {refused} refused");
}

#[test]
fn the_topology_of_known_shapes() {
    let closed = tetrahedron().topology();
    assert_eq!((closed.components, closed.euler_characteristic, closed.boundary_loops), (1, 2, 0));
    assert!(closed.is_closed() && closed.is_oriented_manifold());

    let open = tube(12, 5, 10.0, 10.0).topology();
    let mut expected = Topology::default();
    (expected.nodes, expected.edges, expected.triangles) = (72, 192, 120);
    (expected.boundary_edges, expected.boundary_loops, expected.components) = (24, 2, 1);
    assert_eq!(open, expected);
}

#[test]
fn the_topology_counts_each_defect() {
    let mut turned = tetrahedron();
    turned.triangles[0].swap(0, 1);
    assert_eq!(turned.topology().inconsistent_edges, 3);

    let mut doubled = tetrahedron();
    doubled.triangles.push(doubled.triangles[0]);
    let doubled = doubled.topology();
    assert_eq!((doubled.duplicate_triangles, doubled.non_manifold_edges), (1, 3));

    let mut flat = tetrahedron();
    flat.triangles.push([0, 0, 1]);
    flat.nodes_mm.extend([DVec3::X * 5.0, DVec3::X * 6.0, DVec3::X * 7.0]);
    flat.triangles.push([4, 5, 6]);
    let flat = flat.topology();
    assert_eq!((flat.degenerate_triangles, flat.components, flat.boundary_loops), (2, 2, 1));
}

#[test]
fn areas_and_normals_of_known_shapes() {
    let tube = tube(256, 4, 10.0, 30.0);
    let perimeter = 2.0 * 256.0 * 10.0 * (std::f64::consts::PI / 256.0).sin();
    assert!((tube.area_mm2() - perimeter * 30.0).abs() < 1e-9);
    assert!((tube.node_areas_mm2().iter().sum::<f64>() - tube.area_mm2()).abs() < 1e-9);
    for (p, normal) in tube.nodes_mm.iter().zip(tube.node_normals()) {
        // End rings see an uneven fan of triangles: half a facet's angle is the most that can tilt them.
        assert!(normal.dot(DVec3::new(p.x, p.y, 0.0).normalize()) > (std::f64::consts::PI / 256.0).cos());
    }
    // Turned inside out, the normals point inwards.
    let mut inverted = tube;
    inverted.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    assert!(inverted.node_normals()[0].dot(inverted.nodes_mm[0]) < 0.0);
}

#[test]
fn real_lumen_surfaces_weld_to_their_stated_topology() {
    let cases = [
        ("aorta_adult_full_steve", 39_704, 9, Some(-7)),
        ("aorta_arch_coarctation_bpm120", 22_983, 5, None),
        ("coronary_tree_phantom_vukicevic", 12_960, 7, None),
        ("aorto_iliac_bifurcation_vmtk", 11_887, 3, None),
    ];
    for (name, triangles, openings, euler) in cases {
        let Some(path) = shared(&format!("data/{name}.stl")) else { return };
        let topology = Surface::read(&path).unwrap().topology();
        assert_eq!(
            (topology.triangles, topology.boundary_loops),
            (triangles, openings),
            "{name}: {topology:?}"
        );
        assert!(euler.is_none_or(|euler| topology.euler_characteristic == euler), "{name}: {topology:?}");
        assert!(topology.is_oriented_manifold(), "{name}: {topology:?}");
    }
}

const VTK_READS: &str = r#"
import sys, json, vtk
from vtk.util.numpy_support import vtk_to_numpy
reader = {"vtp": vtk.vtkXMLPolyDataReader, "ply": vtk.vtkPLYReader, "stl": vtk.vtkSTLReader, "obj": vtk.vtkOBJReader}[sys.argv[1].rsplit(".")[-1]]()
reader.SetFileName(sys.argv[1]); reader.Update()
mesh = reader.GetOutput()
cells = vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).tolist()
data = mesh.GetPointData()
# As text: JSON has no NaN.
text = lambda array: [repr(x) for x in vtk_to_numpy(array).ravel().tolist()]
arrays = {data.GetArrayName(k): text(data.GetArray(k)) for k in range(data.GetNumberOfArrays())}
print(json.dumps(dict(points=text(mesh.GetPoints().GetData()), cells=cells, arrays=arrays)))
"#;

#[test]
fn vtk_reads_what_is_written_here() {
    let Some(python) = python_with_vtk() else { return };
    let folder = tempfile::tempdir().unwrap();
    let surface = awkward_surface();
    let positions: Vec<f64> = surface.nodes_mm.iter().flat_map(|p| p.to_array()).collect();
    let numbers = |text: &serde_json::Value| -> Vec<f64> {
        let words: Vec<String> = serde_json::from_value(text.clone()).unwrap();
        words.iter().map(|word| word.parse().unwrap()).collect()
    };
    let corners: Vec<u32> = surface.triangles.iter().flatten().copied().collect();
    for ending in ["vtp", "ply", "obj"] {
        let path = written(&surface, folder.path(), ending);
        let found: serde_json::Value =
            serde_json::from_str(&python.run(VTK_READS, &[path.as_path()])).unwrap();
        let points = numbers(&found["points"]);
        assert_eq!(serde_json::from_value::<Vec<u32>>(found["cells"].clone()).unwrap(), corners);
        if ending == "vtp" {
            assert_eq!(bits(&points), bits(&positions));
            for array in &surface.arrays {
                assert_eq!(
                    bits(&numbers(&found["arrays"][&array.name])),
                    bits(&array.values),
                    "{}",
                    array.name
                );
            }
        } else {
            // VTK's other readers keep single precision.
            let single = |v: &[f64]| -> Vec<f32> { v.iter().map(|&x| x as f32).collect() };
            assert_eq!(single(&points), single(&positions), "{ending}");
        }
    }
}

const VTK_WRITES: &str = r#"
import sys, vtk
from vtk.util.numpy_support import numpy_to_vtk
import numpy as np
source, folder = sys.argv[1:]
reader = vtk.vtkXMLPolyDataReader(); reader.SetFileName(source); reader.Update()
mesh = reader.GetOutput()
normals = numpy_to_vtk(np.zeros((mesh.GetNumberOfPoints(), 3)), deep=1); normals.SetName("vectors are left out"); mesh.GetPointData().AddArray(normals)
for array, values in ((vtk.vtkStringArray(), ("word", "longer words " * 9)), (vtk.vtkBitArray(), (1, 0))):
    array.SetName(array.GetClassName())
    for k in range(mesh.GetNumberOfPoints()): array.InsertNextValue(values[k % 2])
    mesh.GetPointData().AddArray(array)
def write(writer, mesh, name):
    writer.SetInputData(mesh); writer.SetFileName(f"{folder}/{name}"); assert writer.Write()
for mode in range(3):
    for compressor in ("None", "ZLib", "LZ4", "LZMA"):
        for header in (32, 64):
            for order in (0, 1):
                for encoded in ((0, 1) if mode == 2 else (1,)):
                    w = vtk.vtkXMLPolyDataWriter()
                    w.SetDataMode(mode); w.SetByteOrder(order); w.SetEncodeAppendedData(encoded); w.SetBlockSize(1 << 10)
                    w.SetHeaderType(header); getattr(w, "SetCompressorTypeTo" + compressor)()
                    write(w, mesh, f"same-{mode}{compressor}{header}{order}{encoded}.vtp")
plain = vtk.vtkPolyData(); plain.DeepCopy(mesh)
for name in ("vtkStringArray", "vtkBitArray"): plain.GetPointData().RemoveArray(name)
for name, writer, mode in (("text.ply", vtk.vtkPLYWriter, 1), ("binary.ply", vtk.vtkPLYWriter, 2), ("text.stl", vtk.vtkSTLWriter, 1), ("binary.stl", vtk.vtkSTLWriter, 2)):
    w = writer(); w.SetFileType(mode); write(w, plain, name)
stripper = vtk.vtkStripper(); stripper.SetInputData(plain); stripper.Update()
write(vtk.vtkXMLPolyDataWriter(), stripper.GetOutput(), "strips.vtp")
grid = vtk.vtkAppendFilter(); grid.AddInputData(mesh); grid.Update()
write(vtk.vtkXMLUnstructuredGridWriter(), grid.GetOutput(), "same-grid.vtu")
for mode in (1, 2):
    for version in (42, 51):
        def legacy(writer, mesh, name):
            writer.SetFileType(mode); writer.SetFileVersion(version); write(writer, mesh, f"{name}{mode}{version}.vtk")
        legacy(vtk.vtkPolyDataWriter(), mesh, "same-")
        legacy(vtk.vtkPolyDataWriter(), stripper.GetOutput(), "strips-")
        legacy(vtk.vtkUnstructuredGridWriter(), grid.GetOutput(), "same-grid-")
w = vtk.vtkXMLPolyDataWriter(); w.SetNumberOfPieces(3); write(w, plain, "pieces.vtp")
"#;

#[test]
fn what_vtk_writes_loads_in_every_encoding() {
    let Some(python) = python_with_vtk() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut surface = awkward_surface();
    // VTK's text has no sign for zero and no word for NaN that its own reader takes.
    surface.set_array("support", (0..surface.nodes_mm.len()).map(|k| 0.1 * k as f64).collect());
    let source = written(&surface, folder.path(), "vtp");
    let output = tempfile::tempdir().unwrap();
    python.run(VTK_WRITES, &[source.as_path(), output.path()]);
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let (mut same, mut others) = (0, 0);
    for file in std::fs::read_dir(output.path()).unwrap() {
        let path = file.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let (read, space) = Surface::read_with_space(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        // VTK keeps the field that names the axes, in each of its encodings.
        if name.ends_with(".vtp") {
            assert_eq!(space, Some(Space::Ras), "{name}");
        }
        // Of a mesh in memory VTK writes all into each piece. Pieces have nodes of their own.
        let copies = if name == "pieces.vtp" { 3 } else { 1 };
        assert_eq!(read.triangles.len(), copies * surface.triangles.len(), "{name}");
        if name != "pieces.vtp" {
            assert_eq!(read.topology(), surface.topology(), "{name}");
        }
        let bytes = std::fs::read(&path).unwrap();
        for _ in 0..100 {
            // Compressed and appended blocks have lengths of their own to damage.
            let mut damaged = bytes.clone();
            let at = rng.random_range(0..damaged.len());
            damaged[at] = rng.random();
            let _ = read_bytes(name.rsplit('.').next().unwrap(), &damaged);
            let _ = read_bytes(name.rsplit('.').next().unwrap(), &bytes[..at]);
        }
        assert!((read.area_mm2() - copies as f64 * surface.area_mm2()).abs() < 1e-2, "{name}");
        // Strips and pieces order the triangles anew, PLY, STL and VTK's text drop precision.
        if name.ends_with("grid.vtu")
            || name.starts_with("same-") && !name.ends_with("142.vtk") && !name.ends_with("151.vtk")
        {
            assert_same(&read, &surface);
            same += 1;
        } else {
            others += 1;
        }
        if name.starts_with("strips") {
            let normals = read.node_normals();
            assert!(normals.iter().zip(surface.node_normals()).all(|(a, b)| a.dot(b) > 1.0 - 1e-6), "{name}");
        }
        if name.ends_with(".vtk") || name == "pieces.vtp" {
            let names: Vec<&str> = read.arrays.iter().map(|a| a.name.as_str()).collect();
            assert_eq!(names, ["residual_mm", "support"], "{name}");
        }
    }
    assert_eq!((same, others), (64 + 1 + 4, 4 + 2 + 8));
}
