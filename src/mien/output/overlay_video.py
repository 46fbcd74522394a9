"""The overlay video: an MP4 that keeps the time of every frame, and is known again as mien's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np

from mien.arrays import Pixels
from mien.errors import MienError, interruption, warn
from mien.files import create_temporary, move_into_place, named_errors, reason_of

_LARGEST_SIDE = 16384
"""Width and height, in pixels, beyond which the encoder takes no image: larger ones are scaled down."""
TIME_BASE = Fraction(1, 90_000)
_LONGEST = 2**28 // 6
"""Ticks from one frame to the next that every player shows, eight minutes. Before FFmpeg 8 it forgets the order of all
frames where one is displayed more than 2^28 ticks after it is decoded, which can be five frames earlier."""
_COMMENT = "overlay by mien"


class OverlayWriter:
    """Writes an H.264 video to an MP4 file that keeps the time of every frame; the file gets its name when closed.

    with OverlayWriter(path) as writer:
        writer.write(pixels, time)
    The first image sets the size; odd sizes lose their last row or column, as the format needs even ones, and what is
    larger than the encoder allows is scaled down. A gap that players may not show is shown as one second, with a
    warning.
    """

    def __init__(self, path: Path, begins: float | None = None, comment: str = _COMMENT) -> None:
        """begins: time in seconds at which the video begins, by default that of the first image; comment: what the file
        states of itself, by default that it is an overlay."""
        self.path = path
        self._last_pts, self._begins, self._refused = -1, begins, False
        with _named_errors(self.path):
            self._temporary = create_temporary(path)
            try:
                self._container = av.open(str(self._temporary), "w", format="mp4")
                self._container.metadata["comment"] = comment
                self._stream = self._container.add_stream("libx264", options={"crf": "18", "preset": "veryfast"})
            except BaseException:
                self._temporary.unlink()
                raise
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = TIME_BASE

    def __enter__(self) -> OverlayWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(keep=error is None or isinstance(interruption(error), KeyboardInterrupt))

    def write(self, pixels: Pixels, time: float) -> None:
        """Append (H, W, 3) RGB pixels, displayed from `time` (seconds) on."""
        if self._begins is None:
            self._begins = time
        pixels = _no_larger(pixels)
        if self._last_pts < 0:
            self._stream.height, self._stream.width = pixels.shape[0] // 2 * 2, pixels.shape[1] // 2 * 2
        even = np.ascontiguousarray(pixels[: self._stream.height, : self._stream.width])
        picture = av.VideoFrame.from_ndarray(even, format="rgb24")
        # The format needs increasing times: a frame that repeats the time of the previous one gets the next tick.
        self._last_pts = max(self._ticks(time, self._begins), self._last_pts + 1)
        picture.pts, picture.time_base = self._last_pts, TIME_BASE
        with _named_errors(self.path):
            self._append(picture)

    def _ticks(self, time: float, begins: float) -> int:
        """When a frame of this time is displayed, in a video that begins at another one, both in seconds."""
        ticks = round((time - begins) / TIME_BASE)
        gap = ticks - self._last_pts
        if gap <= _LONGEST:
            return ticks
        second = round(1 / TIME_BASE)
        warn(
            f"{self.path}: {float(gap * TIME_BASE):.0f} s lie between two frames, up to {time:.2f} s, more than "
            "players are sure to show; they are shown as one second"
        )
        self._begins = begins + float((gap - second) * TIME_BASE)
        return self._last_pts + second

    def close(self, keep: bool = True) -> None:
        """Finish the file and give it its name, or remove it. A video without frames leaves no file."""
        try:
            with _named_errors(self.path):
                if self._last_pts >= 0 and not self._refused:
                    self._append(None)
                self._container.close()
                if self._last_pts >= 0 and keep:
                    move_into_place(self._temporary, self.path)
        finally:
            self._temporary.unlink(missing_ok=True)

    def _append(self, picture: av.VideoFrame | None) -> None:
        """Encode a picture, or at the end what the encoder still holds. Nothing may follow what was refused, as by a
        full disk: FFmpeg crashes where it has failed to write the header."""
        try:
            self._container.mux(self._stream.encode(picture))
        except (av.FFmpegError, OSError):
            self._refused = True
            raise


def is_overlay(path: Path) -> bool:
    """Whether a file states that it is an overlay of mien."""
    return comment_of(path) == _COMMENT


def comment_of(path: Path) -> str | None:
    """What a video states of itself; None if it states nothing, or is no video."""
    try:
        with av.open(str(path.absolute())) as container:
            comment: str | None = container.metadata.get("comment")
            return comment
    except (av.FFmpegError, OSError, ValueError):
        return None


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    """As `named_errors`, also for what FFmpeg refuses."""
    try:
        with named_errors(path):
            yield
    except av.FFmpegError as error:
        raise MienError(
            f"{path} cannot be encoded ({reason_of(error)}); scale the video down, or omit the overlay"
        ) from error


def _no_larger(pixels: Pixels) -> Pixels:
    """An image (H, W, 3), scaled down if the encoder does not take one of its size."""
    height, width = pixels.shape[:2]
    scale = _LARGEST_SIDE / max(height, width)
    if scale >= 1:
        return pixels
    size = (round(scale * width), round(scale * height))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
