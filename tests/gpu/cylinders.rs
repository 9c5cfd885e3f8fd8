//! Whole cylinders compared.

use crate::device::Device;
use lumenmesh::cylinders::{DeformedTube, FittedCylinder};

/// A tube's numbers in a form whose equality is that of bits: NaN equals itself, 0 is not -0.
fn bits(tube: &DeformedTube) -> Vec<Vec<u64>> {
    let of = |numbers: &[f64]| numbers.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
    let mut all = vec![of(&tube.radii_mm), of(&tube.travel_mm), of(&tube.residual_mm)];
    all.push(tube.support.iter().map(|&n| u64::from(n)).collect());
    all.push(vec![tube.points, tube.gated, tube.rejected]);
    all.extend(tube.history_mm.iter().map(|radii| of(radii)));
    all
}

/// Equal to the last bit.
pub fn assert_same(found: &DeformedTube, expected: &DeformedTube) {
    assert_eq!(found.tube, expected.tube);
    assert!(bits(found) == bits(expected), "found {found:?}\nexpected {expected:?}");
}

/// Equal to the bit on an exact device. Elsewhere a decision that falls the other way in one iteration moves
/// nodes, so radii are compared by their distribution: the mean of |Δr| is rounding and a few such nodes.
pub fn assert_agree(device: &Device, found: &DeformedTube, expected: &DeformedTube) {
    if device.exact {
        return assert_same(found, expected);
    }
    assert_eq!((found.points, found.gated), (expected.points, expected.gated));
    let count = expected.radii_mm.len() as f64;
    let mean = found.radii_mm.iter().zip(&expected.radii_mm).map(|(a, b)| (a - b).abs()).sum::<f64>() / count;
    assert!(mean <= 1e-3, "mean |Δr| {mean} mm");
}

/// [`assert_agree`] for the cylinders of a request.
pub fn assert_all_agree(device: &Device, found: &[FittedCylinder], expected: &[FittedCylinder]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!((found.frame, found.world_from_cylinder), (expected.frame, expected.world_from_cylinder));
        assert_agree(device, &found.tube, &expected.tube);
    }
}

#[test]
fn one_ulp_in_one_radius_is_not_the_same() {
    let tube = lumenmesh::cylinders::Tube { nodes: 3, levels: 1, height_mm: 1.0 };
    let mut cylinder = DeformedTube::primitive(tube, 1.0);
    cylinder.travel_mm = vec![0.5];
    cylinder.support = vec![3; 6];
    (cylinder.points, cylinder.rejected) = (9, 1);
    assert_same(&cylinder, &cylinder);
    let mut off = cylinder.clone();
    off.radii_mm[2] = off.radii_mm[2].next_up();
    assert!(bits(&off) != bits(&cylinder));
    let mut off = cylinder.clone();
    off.support.swap(0, 1);
    off.support[0] += 1;
    assert!(bits(&off) != bits(&cylinder));
}
