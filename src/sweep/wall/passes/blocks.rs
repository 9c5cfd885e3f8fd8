//! The preconditioner's systems along the axis, one for each wave, in blocks of rings
//! (`shaders/sweep/common/blocks.wgsl`, `eliminate`, `couple`, `substitute`).
//!
//! Each couples a ring to the two before and the two behind. The first two rings of every block but the first are its
//! joints: without them the blocks are apart, so that all go forward and back at the same time, and only the joints, two
//! a block, are left to be gone through one after the other. The factors are those of `LDLᵀ` in that order.

use super::Job;

/// The factors of all systems, frequency by frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Factors {
    /// Five planes of a number for each ring and frequency: 1/D, and the factors of the next ring, of the one behind it,
    /// of the first joint and of the second joint of the block.
    pub rings: Vec<f32>,
    /// Per joint and frequency: 1/D, and the factors of the three joints behind it.
    pub joints: Vec<[f32; 4]>,
}

impl Factors {
    /// Nothing yet: numbers for each ring, joint and frequency.
    pub fn zeroed(job: &Job) -> Self {
        let (rings, blocks, frequencies) = (job.rings as usize, job.blocks as usize, frequency_count(job));
        Self {
            rings: vec![0.0; 5 * rings * frequencies],
            joints: vec![[0.0; 4]; 2 * (blocks - 1) * frequencies],
        }
    }

    fn at(&self, job: &Job, part: usize, ring: usize, frequency: usize) -> f32 {
        self.rings[(part * job.rings as usize + ring) * frequency_count(job) + frequency]
    }
}

/// Frequencies about the axis.
pub(in crate::sweep) fn frequency_count(job: &Job) -> usize {
    job.nodes as usize / 2 + 1
}

/// Coefficients c and N - c of a Hartley transform are of one frequency.
fn frequency_of(job: &Job, wave: usize) -> usize {
    wave.min(job.nodes as usize - wave)
}

/// The inside of a block.
fn inside(job: &Job, block: usize) -> std::ops::Range<usize> {
    let (blocks, rings) = (job.blocks as usize, job.block_rings as usize);
    let first = block * rings + if block == 0 { 0 } else { 2 };
    let end = if block + 1 == blocks { job.rings as usize } else { (block + 1) * rings };
    first..end
}

/// Forward through the inside of each block: returns, per block and wave, what its rings pull at the two joints before it
/// and the two behind it.
pub fn eliminate(job: &Job, factors: &Factors, spectrum: &mut [f32]) -> Vec<[f32; 4]> {
    let nodes = job.nodes as usize;
    (0..job.blocks as usize * nodes)
        .map(|index| {
            let (block, wave) = (index / nodes, index % nodes);
            let frequency = frequency_of(job, wave);
            let (mut next, mut next_but_one, mut first, mut second) = (0.0, 0.0, 0.0, 0.0);
            for ring in inside(job, block) {
                let factor = |part: usize| factors.at(job, part, ring, frequency);
                let x = spectrum[ring * nodes + wave] - next;
                spectrum[ring * nodes + wave] = x;
                next = next_but_one + factor(1) * x;
                next_but_one = factor(2) * x;
                first += factor(3) * x;
                second += factor(4) * x;
            }
            [first, second, next, next_but_one]
        })
        .collect()
}

/// The joints: forward through all of them, and back.
pub fn couple(job: &Job, factors: &Factors, pulls: &[[f32; 4]], spectrum: &mut [f32]) {
    let nodes = job.nodes as usize;
    let count = 2 * (job.blocks as usize - 1);
    for wave in 0..nodes {
        let frequency = frequency_of(job, wave);
        let place = |joint: usize| ((joint / 2 + 1) * job.block_rings as usize + joint % 2) * nodes + wave;
        let row = |joint: usize| factors.joints[joint * frequency_count(job) + frequency];
        // What those before pull at the next three.
        let mut pull = [0.0; 3];
        for joint in 0..count {
            let block = joint / 2;
            let behind = pulls[block * nodes + wave];
            let ahead = pulls[(block + 1) * nodes + wave];
            let of_blocks = if joint % 2 == 1 { behind[3] + ahead[1] } else { behind[2] + ahead[0] };
            let x = (spectrum[place(joint)] - of_blocks) - pull[0];
            spectrum[place(joint)] = x;
            let [_, a, b, c] = row(joint);
            pull = [pull[1] + a * x, pull[2] + b * x, c * x];
        }
        let mut known = [0.0; 3];
        for joint in (0..count).rev() {
            let [inverse, a, b, c] = row(joint);
            let x = spectrum[place(joint)] * inverse - a * known[0] - b * known[1] - c * known[2];
            spectrum[place(joint)] = x;
            known = [x, known[0], known[1]];
        }
    }
}

/// Back through the inside of each block, its joints being known.
pub fn substitute(job: &Job, factors: &Factors, spectrum: &mut [f32]) {
    let nodes = job.nodes as usize;
    for index in 0..job.blocks as usize * nodes {
        let (block, wave) = (index / nodes, index % nodes);
        let frequency = frequency_of(job, wave);
        let joints = |ring: usize| (spectrum[ring * nodes + wave], spectrum[(ring + 1) * nodes + wave]);
        let inside = inside(job, block);
        let (first, second) = if block > 0 { joints(block * job.block_rings as usize) } else { (0.0, 0.0) };
        let (mut next, mut next_but_one) =
            if block + 1 < job.blocks as usize { joints(inside.end) } else { (0.0, 0.0) };
        for ring in inside.rev() {
            let factor = |part: usize| factors.at(job, part, ring, frequency);
            let x = spectrum[ring * nodes + wave] * factor(0)
                - factor(1) * next
                - factor(2) * next_but_one
                - factor(3) * first
                - factor(4) * second;
            spectrum[ring * nodes + wave] = x;
            (next, next_but_one) = (x, next);
        }
    }
}
