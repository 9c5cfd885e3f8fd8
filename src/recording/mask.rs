//! Contours from images of the lumen.

use super::outline::{Outline, outlines};
use super::sequence::{Image, Sequence};
use super::{Frame, ReadOptions, Recording};
use crate::geometry::Pose;
use crate::{Error, Result};
use glam::{DMat3, DMat4, DVec2, DVec3};
use std::path::Path;

/// A recording whose contours are outlines of images: masks, or probabilities as a network gives them.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Masks {
    /// The frames that have a pose, with their numbers in the file. One whose image shows no lumen has no contour.
    pub recording: Recording,
    /// Pixels at or above it are lumen.
    pub threshold: f64,
    /// Frames without a pose, which are left out.
    pub without_pose: usize,
    /// Frames whose image has no pixel at the threshold.
    pub empty: usize,
    /// Frames in which the probe lies in no region.
    pub probe_outside: usize,
    /// Frames whose outline the image's edge cuts: there it has no echoes.
    pub cut: usize,
    /// Frames without an image.
    pub without_image: usize,
    /// Whether the images' plane is not the probe's: then poses are those of the image, and no longer of the probe.
    pub tilted: bool,
}

/// How [`Masks`] are read.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MaskOptions {
    /// Pixels at or above it are lumen; without one, half of the largest pixel of all images.
    pub threshold: Option<f64>,
    /// Points of a contour, at equal distances along it.
    pub points: usize,
    /// Width and height of a pixel, mm, where no transform `ImageToProbe` gives them.
    pub pixel_mm: Option<[f64; 2]>,
    /// Where the probe lies in the image, in pixels from the centre of the first; without one, where `ImageToProbe` has it, or
    /// in the middle.
    pub centre_px: Option<[f64; 2]>,
    /// Takes the largest region where none contains the probe.
    pub largest: bool,
}

impl Default for MaskOptions {
    fn default() -> Self {
        Self { threshold: None, points: 128, pixel_mm: None, centre_px: None, largest: false }
    }
}

crate::setters::setters!(MaskOptions {
    with_threshold => threshold: Option<f64>,
    with_points => points: usize,
    with_pixel_mm => pixel_mm: Option<[f64; 2]>,
    with_centre_px => centre_px: Option<[f64; 2]>,
    with_largest => largest: bool,
});

/// The contour in one image.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MaskContour {
    /// Points in the contour's plane, mm, counter-clockwise from the direction of x; none where the image shows no lumen. NaN:
    /// there the image's edge cuts the outline.
    pub contour_mm: Vec<DVec2>,
    /// The plane of the contour in the probe's coordinates: the identity, but where the image's plane is tilted.
    pub probe_from_plane: Pose,
    /// Whether it was found.
    pub found: MaskFound,
}

/// What an image shows of the lumen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaskFound {
    /// All of its outline.
    Whole,
    /// An outline that the image's edge cuts.
    Cut,
    /// Nothing: no pixel is at the threshold.
    Empty,
    /// Regions, but the probe lies in none of them.
    ProbeOutside,
}

impl MaskOptions {
    /// The contour in one image whose directions are those of the transform `ImageToProbe`, which takes pixels to mm; where the
    /// options have the size of a pixel, that counts in its place. Pixels at or above `threshold` are lumen, whatever the
    /// options' own.
    ///
    /// # Errors
    /// Where an option makes no sense, or the transform makes no rectangles of pixels.
    pub fn contour_of(&self, image: &Image, threshold: f64, probe_from_image: &DMat4) -> Result<MaskContour> {
        self.check()?;
        self.oriented_contour(image, threshold, Orientation::of(""), probe_from_image)
    }

    /// The outline of the region about the probe, at equal distances.
    fn oriented_contour(
        &self,
        image: &Image,
        threshold: f64,
        orientation: Orientation,
        probe_from_image: &DMat4,
    ) -> Result<MaskContour> {
        let size = [image.width, image.height];
        let [width, height] = orientation.size(size);
        let middle = DVec2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
        let placed = match self.pixel_mm {
            Some(pixel_mm) => Placed::of_pixels(pixel_mm, self.centre_px.map_or(middle, DVec2::from_array)),
            None => Placed::of(probe_from_image)?,
        };
        let probe_mm = match self.centre_px {
            Some(centre) => placed.mm(DVec2::from_array(centre)),
            None => DVec2::ZERO,
        };
        let contour =
            |found, contour_mm| MaskContour { contour_mm, probe_from_plane: placed.probe_from_plane, found };
        // Only where the lumen lies inside: an outline about a hole runs the other way.
        let mut regions: Vec<Outline> =
            outlines(image, threshold as f32).into_iter().filter(|o| o.twice_area > 0.0).collect();
        if regions.is_empty() {
            return Ok(contour(MaskFound::Empty, Vec::new()));
        }
        for (point, _) in regions.iter_mut().flat_map(|outline| &mut outline.points_px) {
            *point = placed.mm(orientation.marked_far(*point, size));
        }
        let area = |outline: &Outline| outline.twice_area;
        let about = regions
            .iter()
            .filter(|outline| outline.contains(probe_mm))
            .min_by(|a, b| area(a).total_cmp(&area(b)));
        let Some(outline) = about.or_else(|| {
            let largest = regions.iter().max_by(|a, b| area(a).total_cmp(&area(b)));
            largest.filter(|_| self.largest)
        }) else {
            return Ok(contour(MaskFound::ProbeOutside, Vec::new()));
        };
        let points = spaced(&outline.points_px, probe_mm, self.points);
        let is_cut = points.iter().any(|p| p.is_nan());
        Ok(contour(if is_cut { MaskFound::Cut } else { MaskFound::Whole }, points))
    }

