//! Pictures of meshes, drawn on the CPU.
//!
//! Orthographic views with a scale bar, shaded softly from the upper left. An array over the nodes is shown in
//! viridis, which is perceptually uniform and safe for colour-blind eyes, with a colour bar. The inside of the wall
//! is darker than its outside; nodes without a value are grey.
//!
//! The z-buffer is our own, because an opaque triangle mesh needs no more; colours, glyphs and PNG come from `colorous`,
//! `ab_glyph` with the DejaVu fonts, and `png`.

mod canvas;
mod scale;

use crate::setters::setters;
use crate::surface::Surface;
use crate::{Error, Result, output};
use canvas::{Canvas, Colour, Sheet};
use glam::{DVec2, DVec3, UVec2};
pub(super) use scale::label;
use scale::{round_down, ticks};
use std::path::Path;

/// Direction of view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum View {
    /// Against y: x to the right, z up.
    Front,
    /// Against x: y to the right, z up.
    Side,
    /// Against z: x to the right, y up.
    Top,
    /// All three, at one scale.
    #[default]
    Three,
}

/// Style of a picture of a mesh.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Style {
    /// The array to show in colours; the bare mesh where absent.
    pub array: Option<String>,
    /// The values at both ends of the colour bar. Where absent: all of them, but from 0 where none is negative, and
    /// at most up to 10 times their mean, as the thesis caps its maps.
    pub range: Option<[f64; 2]>,
    /// Direction of view.
    pub view: View,
    /// Width and height, 320 to 4096 pixels each.
    pub size: [u32; 2],
}

setters!(Style {
    with_array => array: Option<String>,
    with_range => range: Option<[f64; 2]>,
    with_view => view: View,
    with_size => size: [u32; 2],
});

impl Default for Style {
    fn default() -> Self {
        Self { array: None, range: None, view: View::default(), size: [1600, 1000] }
    }
}

/// A picture, rows from the top, three bytes (sRGB) a pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Red, green and blue of every pixel.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// [`Error::UnknownEnding`] for another ending, [`Error::Write`]; no partial file is left behind.
    pub fn write(&self, path: &Path) -> Result<()> {
        check_ending(path)?;
        output::write_atomically(path, |w| self.encode(w))
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// [`Error::Output`] where the encoder fails.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let encoded = self.encode(&mut bytes);
        encoded.map_err(|source| Error::Output { target: "a picture", source })?;
        Ok(bytes)
    }

    /// Writes the bytes of a PNG file.
    pub(super) fn encode(&self, out: impl std::io::Write) -> std::io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        Ok(writer.finish()?)
    }
}

/// Refuses a picture's name that does not end in `.png`.
///
/// # Errors
/// [`Error::UnknownEnding`].
pub fn check_ending(path: &Path) -> Result<()> {
    match output::ending(path) {
        ending if ending == "png" => Ok(()),
        ending => Err(Error::UnknownEnding { path: path.into(), ending, expected: ".png" }),
    }
}

/// Draws a mesh.
///
/// # Errors
/// [`Error::Surface`] for a mesh without triangles, with wrong indices or positions that are not finite, and for an
/// array that it does not have or that has no value; [`Error::Setting`] for a range or a size that is none.
pub fn render(surface: &Surface, style: &Style) -> Result<Picture> {
    let [width, height] = style.size;
    if !(320..=4096).contains(&width) || !(320..=4096).contains(&height) {
        return Err(Error::Setting {
            name: "size".into(),
            found: format!("{width}x{height}"),
            expected: "320 to 4096 pixels each way".into(),
        });
    }
    surface.check()?;
    let values = Values::new(surface, style)?;
    let layout = Layout::new(surface, style)?;
    let normals = surface.node_normals();
    // Of triangles in one place the first is seen: the others would be drawn in vain.
    let triangles: Vec<[u32; 3]> =
        surface.distinct_triangles().into_iter().map(|t| surface.triangles[t as usize]).collect();
    let views: Vec<_> = layout.panels.iter().map(|panel| (panel, panel.place(surface, &layout))).collect();
    let mut sheet = Sheet::new(width as usize, height as usize, |canvas| {
        for (panel, seen) in &views {
            draw_mesh(canvas, &triangles, seen, &normals, values.as_ref(), panel.eye);
        }
    });
    for panel in &layout.panels {
        sheet.text(panel.label_at, panel.eye.label, layout.text_px * 0.8, FAINT);
    }
    draw_scale_bar(&mut sheet, &layout);
    if let Some(values) = &values {
        draw_colour_bar(&mut sheet, &layout, values);
    }
    Ok(Picture { width, height, rgb: sheet.rgb() })
}

