"""Faces that are tracked: in which frames each is where, and which of them has a face that several tracks have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mien.arrays import Mask
from mien.errors import require
from mien.faces.sightings import Sighting
from mien.geometry.camera import Camera
from mien.initialization.landmarks import is_same_place
from mien.output.track import Track
from mien.start.first_frame import CONFIDENT
from mien.tracking.state import Tracker

LEAST_SECONDS = 1.0
"""Shortest time for which a track must have a face that no other track has."""


@dataclass(frozen=True)
class TrackedFace:
    """A face: its track, its box in each frame, and the tracker and the camera for drawing it."""

    track: Track
    boxes: FaceBoxes
    tracker: Tracker
    camera: Camera


class FaceBoxes:
    """Centre (n, 2) and larger side (n,) of the face of a track in each frame, in pixels, NaN where it is lost, and its
    confidence (n,)."""

    def __init__(self, track: Track) -> None:
        points = track.landmarks
        require(points is not None, "this preset gives no landmarks, which --faces needs; choose another preset")
        assert points is not None
        self.index, self.confidence = track.index, track.confidence
        low, high = points.min(axis=1), points.max(axis=1)
        self.centre, self.size = 0.5 * (low + high), (high - low).max(axis=1)

    def has(self, seen: Sighting) -> bool:
        """Whether the track has the detected face, with confidence."""
        row = int(np.searchsorted(self.index, seen.index))  # images that cannot be read leave gaps
        here = replace(seen, centre=self.centre[row], size=float(self.size[row]))
        return bool(self.confidence[row] > CONFIDENT) and here.is_at(seen)

    def taken_by(self, other: FaceBoxes, earlier: bool) -> Mask:
        """The frames (n,) in which another track, an earlier or a later one, has the same face with a higher
        confidence; the earlier one also with the same, as some trackers estimate none."""
        same = is_same_place(self.centre, self.size, other.centre, other.size)
        higher = other.confidence >= self.confidence if earlier else other.confidence > self.confidence
        return np.asarray(same & higher)


def unknown_part(appearance: Sequence[Sighting], faces: Sequence[TrackedFace]) -> list[Sighting]:
    """The part of an appearance in which no track has the face: all of it, the longest one of at least a second, where
    people have passed each other, or none."""
    runs: list[list[Sighting]] = [[]]
    for seen in appearance:
        if is_known(seen, faces):
            runs.append([])
        else:
            runs[-1].append(seen)
    longest = max(runs, key=len)
    whole = len(longest) == len(appearance)
    lasts = bool(longest) and longest[-1].time - longest[0].time >= LEAST_SECONDS
    return longest if whole or lasts else []


def is_known(seen: Sighting, faces: Sequence[TrackedFace]) -> bool:
    """Whether a track has the face of a sighting."""
    return any(face.boxes.has(seen) for face in faces)


def without_other_faces(face: TrackedFace, all_faces: Sequence[TrackedFace]) -> Track:
    """The track of a face, lost in the frames in which it has the face of another track."""
    reasons: list[str | None] = [None] * len(face.track)
    earlier = True  # a face that is not yet among them comes after them all
    for other in all_faces:
        if other is face:
            earlier = False
            continue
        for k in np.flatnonzero(face.boxes.taken_by(other.boxes, earlier)):
            reasons[k] = f"face {other.track.metadata['face_id']} is here"
    return face.track.without(reasons)