    pub(crate) fn check(&self) -> Result<()> {
        if !(3..=100_000).contains(&self.points) {
            return Err(Error::setting("points", self.points, "3 to 100000"));
        }
        if let Some(size) = self.pixel_mm.filter(|size| !size.iter().all(|s| s.is_finite() && *s > 0.0)) {
            return Err(Error::setting("pixel size", format!("{size:?}"), "two lengths above 0 in mm"));
        }
        if let Some(centre) = self.centre_px.filter(|centre| !centre.iter().all(|c| c.is_finite())) {
            return Err(Error::setting("centre", format!("{centre:?}"), "two finite numbers"));
        }
        Ok(())
    }
}

/// Directions of an image's rows and columns in its file, and the way to the directions that `ImageToProbe` is about: those
/// of PLUS's orientation MF, with x to the marked side and y away from the transducer.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Orientation {
    /// Rows run along y.
    transposed: bool,
    flip_x: bool,
    flip_y: bool,
}

impl Orientation {
    /// By PLUS's code: M or U (marked, unmarked) and F or N (far, near), in the order of rows and columns. What is no code, such
    /// as `XX`, is taken as MF.
    fn of(code: &str) -> Self {
        let letters: Vec<char> = code.chars().take(2).collect();
        let is_code = letters.len() == 2 && code.len() <= 3;
        let (transposed, x, y) = match letters[..] {
            [x @ ('M' | 'U'), y @ ('F' | 'N')] if is_code => (false, x, y),
            [y @ ('F' | 'N'), x @ ('M' | 'U')] if is_code => (true, x, y),
            _ => (false, 'M', 'F'),
        };
        Self { transposed, flip_x: x == 'U', flip_y: y == 'N' }
    }

    /// Pixel coordinates in the directions MF of pixel coordinates in the file.
    fn marked_far(self, p: DVec2, image: [usize; 2]) -> DVec2 {
        let last = self.size(image).map(|size| size as f64 - 1.0);
        let mut p = if self.transposed { DVec2::new(p.y, p.x) } else { p };
        if self.flip_x {
            p.x = last[0] - p.x;
        }
        if self.flip_y {
            p.y = last[1] - p.y;
        }
        p
    }

    /// Width and height in the directions MF.
    fn size(self, [width, height]: [usize; 2]) -> [usize; 2] {
        if self.transposed { [height, width] } else { [width, height] }
    }
}

/// Where an image lies.
#[derive(Debug, Clone, Copy)]
struct Placed {
    /// The frame of the contour: of the probe, or of the image where that is tilted.
    probe_from_plane: Pose,
    /// Millimetres in that plane, about the probe, of pixels.
    x_axis_mm: DVec2,
    y_axis_mm: DVec2,
    origin_mm: DVec2,
}

impl Placed {
    /// From `ImageToProbe`.
    ///
    /// # Errors
    /// [`Error::Recording`] where pixels are no rectangles.
    fn of(probe_from_image: &DMat4) -> Result<Self> {
        let axis = |column: usize| probe_from_image.col(column).truncate();
        let (x, y, origin) = (axis(0), axis(1), axis(3));
        let (sx, sy) = (x.length(), y.length());
        let is_sound = sx > 0.0 && sy > 0.0 && (sx + sy + origin.length()).is_finite();
        if !is_sound || (x.dot(y) / (sx * sy)).abs() > 0.01 {
            return Err(Error::Recording {
                field: "ImageToProbe",
                found: format!("columns {x:.4} and {y:.4}"),
                expected: "two perpendicular axes of a pixel, in mm".into(),
            });
        }
        // Within a thousandth of a pixel over an image of a thousand.
        let flat = 1e-6;
        if (x.z / sx).abs() < flat && (y.z / sy).abs() < flat && origin.z.abs() < 1e-6 {
            let [x, y, origin] = [x, y, origin].map(|axis| axis.truncate());
            return Ok(Self {
                probe_from_plane: Pose::IDENTITY,
                x_axis_mm: x,
                y_axis_mm: y,
                origin_mm: origin,
            });
        }
        let z = x.cross(y).normalize();
        let rotation = DMat3::from_cols(x / sx, z.cross(x / sx), z);
        // The point of the plane that is nearest to the probe.
        let translation_mm = z * z.dot(origin);
        let in_plane = |p: DVec3| (rotation.transpose() * p).truncate();
        Ok(Self {
            probe_from_plane: Pose { rotation, translation_mm },
            x_axis_mm: in_plane(x),
            y_axis_mm: in_plane(y),
            origin_mm: in_plane(origin - translation_mm),
        })
    }

