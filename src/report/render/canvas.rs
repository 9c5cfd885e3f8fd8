//! Pixels: a z-buffer for triangles, then rectangles and text.

use ab_glyph::{Font, FontRef, ScaleFont};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// Red, green and blue, 0 to 1, sRGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Colour([f32; 3]);

impl Colour {
    pub const fn new(red: f32, green: f32, blue: f32) -> Self {
        Self([red, green, blue])
    }

    pub fn times(self, factor: f32) -> Self {
        Self(self.0.map(|c| c * factor))
    }
}

const PAPER: Colour = Colour::new(0.985, 0.985, 0.98);

/// Rows of the picture that are drawn at a time.
const BAND: usize = 256;

/// Pixels along each side of one pixel of the picture, for smooth edges.
const FINE: usize = 3;

/// A band of rows of the picture on which a mesh is drawn: finer than the picture by [`FINE`], positions in the picture's
/// pixels.
pub(super) struct Canvas {
    width: usize,
    /// The rows of the picture.
    rows: Range<usize>,
    colours: Vec<[u8; 3]>,
    nearness: Vec<f32>,
}

impl Canvas {
    pub fn new(width: usize, rows: Range<usize>) -> Self {
        let fine = width * rows.len() * FINE * FINE;
        Self { width, rows, colours: vec![bytes(PAPER); fine], nearness: vec![f32::NEG_INFINITY; fine] }
    }

    /// Draws a triangle where nothing nearer is. Corners: x to the right, y down, z towards the eye; `colour` takes
    /// barycentric coordinates.
    pub fn triangle(&mut self, corners: [DVec3; 3], colour: impl Fn([f64; 3]) -> Colour) {
        let fine = FINE as f64;
        let [a, b, c] = corners.map(|p| p.truncate() * fine);
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let top = self.rows.start * FINE;
        let columns = self.width * FINE;
        let rows = pixels(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), self.rows.end * FINE);
        for y in rows.start.max(top)..rows.end {
            for x in columns_in_row([a, b, c], y, columns) {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let u = (c - b).perp_dot(p - b) / area;
                let v = (a - c).perp_dot(p - c) / area;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let nearness = (corners[0].z * u + corners[1].z * v + corners[2].z * w) as f32;
                let at = (y - top) * columns + x;
                if nearness > self.nearness[at] {
                    self.nearness[at] = nearness;
                    self.colours[at] = bytes(colour([u, v, w]));
                }
            }
        }
    }

    /// The picture's pixels, row by row: each is the mean of the finer ones.
    fn smoothed(&self) -> impl Iterator<Item = Colour> {
        let mean = |x: usize, y: usize| {
            let mut sum = [0_u32; 3];
            for row in y * FINE..(y + 1) * FINE {
                let start = row * self.width * FINE + x * FINE;
                for colour in &self.colours[start..start + FINE] {
                    sum.iter_mut().zip(colour).for_each(|(s, c)| *s += u32::from(*c));
                }
            }
            Colour(sum.map(|s| s as f32 / (FINE * FINE * 255) as f32))
        };
        (0..self.rows.len()).flat_map(move |y| (0..self.width).map(move |x| mean(x, y)))
    }
}

/// The columns that a triangle may cover in a row, at least: a needle covers few of those of its bounding box.
fn columns_in_row([a, b, c]: [DVec2; 3], row: usize, count: usize) -> Range<usize> {
    /// Edges that rise by less are taken whole, as where they cross the row is uncertain.
    const FLAT: f64 = 1e-6;
    let y = row as f64 + 0.5;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        if y < p.y.min(q.y) - FLAT || y > p.y.max(q.y) + FLAT {
            continue;
        }
        let share = ((y - p.y) / (q.y - p.y)).clamp(0.0, 1.0);
        let [from, to] = if (q.y - p.y).abs() < FLAT { [p.x, q.x] } else { [p.x + share * (q.x - p.x); 2] };
        (low, high) = (low.min(from).min(to), high.max(from).max(to));
    }
    pixels(low - 1.0, high + 1.0, count)
}

/// The pixels whose middles lie between two positions.
fn pixels(low: f64, high: f64, count: usize) -> Range<usize> {
    let clamp = |x: f64| x.clamp(0.0, count as f64) as usize;
    clamp((low - 0.5).ceil())..clamp((high + 0.5).floor())
}

/// The picture itself, on which bars and text are drawn.
pub(super) struct Sheet {
    width: usize,
    height: usize,
    pixels: Vec<Colour>,
}

impl Sheet {
    /// A picture of what `draw` puts on each band of it. The finer pixels take memory for one band at a time.
    pub fn new(width: usize, height: usize, draw: impl Fn(&mut Canvas)) -> Self {
        let mut pixels = Vec::with_capacity(width * height);
        for top in (0..height).step_by(BAND) {
            let mut canvas = Canvas::new(width, top..height.min(top + BAND));
            draw(&mut canvas);
            pixels.extend(canvas.smoothed());
        }
        Self { width, height, pixels }
    }

    pub fn rgb(&self) -> Vec<u8> {
        self.pixels.iter().flat_map(|c| bytes(*c)).collect()
    }

    /// Fills a rectangle; pixels that it covers in part are mixed.
    pub fn rectangle(&mut self, low: DVec2, high: DVec2, colour: Colour) {
        let cover = |i: usize, low: f64, high: f64| {
            ((i as f64 + 1.0).min(high) - (i as f64).max(low)).clamp(0.0, 1.0)
        };
        let range = |low: f64, high: f64, count: usize| {
            low.floor().clamp(0.0, count as f64) as usize..high.ceil().clamp(0.0, count as f64) as usize
        };
        for y in range(low.y, high.y, self.height) {
            for x in range(low.x, high.x, self.width) {
                self.mix(x, y, colour, (cover(x, low.x, high.x) * cover(y, low.y, high.y)) as f32);
            }
        }
    }

