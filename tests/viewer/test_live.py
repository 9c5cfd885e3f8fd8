"""The page of `lumenmesh live --view`, in headless Chromium, with the command itself as its server.

LUMENMESH_COMMAND names the command; otherwise it is the one that `cargo build` makes.
"""

import json
import os
import re
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from test_viewer import absent, browser, keep, pixels, playwright, show, table, until, wall  # noqa: F401

COMMAND = Path(os.environ.get("LUMENMESH_COMMAND", Path(__file__).parents[2] / "target/debug/lumenmesh"))
if not COMMAND.exists():
    absent(f"{COMMAND}, which `cargo build` makes,")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "rec.ndjson"
    subprocess.run([COMMAND, "simulate", "--vessel", "aneurysm", "--steady", "-o", path.with_suffix(".mat")], check=True)
    subprocess.run([COMMAND, "import", "recording", path.with_suffix(".mat"), "-o", path], check=True)
    return path


@contextmanager
def live(*arguments, **options):
    """The running command and the address of its page."""
    process = subprocess.Popen(
        [COMMAND, "live", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )
    try:
        yield process, re.search(r"http://[^/]*/", process.stderr.readline())[0]
    finally:
        process.kill()
        process.communicate()


def test_a_vessel_grows_through_the_command(show, recording):
    lines = recording.read_text().splitlines(keepends=True)[:500]
    with live("-", "--view=0", "--hold", "--json", stdin=subprocess.PIPE) as (process, address):

        def send(start, end):
            process.stdin.writelines(lines[start:end])
            process.stdin.flush()

        tab = show(address)
        until(tab, "document.getElementById('status').textContent === 'live'")
        assert tab.locator("#empty").is_visible()
        keep(tab, "command_start")
        pictures, rings = [], []
        for start, end in [(0, 150), (150, 300), (300, len(lines))]:
            send(start, end)
            until(tab, f"lumenmesh.frames.list.length === {end}")
            pictures.append(pixels(tab))
            rings.append(tab.evaluate("lumenmesh.vessel.rings"))
            keep(tab, f"command_{end}")
        assert 0 < rings[0] < rings[1] <= rings[2]
        for one, other in zip(pictures, pictures[1:]):
            assert (np.abs(one - other).max(axis=-1) > 24).mean() > 0.01
        assert wall(pictures[-1]).mean() > 0.05
        assert table(tab, "frame-facts")["frame"] == str(len(lines) - 1)
        process.stdin.close()
        until(tab, "document.getElementById('status').textContent !== 'live'")
        assert "frames in" in tab.locator("body").inner_text()
        keep(tab, "command_end")
        # The page keeps what it has when the command ends.
        process.send_signal(signal.SIGINT)
        summary = json.loads(process.stdout.read())
        assert process.wait() == 0
        assert tab.evaluate("lumenmesh.vessel.rings") == rings[-1] == summary["rings"][-1]
        assert wall(pixels(tab)).mean() > 0.05


def test_the_final_mesh_takes_the_place_of_the_vessel(show, recording):
    arguments = ["--speed", "max", "--view=0", "--hold", "--finish", "--json"]
    path = recording.with_name("short.ndjson")
    path.write_text("".join(recording.read_text().splitlines(keepends=True)[:300]))
    with live(path, *arguments) as (process, address):
        tab = show(address)
        until(tab, "lumenmesh.vessel.count > 0 && !lumenmesh.vessel.isGrid")
        process.send_signal(signal.SIGINT)
        summary = json.loads(process.stdout.read())
        assert tab.evaluate("lumenmesh.vessel.count") == summary["nodes"]
        assert wall(pixels(tab)).mean() > 0.05
        keep(tab, "command_finished")
