"""A tracker over the frames of a start: backwards to where the face appears, and forwards to the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from mien.frame import Frame
from mien.registry import checked
from mien.start.first_frame import Start, before_landmarks
from mien.tracking.state import Estimate, Tracker
from mien.video import backwards

_FACELESS_SECONDS = 10.0
"""Backward tracking stops once the face has been lost for this long."""


def run_back(tracker: Tracker, begin: Start) -> Iterator[Estimate]:
    """Track backwards from the first frame until the face is lost for good; yields the estimates in that order."""
    if begin.since < begin.first.time:
        seen = begin.first.time
        checked(tracker.initialize(begin.first, begin.landmarks, begin.camera), tracker, begin.first)
        for frame in backwards(begin.footage.video, begin.since, begin.first.index):
            estimate = checked(tracker.track(frame), tracker, frame)
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
            yield frame, checked(tracker.initialize(frame, begin.landmarks, begin.camera), tracker, frame)
        else:
            yield frame, checked(tracker.track(frame), tracker, frame)
