"""Where faces are seen in a video, and which sightings in succession are one appearance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mien.arrays import Array
from mien.initialization.landmarks import SAME_PLACE, Landmarks, is_same_place, place_of
from mien.start.footage import Footage
from mien.start.search import sampled_frames

_FAR = 1.5
"""The distance for a second sighting, which shows how fast the face moves."""
_ELSEWHERE = 1e9
"""A distance in pixels beyond any in an image."""
_GAP_SECONDS = 2.0
"""Longest gap between detections at the same place that count as the same face."""


@dataclass(frozen=True)
class Sighting:
    """A face detected in a frame: index and time (seconds) of the frame, centre (2,) and larger side in pixels, and the
    number of cuts before the frame: after a cut, a face at the same place is a different one."""

    index: int
    time: float
    centre: Array
    size: float
    cuts: int = 0

    def is_at(self, other: Sighting, within: float = SAME_PLACE) -> bool:
        """Whether it has about the position and the size of another. within: sizes of the face."""
        return bool(is_same_place(self.centre, self.size, other.centre, other.size, within))

    def distance_after(self, before: Sequence[Sighting]) -> float:
        """Distance in pixels from where a face with these sightings, shortly before, was last, or would be if it went
        on; infinite if it is another face. A second sighting may be further away."""
        last = before[-1]
        if not 0 < self.time - last.time < _GAP_SECONDS or self.cuts != last.cuts:
            return math.inf
        places, within = [last], _FAR
        if len(before) > 1:
            velocity = (last.centre - before[-2].centre) / (last.time - before[-2].time)
            places.append(replace(last, centre=last.centre + velocity * (self.time - last.time)))
            within = SAME_PLACE
        distances = [np.linalg.norm(place.centre - self.centre) for place in places if self.is_at(place, within)]
        return float(min(distances, default=math.inf))


def detections_in(footage: Footage) -> Iterator[list[Sighting]]:
    """The detected faces, twice a second, the largest first."""
    from mien.initialization.detector import detect_all

    for cuts, frame in sampled_frames(footage):
        yield [replace(sighting_of(face), cuts=cuts) for face in detect_all(frame)]


def sighting_of(face: Landmarks) -> Sighting:
    """The sighting of a detected face, with the centre and size of its tracked landmarks."""
    return Sighting(face.frame_index, face.time, *place_of(face.correspondences()[1]))


def appearances_in(detections: Sequence[list[Sighting]]) -> list[list[Sighting]]:
    """Group consecutive sightings in about the same place."""
    from scipy.optimize import linear_sum_assignment

    found: list[list[Sighting]] = []
    for sightings in detections:
        distance = np.array([[seen.distance_after(before) for before in found] for seen in sightings])
        distance = distance.reshape(len(sightings), len(found))
        pairs = zip(*linear_sum_assignment(np.minimum(distance, _ELSEWHERE)), strict=True)
        before = {i: found[j] for i, j in pairs if distance[i, j] < _ELSEWHERE}
        for i, seen in enumerate(sightings):
            if i in before:
                before[i].append(seen)
            else:
                found.append([seen])
    # A single detection may be a false positive, but in a video of short shots, or a damaged one, all are single.
    return [one for one in found if len(one) > 1] or found
