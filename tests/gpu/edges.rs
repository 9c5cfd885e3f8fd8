//! Sections that are hard to group and measure: skewed, empty, on edges, tiny and huge.

use crate::cylinders::{assert_agree, assert_all_agree};
use crate::device::{Device, device};
use crate::grouping::bins_and_scatters;
use crate::sections::{RADIUS_MM, both, patch, recording, wall};
use glam::DVec2;
use lumenmesh::cylinders::{CpuEngine, Engine, FitRequest, Track};
use lumenmesh::low_level::cylinders::passes::Section;
use lumenmesh::settings::{Outliers, Settings};
use std::f64::consts::{PI, TAU};

fn agrees(device: &Device, section: &Section<f32>, settings: &Settings) {
    let expected = CpuEngine::<f32>::new().fit_section(section, RADIUS_MM, settings).unwrap().tube;
    let found = device.engine.fit_section(section, RADIUS_MM, settings).unwrap().tube;
    assert_eq!(found.points, section.len() as u64);
    assert_agree(device, &found, &expected, section, settings);
}

#[test]
fn all_points_in_one_face_of_a_hundred() {
    let Some(device) = device() else { return };
    let settings = Settings::default().with_nodes(20).with_levels(5);
    agrees(device, &patch(30_000, 61, 0.0..TAU / 20.0, -5.0..-3.0), &settings);
}

#[test]
fn half_the_faces_empty() {
    let Some(device) = device() else { return };
    for (nodes, levels) in [(12, 5), (64, 64)] {
        let settings = Settings::default().with_nodes(nodes).with_levels(levels);
        agrees(device, &patch(20_000, 67, 0.0..PI, -5.0..5.0), &settings);
        agrees(device, &patch(20_000, 67, 0.0..TAU, -5.0..0.0), &settings);
    }
}

#[test]
fn one_face_with_a_hundred_thousand_points_among_short_ones() {
    let Some(device) = device() else { return };
    let crowd = patch(100_000, 71, 1.1..1.5, 0.1..1.9);
    for outliers in [Outliers::Iqr, Outliers::Deviation, Outliers::None] {
        let settings = Settings::default().with_outliers(outliers);
        agrees(device, &both(wall(2_000, 73), &crowd), &settings);
    }
}

#[test]
fn two_points_a_triangle() {
    let Some(device) = device() else { return };
    for (nodes, levels) in [(12, 5), (64, 64)] {
        let settings = Settings::default().with_nodes(nodes).with_levels(levels);
        agrees(device, &wall(4 * (nodes * levels) as usize, 79), &settings);
    }
}

#[test]
fn no_point_one_point_two_points() {
    let Some(device) = device() else { return };
    for count in [0, 1, 2] {
        agrees(device, &wall(count, 83), &Settings::default());
    }
    agrees(device, &wall(500, 83), &Settings::default().with_iterations(0));
}

/// Points exactly on every edge between faces, on both ends, at both gates and at the seam.
fn on_edges(nodes: u32, levels: u32, gate: [f64; 2]) -> Section<f32> {
    let mut section = Section::default();
    for j in 0..=nodes {
        for level in 0..=levels {
            let theta = (TAU * f64::from(j) / f64::from(nodes)) as f32;
            let z = (-5.0 + 10.0 * f64::from(level) / f64::from(levels)) as f32;
            for r in [gate[0] * RADIUS_MM, RADIUS_MM, gate[1] * RADIUS_MM] {
                for theta in [theta.next_down().max(0.0), theta, theta.next_up()] {
                    for z in [z.next_down().max(-5.0), z, z.next_up().min(5.0)] {
                        section.r.push(r as f32);
                        section.theta.push(theta);
                        section.z.push(z);
                    }
                }
            }
        }
    }
    section
}

#[test]
fn points_on_edges_belong_to_one_face_each() {
    let Some(device) = device() else { return };
    for (nodes, levels) in [(12, 5), (7, 3), (64, 1)] {
        let settings = Settings::default().with_nodes(nodes).with_levels(levels);
        let section = on_edges(nodes, levels, settings.gate);
        bins_and_scatters(device, &section, &settings);
        agrees(device, &section, &settings);
    }
}

