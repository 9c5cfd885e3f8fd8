//! The page that shows a vessel in a browser (`docs/viewer.md`).

use crate::geometry::Pose;
use crate::recording::{Frame, Recording};
use crate::surface::Surface;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

const PAGE: &str = include_str!("viewer/viewer.html");
/// The files of the page, by their marks.
const FILES: [(&str, &str); 5] = [
    ("/*viewer.css*/", include_str!("viewer/viewer.css")),
    ("/*vessel.js*/", include_str!("viewer/vessel.js")),
    ("/*measure.js*/", include_str!("viewer/measure.js")),
    ("/*scene.js*/", include_str!("viewer/scene.js")),
    ("/*page.js*/", include_str!("viewer/page.js")),
];

/// A page with a vessel, and with the frames of its recording where there is one; `sensor_from_probe` is the calibration.
/// It needs neither a server nor a network.
pub fn viewer_page(title: &str, surface: &Surface, recording: Option<(&Recording, Pose)>) -> String {
    let mut vessel = vessel_of_mesh(title, surface);
    if let Some((recording, sensor_from_probe)) = recording {
        let frames: Vec<Value> = (0..recording.frames.len())
            .filter(|&k| !recording.frames[k].contour_mm.is_empty())
            .map(|k| {
                let frame = &recording.frames[k];
                let mut shown =
                    frame_of(recording.number(k), frame.time_s, frame.world_from_sensor * sensor_from_probe);
                shown["contour_mm"] = contour_of(frame);
                shown
            })
            .collect();
        vessel["frames"] = frames.into();
    }
    page_with(&vessel.to_string().replace('<', "\\u003c"))
}

/// The page of a vessel to go into another page: with the catheter's path, but without contours, which are most
/// of a recording.
pub(super) fn embedded_page(title: &str, surface: &Surface, recording: Option<(&Recording, Pose)>) -> String {
    let mut vessel = vessel_of_mesh(title, surface);
    if let Some((recording, sensor_from_probe)) = recording {
        let frame = |(k, frame): (usize, &Frame)| {
            let mut shown =
                frame_of(recording.number(k), frame.time_s, frame.world_from_sensor * sensor_from_probe);
            // Micrometres do for a picture.
            if let Some(numbers) = shown.get_mut("world_from_probe").and_then(Value::as_array_mut) {
                numbers.iter_mut().filter_map(|x| Some((x.as_f64()?, x))).for_each(|(value, x)| {
                    *x = ((value * 1e4).round() / 1e4).into();
                });
            }
            shown
        };
        vessel["frames"] = recording.frames.iter().enumerate().map(frame).collect();
    }
    page_with(&vessel.to_string().replace('<', "\\u003c"))
}

/// The page of a vessel that a server will send.
#[cfg(feature = "cli")]
pub(crate) fn live_page() -> String {
    page_with("")
}

fn page_with(vessel: &str) -> String {
    let page = FILES.iter().fold(PAGE.to_owned(), |page, (mark, text)| page.replacen(mark, text, 1));
    page.replacen("/*vessel*/", vessel, 1)
}

/// The event `vessel` of a mesh.
pub(crate) fn vessel_of_mesh(title: &str, surface: &Surface) -> Value {
    let arrays: serde_json::Map<String, Value> = surface
        .arrays
        .iter()
        .map(|array| (array.name.clone(), floats(array.values.iter().copied())))
        .collect();
    let indices: Vec<u8> = surface.triangles.iter().flatten().flat_map(|n| n.to_le_bytes()).collect();
    json!({
        "type": "vessel",
        "title": title,
        "positions_mm": floats(surface.nodes_mm.iter().flat_map(|p| p.to_array())),
        "triangles": STANDARD.encode(indices),
        "arrays": arrays,
    })
}

/// A frame without its contour; a pose that is lost is left out.
pub(crate) fn frame_of(number: usize, time_s: Option<f64>, world_from_probe: Pose) -> Value {
    let mut frame = json!({ "number": number, "time_s": time_s });
    if world_from_probe.is_finite() {
        let Pose { rotation, translation_mm } = world_from_probe;
        let row = |i: usize| {
            let [x, y, z] = rotation.row(i).to_array();
            [x, y, z, translation_mm[i]]
        };
        frame["world_from_probe"] = (0..3).flat_map(row).collect();
    }
    frame
}

/// The member `contour_mm` of a frame.
pub(crate) fn contour_of(frame: &Frame) -> Value {
    floats(frame.contour_mm.iter().flat_map(|p| p.to_array()))
}

/// Numbers as the page reads them: f32, little-endian, in base64.
pub(crate) fn floats(values: impl Iterator<Item = f64>) -> Value {
    let bytes: Vec<u8> = values.flat_map(|value| (value as f32).to_le_bytes()).collect();
    STANDARD.encode(bytes).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::NodeArray;
    use glam::DVec3;

    #[test]
    fn a_page_has_all_its_files_and_the_vessel_once() {
        let surface = Surface {
            nodes_mm: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]],
            arrays: vec![NodeArray { name: "support".into(), values: vec![1.0, 2.0, f64::NAN] }],
        };
        let page = viewer_page("a </script> b", &surface, None);
        assert!(FILES.iter().all(|(mark, text)| !page.contains(mark) && page.contains(text)));
        let start = page.find("id=\"vessel\">").unwrap() + "id=\"vessel\">".len();
        let text = &page[start..start + page[start..].find("</script>").unwrap()];
        let vessel: Value = serde_json::from_str(text).unwrap();
        assert_eq!(vessel["title"], "a </script> b");
        let bytes = STANDARD.decode(vessel["positions_mm"].as_str().unwrap()).unwrap();
        assert_eq!(bytes.len(), 3 * 3 * 4);
        assert_eq!(bytes[12..16], 1.0_f32.to_le_bytes());
        assert_eq!(vessel["triangles"], STANDARD.encode([0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]));
    }
}
