"""A mouth that moves further than its patches reach, or that what was measured of its motion has led astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mien.candide.model import MOVES_MOUTH
from mien.config.realtime import MouthSettings
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.person import JAW, Person
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.solution import Prediction, Solution, View
from mien.tracking.realtime.solver import PoseSolver

_JAW_STARTS = (0.0, 0.35, 0.7, 1.05)
"""Values of jaw_drop from which the solver starts again where the mouth does not fit."""


class MouthSearch:
    """Starts the solver again from other mouths where the one that it found does not fit. strange_frames: for how many
    frames a moved mouth has not."""

    def __init__(self, person: Person, solver: PoseSolver, prior: StatePrior, settings: MouthSettings) -> None:
        self.person, self.solver, self.prior, self.settings = person, solver, prior, settings
        self.strange_frames = 0

    def opened(self, view: View, best: Solution, predicted: Prediction) -> Solution:
        """A jaw can move further in a frame than its patches reach: where these do not fit, start from other
        openings."""
        s = self.settings
        if sum(float(best.d2[k] / self.person.expected[k]) for k in JAW) < s.jaw_distance * len(JAW):
            return best
        for jaw in _JAW_STARTS:
            if abs(jaw - best.pose.animation[JAW_DROP]) > 0.5 * _JAW_STARTS[1]:
                animation = best.pose.animation.copy()
                animation[JAW_DROP] = jaw
                candidate = self.solver.solve(view, replace(best.pose, animation=animation), predicted)
                best = min(best, candidate, key=lambda solution: solution.energy)
        return best

    def relaxed(self, view: View, best: Solution, predicted: Prediction) -> Solution:
        """The solution with the mouth at rest, where it fits much better: what was measured of its motion adds up, and
        with it the errors, until the mouth is too far away to be found."""
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
        at_rest = self.prior.prediction(replace(best.pose, animation=rest), predicted.last)
        alone = self.solver.solve(view.of_landmarks(mouth), at_rest.pose, at_rest)
        if (alone.d2[mouth] / usual).mean() > s.share * misfit:
            return best
        return self.solver.solve(view, at_rest.pose, at_rest)
