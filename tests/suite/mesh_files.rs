//! Mesh files as other programs write them, each with the surface that it must give, and files that must be refused.

use crate::support::{shared, tetrahedron};
use crate::surface::{error_of, read_bytes, written};
use glam::DVec3;
use lumenmesh::surface::Surface;

/// A square of side 1 as two triangles.
const SQUARE: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

/// The header of a PLY with four vertices; `more` goes on after their coordinates.
fn ply_header(format: &str, more: &str) -> String {
    let coordinates = "property float x\nproperty float y\nproperty float z\n";
    format!("ply\nformat {format} 1.0\nelement vertex 4\n{coordinates}{more}end_header\n")
}

const FACE: &str = "element face 1\nproperty list uchar int vertex_indices\n";

#[test]
fn ply_passes_over_lists_of_any_type_in_any_element() {
    let lists = "property list uchar float weights\nelement material 1\nproperty list int double colour\n\
                 element face 2\nproperty list uchar float texcoord\nproperty list uchar int vertex_indices\n\
                 property list ushort int8 groups\n";
    let rows = "0 0 0 1 0.5\n1 0 0 0\n1 1 0 2 0.1 0.2\n0 1 0 0\n3 0.1 0.2 0.3\n6 0 0 1 0 1 1 3 0 1 2 1 7\n0 3 0 2 3 0\n";
    let text = ply_header("ascii", lists) + rows;
    let mut binary = ply_header("binary_big_endian", lists).into_bytes();
    for ([x, y], weights) in [
        ([0.0_f32, 0.0_f32], &[0.5_f32][..]),
        ([1.0, 0.0], &[]),
        ([1.0, 1.0], &[0.1, 0.2]),
        ([0.0, 1.0], &[]),
    ] {
        [x, y, 0.0].iter().for_each(|x| binary.extend(x.to_be_bytes()));
        binary.push(weights.len() as u8);
        weights.iter().for_each(|x| binary.extend(x.to_be_bytes()));
    }
    binary.extend(1_i32.to_be_bytes());
    binary.extend(0.3_f64.to_be_bytes());
    for (triangle, groups) in [([0_i32, 1, 2], &[7_u8][..]), ([0, 2, 3], &[])] {
        binary.push(2);
        [0.25_f32, 0.75].iter().for_each(|x| binary.extend(x.to_be_bytes()));
        binary.push(3);
        triangle.iter().for_each(|n| binary.extend(n.to_be_bytes()));
        binary.extend((groups.len() as u16).to_be_bytes());
        binary.extend(groups);
    }
    for bytes in [text.into_bytes(), binary] {
        let surface = read_bytes("ply", &bytes).unwrap();
        assert_eq!(surface.triangles, SQUARE);
        assert_eq!(surface.area_mm2(), 1.0);
        assert!(surface.arrays.is_empty());
    }
}

#[test]
fn ply_reads_numbers_of_eight_bytes() {
    for (signed, unsigned) in [("int64", "uint64"), ("long", "ulong"), ("longlong", "ulonglong")] {
        let more =
            format!("property {signed} id\nelement face 1\nproperty list uchar {unsigned} vertex_index\n");
        let mut bytes = ply_header("binary_little_endian", &more).into_bytes();
        for (k, [x, y]) in [[0.0_f32, 0.0_f32], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].into_iter().enumerate() {
            [x, y, 0.0].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
            bytes.extend((-5 - k as i64).to_le_bytes());
        }
        bytes.push(4);
        (0..4_u64).for_each(|n| bytes.extend(n.to_le_bytes()));
        let surface = read_bytes("ply", &bytes).unwrap();
        assert_eq!(surface.triangles, SQUARE);
        assert_eq!(surface.array("id"), Some(&[-5.0, -6.0, -7.0, -8.0][..]));
    }
}

