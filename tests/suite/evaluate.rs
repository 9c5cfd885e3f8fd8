//! The fitting error: distances against known shapes, an exhaustive oracle and VTK.

use crate::support::{python_with_vtk, shared, tetrahedron, tube};
use glam::DVec3;
use lumenmesh::evaluate::{Distances, Locator, Truth, evaluate};
use lumenmesh::surface::Surface;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn point(rng: &mut ChaCha8Rng, size: f64) -> DVec3 {
    DVec3::new(rng.random(), rng.random(), rng.random()) * size - DVec3::splat(0.5 * size)
}

/// Triangles that share nothing, from slivers to large ones.
fn soup(rng: &mut ChaCha8Rng, triangles: usize) -> Surface {
    let mut surface = Surface::default();
    for t in 0..triangles as u32 {
        let at = point(rng, 10.0);
        let size = [1e-3, 0.1, 1.0, 8.0][rng.random_range(0..4)];
        let mut corners = [point(rng, size), point(rng, size), point(rng, size)];
        if t % 5 == 0 {
            corners[2] = corners[0].lerp(corners[1], 0.3) + point(rng, 1e-4 * size);
        }
        surface.nodes_mm.extend(corners.map(|c| at + c));
        surface.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
    }
    surface
}

/// A sphere of the given fineness, normals outwards.
fn sphere(rings: u32, radius_mm: f64) -> Surface {
    let mut surface = Surface { nodes_mm: vec![DVec3::NEG_Z * radius_mm], ..Surface::default() };
    let around = 2 * rings;
    for ring in 1..rings {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        for j in 0..around {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(j) / f64::from(around)).sin_cos();
            surface.nodes_mm.push(radius_mm * DVec3::new(polar.sin() * cos, polar.sin() * sin, -polar.cos()));
        }
    }
    surface.nodes_mm.push(DVec3::Z * radius_mm);
    let node = |ring: u32, j: u32| 1 + (ring - 1) * around + j % around;
    for j in 0..around {
        surface.triangles.push([0, node(1, j + 1), node(1, j)]);
        for ring in 1..rings - 1 {
            let [a, b] = [node(ring, j), node(ring, j + 1)];
            surface.triangles.extend([[a, b, b + around], [a, b + around, a + around]]);
        }
        surface.triangles.push([node(rings - 1, j), node(rings - 1, j + 1), (rings - 1) * around + 1]);
    }
    surface
}

/// The square [-size, size]² in z = 0, normals to +z.
fn square(size: f64, cells: u32) -> Surface {
    let mut surface = Surface::default();
    for i in 0..=cells {
        for j in 0..=cells {
            let at = |k: u32| size * (2.0 * f64::from(k) / f64::from(cells) - 1.0);
            surface.nodes_mm.push(DVec3::new(at(i), at(j), 0.0));
        }
    }
    for i in 0..cells {
        for j in 0..cells {
            let a = i * (cells + 1) + j;
            let b = a + cells + 1;
            surface.triangles.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
        }
    }
    surface
}

/// The oracle: every triangle; where the foot of the perpendicular lies inside all three sides, the distance to the
/// plane, else the least distance to a side.
fn exhaustive_distance(surface: &Surface, p: DVec3) -> f64 {
    let to_side = |a: DVec3, b: DVec3| {
        let t = ((p - a).dot(b - a) / a.distance_squared(b)).clamp(0.0, 1.0);
        p.distance(a.lerp(b, t))
    };
    let to_triangle = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|n| surface.nodes_mm[n as usize]);
        let normal = (b - a).cross(c - a).normalize();
        let inside = [(a, b), (b, c), (c, a)].iter().all(|&(s, e)| (e - s).cross(p - s).dot(normal) >= 0.0);
        let sides = to_side(a, b).min(to_side(b, c)).min(to_side(c, a));
        if inside { sides.min((p - a).dot(normal).abs()) } else { sides }
    };
    surface.triangles.iter().map(to_triangle).fold(f64::INFINITY, f64::min)
}

fn worst_disagreement(searched: &Surface, oracle: &Surface, queries: &[DVec3]) -> f64 {
    let found = Locator::new(searched).unwrap().closest_all(queries);
    let pairs = queries.iter().zip(&found);
    pairs.map(|(&q, c)| (c.distance_mm - exhaustive_distance(oracle, q)).abs()).fold(0.0, f64::max)
}

