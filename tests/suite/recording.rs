//! Recordings come back from their files as they were, and bad files say what is wrong with them.

use crate::support::shared;
use glam::{DQuat, DVec2, DVec3};
use hdf5_pure::{AttrValue, FileBuilder};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::CylinderModel;
use lumenmesh::recording::{Frame, Recording};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::process::Command;

/// Frames with ragged contours, missing echoes, times and cylinders on some of them, and in one of three
/// recordings numbers with gaps.
fn some_recording(seed: u64) -> Recording {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (frames, rays) = (random.random_range(1..30), random.random_range(0..40));
    let (ragged, timed, modelled) =
        (random.random_bool(0.5), random.random_bool(0.5), random.random_bool(0.5));
    let (first, step) =
        if seed.is_multiple_of(3) { (seed as usize, 1 + seed as usize / 3 % 3) } else { (0, 1) };
    let frame = |k: usize| {
        let mut number = |scale: f64| random.random_range(-scale..scale);
        let quaternion = DQuat::from_xyzw(number(1.0), number(1.0), number(1.0), number(1.0)).normalize();
        let position = DVec3::new(number(500.0), number(500.0), number(1e-7));
        let model = CylinderModel {
            px_mm: number(3.0),
            py_mm: number(3.0),
            theta_rad: number(1.6),
            phi_rad: number(3.1),
            radius_mm: number(5.0).abs() + 1e-3,
        };
        let rays = if ragged { random.random_range(0..=rays) } else { rays };
        let point = |_| match random.random_bool(0.1) {
            true => DVec2::NAN,
            false => DVec2::new(random.random_range(-20.0..20.0), random.random_range(-20.0..20.0)),
        };
        let contour_mm = (0..rays).map(point).collect();
        Frame::new(Pose::from_quaternion(position, quaternion), contour_mm)
            .with_time_s((timed && random.random_bool(0.9)).then(|| random.random_range(0.0..60.0)))
            .with_cylinder((modelled && random.random_bool(0.9)).then_some(model))
            .with_number(Some(first + step * k).filter(|&number| number != k))
    };
    Recording { frames: (0..frames).map(frame).collect() }
}

/// What two recordings differ in; rotations may differ by `rotation_tolerance`, all else by not one bit.
fn difference(a: &Recording, b: &Recording, rotation_tolerance: f64) -> Option<String> {
    if a.frames.len() != b.frames.len() {
        return Some(format!("{} and {} frames", a.frames.len(), b.frames.len()));
    }
    for (k, (a, b)) in a.frames.iter().zip(&b.frames).enumerate() {
        let contour = |f: &Frame| -> Vec<[u64; 2]> {
            f.contour_mm
                .iter()
                .map(|p| if p.is_nan() { [u64::MAX; 2] } else { p.to_array().map(f64::to_bits) })
                .collect()
        };
        let (p, q) = (&a.world_from_sensor, &b.world_from_sensor);
        let same = p.translation_mm.to_array().map(f64::to_bits)
            == q.translation_mm.to_array().map(f64::to_bits)
            && p.rotation.abs_diff_eq(q.rotation, rotation_tolerance)
            && a.time_s == b.time_s
            && contour(a) == contour(b)
            && a.cylinder == b.cylinder
            && a.number == b.number;
        if !same {
            return Some(format!("frame {k}: {a:?} and {b:?}"));
        }
    }
    None
}

#[test]
fn a_recording_comes_back_from_its_file_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let (mat, csv) = (folder.path().join("rec.mat"), folder.path().join("rec"));
    for seed in 0..60 {
        let recording = some_recording(seed);
        recording.write(&mat).unwrap();
        assert_eq!(difference(&recording, &Recording::read(&mat).unwrap(), 0.0), None, "seed {seed}");
        // The folder of the seed before is there and is replaced.
        recording.write(&csv).unwrap();
        assert_eq!(difference(&recording, &Recording::read(&csv).unwrap(), 1e-12), None, "seed {seed}");
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "nothing temporary stays: {left:?}");
}

#[test]
fn the_comparison_sees_one_changed_bit() {
    let recording = some_recording(3);
    let mut changed = recording.clone();
    let frame = changed.frames.iter_mut().find(|f| f.echoes_mm().next().is_some()).unwrap();
    let point = frame.contour_mm.iter_mut().find(|p| !p.is_nan()).unwrap();
    point.y = f64::from_bits(point.y.to_bits() ^ 1);
    assert!(difference(&recording, &changed, 0.0).is_some());
}

#[test]
fn equal_recordings_give_equal_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let path = folder.path().join(name);
        some_recording(7).write(&path).unwrap();
        std::fs::read(path).unwrap()
    };
    assert_eq!(write("a.mat"), write("b.mat"));
}

#[test]
fn real_recordings_are_read_with_their_missing_echoes() {
    for name in ["adult_aorta_clean.mat", "adult_aorta_noisy.mat"] {
        let Some(path) = shared(&format!("recordings/{name}")) else { return };
        let recording = Recording::read(&path).unwrap();
        assert_eq!(recording.frames.len(), 1000);
        assert!(recording.frames.iter().all(|f| f.contour_mm.len() == 90 && f.cylinder.is_some()));
        assert_eq!(recording.frames.iter().map(Frame::missing_echoes).sum::<usize>(), 318);
        let folder = tempfile::tempdir().unwrap();
        let copy = folder.path().join("copy.mat");
        recording.write(&copy).unwrap();
        assert_eq!(difference(&recording, &Recording::read(&copy).unwrap(), 0.0), None);
    }
}

