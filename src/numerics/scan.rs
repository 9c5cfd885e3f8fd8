//! Prefix sums.

/// Replaces every value by the sum of those up to and including it, modulo 2³². Twin: `shaders/common/scan.wgsl`.
pub fn inclusive_scan(values: &mut [u32]) {
    let mut sum = 0_u32;
    for value in values {
        sum = sum.wrapping_add(*value);
        *value = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prefix_sum_includes_its_own_value() {
        let mut values = [3, 0, 4, 1];
        inclusive_scan(&mut values);
        assert_eq!(values, [3, 3, 7, 8]);
        inclusive_scan(&mut []);
    }
}
