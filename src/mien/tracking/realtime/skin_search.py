"""Lips and brows, looked for by the skin that moves with them before the solver begins."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH, TRACKED_UNITS
from mien.compiled import kernel
from mien.config.realtime import SkinSettings
from mien.tracking.realtime.definite import solve_positive
from mien.tracking.realtime.person import Person
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.pose_geometry import STATE_SIZE, rotated
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.skin import BROWS, CORNERS, UPPER_LIP, Skin, SlidingSkin
from mien.tracking.realtime.solution import View

_LIPS = np.linspace(-1.5, 1.5, 21)
"""Values of upper_lip_raiser, from that at rest, at which the skin above the upper lip is looked for."""
_RAISES = np.eye(len(TRACKED_UNITS))[UPPER_LIP.unit]
"""By how much of its unit each unit (6,) raises the upper lip."""
_LEAST_MOTION = 0.02
"""CANDIDE units by which lip_stretcher moves the corners of the mouth outwards, 0.09 in CANDIDE-3, or the units of the
brows lower these, 0.28 in all, below which those of another face model are not looked for there."""
_STRETCHES = np.array([name == "lip_stretcher" for name in TRACKED_UNITS])
"""Which unit (6,) that is."""
_DOWN = np.array([0.0, -1.0, 0.0])
"""In head axes."""
_SURPRISE = 2.0
"""Standard deviations beyond which brows that are not where they were predicted have moved, not the head."""


class _Likeness(NamedTuple):
    """How much some skin looks as in the first frame, as correlations (k,), where it would be if it had moved by values
    (k,) since then; by how much each unit (6,) moves it; the energy that skin exactly as there is worth; the
    correlation below which it says nothing; which share of what it says counts; and the variance of its place that the
    predicted pose of the head leaves."""

    by_unit: Array
    values: Array
    likeness: Array
    energy: float
    least: float
    trust: float
    variance: float = 0.0


class SkinSearch:
    """Looks for the lips and the brows by the skin that moves with them. widening, lowering: (6,) CANDIDE units by
    which lip_stretcher moves the corners of the mouth outwards, and the units of the brows move these down; may_widen,
    may_lower: whether that is enough to look for them; brow_step: (3, 2) how far down a rotation and a translation of
    the head move the brows, in head axes."""

    def __init__(self, person: Person, prior: StatePrior, view: View, first: Pose, settings: SkinSettings) -> None:
        """view, first: the crop of the first frame, and the pose of the face in it."""
        self.person, self.prior, self.settings = person, prior, settings
        face, crop = person.face, (view.image, person.arrays, first.arrays, view.geometry)
        self.upper_lip = Skin(UPPER_LIP, face.upper_lip, *crop)
        self.corners = SlidingSkin(CORNERS, face.corners, *crop)
        self.brows = SlidingSkin(BROWS, face.brows, *crop)
        right, left = (person.units[:, side.carrier] for side in CORNERS.sides)
        self.widening = np.where(_STRETCHES, (left - right)[:, 0] / 2, 0.0)
        brows = [side.carrier for side in BROWS.sides]
        self.lowering = np.where(MOVES_MOUTH, 0.0, -person.units[:, brows, 1].mean(axis=1))
        self.may_widen = float(self.widening.sum()) >= _LEAST_MOTION
        self.may_lower = float(np.abs(self.lowering).sum()) >= _LEAST_MOTION
        self.brow_step = np.column_stack([np.cross(person.neutral[brows].mean(axis=0), _DOWN), _DOWN])

    def with_skin(self, view: View, predicted: Prediction) -> Prediction:
        """A prediction, and where the skin above the upper lip and around the corners of the mouth, and the brows are
        seen. Lips that bare the teeth look strange wherever they are, brows often do, and what was measured of their
        motion is drawn back to rest."""
        skins: list[_Likeness] = []
        if not self.person.is_masked:
            skins += [self._upper_lip(view, predicted), *self._corners(view, predicted)]
        if not (self.person.worn & self.person.brows).any():
            skins += self._brows(view, predicted)
        information, gradient = predicted.information.copy(), np.zeros(STATE_SIZE)
        animation, rest, gain = predicted.pose.animation.copy(), self.prior.rest, self.settings.gain
        found = [_add_skin(tuple(skin), rest, gain, animation, information, gradient) for skin in skins]
        if not any(found):
            return predicted
        pose = predicted.pose.with_animation(animation).moved(solve_positive(information.copy(), gradient))
        return predicted.improved(pose, information)

    def _upper_lip(self, view: View, predicted: Prediction) -> _Likeness:
        s, pose, unit = self.settings, predicted.pose, UPPER_LIP.unit
        lips = float(self.prior.rest[unit]) + _LIPS
        likeness = self.upper_lip.likeness(view.image, self.person.arrays, pose.arrays, view.geometry, lips)
        return _Likeness(_RAISES, _LIPS, likeness, s.energy, s.least, predicted.trust(s.turn_deg))

    def _corners(self, view: View, predicted: Prediction) -> list[_Likeness]:
        """How far out they are, if they are found; how far down they are does not say that."""
        if not self.may_widen:
            return []
        s, likeness = self.settings, self._looked_for(self.corners, view, predicted.pose)
        row = int(likeness.argmax()) // likeness.shape[1]
        if not 0 < row < len(likeness) - 1:
            return []
        trust = predicted.trust(s.turn_deg)
        return [_Likeness(self.widening, self.corners.outwards, likeness[row], s.corner_energy, s.least, trust)]

    def _brows(self, view: View, predicted: Prediction) -> list[_Likeness]:
        """How far down they are. Unlike lips they are not compared with what does not move, so that a head that is
        not where it was predicted moves them, too."""
        if not self.may_lower:
            return []
        s, likeness = self.settings, self._looked_for(self.brows, view, predicted.pose)
        along = likeness[:, int(likeness.argmax()) % likeness.shape[1]].copy()
        trust = predicted.trust(s.brow_turn_deg)
        variance = _variance_along(predicted.information, predicted.pose.arrays[0], self.brow_step)
        return [_Likeness(self.lowering, self.brows.down, along, s.energy, s.brow_least, trust, variance)]

    def _looked_for(self, skin: SlidingSkin, view: View, pose: Pose) -> Array:
        return skin.likeness(view.image, self.person.arrays, pose.arrays, view.geometry)


@kernel()
def _variance_along(information: Any, R: Any, step: Any) -> float:
    """Variance of what a rotation and a translation, steps (3, 2) in the axes of a head with rotation R (3, 3), change
    by one, where information (12, 12) is known of the pose."""
    by_step = np.zeros(STATE_SIZE)
    for k in range(2):
        x, y, z = rotated(R, step[0, k], step[1, k], step[2, k])
        by_step[3 * k], by_step[3 * k + 1], by_step[3 * k + 2] = x, y, z
    found, variance = solve_positive(information.copy(), by_step), 0.0
    for k in range(6):
        variance += by_step[k] * found[k]
    return variance


@kernel()
def _add_skin(skin: Any, rest: Any, gain: float, animation: Any, information: Any, gradient: Any) -> bool:
    """Add to a prediction, its animation (6,), information (12, 12) of a step from it and gradient (12,), that some
    skin, a `_Likeness`, is most like that of the first frame where it has moved by some value; returns whether it is.

    It is if it is alike enough there, and less so on either side: at the top of a parabola through the three. The more
    sharply the likeness falls there, the more that says. gain: by how much more alike it has to be there than where it
    is predicted for the prediction to be given up.
    """
    by_unit, values, likeness, energy, least, trust, variance = skin
    most, last = likeness.argmax(), values.size - 1
    if likeness[most] < least or most == 0 or most == last:
        return False
    step, slope = values[1] - values[0], likeness[most + 1] - likeness[most - 1]
    bend = max(2 * likeness[most] - likeness[most - 1] - likeness[most + 1], 1e-6)
    predicted, squared = 0.0, 0.0
    for k in range(by_unit.size):
        predicted += by_unit[k] * (animation[k] - rest[k])
        squared += by_unit[k] * by_unit[k]
    missing = values[most] + step * slope / (2 * bend) - predicted
    place = min(max((predicted - values[0]) / step, 0.0), last - 1e-9)
    k = int(place)
    there = likeness[k] + (place - k) * (likeness[k + 1] - likeness[k])
    if trust * (likeness[most] - there) > gain and missing * missing > _SURPRISE * _SURPRISE * variance:
        for k in range(by_unit.size):
            animation[k] += missing / squared * by_unit[k]
        missing = 0.0
    certain = 1 / (step * step / (trust * energy * bend + 1e-12) + variance)
    for i in range(by_unit.size):
        gradient[6 + i] += certain * missing * by_unit[i]
        for j in range(by_unit.size):
            information[6 + i, 6 + j] += certain * by_unit[i] * by_unit[j]
    return True
