"""Finding a lost face: where a head that turns aside would have it, by the detector, or by keyframes, matched with SIFT
and placed by PnP.

All of these only propose poses; the energy of the tracker decides whether the face there is the one it knows. The
file begins with the proposals and ends with `Recovery`, which decides when to ask for them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from mien.appearance.rendering import depth_buffer
from mien.appearance.views import crop_camera, crop_of_face
from mien.arrays import Array, Float32, Pixels
from mien.config.realtime import RecoverySettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import exp
from mien.initialization.detector import detect_once
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import place_of
from mien.initialization.upright import Upright, quarters_of
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.prior import StatePrior
from mien.tracking.realtime.solution import Solution, View
from mien.tracking.realtime.solver import PoseSolver

KEYFRAME_PIXELS_PER_UNIT = 55.0  # SIFT begins with the image at twice its size
_CROP_UNITS = 2.0
"""Side of the crop that a keyframe keeps, CANDIDE units."""
_KEYPOINTS = 250
"""Largest number of keypoints of a keyframe; the part of a frame that is searched, which shows more than the face, may
have four times as many."""
_MOST_KEYFRAMES = 9
_KEYFRAME_SPACING = np.radians(15.0)
"""Least rotation, radians, between two keyframes."""
_WINDOW = 440.0
"""Side of the part of the image that one search covers, in pixels of the keyframes."""
_MOST_FACES = 3
"""How many of the faces that the detector finds are tried, the largest first."""
_NECK = np.array([0.0, 0.0, -0.7])
"""What a head turns about, in head axes: the top of the spine."""
_PANS = np.radians([-50.0, -25.0, 0.0, 25.0, 50.0])
"""From the first frame's view, where a head that has turned is looked for."""
_RATIO, _INLIERS, _REPROJECTION_PX = 0.85, 8, 6.0
"""Of a match of keypoints: its distance over that of the second best one, below which it is kept (D. Lowe, IJCV 60,
2004); how many of them have to agree on a pose; and up to which reprojection error, in pixels of the keyframes."""
_BETTER = 0.8
"""A face elsewhere is preferred to one that is doubted, or of which little matches, only if its misfit is below this
share of that one's."""
_TOLERANCE = 0.05
"""Reprojection error up to which a detected point is an inlier, as a share of the face's size."""


@dataclass(frozen=True)
class Keyframe:
    """A view that was tracked well: its pose R (3, 3), t (3,), animation (6,), and the grey crop of the face.

    Most videos never lose the face, so keypoints are found when a search first needs them.
    """

    R: Array
    t: Array
    animation: Array
    gray: Pixels
    camera: Camera
    fit: FirstFrame

    @cached_property
    def features(self) -> tuple[Float32, Array]:
        """SIFT descriptors (m, 128) and their points (m, 3) in head axes; m may be 0."""
        X = self.fit.vertices(self.animation) @ self.R.T + self.t
        depth = depth_buffer(X, self.fit.model.triangles, self.camera, *self.gray.shape[::-1])
        mask = np.isfinite(depth).astype(np.uint8)
        keypoints, descriptors = cv2.SIFT.create(_KEYPOINTS, contrastThreshold=0.01).detectAndCompute(self.gray, mask)
        if not keypoints:
            return np.zeros((0, 128), np.float32), np.zeros((0, 3))
        q = np.array([k.pt for k in keypoints])
        z = depth[np.rint(q[:, 1]).astype(int), np.rint(q[:, 0]).astype(int)]
        seen = np.isfinite(z)
        points = (self.camera.rays(q) * z[:, None])[seen]
        return descriptors[seen], (points - self.t) @ self.R


class _Placed(NamedTuple):
    """A pose R (3, 3), t (3,), and the number of points that agree on it."""

    inliers: int
    R: Array
    t: Array