    fn of_pixels([sx, sy]: [f64; 2], centre_px: DVec2) -> Self {
        Self {
            probe_from_plane: Pose::IDENTITY,
            x_axis_mm: DVec2::new(sx, 0.0),
            y_axis_mm: DVec2::new(0.0, sy),
            origin_mm: -centre_px * DVec2::new(sx, sy),
        }
    }

    fn mm(&self, p: DVec2) -> DVec2 {
        self.origin_mm + self.x_axis_mm * p.x + self.y_axis_mm * p.y
    }
}

impl Masks {
    /// Reads the images of a sequence file as masks. Poses are those of [`Sequence::recording`]; `ImageToProbe` comes from the
    /// file, from the options' PLUS configuration, or from the size of a pixel.
    ///
    /// # Errors
    /// Where the file cannot be read, has no images of one channel, or neither source says where they lie; and where no
    /// frame has both a pose and a contour.
    pub fn read(path: &Path, reading: &ReadOptions, options: &MaskOptions) -> Result<Self> {
        options.check()?;
        if reading.contours.is_some() {
            return Err(Error::setting("contours", "a CSV file", "none: the images give the contours"));
        }
        let sequence = Sequence::read(path)?;
        let mut frames = sequence.poses(reading)?.frames;
        let count = frames.len();
        let threshold = match options.threshold {
            Some(threshold) => threshold,
            None => half_of_the_largest(path, &sequence)?,
        };
        let matrices = match options.pixel_mm {
            Some(_) => Vec::new(),
            None => sequence.matrices("ImageToProbe", reading).map_err(|error| match error {
                Error::Input { path, .. } => {
                    let expected = "a transform ImageToProbe in the file or in a PLUS configuration \
                        (--plus-config), or the size of a pixel (--pixel-size)";
                    Error::input(&path, "place of the images", "none", expected)
                }
                other => other,
            })?,
        };
        let orientation =
            Orientation::of(&sequence.contents().images.map(|i| i.orientation).unwrap_or_default());
        let mut masks = Self {
            recording: Recording::default(),
            threshold,
            without_pose: 0,
            empty: 0,
            probe_outside: 0,
            cut: 0,
            without_image: 0,
            tilted: false,
        };
        let mut has_image = vec![false; count];
        for image in sequence.images()? {
            let (place, image) = image?;
            has_image[place] = true;
            let matrix = matrices.get(place).copied().flatten();
            let frame = &mut frames[place];
            // Where the image lies is as unknown as where the probe lies.
            if options.pixel_mm.is_none() && matrix.is_none() {
                frame.world_from_sensor = Pose::LOST;
                continue;
            }
            let number = frame.number.unwrap_or(place);
            let contour = options
                .oriented_contour(&image, threshold, orientation, &matrix.unwrap_or_default())
                .map_err(|e| e.in_frame_of(path, number))?;
            masks.tilted |= contour.probe_from_plane != Pose::IDENTITY;
            masks.count(contour.found);
            frame.world_from_sensor = frame.world_from_sensor * contour.probe_from_plane;
            frame.contour_mm = contour.contour_mm;
        }
        masks.without_image = has_image.iter().filter(|has| !**has).count();
        for (k, frame) in frames.iter_mut().enumerate() {
            // Frames that are left out leave gaps.
            frame.number.get_or_insert(k);
        }
        let is_lost = |frame: &Frame| frame.world_from_sensor.translation_mm.is_nan();
        masks.without_pose = frames.iter().filter(|frame| is_lost(frame)).count();
        frames.retain(|frame| !is_lost(frame));
        if frames.iter().all(|frame| frame.contour_mm.is_empty()) {
            let found = format!(
                "none in {count} frames: {} without a pose, {} without a pixel at the threshold {threshold}, {} with the \
                 probe in no region",
                masks.without_pose, masks.empty, masks.probe_outside
            );
            return Err(Error::input(path, "contours", found, "a region about the probe in some frame"));
        }
        masks.recording.frames = frames;
        Ok(masks)
    }

