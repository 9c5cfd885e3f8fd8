//! Signed distance of a point to the nearer triangle of its face (method, section 4.1).

use super::Scalar;

/// A face as seen from its corner a: the other corners' radii less a's, and the steps of the grid. In these
/// coordinates a = 0, b = (b, Δ, 0), b' = (b_above, Δ, D), a' = (a_above, 0, D).
#[derive(Debug, Clone, Copy)]
pub struct Face<T> {
    /// r of b.
    pub b: T,
    /// r of b'.
    pub b_above: T,
    /// r of a'.
    pub a_above: T,
    /// Δ = 2π/N.
    pub step_theta: T,
    /// D = H/L.
    pub step_z: T,
}

type Vector<T> = [T; 3];

#[inline(always)]
fn dot<T: Scalar>(p: Vector<T>, q: Vector<T>) -> T {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

#[inline(always)]
fn minus<T: Scalar>(p: Vector<T>, q: Vector<T>) -> Vector<T> {
    [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
}

#[inline(always)]
fn cross<T: Scalar>(p: Vector<T>, q: Vector<T>) -> Vector<T> {
    [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
}

/// Closest point of the triangle (0, b, c) to p, and the triangle's normal, not of unit length.
///
/// Voronoi regions as in C. Ericson, *Real-Time Collision Detection*, 5.1.5, without branches: each region
/// sets the weights of b and c as two numerators over one denominator. The areas that decide between regions
/// are triple products, where the book has differences of products of dot products: equal by Lagrange's
/// identity, but on the slivers of fine grids they keep the digits that f32 has.
#[inline(always)]
fn closest<T: Scalar>(p: Vector<T>, b: Vector<T>, c: Vector<T>) -> (Vector<T>, Vector<T>) {
    let zero = T::default();
    let normal = cross(b, c);
    let (from_b, from_c) = (minus(p, b), minus(p, c));
    let (d1, d2) = (dot(b, p), dot(c, p));
    let (d3, d4) = (dot(b, from_b), dot(c, from_b));
    let (d5, d6) = (dot(b, from_c), dot(c, from_c));
    let area_c = dot(normal, cross(b, p));
    let area_b = dot(normal, cross(p, c));
    let area_a = dot(normal, cross(from_b, from_c));

    // Inside, then the regions of the edges and corners, the book's first test last: the last that holds wins.
    let (mut over_b, mut over_c, mut under) = (area_b, area_c, area_a + area_b + area_c);
    let (e, f) = (d4 - d3, d5 - d6);
    let on_bc = (area_a <= zero) & (e >= zero) & (f >= zero);
    over_b = if on_bc { f } else { over_b };
    over_c = if on_bc { e } else { over_c };
    under = if on_bc { e + f } else { under };
    let on_ac = (area_b <= zero) & (d2 >= zero) & (d6 <= zero);
    over_b = if on_ac { zero } else { over_b };
    over_c = if on_ac { d2 } else { over_c };
    under = if on_ac { d2 - d6 } else { under };
    let at_c = (d6 >= zero) & (d5 <= d6);
    over_b = if at_c { zero } else { over_b };
    over_c = if at_c { d2 } else { over_c };
    under = if at_c { d2 } else { under };
    let on_ab = (area_c <= zero) & (d1 >= zero) & (d3 <= zero);
    over_b = if on_ab { d1 } else { over_b };
    over_c = if on_ab { zero } else { over_c };
    under = if on_ab { d1 - d3 } else { under };
    let at_b = (d3 >= zero) & (d4 <= d3);
    over_b = if at_b { d1 } else { over_b };
    over_c = if at_b { zero } else { over_c };
    under = if at_b { d1 } else { under };
    let at_a = (d1 <= zero) & (d2 <= zero);
    over_b = if at_a { zero } else { over_b };
    over_c = if at_a { zero } else { over_c };
    under = if at_a { T::from_count(1) } else { under };

    let (s, t) = (over_b / under, over_c / under);
    let q = [b[0] * s + c[0] * t, b[1] * s + c[1] * t, b[2] * s + c[2] * t];
    (q, normal)
}

/// Signed distance of a point to the nearer triangle of its face, and whether that is the top one; a tie goes
/// to bottom. The point is given as (r, θ, z) less the face's corner a.
///
/// Both triangles see their shared edge (a, b') as (0, c) or (0, b) with the same expression
/// `t = (b'-a)·(p-a) / ((b'-a)·(p-a) - (b'-a)·(p-b'))`, so a point nearest to that edge is a tie to the bit.
/// Which is nearer is read off `|p-q₁|² - |p-q₂|² = (q₂-q₁)·(2p-q₁-q₂)`, which does not cancel.
#[inline(always)]
pub fn distance<T: Scalar>(p: [T; 3], face: &Face<T>) -> (T, bool) {
    let zero = T::default();
    let b = [face.b, face.step_theta, zero];
    let b_above = [face.b_above, face.step_theta, face.step_z];
    let a_above = [face.a_above, zero, face.step_z];
    let (q1, n1) = closest(p, b, b_above);
    let (q2, n2) = closest(p, b_above, a_above);
    let (e1, e2) = (minus(p, q1), minus(p, q2));
    let sum = [e1[0] + e2[0], e1[1] + e2[1], e1[2] + e2[2]];
    let top = dot(minus(q2, q1), sum) > zero;
    let squared = if top { dot(e2, e2) } else { dot(e1, e1) };
    let side = if top { dot(e2, n2) } else { dot(e1, n1) };
    let distance = squared.sqrt();
    (if side < zero { -distance } else { distance }, top)
}