#[test]
fn ply_reads_faces_and_strips_with_restarts() {
    let more = format!("{FACE}element tristrips 1\nproperty list int int vertex_indices\n");
    let nodes = "0 0 0 1 0 0 1 1 0 0 1 0\n";
    let text = ply_header("ascii", &more) + nodes + "3 0 1 2\n9 1 2 0 3 -1 -1 3 2 1\n";
    let surface = read_bytes("ply", text.as_bytes()).unwrap();
    // The second triangle of a strip is turned round.
    assert_eq!(surface.triangles, [[0, 1, 2], [1, 2, 0], [2, 3, 0], [3, 2, 1]]);
    let alone = ply_header("ascii", "element tristrips 1\nproperty list int int vertex_indices\n");
    let text = alone + nodes + "6 0 1 3 3 2 2\n";
    // Triangles that name a node twice are how a strip goes on elsewhere.
    assert_eq!(read_bytes("ply", text.as_bytes()).unwrap().triangles, [[0, 1, 3]]);
}

#[test]
fn ply_headers_may_end_their_lines_in_any_way_and_begin_with_a_mark() {
    let header = ply_header("binary_little_endian", FACE)
        .replace("element vertex", "comment\nobj_info a\nelement vertex");
    // The first coordinate's first byte is a line feed: it belongs to the body.
    let first = f32::from_le_bytes([b'\n', 0, 0, 0]);
    for ending in ["\n", "\r\n", "\r"] {
        for mark in ["", "\u{feff}"] {
            let mut bytes = format!("{mark}{header}").replace('\n', ending).into_bytes();
            for x in [first, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0] {
                bytes.extend(x.to_le_bytes());
            }
            bytes.push(4);
            (0..4_i32).for_each(|n| bytes.extend(n.to_le_bytes()));
            let surface = read_bytes("ply", &bytes).unwrap();
            assert_eq!(surface.triangles, SQUARE, "{ending:?}");
            assert_eq!(surface.nodes_mm[0].x, f64::from(first));
            let text = ply_header("ascii", FACE) + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
            let text = format!("{mark}{text}").replace('\n', ending);
            assert_eq!(read_bytes("ply", text.as_bytes()).unwrap().triangles, SQUARE, "{ending:?}");
        }
    }
}

