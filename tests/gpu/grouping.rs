//! The passes that group points by face, `bin` to `scatter`, against their twins.

use crate::compare::{Tolerance, integers, numbers, places};
use crate::device::{Device, Readback, device, device_of_a_host, device_without_subgroups};
use crate::sections::{RADIUS_MM, coordinates, seeded, wall};
use lumenmesh::cylinders::Tube;
use lumenmesh::cylinders::{FitRequest, Track};
use lumenmesh::low_level::cylinders::group;
use lumenmesh::low_level::cylinders::passes::{
    FitParameters, LIST_HEAD, Section, TubeGrid, bin, listed_faces, scan_downsweep, scan_reduce, scan_spine,
};
use lumenmesh::settings::Settings;
use rand::RngExt;
use std::iter::repeat_n;

/// The owner of a point that is in no face.
const NONE: u32 = u32::MAX;

/// About the 256 invocations of a workgroup, and several workgroups.
const POINTS: [usize; 9] = [0, 1, 2, 255, 256, 257, 1023, 1025, 20_000];

/// The face of each point.
pub fn faces(section: &Section<f32>, tube: &Tube) -> Vec<u32> {
    let grid = TubeGrid::<f32>::new(tube);
    (0..section.len())
        .map(|i| {
            let (level, node) = grid.face(section.theta[i], section.z[i]);
            level * grid.nodes + node
        })
        .collect()
}

/// Differences of offsets.
fn counts(offsets: &[u32]) -> Vec<u32> {
    offsets.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// `bin` on a section, then `scatter` with the twin's places.
pub fn bins_and_scatters(device: &Device, section: &Section<f32>, settings: &Settings) {
    let tube = Tube::new(settings);
    let groups = group(section, &tube);
    let face_of_each = faces(section, &tube);
    let workspace = device.engine.prepare(section.len() as u32, RADIUS_MM, settings).unwrap();
    let coordinates = coordinates(section);
    let points = ("section", bytemuck::cast_slice(&coordinates));
    let none = vec![0_u32; tube.face_count()];

    let counts_of_none = ("counts", bytemuck::cast_slice(&none));
    if section.is_empty() {
        let [counted] = device.run(&workspace, "bin", &[points, counts_of_none], ["counts"]);
        assert_eq!(counted.words, counted.before);
        return;
    }
    // In the order of the points, as the twin places them.
    let mut of_twin = none.clone();
    let in_order = bin(section, None, &TubeGrid::new(&tube), &mut of_twin);
    assert!(in_order.iter().map(|[face, _]| face).eq(&face_of_each));
    assert_eq!(counts(&groups.offsets), of_twin);
    let passes = if tube.face_count() <= 1024 { &["bin", "bin_few"][..] } else { &["bin"] };
    for pass in passes {
        let [counted, placed] = device.run(&workspace, pass, &[points, counts_of_none], ["counts", "places"]);
        integers(&counted, &of_twin).unwrap();
        places(&placed, &face_of_each, tube.face_count()).unwrap();
    }
    let faces_then_places: Vec<u32> =
        [0, 1].iter().flat_map(|&of| in_order.iter().map(move |pair: &[u32; 2]| pair[of])).collect();
    let inputs = [
        points,
        ("places", bytemuck::cast_slice(&faces_then_places)),
        ("offsets", bytemuck::cast_slice(&groups.offsets)),
    ];
    let [grouped] = device.run(&workspace, "scatter", &inputs, ["grouped"]);
    // θ and z less that of the corner: one product, one or two differences.
    let tolerance = Tolerance::of(device.exact, 4.0, 2.0 * std::f64::consts::TAU.max(settings.height_mm));
    let agrees = |grouped: &Readback, points: &[[f32; 3]]| {
        let [coordinates, faces] = [true, false].map(|coordinate| of_points(grouped, coordinate));
        numbers(&coordinates, points.as_flattened(), tolerance).unwrap();
        let face_of_each = (0..).zip(&of_twin).flat_map(|(face, &count)| repeat_n(face, count as usize));
        integers(&faces, &face_of_each.collect::<Vec<u32>>()).unwrap();
    };
    agrees(&grouped, &groups.points);

    if tube.face_count() <= 1024 {
        for pass in at_once(device) {
            let outputs = ["offsets", "listed_faces", "grouped"];
            let [offsets, listed, grouped] = device.run(&workspace, pass, &[points], outputs);
            integers(&offsets, &groups.offsets).unwrap();
            let expected = listed_faces(&of_twin, workspace.parameters(), listed.words.len());
            same_list(&listed, &expected, workspace.parameters());
            agrees(&as_ordered(&grouped, &groups.offsets, &groups.points), &groups.points);
        }
    }
}

/// The passes in which one workgroup groups the points.
fn at_once(device: &Device) -> Vec<&'static str> {
    let wide = device.engine.device().limits().max_compute_invocations_per_workgroup >= 1024;
    [Some("group_few"), wide.then_some("group_few_wide")].into_iter().flatten().collect()
}

