//! Recordings made of images and of drawn curves.

use crate::support::lumenmesh;
use flate2::{Compression, write::ZlibEncoder};
use glam::{DVec2, DVec3};
use lumenmesh::recording::{Curves, MaskOptions, Masks, ReadOptions, Recording};
use std::io::Write;
use std::path::{Path, PathBuf};

const WIDTH: usize = 80;
const HEIGHT: usize = 60;
/// The lumen in the images, in pixels: its centre and its radius, and where the probe lies.
const CENTRE: DVec2 = DVec2::new(41.3, 30.2);
const RADIUS: f64 = 17.0;
const PROBE: DVec2 = DVec2::new(38.0, 33.0);

/// 255 in the lumen, less over two pixels at its wall; an echo outside that is no lumen.
fn pixel(p: DVec2) -> u8 {
    let lumen = 127.5 + 127.5 * (RADIUS - p.distance(CENTRE)).clamp(-1.0, 1.0);
    let other = if p.distance(DVec2::new(70.0, 8.0)) < 3.0 { 255.0 } else { 0.0 };
    f64::max(lumen, other).round() as u8
}

/// A sequence of masks: the second has no pose, the third no lumen, in the fourth it does not contain the probe.
fn sequence(
    path: &Path,
    orientation: &str,
    compressed: bool,
    in_file: &str,
    order: impl Fn(usize, usize) -> DVec2,
) {
    let mut pixels = Vec::new();
    for frame in 0..5 {
        for k in 0..WIDTH * HEIGHT {
            let p = order(k % WIDTH, k / WIDTH);
            pixels.push(match frame {
                2 => 0,
                3 => pixel(p - DVec2::X * 22.0),
                _ => pixel(p),
            });
        }
    }
    let mut text = format!(
        "ObjectType = Image\nNDims = 3\nDimSize = {WIDTH} {HEIGHT} 5\nElementType = MET_UCHAR\n\
         Kinds = domain domain list\nUltrasoundImageOrientation = {orientation}\n"
    );
    for frame in 0..5 {
        let status = if frame == 1 { "INVALID" } else { "OK" };
        text += &format!(
            "Seq_Frame{frame:04}_ProbeToTrackerTransform = 1 0 0 0 0 1 0 0 0 0 1 {frame} 0 0 0 1\n\
             Seq_Frame{frame:04}_ProbeToTrackerTransformStatus = {status}\n{}",
            in_file.replace("NNNN", &format!("{frame:04}"))
        );
    }
    if compressed {
        let mut stream = ZlibEncoder::new(Vec::new(), Compression::fast());
        stream.write_all(&pixels).unwrap();
        pixels = stream.finish().unwrap();
        text += &format!("CompressedData = True\nCompressedDataSize = {}   \n", pixels.len());
    }
    text += "ElementDataFile = LOCAL\n";
    std::fs::write(path, [text.as_bytes(), &pixels].concat()).unwrap();
}

fn file() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("masks.igs.mha");
    (folder, path)
}

fn flags() -> MaskOptions {
    MaskOptions::default().with_pixel_mm(Some([0.1, 0.1])).with_centre_px(Some(PROBE.to_array()))
}

/// The largest distance of a contour from the lumen's wall, mm.
fn off_the_wall_mm(contour: &[DVec2], probe: DVec2) -> f64 {
    let centre = (CENTRE - probe) * 0.1;
    contour.iter().map(|p| (p.distance(centre) - RADIUS * 0.1).abs()).fold(0.0, f64::max)
}