#[test]
fn distances_equal_those_of_an_exhaustive_search() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for triangles in [1, 2, 3, 4, 5, 7, 8, 9, 33, 400] {
        let surface = soup(&mut rng, triangles);
        let mut queries: Vec<DVec3> = (0..300).map(|_| point(&mut rng, 14.0)).collect();
        // On nodes, far away, and all in one place.
        queries.extend(surface.nodes_mm.iter().take(30));
        queries.extend((0..30).map(|_| point(&mut rng, 2e4)));
        queries.extend([DVec3::ZERO; 20]);
        // Rounding of 1e4 mm coordinates is 2e-12 mm; slivers of 1e-4 lose four more digits.
        let worst = worst_disagreement(&surface, &surface, &queries);
        assert!(worst < 1e-8, "{triangles} triangles: {worst}");
    }
}

#[test]
fn distances_to_a_fine_surface_equal_those_of_an_exhaustive_search() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let surface = sphere(60, 10.0);
    let mut queries: Vec<DVec3> = (0..100).map(|_| point(&mut rng, 30.0)).collect();
    // The centre is as near to every triangle as to any other.
    queries.extend([DVec3::ZERO, DVec3::Z * 10.0, DVec3::splat(1e3)]);
    let worst = worst_disagreement(&surface, &surface, &queries);
    assert!(worst < 1e-11, "{worst}");
}

#[test]
fn slivers_are_as_near_as_an_exhaustive_search_says() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for width in [1e-3, 1e-4, 1e-5, 1e-6] {
        for _ in 0..300 {
            let (a, b) = (point(&mut rng, 20.0), point(&mut rng, 20.0));
            let c = a.lerp(b, rng.random()) + point(&mut rng, width);
            let sliver = Surface { nodes_mm: vec![a, b, c], triangles: vec![[0, 1, 2]], arrays: Vec::new() };
            let queries: Vec<DVec3> =
                (0..10).map(|_| a.lerp(b, rng.random()) + point(&mut rng, 0.1)).collect();
            // Rounding of 20 mm coordinates, 4e-15 mm, turns the normal by 4e-15 mm / width, which counts over 20 mm.
            let worst = worst_disagreement(&sliver, &sliver, &queries);
            assert!(worst < 1e-13 / width, "{width} mm: {worst}");
        }
    }
}

#[test]
fn of_equally_near_triangles_the_first_is_found_wherever_the_search_starts() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut surface = sphere(12, 10.0);
    let once = surface.triangles.len();
    surface.triangles.extend_from_within(..);
    surface.triangles.extend_from_within(..once);
    let locator = Locator::new(&surface).unwrap();
    let mut queries: Vec<DVec3> = (0..2000).map(|_| point(&mut rng, 30.0)).collect();
    queries.extend(&surface.nodes_mm);
    for (&query, many) in queries.iter().zip(locator.closest_all(&queries)) {
        assert!((many.triangle as usize) < once);
        assert_eq!(locator.closest(query), many);
    }
}

/// Far beyond the range of single precision, in which the tree's boxes are.
#[test]
fn any_size_and_any_distance_will_do() {
    let queries: Vec<DVec3> = {
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        (0..200).map(|_| point(&mut rng, 30.0)).collect()
    };
    let reference = Locator::new(&sphere(12, 10.0)).unwrap().closest_all(&queries);
    // Powers of two, so that nothing is rounded.
    for scale in [2f64.powi(-130), 2f64.powi(130)] {
        let locator = Locator::new(&sphere(12, 10.0 * scale)).unwrap();
        for (&query, found) in queries.iter().zip(&reference) {
            let scaled = locator.closest(query * scale);
            assert_eq!((scaled.triangle, scaled.distance_mm), (found.triangle, found.distance_mm * scale));
        }
    }
    let far = Locator::new(&tetrahedron()).unwrap().closest(DVec3::splat(-1e60));
    assert!((far.distance_mm / (1e60 * 3f64.sqrt()) - 1.0).abs() < 1e-15);
}

/// The comparisons above must be able to fail: a thousandth of a millimetre in one node shows.
#[test]
fn the_oracle_notices_a_moved_node() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let surface = soup(&mut rng, 50);
    let mut moved = surface.clone();
    moved.nodes_mm[31].x += 1e-3;
    let queries: Vec<DVec3> = surface.nodes_mm.clone();
    assert!(worst_disagreement(&surface, &moved, &queries) > 1e-4);
}

#[test]
fn one_query_and_many_agree_on_any_number_of_threads() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let surface = tube(40, 60, 12.0, 80.0);
    let locator = Locator::new(&surface).unwrap();
    let queries: Vec<DVec3> = (0..5000).map(|_| point(&mut rng, 90.0)).collect();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| locator.closest_all(&queries))
    };
    let single = on(1);
    assert_eq!(single, on(2));
    assert_eq!(single, on(7));
    for (&query, many) in queries.iter().zip(&single) {
        assert_eq!(locator.distance_mm(query).to_bits(), many.distance_mm.to_bits());
    }
}

