//! Sums in a fixed order (`shaders/sweep/common/sum.wgsl`).

/// The sum of a workgroup's numbers. Their count is a power of two.
pub fn sum_of_workgroup(addends: &mut [f32]) -> f32 {
    let mut half = addends.len() / 2;
    while half > 0 {
        let (left, right) = addends.split_at_mut(half);
        left.iter_mut().zip(right).for_each(|(a, b)| *a += *b);
        half /= 2;
    }
    addends[0]
}

/// The sums of workgroups of 256.
pub(super) fn partial_sums(addends: impl Iterator<Item = f32>) -> Vec<f32> {
    let addends: Vec<f32> = addends.collect();
    addends
        .chunks(256)
        .map(|chunk| {
            let mut own = [0.0; 256];
            own[..chunk.len()].copy_from_slice(chunk);
            sum_of_workgroup(&mut own)
        })
        .collect()
}
