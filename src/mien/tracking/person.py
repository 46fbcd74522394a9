"""What is known of a face but for where it is: learned in the first frame, and better known while it is tracked."""

from __future__ import annotations

import math
from copy import deepcopy
from typing import Any

import numpy as np

from mien.appearance.descriptors import Float32
from mien.compiled import kernel
from mien.config import RealtimeSettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import LANDMARK_NAMES, LANDMARK_VERTICES, Landmarks
from mien.tracking import kernels
from mien.tracking.adaptation import Adaptation
from mien.tracking.eyes import closing_of
from mien.tracking.learning import LearnedFace, Level, learn_face
from mien.tracking.shape import ShapePosterior, shape_information
from mien.tracking.solution import Pose, Solution
from mien.tracking.state import Closing, Mask

_TEMPLES = {"right_temple": 47, "left_temple": 14}
_ANCHORS = {
    "right_ear_upper": 62, "left_ear_upper": 29, "right_cheek": 91, "left_cheek": 90, "forehead": 2, **_TEMPLES
}  # fmt: skip
TRACKED = {**LANDMARK_VERTICES, **_ANCHORS}
"""Names and vertices of what is tracked: the landmarks, and after them anchors that are not reported. These lie far
apart, and away from the eyes, which spectacles hide. Light and hair move the look of the temples: their places are
believed less."""
JAW = [LANDMARK_NAMES.index("lower_lip_outer"), LANDMARK_NAMES.index("chin_boss")]
"""Landmarks that the jaw carries."""
TRUSTED = 0.25
"""Robust weight above which a landmark looks as it should."""
_NOSE = [i for i, name in enumerate(LANDMARK_NAMES) if name.startswith("nose") or "nostril" in name]
_LARGEST_MISPLACEMENT = 4.0
"""Pixels of the crop: a landmark that seems further from its place than this is something else."""
_MOST_LEARNED = 0.7
"""Share of a look that was learned while the face turned, above which it teaches nothing of the shape: it has the error
of the pose that was believed then."""
_SAME_PATCH = 0.9
"""Agreement above which a patch has moved with the face."""
_SPECTACLES_TURN_DEG = (3.0, 14.0)
"""Turns from the first frame's view in which spectacles show: nearer everything looks as in the first frame, and
further on the eyes of people without them look strange as well."""
SPECTACLES = 0.3
"""`Person.spectacles_evidence` above which there is something before the eyes: 0.5 to 1.2 behind spectacles, else
mostly less than 0, and 0.5 where somebody frowns."""


