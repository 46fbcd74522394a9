"""Corners of the mouth and brows, found once more with all else held, on skin that stretches around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mien.appearance.descriptors import CELLS
from mien.arrays import Array, Mask
from mien.candide.model import MOVES_MOUTH, TRACKED_UNITS
from mien.config.realtime import FeatureSettings
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.motion import holding_all_but
from mien.tracking.realtime.person import Person
from mien.tracking.realtime.pose import Prediction
from mien.tracking.realtime.pose_geometry import project
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.solution import Solution, View
from mien.tracking.realtime.solver import PoseSolver

_VISIBLE = 0.5
"""How far all landmarks of a feature have to have been visible for it to be found again."""
_CORNER_OUTWARDS, _CORNER_ABOVE = 0.6, 0.4
"""CANDIDE units from a corner of the mouth, outwards and both upwards and downwards, at which skin does not follow it
any more; on the side of the mouth that is the middle of the lips."""
_BROW_ABOVE, _BROW_BELOW = 1.0, 0.5
"""The same, upwards and downwards from a brow: at the hair, and below the eye."""


class _Features(NamedTuple):
    """Which landmarks (n,) belong to features of the face, which animation units (6,) move these, and the information
    (12, 12) that holds everything else."""

    landmarks: Mask
    units: Mask
    held: Array


class FeatureSearch:
    """Finds the corners of the mouth and the brows again.

    Where they move they look strange, and hardly count beside the rest of the head. Alone, where they cannot lead that
    astray, they may look stranger. follows: (n, 16) see `StretchArrays`; withheld: (6,) how much less of each unit was
    reported in the last frame than was found.
    """

    def __init__(self, person: Person, solver: PoseSolver, prior: StatePrior, settings: FeatureSettings) -> None:
        self.person, self.solver, self.prior, self.settings = person, solver, prior, settings
        corners = np.array([name in ("lip_stretcher", "lip_corner_depressor") for name in TRACKED_UNITS])
        brows = ~MOVES_MOUTH
        self.corners = _Features(person.corners, corners, holding_all_but(corners))
        self.brows = _Features(person.brows, brows, holding_all_but(brows))
        self.both = _Features(person.corners | person.brows, corners | brows, holding_all_but(corners | brows))
        self.follows = _following(person)
        self.withheld = np.zeros(len(TRACKED_UNITS))

    def search(self, view: View, best: Solution, predicted: Prediction, visible: Array, corners: bool) -> Solution:
        """A solution whose corners and brows are found alone, if they can be seen. visible: (n,) how far each landmark
        was in the last frame; corners: whether these are looked for, too."""
        withheld, self.withheld = self.withheld, np.zeros_like(self.withheld)
        if self.solver.misfits(best):
            return best
        seen = view.facing & (visible >= _VISIBLE) & ~self.person.worn
        corners &= bool(seen[self.corners.landmarks].all())
        brows = bool(seen[self.brows.landmarks].all())
        if not (corners or brows):
            return best
        landmarks, free, held = self.both if corners and brows else self.corners if corners else self.brows
        pose, information = best.pose, held.copy()
        information[6:, 6:] += predicted.information[6:, 6:]
        start = pose.with_animation(np.where(free, predicted.pose.animation + withheld, pose.animation))
        at_rest = pose.with_animation(np.where(free, self.prior.rest, pose.animation))
        still, _ = project(self.person.arrays, at_rest.arrays, best.posterior.view)
        tolerance, about = self._tolerance(best, predicted), predicted.improved(start, information)
        alone = self.solver.alone(landmarks, best, about, tolerance, (still, self.follows))
        if corners:
            self.withheld = self._feigned(alone.animation)
        return best.with_pose(pose.with_animation(alone.animation - self.withheld))

    def _tolerance(self, best: Solution, predicted: Prediction) -> Array:
        """Factor (n,) of the squared distances at which weights are a quarter: the less, the further the head has
        turned, and for corners the further the mouth has opened, as both change how they look."""
        s, rest = self.settings, float(self.prior.rest[JAW_DROP])
        open_by = max(float(best.pose.animation[JAW_DROP]) - rest, 0.0)
        added = (s.tolerance - 1) * predicted.trust(s.turn_deg)
        return np.where(self.person.corners, 1 + added / (1 + (open_by / s.jaw) ** 2), 1 + added)

    def _feigned(self, animation: Array) -> Array:
        """How much (6,) of the units that move the corners is not believed: most of what is found near rest, where
        turns and light feign as much."""
        away = np.where(self.corners.units, animation - self.prior.rest, 0.0)
        square = max(self.settings.rest**2, 1e-12)
        return np.asarray(away * square / (away * away + square))


def _following(person: Person) -> Array:
    """Which share (n, 16) of what moves a landmark each cell of its descriptor follows: around corners of the mouth and
    brows the less, the further away it is; around others all of it."""
    descriptor = person.face.fine.descriptor
    down, right = (np.indices((4, 4)).reshape(2, -1) - 1.5) * descriptor.cell / descriptor.pixels_per_unit
    x = person.face.neutral[:, 0]
    follows = np.ones((len(x), CELLS))
    for corner in np.flatnonzero(person.corners):
        half = x[corner] - x[person.corners].mean()
        outwards = right * np.sign(half)
        beside = 1 - np.where(outwards < 0, -outwards / abs(half), outwards / _CORNER_OUTWARDS)
        follows[corner] = np.clip(beside, 0, 1) * np.clip(1 - np.abs(down) / _CORNER_ABOVE, 0, 1)
    follows[person.brows] = np.clip(1 - np.where(down < 0, -down / _BROW_ABOVE, down / _BROW_BELOW), 0, 1)
    return follows
