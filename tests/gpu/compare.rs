//! Comparers of what a device wrote with what its twin computed, and proof that each of them can fail.
//!
//! Each first checks that the device wrote the buffer at all: a buffer that is as it was before the pass proves
//! nothing, whatever it holds.

use crate::device::Readback;

/// The device wrote something, as much as is expected, and nothing behind it.
fn written(found: &Readback, count: usize) -> Result<(), String> {
    if found.words.len() < count {
        return Err(format!("{} words, expected {count}", found.words.len()));
    }
    if count > 0 && found.words[..count] == found.before[..count] {
        return Err("the device did not write these data".into());
    }
    match (count..found.words.len()).find(|&i| found.words[i] != found.before[i]) {
        Some(i) => Err(format!("the device wrote behind the end: word {i} of {count}")),
        None => Ok(()),
    }
}

/// Integers: equal on every device.
pub fn integers(found: &Readback, expected: &[u32]) -> Result<(), String> {
    written(found, expected.len())?;
    match (0..expected.len()).find(|&i| found.words[i] != expected[i]) {
        Some(i) => Err(format!("word {i}: found {:#x}, expected {:#x}", found.words[i], expected[i])),
        None => Ok(()),
    }
}

/// How far numbers may be apart.
#[derive(Clone, Copy)]
pub enum Tolerance {
    /// Not at all.
    Bits,
    /// That many roundings of the largest operand, whose size is the second number.
    Roundings(f64, f64),
}

impl Tolerance {
    /// Bits on an exact device; elsewhere `roundings` times 2⁻²⁴ times `scale`.
    pub fn of(exact: bool, roundings: f64, scale: f64) -> Self {
        if exact { Tolerance::Bits } else { Tolerance::Roundings(roundings, scale) }
    }

    pub fn allows(self, found: f32, expected: f32) -> bool {
        match self {
            Tolerance::Bits => found.to_bits() == expected.to_bits(),
            Tolerance::Roundings(count, scale) => {
                (f64::from(found) - f64::from(expected)).abs() <= count * 2.0_f64.powi(-24) * scale
            }
        }
    }
}

/// Numbers: within a tolerance.
pub fn numbers(found: &Readback, expected: &[f32], tolerance: Tolerance) -> Result<(), String> {
    written(found, expected.len())?;
    match (0..expected.len()).find(|&i| !tolerance.allows(f32::from_bits(found.words[i]), expected[i])) {
        Some(i) => {
            Err(format!("number {i}: found {:e}, expected {:e}", f32::from_bits(found.words[i]), expected[i]))
        }
        None => Ok(()),
    }
}

/// Value, count and residual, as of `TriangleStatistic`.
pub type Entry = (f32, u32, f32);

/// Whether two entries are alike: equal counts, and numbers within a tolerance.
pub fn entries_alike(found: Entry, expected: Entry, tolerance: Tolerance) -> bool {
    found.1 == expected.1 && tolerance.allows(found.0, expected.0) && tolerance.allows(found.2, expected.2)
}

/// Results of decisions: an entry may be another one only where `is_explained` says that rounding decides about it, and
/// not in more than a twentieth of all. `None` must not have been written.
pub fn decisions(
    found: &Readback,
    expected: &[Option<Entry>],
    tolerance: Tolerance,
    is_explained: &dyn Fn(usize, Entry) -> bool,
) -> Result<(), String> {
    written(found, 3 * expected.len())?;
    let mut flipped = 0;
    for (i, expected) in expected.iter().enumerate() {
        let words = &found.words[3 * i..3 * i + 3];
        let Some(expected) = *expected else {
            match words == &found.before[3 * i..3 * i + 3] {
                true => continue,
                false => return Err(format!("entry {i} was written")),
            }
        };
        let found = (f32::from_bits(words[0]), words[1], f32::from_bits(words[2]));
        if !entries_alike(found, expected, tolerance) {
            if !is_explained(i, found) {
                return Err(format!("entry {i}: found {found:?}, expected {expected:?}"));
            }
            flipped += 1;
        }
    }
    let most = 2 + expected.len() / 20;
    match flipped <= most {
        true => Ok(()),
        false => Err(format!("{flipped} entries of {} differ, {most} may", expected.len())),
    }
}

