//! The passes of the sweep against their twins, each on inputs of its own.

use crate::compare::{Tolerance, integers, numbers};
use crate::device::{Device, POISON, Readback};
use crate::nudge::{Nudge, nudges};
use crate::sections::seeded;
use lumenmesh::low_level::sweep::gpu::GpuWallEngine;
use lumenmesh::low_level::sweep::passes::{self, DeviceEcho, Level, Matrix, NextStep, State, WallParameters};
use rand::RngExt;
use std::sync::OnceLock;

/// The device, once for all tests; `None`, said loudly by [`crate::device::device`], where there is none.
pub fn device() -> Option<&'static Device<GpuWallEngine>> {
    static DEVICE: OnceLock<Option<Device<GpuWallEngine>>> = OnceLock::new();
    let open = || {
        let exact = crate::device::device()?.exact;
        let engine = GpuWallEngine::new(std::env::var("LUMENMESH_ADAPTER").ok().as_deref()).unwrap();
        Some(Device { engine, exact })
    };
    DEVICE.get_or_init(open).as_ref()
}

/// Grids about the 20 rings and 60 nodes of a tile and the 256 invocations of a workgroup, one with a prime number of nodes:
/// (rings, nodes).
const GRIDS: [(u32, u32); 7] = [(3, 8), (8, 9), (20, 60), (21, 61), (17, 100), (64, 256), (150, 130)];

/// Parameters on such a grid, with everything known; where it has an even number of rings, of low tiles.
pub fn parameters(rings: u32, nodes: u32) -> WallParameters {
    let arc_mm = 2.0 * std::f64::consts::PI * 11.0 / f64::from(nodes);
    WallParameters {
        project: 1,
        gated: 1,
        tolerance_square: 1e-3,
        max_steps: 7,
        low_tiles: u32::from(rings.is_multiple_of(2)),
        ..WallParameters::new([rings, nodes], [1.2 * arc_mm, arc_mm], 11.0, 0.1)
    }
    .with_noise(0.7)
    .with_smoothness(31.0)
}

fn random(count: usize, range: std::ops::Range<f32>, seed: u64) -> Vec<f32> {
    let mut rng = seeded(seed);
    (0..count).map(|_| rng.random_range(range.clone())).collect()
}

/// A wall, and echoes all over it, some before its first ring, some beyond its last, some far off.
pub fn echoes(
    parameters: &WallParameters,
    count: usize,
    seed: u64,
) -> (Vec<f32>, Vec<DeviceEcho>, Vec<[f32; 2]>) {
    let mut rng = seeded(seed);
    let wall = random(parameters.node_count as usize, -1.5..1.5, seed + 1);
    let echo = |_| {
        let mut normal = [0.0; 3].map(|_: f32| rng.random_range(-1.0_f32..1.0));
        let length = normal.iter().map(|x| x * x).sum::<f32>().sqrt();
        normal.iter_mut().for_each(|x| *x /= length);
        let far = if rng.random_range(0..20) == 0 { 6.0 } else { 1.0 };
        DeviceEcho {
            ring: rng.random_range(0..parameters.rings),
            ring_part: rng.random_range(0.0..1.0),
            node: rng.random_range(0..parameters.nodes),
            node_part: rng.random_range(0.0..1.0),
            rise: far * rng.random_range(-2.0..2.0),
            step: rng.random_range(0.5..0.9),
            normal,
        }
    };
    let echoes: Vec<DeviceEcho> = (0..count).map(echo).collect();
    let mut rng = seeded(seed + 2);
    let shifts = (0..count).map(|_| [0.0; 2].map(|_: f32| rng.random_range(-2.5..2.5))).collect();
    (wall, echoes, shifts)
}

fn bytes<T: bytemuck::Pod>(values: &[T]) -> &[u8] {
    bytemuck::cast_slice(values)
}

/// The state in which a wall is measured.
const SOLVED: State = State {
    prefix: 0,
    rank: 0,
    digits: 0,
    done: passes::CONVERGED,
    steps: 4,
    residual_square: 3.0,
    max_residual_square: 0.01,
};

/// Counts of echoes about the 256 invocations of a workgroup and the 4096 of a block.
const COUNTS: [usize; 6] = [1, 255, 257, 4095, 4097, 20_000];

