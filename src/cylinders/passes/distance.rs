//! Signed distance of a point to the nearer triangle of its face (docs/method.md, "Local cylinder fit").

use super::TubeGrid;
use crate::numerics::Scalar;

/// A face as seen from its corner a, and what the distances of all its points have in common.
///
/// In these coordinates a = 0, b = (b, Δ, 0), b' = (b', Δ, D) and a' = (a', 0, D). The bottom triangle is
/// (a, b, b'), the top one (a, b', a').
#[derive(Debug, Clone, Copy)]
pub struct Face<T> {
    /// r of b.
    b: T,
    /// r of b'.
    b_above: T,
    /// r of a'.
    a_above: T,
    /// The inverse squares of the lengths of the edges: from a to b, to a' and to b', and from b' to b and to a'.
    per_edge: [T; 5],
    /// The inverse squares of the bottom and the top triangle's normals.
    per_normal: [T; 2],
}

impl<T: Scalar> Face<T> {
    /// The face whose corners b, b' and a' have these radii, less that of a.
    #[inline(always)]
    pub fn new([b, b_above, a_above]: [T; 3], grid: &TubeGrid<T>) -> Self {
        let TubeGrid { step_theta: theta, step_z: z, .. } = *grid;
        let [n1, n2] = normals([b, b_above, a_above], grid);
        let (to_b, to_a) = (b - b_above, a_above - b_above);
        let squares = [
            b * b + theta * theta,
            a_above * a_above + z * z,
            b_above * b_above + theta * theta + z * z,
            to_b * to_b + z * z,
            to_a * to_a + theta * theta,
            n1[0] * n1[0] + n1[1] * n1[1] + n1[2] * n1[2],
            n2[0] * n2[0] + n2[1] * n2[1] + n2[2] * n2[2],
            T::from_count(1),
        ];
        // Eight at once, which is one division of vectors.
        let [ab, aa, diagonal, bb, across, bottom, top, _] = squares.map(|square| T::from_count(1) / square);
        Self { b, b_above, a_above, per_edge: [ab, aa, diagonal, bb, across], per_normal: [bottom, top] }
    }

    /// Its numbers, for [`Face::of_numbers`].
    #[inline(always)]
    pub(in crate::cylinders) fn numbers(&self) -> [T; 10] {
        let [ab, aa, diagonal, bb, across] = self.per_edge;
        let [bottom, top] = self.per_normal;
        [self.b, self.b_above, self.a_above, ab, aa, diagonal, bb, across, bottom, top]
    }

    /// The face of [`Face::numbers`].
    #[inline(always)]
    pub(in crate::cylinders) fn of_numbers(numbers: [T; 10]) -> Self {
        let [b, b_above, a_above, ab, aa, diagonal, bb, across, bottom, top] = numbers;
        Self { b, b_above, a_above, per_edge: [ab, aa, diagonal, bb, across], per_normal: [bottom, top] }
    }
}

type Vector<T> = [T; 3];

/// The normals of the bottom triangle, b × b', and of the top one, b' × a'. They point outwards.
#[inline(always)]
fn normals<T: Scalar>([b, b_above, a_above]: [T; 3], grid: &TubeGrid<T>) -> [Vector<T>; 2] {
    let TubeGrid { step_theta: theta, step_z: z, .. } = *grid;
    let along_r = theta * z;
    [[along_r, -(b * z), theta * (b - b_above)], [along_r, z * (a_above - b_above), -(theta * a_above)]]
}

/// The square of a vector's length.
#[inline(always)]
fn square<T: Scalar>(e: Vector<T>) -> T {
    e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
}

#[inline(always)]
fn lesser<T: Scalar>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// The number, within [0, 1].
#[inline(always)]
fn within_one<T: Scalar>(t: T) -> T {
    let (zero, one) = (T::default(), T::from_count(1));
    let t = if t > zero { t } else { zero };
    if t < one { t } else { one }
}