class Person:
    """Where n landmarks are in the head and what moves them, how they look, and how far either is usually off.

    neutral: (n, 3) landmarks at rest, units: (6, n, 3), in head axes; expected: (n,) squared distance of a look that is
    as it should be; tolerance: (n,) how much further it may be; variance: (n, 4) systematic error of a landmark's place
    in pixels of the crop and of the angles that its patch shows; eyes, mouth, plain: (n,) those of the eyes, those of
    mouth and chin, whose look changes as they move, those that look much alike on all faces; strangeness: how much
    stranger the eyes mostly look than the rest of the face when it turns, logarithm of the ratio of their distances.
    """

    def __init__(
        self,
        frame: Frame,
        landmarks: Landmarks,
        fit: FirstFrame,
        camera: Camera,
        settings: RealtimeSettings,
        before: Person | None = None,
    ) -> None:
        """Learn the face of the first frame. before: what an earlier pass over the same frames has learned: its shape
        and what it has learned in that first frame are kept."""
        s, n, vertices = settings, len(TRACKED), list(TRACKED.values())
        self.settings, self.rest = s, fit.animation
        self.face: LearnedFace = before.face if before else learn_face(frame, landmarks, fit, camera, vertices, s)
        face = self.face
        self.units = np.ascontiguousarray(fit.model.animation_units[:, vertices])
        brows = np.array(["brow" in name for name in TRACKED])
        self.eyes = np.array(["eye" in name for name in TRACKED]) & ~brows
        self.mouth = np.array(["lip" in name or "mouth" in name or "chin" in name for name in TRACKED])
        self.shape: ShapePosterior = (
            deepcopy(before.shape)
            if before
            else ShapePosterior(face.neutral, face.normals, self.eyes | brows, fit.R, fit.t, s)
        )
        self.neutral = self.shape.mean
        self.adaptation = Adaptation(n, Pose(fit.R, fit.t, fit.animation).angles, s)
        self.expected = np.full(n, s.expected_distance)
        # What the jaw carries changes its look with it, and what the nose carries is bone: trust both further.
        self.tolerance = np.full(n, s.robust_factor)
        self.tolerance[JAW] *= s.jaw_tolerance
        self.tolerance[_NOSE] *= s.nose_tolerance
        angle = np.radians(s.appearance_angle_sd_deg)
        self.indistinct = np.array([name in _TEMPLES for name in TRACKED])
        self.least_variance = np.where(self.indistinct, s.temple_sd, s.location_sd) ** 2
        self.variance = np.column_stack([self.least_variance] * 2 + [np.full(n, angle * angle)] * 2)
        self.spectacles_evidence: float = before.spectacles_evidence if before else 0.0

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Neutral landmarks and units as the kernels take them."""
        return self.neutral, self.units

    def in_camera(self, pose: Pose) -> Array:
        """Landmarks (n, 3) in camera axes."""
        X: Array = kernels.in_camera(self.arrays, *pose.arrays)
        return X

    def closing(self, solution: Solution, before: Closing | None = None) -> Closing | None:
        """How far the eyes have closed. before: the same of the last frame."""
        return closing_of(solution.residual, self.face.fine.eyes, solution.facing & self.eyes, before)

    def adapted_offset(self, level: Level, pose: Pose) -> Float32:
        """What is added to the means of a level at a pose (n, 128)."""
        adapts = level is self.face.fine and self.adaptation.begun
        return self.adaptation.offset(pose.angles) if adapts else self.adaptation.nothing

    def learned_share(self, solution: Solution) -> float:
        """Mean, over the landmarks that face the camera, of how far their looks there were learned when the face turned
        there, and are not the first frame's."""
        return _masked_mean(self.adaptation.share(solution.pose.angles), solution.facing)

    def misplacement_variance(self, level: Level, animation: Array) -> Array:
        """Variance (n, 4) of each landmark's systematic error: what is measured, and that no face moves just as the
        units do. animation: the last frame's: in this frame's guess an error would excuse itself."""
        error = self.settings.unit_error * level.descriptor.pixels_per_unit * (animation - self.rest)
        variance: Array = kernels.misplacement_variance(self.variance, self.units, error)
        return variance

    def learn(self, solution: Solution, agreement: Array) -> None:
        """From a frame in which the face looks as it should. agreement: (n,) of each patch with the motion before."""
        s, w = self.settings, solution.w
        # What is trusted is less than what is expected: without a floor the trust would shrink for ever.
        trusted = solution.facing & (w > TRUSTED)
        _update_average(self.expected[:, None], 1, solution.d2, trusted, s.expectation_rate, s.least_distance)
        self._learn_locations(solution)
        self._learn_eyes(solution, agreement)
        if s.learn_shape:
            self._learn_shape(solution)

    def learn_view(self, solution: Solution, agreement: Array) -> None:
        """How the face looks where it has turned away from the first frame's view: from a frame in which it is known to
        be the same face, however strange it looks. agreement: (n,) of each patch with the motion before."""
        s = self.settings
        if self._turned_deg(solution) <= s.view_turn_deg:
            return
        strange = self._strange(solution, agreement, s.view_strange_distance)
        if strange.any():
            self.adaptation.learn_view(solution.pose.angles, solution.residual[strange], strange)

    def _learn_eyes(self, solution: Solution, agreement: Array) -> None:
        """How eyes look that look strange, sooner where they mostly do."""
        s = self.settings
        low, high = _SPECTACLES_TURN_DEG
        if low < self._turned_deg(solution) < high:
            eyes, others = (solution.misfit_of(solution.facing & of) for of in (self.eyes, ~self.eyes))
            if 0 < eyes < math.inf and 0 < others < math.inf:
                self.spectacles_evidence += s.spectacles_rate * (math.log(eyes / others) - self.spectacles_evidence)
        least = s.strange_distance if self.spectacles_evidence < SPECTACLES else s.spectacles_distance
        strange = self.eyes & self._strange(solution, agreement, least)
        if strange.any():
            self.adaptation.learn_eyes(solution.pose.angles, solution.residual[strange], strange)

    def _strange(self, solution: Solution, agreement: Array, least: float) -> Mask:
        """Landmarks (n,) that have moved with the face and look stranger than `least` times the expected distance."""
        moved_along = solution.facing & (agreement > _SAME_PATCH)
        return np.asarray(moved_along & (solution.d2 > least * self.expected))

    def _turned_deg(self, solution: Solution) -> float:
        """How far the face has turned from the first frame's view."""
        (tilt, pan), (first_tilt, first_pan) = solution.pose.angles.tolist(), self.adaptation.first.tolist()
        return math.degrees(math.hypot(tilt - first_tilt, pan - first_pan))

    def _learn_locations(self, solution: Solution) -> None:
        """A landmark that is often found beside where the pose puts it says less of the pose from now on."""
        s = self.settings
        found, variance = (
            solution.facing & (solution.w > 1e-3),
            self.least_variance + solution.squared_misplacement(_LARGEST_MISPLACEMENT),
        )
        _update_average(self.variance, 2, variance, found, s.location_rate, 0.0)

    def _learn_shape(self, solution: Solution) -> None:
        s, pose = self.settings, solution.pose
        share = self.adaptation.share(pose.angles)
        if _masked_mean(share, solution.facing) > _MOST_LEARNED:
            return
        tilt, pan = pose.angles
        expression = pose.animation - self.rest
        worth = 1 / (1 + float(expression @ expression) / s.expression_sd**2)
        novelty = self.shape.novelty(tilt, pan, worth)
        if novelty < s.least_novelty:
            return
        regularizer = novelty * np.array([1e-6] * 6 + [1 / 0.3**2] * 6)
        weight = novelty * solution.w * (1 - share)
        Lambda, gradient = shape_information(solution.B, solution.M, solution.g, weight, pose.R, regularizer)
        self.neutral = self.shape.add(self.neutral, Lambda, gradient)


@kernel()
def _update_average(means: Any, columns: int, values: Any, of: Any, rate: float, least: float) -> None:
    """Move the first columns of means (n, k) by a rate towards values (n,), for those that are `of` (n,), and never
    below the least."""
    for i in range(values.size):
        for k in range(columns):
            if of[i]:
                means[i, k] += rate * (values[i] - means[i, k])
            means[i, k] = max(means[i, k], least)


def _masked_mean(values: Float32, of: Mask) -> float:
    """Mean of the values (n,) that are `of` (n,), 0 where none is."""
    count = np.count_nonzero(of)
    return float(values @ of) / count if count else 0.0