/// What Octave prints for some code run in a folder; `None`, said loudly, where there is no Octave.
fn octave(folder: &Path, code: &str) -> Option<String> {
    tool(folder, "octave-cli", &["--no-init-file", "--quiet", "--eval", code])
}

fn tool(folder: &Path, program: &str, arguments: &[&str]) -> Option<String> {
    match Command::new(program).args(arguments).current_dir(folder).output() {
        Ok(output) => {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            Some(String::from_utf8_lossy(&output.stdout).into_owned())
        }
        Err(e) => absent(&format!("{program} does not run: {e}")),
    }
}

fn absent(what: &str) -> Option<String> {
    crate::support::skipped(what, "LUMENMESH_REQUIRE_TOOLS");
    None
}

/// What Python prints, where it has SciPy. `LUMENMESH_PYTHON` may name another one than `python3`.
fn scipy(folder: &Path, code: &str) -> Option<String> {
    let python = std::env::var("LUMENMESH_PYTHON").unwrap_or_else(|_| "python3".into());
    let probe = "import importlib.util as u; print(all(u.find_spec(m) for m in ('numpy', 'scipy')))";
    if tool(folder, &python, &["-c", probe])?.trim() != "True" {
        return absent(&format!("{python} has no SciPy (set LUMENMESH_PYTHON)"));
    }
    tool(folder, &python, &["-c", code])
}

#[test]
fn octave_reads_what_we_write() {
    let folder = tempfile::tempdir().unwrap();
    let recording = some_recording(11);
    recording.write(&folder.path().join("rec.mat")).unwrap();
    let Some(said) = octave(
        folder.path(),
        "load rec.mat; printf('%d ', size(rotm), size(Ep), size(x_data)); \
         printf('%.17g ', rotm(2, 3, end), Ep(end, 2), sum(x_data(! isnan(x_data))));",
    ) else {
        return;
    };
    let last = recording.frames.last().unwrap();
    let (frames, rays) =
        (recording.frames.len(), recording.frames.iter().map(|f| f.contour_mm.len()).max().unwrap());
    let numbers: Vec<f64> = said.split_whitespace().map(|n| n.parse().unwrap()).collect();
    let sizes = [3, 3, frames, frames, 3, frames, rays].map(|n| n as f64);
    assert_eq!(numbers[..7], sizes);
    assert_eq!(numbers[7], last.world_from_sensor.rotation.z_axis.y);
    assert_eq!(numbers[8], last.world_from_sensor.translation_mm.y);
    // The sum is in another order there.
    let sum: f64 = recording.frames.iter().flat_map(Frame::echoes_mm).map(|p| p.x).sum();
    assert!((numbers[9] - sum).abs() < 1e-9, "{} {sum}", numbers[9]);
}

/// Octave code that makes a good recording of 4 frames and 5 rays.
const GOOD: &str = "rotm = repmat(eye(3), [1 1 4]); Ep = reshape(1:12, 4, 3) / 8; \
    x_data = reshape(1:20, 4, 5) / 4; y_data = -x_data; x_data(2, 3) = y_data(2, 3) = NaN;";

#[test]
fn files_that_octave_writes_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let code = format!(
        "{GOOD} save -v6 v6.mat; save -v7 v7.mat; \
         x_data = single(x_data); y_data = single(y_data); Ep = int16(Ep * 8); save -v7 classes.mat; \
         z = {{1, 'a'}}; s.a = 3; t = 'text'; b = true; c = sparse([1 0 2]); save -v7 others.mat; \
         rotm = eye(3); Ep = Ep(1, :); x_data = x_data(1, :); y_data = y_data(1, :); save -v6 one.mat; \
         cyl_px = cyl_py = theta = phi = 0.25; rad = 7; time_s = 2.5; save -v7 model.mat;"
    );
    if octave(folder.path(), &code).is_none() {
        return;
    }
    let read = |name: &str| Recording::read(&folder.path().join(name)).unwrap();
    let v6 = read("v6.mat");
    assert_eq!(v6.frames.len(), 4);
    assert_eq!(v6.frames[1].world_from_sensor.translation_mm, DVec3::new(2.0, 6.0, 10.0) / 8.0);
    assert_eq!(v6.frames[3].contour_mm[4], DVec2::new(5.0, -5.0));
    assert_eq!(v6.frames.iter().map(Frame::missing_echoes).collect::<Vec<_>>(), [0, 1, 0, 0]);
    assert_eq!(difference(&v6, &read("v7.mat"), 0.0), None);
    let classes = read("classes.mat");
    assert_eq!(classes.frames[1].world_from_sensor.translation_mm, DVec3::new(2.0, 6.0, 10.0));
    assert_eq!(classes.frames[0].contour_mm, v6.frames[0].contour_mm);
    assert_eq!(difference(&classes, &read("others.mat"), 0.0), None);
    assert_eq!(read("one.mat").frames.len(), 1);
    let model = &read("model.mat").frames[0];
    assert_eq!(model.time_s, Some(2.5));
    assert_eq!(model.cylinder.unwrap().radius_mm, 7.0);
}

/// Octave code that turns the good recording's frames.
const TURNED: &str = "for k = 1:4, a = 0.3 * k; c = cos(a); s = sin(a); \
    rotm(:, :, k) = [c -s 0; s c 0; 0 0 1]; q(k, :) = [cos(a / 2) 0 0 sin(a / 2)]; \
    tf(:, :, k) = [rotm(:, :, k) Ep(k, :)'; 0 0 0 1]; \
    xy{k} = [x_data(k, :)' y_data(k, :)']; yx{k} = [x_data(k, :); y_data(k, :)]; end; P = Ep; X = x_data; Y = y_data; \
    R = rotm; clear a c s k;";