const WALL: Colour = Colour::new(0.86, 0.70, 0.64);
const NO_VALUE: Colour = Colour::new(0.66, 0.66, 0.66);
const INK: Colour = Colour::new(0.15, 0.15, 0.17);
const FAINT: Colour = Colour::new(0.45, 0.45, 0.48);

/// A direction to look from: right, up and towards the eye are the picture's axes in the world.
struct Eye {
    label: &'static str,
    right: DVec3,
    up: DVec3,
    towards: DVec3,
}

const FRONT: Eye = Eye { label: "front  x→ z↑", right: DVec3::X, up: DVec3::Z, towards: DVec3::NEG_Y };
const SIDE: Eye = Eye { label: "side  y→ z↑", right: DVec3::Y, up: DVec3::Z, towards: DVec3::X };
const TOP: Eye = Eye { label: "top  x→ y↑", right: DVec3::X, up: DVec3::Y, towards: DVec3::Z };

/// Where one view goes in the picture.
struct Panel {
    eye: &'static Eye,
    /// The pixel on which the middle of the mesh comes to lie.
    middle_px: DVec2,
    /// Upper left corner of its label.
    label_at: DVec2,
}

impl Panel {
    /// The surface's nodes as they are seen: x and y in pixels, z towards the eye.
    fn place(&self, surface: &Surface, layout: &Layout) -> Vec<DVec3> {
        let Eye { right, up, towards, .. } = self.eye;
        let place = |p: &DVec3| {
            let d = (*p - layout.middle_mm) * layout.pixels_per_mm;
            DVec3::new(self.middle_px.x + d.dot(*right), self.middle_px.y - d.dot(*up), d.dot(*towards))
        };
        surface.nodes_mm.iter().map(place).collect()
    }
}

struct Layout {
    panels: Vec<Panel>,
    pixels_per_mm: f64,
    middle_mm: DVec3,
    text_px: f64,
    margin_px: f64,
    /// Left edge of the colour bar.
    legend_left_px: f64,
    size_px: DVec2,
}

impl Layout {
    fn new(surface: &Surface, style: &Style) -> Result<Self> {
        let wrong = |found: &str, expected: &str| Error::Surface {
            what: "mesh to draw".into(),
            found: found.into(),
            expected: expected.into(),
        };
        if surface.triangles.is_empty() {
            return Err(wrong("no triangles", "at least one"));
        }
        let Some([low, high]) =
            surface.bounding_box_mm().filter(|_| surface.nodes_mm.iter().all(|p| p.is_finite()))
        else {
            return Err(wrong("a position that is not finite", "finite coordinates in mm"));
        };
        let size_px = UVec2::from(style.size).as_dvec2();
        let (extent, middle_mm) = ((high - low).max(DVec3::splat(1e-9)), (low + high) * 0.5);
        let text_px = (size_px.min_element() / 42.0).clamp(11.0, 40.0);
        let margin_px = text_px * 1.2;
        let legend_width = if style.array.is_some() { text_px * 8.0 } else { 0.0 };
        // The views share what the label above and the scale bar below leave.
        let (label_height, foot_height) = (text_px * 1.4, text_px * 2.6);
        let free = size_px
            - DVec2::new(2.0 * margin_px + legend_width, 2.0 * margin_px + foot_height + label_height);
        let arrangements: &[Rows] = match style.view {
            View::Front => &[&[&[&FRONT]]],
            View::Side => &[&[&[&SIDE]]],
            View::Top => &[&[&[&TOP]]],
            View::Three => {
                &[&[&[&FRONT, &SIDE], &[&TOP]], &[&[&FRONT, &SIDE, &TOP]], &[&[&FRONT], &[&SIDE], &[&TOP]]]
            }
        };
        let gap_px = DVec2::new(margin_px * 2.0, margin_px + label_height);
        let grids = arrangements.iter().map(|rows| Grid::new(rows, extent, gap_px));
        let largest = |a: &Grid, b: &Grid| a.pixels_per_mm(free).total_cmp(&b.pixels_per_mm(free));
        // There is always one; without any there would be nothing to draw.
        let grid = grids.max_by(largest).unwrap_or_default();
        let corner_px = DVec2::new(margin_px, margin_px + label_height);
        let panels = grid.panels(corner_px, free, gap_px, label_height);
        let pixels_per_mm = grid.pixels_per_mm(free);
        Ok(Self {
            panels,
            pixels_per_mm,
            middle_mm,
            text_px,
            margin_px,
            legend_left_px: size_px.x - margin_px - legend_width + text_px * 1.5,
            size_px,
        })
    }
}

