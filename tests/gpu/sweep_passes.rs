//! The passes of the sweep against their twins, each on inputs of its own.

use crate::compare::{Tolerance, integers, numbers};
use crate::device::{POISON, Readback};
use crate::sections::seeded;
use lumenmesh::low_level::sweep::gpu::{SweepEngine, Workspace};
use lumenmesh::low_level::sweep::passes::{self, Echo, Factors, Job, State};
use rand::RngExt;
use std::sync::OnceLock;

/// The sweep's engine on the device of these tests.
pub struct Device {
    pub engine: SweepEngine,
    /// As of [`crate::device::Device`].
    pub exact: bool,
}

/// The device, once for all tests; `None`, said loudly by [`crate::device::device`], where there is none.
pub fn device() -> Option<&'static Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let open = || {
        let exact = crate::device::device()?.exact;
        let engine = SweepEngine::new(std::env::var("LUMENMESH_ADAPTER").ok().as_deref()).unwrap();
        Some(Device { engine, exact })
    };
    DEVICE.get_or_init(open).as_ref()
}

impl Device {
    /// Runs one pass on given inputs and reads buffers back. Outputs that are not inputs too hold [`POISON`] before.
    fn run<const N: usize>(
        &self,
        workspace: &Workspace,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: [&str; N],
    ) -> [Readback; N] {
        let mut read = self.engine.run_pass(workspace, pass, inputs, &outputs).unwrap().into_iter();
        outputs.map(|name| {
            let words: Vec<u32> = bytemuck::pod_collect_to_vec(&read.next().unwrap());
            let mut before = vec![POISON; words.len()];
            for (_, bytes) in inputs.iter().filter(|(input, _)| *input == name) {
                before[..bytes.len() / 4].copy_from_slice(&bytemuck::pod_collect_to_vec::<u8, u32>(bytes));
            }
            Readback { before, words }
        })
    }
}

/// Grids about the 64 and 256 invocations of a workgroup and the blocks, one with a prime number of nodes: (rings, nodes).
const GRIDS: [(u32, u32); 7] = [(3, 8), (8, 9), (15, 64), (16, 67), (17, 100), (64, 256), (150, 130)];

/// A job on such a grid, with everything known.
pub fn job(rings: u32, nodes: u32) -> Job {
    let arc_mm = 2.0 * std::f64::consts::PI * 11.0 / f64::from(nodes);
    Job { feet: 1, gated: 1, enough: 1e-3, ..Job::new(rings, nodes, 11.0, 0.1) }
        .with_noise(0.7)
        .with_smoothness(31.0, 1.2 * arc_mm, arc_mm)
}

fn random(count: usize, range: std::ops::Range<f32>, seed: u64) -> Vec<f32> {
    let mut rng = seeded(seed);
    (0..count).map(|_| rng.random_range(range.clone())).collect()
}

/// A wall, and echoes all over it, some before its first ring, some beyond its last, some far off.
pub fn echoes(job: &Job, count: usize, seed: u64) -> (Vec<f32>, Vec<Echo>, Vec<[f32; 2]>) {
    let mut rng = seeded(seed);
    let wall = random(job.node_count as usize, -1.5..1.5, seed + 1);
    let echo = |_| {
        let mut normal = [0.0; 3].map(|_: f32| rng.random_range(-1.0_f32..1.0));
        let length = normal.iter().map(|x| x * x).sum::<f32>().sqrt();
        normal.iter_mut().for_each(|x| *x /= length);
        let far = if rng.random_range(0..20) == 0 { 6.0 } else { 1.0 };
        Echo {
            ring: rng.random_range(0..job.rings),
            ring_part: rng.random_range(0.0..1.0),
            node: rng.random_range(0..job.nodes),
            node_part: rng.random_range(0.0..1.0),
            rise: far * rng.random_range(-2.0..2.0),
            step: rng.random_range(0.5..0.9),
            normal,
        }
    };
    let echoes: Vec<Echo> = (0..count).map(echo).collect();
    let mut rng = seeded(seed + 2);
    let shifts = (0..count).map(|_| [0.0; 2].map(|_: f32| rng.random_range(-2.5..2.5))).collect();
    (wall, echoes, shifts)
}

fn bytes<T: bytemuck::Pod>(values: &[T]) -> &[u8] {
    bytemuck::cast_slice(values)
}

/// Counts of echoes about the 256 invocations of a workgroup and the 4096 of a block.
const COUNTS: [usize; 6] = [1, 255, 257, 4095, 4097, 20_000];