/// Signed distance of a point to the nearer triangle of its face, and whether that is the top one; a tie goes
/// to bottom. The point is given as (r, θ, z) less the face's corner a.
///
/// The closest point of a triangle is the foot of the perpendicular on its plane where that lies inside, and
/// otherwise the closest point of its edges. It is negative where the point lies behind the plane of the nearer
/// triangle, since p - q and p - a have the same product with the normal for each q in that plane.
///
/// Where the triangles' closest point is one and the same (on the diagonal, at a or at b') both distances are
/// equal to the bit, on any device: edges are followed from a or from b', whichever both triangles share. In a
/// flat face r of each foot is exactly 0, so that the foot that lies inside is the nearer one. A compiler that
/// turns `ab + ac` into `a(b + c)` finds no such sum.
#[inline(always)]
pub fn distance<T: Scalar>(p: [T; 3], face: &Face<T>, grid: &TubeGrid<T>) -> (T, bool) {
    let zero = T::default();
    let [x, y, z] = p;
    let Face { b, b_above, a_above, per_edge, per_normal } = *face;
    let TubeGrid { step_theta: theta, step_z: height, faces_per_rad, faces_per_mm, .. } = *grid;
    let [n1, n2] = normals([b, b_above, a_above], grid);

    // Feet on the planes. Their r follows from θ and z, which are small.
    let side1 = n1[0] * x + n1[1] * y + n1[2] * z;
    let side2 = n2[0] * x + n2[1] * y + n2[2] * z;
    let (k1, k2) = (side1 * per_normal[0], side2 * per_normal[1]);
    let (theta1, z1) = (y - n1[1] * k1, z - n1[2] * k1);
    let (theta2, z2) = (y - n2[1] * k2, z - n2[2] * k2);
    let inside1 = (z1 >= zero) & (theta1 <= theta) & (theta1 * height >= z1 * theta);
    let inside2 = (theta2 >= zero) & (z2 <= height) & (z2 * theta >= theta2 * height);
    let (to_b, to_a) = (b - b_above, a_above - b_above);
    let r1 = theta1 * (b * faces_per_rad) - z1 * (to_b * faces_per_mm);
    let r2 = z2 * (a_above * faces_per_mm) - theta2 * (to_a * faces_per_rad);
    let foot1 = square([x - r1, y - theta1, z - z1]);
    let foot2 = square([x - r2, y - theta2, z - z2]);

    // Edges from a, at the part t of their length.
    let t = within_one((b * x + theta * y) * per_edge[0]);
    let on_ab = square([x - t * b, y - t * theta, z]);
    let t = within_one((a_above * x + height * z) * per_edge[1]);
    let on_aa = square([x - t * a_above, y, z - t * height]);
    let t = within_one((b_above * x + theta * y + height * z) * per_edge[2]);
    let on_diagonal = square([x - t * b_above, y - t * theta, z - t * height]);
    // Edges from b'.
    let from = [x - b_above, y - theta, z - height];
    let t = within_one((to_b * from[0] - height * from[2]) * per_edge[3]);
    let on_bb = square([from[0] - t * to_b, from[1], from[2] + t * height]);
    let t = within_one((to_a * from[0] - theta * from[1]) * per_edge[4]);
    let across = square([from[0] - t * to_a, from[1] + t * theta, from[2]]);

    let bottom = if inside1 { foot1 } else { lesser(on_ab, on_bb) };
    let top = if inside2 { foot2 } else { lesser(on_aa, across) };
    // The diagonal is bottom's too, and no nearer than a foot inside.
    let beats_diagonal = inside2 | (top < on_diagonal);
    let beats_bottom = (top < bottom) | ((top <= bottom) & inside2 & !inside1);
    let is_top = beats_diagonal & beats_bottom;
    let squared = if is_top { top } else { lesser(bottom, on_diagonal) };
    let side = if is_top { side2 } else { side1 };
    let distance = squared.sqrt();
    (if side < zero { -distance } else { distance }, is_top)
}
