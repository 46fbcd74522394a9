"""What surrounds the face. A picture that dissolves into another one changes there too; a hand before the face, or a
grimace, does not change it."""

from __future__ import annotations

from collections import deque

import numpy as np

from mien.geometry.rotation import Array
from mien.video import Frame, Pixels

_ROWS, _COLUMNS = 24, 32
"""Of the grid, at least, where the frame has as many."""
_LEAST_AROUND = 0.08
"""Share of the grid's points that have to lie around the face for anything to be said of them."""


class Scene:
    """The last frames, each as a grid of its points."""

    def __init__(self, look_back: int) -> None:
        """look_back: frames after which the scene is compared with itself."""
        self.seen: deque[Pixels] = deque(maxlen=look_back + 1)

    def remember(self, frame: Frame) -> None:
        """Keep the grid of a frame."""
        self.seen.append(frame.pixels[(*_grid(frame), 1)].copy())

    def correlation(self, frame: Frame, face: Array, radius: float) -> float:
        """How the surroundings in the last frame that was remembered, `frame`, agree with those `look_back` frames
        before: what is further from the face (2,) than a radius, in pixels. 0 where that is hardly anything, and where
        frames differ in size."""
        rows, columns = _grid(frame)
        y, x = np.arange(frame.height)[rows], np.arange(frame.width)[columns]
        around = np.hypot(y[:, None] - face[1], x - face[0]) > radius
        if around.mean() < _LEAST_AROUND or self.seen[0].shape != around.shape:
            return 0.0
        before, now = (grid[around] - grid[around].mean() for grid in (self.seen[0], self.seen[-1]))
        return float(before @ now / max(np.linalg.norm(before) * np.linalg.norm(now), 1e-9))


def _grid(frame: Frame) -> tuple[slice, slice]:
    """Rows and columns all over a frame."""
    down, across = max(frame.height // _ROWS, 1), max(frame.width // _COLUMNS, 1)
    return slice(down // 2, None, down), slice(across // 2, None, across)
