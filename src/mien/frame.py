"""One frame of a video: its pixels, converted on demand, its index and its time."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from numbers import Real
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Pixels
from mien.errors import MienError, require
from mien.graphics import Graphics


class Frame:
    """One image, its index, and its time in seconds.

    A decoded image is converted to RGB only when `pixels` is accessed: the conversion takes longer than decoding, and
    tracking needs only the luminance of a region.
    """

    def __init__(self, pixels: NDArray[Any] | Recorded, index: int = 0, time: float = 0.0) -> None:
        """pixels: (H, W, 3) uint8 RGB, (H, W) uint8 of a grey image, or one whose pixels are made on demand. Raises
        MienError for anything else."""
        if not isinstance(pixels, Recorded):
            _check(pixels)
        numbers = isinstance(index, (int, np.integer)) and isinstance(time, Real)
        if not numbers:
            raise MienError(f"a frame has the index {index!r} and the time {time!r}; give a number from 0, and seconds")
        self.image, self.index, self.time = pixels, int(index), float(time)
        self.height, self.width = (int(n) for n in pixels.shape[:2])
        self.graphics: Graphics | None = None

    def __repr__(self) -> str:
        return f"<Frame {self.index} at {self.time:.2f} s, {self.width}x{self.height} pixels>"

    def behind(self, graphics: Graphics | None) -> Frame:
        """The same frame, whose luminance has these graphics painted over; `pixels` stay as they are."""
        if graphics is self.graphics:
            return self
        if self.luma is None:
            _ = self.pixels  # converted once, for both
        frame = Frame.__new__(Frame)
        vars(frame).update(vars(self), graphics=graphics)
        for derived in ("gray", "_painted"):
            vars(frame).pop(derived, None)
        return frame

    def __reduce__(self) -> tuple[type[Frame], tuple[Pixels, int, float], dict[str, Any]]:
        """Pickle the RGB pixels of a decoded image, which cannot leave its process."""
        image = self.pixels if isinstance(self.image, Recorded) else self.image
        return Frame, (image, self.index, self.time), {"graphics": self.graphics}

    @property
    def interlaced(self) -> bool:
        """Whether it shows one of the two fields of a decoded image."""
        return isinstance(self.image, Recorded) and self.image.interlaced

    @cached_property
    def quantizer_step(self) -> float | None:
        """How coarsely the video around a decoded image was compressed, see `video.quantizer`; None where that is not
        known."""
        return self.image.quantizer_step() if isinstance(self.image, Recorded) else None

    @cached_property
    def pixels(self) -> Pixels:
        """(H, W, 3) uint8 RGB."""
        if isinstance(self.image, Recorded):
            return self.image.rgb()
        return np.repeat(self.image[:, :, None], 3, axis=2) if self.image.ndim == 2 else self.image

    @cached_property
    def luma(self) -> Pixels | None:
        """(H, W) uint8 of an image that has it without a conversion, or is grey; None for others."""
        if isinstance(self.image, Recorded):
            return self.image.luma()
        return self.image if self.image.ndim == 2 else None

    @property
    def brightness(self) -> Pixels:
        """(H, W) uint8 brightness without a conversion: a view of the luma or grey image, or of the green channel."""
        return self.pixels[..., 1] if self.luma is None else self.luma

    @cached_property
    def gray(self) -> Pixels:
        """(H, W) uint8 luminance."""
        return self.gray_part(slice(None), slice(None))

    def gray_part(self, rows: slice, columns: slice) -> Pixels:
        """(h, w) uint8 luminance of a region, at the cost of that region alone."""
        gray = self._recorded_gray(rows, columns)
        if self.graphics is not None:
            gray = gray.copy()
            self.graphics.paste(self._painted, gray, rows.start or 0, columns.start or 0)
        return gray

    def _recorded_gray(self, rows: slice, columns: slice) -> Pixels:
        """The luminance of a region with what is before the face."""
        if self.luma is None:
            return np.asarray(cv2.cvtColor(self.pixels[rows, columns], cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        gray = np.ascontiguousarray(self.luma[rows, columns])
        return gray if gray.flags.writeable else gray.copy()  # for others the kernels would be compiled once more

    @cached_property
    def _painted(self) -> Pixels:
        """The surroundings of the graphics, painted over."""
        assert self.graphics is not None, "there are graphics to paint over"
        rows, columns = self.graphics.surroundings
        return self.graphics.painted_over(self._recorded_gray(rows, columns))


class Recorded(ABC):
    """An image whose pixels are made when they are asked for."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Height and width."""

    @property
    @abstractmethod
    def interlaced(self) -> bool:
        """Whether it is one of two fields, as far as its stream says so."""

    @abstractmethod
    def quantizer_step(self) -> float | None:
        """See `Frame.quantizer_step`."""

    @abstractmethod
    def rgb(self) -> Pixels:
        """(H, W, 3) uint8."""

    @abstractmethod
    def luma(self) -> Pixels | None:
        """(H, W) uint8 luminance if it needs no conversion, None otherwise."""


