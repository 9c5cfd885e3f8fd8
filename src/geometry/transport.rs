use glam::{DMat3, DVec3};

/// Frames along a curve that turn about its tangent as little as possible.
///
/// `points` are the curve's points in mm, `tangents` its unit tangents there. Each result has columns
/// (x, y, tangent), right-handed; the first x lies across the world axis that the first tangent avoids most.
/// Double reflection: W. Wang, B. Jüttler, D. Zheng, Y. Liu, *Computation of rotation minimizing frames*,
/// ACM Transactions on Graphics 27(1), 2008, section 4.
///
/// Points that coincide keep the frame before them but for the turn of the tangent.
pub fn rotation_minimising_frames(points: &[DVec3], tangents: &[DVec3]) -> Vec<DMat3> {
    let mut frames: Vec<DMat3> = Vec::with_capacity(points.len());
    for (i, (&point, &tangent)) in points.iter().zip(tangents).enumerate() {
        let x = match frames.last() {
            None => {
                let t = tangent.abs();
                if t.x <= t.y && t.x <= t.z {
                    DVec3::X
                } else if t.y <= t.z {
                    DVec3::Y
                } else {
                    DVec3::Z
                }
            }
            Some(previous) => {
                frames.push(transported(previous, point - points[i - 1], tangent));
                continue;
            }
        };
        frames.push(with_axes(x, tangent));
    }
    frames
}

/// The frame a chord farther, where the tangent is `tangent`: one step of [`rotation_minimising_frames`], in either
/// direction of the curve.
pub(crate) fn transported(previous: &DMat3, chord: DVec3, tangent: DVec3) -> DMat3 {
    let (mut x, mut t) = (previous.x_axis, previous.z_axis);
    if chord.length_squared() > 0.0 {
        x = reflect(x, chord);
        t = reflect(t, chord);
    }
    let turn = tangent - t;
    if turn.length_squared() > 1e-24 {
        x = reflect(x, turn);
    }
    with_axes(x, tangent)
}

/// The frame along `tangent` whose x axis is as near to `x` as it can be.
fn with_axes(x: DVec3, tangent: DVec3) -> DMat3 {
    let x = (x - tangent * x.dot(tangent)).normalize();
    DMat3::from_cols(x, tangent.cross(x), tangent)
}

fn reflect(v: DVec3, normal: DVec3) -> DVec3 {
    v - normal * (2.0 * normal.dot(v) / normal.length_squared())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn frames_on_a_plane_curve_keep_the_plane_normal() {
        let angles: Vec<f64> = (0..200).map(|i| f64::from(i) / 199.0 * PI).collect();
        let points: Vec<DVec3> = angles.iter().map(|a| DVec3::new(a.cos(), a.sin(), 0.0) * 30.0).collect();
        let tangents: Vec<DVec3> = angles.iter().map(|a| DVec3::new(-a.sin(), a.cos(), 0.0)).collect();
        let frames = rotation_minimising_frames(&points, &tangents);
        let (first, last) = (frames[0], frames[199]);
        assert!((first.x_axis.z - last.x_axis.z).abs() < 1e-9);
        for f in &frames {
            assert!((f.determinant() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn frames_on_a_helix_turn_against_its_torsion() {
        // On a helix of radius a and pitch 2πb the frame turns about the tangent by b/(a²+b²) per unit length
        // relative to the Frenet frame; after one turn the two differ by 2πb/√(a²+b²).
        let (a, b, n) = (10.0_f64, 5.0_f64, 4000);
        let s = (a * a + b * b).sqrt();
        let at = |i: usize| i as f64 / n as f64 * TAU;
        let points: Vec<DVec3> =
            (0..=n).map(|i| DVec3::new(a * at(i).cos(), a * at(i).sin(), b * at(i))).collect();
        let tangents: Vec<DVec3> =
            (0..=n).map(|i| DVec3::new(-a * at(i).sin(), a * at(i).cos(), b) / s).collect();
        let frames = rotation_minimising_frames(&points, &tangents);
        // The Frenet frame returns to itself after one turn, so the difference shows on the frame itself.
        let (x0, x1, t) = (frames[0].x_axis, frames[n].x_axis, tangents[0]);
        let angle = x0.cross(x1).dot(t).atan2(x0.dot(x1));
        let expected = -TAU * b / s;
        let difference = (angle - expected).rem_euclid(TAU);
        assert!(difference.min(TAU - difference) < 1e-4, "{angle} {expected}");
    }
}
