//! The transpose of interpolation (`shaders/sweep/common/restricted.wgsl`).

use super::Level;
use super::transfer::{candidate, share_of, weight_of};

/// The values of a grid, shared out among the nodes of a coarser one: what node j of its ring k gets.
pub(super) fn restricted(
    fine: &Level,
    coarse: &Level,
    fine_value: impl Fn(usize) -> f32,
    k: u32,
    j: u32,
) -> f32 {
    let weight_of_node = |u: u32| match candidate(u, j, fine.nodes, coarse.nodes, true) {
        node if node == fine.nodes => 0.0,
        node => weight_of(j, share_of(node, fine.nodes, coarse.nodes, true)),
    };
    let weights = [0, 1, 2, 3].map(weight_of_node);
    let mut sum = 0.0;
    for t in 0..4 {
        let ring = candidate(t, k, fine.rings, coarse.rings, false);
        if ring == fine.rings {
            continue;
        }
        let of_ring = weight_of(k, share_of(ring, fine.rings, coarse.rings, false));
        if of_ring == 0.0 {
            continue;
        }
        let mut row = 0.0;
        for (u, weight) in (0..).zip(weights).filter(|(_, weight)| *weight != 0.0) {
            let node = candidate(u, j, fine.nodes, coarse.nodes, true);
            row += weight * fine_value((ring * fine.nodes + node) as usize);
        }
        sum += of_ring * row;
    }
    sum
}
