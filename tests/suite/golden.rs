//! The cylinders of an independent f64 implementation of the published method.

use glam::DVec2;
use lumenmesh::cylinders::Tube;
use lumenmesh::cylinders::{CpuEngine, Engine, FitRequest, FittedCylinder, Track};
use lumenmesh::low_level::cylinders::passes::{
    Face, Filter, Gate, Section, TubeGrid, TubeTransform, distance, fill, measure_long, project, update,
};
use lumenmesh::low_level::cylinders::{Groups, group};
use lumenmesh::low_level::numerics::Scalar;
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Settings, Statistic};
use std::collections::BTreeMap;
use std::path::Path;

/// (frame, iteration, ring, node) → radius in mm.
type Radii = BTreeMap<(usize, usize, usize, usize), f64>;

fn read_golden(path: &Path) -> Radii {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let mut cells = line.split(',');
            let mut index = || cells.next().unwrap().parse::<usize>().unwrap();
            let key = (index(), index(), index(), index());
            (key, cells.next().unwrap().parse().unwrap())
        })
        .collect()
}

fn radii(cylinders: &[FittedCylinder]) -> Radii {
    let mut radii = Radii::new();
    for c in cylinders {
        for (iteration, history) in c.tube.history_mm.iter().enumerate() {
            for (index, radius) in history.iter().enumerate() {
                let nodes = c.tube.tube.nodes;
                radii.insert((c.frame, iteration, index / nodes, index % nodes), *radius);
            }
        }
    }
    radii
}

/// What one golden file was made from.
struct Case {
    golden: Radii,
    recording: Recording,
    track: Track,
    frames: Vec<usize>,
    settings: Settings,
}

impl Case {
    fn fit<T: Scalar>(&self) -> Radii {
        let job = FitRequest::new(&self.track, &self.frames, &self.settings).with_history(true);
        radii(&CpuEngine::<T>::new().fit(&job).unwrap().cylinders)
    }
}

fn cases() -> impl Iterator<Item = Case> {
    [
        ("adult_aorta_clean_n24_l8_mean", "adult_aorta_clean", 24, 8, Statistic::Mean),
        ("adult_aorta_noisy_n12_l5_mean", "adult_aorta_noisy", 12, 5, Statistic::Mean),
        ("adult_aorta_noisy_n12_l5_median", "adult_aorta_noisy", 12, 5, Statistic::Median),
    ]
    .into_iter()
    .map(|(golden, recording, nodes, levels, statistic)| {
        // Without these files nothing shows that the method is the published one: that is no test to skip.
        let file = |name: String| {
            crate::support::shared(&name).unwrap_or_else(|| {
                panic!("{name} is missing: LUMENMESH_SHARED names the folder of shared data")
            })
        };
        let golden = read_golden(&file(format!("golden/{golden}.csv")));
        let recording = file(format!("recordings/{recording}.mat"));
        let settings = Settings::default().with_nodes(nodes).with_levels(levels).with_statistic(statistic);
        let recording = Recording::read(&recording).unwrap();
        let track = Track::of(&recording, &settings).unwrap();
        let mut frames: Vec<usize> = golden.keys().map(|k| k.0).collect();
        frames.dedup();
        Case { golden, recording, track, frames, settings }
    })
}

#[test]
fn the_reference_gives_the_golden_radii_to_1e_9_mm() {
    for case in cases() {
        let found = case.fit::<f64>();
        assert_eq!(found.len(), case.golden.len());
        let worst = case.golden.iter().map(|(k, r)| (found[k] - r).abs()).fold(0.0, f64::max);
        // The files hold ten decimals.
        assert!(worst <= 1e-9, "{worst:e} mm");
        // Negative control: a single point that is missing shows.
        let mut fewer = case.recording.clone();
        fewer.frames[case.frames[0]].contour_mm[0] = DVec2::NAN;
        let case = Case { track: Track::of(&fewer, &case.settings).unwrap(), ..case };
        let found = case.fit::<f64>();
        assert!(case.golden.iter().any(|(k, r)| (found[k] - r).abs() > 1e-9));
    }
}

#[test]
fn single_precision_gives_the_golden_radii_to_1e_3_mm_where_no_decision_is_close() {
    for case in cases() {
        let found = case.fit::<f32>();
        let (mut doubtful, mut beyond, mut worst_beyond, mut worst) = (0_usize, 0, 0.0_f64, [0.0_f64; 4]);
        for &frame in &case.frames {
            let doubts = Doubts::of(&case.track, frame, &case.settings);
            for (iteration, doubts) in doubts.per_iteration.iter().enumerate() {
                for (node, &doubt) in doubts.iter().enumerate() {
                    let nodes = case.settings.nodes as usize;
                    let key = (frame, iteration, node / nodes, node % nodes);
                    let error = (found[&key] - case.golden[&key]).abs();
                    worst_beyond = worst_beyond.max(error);
                    beyond += usize::from(error > 1e-3);
                    doubtful += usize::from(doubt);
                    if !doubt {
                        worst[iteration] = worst[iteration].max(error);
                    }
                }
            }
        }
        let share = doubtful as f64 / case.golden.len() as f64;
        println!(
            "{} radii: {:.1} % behind a close decision; of all, {beyond} differ by more than 1e-3 mm (the worst by \
             {worst_beyond:.1e}); of the others the worst by {worst:?} mm, iteration by iteration",
            case.golden.len(),
            100.0 * share
        );
        assert!(worst.iter().all(|&w| w <= 1e-3), "{worst:?} mm");
        // What the bounds below promise is tighter still.
        for (iteration, &w) in worst.iter().enumerate() {
            assert!(w <= radius_bound(iteration), "iteration {iteration}: {w:e} mm");
        }
        assert!(share <= 0.15, "{:.1} % of the radii go unchecked", 100.0 * share);
    }
}

