//! Mutated copies of valid inputs.

use rand::seq::IndexedRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// A file that holds one input after the other, in memory where the system has a folder for that.
pub struct File {
    path: PathBuf,
    _folder: tempfile::TempDir,
}

impl File {
    pub fn new(name: &str) -> Self {
        let in_memory = Path::new("/dev/shm");
        let folder = if in_memory.is_dir() { tempfile::tempdir_in(in_memory) } else { tempfile::tempdir() };
        let folder = folder.unwrap();
        Self { path: folder.path().join(name), _folder: folder }
    }

    /// The file's path, once it holds these bytes.
    pub fn holding(&self, bytes: &[u8]) -> &Path {
        std::fs::write(&self.path, bytes).unwrap();
        &self.path
    }
}

/// How many inputs each reader is given.
pub fn inputs() -> u64 {
    std::env::var("LUMENMESH_FUZZ_INPUTS").ok().map_or(2_000, |n| n.parse().unwrap())
}

/// Gives `read` mutated copies of the seeds, one after the other.
///
/// `tokens` are pieces that mean something to the format: keywords, separators, numbers at the edge of their type.
///
/// # Panics
/// With the input's number where `read` panics. Returns how many inputs `read` accepted, so that a caller can assert that
/// some were read and some refused.
pub fn fuzz(seeds: &[Vec<u8>], tokens: &[&[u8]], read: impl Fn(&[u8]) -> bool) -> u64 {
    (0..inputs()).filter(|&number| one(seeds, tokens, number, &read)).count() as u64
}

/// Gives `read` the input of that number.
pub fn one(seeds: &[Vec<u8>], tokens: &[&[u8]], number: u64, read: &impl Fn(&[u8]) -> bool) -> bool {
    let input = mutated(seeds, tokens, number);
    catch_unwind(AssertUnwindSafe(|| read(&input))).unwrap_or_else(|_| {
        let start = String::from_utf8_lossy(&input[..input.len().min(400)]).into_owned();
        panic!("input {number} ({} bytes) panics; it starts with {start:?}", input.len())
    })
}

/// The input of that number: a seed with one to eight mutations.
pub fn mutated(seeds: &[Vec<u8>], tokens: &[&[u8]], number: u64) -> Vec<u8> {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let mut bytes = seeds.choose(&mut random).unwrap().clone();
    for _ in 0..random.random_range(1..=8) {
        mutate(&mut bytes, tokens, &mut random);
    }
    bytes
}

fn mutate(bytes: &mut Vec<u8>, tokens: &[&[u8]], random: &mut impl Rng) {
    /// Values at the edge of something, as one, two, four or eight bytes.
    const EDGES: [u64; 9] =
        [0, 1, 0x7f, 0x80, 0xff, 0x7fff_ffff, 0xffff_ffff, 0x7ff8_0000_0000_0000, u64::MAX];
    let at = random.random_range(0..=bytes.len());
    let length = random.random_range(0..=(bytes.len() - at).min(64));
    match random.random_range(0..9) {
        0 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
        1 if at < bytes.len() => bytes[at] = random.random(),
        2 => bytes.truncate(at),
        3 => drop(bytes.drain(at..at + length)),
        4 => {
            let copy = bytes[at..at + length].to_vec();
            let to = random.random_range(0..=bytes.len());
            bytes.splice(to..to, copy);
        }
        5 | 6 => {
            if let Some(token) = tokens.choose(random) {
                let end = if random.random() { at } else { at + length };
                bytes.splice(at..end, token.iter().copied());
            }
        }
        7 => {
            let edge = EDGES.choose(random).unwrap().to_le_bytes();
            let width = [1, 2, 4, 8].choose(random).copied().unwrap().min(bytes.len() - at);
            bytes[at..at + width].copy_from_slice(&edge[..width]);
        }
        _ => {
            let other = random.random_range(0..=bytes.len());
            if other < bytes.len() && at < bytes.len() {
                bytes.swap(at, other);
            }
        }
    }
}
