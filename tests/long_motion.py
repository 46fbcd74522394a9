"""A rendered face that looks about and speaks, for the tests of the two presets."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_VERTICES
from mien.synthetic import FPS, SyntheticSequence, make_sequence, moved
from small_motion import face

FRAMES = 40
NOISE_SD = 2.0


def states(frames: int = FRAMES, share: float = 1.0) -> Array:
    """States (n, 12): pan to 25 degrees, tilt to 10, roll to 12, a shift and an open mouth, back where it began;
    of all of it a share."""
    phase = np.linspace(0, 2 * np.pi, frames)[:, None]
    animation = np.zeros((frames, 6))
    animation[:, TRACKED_UNITS.index("jaw_drop")] = 0.25 * (1 - np.cos(2 * phase[:, 0]))
    angles, shift = np.sin(phase * [1, 1, 2]) * [-10.0, 25, 12], np.sin(phase) * [0.15, 0.05, 0.2]
    return moved(face(), share * angles, share * shift, share * animation)


@cache
def sequence() -> SyntheticSequence:
    """The face in these states, with the noise of a camera."""
    return make_sequence(face(), states(), noise_sd=NOISE_SD)


@cache
def gentle_sequence() -> SyntheticSequence:
    """The same at half the size: what the simplex follows with the evaluations that it has."""
    return make_sequence(face(), states(share=0.5), noise_sd=NOISE_SD)


@cache
def with_spectacles() -> SyntheticSequence:
    """The face of `sequence()` with dark rims, which stand a sixth of a unit off the eyes."""
    fit, camera, angles = face().fit, face().camera, np.linspace(0, 2 * np.pi, 40)
    vertices = fit.vertices()
    rims = []
    for side in ("left", "right"):
        inner, outer = (vertices[LANDMARK_VERTICES[f"{side}_eye_{corner}_corner"]] for corner in ("inner", "outer"))
        radius = 0.75 * np.linalg.norm(outer - inner)
        ring = np.stack([radius * np.cos(angles), 0.8 * radius * np.sin(angles), np.full(40, 1 / 6)], axis=1)
        rims.append(0.5 * (inner + outer) + ring)
    frames = []
    for frame, R, t in zip(sequence().frames, sequence().R, sequence().t, strict=True):
        pixels = frame.pixels.copy()
        for rim in rims:
            p = camera.project(rim @ R.T + t)[0]
            cv2.polylines(pixels, [np.round(16 * p).astype(np.int32)], True, (30, 25, 25), 2, cv2.LINE_AA, shift=4)
        frames.append(Frame(pixels, frame.index, frame.time))
    return shown(frames)


@cache
def leaving(across: float, down: float, frames: int = 14) -> SyntheticSequence:
    """The face moves so many units across and down, out of the image, stays for a few frames, and comes back."""
    there = np.linspace(0, 1, frames)
    along = np.concatenate([there, np.ones(3), there[::-1], np.zeros(3)])[:, None]
    still = np.zeros((len(along), 3))
    return make_sequence(face(), moved(face(), still, along * [across, down, 0], np.tile(still, 2)), noise_sd=NOISE_SD)


def shown(frames: Sequence[Frame], of: Sequence[int] | None = None) -> SyntheticSequence:
    """`sequence()` with other pictures, whose truth is that of the frames `of`; the pictures are numbered anew."""
    truth, rows = sequence(), list(range(len(frames)) if of is None else of)
    numbered = tuple(Frame(f.pixels, k, k / FPS) for k, f in enumerate(frames))
    return SyntheticSequence(numbered, truth.R[rows], truth.t[rows], truth.animation[rows], truth.landmarks[rows])


def in_order(rows: Sequence[int]) -> SyntheticSequence:
    """The frames of `sequence()` in another order: left out, repeated, backwards."""
    return shown([sequence().frames[k] for k in rows], rows)