    fn count(&mut self, found: MaskFound) {
        match found {
            MaskFound::Whole => {}
            MaskFound::Cut => self.cut += 1,
            MaskFound::Empty => self.empty += 1,
            MaskFound::ProbeOutside => self.probe_outside += 1,
        }
    }
}

/// Points at equal distances along a closed line, counter-clockwise from where it lies in the direction of x from a centre;
/// NaN on the parts between points that are cut.
fn spaced(points: &[(DVec2, bool)], centre: DVec2, count: usize) -> Vec<DVec2> {
    let angle = |p: DVec2| (p - centre).to_angle().abs();
    let start =
        (0..points.len()).min_by(|&a, &b| angle(points[a].0).total_cmp(&angle(points[b].0))).unwrap_or(0);
    let mut line: Vec<(DVec2, bool)> = points[start..].iter().chain(&points[..=start]).copied().collect();
    let twice_area: f64 = line.windows(2).map(|pair| (pair[0].0 - centre).perp_dot(pair[1].0 - centre)).sum();
    if twice_area < 0.0 {
        line.reverse();
    }
    let length: f64 = line.windows(2).map(|pair| pair[0].0.distance(pair[1].0)).sum();
    let (mut k, mut before) = (0, 0.0);
    let mut spaced = Vec::with_capacity(count);
    for j in 0..count {
        let at = length * j as f64 / count as f64;
        while k + 2 < line.len() && before + line[k].0.distance(line[k + 1].0) < at {
            before += line[k].0.distance(line[k + 1].0);
            k += 1;
        }
        let [(a, cut_a), (b, cut_b)] = [line[k], line[k + 1]];
        let step = a.distance(b);
        let share = if step > 0.0 { ((at - before) / step).clamp(0.0, 1.0) } else { 0.0 };
        spaced.push(if cut_a || cut_b { DVec2::NAN } else { a.lerp(b, share) });
    }
    spaced
}

/// Half of the largest pixel of all images.
fn half_of_the_largest(path: &Path, sequence: &Sequence) -> Result<f64> {
    let mut largest = 0.0_f32;
    for image in sequence.images()? {
        largest = image?.1.pixels.iter().copied().filter(|p| p.is_finite()).fold(largest, f32::max);
    }
    match largest > 0.0 {
        true => Ok(f64::from(largest) / 2.0),
        false => Err(Error::input(path, "images", "no pixel above 0", "masks of the lumen")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientation_codes_lead_to_marked_and_far() {
        let p = DVec2::new(1.0, 2.0);
        for (code, expected) in [
            ("MF", [1.0, 2.0]),
            ("MFA", [1.0, 2.0]),
            ("UF", [8.0, 2.0]),
            ("UN", [8.0, 3.0]),
            ("MN", [1.0, 3.0]),
            ("FM", [2.0, 1.0]),
            ("NU", [3.0, 8.0]),
            ("XX", [1.0, 2.0]),
            ("", [1.0, 2.0]),
            ("UNKNOWN", [1.0, 2.0]),
            ("BRIGHTNESSBRIGHTNESS", [1.0, 2.0]),
        ] {
            let size = [10, 6];
            let found = Orientation::of(code).marked_far(p, size);
            // Transposed, a row of the file runs along y: 10 pixels of y and 6 of x.
            assert_eq!(found, DVec2::from_array(expected), "{code}");
        }
    }

    #[test]
    fn an_image_lies_in_the_world_where_its_transform_says() {
        let tilted = DMat4::from_rotation_x(0.3)
            * DMat4::from_translation(DVec3::new(-5.0, -4.0, 2.0))
            * DMat4::from_scale(DVec3::new(0.05, 0.08, 1.0));
        let flat = DMat4::from_translation(DVec3::new(-5.0, 4.0, 0.0))
            * DMat4::from_scale(DVec3::new(0.05, -0.08, 1.0));
        for (matrix, is_tilted) in [(tilted, true), (flat, false)] {
            let placed = Placed::of(&matrix).unwrap();
            assert_eq!(placed.probe_from_plane != Pose::IDENTITY, is_tilted);
            for p in [DVec2::ZERO, DVec2::new(30.0, 7.0), DVec2::new(100.0, 200.0)] {
                let expected = matrix.transform_point3(p.extend(0.0));
                let found = placed.probe_from_plane.transform_point(placed.mm(p).extend(0.0));
                assert!(found.distance(expected) < 1e-9, "{found} {expected}");
            }
        }
        assert!(Placed::of(&DMat4::ZERO).is_err());
        let sheared = DMat4::from_cols_array_2d(&[
            [1.0, 0.0, 0.0, 0.0],
            [0.5, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]);
        assert!(Placed::of(&sheared).is_err());
    }
}
