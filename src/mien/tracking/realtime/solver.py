"""The face in one frame: the pose that minimises Eq. (9), near a prediction."""

from __future__ import annotations

import math

import numpy as np

from mien.appearance.crop import is_blank
from mien.appearance.descriptors import StretchArrays, rigid
from mien.appearance.face_camera import FaceCamera
from mien.arrays import Array, Mask
from mien.config import RealtimeSettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.graphics import Graphics
from mien.tracking.realtime import pose_geometry
from mien.tracking.realtime.kernels import AppearanceArrays
from mien.tracking.realtime.level import Level
from mien.tracking.realtime.person import Person
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.posterior import LowestPoint, PosePosterior
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.solution import Solution, View


class PoseSolver:
    """Looks at a frame through the crop for a pose, and minimises Eq. (9) there."""

    def __init__(self, person: Person, camera: Camera, prior: StatePrior, settings: RealtimeSettings) -> None:
        self.person, self.face = person, person.face
        self.camera, self.camera_vector = camera, camera.vector
        self.prior = prior
        self.settings = settings
        self.rigid = rigid(len(person.expected))

    def refine(
        self, frame: Frame, predicted: Prediction, start: Pose | None = None, view: View | None = None
    ) -> tuple[View, Solution]:
        """The best solution at full resolution from a start, by default the predicted pose. A view that was not made
        for nearly that pose, or for the solution's, is replaced by one that is."""
        start = start or predicted.pose
        if view is None or not self._fits(view, start):
            view = self.view(self.face.fine, frame, start)
        view = view.upright_at(start)
        solution = self.solve(view, start, predicted)
        if not self._fits(view, solution.pose):
            view = self.view(self.face.fine, frame, solution.pose)
            solution = self.solve(view, solution.pose, predicted)
        return view, solution

    def coarse(self, frame: Frame, predicted: Prediction, start: Pose) -> Pose:
        """The best pose at half the resolution, which sees faces further away from the start."""
        return self.solve(self.view(self.face.coarse, frame, start), start, predicted).pose

    def face_camera(self, level: Level, pose: Pose) -> FaceCamera:
        """The camera that sees a face at a pose as the views of a level show it."""
        focal_px = level.descriptor.pixels_per_unit * pose.distance
        return FaceCamera(self.camera, pose.ray, pose.roll, focal_px, level.size)

    def view(self, level: Level, frame: Frame, pose: Pose) -> View:
        """The crop of a frame for a pose at one level, and the landmarks that face the camera there: a set that stays
        as it is while the view is solved."""
        level = level.at(pose.angles)
        camera = self.face_camera(level, pose)
        image = camera.sample(frame, level.descriptor.blur)
        X, R = self.person.in_camera(pose), pose.arrays[0]
        facing = pose_geometry.facing_camera(
            X,
            self.face.normals,
            R,
            self.camera_vector,
            frame.width,
            frame.height,
            self.settings.visibility.hidden_cosine,
        )
        facing &= level.depth_behind(pose.angles) < self.settings.visibility.hidden_depth
        if frame.graphics is not None:
            facing &= ~self._behind_graphics(frame.graphics, X, level.descriptor.reach / camera.scale)
        if is_blank(image):
            facing[:] = False
        return View(level, pose, pose, image, (camera.projection, pose.ray), facing, facing)

    def share_behind_graphics(self, graphics: Graphics, pose: Pose) -> float:
        """Share of the landmarks of a face at a pose that graphics cover at full resolution."""
        level = self.face.fine
        reach = level.descriptor.reach / self.face_camera(level, pose).scale
        return float(self._behind_graphics(graphics, self.person.in_camera(pose), reach).mean())

    def _behind_graphics(self, graphics: Graphics, X: Array, reach: float) -> Mask:
        """Of which landmarks (n,), at points X (n, 3) in camera axes, graphics leave too little. reach: pixels of the
        image that their descriptors extend to each side."""
        points, ahead = self.camera.project(X)
        points = np.where(ahead[:, None], points, -math.inf)
        return graphics.share_around(points, reach) >= self.settings.visibility.graphics_share

    def solve(self, view: View, start: Pose, predicted: Prediction) -> Solution:
        """Minimise Eq. (9) in one view by Levenberg-Marquardt."""
        posterior = self.posterior(view, predicted)
        found = self._lowest(posterior, start)
        expected, noise, most = self.person.expected.copy(), view.level.noise, self.settings.recovery.seen_distance
        return Solution(Pose(*found.pose), found.energy, found.at, posterior, view.facing, expected, noise, most)

    def alone(
        self, landmarks: Mask, found: Solution, predicted: Prediction, tolerance: Array, stretch: StretchArrays
    ) -> Pose:
        """The pose that minimises what a solution did by these of its landmarks (n,) alone, about another prediction.
        tolerance: factor (n,) of the squared distances at which weights are a quarter; stretch: of the skin."""
        active, scale, prior = found.posterior.active, found.posterior.scale, self.prior.arrays(predicted)
        posterior = found.posterior._replace(
            active=active * landmarks, scale=tolerance * scale, prior=prior, stretch=stretch
        )
        return Pose(*self._lowest(posterior, found.pose).pose)

    def _lowest(self, posterior: PosePosterior, start: Pose) -> LowestPoint:
        s = self.settings.solver
        return posterior.solve(start.arrays, s.iterations, s.tolerance)

    def misfits(self, found: Solution) -> bool:
        """Whether a solution looks unlike the face."""
        return found.misfit > self.settings.solver.retry_distance

    def posterior(self, view: View, predicted: Prediction) -> PosePosterior:
        """Eq. (9) in one view, with its prior centred on a prediction."""
        person, level, appearance = self.person, view.level, view.level.appearance
        U, gain, learned = person.metric(level)
        return PosePosterior(
            maps=view.maps,
            sampling=view.sampling,
            person=person.arrays,
            appearance=AppearanceArrays(
                coefficients=appearance.coefficients,
                limit=appearance.limit,
                offset=person.adapted_offset(level, view.upright),
                U=U,
                gain=gain,
                learned=learned,
                inverse_floor=appearance.inverse_floor,
                trust=level.trust(view.pose.angles, self.settings.covariance.lack_of_fit),
                variance=person.misplacement_variance(level, predicted.last.animation),
            ),
            active=view.facing * person.covers.weight,
            scale=person.tolerance * person.expected,
            prior=self.prior.arrays(predicted),
            view=view.geometry,
            stretch=self.rigid,
        )

    def _fits(self, view: View, pose: Pose) -> bool:
        """Whether the crop of a view was made for nearly the roll, scale and position of a face at a pose."""
        s, (roll, scale) = self.settings, view.roll_and_scale(pose)
        upright = abs(math.degrees(roll)) <= s.solver.crop_roll_deg
        return upright and abs(scale - 1) <= s.solver.crop_scale and view.shift(pose) <= s.solver.crop_shift
