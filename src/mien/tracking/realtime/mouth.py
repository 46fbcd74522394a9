"""The mouth where it moves further than its patches reach, and where what was measured of its motion has led it
astray."""

from __future__ import annotations

import numpy as np

from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH
from mien.config.realtime import MouthSettings
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.person import JAW, Person
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.skin import CHIN, Skin
from mien.tracking.realtime.solution import Solution, View
from mien.tracking.realtime.solver import PoseSolver

_JAWS = np.linspace(-0.3, 1.5, 13)
"""Values of jaw_drop at which the chin is looked for."""
_JAW_STARTS = (0.0, 0.35, 0.7, 1.05)
"""Values of jaw_drop from which the solver starts again where the mouth does not fit."""
_OPEN = 0.25
"""Value of jaw_drop, more than at rest, from which on a mouth is open."""
_OTHER_JAW = 0.175
"""Difference of jaw_drop from which on a mouth is open to another degree."""


class MouthSearch:
    """Looks for the mouth again where the one that the solver found may not be right. strange_frames:
    for how many frames a moved mouth has not fitted; is_open: whether the chin has shown that the mouth opened, and it
    has not closed; is_put_back: whether it was put back to rest in the last frame that was searched."""

    def __init__(
        self,
        person: Person,
        solver: PoseSolver,
        prior: StatePrior,
        view: View,
        first: Pose,
        settings: MouthSettings,
    ) -> None:
        """view, first: the crop of the first frame, and the pose of the face in it."""
        self.person, self.solver, self.prior, self.settings = person, solver, prior, settings
        self.chin = Skin(CHIN, person.face.chin, view.image, person.arrays, first.arrays, view.geometry)
        self.strange_frames, self.is_open, self.is_put_back = 0, False, False

    def search(self, view: View, best: Solution, predicted: Prediction) -> Solution:
        """A solution with the mouth that fits best."""
        opened = best if self.person.is_masked else self._opened(view, best, predicted)
        relaxed = self._relaxed(view, opened, predicted.last)
        self.is_put_back = relaxed is not opened
        return relaxed

    def _opened(self, view: View, best: Solution, predicted: Prediction) -> Solution:
        """A jaw can move further in a frame than its patches reach, and lips that open look strange wherever they are:
        where these do not fit, start from other openings, and judge all by how much the chin looks as it did."""
        s, found = self.settings, float(best.pose.animation[JAW_DROP])
        open_from = float(self.prior.rest[JAW_DROP]) + _OPEN
        fits = sum(float(best.d2[k] / self.person.expected[k]) for k in JAW) < s.jaw_distance * len(JAW)
        if fits and (found < open_from or self.is_open):
            self.is_open = found >= open_from
            return best
        seen, *elsewhere = self._chin(view, best.pose, _JAWS)
        most = int(np.argmax(elsewhere))
        self.is_open |= elsewhere[most] > s.chin_seen and float(_JAWS[most]) >= open_from
        if fits:
            return best
        lowest = best.energy - s.chin_energy * seen
        starts = (float(_JAWS[most]), *_JAW_STARTS) if elsewhere[most] > s.chin_least else _JAW_STARTS
        for jaw in starts:
            if abs(jaw - float(best.pose.animation[JAW_DROP])) > _OTHER_JAW:
                candidate = self.solver.solve(view, best.pose.with_unit(JAW_DROP, jaw), predicted)
                (seen,) = self._chin(view, candidate.pose)
                energy = candidate.energy - s.chin_energy * seen
                if energy < lowest:
                    best, lowest = candidate, energy
        return best

    def _chin(self, view: View, pose: Pose, jaws: Array | tuple[()] = ()) -> list[float]:
        """How much the chin looks as in the first frame with the jaw as in a pose, and then at each of jaws (k,):
        correlations, and at least the one below which it is hidden or changed."""
        jaws = np.append(pose.animation[JAW_DROP], jaws)
        likeness = self.chin.likeness(view.image, self.person.arrays, pose.arrays, view.geometry, jaws)
        return [max(value, self.settings.chin_least) for value in likeness.tolist()]

    def _relaxed(self, view: View, best: Solution, last: Pose) -> Solution:
        """The solution with the mouth at rest, where it fits much better: what was measured of its motion adds up, and
        with it the errors, until the mouth is too far away to be found. last: the pose of the last frame."""
        s, mouth = self.settings, view.facing & self.person.mouth
        moved = np.abs(best.pose.animation - self.prior.rest)[MOVES_MOUTH]
        if max(moved.tolist()) <= s.moved:  # as in most frames; for a few numbers faster than NumPy
            self.strange_frames = 0
            return best
        usual = self.person.expected[mouth]
        misfit = float((best.d2[mouth] / usual).mean()) if mouth.any() else 0.0
        self.strange_frames = self.strange_frames + 1 if misfit > s.distance else 0
        if self.strange_frames % s.interval != 1:
            return best
        rest = np.where(MOVES_MOUTH, self.prior.rest, best.pose.animation)
        at_rest = self.prior.prediction(best.pose.with_animation(rest), last)
        alone = self.solver.solve(view.of_landmarks(mouth), at_rest.pose, at_rest)
        if (alone.d2[mouth] / usual).mean() > s.share * misfit:
            return best
        return self.solver.solve(view, at_rest.pose, at_rest)
