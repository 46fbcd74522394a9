"""The mouth where it moves further than its patches reach, where what was measured of its motion has led it astray, and
where its corners look strange."""

from __future__ import annotations

import numpy as np

from mien.appearance.descriptors import CELLS
from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH, TRACKED_UNITS
from mien.config.realtime import MouthSettings
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.motion import holding_all_but
from mien.tracking.realtime.person import JAW, Person
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.pose_geometry import points_in_crop
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
_MOVES_CORNERS = np.array([name in ("lip_stretcher", "lip_corner_depressor") for name in TRACKED_UNITS])
"""Which units (6,) move the corners of the mouth."""
_STRETCHER = TRACKED_UNITS.index("lip_stretcher")
_VISIBLE = 0.5
"""How far both corners have to have been visible to be found again."""
_OUTWARDS, _ABOVE = 0.6, 0.4
"""CANDIDE units from a corner of the mouth, outwards and both upwards and downwards, at which skin does not follow it
any more; on the side of the mouth that is the middle of the lips."""


class MouthSearch:
    """Looks for the mouth again where the one that the solver found may not be right. held: (12, 12)
    information that holds all but its corners; follows: (n, 16) see `StretchArrays`; strange_frames: for how many
    frames a moved mouth has not fitted; is_open: whether the chin has shown that the mouth opened, and it has not
    closed; withheld: how much less of lip_stretcher is reported in this frame than was found."""

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
        self.held = holding_all_but(_MOVES_CORNERS)
        self.follows = _following_corners(person)
        self.strange_frames, self.is_open, self.withheld = 0, False, 0.0

    def search(self, view: View, best: Solution, predicted: Prediction, visible: Array) -> Solution:
        """A solution with the mouth that fits best. visible: (n,) how far each landmark was in the last frame."""
        masked, withheld, self.withheld = self.person.is_masked, self.withheld, 0.0
        opened = best if masked else self._opened(view, best, predicted)
        relaxed = self._relaxed(view, opened, predicted.last)
        seen = view.facing & (visible >= _VISIBLE)
        if masked or relaxed is not opened or self.solver.misfits(opened) or not seen[self.person.corners].all():
            return relaxed
        return self._with_corners(opened, predicted, withheld)

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

    def _with_corners(self, best: Solution, predicted: Prediction, withheld: float) -> Solution:
        """A solution whose corners of the mouth are found alone, with all else held. Corners that move look strange,
        and hardly count beside the rest of the head; here, where they cannot lead it astray, they may look stranger,
        but the less, the further the head has turned, or the mouth has opened, as both change how they look. The skin
        around them stretches. withheld: in the last frame."""
        s, pose = self.settings, best.pose
        open_by = max(float(pose.animation[JAW_DROP] - self.prior.rest[JAW_DROP]), 0.0)
        trust = predicted.trust(s.corner_turn_deg) / (1 + (open_by / s.corner_jaw) ** 2)
        information = self.held.copy()
        information[6:, 6:] += predicted.information[6:, 6:]
        start = pose.with_animation(np.where(_MOVES_CORNERS, predicted.pose.animation, pose.animation))
        start = start.with_unit(_STRETCHER, float(start.animation[_STRETCHER]) + withheld)
        held, tolerance = predicted.improved(start, information), 1 + (s.corner_tolerance - 1) * trust
        at_rest = pose.with_animation(np.where(_MOVES_CORNERS, self.prior.rest, pose.animation))
        still = points_in_crop(self.person.arrays, at_rest.arrays, best.posterior.view)
        found = self.solver.alone(self.person.corners, best, held, tolerance, (still, self.follows)).animation
        rest, stretched = float(self.prior.rest[_STRETCHER]), float(found[_STRETCHER])
        reported = rest + (stretched - rest) / (1 + (s.corner_rest / max(abs(stretched - rest), 1e-9)) ** 2)
        self.withheld = stretched - reported
        return best.with_pose(pose.with_animation(found).with_unit(_STRETCHER, reported))


def _following_corners(person: Person) -> Array:
    """Which share (n, 16) of what moves a corner of the mouth each cell of its descriptor follows: less, the further it
    is from it. Those of other landmarks follow these entirely."""
    descriptor = person.face.fine.descriptor
    down, right = (np.indices((4, 4)).reshape(2, -1) - 1.5) * descriptor.cell / descriptor.pixels_per_unit
    x = person.face.neutral[:, 0]
    follows = np.ones((len(x), CELLS))
    for corner in np.flatnonzero(person.corners):
        half = x[corner] - x[person.corners].mean()
        outwards = right * np.sign(half)
        beside = 1 - np.where(outwards < 0, -outwards / abs(half), outwards / _OUTWARDS)
        follows[corner] = np.clip(beside, 0, 1) * np.clip(1 - np.abs(down) / _ABOVE, 0, 1)
    return follows