#[test]
fn arrays_that_others_arrange_otherwise_are_read() {
    let kept = "Ep = P; x_data = X; y_data = Y; clear R P X Y tf q xy yx";
    let cases = [
        "rec.rotm = R; rec.Ep = P; rec.x_data = X; rec.y_data = Y; clear rotm Ep x_data y_data",
        "s.pose.rotm = R; s.pose.Ep = P; s.note = 'a'; s.image.x_data = X; s.more = {1, 'b', {2}}; y_data = Y; \
         clear rotm Ep x_data",
        "Ep = P'; rotm = permute(R, [3 1 2]); x_data = X'; y_data = Y'",
        "quat_wxyz = q; clear rotm",
        "quat_xyzw = q(:, [2 3 4 1])'; clear rotm",
        "wTe = tf; clear rotm Ep",
        "poses = permute(tf, [3 1 2]); clear rotm Ep",
        "T = permute(tf, [2 1 3]); clear rotm Ep",
        "x_data = num2cell(X, 2); y_data = num2cell(Y, 2)'",
        "contours = xy; clear x_data y_data",
        "rec.contours = yx'; clear x_data y_data",
        "valid = true(4, 1); status = {'OK'; 'OK'; 'TOOL_OK'; 'ok'}",
        // What else may be named as ours is left alone.
        "status = 'done'; T = 300; ok = 1; pose = {1}",
    ];
    let folder = tempfile::tempdir().unwrap();
    let mut code = format!("{GOOD} {TURNED} save -v7 plain.mat rotm Ep x_data y_data; ");
    for (i, change) in cases.iter().enumerate() {
        let rest = if change.contains("T = 3") { kept } else { "clear R P X Y tf q xy yx" };
        code +=
            &format!("clear all; {GOOD} {TURNED} {change}; {rest}; save -v7 c{i}.mat; save -v6 d{i}.mat; ");
    }
    code += &format!(
        "clear all; {GOOD} {TURNED} quat_wxyz = q; text = 'abc'; save -v4 v4.mat quat_wxyz Ep x_data y_data text"
    );
    if octave(folder.path(), &code).is_none() {
        return;
    }
    let plain = Recording::read(&folder.path().join("plain.mat")).unwrap();
    assert!((plain.frames[2].world_from_sensor.rotation.x_axis.y - 0.9_f64.sin()).abs() < 1e-15);
    let same = |name: String| {
        let recording = Recording::read(&folder.path().join(&name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(difference(&plain, &recording, 1e-12), None, "{name}");
    };
    for (i, _) in cases.iter().enumerate() {
        same(format!("c{i}.mat"));
        same(format!("d{i}.mat"));
    }
    same("v4.mat".into());
}

#[test]
fn ragged_contours_and_lost_poses_are_read_from_cells_and_flags() {
    let folder = tempfile::tempdir().unwrap();
    let code = format!(
        "{GOOD} contours = {{[1 2; 3 4; 5 6], [], [7 8], zeros(0, 2)}}; clear x_data y_data; save -v7 points.mat; \
         clear contours; x_data = {{[1 3 5], [], 7, zeros(1, 0)}}; y_data = {{[2; 4; 6], [], 8, []}}; save -v7 vectors.mat; \
         valid = [1 0 1 1]; status = {{'OK', 'OK', 'OK', 'OUT_OF_VIEW'}}; save -v7 lost.mat; \
         valid = logical(valid); clear status; rotm = round(rotm * 100) / 100; rotm(:, :, 3) = [.8 -.6 0; .6 .803 0; 0 0 1]; \
         save -v7 rounded.mat"
    );
    if octave(folder.path(), &code).is_none() {
        return;
    }
    let read = |name: &str| Recording::read_unchecked(&folder.path().join(name)).unwrap();
    let points = read("points.mat");
    let expected = [
        vec![DVec2::new(1.0, 2.0), DVec2::new(3.0, 4.0), DVec2::new(5.0, 6.0)],
        vec![],
        vec![DVec2::new(7.0, 8.0)],
        vec![],
    ];
    assert!(points.frames.iter().map(|f| &f.contour_mm).eq(&expected));
    assert_eq!(difference(&points, &read("vectors.mat"), 0.0), None);
    assert_eq!(lost(&read("lost.mat")), [1, 3]);
    let rounded = read("rounded.mat");
    assert_eq!(lost(&rounded), [1]);
    let frame = &rounded.frames[2];
    // 0.803² + 0.6² − 1.
    assert!((frame.rotation_error.unwrap() - 4.809e-3).abs() < 1e-12);
    assert!(frame.world_from_sensor.orthogonality_error() < 1e-15);
    assert!((frame.world_from_sensor.rotation.x_axis.y - 0.6).abs() < 2e-3);
    assert!(rounded.frames[0].rotation_error.is_none());
    let said = lumenmesh::recording::Summary::of(&rounded).to_string();
    assert!(said.contains("rotations       1 made orthonormal"), "{said}");
}

#[test]
fn arrays_that_can_be_read_in_two_ways_are_refused() {
    let cases = [
        (
            "quat = q; clear rotm",
            "quat: found quaternions in an order that the name does not state, expected the name quat_wxyz",
        ),
        (
            "Ep = Ep'; x_data = X(:, 1:4); y_data = Y(:, 1:4)",
            "x_data: found 4x4, which can be read in two ways, beside Ep, which is transposed",
        ),
        (
            "contours = {eye(2), eye(2), [], eye(2)}; clear x_data y_data",
            "contours{4}: found 2x2, expected a cell that tells",
        ),
        (
            "contours = {ones(3, 2), ones(2, 3), [], []}; clear x_data y_data",
            "contours{2}: found 2x3, expected Mx2, as in",
        ),
        ("contours = {1, 2, 3, ones(4)}; clear x_data y_data", "contours{1}: found 1x1, expected Mx2 or 2xM"),
        ("contours = {'a', 2, 3, 4}; clear x_data y_data", "contours{1}: found text, expected cells of Mx2"),
        ("contours = {1, 2, 3}; clear x_data y_data", "contours: found 3 cells, expected 4, one per frame"),
        (
            "x_data = {1, 2, 3, 4}; y_data = {1, [1 2], 3, 4}",
            "y_data{2}: found 2 numbers, expected 1 (as x_data)",
        ),
        ("x_data = {1, 2, eye(3), 4}; y_data = {1, 2, 3, 4}", "x_data{3}: found 3x3, expected a vector"),
        ("a.rotm = b.rotm = R; clear rotm", "rotm: found a.rotm, b.rotm, expected one variable of that name"),
        (
            "wTe = tf; wTe(4, 2, 3) = 1; clear rotm Ep",
            "wTe: found a transform whose last row is not 0, 0, 0, 1",
        ),
        (
            "wTe = repmat(eye(4), [1 1 5]); clear rotm Ep",
            "wTe: found transforms without a translation, expected",
        ),
        ("T = 300; clear rotm", "T: found 1x1, expected 4x4xF, one transform per frame"),
        ("frame_number = [1 2 2 3]", "frame_number(3): found 2, expected whole numbers that rise"),
    ];
    let folder = tempfile::tempdir().unwrap();
    let mut code = String::new();
    for (i, (change, _)) in cases.iter().enumerate() {
        code += &format!("clear all; {GOOD} {TURNED} {change}; save -v7 bad{i}.mat; ");
    }
    if octave(folder.path(), &code).is_none() {
        return;
    }
    for (i, (change, expected)) in cases.iter().enumerate() {
        let message =
            Recording::read(&folder.path().join(format!("bad{i}.mat"))).expect_err(change).to_string();
        assert!(message.contains(expected), "{change}: {message}");
    }
}

#[test]
fn scipy_and_we_read_each_others_files() {
    let folder = tempfile::tempdir().unwrap();
    let recording = some_recording(11);
    recording.write(&folder.path().join("ours.mat")).unwrap();
    let code = "from scipy.io import loadmat, savemat\n\
        m = {k: v for k, v in loadmat('ours.mat').items() if not k.startswith('__')}\n\
        savemat('plain.mat', m)\n\
        savemat('compressed.mat', m, do_compression=True)";
    if scipy(folder.path(), code).is_none() {
        return;
    }
    for name in ["plain.mat", "compressed.mat"] {
        let read = Recording::read(&folder.path().join(name)).unwrap();
        assert_eq!(difference(&recording, &read, 0.0), None, "{name}");
    }
}

#[test]
fn bad_mat_variables_are_named_with_what_was_expected() {
    let cases = [
        (
            "clear Ep",
            "Ep: found no variable of that name among rotm, x_data, y_data, expected rotm, Ep, x_data and y_data",
        ),
        ("clear y_data", "y_data: found no variable of that name"),
        (
            "rec.rot = rotm; clear rotm",
            "rotm: found no variable of that name among Ep, rec (rot), x_data, y_data",
        ),
        ("clear all; a.b.c = d = 1", "Ep: found no variable of that name among a (b (c)), d, expected"),
        ("Ep = Ep(:, 1:2)", "Ep: found 4x2, expected Fx3"),
        ("rotm = rotm(:, :, 1:3)", "rotm: found 3x3x3, expected 3x3x4, for 4 frames"),
        ("x_data = x_data'", "y_data: found 4x5, expected 5x4 (as x_data)"),
        ("x_data = x_data(1:3, :)", "x_data: found 3x5, expected 4xM, for 4 frames"),
        ("y_data = y_data(:, 1:4)", "y_data: found 4x4, expected 4x5 (as x_data)"),
        ("x_data = x_data * i", "x_data: found complex numbers, expected a full array of real numbers"),
        ("rotm = {rotm}", "rotm: found a cell array, expected"),
        ("Ep = 'abc'", "Ep: found text, expected"),
        ("Ep = struct('a', 1)", "Ep: found a struct, expected"),
        ("Ep = sparse(Ep)", "Ep: found a sparse array, expected"),
        ("Ep = Ep > 0", "Ep: found logical values, expected"),
        (
            "Ep(3, 2) = NaN",
            "frame 2: position: found [0.375, NaN, 1.375], expected three finite numbers in mm",
        ),
        ("rotm(1, 1, 2) = Inf", "frame 1: rotation: found a number that is not finite"),
        ("rotm(1, 1, 2) = -1", "frame 1: rotation: found determinant -1.000, expected 1 (right-handed axes)"),
        ("rotm(1, 1, 2) = 1.5", "frame 1: rotation: found |RᵀR - I| = 1.250e0, expected at most 1e-3"),
        (
            "x_data(1, 2) = NaN",
            "frame 0: contour: found (NaN, -1.25) at point 1, expected two finite numbers",
        ),
        ("rad = ones(4, 1)", "cyl_px, cyl_py, theta, phi: found no variable of that name, expected all of"),
        ("time_s = [1 2 3]", "time_s: found 1x3, expected 4x1 (one number per frame)"),
        ("rays = [5 5 6 5]", "frame 2: rays: found 6, expected a whole number from 0 to 5"),
        (
            "cyl_px = cyl_py = theta = phi = ones(4, 1); rad = [1 1 1 0]",
            "frame 3: cylinder radius: found 0.0 mm",
        ),
        ("Ep = zeros(0, 3); rotm = zeros(3, 3, 0); x_data = y_data = zeros(0, 5)", "frames: found 0 frames"),
    ];
    let folder = tempfile::tempdir().unwrap();
    let mut code = String::new();
    for (i, (change, _)) in cases.iter().enumerate() {
        code += &format!("clear all; {GOOD} {change}; save -v7 bad{i}.mat; ");
    }
    if octave(folder.path(), &code).is_none() {
        return;
    }
    for (i, (change, expected)) in cases.iter().enumerate() {
        let path = folder.path().join(format!("bad{i}.mat"));
        let message = Recording::read(&path).expect_err(change).to_string();
        assert!(message.starts_with(&format!("{}: ", path.display())), "{change}: {message}");
        assert!(message.contains(expected), "{change}: {message}");
    }
}

#[test]
fn files_that_are_no_mat_files_say_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        Recording::read(&path).unwrap_err().to_string()
    };
    let mut hdf5 =
        b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan 01 00:00:00 2024 HDF5".to_vec();
    hdf5.resize(512, b' ');
    hdf5.extend(b"\x89HDF\r\n\x1a\n");
    for content in [hdf5.as_slice(), b"\x89HDF\r\n\x1a\n and so on"] {
        let said = message("v73.mat", content);
        assert!(said.contains("v73.mat: format: found"), "{said}");
        assert!(said.contains("save with -v7"), "{said}");
    }
    assert!(message("empty.mat", b"").contains("found an empty file"));
    assert!(message("noise.mat", &[7; 300]).contains("found a file without the header of one"));
    for (content, expected) in [
        (
            b"# Created by Octave 9.2.0".as_slice(),
            "found a file of Octave's own text format, expected a MAT-file (in",
        ),
        (b"Octave-1-L\0", "found a file of Octave's own binary format"),
        (b"\x1f\x8b\x08\0\0\0\0\0", "found a file compressed by gzip (unpack it first)"),
        (b"PK\x03\x04", "found a zip archive"),
    ] {
        let said = message("other.mat", content);
        assert!(said.contains(expected), "{said}");
    }
    assert!(message("rec.npz", b"PK").contains("unknown ending \"npz\", expected one of mat"));
    let absent = Recording::read(&folder.path().join("absent.mat")).unwrap_err().to_string();
    assert!(absent.contains("absent.mat: cannot read: "), "{absent}");
}

