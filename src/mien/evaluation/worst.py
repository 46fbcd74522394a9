"""The frames with the largest errors of a tracker."""

from __future__ import annotations

import numpy as np

from mien.arrays import Array
from mien.evaluation.datasets.sequence import Truth
from mien.evaluation.metrics import landmark_rms
from mien.evaluation.points12 import points_of_names, points_of_scheme
from mien.evaluation.protocols import Protocol, compare
from mien.evaluation.results import TrackTable

WORST_FRAMES = 20
"""Number of frames whose images a result stores; a contact sheet shows as many, which may all be of one sequence."""


def worst_frames(track: TrackTable, truth: Truth) -> tuple[int, ...]:
    """The `WORST_FRAMES` frames with the largest of the `frame_errors`. In longer videos, of neighbouring frames, which
    look alike, only the worst is taken."""
    errors = frame_errors(track, truth)
    remaining, spacing = np.where(np.isfinite(errors), errors, -1.0), max(1, len(errors) // (2 * WORST_FRAMES))
    chosen: list[int] = []
    while len(chosen) < WORST_FRAMES and remaining.max() >= 0:
        worst = int(np.argmax(remaining))
        chosen.append(worst)
        remaining[max(0, worst - spacing + 1) : worst + spacing] = -1.0
    return tuple(chosen)


def frame_errors(track: TrackTable, truth: Truth) -> Array:
    """Errors (n,): of the rotation in degrees or, where none can be compared, of the twelve points in pixels; NaN if
    unknown."""
    first = int(np.argmax(truth.known))
    if truth.has_pose and np.isfinite(track.rotation[: first + 1]).all(axis=(1, 2)).any():
        return compare(Protocol.REBASED, truth, track.rotation).rotation_error_deg
    points = points_of_names(track.landmarks, track.landmark_names)
    if truth.landmarks is None or points is None:
        return np.full(track.frames, np.nan)
    return landmark_rms(points, points_of_scheme(truth.landmarks, truth.landmark_scheme))
