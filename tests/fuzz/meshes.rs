//! Mesh files.

use crate::mutate::{File, fuzz, inputs};
use glam::DVec3;
use lumenmesh::surface::Surface;
use std::time::{Duration, Instant};

/// A closed surface of four triangles with an array.
fn tetrahedron() -> Surface {
    let mut surface = Surface {
        nodes_mm: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        ..Surface::default()
    };
    surface.set_array("support", vec![0.0, 1.5, f64::NAN, -2.0]);
    surface
}

/// The bytes of a file that `Surface::write` makes.
fn written(ending: &str) -> Vec<u8> {
    let file = File::new(&format!("mesh.{ending}"));
    let path = file.holding(b"");
    tetrahedron().write(path).unwrap();
    std::fs::read(path).unwrap()
}

/// Reads mutated files of that ending. What is accepted must be sound, and no input may take long.
fn read_all(ending: &str, seeds: &[Vec<u8>], tokens: &[&[u8]]) {
    const LONGEST: Duration = Duration::from_secs(2);
    let file = File::new(&format!("mesh.{ending}"));
    for seed in seeds {
        Surface::read(file.holding(seed)).unwrap();
    }
    let slowest = std::cell::Cell::new(Duration::ZERO);
    let accepted = fuzz(seeds, tokens, |bytes| {
        let start = Instant::now();
        let read = Surface::read(file.holding(bytes));
        slowest.set(slowest.get().max(start.elapsed()));
        match read {
            Ok(surface) => {
                surface.check().unwrap();
                assert!(!surface.triangles.is_empty());
                true
            }
            Err(error) => {
                let text = error.to_string();
                assert!(text.len() < 1500 && !text.chars().any(char::is_control), "{text:?}");
                false
            }
        }
    });
    println!("{ending}: {accepted} of {} accepted, the slowest in {:?}", inputs(), slowest.get());
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
    assert!(slowest.get() < LONGEST, "{:?}", slowest.get());
}

const TOKENS: [&[u8]; 16] = [
    b"nan",
    b"-1",
    b"1e308",
    b"1e-308",
    b"4294967295",
    b"9223372036854775807",
    b" 0",
    b" 3 0 1 2",
    b"\r",
    b"\n",
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\0",
    b"\\\n",
    b"0.1",
    b"#",
];

