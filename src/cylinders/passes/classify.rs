//! The faces with many points.

/// The faces with more than `max_short` points, in ascending order; the device lists them in any order.
pub fn classify(offsets: &[u32], max_short: u32) -> Vec<u32> {
    let faces = (0..).zip(offsets.windows(2));
    faces.filter(|(_, ends)| ends[1] - ends[0] > max_short).map(|(face, _)| face).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_is_long_only_above_the_bound() {
        assert_eq!(classify(&[0, 4, 9, 9, 13, 20], 4), [1, 4]);
        assert!(classify(&[0], 4).is_empty());
    }
}