#[test]
fn ply_refuses_what_it_would_lose() {
    let nodes = "0 0 0 1 0 0 1 1 0 0 1 0\n";
    for (more, rows, expected) in [
        (FACE, "3 0 1 2\n3 0 2 3\n", "end: found 4 bytes after the rows that the header promises"),
        (
            "element face 1\nproperty list uchar int corners\n",
            "3 0 1 2\n",
            "element face: found none, expected a list vertex_indices",
        ),
        ("element vertex 1\nproperty float x\n", "1\n", "element vertex: found a second one, expected one"),
        (
            "element edge 2\nproperty int vertex1\nproperty int vertex2\n",
            "0 1 1 2\n",
            "triangles: found none (nodes: 4, edges: 2)",
        ),
        ("", "", "triangles: found none (nodes: 4), expected at least one"),
    ] {
        let text = error_of("ply", (ply_header("ascii", more) + nodes + rows).as_bytes());
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn obj_text_may_come_in_other_encodings_and_line_ends() {
    let text = "# façade\nv 0 0 0 1 0.5 0.5 0.5\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nv 9 9 9\ng größe\nusemtl C:\\names\\\nf 1 2 3 \\\n  4\n\
                mtllib a\\\nl 1 2\n";
    let wide = |unit: fn(u16) -> [u8; 2]| -> Vec<u8> {
        [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(unit).collect()
    };
    let latin: Vec<u8> = text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    let files = [
        text.into(),
        format!("\u{feff}{}", &text["# façade\n".len()..]).into_bytes(),
        latin,
        wide(u16::to_le_bytes),
        wide(u16::to_be_bytes),
        text.replace('\n', "\r").into_bytes(),
        text.replace('\n', "\r\n").into_bytes(),
    ];
    for (k, bytes) in files.iter().enumerate() {
        let surface = read_bytes("obj", bytes).unwrap();
        assert_eq!((surface.nodes_mm.len(), surface.area_mm2()), (5, 1.0), "file {k}");
        assert_eq!(surface.triangles, SQUARE, "file {k}");
    }
}

#[test]
fn obj_reads_comments_after_values_and_says_what_else_there_is() {
    let text = "v 0 0 0 # first\nv 1 0 0\nv 1 1 0\nf -3 -2 -1 # all\n";
    assert_eq!(read_bytes("obj", text.as_bytes()).unwrap().triangles, [[0, 1, 2]]);
    let text = error_of("obj", b"v 0 0 0\nv 1 0 0\nl 1 2\np 1\np 2\n");
    assert!(
        text.ends_with("triangles: found none (nodes: 2, lines: 1, points: 2), expected at least one"),
        "{text}"
    );
    let text = error_of("obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nsurf 0 1 0 1 1 2 3\n");
    assert!(text.ends_with("line 5: found a free-form surface, expected polygons"), "{text}");
}

/// A facet of a text STL with a corner at `x`.
fn facet(x: u32) -> String {
    format!(
        "facet normal 0 0 1\n outer loop\n  vertex {x} 0 0\n  vertex 1 0 0\n  vertex 0 1 0\n endloop\nendfacet\n"
    )
}

#[test]
fn stl_keywords_come_in_any_case_and_spelling() {
    let text = format!("solid tube\n{}{}endsolid tube\n", facet(3), facet(4));
    let apart =
        text.replace("endloop", "end loop").replace("endfacet", "End Facet").replace("endsolid", "end solid");
    let marked = format!("\u{feff}{text}");
    let wide: Vec<u8> = marked.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let files = [
        text.to_uppercase().into_bytes(),
        text.replace("solid", "Solid").into_bytes(),
        apart.into_bytes(),
        marked.into_bytes(),
        wide,
        text.replace('\n', "\r").into_bytes(),
        format!("\n  {text}\n\n").into_bytes(),
        // Several solids are one surface.
        format!("solid a\n{}endsolid a\nsolid\nendsolid\n\nsolid b\n{}endsolid\n", facet(3), facet(4))
            .into_bytes(),
    ];
    for (k, bytes) in files.iter().enumerate() {
        let surface = read_bytes("stl", bytes).unwrap();
        // Half of a base, 2 and 3 wide, by a height of 1.
        assert_eq!((surface.triangles.len(), surface.area_mm2()), (2, 2.5), "file {k}");
    }
}

#[test]
fn stl_refuses_texts_that_are_cut_or_not_stl() {
    let [first, second] = [facet(3), facet(4)];
    for (text, expected) in [
        (
            format!("solid a\n{first}endsolid a\nsolid b\n{second}"),
            "end: found a text cut short in solid 2, expected endsolid",
        ),
        (
            format!("solid a\n{first}solid b\n{second}endsolid b\n"),
            "line 9: found solid, expected endsolid before the next solid",
        ),
        (format!("solid a\n{first}endsolid a\n{second}"), "line 10: found facet, expected solid"),
        (
            format!("solid a\n{first}colour 1\nendsolid a\n"),
            "line 9: found colour, expected a keyword of STL",
        ),
        ("solid a\nendsolid a\n".into(), "triangles: found none, expected at least one"),
        (
            format!("solid a\n{}endsolid a\n", facet(1)),
            "triangles: found none (nodes: 2, triangles without three different corners: 1)",
        ),
    ] {
        let text = error_of("stl", text.as_bytes());
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn binary_stl_may_say_solid_and_have_fewer_bytes_more_than_a_triangle_takes() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = std::fs::read(written(&tetrahedron(), folder.path(), "stl")).unwrap();
    bytes[..80].fill(b' ');
    bytes[..10].copy_from_slice(b"solid tube");
    for more in [0, 1, 49] {
        let longer = [bytes.as_slice(), &vec![b'\n'; more]].concat();
        assert_eq!(read_bytes("stl", &longer).unwrap().topology(), tetrahedron().topology());
    }
    let longer = [bytes.as_slice(), &[0; 50]].concat();
    for (wrong, length) in [(&longer[..], 334), (&bytes[..283], 283)] {
        let text = error_of("stl", wrong);
        let expected = format!(
            "length of the binary file: found {length} bytes, expected 284 bytes for the 4 triangles of its header"
        );
        assert!(text.ends_with(&expected), "{text}");
    }
}

/// A polygon over nodes of z = 0 in a file of each format that has polygons.
fn polygon_files(corners: &[[f64; 2]]) -> [(&'static str, String); 4] {
    let count = corners.len();
    let rows: String = corners.iter().map(|[x, y]| format!("{x} {y} 0\n")).collect();
    let nodes: String = (0..count).map(|n| format!(" {n}")).collect();
    let obj: String = rows.lines().map(|row| format!("v {row}\n")).collect();
    let one_based: String = (1..=count).map(|n| format!(" {n}")).collect();
    let coordinates = "property double x\nproperty double y\nproperty double z\n";
    let array = |name: &str, components: u8, text: &str| {
        format!(
            "<DataArray type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"ascii\">{text}</DataArray>"
        )
    };
    let [points, connectivity, offsets] = [
        array("Points", 3, &rows),
        array("connectivity", 1, &nodes),
        array("offsets", 1, &count.to_string()),
    ];
    [
        ("obj", format!("{obj}f{one_based}\n")),
        (
            "ply",
            format!(
                "ply\nformat ascii 1.0\nelement vertex {count}\n{coordinates}{FACE}end_header\n{rows}{count}{nodes}\n"
            ),
        ),
        (
            "vtp",
            format!(
                "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"{count}\"><Points>{points}</Points><Polys>{connectivity}\
                 {offsets}</Polys></Piece></PolyData></VTKFile>"
            ),
        ),
        (
            "vtk",
            format!(
                "# vtk DataFile Version 2.0\n\nASCII\nDATASET POLYDATA\nPOINTS {count} double\n{rows}POLYGONS 1 {}\n{count}{nodes}\n",
                count + 1
            ),
        ),
    ]
}

#[test]
fn concave_polygons_keep_their_area_in_every_format() {
    // Three unit squares. A fan about the first corner would cover four.
    let el = [[2.0, 2.0], [1.0, 2.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [2.0, 0.0]];
    for (ending, text) in polygon_files(&el) {
        let surface = read_bytes(ending, text.as_bytes()).unwrap();
        assert_eq!((surface.triangles.len(), surface.area_mm2()), (4, 3.0), "{ending}");
        assert!(surface.triangle_normals().iter().all(|&n| n == DVec3::Z), "{ending}");
    }
    let bow_tie = [[0.0, 0.0], [3.0, 3.0], [3.0, 0.0], [0.0, 2.0]];
    for (ending, text) in polygon_files(&bow_tie) {
        let text = error_of(ending, text.as_bytes());
        let expected =
            "polygon 0: found edges that cross, among 4 corners, expected a polygon that has one inside";
        assert!(text.ends_with(expected), "{ending}: {text}");
    }
}

/// A piece of a VTP: a unit square at height `z`, with arrays.
fn vtp_piece(z: f64, arrays: &str) -> String {
    format!(
        "<Piece NumberOfPoints=\"4\" NumberOfPolys=\"1\" NumberOfLines=\"0\"><PointData>{arrays}</PointData><Points>\
         <DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">0 0 {z} 1 0 {z} 1 1 {z} 0 1 {z}</DataArray></Points>\
         <Polys><DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">0 1 2 3</DataArray>\
         <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">4</DataArray></Polys></Piece>"
    )
}

fn vtp(pieces: &str) -> String {
    format!(
        "<?xml version=\"1.0\"?><VTKFile type=\"PolyData\" version=\"1.0\"><PolyData>{pieces}</PolyData></VTKFile>"
    )
}

fn vtp_array(kind: &str, name: &str, text: &str) -> String {
    format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">{text}</DataArray>")
}

#[test]
fn vtp_joins_pieces_and_their_arrays() {
    let [low, high] =
        [("r", "1 2 3 4"), ("r", "5 6 7 8")].map(|(name, text)| vtp_array("Float32", name, text));
    let only = vtp_array("Int8", "only", "1 1 1 -1");
    let empty = "<Piece NumberOfPoints=\"0\" NumberOfPolys=\"0\"><PointData></PointData></Piece>";
    let pieces = vtp_piece(0.0, &low) + empty + &vtp_piece(2.0, &(high + &only));
    let surface = read_bytes("vtp", vtp(&pieces).as_bytes()).unwrap();
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]);
    assert_eq!((surface.area_mm2(), surface.nodes_mm[7]), (2.0, DVec3::new(0.0, 1.0, 2.0)));
    assert_eq!(surface.array("r"), Some(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0][..]));
    let only = surface.array("only").unwrap();
    assert!(only[..4].iter().all(|x| x.is_nan()));
    assert_eq!(only[4..], [1.0, 1.0, 1.0, -1.0]);
    // A node of another piece is none of this one's.
    let wrong = vtp(&(vtp_piece(0.0, "").replace("0 1 2 3", "0 1 2 4") + &vtp_piece(2.0, "")));
    assert!(
        error_of("vtp", wrong.as_bytes())
            .ends_with("polygon 0: found node 4, expected a node from 0 to below 4")
    );
}

#[test]
fn vtp_passes_over_arrays_that_nobody_asked_for() {
    let arrays = [
        vtp_array("Float64", "r", "1 2 3 4"),
        vtp_array("Bit", "inside", "1 0 1 0"),
        "<Array type=\"String\" Name=\"names\" format=\"ascii\">97 0 98 0 99 0 100 0</Array>".into(),
        vtp_array("String", "more names", "97 0"),
        vtp_array("Float128", "wide", "?"),
        vtp_array("Float64", "r", "5 6 7 8"),
        vtp_array("Float64", "", "5 6 7 8"),
    ];
    let surface = read_bytes("vtp", vtp(&vtp_piece(0.0, &arrays.concat())).as_bytes()).unwrap();
    assert_eq!(surface.area_mm2(), 1.0);
    assert_eq!(surface.arrays.len(), 1);
    assert_eq!(surface.array("r"), Some(&[1.0, 2.0, 3.0, 4.0][..]));
}

#[test]
fn vtp_refuses_what_it_would_lose_or_cannot_hold() {
    let whole = vtp(&vtp_piece(0.0, ""));
    let lines = vtp("<Piece NumberOfPoints=\"0\" NumberOfLines=\"3\" NumberOfVerts=\"2\"></Piece>");
    for (text, expected) in [
        (whole.replace("NumberOfPolys=\"1\"", "NumberOfPolys=\"2\""), "Polys offsets: found 1, expected 2"),
        (whole.replace(">4<", ">3<"), "Polys connectivity: found 4, expected 3, where the last cell ends"),
        (lines, "triangles: found none (lines: 3, points: 2, pieces: 1), expected at least one"),
        (vtp(""), "Piece: found none, expected at least one"),
        (
            whole.replace("\"1.0\"><", "\"1.0\" compressor=\"vtkZstdDataCompressor\"><"),
            "compressor: found vtkZstdDataCompressor",
        ),
    ] {
        let text = error_of("vtp", text.as_bytes());
        assert!(text.contains(expected), "{text}");
    }
    // Two blocks of 4 GB each in a few bytes.
    let header: Vec<u8> = [2_u32, 1 << 31, 0, 8, 8].iter().flat_map(|n| n.to_le_bytes()).collect();
    let mut bomb = b"<VTKFile type=\"PolyData\" compressor=\"vtkLZ4DataCompressor\"><PolyData><Piece NumberOfPoints=\"1\"><Points>\
        <DataArray type=\"UInt8\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/></Points></Piece></PolyData>\
        <AppendedData encoding=\"raw\">_"
        .to_vec();
    bomb.extend(header);
    bomb.extend([0; 16]);
    let text = error_of("vtp", &bomb);
    let expected = "found arrays of 34359738368 bytes or more in memory, expected at most 67108864: 200 times the file's size, or 64 MB";
    assert!(text.ends_with(expected), "{text}");
}

#[test]
fn vtu_is_read_where_its_cells_are_those_of_a_surface() {
    let file = |types: &str| {
        let text = vtp(&vtp_piece(0.0, &vtp_array("Float32", "r", "1 2 3 4")));
        let text = text
            .replace("Polys", "Cells")
            .replace("PolyData", "UnstructuredGrid")
            .replace("0 1 2 3<", "0 1 0 1 3 2 2 3 0<");
        text.replace("NumberOfCells=\"1\"", "NumberOfCells=\"3\"")
            .replace(">4<", ">2 6 9<")
            .replace("</Cells>", &(vtp_array("UInt8", "types", types) + "</Cells>"))
    };
    let surface = read_bytes("vtu", file("3 8 5").as_bytes()).unwrap();
    // A line, a pixel, both of whose rows go to the right, and a triangle.
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3], [2, 3, 0]]);
    assert_eq!(surface.array("r"), Some(&[1.0, 2.0, 3.0, 4.0][..]));
    let text = error_of("vtu", file("3 10 5").as_bytes());
    let expected = "cell 1: found VTK's type 10 with 4 nodes, expected triangles, quads, polygons, pixels or strips (5 to 9)";
    assert!(text.contains(expected), "{text}");
}