#[test]
fn measure_is_its_twin() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        for (count, project) in [(1, 1), (257, 0), (20_000, 1)] {
            let parameters = WallParameters { project, ..parameters(rings, nodes) };
            let (wall, echoes, shifts) = echoes(&parameters, count, u64::from(rings));
            let workspace = device.engine.prepare(&parameters, &echoes).unwrap();
            let state = [SOLVED];
            let inputs = [("state", bytes(&state)), ("wall", bytes(&wall)), ("shifts", bytes(&shifts))];
            let [residuals, projections] =
                device.run(&workspace, "measure", &inputs, ["residuals", "shifts"]);
            let (expected, moved): (Vec<f32>, Vec<[f32; 2]>) =
                echoes.iter().zip(&shifts).map(|(e, s)| passes::measure(&parameters, e, &wall, *s)).unzip();
            if device.exact {
                numbers(&residuals, &expected, Tolerance::Bits).unwrap();
                match project {
                    1 => numbers(&projections, moved.as_flattened(), Tolerance::Bits).unwrap(),
                    _ => assert_eq!(projections.words, projections.before),
                }
                continue;
            }
            let nudged = |mut nudge: Nudge| {
                let moved = nudged_wall(&wall, &echoes, &shifts, &mut nudge);
                let (wall, echoes, shifts) = &moved;
                echoes.iter().zip(shifts).map(|(e, s)| passes::measure(&parameters, e, wall, *s)).unzip()
            };
            let runs: Vec<(Vec<f32>, Vec<[f32; 2]>)> = nudges().map(nudged).collect();
            let reach = reach_of(&expected, runs.iter().map(|(residuals, _)| &residuals[..]));
            alike(&residuals.numbers()[..count], &expected, &reach).unwrap();
            let projected = moved.as_flattened();
            let reach = reach_of(projected, runs.iter().map(|(_, moved)| moved.as_flattened()));
            alike(&projections.numbers()[..2 * count], projected, &reach).unwrap();
        }
    }
}

/// A wall, echoes and their projections, moved by some roundings.
fn nudged_wall(
    wall: &[f32],
    echoes: &[DeviceEcho],
    shifts: &[[f32; 2]],
    nudge: &mut Nudge,
) -> (Vec<f32>, Vec<DeviceEcho>, Vec<[f32; 2]>) {
    let wall = wall.iter().map(|&x| nudge.of(x, 1.5)).collect();
    let shifts = shifts.iter().map(|shift| shift.map(|x| nudge.of(x, 2.5))).collect();
    let mut echoes = echoes.to_vec();
    for echo in &mut echoes {
        echo.rise = nudge.of(echo.rise, 6.0);
        echo.normal = echo.normal.map(|x| nudge.of(x, 1.0));
    }
    (wall, echoes, shifts)
}

/// How far each number of a twin moves with its inputs.
fn reach_of<'a>(expected: &[f32], runs: impl Iterator<Item = &'a [f32]>) -> Vec<f32> {
    let mut reach = vec![0.0_f32; expected.len()];
    for run in runs {
        for ((far, a), b) in reach.iter_mut().zip(run).zip(expected) {
            *far = far.max((a - b).abs());
        }
    }
    reach
}

/// What echoes make of a wall: alike to some roundings of millimetres. A projection on an edge between triangles may lie
/// on either, where the wall is the same but its slope is not: it differs no farther than twice as much as the twin does
/// with inputs that are off by rounding.
fn alike(found: &[f32], expected: &[f32], reach: &[f32]) -> Result<(), String> {
    if found.len() != expected.len() {
        return Err(format!("{} numbers, expected {}", found.len(), expected.len()));
    }
    let is_alike =
        |i: usize| (found[i] - expected[i]).abs() <= 1e-4 * (1.0 + expected[i].abs()) + 2.0 * reach[i];
    match (0..found.len()).find(|&i| !is_alike(i)) {
        None => Ok(()),
        Some(i) => {
            Err(format!("number {i}: found {:e}, expected {:e}, ± {:e}", found[i], expected[i], reach[i]))
        }
    }
}

/// Fixed-point sums over echoes, node by node: each is off by some thirty roundings of what was added to it, whose sizes
/// sum to `sizes`, or by what the twin's are where its inputs are off by rounding.
fn sums_agree(found: &[i64], expected: &[i64], sizes: &[i64], runs: &[Vec<i64>]) -> Result<(), String> {
    if found.len() != expected.len() {
        return Err(format!("{} sums, expected {}", found.len(), expected.len()));
    }
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let apart = a.abs_diff(*b) as f64;
        // The fixed-point step, too.
        let by_rounding = 64.0 * 2.0_f64.powi(-24) * sizes[i] as f64 + 64.0;
        let reach = || runs.iter().map(|run| run[i].abs_diff(*b)).max().unwrap_or(0) as f64;
        if apart > by_rounding && apart > 2.0 * reach() {
            return Err(format!(
                "sum {i}: found {a}, expected {b}, within {by_rounding:.0} or {:.0}",
                reach()
            ));
        }
    }
    Ok(())
}

#[test]
fn what_is_apart_is_told_from_what_is_alike() {
    let numbers = random(1000, -2.0..2.0, 21);
    let mut reach = vec![0.0; 1000];
    alike(&numbers, &numbers, &reach).unwrap();
    let mut off = numbers.clone();
    off[17] += 1e-3;
    assert!(alike(&off, &numbers, &reach).unwrap_err().starts_with("number 17"));
    reach[17] = 1e-3;
    alike(&off, &numbers, &reach).unwrap();
    off[17] += 1.0;
    assert!(alike(&off, &numbers, &reach).is_err());
    off[17] = f32::NAN;
    assert!(alike(&off, &numbers, &reach).is_err());
    assert!(alike(&numbers[..990], &numbers, &reach).is_err());
    assert!(alike(&vec![f32::from_bits(POISON); 1000], &numbers, &reach).is_err());
}