/// Grouped points, whose order within a face is any, each at the place of the nearest of `points`.
fn as_ordered(grouped: &Readback, offsets: &[u32], points: &[[f32; 3]]) -> Readback {
    let found: Vec<[u32; 4]> = grouped.words.as_chunks().0.to_vec();
    let mut words = found.clone();
    for ends in offsets.windows(2) {
        let places = ends[0] as usize..ends[1] as usize;
        let mut left = found[places.clone()].to_vec();
        for place in places {
            let apart = |point: &[u32; 4]| -> f32 {
                let numbers = point.iter().zip(points[place]);
                numbers.map(|(bits, expected)| (f32::from_bits(*bits) - expected).abs()).sum()
            };
            let nearest = (0..left.len()).min_by(|&a, &b| apart(&left[a]).total_cmp(&apart(&left[b])));
            words[place] = left.swap_remove(nearest.unwrap());
        }
    }
    Readback { before: grouped.before.clone(), words: words.as_flattened().to_vec() }
}

/// Lists of long faces, of those that a subgroup measures and of those of middle size, each in any order.
fn same_list(found: &Readback, expected: &[u32], parameters: &FitParameters) {
    let words = found.words.len();
    assert_eq!([found.words[0], found.words[2], found.words[3]], [expected[0], expected[2], expected[3]]);
    let [long, middle, narrow] = [0, 2, 3].map(|i| expected[i] as usize);
    let first_narrow = LIST_HEAD + parameters.most_long as usize;
    for part in [LIST_HEAD..LIST_HEAD + long, first_narrow..first_narrow + narrow, words - middle..words] {
        let (mut found, mut expected) = (found.words[part.clone()].to_vec(), expected[part].to_vec());
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected);
    }
}

/// The coordinates of grouped points, or their faces.
fn of_points(grouped: &Readback, coordinates: bool) -> Readback {
    let part = |words: &[u32]| match coordinates {
        true => words.chunks_exact(4).flat_map(|point| point[..3].iter().copied()).collect(),
        false => words.chunks_exact(4).map(|point| point[3]).collect(),
    };
    Readback { before: part(&grouped.before), words: part(&grouped.words) }
}

#[test]
fn bin_and_scatter_are_their_twin() {
    let Some(device) = device() else { return };
    for (nodes, levels) in [(12, 5), (3, 1), (32, 32), (205, 5), (64, 48)] {
        for count in POINTS {
            let settings = Settings::default().with_nodes(nodes).with_levels(levels);
            bins_and_scatters(device, &wall(count, 17), &settings);
        }
    }
}

/// More points than a window has, window by window of faces.
#[test]
fn scatter_writes_window_by_window() {
    let Some(device) = device_of_a_host() else { return };
    let settings = Settings::default().with_nodes(64).with_levels(48);
    let count = (1 << 22) + 1;
    let workspace = device.engine.prepare(count, RADIUS_MM, &settings).unwrap();
    assert_eq!(workspace.parameters().window, 64 * 48 / 2);
    bins_and_scatters(device, &wall(count as usize, 241), &settings);
}

#[test]
fn bin_and_scatter_keep_cylinders_apart_and_leave_out_points_without_one() {
    let Some(device) = device() else { return };
    let settings = Settings::default();
    let track = Track::of(&crate::sections::recording(30, 80, 5), &settings).unwrap();
    let request = FitRequest::new(&track, &[9, 19, 29], &settings);
    let [workspace] = &device.engine.prepare_request(&request).unwrap()[..] else { panic!("one batch") };
    let tube = Tube::new(&settings);
    let slots = workspace.parameters().slots as usize;
    let section = wall(slots, 6);
    let mut rng = seeded(7);
    let owners: Vec<u32> = (0..slots).map(|_| [0, 1, 2, NONE][rng.random_range(0..4)]).collect();
    let face_of_each: Vec<u32> = faces(&section, &tube)
        .iter()
        .zip(&owners)
        .map(|(face, owner)| if *owner == NONE { NONE } else { owner * 60 + face })
        .collect();
    let mut expected = vec![0_u32; 180];
    face_of_each.iter().filter(|&&f| f != NONE).for_each(|&f| expected[f as usize] += 1);
    let coordinates = coordinates(&section);
    let inputs = [
        ("section", bytemuck::cast_slice(&coordinates)),
        ("owners", bytemuck::cast_slice(&owners)),
        ("counts", bytemuck::cast_slice(&[0_u32; 180])),
    ];
    for pass in ["bin", "bin_few"] {
        let [counted, placed] = device.run(workspace, pass, &inputs, ["counts", "places"]);
        integers(&counted, &expected).unwrap();
        places(&placed, &face_of_each, 180).unwrap();
    }
    let sums = expected.iter().scan(0, |sum, count| {
        *sum += count;
        Some(*sum)
    });
    let offsets: Vec<u32> = std::iter::once(0).chain(sums).collect();
    for pass in at_once(device) {
        let [found, grouped] = device.run(workspace, pass, &inputs[..2], ["offsets", "grouped"]);
        integers(&found, &offsets).unwrap();
        let of_each = (0..180).flat_map(|face: u32| repeat_n(face, expected[face as usize] as usize));
        let faces = of_points(&grouped, false);
        let count = offsets[180] as usize;
        assert_eq!(faces.words[..count], of_each.collect::<Vec<_>>());
        // Places of points that belong to no face stay as they were.
        assert_eq!(faces.words[count..], faces.before[count..]);
    }
    let mut of_twin = vec![0_u32; 180];
    let twin = bin(&section, Some(&owners), &TubeGrid::new(&tube), &mut of_twin);
    assert_eq!(of_twin, expected);
    assert!(twin.iter().map(|[face, _]| face).eq(&face_of_each));
}

