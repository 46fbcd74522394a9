"""What surrounds the face. A picture that dissolves into another one changes there too; a hand before the face, or a
grimace, does not change it."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from mien.geometry.rotation import Array
from mien.video import Frame, Pixels

_ROWS, _COLUMNS = 24, 32
_LEAST_POINTS = 60
"""Points of the grid around the face below which nothing is said of them."""


class Scene:
    """The last frames, each as a grid of its points."""

    def __init__(self, look_back: int) -> None:
        """look_back: frames after which the scene is compared with itself."""
        self.seen: deque[Pixels] = deque(maxlen=look_back + 1)

    def remember(self, frame: Frame) -> None:
        """Keep the grid of a frame."""
        y, x = _grid(frame)
        self.seen.append(frame.pixels[y[:, None], x, 1])

    def correlation(self, frame: Frame, face: Array, radius: float) -> float:
        """How the surroundings in the last frame that was remembered, `frame`, agree with those `look_back` frames
        before: what is further from the face (2,) than a radius, in pixels. 0 where that is hardly anything."""
        y, x = _grid(frame)
        around = np.hypot(y[:, None] - face[1], x - face[0]) > radius
        if np.count_nonzero(around) < _LEAST_POINTS:
            return 0.0
        before, now = (grid[around] - grid[around].mean() for grid in (self.seen[0], self.seen[-1]))
        return float(before @ now / max(np.linalg.norm(before) * np.linalg.norm(now), 1e-9))


def _grid(frame: Frame) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """y and x of points all over a frame."""
    return _middles(_ROWS, frame.height), _middles(_COLUMNS, frame.width)


def _middles(parts: int, length: int) -> NDArray[np.intp]:
    return ((np.arange(parts) + 0.5) * length / parts).astype(np.intp)