/// The twin's sums over some echoes, node by node, and the sizes of what was added.
fn accumulated(
    parameters: &WallParameters,
    wall: &[f32],
    echoes: &[DeviceEcho],
    shifts: &[[f32; 2]],
) -> (Vec<i64>, Vec<i64>) {
    let empty = vec![[0_i64; 5]; parameters.node_count as usize];
    let (mut sums, mut sizes) = (empty.clone(), empty.clone());
    let mut one = empty;
    for (echo, shift) in echoes.iter().zip(shifts) {
        passes::accumulate(parameters, echo, wall, *shift, &mut sums);
        // A projection is at most 2.5 rings away, and an echo adds to its ring and the next.
        let (ring, nodes) = (echo.ring as usize, parameters.nodes as usize);
        let (first, last) = (ring.saturating_sub(4) * nodes, ((ring + 6) * nodes).min(one.len()));
        one[first..last].fill([0; 5]);
        passes::accumulate(parameters, echo, wall, *shift, &mut one);
        for (size, added) in sizes[first..last].iter_mut().flatten().zip(one[first..last].as_flattened()) {
            *size += added.abs();
        }
    }
    (sums.into_iter().flatten().collect(), sizes.into_iter().flatten().collect())
}

#[test]
fn one_echo_that_is_left_out_shows_in_the_sums() {
    let parameters = parameters(17, 100);
    let (wall, echoes, shifts) = echoes(&parameters, 20_000, 22);
    let (sums, sizes) = accumulated(&parameters, &wall, &echoes, &shifts);
    let run = |mut nudge: Nudge| {
        let (wall, echoes, shifts) = nudged_wall(&wall, &echoes, &shifts, &mut nudge);
        accumulated(&parameters, &wall, &echoes, &shifts).0
    };
    let runs: Vec<Vec<i64>> = nudges().map(run).collect();
    let other_rounding = run(Nudge::new(8000));
    sums_agree(&sums, &sums, &sizes, &[]).unwrap();
    sums_agree(&other_rounding, &sums, &sizes, &runs).unwrap();
    for lost in [0, 4711, 19_999] {
        let (mut echoes, mut shifts) = (echoes.clone(), shifts.clone());
        echoes.remove(lost);
        shifts.remove(lost);
        let (fewer, _) = accumulated(&parameters, &wall, &echoes, &shifts);
        // One that weighs nothing is not missed.
        assert!(fewer == sums || sums_agree(&fewer, &sums, &sizes, &runs).is_err());
    }
    let mut off = sums.clone();
    off[777] += sizes[777] / 1000;
    assert!(sums_agree(&off, &sums, &sizes, &runs).unwrap_err().starts_with("sum 777"));
    let mut swapped = sums.clone();
    swapped.rotate_left(5);
    assert!(sums_agree(&swapped, &sums, &sizes, &runs).is_err());
    assert!(sums_agree(&vec![-1; sums.len()], &sums, &sizes, &runs).is_err());
    assert!(sums_agree(&sums[5..], &sums, &sizes, &runs).is_err());
}

#[test]
fn the_median_is_chosen_digit_by_digit() {
    let Some(device) = device() else { return };
    for (seed, count) in (0..).zip(COUNTS) {
        let parameters = parameters(8, 9);
        let (_, echoes, _) = echoes(&parameters, count, seed);
        let workspace = device.engine.prepare(&parameters, &echoes).unwrap();
        let mut residuals = random(count, -3.0..3.0, seed);
        // Many alike, and some far smaller.
        residuals.iter_mut().step_by(3).for_each(|x| *x = 0.25);
        residuals.iter_mut().skip(1).step_by(5).for_each(|x| *x *= 1e-30);
        let mut state = State { rank: count as u32 / 2, ..SOLVED };
        let mut counts = [0; 256];
        for _ in 0..4 {
            let inputs = [
                ("residuals", bytes(&residuals)),
                ("state", bytemuck::bytes_of(&state)),
                ("counts", bytes(&counts)),
            ];
            let [counted] = device.run(&workspace, "count_residuals", &inputs, ["counts"]);
            passes::count_residuals(&residuals, &state, &mut counts);
            integers(&counted, &counts).unwrap();

            let inputs = [("state", bytemuck::bytes_of(&state)), ("counts", bytes(&counts))];
            let [picked, cleared] = device.run(&workspace, "pick_digit", &inputs, ["state", "counts"]);
            passes::pick_digit(&mut counts, &mut state);
            integers(&picked, bytemuck::cast_slice(&[state])).unwrap();
            integers(&cleared, &counts).unwrap();
        }
        let mut sizes: Vec<f32> = residuals.iter().map(|x| x.abs()).collect();
        sizes.sort_by(f32::total_cmp);
        assert_eq!(f32::from_bits(state.prefix), sizes[count / 2]);
    }
}

