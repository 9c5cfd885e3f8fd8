//! The passes `measure_short`, with subgroups and without, `measure_narrow` and `measure_long` against their twins.

use crate::compare::{Entry, Tolerance, decisions, entries_alike};
use crate::cylinders::{assert_agree, assert_same};
use crate::device::{Device, POISON, Readback, device, device_of_a_host, device_without_subgroups};
use crate::nudge::{Nudge, nudges};
use crate::sections::{RADIUS_MM, seeded, wall};
use lumenmesh::cylinders::{CpuEngine, Engine, Tube};
use lumenmesh::low_level::cylinders::gpu::LANES;
use lumenmesh::low_level::cylinders::passes::{
    Face, Filter, FitParameters, LIST_HEAD, TriangleStatistic, TubeGrid, distance, grouped_point,
    listed_faces, measure_long, measure_short,
};
use lumenmesh::settings::{Outliers, Settings, Statistic};
use rand::RngExt;
use std::iter::repeat_n;

/// How the points of a face differ from each other.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pattern {
    Random,
    AllEqual,
    TwoValues,
    Sorted,
    /// Nearly all on one spot, the rest far away.
    Skewed,
}

const PATTERNS: [Pattern; 5] =
    [Pattern::Random, Pattern::AllEqual, Pattern::TwoValues, Pattern::Sorted, Pattern::Skewed];

/// Points of faces with so many points each, measured from their faces' corners.
struct Faces {
    tube: Tube,
    offsets: Vec<u32>,
    points: Vec<[f32; 3]>,
    radii: Vec<f32>,
}

impl Faces {
    fn new(settings: &Settings, sizes: &[u32], pattern: Pattern) -> Self {
        let tube = Tube::new(settings);
        assert_eq!(sizes.len(), tube.face_count());
        let grid = TubeGrid::<f32>::new(&tube);
        let mut rng = seeded(31);
        let (mut offsets, mut points) = (vec![0], Vec::new());
        for &size in sizes {
            let begin = points.len();
            for i in 0..size {
                let any = [
                    rng.random_range(9.0..15.0_f32),
                    rng.random_range(0.0..1.0_f32) * grid.step_theta,
                    rng.random_range(0.0..1.0_f32) * grid.step_z,
                ];
                let spot = [12.75, 0.25 * grid.step_theta, 0.5 * grid.step_z];
                points.push(match pattern {
                    Pattern::Random | Pattern::Sorted => any,
                    Pattern::AllEqual => spot,
                    Pattern::TwoValues if i % 3 == 0 => [11.5, spot[1], spot[2]],
                    Pattern::TwoValues => spot,
                    Pattern::Skewed if i % 50 == 7 => any,
                    Pattern::Skewed => [spot[0] + any[1] * 1e-4, spot[1], spot[2]],
                });
            }
            if pattern == Pattern::Sorted {
                points[begin..].sort_by(|p, q| p[0].total_cmp(&q[0]));
            }
            offsets.push(points.len() as u32);
        }
        let radii = (0..tube.node_count()).map(|_| 12.0 + rng.random_range(-0.8..0.8_f32)).collect();
        Self { tube, offsets, points, radii }
    }

    fn size(&self, face: usize) -> u32 {
        self.offsets[face + 1] - self.offsets[face]
    }

    /// The statistics of one face's two triangles; with points and radii that are moved by some roundings, where asked.
    fn twin(
        &self,
        face: usize,
        rule: &Filter<f32>,
        long: bool,
        nudge: Option<&mut Nudge>,
    ) -> [TriangleStatistic<f32>; 2] {
        let mut nudge = nudge;
        let mut moved = |x: f32, size: f64| nudge.as_mut().map_or(x, |nudge| nudge.of(x, size));
        let (tube, grid) = (&self.tube, TubeGrid::<f32>::new(&self.tube));
        let (row, j) = (face - face % tube.nodes, face % tube.nodes);
        let k = tube.next(j);
        let a = self.radii[row + j];
        let above = row + tube.nodes;
        let corners = [row + k, above + k, above + j].map(|node| moved(self.radii[node] - a, 1.0));
        let corners = Face::new(corners, &grid);
        let mut distances = [Vec::new(), Vec::new()];
        for [r, theta, z] in &self.points[self.offsets[face] as usize..self.offsets[face + 1] as usize] {
            let point = [moved(r - a, 4.0), moved(*theta, 1.0), moved(*z, 1.0)];
            let (signed, top) = distance(point, &corners, &grid);
            distances[usize::from(top)].push(signed);
        }
        let measure = if long { measure_long } else { measure_short };
        distances.map(|d| measure(&d, rule, &mut Vec::new()))
    }

