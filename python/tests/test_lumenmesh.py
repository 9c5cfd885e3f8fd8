"""The installed wheel, as a user has it."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import lumenmesh as lm
import numpy as np
import pytest


@pytest.fixture(scope="module")
def simulated():
    return lm.simulate("stenosis", seed=3, steady=True)


def test_it_is_the_installed_package():
    assert "site-packages" in lm.__file__
    assert lm.__version__.count(".") == 2


def test_a_recording_becomes_a_lumen(simulated, tmp_path):
    recording, truth = simulated
    stages = []
    lumen = lm.reconstruct(recording, backend="cpu", progress=lambda *step: stages.append(step))
    assert stages and stages[-1][1] <= stages[-1][2]
    assert lumen.vertices.dtype == np.float64 and lumen.vertices.shape[1] == 3
    assert lumen.faces.dtype == np.int32 and lumen.faces.max() < len(lumen.vertices)
    assert {"support", "standard_error_mm"} <= set(lumen.point_data)
    assert lumen.report["settings"]["method"] == "sweep" and lumen.report["screening"]["left_out"] == []
    error_mm = lm.evaluate(lumen, truth)["mesh_to_truth"]["mean_mm"]
    assert 0 < error_mm < 0.3
    assert "vertices" in repr(lumen) and "frames" in repr(recording)
    assert lumen._repr_html_().startswith('<img src="data:image/png;base64,iVBOR')
    # Files and objects hold the same.
    lumen.save(tmp_path / "lps.ply", space="lps")
    assert np.array_equal(lm.read_mesh(tmp_path / "lps.ply").vertices, lumen.vertices)
    recording.save(tmp_path / "recording.mat")
    again = lm.read(tmp_path / "recording.mat")
    lumen.save(tmp_path / "lumen.vtp")
    lm.reconstruct(again, backend="cpu").save(tmp_path / "again.vtp")
    assert (tmp_path / "lumen.vtp").read_bytes() == (tmp_path / "again.vtp").read_bytes()
    truth.save(tmp_path / "truth.stl")
    assert lm.evaluate(tmp_path / "lumen.vtp", tmp_path / "truth.stl")["mesh_to_truth"]["mean_mm"] == pytest.approx(
        error_mm, abs=1e-5
    )


def test_arrays_of_any_real_type_and_layout_are_taken(simulated):
    recording, _ = simulated
    poses, contours, time = recording.poses, recording.contours, recording.time
    rays = max(map(len, contours))
    square = np.full((len(contours), rays, 2), np.nan)
    for k, contour in enumerate(contours):
        square[k, : len(contour)] = contour
    plain = lm.Recording(poses, contours, time)
    wide = np.zeros((len(poses), 8, 4))
    wide[:, ::2] = poses
    for other in [
        lm.Recording(np.asfortranarray(poses), square, time),
        lm.Recording(wide[:, ::2], [c[::-1][::-1] for c in contours], list(time)),
        lm.Recording(poses.tolist(), [c.tolist() for c in contours], time),
    ]:
        assert np.array_equal(other.poses, plain.poses) and len(other) == len(plain)
        for a, b in zip(other.contours, plain.contours):
            assert np.array_equal(a[: len(b)], b, equal_nan=True)
    single = lm.Recording(poses.astype(np.float32), [c.astype(np.float32) for c in contours])
    assert single.time is None and np.allclose(single.poses, poses, atol=1e-4)
    whole = lm.Recording(np.eye(4, dtype=int)[None], [np.array([[1, 0], [0, 1], [-1, 0]])])
    assert whole.contours[0].dtype == np.float64


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: lm.Recording(np.eye(4), [[]]), r"poses: found shape \(4, 4\), expected \(F, 4, 4\)"),
        (lambda: lm.Recording(np.eye(4)[None], []), "contours: found 0, expected 1, one for each pose"),
        (lambda: lm.Recording(np.eye(4)[None], [np.zeros((3, 3))]), r"frame 0: found shape \(3, 3\), expected \(M, 2\)"),
        (lambda: lm.Recording(np.eye(4)[None] * 1j, [[]]), "poses: found an array of complex128, expected real numbers"),
        (lambda: lm.Recording(np.array([["a"] * 4] * 4)[None], [[]]), "expected real numbers"),
        (lambda: lm.Recording(2 * np.eye(4)[None], [[]]), "frame 0: pose: found a matrix whose last row"),
        (lambda: lm.Recording(np.eye(4)[None], [[]], time=[0.0, 1.0]), r"time: found shape \(2,\), expected \(1,\)"),
        (lambda: lm.read("no.mat"), "no.mat: cannot read"),
        (lambda: lm.Mesh(np.zeros((2, 3)), [[0, 1, 2]]), "faces: row 0: found 2, expected a vertex from 0 to 1"),
        (lambda: lm.Mesh(np.zeros((3, 3)), [[0, 1, 1.5]]), "faces: found fractions"),
        (lambda: lm.Mesh(np.zeros((3, 3)), [[0, 1, 2]], {"a": [1.0]}), r"point_data\['a'\]: found shape \(1,\)"),
        (lambda: lm.Live(method="tube"), "setting method: found \"tube\", expected `sweep` or `cylinders`"),
        (lambda: lm.Live(node=3), "setting node: found no setting of that name"),
        (lambda: lm.Live(nodes=2), "setting nodes: found 2, expected at least 3"),
        (lambda: lm.Live(sweep={"nodes": "many"}), "setting sweep.nodes: found"),
        (lambda: lm.Live(gate=[0, float("nan")]), "setting gate: found"),
        (lambda: lm.Live().part(-1, 3), "part: found rings -1 to 3"),
        (lambda: lm.reconstruct(lm.Recording(np.empty((0, 4, 4)), [])), "expected"),
        (lambda: lm.simulate("teapot"), "teapot"),
    ],
)
def test_wrong_input_raises_in_the_words_of_the_command_line(make, message):
    with pytest.raises(lm.Error, match=message) as raised:
        make()
    assert isinstance(raised.value, ValueError)


def test_left_handed_and_lost_poses_are_left_out_and_told(simulated):
    recording, _ = simulated
    poses = recording.poses
    poses[5] = np.nan
    poses[7, :3, 0] *= -1
    lumen = lm.reconstruct(lm.Recording(poses, recording.contours), backend="cpu")
    assert [one["frame"] for one in lumen.report["screening"]["left_out"]] == [5, 7]
    with pytest.raises(lm.Error, match="frame 5"):
        lm.reconstruct(lm.Recording(poses, recording.contours), unfit_frames="refuse")


def test_live_grows_and_tells_what_changed(simulated):
    recording, truth = simulated
    live = lm.Live(sweep={"keep_unsupported": True})
    followed: list[np.ndarray] = []

    def follow(change: lm.Change) -> None:
        followed[:0] = [np.empty(0)] * change.before
        del followed[change.rings :]
        followed.extend([np.empty(0)] * (change.rings - len(followed)))
        for first, end in change.changed:
            part = live.part(first, end).vertices.reshape(end - first, live.nodes, 3)
            followed[first:end] = list(part)

    for pose, contour, time in zip(recording.poses, recording.contours, recording.time):
        change = live.push(pose, contour, time)
        follow(change)
    times = change.times
    parts = [times.screening_s, times.axis_s, times.placing_s, times.solving_s]
    assert min(parts) >= 0 and 0 < sum(parts) <= times.total_s
    assert change.frame == len(recording) - 1
    flushed = live.flush()
    assert flushed.left_out == []
    follow(flushed)
    # Rings that did not change keep the noise of their time, which the radii are corrected for.
    assert np.allclose(np.concatenate(followed), live.surface().vertices, atol=0.02)
    assert lm.evaluate(live.surface(), truth)["mesh_to_truth"]["median_mm"] < 0.3
    with pytest.raises(lm.Error, match="pose: found shape"):
        live.push(np.eye(3), recording.contours[0])
    assert live.engine["name"] == "cpu" and live.branches == 1
    assert not live.surface().point_data["branch"].any()
    live.reset()
    assert len(live) == 0 and live.rings == 0 and "0 frames" in repr(live)


def test_a_live_vessel_goes_on_from_a_file_and_is_finished(simulated, tmp_path):
    recording, _ = simulated
    frames = list(zip(recording.poses, recording.contours, recording.time))
    whole, half = lm.Live(keep_frames=True, backend="cpu"), lm.Live(keep_frames=True, backend="cpu")
    changes = [whole.push(*frame) for frame in frames]
    for frame in frames[: len(frames) // 2]:
        half.push(*frame)
    half.snapshot(tmp_path / "live.state")
    again = lm.Live.restore(tmp_path / "live.state")
    assert len(again) == len(half)
    assert [again.push(*frame) for frame in frames[len(half) :]] == changes[len(half) :]
    assert np.array_equal(again.surface().vertices, whole.surface().vertices)
    assert not np.array_equal(half.surface().vertices.shape, whole.surface().vertices.shape)
    assert np.array_equal(again.finish().vertices, lm.reconstruct(recording, backend="cpu").vertices)
    live = lm.Live()
    live.push(*frames[0])
    with pytest.raises(lm.Error, match="found 1 that were not kept"):
        live.finish()
    (tmp_path / "live.state").write_bytes((tmp_path / "live.state").read_bytes()[:-1])
    with pytest.raises(lm.Error, match="live.state: content: found .* the file is not whole"):
        lm.Live.restore(tmp_path / "live.state")


def test_what_the_callback_raises_is_raised(simulated):
    for method in ("sweep", "cylinders"):
        steps = []

        def stop(*step):
            steps.append(step)
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            lm.reconstruct(simulated[0], progress=stop, method=method, backend="cpu")
        assert len(steps) == 1


def test_ctrl_c_ends_a_computation(simulated):
    # A shell's background jobs ignore the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    stages: list[str] = []

    def follow(stage, done, total):
        stages.append(stage)
        os.kill(os.getpid(), signal.SIGINT)
        # Longer than signals wait at most.
        time.sleep(0.3)

    try:
        with pytest.raises(KeyboardInterrupt):
            lm.reconstruct(simulated[0], progress=follow, backend="cpu")
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(stages) == 1


def test_threads_take_turns_with_a_live_vessel(simulated):
    frames = list(zip(simulated[0].poses, simulated[0].contours))
    live = lm.Live(sweep={"keep_unsupported": True}, method="cylinders")

    def push():
        for frame in frames[:60]:
            live.push(*frame)

    threads = [threading.Thread(target=push) for _ in range(3)]
    for thread in threads:
        thread.start()
    # The frames come in whatever order the threads push them, so that only their number is sure to grow.
    seen = []
    for _ in range(50):
        assert live.surface() is not None
        seen.append(len(live))
    for thread in threads:
        thread.join()
    assert len(live) == 180 and seen == sorted(seen)


def test_other_threads_run_meanwhile(simulated):
    counted, done = 0, threading.Event()

    def work():
        lm.reconstruct(simulated[0], backend="cpu")
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    while not done.wait(0.001):
        counted += 1
    thread.join()
    assert counted > 2


def test_phases_of_a_cycle_are_kept(simulated, tmp_path):
    recording, _ = simulated
    assert recording.phase is None
    phase = np.arange(len(recording)) * 0.1
    phase[3] = np.nan
    phased = lm.Recording(recording.poses, recording.contours, recording.time, phase=phase)
    phased.save(tmp_path / "phased.mat")
    for copy in (phased, pickle.loads(pickle.dumps(phased)), lm.read(tmp_path / "phased.mat")):
        assert np.array_equal(copy.phase, phase, equal_nan=True)
    with pytest.raises(lm.Error, match="phase"):
        lm.Recording(recording.poses, recording.contours, phase=phase[1:])


def test_objects_can_be_pickled(simulated):
    recording, truth = simulated
    copy = pickle.loads(pickle.dumps(recording))
    assert np.array_equal(copy.poses, recording.poses) and np.array_equal(copy.time, recording.time)
    lumen = lm.reconstruct(recording, backend="cpu")
    again = pickle.loads(pickle.dumps(lumen))
    assert again.report == lumen.report and np.array_equal(again.vertices, lumen.vertices)
    assert np.array_equal(pickle.loads(pickle.dumps(truth)).faces, truth.faces)


def test_pyvista_and_trimesh(simulated):
    lumen = lm.reconstruct(simulated[0], backend="cpu")
    pyvista = pytest.importorskip("pyvista")
    mesh = lumen.to_pyvista()
    assert isinstance(mesh, pyvista.PolyData) and mesh.n_cells == len(lumen.faces)
    assert np.array_equal(mesh.point_data["support"], lumen.point_data["support"])
    pytest.importorskip("trimesh")
    assert np.array_equal(lumen.to_trimesh().vertices, lumen.vertices)


def test_a_million_pushes_hold_no_memory():
    """Of a catheter at rest; a thousandth of them, for the time that it takes."""
    import resource

    live, pose = lm.Live(), np.eye(4)
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    random = np.random.default_rng(1)

    def rest(frames):
        for k in range(frames):
            pose[2, 3] = 10 * np.sin(k / 40)
            contour = 8 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + random.normal(0, 0.1, (60, 2))
            live.push(pose + 0, contour)
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    before = rest(500)
    assert rest(1000) < before + 20_000


def test_the_module_s_example_runs():
    code = "import doctest, lumenmesh; raise SystemExit(doctest.testmod(lumenmesh).failed)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
