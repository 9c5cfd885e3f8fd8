//! Interpolation from a coarser grid (`shaders/sweep/common/interpolated.wgsl`).

use super::Level;
use super::transfer::share_of;

/// The value of a coarser grid at node j of ring k of a finer one.
pub(super) fn interpolated(fine: &Level, coarse: &Level, values: &[f32], k: u32, j: u32) -> f32 {
    let ring = share_of(k, fine.rings, coarse.rings, false);
    let node = share_of(j, fine.nodes, coarse.nodes, true);
    let value = |ring: u32, node: u32| values[(ring * coarse.nodes + node) as usize];
    let (a0, b0) = (value(ring.below, node.below), value(ring.above, node.below));
    let a = a0 + node.part * (value(ring.below, node.above) - a0);
    let b = b0 + node.part * (value(ring.above, node.above) - b0);
    a + ring.part * (b - a)
}