#[test]
fn measure_is_its_twin() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        for (count, feet) in [(1, 1), (257, 0), (20_000, 1)] {
            let job = Job { feet, ..job(rings, nodes) };
            let (wall, echoes, shifts) = echoes(&job, count, u64::from(rings));
            let workspace = device.engine.prepare(&job, &echoes).unwrap();
            let inputs = [("wall", bytes(&wall)), ("shifts", bytes(&shifts))];
            let [misses, feet_of] = device.run(&workspace, "measure", &inputs, ["misses", "shifts"]);
            let (expected, moved): (Vec<f32>, Vec<[f32; 2]>) =
                echoes.iter().zip(&shifts).map(|(e, s)| passes::measure(&job, e, &wall, *s)).unzip();
            let most = count / 500 + 1;
            few_apart(&misses.numbers()[..count], &expected, most).unwrap();
            few_apart(&feet_of.numbers()[..2 * count], moved.as_flattened(), 2 * most).unwrap();
            if !device.exact {
                continue;
            }
            numbers(&misses, &expected, Tolerance::Bits).unwrap();
            match feet {
                1 => numbers(&feet_of, moved.as_flattened(), Tolerance::Bits).unwrap(),
                _ => assert_eq!(feet_of.words, feet_of.before),
            }
        }
    }
}

/// What echoes make of a wall: a foot on an edge between triangles may be held against either, where the wall is the
/// same but its slope is not; all others are alike to some roundings of millimetres.
fn few_apart(found: &[f32], expected: &[f32], most: usize) -> Result<(), String> {
    let alike = |(a, b): &(&f32, &f32)| (*a - *b).abs() <= 1e-4 * (1.0 + b.abs());
    let apart = expected.len() - found.iter().zip(expected).filter(alike).count();
    (apart <= most).then_some(()).ok_or(format!("{apart} of {} are apart, {most} may be", expected.len()))
}

/// Fixed-point sums over echoes: each of them weighs ten at most and is off by some thirty roundings of that, or falls
/// on the other side of a gate or of an edge. Of the whole that is little.
fn sums_agree(found: &[i64], expected: &[i64]) -> Result<(), String> {
    let apart: f64 = found.iter().zip(expected).map(|(a, b)| (a - b).abs() as f64).sum();
    let whole: f64 = expected.iter().map(|s| s.abs() as f64).sum();
    let same = found.len() == expected.len() && apart <= 2e-3 * whole;
    same.then_some(()).ok_or(format!("{apart:e} of {whole:e} is elsewhere"))
}

#[test]
fn what_is_apart_is_told_from_what_is_alike() {
    let numbers = random(1000, -2.0..2.0, 21);
    few_apart(&numbers, &numbers, 0).unwrap();
    let mut off = numbers.clone();
    off[17] += 1e-3;
    few_apart(&off, &numbers, 1).unwrap();
    assert!(few_apart(&off, &numbers, 0).is_err());
    off[18] = f32::NAN;
    assert!(few_apart(&off, &numbers, 1).is_err());
    assert!(few_apart(&numbers[..990], &numbers, 5).is_err());
    assert!(few_apart(&vec![f32::from_bits(POISON); 1000], &numbers, 3).is_err());

    let sums: Vec<i64> = numbers.iter().map(|x| (x * 2.0_f32.powi(26)) as i64).collect();
    sums_agree(&sums, &sums).unwrap();
    let mut swapped = sums.clone();
    swapped.rotate_left(1);
    assert!(sums_agree(&swapped, &sums).is_err());
    // An echo in ten left out.
    let fewer: Vec<i64> = sums.iter().enumerate().map(|(i, &s)| if i % 10 == 0 { 0 } else { s }).collect();
    assert!(sums_agree(&fewer, &sums).is_err());
    assert!(sums_agree(&vec![-1; 1000], &sums).is_err());
}