class Keyframes:
    """Views of one face at different poses, and the search for it in a frame."""

    def __init__(self, fit: FirstFrame, camera: Camera) -> None:
        self.fit, self.camera = fit, camera
        self.keyframes: list[Keyframe] = []
        self.rotations = np.zeros((0, 9))
        self.searches = 0

    def is_new(self, R: Array) -> bool:
        """Whether a view at this rotation would add anything."""
        if len(self.keyframes) >= _MOST_KEYFRAMES:
            return False
        nearest = 1 + 2 * math.cos(_KEYFRAME_SPACING)  # the trace of a rotation by that angle
        return max((self.rotations @ R.ravel()).tolist(), default=-1.0) < nearest

    def add(self, frame: Frame, R: Array, t: Array, animation: Array) -> None:
        """Keep a view."""
        size = round(_CROP_UNITS * KEYFRAME_PIXELS_PER_UNIT)
        crop = crop_of_face(R, t, self.camera, KEYFRAME_PIXELS_PER_UNIT, size)
        gray = np.clip(crop.sample(frame), 0, 255).astype(np.uint8)
        self.rotations = np.vstack([self.rotations, R.ravel()])
        self.keyframes.append(Keyframe(R, t, animation, gray, crop_camera(self.camera, crop), self.fit))

    def find(self, frame: Frame, last: Array) -> tuple[Array, Array] | None:
        """Pose R, t of the face by its keyframes, None where they do not agree on one.

        last: (3,) last position of the face, which gives its size in the image and where to search. The cost does not
        depend on the size of the image: in large ones searches alternate between that position and the rest.
        """
        keyframes = [k for k in self.keyframes if len(k.features[0]) >= _INLIERS]
        if not keyframes:
            return None
        scale = min(KEYFRAME_PIXELS_PER_UNIT * float(last[2]) / self.camera.focal_px, 2.5)
        window, corner = self._window(frame, last, scale)
        interpolation = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        image = cv2.resize(window, None, fx=scale, fy=scale, interpolation=interpolation)
        keypoints, descriptors = cv2.SIFT.create(4 * _KEYPOINTS, contrastThreshold=0.01).detectAndCompute(image, None)
        if len(keypoints) < _INLIERS:
            return None
        p = (np.array([k.pt for k in keypoints]) + 0.5) / scale - 0.5 + corner
        found = [placed for k in keyframes if (placed := self._place(k, p, descriptors, scale)) is not None]
        best = max(found, key=lambda placed: placed.inliers, default=None)
        return None if best is None or best.inliers < _INLIERS else (best.R, best.t)

    def _window(self, frame: Frame, last: Array, scale: float) -> tuple[Pixels, Array]:
        """The grey part of a frame that this search covers, and its corner (2,)."""
        side, face = _WINDOW / scale, _CROP_UNITS * KEYFRAME_PIXELS_PER_UNIT / scale
        around, elsewhere = divmod(self.searches, 2)
        self.searches += 1
        size = np.array([frame.width, frame.height])
        corner = self.camera.project(last)[0] - 0.5 * side
        if elsewhere:  # windows that cover the frame and overlap by a face
            columns, rows = (1 + np.maximum(np.ceil((size - side) / (side - face)), 0)).astype(int)
            corner = np.array([around % columns, around // columns % rows]) * (side - face)
        x, y = np.clip(np.rint(corner), 0, np.maximum(size - round(side), 0)).astype(int)
        return frame.gray_part(slice(y, y + round(side)), slice(x, x + round(side))), np.array([x, y])

    def _place(self, keyframe: Keyframe, p: Array, descriptors: Float32, scale: float) -> _Placed | None:
        """The pose by the matches of keypoints p (k, 2), with their descriptors (k, 128), with one keyframe; None where
        they give none. scale: at which the keypoints were found."""
        known, points = keyframe.features
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(known, descriptors, k=2)
        good = [m for m, *rest in pairs if rest and m.distance < _RATIO * rest[0].distance]
        if len(good) < _INLIERS:
            return None
        X = points[[m.queryIdx for m in good]]
        return _pnp(X, p[[m.trainIdx for m in good]], self.camera, _REPROJECTION_PX / scale)


def turned_aside(pose: Pose, R_first: Array) -> Iterator[Pose]:
    """Poses of a head that has turned aside since it was at a pose, about its own axis, or back to where it looked in
    the first frame, with rotation R_first (3, 3). The neck stays where it is."""
    neck = pose.R @ _NECK + pose.t
    for pan in _PANS:
        R = R_first @ exp(np.array([0.0, pan, 0.0]))
        yield Pose(R, neck - R @ _NECK, pose.animation)


def find_by_detector(
    frame: Frame, fit: FirstFrame, camera: Camera, roll: float, distant: bool
) -> Iterator[tuple[Array, Array]]:
    """Poses R, t of the faces that the detector finds, the largest first. roll: about that of the face, radians, as the
    detector takes a face upside down for an upright one; distant: whether to look for faces that are small in the image
    where there is no other."""
    view = Upright(frame, quarters_of(roll))
    for face in detect_once(view.frame, distant=distant)[:_MOST_FACES]:
        vertices, points, _ = face.correspondences()
        points = view.points_seen(points)
        placed = _pnp(fit.vertices()[vertices], points, camera, _TOLERANCE * place_of(points)[1])
        if placed is not None:
            yield placed.R, placed.t


def _pnp(X: Array, p: Array, camera: Camera, tolerance_px: float) -> _Placed | None:
    """The pose of points X (n, 3) in head axes seen at p (n, 2), up to a distance of `tolerance_px` for inliers; None
    where they have none."""
    cv2.setRNGSeed(0)
    try:
        ok, r, t, inliers = cv2.solvePnPRansac(
            np.ascontiguousarray(X), np.ascontiguousarray(p), camera.matrix, None,
            iterationsCount=300, reprojectionError=float(tolerance_px), flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
    except cv2.error:  # it refuses points that nearly coincide
        return None
    if not ok or inliers is None or t[2, 0] <= 0:
        return None
    return _Placed(len(inliers), exp(r[:, 0]), t[:, 0])


class Recovery:
    """The search for the face elsewhere, if it is not where it was, or what was found there may be something else.

    keyframes: the views that it is known by; strange_frames, doubted_frames: for how many frames little of what was
    found has matched, and its identity has been doubted.
    """

    def __init__(
        self, fit: FirstFrame, first: Pose, camera: Camera, solver: PoseSolver, prior: StatePrior, s: RecoverySettings
    ) -> None:
        """first: pose of the first frame, as the learned appearance gives it."""
        self.fit, self.R_first, self.camera = fit, first.R, camera
        self.solver, self.prior, self.settings = solver, prior, s
        self.keyframes = Keyframes(fit, camera)
        self.strange_frames = self.doubted_frames = 0

    def elsewhere(
        self, frame: Frame, here: Solution, last: Pose, lost_frames: int, is_doubted: bool
    ) -> tuple[View, Solution] | None:
        """The face at another place, if at the one that was found little of it matches, or its identity is doubted: as
        a head that has turned aside, or where the detector or the keyframes propose. None if it is nowhere else.

        last: where it was seen last; lost_frames: for how many frames before this one it has been lost."""
        s, share = self.settings, here.inlier_share
        lost, strange = share < s.least_share, share < s.recovered_share and self.solver.misfits(here)
        than = None if lost else here
        self.strange_frames = self.strange_frames + 1 if strange else 0
        if strange and self._is_due(self.strange_frames - 1):
            found = list(self._faces_near(turned_aside(last, self.R_first), last, frame, than))
            if found:
                return min(found, key=lambda there: there[1].misfit)
        if self._is_due(lost_frames) if lost else self._doubts(here, is_doubted):
            proposals = (Pose(*placed, self.fit.animation) for placed in self._proposals(frame, last, lost_frames))
            return next(self._faces_near(proposals, last, frame, than), None)
        return None

    def _is_due(self, frames: int) -> bool:
        """Whether to search the image now that the face has been away for some frames."""
        return frames < 3 or frames % self.settings.interval == 0

    def _doubts(self, here: Solution, is_doubted: bool) -> bool:
        """Whether to search for the face elsewhere: every so many frames while its identity is doubted."""
        doubtful = is_doubted and self.solver.misfits(here)
        self.doubted_frames = self.doubted_frames + 1 if doubtful else 0
        return doubtful and self.doubted_frames % self.settings.doubt_interval == 0

    def _proposals(self, frame: Frame, last: Pose, lost_frames: int) -> Iterator[tuple[Array, Array]]:
        s = self.settings
        thorough = lost_frames < s.patience or lost_frames % (3 * s.interval) == 0
        yield from find_by_detector(frame, self.fit, self.camera, last.roll, thorough)
        known = self.keyframes.find(frame, last.t) if thorough else None
        if known is not None:
            yield known

    def _faces_near(
        self, starts: Iterable[Pose], last: Pose, frame: Frame, than: Solution | None
    ) -> Iterator[tuple[View, Solution]]:
        """What is found near each of these poses that looks like the face of the first frame, and fits better than what
        was found so far."""
        s = self.settings
        for start in starts:
            coarse = self.solver.coarse(frame, self.prior.prediction(start, last), start)
            view, solution = self.solver.refine(frame, self.prior.prediction(coarse, last))
            looks_like_it = solution.inlier_share >= s.recovered_share
            if looks_like_it and (than is None or _fits_better(solution, than)):
                yield view, solution


def _fits_better(there: Solution, here: Solution) -> bool:
    """Whether a face elsewhere is preferred to the one that was found here, of which also the best part has to match
    less: of a face that is half covered, most looks strange where it is."""
    return there.misfit < _BETTER * here.misfit and there.best_misfit < here.best_misfit
