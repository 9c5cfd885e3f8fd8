//! Area and area centroid of a polygon, how often it goes round a point, and the triangles that fill it.

use glam::{DVec2, DVec3};
use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation as _, mitigate_underflow};
use std::collections::HashMap;

/// A polygon whose area is below this share of its extent squared is a line: its plane would be rounding noise.
const SMALLEST_AREA_RATIO: f64 = 1e-6;

/// Four corners whose tetrahedron has less than this share of their extent cubed (times six) lie in a plane.
const SMALLEST_VOLUME_RATIO: f64 = 1e-3;

/// Convex polygons of up to so many corners become fans. In larger ones a fan's triangles are needles.
const LARGEST_FAN: usize = 16;

/// Where edges cross, corners are moved by up to this share of the polygon's extent to make them touch, which is more
/// than the rounding of coordinates in single precision.
const TOLERANCE: f64 = 1e-6;

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

/// How often a closed polygon goes round the origin; negative where it does so clockwise.
pub(crate) fn turns_about_origin(points: &[DVec2]) -> i32 {
    let next = points.iter().cycle().skip(1);
    // A ray from the origin along x crosses the polygon so often from below and from above.
    let crossing = |(a, b): (&DVec2, &DVec2)| match (a.y <= 0.0, b.y <= 0.0) {
        (true, false) => i32::from(a.perp_dot(*b) > 0.0),
        (false, true) => -i32::from(a.perp_dot(*b) < 0.0),
        _ => 0,
    };
    points.iter().zip(next).map(crossing).sum()
}

/// The triangles that fill a polygon in space, as places among its corners, each running round the way that the polygon
/// does; `None` where its edges cross, seen along its normal.
///
/// The plane's normal is that of Newell's method. Corners at one position are one: polygons with holes, whose outline runs
/// to a hole and back along the same way, are filled right. A polygon that is no more than a line becomes a fan without
/// area.
pub(crate) fn triangulate(corners: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    let fan = || (2..corners.len()).map(|k| [0, k - 1, k]).collect();
    let &first = corners.first()?;
    let extent = corners.iter().map(|c| c.distance(first)).fold(0.0, f64::max);
    let unit: Vec<DVec3> = corners.iter().map(|&c| (c - first) / extent).collect();
    let crosses = unit.windows(2).map(|pair| pair[0].cross(pair[1]));
    let (normal, whole) =
        crosses.fold((DVec3::ZERO, 0.0), |(sum, whole), cross| (sum + cross, whole + cross.length()));
    if whole.is_nan() || whole <= SMALLEST_AREA_RATIO {
        return Some(fan());
    }
    // What is left of areas that cancel is rounding noise.
    if normal.length() <= whole * f64::EPSILON * corners.len() as f64 {
        return None;
    }
    let (right, up) = normal.try_normalize()?.any_orthonormal_pair();
    let flat: Vec<DVec2> = unit.iter().map(|c| DVec2::new(c.dot(right), c.dot(up))).collect();
    if corners.len() <= LARGEST_FAN && is_seen_from_its_first(&flat) {
        return Some(fan());
    }
    let rounded = || flat.iter().map(|p| (p / TOLERANCE).round() * TOLERANCE).collect::<Vec<_>>();
    delaunay(&flat).or_else(|| delaunay(&rounded())).or_else(|| skew_patch(&unit))
}

/// Four corners that do not lie in one plane have edges that do not meet, though they may cross as seen along the normal,
/// as where a vessel's quads fold at a bend: two triangles about the shorter diagonal.
fn skew_patch(corners: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    let &[a, b, c, d] = corners else { return None };
    if (b - a).dot((c - a).cross(d - a)).abs() < SMALLEST_VOLUME_RATIO {
        return None;
    }
    let is_first_shorter = a.distance_squared(c) <= b.distance_squared(d);
    Some(if is_first_shorter { vec![[0, 1, 2], [0, 2, 3]] } else { vec![[1, 2, 3], [1, 3, 0]] })
}

/// Whether a fan about the first corner, whose angle is less than 180°, fills the polygon.
fn is_seen_from_its_first(corners: &[DVec2]) -> bool {
    let from_first = |k: usize| corners[k] - corners[0];
    (2..corners.len()).all(|k| {
        from_first(1).perp_dot(from_first(k)) > 0.0 && from_first(k - 1).perp_dot(from_first(k)) > 0.0
    })
}

