"""A video through a lens that bends straight lines, as a pinhole camera would have filmed it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mien.arrays import Pixels
from mien.frame import Frame, Recorded
from mien.lens import Lens
from mien.video.source import Video


@dataclass(frozen=True)
class StraightVideo:
    """The frames of a video, straightened; everything else is the video's own."""

    video: Video
    lens: Lens

    @property
    def name(self) -> str:
        return self.video.name

    @property
    def path(self) -> Path | None:
        return self.video.path

    @property
    def repeatable(self) -> bool:
        return self.video.repeatable

    @property
    def fps(self) -> float:
        return self.video.fps

    @property
    def begin(self) -> float:
        return self.video.begin

    @property
    def frame_count(self) -> int | None:
        return self.video.frame_count

    @property
    def stopped(self) -> str | None:
        return self.video.stopped

    def __iter__(self) -> Iterator[Frame]:
        return map(self.straight, self.video)

    def straight(self, frame: Frame) -> Frame:
        """A frame of the video, straightened once its pixels are asked for."""
        return Frame(_Straightened(frame, self.lens), frame.index, frame.time)


@dataclass(frozen=True)
class _Straightened(Recorded):
    """The image of a frame, straightened."""

    frame: Frame
    lens: Lens

    @property
    def shape(self) -> tuple[int, int]:
        return self.frame.height, self.frame.width

    @property
    def interlaced(self) -> bool:
        return self.frame.interlaced

    def quantizer_step(self) -> float | None:
        return self.frame.quantizer_step

    def rgb(self) -> Pixels:
        return self.lens.straighten(self.frame.pixels)

    def luma(self) -> Pixels | None:
        return None if self.frame.luma is None else self.lens.straighten(self.frame.luma)
