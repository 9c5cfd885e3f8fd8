//! The diagonal of the bending's matrix (`shaders/sweep/common/diagonal.wgsl`).

use super::Level;

/// Whether second differences along the axis exist on a ring: the ends are free.
pub(super) fn has_arch(level: &Level, k: u32) -> u32 {
    u32::from(k >= 1 && k + 1 < level.rings)
}

/// The diagonal of the matrix of λ times the bending on ring k.
pub(super) fn diagonal(level: &Level, k: u32) -> f32 {
    let mut arches = 4 * has_arch(level, k) + has_arch(level, k + 1);
    let mut twists = if k + 1 < level.rings { 2 } else { 0 };
    if k > 0 {
        arches += has_arch(level, k - 1);
        twists += 2;
    }
    // Where neighbours on both sides are the same node, or the node itself.
    let (bends, twists) = match level.nodes {
        1 => (0, 0),
        2 => (8, twists),
        _ => (6, twists),
    };
    arches as f32 * level.along + bends as f32 * level.around + twists as f32 * level.twist
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::wall::passes::{WallParameters, bending};

    #[test]
    fn the_diagonal_is_what_a_node_pulls_itself_with() {
        for (rings, nodes) in [(3, 1), (4, 1), (9, 1), (3, 2), (7, 2), (3, 3), (5, 4), (6, 9)] {
            let parameters = WallParameters::new([rings, nodes], [1.3, 0.9], 5.0, 0.1);
            let level = parameters.with_smoothness(2.0).finest();
            for node in 0..level.count as usize {
                let mut x = vec![0.0; level.count as usize];
                x[node] = 1.0;
                let (k, j) = (node / nodes as usize, node % nodes as usize);
                let expected = bending(&level, &x, k, j);
                let found = diagonal(&level, k as u32);
                assert!(
                    (found - expected).abs() <= 1e-5 * expected,
                    "{rings} x {nodes}, {node}: {found} {expected}"
                );
            }
        }
    }
}
