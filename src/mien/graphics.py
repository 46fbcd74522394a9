"""Graphics over a video: a logo, a caption, a time code, a bar. They stand still while the face moves behind them."""

from __future__ import annotations

import base64
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Float32, Mask, Pixels
from mien.errors import require


@dataclass(frozen=True)
class Graphics:
    """The pixels of a video that show graphics instead of the face.

    width, height: size of the image; x, y: column and row in it of the first pixel of `mask` (h, w). Raises MienError
    for a mask that reaches beyond the image.
    """

    width: int
    height: int
    x: int
    y: int
    mask: Mask

    def __post_init__(self) -> None:
        h, w = self.mask.shape
        inside = 0 <= self.x <= self.width - w and 0 <= self.y <= self.height - h
        require(inside, f"graphics of {w}x{h} pixels at {self.x}, {self.y} lie outside {self.width}x{self.height}")

    @cached_property
    def surroundings(self) -> tuple[slice, slice]:
        """Rows and columns of the image that `painted_over` needs: those of the mask, and one more each way."""
        (h, w), (y, x) = self.mask.shape, (self.y, self.x)
        return slice(max(y - 1, 0), min(y + h + 1, self.height)), slice(max(x - 1, 0), min(x + w + 1, self.width))

    def painted_over(self, gray: Pixels) -> Pixels:
        """The grey `surroundings` with the nearest other pixels of the same row and column, weighed by their nearness,
        in place of the graphics."""
        painted, (sources, weights) = gray.copy(), self._interpolation
        painted[self._surrounded] = np.rint(np.einsum("ij,ij->i", weights, gray.ravel()[sources])).astype(np.uint8)
        return painted

    def paste(self, painted: Pixels, gray: Pixels, y: int, x: int) -> None:
        """Put what `painted_over` gave into a grey part of the image (h, w), whose first pixel is in row y and column
        x."""
        rows, columns = self.surroundings
        top, left = max(rows.start, y), max(columns.start, x)
        bottom, right = min(rows.stop, y + gray.shape[0]), min(columns.stop, x + gray.shape[1])
        if top < bottom and left < right:
            part = painted[top - rows.start : bottom - rows.start, left - columns.start : right - columns.start]
            gray[top - y : bottom - y, left - x : right - x] = part

    @cached_property
    def _surrounded(self) -> Mask:
        """The mask within the `surroundings`."""
        rows, columns = self.surroundings
        (h, w), top, left = self.mask.shape, self.y - rows.start, self.x - columns.start
        below, right = rows.stop - self.y - h, columns.stop - self.x - w
        return np.pad(self.mask, [(top, below), (left, right)])

    @cached_property
    def _interpolation(self) -> tuple[NDArray[np.int32], Float32]:
        """For each masked pixel, the nearest others (n, 4) to its left, right, above and below, as positions in the
        flat `surroundings`, and their weights (n, 4); none, where graphics fill row and column to the borders."""
        mask = self._surrounded
        rows, columns = np.nonzero(mask)
        across, down = _nearest_outside(mask), [n.T for n in _nearest_outside(mask.T)]
        x = np.stack([*(n[rows, columns] for n in across), columns, columns], axis=1)
        y = np.stack([rows, rows, *(n[rows, columns] for n in down)], axis=1)
        there = (x >= 0) & (x < mask.shape[1]) & (y >= 0) & (y < mask.shape[0])
        weights = there / np.maximum(np.abs(x - columns[:, None]) + np.abs(y - rows[:, None]), 1)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        sources = np.where(there, y * mask.shape[1] + x, 0)
        return sources.astype(np.int32), weights.astype(np.float32)

    def share_around(self, points: Array, reach: float) -> Array:
        """Share (n,) of graphics in the squares that extend by `reach` pixels around image points (n, 2)."""
        h, w = self.mask.shape
        x0, x1 = (np.rint(np.clip(points[:, 0] - self.x + side, 0, w)).astype(int) for side in (-reach, reach))
        y0, y1 = (np.rint(np.clip(points[:, 1] - self.y + side, 0, h)).astype(int) for side in (-reach, reach))
        sums = self._sums
        return np.asarray((sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]) / (2 * reach) ** 2)

    @cached_property
    def _sums(self) -> Array:
        return np.asarray(cv2.integral(self.mask.astype(np.uint8)), dtype=float)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; the mask is a PNG in Base64."""
        png = cv2.imencode(".png", self.mask.astype(np.uint8) * 255)[1].tobytes()
        place = {"width": self.width, "height": self.height, "x": self.x, "y": self.y}
        return place | {"mask_png": base64.b64encode(png).decode("ascii")}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Graphics:
        """The graphics that `to_dict` gave. Raises KeyError, TypeError, ValueError or MienError for anything else."""
        png = np.frombuffer(base64.b64decode(values["mask_png"], validate=True), np.uint8)
        mask: NDArray[Any] | None = None
        with suppress(cv2.error):  # it is empty, or states a size that no image has
            mask = cv2.imdecode(png, cv2.IMREAD_GRAYSCALE)
        require(mask is not None, "`mask_png` of the graphics is no PNG in Base64; remove the graphics")
        width, height, x, y = (int(values[name]) for name in ("width", "height", "x", "y"))
        return Graphics(width, height, x, y, np.asarray(mask) > 0)


def _nearest_outside(mask: Mask) -> list[NDArray[np.intp]]:
    """The columns (h, w) of the nearest pixels to the left and to the right of each pixel that are not masked; -1 and w
    where there are none."""
    columns = np.broadcast_to(np.arange(mask.shape[1]), mask.shape)
    left = np.maximum.accumulate(np.where(mask, -1, columns), axis=1)
    right = np.minimum.accumulate(np.where(mask, mask.shape[1], columns)[:, ::-1], axis=1)[:, ::-1]
    return [left, right]