#[test]
fn the_median_is_chosen_digit_by_digit() {
    let Some(device) = device() else { return };
    for (seed, count) in (0..).zip(COUNTS) {
        let job = job(8, 9);
        let (_, echoes, _) = echoes(&job, count, seed);
        let workspace = device.engine.prepare(&job, &echoes).unwrap();
        let mut misses = random(count, -3.0..3.0, seed);
        // Many alike, and some far smaller.
        misses.iter_mut().step_by(3).for_each(|x| *x = 0.25);
        misses.iter_mut().skip(1).step_by(5).for_each(|x| *x *= 1e-30);
        let mut state = State { rest: count as u32 / 2, ..State::default() };
        let mut counts = [0; 256];
        for _ in 0..4 {
            let inputs = [
                ("misses", bytes(&misses)),
                ("state", bytemuck::bytes_of(&state)),
                ("counts", bytes(&counts)),
            ];
            let [counted] = device.run(&workspace, "count_misses", &inputs, ["counts"]);
            passes::count_misses(&misses, &state, &mut counts);
            integers(&counted, &counts).unwrap();

            let inputs = [("state", bytemuck::bytes_of(&state)), ("counts", bytes(&counts))];
            let [picked, cleared] = device.run(&workspace, "pick_digit", &inputs, ["state", "counts"]);
            passes::pick_digit(&mut counts, &mut state);
            integers(&picked, bytemuck::cast_slice(&[state])).unwrap();
            integers(&cleared, &counts).unwrap();
        }
        let mut sizes: Vec<f32> = misses.iter().map(|x| x.abs()).collect();
        sizes.sort_by(f32::total_cmp);
        assert_eq!(f32::from_bits(state.prefix), sizes[count / 2]);
    }
}

#[test]
fn accumulate_is_its_twin() {
    let Some(device) = device() else { return };
    for ((rings, nodes), count) in GRIDS.into_iter().zip([1, 255, 257, 4097, 20_000, 100, 50_000]) {
        for gated in [0, 1] {
            let job = Job { gated, ..job(rings, nodes) };
            let (wall, echoes, shifts) = echoes(&job, count, u64::from(nodes));
            let workspace = device.engine.prepare(&job, &echoes).unwrap();
            let none = vec![0_u32; 5 * job.node_count as usize];
            let inputs = [
                ("wall", bytes(&wall)),
                ("shifts", bytes(&shifts)),
                ("sums_low", bytes(&none)),
                ("sums_high", bytes(&none)),
            ];
            let [low, high] = device.run(&workspace, "accumulate", &inputs, ["sums_low", "sums_high"]);
            let mut sums = vec![[0; 5]; job.node_count as usize];
            for (echo, shift) in echoes.iter().zip(&shifts) {
                passes::accumulate(&job, echo, &wall, *shift, &mut sums);
            }
            let sums: Vec<i64> = sums.into_iter().flatten().collect();
            let words = low.words.iter().zip(&high.words).take(sums.len());
            let found: Vec<i64> = words.map(|(&l, &h)| i64::from(h as i32) << 32 | i64::from(l)).collect();
            sums_agree(&found, &sums).unwrap();
            if device.exact {
                integers(&low, &sums.iter().map(|&s| s as u32).collect::<Vec<_>>()).unwrap();
                let highs: Vec<u32> = sums.iter().map(|&s| (s >> 32) as u32).collect();
                // Few sums are negative or that large.
                match highs.iter().all(|&h| h == 0) {
                    true => assert_eq!(high.words, high.before),
                    false => integers(&high, &highs).unwrap(),
                }
            }
        }
    }
}

/// Sums over echoes, as large as many echoes make them and of both signs.
fn sums(job: &Job, seed: u64) -> Vec<[i64; 5]> {
    let mut rng = seeded(seed);
    let scale = f64::from(job.weight_scale);
    let sum = |_: i32| (rng.random_range(-3.0..40.0) * scale) as i64;
    let all: Vec<i64> = (0..5 * job.node_count as i32).map(sum).collect();
    all.chunks_exact(5).map(|row| [row[0], row[1], row[2], row[3], row[4]]).collect()
}

