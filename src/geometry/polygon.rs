//! Area and area centroid of a polygon.

use glam::DVec2;

/// Twice the signed area of a closed polygon, and six times its first moment of area about its first point; zeros
/// without points.
///
/// The area's centroid is the first point plus `moment / (3 · twice_area)`. Both are taken about the first point, so
/// that a polygon far from the origin loses no digits.
pub(crate) fn twice_area_and_moment(points: impl Iterator<Item = DVec2> + Clone) -> (f64, DVec2) {
    let Some(origin) = points.clone().next() else { return (0.0, DVec2::ZERO) };
    let points = points.map(|p| p - origin);
    let next = points.clone().skip(1).chain([DVec2::ZERO]);
    points.zip(next).fold((0.0, DVec2::ZERO), |(twice_area, moment), (a, b)| {
        let cross = a.perp_dot(b);
        (twice_area + cross, moment + (a + b) * cross)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangle_has_its_area_and_centroid_in_both_directions() {
        let mut corners = [(2.0, 1.0), (6.0, 1.0), (6.0, 3.0), (2.0, 3.0)].map(DVec2::from);
        for sign in [1.0, -1.0] {
            let (twice_area, moment) = twice_area_and_moment(corners.iter().copied());
            assert_eq!(twice_area, sign * 16.0);
            assert_eq!(corners[0] + moment / (3.0 * twice_area), DVec2::new(4.0, 2.0));
            corners.reverse();
        }
        assert_eq!(twice_area_and_moment(std::iter::empty()), (0.0, DVec2::ZERO));
    }
}