/// A legacy VTK file with the corners of a unit square.
fn vtk(kind: &str, data: &str) -> String {
    let points = "POINTS 4 float\n0 0 0 1 0 0 1 1 0\n0 1 0\n";
    format!("# vtk DataFile Version 3.0\nby hand\n{kind}\nDATASET {data}\n{points}")
}

#[test]
fn vtk_text_is_read_with_cells_of_both_kinds_and_its_arrays() {
    let attributes = "METADATA\nINFORMATION 1\nNAME x LOCATION y\n\nPOINT_DATA 4\nSCALARS a%20b double\nLOOKUP_TABLE default\n1 2 3 4\n\
                      VECTORS v float\n0 0 0 0 0 0 0 0 0 0 0 0\nLOOKUP_TABLE t 1\n0 0 0 1\nCOLOR_SCALARS c 2\n0 0 0 0 0 0 0 0\n\
                      TEXTURE_COORDINATES t 2 float\n0 0 0 0 0 0 0 0\nFIELD FieldData 3\nnames 1 4 string\none\ntwo words\n\nfour\n\
                      METADATA\nx\n\nbits 1 4 bit\n1 0 1 0\ncount 1 4 vtkIdType\n9 8 7 6\nCELL_DATA 1\nSCALARS of_cells int 1\n\
                      LOOKUP_TABLE default\n5\n";
    let old = vtk("ASCII", "POLYDATA") + "VERTICES 1 2\n1 0\nPOLYGONS 1 5\n4 0 1 2 3\n" + attributes;
    let new = vtk("ascii", "polydata")
        + "POLYGONS 2 4\nOFFSETS vtktypeint64\n0 4\nCONNECTIVITY vtktypeint64\n0 1 2 3\n"
        + attributes;
    let grid =
        vtk("ASCII", "UNSTRUCTURED_GRID") + "CELLS 2 7\n1 0\n4 0 1 2 3\nCELL_TYPES 2\n1\n9\n" + attributes;
    let field = new.replace("POINTS", "FIELD FieldData 1\nTimeValue 1 1 double\n0.5\nPOINTS");
    for text in [
        &old,
        &new,
        &grid,
        &field,
        &old.replace('\n', "\r\n"),
        &old.replace('\n', "\r"),
        &format!("\u{feff}{old}"),
    ] {
        let surface = read_bytes("vtk", text.as_bytes()).unwrap();
        assert_eq!(surface.triangles, SQUARE, "{text:?}");
        assert_eq!(surface.array("a b"), Some(&[1.0, 2.0, 3.0, 4.0][..]));
        assert_eq!(surface.array("count"), Some(&[9.0, 8.0, 7.0, 6.0][..]));
        assert_eq!(surface.arrays.len(), 2);
    }
}