/// A dataset as MATLAB writes it: the sizes in reverse order, and what it is in an attribute.
fn dataset(builder: &mut hdf5_pure::DatasetBuilder, class: &str, shape: &[u64]) {
    let reversed: Vec<u64> = shape.iter().rev().copied().collect();
    builder.with_shape(&reversed).set_attr("MATLAB_class", AttrValue::AsciiString(class.into()));
}

/// A file of version 7.3 of two frames: a struct, an array in chunks, a cell array, an empty array, and a
/// variable that nobody asked for.
fn version_7_3() -> Vec<u8> {
    let mut file = FileBuilder::new();
    file.with_userblock(512).with_userblock_content(b"MATLAB 7.3 MAT-file, Platform: GLNXA64");
    let mut rec = file.create_group("rec");
    rec.set_attr("MATLAB_class", AttrValue::AsciiString("struct".into()));
    // A turn by a quarter about z, and none.
    let quarter = [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    dataset(rec.create_dataset("rotm").with_f64_data(&quarter).with_deflate(3), "double", &[3, 3, 2]);
    dataset(rec.create_dataset("Ep").with_f32_data(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), "single", &[2, 3]);
    file.add_group(rec.finish());
    let mut cells = file.create_group("#refs#");
    dataset(cells.create_dataset("a").with_f64_data(&[1.0, 3.0, 5.0, 2.0, 4.0, 6.0]), "double", &[3, 2]);
    dataset(cells.create_dataset("b").with_f64_data(&[7.0, 8.0]), "double", &[1, 2]);
    file.add_group(cells.finish());
    dataset(
        file.create_dataset("contours").with_path_references(&["/#refs#/a", "/#refs#/b"]),
        "cell",
        &[1, 2],
    );
    dataset(file.create_dataset("valid").with_u8_data(&[0, 1]), "logical", &[2, 1]);
    dataset(file.create_dataset("image").with_u8_data(&[7; 24]), "uint8", &[2, 3, 4]);
    let empty = file.create_dataset("time_s").with_u64_data(&[0, 0]);
    empty.set_attr("MATLAB_empty", AttrValue::U64(1));
    dataset(empty, "double", &[2]);
    file.finish().unwrap()
}

#[test]
fn version_7_3_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.mat");
    std::fs::write(&path, version_7_3()).unwrap();
    let recording = Recording::read_unchecked(&path).unwrap();
    assert_eq!(lost(&recording), [0]);
    let [first, second] = &recording.frames[..] else { panic!("two frames") };
    assert_eq!(first.contour_mm, [DVec2::new(1.0, 2.0), DVec2::new(3.0, 4.0), DVec2::new(5.0, 6.0)]);
    assert_eq!(second.contour_mm, [DVec2::new(7.0, 8.0)]);
    assert_eq!(
        second.world_from_sensor,
        Pose { translation_mm: DVec3::new(2.0, 4.0, 6.0), ..Pose::IDENTITY }
    );
    assert_eq!(second.time_s, None);

    let whole = version_7_3();
    for length in 0..whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        let read = Recording::read_unchecked(&path);
        assert!(read.is_err() || length + 100 > whole.len(), "cut at {length}");
    }
}

