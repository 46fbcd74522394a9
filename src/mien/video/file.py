"""A video file: what its header states, and the time stamps of its frames. Decoding itself is in `container.py`."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

from mien.errors import require, warn
from mien.frame import Decoded, Display, Frame
from mien.video.clock import Clock
from mien.video.container import DTS_ONLY, decoded_images, open_container, packets_from, shown_stream, start_of
from mien.video.folder import FOLDER_FPS
from mien.video.quantizer import quantizer_step
from mien.video.scaling import same_size

_MAXIMUM_ASPECT = 4.0
"""Pixel aspect ratio above which (or below whose inverse) the header is taken to be wrong."""
_MISSING_S = 0.2
"""Seconds without frames, on the way or at an end that is known, from which they are warned of in formats that state no
number of frames, where those that are damaged leave no other trace."""
_FASTEST, _FIRST_PACKETS = 250.0, 64
"""Frames per second up to which a header is believed, as what browsers record states a clock's 1000; and the number of
packets that are looked at otherwise."""


@dataclass(frozen=True)
class VideoFile:
    """A file that FFmpeg reads, with what its header states; 0 means not stated.

    begin, duration: seconds; declared: number of frames; aspect: width of a pixel over its height; may_jump: whether
    the container format allows files to be concatenated, so that time may jump back; exact: whether the duration is
    certainly not that of the sound; dts_only: whether the format is one of `DTS_ONLY`; start: seconds, see `start_of`.
    """

    path: Path
    fps: float
    begin: float
    duration: float
    declared: int
    aspect: float = 1.0
    may_jump: bool = False
    exact: bool = False
    dts_only: bool = False
    start: Fraction = Fraction(0)

    repeatable = True
    stopped = None

    @property
    def name(self) -> str:
        return str(self.path)

    @property
    def frame_count(self) -> int | None:
        return self.declared or round(self.duration * self.fps) or None

    def __iter__(self) -> Iterator[Frame]:
        return same_size(self._frames(), self.name)

    @cached_property
    def in_order(self) -> bool:
        """Whether time never jumps back; in concatenated files it does, and two frames may have the same time. If the
        format allows it, the packets of the whole file are read once to find out."""
        if not self.may_jump:
            return True
        with open_container(self.path) as container:
            last = -math.inf
            for packet in packets_from(container):
                if packet is None or (packet.dts is not None and packet.dts < last):
                    return False
                last = last if packet.dts is None else packet.dts
            return True

    def between(self, begin: float, until: float) -> Iterator[Frame]:
        """The frames in the closed interval [begin, until] (seconds), without index and in their original size.

        Decoding starts at the key frame before `begin`; in some containers seeking misses it, and frames are missing.
        """
        display, clock = self._display(), Clock(self.name, math.nan)
        for image in decoded_images(self.path, begin):
            time = math.nan if image is None else clock.time_of(*self._stated(image))
            if not time <= until:
                return
            if time >= begin:
                yield Frame(Decoded(image, display, self.aspect), time=time)

    def _frames(self) -> Iterator[Frame]:
        display = self._display()
        count, incomplete, invented, clock = 0, False, False, Clock(self.name, self.begin)
        for image in decoded_images(self.path):
            if image is None:
                incomplete = True
                continue
            time = clock.time_of(*self._stated(image))
            # Not by the errors that libav logs: sound recordings that begin between two key frames have many.
            if image.is_corrupt and not invented:
                invented = True
                warn(
                    f"{self.path} is damaged, first at about {time:.2f} s; the decoder invents what is missing, so "
                    "that poses may be wrong there at a high confidence; copy the file again from where it was recorded"
                )
            yield Frame(Decoded(image, display, self.aspect), count, time)
            count += 1
        require(
            count > 0,
            f"{self.path}: no frame could be decoded; the file is empty, damaged, or of a kind that is not supported; "
            "convert it to MP4",
        )
        if incomplete or self._ends_early(count, clock.until):
            of = f" of {self.declared}" if self.declared else ""
            warn(f"{self.path} is truncated or damaged: {count}{of} frames were decoded, to {clock.time:.2f} s")
        elif self.may_jump and clock.missing > _MISSING_S:
            where = f"the first after {clock.missing_from:.2f} s"
            warn(f"{self.path}: {clock.missing:.2f} s of it have no frames, {where}; it may be damaged, or cut")

    def _display(self) -> Display:
        """What its images share. They tell the container's time; here it counts from where the file starts."""
        start = float(self.start)
        return Display(lambda time: quantizer_step(self.path, time - start))

    def _stated(self, image: Any) -> tuple[float | None, float]:
        """When an image is shown, None if that is not stated, and for how long, in seconds."""
        if self.dts_only:  # that of the packet with which an image came: they come in the order in which they are shown
            ticks, duration = image.dts, 0
        else:
            ticks, duration = image.pts, image.duration
        time = None if ticks is None else float(ticks * image.time_base - self.start)
        return time, float(duration * image.time_base) if duration else 1 / self.fps

    def _ends_early(self, count: int, until: float) -> bool:
        """Whether frames are missing after `until`."""
        missing = self.begin + self.duration - until
        if self.declared == 0:
            return missing > (_MISSING_S if self.exact else max(1.0, 0.05 * self.duration))
        # A part that was cut out without decoding has frames before it that count, but are not shown.
        return missing * self.fps > max(0.5, 0.5 * (self.declared - count)) and count < self.declared