#[test]
fn accumulate_is_its_twin() {
    let Some(device) = device() else { return };
    for ((rings, nodes), count) in GRIDS.into_iter().zip([1, 255, 257, 4097, 20_000, 100, 50_000]) {
        for gated in [0, 1] {
            let parameters = WallParameters { gated, ..parameters(rings, nodes) };
            let (wall, echoes, shifts) = echoes(&parameters, count, u64::from(nodes));
            let workspace = device.engine.prepare(&parameters, &echoes).unwrap();
            let none = vec![0_u32; 5 * parameters.node_count as usize];
            let inputs = [
                ("wall", bytes(&wall)),
                ("shifts", bytes(&shifts)),
                ("sums_low", bytes(&none)),
                ("sums_high", bytes(&none)),
            ];
            let [low, high] = device.run(&workspace, "accumulate", &inputs, ["sums_low", "sums_high"]);
            let (sums, sizes) = accumulated(&parameters, &wall, &echoes, &shifts);
            let words = low.words.iter().zip(&high.words).take(sums.len());
            let found: Vec<i64> = words.map(|(&l, &h)| i64::from(h as i32) << 32 | i64::from(l)).collect();
            if !device.exact {
                let run = |mut nudge: Nudge| {
                    let (wall, echoes, shifts) = nudged_wall(&wall, &echoes, &shifts, &mut nudge);
                    accumulated(&parameters, &wall, &echoes, &shifts).0
                };
                let runs: Vec<Vec<i64>> = nudges().map(run).collect();
                sums_agree(&found, &sums, &sizes, &runs).unwrap();
            }
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
fn sums(parameters: &WallParameters, seed: u64) -> Vec<[i64; 5]> {
    let mut rng = seeded(seed);
    let scale = f64::from(parameters.weight_scale);
    let sum = |_: i32| (rng.random_range(-3.0..40.0) * scale) as i64;
    let all: Vec<i64> = (0..5 * parameters.node_count as i32).map(sum).collect();
    all.chunks_exact(5).map(|row| [row[0], row[1], row[2], row[3], row[4]]).collect()
}

#[test]
fn assemble_assemble_rhs_and_lump_are_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let parameters = parameters(rings, nodes);
        let count = parameters.node_count as usize;
        let workspace = device.engine.prepare(&parameters, &[]).unwrap();
        let sums = sums(&parameters, 7);
        let wall = random(count, -1.5..1.5, 8);
        let low: Vec<u32> = sums.iter().flatten().map(|&s| s as u32).collect();
        let high: Vec<u32> = sums.iter().flatten().map(|&s| (s >> 32) as u32).collect();
        let inputs = [("sums_low", bytes(&low)), ("sums_high", bytes(&high)), ("wall", bytes(&wall))];
        let outputs = ["rows", "product", "change", "direction"];
        let [rows, residual, change, direction] = device.run(&workspace, "assemble", &inputs, outputs);
        let (expected, left) = passes::assemble(&parameters, &sums, &wall);
        numbers(&rows, expected.as_flattened(), Tolerance::of(device.exact, 4.0, 40.0)).unwrap();
        // Thirteen numbers of at most 1.5, differences of differences of them, times λ.
        let bent = f64::from(parameters.along + parameters.around + parameters.twist)
            * 16.0
            * 1.5
            * f64::from(parameters.per_noise);
        numbers(&residual, &left, Tolerance::of(device.exact, 32.0, 40.0 + bent)).unwrap();
        for zeroed in [change, direction] {
            numbers(&zeroed, &vec![0.0; count], Tolerance::Bits).unwrap();
        }

        let inputs = [&inputs[..], &[("rows", bytes(expected.as_flattened()))]].concat();
        let [aims] = device.run(&workspace, "assemble_rhs", &inputs, ["rights"]);
        let scale = 8.0 * 40.0 * 12.5 * f64::from(parameters.per_noise);
        let aimed = passes::assemble_rhs(&parameters, &sums, &expected, &wall);
        numbers(&words(&aims, count), &aimed, Tolerance::of(device.exact, 16.0, scale)).unwrap();

        let [own] = device.run(&workspace, "lump", &[("rows", bytes(&expected))], ["own"]);
        let lumped = passes::lump(&parameters, &expected);
        let tolerance = Tolerance::of(device.exact, 16.0, 7.0 * 40.0);
        numbers(&words(&own, 2 * count), lumped.as_flattened(), tolerance).unwrap();
    }
}

/// The first words of a buffer: some have room for more than one pass needs.
fn words(read: &Readback, count: usize) -> Readback {
    read.at(&(0..count).collect::<Vec<_>>())
}

/// A wall's grids, with echoes on all of it but a hole.
struct Grids {
    parameters: WallParameters,
    levels: Vec<Level>,
    rows: Vec<[f32; 4]>,
    /// Grid by grid.
    own: Vec<Vec<[f32; 2]>>,
}

impl Grids {
    fn new(rings: u32, nodes: u32) -> Self {
        let parameters = parameters(rings, nodes);
        let levels = parameters.levels();
        let mut sums = sums(&parameters, 13);
        sums.iter_mut().skip(5).take(40).for_each(|row| *row = [0; 5]);
        // Couplings are not negative.
        sums.iter_mut().flatten().for_each(|sum| *sum = sum.abs());
        let (rows, _) = passes::assemble(&parameters, &sums, &vec![0.0; sums.len()]);
        let mut own = vec![passes::lump(&parameters, &rows)];
        for pair in levels.windows(2) {
            own.push(passes::coarsen(&pair[0], &pair[1], &own[own.len() - 1]));
        }
        Self { parameters, levels, rows, own }
    }

    fn matrix(&self, level: usize) -> Matrix<'_> {
        Matrix {
            parameters: &self.parameters,
            level: &self.levels[level],
            rows: &self.rows,
            own: &self.own[level],
        }
    }

    /// Numbers for the nodes of all grids.
    fn random(&self, seed: u64) -> Vec<f32> {
        random(self.own.iter().map(Vec::len).sum(), -2.0..2.0, seed)
    }

    /// Those of a grid.
    fn of<'a>(&self, level: usize, all: &'a [f32]) -> &'a [f32] {
        let Level { first, count, .. } = self.levels[level];
        &all[first as usize..(first + count) as usize]
    }
}