#[test]
fn what_version_7_3_cannot_say_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.mat");
    let message = |change: &dyn Fn(&mut FileBuilder)| {
        let mut file = FileBuilder::new();
        change(&mut file);
        std::fs::write(&path, file.finish().unwrap()).unwrap();
        Recording::read_unchecked(&path).unwrap_err().to_string()
    };
    // Another program's arrays are in rows, so that each rotation would be read as its inverse.
    let said = message(&|file| {
        file.create_dataset("rotm").with_f64_data(&[0.0; 18]).with_shape(&[2, 3, 3]);
    });
    assert!(
        said.contains("rotm: found a dataset that MATLAB has not written (it has no MATLAB_class)"),
        "{said}"
    );
    let said = message(&|file| {
        dataset(file.create_dataset("Ep").with_f64_data(&[0.0; 6]).with_shape(&[2, 3]), "double", &[2, 3]);
    });
    assert!(said.contains("rotm: found no variable of that name"), "{said}");
}

#[test]
fn a_mat_file_that_is_cut_short_names_the_variable() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.mat");
    some_recording(11).write(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let message = |length: usize| {
        std::fs::write(&path, &whole[..length]).unwrap();
        Recording::read(&path).unwrap_err().to_string()
    };
    assert!(message(400).contains("rec.mat: rotm: found 264 of "), "{}", message(400));
    assert!(message(400).contains("the file is cut short"), "{}", message(400));
    for length in 0..600 {
        message(length);
    }
}

