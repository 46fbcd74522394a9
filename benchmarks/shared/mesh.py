"""MediaPipe's points of a face, laid over those of another frame by what no expression moves."""

from __future__ import annotations

import numpy as np

from mien.arrays import Array
from mien.errors import require
from mien.geometry.rotation import similarity
from mien.initialization.landmarks import Landmarks

STILL = [1, 4, 5, 6, 8, 9, 10, 33, 54, 93, 103, 127, 133, 151, 168, 195, 197, 234, 263, 284, 323, 332, 356, 362, 454]
"""Points of nose, forehead, temples, and the corners of the eyes."""
EYES = [33, 133, 362, 263]


def mesh(face: Landmarks) -> Array:
    """(468, 3) points of MediaPipe with their depths."""
    depths = face.depths
    require(depths is not None, f"{face.source}: these landmarks have no depths; install MediaPipe")
    return np.column_stack([face.points, np.asarray(depths)])[:468]


def laid_over(points: Array, first: Array) -> Array:
    """Points (468, 3) moved, turned and scaled so that those which are still lie on those of the first frame."""
    scale, R, t = similarity(points[STILL], first[STILL])
    return np.asarray(scale * points @ R.T + t)