/// Views, row by row.
type Rows = &'static [&'static [&'static Eye]];

/// An arrangement of views: how wide its columns and how high its rows are.
#[derive(Default)]
struct Grid {
    eyes: Rows,
    columns_mm: Vec<f64>,
    rows_mm: Vec<f64>,
    all_mm: DVec2,
    gaps_px: DVec2,
}

impl Grid {
    fn new(eyes: Rows, extent_mm: DVec3, gap_px: DVec2) -> Self {
        let width = |eye: &Eye| extent_mm.dot(eye.right.abs());
        let height = |eye: &Eye| extent_mm.dot(eye.up.abs());
        let widest_row = eyes.iter().map(|row| row.len()).max().unwrap_or(0);
        let columns_mm: Vec<f64> = (0..widest_row)
            .map(|c| eyes.iter().filter_map(|row| row.get(c)).map(|eye| width(eye)).fold(0.0, f64::max))
            .collect();
        let rows_mm: Vec<f64> =
            eyes.iter().map(|row| row.iter().map(|eye| height(eye)).fold(0.0, f64::max)).collect();
        Self {
            eyes,
            all_mm: DVec2::new(columns_mm.iter().sum(), rows_mm.iter().sum()),
            gaps_px: gap_px * DVec2::new((columns_mm.len() - 1) as f64, (rows_mm.len() - 1) as f64),
            columns_mm,
            rows_mm,
        }
    }

    /// The scale at which the views fill the room.
    fn pixels_per_mm(&self, room_px: DVec2) -> f64 {
        ((room_px - self.gaps_px) / self.all_mm).min_element()
    }

    /// Where each view goes in a room with that upper left corner.
    fn panels(&self, corner_px: DVec2, room_px: DVec2, gap_px: DVec2, label_height_px: f64) -> Vec<Panel> {
        let pixels_per_mm = self.pixels_per_mm(room_px);
        let start = corner_px + (room_px - self.gaps_px - self.all_mm * pixels_per_mm) * 0.5;
        let mut panels = Vec::new();
        let mut y = start.y;
        for (row, height_mm) in self.eyes.iter().zip(&self.rows_mm) {
            let mut x = start.x;
            for (eye, width_mm) in row.iter().zip(&self.columns_mm) {
                let size_px = DVec2::new(*width_mm, *height_mm) * pixels_per_mm;
                panels.push(Panel {
                    eye,
                    middle_px: DVec2::new(x, y) + size_px * 0.5,
                    label_at: DVec2::new(x, y - label_height_px),
                });
                x += size_px.x + gap_px.x;
            }
            y += height_mm * pixels_per_mm + gap_px.y;
        }
        panels
    }
}

/// The array on show and its colours.
struct Values<'a> {
    name: &'a str,
    of_nodes: &'a [f64],
    range: [f64; 2],
    /// Whether there are values below and above the range, and nodes without one.
    below: bool,
    above: bool,
    missing: bool,
    colours: Vec<Colour>,
}