/// A folder of CSV files, written as a spreadsheet in Europe may.
fn write_csv(folder: &Path, poses: &str, contours: &str, cylinders: Option<&str>) {
    std::fs::write(folder.join("poses.csv"), poses).unwrap();
    std::fs::write(folder.join("contours.csv"), contours).unwrap();
    if let Some(text) = cylinders {
        std::fs::write(folder.join("cylinders.csv"), text).unwrap();
    }
}

#[test]
fn csv_columns_are_found_by_name_in_any_dialect() {
    let folder = tempfile::tempdir().unwrap();
    write_csv(
        folder.path(),
        "\u{feff}note;qw;qx;qy;qz;x_mm;y_mm;z_mm;time_s;frame\r\nfirst;1,0004;0;0;0;-1,5;2;3;;10\r\n;0;1;0;0;0;0;0;0,25;12\r\n",
        "frame\ty_mm\tx_mm\n12\t1.5\t2\n10\t\t\n10\tNaN\tNaN\n12\t3\t4\n",
        Some("frame,px_mm,py_mm,theta_rad,phi_rad,radius_mm\n12,0,0,1.5,1.5,4\n"),
    );
    let recording = Recording::read(folder.path()).unwrap();
    let [first, second] = &recording.frames[..] else { panic!("two frames") };
    assert_eq!(
        first.world_from_sensor,
        Pose { translation_mm: DVec3::new(-1.5, 2.0, 3.0), ..Pose::IDENTITY }
    );
    assert_eq!((first.time_s, second.time_s), (None, Some(0.25)));
    assert_eq!((first.contour_mm.len(), first.missing_echoes()), (2, 2));
    assert_eq!(second.contour_mm, [DVec2::new(2.0, 1.5), DVec2::new(4.0, 3.0)]);
    assert_eq!(second.cylinder.unwrap().radius_mm, 4.0);
}

#[test]
fn bad_csv_lines_are_named_with_what_was_expected() {
    let poses = "frame,x_mm,y_mm,z_mm,qx,qy,qz,qw\n3,0,0,0,0,0,0,1\n4,0,0,0,0,0,0,1\n";
    let contours = "frame,x_mm,y_mm\n3,1,1\n4,2,2\n";
    let cylinders = "frame,px_mm,py_mm,theta_rad,phi_rad,radius_mm\n3,0,0,1,1,1\n";
    let cases = [
        ("poses", "x_mm,y_mm", "x_px,y_mm", "poses.csv: x_mm: found columns frame, x_px, y_mm"),
        ("poses", "x_mm,y_mm", "x_mm,x_mm", "poses.csv: x_mm: found two columns of that name, expected one"),
        ("poses", "4,0", "3,0", "poses.csv: line 3: frame: found 3, expected a number above 3"),
        ("poses", "4,0", "2,0", "poses.csv: line 3: frame: found 2, expected a number above 3"),
        ("poses", "4,0", "4.5,0", "poses.csv: line 3: frame: found 4.5, expected a whole number"),
        ("poses", "4,0", "4,abc", "poses.csv: line 3: x_mm: found \"abc\", expected a number"),
        (
            "poses",
            "4,0,",
            "4,,",
            "poses.csv: frame 4: pose: found none, expected a pose: the tracker reported none",
        ),
        ("poses", "\n4,", "\n,", "poses.csv: line 3: frame: found nothing, expected a number"),
        ("poses", "\n4,", "\nN/A,", "poses.csv: line 3: frame: found \"N/A\", expected a number"),
        (
            "poses",
            "4,0,0,0,0,0,0,1",
            "4,0,0,0,0",
            "poses.csv: line 3: found 5 fields, expected 8, one for each column name",
        ),
        (
            "poses",
            "4,0,0,0,0,0,0,1",
            "4,0,0,0,0,0,0,0.9",
            "poses.csv: frame 4: rotation: found axes of length 0.8100 (a quaternion of norm 0.9000), expected unit axes",
        ),
        (
            "poses",
            "4,0,0,0,0,0,0,1",
            "4,0,0,0,0,0,0,0",
            "poses.csv: frame 4: rotation: found a first axis of length 0, expected unit axes",
        ),
        (
            "poses",
            "4,0,0,0,0,0,0,1",
            "4,0,NaN,0,0,0,0,1",
            "poses.csv: frame 4: pose: found none, expected a pose: the tracker reported none",
        ),
        (
            "contours",
            "4,2",
            "5,2",
            "poses.csv: frame 5: pose: found none, expected a pose: the tracker reported none",
        ),
        (
            "contours",
            "4,2,2",
            "4,2,",
            "contours.csv: frame 4: contour: found (2, NaN) at point 0, expected two finite numbers",
        ),
        ("contours", "frame,x_mm,y_mm\n", "", "contours.csv: frame: found no line of column names"),
        (
            "cylinders",
            "3,0",
            "9,0",
            "cylinders.csv: line 2: frame: found 9, expected a frame of poses.csv or contours",
        ),
        (
            "cylinders",
            "1,1,1\n",
            "1,1,1\n3,0,0,1,1,1\n",
            "cylinders.csv: line 3: frame: found a second line for this frame, expected one",
        ),
        (
            "cylinders",
            "1,1,1\n",
            "1,1,-1\n",
            "cylinders.csv: frame 3: cylinder radius: found -1.0 mm, expected more than 0 and at most 10000 mm",
        ),
        ("cylinders", "1,1,1\n", "1,1,1e30\n", "cylinders.csv: frame 3: cylinder radius: found 1e30 mm"),
    ];
    let folder = tempfile::tempdir().unwrap();
    write_csv(folder.path(), poses, contours, Some(cylinders));
    Recording::read(folder.path()).unwrap();
    for (file, from, to, expected) in cases {
        let change =
            |name: &str, text: &str| if file == name { text.replace(from, to) } else { text.to_owned() };
        let cylinders = change("cylinders", cylinders);
        write_csv(folder.path(), &change("poses", poses), &change("contours", contours), Some(&cylinders));
        let message = Recording::read(folder.path()).expect_err(expected).to_string();
        assert!(message.contains(expected), "{expected}\n{message}");
        assert!(message.starts_with(&folder.path().display().to_string()), "{message}");
    }
    std::fs::remove_file(folder.path().join("contours.csv")).unwrap();
    let message = Recording::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("cannot read"), "{message}");
}

