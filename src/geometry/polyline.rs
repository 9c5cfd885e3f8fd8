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
    nearest_of(points, 0..points.len() - 1, point, true).map(|(segment, share, _)| (segment, share))
}

/// The first of the nearest of some segments, where on it, and the squared distance.
fn nearest_of(
    points: &[DVec3],
    segments: impl Iterator<Item = usize>,
    point: DVec3,
    is_prolonged: bool,
) -> Option<(usize, f64, f64)> {
    let last = points.len() - 2;
    let (mut least, mut nearest) = (f64::INFINITY, None);
    for segment in segments {
        let (start, along) = (points[segment], points[segment + 1] - points[segment]);
        let low = if is_prolonged && segment == 0 { f64::NEG_INFINITY } else { 0.0 };
        let high = if is_prolonged && segment == last { f64::INFINITY } else { 1.0 };
        let share =
            ((point - start).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(low, high);
        let squared = point.distance_squared(start + along * share);
        if squared < least {
            least = squared;
            nearest = Some((segment, share, squared));
        }
    }
    nearest
}

/// A polyline that is searched again and again: the same answers as from a search of all segments, from those few that may be the
/// nearest.
pub(crate) struct Searched<'a> {
    points: &'a [DVec3],
    /// A ball about each run of [`RUN`] segments: its centre and radius.
    balls: Vec<(DVec3, f64)>,
}

/// Segments in a run.
const RUN: usize = 16;
/// Factor by which bounds are too wide, for rounding.
const SLACK: f64 = 1.0 + 1e-9;

impl<'a> Searched<'a> {
    /// Of at least one point; without a second one, that is the nearest.
    pub(crate) fn of(points: &'a [DVec3]) -> Self {
        let ball = |run: usize| {
            let of = &points[run * RUN..points.len().min((run + 1) * RUN + 1)];
            let (low, high) = (of.iter().copied().reduce(DVec3::min), of.iter().copied().reduce(DVec3::max));
            let centre = low.unwrap_or(DVec3::NAN).midpoint(high.unwrap_or(DVec3::NAN));
            (centre, of.iter().map(|p| p.distance(centre)).fold(0.0, f64::max))
        };
        Self { points, balls: (0..(points.len() - 1).div_ceil(RUN)).map(ball).collect() }
    }

    /// The runs that may have what is nearest to a point, in order.
    fn runs(&self, point: DVec3) -> impl Iterator<Item = usize> + '_ {
        let most = self.balls.iter().map(|(centre, radius)| point.distance(*centre) + radius);
        let most = most.fold(f64::INFINITY, f64::min) * SLACK;
        let is_near = move |run: &usize| {
            let (centre, radius) = self.balls[*run];
            let distance = point.distance(centre);
            // A point that is not finite is near everything.
            distance.is_nan() || distance <= (most + radius) * SLACK
        };
        (0..self.balls.len()).filter(is_near)
    }

    fn segments(&self, run: usize) -> std::ops::Range<usize> {
        run * RUN..(self.points.len() - 1).min((run + 1) * RUN)
    }

    /// As the function [`nearest`], for at least two points.
    pub(crate) fn nearest(&self, point: DVec3) -> Option<(usize, f64)> {
        let (last, mut is_last) = (self.points.len() - 2, false);
        // The end segments may be nearest however far away they are.
        let near = self.runs(point).flat_map(|run| self.segments(run)).filter(|&segment| segment > 0);
        let segments = std::iter::once(0).chain(near).inspect(|&segment| is_last |= segment == last);
        let found = nearest_of(self.points, segments, point, true);
        let end = || nearest_of(self.points, last..last + 1, point, true);
        let better = |a: (usize, f64, f64), b: (usize, f64, f64)| if b.2 < a.2 { b } else { a };
        let found = match (found, is_last) {
            (Some(found), false) => end().map_or(Some(found), |end| Some(better(found, end))),
            (found, _) => found,
        };
        found.map(|(segment, share, _)| (segment, share))
    }

    /// The place that is nearest to a point, no end prolonged: the segment, where on it, and the distance.
    pub(crate) fn nearest_within(&self, point: DVec3) -> Option<(usize, f64, f64)> {
        if let [only] = self.points {
            return Some((0, 0.0, only.distance(point)));
        }
        let segments = self.runs(point).flat_map(|run| self.segments(run));
        nearest_of(self.points, segments, point, false)
            .map(|(segment, share, squared)| (segment, share, squared.sqrt()))
    }

    /// The first of the points that are nearest to another one.
    pub(crate) fn nearest_point(&self, point: DVec3) -> usize {
        let near = self.runs(point).flat_map(|run| {
            let segments = self.segments(run);
            segments.start..segments.end + 1
        });
        let squared = |k: usize| self.points[k].distance_squared(point);
        let nearer = |best: (usize, f64), k: usize| if squared(k) < best.1 { (k, squared(k)) } else { best };
        near.fold((0, f64::INFINITY), nearer).0
    }
}

/// Length from the start of a polyline to a place on it, as [`nearest`] gives it; 0 without one.
pub(crate) fn station(points: &[DVec3], lengths: &[f64], place: Option<(usize, f64)>) -> f64 {
    place.map_or(0.0, |(segment, share)| {
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
        let station = |x, y| station(&CORNER, &lengths, nearest(&CORNER, DVec3::new(x, y, 1.0)));
        assert_eq!((station(1.0, 0.2), station(2.9, 4.0)), (1.0, 7.0));
        assert_eq!((station(-2.0, 0.0), station(3.0, 6.5)), (-2.0, 9.5));
        // The outer side of the corner.
        assert_eq!(station(4.0, -1.0), 3.0);
        assert_eq!(nearest(&CORNER, DVec3::NAN), None);
    }

    #[test]
    fn a_searched_polyline_gives_the_same_answers() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut number = || rng.random::<f64>() - 0.5;
        for count in [1, 2, 3, 16, 17, 18, 33, 200] {
            // A walk, with a rest in which points coincide.
            let mut points = vec![DVec3::ZERO];
            for k in 1..count {
                let step =
                    if k % 7 == 3 { DVec3::ZERO } else { DVec3::new(0.3 + number(), number(), number()) };
                points.push(points[k - 1] + step);
            }
            let searched = Searched::of(&points);
            for k in 0..300 {
                let at = points[k % count] + DVec3::new(number(), number(), number()) * 0.1 * k as f64;
                let first = |best: usize, i: usize| {
                    let squared = |i: usize| points[i].distance_squared(at);
                    if squared(i) < squared(best) { i } else { best }
                };
                if count > 1 {
                    assert_eq!(searched.nearest(at), nearest(&points, at));
                    assert_eq!(searched.nearest_point(at), (0..count).fold(0, first));
                    let all = nearest_of(&points, 0..count - 1, at, false);
                    let all = all.map(|(segment, share, squared)| (segment, share, squared.sqrt()));
                    assert_eq!(searched.nearest_within(at), all);
                } else {
                    assert_eq!(searched.nearest_within(at), Some((0, 0.0, at.length())));
                }
            }
        }
    }
}
