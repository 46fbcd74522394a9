"""Shared by the trackers with a rigid surface, apart from the registration: estimates, and recovery of a lost head."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mien.arrays import Array, Float32
from mien.baselines.surface import GRAZING, Pose, Surface
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import LANDMARK_NAMES, VERTICES
from mien.tracking.state import Estimate, Status, TrackedLandmarks

OUT_OF_SIGHT = "the face left the image or turned away"
NOT_FOUND = "the frame could not be registered with the face"

LEAST_IN_SIGHT = 0.35
"""Fraction of the surface that must be visible in the image; with less, the head has turned or moved out of it."""
PATCH_PIXELS_PER_UNIT = 20.0
"""Resolution at which a whole frame is searched for the face of the first frame."""
PATCH_UNITS = (0.5, 0.7)
"""Half the width and half the height of the face template, in CANDIDE units."""


@dataclass(frozen=True)
class RigidHead:
    """The head of the first frame: its fit, camera and surface, and a small face template (h, w) to search for, with
    the place (2,) in it of the head's origin, x and y, which the border of the image may have moved off its middle."""

    fit: FirstFrame
    camera: Camera
    surface: Surface
    patch: Float32
    origin: Array

    @classmethod
    def from_first_frame(cls, frame: Frame, fit: FirstFrame, camera: Camera, surface: Surface) -> RigidHead:
        """Cut the template out of the first frame, in which the head is fitted."""
        small, scale = _shrunk(frame, camera, fit)
        (u, v), _ = camera.project(fit.t)
        half = np.array(PATCH_UNITS) * camera.focal_px / fit.t[2] * scale
        height, width = small.shape
        x0, x1 = np.clip(np.round([u * scale - half[0], u * scale + half[0]]), 0, width).astype(int)
        y0, y1 = np.clip(np.round([v * scale - half[1], v * scale + half[1]]), 0, height).astype(int)
        return cls(fit, camera, surface, small[y0:y1, x0:x1], np.array([u * scale - x0, v * scale - y0]))

    @property
    def first(self) -> Pose:
        """Pose of the first frame."""
        return Pose(self.fit.R, self.fit.t)

    def relocate(self, frame: Frame) -> Pose:
        """The pose of the first frame, shifted to the best match of the face template (normalised correlation)."""
        small, scale = _shrunk(frame, self.camera, self.fit)
        match = cv2.matchTemplate(small, self.patch, cv2.TM_CCOEFF_NORMED)
        _, _, _, (x, y) = cv2.minMaxLoc(match)
        centre = (np.array([x, y]) + self.origin) / scale
        z = float(self.fit.t[2])
        shift = (centre - [self.camera.cx, self.camera.cy]) * z / self.camera.focal_px
        return Pose(self.fit.R, np.array([shift[0], shift[1], z]))

    def in_sight(self, frame: Frame, pose: Pose) -> bool:
        """Whether enough of the surface faces the camera and projects into the image."""
        X, cosine = self.surface.seen(pose)
        inside = self.camera.in_image(X, frame.width, frame.height)
        return bool((inside & (cosine > GRAZING)).mean() >= LEAST_IN_SIGHT)

    def estimate(self, frame: Frame, status: Status, pose: Pose) -> Estimate:
        """The estimate with pose and rigid landmarks; these trackers estimate neither animation nor uncertainty."""
        X = self.fit.vertices()[VERTICES] @ pose.R.T + pose.t
        image, _ = self.camera.project(X)
        landmarks = TrackedLandmarks(LANDMARK_NAMES, image, X)
        return Estimate(
            frame.index,
            frame.time,
            status,
            rotation=pose.R,
            translation=pose.t,
            landmarks=landmarks,
            confidence=1.0,
            mm_per_unit=self.fit.mm_per_unit,
        )

    def lost(self, frame: Frame, pose: Pose) -> Estimate:
        """The estimate for a frame without a face in sight. pose: at which it was found, else the last one; it decides
        on the reason."""
        reason = NOT_FOUND if self.in_sight(frame, pose) else OUT_OF_SIGHT
        return Estimate.lost(frame, reason, self.fit.mm_per_unit)


def _shrunk(frame: Frame, camera: Camera, fit: FirstFrame) -> tuple[Float32, float]:
    """The whole frame, scaled so that a CANDIDE unit at the first frame's distance has `PATCH_PIXELS_PER_UNIT`, and the
    scale."""
    scale = min(PATCH_PIXELS_PER_UNIT * float(fit.t[2]) / camera.focal_px, 1.0)
    size = (max(round(frame.width * scale), 1), max(round(frame.height * scale), 1))
    return cv2.resize(frame.gray, size, interpolation=cv2.INTER_AREA).astype(np.float32), scale