#[test]
fn a_recording_that_would_not_read_back_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = some_recording(1);
    recording.frames[0].number = Some(17);
    recording.frames[0].world_from_sensor.translation_mm.x = f64::NAN;
    for name in ["rec.mat", "rec"] {
        let message = recording.write(&folder.path().join(name)).unwrap_err().to_string();
        assert!(message.contains(&format!("{name}: frame 17: position: found ")), "{message}");
    }
    let message = some_recording(1).write(&folder.path().join("rec.xlsx")).unwrap_err().to_string();
    assert!(message.contains("rec.xlsx: unknown ending \"xlsx\", expected one of mat"), "{message}");
    std::fs::write(folder.path().join("file"), "in the way").unwrap();
    let message = some_recording(1).write(&folder.path().join("file")).unwrap_err().to_string();
    assert!(message.contains("file: cannot write: "), "{message}");
    let message = some_recording(1).write(&folder.path().join("no/such/rec")).unwrap_err().to_string();
    assert!(message.contains("rec: cannot write: "), "{message}");
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["file"]);
}

/// Poses of frames 7, 8, … with 40 good lines.
fn poses_with(header: &str, lines: &[(usize, &str)]) -> String {
    let line = |k: usize| {
        let own = lines.iter().find(|(number, _)| *number == k);
        own.map_or_else(|| format!("{k},0,0,{k},0,0,0,1,OK\n"), |(_, line)| format!("{k},{line}\n"))
    };
    format!("frame,x_mm,y_mm,z_mm,qx,qy,qz,qw,{header}\n{}", (7..47).map(line).collect::<String>())
}

/// The numbers of the frames whose poses are lost.
fn lost(recording: &Recording) -> Vec<usize> {
    let lost = |&k: &usize| !recording.frames[k].world_from_sensor.is_finite();
    (0..recording.frames.len()).filter(lost).map(|k| recording.number(k)).collect()
}

