"""Lips and brows, looked for by the skin that moves with them before the solver begins."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.config.realtime import SkinSettings
from mien.tracking.realtime.definite import solve_definite
from mien.tracking.realtime.person import Person
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.pose_geometry import STATE_SIZE
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
_MOVES_BROWS = np.array(["brow" in name for name in TRACKED_UNITS])
"""Which units (6,) these are."""
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

    @property
    def is_found(self) -> bool:
        """Whether it is alike enough at one of the values, and less so on either side of it."""
        most = int(self.likeness.argmax())
        return bool(self.likeness[most] >= self.least) and 0 < most < len(self.values) - 1

    @property
    def top(self) -> tuple[float, float]:
        """By how much the skin has moved, the top of a parabola through the greatest likeness and those beside it, and
        the information of that: the more sharply the likeness falls there, the more."""
        k = int(self.likeness.argmax())
        before, most, behind = self.likeness[k - 1 : k + 2].tolist()
        step, bend = float(self.values[1] - self.values[0]), max(2 * most - before - behind, 1e-6)
        value = float(self.values[k]) + step * (behind - before) / (2 * bend)
        return value, 1 / (step**2 / (self.trust * self.energy * bend + 1e-12) + self.variance)

    def gain(self, value: float) -> float:
        """By how much more alike the skin is where it was found than where it would be if it had moved by a value."""
        return self.trust * float(self.likeness.max() - np.interp(value, self.values, self.likeness))


class SkinSearch:
    """Looks for the lips and the brows by the skin that moves with them. widening, lowering: (6,) CANDIDE units by
    which lip_stretcher moves the corners of the mouth outwards, and the units of the brows move these down; brow_step:
    (3, 2) how far down a rotation and a translation of the head move the brows, in head axes."""

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
        self.lowering = np.where(_MOVES_BROWS, -person.units[:, brows, 1].mean(axis=1), 0.0)
        self.brow_step = np.column_stack([np.cross(person.neutral[brows].mean(axis=0), _DOWN), _DOWN])

    def with_skin(self, view: View, predicted: Prediction) -> Prediction:
        """A prediction, and where the skin above the upper lip and around the corners of the mouth, and the brows are
        seen. Lips that bare the teeth look strange wherever they are, brows often do, and what was measured of their
        motion is drawn back to rest."""
        skins: list[_Likeness] = []
        if not self.person.is_masked:
            skins += [self._upper_lip(view, predicted.pose), *self._corners(view, predicted.pose)]
        if not (self.person.worn & self.person.brows).any():
            skins += self._brows(view, predicted)
        found = [skin for skin in skins if skin.is_found]
        return self._moved(predicted, found) if found else predicted

    def _upper_lip(self, view: View, pose: Pose) -> _Likeness:
        s, unit = self.settings, UPPER_LIP.unit
        lips = float(self.prior.rest[unit]) + _LIPS
        likeness = self.upper_lip.likeness(view.image, self.person.arrays, pose.arrays, view.geometry, lips)
        return _Likeness(_RAISES, _LIPS, likeness, s.energy, s.least, self._trust(pose, s.turn_deg))

    def _corners(self, view: View, pose: Pose) -> list[_Likeness]:
        """How far out they are, if they are found; how far down they are does not say that."""
        if float(self.widening.sum()) < _LEAST_MOTION:
            return []
        s, likeness = self.settings, self._looked_for(self.corners, view, pose)
        row = int(likeness.argmax()) // likeness.shape[1]
        if not 0 < row < len(likeness) - 1:
            return []
        trust = self._trust(pose, s.turn_deg)
        return [_Likeness(self.widening, self.corners.outwards, likeness[row], s.corner_energy, s.least, trust)]

    def _brows(self, view: View, predicted: Prediction) -> list[_Likeness]:
        """How far down they are. Unlike lips they are not compared with what does not move, so that a head that is
        not where it was predicted moves them, too."""
        if float(np.abs(self.lowering).sum()) < _LEAST_MOTION:
            return []
        s, pose = self.settings, predicted.pose
        likeness = self._looked_for(self.brows, view, pose)
        along = likeness[:, int(likeness.argmax()) % likeness.shape[1]]
        by_step = np.zeros(STATE_SIZE)
        by_step[:6] = (pose.R @ self.brow_step).T.ravel()
        variance = float(by_step @ solve_definite(predicted.information, by_step))
        trust = self._trust(pose, s.brow_turn_deg)
        return [_Likeness(self.lowering, self.brows.down, along, s.energy, s.brow_least, trust, variance)]

    def _looked_for(self, skin: SlidingSkin, view: View, pose: Pose) -> Array:
        return skin.likeness(view.image, self.person.arrays, pose.arrays, view.geometry)

    def _trust(self, pose: Pose, degrees: float) -> float:
        """Which share counts of what skin says: the further a head turns, the more it looks otherwise by that."""
        return 1 / (1 + self.prior.turned(pose, degrees))

    def _moved(self, predicted: Prediction, skins: list[_Likeness]) -> Prediction:
        """A prediction, and that some skin is most like that of the first frame where it has moved by some value."""
        pose, rest = predicted.pose, self.prior.rest
        information, gradient = predicted.information.copy(), np.zeros(STATE_SIZE)
        for skin in skins:
            by_unit, (seen, certain) = skin.by_unit, skin.top
            missing = seen - float(by_unit @ (pose.animation - rest))
            if skin.gain(seen - missing) > self.settings.gain and missing**2 > _SURPRISE**2 * skin.variance:
                there = pose.animation + missing / float(by_unit @ by_unit) * by_unit  # what was predicted is not there
                pose, missing = replace(pose, animation=there), 0.0
            information[6:, 6:] += certain * by_unit * by_unit[:, None]
            gradient[6:] += certain * missing * by_unit
        pose = pose.moved(solve_definite(information, gradient))
        return replace(predicted, pose=pose, information=information)