    /// Runs a pass that measures the faces of a class: it writes those, all of those, and no others.
    fn agrees(&self, device: &Device, settings: &Settings, pass: &str) {
        let narrow = pass == "measure_narrow";
        let long = narrow || pass.starts_with("measure_long");
        let count = self.points.len() as u32;
        let workspace = device.engine.prepare(count, RADIUS_MM, settings).unwrap();
        let FitParameters { max_short, max_middle, max_narrow, most_long, .. } = *workspace.parameters();
        let is_own = |size: u32| match pass.starts_with("measure_middle") {
            true => size > max_short && size <= max_middle,
            false if narrow => size > max_middle && size <= max_narrow,
            false if long => size > max_narrow,
            false => size <= max_short,
        };
        let rule = Filter::new(settings, RADIUS_MM);
        let faces = self.tube.face_count();
        let mut expected = vec![None; 2 * faces];
        for face in (0..faces).filter(|&f| is_own(self.size(f))) {
            for (half, s) in self.twin(face, &rule, long, None).into_iter().enumerate() {
                expected[2 * face + half] = Some((s.value, s.kept, s.residual));
            }
        }
        assert!(expected.iter().any(Option::is_some), "no face for {pass}");
        let counts: Vec<u32> = (0..faces).map(|face| self.size(face)).collect();
        let face_of_each = (0..).zip(&counts).flat_map(|(face, &count)| repeat_n(face, count as usize));
        let grouped: Vec<[u32; 4]> =
            self.points.iter().zip(face_of_each).map(|(point, face)| grouped_point(*point, face)).collect();
        let most = faces.min(count as usize / (max_short as usize + 1)) + most_long as usize;
        let listed = listed_faces(&counts, workspace.parameters(), LIST_HEAD + most);
        let mut inputs = vec![
            ("offsets", bytemuck::cast_slice(&self.offsets)),
            ("grouped", bytemuck::cast_slice(&grouped)),
            ("radii", bytemuck::cast_slice(&self.radii)),
        ];
        inputs.push(("listed_faces", bytemuck::cast_slice(&listed)));
        // The keys that `distance` writes are what measure_long would write itself.
        let is_keyed = ["measure_long_keyed", "measure_long_wide"].contains(&pass);
        let keys = is_keyed.then(|| {
            let [keys] = device.run(&workspace, "distance", &inputs[..3], ["keys"]);
            keys.words
        });
        if let Some(keys) = &keys {
            inputs.push(("keys", bytemuck::cast_slice(keys)));
        }
        let outputs = ["triangle_values", "triangle_support"];
        let [values, support] = device.run(&workspace, pass, &inputs, outputs);
        let found = entries(&values, &support);
        // A distance is some 60 operations on differences of a few mm; the fixed-point step and the mean add
        // two roundings. A point may change its triangle, or fall on the other side of a fence.
        let tolerance = Tolerance::of(device.exact, 128.0, 6.0);
        let by_rounding = Tolerance::Roundings(256.0, 6.0);
        let is_explained = |i: usize, found: Entry| {
            let one = |mut nudge: Nudge| {
                let s = self.twin(i / 2, &rule, long, Some(&mut nudge))[i % 2];
                entries_alike((s.value, s.kept, s.residual), found, by_rounding)
            };
            !device.exact && nudges().any(one)
        };
        decisions(&found, &expected, tolerance, &is_explained).unwrap();
    }
}

/// Value, number and residual of each triangle, from what a pass wrote.
fn entries(values: &Readback, support: &Readback) -> Readback {
    let value = |word: u32| match word {
        POISON => POISON,
        0 => 0,
        word => !word,
    };
    let together = |values: &[u32], support: &[u32]| {
        let pairs = values.iter().zip(support.chunks_exact(2));
        pairs.flat_map(|(&word, support)| [value(word), support[0], support[1]]).collect()
    };
    Readback {
        before: together(&values.before, &support.before),
        words: together(&values.words, &support.words),
    }
}

fn all_rules() -> impl Iterator<Item = (Outliers, Statistic)> {
    [Outliers::Iqr, Outliers::Deviation, Outliers::None]
        .into_iter()
        .flat_map(|outliers| [Statistic::Mean, Statistic::Median].map(|statistic| (outliers, statistic)))
}

/// Mean numbers of points per face, for which the engine takes 1, 2, 4, 8, 16 and 32 lanes to a face.
const MEANS: [u32; 6] = [2, 6, 15, 38, 86, 195];

