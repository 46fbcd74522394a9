"""What is known of a face apart from its pose: learned in the first frame, and refined while it is tracked."""

from __future__ import annotations

import math
from copy import deepcopy
from typing import Any

import numpy as np

from mien.arrays import Array, Float32, Mask
from mien.compiled import kernel
from mien.config import RealtimeSettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import LANDMARK_NAMES, LANDMARK_VERTICES, Landmarks, opening_of
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime import pose_geometry
from mien.tracking.realtime.adaptation import Adaptation
from mien.tracking.realtime.covers import Covers
from mien.tracking.realtime.eyes import closing_of
from mien.tracking.realtime.learning import LearnedFace, learn_face
from mien.tracking.realtime.level import Level
from mien.tracking.realtime.look_covariance import LearnedCovariance
from mien.tracking.realtime.misplacement import learn_misplacement, misplacement_variance
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.pose_geometry import PersonArrays
from mien.tracking.realtime.prior import student_information
from mien.tracking.realtime.shape import ShapePosterior, shape_information
from mien.tracking.realtime.solution import Solution
from mien.tracking.state import Closing

_TEMPLES = {"right_temple": 47, "left_temple": 14}
_ANCHORS = {
    "right_ear_upper": 62, "left_ear_upper": 29, "right_cheek": 91, "left_cheek": 90, "forehead": 2, **_TEMPLES
}  # fmt: skip
TRACKED = {**LANDMARK_VERTICES, **_ANCHORS}
"""Names and vertices of what is tracked: the landmarks, then anchors, which are not reported. Anchors lie far apart,
and away from the eyes, which spectacles cover. The positions of the temples are trusted less, since light and hair
change how they look."""
JAW = [LANDMARK_NAMES.index("lower_lip_outer"), LANDMARK_NAMES.index("chin_boss")]
"""Landmarks that the jaw carries."""
TRUSTED = 0.25
"""Robust weight above which a landmark looks as it should."""
_NOSE = [i for i, name in enumerate(LANDMARK_NAMES) if name.startswith("nose") or "nostril" in name]
_BEHIND_MASK = [i for i in _NOSE if LANDMARK_NAMES[i] != "nose_bump"]
"""Landmarks that a mask covers beside mouth and chin."""
_MOST_LEARNED = 0.7
"""Share of the appearance learned in turns above which a frame teaches nothing of the shape: such an appearance carries
the pose errors of the frames that it was learned from."""
_LEAST_INFORMATION = 1e-6
"""Next to none: of a step of the head, and of units far from rest, where the shape is learned."""
_SAME_PATCH = 0.9
"""Agreement (see `PatchHistory`) above which a patch has moved with the face."""
_SHUT = 0.13
"""Height of open eyes over their width below which they are shut: 0.04 to 0.12 in frames of shut eyes, from 0.16 on in
others, wide ones 0.5."""
_SPECTACLES_TURN_DEG = (3.0, 14.0)
"""Turns from the first frame at which spectacles can be told: nearer to it everything looks as it did there, and
further away everybody's eyes look strange."""
SPECTACLES = 0.3
"""`Person.spectacles_evidence` above which the person wears some: it is 0.5 to 1.2 then, otherwise mostly below 0, and
up to 0.5 where somebody frowns."""


