"""The programs on the pages for hosts run as they stand there. Rust's are tested by `cargo test --doc`.

What a page leaves to the host (a robot that gives frames, a view that shows them) is defined here. LUMENMESH
names the command; the C library lies in `deps` beside it.
"""

import os
import re
import shutil
import subprocess

import pytest
from pages import COMMAND, ROOT, absent, blocks

HOSTS = ROOT / "docs/hosts"


def programs(page, language):
    """The page's blocks in a language."""
    return [
        block.text for block in blocks((HOSTS / page).read_text(encoding="utf-8")) if block.language == language
    ]


def tool(name):
    if shutil.which(name) is None:
        absent(name, "LUMENMESH_REQUIRE_TOOLS")
    return name


def run(*command, **how):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **how)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


class View:
    """Whoever shows the vessel: what was updated, by the number of its first vertex."""

    def __init__(self):
        self.parts = []

    def update(self, first, vertices, errors):
        assert vertices.shape == (len(errors), 3) and len(errors) > 0
        self.parts.append((first, len(errors)))


@pytest.fixture
def python_host(tmp_path, monkeypatch):
    """The names that the Python page takes for granted, and the calls of `plot`, which would open a window."""
    try:
        import lumenmesh as lm
        import pyvista
    except ImportError as error:
        absent(f"the Python package {error.name}", "LUMENMESH_REQUIRE_TOOLS")
    monkeypatch.chdir(tmp_path)
    plotted = []
    monkeypatch.setattr(
        pyvista.PolyData, "plot", lambda mesh, scalars: plotted.append(mesh.point_data[scalars])
    )
    recording, truth = lm.simulate("stenosis", seed=3, steady=True)
    truth.save("truth.stl")
    poses, contours, time = recording.poses, recording.contours, recording.time
    names = {"poses": poses, "contours": contours, "time": time}
    return {
        **names,
        "frames": list(zip(poses, contours, time, strict=True)),
        "view": View(),
        "plotted": plotted,
    }


def test_the_python_page_runs(python_host, tmp_path):
    whole, live = programs("python.md", "python")
    exec(compile(whole, "python.md", "exec"), python_host)
    assert python_host["lumen"].vertices.shape[1] == 3 and len(python_host["plotted"][0]) == len(
        python_host["lumen"].vertices
    )
    assert (tmp_path / "vessel.vtp").stat().st_size > 0
    (tmp_path / "vessel.vtp").unlink()
    exec(compile(live, "python.md", "exec"), python_host)
    assert (tmp_path / "vessel.vtp").stat().st_size > 0
    view, nodes = python_host["view"], python_host["live"].nodes
    assert len(view.parts) > 10 and all(
        first % nodes == 0 and count % nodes == 0 for first, count in view.parts
    )


def test_a_wrong_python_page_is_told(python_host):
    whole = programs("python.md", "python")[0]
    assert "lm.reconstruct(" in whole
    with pytest.raises(AttributeError, match="reconstrukt"):
        exec(whole.replace("lm.reconstruct(", "lm.reconstrukt("), python_host)


# Octave without a display has no `patch`; `py` is MATLAB's alone, so its program is parsed only.
PATCH = """\
function patch (varargin)
  drawn = struct (varargin{:});
  printf ('drawn %d %d %d\\n', size (drawn.Vertices, 2), size (drawn.Faces, 2), ...
          rows (drawn.FaceVertexCData) == rows (drawn.Vertices));
end
"""


def octave(code, folder):
    (folder / "page.m").write_text(code, encoding="utf-8")
    (folder / "patch.m").write_text(PATCH, encoding="utf-8")
    if not (folder / "matlab").exists():
        (folder / "matlab").symlink_to(ROOT / "matlab")
    environment = {**os.environ, "LUMENMESH": str(COMMAND)}
    # `source` runs a file of commands in the order in which they stand.
    code = "try, source ('page.m'); catch e, printf ('error: %s\\n', e.message); exit (1); end"
    command = [tool("octave-cli"), "--no-init-file", "--quiet", "--eval", code]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_the_matlab_page_runs_in_octave(tmp_path):
    whole, live = programs("matlab.md", "matlab")
    run(
        COMMAND,
        "simulate",
        "--vessel",
        "cylinder",
        "--steady",
        "-o",
        "pullback.mat",
        "--truth",
        "truth.stl",
        cwd=tmp_path,
    )
    done = octave(whole, tmp_path)
    assert done.returncode == 0 and "drawn 3 3 1" in done.stdout, done.stdout + done.stderr
    assert 0 < float(re.search(r"mean_mm = (\S+)", done.stdout).group(1)) < 1
    assert (tmp_path / "vessel.vtp").stat().st_size > 0
    done = octave(f"if false\n{live}end\ndisp ('parsed')\n", tmp_path)
    assert "parsed" in done.stdout, done.stdout + done.stderr
    # A page with a mistake is told: one of its language, one of ours.
    for wrong in [live.replace("while ", "while ("), whole.replace("'nodes'", "'nodez'")]:
        assert octave(wrong, tmp_path).returncode != 0