#[test]
fn a_query_that_is_not_finite_has_no_distance() {
    let locator = Locator::new(&tetrahedron()).unwrap();
    let queries = [DVec3::ONE, DVec3::NAN, DVec3::INFINITY, DVec3::ONE * 2.0];
    let distances: Vec<f64> = locator.closest_all(&queries).iter().map(|c| c.distance_mm).collect();
    assert_eq!(distances[0], locator.distance_mm(DVec3::ONE));
    assert!(distances[1].is_nan() && distances[2].is_nan() && locator.distance_mm(DVec3::NAN).is_nan());
    assert_eq!(distances[3], locator.distance_mm(DVec3::ONE * 2.0));
}

#[test]
fn the_sign_is_right_all_about_a_closed_surface() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    // A tetrahedron's corners are sharp: a face's own normal gives wrong signs there.
    let surface = tetrahedron();
    let locator = Locator::new(&surface).unwrap();
    let (mut inside, mut outside) = (0, 0);
    for _ in 0..4000 {
        let p = point(&mut rng, 3.0) + DVec3::splat(0.3);
        let is_inside = p.min_element() > 0.0 && p.element_sum() < 1.0;
        let signed = locator.closest(p).signed_distance_mm;
        assert_eq!(signed < 0.0, is_inside, "{p}");
        if is_inside { inside += 1 } else { outside += 1 }
    }
    assert!(inside > 10 && outside > 1000);
}

#[test]
fn a_plane_has_known_distances_and_a_known_covered_share() {
    let mut mesh = square(2.0, 8);
    mesh.nodes_mm.iter_mut().for_each(|p| p.z = -0.25);
    let evaluation = evaluate(&mesh, &Truth::new(square(4.0, 16)).unwrap()).unwrap();
    let forth = evaluation.mesh_to_truth;
    assert_eq!(
        (forth.mean_mm, forth.rms_mm, forth.median_mm, forth.p95_mm, forth.max_mm),
        (0.25, 0.25, 0.25, 0.25, 0.25)
    );
    assert_eq!((forth.nodes, evaluation.signed_mean_mm, evaluation.area_weighted_mean_mm), (81, -0.25, 0.25));
    // Of the truth's nodes, 0.5 mm apart, 7 x 7 lie over the inside of the mesh; each stands for 0.25 of 64 mm².
    let back = evaluation.truth_to_mesh.unwrap();
    assert_eq!((back.nodes, back.mean_mm, back.max_mm), (49, 0.25, 0.25));
    assert!((evaluation.covered_area_share - 49.0 * 0.25 / 64.0).abs() < 1e-12);
    // Two flat boxes, one above the other.
    assert!(evaluation.warnings[0].contains("do not touch"));
}

#[test]
fn concentric_spheres_are_their_difference_in_radius_apart() {
    let truth = Truth::new(sphere(90, 10.0)).unwrap();
    for (radius_mm, difference_mm) in [(11.0, 1.0), (9.5, -0.5)] {
        let evaluation = evaluate(&sphere(31, radius_mm), &truth).unwrap();
        // Flat facets lie inside the sphere by up to radius·(1 - cos(angle between nodes)).
        let sag = 10.0 * (1.0 - (std::f64::consts::PI / 90.0).cos());
        assert!((evaluation.signed_mean_mm - difference_mm).abs() < sag, "{}", evaluation.signed_mean_mm);
        assert!((evaluation.mesh_to_truth.mean_mm - difference_mm.abs()).abs() < sag);
        assert_eq!(evaluation.covered_area_share, 1.0, "a closed mesh has no rim");
    }
}

#[test]
fn percentiles_are_by_nearest_rank_and_weights_count_like_copies() {
    let distances: Vec<f64> = (1..=20).rev().map(f64::from).collect();
    let of = |weights: &[f64]| Distances::of(&distances[..weights.len()], weights).unwrap();
    let even = of(&[1.0; 20]);
    assert_eq!((even.median_mm, even.p95_mm, even.max_mm, even.mean_mm), (10.0, 19.0, 20.0, 10.5));
    let rms = ((1..=20).map(|k| f64::from(k * k)).sum::<f64>() / 20.0).sqrt();
    assert!((even.rms_mm - rms).abs() < 1e-12);
    let mut weighted = of(&[3.0, 1.0, 0.0]);
    let copies = Distances::of(&[20.0, 20.0, 20.0, 19.0], &[1.0; 4]).unwrap();
    weighted.nodes = 4;
    assert_eq!(weighted, copies);
    assert!(Distances::of(&[1.0], &[0.0]).is_none() && Distances::of(&[], &[]).is_none());
}