/// How far single precision moves a point of these recordings in r and z (mm) and in r·θ: the transform is rounded
/// once (2⁻²⁴ of up to 32 mm), and so are three products and sums of that size. Checked by the fit of the margins.
const POINT_BOUND_MM: f64 = 1e-5;

/// The same for θ: two ULP at 2π and the share of the point's bound at the least radius, 6 mm.
const ANGLE_BOUND_RAD: f64 = POINT_BOUND_MM / 6.0 + 1e-6;

/// How far a signed distance is off if its nodes are exact: the point's own error and the rounding of about ten
/// operations on numbers below 8.
const DISTANCE_BOUND_MM: f64 = 2.0 * POINT_BOUND_MM;

/// How far a node's radius is off after so many iterations if every decision fell alike: it begins half an ULP of up to
/// 32 mm away, then e' = e + (e + distance).
fn radius_bound(iteration: usize) -> f64 {
    (0..iteration).fold(1e-6, |e, _| 2.0 * e + DISTANCE_BOUND_MM)
}

/// Nodes whose radius hangs on a decision that rounding to single precision could turn: a point on the gate or on the
/// edge of two faces, a point as near to both triangles of its face, a distance on a filter's fence.
///
/// Found along a run in double precision: every decision is tried at all corners of the box that rounding spans.
struct Doubts {
    /// For each iteration from 0 and each node.
    per_iteration: Vec<Vec<bool>>,
}

impl Doubts {
    fn of(track: &Track, frame: usize, settings: &Settings) -> Self {
        let radius_mm = track.cylinder(frame).unwrap().radius_mm;
        let tube = Tube::new(settings);
        let section: Section<f64> = track.section(frame, settings).unwrap();
        let groups = group(&section, &tube);
        let filter_of = Filter::<f64>::new(settings, radius_mm);
        let grid = TubeGrid::<f64>::new(&tube);
        let faces_on_edges = faces_in_doubt(track, frame, settings, &grid);

        let mut radii = vec![radius_mm; tube.node_count()];
        let mut nodes = vec![false; tube.node_count()];
        let mut per_iteration = vec![nodes.clone()];
        for iteration in 0..settings.iterations as usize {
            let off = radius_bound(iteration);
            let (mut statistics, mut doubts) = (Vec::new(), Vec::new());
            for top in [false, true] {
                for (face, on_edge) in faces_on_edges.iter().enumerate() {
                    let corners = corners(&tube, face);
                    let inherited = *on_edge || corners.iter().any(|&c| nodes[c]);
                    let (distances, turns) = distances_of(&groups, &grid, &radii, face, corners, off, top);
                    statistics.push(measure_long(&distances, &filter_of, &mut Vec::new()));
                    doubts.push(inherited || turns || on_a_fence(&distances, off));
                }
            }
            let mut values = Vec::new();
            fill(&statistics, &tube, &mut values);
            spread_to_empty(&statistics.iter().map(|s| s.kept).collect::<Vec<_>>(), &tube, &mut doubts);
            update(&values, &tube, &filter_of, &mut radii);
            for (node, doubt) in nodes.iter_mut().enumerate() {
                *doubt = *doubt || tube.incident_triangles(node).any(|t| doubts[t]);
            }
            per_iteration.push(nodes.clone());
        }
        Self { per_iteration }
    }
}

/// Nodes a, b, b', a' of a face.
fn corners(tube: &Tube, face: usize) -> [usize; 4] {
    let (row, j) = (face - face % tube.nodes, face % tube.nodes);
    let k = tube.next(j);
    [row + j, row + k, row + tube.nodes + k, row + tube.nodes + j]
}