/// Those of every format and its own.
fn tokens(own: &[&'static [u8]]) -> Vec<&'static [u8]> {
    TOKENS.iter().chain(own).copied().collect()
}

#[test]
fn ply() {
    let header = "ply\ncomment x\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n\
                  property float z\nproperty list uchar float t\nelement face 1\n\
                  property list uchar int vertex_indices\nproperty list uchar float texcoord\nelement tristrips 1\n\
                  property list int int vertex_indices\nelement other 1\nproperty list char double k\nend_header\n";
    let rows = "2 2 0 0\n1 2 0 1 5\n1 1 0 0\n0 1 0 0\n0 0 0 0\n2 0 0 0\n6 0 1 2 3 4 5 2 0.5 1\n8 0 1 2 3 -1 3 4 5\n1 2.5\n";
    let seeds = [written("ply"), format!("{header}{rows}").into_bytes()];
    let own: [&[u8]; 9] = [
        b"property list uchar float t\n",
        b"property double k\n",
        b"element vertex 3\n",
        b"element face 2\n",
        b"binary_big_endian",
        b"ascii",
        b"int64",
        b"tristrips",
        b"end_header\n",
    ];
    read_all("ply", &seeds, &tokens(&own));
}

#[test]
fn obj() {
    let el = "v 2 2 0\nv 1 2 0 0.5 0.5 1\nv 1 1 0\nv 0 1 0\nv 0 0 0\nv 2 0 0\nvn 0 0 1\nf 1/1/1 2//1 3 4 5 \\\n 6\nf -1 -2 -3\n";
    let wide: Vec<u8> = [0xfeff].into_iter().chain(el.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    // A comb with a hole: what keeps the triangulation busy.
    let comb: String = (0..200).map(|k| format!("v {k} {} 0\n", if k % 2 == 0 { k } else { -k })).collect();
    let corners: String = (1..=200).map(|k| format!(" {k}")).collect();
    let seeds = [written("obj"), el.into(), wide, format!("{comb}f{corners}\n").into_bytes()];
    let own: [&[u8]; 6] = [b"f 1 2 3 4 5\n", b"v 0 0 0\n", b"f ", b"//1", b"surf ", b"l 1 2\n"];
    read_all("obj", &seeds, &tokens(&own));
}

#[test]
fn stl() {
    let facet =
        "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0.5\nendloop\nendfacet\n";
    let text = format!("solid a\n{facet}{facet}endsolid a\nSOLID b\n{facet}END SOLID b\n");
    let mut solid = written("stl");
    solid[..6].copy_from_slice(b"solid ");
    let seeds = [written("stl"), text.into_bytes(), solid];
    let own: [&[u8]; 7] = [
        b"solid ",
        b"endsolid\n",
        b"end loop\n",
        b"facet ",
        b"vertex 1 2 3\n",
        b"endloop\n",
        b"outer loop\n",
    ];
    read_all("stl", &seeds, &tokens(&own));
}

/// A triangle's positions, nodes and end in bytes, as each compressor stores them; LZMA with both of its check sums.
const COMPRESSED: [[&str; 4]; 4] = [
    [
        "vtkLZ4DataCompressor",
        "AQAAAAkAAAAAAAAACgAAAA==kAAAAAEAAAABAA==",
        "AQAAAAMAAAAAAAAABAAAAA==MAABAg==",
        "AQAAAAEAAAAAAAAAAgAAAA==EAM=",
    ],
    [
        "vtkLZMADataCompressor",
        "AQAAAAkAAAAAAAAAQAAAAA==/Td6WFoAAAFpIt42AgAhAQwAAACPmEGcAQAIAAAAAQAAAAEAAAAAAEr2TjQAAR0Jk2E2ppBCmQ0BAAAAAAFZWg==",
        "AQAAAAMAAAAAAAAAOAAAAA==/Td6WFoAAAFpIt42AgAhAQwAAACPmEGcAQACAAECAAB/iVQIAAEXAwdgDLyQQpkNAQAAAAABWVo=",
        "AQAAAAEAAAAAAAAAOAAAAA==/Td6WFoAAAFpIt42AgAhAQwAAACPmEGcAQAAAwAAAAA3vgtLAAEVAaljNGCQQpkNAQAAAAABWVo=",
    ],
    [
        "vtkLZMADataCompressor",
        "AQAAAAkAAAAAAAAARAAAAA==/Td6WFoAAATm1rRGAgAhARYAAAB0L+WjAQAIAAAAAQAAAAEAAAAAALujoxOSG6yHAAEhCWwYxdUftvN9AQAAAAAEWVo=",
        "AQAAAAMAAAAAAAAAPAAAAA==/Td6WFoAAATm1rRGAgAhARYAAAB0L+WjAQACAAECAAAQikmEAxCUSgABGwMLL7kQH7bzfQEAAAAABFla",
        "AQAAAAEAAAAAAAAAPAAAAA==/Td6WFoAAATm1rRGAgAhARYAAAB0L+WjAQAAAwAAAABtwIDPmtsHWAABGQGlLIHMH7bzfQEAAAAABFla",
    ],
    [
        "vtkZLibDataCompressor",
        "AQAAAAkAAAAAAAAADgAAAA==eJxjYGBgZABhAAARAAM=",
        "AQAAAAMAAAAAAAAACwAAAA==eJxjYGQCAAAHAAQ=",
        "AQAAAAEAAAAAAAAACQAAAA==eJxjBgAABAAE",
    ],
];

#[test]
fn vtp() {
    let array = |kind: &str, name: &str, more: &str, text: &str| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\"{more}>{text}</DataArray>\n")
    };
    let piece = format!(
        "<Piece NumberOfPoints=\"4\" NumberOfPolys=\"1\" NumberOfStrips=\"1\">\n<PointData>{}{}</PointData><Points>{}</Points>\n\
         <Polys>{}{}</Polys>\n<Strips>{}{}</Strips></Piece>\n",
        array("Float32", "r", "", "1 2 3 4"),
        array("Bit", "b", "", "1 0 1 0"),
        array("Float64", "Points", " NumberOfComponents=\"3\"", "0 0 0 1 0 0 1 1 0 0 1 0"),
        array("Int64", "connectivity", "", "0 1 2 3"),
        array("Int32", "offsets", "", "4"),
        array("Int64", "connectivity", "", "0 1 3 2"),
        array("UInt8", "offsets", "", "4"),
    );
    let file = |attributes: &str, pieces: &str| {
        format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\"{attributes}><PolyData>\n{pieces}</PolyData></VTKFile>\n"
        )
    };
    let compressed = |compressor: &str, points: &str, connectivity: &str, offsets: &str| {
        let binary = |kind: &str, name: &str, components: u8, text: &str| {
            format!(
                "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"binary\">{text}</DataArray>"
            )
        };
        file(
            &format!(" compressor=\"{compressor}\""),
            &format!(
                "<Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\"><Points>{}</Points><Polys>{}{}</Polys></Piece>",
                binary("UInt8", "Points", 3, points),
                binary("UInt8", "connectivity", 1, connectivity),
                binary("UInt8", "offsets", 1, offsets),
            ),
        )
    };
    let [lz4, lzma, lzma64, zlib] = COMPRESSED.map(|[name, a, b, c]| compressed(name, a, b, c).into_bytes());
    for bytes in [&lz4, &lzma, &lzma64, &zlib] {
        assert_eq!(Surface::read(File::new("mesh.vtp").holding(bytes)).unwrap().area_mm2(), 0.5);
    }
    let empty = "<Piece NumberOfPoints=\"0\" NumberOfPolys=\"0\"></Piece>\n";
    let seeds = [
        written("vtp"),
        file("", &piece).into_bytes(),
        file(" byte_order=\"BigEndian\" header_type=\"UInt64\"", &format!("{piece}{empty}{piece}"))
            .into_bytes(),
        lz4,
        lzma,
        lzma64,
        zlib,
    ];
    let own: [&[u8]; 10] = [
        b"<Piece>",
        b"</Piece>",
        b"format=\"appended\"",
        b"<AppendedData encoding=\"raw\">_",
        b"Int8",
        b"AAAAAAAAAAA=",
        b"compressor=\"vtkLZ4DataCompressor\"",
        b"BigEndian",
        b"UnstructuredGrid",
        b"/////w==",
    ];
    read_all("vtp", &seeds, &tokens(&own));
}

