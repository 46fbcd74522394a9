"""The real-time tracker, the preset `realtime`: the paper's posterior, minimised by its gradient, and what it lacks.

Each frame: predict the pose from the motion of the pixels, minimise Eq. (9) from there, decide whether what was found
is the face, learn from it, and report. A face that is lost is searched for with keyframes and the detector.
"""

from __future__ import annotations

import math

import numpy as np

from mien.appearance.crop import is_blank
from mien.appearance.quality import FINEST, sharpness
from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH, Candide, lid_closing, with_eyes_closed
from mien.config import RealtimeSettings, given_or_default
from mien.errors import require, warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.graphics import Graphics
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.threads import one_blas_thread
from mien.tracking.prior import state_sd
from mien.tracking.realtime import pose_geometry
from mien.tracking.realtime.axes import HeadAxes
from mien.tracking.realtime.definite import solve_definite
from mien.tracking.realtime.features import FeatureSearch
from mien.tracking.realtime.first_run import BackgroundCompilation, load_cached
from mien.tracking.realtime.identity import FAMILIAR, Identity, familiarity
from mien.tracking.realtime.motion import Motion
from mien.tracking.realtime.mouth import MouthSearch
from mien.tracking.realtime.person import TRUSTED, Person
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.recovery import Recovery
from mien.tracking.realtime.skin_search import SkinSearch
from mien.tracking.realtime.solution import Solution, View
from mien.tracking.realtime.solver import PoseSolver
from mien.tracking.realtime.uncertainty import (
    UNSEEN_MOUTH_SD,
    Reference,
    ReliefError,
    confidence,
    focal_covariance,
    frame_variance,
    state_covariance,
    visibility,
)
from mien.tracking.realtime.veiled import Veiled, veiled_parts
from mien.tracking.state import (
    Closing,
    Estimate,
    Status,
    TrackedLandmarks,
    require_begun,
    require_first,
    require_next_of,
)

_LIDS = np.array(
    [[LANDMARK_NAMES.index(f"{side}_eyelid_{lid}_mid") for side in ("right", "left")] for lid in ("upper", "lower")]
)
"""Rows (2, 2) of the landmarks on the upper and lower eyelids."""
_NEAREST = 1.0
"""Least distance of a face in CANDIDE units, about 11 cm: turned, a part of it would be behind a nearer camera."""
_BLURRED = 0.4
"""`sharpness` of a face in the first frame below which it is blurred."""
_COARSE = 25.0
"""Grey values to which it was rounded there from which it is coarsely compressed: standard deviations nearly double."""
_FACE_RADIUS = 1.3
"""Radius in CANDIDE units around the face beyond which the surroundings begin."""


