//! The local estimate of the cylinders, against the models that an external tool put into two recordings.

mod support;

use glam::DVec2;
use lumenmesh::geometry::Pose;
use lumenmesh::recording::Recording;
use support::shared;

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers[numbers.len() / 2]
}

/// Medians over the frames of: distance of the centres (mm), angle of the axes (degrees), relative difference of the
/// radii.
fn medians(given: &Recording, estimated: &Recording) -> [f64; 3] {
    let pairs =
        || given.frames.iter().zip(&estimated.frames).filter_map(|(a, b)| Some((a.cylinder?, b.cylinder?)));
    let centre = pairs().map(|(a, b)| DVec2::new(a.px_mm - b.px_mm, a.py_mm - b.py_mm).length());
    let angle = pairs().map(|(a, b)| {
        let [a, b] = [a, b].map(|m| m.sensor_from_cylinder().rotation.x_axis);
        a.dot(b).abs().min(1.0).acos().to_degrees()
    });
    let radius = pairs().map(|(a, b)| (b.radius_mm / a.radius_mm - 1.0).abs());
    [median(centre.collect()), median(angle.collect()), median(radius.collect())]
}

#[test]
fn estimates_agree_with_the_models_of_the_recordings() {
    for (name, most) in
        [("adult_aorta_clean.mat", [1.5, 15.0, 0.1]), ("adult_aorta_noisy.mat", [1.5, 15.0, 0.1])]
    {
        let Some(path) = shared(&format!("recordings/{name}")) else { return };
        let given = Recording::read(&path).unwrap();
        let mut estimated = given.clone();
        estimated.frames.iter_mut().for_each(|f| f.cylinder = None);
        assert_eq!(estimated.estimate_cylinders(Pose::IDENTITY), 1000);
        let found = medians(&given, &estimated);
        println!(
            "{name}: centre {:.3} mm, axis {:.2} degrees, radius {:.2} %",
            found[0],
            found[1],
            found[2] * 100.0
        );
        for (what, (found, most)) in ["centre", "axis", "radius"].into_iter().zip(found.into_iter().zip(most))
        {
            assert!(found < most, "{name}: {what}: {found} is not below {most}");
        }
        // The comparison sees a model that is off.
        let mut off = estimated;
        for cylinder in off.frames.iter_mut().filter_map(|f| f.cylinder.as_mut()) {
            cylinder.px_mm += 5.0;
            cylinder.theta_rad += 0.6;
            cylinder.radius_mm *= 1.3;
        }
        let far = medians(&given, &off);
        assert!((0..3).all(|i| far[i] > most[i]), "{far:?}");
    }
}

#[test]
fn a_model_that_is_there_stays() {
    let Some(path) = shared("recordings/adult_aorta_clean.mat") else { return };
    let given = Recording::read(&path).unwrap();
    let mut filled = given.clone();
    filled.frames[500].cylinder = None;
    assert_eq!(filled.estimate_cylinders(Pose::IDENTITY), 1);
    for k in (0..1000).filter(|&k| k != 500) {
        assert_eq!(filled.frames[k].cylinder, given.frames[k].cylinder, "frame {k}");
    }
}