#[test]
fn the_scan_is_a_running_sum() {
    let Some(device) = device() else { return };
    let mut rng = seeded(23);
    // About the 4, 256 and 1024 faces of an invocation, a workgroup and a block, and the 256 blocks of one turn
    // of the spine.
    for faces in [3, 4, 5, 255, 256, 257, 1023, 1024, 1025, 262_143, 262_144, 262_145, 600_000] {
        let settings = Settings::default().with_nodes(faces).with_levels(1);
        let workspace = device.engine.prepare(10, RADIUS_MM, &settings).unwrap();
        let counts: Vec<u32> = (0..faces).map(|_| rng.random_range(0..9)).collect();
        let counts_bytes = ("counts", bytemuck::cast_slice(&counts));

        let sums: Vec<u32> = counts.chunks(1024).map(|block| block.iter().sum()).collect();
        let [found] = device.run(&workspace, "scan_reduce", &[counts_bytes], ["block_sums"]);
        integers(&found, &sums).unwrap();
        assert_eq!(scan_reduce(&counts), sums);

        let mut before: Vec<u32> = Vec::new();
        let mut sum = 0;
        for own in &sums {
            before.push(sum);
            sum += own;
        }
        let inputs = [("block_sums", bytemuck::cast_slice(&sums))];
        let [found] = device.run(&workspace, "scan_spine", &inputs, ["block_sums"]);
        integers(&found, &before).unwrap();
        let mut of_twin = sums.clone();
        scan_spine(&mut of_twin);
        assert_eq!(of_twin, before);

        let mut offsets = vec![0];
        offsets.extend(counts.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        }));
        let inputs = [
            counts_bytes,
            ("block_sums", bytemuck::cast_slice(&before)),
            ("listed_faces", bytemuck::cast_slice(&[0_u32; LIST_HEAD])),
        ];
        let [found] = device.run(&workspace, "scan_downsweep", &inputs, ["offsets"]);
        integers(&found, &offsets).unwrap();
        assert_eq!(scan_downsweep(&counts, &before), offsets);
    }
}

/// The list that the device makes of faces with so many points each is the twin's; returns that.
fn list_agrees(device: &Device, counts: &[u32], most: [u32; 3]) -> Vec<u32> {
    let settings = Settings::default().with_nodes(counts.len() as u32).with_levels(1);
    let workspace = device.engine.prepare(counts.iter().sum(), RADIUS_MM, &settings).unwrap();
    let FitParameters { max_short, max_middle, max_narrow, .. } = *workspace.parameters();
    assert_eq!([max_short, max_middle, max_narrow], most);
    let mut before = scan_reduce(counts);
    scan_spine(&mut before);
    let inputs = [
        ("counts", bytemuck::cast_slice(counts)),
        ("block_sums", bytemuck::cast_slice(&before)),
        ("listed_faces", bytemuck::cast_slice(&[0_u32, 7, 0, 0])),
    ];
    let [found] = device.run(&workspace, "scan_downsweep", &inputs, ["listed_faces"]);
    let expected = listed_faces(counts, workspace.parameters(), found.words.len());
    same_list(&found, &expected, workspace.parameters());
    // Another pass's word.
    assert_eq!(found.words[1], 7);
    expected
}

#[test]
fn listed_faces_are_those_above_the_capacities() {
    let Some(device) = device_without_subgroups() else { return };
    let mut rng = seeded(29);
    for faces in [3_u32, 255, 256, 257, 1023, 1024, 1025] {
        let of_face = |face: u32| match face % 40 {
            0 => 32,
            1 | 21 => 33,
            2 => 0,
            3 => 257,
            4 => 256,
            _ => rng.random_range(0..5),
        };
        let counts: Vec<u32> = (0..faces).map(of_face).collect();
        // So many points per face that four lanes measure a short one and 32 one of middle size.
        let expected = list_agrees(device, &counts, [32, 256, 256]);
        assert!(faces < 4 || (expected[0] > 0 && expected[2] > 1));
    }
}

#[test]
fn listed_faces_of_subgroups_follow_the_long_ones() {
    let Some(device) = device().filter(|device| device.is_narrow()) else { return };
    // So many points per face that none is a short one, and that eight lanes measure one.
    for (faces, short) in [(300, 0), (2000, 64)] {
        let mut counts = vec![30; faces];
        [counts[0], counts[1], counts[2], counts[faces - 1]] = [1024, 1025, 24_000, 9000];
        let expected = list_agrees(device, &counts, [short, short, 1024]);
        assert_eq!(expected[..4], [3, 0, 0, if short == 0 { faces as u32 - 3 } else { 1 }]);
    }
}
