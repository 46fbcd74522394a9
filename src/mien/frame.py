"""One image of a video: its pixels, made when they are asked for, its place and its time."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.errors import require

Pixels = NDArray[np.uint8]


class Frame:
    """One image, its index, and its time in seconds.

    What a video decodes becomes RGB when its `pixels` are asked for, and not before: that takes longer than decoding,
    and tracking asks for the grey of a part alone.
    """

    def __init__(self, pixels: Pixels | Decoded, index: int = 0, time: float = 0.0) -> None:
        """pixels: (H, W, 3) uint8 RGB, or what gives them. Raises MienError where they are anything else."""
        if not isinstance(pixels, Decoded):
            _check(pixels)
        self.image, self.index, self.time = pixels, index, time
        self.height, self.width = (int(n) for n in pixels.shape[:2])

    def __reduce__(self) -> tuple[type[Frame], tuple[Pixels, int, float]]:
        """To other processes go the pixels: what was decoded stays in its own."""
        return Frame, (self.pixels, self.index, self.time)

    @cached_property
    def pixels(self) -> Pixels:
        """(H, W, 3) uint8 RGB."""
        return self.image.rgb() if isinstance(self.image, Decoded) else self.image

    @cached_property
    def _luma(self) -> Pixels | None:
        return self.image.luma() if isinstance(self.image, Decoded) else None

    @property
    def brightness(self) -> Pixels:
        """(H, W) uint8 view of what is there without a conversion: luma where that was decoded, else green."""
        return self.pixels[..., 1] if self._luma is None else self._luma

    @cached_property
    def gray(self) -> Pixels:
        """(H, W) uint8 luminance."""
        return self.gray_part(slice(None), slice(None))

    def gray_part(self, rows: slice, columns: slice) -> Pixels:
        """(h, w) uint8 luminance of a part; costs what the part costs."""
        if self._luma is None:
            return np.asarray(cv2.cvtColor(self.pixels[rows, columns], cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        return np.ascontiguousarray(self._luma[rows, columns])


@dataclass(frozen=True)
class Decoded:
    """An image of PyAV, and what it becomes upright and with square pixels, as its metadata says.

    converter: a VideoReformatter, one for all images of a video: it keeps how to convert, which takes several times as
    long to find out as to do. aspect: width of a pixel over its height; the shorter side of the image is drawn out.
    """

    image: Any
    converter: Any
    aspect: float = 1.0

    @cached_property
    def shown(self) -> tuple[int, int]:
        """How players show it: its columns from the left, 1, or from the right, -1, and then so many quarters of a turn
        counter-clockwise."""
        from av.sidedata.sidedata import Type

        matrix = self.image.side_data.get(Type.DISPLAYMATRIX)
        if matrix is None:
            return 1, 0
        a, b, _, c, d = np.frombuffer(matrix, np.int32)[:5].astype(float)  # x' = a x + c y, y' = b x + d y
        columns = 1 if a * d - b * c >= 0 else -1
        return columns, round(2 * math.atan2(c, columns * a) / math.pi) % 4

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, upright."""
        height, width = self._square
        return (width, height) if self.shown[1] % 2 else (height, width)

    @cached_property
    def _square(self) -> tuple[int, int]:
        """Height and width with square pixels, before it is turned."""
        height, width = int(self.image.height), int(self.image.width)
        return round(height * max(1 / self.aspect, 1)), round(width * max(self.aspect, 1))

    def rgb(self) -> Pixels:
        """(H, W, 3) uint8."""
        with _converting:
            height, width = self._square
            pixels = self.converter.reformat(self.image, width, height, format="rgb24").to_ndarray()
        return np.ascontiguousarray(self._as_shown(pixels))

    def luma(self) -> Pixels | None:
        """(H, W) uint8, a view; None where what was decoded has no luma of eight bits apart from its colour, or no
        square pixels."""
        plane, width, height = self.image.planes[0], self.image.width, self.image.height
        if not _has_luma(self.image.format.name) or plane.line_size < width or self._square != (height, width):
            return None
        rows = np.frombuffer(plane, np.uint8, height * plane.line_size).reshape(height, plane.line_size)
        return self._as_shown(rows[:, :width])

    def _as_shown(self, pixels: Pixels) -> Pixels:
        """A view of what was decoded, as players show it."""
        columns, quarters = self.shown
        return np.rot90(pixels[:, ::columns], quarters)


def _check(pixels: object) -> None:
    """Refuse what is no image in RGB: values of 16 bits or fractions of one would be tracked as something else."""
    told = f"an array {pixels.shape} of {pixels.dtype}" if isinstance(pixels, np.ndarray) else str(type(pixels))
    require(
        isinstance(pixels, np.ndarray) and pixels.dtype == np.uint8 and pixels.shape[2:] == (3,) and pixels.size > 0,
        f"the pixels of a frame are {told}; give an array (height, width, 3) of uint8 in RGB, "
        "as cv2.cvtColor(image, cv2.COLOR_BGR2RGB) makes it of an image that OpenCV has read",
    )


_converting = threading.Lock()
"""A frame may be asked for its pixels in another thread than another one of its video."""


@cache
def _has_luma(name: str) -> bool:
    """Whether a pixel format of FFmpeg begins with a plane of luma."""
    from av import VideoFormat

    pixels = VideoFormat(name)
    first = pixels.components[0]
    return name == "gray" or bool(pixels.is_planar and first.is_luma and first.plane == 0 and first.bits == 8)
