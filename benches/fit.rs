//! scratch
use lumenmesh::fit::passes::Section;
use lumenmesh::fit::{CpuEngine, Engine};
use lumenmesh::settings::Settings;
use rand::{RngExt, SeedableRng};
use std::time::Instant;

fn section(points: usize) -> Section<f32> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let normal = rand_distr::StandardNormal;
    let mut s = Section::default();
    for _ in 0..points {
        let t = rng.random_range(0.0..std::f64::consts::TAU);
        let z = rng.random_range(-5.0..5.0);
        let e: f64 = rng.sample(normal);
        let mut r = 12.0 * (1.1 + 0.05 * (2.0 * t).sin() + 0.05 * f64::sin(z)) + 0.5 * e;
        if rng.random_range(0.0..1.0) < 0.02 {
            let e: f64 = rng.sample(normal);
            r += 5.0 * e;
        }
        s.r.push(r as f32);
        s.theta.push(t as f32);
        s.z.push(z as f32);
    }
    s
}

fn main() {
    let engine = CpuEngine::<f32>::new();
    for (n, l, p) in [(12, 5, 10_000), (12, 5, 1_000_000), (512, 512, 1_000_000), (512, 512, 10_000_000)] {
        let s = section(p);
        let settings = Settings { nodes: n, levels: l, ..Settings::default() };
        let mut times = Vec::new();
        for _ in 0..5 {
            let t = Instant::now();
            let tube = engine.fit_section(&s, 12.0, &settings).unwrap();
            times.push(t.elapsed().as_secs_f64());
            assert!(tube.points == p as u64);
        }
        times.sort_by(f64::total_cmp);
        println!("{n}x{l} {p}: {:.3} ms", times[2] * 1e3);
    }
}
