"""The example with Dask, on workers of this machine."""

import csv
import importlib.util
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import lumenmesh as lm

EXAMPLE = Path(__file__).parents[1] / "examples" / "many_recordings.py"


def has_dask():
    """Whether Dask is there; without it, and unless tools are required, its test is skipped."""
    there = importlib.util.find_spec("distributed") is not None
    assert there or os.environ.get("LUMENMESH_REQUIRE_TOOLS") != "1", "dask distributed is missing"
    if not there:
        warnings.warn("SKIPPED: no dask distributed")
    return there


@pytest.mark.skipif(not has_dask(), reason="no dask distributed")
def test_many_recordings_on_a_local_cluster(tmp_path):
    recordings, truths = tmp_path / "recordings", tmp_path / "truths"
    recordings.mkdir(), truths.mkdir()
    for seed, vessel in [(1, "cylinder"), (2, "stenosis")]:
        recording, wall = lm.simulate(vessel, seed=seed, steady=True)
        recording.save(recordings / f"{vessel}.mat")
        wall.save(truths / f"{vessel}.vtp")
    (recordings / "broken.mat").write_bytes(b"no recording")
    wall.save(truths / "broken.vtp")
    table = tmp_path / "study.csv"
    command = [sys.executable, EXAMPLE, recordings, "--truths", truths, "-o", table, "--workers", "2"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    with table.open() as file:
        lines = list(csv.DictReader(file))
    assert [line["recording"] for line in lines] == [f"{n}.mat" for n in ("broken", "cylinder", "stenosis") for _ in "123"]
    assert all("broken.mat" in line["failed"] and not line["mean_mm"] for line in lines[:3])
    # A worker gives what this process gives.
    for line in lines[3:]:
        lumen = lm.reconstruct(
            lm.read(recordings / line["recording"]), backend="cpu", sweep={"roughness": float(line["roughness"])}
        )
        error = lm.evaluate(lumen, truths / line["recording"].replace(".mat", ".vtp"))
        assert float(line["mean_mm"]) == error["mesh_to_truth"]["mean_mm"] and not line["failed"]
    assert len({line["mean_mm"] for line in lines[3:]}) == 6


def test_a_recording_without_a_wall_is_told(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "a.mat").write_bytes(b"")
    command = [sys.executable, EXAMPLE, tmp_path, "--truths", tmp_path, "-o", tmp_path / "study.csv", "--workers", "1"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)
    assert done.returncode != 0 and "found no wall of a.mat" in done.stderr
    assert not (tmp_path / "study.csv").exists()
