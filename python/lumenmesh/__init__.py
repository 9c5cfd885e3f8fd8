"""From tracked intravascular ultrasound to a 3D mesh of the vessel's lumen.

Lengths are in mm, angles in rad, times in s; indices count from 0. A pose is a 4x4 matrix: the tracker's sensor in the
world, with the translation in its last column.

    >>> import lumenmesh as lm
    >>> recording, truth = lm.simulate("cylinder", seed=1)
    >>> lumen = lm.reconstruct(recording)
    >>> lm.evaluate(lumen, truth)["mesh_to_truth"]["mean_mm"] < 0.2
    True
"""

from ._api import (
    Change,
    Live,
    Lumen,
    Mesh,
    Recording,
    Times,
    evaluate,
    read,
    read_mesh,
    reconstruct,
    simulate,
)
from ._lumenmesh import Error, __version__

__all__ = [
    "Change",
    "Error",
    "Live",
    "Lumen",
    "Mesh",
    "Recording",
    "Times",
    "__version__",
    "evaluate",
    "read",
    "read_mesh",
    "reconstruct",
    "simulate",
]