/// Faces that have a point which rounding could put into another face or across the gate, or take from there.
fn faces_in_doubt(track: &Track, frame: usize, settings: &Settings, grid: &TubeGrid<f64>) -> Vec<bool> {
    let cylinder = track.cylinder(frame).unwrap();
    let gate = Gate::<f64>::new(settings, cylinder.radius_mm);
    let (mut exact, mut single) = (Section::<f64>::default(), Section::<f32>::default());
    let all = Gate { half_height: f64::INFINITY, low: 0.0, high: f64::INFINITY };
    let all_single = Gate { half_height: f32::INFINITY, low: 0.0, high: f32::INFINITY };
    for near in track.near(frame, settings).unwrap() {
        let points = &track.echoes_mm()[near.echoes];
        project(points, &TubeTransform::new(&near.cylinder_from_probe), &all, &mut exact);
        project(points, &TubeTransform::new(&near.cylinder_from_probe), &all_single, &mut single);
    }
    let mut doubts = vec![false; (grid.nodes * grid.levels) as usize];
    for i in 0..exact.len() {
        let (r, theta, z) = (exact.r[i], exact.theta[i], exact.z[i]);
        let slack = POINT_BOUND_MM;
        if z.abs() > gate.half_height + slack || r < gate.low - slack || r > gate.high + slack {
            continue;
        }
        // The bounds that all else rests on hold for every point.
        let turn = (f64::from(single.theta[i]) - theta).abs();
        assert!((f64::from(single.r[i]) - r).abs() <= POINT_BOUND_MM);
        assert!((f64::from(single.z[i]) - z).abs() <= POINT_BOUND_MM);
        assert!(turn.min(std::f64::consts::TAU - turn) <= ANGLE_BOUND_RAD, "{turn:e}");

        let inside = |x: f64, low: f64, high: f64| low + slack < x && x < high - slack;
        let gated = !inside(z, -gate.half_height, gate.half_height) || !inside(r, gate.low, gate.high);
        let around = |turn: f64, rise: f64| {
            let theta = (theta + turn).rem_euclid(std::f64::consts::TAU);
            let (level, node) = grid.face(theta, (z + rise).clamp(-gate.half_height, gate.half_height));
            (level * grid.nodes + node) as usize
        };
        let [turn, rise] = [ANGLE_BOUND_RAD, slack];
        let places = [around(-turn, -rise), around(-turn, rise), around(turn, -rise), around(turn, rise)];
        if gated || places.iter().any(|&face| face != places[0]) {
            places.iter().for_each(|&face| doubts[face] = true);
        }
    }
    doubts
}

/// The distances of the points that a face's bottom or top triangle gets, and whether another triangle could get one.
fn distances_of(
    groups: &Groups<f64>,
    grid: &TubeGrid<f64>,
    radii: &[f64],
    face: usize,
    corners: [usize; 4],
    off: f64,
    top: bool,
) -> (Vec<f64>, bool) {
    let [a, b, b_above, a_above] = corners.map(|c| radii[c]);
    let face_of =
        |db: f64, dc: f64, dd: f64| Face::new([b - a + db, b_above - a + dc, a_above - a + dd], grid);
    let (mut distances, mut turns) = (Vec::new(), false);
    for &[r, theta, z] in groups.of_face(face) {
        let p = [r - a, theta, z];
        let (d, nearer_top) = distance(p, &face_of(0.0, 0.0, 0.0), grid);
        if nearer_top == top {
            distances.push(d);
        }
        // Every corner of the box: the point in three directions, three nodes against the fourth.
        turns |= (0..64).any(|corner| {
            let sign = |bit: usize| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
            let reach = DISTANCE_BOUND_MM + off;
            let p =
                [p[0] + sign(0) * reach, p[1] + sign(1) * ANGLE_BOUND_RAD, p[2] + sign(2) * POINT_BOUND_MM];
            let [db, dc, dd] = [sign(3), sign(4), sign(5)].map(|s| s * 2.0 * off);
            distance(p, &face_of(db, dc, dd), grid).1 != nearer_top
        });
    }
    (distances, turns)
}

/// Whether a distance lies as near to a fence of the box plot as rounding reaches. Quartiles move no further than the
/// distances do, so that a fence `q1 - 1.5 (q3 - q1)` moves four times as far at most.
fn on_a_fence(distances: &[f64], off: f64) -> bool {
    let n = distances.len();
    if n < 2 {
        return false;
    }
    let mut sorted = distances.to_vec();
    sorted.sort_by(f64::total_cmp);
    let quantile = |p: f64| sorted[((p * (n as f64 + 1.0)) + 0.5).floor() as usize - 1];
    let (q1, q3) = (quantile(0.25), quantile(0.75));
    let reach = 5.0 * (DISTANCE_BOUND_MM + off);
    let fences = [q1 - 1.5 * (q3 - q1), q3 + 1.5 * (q3 - q1)];
    distances.iter().any(|d| fences.iter().any(|fence| (d - fence).abs() <= reach))
}

/// An empty triangle is as doubtful as the neighbours that it is filled from.
fn spread_to_empty(kept: &[u32], tube: &Tube, doubts: &mut [bool]) {
    let faces = tube.face_count();
    for face in (0..faces).filter(|&f| kept[f] == 0) {
        let (two, third) = tube.bottom_neighbours(face);
        doubts[face] |= two.into_iter().chain(third).any(|f| doubts[faces + f]);
    }
    for face in (0..faces).filter(|&f| kept[faces + f] == 0) {
        let (two, third) = tube.top_neighbours(face);
        doubts[faces + face] |= two.into_iter().chain(third).any(|f| doubts[f]);
    }
}