/// Sizes of 60 faces with that mean: about every boundary up to the capacity of a short face and one beyond
/// it, which the pass must leave alone.
fn sizes(mean: u32, capacity: u32, width: u32) -> Vec<u32> {
    let boundaries = [0, 1, 2, 3, 4, 5, 7, 8, 9, 31, 32, 33, 127, 128, 129];
    let own = [width - 1, width, width + 1, capacity - 1, capacity, capacity + 1];
    let mut sizes: Vec<u32> = boundaries.into_iter().chain(own).filter(|&n| n <= capacity + 1).collect();
    let (rest, faces) = (60 * mean - sizes.iter().sum::<u32>(), 60 - sizes.len() as u32);
    sizes.extend((0..faces).map(|face| rest * (face + 1) / faces - rest * face / faces));
    assert_eq!((sizes.len(), sizes.iter().sum::<u32>()), (60, 60 * mean));
    sizes
}

/// An engine, a pass with which it measures short faces, and the lanes and mean points per face for which it
/// does.
type Way = (&'static Device, &'static str, Vec<(u32, u32)>);

fn ways() -> Vec<Way> {
    let mut ways = Vec::new();
    // Where the device is not known to be a program, another pass measures the faces that one invocation could.
    let all = |device: &Device| {
        let adapter = device.engine.adapter();
        let few = u32::from(!adapter.is_some_and(|adapter| adapter.is_software()));
        LANES.into_iter().zip(MEANS).filter(move |(lanes, _)| *lanes > few)
    };
    for device in [device(), device_of_a_host()].into_iter().flatten() {
        if let Some(width) = device.engine.subgroup_width() {
            ways.push((device, "measure_short", all(device).filter(|(lanes, _)| *lanes <= width).collect()));
        }
    }
    if let Some(device) = device_without_subgroups() {
        ways.push((device, "measure_short_shared", all(device).collect()));
    }
    ways
}

#[test]
fn measure_short_is_its_twins_with_every_number_of_lanes() {
    for (device, pass, lanes_and_means) in ways() {
        for (lanes, mean) in lanes_and_means {
            let sizes = sizes(mean, 8 * lanes, device.engine.subgroup_width().unwrap_or(8));
            for pattern in PATTERNS {
                for (outliers, statistic) in all_rules() {
                    let settings = Settings::default().with_outliers(outliers).with_statistic(statistic);
                    let faces = Faces::new(&settings, &sizes, pattern);
                    let count = faces.points.len() as u32;
                    let workspace = device.engine.prepare(count, RADIUS_MM, &settings).unwrap();
                    assert_eq!(workspace.parameters().max_short, 8 * lanes);
                    faces.agrees(device, &settings, pass);
                }
            }
        }
    }
}

#[test]
fn measure_short_takes_blocks_of_faces_that_do_not_fill_a_workgroup() {
    for (device, pass, lanes_and_means) in ways() {
        for (lanes, mean) in lanes_and_means {
            // A workgroup has 128 / lanes faces.
            let block = 128 / lanes;
            for faces in [3.max(block - 1), 3.max(block), block + 1, 2 * block + 1] {
                let settings = Settings::default().with_nodes(faces).with_levels(1);
                let sizes: Vec<u32> = (0..faces).map(|face| mean / 2 + face % mean.max(2)).collect();
                Faces::new(&settings, &sizes, Pattern::Random).agrees(device, &settings, pass);
            }
        }
    }
}

/// Faces with very few points on a device that is not known to be a program: about every boundary of what an invocation
/// measures, in workgroups that they do not fill, with more points than a workgroup shares out at a time.
#[test]
fn measure_few_is_its_twin() {
    let Some(device) = device_of_a_host() else { return };
    let boundaries = [0, 1, 2, 3, 7, 8, 9, 10, 14, 15, 16, 17, 33, 64, 65];
    for (faces, others, place, few) in [
        (128, [0, 1], 0, 0),
        (127, [1, 1], 100, 0),
        (300, [0, 5], 0, 0),
        (300, [0, 5], 100, 12),
        (400, [1, 0], 100, 20),
    ] {
        let mut sizes: Vec<u32> = (0..faces).map(|face| others[face % 2]).collect();
        sizes[place..place + boundaries.len()].copy_from_slice(&boundaries);
        sizes[20..20 + few].fill(11);
        let mean = f64::from(sizes.iter().sum::<u32>()) / faces as f64;
        assert!(mean + 2.0 * mean.sqrt() <= 8.0, "{mean} points a face");
        for pattern in PATTERNS {
            for (outliers, statistic) in all_rules() {
                let settings = Settings::default()
                    .with_nodes(faces as u32)
                    .with_levels(1)
                    .with_outliers(outliers)
                    .with_statistic(statistic);
                let faces = Faces::new(&settings, &sizes, pattern);
                faces.agrees(device, &settings, "measure_few");
                let middle = match device.engine.subgroup_width().is_some_and(|width| width >= 8) {
                    true => "measure_middle",
                    false => "measure_middle_shared",
                };
                faces.agrees(device, &settings, middle);
                faces.agrees(device, &settings, "measure_long");
            }
        }
    }
}