HOST = """\
#include <cmath>
#include <cstdio>

// A straight vessel of 8 mm radius.
struct Robot {
    int k = 0;
    bool next(lumenmesh::Frame &frame) {
        frame.world_from_sensor = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.5 * k, 0, 0, 0, 1};
        frame.time_s = k / 30.0;
        frame.contour_mm.clear();
        for (int ray = 0; ray < 60; ray++) {
            const double angle = 6.283185307179586 * ray / 60;
            frame.contour_mm.push_back({8 * std::cos(angle), 8 * std::sin(angle)});
        }
        return k++ < 80;
    }
};
struct View {
    std::size_t updates = 0;
    template <typename Vertices>
    void update(std::size_t, const Vertices &vertices, const std::vector<double> &errors) {
        updates += !vertices.empty() && vertices.size() == errors.size();
    }
};
struct Window {
    bool closed() const { return false; }
};

int main() {
    Robot robot;
    View view;
    const Window window;
    const lumenmesh::Settings settings;
    lumenmesh::Frame frame;
    std::vector<lumenmesh::Frame> frames;
    while (robot.next(frame)) frames.push_back(frame);
    const lumenmesh::Recording recording(frames);
    robot.k = 0;
"""


def host(live, progress):
    """The program that has both blocks of the page in its main function."""
    include = "#include <lumenmesh.hpp>\n"
    assert live.startswith(include)
    tail = '    lumen.mesh().write("whole.vtp");\n    std::printf("%zu updates\\n", view.updates);\n}\n'
    return include + HOST + live.removeprefix(include) + progress + tail


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Where the C interface is installed, as a host has it."""
    for name in ["cc", "c++", "cmake", "pkg-config"]:
        tool(name)
    prefix = tmp_path_factory.mktemp("capi")
    run(ROOT / "capi/install.sh", prefix, COMMAND.parent / "deps")
    return prefix


def built(source, folder, prefix):
    """Builds a host by the page's lines for CMake."""
    (lines,) = programs("c.md", "cmake")
    text = f"cmake_minimum_required(VERSION 3.16)\nproject(host CXX)\nadd_executable(host host.cpp)\n{lines}"
    (folder / "CMakeLists.txt").write_text(text, encoding="utf-8")
    (folder / "host.cpp").write_text(source, encoding="utf-8")
    flags = "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror"
    run("cmake", "-S", folder, "-B", folder / "build", f"-DCMAKE_PREFIX_PATH={prefix}", flags)
    run("cmake", "--build", folder / "build")
    return folder / "build/host"


def test_the_c_page_compiles_and_runs(installed, tmp_path):
    live, progress = programs("c.md", "cpp")
    program = built(host(live, progress), tmp_path, installed)
    assert int(run(program, cwd=tmp_path).split()[0]) > 10
    assert (tmp_path / "vessel.vtp").stat().st_size > 0 and (tmp_path / "whole.vtp").stat().st_size > 0
    # A page with a mistake is told.
    assert "live.push(" in live
    with pytest.raises(AssertionError, match="no member named"):
        built(host(live.replace("live.push(", "live.posh("), progress), tmp_path, installed)


def test_the_line_for_pkg_config_compiles_a_host(installed, tmp_path):
    line = re.search(r"`(cc host\.c [^`]*)`", (HOSTS / "c.md").read_text(encoding="utf-8")).group(1)
    shutil.copy2(ROOT / "capi/examples/batch.c", tmp_path / "host.c")
    paths = {"PKG_CONFIG_PATH": str(installed / "lib/pkgconfig"), "LD_LIBRARY_PATH": str(installed / "lib")}
    run("bash", "-euc", line, cwd=tmp_path, env={**os.environ, **paths})
    run(COMMAND, "simulate", "--vessel", "cylinder", "--steady", "-o", "pullback.mat", cwd=tmp_path)
    run(tmp_path / "a.out", "pullback.mat", "mesh.vtp", cwd=tmp_path, env={**os.environ, **paths})
    assert (tmp_path / "mesh.vtp").stat().st_size > 0