#[test]
fn assemble_aim_and_weigh_rings_are_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let job = job(rings, nodes);
        let count = job.node_count as usize;
        let workspace = device.engine.prepare(&job, &[]).unwrap();
        let sums = sums(&job, 7);
        let wall = random(count, -1.5..1.5, 8);
        let low: Vec<u32> = sums.iter().flatten().map(|&s| s as u32).collect();
        let high: Vec<u32> = sums.iter().flatten().map(|&s| (s >> 32) as u32).collect();
        let inputs = [("sums_low", bytes(&low)), ("sums_high", bytes(&high)), ("wall", bytes(&wall))];
        let outputs = ["rows", "product", "change", "direction"];
        let [rows, residual, change, direction] = device.run(&workspace, "assemble", &inputs, outputs);
        let (expected, left) = passes::assemble(&job, &sums, &wall);
        numbers(&rows, expected.as_flattened(), Tolerance::of(device.exact, 4.0, 40.0)).unwrap();
        // Thirteen numbers of at most 1.5, differences of differences of them, times λ.
        let bent = f64::from(job.along + job.around + job.twist) * 16.0 * 1.5 * f64::from(job.per_noise);
        numbers(&residual, &left, Tolerance::of(device.exact, 32.0, 40.0 + bent)).unwrap();
        for zeroed in [change, direction] {
            numbers(&zeroed, &vec![0.0; count], Tolerance::Bits).unwrap();
        }

        let inputs = [&inputs[..], &[("rows", bytes(expected.as_flattened()))]].concat();
        let [aims] = device.run(&workspace, "aim", &inputs, ["residual"]);
        let scale = 8.0 * 40.0 * 12.5 * f64::from(job.per_noise);
        let aimed = passes::aim(&job, &sums, &expected, &wall);
        numbers(&aims, &aimed, Tolerance::of(device.exact, 16.0, scale)).unwrap();

        let [weights] =
            device.run(&workspace, "weigh_rings", &[("rows", bytes(&expected))], ["ring_weights"]);
        let sums = passes::weigh_rings(&job, &expected);
        let scale = 200.0 * f64::from(nodes);
        let words = weights.at(&(0..rings as usize).collect::<Vec<_>>());
        numbers(&words, &sums, Tolerance::of(device.exact, 16.0, scale)).unwrap();
    }
}

#[test]
fn the_transforms_are_their_twins_and_undo_each_other() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let job = job(rings, nodes);
        let count = job.node_count as usize;
        let workspace = device.engine.prepare(&job, &[]).unwrap();
        let residual = random(count, -2.0..2.0, 9);
        let state = [State::default()];
        let waves = passes::waves(nodes);
        // As many products as a factor of N, and then as the other, each at most twice the size of what goes in.
        let tolerance = |size: f64| Tolerance::of(device.exact, 8.0, f64::from(nodes) * size);
        let known = ("state", bytes(&state));
        let [parts] =
            device.run(&workspace, "part_residual", &[known, ("residual", bytes(&residual))], ["parts"]);
        let expected = passes::part(&job, &waves, &residual);
        numbers(&parts, expected.as_flattened(), tolerance(2.0)).unwrap();
        let [spectrum] =
            device.run(&workspace, "join_waves", &[known, ("parts", bytes(&expected))], ["spectrum"]);
        let expected = passes::join_waves(&job, &waves, &expected);
        numbers(&spectrum, &expected, tolerance(4.0)).unwrap();

        let [parts] =
            device.run(&workspace, "part_waves", &[known, ("spectrum", bytes(&expected))], ["parts"]);
        let size = 3.0 * f64::from(nodes);
        let expected = passes::part(&job, &waves, &expected);
        numbers(&parts, expected.as_flattened(), tolerance(size)).unwrap();
        let inputs = [known, ("parts", bytes(&expected)), ("residual", bytes(&residual))];
        let outputs = ["preconditioned", "partials"];
        let [values, partials] = device.run(&workspace, "join_values", &inputs, outputs);
        let (expected, sums) = passes::join_values(&job, &waves, &expected, &residual);
        numbers(&values, &expected, tolerance(3.0)).unwrap();
        numbers(&words(&partials, sums.len()), &sums, tolerance(512.0 * 6.0)).unwrap();
        let apart = expected.iter().zip(&residual).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-5, "{rings} rings of {nodes}: {apart}");
    }
}

/// The first words of a buffer: some have room for more than one pass needs.
fn words(read: &Readback, count: usize) -> Readback {
    read.at(&(0..count).collect::<Vec<_>>())
}

/// Factors as of systems that are held well enough for numbers to stay small.
fn factors(job: &Job) -> Factors {
    let mut factors = Factors::zeroed(job);
    let values = random(factors.rings.len(), -0.3..0.3, 10);
    factors.rings.copy_from_slice(&values);
    let values = random(4 * factors.joints.len(), -0.3..0.3, 11);
    factors.joints.as_flattened_mut().copy_from_slice(&values);
    factors
}

