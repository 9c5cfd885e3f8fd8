//! A periodic motion of a vessel, as a Fourier series.

use glam::DVec3;
use serde::Serialize;
use std::f64::consts::TAU;

/// Harmonics of a cycle.
pub(super) const HARMONICS: usize = 2;
/// Waves of a cycle: a cosine and a sine of each harmonic.
pub(super) const WAVES: usize = 2 * HARMONICS;
/// What a wave moves: the place in x, y and z of the world, mm, and the size, as a share of the radius.
pub(super) const PARTS: usize = 4;
/// Phases at which a cycle is looked at.
const PHASES: usize = 64;
/// A vessel rests where it stays within this share of its way.
const REST_SHARE: f64 = 0.15;

/// Place and size of a vessel, in mm along x, y and z and as a share of its radius: how far it is from the mean of a cycle.
pub(super) type State = [f64; PARTS];

/// When the frames of a recording were taken.
pub(super) struct Clock {
    /// About the middle of the recording, s.
    pub times_s: Vec<f64>,
    /// Their phases, where the recording has them.
    pub phases: Option<Vec<f64>>,
}

impl Clock {
    /// The phase of a cycle in a frame, and what a cycle more over the whole recording adds to it.
    pub fn phase(&self, rhythm: &Rhythm, frame: usize) -> [f64; 2] {
        match &self.phases {
            Some(phases) if rhythm.is_given => [phases[frame], 0.0],
            _ => [rhythm.frequency_hz * self.times_s[frame], self.times_s[frame] / self.span_s()],
        }
    }

    /// The phase from which those that are reported count, and the same of it.
    pub fn start(&self, rhythm: &Rhythm) -> [f64; 2] {
        if rhythm.is_given { [0.0; 2] } else { self.phase(rhythm, 0) }
    }

    /// The time from the first to the last frame, s.
    pub fn span_s(&self) -> f64 {
        self.times_s.last().zip(self.times_s.first()).map_or(0.0, |(last, first)| last - first)
    }

    /// The cycle whose phases the recording has.
    pub fn given(&self) -> Option<Rhythm> {
        let turns = |pair: &[f64]| (pair[1] - pair[0]).rem_euclid(1.0);
        let cycles: f64 = self.phases.as_ref()?.windows(2).map(turns).sum();
        Some(Rhythm::new(cycles / self.span_s(), true))
    }
}

/// A periodic motion of the vessel, which carries the catheter along, or of the lumen's size.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Cycle {
    /// Whether the recording has its phases; otherwise its frequency was estimated.
    pub has_phases: bool,
    /// Its frequency, Hz; of phases in the recording their mean rate.
    pub frequency_hz: f64,
    /// Standard error of that, Hz; 0 of phases in the recording.
    pub frequency_standard_error_hz: f64,
    /// How far apart the two places are that lie farthest from each other, mm; 0 where no motion was significant.
    pub way_mm: f64,
    /// Standard error of that, mm.
    pub way_standard_error_mm: f64,
    /// By how much the lumen's radius is larger at its largest than at its smallest, as a share of its mean; 0 where no change
    /// was significant.
    pub size_change: f64,
    /// Standard error of that.
    pub size_change_standard_error: f64,
    /// How far the farthest place of the cycle lies from the one that is shown, mm.
    pub farthest_mm: f64,
    /// By how much the lumen's radius differs at most from the one that is shown, as a share of its mean.
    pub largest_difference: f64,
    /// The phase at which the vessel rests longest, in cycles, 0 in the first frame or where the recording's phases are: about it the vessel stays within
    /// 0.15 of its way for the largest share of the cycle. Of two that are equally long it is that nearer to the state at phase 0.
    pub rest_phase: f64,
    /// The Fourier series over that phase: of each harmonic the factors of cosine and sine,
    /// for the place in x, y and z of the world, mm, and the size, as a share of the radius.
    pub harmonics: [[[f64; PARTS]; 2]; HARMONICS],
}

/// A cycle while it is estimated.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rhythm {
    /// Whether the recording has its phases.
    pub is_given: bool,
    pub frequency_hz: f64,
    pub waves: [State; WAVES],
    /// Whether the place moves, and whether the size changes.
    pub moves: bool,
    pub beats: bool,
}

/// Cosine and sine of each harmonic, and their derivatives by the phase, at a phase in cycles.
pub(super) fn waves_at(phase: f64) -> [[f64; 2]; WAVES] {
    std::array::from_fn(|wave| {
        let turns = TAU * (wave / 2 + 1) as f64;
        let (sin, cos) = (turns * phase).sin_cos();
        if wave % 2 == 0 { [cos, -turns * sin] } else { [sin, turns * cos] }
    })
}

impl Rhythm {
    pub fn new(frequency_hz: f64, is_given: bool) -> Self {
        Self { is_given, frequency_hz, waves: [[0.0; PARTS]; WAVES], moves: true, beats: true }
    }

    /// The state at a phase, and its derivative by that.
    pub fn at(&self, phase: f64) -> [State; 2] {
        let waves = waves_at(phase);
        [0, 1].map(|order| {
            std::array::from_fn(|part| self.waves.iter().zip(&waves).map(|(w, b)| w[part] * b[order]).sum())
        })
    }

    /// The state at a phase.
    fn of_phase(&self, phase: f64) -> State {
        self.at(phase)[0]
    }

    /// Whether a part of the state moves.
    pub fn is_free(&self, part: usize) -> bool {
        if part < 3 { self.moves } else { self.beats }
    }

    fn places(&self) -> Vec<State> {
        (0..PHASES).map(|k| self.of_phase(k as f64 / PHASES as f64)).collect()
    }

