"""Vessels to show, made up: a bent tube whose lumen, support and errors are known at every node."""

import base64
import math

import numpy as np


def packed(array, kind="<f4"):
    """Base64 of little-endian numbers."""
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode()


class Tube:
    """A quarter of a circle of 120 mm radius, with an egg-shaped lumen that is narrow in the middle.

    `positions_mm` is K x N x 3. `origin_mm` moves it in the world.
    """

    def __init__(self, rings=120, nodes=48, origin_mm=(0.0, 0.0, 0.0), seed=1):
        self.rings, self.nodes = rings, nodes
        random = np.random.default_rng(seed)
        turn = np.linspace(0.0, 0.5 * math.pi, rings)[:, None]
        zero = np.zeros_like(turn)
        self.along = np.concatenate([-np.sin(turn), zero, np.cos(turn)], axis=1)
        self.right = np.concatenate([np.cos(turn), zero, np.sin(turn)], axis=1)
        self.up = np.cross(self.along, self.right)
        self.axis_mm = 120.0 * self.right + np.array(origin_mm)
        angle = 2.0 * math.pi * np.arange(nodes) / nodes
        along = np.linspace(0.0, 1.0, rings)[:, None]
        narrow = 1.0 - 0.45 * np.exp(-(((along - 0.5) / 0.08) ** 2))
        self.radius_mm = 11.0 * narrow * (1.0 + 0.12 * np.cos(angle) + 0.05 * np.sin(3.0 * angle))
        # Node j of ring k in the plane of its ring.
        self.flat_mm = self.radius_mm[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.positions_mm = (
            self.axis_mm[:, None]
            + self.flat_mm[..., :1] * self.right[:, None]
            + self.flat_mm[..., 1:] * self.up[:, None]
        )
        # The mouth of a branch: nobody has seen the wall there.
        mouth = ((along - 0.25) / 0.05) ** 2 + ((angle - 4.3) / 0.5) ** 2 < 1.0
        support = np.where(mouth, 0, random.poisson(9.0, (rings, nodes)) + 1)
        self.arrays = {
            "support": support,
            "standard_error_mm": np.where(mouth, np.nan, 0.6 / np.sqrt(np.maximum(support, 1))),
            "signed_error_mm": 0.2 * np.sin(3.0 * angle) * np.cos(9.0 * along),
            "frame": np.repeat(2.0 * np.arange(rings)[:, None], nodes, axis=1),
            "supported": np.where(mouth, 0, 1),
        }

    def part(self, start, end):
        """Rings `start` up to `end` as an event has them."""
        return {
            "positions_mm": packed(self.positions_mm[start:end]),
            "arrays": {name: packed(values[start:end]) for name, values in self.arrays.items()},
        }

    def vessel(self, start=0, end=None, frames=(), **more):
        end = self.rings if end is None else end
        grid = {"type": "vessel", "title": "bent tube", "nodes": self.nodes, "rings": end - start}
        return grid | self.part(start, end) | {"frames": list(frames)} | more

    def triangles(self):
        """As docs/viewer.md joins the rings."""
        k, j = np.meshgrid(np.arange(self.rings - 1), np.arange(self.nodes), indexing="ij")
        a, b = k * self.nodes + j, k * self.nodes + (j + 1) % self.nodes
        faces = np.stack([a, b, b + self.nodes, a, b + self.nodes, a + self.nodes], axis=-1)
        return faces.reshape(-1, 3)

    def mesh(self, frames=(), **more):
        """The same wall as a mesh that is no grid: its triangles are in another order."""
        order = np.random.default_rng(2).permutation(len(self.triangles()))
        whole = self.part(0, self.rings)
        mesh = {"type": "vessel", "title": "any mesh", "triangles": packed(self.triangles()[order], "<u4")}
        return mesh | whole | {"frames": list(frames)} | more

    def frame(self, ring, number=None, time_s=None, contour=True):
        """The frame of a probe on the axis, in the plane of a ring."""
        pose = np.column_stack([self.right[ring], self.up[ring], self.along[ring], self.axis_mm[ring]])
        frame = {"number": 2 * ring if number is None else number, "world_from_probe": pose.ravel().tolist()}
        if time_s is not None:
            frame["time_s"] = time_s
        if contour:
            points = self.flat_mm[ring].copy()
            points[5] = np.nan
            frame["contour_mm"] = packed(points)
        return frame


def measures(flat_mm):
    """Area, circular-equivalent, least and greatest diameter, and perimeter of a polygon (n x 2)."""
    x, y = flat_mm.T
    u, v = np.roll(x, -1), np.roll(y, -1)
    twice = x * v - u * y
    area = 0.5 * twice.sum()
    centre = np.array([((x + u) * twice).sum(), ((y + v) * twice).sum()]) / (6.0 * area)
    angles = np.pi * np.arange(360) / 360
    chords = []
    for direction in np.column_stack([np.cos(angles), np.sin(angles)]):
        matrix = np.stack(
            [np.broadcast_to(direction, flat_mm.shape), flat_mm - np.column_stack([u, v])], axis=-1
        )
        along, share = np.linalg.solve(matrix, (flat_mm - centre)[..., None])[..., 0].T
        along = along[(share >= 0.0) & (share <= 1.0)]
        chords.append(along[along > 0.0].min() - along[along < 0.0].max())
    return {
        "area": abs(area),
        "circular-equivalent diameter": 2.0 * math.sqrt(abs(area) / math.pi),
        "least diameter": min(chords),
        "greatest diameter": max(chords),
        "perimeter": np.hypot(u - x, v - y).sum(),
    }