#[test]
fn what_cannot_be_measured_is_an_error_and_what_is_doubtful_a_warning() {
    let truth = Truth::new(tube(20, 10, 10.0, 40.0)).unwrap();
    let mut broken = tube(20, 10, 9.0, 40.0);
    broken.nodes_mm[7].y = f64::NAN;
    let text = evaluate(&broken, &truth).unwrap_err().to_string();
    assert!(text.starts_with("surface: position of node 7: found ["), "{text}");
    let mut flat = tetrahedron();
    flat.nodes_mm = vec![DVec3::ZERO; 4];
    let text = Truth::new(flat).err().unwrap().to_string();
    assert_eq!(text, "surface: triangles with an area: found none, expected at least one");

    let warnings = |mesh: &Surface, truth: &Surface| {
        evaluate(mesh, &Truth::new(truth.clone()).unwrap()).unwrap().warnings
    };
    let tube = tube(20, 10, 10.0, 40.0);
    assert_eq!(warnings(&tube, &tube), Vec::<String>::new());
    let mut metres = tube.clone();
    metres.nodes_mm.iter_mut().for_each(|p| *p *= 1e-3);
    assert!(warnings(&metres, &tube)[0].contains("are both in millimetres?"));
    let mut elsewhere = tube.clone();
    elsewhere.nodes_mm.iter_mut().for_each(|p| *p += 100.0);
    assert!(warnings(&elsewhere, &tube)[0].contains("the bounding boxes do not touch"));
    let mut turned = tube.clone();
    turned.triangles[101].swap(0, 1);
    assert!(
        warnings(&tube, &turned)[0]
            .starts_with("the truth has 3 edges whose two triangles face opposite ways")
    );
}

#[test]
fn nodes_of_a_real_surface_are_at_no_distance_from_it() {
    let Some(path) = shared("data/aorta_adult_full_steve.stl") else { return };
    let surface = Surface::read(&path).unwrap();
    let evaluation = evaluate(&surface, &Truth::new(surface.clone()).unwrap()).unwrap();
    assert!(evaluation.mesh_to_truth.max_mm < 1e-12 && evaluation.warnings.is_empty());
    // Only the rims of the nine openings count as not covered.
    assert!((0.97..1.0).contains(&evaluation.covered_area_share), "{}", evaluation.covered_area_share);
}

const VTK_DISTANCES: &str = r#"
import sys, vtk
from vtk.util.numpy_support import vtk_to_numpy, numpy_to_vtk
def read(path):
    reader = vtk.vtkXMLPolyDataReader(); reader.SetFileName(path); reader.Update(); return reader.GetOutput()
truth, mesh = map(read, sys.argv[1:])
locator = vtk.vtkCellLocator(); locator.SetDataSet(truth); locator.BuildLocator()
implicit = vtk.vtkImplicitPolyDataDistance(); implicit.SetInput(truth)
at, cell, sub, squared = [0.0] * 3, vtk.mutable(0), vtk.mutable(0), vtk.mutable(0.0)
for p in vtk_to_numpy(mesh.GetPoints().GetData()).tolist():
    locator.FindClosestPoint(p, at, cell, sub, squared)
    print(repr(float(squared) ** 0.5), repr(implicit.EvaluateFunction(p)))
"#;

#[test]
fn vtk_finds_the_same_distances() {
    let (Some(python), Some(path)) = (python_with_vtk(), shared("data/aorto_iliac_bifurcation_vmtk.stl"))
    else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let truth = Surface::read(&path).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut mesh = truth.clone();
    mesh.nodes_mm.iter_mut().for_each(|p| *p += point(&mut rng, 2.0));
    let (truth_file, mesh_file) = (folder.path().join("truth.vtp"), folder.path().join("mesh.vtp"));
    truth.write(&truth_file).unwrap();
    mesh.write(&mesh_file).unwrap();
    let evaluation = evaluate(&mesh, &Truth::new(truth).unwrap()).unwrap();
    let printed = python.run(VTK_DISTANCES, &[&truth_file, &mesh_file]);
    let (mut compared, mut signs) = (0, 0);
    for (k, line) in printed.lines().enumerate() {
        let mut words = line.split(' ').map(|word| word.parse::<f64>().unwrap());
        let (unsigned, signed) = (words.next().unwrap(), words.next().unwrap());
        // VTK's closest point on a triangle is good to about single precision.
        assert!(
            (unsigned - evaluation.error_mm[k]).abs() < 1e-6,
            "node {k}: {unsigned} {}",
            evaluation.error_mm[k]
        );
        compared += 1;
        signs += usize::from((signed < 0.0) == (evaluation.signed_error_mm[k] < 0.0));
    }
    assert_eq!(compared, mesh.nodes_mm.len());
    // VTK's normals at edges and nodes are not weighted by angle, and at open rims the sign is a convention.
    assert!(signs as f64 > 0.99 * compared as f64, "{signs} of {compared} signs agree");
}