/// Grids that have many coarser ones and few, whose numbers of rings and nodes are odd and even, or just those of a tile.
const MULTIGRIDS: [(u32, u32); 8] =
    [(3, 8), (8, 9), (17, 100), (20, 54), (41, 57), (64, 256), (151, 65), (700, 16)];

/// What a pass over each grid but the coarsest leaves in a buffer with all grids' nodes: what its twin computed for a grid,
/// where it writes there, and what was there before.
fn of_levels(before: &[f32], levels: &[Level], written: impl Fn(usize) -> Option<Vec<f32>>) -> Vec<f32> {
    let mut all = before.to_vec();
    for (l, level) in levels.iter().enumerate() {
        if let Some(of_grid) = written(l) {
            all[level.first as usize..][..level.count as usize].copy_from_slice(&of_grid);
        }
    }
    all
}

#[test]
fn descend_and_ascend_are_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in MULTIGRIDS {
        let grids = Grids::new(rings, nodes);
        let Grids { parameters, levels, rows, own } = &grids;
        let workspace = device.engine.prepare(parameters, &[]).unwrap();
        let [rights, values, results] = [31, 32, 33].map(|seed| grids.random(seed));
        let all: Vec<f32> = own.iter().flatten().flatten().copied().collect();
        let state = [State::default()];
        let known = [("state", bytes(&state)), ("rows", bytes(rows.as_flattened())), ("own", bytes(&all))];
        // Matrices have up to a dozen roundings of numbers as large as their diagonals times two.
        let largest = own.iter().flatten().fold(0.0_f64, |most, own| most.max(f64::from(own[1]).recip()));
        let relaxed = Tolerance::of(device.exact, 64.0, 8.0 * largest * f64::from(all[1]).max(1.0));
        let left = Tolerance::of(device.exact, 64.0, 8.0 * largest);
        let coarsest = levels.len() - 1;

        // Grid by grid, the finest first: a grid's right-hand side is what the finer one left.
        let inputs = [&known[..], &[("rights", bytes(&rights)), ("values", bytes(&values))]].concat();
        let [found, found_rights] = device.run(&workspace, "descend", &inputs, ["values", "rights"]);
        let (mut expected, mut expected_rights) = (Vec::new(), vec![grids.of(0, &rights).to_vec()]);
        for l in 0..coarsest {
            let (of_grid, of_coarse) = passes::descend(&grids.matrix(l), &levels[l + 1], &expected_rights[l]);
            expected.push(of_grid);
            expected_rights.push(of_coarse);
        }
        let expected = of_levels(&values, levels, |l| expected.get(l).cloned());
        numbers(&found, &expected, relaxed).unwrap();
        numbers(&found_rights, &expected_rights.concat(), left).unwrap();

        // Grid by grid, the finest first: every grid gets the values that the next one had before.
        let inputs = [
            &known[..],
            &[("rights", bytes(&rights)), ("values", bytes(&values)), ("results", bytes(&results))],
        ]
        .concat();
        let [found, squares] = device.run(&workspace, "ascend", &inputs, ["results", "squares"]);
        let of = |l: usize| {
            let [right, before] = [&rights, &values].map(|all| grids.of(l, all));
            passes::ascend(&grids.matrix(l), &levels[l + 1], grids.of(l + 1, &results), right, before)
        };
        let expected = of_levels(&results, levels, |l| (l < coarsest).then(|| of(l).0));
        numbers(&found, &expected, relaxed).unwrap();
        let sums = of(0).1;
        assert_eq!(sums.len(), passes::tile_count(parameters, &levels[0], passes::ASCEND_COLUMNS) as usize);
        let summed = match relaxed {
            Tolerance::Roundings(..) => Tolerance::of(false, 128.0, 2048.0 * 8.0 * largest),
            exact => exact,
        };
        numbers(&words(&squares, sums.len()), &sums, summed).unwrap();
    }
}

