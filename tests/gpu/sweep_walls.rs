//! Whole sweeps on the device against the CPU's, which computes in f64.

use crate::device::{device, say};
use crate::recordings::shared;
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::reconstruction::{Lumen, Reconstructor};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Backend, Settings, SweepSettings};
use lumenmesh::simulate::{self, Insertion, Noise, Phantom, Probe, Shape, Simulation, Visit};
use lumenmesh::study::bench::SweepCase;
use lumenmesh::surface::Surface;
use lumenmesh::sweep::Sweep;

fn settings(backend: Backend, nodes: Option<u32>) -> Settings {
    let adapter = std::env::var("LUMENMESH_ADAPTER").ok();
    Settings::default()
        .with_backend(backend)
        .with_adapter(adapter)
        .with_sweep(SweepSettings::default().with_nodes(nodes))
}

/// |Δr| over the nodes that both support, sorted, mm.
fn apart(a: &Sweep, b: &Sweep) -> Vec<f64> {
    assert_eq!(a.radii_mm.len(), b.radii_mm.len());
    let mut apart: Vec<f64> = (0..a.radii_mm.len())
        .filter(|&n| a.support.supported[n] && b.support.supported[n])
        .map(|n| (a.radii_mm[n] - b.radii_mm[n]).abs())
        .collect();
    apart.sort_by(f64::total_cmp);
    apart
}

/// No node of a device's wall is farther from the CPU's, mm.
const MAX_APART_MM: f64 = 0.1;

/// Whether a device's wall is the CPU's. Where echoes are many, f32 costs some 1e-6 mm. Where few hold the wall both are
/// off by more: their equations are solved until a thousandth of the noise is left on average, and one of them may take
/// another step, or another reweighting, to come that far: but no node by more than [`MAX_APART_MM`].
fn agree(found: &Sweep, expected: &Sweep) -> Result<(), String> {
    let apart = apart(found, expected);
    let rank = |share: f64| apart[((apart.len() - 1) as f64 * share) as usize];
    let (a, b) = (&found.report, &expected.report);
    say(&format!(
        "noise {:.4} mm, {} rings of {}: |Δr| median {:.1e}, p99 {:.1e}, max {:.1e} mm; {} and {} steps in {} and {} \
         iterations",
        b.noise_mm,
        b.rings,
        expected.nodes,
        rank(0.5),
        rank(0.99),
        rank(1.0),
        a.solver_steps,
        b.solver_steps,
        a.iterations,
        b.iterations,
    ));
    let differing =
        found.support.supported.iter().zip(&expected.support.supported).filter(|(a, b)| a != b).count();
    let near = rank(0.5) <= 1e-4 && rank(0.99) <= 1e-3 && rank(1.0) <= MAX_APART_MM;
    match near && differing <= expected.nodes {
        true => Ok(()),
        false => Err(format!(
            "median {:e}, p99 {:e}, max {:e} mm; {differing} nodes supported by one",
            rank(0.5),
            rank(0.99),
            rank(1.0)
        )),
    }
}

fn simulated(shape: &str, settings: &simulate::SimulationSettings) -> Recording {
    let vessel = Phantom::from(shape.parse::<Shape>().unwrap()).vessel().unwrap();
    Simulation::run(vessel, settings).unwrap().recording
}

#[test]
fn a_wall_is_the_cpu_s_with_noise_and_without() {
    let Some(_) = device() else { return };
    for (shape, noise, seed, nodes) in [
        ("stenosis", Noise::default(), 7, None),
        ("side_branch", Noise::default(), 8, Some(65)),
        ("small_arch", Noise::none(), 9, None),
    ] {
        let noise = noise.with_seed(seed);
        let recording = simulated(shape, &simulate::SimulationSettings::default().with_noise(noise));
        let expected = Sweep::of(&recording, &settings(Backend::Cpu, nodes)).unwrap();
        let found = Sweep::of(&recording, &settings(Backend::Gpu, nodes)).unwrap();
        assert_eq!((found.report.engine.name.as_str(), expected.report.engine.name.as_str()), ("gpu", "cpu"));
        assert!(found.report.engine.adapter.is_some());
        assert_eq!(found.report.rings, expected.report.rings);
        agree(&found, &expected).unwrap();

        // The comparer finds a wall that is another's, and one that is off.
        let mut off = found.clone();
        off.radii_mm.iter_mut().for_each(|r| *r += 2e-3);
        agree(&off, &expected).unwrap_err();
        let node = found.support.supported.iter().position(|&supported| supported).unwrap();
        let mut off = found.clone();
        off.radii_mm[node] += 0.2;
        agree(&off, &expected).unwrap_err();
        let mut swapped = found;
        swapped.radii_mm.rotate_right(1);
        agree(&swapped, &expected).unwrap_err();
    }
}

