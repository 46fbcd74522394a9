"""The skin between lower lip and chin, which the jaw carries: where it looks as in the first frame, there the jaw is.

A mouth that opens shows what the first frame did not, teeth and dark, so that the landmarks of the lips look strange
wherever they are. The skin below them stays as it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.arrays import Array, Float32
from mien.compiled import kernel
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.motion import bilinear, center
from mien.tracking.realtime.pose_geometry import (
    PersonArrays,
    PoseArrays,
    ViewArrays,
    head_to_crop,
    landmark,
    project_to_crop,
)

CARRIER = LANDMARK_NAMES.index("lower_lip_outer")
"""The landmark below which the skin lies, and which the jaw carries."""
OFFSETS = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(0.02, 0.36, 8)), axis=-1).reshape(-1, 2)
"""Where the skin lies in the first frame's image from there, right and down, CANDIDE units."""


class Chin:
    """What the skin below the mouth looks like in the first frame, and where a crop shows it."""

    def __init__(self, points: Array, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays) -> None:
        """points: (m, 3) on the skin, relative to `CARRIER`, head axes; image, pose, view: the crop of the first frame,
        and the face in it."""
        self.points = np.ascontiguousarray(points.T)
        self.values = np.empty(len(points), np.float32)
        _look(image, person, self.points, pose, float(pose[2][JAW_DROP]), view, self.values)
        center(self.values)

    def likeness(self, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays, jaws: Array) -> Array:
        """Correlations (k,) of the skin in the first frame with what a crop, in which the face is at a pose, shows
        where values (k,) of jaw_drop would have carried it."""
        likeness: Array = _likeness(image, person, self.points, pose, jaws, view, self.values)
        return likeness


@kernel()
def _look(image: Any, person: Any, points: Any, pose: Any, jaw: float, view: Any, out: Any) -> None:
    """The values (m,) that a crop shows at points (3, m), relative to `CARRIER`, at a pose with another jaw_drop."""
    R, t, a = pose
    opened = a.copy()
    opened[JAW_DROP] = jaw
    to_crop = head_to_crop(R, t, view)
    x, y, z = landmark(CARRIER, person, opened)
    for j in range(out.size):
        u, v, _ = project_to_crop(x + points[0, j], y + points[1, j], z + points[2, j], to_crop)
        out[j] = bilinear(image, u, v)[0]


@kernel()
def _likeness(image: Any, person: Any, points: Any, pose: Any, jaws: Any, view: Any, values: Any) -> Any:
    """What `Chin.likeness` returns; values: (m,) of the first frame, less their mean."""
    out, shown = np.empty(jaws.size), np.empty(values.size, np.float32)
    squared = 1e-6
    for j in range(values.size):
        squared += values[j] * values[j]
    for k in range(jaws.size):
        _look(image, person, points, pose, jaws[k], view, shown)
        norm = center(shown) + 1e-6
        product = 0.0
        for j in range(values.size):
            product += shown[j] * values[j]
        out[k] = product / np.sqrt(squared * norm)
    return out
