//! Vessels that branch, frame by frame.

use crate::support::vessel::{bits, coverage, mean_error_mm, simulated};
use lumenmesh::glam::DVec3;
use lumenmesh::reconstruction::Live;
use lumenmesh::settings::{Branches, Settings};
use lumenmesh::simulate::{Insertion, Simulation, SimulationSettings, Visit};
use lumenmesh::surface::Surface;

fn visiting(shape: &str, visits: &[usize], insertion: Insertion) -> Simulation {
    let visits = visits.iter().map(|&branch| Visit::new(branch, None)).collect();
    let insertion = insertion.with_visits(visits);
    simulated(shape, &SimulationSettings::default().with_insertion(insertion))
}

fn settings(branches: Branches) -> Settings {
    let mut settings = Settings::default();
    settings.branches = branches;
    settings
}

/// The live vessel after all frames, and what a host has that follows `Change`: nodes of every ring.
fn followed(simulation: &Simulation, branches: Branches) -> (Live, Vec<Vec<DVec3>>) {
    let mut live = Live::new(&settings(branches)).unwrap();
    let mut host: Vec<Vec<DVec3>> = Vec::new();
    let mut follow = |live: &Live, change: lumenmesh::reconstruction::Change| {
        host.splice(0..0, std::iter::repeat_n(Vec::new(), change.before));
        host.resize(change.rings, Vec::new());
        for range in change.changed {
            let part = live.part(range.clone());
            for (ring, nodes_mm) in range.zip(part.nodes_mm.chunks(live.nodes())) {
                host[ring] = nodes_mm.to_vec();
            }
        }
    };
    for frame in &simulation.recording.frames {
        let change = live.push(frame).unwrap();
        follow(&live, change);
    }
    let change = live.flush().unwrap();
    follow(&live, change);
    (live, host)
}

/// Triangles with an edge of more than a tenth of the surface's size: they would join what does not belong together.
fn long_triangles(surface: &Surface) -> usize {
    let [low, high] = surface.bounding_box_mm().unwrap();
    let limit_mm = low.distance(high) / 10.0;
    let length_mm = |a: u32, b: u32| surface.nodes_mm[a as usize].distance(surface.nodes_mm[b as usize]);
    let is_long = |[a, b, c]: &&[u32; 3]| length_mm(*a, *b).max(length_mm(*b, *c)) > limit_mm;
    surface.triangles.iter().filter(is_long).count()
}

#[test]
fn a_branch_opens_when_the_catheter_enters_it() {
    for (shape, visits) in [("bifurcation", &[0, 1][..]), ("side_branch", &[0, 1]), ("tree", &[0, 1, 2, 3])] {
        // The tree in one way; the others with returns, detours and rests.
        let insertion = if shape == "tree" { Insertion::steady() } else { Insertion::default() };
        let simulation = visiting(shape, visits, insertion);
        let (live, host) = followed(&simulation, Branches::Auto);
        let surface = live.surface();
        let mean_mm = mean_error_mm(&surface, simulation.vessel.surface());
        let covered = coverage(&surface, &simulation.truth_recording);
        println!("{shape}: {} walls, mean {mean_mm:.3} mm, coverage {covered:.4}", live.branches());
        assert_eq!(live.branches(), visits.len(), "{shape}");
        assert!(mean_mm < 0.1, "{shape}: {mean_mm}");
        assert!(covered > 0.95, "{shape}: {covered}");
        assert_eq!(long_triangles(&surface), 0, "{shape}: walls are not joined to each other");

        if shape == "tree" {
            let (single, _) = followed(&simulation, Branches::Off);
            assert_eq!(single.branches(), 1);
            let of_one = coverage(&single.surface(), &simulation.truth_recording);
            assert!(of_one < covered - 0.03, "{shape}: {of_one} against {covered}");
        }

        // A host that follows the changes has the vessel as it is; radii keep the noise correction of their time.
        let whole = live.part(0..live.rings());
        assert_eq!(host.len(), live.rings());
        let farthest_mm =
            host.iter().flatten().zip(&whole.nodes_mm).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert_eq!(host.iter().map(Vec::len).sum::<usize>(), whole.nodes_mm.len());
        assert!(farthest_mm < 0.02, "{shape}: {farthest_mm}");
    }
}

#[test]
fn a_vessel_without_branches_has_one_wall() {
    for shape in ["small_arch", "aneurysm", "stenosis"] {
        let settings = SimulationSettings::default().with_insertion(Insertion::steady());
        let simulation = simulated(shape, &settings);
        let (live, _) = followed(&simulation, Branches::Auto);
        let (off, _) = followed(&simulation, Branches::Off);
        assert_eq!(live.branches(), 1, "{shape}");
        assert!(bits(&live.surface()) == bits(&off.surface()), "{shape}");
    }
}

#[test]
fn walls_go_on_from_a_snapshot() {
    let simulation = visiting("bifurcation", &[0, 1], Insertion::steady());
    let frames = &simulation.recording.frames;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.state");
    let mut whole = Live::new(&settings(Branches::Auto)).unwrap();
    let mut again = None;
    let mut written = [false; 2];
    for (k, frame) in frames.iter().enumerate() {
        let change = whole.push(frame).unwrap();
        if let Some(again) = &mut again {
            assert!(Live::push(again, frame).unwrap() == change, "frame {k}");
        }
        // While frames wait for a wall, and with two walls.
        let is_due = [change.off_axis && whole.branches() == 1, whole.branches() == 2];
        if (0..2).any(|i| is_due[i] && !std::mem::replace(&mut written[i], true)) {
            whole.snapshot(&path).unwrap();
            again = Some(Live::restore(&path).unwrap());
        }
    }
    assert_eq!((whole.branches(), written), (2, [true; 2]));
    assert!(again.unwrap().surface().nodes_mm == whole.surface().nodes_mm);
}