/// Whole fits whose faces have so few points on average.
#[test]
fn faces_of_few_points_are_the_cpu_s() {
    let Some(device) = device_of_a_host() else { return };
    for points in [1_000, 9_000] {
        for (outliers, statistic) in all_rules() {
            let settings = Settings::default()
                .with_nodes(64)
                .with_levels(48)
                .with_outliers(outliers)
                .with_statistic(statistic);
            let section = wall(points, 251);
            let workspace = device.engine.prepare(points as u32, RADIUS_MM, &settings).unwrap();
            assert_eq!(workspace.parameters().max_short, 16);
            let found = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            let expected = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            assert_agree(device, &found, &expected, &section, &settings);
        }
    }
}

/// Faces of up to and beyond that many points, so many on average that none is a short one.
fn long_sizes(most: u32) -> Vec<u32> {
    let mut sizes =
        vec![257, 256, 258, 511, 512, 513, 0, 1, 2, 3, 1000, 4096, most - 1, most, most + 1, 2 * most];
    sizes.resize(80, 20);
    sizes
}

#[test]
fn measure_long_is_its_twins() {
    let Some(device) = device_of_a_host() else { return };
    for pattern in PATTERNS {
        for (outliers, statistic) in all_rules() {
            let settings =
                Settings::default().with_nodes(16).with_outliers(outliers).with_statistic(statistic);
            let faces = Faces::new(&settings, &long_sizes(50_000), pattern);
            let count = faces.points.len() as u32;
            let workspace = device.engine.prepare(count, RADIUS_MM, &settings).unwrap();
            assert_eq!([workspace.parameters().max_short, workspace.parameters().max_narrow], [0, 0]);
            faces.agrees(device, &settings, "measure_long");
            faces.agrees(device, &settings, "measure_long_keyed");
            if device.engine.device().limits().max_compute_invocations_per_workgroup >= 1024 {
                faces.agrees(device, &settings, "measure_long_wide");
            }
        }
    }
}

#[test]
fn measure_narrow_is_its_twin_and_leaves_longer_faces_to_workgroups() {
    let Some(device) = device().filter(|device| device.is_narrow()) else { return };
    let agrees = |settings: &Settings, sizes: &[u32], pattern: Pattern, most: u32| {
        let faces = Faces::new(settings, sizes, pattern);
        let workspace = device.engine.prepare(faces.points.len() as u32, RADIUS_MM, settings).unwrap();
        assert_eq!([workspace.parameters().max_short, workspace.parameters().max_narrow], [0, most]);
        faces.agrees(device, settings, "measure_narrow");
        if sizes.iter().any(|&size| size > most) {
            faces.agrees(device, settings, "measure_long");
        }
    };
    for (outliers, statistic) in all_rules() {
        let settings = Settings::default().with_nodes(16).with_outliers(outliers).with_statistic(statistic);
        for pattern in PATTERNS {
            let mut sizes = long_sizes(1024);
            [sizes[78], sizes[79]] = [10_000, 10_000];
            agrees(&settings, &sizes, pattern, 1024);
        }
        // Twice the mean, at most, and all where there are few.
        let settings = settings.with_nodes(3).with_levels(1);
        agrees(&settings, &[24_000, 5999, 6001], Pattern::Random, 24_000);
        agrees(&settings, &[24_001, 5999, 6000], Pattern::Sorted, 24_000);
        agrees(&settings, &[32_768, 32_769, 65_536], Pattern::Skewed, 32_768);
        agrees(&settings, &[300, 30_000, 2_468], Pattern::Random, 32_768);
    }
}

/// Whole fits whose faces several workgroups share, about the number of points from which they do.
#[test]
fn faces_of_very_many_points_are_shared_between_workgroups() {
    let Some(device) = device_of_a_host() else { return };
    for points in [60 * 2048 - 1, 60 * 2048] {
        for (outliers, statistic) in all_rules() {
            let settings = Settings::default().with_outliers(outliers).with_statistic(statistic);
            let section = wall(points, 239);
            let found = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            let expected = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            assert_agree(device, &found, &expected, &section, &settings);
        }
    }
}