impl<'a> Values<'a> {
    fn new(surface: &'a Surface, style: &'a Style) -> Result<Option<Self>> {
        let Some(name) = &style.array else {
            return Ok(None);
        };
        let Some(of_nodes) = surface.array(name) else {
            let names: Vec<&str> = surface.arrays.iter().map(|a| a.name.as_str()).collect();
            return Err(Error::Surface {
                what: format!("array {name:?}"),
                found: "none of that name".into(),
                expected: match names.as_slice() {
                    [] => "an array, but the mesh has none".into(),
                    names => format!("one of {}", names.join(", ")),
                },
            });
        };
        let finite = || of_nodes.iter().copied().filter(|v| v.is_finite());
        let (low, high) =
            finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return Err(Error::Surface {
                what: format!("array {name:?}"),
                found: "no finite value".into(),
                expected: "at least one".into(),
            });
        }
        let range = match style.range {
            Some([a, b]) if a.is_finite() && b.is_finite() && a < b => [a, b],
            Some([a, b]) => {
                return Err(Error::Setting {
                    name: "range".into(),
                    found: format!("{a},{b}"),
                    expected: "two finite numbers, the smaller first".into(),
                });
            }
            None if low >= 0.0 => {
                let mean = finite().sum::<f64>() / finite().count() as f64;
                [0.0, high.min(10.0 * mean)]
            }
            None => [low, high],
        };
        // One value all over still needs a bar of some length.
        let range = if range[0] < range[1] { range } else { [range[0], range[0] + range[0].abs().max(1.0)] };
        Ok(Some(Self {
            name,
            of_nodes,
            range,
            below: low < range[0],
            above: high > range[1],
            missing: of_nodes.iter().any(|v| !v.is_finite()),
            colours: (0..1024).map(|i| viridis(f64::from(i) / 1023.0)).collect(),
        }))
    }

    fn colour(&self, value: f64) -> Colour {
        let t = (value - self.range[0]) / (self.range[1] - self.range[0]);
        if t.is_nan() {
            return NO_VALUE;
        }
        let last = self.colours.len() - 1;
        self.colours[(t.clamp(0.0, 1.0) * last as f64).round() as usize]
    }
}

fn viridis(t: f64) -> Colour {
    let c = colorous::VIRIDIS.eval_continuous(t.clamp(0.0, 1.0));
    Colour::new(f32::from(c.r) / 255.0, f32::from(c.g) / 255.0, f32::from(c.b) / 255.0)
}

fn draw_mesh(
    canvas: &mut Canvas,
    triangles: &[[u32; 3]],
    seen: &[DVec3],
    normals: &[DVec3],
    values: Option<&Values>,
    Eye { right, up, towards, .. }: &Eye,
) {
    // From the upper left, a little off the eye, so that shapes show and no side is black.
    let light = (*right * -0.35 + *up * 0.45 + *towards * 0.82).normalize();
    for triangle in triangles {
        let corners = triangle.map(|n| seen[n as usize]);
        let [na, nb, nc] = triangle.map(|n| normals[n as usize]);
        // Rows count downwards, which turns the sense of the triangle round.
        let area = (corners[1] - corners[0]).truncate().perp_dot((corners[2] - corners[0]).truncate());
        let outside = area < 0.0;
        let [va, vb, vc] = match values {
            Some(values) => triangle.map(|n| values.of_nodes[n as usize]),
            None => [f64::NAN; 3],
        };
        canvas.triangle(corners, |[a, b, c]| {
            let normal = (na * a + nb * b + nc * c).normalize_or_zero();
            let normal = if outside { normal } else { -normal };
            let colour = match values {
                Some(values) => values.colour(va * a + vb * b + vc * c),
                None => WALL,
            };
            // Light wraps round, so that relief shows on the far side too.
            let shade = 0.4 + 0.3 * (1.0 + normal.dot(light));
            colour.times((if outside { shade } else { 0.6 * shade }) as f32)
        });
    }
}

