//! Lengths along a polyline, points at given lengths, and the nearest place on it.

use glam::DVec3;

/// Length of a polyline up to each of its points; the first is 0.
pub(crate) fn lengths(points: &[DVec3]) -> Vec<f64> {
    let mut lengths = vec![0.0; points.len()];
    for i in 1..points.len() {
        lengths[i] = lengths[i - 1] + points[i].distance(points[i - 1]);
    }
    lengths
}

/// The point at a length from the start; beyond an end, that end. `lengths` are those of [`lengths`], for at least
/// two points.
pub(crate) fn point_at(points: &[DVec3], lengths: &[f64], length: f64) -> DVec3 {
    let after = lengths.partition_point(|&l| l <= length).clamp(1, points.len() - 1);
    within(points, lengths, after - 1, length)
}

/// The point at a length from the start that lies in the given segment, or else that segment's nearer end.
fn within(points: &[DVec3], lengths: &[f64], segment: usize, length: f64) -> DVec3 {
    let span = lengths[segment + 1] - lengths[segment];
    let share = if span > 0.0 { (length - lengths[segment]) / span } else { 0.0 };
    points[segment].lerp(points[segment + 1], share.clamp(0.0, 1.0))
}

/// Points at equal steps of a polyline's length, about `step` apart and at least three, both ends among them.
pub(crate) fn resampled(points: &[DVec3], step: f64) -> Vec<DVec3> {
    let lengths = lengths(points);
    let total = lengths[lengths.len() - 1];
    let count = ((total / step).ceil() as usize).max(2);
    let mut segment = 0;
    (0..=count)
        .map(|i| {
            let length = total * i as f64 / count as f64;
            // Not `point_at`: where points coincide, it would take the last of them instead of the first.
            while segment + 2 < points.len() && lengths[segment + 1] < length {
                segment += 1;
            }
            within(points, &lengths, segment, length)
        })
        .collect()
}

/// The segment of a polyline that is nearest to a point, and where on it: 0 at its start, 1 at its end. The end
/// segments are prolonged. `None` where no distance is finite.
pub(crate) fn nearest(points: &[DVec3], point: DVec3) -> Option<(usize, f64)> {
    let last = points.len() - 2;
    let (mut least, mut nearest) = (f64::INFINITY, None);
    for (segment, pair) in points.windows(2).enumerate() {
        let along = pair[1] - pair[0];
        let low = if segment == 0 { f64::NEG_INFINITY } else { 0.0 };
        let high = if segment == last { f64::INFINITY } else { 1.0 };
        let share =
            ((point - pair[0]).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(low, high);
        let distance = point.distance_squared(pair[0] + along * share);
        if distance < least {
            least = distance;
            nearest = Some((segment, share));
        }
    }
    nearest
}

/// Length from the start of a polyline to the place on it that is [`nearest`] to a point; 0 where there is none.
pub(crate) fn station(points: &[DVec3], lengths: &[f64], point: DVec3) -> f64 {
    nearest(points, point).map_or(0.0, |(segment, share)| {
        lengths[segment] + share * (points[segment + 1] - points[segment]).length()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNER: [DVec3; 3] = [DVec3::ZERO, DVec3::new(3.0, 0.0, 0.0), DVec3::new(3.0, 5.0, 0.0)];

    #[test]
    fn points_lie_at_their_lengths() {
        let lengths = lengths(&CORNER);
        assert_eq!(lengths, [0.0, 3.0, 8.0]);
        for (length, expected) in
            [(-1.0, CORNER[0]), (1.5, DVec3::X * 1.5), (3.0, CORNER[1]), (5.5, DVec3::new(3.0, 2.5, 0.0))]
        {
            assert_eq!(point_at(&CORNER, &lengths, length), expected);
        }
        assert_eq!(point_at(&CORNER, &lengths, 9.0), CORNER[2]);
    }

    #[test]
    fn equal_steps_keep_both_ends() {
        let points = resampled(&CORNER, 1.1);
        assert_eq!((points.len(), points[0], points[3], points[8]), (9, CORNER[0], CORNER[1], CORNER[2]));
        assert_eq!(resampled(&CORNER[..2], 100.0).len(), 3);
        assert_eq!(resampled(&[DVec3::X; 3], 1.0), [DVec3::X; 3]);
    }

    #[test]
    fn the_nearest_place_may_lie_beyond_an_end() {
        let lengths = lengths(&CORNER);
        let station = |x, y| station(&CORNER, &lengths, DVec3::new(x, y, 1.0));
        assert_eq!((station(1.0, 0.2), station(2.9, 4.0)), (1.0, 7.0));
        assert_eq!((station(-2.0, 0.0), station(3.0, 6.5)), (-2.0, 9.5));
        // The outer side of the corner.
        assert_eq!(station(4.0, -1.0), 3.0);
        assert_eq!(nearest(&CORNER, DVec3::NAN), None);
    }
}
