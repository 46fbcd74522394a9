"""The surroundings of the face. A dissolve into another picture changes them; a hand before the face, or a grimace,
does not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array
from mien.frame import Frame
from mien.tracking.recent import Recent

_ROWS, _COLUMNS = 24, 32
"""Least number of grid cells in frames that have as many pixels."""
_SAME_SHOT = 0.7
"""Correlation of a picture with the one before below which there was a cut: in thirteen recordings it is 0.82 and
more."""
_LEAST_AROUND = 0.08
"""Least share of the grid that has to lie around the face for a verdict."""
_DARK = 80
"""Sum of the four pixels of a cell up to which it is dark."""


class Scene:
    """The last frames, each as a coarse grid."""

    def __init__(self, frames: int, seconds: float = 0.0) -> None:
        """frames, seconds: after which the scene is compared with itself, see `Recent`."""
        self.seen: Recent[NDArray[np.uint16]] = Recent(frames, seconds)

    def remember(self, frame: Frame) -> None:
        """Keep the grid of a frame: per cell the sum of four pixels, at a quarter and three quarters of its sides. The
        noise of a single pixel would hide a plain background."""
        self.cell = down, across = _cell(frame)
        rows, columns = frame.height // down, frame.width // across
        image = frame.brightness[: rows * down, : columns * across]
        above, below = (image[y::down] for y in _quarters(down))
        left, right = _quarters(across)
        total = np.add(above[:, left::across], above[:, right::across], dtype=np.uint16)
        total += below[:, left::across]
        total += below[:, right::across]
        self.seen.add(total, frame.time)

    def correlation(self, face: Array, radius: float) -> float:
        """Correlation of the surroundings in the frame remembered last with the earlier one: of what is
        further from the face (2,) than a radius, in pixels, without what is dark in both, like the bars beside a
        picture, which a cut leaves as they were, as long as that is not nearly all. 0 where there is hardly anything
        around, and where the frames differ in size."""
        rows, columns = self.seen[-1].shape
        down, across = self.cell
        y, x = (np.arange(rows) + 0.5) * down - 0.5, (np.arange(columns) + 0.5) * across - 0.5
        reach = 0.25 * np.hypot(down, across)  # of those four pixels from the middle of their cell
        around = np.hypot(y[:, None] - face[1], x - face[0]) > radius + reach
        if around.mean() < _LEAST_AROUND or self.seen[0].shape != around.shape:
            return 0.0
        lit = around & (np.maximum(self.seen[0], self.seen[-1]) > _DARK)
        seen = lit if lit.mean() >= _LEAST_AROUND else around
        before, now = (grid[seen] - grid[seen].mean() for grid in (self.seen[0], self.seen[-1]))
        return float(before @ now / max(np.linalg.norm(before) * np.linalg.norm(now), 1e-9))


def numbered_by_shot(frames: Iterable[Frame]) -> Iterator[tuple[int, Frame]]:
    """Each frame, with the number of cuts before it."""
    scene, cuts = Scene(frames=1), 0
    for frame in frames:
        scene.remember(frame)
        cuts += scene.correlation(np.zeros(2), 0.0) < _SAME_SHOT
        yield cuts, frame


def _quarters(length: int) -> tuple[int, int]:
    """A quarter and three quarters of a length."""
    return length // 4, 3 * length // 4


def _cell(frame: Frame) -> tuple[int, int]:
    """Height and width of a grid cell in pixels."""
    return max(frame.height // _ROWS, 1), max(frame.width // _COLUMNS, 1)
