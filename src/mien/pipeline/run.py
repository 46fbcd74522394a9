"""A tracker over the frames of a start: backwards to where the face appears, and forwards to the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from mien.frame import Frame
from mien.registry import called, checked
from mien.start.first_frame import Start, before_landmarks
from mien.tracking.state import Estimate, Tracker
from mien.video import backwards

_FACELESS_SECONDS = 10.0
"""Backward tracking stops once the face has been lost for this long."""


def run_back(tracker: Tracker, begin: Start) -> Iterator[Estimate]:
    """Track backwards from the first frame until the face is lost for good; yields the estimates in that order."""
    if begin.since < begin.first.time:
        seen = begin.first.time
        _initialize(tracker, begin.first, begin)
        for frame in backwards(begin.footage.video, begin.since, begin.first.index):
            estimate = tracked(tracker, frame)
            yield estimate
            if estimate.status.success:
                seen = frame.time
            elif seen - frame.time > _FACELESS_SECONDS:
                return


def run(
    tracker: Tracker, begin: Start, earlier: Mapping[int, Estimate] = MappingProxyType({})
) -> Iterator[tuple[Frame, Estimate]]:
    """Track forwards; yields each frame with its estimate, before the first that of `run_back` by index."""
    for frame in begin.frames:
        if frame.index < begin.first.index:
            yield frame, earlier.get(frame.index) or before_landmarks(frame)
        elif frame.index == begin.first.index:
            yield frame, _initialize(tracker, frame, begin)
        else:
            yield frame, tracked(tracker, frame)


def _initialize(tracker: Tracker, frame: Frame, begin: Start) -> Estimate:
    with called(tracker):
        returned = tracker.initialize(frame, begin.landmarks, begin.camera)
    return checked(returned, tracker, frame)


def tracked(tracker: Tracker, frame: Frame) -> Estimate:
    """The estimate of a tracker for the next frame. Raises MienError if it gives none."""
    with called(tracker):
        returned = tracker.track(frame)
    return checked(returned, tracker, frame)
