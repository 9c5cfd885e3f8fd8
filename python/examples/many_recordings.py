"""Many recordings on many machines, with Dask: the error of each for several settings.

    python many_recordings.py FOLDER --truths TRUTHS -o study.csv                       # on this machine
    python many_recordings.py FOLDER --truths TRUTHS -o study.csv --scheduler tcp://head:8786

FOLDER has recordings NAME.mat, TRUTHS a wall NAME.vtp (or .stl, .ply) for each. Both folders must be seen by all machines.
A recording that cannot be reconstructed gives a line with the reason, and the others go on.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

from dask.distributed import Client, LocalCluster, as_completed

import lumenmesh as lm

ROUGHNESSES = [0.0625, 0.125, 0.25]
COLUMNS = ["recording", "roughness", "mean_mm", "nodes", "left_out", "failed"]


def measured(recording: Path, truth: Path, roughness: float) -> dict[str, Any]:
    """One task: it runs wherever a worker is free, on all threads that the worker has."""
    line: dict[str, Any] = {"recording": recording.name, "roughness": roughness}
    try:
        lumen = lm.reconstruct(lm.read(recording), backend="cpu", sweep={"roughness": roughness})
        error = lm.evaluate(lumen, truth)["mesh_to_truth"]
    except lm.Error as failed:
        return line | {"failed": str(failed)}
    left_out = len(lumen.report["screening"]["left_out"])
    return line | {"mean_mm": error["mean_mm"], "nodes": len(lumen.vertices), "left_out": left_out}


def truth_of(recording: Path, truths: Path) -> Path:
    found = [path for ending in (".vtp", ".stl", ".ply") if (path := truths / (recording.stem + ending)).exists()]
    if not found:
        raise SystemExit(f"{truths}: found no wall of {recording.name}, expected {recording.stem}.vtp, .stl or .ply")
    return found[0]


def study(client: Client, recordings: list[Path], truths: Path) -> list[dict[str, Any]]:
    """The lines in the order of recordings and settings, whichever comes first."""
    tasks = [(path, truth_of(path, truths), roughness) for path in recordings for roughness in ROUGHNESSES]
    futures = client.map(measured, *zip(*tasks))
    for done, future in enumerate(as_completed(futures), 1):
        line = future.result()
        print(f"{done} of {len(tasks)}: {line['recording']}: {line.get('failed') or line['mean_mm']}")
    return client.gather(futures)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--truths", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scheduler", help="address of a running scheduler; without it, workers on this machine")
    parser.add_argument("--workers", type=int, help="workers on this machine, one for each core unless given")
    arguments = parser.parse_args()
    recordings = sorted(arguments.folder.glob("*.mat"))
    if not recordings:
        raise SystemExit(f"{arguments.folder}: found no recording, expected NAME.mat")
    # lumenmesh uses threads of its own: one task at a time for each worker.
    cluster = arguments.scheduler or LocalCluster(n_workers=arguments.workers, threads_per_worker=1)
    with Client(cluster) as client:
        lines = study(client, recordings, arguments.truths)
    with arguments.output.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(lines)
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