class Person:
    """The shape and the appearance of n landmarks, and how far either is usually wrong.

    units: (6, n, 3) in head axes; expected: (n,) squared distance of the usual appearance; tolerance: (n,) factor of it
    at which a robust weight is a quarter; variance: (n, 4) of the systematic error of a landmark's position, in pixels
    of the crop, and of the angles that its patch shows; brows, eyes, corners, mouth, temples: (n,) which landmarks
    belong to these, the corners of the mouth, to mouth and chin, whose appearance changes as they move, and to the
    temples, which look alike on all faces; worn: (n,) which were learned as they lie on dark glasses or a mask; masked:
    (n,) on a mask; covers: what lies on the face; spectacles_evidence: logarithm of how much stranger the eyes look
    than the rest of a turned face, as a ratio of distances; learned_shut: whether the eyes were shut in the first
    frame; firmness: (6,) of the animation about rest where the shape is learned, see `student_information`.
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
        """Learn the face of the first frame. before: the person as an earlier pass over the same frames knew it, whose
        shape and first appearance, and whether it seemed to wear spectacles, are kept."""
        s, n, vertices = settings, len(TRACKED), list(TRACKED.values())
        self.settings, self.rest = s, fit.animation
        self.face: LearnedFace = before.face if before else learn_face(frame, landmarks, fit, camera, vertices, s)
        face = self.face
        self.units = np.ascontiguousarray(fit.model.animation_units[:, vertices])
        self.brows = np.array(["brow" in name for name in TRACKED])
        self.eyes = np.array(["eye" in name for name in TRACKED])
        self.corners = np.array(["mouth_corner" in name for name in TRACKED])
        self.mouth = np.array(["lip" in name or "mouth" in name or "chin" in name for name in TRACKED])
        self.shape: ShapePosterior = (
            deepcopy(before.shape)
            if before
            else ShapePosterior(face.neutral, face.normals, self.eyes | self.brows, fit.R, fit.t, s.shape)
        )
        self.firmness = np.full(6, s.shape.rest_sd**-2 / _LEAST_INFORMATION)
        self.firmness[JAW_DROP] = s.shape.rest_jaw_sd**-2 / _LEAST_INFORMATION
        self.look_covariance = LearnedCovariance(face.fine.appearance, s.covariance)
        self.adaptation = Adaptation(n, Pose(fit.R, fit.t, fit.animation).angles, s.adaptation)
        self.expected = np.full(n, s.weights.expected_distance)
        # What the jaw carries changes its look with it, and what the nose carries is bone: trust both further.
        self.tolerance = np.full(n, s.weights.robust_factor)
        self.tolerance[JAW] *= s.weights.jaw_tolerance
        self.tolerance[_NOSE] *= s.weights.nose_tolerance
        angle = np.radians(s.misplacement.angle_sd_deg)
        self.temples = np.array([name in _TEMPLES for name in TRACKED])
        self.least_variance = np.where(self.temples, s.misplacement.temple_sd, s.misplacement.least_sd) ** 2
        self.variance = np.column_stack([self.least_variance] * 2 + [np.full(n, angle * angle)] * 2)
        self.worn, self.masked = np.zeros(n, bool), np.zeros(n, bool)
        self.covers = Covers(face.neutral, self.eyes, self.mouth, s.visibility)
        self.spectacles_evidence: float = before.spectacles_evidence if before else 0.0
        self.learned_shut = opening_of(dict(zip(TRACKED, face.neutral, strict=True))) < _SHUT

    @property
    def neutral(self) -> Array:
        """(n, 3) landmarks at rest, head axes, as they are known now."""
        return self.shape.mean

    @property
    def is_masked(self) -> bool:
        """Whether the face was learned behind a mask."""
        return bool(self.masked[JAW[0]])

    @property
    def arrays(self) -> PersonArrays:
        """Landmarks and units as the kernels take them."""
        return self.neutral, self.units

    def in_camera(self, pose: Pose) -> Array:
        """Landmarks (n, 3) in camera axes."""
        X: Array = pose_geometry.in_camera(self.arrays, pose.arrays)
        return X

    def wear_glasses(self) -> None:
        """Trust eyes and brows less, as of a face that was learned behind dark glasses."""
        self._wear(self.eyes | self.brows)

    def wear_mask(self) -> None:
        """Trust mouth, chin and nose less, as of a face that was learned behind a mask."""
        self.masked = self.mouth.copy()
        self.masked[_BEHIND_MASK] = True
        self._wear(self.masked)

    def _wear(self, landmarks: Mask) -> None:
        """Trust the positions of these landmarks (n,) less: what was learned of them is something worn, which slides on
        the face as they do not."""
        self.worn = self.worn | landmarks
        self.least_variance = np.where(self.worn, self.settings.misplacement.worn_sd**2, self.least_variance)
        self.variance[:, :2] = np.maximum(self.variance[:, :2], self.least_variance[:, None])

    def closing(self, solution: Solution, before: Closing | None = None) -> Closing | None:
        """How far the eyes have closed; None where that is not known, also if they were shut when they were learned.
        before: the last frame's."""
        if self.learned_shut:
            return None
        return closing_of(solution.at.residual, self.face.fine.eyes, solution.facing & self.eyes, before)

    def adapted_offset(self, level: Level, pose: Pose) -> Float32:
        """What adaptation adds to the means (n, 128) of a level at a pose."""
        adapts = level.descriptor is self.face.fine.descriptor and self.adaptation.begun
        return self.adaptation.offset(pose.angles) if adapts else self.adaptation.nothing

    def learned_share(self, solution: Solution) -> float:
        """How much of the appearance at a solution was learned in turns: the mean over the landmarks that face the
        camera."""
        return self.adaptation.mean_share(self.adaptation.share(solution.pose.angles), solution.facing)

    def seen_share(self, solution: Solution) -> float:
        """Share of the landmarks that are seen, see `Solution.seen`, without those on something worn."""
        return solution.seen_share - float(np.count_nonzero(solution.seen & self.worn)) / len(self.worn)

    def layer(self, solution: Solution, view: Array) -> float:
        """Standard deviation, along a view (3,) in head axes, of the positions of the landmarks that a solution rests
        on, by their weight: those that are seen, see `Solution.seen`, and uncovered; 0 without any."""
        bare = solution.seen & ~(self.covers.covered | self.worn)
        spread: float = _spread(self.neutral, view, solution.w, bare)
        return spread

    def misplacement_variance(self, level: Level, animation: Array) -> Array:
        """Variance (n, 4) of each landmark's systematic error: the measured one, and what the units contribute, since
        no face moves exactly as they do. animation: the last frame's; by its own, an error would excuse itself."""
        pixels_per_unit, measured = level.descriptor.pixels_per_unit, self.face.fine.descriptor.pixels_per_unit
        share = self.settings.misplacement.unit_error * pixels_per_unit
        variance: Array = misplacement_variance(
            self.variance, pixels_per_unit / measured, self.units, animation, self.rest, share
        )
        return variance

    def learn(self, solution: Solution, agreement: Array) -> bool:
        """Learn from a frame in which the face looks familiar; returns whether the shape has changed. agreement: (n,)
        see `PatchHistory`."""
        self._learn_distances(solution)
        self._learn_covariance(solution)
        self._learn_locations(solution)
        self._learn_eyes(solution, agreement)
        return self.settings.shape.learn and self._learn_shape(solution)

    def _learn_distances(self, solution: Solution) -> None:
        """Expect of each landmark the distance that it mostly has."""
        s = self.settings.weights
        limits = s.least_distance, s.expected_distance
        _learn_distances(self.expected, solution.d2, solution.facing, solution.w, s.expectation_rate, limits)

    def _learn_covariance(self, solution: Solution) -> None:
        """Follow what changes the look of a face at rest, as light does, near enough to the front."""
        if self.face.fine.at(solution.pose.angles) is self.face.fine:
            worth = self.shape.worth(solution.pose.animation - self.rest)
            trusted, covered = solution.facing & (solution.w > TRUSTED), not self.covers.learnable.all()
            self.look_covariance.learn(solution.at.residual, trusted, self.expected, covered, worth)

    def metric(self, level: Level) -> tuple[Float32, Float32, int]:
        """Eigenvectors U (n, k, 128) and gain (n, k) of the metric at a level, and how many of the last of them were
        learned while tracking, see `LearnedCovariance`."""
        if level is self.face.fine:
            return self.look_covariance.U, self.look_covariance.gain, self.settings.covariance.learned
        return level.appearance.U, level.appearance.gain, 0

    def follow_quality(self, solution: Solution) -> None:
        """Expect less of a familiar face that hardly has turned and yet looks worse than usual as a whole: the picture
        has become worse, as by noise in the evening, or the face looks otherwise, as where somebody weeps."""
        s, worse = self.settings.weights, solution.misfit - 1
        if 0 < worse < math.inf and self._turned_deg(solution) < s.quality_turn_deg:
            self.expected = np.minimum((1 + s.quality_rate * worse) * self.expected, s.expected_distance)

    def learn_view(self, solution: Solution, agreement: Array) -> None:
        """Learn the appearance of a face that has turned away from the first frame's view, however strange it looks:
        from a frame in which it is known to be the same face. agreement: (n,) see `PatchHistory`."""
        s = self.settings.adaptation
        if self._turned_deg(solution) <= s.view_turn_deg:
            return
        strange = self._strange(solution, agreement, s.view_strange_distance) & self.covers.learnable
        if strange.any():
            self.adaptation.learn_view(solution.pose.angles, solution.at.residual[strange], strange)

    def _learn_eyes(self, solution: Solution, agreement: Array) -> None:
        """Learn the appearance of eyes that look strange, sooner if the person wears spectacles."""
        s = self.settings.adaptation
        low, high = _SPECTACLES_TURN_DEG
        if low < self._turned_deg(solution) < high:
            seen = solution.facing & (agreement > _SAME_PATCH)
            eyes, others = (solution.misfit_of(seen & of) for of in (self.eyes, ~self.eyes))
            if 0 < eyes < math.inf and 0 < others < math.inf:
                self.spectacles_evidence += s.spectacles_rate * (math.log(eyes / others) - self.spectacles_evidence)
        least = s.strange_distance if self.spectacles_evidence < SPECTACLES else s.spectacles_distance
        strange = self.eyes & self._strange(solution, agreement, least)
        if strange.any():
            self.adaptation.learn_eyes(solution.pose.angles, solution.at.residual[strange], strange)

    def _strange(self, solution: Solution, agreement: Array, least: float) -> Mask:
        """Landmarks (n,) that have moved with the face and whose distance is beyond `least` times the expected one."""
        moved_along = solution.facing & (agreement > _SAME_PATCH)
        return np.asarray(moved_along & (solution.d2 > least * self.expected))

    def _turned_deg(self, solution: Solution) -> float:
        """Turn of the face away from the first frame's view."""
        (tilt, pan), (first_tilt, first_pan) = solution.pose.angles.tolist(), self.adaptation.first.tolist()
        return math.degrees(math.hypot(tilt - first_tilt, pan - first_pan))

    def _learn_locations(self, solution: Solution) -> None:
        """Trust a landmark less that is often found beside where the pose puts it."""
        at, rate = solution.at, self.settings.misplacement.rate
        learn_misplacement(self.variance, self.least_variance, at.M, at.g, solution.facing, at.w, rate)

    def _learn_shape(self, solution: Solution) -> bool:
        pose = solution.pose
        share = self.adaptation.share(pose.angles)
        if self.adaptation.mean_share(share, solution.facing) > _MOST_LEARNED:
            return False
        moved = pose.animation - self.rest
        novelty = self.shape.novelty(pose.angles, moved)
        if novelty == 0:
            return False
        weight = novelty * solution.w * (1 - share)
        at = solution.at
        Lambda, gradient = shape_information(at.B, at.M, at.g, weight, pose.R, self._step_prior(moved, novelty))
        return self.shape.add(self.neutral, Lambda, gradient, novelty)

    def _step_prior(self, moved: Array, novelty: float) -> tuple[Array, Array]:
        """Information (12,) of a pose step from a solution, and the gradient (12,) of its energy there, times the
        novelty of the frame: of the head nothing is known, but a face, whose units are here `moved` (6,) from rest, is
        mostly at rest. Else a lip that is nearer than was thought would rise with every nod for ever."""
        information, gradient = np.full(12, novelty * _LEAST_INFORMATION), np.zeros(12)
        information[6:] = student_information(information[6:], self.firmness, moved, self.settings.rest.within, 1.0)
        gradient[6:] = information[6:] * moved
        return information, gradient


@kernel()
def _learn_distances(expected: Any, d2: Any, facing: Any, w: Any, rate: float, limits: Any) -> None:
    """Moving average of the squared distances expected (n,) of the landmarks that are trusted, within limits: what is
    trusted is less than what is expected, so that without a floor the trust would shrink for ever; and some are trusted
    beyond what is expected."""
    least, most = limits
    for i in range(d2.size):
        if facing[i] and w[i] > TRUSTED:
            expected[i] += rate * (d2[i] - expected[i])
        expected[i] = min(max(expected[i], least), most)


@kernel()
def _spread(points: Any, direction: Any, weight: Any, of: Any) -> float:
    """Standard deviation along a direction (3,) of those points (n, 3) that are `of` (n,), by weights (n,); 0 without
    any."""
    total, first, second = 1e-12, 0.0, 0.0
    for i in range(weight.size):
        if of[i]:
            along = points[i, 0] * direction[0] + points[i, 1] * direction[1] + points[i, 2] * direction[2]
            total += weight[i]
            first += weight[i] * along
            second += weight[i] * along * along
    mean = first / total
    return float(np.sqrt(max(second / total - mean * mean, 0.0)))