#[test]
fn a_mask_becomes_a_contour_between_pixels() {
    let (_folder, path) = file();
    for compressed in [false, true] {
        sequence(&path, "MF", compressed, "", |x, y| DVec2::new(x as f64, y as f64));
        let masks = Masks::read(&path, &ReadOptions::default(), &flags()).unwrap();
        let counts = (masks.without_pose, masks.empty, masks.probe_outside, masks.cut, masks.threshold);
        assert_eq!(counts, (1, 1, 1, 0, 127.5));
        let frames = &masks.recording.frames;
        assert_eq!((0..4).map(|k| masks.recording.number(k)).collect::<Vec<_>>(), [0, 2, 3, 4]);
        assert_eq!(frames.iter().map(|f| f.contour_mm.len()).collect::<Vec<_>>(), [128, 0, 0, 128]);
        // A fiftieth of a pixel.
        assert!(off_the_wall_mm(&frames[0].contour_mm, PROBE) < 0.002);
        assert!(off_the_wall_mm(&frames[0].contour_mm, PROBE + DVec2::X) > 0.05);
        // At equal distances, counter-clockwise from the direction of x.
        let contour = &frames[0].contour_mm;
        let steps: Vec<f64> = (0..128).map(|k| contour[k].distance(contour[(k + 1) % 128])).collect();
        assert!(steps.iter().all(|step| (step - steps[0]).abs() < 0.02 * steps[0]), "{steps:?}");
        assert!(contour[0].x > 0.0 && contour[0].y.abs() < 0.1 && contour[20].y > 0.5);
    }
}

#[test]
fn every_orientation_gives_the_same_contours() {
    let (_folder, path) = file();
    sequence(&path, "MF", false, "", |x, y| DVec2::new(x as f64, y as f64));
    let straight = Masks::read(&path, &ReadOptions::default(), &flags()).unwrap();
    let last = DVec2::new(WIDTH as f64 - 1.0, HEIGHT as f64 - 1.0);
    sequence(&path, "UN", false, "", |x, y| last - DVec2::new(x as f64, y as f64));
    let turned = Masks::read(&path, &ReadOptions::default(), &flags()).unwrap();
    for (a, b) in straight.recording.frames.iter().zip(&turned.recording.frames) {
        assert_eq!(a.contour_mm.len(), b.contour_mm.len());
        assert!(off_the_wall_mm(&b.contour_mm, PROBE) < 0.002);
    }
    sequence(&path, "UN", false, "", |x, y| DVec2::new(x as f64, y as f64));
    let wrong = Masks::read(&path, &ReadOptions::default(), &flags().with_largest(true)).unwrap();
    assert!(off_the_wall_mm(&wrong.recording.frames[0].contour_mm, PROBE) > 0.05);
}

#[test]
fn image_to_probe_comes_from_a_configuration_or_the_file() {
    let (folder, path) = file();
    let matrix = format!("0.1 0 0 {} 0 0.1 0 {} 0 0 0.1 0 0 0 0 1", -0.1 * PROBE.x, -0.1 * PROBE.y);
    let config = folder.path().join("plus.xml");
    let xml = format!("<C><Transform From=\"Image\" To=\"Probe\" Matrix=\"{matrix}\"/></C>");
    std::fs::write(&config, xml).unwrap();
    let reading = ReadOptions::default().with_plus_config(Some(config));
    let plain = |x: usize, y: usize| DVec2::new(x as f64, y as f64);
    sequence(&path, "MFA", false, "", plain);
    let by_config = Masks::read(&path, &reading, &MaskOptions::default()).unwrap();
    assert!(off_the_wall_mm(&by_config.recording.frames[0].contour_mm, PROBE) < 0.002 && !by_config.tilted);
    let message =
        Masks::read(&path, &ReadOptions::default(), &MaskOptions::default()).unwrap_err().to_string();
    assert!(message.contains("--plus-config") && message.contains("--pixel-size"), "{message}");
    sequence(&path, "MF", false, &format!("Seq_FrameNNNN_ImageToProbeTransform = {matrix}\n"), plain);
    let reading = ReadOptions::default().with_transform(Some("ProbeToTracker".into()));
    let by_file = Masks::read(&path, &reading, &MaskOptions::default()).unwrap();
    assert_eq!(by_file.recording.frames[0].contour_mm, by_config.recording.frames[0].contour_mm);
}

