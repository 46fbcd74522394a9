"""Eyes that cannot be seen, behind dark glasses or a reflection, or under something plain; and mouths behind a mask.

Descriptors are invariant to gain, so that what is left of an eye behind a dark lens, and the edge of the lens, look
like an eye that stays open. An eye, open or shut, differs from skin: iris, lashes and the shadow of the lid are about
as rich in contrast as the rest of a face. So an eye that shows a small part of that contrast is not seen, nor is one
that is brighter than the brightest skin of the face, as only a light is. A mouth has at least the line between its
lips, which what is plain has not.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mien.arrays import Array, Float32, Mask
from mien.compiled import kernel
from mien.config.realtime import VisibilitySettings
from mien.initialization.landmarks import EYE_PARTS, LANDMARK_NAMES, MOUTH_CORNERS
from mien.tracking.realtime.motion import bilinear
from mien.tracking.realtime.order import insert
from mien.tracking.realtime.pose_geometry import PersonArrays, PoseArrays, ViewArrays, head_to_crop, project_to_crop
from mien.tracking.realtime.pose_geometry import landmark as landmark_of

_EYES = np.array([[LANDMARK_NAMES.index(f"{side}_{part}") for part in EYE_PARTS] for side in ("right", "left")])
"""Rows (2, 4) of the landmarks of each eye."""
_OF_EYES = np.isin(np.arange(len(LANDMARK_NAMES)), _EYES)
"""Which landmarks these are; what is tracked beside the landmarks follows them."""
_ALONG, _ACROSS = np.linspace(0.2, 0.8, 7), np.linspace(-0.2, 0.2, 5)
"""Where an eye, or a mouth, is looked at: from one corner to the other, and up, in widths of it."""
_AROUND = np.array([-0.12, 0.12])
"""Where the brightness of a patch is looked at, to either side of its landmark, CANDIDE units."""
_BRIGHTEST = 0.9
"""Quantile of the brightness of the patches of a face that is taken for its brightest skin."""


class Veiled(NamedTuple):
    """Which landmarks (n,) belong to eyes of which something faces the camera and that cannot be seen; whether that is
    so of all eyes of which something does; whether a mouth that faces the camera cannot be seen."""

    landmarks: Mask
    all: bool
    mouth: bool


def veiled_parts(
    image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays, shown: tuple[Mask, Array, float],
    settings: VisibilitySettings,
) -> Veiled:  # fmt: skip
    """What of eyes and mouth a crop, in which the face is at a pose, does not show. shown: which landmarks (n,) face
    the camera, the norms (n,) of the patches around them, and what makes these standard deviations of grey values."""
    s = settings
    return Veiled(*_veiled(image, person, pose, view, shown, s.least_eye_contrast, s.eye_glare, s.least_mouth_contrast))


@kernel()
def _veiled(
    image: Any, person: Any, pose: Any, view: Any, shown: Any, least: float, glare: float, least_of_mouth: float
) -> Any:
    """The entries of `Veiled`."""
    facing, norms, scale = shown
    R, t, a = pose
    n, to_crop = facing.size, head_to_crop(R, t, view)
    veiled, contrasts, others = np.zeros(n, np.bool_), np.empty(n), np.empty(n, np.intp)
    count, faces, hidden = 0, 0, 0
    for i in range(n):
        if facing[i] and not (i < _OF_EYES.size and _OF_EYES[i]):
            insert(scale * norms[i], contrasts, count)
            others[count] = i
            count += 1
    if count == 0:
        return veiled, False, False
    usual = contrasts[count // 2]
    for k in range(len(_EYES)):
        if facing[_EYES[k]].any():
            faces += 1
            median, sd = _look(_EYES[k, 0], _EYES[k, 1], image, person, a, to_crop)
            if sd < least * usual or _outshines(median / glare, others[:count], image, person, a, to_crop):
                hidden += 1
                veiled[_EYES[k]] = True
    right, left = MOUTH_CORNERS
    _, sd = _look(right, left, image, person, a, to_crop)
    return veiled, 0 < faces == hidden, bool(facing[right] and facing[left] and sd < least_of_mouth * usual)


@kernel()
def _outshines(grey: float, others: Any, image: Any, person: Any, a: Any, to_crop: Any) -> bool:
    """Whether a grey value exceeds the brightness of the quantile `_BRIGHTEST` of landmarks `others` (m,)."""
    needed = others.size - int(_BRIGHTEST * (others.size - 1))
    for i in others:
        if _brightness(i, image, person, a, to_crop) >= grey:
            needed -= 1
            if needed == 0:  # mostly after a few of them
                return False
    return True


@kernel()
def _brightness(i: int, image: Any, person: Any, a: Any, to_crop: Any) -> float:
    """Mean grey value around landmark i."""
    x, y, z = landmark_of(i, person, a)
    total = 0.0
    for dx in _AROUND:
        for dy in _AROUND:
            u, v, _ = project_to_crop(x + dx, y + dy, z, to_crop)
            total += bilinear(image, u, v)[0]
    return total / (_AROUND.size * _AROUND.size)


@kernel()
def _look(outer: int, inner: int, image: Any, person: Any, a: Any, to_crop: Any) -> Any:
    """Median and standard deviation of the grey values between the corners of an eye, or of the mouth."""
    x, y, z = landmark_of(outer, person, a)
    X, Y, Z = landmark_of(inner, person, a)
    width = np.sqrt((X - x) ** 2 + (Y - y) ** 2 + (Z - z) ** 2)
    values, count, total, squares = np.empty(_ALONG.size * _ACROSS.size), 0, 0.0, 0.0
    for s in _ALONG:
        for up in _ACROSS:
            u, v, _ = project_to_crop(x + s * (X - x), y + s * (Y - y) + up * width, z + s * (Z - z), to_crop)
            value = float(bilinear(image, u, v)[0])
            insert(value, values, count)
            count += 1
            total += value
            squares += value * value
    mean = total / count
    return values[count // 2], np.sqrt(max(squares / count - mean * mean, 0.0))
