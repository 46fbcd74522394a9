"""Boards that pass before a face, or stay there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from skimage import data

from mien.arrays import Array
from mien.frame import Frame

BEGIN, CHANCE = 15, 0.06
"""Frame before which nothing comes, and how probable it is from one frame to the next that something does."""
PATTERN = 90
"""Side of the piece of a picture that is painted on a board."""


@dataclass(frozen=True)
class Board:
    """Something before the face: where its centre is, (2,) pixels, in the frame `begin`, how it moves; its
    picture (h, w, 3)."""

    begin: int
    end: int
    centre: Array
    velocity: Array
    picture: Any

    def paint(self, frame: Frame) -> Frame:
        """The frame with the board before it."""
        height, width = self.picture.shape[:2]
        centre = self.centre + (frame.index - self.begin) * self.velocity
        x, y = np.round(centre - [width / 2, height / 2]).astype(int)
        pixels = frame.pixels.copy()
        rows, columns = slice(max(y, 0), max(y + height, 0)), slice(max(x, 0), max(x + width, 0))
        under = pixels[rows, columns]
        under[:] = self.picture[rows.start - y :, columns.start - x :][: under.shape[0], : under.shape[1]]
        return Frame(pixels, frame.index, frame.time)


def boards(landmarks: Array, rng: np.random.Generator) -> Iterator[Board]:
    """Boards of 0.3 to 1.5 faces before a face with landmarks (n, k, 2); a third stays, the others pass."""
    pictures = [data.coffee(), data.chelsea(), data.astronaut()]
    k = BEGIN
    while k < len(landmarks):
        k += 1 + int(rng.geometric(CHANCE))
        frames = int(rng.uniform(8, 35))
        if k + frames >= len(landmarks):
            return
        face, width = landmarks[k].mean(axis=0), float(np.ptp(landmarks[k, :, 0]))
        across, down = (int(v) for v in width * rng.uniform(0.3, 1.5, 2))
        velocity = rng.normal(0, width / 15, 2) * (rng.random() > 1 / 3)
        centre = face + rng.normal(0, 0.35 * width, 2) - 0.5 * frames * velocity
        picture = pictures[rng.integers(len(pictures))]
        row, column = (rng.integers(0, n - PATTERN) for n in picture.shape[:2])
        piece = cv2.resize(picture[row : row + PATTERN, column : column + PATTERN], (across, down))
        yield Board(k, k + frames, centre, velocity, piece)
        k += frames