#[test]
fn the_edge_of_the_image_is_no_wall() {
    let (_folder, path) = file();
    sequence(&path, "MF", false, "", |x, y| DVec2::new(x as f64, y as f64 + 20.0));
    let options = flags().with_centre_px(Some([PROBE.x, PROBE.y - 20.0]));
    let masks = Masks::read(&path, &ReadOptions::default(), &options).unwrap();
    let contour = &masks.recording.frames[0].contour_mm;
    let missing = contour.iter().filter(|p| p.is_nan()).count();
    assert!(masks.cut >= 2 && (10..60).contains(&missing), "{missing} of {}", contour.len());
    let seen: Vec<DVec2> = contour.iter().copied().filter(|p| !p.is_nan()).collect();
    assert!(off_the_wall_mm(&seen, PROBE) < 0.002);
}

#[test]
fn what_is_wrong_with_masks_is_said() {
    let (_folder, path) = file();
    let plain = |x: usize, y: usize| DVec2::new(x as f64, y as f64);
    let says = |options: &MaskOptions, words: &str| {
        let message = Masks::read(&path, &ReadOptions::default(), options).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    };
    sequence(&path, "MF", false, "", plain);
    says(&flags().with_threshold(Some(300.0)), "5 without a pixel at the threshold 300");
    says(&flags().with_points(2), "points: found 2");
    says(&flags().with_pixel_mm(Some([0.0, 1.0])), "pixel size");
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 10]).unwrap();
    says(&flags(), "pixels of image 4: found 4790 bytes, expected 4800 bytes");
    let text = String::from_utf8_lossy(&whole).replace("DimSize = 80 60 5", "DimSize = 99999999 99999999 5");
    std::fs::write(&path, text).unwrap();
    says(&flags(), "at most 2^26 pixels");
    let text = String::from_utf8_lossy(&whole).replace("MET_UCHAR", "MET_OTHER");
    std::fs::write(&path, text).unwrap();
    says(&flags(), "type of pixels: found MET_OTHER");
}

#[test]
fn the_command_imports_masks_and_reconstructs_from_them() {
    let (folder, path) = file();
    let mut text = String::new();
    let mut pixels = Vec::new();
    for frame in 0..60 {
        let matrix = format!("1 0 0 0 0 1 0 0 0 0 1 {} 0 0 0 1", 0.5 * f64::from(frame));
        text += &format!("Seq_Frame{frame:04}_ProbeToTrackerTransform = {matrix}\n");
        let jitter = 0.1 * f64::from(frame * 7 % 5);
        pixels.extend(
            (0..WIDTH * HEIGHT).map(|k| pixel(DVec2::new((k % WIDTH) as f64 + jitter, (k / WIDTH) as f64))),
        );
    }
    let header =
        format!("ObjectType = Image\nNDims = 3\nDimSize = {WIDTH} {HEIGHT} 60\nElementType = MET_UCHAR\n");
    std::fs::write(&path, [(header + &text + "ElementDataFile = LOCAL\n").as_bytes(), &pixels].concat())
        .unwrap();
    let arguments =
        ["import", "mask", "masks.igs.mha", "-o", "rec.igs.mha", "--pixel-size", "0.1", "--centre", "38,33"];
    let (status, said, wrong) = lumenmesh(&arguments, folder.path());
    assert!(status == 0 && said.contains("threshold       127.5"), "{said}{wrong}");
    let (status, _, wrong) = lumenmesh(&["reconstruct", "rec.igs.mha", "-o", "vessel.vtp"], folder.path());
    assert_eq!(status, 0, "{wrong}");
    let mesh = lumenmesh::surface::Surface::read(&folder.path().join("vessel.vtp")).unwrap();
    let centre = (CENTRE - PROBE) * 0.1;
    let radii: Vec<f64> = mesh.nodes_mm.iter().map(|p| p.truncate().distance(centre)).collect();
    let mean = radii.iter().sum::<f64>() / radii.len() as f64;
    assert!((mean - 1.7).abs() < 0.02, "{mean}");
}

