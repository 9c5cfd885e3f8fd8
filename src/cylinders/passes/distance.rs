//! Signed distance of a point to the nearer triangle of its face (docs/method.md, "Local cylinder fit").

use crate::numerics::Scalar;

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

/// The quantities that decide in which Voronoi region of the triangle (0, b, c) a point p lies: products with b and
/// c, and the areas opposite the corners, `n·((c-b)×(p-b))`, `n·(p×c)` and `n·(b×p)`, all times 2|n|.
struct Products<T> {
    /// b·p, c·p.
    from_a: [T; 2],
    /// b·(p-b), c·(p-b).
    from_b: [T; 2],
    /// b·(p-c), c·(p-c).
    from_c: [T; 2],
    /// Opposite a, b and c.
    areas: [T; 3],
}

/// Weights of b and c in the closest point of the triangle (0, b, c).
///
/// Voronoi regions as in C. Ericson, *Real-Time Collision Detection*, 5.1.5, without branches: each region
/// sets the weights as two numerators over one denominator. The areas are triple products, where the book has
/// differences of products of dot products: equal by Lagrange's identity, but they preserve f32 precision on the
/// slivers of fine grids.
#[inline(always)]
fn closest<T: Scalar>(products: &Products<T>) -> (T, T) {
    let Products { from_a: [d1, d2], from_b: [d3, d4], from_c: [d5, d6], areas: [area_a, area_b, area_c] } =
        *products;
    let zero = T::default();

    // The interior, then the edges and corners in the reverse of the book's order: the last test that holds wins.
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
    (over_b / under, over_c / under)
}

/// Signed distance of a point to the nearer triangle of its face, and whether that is the top one; a tie goes
/// to bottom. The point is given as (r, θ, z) less the face's corner a.
///
/// Both triangles compute the closest point on their shared edge (a, b') by the same expression
/// `t = (b'-a)·(p-a) / ((b'-a)·(p-a) - (b'-a)·(p-b'))`, so a point nearest to that edge is a tie to the bit.
/// The sign of `|p-q₁|² - |p-q₂|² = (q₂-q₁)·(2p-q₁-q₂)` decides which is nearer; the product does not cancel.
///
/// The cross products are written out for these two triangles with common factors extracted, so that a compiler
/// that may turn `ab + ac` into `a(b + c)` changes nothing, and the device agrees to the bit.
#[inline(always)]
pub fn distance<T: Scalar>(p: [T; 3], face: &Face<T>) -> (T, bool) {
    let zero = T::default();
    let [x, y, z] = p;
    let Face { b: u, b_above: v, a_above: w, step_theta: dt, step_z: dz } = *face;
    let corner_b = [u, dt, zero];
    let corner_b_above = [v, dt, dz];
    let corner_a_above = [w, zero, dz];
    let from_b = [x - u, y - dt, z];
    let from_b_above = [x - v, y - dt, z - dz];
    let from_a_above = [x - w, y, z - dz];
    let diagonal = dot(corner_b_above, p);
    let beyond_diagonal = dot(corner_b_above, from_b_above);
    let n_r = dt * dz;

    // Bottom: (a, b, b').
    let n1 = [n_r, -(u * dz), dt * (u - v)];
    let bb_r = v - u;
    let bottom = Products {
        from_a: [dot(corner_b, p), diagonal],
        from_b: [dot(corner_b, from_b), dot(corner_b_above, from_b)],
        from_c: [dot(corner_b, from_b_above), beyond_diagonal],
        areas: [
            dot(n1, [-(dz * from_b[1]), dz * from_b[0] - bb_r * z, bb_r * from_b[1]]),
            dot(n1, [y * dz - z * dt, z * v - x * dz, x * dt - y * v]),
            dot(n1, [dt * z, -(u * z), u * y - dt * x]),
        ],
    };
    let (s1, t1) = closest(&bottom);
    let q1 = [u * s1 + v * t1, dt * (s1 + t1), dz * t1];

    // Top: (a, b', a').
    let aa_r = w - v;
    let n2 = [n_r, dz * aa_r, -(dt * w)];
    let top = Products {
        from_a: [diagonal, dot(corner_a_above, p)],
        from_b: [beyond_diagonal, dot(corner_a_above, from_b_above)],
        from_c: [dot(corner_b_above, from_a_above), dot(corner_a_above, from_a_above)],
        areas: [
            dot(
                n2,
                [
                    -(dt * from_b_above[2]),
                    -(aa_r * from_b_above[2]),
                    aa_r * from_b_above[1] + dt * from_b_above[0],
                ],
            ),
            dot(n2, [y * dz, z * w - x * dz, -(y * w)]),
            dot(n2, [dt * z - dz * y, dz * x - v * z, v * y - dt * x]),
        ],
    };
    let (s2, t2) = closest(&top);
    let q2 = [v * s2 + w * t2, dt * s2, dz * (s2 + t2)];

    let (e1, e2) = (minus(p, q1), minus(p, q2));
    let sum = [e1[0] + e2[0], e1[1] + e2[1], e1[2] + e2[2]];
    let is_top = dot(minus(q2, q1), sum) > zero;
    let squared = if is_top { dot(e2, e2) } else { dot(e1, e1) };
    let side = if is_top { dot(e2, n2) } else { dot(e1, n1) };
    let distance = squared.sqrt();
    (if side < zero { -distance } else { distance }, is_top)
}