#[test]
fn coarsen_is_its_twin() {
    let Some(device) = device() else { return };
    for (rings, nodes) in MULTIGRIDS {
        let grids = Grids::new(rings, nodes);
        let Grids { parameters, own, .. } = &grids;
        let workspace = device.engine.prepare(parameters, &[]).unwrap();
        // Weights sum up from grid to grid.
        let first: Vec<f32> = own[0].as_flattened().to_vec();
        let [found] = device.run(&workspace, "coarsen", &[("own", bytes(&first))], ["own"]);
        let expected: Vec<f32> = own.iter().flatten().flatten().copied().collect();
        let all = own[0].iter().map(|own| f64::from(own[0])).sum::<f64>();
        numbers(&found, &expected, Tolerance::of(device.exact, 64.0, all)).unwrap();
        let coarsest = own[own.len() - 1].iter().map(|own| f64::from(own[0])).sum::<f64>();
        assert!((coarsest - all).abs() < 1e-5 * all, "{rings} x {nodes}: {coarsest} of {all}");
    }
}

#[test]
fn the_cycle_of_one_workgroup_is_its_twin() {
    let Some(device) = device() else { return };
    for (rings, nodes) in MULTIGRIDS {
        let grids = Grids::new(rings, nodes);
        let Grids { parameters, levels, own, .. } = &grids;
        let workspace = device.engine.prepare(parameters, &[]).unwrap();
        // The pass runs on the first grid that the workspace leaves to one workgroup.
        let first = workspace.large_levels();
        let (rights, results) = (grids.random(36), grids.random(37));
        let all: Vec<f32> = own.iter().flatten().flatten().copied().collect();
        let state = [State::default()];
        let inputs = [
            ("state", bytes(&state)),
            ("own", bytes(&all)),
            ("rights", bytes(&rights)),
            ("results", bytes(&results)),
        ];
        let [found] = device.run(&workspace, "coarse_cycle", &inputs, ["results"]);
        let of_each: Vec<&[[f32; 2]]> = own[first..].iter().map(|own| &own[..]).collect();
        let expected = passes::coarse_cycle(parameters, &levels[first..], &of_each, grids.of(first, &rights));
        let size = expected.iter().fold(0.0_f64, |most, x| most.max(f64::from(x.abs())));
        let expected = of_levels(&results, levels, |l| (l == first).then(|| expected.clone()));
        numbers(&found, &expected, Tolerance::of(device.exact, 4096.0, size)).unwrap();
    }
}

#[test]
fn apply_is_its_twin() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let parameters = parameters(rings, nodes);
        let count = parameters.node_count as usize;
        let workspace = device.engine.prepare(&parameters, &[]).unwrap();
        let (rows, _) = passes::assemble(&parameters, &sums(&parameters, 13), &vec![0.0; count]);
        let [results, direction] = [14, 20].map(|seed| random(count, -0.7..0.7, seed));
        // Their sum is the residual's square, four times that of the step before.
        let tiles = passes::tile_count(&parameters, &parameters.finest(), passes::ASCEND_COLUMNS) as usize;
        let squares = vec![1.2 / tiles as f32; tiles];
        let before = State { residual_square: 3.0, steps: 4, max_residual_square: 1e-3, ..State::default() };
        let inputs = [
            ("state", bytemuck::bytes_of(&before)),
            ("squares", bytes(&squares)),
            ("rows", bytes(rows.as_flattened())),
            ("results", bytes(&results)),
            ("direction", bytes(&direction)),
        ];
        let outputs = ["next_step", "product", "curvatures"];
        let [found, product, curvatures] = device.run(&workspace, "apply", &inputs, outputs);
        let applied = passes::apply(&parameters, &before, &squares, &rows, &results, &direction);
        same_step(device, &found, applied.next_step);
        assert!((applied.next_step.beta - 0.4).abs() < 1e-5 && applied.next_step.ends == 0);
        let (expected, sums) = (applied.product, applied.curvatures);
        let scale = 7.0 * 40.0 + 16.0 * f64::from(parameters.along + parameters.around + parameters.twist);
        numbers(&product, &expected, Tolerance::of(device.exact, 32.0, scale)).unwrap();
        assert_eq!(
            sums.len(),
            passes::tile_count(&parameters, &parameters.finest(), passes::APPLY_COLUMNS) as usize
        );
        let tolerance = Tolerance::of(device.exact, 128.0, 1200.0 * scale);
        numbers(&words(&curvatures, sums.len()), &sums, tolerance).unwrap();
    }
}

