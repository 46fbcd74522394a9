"""A rendered face in a small known motion, for the tests of the trackers."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

import cv2
import numpy as np

from mien.arrays import Array, Pixels
from mien.config import RealtimeSettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between
from mien.initialization.landmarks import place_of
from mien.synthetic import Portrait, SyntheticSequence, make_sequence, moved, portrait
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate, Tracker

ANGLES_DEG = np.array([4.0, -8.0, 5.0])
SHIFT = np.array([0.06, -0.04, 0.1])
STEPS = 3


@cache
def face() -> Portrait:
    """The portrait, which takes a second to read."""
    return portrait()


def small_motion(blank: Collection[int] = ()) -> SyntheticSequence:
    """The face as it is, then in three steps to ANGLES_DEG and SHIFT; frames that are `blank` are black."""
    along = np.linspace(0, 1, STEPS + 1)[:, None]
    states = moved(face(), along * ANGLES_DEG, along * SHIFT, np.zeros((STEPS + 1, 6)))
    return make_sequence(face(), states, noise_sd=2, blank=blank)


def turned_portrait(deg: float) -> tuple[Pixels, Array]:
    """The first frame of the small motion turned about its face, and the (2, 3) matrix that does it."""
    pixels, ((x, y), _) = small_motion().frames[0].pixels, place_of(face().landmarks.points)
    A = cv2.getRotationMatrix2D((x, y), deg, 1.0)
    return np.asarray(cv2.warpAffine(pixels, A, pixels.shape[1::-1], borderMode=cv2.BORDER_REPLICATE), np.uint8), A


def seen_by_turned(frame: Frame, camera: Camera, R: Array) -> tuple[Pixels, Array]:
    """What a camera sees of a frame once it has turned by R (3, 3), and the homography (3, 3) that moves its image."""
    homography = camera.matrix @ R @ np.linalg.inv(camera.matrix)
    size = frame.width, frame.height
    seen = cv2.warpPerspective(frame.pixels, homography, size, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.uint8), homography


def with_border(frame: Frame, across: int, down: int) -> Frame:
    """A frame with a border of so many pixels, which repeats its outermost ones, on either side."""
    wide = cv2.copyMakeBorder(frame.pixels, down, down, across, across, cv2.BORDER_REPLICATE)
    return Frame(np.asarray(wide, np.uint8), frame.index, frame.time)


def begun(first: Frame, settings: RealtimeSettings | None = None) -> RealtimeTracker:
    """The real-time tracker, which has learned the portrait in a frame."""
    tracker = RealtimeTracker(settings)
    tracker.initialize(first, face().landmarks, face().camera)
    return tracker


def run(tracker: Tracker, sequence: SyntheticSequence) -> list[Estimate]:
    """Estimates of all frames, from the portrait's landmarks on the first."""
    first = tracker.initialize(sequence.frames[0], face().landmarks, face().camera)
    return [first, *(tracker.track(frame) for frame in sequence.frames[1:])]


def errors_deg(estimates: list[Estimate], truth: SyntheticSequence) -> Array:
    """(n,) angles in degrees between the turn since the first frame and the true one; NaN where lost."""
    R = np.stack([np.full((3, 3), np.nan) if e.rotation is None else e.rotation for e in estimates])
    assert np.isfinite(R[0]).all()
    return np.asarray(np.degrees(angle_between(R @ R[0].T, truth.R @ truth.R[0].T)))


def errors_of_all_deg(estimates: list[Estimate], truth: SyntheticSequence) -> Array:
    """The same (n,) of a track that has lost no frame."""
    errors = errors_deg(estimates, truth)
    assert np.isfinite(errors).all(), [e.reason for e in estimates]
    return errors
