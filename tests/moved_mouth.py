"""A rendered face whose mouth moves from one frame to the next, for the tests of what looks for it."""

from __future__ import annotations

import numpy as np

from mien.arrays import Array
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.synthetic import SyntheticSequence, make_sequence, moved
from small_motion import face


def moved_unit(unit: int, amount: float, roll_deg: float = 0.0) -> SyntheticSequence:
    """A face of which one animation unit is moved after the first of four frames, and stays so; its head is held
    aslant."""
    animation = np.zeros((4, 6))
    animation[1:, unit] = amount
    return make_sequence(face(), moved(face(), np.tile([0, 0, roll_deg], (4, 1)), np.zeros((4, 3)), animation))


def with_mouth(frame: Frame, landmarks: Array, grey: int, below: int) -> Frame:
    """The frame with something between the lips, and on them, that the first one did not show, from some pixels below
    the upper one's border on."""
    corners = [name for name in LANDMARK_NAMES if "mouth_corner" in name]
    left, right = sorted(int(landmarks[LANDMARK_NAMES.index(name), 0]) for name in corners)
    top, bottom = (int(landmarks[LANDMARK_NAMES.index(f"{lip}_lip_outer"), 1]) for lip in ("upper", "lower"))
    pixels = frame.pixels.copy()
    pixels[top + below : bottom + 1, left:right] = grey
    return Frame(pixels, frame.index, frame.time)
