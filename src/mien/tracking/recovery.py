"""Finding a face again: keyframes matched by SIFT and placed by PnP, or the detector where it is installed.

Both only propose poses; the tracker's own energy decides whether the face that is there is the one it knows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.appearance.rendering import depth_buffer
from mien.appearance.views import crop_camera, crop_of_face
from mien.errors import MienError
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array, exp
from mien.initialization.detector import detect_once
from mien.initialization.fit import FirstFrame
from mien.video import Frame

KEYFRAME_PIXELS_PER_UNIT = 110.0
_CROP_UNITS = 2.0
_KEYPOINTS = 250
_MOST_KEYFRAMES = 9
_KEYFRAME_SPACING = np.radians(15.0)
_LARGEST_SEARCH = 1280  # pixels of the longer side of the image that is searched
_RATIO, _INLIERS, _REPROJECTION_PX = 0.85, 8, 6.0


@dataclass(frozen=True)
class Keyframe:
    """A view that was tracked well: its pose R (3, 3), t (3,), animation (6,), and the grey crop of its face.

    Most videos never lose the face: keypoints are only looked for when a search asks for them.
    """

    R: Array
    t: Array
    animation: Array
    gray: NDArray[np.uint8]
    view: Camera
    fit: FirstFrame

    @cached_property
    def features(self) -> tuple[NDArray[np.float32], Array]:
        """SIFT descriptors (m, 128) and their points (m, 3) in head axes; m may be 0."""
        X = self.fit.vertices(self.animation) @ self.R.T + self.t
        depth = depth_buffer(X, self.fit.model.triangles, self.view, *self.gray.shape)
        mask = np.isfinite(depth).astype(np.uint8)
        keypoints, descriptors = cv2.SIFT.create(_KEYPOINTS, contrastThreshold=0.01).detectAndCompute(self.gray, mask)
        if descriptors is None:
            return np.zeros((0, 128), np.float32), np.zeros((0, 3))
        q = np.array([k.pt for k in keypoints])
        z = depth[np.rint(q[:, 1]).astype(int), np.rint(q[:, 0]).astype(int)]
        seen = np.isfinite(z)
        points = np.column_stack([(q - [self.view.cx, self.view.cy]) / self.view.focal_px * z[:, None], z])[seen]
        return descriptors[seen], (points - self.t) @ self.R


class Keyframes:
    """Views of one face at different poses, and the search for it in a frame."""

    def __init__(self, fit: FirstFrame, camera: Camera) -> None:
        self.fit, self.camera = fit, camera
        self.keyframes: list[Keyframe] = []

    def is_new(self, R: Array) -> bool:
        """Whether a view at this rotation would add something."""
        if len(self.keyframes) >= _MOST_KEYFRAMES:
            return False
        nearest = 1 + 2 * np.cos(_KEYFRAME_SPACING)  # the trace of a rotation by that angle
        return all(float((k.R * R).sum()) < nearest for k in self.keyframes)

    def add(self, frame: Frame, R: Array, t: Array, animation: Array) -> None:
        """Keep a view."""
        size = round(_CROP_UNITS * KEYFRAME_PIXELS_PER_UNIT)
        crop = crop_of_face(R, t, self.camera, KEYFRAME_PIXELS_PER_UNIT, size)
        gray = np.clip(crop.sample(frame.pixels), 0, 255).astype(np.uint8)
        self.keyframes.append(Keyframe(R, t, animation, gray, crop_camera(self.camera, crop), self.fit))

    def find(self, frame: Frame, distance: float) -> tuple[Array, Array] | None:
        """Pose R, t of the face by its keyframes, None where they do not agree on one.

        distance: where the face was last, which says how large it may be in the image.
        """
        keyframes = [k for k in self.keyframes if len(k.features[0]) >= _INLIERS]
        if not keyframes:
            return None
        scale = KEYFRAME_PIXELS_PER_UNIT * distance / self.camera.focal_px
        scale = min(scale, 2.5, _LARGEST_SEARCH / max(frame.width, frame.height))
        interpolation = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        image = cv2.resize(frame.gray, None, fx=scale, fy=scale, interpolation=interpolation)
        keypoints, descriptors = cv2.SIFT.create(4 * _KEYPOINTS, contrastThreshold=0.01).detectAndCompute(image, None)
        if descriptors is None or len(keypoints) < _INLIERS:
            return None
        p = (np.array([k.pt for k in keypoints]) + 0.5) / scale - 0.5
        found = [self._place(k, p, descriptors, scale) for k in keyframes]
        best = max(found, key=lambda f: f[0])
        return None if best[0] < _INLIERS else (best[1], best[2])

    def _place(
        self, keyframe: Keyframe, p: Array, descriptors: NDArray[np.float32], scale: float
    ) -> tuple[int, Array, Array]:
        """Number of inliers, and pose, of the matches with one keyframe."""
        known, points = keyframe.features
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(known, descriptors, k=2)
        good = [m for m, *rest in pairs if rest and m.distance < _RATIO * rest[0].distance]
        nothing = (0, np.eye(3), np.zeros(3))
        if len(good) < _INLIERS:
            return nothing
        X = points[[m.queryIdx for m in good]]
        return _pnp(X, p[[m.trainIdx for m in good]], self.camera, _REPROJECTION_PX / scale) or nothing


def find_by_detector(frame: Frame, fit: FirstFrame, camera: Camera) -> tuple[Array, Array] | None:
    """Pose R, t of the largest face that the detector sees; None without a face or without the extra `auto`."""
    try:
        landmarks = detect_once(frame)
    except MienError:
        return None
    if landmarks is None:
        return None
    vertices, points, _ = landmarks.correspondences()
    placed = _pnp(fit.vertices()[vertices], points, camera, 0.05 * float(np.ptp(points)))
    return None if placed is None else (placed[1], placed[2])


def _pnp(X: Array, p: Array, camera: Camera, tolerance_px: float) -> tuple[int, Array, Array] | None:
    """Inliers, R and t of points X (n, 3) in head axes seen at p (n, 2)."""
    K = np.array([[camera.focal_px, 0, camera.cx], [0, camera.focal_px, camera.cy], [0, 0, 1]])
    cv2.setRNGSeed(0)
    try:
        ok, r, t, inliers = cv2.solvePnPRansac(
            np.ascontiguousarray(X), np.ascontiguousarray(p), K, None,
            iterationsCount=300, reprojectionError=float(tolerance_px), flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
    except cv2.error:  # it refuses points that nearly coincide
        return None
    if not ok or inliers is None or t[2, 0] <= 0:
        return None
    return len(inliers), exp(r[:, 0]), t[:, 0]
