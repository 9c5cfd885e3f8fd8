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
        process.wait()


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


def test_a_report_has_the_vessel_to_turn_and_prints_a_picture(browser, recording, tmp_path):
    report = tmp_path / "report.html"
    subprocess.run([COMMAND, "report", recording, "-o", report], check=True, stdout=subprocess.DEVNULL)
    assert report.stat().st_size < 3_000_000
    tab = browser.new_page(viewport={"width": 1100, "height": 800})
    errors = []
    tab.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(report.as_uri())
    tab.locator("iframe").scroll_into_view_if_needed()
    until(tab, "document.querySelectorAll('iframe').length === 1")
    until(tab, "true")
    frame = tab.frames[1]
    until(frame, "window.lumenmesh?.vessel.count > 0")
    assert frame.evaluate("lumenmesh.frames.list.length") == len(recording.read_text().splitlines())
    assert frame.locator("#title").inner_text() == "The vessel"
    assert wall(pixels(tab, "iframe")).mean() > 0.03
    keep(tab, "report_screen")
    pictures = tab.locator("figure img")
    assert pictures.count() >= 1 and tab.locator("iframe").is_visible()
    tab.emulate_media(media="print")
    assert pictures.first.is_visible() and tab.locator("iframe").is_hidden()
    keep(tab, "report_print")
    assert errors == []
    tab.close()