@dataclass(frozen=True)
class Decoded(Recorded):
    """An image decoded by PyAV, which becomes upright, with square pixels, as its metadata says. Of an interlaced one,
    whose two fields show different moments, only the upper field is seen.

    display: shared by all images of a video. aspect: width of a pixel over its height; correcting it stretches the
    image, never shrinks it.
    """

    image: Any
    display: Display
    aspect: float = 1.0

    @property
    def orientation(self) -> tuple[int, int]:
        """See `Display.orientation`."""
        return self.display.orientation(self.image)

    @property
    def interlaced(self) -> bool:
        """Whether the image has two fields, as far as its stream says so."""
        return bool(self.image.interlaced_frame)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the upright image."""
        height, width = self._size_with_square_pixels
        return (width, height) if self.orientation[1] % 2 else (height, width)

    @cached_property
    def _size_with_square_pixels(self) -> tuple[int, int]:
        """Height and width with square pixels, before rotation."""
        height, width = int(self.image.height), int(self.image.width)
        return round(height * max(1 / self.aspect, 1)), round(width * max(self.aspect, 1))

    def quantizer_step(self) -> float | None:
        """See `Frame.quantizer_step`."""
        return None if self.image.time is None else self.display.quantizer_step(float(self.image.time))

    def rgb(self) -> Pixels:
        """(H, W, 3) uint8."""
        height, width = self._size_with_square_pixels
        rows = int(self.image.height) if self.interlaced else height  # scaling would mix the fields
        with _converting:
            if self.image.colorspace not in _CONVERTED:
                self.image.colorspace = _UNSPECIFIED
            converted = self.display.converter.reformat(self.image, width, rows, format="rgb24")
        pixels = self._of_one_moment(np.asarray(converted.to_ndarray(), np.uint8))
        if rows != height:
            pixels = np.asarray(cv2.resize(pixels, (width, height)), np.uint8)
        return np.ascontiguousarray(self._upright(pixels))

    def luma(self) -> Pixels | None:
        """(H, W) uint8 luma plane, a view unless it is interlaced; None if the pixel format has no separate 8-bit luma
        plane, or the pixels are not square."""
        plane, width, height = self.image.planes[0], self.image.width, self.image.height
        square = self._size_with_square_pixels == (height, width)
        if not _has_luma(self.image.format.name) or plane.line_size < width or not square:
            return None
        rows = np.frombuffer(plane, np.uint8, height * plane.line_size).reshape(height, plane.line_size)
        return self._upright(self._of_one_moment(rows[:, :width]))

    def _of_one_moment(self, pixels: Pixels) -> Pixels:
        """Decoded pixels (H, W, ..), without the lower field if they are interlaced."""
        return upper_field(pixels) if self.interlaced else pixels

    def _upright(self, pixels: Pixels) -> Pixels:
        """View of decoded pixels, mirrored and rotated for display."""
        columns, quarters = self.orientation
        return np.rot90(pixels[:, ::columns], quarters)


class Display:
    """What the images of a video share: how they are displayed, what converts them, as setting up a conversion takes
    several times as long as running it, and quantizer_step, how coarsely they were compressed at a time in seconds."""

    def __init__(self, quantizer_step: Callable[[float], float | None]) -> None:
        from av.video.reformatter import VideoReformatter

        self.converter, self.quantizer_step = VideoReformatter(), quantizer_step
        self._orientations: dict[float, tuple[int, int]] = {}

    def orientation(self, image: Any) -> tuple[int, int]:
        """Column order, 1 as stored or -1 mirrored, and the number of counter-clockwise quarter turns after it.

        The display matrix is read once per rotation: an image whose side data was read stays in memory until Python
        collects garbage.
        """
        rotation = image.rotation
        if rotation not in self._orientations:
            self._orientations[rotation] = _orientation(image)
        return self._orientations[rotation]


def _orientation(image: Any) -> tuple[int, int]:
    """`Display.orientation` by the display matrix of a decoded image."""
    from av.sidedata.sidedata import Type

    try:
        matrix = image.side_data.get(Type.DISPLAYMATRIX)
    except ValueError:  # it fails on side data of a kind that PyAV does not know, such as EXIF
        return 1, round(image.rotation / 90) % 4
    if matrix is None:
        return 1, 0
    a, b, _, c, d = np.frombuffer(matrix, np.int32)[:5].astype(float)  # x' = a x + c y, y' = b x + d y
    columns = 1 if a * d - b * c >= 0 else -1
    return columns, round(2 * math.atan2(c, columns * a) / math.pi) % 4


def upper_field(pixels: Pixels) -> Pixels:
    """The rows 0, 2, 4 .. of an image (H, W, ..) where they are, and between them the means of their neighbours."""
    field, whole = pixels[::2], pixels.copy()
    whole[1:-1:2] = cv2.addWeighted(field[:-1], 0.5, field[1:], 0.5, 0)
    if len(pixels) % 2 == 0:
        whole[-1] = field[-1]
    return whole


def _check(pixels: object) -> None:
    """Reject anything but 8-bit RGB and grey: 16-bit values, or floats between 0 and 1, would be misread."""
    given = f"an array {pixels.shape} of {pixels.dtype}" if isinstance(pixels, np.ndarray) else str(type(pixels))
    deep = isinstance(pixels, np.ndarray) and pixels.dtype == np.uint16
    upper = "; the upper 8 of 12 bits are (image >> 4).astype(np.uint8), those of 16 (image >> 8)" if deep else ""
    require(
        isinstance(pixels, np.ndarray)
        and pixels.dtype == np.uint8
        and (pixels.ndim == 2 or pixels.shape[2:] == (3,))
        and pixels.size > 0,
        f"the pixels of a frame are {given}; give an array (height, width, 3) of uint8 in RGB, "
        "as cv2.cvtColor(image, cv2.COLOR_BGR2RGB) makes from an image read with OpenCV, or (height, width) of uint8 "
        f"of a grey image{upper}",
    )


_CONVERTED, _UNSPECIFIED = (0, 1, 2, 4, 5, 6, 7, 9), 2
"""Colour spaces that FFmpeg converts to RGB, by their numbers in ITU-T H.273. It refuses others, such as YCgCo, ICtCp
and reserved numbers: read as the usual one, their colours are wrong, but their brightness nearly right."""
_converting = threading.Lock()
"""Frames of one video share a `Display` and may be converted in different threads."""


@cache
def _has_luma(name: str) -> bool:
    """Whether the first plane of an FFmpeg pixel format is 8-bit luma."""
    from av import VideoFormat

    pixels = VideoFormat(name)
    first = pixels.components[0]
    return name == "gray" or bool(pixels.is_planar and first.is_luma and first.plane == 0 and first.bits == 8)
