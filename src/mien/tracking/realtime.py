"""The tracker for use: the posterior of the paper, minimised by its gradient, with what the paper lacks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mien.appearance.crop import is_blank
from mien.candide.model import Candide, lid_ways, with_eyes_closed
from mien.config import RealtimeSettings
from mien.errors import MienError, require
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks, rows_told
from mien.tracking import kernels
from mien.tracking.axes import HeadAxes
from mien.tracking.definite import inverse_definite, solve_definite
from mien.tracking.first_run import CompiledBeside
from mien.tracking.identity import FAMILIAR, Identity, familiarity
from mien.tracking.learning import Level
from mien.tracking.motion import JAW_DROP, MOUTH_UNITS, Motion
from mien.tracking.person import JAW, TRUSTED, Person
from mien.tracking.posterior import PosePosterior
from mien.tracking.prior import state_sd
from mien.tracking.recovery import Keyframes, find_by_detector
from mien.tracking.solution import Pose, Prediction, Solution, View
from mien.tracking.state import Estimate, Status, TrackedLandmarks
from mien.tracking.uncertainty import (
    confidence,
    frame_variance,
    state_covariance,
    turn_squared,
    visibility,
)

_LIDS = np.array(
    [[LANDMARK_NAMES.index(f"{side}_eyelid_{lid}_mid") for side in ("right", "left")] for lid in ("upper", "lower")]
)
"""Upper and lower ones."""
_JAW_STARTS = (0.0, 0.35, 0.7, 1.05)
_FACE_RADIUS = 1.3
"""CANDIDE units around the face that are not its surroundings."""
_BETTER = 0.8
"""Share of the misfit of a face whose identity is doubted below which a face elsewhere is preferred."""


class RealtimeTracker:
    """Bayesian tracker with a pose-dependent appearance and a shape that is learned while tracking."""

    def __init__(
        self,
        settings: RealtimeSettings | None = None,
        model: Candide | None = None,
        before: Person | None = None,
    ) -> None:
        """model: the face model, the package's own unless given; see `fit_first_frame`. before: see `again`."""
        self.settings = settings or RealtimeSettings()
        self.model = model
        self.before = before
        self.size: tuple[int, int] | None = None
        self.compiled = CompiledBeside()

    def again(self) -> RealtimeTracker:
        """A new tracker for the same frames, from the same landmarks of the same first one, which begins with the shape
        that this one has learned from them."""
        return RealtimeTracker(self.settings, self.model, self.person)

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Fit the first frame and learn the appearance of its landmarks."""
        s = self.settings
        landmarks.check(frame.width, frame.height)
        self.size, self.camera = (frame.width, frame.height), camera
        self.camera_vector = camera.vector
        self.fit = fit_first_frame(landmarks, camera, (self.model or Candide.default()).with_whole_brows())
        self.person = Person(frame, landmarks, self.fit, camera, s, self.before)
        self.compiled.finish()
        self.face = self.person.face
        self.pose = Pose(self.fit.R, self.fit.t, self.fit.animation)
        sd = state_sd(s.prior_rotation_deg, s.prior_translation, s.prior_depth, s.prior_animation)
        sd[6 + JAW_DROP] = s.prior_jaw
        self.information = np.diag(1 / sd**2)
        self.rest_information, self.rest_firmness = np.full(6, s.rest_animation**-2), np.full(6, s.rest_firmness)
        self.rest_information[MOUTH_UNITS], self.rest_firmness[MOUTH_UNITS] = s.rest_mouth**-2, s.rest_mouth_firmness
        self.rest_firmness[JAW_DROP] = s.rest_jaw_firmness
        self.velocity = np.zeros(12)
        self.motion = Motion(self.face.patches, s)
        self.identity = Identity(1.0 - self.person.plain)
        self.keyframes = Keyframes(self.fit, camera)
        self.keyframes.add(frame, self.fit.R, self.fit.t, self.fit.animation)
        self.lost_frames = self.doubted_frames = 0
        self.axes = self._axes()
        settled = self._settle(frame)
        self.axes = self._axes()
        self.beside = self._beside(landmarks)
        familiar = familiarity(settled.telling, self.pose.R, self.axes.first.R)
        return self._estimate(frame, Status.INITIALIZED, settled, familiar)

    def _axes(self) -> HeadAxes:
        """What rotations are measured from, where the face is now."""
        return HeadAxes(self.fit, self.pose.R, self.pose.t, self.person.shape, self.settings)

    def _settle(self, frame: Frame) -> Solution:
        """Move the first pose from where the landmarks put it to where the learned appearance finds it: every later
        rotation is measured from it."""
        for _ in range(3):
            view, solution = self._fine(frame, self._stay())
            self.pose = solution.pose
        self._remember(frame, view, solution)
        self.closing = self.person.closing(solution)
        return solution

    def _beside(self, landmarks: Landmarks) -> Array:
        """How far, (26, 3) in head axes, the landmarks of the first frame lie beside those of the model across the
        view, where the face is now; nothing for those that were not given."""
        X = self.person.posed(self.pose)[: len(LANDMARK_NAMES)]
        beside = np.zeros_like(X)
        rows = rows_told(landmarks.scheme)
        known = [LANDMARK_NAMES.index(name) for name in rows]
        points = landmarks.points[list(rows.values())].mean(axis=1)
        beside[known, :2] = (points - self.camera.project(X[known])[0]) * X[known, 2:] / self.camera.focal_px
        return np.asarray(beside @ self.pose.R)

    def track(self, frame: Frame) -> Estimate:
        """Predict, minimise Eq. (9), judge, learn; a face that is lost is looked for. Raises MienError before
        `initialize`, and for a frame of another size than the first, of which the camera is."""
        if self.size != (frame.width, frame.height):
            require(self.size is not None, "the tracker knows no face yet; call initialize first")
            raise MienError(
                f"frame {frame.index} has the size {(frame.width, frame.height)}, the first had {self.size}; "
                "scale it, as mien.stream does"
            )
        s = self.settings
        view, solution = self._search(frame)
        status = Status.TRACKED
        if solution.share(s.seen_distance) < s.least_share:
            search = self.lost_frames < 3 or self.lost_frames % s.recovery_interval == 0
            found = self._recover(frame) if search else None
            if found is None:
                return self._lose(frame, view, solution)
            view, solution = found
        elif self._doubt(solution):
            found = self._recover(frame, _BETTER * solution.misfit)
            if found is not None:
                (view, solution), status = found, Status.RECOVERED
        if self.lost_frames:
            status = Status.RECOVERED
        self.velocity = self.pose.step_to(solution.pose) * (status is Status.TRACKED)
        self.velocity[6:] = 0  # a head that moves goes on moving, an expression stops
        self.pose, self.lost_frames = solution.pose, 0
        familiar = familiarity(solution.telling, self.pose.R, self.axes.first.R)
        if familiar > FAMILIAR and not self._unlike(solution):
            self.person.learn(solution, self.identity.patches.agreement)
            self.axes.learn(self.person.shape)
            if self.keyframes.is_new(self.pose.R):
                self.keyframes.add(frame, self.pose.R, self.pose.t, self.pose.animation)
        agreements = self._remember(frame, view, solution)
        self.identity.update(familiar, agreements, lambda: self._surroundings(frame))
        if status is Status.TRACKED and self.identity.is_steady:
            self.person.learn_view(solution, self.identity.patches.agreement)
        return self._estimate(frame, status, solution, familiar)

    def _surroundings(self, frame: Frame) -> float:
        """How the surroundings of the face agree with those of twelve frames ago."""
        radius = _FACE_RADIUS * self.camera.focal_px / float(self.pose.t[2])
        return self.identity.scene.correlation(frame, self.camera.project(self.pose.t)[0], radius)

    def _lose(self, frame: Frame, view: View, solution: Solution) -> Estimate:
        """Stay where the face was seen last, and say why it is lost."""
        self.lost_frames += 1
        self.velocity, self.closing = np.zeros(12), None
        outside = self.camera.in_image(self.person.posed(solution.pose), frame.width, frame.height).mean() < 0.5
        unlike = "the image is blank" if is_blank(view.image) else "nothing here looks like the face of the first frame"
        return Estimate.lost(frame, "the face left the image" if outside else unlike, self.fit.mm_per_unit)

    def _doubt(self, solution: Solution) -> bool:
        """Whether to look if the face is somewhere else: from time to time while nothing says that this is it."""
        doubtful = self.identity.is_doubted and self._unlike(solution)
        self.doubted_frames = self.doubted_frames + 1 if doubtful else 0
        return doubtful and self.doubted_frames % self.settings.doubt_interval == 0

    def _recover(self, frame: Frame, misfit: float = math.inf) -> tuple[View, Solution] | None:
        """The face at a pose that the detector or the keyframes propose, if it is the one of the first frame, and there
        is less of a misfit."""
        s = self.settings
        for placed in self._proposals(frame):
            start = Pose(*placed, self.fit.animation)
            coarse = self._solve(self._look(self.face.coarse, frame, start), start, Prediction(start, self.information))
            view, solution = self._fine(frame, Prediction(coarse.pose, self.information))
            if solution.share(s.seen_distance) >= s.recovered_share and solution.misfit < misfit:
                self.closing = self.person.closing(solution)
                return view, solution
        return None

    def mesh(self, estimate: Estimate) -> Array | None:
        """Vertices (113, 3) in camera axes of an estimate of this tracker, None where it is lost."""
        if estimate.rotation is None or estimate.translation is None:
            return None
        vertices = self.fit.vertices(estimate.animation)
        if estimate.closing:
            vertices = with_eyes_closed(vertices, estimate.closing.share)
        return np.asarray(vertices @ self.axes.model_rotation(estimate.rotation).T + estimate.translation)

    def _proposals(self, frame: Frame) -> Iterator[tuple[Array, Array]]:
        s, lost = self.settings, self.lost_frames
        thorough = lost < s.recovery_patience or lost % (3 * s.recovery_interval) == 0
        yield from find_by_detector(frame, self.fit, self.camera, thorough)
        known = self.keyframes.find(frame, self.pose.t) if thorough else None
        if known is not None:
            yield known

    def _search(self, frame: Frame) -> tuple[View, Solution]:
        """The best solution near the prediction; where it does not look like the face, coarse to fine."""
        s = self.settings
        predicted = Prediction(self.pose.moved(s.velocity * self.velocity), self.information)
        view = self._look(self.face.fine, frame, predicted.pose)
        moved = predicted if self.lost_frames else self._move(view, predicted)
        view, best = self._fine(frame, moved, view=view)
        if self._unlike(best) and (moved is predicted or best.share(s.seen_distance) < s.retry_share):
            if moved is not predicted:
                view, best = self._fine(frame, predicted)
            for start in (predicted.pose, self.pose):
                coarse = self._solve(self._look(self.face.coarse, frame, start), start, predicted)
                again, fine = self._fine(frame, predicted, coarse.pose)
                if fine.energy < best.energy:
                    view, best = again, fine
            moved = predicted
        self.closing = self.person.closing(best, self.closing)
        blinking = self.closing is not None and self.closing.share > s.closing_share
        if blinking and not self.lost_frames and not self._unlike(best):
            view, best, moved = self._without_eyes(view, predicted)
        best = self._open_mouth(view, best, moved)
        return view, best if self.lost_frames else self._hold(predicted.pose, best)

    def _unlike(self, found: Solution) -> bool:
        """Whether what was found does not look like the face."""
        return found.misfit > self.settings.retry_distance

    def _hold(self, predicted: Pose, found: Solution) -> Solution:
        """Few landmarks say less of the pose than that a head moves little in a frame: the pose between what is
        predicted and what is found, each weighed by its information."""
        s = self.settings
        seen = found.seen(s.seen_distance)
        share = np.count_nonzero(seen) / len(seen)
        if share >= s.hold_share:
            return found
        sd = state_sd(s.hold_rotation_deg, s.hold_translation, s.hold_translation, s.hold_animation)
        sd[6 + JAW_DROP] = s.prior_jaw
        inertia = np.diag(1 / sd**2)
        information = found.H / frame_variance(found.d2[seen], share)
        back = solve_definite(information + inertia, inertia @ predicted.step_to(found.pose))
        return replace(found, pose=found.pose.moved(-back))

    def _move(self, view: View, predicted: Prediction) -> Prediction:
        """The prediction after the motion that the pixels show since the last frame."""
        prior = self._prior(predicted)
        arrays, covariance = self.motion.measure(view.image, self.person.arrays, prior, view.geometry)
        pose = Pose(*arrays)
        covariance += self.spread
        covariance.reshape(-1)[::13] += self.motion.drift(self.pose.step_to(pose))  # the diagonal
        return Prediction(pose, inverse_definite(covariance))

    def _remember(self, frame: Frame, view: View, solution: Solution) -> tuple[float, float]:
        """Keep what the next frame's motion is measured from, and what surrounds it; returns how well the patches agree
        with the last frame's, and with those of some frames ago."""
        self.identity.scene.remember(frame)
        self.spread = solution.spread
        seen = solution.facing * np.minimum(solution.w / TRUSTED, 1)
        patches = self.motion.remember(view.image, self.person.arrays, self.pose.arrays, view.geometry)
        agreements = self.identity.patches.add(*patches, seen)
        mouth = self.person.mouth
        self.visible = visibility(solution.d2, solution.facing, self.identity.patches.agreement, mouth)
        # A mouth that moves soon looks like nothing that is known of it: its patches say how it moves while it is seen.
        self.motion.weight = np.maximum(seen, mouth * self.visible)
        return agreements

    def _without_eyes(self, view: View, predicted: Prediction) -> tuple[View, Solution, Prediction]:
        """The view with the eyes hidden, the best solution in it, and the motion that the rest of the face shows."""
        self.motion.weight[self.person.eyes] = 0
        self.identity.patches.disregard(self.person.eyes)
        view = replace(view, facing=view.facing & ~self.person.eyes)
        moved = self._move(view, predicted)
        return view, self._solve(view, moved.pose, moved), moved

    def _open_mouth(self, view: View, best: Solution, predicted: Prediction) -> Solution:
        """A jaw moves further in a frame than its patches reach: where they do not fit, try it elsewhere."""
        s = self.settings
        if sum(float(best.d2[k] / self.person.expected[k]) for k in JAW) < s.jaw_retry_distance * len(JAW):
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
        """The best solution near a pose (the predicted one) at full resolution, with descriptors that are upright
        there. Where the crop was made for a face elsewhere, look again from where it is."""
        start = start or predicted.pose
        if view is None or not self._is_made_for(view, start):
            view = self._look(self.face.fine, frame, start)
        view = view.upright_at(start)
        solution = self._solve(view, start, predicted)
        if not self._is_made_for(view, solution.pose):
            view = self._look(self.face.fine, frame, solution.pose)
            solution = self._solve(view, solution.pose, predicted)
        return view, solution

    def _is_made_for(self, view: View, pose: Pose) -> bool:
        """Whether the crop of a view was made for a face of nearly the roll, size and place of that at a pose."""
        s, (roll, scale) = self.settings, view.leaning(pose)
        upright = abs(math.degrees(roll)) <= s.crop_roll_deg
        return upright and abs(scale - 1) <= s.crop_scale and view.shift(pose) <= s.crop_shift

    def _look(self, level: Level, frame: Frame, pose: Pose) -> View:
        """The frame as one level sees it from a pose. What can be seen of the face is frozen here."""
        crop = level.crop(pose.R, pose.t, self.camera)
        image = crop.sample(frame, level.descriptor.blur)
        geometry = (self.camera_vector, crop.linear, crop.offset, pose.ray)
        facing = kernels.visible(
            self.person.posed(pose), self.face.normals, pose.arrays[0], self.camera_vector, frame.width, frame.height,
            self.settings.hidden_cosine,
        )  # fmt: skip
        facing &= level.depth_behind(pose.angles) < self.settings.hidden_depth
        if is_blank(image):
            facing[:] = False
        return View(level, pose, pose, crop, image, geometry, facing)

    def _solve(self, view: View, start: Pose, predicted: Prediction) -> Solution:
        """Levenberg-Marquardt in one view."""
        s = self.settings
        R, t, a, energy, H, residual, M, g, d2, B, w, _ = self._posterior(view, predicted).solve(
            *start.arrays, s.iterations, s.tolerance
        )
        return Solution(Pose(R, t, a), energy, H, residual, M, g, d2, B, w, view.facing, self.person.expected.copy())

    def _prior(self, predicted: Prediction) -> tuple[Array, ...]:
        """The prior as the kernels take it: about a prediction, and of the animation about its rest. It has heavy tails
        (Student's t, weighed by the last frame): a face is mostly at rest, and where it is not it may be anything. What
        a turn does to a face looks like an expression: the further it has turned, the less an expression is believed.
        """
        s, pose = self.settings, predicted.pose
        turned = turn_squared(pose.R, self.axes.first.R) / math.sin(math.radians(s.rest_turn_deg)) ** 2
        moved = (self.pose.animation - self.fit.animation) / s.rest_within
        firm = kernels.firm(self.rest_information, moved, self.rest_firmness, 1 + turned)
        return (*pose.arrays, predicted.information, self.fit.animation, firm)

    def _posterior(self, view: View, predicted: Prediction) -> PosePosterior:
        """Eq. (9) for one view, the prior centred on a prediction."""
        person, level, appearance = self.person, view.level, view.level.appearance
        trust = 1 / (1 + level.lack_of_fit(view.pose.angles) / self.settings.lack_of_fit)
        return PosePosterior(
            maps=view.maps,
            reading=view.reading,
            person=person.arrays,
            appearance=(appearance.coefficients, person.adapted(level, view.upright), appearance.U,
                        trust[:, None] * appearance.gain, trust * appearance.inverse_floor, appearance.limit,
                        person.misplaced(level, self.pose.animation)),
            active=view.facing.astype(np.float64),
            scale=person.tolerance * person.expected,
            prior=self._prior(predicted),
            view=view.geometry,
        )  # fmt: skip

    def _estimate(self, frame: Frame, status: Status, solution: Solution, familiar: float) -> Estimate:
        """The present pose with what the solution says of its landmarks and its error. familiar: see `familiarity`."""
        n = len(LANDMARK_NAMES)
        closing = self.closing
        ways = lid_ways(closing.share if closing else 0.0)
        X, image = kernels.told(self.person.arrays, self.beside, *self.pose.arrays, _LIDS, ways, self.camera_vector)
        seen = solution.seen(self.settings.seen_distance)
        distance = np.sqrt(solution.d2[:n])
        landmarks = TrackedLandmarks(LANDMARK_NAMES, image, X, self.visible[:n], distance)
        share = np.count_nonzero(seen) / len(seen)
        relief_sd, learned = self.person.shape.relief_sd, self.person.learned_share(solution)
        covariance = state_covariance(
            solution.spread, solution.d2[seen], share, self.pose.R, self.axes.first, relief_sd, learned
        )
        sure = confidence(covariance, share, familiar, self.identity.probability)
        return Estimate(
            frame.index, frame.time, status, self.axes.rotation(self.pose.R), self.pose.t, self.pose.animation,
            covariance, landmarks, sure, self.fit.mm_per_unit, closing=closing,
        )  # fmt: skip
