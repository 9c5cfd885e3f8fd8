//! Closest distances to a surface, the work behind the fitting error: ours (f64, with sign and rim) against plain
//! parry3d (f32, unsigned) on the same triangles and queries.
//!
//! `cargo bench --bench distance [-- QUERIES TRIANGLES REPETITIONS]`, by default 100000 200000 9. With `--test`, as
//! `cargo test --benches` passes it, one tiny round. The two take turns. On one thread seconds are CPU-seconds; on all
//! threads they are wall. Times include ordering the queries, and exclude building the trees, which is printed apart.

use glam::DVec3;
use lumenmesh::evaluate::Locator;
use lumenmesh::surface::Surface;
use parry3d::{math::Vector, query::PointQuery, shape::TriMesh};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::time::Instant;

const RADIUS_MM: f64 = 12.0;
const HEIGHT_MM: f64 = 200.0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let tiny = arguments.iter().any(|a| a == "--test");
    let numbers: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    let pick = |k: usize, usual: usize, tiny_one: usize| match numbers.get(k) {
        Some(&n) => n,
        None if tiny => tiny_one,
        None => usual,
    };
    let (count, triangles, repetitions) = (pick(0, 100_000, 500), pick(1, 200_000, 2_000), pick(2, 9, 1));

    let surface = tube(triangles);
    println!(
        "{count} queries, {} triangles, {repetitions} rounds, median (least to most)",
        surface.triangles.len()
    );
    let clock = Instant::now();
    let locator = Locator::new(&surface).expect("a tube is a surface");
    let ours = clock.elapsed();
    let clock = Instant::now();
    let parry =
        TriMesh::new(surface.nodes_mm.iter().map(|&p| single(p)).collect(), surface.triangles.clone())
            .expect("a tube is a mesh");
    println!(
        "build: ours {:.1} ms, parry3d {:.1} ms",
        1e3 * ours.as_secs_f64(),
        1e3 * clock.elapsed().as_secs_f64()
    );

    for (kind, deviation_mm, ordered) in
        [("1 mm off, random order", 1.0, false), ("0.05 mm off, ring order", 0.05, true)]
    {
        let queries = queries(count, deviation_mm, ordered);
        let singles: Vec<Vector> = queries.iter().map(|&p| single(p)).collect();
        check(&surface, &locator, &queries);
        for threads in [1, std::thread::available_parallelism().map_or(1, usize::from)] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let (mut ours, mut theirs, mut sums) = (Vec::new(), Vec::new(), (0.0, 0.0));
            for _ in 0..repetitions {
                let clock = Instant::now();
                let found = pool.install(|| locator.closest_all(&queries));
                ours.push(clock.elapsed().as_secs_f64());
                sums.0 = found.iter().map(|c| c.distance_mm).sum();
                let clock = Instant::now();
                let distance = |p: &Vector| parry.distance_to_local_point(*p, false);
                let found: Vec<f32> =
                    pool.install(|| singles.par_iter().with_min_len(256).map(distance).collect());
                theirs.push(clock.elapsed().as_secs_f64());
                sums.1 = found.iter().map(|&d| f64::from(d)).sum();
            }
            assert!((sums.0 / sums.1 - 1.0).abs() < 1e-3, "the two do not agree: {sums:?}");
            let name =
                if threads == 1 { "1 thread, CPU".to_owned() } else { format!("{threads} threads, wall") };
            let (ours, theirs) = (quantiles(ours), quantiles(theirs));
            println!(
                "{kind}; {name}: ours {}, parry3d {}: {:.2} times as fast",
                shown(ours),
                shown(theirs),
                theirs[1] / ours[1]
            );
        }
    }
}

fn quantiles(mut seconds: Vec<f64>) -> [f64; 3] {
    seconds.sort_by(f64::total_cmp);
    [seconds[0], seconds[seconds.len() / 2], seconds[seconds.len() - 1]]
}

