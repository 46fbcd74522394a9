"""Frames, and where they come from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frame:
    """One decoded image: pixels (H, W, 3) uint8 RGB, its index, its time in seconds."""

    pixels: NDArray[np.uint8]
    index: int = 0
    time: float = 0.0

    @property
    def width(self) -> int:
        return int(self.pixels.shape[1])

    @property
    def height(self) -> int:
        return int(self.pixels.shape[0])

    @cached_property
    def gray(self) -> NDArray[np.uint8]:
        """(H, W) uint8 luminance."""
        return np.asarray(cv2.cvtColor(self.pixels, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