#[test]
fn the_steps_of_conjugate_gradients_are_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS {
        let parameters = parameters(rings, nodes);
        let count = parameters.node_count as usize;
        let workspace = device.engine.prepare(&parameters, &[]).unwrap();
        let [a, b, c, d, e] = [15, 16, 17, 18, 19].map(|seed| random(count, -2.0..2.0, seed));
        let begun = State { steps: 4, ..State::default() };
        let next_step = NextStep { ends: 0, square: 1.1, beta: 0.61 };
        let tolerance = Tolerance::of(device.exact, 4.0, 4.0);

        let tiles = passes::tile_count(&parameters, &parameters.finest(), passes::APPLY_COLUMNS) as usize;
        let curvatures = random(tiles, 0.5..1.5, 20);
        let inputs = [
            ("state", bytemuck::bytes_of(&begun)),
            ("next_step", bytemuck::bytes_of(&next_step)),
            ("curvatures", bytes(&curvatures)),
            ("results", bytes(&a)),
            ("product", bytes(&b)),
            ("direction", bytes(&e)),
            ("change", bytes(&c)),
            ("rights", bytes(&d)),
        ];
        let [found, direction, change, residual] =
            device.run(&workspace, "cg_step", &inputs, ["state", "direction", "change", "rights"]);
        let (mut along, mut x, mut left) = (e.clone(), c.clone(), d.clone());
        let mut state = begun;
        passes::cg_step(&mut state, &next_step, &curvatures, &a, &b, [&mut along, &mut x, &mut left]);
        assert_eq!((state.steps, state.residual_square), (5, 1.1));
        same_state(device, &found, state);
        numbers(&direction, &along, tolerance).unwrap();
        numbers(&change, &x, tolerance).unwrap();
        numbers(&words(&residual, count), &left, tolerance).unwrap();

        let solved = [SOLVED];
        let rows: Vec<[f32; 4]> = c.iter().map(|&x| [x.abs(), f32::NAN, f32::NAN, f32::NAN]).collect();
        let inputs =
            [("state", bytes(&solved)), ("change", bytes(&a)), ("rows", bytes(&rows)), ("wall", bytes(&b))];
        let [wall, ways] = device.run(&workspace, "move_wall", &inputs, ["wall", "travels"]);
        let mut expected = b.clone();
        let sums = passes::move_wall(&parameters, &a, &rows, &mut expected);
        let sums = sums.as_flattened();
        numbers(&wall, &expected, tolerance).unwrap();
        numbers(&words(&ways, sums.len()), sums, Tolerance::of(device.exact, 16.0, 512.0)).unwrap();
    }
}

/// A state's words, those of its numbers apart.
fn same_state(device: &Device<GpuWallEngine>, found: &Readback, expected: State) {
    if device.exact {
        return integers(found, bytemuck::cast_slice(&[expected])).unwrap();
    }
    let found: State = bytemuck::pod_read_unaligned(bytemuck::cast_slice(&found.words));
    assert_eq!((found.done, found.steps), (expected.done, expected.steps));
    for (a, b) in [
        (found.residual_square, expected.residual_square),
        (found.max_residual_square, expected.max_residual_square),
    ] {
        assert!((a - b).abs() <= 1e-5 * (1.0 + b.abs()), "{a} {b}");
    }
}

/// A next step's words, those of its numbers apart.
fn same_step(device: &Device<GpuWallEngine>, found: &Readback, expected: NextStep) {
    if device.exact {
        return integers(found, bytemuck::cast_slice(&[expected])).unwrap();
    }
    // A buffer may be longer.
    let words = &found.words[..size_of::<NextStep>() / 4];
    let found: NextStep = bytemuck::pod_read_unaligned(bytemuck::cast_slice(words));
    assert_eq!(found.ends, expected.ends);
    for (a, b) in [(found.square, expected.square), (found.beta, expected.beta)] {
        assert!(a.is_nan() && b.is_nan() || a == b || (a - b).abs() <= 1e-5 * (1.0 + b.abs()), "{a} {b}");
    }
}

#[test]
fn cg_limit_apply_and_cg_step_decide_as_their_twins() {
    let Some(device) = device() else { return };
    for (rings, nodes) in GRIDS.into_iter().chain([(2000, 512)]) {
        let parameters = parameters(rings, nodes);
        let workspace = device.engine.prepare(&parameters, &[]).unwrap();
        let tiles = |columns| passes::tile_count(&parameters, &parameters.finest(), columns) as usize;
        let count = parameters.node_count as usize;
        let (none, rows) = (vec![0.0_f32; count], vec![[0.0_f32; 4]; count]);
        let begun = State { residual_square: 3.0, steps: 4, max_residual_square: 1e-3, ..State::default() };
        // Above and below what is enough, no numbers, the first step, the last one, and once it is done.
        for (low, high, state) in [
            (0.0, 2.0, begun),
            (-1e-9, 1e-9, begun),
            (-2.0, -1.0, begun),
            (f32::NAN, 0.0, begun),
            (f32::MAX, f32::INFINITY, begun),
            (0.0, 2.0, State::default()),
            (0.0, 2.0, State { steps: 7, ..begun }),
            (0.0, 2.0, State { done: 1, ..begun }),
        ] {
            let partials = |count| match low.is_nan() || high.is_infinite() {
                true => vec![if low.is_nan() { low } else { high }; count],
                false => random(count, low..high, 19),
            };
            let finite = low.is_finite() && high.is_finite();
            for (pass, buffer, columns) in [
                ("cg_limit", "squares", passes::ASCEND_COLUMNS),
                ("apply", "squares", passes::ASCEND_COLUMNS),
                ("cg_step", "curvatures", passes::APPLY_COLUMNS),
            ] {
                if pass == "cg_limit" && !finite {
                    continue;
                }
                let partials = partials(tiles(columns));
                let step = NextStep { ends: state.done, square: 2.0, beta: 0.5 };
                let mut inputs = vec![(buffer, bytes(&partials)), ("state", bytemuck::bytes_of(&state))];
                inputs.push(("next_step", bytemuck::bytes_of(&step)));
                let zeroed = ["results", "direction", "product", "change", "rights"];
                inputs.extend(zeroed.map(|name| (name, bytes(&none))));
                inputs.push(("rows", bytes(&rows)));
                let [found, found_step] = device.run(&workspace, pass, &inputs, ["state", "next_step"]);
                let (mut expected, mut expected_step) = (state, step);
                match pass {
                    "cg_limit" => passes::cg_limit(&parameters, &partials, &mut expected),
                    "apply" if state.done == 0 => {
                        let applied = passes::apply(&parameters, &state, &partials, &rows, &none, &none);
                        expected_step = applied.next_step;
                        let of_steps = if state.steps == 7 { passes::EXHAUSTED } else { expected_step.ends };
                        let ends = if finite { of_steps } else { passes::BROKEN };
                        assert_eq!(expected_step.ends, ends, "{low} to {high}");
                    }
                    "apply" => {}
                    _ => {
                        let [mut a, mut b, mut c] = [none.clone(), none.clone(), none.clone()];
                        let vectors = [&mut a[..], &mut b, &mut c];
                        passes::cg_step(&mut expected, &step, &partials, &none, &none, vectors);
                        if state.done == 0 && (!finite || high < 0.0) {
                            assert_eq!(expected.done, passes::BROKEN, "{low} to {high}");
                        }
                    }
                }
                match expected == state {
                    true => assert_eq!(found.words, found.before),
                    false => same_state(device, &found, expected),
                }
                match expected_step == step {
                    true => assert_eq!(found_step.words, found_step.before),
                    false => same_step(device, &found_step, expected_step),
                }
            }
        }
    }
}

