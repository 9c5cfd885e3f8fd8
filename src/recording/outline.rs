//! Outlines of regions in images.

use super::sequence::Image;
use glam::DVec2;

/// The outline of a region, in pixels; pixel centres have whole coordinates.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    /// Its points in order, and whether each lies on the image's edge, where the region goes on unseen.
    pub points_px: Vec<(DVec2, bool)>,
    /// Twice the signed area, in pixels²: positive where the region lies inside, negative around a hole.
    pub twice_area: f64,
}

impl Outline {
    /// Whether a point lies inside, by the crossings of a ray.
    pub fn contains(&self, p: DVec2) -> bool {
        let points = &self.points_px;
        let mut inside = false;
        for (k, (b, _)) in points.iter().enumerate() {
            let (a, _) = points[if k == 0 { points.len() - 1 } else { k - 1 }];
            if (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x) {
                inside = !inside;
            }
        }
        inside
    }
}

/// The outlines of all regions at or above a threshold, by marching squares: between two pixel centres the outline lies
/// where a straight line between their values meets the threshold. Regions that touch at a corner are one where the mean
/// of the four pixels reaches the threshold.
pub(super) fn outlines(image: &Image, threshold: f32) -> Vec<Outline> {
    let (width, height) = (image.width, image.height);
    // With a margin of pixels that are in no region.
    let value = |i: usize, j: usize| match (1..=width).contains(&i) && (1..=height).contains(&j) {
        true => image.pixels[(j - 1) * width + i - 1],
        false => f32::NEG_INFINITY,
    };
    let is_in = |i: usize, j: usize| value(i, j) >= threshold;
    // Edges between neighbours, horizontal ones even.
    let row = width + 2;
    let mut segments: Vec<(usize, usize)> = Vec::new();
    for j in 0..=height {
        for i in 0..=width {
            let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
            let inside = corners.map(|(i, j)| is_in(i, j));
            if inside == [true; 4] || inside == [false; 4] {
                continue;
            }
            let edges = [
                2 * (j * row + i),
                2 * (j * row + i + 1) + 1,
                2 * ((j + 1) * row + i),
                2 * (j * row + i) + 1,
            ];
            let leaves = |k: usize| inside[k] && !inside[(k + 1) % 4];
            let joined = || {
                let mean = corners.map(|(i, j)| value(i, j)).iter().sum::<f32>() / 4.0;
                mean >= threshold
            };
            let is_saddle = inside[0] == inside[2] && inside[1] == inside[3];
            for k in (0..4).filter(|&k| leaves(k)) {
                // From where the region is left to where it is entered: about a single corner, or to the only other edge.
                let enters = |k: usize| !inside[k] && inside[(k + 1) % 4];
                let end = match is_saddle {
                    true if joined() => (k + 1) % 4,
                    true => (k + 3) % 4,
                    false => (0..4).find(|&k| enters(k)).unwrap_or(k),
                };
                segments.push((edges[k], edges[end]));
            }
        }
    }
    segments.sort_unstable();
    let point = |edge: usize| {
        let (i, j) = (edge / 2 % row, edge / 2 / row);
        let (k, l) = if edge.is_multiple_of(2) { (i + 1, j) } else { (i, j + 1) };
        let (a, b) = (value(i, j), value(k, l));
        let at = |i: usize, j: usize| DVec2::new(i as f64 - 1.0, j as f64 - 1.0);
        match a.is_finite() && b.is_finite() {
            true => {
                let share =
                    ((f64::from(threshold) - f64::from(a)) / (f64::from(b) - f64::from(a))).clamp(0.0, 1.0);
                (at(i, j).lerp(at(k, l), share), false)
            }
            // At the margin, or beside a pixel that is no number.
            false => (if is_in(i, j) { at(i, j) } else { at(k, l) }, true),
        }
    };
    let mut found = Vec::new();
    let mut taken = vec![false; segments.len()];
    for start in 0..segments.len() {
        let mut at = start;
        let mut points_px = Vec::new();
        while !taken[at] {
            taken[at] = true;
            points_px.push(point(segments[at].0));
            let Ok(next) = segments.binary_search_by_key(&segments[at].1, |segment| segment.0) else { break };
            at = next;
        }
        if points_px.len() < 3 {
            continue;
        }
        let pairs = points_px.iter().zip(points_px.iter().cycle().skip(1));
        let twice_area = pairs.map(|((a, _), (b, _))| a.perp_dot(*b)).sum();
        found.push(Outline { points_px, twice_area });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rows: &[&[f32]]) -> Image {
        Image::new(rows[0].len(), rows.len(), rows.concat()).unwrap()
    }

    #[test]
    fn a_disc_of_smooth_values_is_outlined_to_a_hundredth_of_a_pixel() {
        let centre = DVec2::new(20.3, 18.7);
        let pixels = (0..40 * 40).map(|k| {
            let p = DVec2::new(f64::from(k % 40), f64::from(k / 40));
            (20.0 - p.distance(centre)) as f32
        });
        let image = Image::new(40, 40, pixels.collect()).unwrap();
        let found = outlines(&image, 10.0);
        assert_eq!(found.len(), 1);
        let worst = found[0].points_px.iter().map(|(p, _)| (p.distance(centre) - 10.0).abs());
        assert!(worst.fold(0.0, f64::max) < 0.013);
        let area = std::f64::consts::PI * 100.0;
        // The points lie up to 0.013 pixels inside, and chords of a pixel 0.0125: of a radius of 10, twice.
        assert!((found[0].twice_area / 2.0 / area - 1.0).abs() < 2.0 * (0.013 + 0.0125) / 10.0);
        assert!(found[0].contains(centre) && !found[0].contains(DVec2::new(31.0, 18.0)));
    }

    #[test]
    fn a_hole_runs_the_other_way() {
        let found = outlines(&image(&[&[1.0; 5], &[1.0, 0.0, 0.0, 0.0, 1.0], &[1.0; 5]]), 0.5);
        let mut areas: Vec<f64> = found.iter().map(|outline| outline.twice_area).collect();
        areas.sort_by(f64::total_cmp);
        // The margin is not seen: there the outline runs through the centres of the outermost pixels.
        assert_eq!((areas.len(), areas[1]), (2, 16.0));
        assert!(areas[0] < 0.0);
        assert!(
            found
                .iter()
                .all(|outline| outline.points_px.iter().all(|(_, cut)| *cut == (outline.twice_area > 0.0)))
        );
    }

    #[test]
    fn corners_that_touch_are_joined_where_their_mean_is_high() {
        let saddle = |high: f32| {
            let rows: [[f32; 4]; 4] = [[0.0; 4], [0.0, high, 0.0, 0.0], [0.0, 0.0, high, 0.0], [0.0; 4]];
            outlines(&Image::new(4, 4, rows.concat()).unwrap(), 0.5).len()
        };
        assert_eq!((saddle(0.9), saddle(1.0), saddle(1.1)), (2, 1, 1));
    }

    #[test]
    fn nothing_has_no_outline() {
        assert!(outlines(&image(&[&[0.0, 0.0], &[0.0, f32::NAN]]), 0.5).is_empty());
        assert_eq!(outlines(&image(&[&[1.0]]), 0.5).len(), 1);
    }
}
