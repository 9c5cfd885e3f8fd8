//! Results that rounding decides.
//!
//! A point on the edge between two triangles, on the gate or on a fence may fall on either side where a device rounds
//! or fuses in its own way, and a whole node moves with it. Such a result differs from the twin's for no fault of the
//! device. It is told from a fault by the twin itself: its inputs are moved by a few roundings, again and again, and a
//! difference is explained only where one of these runs differs from the first as well.

use crate::sections::seeded;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Runs with moved inputs. Of those whose size reaches over a boundary half fall on its other side.
const RUNS: u64 = 36;
/// Roundings by which inputs are moved at most, run by run.
const ROUNDINGS: [f64; 6] = [2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// Moves numbers by a few roundings.
pub struct Nudge {
    random: ChaCha8Rng,
    roundings: f64,
}

impl Nudge {
    /// One of all the runs.
    pub fn new(seed: u64) -> Self {
        Self { random: seeded(1000 + seed), roundings: ROUNDINGS[seed as usize % ROUNDINGS.len()] }
    }

    /// The number, moved by some roundings of a number of that size.
    pub fn of(&mut self, number: f32, size: f64) -> f32 {
        let by = self.random.random_range(-1.0..1.0) * self.roundings * 2.0_f64.powi(-24) * size;
        (f64::from(number) + by) as f32
    }
}

/// The runs.
pub fn nudges() -> impl Iterator<Item = Nudge> {
    (0..RUNS).map(Nudge::new)
}
