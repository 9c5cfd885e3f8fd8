//! The closest point of a triangle, and where a ray meets it.

use glam::DVec3;

/// The part of a triangle that a point is on: its inside, the edge that starts at corner k, or corner k.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Feature {
    Face,
    Edge(usize),
    Corner(usize),
}

/// The closest point of a triangle to a point, and the part of the triangle that it is on.
///
/// By Voronoi regions (C. Ericson, *Real-Time Collision Detection*, 2005, section 5.1.5), with areas from cross products:
/// his faster ones from dot products go wrong in slivers, by as much as the width of one a hundred thousand times longer
/// than wide. The passes of the cylinder fit have a form of their own, without branches and in the order of operations of
/// their shader.
#[inline(always)] // A twentieth of the time of the surface locator's search, which calls it from two places.
pub(crate) fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> (DVec3, Feature) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, Feature::Corner(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, Feature::Corner(1));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, Feature::Corner(2));
    }
    // Barycentric coordinates, but for a factor: the squared length of the normal.
    let normal = ab.cross(ac);
    let across = normal.cross(ap);
    let (v, w, whole) = (ac.dot(across), -ab.dot(across), normal.length_squared());
    if w <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (a + ab * (d1 / (d1 - d3)), Feature::Edge(0));
    }
    if v <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (a + ac * (d2 / (d2 - d6)), Feature::Edge(2));
    }
    if v + w >= whole && d4 >= d3 && d5 >= d6 {
        return (b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))), Feature::Edge(1));
    }
    (a + ab * (v / whole) + ac * (w / whole), Feature::Face)
}

/// How far along a ray it meets a triangle, from either side, in lengths of `direction`; `None` where it misses it or
/// runs parallel to it.
///
/// C. Ericson, *Real-Time Collision Detection*, 2005, section 5.3.6, for both sides as in `parry3d`.
pub(crate) fn ray_meets(origin: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (ab, ac, ap) = (b - a, c - a, origin - a);
    let normal = ab.cross(ac);
    let (d, t) = (normal.dot(direction), ap.dot(normal));
    if d == 0.0 || (t < 0.0 && d < 0.0) || (t > 0.0 && d > 0.0) {
        return None;
    }
    let d = d.abs();
    // Barycentric coordinates times d.
    let e = -direction.cross(ap);
    let (v, w) = if t < 0.0 { (-ac.dot(e), ab.dot(e)) } else { (ac.dot(e), -ab.dot(e)) };
    if v < 0.0 || v > d || w < 0.0 || v + w > d {
        return None;
    }
    let per_d = 1.0 / d;
    Some(if t < 0.0 { -t * per_d } else { t * per_d })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_region_gives_its_feature() {
        let corners = [DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0];
        for ([x, y], point, feature) in [
            ([1.0, 1.0], DVec3::new(1.0, 1.0, 0.0), Feature::Face),
            ([2.0, -1.0], DVec3::X * 2.0, Feature::Edge(0)),
            ([3.0, 3.0], DVec3::new(2.0, 2.0, 0.0), Feature::Edge(1)),
            ([-1.0, 2.0], DVec3::Y * 2.0, Feature::Edge(2)),
            ([-1.0, -1.0], DVec3::ZERO, Feature::Corner(0)),
            ([6.0, -1.0], DVec3::X * 4.0, Feature::Corner(1)),
            ([-1.0, 6.0], DVec3::Y * 4.0, Feature::Corner(2)),
        ] {
            assert_eq!(closest_on_triangle(DVec3::new(x, y, 3.0), corners), (point, feature));
        }
    }

    #[test]
    fn a_ray_meets_a_triangle_from_both_sides_but_not_behind_itself() {
        let corners = [DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0];
        let from = DVec3::new(1.0, 1.0, 3.0);
        assert_eq!(ray_meets(from, DVec3::NEG_Z, corners), Some(3.0));
        assert_eq!(ray_meets(from, DVec3::NEG_Z * 2.0, corners), Some(1.5));
        assert_eq!(ray_meets(-from + 2.0 * DVec3::new(1.0, 1.0, 0.0), DVec3::Z, corners), Some(3.0));
        assert_eq!(ray_meets(from, DVec3::Z, corners), None);
        assert_eq!(ray_meets(from, DVec3::X, corners), None);
        assert_eq!(ray_meets(from + DVec3::X * 3.0, DVec3::NEG_Z, corners), None);
    }
}