fn shown([least, median, most]: [f64; 3]) -> String {
    format!("{:.1} ms ({:.1} to {:.1})", 1e3 * median, 1e3 * least, 1e3 * most)
}

fn single(p: DVec3) -> Vector {
    Vector::new(p.x as f32, p.y as f32, p.z as f32)
}

/// Numbers that f32 holds, so that both measure the same thing.
fn rounded(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(f64::from(x as f32), f64::from(y as f32), f64::from(z as f32))
}

fn radius(angle: f64, z: f64) -> f64 {
    RADIUS_MM * (1.0 + 0.10 * (3.0 * angle + z / 20.0).sin() + 0.15 * (z * TAU / 80.0).sin())
}

fn tube(triangles: usize) -> Surface {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let noise = Normal::new(0.0, 0.02).expect("a deviation");
    let n = ((triangles as f64 / 2.0).sqrt().round() as u32).max(3);
    let levels = (triangles as u32 / (2 * n)).max(1);
    let mut surface = Surface::default();
    for level in 0..=levels {
        let z = HEIGHT_MM * (f64::from(level) / f64::from(levels) - 0.5);
        for j in 0..n {
            let angle = TAU * f64::from(j) / f64::from(n);
            let r = radius(angle, z) + noise.sample(&mut rng);
            surface.nodes_mm.push(rounded(r * angle.cos(), r * angle.sin(), z));
        }
    }
    for level in 0..levels {
        for j in 0..n {
            let (a, b) = (level * n + j, level * n + (j + 1) % n);
            surface.triangles.extend([[a, b, b + n], [a, b + n, a + n]]);
        }
    }
    surface
}

fn queries(count: usize, deviation_mm: f64, ordered: bool) -> Vec<DVec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let noise = Normal::new(0.0, deviation_mm).expect("a deviation");
    let rings = (count as f64).sqrt().floor().max(1.0);
    let mut places: Vec<(f64, f64)> = (0..count)
        .map(|_| (TAU * rng.random::<f64>(), 0.98 * HEIGHT_MM * (rng.random::<f64>() - 0.5)))
        .collect();
    if ordered {
        let ring = |z: f64| (z / HEIGHT_MM * rings).floor();
        places.sort_by(|p, q| ring(p.1).total_cmp(&ring(q.1)).then(p.0.total_cmp(&q.0)));
    }
    let place = |(angle, z): (f64, f64)| {
        let r = radius(angle, z) + noise.sample(&mut rng);
        rounded(r * angle.cos(), r * angle.sin(), z)
    };
    places.into_iter().map(place).collect()
}

/// Every triangle, by sampling no tree: the distance to the plane where the foot is inside, else to the sides.
fn check(surface: &Surface, locator: &Locator, queries: &[DVec3]) {
    let found = locator.closest_all(queries);
    for k in (0..queries.len()).step_by((queries.len() / 50).max(1)) {
        let p = queries[k];
        let corners = surface.triangles.iter().map(|t| t.map(|n| surface.nodes_mm[n as usize]));
        let truth = corners.map(|c| distance(p, c)).fold(f64::INFINITY, f64::min);
        assert!(
            (found[k].distance_mm - truth).abs() < 1e-9,
            "query {k}: {} instead of {truth}",
            found[k].distance_mm
        );
    }
}

fn distance(p: DVec3, corners: [DVec3; 3]) -> f64 {
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let sides = [0, 1, 2].map(|k| (corners[k], corners[(k + 1) % 3]));
    if sides.iter().all(|&(a, b)| (b - a).cross(p - a).dot(normal) >= 0.0) {
        return (p - corners[0]).dot(normal.normalize()).abs();
    }
    let side = |(a, b): (DVec3, DVec3)| {
        let t = ((p - a).dot(b - a) / a.distance_squared(b)).clamp(0.0, 1.0);
        p.distance(a.lerp(b, t))
    };
    sides.map(side).into_iter().fold(f64::INFINITY, f64::min)
}