#[test]
fn denormal_numbers_and_points_on_the_axis() {
    let Some(device) = device() else { return };
    let settings = Settings::default().with_gate([0.0, 1.5]);
    let mut section = wall(1_000, 89);
    let tiny = [0.0, -0.0, 1e-45, 1e-40, f32::MIN_POSITIVE, 1e-30];
    for r in tiny {
        for theta in tiny {
            for z in tiny.into_iter().chain([-1e-45, -1e-40]) {
                section.r.push(r.abs());
                section.theta.push(theta.abs());
                section.z.push(z);
            }
        }
    }
    bins_and_scatters(device, &section, &settings);
    agrees(device, &section, &settings);
}

#[test]
fn numbers_that_are_not_finite_are_refused_before_they_reach_the_device() {
    let Some(device) = device() else { return };
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for component in 0..3 {
            let mut section = wall(100, 97);
            let values = [&mut section.r, &mut section.theta, &mut section.z];
            values.into_iter().nth(component).unwrap()[42] = poison;
            let settings = Settings::default();
            for engine in [&device.engine as &dyn Engine, &CpuEngine::<f32>::new()] {
                let message = engine.fit_section(&section, RADIUS_MM, &settings).unwrap_err().to_string();
                assert!(message.contains("at point 42"), "{message}");
            }
        }
    }
    for radius_mm in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        assert!(device.engine.prepare(100, radius_mm, &Settings::default()).is_err());
    }
    let mut uneven = wall(100, 97);
    uneven.z.pop();
    assert!(device.engine.fit_section(&uneven, RADIUS_MM, &Settings::default()).is_err());
}

#[test]
fn echoes_far_away_are_left_out_as_on_the_cpu() {
    let Some(device) = device() else { return };
    let settings = Settings::default();
    let mut pullback = recording(20, 60, 223);
    for (k, frame) in pullback.frames.iter_mut().enumerate() {
        let far = [1e3, 1e4, 1e5, 9e5, 1e6][k % 5];
        frame.contour_mm[3] = DVec2::new(far, -far);
        frame.contour_mm[4] = DVec2::new(0.0, far);
    }
    let track = Track::of(&pullback, &settings).unwrap();
    let request = FitRequest::new(&track, &[9, 19], &settings);
    let expected = CpuEngine::<f32>::new().fit(&request).unwrap().cylinders;
    let found = device.engine.fit(&request).unwrap().cylinders;
    assert_all_agree(device, &found, &expected, &pullback, &settings);
    // Farther ones, whose squares are too large for single precision, are no echoes.
    pullback.frames[3].contour_mm[3] = DVec2::new(1e19, -1e19);
    assert!(Track::of(&pullback, &settings).is_err());
}

#[test]
fn small_jobs_after_a_large_one_see_nothing_of_it() {
    let Some(device) = device() else { return };
    let coarse = Settings::default();
    let fine = Settings::default().with_nodes(200).with_levels(150);
    for (points, settings) in [(100, &coarse), (200_000, &fine), (100, &coarse), (0, &coarse), (3_000, &fine)]
    {
        agrees(device, &wall(points, 101), settings);
    }
}

#[test]
fn more_than_65535_workgroups_a_pass() {
    let Some(device) = device() else { return };
    // 64 faces or nodes a workgroup: 65,625 of them.
    let settings = Settings::default().with_nodes(4_200_000).with_levels(1).with_iterations(1);
    agrees(device, &wall(20_000, 103), &settings);
}

/// llvmpipe ends loops after 65,535 rounds, so that no workgroup may have too many faces to do.
#[test]
fn thousands_of_long_faces_are_all_measured() {
    let Some(device) = device() else { return };
    let settings = Settings::default().with_nodes(100).with_levels(60).with_iterations(1);
    agrees(device, &wall(2_400_000, 173), &settings);
}
