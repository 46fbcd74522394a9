"""The tracker of the paper, section 3, as printed: the preset `paper`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.appearance.crop import Crop
from mien.appearance.descriptors import describe, describe_with_opencv, orientation_maps
from mien.appearance.gaussian import Gaussians
from mien.appearance.views import centre_of_face, rendered_views, view_rotations
from mien.arrays import Array, Float32
from mien.candide.model import Candide
from mien.config import DescriptorSettings, PaperSettings, given_or_default
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmarks import LANDMARK_NAMES, VERTICES, Landmarks
from mien.tracking.likelihood import AppearanceLikelihood, LandmarkModel
from mien.tracking.optimizers import Simplex
from mien.tracking.posterior import Posterior
from mien.tracking.prior import GaussianPrior, state_sd
from mien.tracking.state import (
    Estimate,
    Status,
    TrackedLandmarks,
    pack,
    require_begun,
    require_first,
    require_next_of,
    unpack,
)

CROP_SIZE_UNITS = 2.4
"""Side of the crop in CANDIDE units: the landmarks, their patches, and room for them to move."""


@dataclass(frozen=True)
class Reader:
    """Descriptors of one frame at crop points (n, 2) -> (n, 128)."""

    gray: Float32
    maps: Float32 | None
    cell: int
    root: float

    @classmethod
    def of(cls, gray: Float32, settings: DescriptorSettings) -> Reader:
        maps = orientation_maps(gray, settings.cell) if settings.kernel == "mien" else None
        return cls(gray, maps, settings.cell, settings.root)

    def __call__(self, points: Array) -> Float32:
        if self.maps is None:
            return describe_with_opencv(self.gray, points, self.cell)
        return describe(self.maps, points, self.cell, self.root)


class PaperTracker:
    """Bayesian tracker with adaptive Gaussians of SIFT descriptors (Tran et al., section 3)."""

    def __init__(self, settings: PaperSettings | None = None, model: Candide | None = None) -> None:
        """model: the face model, the package's own unless given; see `fit_first_frame`."""
        self.settings = given_or_default(settings, PaperSettings)
        self.model = model
        self.size: tuple[int, int] | None = None

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Section 3.1: fit the first frame, render the views, learn a Gaussian per landmark. Raises MienError for
        landmarks that cannot be tracked."""
        s = self.settings
        require_first(frame, landmarks, camera)
        self.size, self.camera = None, camera  # until the face is known
        self.fit = fit_first_frame(landmarks, camera, self.model)
        self.landmarks = LandmarkModel.of_first_frame(self.fit)
        self.scale_distance = float(self.fit.t[2])
        samples = learn_views(frame, self.fit, camera, s)
        self.gaussians = Gaussians.learn(samples, s.eigenvalue_floor)
        self.prior_sd = state_sd(s.prior_rotation_deg, s.prior_translation, s.prior_depth, s.prior_animation)
        self.simplex = Simplex(s.simplex_spread * self.prior_sd, s.simplex_evaluations, np.random.default_rng(s.seed))
        self.b = pack(self.fit.R, self.fit.t, self.fit.animation)
        self.observed: Float32 | None = self._likelihood(frame).observe(self.b)
        self.size = frame.width, frame.height
        return self._estimate(frame, Status.INITIALIZED)

    def track(self, frame: Frame) -> Estimate:
        """Section 3.2: update the Gaussians with the last observation, then minimise Eq. (9). Raises MienError before
        `initialize`, and for a frame whose size differs from the first one's."""
        require_next_of(self.size, frame)
        s = self.settings
        if self.observed is not None:  # each observation counts once
            self.gaussians = self.gaussians.update(self.observed, s.forgetting, s.innovation == "mean")
        likelihood = self._likelihood(frame)
        posterior = Posterior(likelihood, GaussianPrior(self.b, self.prior_sd))
        self.b = self.simplex.minimize(posterior, self.b).b
        if not in_view(self.landmarks.in_camera(self.b), self.camera, frame):
            # Nothing of the face is left in the image: go back to where it can be seen again.
            self.b, self.observed = pack(self.fit.R, self.fit.t, self.fit.animation), None
            return Estimate.lost(frame, "the face left the image", self.fit.mm_per_unit)
        status = Status.RECOVERED if self.observed is None else Status.TRACKED
        self.observed = likelihood.observe(self.b)
        return self._estimate(frame, status)

    def mesh(self, estimate: Estimate) -> Array | None:
        """Vertices (113, 3) in camera axes of an estimate of this tracker, None where it is lost. Raises MienError
        before `initialize`."""
        require_begun(self.size)
        return self.fit.mesh(estimate.rotation, estimate.translation, estimate.animation)

    def _likelihood(self, frame: Frame) -> AppearanceLikelihood:
        R, t, _ = unpack(self.b)
        d = self.settings.descriptor
        # The patches keep the size in pixels of the first frame: the paper adapts neither scale nor orientation.
        scale = d.pixels_per_unit * self.scale_distance / self.camera.focal_px
        crop = Crop(centre_of_face(R, t, self.camera), scale, 0.0, crop_size(d))
        reader = Reader.of(crop.sample(frame, d.blur), d)
        return AppearanceLikelihood(self.landmarks, self.camera, crop, reader, self.gaussians)

    def _estimate(self, frame: Frame, status: Status) -> Estimate:
        R, t, animation = unpack(self.b)
        X = self.landmarks.in_camera(self.b)
        image, _ = self.camera.project(X)
        assert self.observed is not None, "an estimate is of what was observed"
        distance = np.sqrt(self.gaussians.squared_distance(self.observed))
        tracked = TrackedLandmarks(LANDMARK_NAMES, image, X, None, distance)
        return Estimate(
            frame.index,
            frame.time,
            status,
            rotation=R,
            translation=t,
            animation=animation,
            landmarks=tracked,
            confidence=1.0,
            mm_per_unit=self.fit.mm_per_unit,
        )


def in_view(X: Array, camera: Camera, frame: Frame) -> bool:
    """Whether more than a quarter of the points X (n, 3) in camera axes are seen in the frame."""
    return bool(camera.in_image(X, frame.width, frame.height).mean() > 0.25)


def crop_size(settings: DescriptorSettings) -> int:
    """Side of the crop in pixels."""
    return round(CROP_SIZE_UNITS * settings.pixels_per_unit)


def learn_views(frame: Frame, fit: FirstFrame, camera: Camera, settings: PaperSettings) -> Float32:
    """Descriptors (views, n, 128) of the landmarks in every rendered view of the first frame's face."""
    d = settings.descriptor
    rotations = view_rotations(settings.view_limit_deg, settings.view_step_deg)
    triangles, size = fit.model.triangles, crop_size(d)
    views = rendered_views(frame, fit, camera, triangles, rotations, d.pixels_per_unit, size, d.blur)
    return np.stack([Reader.of(image, d)(p[VERTICES]) for image, p in views])