#[test]
fn eliminate_couple_and_substitute_are_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS.into_iter().chain([(1000, 8)]) {
        let job = job(rings, nodes);
        let workspace = device.engine.prepare(&job, &[]).unwrap();
        let factors = factors(&job);
        let mut spectrum = random(job.node_count as usize, -2.0..2.0, 12);
        let state = [State::default()];
        // Each number is made of a few of the size of at most 4, times factors below one.
        let tolerance = Tolerance::of(device.exact, 64.0, 8.0);

        let known = [("state", bytes(&state)), ("factors", bytes(&factors.rings))];
        let inputs = [&known[..], &[("spectrum", bytes(&spectrum))]].concat();
        let [forward, pulls] = device.run(&workspace, "eliminate", &inputs, ["spectrum", "pulls"]);
        let before = spectrum.clone();
        let expected = passes::eliminate(&job, &factors, &mut spectrum);
        numbers(&forward, &spectrum, tolerance).unwrap();
        numbers(&pulls, expected.as_flattened(), tolerance).unwrap();
        assert!(before != spectrum);

        if job.blocks > 1 {
            let joints = factors.joints.as_flattened();
            let inputs = [
                ("state", bytes(&state)),
                ("joints", bytes(joints)),
                ("pulls", bytes(expected.as_flattened())),
                ("spectrum", bytes(&spectrum)),
            ];
            let [coupled] = device.run(&workspace, "couple", &inputs, ["spectrum"]);
            passes::couple(&job, &factors, &expected, &mut spectrum);
            numbers(&coupled, &spectrum, tolerance).unwrap();
        }

        let inputs = [&known[..], &[("spectrum", bytes(&spectrum))]].concat();
        let [back] = device.run(&workspace, "substitute", &inputs, ["spectrum"]);
        passes::substitute(&job, &factors, &mut spectrum);
        numbers(&back, &spectrum, tolerance).unwrap();
    }
}

#[test]
fn apply_is_its_twin() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let job = job(rings, nodes);
        let count = job.node_count as usize;
        let workspace = device.engine.prepare(&job, &[]).unwrap();
        let (rows, _) = passes::assemble(&job, &sums(&job, 13), &vec![0.0; count]);
        let direction = random(count, -1.0..1.0, 14);
        let state = [State::default()];
        let inputs = [
            ("state", bytes(&state)),
            ("rows", bytes(rows.as_flattened())),
            ("direction", bytes(&direction)),
        ];
        let [product, partials] = device.run(&workspace, "apply", &inputs, ["product", "partials"]);
        let (expected, sums) = passes::apply(&job, &rows, &direction);
        let scale = 7.0 * 40.0 + 16.0 * f64::from(job.along + job.around + job.twist);
        numbers(&product, &expected, Tolerance::of(device.exact, 32.0, scale)).unwrap();
        numbers(&words(&partials, sums.len()), &sums, Tolerance::of(device.exact, 48.0, 256.0 * scale))
            .unwrap();
    }
}

#[test]
fn the_steps_of_conjugate_gradients_are_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let job = job(rings, nodes);
        let count = job.node_count as usize;
        let workspace = device.engine.prepare(&job, &[]).unwrap();
        let [a, b, c, d] = [15, 16, 17, 18].map(|seed| random(count, -2.0..2.0, seed));
        let begun = State { size: 3.0, length: 0.37, turn: 0.61, steps: 4, ..State::default() };
        let tolerance = Tolerance::of(device.exact, 4.0, 4.0);

        let inputs =
            [("state", bytemuck::bytes_of(&begun)), ("preconditioned", bytes(&a)), ("direction", bytes(&b))];
        let [direction] = device.run(&workspace, "redirect", &inputs, ["direction"]);
        let mut expected = b.clone();
        passes::redirect(&begun, &a, &mut expected);
        numbers(&direction, &expected, tolerance).unwrap();

        let inputs = [
            ("state", bytemuck::bytes_of(&begun)),
            ("direction", bytes(&a)),
            ("product", bytes(&b)),
            ("change", bytes(&c)),
            ("residual", bytes(&d)),
        ];
        let [change, residual] = device.run(&workspace, "advance", &inputs, ["change", "residual"]);
        let (mut x, mut left) = (c.clone(), d.clone());
        passes::advance(&begun, &a, &b, &mut x, &mut left);
        numbers(&change, &x, tolerance).unwrap();
        numbers(&residual, &left, tolerance).unwrap();

        let inputs = [("change", bytes(&a)), ("wall", bytes(&b))];
        let [wall, ways] = device.run(&workspace, "move_wall", &inputs, ["wall", "partials"]);
        let mut expected = b.clone();
        let sums = passes::move_wall(&job, &a, &mut expected);
        numbers(&wall, &expected, tolerance).unwrap();
        numbers(&words(&ways, sums.len()), &sums, Tolerance::of(device.exact, 16.0, 512.0)).unwrap();
    }
}