#[test]
fn vtk_binary_is_read() {
    let mut bytes = b"# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\nPOINTS 4 double\n".to_vec();
    for x in [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0_f64] {
        bytes.extend(x.to_be_bytes());
    }
    bytes.extend(b"\nTRIANGLE_STRIPS 1 5\n");
    [4, 1, 2, 0, 3_i32].iter().for_each(|n| bytes.extend(n.to_be_bytes()));
    bytes.extend(b"\nPOINT_DATA 4\nFIELD FieldData 3\nbits 1 4 bit\n\xa0\nnames 1 4 string\n\xc3one\xc0\xc1a\x80\x02bc\nr 1 4 short\n");
    [-1, 2, 300, 4_i16].iter().for_each(|x| bytes.extend(x.to_be_bytes()));
    let surface = read_bytes("vtk", &bytes).unwrap();
    assert_eq!(surface.triangles, [[1, 2, 0], [2, 3, 0]]);
    assert_eq!(surface.arrays.len(), 1);
    assert_eq!(surface.array("r"), Some(&[-1.0, 2.0, 300.0, 4.0][..]));
    let text = error_of("vtk", &bytes[..bytes.len() - 1]);
    assert!(text.ends_with("r: found the last 7 bytes of the file, expected 4 values"), "{text}");
}

