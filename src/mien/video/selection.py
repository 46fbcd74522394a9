"""Which frames of a source are read, and in which order: between two times, backwards, or a single one again."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Generator, Iterator, Sequence

from mien.errors import require
from mien.frame import Frame
from mien.video.file import VideoFile
from mien.video.source import Video
from mien.video.straight import StraightVideo

BUFFER_BYTES = 1 << 29
"""Memory, in bytes, for the frames that are buffered to play a video backwards."""
SAME_TIME = 1e-6
"""Times in seconds that differ by less are the same: tables round them to six digits."""


def check_interval(start: float | None, end: float | None) -> None:
    """Raise MienError if the interval between two times in seconds is empty."""
    require(start is None or end is None or start < end, f"the start {start} s must come before the end {end} s")


def select(video: Video, start: float | None = None, end: float | None = None) -> Generator[Frame, None, None]:
    """The frames in the half-open interval `start <= time < end` (seconds), with their indices in the whole video; a
    frame is at its time stamp also as tables round it.

    Frames before `start` are decoded and skipped, so that indices stay exact. Raises MienError if the interval is
    empty or contains no frame.
    """
    check_interval(start, end)
    last, found, ended = -math.inf, False, False
    for frame in video:
        last = frame.time
        ended = end is not None and last > end - SAME_TIME
        if ended:
            break
        if start is None or last > start - SAME_TIME:
            found = True
            yield frame
    after = "" if start is None else f" from {start:g} s" + (" on" if end is None else "")
    before = "" if end is None else f" before {end:g} s"
    require(found or last > -math.inf, f"{video.name}: there is no frame")
    nearest = "the next" if ended else "its last"
    require(found, f"{video.name} has no frame{after}{before}; {nearest} is at {last:g} s")


def backwards(video: Video, begin: float, end: int) -> Iterator[Frame]:
    """The frames with `time >= begin` (seconds, as in `select`) and `index < end`, in reverse order.

    At most `BUFFER_BYTES` of frames are buffered at a time; a longer interval is decoded again in parts.
    """
    remaining: list[tuple[int, float]] = []
    buffer: deque[Frame] = deque()
    for frame in video:
        if frame.index >= end:
            break
        if frame.time > begin - SAME_TIME:
            remaining.append((frame.index, frame.time))
            buffer.append(frame)
            if len(buffer) > 1 and len(buffer) * 3 * frame.height * frame.width > BUFFER_BYTES:
                buffer.popleft()
    capacity = len(buffer)
    while buffer:
        remaining = remaining[: -len(buffer)]
        size = buffer[0].height, buffer[0].width
        while buffer:
            yield buffer.pop()
        buffer.extend(_decode_frames(video, remaining[-capacity:], size))


def decode_frame(video: Video, like: Frame, index: int, time: float) -> Frame:
    """Decode the frame with this index and time (seconds), in the size of the frame `like`, if possible from the
    nearest key frame. Raises MienError if it is no longer there."""
    found = _decode_frames(video, [(index, time)], (like.height, like.width))
    gone = f"{video.name}: its frame at {time:.2f} s can no longer be read; leave it unchanged while it is tracked"
    require(bool(found), gone)
    return found[0]


def _decode_frames(video: Video, stamps: Sequence[tuple[int, float]], size: tuple[int, int]) -> list[Frame]:
    """Decode the frames with these indices and times: from the nearest key frame, or from the beginning if time jumps
    back or seeking does not find them all."""
    if not stamps:
        return []
    if isinstance(video, StraightVideo):
        return [video.straight(frame) for frame in _decode_frames(video.video, stamps, size)]
    indices, times = zip(*stamps, strict=True)
    if isinstance(video, VideoFile) and video.in_order:
        found = list(video.between(times[0], times[-1]))
        if [f.time for f in found] == list(times) and all((f.height, f.width) == size for f in found):
            return [Frame(f.image, index, f.time) for f, index in zip(found, indices, strict=True)]
    until = itertools.takewhile(lambda frame: frame.index <= indices[-1], video)
    wanted = set(indices)
    return [frame for frame in until if frame.index in wanted]


def expected_count(video: Video, start: float | None = None, end: float | None = None) -> int | None:
    """Approximate number of frames that `select` will yield; None if unknown."""
    if video.frame_count is None:
        return None
    origin = video.begin + SAME_TIME
    first = 0.0 if start is None else (start - origin) * video.fps
    stop = math.inf if end is None else (end - origin) * video.fps
    first, stop = (min(max(number, 0.0), video.frame_count) for number in (first, stop))  # they may be infinite
    return max(math.ceil(stop) - math.ceil(first), 1)