/// 300 faces with some of these sizes and others, so that the mean is as given.
fn with_others(mut sizes: Vec<u32>, mean: u32) -> (Settings, Vec<u32>) {
    let (rest, others) = (300 * mean - sizes.iter().sum::<u32>(), 300 - sizes.len() as u32);
    sizes.extend((0..others).map(|face| rest * (face + 1) / others - rest * face / others));
    (Settings::default().with_nodes(20).with_levels(15), sizes)
}

/// The lanes of a face of middle size, where there is one.
fn middle_lanes(device: &Device, lanes: u32) -> Option<u32> {
    let (growth, most) = match device.engine.subgroup_width() {
        Some(width) if device.is_narrow() => (2, width),
        _ => (8, 32),
    };
    (lanes < most).then_some((growth * lanes).min(most))
}

#[test]
fn measure_middle_is_its_twin_with_every_number_of_lanes() {
    for (device, _, lanes_and_means) in ways() {
        for (lanes, mean) in lanes_and_means {
            let Some(middle) = middle_lanes(device, lanes) else { continue };
            let width = device.engine.subgroup_width();
            let pass = match width.is_some_and(|width| middle <= width) {
                true => "measure_middle",
                false => "measure_middle_shared",
            };
            let [least, most] = [8 * lanes + 1, 8 * middle];
            let sizes = vec![least, least - 1, least + 1, most - 1, most, most + 1];
            let (settings, sizes) = with_others(sizes, mean);
            for pattern in PATTERNS {
                for (outliers, statistic) in all_rules() {
                    let settings = settings.clone().with_outliers(outliers).with_statistic(statistic);
                    Faces::new(&settings, &sizes, pattern).agrees(device, &settings, pass);
                }
            }
        }
    }
}

#[test]
fn measure_long_begins_right_above_each_capacity() {
    for (device, _, lanes_and_means) in ways() {
        for (lanes, mean) in lanes_and_means {
            let capacity = 8 * middle_lanes(device, lanes).unwrap_or(lanes);
            let (settings, sizes) =
                with_others(vec![capacity + 1, capacity, capacity + 2, 2 * capacity], mean);
            let faces = Faces::new(&settings, &sizes, Pattern::Random);
            let workspace = device.engine.prepare(300 * mean, RADIUS_MM, &settings).unwrap();
            assert_eq!(workspace.parameters().max_middle, capacity);
            let pass = if device.is_narrow() { "measure_narrow" } else { "measure_long" };
            faces.agrees(device, &settings, pass);
        }
    }
}

/// More faces of middle size, of several cylinders, than workgroups have room for at a time.
#[test]
fn many_faces_of_middle_size_are_all_measured() {
    for (device, _, _) in ways().into_iter().filter(|(device, ..)| !device.is_narrow()) {
        let settings = Settings::default().with_nodes(100).with_levels(90);
        let sizes: Vec<u32> = (0..9000).map(|face| if face % 3 == 0 { 9 + face % 50 } else { 0 }).collect();
        let mean = sizes.iter().sum::<u32>() / 9000;
        assert!(mean > 8);
        let pass = match device.engine.subgroup_width().is_some_and(|width| width >= 32) {
            true => "measure_middle",
            false => "measure_middle_shared",
        };
        Faces::new(&settings, &sizes, Pattern::Random).agrees(device, &settings, pass);
    }
}

#[test]
fn more_long_faces_than_workgroups_are_all_measured() {
    // At most 1024 workgroups take the long faces in turn.
    let settings = Settings::default().with_nodes(50).with_levels(30);
    let faces = Faces::new(&settings, &[300; 1500], Pattern::Random);
    for device in [device(), device_of_a_host()].into_iter().flatten() {
        let pass = if device.is_narrow() { "measure_narrow" } else { "measure_long" };
        faces.agrees(device, &settings, pass);
    }
}

#[test]
fn whole_fits_are_the_same_with_subgroups_and_without() {
    let (Some(with), Some(without)) = (device(), device_without_subgroups()) else { return };
    for (nodes, levels, points) in [(64, 48, 6_000), (64, 48, 40_000), (12, 5, 2_000), (12, 5, 9_000)] {
        for (outliers, statistic) in all_rules() {
            let settings = Settings::default()
                .with_nodes(nodes)
                .with_levels(levels)
                .with_outliers(outliers)
                .with_statistic(statistic);
            let section = wall(points, 233);
            let fit =
                |device: &Device| device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            assert_same(&fit(with), &fit(without));
        }
    }
}
