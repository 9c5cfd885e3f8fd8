"""The page that shows a vessel, in headless Chromium.

Needs Chromium and the Python packages playwright, numpy and pillow. Without them the tests are skipped, or fail where
LUMENMESH_REQUIRE_TOOLS is set. LUMENMESH_PICTURES names a folder for screenshots to look at.
"""

import io
import os
import re
import shutil
import time
from pathlib import Path

import pytest

REQUIRED = bool(os.environ.get("LUMENMESH_REQUIRE_TOOLS"))


def absent(what):
    return (
        pytest.fail(f"{what} is missing")
        if REQUIRED
        else pytest.skip(f"{what} is missing", allow_module_level=True)
    )


try:
    import numpy as np
    from PIL import Image
    from playwright.sync_api import sync_playwright
except ImportError as error:
    absent(f"Python package {error.name}")
CHROMIUM = os.environ.get("LUMENMESH_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
if CHROMIUM is None:
    absent("Chromium")

from server import page as html_of
from server import serving
from tube import Tube, measures, packed

FLAGS = [
    *(
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-quic",
    ),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
]


@pytest.fixture(scope="module")
def playwright():
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(playwright):
    started = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    yield started
    started.close()


@pytest.fixture
def show(browser, tmp_path):
    """Opens a vessel's page from a file, or an address. At the end: no errors, and no request to anywhere else."""
    opened = []

    def open_page(what, size=(1280, 800), scheme="light"):
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, accept_downloads=True
        )
        tab = context.new_page()
        found, asked = [], []
        tab.on(
            "console",
            lambda message: found.append(message.text) if message.type in ("error", "warning") else None,
        )
        tab.on("pageerror", lambda error: found.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        if isinstance(what, str):
            address = what
        else:
            path = tmp_path / f"page{len(opened)}.html"
            path.write_text(html_of(what))
            address = path.as_uri()
        opened.append((context, address, found, asked))
        tab.goto(address)
        until(tab, "Boolean(window.lumenmesh)")
        return tab

    yield open_page
    for context, address, found, asked in opened:
        context.close()
        assert not found
        origin = re.match(r"file:///|http://[^/]*/", address)[0]
        assert asked and all(url.startswith((origin, "blob:", "data:")) for url in asked), asked


def settle(tab):
    """Until all that is asked for is drawn."""
    tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def pixels(tab, selector="#scene"):
    """What is seen of an element, as h x w x 3."""
    settle(tab)
    image = np.array(Image.open(io.BytesIO(tab.locator(selector).screenshot())).convert("RGB")).astype(int)
    return image


def wall(image):
    """Where an image is not of the colour of its upper right corner."""
    return np.abs(image - image[2, -3]).max(axis=-1) > 24


def keep(tab, name):
    if folder := os.environ.get("LUMENMESH_PICTURES"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        tab.screenshot(path=Path(folder) / f"{name}.png")


def table(tab, identity):
    """A table of the page: name to text. Rows without a name are under the empty one."""
    rows = tab.locator(f"#{identity} tr").all()
    return {(row.locator("th").all_inner_texts() or [""])[0]: row.locator("td").inner_text() for row in rows}


def assert_measures(shown, expected):
    """What a table shows is what was computed, to half of its last digit and the rounding of f32."""
    for name, value in expected.items():
        number = float(shown[name].split()[0])
        assert abs(number - value) <= 0.005 + 1e-5 * value, (
            f"{name}: {shown[name]} is shown, {value} was computed"
        )


def until(tab, condition):
    """Waits for a condition and for what is drawn after it. Playwright's own waiting needs `eval`, which the page forbids."""
    end = time.monotonic() + 20.0
    while not tab.evaluate(condition):
        assert time.monotonic() < end, condition
        time.sleep(0.02)
    settle(tab)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_finished_page_shows_wall_legend_map_and_numbers(show, scheme):
    tube = Tube()
    frames = [tube.frame(k, time_s=k / 12.0) for k in range(0, 120, 2)]
    tab = show(tube.vessel(frames=frames), scheme=scheme)
    image = pixels(tab)
    assert wall(image).mean() > 0.08
    paper = image[2, -3]
    assert (paper > 240).all() if scheme == "light" else (paper < 40).all()
    assert tab.locator("#legend-title").inner_text() == "support (echoes)"
    assert tab.locator("#legend-ticks span").count() >= 3
    assert tab.locator("#legend-unsupported").is_visible()
    # What is not covered: the mouth of the branch.
    covered = tube.arrays["supported"].mean()
    assert table(tab, "facts")["nodes with echoes"] == f"{100 * covered:.0f} %"
    assert 0.9 < covered < 0.999
    assert pixels(tab, "#map").std() > 20
    assert tab.locator("#title").inner_text() == tab.title() == "bent tube"
    keep(tab, f"finished_{scheme}")


def test_nothing_lies_between_two_branches(show):
    tube = Tube()
    plain = wall(pixels(show(tube.vessel())))
    # The second half from its far end on: as another branch it looks the same, joined to the first it does not.
    order = np.r_[:60, 119:59:-1]
    tube.positions_mm = tube.positions_mm[order]
    tube.arrays = {name: values[order] for name, values in tube.arrays.items()}
    joined = wall(pixels(show(tube.vessel())))
    tube.arrays["branch"] = np.repeat(np.arange(120)[:, None] // 60, tube.nodes, axis=1)
    tab = show(tube.vessel())
    apart = wall(pixels(tab))
    keep(tab, "branches")
    assert np.mean(apart & ~plain) < 0.001 and np.mean(plain & ~apart) < 0.002
    assert np.mean(joined & ~plain) > 0.005
    # New rings of the first branch move the gap.
    assert tab.evaluate("[...lumenmesh.vessel.seams]") == [59]
    tab.evaluate("(change) => lumenmesh.take(change)", change_of(tube, 61))
    assert tab.evaluate("[...lumenmesh.vessel.seams]") == [60]


def change_of(tube, first_of_branch):
    """A ring more of the first branch: the rings behind it have other numbers."""
    order = np.r_[:60, 59, 60:120]
    tube.positions_mm = tube.positions_mm[order]
    tube.arrays = {name: values[order] for name, values in tube.arrays.items()}
    tube.arrays["branch"][:first_of_branch] = 0
    changed = [{"from": 60, "to": 121} | tube.part(60, 121)]
    return {"type": "change", "before": 0, "rings": 121, "changed": changed}


def test_a_click_measures_the_ring_there(show):
    tube = Tube()
    tab = show(tube.vessel())
    for ring in (20, 61, 100):
        # The node of that ring that is nearest to the eye.
        places = [tab.evaluate("(n) => lumenmesh.project(n)", ring * 48 + j) for j in range(48)]
        eye = tab.evaluate("lumenmesh.eye.place")
        origin = tube.positions_mm[0, 0]
        node = np.argmin(np.linalg.norm(tube.positions_mm[ring] - origin - eye, axis=1))
        tab.mouse.click(*places[node])
        shown = table(tab, "measured")
        assert shown["ring"] == f"{ring} of 120"
        assert shown["last seen in frame"] == str(2 * ring)
        assert_measures(shown, measures(tube.flat_mm[ring]))
        with pytest.raises(AssertionError):
            assert_measures(shown, measures(1.001 * tube.flat_mm[ring]))
    keep(tab, "measured")


def test_the_map_and_the_keys_measure_too(show):
    tube = Tube()
    tab = show(tube.vessel())
    box = tab.locator("#map").bounding_box()
    tab.mouse.click(box["x"] + box["width"] * 30.5 / 120, box["y"] + 10)
    shown = table(tab, "measured")
    assert shown["ring"] == "30 of 120"
    share = tube.arrays["supported"][30].mean()
    assert shown["outline with echoes"] == f"{100 * share:.0f} %" and share < 0.95
    assert "guess" in shown[""]
    tab.locator("#scene").focus()
    tab.keyboard.press("]")
    assert table(tab, "measured")["ring"] == "31 of 120"
    tab.keyboard.press("[")
    assert table(tab, "measured")["ring"] == "30 of 120"


@pytest.mark.parametrize("plane", ["frames", "axis"])
def test_a_click_cuts_a_mesh_without_rings(show, plane):
    """By the plane of a frame, or across the axis. Here both are the planes of rings."""
    tube = Tube(origin_mm=(4000.0, -900.0, 250.0))
    frames = [tube.frame(k) for k in range(1, 119)]
    more = {"frames": frames} if plane == "frames" else {"axis_mm": packed(tube.axis_mm)}
    tab = show(tube.mesh(**more))
    assert tab.locator("#unrolled").is_hidden()
    eye = tab.evaluate("lumenmesh.eye.place")
    origin = tab.evaluate("lumenmesh.vessel.origin")
    ring = 80
    node = ring * 48 + np.argmin(np.linalg.norm(tube.positions_mm[ring] - origin - eye, axis=1))
    tab.mouse.click(*tab.evaluate("(n) => lumenmesh.project(n)", int(node)))
    shown = table(tab, "measured")
    if plane == "frames":
        assert shown["frame"] == str(2 * ring)
    # The plane of ring k cuts the triangles a hair before or behind its nodes.
    expected = measures(tube.flat_mm[ring])
    for name, value in expected.items():
        assert abs(float(shown[name].split()[0]) - value) < 0.01 * value, (name, shown[name], value)
    keep(tab, f"mesh_{plane}")


def test_an_open_outline_is_not_measured(show):
    tube = Tube(rings=40)
    half = tube.triangles()
    # Without one side of the wall no outline is closed.
    half = half[(half % 48 < 30).all(axis=1)]
    tab = show(tube.mesh(frames=[tube.frame(k) for k in range(40)]) | {"triangles": packed(half, "<u4")})
    nodes = [20 * 48 + j for j in range(1, 29)]
    for node in nodes:
        tab.mouse.click(*tab.evaluate("(n) => lumenmesh.project(n)", node))
        if shown := table(tab, "measured"):
            break
    assert "open" in shown[""] and "area" not in shown


def test_a_vessel_grows(show):
    """What the page holds after every event is what was sent, also with rings in front, dropped, and sent anew."""
    tube = Tube(origin_mm=(50.0, 60.0, 70.0))
    with serving([{"type": "vessel", "title": "live", "nodes": 0, "rings": 0}]) as server:
        tab = show(server.url)
        until(tab, "document.getElementById('status').textContent === 'live'")
        assert tab.locator("#empty").is_visible() and tab.locator("#legend").is_hidden()
        keep(tab, "live_start")

        def holds(start, end):
            until(tab, f"lumenmesh.vessel.rings === {end - start}")
            held = tab.evaluate(
                "() => { const v = lumenmesh.vessel, n = v.count; return { origin: v.origin, positions:"
                " Array.from(v.positions.subarray(0, 3 * n)), support: Array.from(v.arrays.get('support').subarray(0, n)) } }"
            )
            world = np.array(held["positions"]).reshape(-1, 3) + held["origin"]
            expected = tube.positions_mm[start:end].reshape(-1, 3)
            return (
                np.abs(world - expected).max() < 2e-5
                and held["support"] == tube.arrays["support"][start:end].ravel().tolist()
            )

        def change(start, end, changed, before=0, frame=None):
            parts = [{"from": a - start, "to": b - start} | tube.part(a, b) for a, b in changed]
            event = {"type": "change", "before": before, "rings": end - start, "changed": parts}
            server.send(
                event | ({"frame": tube.frame(frame, time_s=frame / 12.0)} if frame is not None else {})
            )

        server.send(tube.vessel(40, 50, title="live"))
        assert holds(40, 50)
        seen = [wall(pixels(tab)).mean()]
        # Growth at the end, some rings changed twice; in front; at both ends; fewer; the same again.
        change(40, 60, [(48, 60)], frame=58)
        assert holds(40, 60)
        change(30, 60, [(30, 41)], before=10, frame=31)
        assert holds(30, 60)
        keep(tab, "live_middle")
        seen.append(pixels(tab))
        change(28, 75, [(28, 30), (59, 75)], before=2)
        assert holds(28, 75)
        change(28, 70, [])
        assert holds(28, 70)
        change(0, 120, [(0, 28), (70, 120)], before=28, frame=118)
        assert holds(0, 120)
        keep(tab, "live_end")
        assert np.abs(pixels(tab) - seen[1]).max() > 100
        shown = table(tab, "frame-facts")
        assert shown["frame"] == "236" and shown["echoes"] == "47 of 48"
        # A page that changes what it does not understand would now differ.
        assert tab.locator("#alerts p").count() == 0

        # A connection that is lost: the page comes back and begins with all of the vessel.
        server.first = [tube.vessel(10, 90, title="again")]
        before = server.connections
        server.interrupt()
        assert holds(10, 90)
        assert server.connections == before + 1
        server.send({"type": "end", "text": "90 frames."})
        until(tab, "document.getElementById('status').textContent.includes('90 frames.')")
        time.sleep(0.4)
        assert server.connections == before + 1, "after the end the page does not connect again"


def test_the_comparison_of_a_grown_vessel_finds_a_wrong_ring(show):
    tube = Tube(rings=30)
    tab = show(tube.vessel())
    held = np.array(tab.evaluate("Array.from(lumenmesh.vessel.positions)")).reshape(-1, 3) + tab.evaluate(
        "lumenmesh.vessel.origin"
    )
    assert np.abs(held - tube.positions_mm.reshape(-1, 3)).max() < 2e-5
    assert np.abs(held - np.roll(tube.positions_mm, 1, axis=0).reshape(-1, 3)).max() > 1.0


def test_what_no_echo_supports_has_no_colour_of_measured_wall(show):
    tube = Tube()
    for hidden in (False, True):
        for unsupported in (
            {"supported": packed(np.zeros((120, 48)))},
            {"support": packed(np.zeros((120, 48)))},
        ):
            vessel = tube.vessel()
            vessel["arrays"] = vessel["arrays"] | unsupported
            if "supported" not in unsupported:
                # Without flags, nodes without echoes are not supported.
                del vessel["arrays"]["supported"]
            tab = show(vessel)
            if hidden:
                tab.keyboard.press("u")
            image = pixels(tab)[2:400]
            assert wall(image).any() != hidden
            # Grey: its components are equal.
            assert (image.max(axis=-1) - image.min(axis=-1))[wall(image)].max(initial=0) < 10
            tab.close()
    # The comparison sees the colours of measured wall.
    image = pixels(show(tube.vessel()))[2:400]
    assert (image.max(axis=-1) - image.min(axis=-1))[wall(image)].max() > 60


def test_a_catheter_that_is_too_fast_is_warned_of(show):
    tube = Tube(rings=200)
    ring_mm = 0.5 * np.pi * 120.0 / 199
    slow, fast = range(10, 60, 2), range(60, 120, 6)
    at = [*slow, *fast]
    frames = [tube.frame(k, number=i, time_s=i / 20.0) for i, k in enumerate(at)]
    tab = show(tube.vessel(frames=[]))
    assert tab.locator("#frame-section").is_hidden()
    # 2 rings per frame are as much as leaves no ring without echoes; rounding must not decide.
    tab = show(tube.vessel(frames=frames, max_frame_distance_mm=2.5 * ring_mm))
    warning = tab.locator("#speed-warning")
    assert warning.is_visible()
    assert "9 frames so far" in warning.inner_text()
    shown = table(tab, "frame-facts")
    assert float(shown["speed along the axis"].split()[0]) == pytest.approx(6 * ring_mm * 20.0, abs=0.06)
    assert float(shown["limit at this frame rate"].split()[0]) == pytest.approx(2.5 * ring_mm * 20.0, abs=0.06)
    keep(tab, "too_fast")
    tab = show(tube.vessel(frames=frames[: len(slow)], max_frame_distance_mm=2.5 * ring_mm))
    assert tab.locator("#speed-warning").is_hidden()
    # The limit without one that is sent: twice the distance of two rings' middles, which lie a little off the
    # axis.
    tab = show(tube.vessel(frames=[tube.frame(k) for k in range(0, 200, 3)]))
    assert tab.evaluate("lumenmesh.frames.frame.limit") == pytest.approx(2.0 * ring_mm, rel=0.01)
    assert "66 frames so far" in tab.locator("#speed-warning").inner_text()


def test_frames_that_are_not_used_say_why(show):
    tube = Tube()
    lost = {"number": 7, "left_out": "the sensor is lost"}
    tab = show(tube.vessel(frames=[tube.frame(3), lost]))
    assert "the sensor is lost" in table(tab, "frame-facts")[""]
    tab.keyboard.press("j")
    assert table(tab, "frame-facts")["frame"] == "6"


def test_every_key_does_what_the_help_says(show):
    tube = Tube()
    tab = show(tube.vessel(frames=[tube.frame(k) for k in (4, 60)]))
    tab.locator("#scene").focus()

    def changes(key):
        before = pixels(tab)
        tab.keyboard.press(key)
        return np.abs(pixels(tab) - before).max() > 24

    for key in ("ArrowLeft", "ArrowUp", "Shift+ArrowRight", "+", "-", "0", "u", "u", "j", "f", "ArrowUp", "f"):
        assert changes(key), key
    tab.keyboard.press("0")
    names = tab.locator("#quantity option").all_inner_texts()
    assert len(names) == 5 and "radius" in names
    for name in names[1:]:
        assert changes("c"), name
        assert tab.locator("#legend-title").inner_text().startswith(name)
    assert tab.evaluate("lumenmesh.quantity") == "frame"
    tab.keyboard.press("C")
    for kind in ("view", "x", "y", "z", "axis", "none"):
        tab.keyboard.press("x")
        assert tab.locator("#clip").input_value() == kind
        if kind == "x":
            assert changes("."), "the clip plane moves"
            keep(tab, "clipped")
    tab.keyboard.press("f")
    keep(tab, "flight")
    tab.keyboard.press(" ")
    until(tab, "lumenmesh.eye.flight.share > 0.03")
    tab.keyboard.press(" ")
    tab.keyboard.press("f")
    assert changes("c")
    with tab.expect_download() as download:
        tab.keyboard.press("s")
    image = np.array(Image.open(download.value.path()).convert("RGB")).astype(int)
    assert download.value.suggested_filename == "bent_tube.png"
    assert wall(image).mean() > 0.05
    if folder := os.environ.get("LUMENMESH_PICTURES"):
        shutil.copy(download.value.path(), Path(folder) / "saved.png")
    # A key that nothing is bound to does nothing.
    assert not changes("q")
    tab.keyboard.press("?")
    assert tab.locator("#help").is_visible()
    keep(tab, "help")
    tab.keyboard.press("Escape")
    assert tab.locator("#help").is_hidden()


def test_mouse_and_wheel_move_the_eye(show):
    tube = Tube()
    tab = show(tube.vessel())
    box = tab.locator("#scene").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    place = tab.evaluate("lumenmesh.eye.place")
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 60, y + 20, steps=4)
    tab.mouse.up()
    turned = tab.evaluate("lumenmesh.eye.place")
    assert np.linalg.norm(np.subtract(turned, place)) > 5.0
    assert tab.evaluate("lumenmesh.measured") is None, "a drag is no click"
    tab.mouse.wheel(0, -240)
    settle(tab)
    assert tab.evaluate("lumenmesh.eye.distance") < np.linalg.norm(
        np.subtract(place, tab.evaluate("lumenmesh.eye.target"))
    )
    target = tab.evaluate("lumenmesh.eye.target")
    tab.mouse.down(button="right")
    tab.mouse.move(x, y + 50, steps=3)
    tab.mouse.up(button="right")
    assert np.linalg.norm(np.subtract(tab.evaluate("lumenmesh.eye.target"), target)) > 1.0


def test_a_range_of_colours_can_be_set(show):
    tab = show(Tube().vessel())
    automatic = tab.evaluate("lumenmesh.range")
    tab.locator("#low").fill("2")
    tab.locator("#high").fill("8")
    tab.locator("#high").press("Enter")
    assert tab.evaluate("lumenmesh.range") == [2, 8]
    tab.locator("#high").fill("1")
    tab.locator("#high").press("Enter")
    assert "lower and a higher" in tab.locator("#alerts").inner_text()
    tab.locator("#range-auto").click()
    assert tab.evaluate("lumenmesh.range") == automatic


FAULTS = {
    "a ring too many": lambda v: v | {"rings": v["rings"] + 1},
    "not base64": lambda v: v | {"positions_mm": "%%%"},
    "no positions": lambda v: v | {"positions_mm": 7},
    "an array too short": lambda v: v | {"arrays": {"support": packed([1.0])}},
    "a negative number": lambda v: v | {"nodes": -1},
    "a pose of 11 numbers": lambda v: v | {"frames": [{"number": 1, "world_from_probe": [0.0] * 11}]},
    "a triangle of no node": lambda v: v | {"triangles": packed([0, 1, 10**6], "<u4")},
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_does_not_fit_is_said_and_not_shown(show, fault):
    tab = show(FAULTS[fault](Tube(rings=20).vessel()))
    text = tab.locator("#alerts").inner_text()
    assert "cannot be shown" in text and ("expected" in text or "base64" in text), text
    assert tab.evaluate("lumenmesh.vessel.count") == 0


def test_a_faulty_change_leaves_the_vessel_and_the_page_asks_for_all_of_it(show):
    tube = Tube(rings=40)
    with serving([tube.vessel(0, 20)]) as server:
        tab = show(server.url)
        until(tab, "lumenmesh.vessel.rings === 20")
        connections = server.connections
        server.first = [tube.vessel(0, 30)]
        server.send({"type": "change", "rings": 25, "changed": [{"from": 20, "to": 25} | tube.part(20, 24)]})
        until(tab, "document.getElementById('alerts').textContent.includes('cannot be shown')")
        assert tab.evaluate("lumenmesh.vessel.rings") == 20
        until(tab, "lumenmesh.vessel.rings === 30")
        assert server.connections == connections + 1
        tab.close()


def test_messages_are_text(show):
    tube = Tube(rings=30)
    title = "</script><img src=x onerror=alert(1)>"
    with serving([tube.vessel(title=title)]) as server:
        tab = show(server.url)
        until(tab, "lumenmesh.vessel.rings === 30")
        server.send({"type": "message", "text": "<b>lost</b>"})
        server.send({"type": "something new"})
        until(tab, "document.getElementById('alerts').textContent.includes('<b>lost</b>')")
        tab.close()
    tab = show(tube.vessel(title=title))
    assert tab.title() == title and tab.locator("img").count() == 0
    assert tab.evaluate("lumenmesh.vessel.rings") == 30


def test_a_mesh_without_any_array_is_shown_plain(show):
    tube = Tube(rings=30)
    tab = show(
        {
            "type": "vessel",
            "title": "wall.stl",
            "triangles": packed(tube.triangles(), "<u4"),
            "positions_mm": packed(tube.positions_mm),
        }
    )
    assert wall(pixels(tab)).mean() > 0.05
    assert tab.locator("#legend").is_hidden()
    assert table(tab, "facts")["triangles"] == str(len(tube.triangles()))
    assert tab.locator("#fly").is_disabled()
    tab.mouse.click(*tab.evaluate("lumenmesh.project(15 * 48 + 36)"))
    assert "no plane to cut by" in table(tab, "measured")[""]


@pytest.mark.parametrize("size", [(390, 780), (700, 500), (1920, 1080)])
def test_nothing_is_cut_off_in_any_window(show, size):
    tube = Tube()
    frames = [tube.frame(k, time_s=k / 12.0) for k in range(0, 120, 8)]
    tab = show(tube.vessel(frames=frames), size=size)
    assert wall(pixels(tab)).mean() > 0.03
    assert tab.evaluate("document.documentElement.scrollWidth") <= size[0]
    box, stage = tab.locator("#legend").bounding_box(), tab.locator("#stage").bounding_box()
    assert box["y"] >= stage["y"] and box["x"] + box["width"] <= stage["x"] + stage["width"]
    keep(tab, f"window_{size[0]}")


def test_every_control_has_a_name(show):
    tube = Tube()
    tab = show(tube.vessel(frames=[tube.frame(4), tube.frame(6)]))
    nameless = tab.evaluate(
        "() => [...document.querySelectorAll('button, select, input, canvas, dialog')].filter((one) => !(one.ariaLabel ||"
        " one.getAttribute('aria-label') || one.getAttribute('aria-labelledby') || one.labels?.length ||"
        " one.textContent.trim())).map((one) => one.outerHTML)"
    )
    assert nameless == []


def test_without_webgl_the_page_says_so_and_still_has_numbers(playwright, tmp_path):
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-3d-apis"])
    tab = browser.new_page()
    errors = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    (tmp_path / "page.html").write_text(html_of(Tube().vessel()))
    tab.goto((tmp_path / "page.html").as_uri())
    assert "no WebGL 2" in tab.locator("#empty").inner_text() and tab.locator("#empty").is_visible()
    assert pixels(tab, "#map").std() > 20
    tab.keyboard.press("]")
    assert "area" in table(tab, "measured")
    assert errors == []
    browser.close()


def test_a_page_within_a_page(browser, tmp_path):
    """As a report embeds it."""
    inner = html_of(Tube().vessel()).replace("&", "&amp;").replace('"', "&quot;")
    (tmp_path / "report.html").write_text(
        f'<!DOCTYPE html><title>r</title><iframe title="vessel" style="width: 900px; height: 600px" srcdoc="{inner}"></iframe>'
    )
    tab = browser.new_page(viewport={"width": 1000, "height": 700})
    errors = []
    tab.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto((tmp_path / "report.html").as_uri())
    frame = tab.frames[1]
    until(frame, "window.lumenmesh?.vessel.rings === 120")
    assert wall(pixels(tab, "iframe")).mean() > 0.05
    keep(tab, "within_a_report")
    assert errors == []
    tab.close()


def test_frame_time_at_50000_nodes(show):
    """Measured, not judged: the software renderer of this machine stands for no graphics card."""
    tube = Tube(rings=400, nodes=128)
    tab = show(tube.vessel())
    mean_ms = tab.evaluate("lumenmesh.frameTime(10)")
    size = tab.evaluate("[document.getElementById('scene').width, document.getElementById('scene').height]")
    # A frame that changes 12 rings, as it comes from the server; then without what is drawn after it.
    change = {"type": "change", "rings": 400, "changed": [{"from": 200, "to": 212} | tube.part(200, 212)]}
    change["frame"] = tube.frame(206, time_s=0.0)
    work_ms = tab.evaluate(
        "(change) => { const start = performance.now(); for (let i = 0; i < 20; i += 1) { lumenmesh.take(change); lumenmesh.refresh(); }"
        " return (performance.now() - start) / 20; }",
        change,
    )
    print(
        f"\n{400 * 128} nodes, {2 * 399 * 128} triangles at {size[0]}x{size[1]}: {mean_ms:.1f} ms to draw on SwiftShader,"
        f" {work_ms:.1f} ms for a change of 12 rings"
    )
    assert mean_ms > 0.0 and work_ms > 0.0
