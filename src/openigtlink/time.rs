//! Times as messages carry them.

use std::time::SystemTime;

/// When a message was made: 2⁻³² s since 1970 in UTC; 0 where the sender does not say.
///
/// Whole numbers, because an f64 of today's seconds since 1970 has steps of 0.24 µs; differences within 24
/// days are exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Hash)]
pub struct Timestamp(pub u64);

/// A second.
const SECOND: f64 = 4_294_967_296.0;

impl Timestamp {
    /// The sender does not say.
    pub const UNKNOWN: Self = Self(0);

    /// Now, by the clock of this machine.
    pub fn now() -> Self {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Self((since.as_secs() << 32) | ((u64::from(since.subsec_nanos()) << 32) / 1_000_000_000))
    }

    /// From seconds since 1970; unknown where they are not above 0.
    pub fn from_s(seconds: f64) -> Self {
        Self((seconds * SECOND).round() as u64)
    }

    /// Seconds since 1970, rounded to an f64.
    pub fn to_s(self) -> f64 {
        self.0 as f64 / SECOND
    }

    /// Whether the sender says when.
    pub fn is_known(self) -> bool {
        self != Self::UNKNOWN
    }

    /// Seconds from another time to this one, negative where this is earlier.
    pub fn seconds_since(self, other: Self) -> f64 {
        (i128::from(self.0) - i128::from(other.0)) as f64 / SECOND
    }

    /// This time and so many seconds; at the ends of what can be said it stays there.
    #[must_use]
    pub fn plus_s(self, seconds: f64) -> Self {
        let shifted = i128::from(self.0) + i128::from((seconds * SECOND).round() as i64);
        Self(shifted.clamp(1, i128::from(u64::MAX)) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_lose_nothing() {
        let origin = Timestamp::from_s(1_700_000_000.25);
        assert_eq!(origin.0, (1_700_000_000 << 32) | (1 << 30));
        for fraction in [0, 1, 3, u64::from(u32::MAX), (86_400 << 32) | 12_345] {
            let later = Timestamp(origin.0 + fraction);
            assert_eq!(later.seconds_since(origin), fraction as f64 / SECOND);
            assert_eq!(origin.seconds_since(later), -(fraction as f64) / SECOND);
            assert_eq!(origin.plus_s(fraction as f64 / SECOND), later);
        }
        assert_eq!(Timestamp::from_s(-1.0), Timestamp::UNKNOWN);
        assert_eq!(Timestamp::from_s(f64::NAN), Timestamp::UNKNOWN);
        assert!((Timestamp::now().to_s() - origin.to_s()) > 0.0);
    }
}