#[test]
fn vtk_refuses_what_it_cannot_read() {
    let polygons = "POLYGONS 1 5\n4 0 1 2 3\n";
    let whole = vtk("ASCII", "POLYDATA") + polygons;
    for (text, expected) in [
        ("vtk\n".into(), "line 1: found vtk, expected # vtk DataFile Version"),
        (whole.replace("ASCII", "UTF-8"), "line 3: found UTF-8, expected ASCII or BINARY"),
        (
            vtk("ASCII", "STRUCTURED_GRID"),
            "data set: found DATASET STRUCTURED_GRID, expected DATASET POLYDATA or DATASET UNSTRUCTURED_GRID",
        ),
        (
            whole.replace("1 5\n4", "1 5\n5"),
            "POLYGONS 0: found a list of 5, expected a list within the 5 numbers",
        ),
        (whole.replace("1 5", "1 6") + "7\n", "POLYGONS: found 1 numbers after the last of 1 cells"),
        (whole.replace("0 1 2 3", "0 1 2 4"), "polygon 0: found node 4, expected a node from 0 to below 4"),
        (
            whole.replace("POINTS 4", "POINTS 400000000000"),
            "POINTS: found the last 48 bytes of the file, expected 1200000000000 values",
        ),
        (
            whole.clone() + "POINT_DATA 3\nSCALARS r float\nLOOKUP_TABLE t\n1 2 3\n",
            "node array \"r\": found 3 values, expected 4",
        ),
        (whole.clone() + "SHADERS 1\n", "keyword: found SHADERS, expected one of VTK's legacy format"),
        (vtk("ASCII", "POLYDATA") + "LINES 1 3\n2 0 1\n", "triangles: found none (nodes: 4, lines: 1)"),
    ] {
        let text = error_of("vtk", text.as_bytes());
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn messages_show_no_control_characters_and_end() {
    let long = "x".repeat(5000);
    for (ending, bytes) in [
        ("ply", b"ply\rformat \x1b[31m\x07 1.0\r\rend_header\r".to_vec()),
        ("ply", [b"\x00\x1b[2J\x80\xff", long.as_bytes(), b"\n"].concat()),
        ("obj", [b"v 0 0 \x1b[31m\xe2\x80\xae", long.as_bytes()].concat()),
        ("stl", [b"solid \xff\nvertex ", long.as_bytes()].concat()),
        ("vtp", [b"<VTKFile type=\"PolyData\x1b", long.as_bytes(), b"\">"].concat()),
        ("vtk", [b"# vtk\x1b\x9b".as_slice(), long.as_bytes(), b"\n"].concat()),
    ] {
        let text = error_of(ending, &bytes);
        assert!(text.len() < 800 && !text.chars().any(|c| c.is_control() || c == '\u{202e}'), "{text:?}");
    }
}

#[test]
fn meshes_of_other_programs_are_whole() {
    // A tube of elliptic cross-section, 12 quads about and 6 along, 12 mm long.
    let corner = |k: u32| {
        let angle = f64::from(k) / 12.0 * std::f64::consts::TAU;
        DVec3::new(3.0 * angle.cos(), 2.0 * angle.sin(), 0.0)
    };
    let tube = 12.0 * (0..12).map(|k| corner(k).distance(corner(k + 1))).sum::<f64>();
    for (name, triangles, area) in [
        ("d1_face_texcoord.ply", 144, tube),
        ("h1_bom_spare_vertex.obj", 144, tube),
        ("i1_upper_case.stl", 144, tube),
        ("j1_solid_header_one_byte_more.stl", 144, tube),
        ("j2_cr_only_header.ply", 144, tube),
        ("m1_faces_and_tristrips.ply", 144, tube),
        ("p1_bit_array.vtp", 144, tube),
        ("q1_concave_polygon.obj", 4, 3.0),
    ] {
        let Some(path) = shared(&format!("fieldtests/{name}")) else { return };
        let surface = Surface::read(&path).unwrap();
        assert_eq!(surface.triangles.len(), triangles, "{name}");
        assert!((surface.area_mm2() - area).abs() < 1e-3, "{name}: {}", surface.area_mm2());
        assert_eq!(surface.topology().non_manifold_edges, 0, "{name}");
    }
    let Some(path) = shared("fieldtests/g1_second_solid_cut.stl") else { return };
    let text = Surface::read(&path).unwrap_err().to_string();
    assert!(text.ends_with("end: found a text cut short in solid 2, expected endsolid"), "{text}");
}
