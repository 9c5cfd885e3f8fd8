//! Pictures against the meshes that they show.

use crate::support::tube;
use lumenmesh::report::render::{Picture, Style, View, render};
use lumenmesh::surface::Surface;

/// A tube of 20 by 60 mm about z.
fn mesh() -> Surface {
    tube(64, 30, 10.0, 60.0)
}

fn front() -> Style {
    Style::default().with_view(View::Front).with_size([400, 500])
}

fn pixel(picture: &Picture, x: u32, y: u32) -> [u8; 3] {
    let at = 3 * (y * picture.width + x) as usize;
    [picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]]
}

/// The first and the last pixel of a row that is neither paper nor text, which is grey.
fn silhouette(picture: &Picture, y: u32) -> Option<(u32, u32)> {
    let seen = |x: &u32| {
        let [r, g, b] = pixel(picture, *x, y).map(i32::from);
        (r - b).abs().max((r - g).abs()) > 8
    };
    Some(((0..picture.width).find(seen)?, (0..picture.width).rev().find(seen)?))
}

#[test]
fn a_tube_is_drawn_to_scale() {
    let picture = render(&mesh(), &front()).unwrap();
    let rows: Vec<(u32, (u32, u32))> =
        (0..picture.height).filter_map(|y| Some((y, silhouette(&picture, y)?))).collect();
    let height = rows.len() as f64;
    let (left, right) = rows[rows.len() / 2].1;
    let width = f64::from(right - left + 1);
    // Both edges of either are off by a pixel at most.
    assert!((height / width - 3.0).abs() < 3.0 * 2.0 * (1.0 / height + 1.0 / width), "{width} x {height}");
    assert!(height > 300.0, "the tube fills the picture: {height} of 500 pixels");
}

#[test]
fn values_have_their_colours_and_missing_ones_are_grey() {
    let mut surface = mesh();
    let values = |surface: &Surface, low: f64, high: f64| {
        surface.nodes_mm.iter().map(|p| if p.z > 0.0 { high } else { low }).collect()
    };
    let style = front().with_array(Some("error_mm".into())).with_range(Some([0.0, 1.0]));
    let shown = |surface: &Surface| {
        let picture = render(surface, &style).unwrap();
        let middle = (picture.width - 90) / 2;
        [pixel(&picture, middle, 120), pixel(&picture, middle, 380)]
    };
    surface.set_array("error_mm", values(&surface, 0.0, 1.0));
    let [[r1, g1, b1], [r0, g0, b0]] = shown(&surface);
    // Viridis goes from dark violet to yellow.
    assert!(r1 > b1 + 50 && g1 > b1 + 50, "the upper half is {r1} {g1} {b1}");
    assert!(b0 > g0 + 30 && r0 > g0 + 30, "the lower half is {r0} {g0} {b0}");
    surface.set_array("error_mm", values(&surface, f64::NAN, 1.0));
    let [_, [r, g, b]] = shown(&surface);
    assert!(r == g && g == b && (90..200).contains(&r), "without a value: {r} {g} {b}");
}

#[test]
fn the_inside_is_darker_than_the_outside() {
    let outside = mesh();
    let mut inside = mesh();
    inside.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let brightness = |surface: &Surface| {
        let picture = render(surface, &front()).unwrap();
        pixel(&picture, 200, 250).iter().map(|c| u32::from(*c)).sum::<u32>()
    };
    assert!(brightness(&inside) * 4 < brightness(&outside) * 3);
}

#[test]
fn the_file_holds_the_picture_and_is_the_same_every_time() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one.png"), folder.path().join("two.png"));
    let picture = render(&mesh(), &Style::default().with_size([640, 480])).unwrap();
    picture.write(&one).unwrap();
    render(&mesh(), &Style::default().with_size([640, 480])).unwrap().write(&two).unwrap();
    assert_eq!(std::fs::read(&one).unwrap(), std::fs::read(&two).unwrap());
    let file = std::io::BufReader::new(std::fs::File::open(&one).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut rgb).unwrap();
    assert_eq!((info.width, info.height), (640, 480));
    assert!(rgb == picture.rgb);
}

#[test]
fn what_cannot_be_drawn_is_refused_with_a_reason() {
    let mut surface = mesh();
    surface.set_array("error_mm", vec![f64::NAN; surface.nodes_mm.len()]);
    let message = |style: Style| render(&surface, &style).unwrap_err().to_string();
    let with_array = |name: &str| front().with_array(Some(name.into()));
    assert!(message(with_array("eror_mm")).contains("expected one of error_mm"));
    assert!(message(with_array("error_mm")).contains("no finite value"));
    assert!(message(front().with_size([10, 500])).contains("10x500"));
    surface.set_array("error_mm", vec![1.0; surface.nodes_mm.len()]);
    let backwards = with_array("error_mm").with_range(Some([2.0, 1.0]));
    assert!(render(&surface, &backwards).unwrap_err().to_string().contains("the smaller first"));
    surface.nodes_mm[3].x = f64::NAN;
    assert!(render(&surface, &front()).unwrap_err().to_string().contains("finite coordinates"));
    surface.nodes_mm[3].x = 0.0;
    surface.triangles.clear();
    assert!(render(&surface, &front()).unwrap_err().to_string().contains("no triangles"));
    let picture = Picture { width: 1, height: 1, rgb: vec![0; 3] };
    assert!(picture.write("picture.jpg".as_ref()).unwrap_err().to_string().contains(".png"));
}