#[test]
fn mat() {
    read_all(
        "mat",
        &[written("mat")],
        &tokens(&[b"vertices", b"faces", b"space", b"lps", b"\x0e\0\0\0", b"\x0f\0\0\0"]),
    );
}

#[test]
fn vtk() {
    let head =
        |kind: &str, data: &str| format!("# vtk DataFile Version 5.1\ntitle\n{kind}\nDATASET {data}\n");
    let points = "POINTS 6 float\n2 2 0 1 2 0 1 1 0\n0 1 0 0 0 0 2 0 0\n";
    let old = format!(
        "{}{points}POLYGONS 1 7\n6 0 1 2 3 4 5\nTRIANGLE_STRIPS 1 5\n4 0 1 2 3\nLINES 1 3\n2 0 1\nPOINT_DATA 6\n\
         SCALARS r double 1\nLOOKUP_TABLE default\n1 2 3 4 5 6\nFIELD f 2\na 1 6 int\n1 2 3 4 5 6\nb 1 6 string\na\nb\n\n\nc\nd\n\
         METADATA\nx\n\nCELL_DATA 1\nNORMALS n float\n0 0 1\n",
        head("ASCII", "POLYDATA")
    );
    let new = format!(
        "{}{points}METADATA\nINFORMATION 0\n\nCELLS 3 7\nOFFSETS vtktypeint64\n0 3 7\nCONNECTIVITY vtktypeint64\n0 1 2 2 3 4 5\n\
         CELL_TYPES 2\n5\n9\n",
        head("ASCII", "UNSTRUCTURED_GRID")
    );
    let mut binary = format!("{}POINTS 4 float\n", head("BINARY", "POLYDATA")).into_bytes();
    for x in [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0u8] {
        binary.extend(f32::from(x).to_be_bytes());
    }
    binary.extend(b"\nPOLYGONS 1 5\n");
    [4, 0, 1, 2, 3].iter().for_each(|n: &i32| binary.extend(n.to_be_bytes()));
    binary.extend(b"\nPOINT_DATA 4\nFIELD f 2\nname%20x 1 4 unsigned_char\n\x01\x02\x03\x04\ns 1 4 string\n\xc1a\xc1b\xc0\xc1c\n");
    let seeds = [old.into_bytes(), new.into_bytes(), binary];
    let own: [&[u8]; 10] = [
        b"POLYGONS 1 4\n",
        b"OFFSETS vtktypeint64\n",
        b"CELL_TYPES ",
        b"BINARY",
        b"ASCII",
        b"METADATA\n",
        b"string",
        b"FIELD f 1\n",
        b"LOOKUP_TABLE t 2\n",
        b"unsigned_long",
    ];
    read_all("vtk", &seeds, &tokens(&own));
}
