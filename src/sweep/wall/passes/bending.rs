//! The gradient of the bending energy (`shaders/sweep/common/bending.wgsl`). In f64 this is
//! part of `Operator`.

use super::Level;
use super::stencil_at::stencil_at;

/// The second difference of three values in a row, from first differences: these are exact where neighbours
/// are alike.
fn second_difference(a: f32, b: f32, c: f32) -> f32 {
    (c - b) - (b - a)
}

/// The gradient of λ times the bending energy of `x`, the values of a grid, at its node j of ring k.
pub fn bending(level: &Level, x: &[f32], k: usize, j: usize) -> f32 {
    let rings = level.rings as usize;
    let s = stencil_at(level, x, k, j);
    let bend_before = second_difference(s.last_but_one, s.before, s.here);
    let bend = second_difference(s.before, s.here, s.next);
    let bend_next = second_difference(s.here, s.next, s.next_but_one);
    let around = (bend_before - bend) + (bend_next - bend);

    // Second differences along the axis exist on inner rings, twists between two rings.
    let (mut arch_below, mut arch, mut arch_above, mut twist) = (0.0, 0.0, 0.0, 0.0);
    if k >= 1 {
        if k >= 2 {
            arch_below = second_difference(s.below_but_one, s.below, s.here);
        }
        if k + 1 < rings {
            arch = second_difference(s.below, s.here, s.above);
        }
        twist = ((s.here - s.before) - (s.below - s.below_before))
            - ((s.next - s.here) - (s.below_next - s.below));
    }
    if k + 1 < rings {
        if k + 2 < rings {
            arch_above = second_difference(s.here, s.above, s.above_but_one);
        }
        twist += ((s.above_next - s.above) - (s.next - s.here))
            - ((s.above - s.above_before) - (s.here - s.before));
    }
    let along = (arch_below - arch) + (arch_above - arch);
    level.along * along + level.around * around + level.twist * twist
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::prepare::grid::WallGrid;
    use crate::sweep::wall::bending::LocalSmoothness;
    use crate::sweep::wall::operator::Operator;
    use crate::sweep::wall::passes::WallParameters;

    #[test]
    fn the_bending_is_the_cpu_s() {
        for rings in [3, 4, 7] {
            let grid = WallGrid { rings, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };
            let parameters = WallParameters::new([rings as u32, 8], [grid.step_mm, grid.arc_mm], 5.0, 0.1);
            let level = parameters.with_smoothness(3.0).finest();
            let x: Vec<f32> = (0..8 * rings).map(|i| (0.7 * (i * i) as f32).sin()).collect();
            let mut expected = vec![0.0; x.len()];
            let wide: Vec<f64> = x.iter().map(|&x| f64::from(x)).collect();
            let no_echoes = Operator::lumped(&grid, vec![0.0; x.len()], 3.0, LocalSmoothness::default());
            no_echoes.apply(&wide, &mut expected);
            for (node, expected) in expected.iter().enumerate() {
                let found = bending(&level, &x, node / 8, node % 8);
                // Some thirty roundings of sums of up to 64 numbers of at most 1, times 4.
                assert!((f64::from(found) - expected).abs() < 1e-5 * 64.0, "{node}: {found} {expected}");
            }
        }
    }
}