class RealtimeTracker:
    """Bayesian tracker with a pose-dependent appearance and a shape that is learned while tracking.

    What it knows of the person is in `person`, where the face is in `pose`; `identity` judges whether it is still the
    face of the first frame, and `axes` relates the model's axes to the head's.
    """

    def __init__(
        self,
        settings: RealtimeSettings | None = None,
        model: Candide | None = None,
        before: Person | None = None,
    ) -> None:
        """model: the face model, by default CANDIDE-3; see `fit_first_frame`. before: what an earlier pass over the
        same frames has learned, see `again`."""
        self.settings = given_or_default(settings, RealtimeSettings)
        self.model = model
        self.before = before
        self.size: tuple[int, int] | None = None
        self.graphics: Graphics | None = None
        self.compilation = BackgroundCompilation()

    def again(self) -> RealtimeTracker:
        """A tracker for a second pass over the same frames, from the same first frame and landmarks: it begins with the
        shape that this one has learned. Raises MienError before `initialize`, and where that has failed."""
        require_begun(self.size)
        return RealtimeTracker(self.settings, self.model, self.person)

    @one_blas_thread()
    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Fit the first frame and learn the appearance of its landmarks. Raises MienError for landmarks that cannot be
        tracked, and for a face that would be nearer to the camera than it is wide."""
        s = self.settings
        require_first(frame, landmarks, camera)
        self.size = None  # until the face is known
        self.graphics, frame = landmarks.graphics, frame.behind(landmarks.graphics)
        self.camera = camera
        self.fit = fit_first_frame(landmarks, camera, (self.model or Candide.default()).with_whole_brows())
        focal, mm = f"{camera.focal_px:.0f} pixels", f"{self.fit.t[2] * self.fit.mm_per_unit:.0f} mm"
        require(
            self.fit.t[2] >= _NEAREST,
            f"with a focal length of {focal} the face would be {mm} from the camera; "
            "give the camera's own focal length or field of view",
        )
        self.person = Person(frame, landmarks, self.fit, camera, s, self.before)
        self.compilation.finish()
        load_cached()
        self.face = self.person.face
        self.pose = Pose(self.fit.R, self.fit.t, self.fit.animation)
        self.prior = StatePrior(self.pose, s)
        self.solver = PoseSolver(self.person, camera, self.prior, s)
        self.velocity = np.zeros(12)
        self.motion = Motion(self.face.patches, self.person.mouth, s.prior.jaw, s.motion)
        self.identity = Identity(1.0 - self.person.temples)
        self.lost_frames = 0
        settled = self._learn_first_pose(frame)
        self._warn_of_what_is_hidden(frame, landmarks.source)
        self.recovery = Recovery(self.fit, self.pose, camera, self.solver, self.prior, s.recovery)
        self.recovery.keyframes.add(frame, self.fit.R, self.fit.t, self.fit.animation)
        covered = 0.0 if self.graphics is None else self.solver.share_behind_graphics(self.graphics, self.pose)
        sharp, rounding = self._quality(frame, landmarks.source)
        flat, worn = landmarks.depths is None, bool(self.person.worn.any())
        sight = self.pose.line_of_sight
        first = Reference(self.pose.R, sight, self.fit.axes_sd, covered, sharp, rounding, flat, worn)
        self.axes = HeadAxes(self.fit, first, self.person.shape, s.axes)
        self.landmark_offsets = self._landmark_offsets(landmarks)
        familiar = self._familiarity(settled)
        self.size = frame.width, frame.height
        return self._estimate(frame, Status.INITIALIZED, settled, familiar)

    def _learn_first_pose(self, frame: Frame) -> Solution:
        """Refine the pose that the landmarks gave by the learned appearance, as later rotations are measured from it,
        and take note of what is seen there, and of what is worn."""
        for _ in range(3):
            view, solution = self.solver.refine(frame, self.prior.prediction(self.pose, self.pose))
            self.pose = solution.pose
        self.prior.seen_from, self.first_animation = self.pose.seen_from, self.pose.animation
        self.skin = SkinSearch(self.person, self.prior, view, self.pose, self.settings.skin)
        self.mouth = MouthSearch(self.person, self.solver, self.prior, view, self.pose, self.settings.mouth)
        self.features = FeatureSearch(self.person, self.solver, self.prior, self.settings.features)
        self._remember(frame, view, solution)
        self.closing, self.learned_veiled = self.person.closing(solution), self.veiled.all
        if self.learned_veiled:
            self.person.wear_glasses()
        if self.veiled.mouth:
            self.person.wear_mask()
        return solution

    def _warn_of_what_is_hidden(self, frame: Frame, source: str) -> None:
        """Warn if the eyes or the mouth cannot be seen in the first frame. source: of its landmarks."""
        if self.person.is_masked:
            warn(
                f"{source}: the mouth cannot be seen at {frame.time:.2f} s, where the face is learned, as behind a "
                "mask, so that nothing is known of what it does; begin where it is seen"
            )
        if self.closing is None:
            warn(
                f"{source}: the eyes are shut, covered or too small at {frame.time:.2f} s, where the face is learned, "
                "so that eyes_closed is not estimated; begin where they are open; in a file, `mien landmarks` with "
                "--start finds landmarks there, and --landmarks learns the face from them"
            )
        elif self.learned_veiled:
            warn(
                f"{source}: the eyes cannot be seen at {frame.time:.2f} s, where the face is learned, as behind dark "
                "glasses or reflections, so that eyes_closed is not estimated; begin where they are seen"
            )

    def _quality(self, frame: Frame, source: str) -> tuple[float, float]:
        """Sharpness of the face in the first frame, and to how many grey values it was rounded, see `Reference`; warns
        if it is blurred or coarsely compressed. source: of the landmarks, for the warning."""
        camera = self.solver.face_camera(self.face.fine, self.pose)
        sharp = sharpness(camera.sample(frame, FINEST))  # however much the descriptors are smoothed
        rounding = (frame.quantizer_step or 0.0) * camera.scale
        poor = "blurred or enlarged" if sharp < _BLURRED else "coarsely compressed" if rounding > _COARSE else ""
        if poor:
            warn(
                f"{source}: the face is {poor} at {frame.time:.2f} s, where it is learned: what it does is less "
                "certain, as the standard deviations say"
            )
        return sharp, rounding

    def _landmark_offsets(self, landmarks: Landmarks) -> Array:
        """Offsets (26, 3), in head axes and parallel to the image plane, from the model's landmarks to those given in
        the first frame; zero for those that were not given."""
        X = self.person.in_camera(self.pose)[: len(LANDMARK_NAMES)]
        offsets = np.zeros_like(X)
        reported = landmarks.reported()
        known, points = [LANDMARK_NAMES.index(name) for name in reported], np.array(list(reported.values()))
        offsets[known, :2] = (points - self.camera.project(X[known])[0]) * X[known, 2:] / self.camera.focal_px
        return np.asarray(offsets @ self.pose.R)

    def track(self, frame: Frame) -> Estimate:
        """The face in the next frame; one that is lost is searched for. Raises MienError before `initialize`, and for a
        frame whose size differs from the first one's."""
        require_next_of(self.size, frame)
        s, frame = self.settings, frame.behind(self.graphics)
        view, solution = self._search(frame)
        status = Status.RECOVERED if self.lost_frames else Status.TRACKED
        found = self.recovery.elsewhere(frame, solution, self.pose, self.lost_frames, self.identity.is_doubted)
        if found is not None:
            (view, solution), status = found, Status.RECOVERED
            self.closing = self.person.closing(solution)
        elif solution.inlier_share < s.recovery.least_share:
            return self._lose(frame, view, solution)
        self.velocity = self.pose.step_to(solution.pose) * (status is Status.TRACKED)
        self.velocity[6:] = 0  # a head keeps moving, an expression does not
        self.pose, self.lost_frames = solution.pose, 0
        familiar = self._familiarity(solution)
        agreements = self._remember(frame, view, solution)
        self.person.covers.update(
            solution.d2_without_noise, solution.facing, self.identity.patches.agreement, self.mouth.is_open
        )
        if familiar > FAMILIAR:
            if not self.solver.misfits(solution):
                self._learn(frame, solution)
            self.person.follow_quality(solution)
        self.identity.update(familiar, agreements, self._surroundings)
        if status is Status.TRACKED and self.identity.is_steady:
            self.person.learn_view(solution, self.identity.patches.agreement)
        return self._estimate(frame, status, solution, familiar)

    def _learn(self, frame: Frame, solution: Solution) -> None:
        """Learn from a frame in which the face looks as it should."""
        if self.person.learn(solution, self.identity.patches.agreement):
            self.axes.learn(self.person.shape)
        keyframes = self.recovery.keyframes
        pose = solution.pose
        if keyframes.is_new(pose.R):
            keyframes.add(frame, pose.R, pose.t, pose.animation)

    def _familiarity(self, solution: Solution) -> float:
        """`familiarity` of a solution."""
        cosine = float(solution.pose.seen_from @ self.axes.first.seen_from)
        return familiarity(solution.best_d2, math.acos(min(max(cosine, -1.0), 1.0)))

    def _surroundings(self) -> float:
        """Correlation of the surroundings of the face in the frame remembered last with those of `LOOK_BACK` frames
        before."""
        radius = _FACE_RADIUS * self.camera.focal_px / float(self.pose.t[2])
        return self.identity.scene.correlation(self.camera.project(self.pose.t)[0], radius)

    def _lose(self, frame: Frame, view: View, solution: Solution) -> Estimate:
        """Keep the last pose, and report why the face is lost."""
        self.lost_frames += 1
        self.velocity, self.closing = np.zeros(12), None
        self.person.covers.forget()
        outside = self.camera.in_image(self.person.in_camera(solution.pose), frame.width, frame.height).mean() < 0.5
        if outside:
            reason = "the face left the image"
        elif is_blank(view.image):
            reason = "the image is blank where the face was"
        else:
            reason = "nothing here looks like the face of the first frame"
        return Estimate.lost(frame, reason, self.fit.mm_per_unit)

    def mesh(self, estimate: Estimate) -> Array | None:
        """Vertices (113, 3) in camera axes of an estimate of this tracker, or of one read from its table, whose
        rotations have the axes that are known now; None where the face is lost. Raises MienError before
        `initialize`."""
        require_begun(self.size)
        if estimate.rotation is None or estimate.translation is None:
            return None
        R = estimate.model_rotation
        R = self.axes.model_rotation(estimate.rotation) if R is None else R
        vertices = self.fit.vertices(estimate.animation)
        if estimate.closing:
            vertices = with_eyes_closed(vertices, estimate.closing.share)
        return np.asarray(vertices @ R.T + estimate.translation)

    def _reported_landmarks(self, pose: Pose, closed: float) -> tuple[Array, Array]:
        """The landmarks of a pose as they are reported, with the shape that is known now: (26, 3) in camera axes and
        (26, 2) in the image. closed: how far the eyes are."""
        X, image = pose_geometry.reported_landmarks(
            self.person.arrays,
            self.landmark_offsets,
            pose.arrays,
            _LIDS,
            lid_closing(closed),
            self.solver.camera_vector,
        )
        return X, image

    def landmark_depths(self, R: Array, t: Array, animation: Array, closed: float) -> Array:
        """Depths (26,) in CANDIDE units of the landmarks of an earlier estimate, by the shape that is known now. R:
        its `model_rotation`; closed: how far the eyes were."""
        # An estimate's arrays are read-only: for such the kernel would be compiled once more.
        pose = Pose(R.copy(), t.copy(), animation.copy())
        return np.asarray(self._reported_landmarks(pose, closed)[0][:, 2])

    def _search(self, frame: Frame) -> tuple[View, Solution]:
        """The best solution near the prediction; coarse to fine where the first one does not look like the face."""
        s = self.settings
        predicted = self.prior.prediction(self.pose.moved(s.prior.velocity * self.velocity), self.pose)
        view = self.solver.view(self.face.fine, frame, predicted.pose)
        moved = predicted if self.lost_frames else self._predict_from_motion(view, predicted)
        view, best = self.solver.refine(frame, moved, view=view)
        if self.solver.misfits(best) and (moved is predicted or best.inlier_share < s.solver.retry_share):
            near = (view, best) if moved is predicted else self.solver.refine(frame, predicted)
            starts = [self.solver.coarse(frame, predicted, start) for start in (predicted.pose, self.pose)]
            others = [self.solver.refine(frame, predicted, start) for start in starts]
            view, best = min([near, *others], key=lambda found: found[1].energy)
            moved = predicted
        self.closing = self.person.closing(best, self.closing)
        if self._eyes_are_shut and not self.lost_frames and not self.solver.misfits(best):
            view, best, moved = self._without_eyes(view, predicted)
        best = self.mouth.search(view, best, moved)
        best = self.features.search(view, best, moved, self.visible, not self.mouth.is_put_back)
        return view, best if self.lost_frames else self._damp(predicted.pose, best)

    @property
    def _eyes_are_shut(self) -> bool:
        return self.closing is not None and self.closing.share > self.settings.visibility.closing_share

    def _damp(self, predicted: Pose, found: Solution) -> Solution:
        """Where few landmarks are seen, fuse the solution with the prediction, each weighed by its information: that a
        head moves little in a frame then says more than the landmarks do."""
        s = self.settings
        if found.seen_share >= s.hold.share:
            return found
        sd = state_sd(s.hold.rotation_deg, s.hold.translation, s.hold.translation, s.hold.animation, s.prior.jaw)
        inertia = np.diag(1 / sd**2)
        information = found.at.H / frame_variance(found.seen_d2, found.seen_share)
        back = solve_definite(information + inertia, inertia @ predicted.step_to(found.pose))
        return found.with_pose(found.pose.moved(-back))

    def _predict_from_motion(self, view: View, predicted: Prediction) -> Prediction:
        """The prediction corrected by the motion of the pixels since the last frame, and by where the skin that moves
        with lips and brows is."""
        prior = self.prior.arrays(predicted)
        moved, measured = self.motion.measure(view.image, self.person.arrays, prior, view.geometry)
        pose = Pose(*moved)
        step = self.pose.step_to(pose)
        information = self.motion.information_of(measured, prior.information, self.step_covariance, step)
        return self.skin.with_skin(view, predicted.improved(pose, information))

    def _remember(self, frame: Frame, view: View, solution: Solution) -> tuple[float, float]:
        """Store what the next frame is compared with: the patches and the surroundings. Returns the correlations of the
        patches that `PatchHistory.add` gives."""
        self.identity.scene.remember(frame)
        self.step_covariance = solution.step_covariance
        seen = solution.facing * np.minimum(solution.w / TRUSTED, 1)
        patches = self.motion.remember(view.image, self.person.arrays, solution.pose.arrays, view.geometry)
        agreements = self.identity.patches.add(*patches, seen, frame.time)
        mouth = self.person.mouth
        self.visible = visibility(solution.d2_without_noise, solution.facing, self.identity.patches.agreement, mouth)
        self.veiled = self._veiled(view, solution.pose, patches[1])
        self.visible[self.veiled.landmarks] = 0
        # A moving mouth soon looks unlike anything learned: while it is visible, its patches still show how it moves.
        self.motion.weight = np.maximum(seen, mouth * self.visible) * ~self.person.worn
        return agreements

    def _veiled(self, view: View, pose: Pose, norms: Array) -> Veiled:
        """The eyes and the mouth that cannot be seen. norms: (n,) of the patches, see `Template`."""
        shown = view.all_facing, norms, 1 / math.sqrt(self.face.patches.shape[1])
        arrays = self.person.arrays
        return veiled_parts(view.image, arrays, pose.arrays, view.geometry, shown, self.settings.visibility)

    def _told_pose(self, solution: Solution) -> Pose:
        """The pose that is reported: the mouth at rest if it is never seen, as its units follow what it is behind."""
        pose = solution.pose
        if not self.person.is_masked:
            return pose
        return pose.with_animation(np.where(MOVES_MOUTH, self.first_animation, pose.animation))

    @property
    def _told_closing(self) -> Closing | None:
        """The closing that is reported: none of eyes that cannot be seen, or could not where they were learned."""
        return None if self.veiled.all or self.learned_veiled else self.closing

    def _without_eyes(self, view: View, predicted: Prediction) -> tuple[View, Solution, Prediction]:
        """The view, solution and predicted motion without the landmarks of the eyes, while these blink."""
        self.motion.weight[self.person.eyes] = 0
        self.identity.patches.disregard(self.person.eyes)
        view = view.of_landmarks(~self.person.eyes)
        moved = self._predict_from_motion(view, predicted)
        return view, self.solver.solve(view, moved.pose, moved), moved

    def _estimate(self, frame: Frame, status: Status, solution: Solution, familiar: float) -> Estimate:
        """The estimate of a frame: the pose of a solution, its landmarks, covariance and confidence. familiar:
        `familiarity`."""
        share = self.person.seen_share(solution)
        covariance = self._covariance(solution, share)
        return Estimate(
            frame.index,
            frame.time,
            status,
            rotation=self.axes.rotation(solution.pose.R),
            translation=solution.pose.t,
            animation=self._told_pose(solution).animation,
            covariance=covariance,
            landmarks=self._tracked_landmarks(solution),
            confidence=confidence(covariance, share, familiar, self.identity.probability),
            mm_per_unit=self.fit.mm_per_unit,
            closing=self._told_closing,
            model_rotation=solution.pose.R,
        )

    def _tracked_landmarks(self, solution: Solution) -> TrackedLandmarks:
        """The landmarks at the pose of a solution, how visible they are, and how far from what was expected."""
        n = len(LANDMARK_NAMES)
        closing = self._told_closing
        X, image = self._reported_landmarks(self._told_pose(solution), closing.share if closing else 0.0)
        hidden = self.person.masked | self.person.eyes if self._eyes_are_shut else self.person.masked
        visible = np.where(hidden[:n], 0.0, self.visible[:n])
        distance = np.where(solution.facing[:n], np.sqrt(solution.d2[:n]), np.nan)
        return TrackedLandmarks(LANDMARK_NAMES, image, X, visible, distance)

    def _covariance(self, solution: Solution, share: float) -> Array:
        """Covariance (12, 12) of the pose of a solution, see `Estimate`. share: `Person.seen_share`."""
        first, shape = self.axes.first, self.person.shape
        relief = ReliefError(
            shape.relief_sd,
            lean=math.hypot(*shape.lean.tolist()),
            learned=self.person.learned_share(solution),
            layer=self.person.layer(solution, first.seen_from),
        )
        pose, moved = solution.pose, solution.pose.animation - self.first_animation
        spread, d2 = solution.step_covariance, solution.seen_d2
        covariance = state_covariance(spread, d2, share, pose, moved, first, relief)
        if self.person.is_masked:
            covariance[6:, 6:] += np.diag(UNSEEN_MOUTH_SD**2)
        if self.camera.focal_log_sd > 0:
            covariance[:6, :6] += focal_covariance(pose.t, first.line_of_sight, self.camera.focal_log_sd)
        return covariance
