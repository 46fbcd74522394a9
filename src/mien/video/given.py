"""Sources without a file: a camera, and frames that a program reads itself; their `path` is None."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.errors import require, warn
from mien.frame import Frame
from mien.video.clock import Clock
from mien.video.opencv_log import opencv_silenced
from mien.video.scaling import same_size

_USUAL_FPS = 30.0
_INTERVALS, _LONGEST_S = 10, 5.0
"""Number of intervals between the first frames, and the median in seconds from which they are taken to be in another
unit: nobody follows a face with an image every five seconds, but with 200 a second."""
_LARGEST = 2**31 - 1
"""The largest number of a camera that OpenCV can be asked for."""
_RECENT = 31
"""Number of the last times that tell how long a frame takes whose own is wrong."""


@dataclass(eq=False)
class CameraDevice:
    """A camera by its number; times are seconds since its first frame. Iteration ends, with a warning, when the camera
    gives no more images; `stopped` then says so."""

    number: int
    stopped: str | None = None

    path = None
    repeatable = False
    frame_count = None
    fps = _USUAL_FPS
    begin = 0.0

    @property
    def name(self) -> str:
        return f"camera {self.number}"

    def __iter__(self) -> Iterator[Frame]:
        missing = f"camera {self.number} cannot be opened; check that it is connected"
        require(abs(self.number) <= _LARGEST, missing)
        with opencv_silenced():
            device = cv2.VideoCapture(self.number)
        try:
            require(device.isOpened(), missing)
            yield from same_size(self._frames_of(device), self.name)
        finally:
            device.release()

    def _frames_of(self, device: cv2.VideoCapture) -> Iterator[Frame]:
        """The frames of a device that is open, in the sizes that it gives them."""
        first = now = 0.0
        for index in itertools.count():
            image = _next_image(device)
            if image is None:
                require(index > 0, f"camera {self.number} gives no image; check that no other program uses it")
                self.stopped = f"camera {self.number} gives no more images after {now - first:.2f} s"
                warn(f"{self.stopped}, which ends the track; check its cable, and that no other program uses it")
                return
            now = perf_counter()
            first = first if index else now
            yield Frame(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), index, now - first)


def _next_image(device: cv2.VideoCapture) -> NDArray[Any] | None:
    """The next image of a device; None if it gives none, or an empty one, or its driver fails, as some do when their
    camera is unplugged."""
    try:
        success, image = device.read()
    except cv2.error:
        return None
    return image if success and image is not None and image.size else None


@dataclass(frozen=True)
class GivenFrames:
    """Frames that a program reads itself: all of them in a sequence, which is read again like a file, or one after the
    other, like those of a camera."""

    frames: Iterable[Frame]

    path = None
    name = "the frames"
    stopped = None

    @property
    def repeatable(self) -> bool:
        return isinstance(self.frames, Sequence)

    @property
    def frame_count(self) -> int | None:
        return len(self.frames) if isinstance(self.frames, Sequence) else None

    @cached_property
    def fps(self) -> float:
        """By the times of a sequence, else unknown and taken to be `_USUAL_FPS`."""
        stated = [frame.time for frame in self.frames if isinstance(frame, Frame)] if self.repeatable else []
        step = float(np.median(np.diff(stated))) if len(stated) > 1 else math.nan
        return 1 / step if 0 < step < math.inf else _USUAL_FPS

    @property
    def begin(self) -> float:
        first = self.frames[0] if isinstance(self.frames, Sequence) and self.frames else None
        return first.time if isinstance(first, Frame) and math.isfinite(first.time) else 0.0

    def __iter__(self) -> Iterator[Frame]:
        return same_size(_in_seconds(self._checked(), self.name), self.name)

    def _checked(self) -> Iterator[Frame]:
        last, clock, regular, stated = -1, Clock(self.name), True, deque[float](maxlen=_RECENT)
        for frame in self.frames:
            require(
                isinstance(frame, Frame), f"{type(frame)} is no frame; give each as mien.Frame(pixels, index, time)"
            )
            require(frame.index >= 0, f"a frame has the index {frame.index}; count them from 0")
            require(
                last >= 0 or math.isfinite(frame.time),
                f"the first frame has the time {frame.time:g} s; give each frame its time in seconds, as in "
                "mien.Frame(pixels, index, time.perf_counter())",
            )
            before = clock.time
            index, time = max(frame.index, last + 1), clock.time_of(frame.time, _step(stated, 1 / self.fps))
            if math.isfinite(frame.time):
                stated.append(frame.time)
            if (index, time) == (frame.index, frame.time):
                yield frame
            else:
                if regular:
                    warn(
                        f"{self.name}: frame {frame.index} at {frame.time:g} s comes after frame {last} at "
                        f"{before:g} s; it is counted on from there. Give each the next index and a later time, as in "
                        "mien.Frame(pixels, index, time.perf_counter())"
                    )
                regular = False
                yield Frame(frame.image, index, time)
            last = index


def _step(stated: Sequence[float], longest: float) -> float:
    """Seconds from one frame to the next by the last times stated, at most `longest`: counted on in larger steps, time
    would run ahead of a camera that is faster, which repeats a single time stamp or has a coarse clock."""
    advances = [max(after - before, 0.0) for before, after in itertools.pairwise(stated)]
    return min(sum(advances) / len(advances), longest) if any(advances) else longest


def _in_seconds(frames: Iterator[Frame], name: str) -> Iterator[Frame]:
    """The frames; warns if the first intervals between them are longer than those of a video in seconds."""
    times: list[float] = []
    for frame in frames:
        if len(times) <= _INTERVALS:
            times.append(frame.time)
            step = float(np.median(np.diff(times))) if len(times) == _INTERVALS + 1 else 0.0
            if step > _LONGEST_S:
                warn(
                    f"{name}: {step:.3g} s lie between each and the next, too long to follow a face; if their times "
                    "are milliseconds, divide them by 1000: mien takes seconds"
                )
        yield frame