    /// The phases between which place and size differ most.
    pub fn extremes(&self) -> [[f64; 2]; 2] {
        let states = self.places();
        let between = |distance: &dyn Fn(&State, &State) -> f64| {
            let mut best = (0.0, [0.0; 2]);
            for (j, a) in states.iter().enumerate() {
                for (k, b) in states.iter().enumerate().skip(j + 1) {
                    let distance = distance(a, b);
                    if distance > best.0 {
                        best = (distance, [j, k].map(|k| k as f64 / PHASES as f64));
                    }
                }
            }
            best.1
        };
        [between(&apart_mm), between(&|a, b| (a[3] - b[3]).abs())]
    }

    /// The way between the places that lie farthest apart, mm, and the largest change of the size.
    pub fn ways(&self) -> [f64; 2] {
        let [place, size] = self.extremes();
        let [a, b] = place.map(|phase| self.of_phase(phase));
        let [c, d] = size.map(|phase| self.of_phase(phase)[3]);
        [apart_mm(&a, &b), (c - d).abs()]
    }

    /// How far place and size differ at most from a state.
    pub fn farthest(&self, from: &State) -> [f64; 2] {
        self.places().iter().fold([0.0; 2], |[place, size], state| {
            [f64::max(place, apart_mm(state, from)), f64::max(size, (state[3] - from[3]).abs())]
        })
    }

    /// The phase about which the vessel stays longest, the one nearer to the state at `start` if two are alike.
    pub fn rest_phase(&self, start: f64) -> f64 {
        let states = self.places();
        let from = self.of_phase(start);
        // A size counts as a place where the place does not change.
        let distance = |a: &State, b: &State| if self.moves { apart_mm(a, b) } else { (a[3] - b[3]).abs() };
        let way = states.iter().flat_map(|a| states.iter().map(|b| distance(a, b))).fold(0.0, f64::max);
        let stay =
            |state: &State| states.iter().filter(|other| distance(state, other) <= REST_SHARE * way).count();
        let longest = states.iter().map(stay).max().unwrap_or(0);
        // Phases are looked at in steps: a difference of two is none.
        let rest = (0..PHASES).filter(|&k| stay(&states[k]) + 2 >= longest);
        let nearest =
            rest.min_by(|&a, &b| distance(&states[a], &from).total_cmp(&distance(&states[b], &from)));
        (nearest.unwrap_or(0) as f64 / PHASES as f64 - start).rem_euclid(1.0)
    }

    /// The Fourier series over the phase from `start` on.
    pub fn harmonics_from(&self, start: f64) -> [[[f64; PARTS]; 2]; HARMONICS] {
        std::array::from_fn(|harmonic| {
            let (sin, cos) = (TAU * (harmonic + 1) as f64 * start).sin_cos();
            let [a, b] = [0, 1].map(|i| self.waves[2 * harmonic + i]);
            [
                std::array::from_fn(|part| a[part] * cos + b[part] * sin),
                std::array::from_fn(|part| b[part] * cos - a[part] * sin),
            ]
        })
    }
}

/// The distance of two places, mm.
fn apart_mm(a: &State, b: &State) -> f64 {
    place_mm(a).distance(place_mm(b))
}

/// The place of a state, mm.
pub(super) fn place_mm(state: &State) -> DVec3 {
    DVec3::new(state[0], state[1], state[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_is_the_same_from_another_phase() {
        let waves = std::array::from_fn(|w| std::array::from_fn(|p| (3.0 * w as f64 + p as f64).sin()));
        let rhythm = Rhythm { waves, ..Rhythm::new(0.8, false) };
        let turned =
            Rhythm { waves: *rhythm.harmonics_from(0.3).as_flattened().first_chunk().unwrap(), ..rhythm };
        for phase in [0.0, 0.17, 0.5, 0.93] {
            let (a, b) = (rhythm.of_phase(0.3 + phase), turned.of_phase(phase));
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12), "{phase}: {a:?} {b:?}");
            let step = 1e-6;
            let [_, slope] = rhythm.at(phase);
            let [after, before] = [step, -step].map(|step| rhythm.of_phase(phase + step));
            for part in 0..PARTS {
                let difference = (after[part] - before[part]) / (2.0 * step);
                assert!((slope[part] - difference).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_vessel_rests_where_it_stays_longest() {
        // Of a breath with a long end-expiration: cos φ + cos 2φ/4 is flat about half a cycle.
        let mut rhythm = Rhythm::new(0.25, false);
        rhythm.waves[0][1] = 4.0;
        rhythm.waves[2][1] = 1.0;
        for start in [0.0, 0.1, 0.6] {
            let rest = rhythm.rest_phase(start);
            // From the one end to the other it goes 8 mm.
            let from_end_mm = apart_mm(&rhythm.of_phase(rest + start), &rhythm.of_phase(0.5));
            assert!(from_end_mm <= REST_SHARE * 8.0, "{rest}: {from_end_mm}");
        }
        let [place, size] = rhythm.extremes();
        assert!((place[0] - place[1]).abs() > 0.3 && size == [0.0; 2], "{place:?}");
        // A sine stays as long at either end: the nearer one counts.
        let mut sine = Rhythm::new(1.2, false);
        sine.waves[0][0] = 1.0;
        assert!(sine.rest_phase(0.05).min(1.0 - sine.rest_phase(0.05)) < 0.1);
        let farthest = sine.farthest(&sine.of_phase(0.0));
        assert!((farthest[0] - 2.0).abs() < 1e-12 && farthest[1] == 0.0);
    }
}