    /// Writes a line of text with its upper left corner at `at`, `size_px` from line to line.
    pub fn text(&mut self, at: DVec2, text: &str, size_px: f64, colour: Colour) {
        let Some(font) = font() else { return };
        let scaled = font.as_scaled(size_px as f32);
        let baseline = at.y as f32 + scaled.ascent();
        let mut x = at.x as f32;
        for letter in text.chars() {
            let id = scaled.glyph_id(letter);
            let glyph = id.with_scale_and_position(size_px as f32, ab_glyph::point(x, baseline));
            x += scaled.h_advance(id);
            if let Some(outline) = font.outline_glyph(glyph) {
                let corner = outline.px_bounds().min;
                outline.draw(|dx, dy, cover| {
                    let (px, py) = (corner.x + dx as f32, corner.y + dy as f32);
                    if px >= 0.0 && py >= 0.0 {
                        self.mix(px as usize, py as usize, colour, cover);
                    }
                });
            }
        }
    }

    pub fn text_width(&self, text: &str, size_px: f64) -> f64 {
        font().map_or(0.0, |font| {
            let scaled = font.as_scaled(size_px as f32);
            text.chars().map(|letter| f64::from(scaled.h_advance(scaled.glyph_id(letter)))).sum()
        })
    }

    fn mix(&mut self, x: usize, y: usize, colour: Colour, cover: f32) {
        if x < self.width && y < self.height {
            let pixel = &mut self.pixels[y * self.width + x].0;
            let cover = cover.clamp(0.0, 1.0);
            pixel.iter_mut().zip(colour.0).for_each(|(old, new)| *old += (new - *old) * cover);
        }
    }
}

/// The font is part of the program; that it can be read is for the tests to say.
fn font() -> Option<FontRef<'static>> {
    FontRef::try_from_slice(dejavu::sans::regular()).ok()
}

fn bytes(colour: Colour) -> [u8; 3] {
    colour.0.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_font_has_every_letter_that_is_used() {
        let font = font().unwrap();
        for letter in "0123456789.-e ()²°→↑abcdefghijklmnopqrstuvwxyz".chars() {
            assert_ne!(font.glyph_id(letter).0, 0, "{letter}");
        }
    }

    #[test]
    fn the_nearer_triangle_wins_whichever_comes_first() {
        let flat = |z: f64| [DVec3::new(0.0, 0.0, z), DVec3::new(8.0, 0.0, z), DVec3::new(0.0, 8.0, z)];
        let (near, far) = (Colour::new(1.0, 0.0, 0.0), Colour::new(0.0, 0.0, 1.0));
        for order in [[(1.0, near), (0.0, far)], [(0.0, far), (1.0, near)]] {
            let sheet = Sheet::new(8, 8, |canvas| {
                for (z, colour) in order {
                    canvas.triangle(flat(z), |_| colour);
                }
            });
            assert_eq!(sheet.pixels[8 + 1], near);
            assert_eq!(bytes(sheet.pixels[8 * 7 + 7]), bytes(PAPER));
        }
    }

    #[test]
    fn edges_are_mixed_and_half_planes_add_up() {
        // Two triangles that share an edge leave no seam: every fine pixel of the square is drawn.
        let [a, b, c, d] =
            [(1.0, 1.0), (8.0, 1.0), (8.0, 8.0), (1.0, 8.0)].map(|(x, y)| DVec3::new(x, y, 0.0));
        let ink = Colour::new(0.0, 0.0, 0.0);
        let sheet = Sheet::new(9, 9, |canvas| {
            canvas.triangle([a, b, c], |_| ink);
            canvas.triangle([a, c, d], |_| ink);
        });
        assert!((1..8).all(|y| (1..8).all(|x| sheet.pixels[y * 9 + x] == ink)));
        let half = Sheet::new(4, 4, |canvas| {
            canvas.triangle([DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0], |_| ink);
        });
        let [red, ..] = half.pixels[4 + 2].0;
        assert!(red > 0.2 && red < 0.8, "a pixel on the edge is {red}");
    }

    #[test]
    fn bands_and_rows_of_a_triangle_leave_no_gap() {
        // A slanted triangle across three bands: fine pixels whose middles are inside, counted one by one.
        let (width, height) = (40, 2 * BAND + 60);
        let corners = [(3.3, 1.2), (36.1, 300.7), (12.9, 560.4)].map(|(x, y)| DVec3::new(x, y, 0.0));
        let ink = Colour::new(0.0, 0.0, 0.0);
        let sheet = Sheet::new(width, height, |canvas| canvas.triangle(corners, |_| ink));
        let [a, b, c] = corners.map(|p| p.truncate());
        let inside = |p: DVec2| {
            [(a, b), (b, c), (c, a)].iter().all(|(from, to)| (*to - *from).perp_dot(p - *from) >= 0.0)
        };
        let fine = FINE as f64;
        for y in 0..height {
            for x in 0..width {
                let middles = (0..FINE * FINE).map(|k| {
                    DVec2::new((x * FINE + k % FINE) as f64 + 0.5, (y * FINE + k / FINE) as f64 + 0.5) / fine
                });
                let covered = middles.filter(|&p| inside(p)).count() as f32;
                let paper = bytes(PAPER)[0] as f32 / 255.0;
                let expected = paper * (1.0 - covered / (FINE * FINE) as f32);
                assert!((sheet.pixels[y * width + x].0[0] - expected).abs() < 1e-3, "{x} {y}");
            }
        }
    }
}