/// The triangles of the polygon's constrained Delaunay triangulation about which it runs once, anticlockwise; `None`
/// where edges cross or it runs otherwise about a triangle.
fn delaunay(corners: &[DVec2]) -> Option<Vec<[usize; 3]>> {
    let (mut place_of, mut positions) = (Vec::new(), Vec::new());
    let mut vertex_at: HashMap<[u64; 2], usize> = HashMap::new();
    let mut vertex = |(place, corner): (usize, &DVec2)| {
        let position = mitigate_underflow(Point2::new(corner.x, corner.y));
        // Adding zero makes -0 and 0 the same position.
        *vertex_at.entry([position.x, position.y].map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
            positions.push(position);
            place_of.push(place);
            positions.len() - 1
        })
    };
    let outline: Vec<usize> = corners.iter().enumerate().map(&mut vertex).collect();
    let mut delaunay =
        ConstrainedDelaunayTriangulation::<Point2<f64>>::bulk_load_cdt(positions, Vec::new()).ok()?;

    // How often the outline runs along each directed edge, less how often it runs back.
    let mut runs = vec![0_i64; 2 * delaunay.num_undirected_edges()];
    let next = outline.iter().cycle().skip(1);
    for (&from, &to) in outline.iter().zip(next).filter(|(from, to)| from != to) {
        let [from, to] = [from, to].map(FixedVertexHandle::from_index);
        let path = delaunay.try_add_constraint(from, to);
        if path.is_empty() {
            return None;
        }
        for edge in path {
            runs[edge.index()] += 1;
            runs[edge.rev().index()] -= 1;
        }
    }

    // How often it runs about each face: from the outside inwards, what an edge adds to the face on its left.
    let mut turns: Vec<Option<i64>> = vec![None; delaunay.num_all_faces()];
    turns[delaunay.outer_face().index()] = Some(0);
    let mut border: Vec<_> = delaunay.convex_hull().map(|edge| edge.rev().fix()).collect();
    while let Some(edge) = border.pop() {
        let edge = delaunay.directed_edge(edge);
        let outside = turns[edge.rev().face().index()]?;
        if turns[edge.face().index()].is_none() {
            turns[edge.face().index()] = Some(outside + runs[edge.fix().index()]);
            border.extend([edge.next().rev().fix(), edge.prev().rev().fix()]);
        }
    }
    let mut triangles = Vec::with_capacity(corners.len());
    for face in delaunay.inner_faces() {
        match turns[face.index()]? {
            0 => {}
            1 => triangles.push(face.vertices().map(|v| place_of[v.index()])),
            _ => return None,
        }
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn turns_about_the_origin_are_counted_with_their_sense() {
        let round = |turns: i32, centre: DVec2| -> Vec<DVec2> {
            let angle = |k: i32| std::f64::consts::TAU * f64::from(turns * k) / 40.0;
            (0..40).map(|k| centre + DVec2::from_angle(angle(k) + 0.1)).collect()
        };
        for turns in [-2, -1, 1, 2, 3] {
            assert_eq!(turns_about_origin(&round(turns, DVec2::new(0.5, -0.3))), turns);
            assert_eq!(turns_about_origin(&round(turns, DVec2::new(0.9, 0.9))), 0);
        }
        assert_eq!(turns_about_origin(&[]), 0);
        assert_eq!(turns_about_origin(&[DVec2::X]), 0);
    }

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

    /// The summed areas of a polygon's triangles, each of which must run round like the polygon about `normal`.
    fn filled(corners: &[DVec3], normal: DVec3) -> f64 {
        let triangles = triangulate(corners).unwrap();
        let twice = triangles.iter().map(|&[a, b, c]| {
            let turned = (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(normal);
            assert!(turned > 0.0, "{a} {b} {c} turns the other way");
            turned
        });
        twice.sum::<f64>() / 2.0
    }

    fn in_space(corners: &[[f64; 2]]) -> (Vec<DVec3>, DVec3) {
        let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -2.0, 1.0);
        let place = |&[x, y]: &[f64; 2]| turn * DVec3::new(x, y, 0.0) + DVec3::new(300.0, -20.0, 7.0);
        (corners.iter().map(place).collect(), turn * DVec3::Z)
    }

    #[test]
    fn concave_polygons_are_filled_wherever_they_begin() {
        // An L of three unit squares; a star whose points reach from 1 to 2, of five times sin 36°·1·2; a square of side 4
        // with a hole of side 2, to which its outline runs along one way there and back.
        let el = [[2.0, 2.0], [1.0, 2.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [2.0, 0.0]];
        let star: Vec<[f64; 2]> = (0..10)
            .map(|k| {
                (DVec2::from_angle(0.2 * std::f64::consts::PI * f64::from(k)) * f64::from(1 + k % 2))
                    .to_array()
            })
            .collect();
        let hole = [[1.0, 1.0], [1.0, 3.0], [3.0, 3.0], [3.0, 1.0], [1.0, 1.0]];
        let frame = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [0.0, 0.0]];
        let framed: Vec<[f64; 2]> = frame.iter().chain(&hole).copied().collect();
        let arrow = [[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]];
        let ten = 10.0 * (0.2 * std::f64::consts::PI).sin();
        for (corners, area) in [(&el[..], 3.0), (&star, ten), (&framed, 12.0), (&arrow, 1.0)] {
            for first in 0..corners.len() {
                let mut corners = corners.to_vec();
                corners.rotate_left(first);
                let (forwards, normal) = in_space(&corners);
                let backwards: Vec<DVec3> = forwards.iter().rev().copied().collect();
                assert!((filled(&forwards, normal) - area).abs() < 1e-12 * 300.0);
                assert!((filled(&backwards, -normal) - area).abs() < 1e-12 * 300.0);
            }
        }
    }

    #[test]
    fn repeated_corners_and_corners_on_an_edge_are_no_loss() {
        let square = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]];
        let (corners, normal) = in_space(&square);
        assert!((filled(&corners, normal) - 4.0).abs() < 1e-9);
        // Nearer to each other than the triangulation can tell.
        let close = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 1e-308]]
            .map(|[x, y]| DVec3::new(x, y, 0.0));
        assert_eq!(filled(&close, DVec3::Z), 4.0);
        // All corners on a line: triangles without area, which name every corner.
        let line: Vec<DVec3> = [0.0, 1.0, 3.0, 2.0].map(DVec3::splat).to_vec();
        assert_eq!(triangulate(&line), Some(vec![[0, 1, 2], [0, 2, 3]]));
    }

    #[test]
    fn crossing_edges_are_told_from_rounding() {
        let bow_tie = [[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]];
        let uneven = [[0.0, 0.0], [3.0, 3.0], [3.0, 0.0], [0.0, 2.0]];
        let pentagram: Vec<[f64; 2]> =
            (0..5).map(|k| DVec2::from_angle(0.8 * std::f64::consts::PI * f64::from(k)).to_array()).collect();
        for crossing in [&bow_tie[..], &uneven, &pentagram] {
            assert_eq!(triangulate(&in_space(crossing).0), None);
        }
        // The same corners not in a plane: edges that do not meet.
        let skew = [[0.0, 0.0, 0.0], [3.0, 3.0, 0.5], [3.0, 0.0, 0.0], [0.0, 2.0, 0.5]].map(DVec3::from);
        assert_eq!(triangulate(&skew), Some(vec![[0, 1, 2], [0, 2, 3]]));
        // The way to a hole and the way back, apart by what single precision loses.
        let nearly = [
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 4.0],
            [0.0, 4.0],
            [1e-7, 0.0],
            [1.0, 1.0 + 1e-7],
            [1.0, 3.0],
            [3.0, 3.0],
            [3.0, 1.0],
            [1.0 - 1e-7, 1.0],
        ];
        let (corners, _) = in_space(&nearly);
        let triangles = triangulate(&corners).unwrap();
        let twice =
            |&[a, b, c]: &[usize; 3]| (corners[b] - corners[a]).cross(corners[c] - corners[a]).length();
        assert!((triangles.iter().map(twice).sum::<f64>() / 2.0 - 12.0).abs() < 1e-5);
    }

    #[test]
    fn a_polygon_is_filled_with_its_whole_area_or_refused() {
        // Corners on a small grid: edges that cross, touch, overlap and run back are common.
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let (mut filled, mut refused) = (0, 0);
        for _ in 0..20_000 {
            let count = random.random_range(4..12);
            let corners: Vec<DVec2> = (0..count)
                .map(|_| DVec2::new(random.random_range(0..5).into(), random.random_range(0..4).into()))
                .collect();
            let in_space: Vec<DVec3> = corners.iter().map(|c| c.extend(1.0)).collect();
            let Some(triangles) = triangulate(&in_space) else {
                refused += 1;
                continue;
            };
            let (twice_area, _) = twice_area_and_moment(corners.iter().copied());
            let twice = triangles
                .iter()
                .map(|&[a, b, c]| (corners[b] - corners[a]).perp_dot(corners[c] - corners[a]));
            // The outline's own direction counts as forwards.
            assert!((twice.sum::<f64>() - twice_area).abs() < 1e-9, "{corners:?}");
            filled += 1;
        }
        assert!(filled > 1000 && refused > 1000, "{filled} filled, {refused} refused");
    }

    #[test]
    fn a_large_polygon_is_filled_in_time_that_grows_little_faster_than_it() {
        // Far and near by turns: time that grows with the square would be minutes.
        let count = 200_000_u32;
        let corners: Vec<DVec3> = (0..count)
            .map(|k| {
                let angle = f64::from(k) / f64::from(count) * std::f64::consts::TAU;
                DVec2::from_angle(angle).extend(0.0) * f64::from(1 + k % 2)
            })
            .collect();
        let expected = f64::from(count) * (std::f64::consts::TAU / f64::from(count)).sin();
        assert!((filled(&corners, DVec3::Z) - expected).abs() < 1e-9);
    }
}
