"""What users see: arrays are checked here, before the native part takes them."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _lumenmesh as native

Path = str | PathLike[str]


def _array(name: str, value: ArrayLike, shape: tuple[int | None, ...], expected: str) -> NDArray[np.float64]:
    """The value as contiguous doubles of that shape; None stands for any size."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise native.Error(f"{name}: found an array of {array.dtype}, expected real numbers")
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape))
    if not fits:
        raise native.Error(f"{name}: found shape {array.shape}, expected {expected}")
    return np.ascontiguousarray(array, dtype=np.float64)


def _settings(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Settings as the TOML file writes them; a dictionary is a group: sweep={"nodes": 64}."""
    named = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            named += _settings(value, f"{prefix}{name}.")
        elif value is None:
            named.append((prefix + name, "none"))
        elif isinstance(value, str):
            named.append((prefix + name, value))
        else:
            plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
            try:
                named.append((prefix + name, json.dumps(plain, allow_nan=False)))
            except (TypeError, ValueError):
                raise native.Error(
                    f"setting {prefix}{name}: found {value!r}, expected a number, a text or a list"
                ) from None
    return named


class Recording:
    """What the probe saw.

    Parameters
    ----------
    poses : (F, 4, 4)
        The tracker's sensor in the world; a matrix with a NaN is a pose that the tracker did not measure.
    contours : F arrays (M, 2), or one array (F, M, 2)
        The wall in the probe's plane, mm; NaN where a ray has no echo.
    time : (F,), optional
        Seconds; NaN where it is not known.
    cylinders : (F, 5), optional
        Local cylinders: px, py (mm), theta, phi (rad), radius (mm); NaN where a frame has none.
    phase : (F,), optional
        Phase of the heart or of the breath, in cycles, for the setting `motion.shown` or `motion.window`; NaN where it is
        not known.

    Numbers of any real type and layout are taken. Raises `Error` for other shapes and types.
    """

    __slots__ = ("_native",)

    def __init__(
        self,
        poses: ArrayLike,
        contours: ArrayLike | Iterable[ArrayLike],
        time: ArrayLike | None = None,
        cylinders: ArrayLike | None = None,
        phase: ArrayLike | None = None,
    ) -> None:
        checked = _array("poses", poses, (None, 4, 4), "(F, 4, 4)")
        frames = len(checked)
        if isinstance(contours, np.ndarray) and contours.dtype != object:
            contours = list(_array("contours", contours, (frames, None, 2), f"({frames}, M, 2)"))
        points = [
            _array(f"contours: frame {k}", c, (None, 2), "(M, 2)") if np.size(c) else np.empty((0, 2))
            for k, c in enumerate(contours)  # type: ignore[arg-type]
        ]
        if len(points) != frames:
            raise native.Error(f"contours: found {len(points)}, expected {frames}, one for each pose")
        at = None if time is None else _array("time", time, (frames,), f"({frames},)")
        models = None if cylinders is None else _array("cylinders", cylinders, (frames, 5), f"({frames}, 5)")
        cycles = None if phase is None else _array("phase", phase, (frames,), f"({frames},)")
        self._native = native.NativeRecording(checked, points, at, models, cycles)

    @classmethod
    def _of(cls, of: native.NativeRecording) -> Recording:
        recording = cls.__new__(cls)
        recording._native = of
        return recording

    @property
    def poses(self) -> NDArray[np.float64]:
        """(F, 4, 4): the tracker's sensor in the world."""
        return self._native.poses()

    @property
    def contours(self) -> list[NDArray[np.float64]]:
        """For each frame (M, 2), mm; NaN where a ray has no echo."""
        return self._native.contours()

    @property
    def time(self) -> NDArray[np.float64] | None:
        """(F,), s; None where no frame has a time."""
        return self._native.time()

    @property
    def cylinders(self) -> NDArray[np.float64] | None:
        """(F, 5); None where no frame has a cylinder."""
        return self._native.cylinders()

    @property
    def phase(self) -> NDArray[np.float64] | None:
        """(F,), cycles; None where no frame has a phase."""
        return self._native.phase()

    def save(self, path: Path) -> None:
        """Writes a .mat file by that ending, else a folder of CSV files."""
        self._native.write(path)

    def __len__(self) -> int:
        return self._native.frames()

    def __repr__(self) -> str:
        points = sum(int(np.isfinite(c).all(axis=1).sum()) for c in self.contours)
        return f"<lumenmesh.Recording: {len(self)} frames, {points} echoes>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Recording, (self.poses, self.contours, self.time, self.cylinders, self.phase)


class Mesh:
    """A triangle mesh with arrays over its vertices.

    Parameters
    ----------
    vertices : (V, 3)
        mm.
    faces : (T, 3)
        Vertices of each triangle, counter-clockwise seen from outside the lumen.
    point_data : dict of (V,), optional
    """

    __slots__ = ("_native",)

    def __init__(
        self, vertices: ArrayLike, faces: ArrayLike, point_data: Mapping[str, ArrayLike] | None = None
    ) -> None:
        nodes = _array("vertices", vertices, (None, 3), "(V, 3)")
        corners = _array("faces", faces, (None, 3), "(T, 3)")
        if not np.array_equal(corners, np.floor(corners)):
            raise native.Error("faces: found fractions, expected whole numbers")
        arrays = [
            (name, _array(f"point_data[{name!r}]", values, (len(nodes),), f"({len(nodes)},)"))
            for name, values in (point_data or {}).items()
        ]
        self._native = native.NativeMesh(nodes, corners.astype(np.int64), arrays)

    @classmethod
    def _of(cls, of: native.NativeMesh) -> Mesh:
        mesh = Mesh.__new__(Mesh)
        mesh._native = of
        return mesh

    @property
    def vertices(self) -> NDArray[np.float64]:
        """(V, 3), mm."""
        return self._native.vertices()

    @property
    def faces(self) -> NDArray[np.int32]:
        """(T, 3)."""
        return self._native.faces()

    @property
    def point_data(self) -> dict[str, NDArray[np.float64]]:
        """Arrays over the vertices by their names, such as support and standard_error_mm."""
        return self._native.point_data()

    def save(self, path: Path, space: str = "ras") -> None:
        """Writes .vtp, .ply, .stl, .obj or .mat. space: "ras", the tracker's axes, or "lps", x and y negated."""
        self._native.write(path, space)

    def picture(self, array: str | None = None, size: tuple[int, int] = (960, 600)) -> bytes:
        """The mesh from three sides as a PNG file, coloured by an array."""
        return self._native.picture(array, *size)

    def to_pyvista(self) -> Any:
        """A pyvista.PolyData with the same arrays. Needs pyvista."""
        import pyvista  # type: ignore[import-not-found, import-untyped, unused-ignore]

        faces = self.faces
        mesh = pyvista.PolyData(self.vertices, np.insert(faces, 0, 3, axis=1).ravel())
        for name, values in self.point_data.items():
            mesh.point_data[name] = values
        return mesh

    def to_trimesh(self) -> Any:
        """A trimesh.Trimesh with the vertices in the same order. Needs trimesh."""
        import trimesh  # type: ignore[import-not-found, import-untyped, unused-ignore]

        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        mesh.vertex_attributes.update(self.point_data)
        return mesh

    def __repr__(self) -> str:
        faces, arrays = len(self.faces), ", ".join(self.point_data) or "none"
        name = type(self).__name__
        return f"<lumenmesh.{name}: {len(self.vertices)} vertices, {faces} triangles; arrays: {arrays}>"

    def _repr_html_(self) -> str:
        """A picture for notebooks."""
        try:
            png = base64.b64encode(self.picture()).decode()
        except native.Error:
            return f"<code>{repr(self)[1:-1]}</code>"
        return f'<img src="data:image/png;base64,{png}" width="640"><br><code>{repr(self)[1:-1]}</code>'

    def __reduce__(self) -> tuple[Any, ...]:
        return Mesh, (self.vertices, self.faces, self.point_data)


class Lumen(Mesh):
    """A reconstructed lumen: its mesh, and `report`, what was done: settings, frames that were left out and why, and the
    method's numbers, as `lumenmesh reconstruct --json` prints them."""

    __slots__ = ("report",)

    report: dict[str, Any]

    def __reduce__(self) -> tuple[Any, ...]:
        return _lumen, (self.vertices, self.faces, self.point_data, self.report)


def _lumen(
    vertices: ArrayLike, faces: ArrayLike, point_data: Mapping[str, ArrayLike], report: dict[str, Any]
) -> Lumen:
    lumen = Lumen(vertices, faces, point_data)
    lumen.report = report
    return lumen


@dataclass(frozen=True, slots=True)
class Times:
    """How long the stages of a frame took, in seconds of wall-clock time."""

    screening_s: float
    """Judging whether the frame is fit for use."""
    axis_s: float
    """Drawing the axis of a swept vessel anew, and placing older echoes about it."""
    placing_s: float
    """Placing the frame and its echoes."""
    solving_s: float
    """Solving for the wall, or fitting a cylinder."""
    total_s: float
    """All of the frame."""


@dataclass(frozen=True, slots=True)
class Change:
    """What a frame changed. Rings are numbered along the vessel; ring k has the nodes from k * live.nodes on."""

    frame: int
    """The frame's number: how many were taken before it."""
    before: int
    """New rings in front of all others: what was ring k is ring k + before now."""
    changed: list[tuple[int, int]]
    """Ranges of rings that changed or are new: the first, and the one after the last."""
    rings: int
    """Rings of the vessel now."""
    off_axis: bool
    """Whether the frame lies outside of the vessel's lumen: its echoes wait."""
    left_out: list[dict[str, Any]]
    """Frames that were found unfit now, and why."""
    waiting: int
    """Frames that wait: they jump off the path of the others, and later ones decide; or the vessel began anew, and it is
    not their turn yet."""
    restarted: bool
    """Whether the vessel began anew, because what was shown before came from frames that are left out now, or from points
    that are no wall. Frames follow from the first on, some with each push."""
    times: Times = field(compare=False)
    """How long that took; changes are equal if all else is."""


def _change(values: native._Change) -> Change:
    frame, before, changed, rings, off_axis, left_out, waiting, restarted, times = values
    frames = [] if left_out == "[]" else json.loads(left_out)
    return Change(frame, before, changed, rings, off_axis, frames, waiting, restarted, Times(*times))


class Live:
    """A vessel that grows frame by frame, in bounded time. Settings as for `reconstruct`.

    Any thread may use it; calls from several wait for each other. While it computes, other Python threads run.
    keep_frames: for `finish`; otherwise memory grows with the vessel's length only.
    """

    __slots__ = ("_native",)

    def __init__(self, *, keep_frames: bool = False, **settings: Any) -> None:
        self._native = native.NativeLive(_settings(settings), keep_frames)

    @classmethod
    def restore(cls, path: Path) -> Live:
        """A vessel as it was when `snapshot` wrote the file, with its settings: what follows is the same to the last bit."""
        live = cls.__new__(cls)
        live._native = native.NativeLive.restore(path)
        return live

    def snapshot(self, path: Path) -> None:
        """Writes the whole state as a file, complete or not at all."""
        self._native.snapshot(path)

    def finish(self) -> Lumen:
        """The lumen of all frames at once, as `reconstruct` makes it of a recording of them. Needs keep_frames."""
        return _reconstructed(*self._native.finish())

    def push(self, pose: ArrayLike, contour: ArrayLike, time: float | None = None) -> Change:
        """Takes the next frame: pose (4, 4), contour (M, 2) in mm with NaN where a ray has no echo, time in s.

        Raises `Error` where the frame is refused; the vessel is then as before.
        """
        points = _array("contour", contour, (None, 2), "(M, 2)") if np.size(contour) else np.empty((0, 2))
        return _change(self._native.push(_array("pose", pose, (4, 4), "(4, 4)"), points, time))

    def flush(self) -> Change:
        """After the last frame: frames that still wait are left out."""
        return _change(self._native.flush())

    def reset(self) -> None:
        """Forgets all frames."""
        self._native.reset()

    def surface(self) -> Mesh:
        """The vessel so far; a mesh without vertices as long as it has not begun."""
        return Mesh._of(self._native.surface())

    def part(self, first: int, end: int) -> Mesh:
        """The rings from first up to, not with, end: all nodes in order, also what no echo supports."""
        if min(first, end) < 0:
            raise native.Error(f"part: found rings {first} to {end}, expected numbers from 0 on")
        return Mesh._of(self._native.part(first, end))

    @property
    def rings(self) -> int:
        """Rings of the vessel."""
        return self._native.rings()

    @property
    def nodes(self) -> int:
        """Nodes of each ring; 0 as long as there is none."""
        return self._native.nodes()

    @property
    def branches(self) -> int:
        """Branches that have a wall: what was seen first, and each that the catheter entered since. The array `branch` of a
        swept vessel says which one a vertex belongs to."""
        return self._native.branches()

    @property
    def engine(self) -> dict[str, str] | None:
        """Where frames are computed: `name`, `adapter` of a device, and `why`. None before the first cylinder."""
        said: dict[str, str] | None = json.loads(self._native.engine())
        return said

    def __len__(self) -> int:
        return self._native.frames()

    def __repr__(self) -> str:
        return f"<lumenmesh.Live: {len(self)} frames, {self.rings} rings of {self.nodes} nodes>"


def read(path: Path) -> Recording:
    """Reads a recording: a MATLAB .mat file (v4 to v7.3) or a folder of CSV files."""
    return Recording._of(native.NativeRecording.read(path))


def read_mesh(path: Path) -> Mesh:
    """Reads a mesh: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu."""
    return Mesh._of(native.NativeMesh.read(path))


def reconstruct(
    recording: Recording,
    *,
    progress: Callable[[str, int, int], object] | None = None,
    **settings: Any,
) -> Lumen:
    """Reconstructs the lumen of a recording.

    Settings are keywords with the names, values and limits of the TOML file, groups as dictionaries:
    `method="cylinders", nodes=24, sweep={"roughness": 0.1}`. `progress(stage, done, total)` is called from other threads;
    what it raises, KeyboardInterrupt too, ends the computation soon and is raised here.
    """
    return _reconstructed(*native.reconstruct(recording._native, _settings(settings), progress))


def _reconstructed(mesh: native.NativeMesh, report: str) -> Lumen:
    lumen = Lumen.__new__(Lumen)
    lumen._native = mesh
    lumen.report = json.loads(report)
    return lumen


def _mesh(mesh: Mesh | Path) -> Mesh:
    return mesh if isinstance(mesh, Mesh) else read_mesh(mesh)


def evaluate(mesh: Mesh | Path, truth: Mesh | Path) -> dict[str, Any]:
    """How far a mesh is from the truth, as `lumenmesh evaluate --json` prints it; the fitting error is
    `["mesh_to_truth"]["mean_mm"]`."""
    numbers: dict[str, Any] = json.loads(_mesh(mesh)._native.evaluate(_mesh(truth)._native))
    return numbers


def simulate(
    vessel: str = "aorta", *, seed: int = 1, noise: bool = True, rays: int = 90, steady: bool = False
) -> tuple[Recording, Mesh]:
    """A recording of a phantom, and its wall. `lumenmesh simulate --help` lists the vessels; steady: the catheter only
    advances."""
    recording, wall = native.simulate(vessel, seed, noise, rays, steady)
    return Recording._of(recording), Mesh._of(wall)