/// The groups of all, then their places: whatever the order in which the device gave these, those of each group are
/// 0, 1, 2, … once each.
pub fn places(found: &Readback, group_of_each: &[u32], groups: usize) -> Result<(), String> {
    written(found, 2 * group_of_each.len())?;
    let mut taken = vec![Vec::new(); groups];
    for (i, &group) in group_of_each.iter().enumerate() {
        let [of, place] = [found.words[i], found.words[group_of_each.len() + i]];
        if of != group {
            return Err(format!("point {i}: face {of}, expected {group}"));
        }
        if let Some(taken) = taken.get_mut(group as usize) {
            taken.push(place);
        }
    }
    for (group, mut taken) in taken.into_iter().enumerate() {
        taken.sort_unstable();
        if let Some(place) = taken.iter().zip(0..).position(|(found, expected)| *found != expected) {
            return Err(format!("face {group}: place {place} is missing or there twice"));
        }
    }
    Ok(())
}

mod controls {
    use super::*;
    use crate::device::{POISON, device};
    use lumenmesh::settings::Settings;

    /// What an honest device wrote, for tests of the comparers alone.
    fn wrote(words: &[u32]) -> Readback {
        Readback { before: vec![POISON; words.len()], words: words.to_vec() }
    }

    fn bits(numbers: &[f32]) -> Vec<u32> {
        numbers.iter().map(|x| x.to_bits()).collect()
    }

    const NUMBERS: [f32; 4] = [1.0, -2.5, 12.25, 0.0];

    #[test]
    fn equal_data_pass() {
        integers(&wrote(&[3, 1, 2]), &[3, 1, 2]).unwrap();
        numbers(&wrote(&bits(&NUMBERS)), &NUMBERS, Tolerance::Bits).unwrap();
        places(&wrote(&[0, 1, 0, POISON, 1, 0, 0, 0]), &[0, 1, 0, POISON], 2).unwrap();
        let entries = [Some((1.0, 3, 0.5)), None];
        let words = [1.0_f32.to_bits(), 3, 0.5_f32.to_bits(), POISON, POISON, POISON];
        decisions(&wrote(&words), &entries, Tolerance::Bits, NEVER).unwrap();
    }

    const NEVER: &dyn Fn(usize, Entry) -> bool = &|_, _| false;

    #[test]
    fn one_ulp_fails_where_bits_count() {
        for i in 0..NUMBERS.len() {
            let mut off = NUMBERS;
            off[i] = off[i].next_up();
            assert!(numbers(&wrote(&bits(&off)), &NUMBERS, Tolerance::Bits).is_err());
        }
        // 0 and -0 too.
        let negative_zero = [1.0, -2.5, 12.25, -0.0];
        assert!(numbers(&wrote(&bits(&negative_zero)), &NUMBERS, Tolerance::Bits).is_err());
        let words = [1.0_f32.to_bits(), 3, 0.5_f32.next_up().to_bits()];
        assert!(decisions(&wrote(&words), &[Some((1.0, 3, 0.5))], Tolerance::Bits, NEVER).is_err());
    }

    #[test]
    fn a_tolerance_holds_up_to_its_bound_and_no_further() {
        let step = 12.25_f32.next_up() - 12.25;
        let scale = f64::from(step) * 2.0_f64.powi(24);
        let two = Tolerance::Roundings(2.0, scale);
        let off = |steps: f32| wrote(&bits(&[12.25 + steps * step]));
        numbers(&off(2.0), &[12.25], two).unwrap();
        assert!(numbers(&off(3.0), &[12.25], two).is_err());
        assert!(numbers(&off(-3.0), &[12.25], two).is_err());
        assert!(numbers(&wrote(&bits(&[f32::NAN])), &[12.25], two).is_err());
    }