#[test]
fn nothing_moves_once_the_solver_is_done() {
    let Some(device) = device() else { return };
    let parameters = parameters(17, 100);
    let workspace = device.engine.prepare(&parameters, &[]).unwrap();
    let done = [State { done: 1, residual_square: 1.0, ..State::default() }];
    let next_step = [NextStep { ends: 1, square: 1.0, beta: 1.0 }];
    let ones = vec![1.0_f32; parameters.node_count as usize];
    for (pass, output) in [
        ("descend", "values"),
        ("descend", "rights"),
        ("coarse_cycle", "results"),
        ("ascend", "results"),
        ("apply", "product"),
        ("cg_step", "direction"),
        ("cg_step", "change"),
        ("cg_step", "rights"),
    ] {
        let names = ["values", "results", "direction", "rights", "product", "change"];
        let mut inputs = vec![("state", bytes(&done)), ("next_step", bytes(&next_step))];
        inputs.extend(names.iter().map(|&name| (name, bytes(&ones))));
        let [read] = device.run(&workspace, pass, &inputs, [output]);
        assert_eq!(read.words, read.before, "{pass}");
    }
}

#[test]
fn no_wall_moves_and_nothing_is_measured_before_the_solver_is_done() {
    let Some(device) = device() else { return };
    let parameters = parameters(17, 100);
    let (wall, echoes, shifts) = echoes(&parameters, 300, 5);
    let workspace = device.engine.prepare(&parameters, &echoes).unwrap();
    let ones = vec![1.0_f32; 4 * parameters.node_count as usize];
    for done in [0, passes::BROKEN] {
        let state = [State { done, ..SOLVED }];
        for (pass, output) in [("move_wall", "wall"), ("measure", "shifts"), ("count_residuals", "counts")] {
            let inputs = [
                ("state", bytes(&state)),
                ("change", bytes(&ones[..wall.len()])),
                ("rows", bytes(&ones)),
                ("wall", bytes(&wall)),
                ("shifts", bytes(&shifts)),
                ("residuals", bytes(&ones[..300])),
            ];
            let [read] = device.run(&workspace, pass, &inputs, [output]);
            assert_eq!(read.words, read.before, "{pass}");
        }
    }
}

/// What one pass wrote is not taken for another's, nor what the CPU wrote for the device's.
#[test]
fn data_of_the_cpu_passed_as_the_device_s_fail() {
    let Some(device) = device() else { return };
    let parameters = parameters(8, 9);
    let workspace = device.engine.prepare(&parameters, &[]).unwrap();
    let of_cpu = random(parameters.node_count as usize, -2.0..2.0, 20);
    let done = NextStep { ends: 1, ..NextStep::default() };
    let inputs = [("rights", bytes(&of_cpu)), ("next_step", bytemuck::bytes_of(&done))];
    let [residual] = device.run(&workspace, "cg_step", &inputs, ["rights"]);
    let residual = words(&residual, of_cpu.len());
    assert_eq!(residual.numbers(), of_cpu);
    assert!(numbers(&residual, &of_cpu, Tolerance::Bits).unwrap_err().contains("did not write"));
}

#[test]
fn an_unknown_pass_or_buffer_is_refused() {
    let Some(device) = device() else { return };
    let workspace = device.engine.prepare(&parameters(8, 9), &[]).unwrap();
    assert!(device.engine.run_pass(&workspace, "no such pass", &[], &[]).is_err());
    assert!(device.engine.run_pass(&workspace, "cg_limit", &[], &["no such buffer"]).is_err());
}