/// A state's words, those of its numbers apart.
fn same_state(device: &Device, found: &Readback, expected: State) {
    if device.exact {
        return integers(found, bytemuck::cast_slice(&[expected])).unwrap();
    }
    let found: State = bytemuck::pod_read_unaligned(bytemuck::cast_slice(&found.words));
    assert_eq!((found.done, found.steps), (expected.done, expected.steps));
    for (a, b) in [(found.size, expected.size), (found.length, expected.length), (found.turn, expected.turn)]
    {
        assert!((a - b).abs() <= 1e-5 * (1.0 + b.abs()), "{a} {b}");
    }
}

#[test]
fn turn_and_stride_decide_as_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS.into_iter().chain([(4000, 512)]) {
        let job = job(rings, nodes);
        let workspace = device.engine.prepare(&job, &[]).unwrap();
        let joined = (rings as usize * (nodes as usize / 2 + 1)).div_ceil(256);
        let blocks = (job.node_count as usize).div_ceil(256);
        let begun = State { size: 3.0, steps: 4, ..State::default() };
        // Above and below what is enough, no number, the first step, and once it is done.
        for (low, high, state) in [
            (0.0, 2.0, begun),
            (-1e-9, 1e-9, begun),
            (-2.0, -1.0, begun),
            (f32::NAN, 0.0, begun),
            (0.0, 2.0, State::default()),
            (0.0, 2.0, State { done: 1, ..begun }),
        ] {
            let partials = |count| match low.is_nan() {
                true => vec![f32::NAN; count],
                false => random(count, low..high, 19),
            };
            for (pass, partials) in [("turn", partials(joined)), ("stride", partials(blocks))] {
                let inputs = [("partials", bytes(&partials)), ("state", bytemuck::bytes_of(&state))];
                let [found] = device.run(&workspace, pass, &inputs, ["state"]);
                let mut expected = state;
                match pass {
                    "turn" => passes::turn(&job, &partials, &mut expected),
                    _ => passes::stride(&partials, &mut expected),
                }
                match expected == state {
                    true => assert_eq!(found.words, found.before),
                    false => same_state(device, &found, expected),
                }
            }
        }
    }
}

#[test]
fn nothing_moves_once_the_solver_is_done() {
    let Some(device) = device() else { return };
    let job = job(17, 100);
    let workspace = device.engine.prepare(&job, &[]).unwrap();
    let done = [State { done: 1, size: 1.0, length: 1.0, turn: 1.0, ..State::default() }];
    let ones = vec![1.0_f32; job.node_count as usize];
    for (pass, output) in [
        ("part_residual", "parts"),
        ("join_waves", "spectrum"),
        ("eliminate", "pulls"),
        ("couple", "spectrum"),
        ("substitute", "spectrum"),
        ("part_waves", "parts"),
        ("join_values", "preconditioned"),
        ("redirect", "direction"),
        ("apply", "product"),
        ("advance", "change"),
    ] {
        let names = ["spectrum", "preconditioned", "direction", "residual", "product", "change"];
        let mut inputs = vec![("state", bytes(&done))];
        inputs.extend(names.iter().map(|&name| (name, bytes(&ones))));
        let [read] = device.run(&workspace, pass, &inputs, [output]);
        assert_eq!(read.words, read.before, "{pass}");
    }
}

/// What one pass wrote is not taken for another's, nor what the CPU wrote for the device's.
#[test]
fn data_of_the_cpu_passed_as_the_device_s_fail() {
    let Some(device) = device() else { return };
    let job = job(8, 9);
    let workspace = device.engine.prepare(&job, &[]).unwrap();
    let of_cpu = random(job.node_count as usize, -2.0..2.0, 20);
    let done = State { done: 1, ..State::default() };
    let inputs = [("residual", bytes(&of_cpu)), ("state", bytemuck::bytes_of(&done))];
    let [residual] = device.run(&workspace, "advance", &inputs, ["residual"]);
    assert_eq!(residual.numbers(), of_cpu);
    assert!(numbers(&residual, &of_cpu, Tolerance::Bits).unwrap_err().contains("did not write"));
}

#[test]
fn an_unknown_pass_or_buffer_is_refused() {
    let Some(device) = device() else { return };
    let workspace = device.engine.prepare(&job(8, 9), &[]).unwrap();
    assert!(device.engine.run_pass(&workspace, "no such pass", &[], &[]).is_err());
    assert!(device.engine.run_pass(&workspace, "turn", &[], &["no such buffer"]).is_err());
}