    #[test]
    fn two_swapped_fail() {
        assert!(integers(&wrote(&[3, 2, 1]), &[3, 1, 2]).is_err());
        let mut swapped = NUMBERS;
        swapped.swap(0, 1);
        assert!(numbers(&wrote(&bits(&swapped)), &NUMBERS, Tolerance::Roundings(64.0, 12.25)).is_err());
        // The faces of two points.
        assert!(places(&wrote(&[1, 0, 0, 0]), &[0, 1], 2).is_err());
        let entry = |value: f32| [value.to_bits(), 3, 0.5_f32.to_bits()];
        let words = [entry(2.0), entry(1.0)].concat();
        let expected = [Some((1.0, 3, 0.5)), Some((2.0, 3, 0.5))];
        assert!(decisions(&wrote(&words), &expected, Tolerance::Roundings(64.0, 2.0), NEVER).is_err());
    }

    #[test]
    fn a_place_given_twice_or_left_out_fails() {
        assert!(places(&wrote(&[0, 0, 0, 0]), &[0, 0], 1).is_err());
        assert!(places(&wrote(&[0, 0, 0, 2]), &[0, 0], 1).is_err());
    }

    #[test]
    fn decisions_are_explained_and_counted() {
        let entry = |count: u32| [1.0_f32.to_bits(), count, 0.5_f32.to_bits()];
        let words = [entry(3), entry(4), entry(5)].concat();
        let expected = [Some((1.0, 3, 0.5)), Some((9.0, 3, 0.5)), Some((9.0, 3, 0.5))];
        decisions(&wrote(&words), &expected, Tolerance::Bits, &|i, _| i > 0).unwrap();
        assert!(decisions(&wrote(&words), &expected, Tolerance::Bits, &|i, _| i > 1).is_err());
        // Another value with the same count is no less of a difference.
        let off = [entry(3), [8.0_f32.to_bits(), 3, 0.5_f32.to_bits()], entry(5)].concat();
        assert!(decisions(&wrote(&off), &expected, Tolerance::Bits, &|i, _| i == 2).is_err());
        let all = [entry(4); 3].concat();
        assert!(decisions(&wrote(&all), &expected, Tolerance::Bits, &|_, _| true).is_err());
    }

    #[test]
    fn a_word_that_was_not_written_fails_and_so_does_one_too_many() {
        assert!(integers(&wrote(&[3, POISON, 2]), &[3, 1, 2]).is_err());
        assert!(
            numbers(&wrote(&[1.0_f32.to_bits(), POISON]), &[1.0, 2.0], Tolerance::Roundings(1.0, 1e9))
                .is_err()
        );
        assert!(integers(&wrote(&[3, 1, 2]), &[3, 1]).is_err());
        let words = [1.0_f32.to_bits(), 3, 0.5_f32.to_bits()];
        assert!(decisions(&wrote(&words), &[None], Tolerance::Bits, NEVER).is_err());
    }

    /// The CPU's own result, put where the device's is looked for, by a pass that never writes there.
    #[test]
    fn data_of_the_cpu_passed_as_the_device_s_fail() {
        let Some(device) = device() else { return };
        let settings = Settings::default();
        let workspace = device.engine.prepare(100, 12.0, &settings).unwrap();
        let count = workspace.parameters().node_count as usize;
        let of_cpu: Vec<f32> = (0..count).map(|i| 12.0 + i as f32).collect();
        let bytes = bytemuck::cast_slice(&of_cpu);
        let [radii] = device.run(&workspace, "scan_spine", &[("radii", bytes)], ["radii"]);
        assert_eq!(radii.numbers()[..count], of_cpu);
        let message = numbers(&radii, &of_cpu, Tolerance::Bits).unwrap_err();
        assert!(message.contains("did not write"), "{message}");
        assert!(integers(&radii, &bits(&of_cpu)).unwrap_err().contains("did not write"));
        // And a pass that is not run at all leaves poison, not stale data.
        let [radii] = device.run(&workspace, "scan_spine", &[], ["radii"]);
        assert!(radii.words.iter().all(|&w| w == POISON));
        assert!(numbers(&radii, &of_cpu, Tolerance::Bits).is_err());
    }
}
