"""The tracker for use: the posterior of the paper, minimised by its gradient, with what the paper lacks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace

import numpy as np

from mien.appearance.crop import is_blank
from mien.appearance.descriptors import Float32
from mien.appearance.views import CENTRE, roll_of
from mien.candide.model import Candide, closed_lids, with_eyes_closed
from mien.config import RealtimeSettings
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array, ray_rotation
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import LANDMARK_NAMES, LANDMARK_VERTICES, Landmarks
from mien.tracking import kernels
from mien.tracking.adaptation import Adaptation
from mien.tracking.eyes import closing_of
from mien.tracking.first_run import compiled_beside
from mien.tracking.learning import Level, learn_face
from mien.tracking.motion import JAW_DROP, Motion
from mien.tracking.posterior import PosePosterior
from mien.tracking.prior import state_sd
from mien.tracking.recovery import Keyframes, find_by_detector
from mien.tracking.shape import ShapePosterior, shape_information
from mien.tracking.solution import Pose, Prediction, Solution, View
from mien.tracking.state import Closing, Estimate, Mask, Status, TrackedLandmarks
from mien.tracking.uncertainty import (
    RECOGNITION_RATE,
    SAME_CORRELATION,
    Reference,
    confidence,
    familiarity,
    frame_variance,
    state_covariance,
    turn_squared,
)
from mien.video import Frame

_ANCHORS = {"right_ear_upper": 62, "left_ear_upper": 29, "right_cheek": 91, "left_cheek": 90, "forehead": 2}
TRACKED = {**LANDMARK_VERTICES, **_ANCHORS}
"""Names and vertices of what is tracked: the landmarks, and after them anchors that are not reported. These lie far
apart, and away from the eyes, which spectacles hide."""
_JAW = [LANDMARK_NAMES.index("lower_lip_outer"), LANDMARK_NAMES.index("chin_boss")]
_NOSE = [i for i, name in enumerate(LANDMARK_NAMES) if name.startswith("nose") or "nostril" in name]
_UPPER_LIDS, _LOWER_LIDS = (
    [LANDMARK_NAMES.index(f"{side}_eyelid_{lid}_mid") for side in ("right", "left")] for lid in ("upper", "lower")
)
_FAR = 4.0
"""Pixels of the crop: a landmark that seems further from its place than this is something else."""
_TRUSTED = 0.25
"""Robust weight above which a landmark looks as it should."""
_SAME_PATCH = 0.9
"""Agreement above which a patch has moved with the face."""
_JAW_STARTS = (0.0, 0.35, 0.7, 1.05)


class RealtimeTracker:
    """Bayesian tracker with a pose-dependent appearance and a shape that is learned while tracking."""

    def __init__(
        self,
        settings: RealtimeSettings | None = None,
        model: Candide | None = None,
        known_shape: ShapePosterior | None = None,
    ) -> None:
        """model: the face model, the package's own unless given; see `fit_first_frame`. known_shape: see `again`."""
        self.settings = settings or RealtimeSettings()
        self.model = model
        self.known_shape = known_shape

    def again(self) -> RealtimeTracker:
        """A new tracker for the same frames, which begins with the shape that this one has learned from them."""
        return RealtimeTracker(self.settings, self.model, self.shape)

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Fit the first frame and learn the appearance of its landmarks."""
        s = self.settings
        landmarks.check(frame.width, frame.height)
        self.camera = camera
        self.camera_vector = camera.vector
        self.fit = fit_first_frame(landmarks, camera, (self.model or Candide.default()).with_whole_brows())
        vertices, n = list(TRACKED.values()), len(TRACKED)
        with compiled_beside():
            self.face = learn_face(frame, landmarks, self.fit, camera, vertices, s)
        self.units = np.ascontiguousarray(self.fit.model.animation_units[:, vertices])
        self.pose = Pose(self.fit.R, self.fit.t, self.fit.animation)
        brows = np.array(["brow" in name for name in TRACKED])
        self.eyes = np.array(["eye" in name for name in TRACKED]) & ~brows
        self.shape = deepcopy(self.known_shape) or ShapePosterior(
            self.face.neutral, self.face.normals, self.eyes | brows, self.fit.R, self.fit.t, s
        )
        self.neutral = self.shape.mean
        self.adaptation = Adaptation(n, self.pose.angles, s)
        self.expected = np.full(n, s.expected_distance)
        # What the jaw carries changes its look with it, and what the nose carries is bone: trust both further.
        self.tolerance = np.full(n, s.robust_factor)
        self.tolerance[_JAW] *= s.jaw_tolerance
        self.tolerance[_NOSE] *= s.nose_tolerance
        sd = state_sd(s.prior_rotation_deg, s.prior_translation, s.prior_depth, s.prior_animation)
        sd[6 + JAW_DROP] = s.prior_jaw
        self.information = np.diag(1 / sd**2)
        self.rest_information = np.full(6, 1 / s.rest_animation**2)
        self.rest_information[JAW_DROP] = 1 / s.rest_jaw**2
        angle = np.radians(s.appearance_angle_sd_deg)
        self.variance = np.tile(np.square([s.location_sd, s.location_sd, angle, angle]), (n, 1))
        self.velocity = np.zeros(12)
        self.motion = Motion(self.face.patches, s)
        self.keyframes = Keyframes(self.fit, camera)
        self.keyframes.add(frame, self.fit.R, self.fit.t, self.fit.animation)
        self.lost_frames = 0
        self.known = 1.0
        self.first = self._reference()
        settled = self._settle(frame)
        self.first = self._reference()
        return self._estimate(frame, Status.INITIALIZED, settled)

    def _reference(self) -> Reference:
        """What rotations are measured from, where the face is now."""
        t = self.pose.t
        return Reference(self.pose.R, t / np.linalg.norm(t), self.fit.axes_sd)

    def _settle(self, frame: Frame) -> Solution:
        """Move the first pose from where the landmarks put it to where the learned appearance finds it: every later
        rotation is measured from it."""
        for _ in range(3):
            view, solution = self._fine(frame, self._stay())
            self.pose = solution.pose
        self._remember(view, solution)
        self.closing = self._closing(solution)
        return solution

    def track(self, frame: Frame) -> Estimate:
        """Predict, minimise Eq. (9), judge, learn; a face that is lost is looked for."""
        s = self.settings
        view, solution = self._search(frame)
        status = Status.TRACKED
        if solution.share(s.seen_distance) < s.least_share:
            search = self.lost_frames < 3 or self.lost_frames % s.recovery_interval == 0
            found = self._recover(frame) if search else None
            if found is None:
                return self._lose(frame, view, solution)
            view, solution = found
        if self.lost_frames:
            status = Status.RECOVERED
        self.velocity = self.pose.step_to(solution.pose) * (status is Status.TRACKED)
        self.velocity[6:] = 0  # a head that moves goes on moving, an expression stops
        self.pose, self.lost_frames = solution.pose, 0
        familiar = familiarity(solution.telling, self.pose.R, self.first.R)
        if familiar > 0.5 and solution.misfit(self.expected) < s.retry_distance:
            self._learn(solution)
            if self.keyframes.is_new(self.pose.R):
                self.keyframes.add(frame, self.pose.R, self.pose.t, self.pose.animation)
        same = self._remember(view, solution) > SAME_CORRELATION and status is Status.TRACKED
        self.known = max(self.known, self.known + RECOGNITION_RATE * (familiar - self.known)) if same else 0.0
        return self._estimate(frame, status, solution)

    def _lose(self, frame: Frame, view: View, solution: Solution) -> Estimate:
        """Stay where the face was seen last, and say why it is lost."""
        self.lost_frames += 1
        self.velocity = np.zeros(12)
        outside = self.camera.in_image(self._posed(solution.pose), frame.width, frame.height).mean() < 0.5
        unlike = "the image is blank" if is_blank(view.image) else "nothing here looks like the face of the first frame"
        return Estimate.lost(frame, "the face left the image" if outside else unlike, self.fit.mm_per_unit)

    def _recover(self, frame: Frame) -> tuple[View, Solution] | None:
        """The face at a pose that the keyframes or the detector propose, if it is the one of the first frame."""
        s = self.settings
        for placed in self._proposals(frame):
            if placed is None:
                continue
            start = Pose(*placed, self.fit.animation)
            coarse = self._solve(self._look(self.face.coarse, frame, start), start, Prediction(start, self.information))
            view, solution = self._fine(frame, Prediction(coarse.pose, self.information))
            if solution.share(s.seen_distance) >= s.recovered_share:
                self.closing = self._closing(solution)
                return view, solution
        return None

    def mesh(self, estimate: Estimate) -> Array | None:
        """Vertices (113, 3) in camera axes of an estimate of this tracker, None where it is lost."""
        if estimate.rotation is None or estimate.translation is None:
            return None
        vertices = self.fit.vertices(estimate.animation)
        if estimate.closing:
            vertices = with_eyes_closed(vertices, estimate.closing.share)
        return np.asarray(vertices @ estimate.rotation.T + estimate.translation)

    def _proposals(self, frame: Frame) -> Iterator[tuple[Array, Array] | None]:
        yield self.keyframes.find(frame, float(self.pose.t[2]))
        yield find_by_detector(frame, self.fit, self.camera)

    def _search(self, frame: Frame) -> tuple[View, Solution]:
        """The best solution near the prediction; where it does not look like the face, coarse to fine."""
        s = self.settings
        predicted = Prediction(self.pose.moved(s.velocity * self.velocity), self.information)
        view = self._look(self.face.fine, frame, predicted.pose)
        moved = predicted if self.lost_frames else self._move(view, predicted)
        view, best = self._fine(frame, moved, view=view)
        unlike = best.misfit(self.expected) > s.retry_distance
        if unlike and (moved is predicted or best.share(s.seen_distance) < s.retry_share):
            if moved is not predicted:
                view, best = self._fine(frame, predicted)
            for start in (predicted.pose, self.pose):
                coarse = self._solve(self._look(self.face.coarse, frame, start), start, predicted)
                again, fine = self._fine(frame, predicted, coarse.pose)
                if fine.energy < best.energy:
                    view, best = again, fine
            moved = predicted
        self.closing = self._closing(best)
        unlike = best.misfit(self.expected) > s.retry_distance
        if self.closing and self.closing.share > s.closing_share and not (unlike or self.lost_frames):
            view, best, moved = self._without_eyes(view, predicted)
        best = self._open_mouth(view, best, moved)
        return view, best if self.lost_frames else self._hold(predicted.pose, best)

    def _hold(self, predicted: Pose, found: Solution) -> Solution:
        """Few landmarks say less of the pose than that a head moves little in a frame: the pose between what is
        predicted and what is found, each weighed by its information."""
        s = self.settings
        seen = found.seen(s.seen_distance)
        share = float(seen.mean())
        if share >= s.hold_share:
            return found
        sd = state_sd(s.hold_rotation_deg, s.hold_translation, s.hold_translation, s.hold_animation)
        sd[6 + JAW_DROP] = s.prior_jaw
        inertia = np.diag(1 / sd**2)
        information = found.H / frame_variance(found.d2[seen], share)
        back = np.linalg.solve(information + inertia, inertia @ predicted.step_to(found.pose))
        return replace(found, pose=found.pose.moved(-back))

    def _move(self, view: View, predicted: Prediction) -> Prediction:
        """The prediction after the motion that the pixels show since the last frame."""
        person = (self.neutral, self.units)
        arrays, covariance = self.motion.measure(view.image, person, self._prior(predicted), view.geometry)
        pose = Pose(*arrays)
        drift = self.motion.drift(self.pose.step_to(pose))
        return Prediction(pose, np.linalg.inv(self.spread + covariance + np.diag(drift)))

    def _remember(self, view: View, solution: Solution) -> float:
        """Keep what the next frame's motion is measured from; returns how well it agrees with the last frame's."""
        self.spread = solution.spread
        seen = solution.facing * np.minimum(solution.w / _TRUSTED, 1)
        return self.motion.remember(view.image, (self.neutral, self.units), self.pose.arrays, view.geometry, seen)

    def _closing(self, found: Solution) -> Closing | None:
        """How far the eyes have closed."""
        eyes = self.eyes
        return closing_of(self._residual(found, eyes), self.face.fine.eyes[:, eyes], found.facing[eyes])

    def _without_eyes(self, view: View, predicted: Prediction) -> tuple[View, Solution, Prediction]:
        """The view with the eyes hidden, the best solution in it, and the motion that the rest of the face shows."""
        self.motion.weight[self.eyes] = 0
        view = replace(view, facing=view.facing & ~self.eyes)
        moved = self._move(view, predicted)
        return view, self._solve(view, moved.pose, moved), moved

    def _residual(self, solution: Solution, landmarks: Mask) -> Float32:
        """(k, 128): what was seen of k landmarks at full resolution less the mean that was expected there."""
        tilt, pan = angles = solution.pose.angles
        appearance = self.face.fine.appearance
        mean = appearance.mean(kernels.polynomial(tilt, pan, appearance.limit)[0], landmarks)
        return np.asarray(solution.y[landmarks] - mean - self.adaptation.offset(angles)[landmarks])

    def _open_mouth(self, view: View, best: Solution, predicted: Prediction) -> Solution:
        """A jaw moves further in a frame than its patches reach: where they do not fit, try it elsewhere."""
        s = self.settings
        if (best.d2 / self.expected)[_JAW].mean() < s.jaw_retry_distance:
            return best
        for jaw in _JAW_STARTS:
            if abs(jaw - best.pose.animation[JAW_DROP]) > 0.5 * _JAW_STARTS[1]:
                animation = best.pose.animation.copy()
                animation[JAW_DROP] = jaw
                candidate = self._solve(view, replace(best.pose, animation=animation), predicted)
                best = min(best, candidate, key=lambda solution: solution.energy)
        return best

    def _stay(self) -> Prediction:
        """The prediction that nothing moves."""
        return Prediction(self.pose, self.information)

    def _fine(
        self, frame: Frame, predicted: Prediction, start: Pose | None = None, view: View | None = None
    ) -> tuple[View, Solution]:
        """The best solution near a pose (the predicted one) at full resolution. A crop whose roll or size is not the
        face's changes the descriptors and so the pose: where a view is off, look again from where the face is."""
        start = start or predicted.pose
        if view is None or not self._is_upright(view, start):
            view = self._look(self.face.fine, frame, start)
        solution = self._solve(view, start, predicted)
        if not self._is_upright(view, solution.pose):
            view = self._look(self.face.fine, frame, solution.pose)
            solution = self._solve(view, solution.pose, predicted)
        return view, solution

    def _is_upright(self, view: View, pose: Pose) -> bool:
        """Whether the face at a pose has the roll and the size for which the view's crop was made."""
        s = self.settings
        rolled = math.degrees(abs(math.remainder(roll_of(pose.R) - view.crop.angle, math.tau)))
        return bool(rolled <= s.crop_roll_deg and abs(pose.t[2] / view.pose.t[2] - 1) <= s.crop_scale)

    def _look(self, level: Level, frame: Frame, pose: Pose) -> View:
        """The frame as one level sees it from a pose. What can be seen of the face is frozen here."""
        crop = level.crop(pose.R, pose.t, self.camera)
        image = crop.sample(frame.pixels, level.descriptor.blur)
        offset = 0.5 * (crop.size - 1) - crop.linear @ np.array(crop.centre)
        geometry = (self.camera_vector, crop.linear, offset, ray_rotation(pose.R @ CENTRE + pose.t))
        facing = kernels.visible(
            self._posed(pose), self.face.normals, pose.arrays[0], self.camera_vector, frame.width, frame.height,
            self.settings.hidden_cosine,
        )  # fmt: skip
        return View(level, pose, crop, image, geometry, facing & (not is_blank(image)))

    def _solve(self, view: View, start: Pose, predicted: Prediction) -> Solution:
        """Levenberg-Marquardt in one view."""
        s = self.settings
        R, t, a, energy, H, y, M, g, d2, B, w, _ = self._posterior(view, predicted).solve(
            *start.arrays, s.iterations, s.tolerance
        )
        return Solution(Pose(R, t, a), energy, H, y, M, g, d2, B, w, view.facing)

    def _prior(self, predicted: Prediction) -> tuple[Array, ...]:
        """The prior as the kernels take it: about a prediction, and of the animation about its rest. It has heavy tails
        (Student's t, weighed by the last frame): a face is mostly at rest, and where it is not it may be anything. What
        a turn does to a face looks like an expression: the further it has turned, the less an expression is believed.
        """
        s, pose = self.settings, predicted.pose
        turned = turn_squared(pose.R, self.first.R) / math.sin(math.radians(s.rest_turn_deg)) ** 2
        moved = (self.pose.animation - self.fit.animation) / s.rest_within
        firm = (1 + turned) * (1 + s.rest_firmness / (1 + moved * moved))
        return (*pose.arrays, predicted.information, self.fit.animation, firm * self.rest_information)

    def _posterior(self, view: View, predicted: Prediction) -> PosePosterior:
        """Eq. (9) for one view, the prior centred on a prediction."""
        appearance, adaptation = view.level.appearance, self.adaptation
        adapted = adaptation.nothing
        if adaptation.begun and view.level is self.face.fine:
            adapted = adaptation.offset(view.pose.angles)
        return PosePosterior(
            maps=view.maps,
            cell=view.level.descriptor.cell,
            root=view.level.descriptor.root,
            person=(self.neutral, self.units),
            appearance=(appearance.coefficients, adapted, appearance.U, appearance.gain,
                        appearance.inverse_floor, appearance.limit, self._misplaced(view.level)),
            active=view.facing.astype(np.float64),
            scale=self.tolerance * self.expected,
            prior=self._prior(predicted),
            view=view.geometry,
        )  # fmt: skip

    def _misplaced(self, level: Level) -> Array:
        """Variance (n, 4) of each landmark's systematic error: what is measured, and that no face moves just as the
        units do. The last frame says how far they moved it: in this frame's guess an error would excuse itself."""
        moved = (self.pose.animation - self.fit.animation) @ self.units.reshape(6, -1)
        error = self.settings.unit_error * level.descriptor.pixels_per_unit * moved.reshape(-1, 3)
        variance = self.variance.copy()
        variance[:, :2] += (error * error).sum(axis=1, keepdims=True)
        return variance

    def _learn(self, solution: Solution) -> None:
        s = self.settings
        w, facing = solution.w, solution.facing
        trusted = facing & (w > _TRUSTED)
        self.expected[trusted] += s.expectation_rate * (solution.d2[trusted] - self.expected[trusted])
        # What is trusted is less than what is expected: without a floor the trust would shrink for ever.
        np.maximum(self.expected, s.least_distance, out=self.expected)
        self._weigh(solution)
        tilt, pan = angles = self.pose.angles
        moved_along = self.eyes & (self.motion.agreement > _SAME_PATCH)
        strange = facing & moved_along & (solution.d2 > s.strange_distance * self.expected)
        if strange.any():
            self.adaptation.learn(angles, self._residual(solution, strange), strange)
        if s.learn_shape:
            expression = self.pose.animation - self.fit.animation
            worth = 1 / (1 + float(expression @ expression) / s.expression_sd**2)
            novelty = self.shape.novelty(tilt, pan, worth)
            if novelty < s.least_novelty:
                return
            regularizer = novelty * np.array([1e-6] * 6 + [1 / 0.3**2] * 6)
            Lambda, gradient = shape_information(
                solution.B, solution.M, solution.g, novelty * w, self.pose.R, regularizer
            )  # fmt: skip
            self.neutral = self.shape.add(self.neutral, Lambda, gradient)

    def _weigh(self, solution: Solution) -> None:
        """A landmark that is often found beside where the pose puts it says less of the pose from now on."""
        s = self.settings
        found = solution.facing & (solution.w > 1e-3)
        variance = s.location_sd**2 + solution.misplacement(_FAR)
        self.variance[:, :2] += (s.location_rate * found * (variance - self.variance[:, 0]))[:, None]

    def _posed(self, pose: Pose) -> Array:
        """Landmarks (n, 3) in camera axes."""
        shown = self.neutral + (pose.animation @ self.units.reshape(6, -1)).reshape(-1, 3)
        return np.asarray(shown @ pose.R.T + pose.t)

    def _estimate(self, frame: Frame, status: Status, solution: Solution) -> Estimate:
        """The present pose with what the solution says of its landmarks and its error."""
        n = len(LANDMARK_NAMES)
        X, closing = self._posed(self.pose)[:n], self.closing
        if closing:
            X[_UPPER_LIDS], X[_LOWER_LIDS] = closed_lids(X[_UPPER_LIDS], X[_LOWER_LIDS], closing.share)
        seen = solution.seen(self.settings.seen_distance)
        distance = np.sqrt(solution.d2[:n])
        landmarks = TrackedLandmarks(LANDMARK_NAMES, self.camera.project(X)[0], X, seen[:n].astype(float), distance)
        share = float(seen.mean())
        covariance = state_covariance(
            solution.spread, solution.d2[seen], share, self.pose.R, self.first, self.shape.relief_sd
        )
        sure = confidence(covariance, solution.telling, share, self.pose.R, self.first.R, self.known)
        return Estimate(
            frame.index, frame.time, status, self.pose.R, self.pose.t, self.pose.animation, covariance, landmarks,
            sure, self.fit.mm_per_unit, closing=closing,
        )  # fmt: skip