fn draw_scale_bar(sheet: &mut Sheet, layout: &Layout) {
    let length_mm = round_down(0.2 * layout.size_px.x / layout.pixels_per_mm);
    let length = length_mm * layout.pixels_per_mm;
    let thickness = (layout.text_px * 0.22).max(2.0).round();
    let left = layout.margin_px.round();
    let bottom = (layout.size_px.y - layout.margin_px).round();
    let end = DVec2::new(left + length.round(), bottom);
    sheet.rectangle(DVec2::new(left, bottom - thickness), end, INK);
    let tick = DVec2::new(thickness, 3.0 * thickness);
    sheet.rectangle(DVec2::new(left, bottom - tick.y), DVec2::new(left + tick.x, bottom), INK);
    sheet.rectangle(DVec2::new(end.x - tick.x, bottom - tick.y), end, INK);
    let text = format!("{} mm", label(length_mm, length_mm));
    let x = left + 0.5 * (length - sheet.text_width(&text, layout.text_px));
    sheet.text(DVec2::new(x.max(left), bottom - tick.y - layout.text_px * 1.1), &text, layout.text_px, INK);
}

fn draw_colour_bar(sheet: &mut Sheet, layout: &Layout, values: &Values) {
    let px = layout.text_px;
    let (left, right) = (layout.legend_left_px.round(), (layout.legend_left_px + px * 1.1).round());
    let (top, bottom) = ((layout.size_px.y * 0.2).round(), (layout.size_px.y * 0.75).round());
    let [low, high] = values.range;
    for y in top as usize..bottom as usize {
        let t = 1.0 - (y as f64 + 0.5 - top) / (bottom - top);
        let row = DVec2::new(left, y as f64);
        sheet.rectangle(row, DVec2::new(right, row.y + 1.0), values.colour(low + t * (high - low)));
    }
    // A point at an end says that there are values beyond it.
    let point = (px * 0.8).round();
    for i in 0..point as usize {
        let inset = (i as f64 + 0.5) / point * 0.5 * (right - left);
        let (x0, x1) = (left + inset, right - inset);
        if values.above {
            let y = top - i as f64 - 1.0;
            sheet.rectangle(DVec2::new(x0, y), DVec2::new(x1, y + 1.0), values.colour(high));
        }
        if values.below {
            let y = bottom + i as f64;
            sheet.rectangle(DVec2::new(x0, y), DVec2::new(x1, y + 1.0), values.colour(low));
        }
    }
    let (step, at) = ticks(low, high);
    for value in at {
        let y = (bottom - (value - low) / (high - low) * (bottom - top)).round();
        sheet.rectangle(DVec2::new(right, y - 1.0), DVec2::new(right + px * 0.3, y + 1.0), INK);
        sheet.text(DVec2::new(right + px * 0.5, y - px * 0.58), &label(value, step), px, INK);
    }
    let title = title(values.name);
    let width = sheet.text_width(&title, px);
    let x = left.min(layout.size_px.x - layout.margin_px - width).max(0.0);
    sheet.text(DVec2::new(x, top - point - px * 1.8), &title, px, INK);
    if values.missing {
        let y = bottom + point + px;
        sheet.rectangle(DVec2::new(left, y), DVec2::new(right, y + px), NO_VALUE);
        sheet.text(DVec2::new(right + px * 0.5, y - px * 0.08), "no value", px, INK);
    }
}

/// An array's name for people: the unit at its end goes into brackets.
fn title(name: &str) -> String {
    let (quantity, unit) = match name.rsplit_once('_') {
        Some((quantity, "mm")) => (quantity, " (mm)"),
        Some((quantity, "mm2")) => (quantity, " (mm²)"),
        Some((quantity, "rad")) => (quantity, " (rad)"),
        Some((quantity, "deg")) => (quantity, " (°)"),
        Some((quantity, "s")) => (quantity, " (s)"),
        _ => (name, ""),
    };
    quantity.replace('_', " ") + unit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_say_the_unit() {
        assert_eq!(title("signed_distance_mm"), "signed distance (mm)");
        assert_eq!(title("points"), "points");
        assert_eq!(title("time_s"), "time (s)");
    }
}
