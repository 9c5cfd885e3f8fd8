//! Pixels: a z-buffer for triangles, then rectangles and text.

use ab_glyph::{Font, FontRef, ScaleFont};
use glam::{DVec2, DVec3};

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

/// Pixels along each side of one pixel of the picture, for smooth edges.
const FINE: usize = 3;

/// Where a mesh is drawn: finer than the picture by [`FINE`], positions in the picture's pixels.
pub(super) struct Canvas {
    width: usize,
    height: usize,
    colours: Vec<[u8; 3]>,
    nearness: Vec<f32>,
}

impl Canvas {
    pub fn new(width: usize, height: usize) -> Self {
        let fine = width * height * FINE * FINE;
        Self { width, height, colours: vec![bytes(PAPER); fine], nearness: vec![f32::NEG_INFINITY; fine] }
    }

    pub fn size(&self) -> DVec2 {
        DVec2::new(self.width as f64, self.height as f64)
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
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let columns = pixels(low.x, high.x, self.width * FINE);
        for y in pixels(low.y, high.y, self.height * FINE) {
            for x in columns.clone() {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let u = (c - b).perp_dot(p - b) / area;
                let v = (a - c).perp_dot(p - c) / area;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let nearness = (corners[0].z * u + corners[1].z * v + corners[2].z * w) as f32;
                let at = y * self.width * FINE + x;
                if nearness > self.nearness[at] {
                    self.nearness[at] = nearness;
                    self.colours[at] = bytes(colour([u, v, w]));
                }
            }
        }
    }

    /// The picture: each of its pixels is the mean of the finer ones.
    pub fn smoothed(&self) -> Sheet {
        let mut pixels = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let mut sum = [0_u32; 3];
                for row in y * FINE..(y + 1) * FINE {
                    let start = row * self.width * FINE + x * FINE;
                    for colour in &self.colours[start..start + FINE] {
                        sum.iter_mut().zip(colour).for_each(|(s, c)| *s += u32::from(*c));
                    }
                }
                let n = (FINE * FINE * 255) as f32;
                pixels.push(Colour(sum.map(|s| s as f32 / n)));
            }
        }
        Sheet { width: self.width, height: self.height, pixels }
    }
}

/// The pixels whose middles lie between two positions.
fn pixels(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
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
            let mut canvas = Canvas::new(8, 8);
            for (z, colour) in order {
                canvas.triangle(flat(z), |_| colour);
            }
            let sheet = canvas.smoothed();
            assert_eq!(sheet.pixels[8 + 1], near);
            assert_eq!(bytes(sheet.pixels[8 * 7 + 7]), bytes(PAPER));
        }
    }

    #[test]
    fn edges_are_mixed_and_half_planes_add_up() {
        // Two triangles that share an edge leave no seam: every fine pixel of the square is drawn.
        let mut canvas = Canvas::new(9, 9);
        let [a, b, c, d] =
            [(1.0, 1.0), (8.0, 1.0), (8.0, 8.0), (1.0, 8.0)].map(|(x, y)| DVec3::new(x, y, 0.0));
        let ink = Colour::new(0.0, 0.0, 0.0);
        canvas.triangle([a, b, c], |_| ink);
        canvas.triangle([a, c, d], |_| ink);
        let sheet = canvas.smoothed();
        assert!((1..8).all(|y| (1..8).all(|x| sheet.pixels[y * 9 + x] == ink)));
        let mut half = Canvas::new(4, 4);
        half.triangle([DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0], |_| ink);
        let [red, ..] = half.smoothed().pixels[4 + 2].0;
        assert!(red > 0.2 && red < 0.8, "a pixel on the edge is {red}");
    }
}