#[test]
fn a_pose_that_the_tracker_did_not_report_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let lines = [
        (9, ",,,,,,,OK"),
        (11, "0,0,NaN,0,0,0,1,OK"),
        (12, "N/A,N/A,N/A,na,NULL,none,#N/A,OK"),
        (13, "0,0,-1.#IND,0,0,0,1,"),
        (15, "-,-,-,-,-,-,-,OK"),
        (20, "0,0,20,0,0,0,1,MISSING"),
        (21, "0,0,0,0,0,0,0,TOOL_OUT_OF_VIEW"),
        (22, "unread,0,0,0,0,0,0,Invalid"),
    ];
    let contours: String = (7..50).map(|k| format!("{k},1,2\n{k},na,N/A\n")).collect();
    let contours = format!("frame,x_mm,y_mm\n{contours}");
    let read = |poses: &str| {
        write_csv(folder.path(), poses, &contours, None);
        Recording::read_unchecked(folder.path())
    };
    let recording = read(&poses_with("ProbeToTrackerTransformStatus", &lines)).unwrap();
    assert_eq!(recording.frames.len(), 43);
    assert_eq!(lost(&recording), [9, 11, 12, 13, 15, 20, 21, 22, 47, 48, 49]);
    assert!(recording.frames.iter().all(|f| f.contour_mm.len() == 2 && f.missing_echoes() == 1));
    assert_eq!(recording.frames[1].number, Some(8));

    for (header, lines, expected) in [
        (
            "ok",
            vec![(9, "0,0,9,0,0,0,1,0"), (10, "0,0,9,0,0,0,1,1"), (11, "0,0,9,0,0,0,1,False")],
            vec![9, 11],
        ),
        ("is_valid", vec![(9, "0,0,9,0,0,0,1,no"), (10, "0,0,9,0,0,0,1,")], vec![9]),
        ("state", vec![(9, "0,0,9,0,0,0,1,systole"), (10, "0,0,9,0,0,0,1,disabled")], vec![10]),
        ("quality", vec![(9, "0,0,9,0,0,0,1,0"), (10, "0,0,9,0,0,0,1,0.3")], vec![]),
        ("note", vec![(9, "0,0,9,0,0,0,1,lost in thought")], vec![]),
    ] {
        let recording = read(&poses_with(header, &lines)).unwrap();
        assert_eq!(lost(&recording), [&expected[..], &[47, 48, 49]].concat(), "{header}");
    }
    for (header, line, expected) in [
        (
            "status",
            "0,0,9,0,0,0,1,ERR42",
            "poses.csv: line 4: status: found \"ERR42\", expected OK, or MISSING",
        ),
        ("ok", "0,0,9,0,0,0,1,maybe", "poses.csv: line 4: ok: found \"maybe\", expected OK, or MISSING"),
        (
            "status",
            "0,0,9,0,0,0,1,3",
            "poses.csv: line 5: status: found 4 after 3, expected words such as OK",
        ),
    ] {
        let message =
            read(&poses_with(header, &[(9, line), (10, "0,0,9,0,0,0,1,4")])).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn contours_may_have_one_line_for_each_frame() {
    let folder = tempfile::tempdir().unwrap();
    let poses = "frame,x_mm,y_mm,z_mm,qx,qy,qz,qw\n3,0,0,0,0,0,0,1\n4,0,0,0,0,0,0,1\n";
    let read = |contours: &str| {
        write_csv(folder.path(), poses, contours, None);
        Recording::read(folder.path()).map_err(|e| e.to_string())
    };
    let long = read("frame,x_mm,y_mm\n3,1,2\n3,3,4\n3,,\n4,5,6\n4,7,8\n4,9,10\n").unwrap();
    for wide in [
        "frame,x0,y0,x1,y1,x2,y2\n3,1,2,3,4,,\n4,5,6,7,8,9,10\n",
        "frame,x_1,x_2,x_3,y_1,y_2,y_3\n3,1,3,NaN,2,4,NaN\n4,5,7,9,6,8,10\n",
        "y[0] (cm);x[0] (cm);y[1] (cm);x[1] (cm);y[2] (cm);x[2] (cm);frame\n,2;,1;,4;,3;;;3\n,6;,5;,8;,7;1;,9;4\n",
        "frame\tx2_mm\ty2_mm\tx10_mm\ty10_mm\tx11_mm\ty11_mm\n3\t1\t2\t3\t4\t\t\n4\t5\t6\t7\t8\t9\t10\n",
    ] {
        assert_eq!(difference(&long, &read(wide).unwrap(), 0.0), None, "{wide}");
    }
    for (contours, expected) in [
        (
            "frame,x0,y0,x1\n3,1,2,3\n",
            "contours.csv: columns: found 2 columns of x and 1 of y, expected as many of each",
        ),
        (
            "frame,x0,y0\n3,1,2\n3,1,2\n",
            "contours.csv: line 3: frame: found a second line for this frame, expected one",
        ),
        (
            "frame,x0,y0,x00,y1\n3,1,2,3,4\n",
            "contours.csv: x_mm: found two columns of one number, expected one of each",
        ),
        ("frame,x0,y0\n3,1,\n", "contours.csv: frame 3: contour: found (1, NaN) at point 0"),
        (
            "frame,x0,y0\n4,1,2\n5,1,2\n",
            "contours.csv: frame: found frames 4 to 5, expected 3 to 4 as in poses.csv: one counts from 0 and the \
             other from 1",
        ),
    ] {
        let message = read(contours).unwrap_err();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn frames_keep_the_numbers_of_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let contours: String =
        (0..5).map(|k| format!("{},1,{}\n", 3 * k + 7, if k == 4 { "inf" } else { "2" })).collect();
    let poses: String = (0..5).map(|k| format!("{},0,0,{k},0,0,0,1\n", 3 * k + 7)).collect();
    let contours = format!("frame,x_mm,y_mm\n{contours}");
    write_csv(folder.path(), &format!("frame,x_mm,y_mm,z_mm,qx,qy,qz,qw\n{poses}"), &contours, None);
    let message = Recording::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("contours.csv: frame 19: contour: found (1, inf) at point 0"), "{message}");

    write_csv(
        folder.path(),
        &format!("frame,x_mm,y_mm,z_mm,qx,qy,qz,qw\n{poses}"),
        &contours.replace("inf", "2"),
        None,
    );
    let mut recording = Recording::read(folder.path()).unwrap();
    assert_eq!((0..5).map(|k| recording.number(k)).collect::<Vec<_>>(), [7, 10, 13, 16, 19]);
    // In another order they cannot be written.
    recording.frames.swap(0, 1);
    for name in ["swapped.mat", "swapped"] {
        let path = folder.path().join(name);
        recording.write(&path).unwrap();
        assert!(Recording::read(&path).unwrap().frames.iter().all(|f| f.number.is_none()));
    }
}

#[test]
fn models_of_an_older_recording_do_not_stay_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec");
    let with_models =
        (0..).map(some_recording).find(|r| r.frames.iter().any(|f| f.cylinder.is_some())).unwrap();
    with_models.write(&path).unwrap();
    assert!(path.join("cylinders.csv").exists());
    let mut without = with_models;
    without.frames.iter_mut().for_each(|f| f.cylinder = None);
    without.write(&path).unwrap();
    assert_eq!(difference(&without, &Recording::read(&path).unwrap(), 1e-12), None);
}