def open_file(path: Path) -> VideoFile:
    """A video file with what its header states. Raises MienError if it is not a video."""
    with open_container(path) as container:
        stream = shown_stream(container)
        stated = float(stream.average_rate or stream.guessed_rate or FOLDER_FPS)
        fps = _rate(container, stated)
        # Where the header counts the ticks of a clock as frames, it does so in the number of frames as well.
        declared = int(stream.frames) if fps > 0.9 * stated else 0
        start = start_of(container)
        begin = float(stream.start_time * stream.time_base - start) if stream.start_time else 0.0
        length = stream.duration * stream.time_base if stream.duration else (container.duration or 0) * 1e-6
        if container.format.name == "avi" and stream.frames:  # FFmpeg shortens the duration of a truncated file
            length = stream.frames / stated
        matroska, tagged = "matroska" in container.format.name, _tagged_end(stream)
        if matroska:  # its duration is the end time of the last frame, or of the sound if that is longer
            length = max((tagged or length) - start - begin, 0)
        aspect = float(stream.sample_aspect_ratio or 1)
        aspect = aspect if 1 / _MAXIMUM_ASPECT <= aspect <= _MAXIMUM_ASPECT else 1.0
        may_jump = not (stream.frames or matroska)
        exact = matroska and (tagged is not None or len(container.streams) == 1)
        dts_only = container.format.name in DTS_ONLY
        return VideoFile(path, fps, begin, float(length), declared, aspect, may_jump, exact, dts_only, start)


def _tagged_end(stream: Any) -> float | None:
    """The end time in seconds that the tags of a Matroska stream state, None if they do not."""
    stated = next((text for name, text in stream.metadata.items() if name.startswith("DURATION")), "")
    parts = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stated)
    return None if parts is None else 3600 * float(parts[1]) + 60 * float(parts[2]) + float(parts[3])


def _rate(container: Any, stated: float) -> float:
    """Frames per second as the header states them; if they are too many to be believed, as the first frames show."""
    if stated <= _FASTEST:
        return stated
    packets = itertools.islice(packets_from(container), _FIRST_PACKETS)
    stamped = (packet for packet in packets if packet is not None and packet.pts is not None)
    times = sorted(float(packet.pts * packet.time_base) for packet in stamped)
    steps = [later - before for before, later in itertools.pairwise(times) if later > before]
    return 1 / median(steps) if steps else stated