#[test]
fn walls_of_branches_are_fitted_side_by_side_on_one_device() {
    let Some(_) = device() else { return };
    let visits = [0, 1].map(|branch| Visit::new(branch, None)).to_vec();
    let insertion = Insertion::default().with_visits(visits);
    let recording =
        simulated("side_branch", &simulate::SimulationSettings::default().with_insertion(insertion));
    let on_device = Reconstructor::new(settings(Backend::Gpu, None));
    let found = on_device.run(&recording).unwrap();
    let expected = Reconstructor::new(settings(Backend::Cpu, None)).run(&recording).unwrap();
    let sweeps = |lumen: &Lumen| lumen.branches().unwrap().sweeps.clone();
    assert_eq!(sweeps(&found).len(), 2);
    for (found, expected) in sweeps(&found).iter().zip(&sweeps(&expected)) {
        assert_eq!((found.report.engine.name.as_str(), expected.report.engine.name.as_str()), ("gpu", "cpu"));
        agree(found, expected).unwrap();
    }
    // In the device's kept memory, whichever branch comes first.
    for _ in 0..3 {
        let [again, found] = [&on_device.run(&recording).unwrap(), &found].map(Lumen::surface);
        assert_eq!(again.triangles, found.triangles);
        assert!(again.nodes_mm == found.nodes_mm);
    }
}

#[test]
fn the_sweep_s_error_is_the_cpu_s() {
    let Some(_) = device() else { return };
    for name in ["adult_aorta_clean", "adult_aorta_noisy"] {
        let (Some(recording), Some(truth)) =
            (shared(&format!("recordings/{name}.mat")), shared("data/aorta_adult_full_steve.stl"))
        else {
            return;
        };
        let recording = Recording::read(&recording).unwrap();
        let truth = Truth::new(Surface::read(&truth).unwrap()).unwrap();
        let [found, expected] =
            [Backend::Gpu, Backend::Cpu].map(|b| Sweep::of(&recording, &settings(b, None)).unwrap());
        agree(&found, &expected).unwrap();
        let [found, expected] = [found, expected]
            .map(|sweep| evaluate(&sweep.surface(false), &truth).unwrap().mesh_to_truth.mean_mm);
        say(&format!("{name}: mean error {found:.6} mm on the device, {expected:.6} mm on the CPU"));
        assert!((found - expected).abs() <= 1e-3);
    }
}

/// A grid as fine as the sweep is meant for. It takes minutes on a software device:
///
/// ```sh
/// cargo test --release --test gpu sweep_walls -- --ignored --nocapture
/// ```
#[test]
#[ignore = "takes minutes on a software device; run it optimised"]
fn thousands_of_rings_of_512_nodes_are_the_cpu_s() {
    let Some(_) = device() else { return };
    let many: SweepCase = "512x1e6".parse().unwrap();
    let small = Noise::none().with_contour_sd_mm(0.01);
    let probe = Probe::default().with_rays(512);
    let clean = simulate::SimulationSettings::default().with_noise(small).with_probe(probe);
    for recording in [simulated("small_arch", &clean), many.recording(11)] {
        let start = std::time::Instant::now();
        let expected = Sweep::of(&recording, &settings(Backend::Cpu, Some(512))).unwrap();
        say(&format!(
            "CPU: {:.1} s, fitting {:.1} s",
            start.elapsed().as_secs_f64(),
            expected.report.seconds.fit
        ));
        let start = std::time::Instant::now();
        let found = Sweep::of(&recording, &settings(Backend::Gpu, Some(512))).unwrap();
        say(&format!(
            "device: {:.1} s, fitting {:.1} s",
            start.elapsed().as_secs_f64(),
            found.report.seconds.fit
        ));
        agree(&found, &expected).unwrap();
    }
}