/// A closed curve as Slicer writes it, around a point on a bent line, in LPS.
fn markup(k: usize, kind: &str, system: &str) -> String {
    let angle = 0.1 * k as f64;
    let (centre, x) = (DVec3::new(0.0, 10.0 * angle.sin(), 20.0 * angle), DVec3::X);
    let y = DVec3::new(0.0, angle.cos(), -angle.sin());
    let points = (0..12).map(|j| {
        let (sin, cos) = (f64::from(j) * std::f64::consts::TAU / 12.0).sin_cos();
        let p = centre + x * (3.0 * cos) + y * (3.0 * sin);
        let p = if system == "LPS" { DVec3::new(-p.x, -p.y, p.z) } else { p };
        format!(r#"{{"id":"{j}","position":[{},{},{}],"positionStatus":"defined"}}"#, p.x, p.y, p.z)
    });
    format!(
        r#"{{"@schema":"x","markups":[{{"type":"{kind}","coordinateSystem":"{system}","coordinateUnits":"mm","controlPoints":[{}]}}]}}"#,
        points.collect::<Vec<_>>().join(",")
    )
}

#[test]
fn curves_drawn_in_slicer_become_frames_across_the_vessel() {
    let folder = tempfile::tempdir().unwrap();
    let read = |system: &str| {
        let paths: Vec<PathBuf> = (0..6)
            .map(|k| {
                let path = folder.path().join(format!("lumen_{k}.mrk.json"));
                std::fs::write(&path, markup(k, "ClosedCurve", system)).unwrap();
                path
            })
            .collect();
        Curves::read(&paths).unwrap()
    };
    let curves = read("LPS");
    assert_eq!(curves.names[5], "lumen_5");
    for (k, frame) in curves.recording.frames.iter().enumerate() {
        let angle = 0.1 * k as f64;
        let centre = DVec3::new(0.0, 10.0 * angle.sin(), 20.0 * angle);
        assert!(frame.world_from_sensor.translation_mm.distance(centre) < 1e-9);
        assert!(
            frame.world_from_sensor.rotation.z_axis.dot(DVec3::new(0.0, angle.sin(), angle.cos()))
                > 0.999_999
        );
        assert!(frame.contour_mm.iter().all(|p| (p.length() - 3.0).abs() < 0.01));
        assert!(curves.off_plane_mm[k] < 1e-9);
    }
    let same = read("RAS");
    for (a, b) in same.recording.frames.iter().zip(&curves.recording.frames) {
        assert!(a.world_from_sensor.translation_mm.distance(b.world_from_sensor.translation_mm) < 1e-9);
    }
    let (status, said, wrong) = lumenmesh(
        &["import", "curves", "lumen_0.mrk.json", "lumen_1.mrk.json", "-o", "drawn.mat"],
        folder.path(),
    );
    assert!(status == 0 && said.contains("1: lumen_1"), "{said}{wrong}");
    assert_eq!(Recording::read(&folder.path().join("drawn.mat")).unwrap().frames.len(), 2);
    let path = folder.path().join("lumen_0.mrk.json");
    for (text, words) in [
        (markup(0, "Line", "LPS"), "ClosedCurve"),
        (markup(0, "ClosedCurve", "XYZ"), "LPS or RAS"),
        (markup(0, "ClosedCurve", "RAS").replace("\"mm\"", "\"um\""), "expected mm"),
        (markup(0, "ClosedCurve", "RAS").replace("defined", "preview"), "0 different points"),
        ("{".into(), "markups"),
    ] {
        std::fs::write(&path, text).unwrap();
        let message = Curves::read(std::slice::from_ref(&path)).unwrap_err().to_string();
        assert!(message.contains(words) && message.contains("lumen_0.mrk.json"), "{message}");
    }
}
