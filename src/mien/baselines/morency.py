"""Morency, Whitehill, Movellan 2008: GAVAM, an ellipsoid and an adaptive set of keyframes in a Kalman filter.

L.-P. Morency, J. Whitehill, J. Movellan, "Generalized adaptive view-based appearance model: integrated
framework for monocular head pose estimation", IEEE Conference on Automatic Face and Gesture Recognition, 2008.

Every frame is registered, by the normal flow of the ellipsoid's surface, with several frames whose poses are
known: the previous one, the first one and the keyframes nearest in pose. A Kalman filter, whose state is the
poses of all these frames together, fuses the measured changes of pose; it also corrects the keyframes, whose
poses were measured with error. A keyframe is acquired where the head turns to where none is.

Simplifications: the ellipsoid and the first pose come from the fitted CANDIDE instead of a detector's window,
and the static estimator of pose (a classifier trained on a corpus) is left out; a change of pose is a
difference in rotation vector and translation; the covariance of a measurement has a term for the mismatch
between ellipsoid and face, which grows with the change; a lost head is searched for by the normalised
correlation of the first face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mien.baselines.rigid_head import RigidHead
from mien.baselines.surface import (
    Pose,
    Registration,
    Residuals,
    Template,
    View,
    ellipsoid,
    look,
    look_first,
    register,
    take,
)
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array, angle_between, log
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import Landmarks
from mien.tracking.state import Estimate, Status

KEYFRAME_SPACING_DEG = 10.0
KEYFRAMES_USED, MOST_KEYFRAMES = 2, 24
LEAST_CORRELATION, LEAST_KEYFRAME_CORRELATION = 0.7, 0.75
FIRST_REACH_DEG = 40.0
"""The first frame is registered with as long as the head has not turned further from it."""

MOTION_SD = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.3])
"""Standard deviation of the change between two frames: radians, CANDIDE units in camera axes."""
CORRELATED_POINTS = 30.0
"""Neighbouring points share their error: so many count as one in the covariance of a registration."""
MISMATCH = 0.1
"""Standard deviation of a measured change of pose because the head is no ellipsoid, as a part of the turn."""


@dataclass(frozen=True)
class BaseFrame:
    """A frame that others are registered with: what was seen, and the pose as it is known now."""

    view: View
    pose: Pose


class MorencyTracker:
    """GAVAM; without `keyframes` every frame is registered with the previous one alone."""

    def __init__(self, *, keyframes: bool = True) -> None:
        self.keyframes = keyframes

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Lay the ellipsoid into the fitted face; the first frame is the first base frame, known exactly."""
        landmarks.check(frame.width, frame.height)
        fit = fit_first_frame(landmarks, camera)
        self.head = RigidHead.of(frame, fit, camera, ellipsoid(fit))
        self.status = Status.INITIALIZED
        self.pose = self.head.first
        first = BaseFrame(look_first(frame, self.pose, camera), self.pose)
        self.frames = [first, first]  # the state: the first frame, the keyframes, the previous one, six entries each
        self.covariance = 1e-8 * np.eye(6 * len(self.frames))
        return self.head.estimate(frame, self.status, self.pose)

    def track(self, frame: Frame) -> Estimate:
        """Register the frame with the base frames, fuse, and keep it as a keyframe if it is a new view."""
        view = look(frame, self.pose, self.head.camera)
        measured = [] if view is None else self._measure(view, self.pose, self._base_frames())
        if not measured and self.status is Status.LOST:
            view, measured = self._search(frame)
        if not measured or view is None:
            return self._lost(frame)
        self._fuse(view, measured)
        if not self.head.in_sight(frame, self.pose):
            return self._lost(frame)
        self.status = Status.RECOVERED if self.status is Status.LOST else Status.TRACKED
        return self.head.estimate(frame, self.status, self.pose)

    def _base_frames(self) -> list[int]:
        """Rows of `frames` to register with: the previous, and with keyframes the first and the nearest."""
        previous = len(self.frames) - 1
        if not self.keyframes:
            return [previous]
        turn = [self._turn(i) for i in range(previous)]
        first = [0] if turn[0] < np.radians(FIRST_REACH_DEG) else []
        nearest = [i for i in np.argsort(turn).tolist() if i != 0][:KEYFRAMES_USED]
        return [previous, *first, *nearest]

    def _turn(self, i: int) -> float:
        return float(angle_between(self.frames[i].pose.R, self.pose.R))

    def _measure(self, view: View, start: Pose, rows: list[int]) -> list[tuple[int, Registration]]:
        """Registrations that succeeded, with the rows of their base frames. The first of them starts the others."""
        measured: list[tuple[int, Registration]] = []
        for i in rows:
            template = self._template(i)
            r = register(self.head.surface, template, view, start, weights, coarse=not measured)
            least = LEAST_CORRELATION if i == len(self.frames) - 1 else LEAST_KEYFRAME_CORRELATION
            if r is not None and r.correlation >= least:
                measured.append((i, r))
                start = r.pose
        return measured

    def _template(self, i: int) -> Template:
        """The surface as a base frame shows it, at the pose that it is now known to have."""
        return take(self.head.surface, self.frames[i].view, self.frames[i].pose)

    def _fuse(self, view: View, measured: list[tuple[int, Registration]]) -> None:
        """Kalman filter over the poses of all base frames and of this one, which becomes the previous frame."""
        pose, P = self.pose, self._predicted_covariance()
        n = len(self.frames)
        H = np.zeros((6 * len(measured), 6 * (n + 1)))
        z, S = np.zeros(len(H)), np.zeros((len(H), len(H)))
        for k, (i, r) in enumerate(measured):
            rows = slice(6 * k, 6 * k + 6)
            H[rows, 6 * n :] = np.eye(6)
            H[rows, 6 * i : 6 * i + 6] = -np.eye(6)
            z[rows] = _difference(r.pose, pose)
            S[rows, rows] = _measurement_covariance(r, self.frames[i].pose)
        K = np.linalg.solve(H @ P @ H.T + S, H @ P).T
        step = (K @ z).reshape(-1, 6)
        P = P - K @ H @ P
        self.frames = [replace(f, pose=f.pose.moved(d)) for f, d in zip(self.frames, step, strict=False)]
        self.pose = pose.moved(step[-1])
        self._keep(BaseFrame(view, self.pose), 0.5 * (P + P.T))

    def _predicted_covariance(self) -> Array:
        """That of the base frames and of this one, which is where the previous one was, give or take a step."""
        P, previous = self.covariance, slice(-6, None)
        cross = P[:, previous]
        return np.block([[P, cross], [cross.T, P[previous, previous] + np.diag(MOTION_SD**2)]])

    def _keep(self, frame: BaseFrame, P: Array) -> None:
        """Replace the previous frame by this one; where no other is near, this one is a keyframe besides."""
        n = len(self.frames)
        nearest = min(float(angle_between(f.pose.R, frame.pose.R)) for f in self.frames[:-1])
        if self.keyframes and nearest > np.radians(KEYFRAME_SPACING_DEG) and n < MOST_KEYFRAMES + 2:
            kept = [*range(n - 1), n, n]
            self.frames = [*self.frames[:-1], frame, frame]
        else:
            kept = [*range(n - 1), n]
            self.frames = [*self.frames[:-1], frame]
        rows = np.concatenate([np.arange(6 * i, 6 * i + 6) for i in kept])
        self.covariance = P[np.ix_(rows, rows)]

    def _search(self, frame: Frame) -> tuple[View | None, list[tuple[int, Registration]]]:
        """A lost head: where the frame resembles the first face, register with every keyframe; the best counts."""
        t = self.head.relocated(frame).t
        view = look(frame, Pose(self.pose.R, t), self.head.camera)
        if view is None:
            return None, []
        keyframes = range(len(self.frames) - 1)
        tried = [m for i in keyframes for m in self._measure(view, Pose(self.frames[i].pose.R, t), [i])]
        if not tried:
            return None, []
        best = max(tried, key=lambda m: m[1].correlation)
        self.pose = best[1].pose
        n = len(self.covariance)  # the previous pose says nothing of this one
        self.covariance[n - 6 :, :] = self.covariance[:, n - 6 :] = 0
        self.covariance[n - 6 :, n - 6 :] = np.eye(6)
        return view, [best]

    def _lost(self, frame: Frame) -> Estimate:
        self.status = Status.LOST
        return self.head.lost(frame, self.pose)


def _difference(a: Pose, b: Pose) -> Array:
    """Step (6,) with `b.moved(step) == a`."""
    return np.concatenate([log(a.R @ b.R.T), a.t - b.t])


def _measurement_covariance(r: Registration, base: Pose) -> Array:
    """(6, 6): that of least squares for correlated points, and the mismatch of the ellipsoid."""
    turn = float(angle_between(base.R, r.pose.R))
    return np.asarray(CORRELATED_POINTS * r.covariance + (MISMATCH * turn) ** 2 * np.eye(6) + 1e-8 * np.eye(6))


def weights(r: Residuals) -> Array:
    """Points by their projected density, less where the frame differs much from the template."""
    sd = 1.0 + 1.4826 * float(np.median(np.abs(r.e)))
    return np.asarray(1e-6 + r.cosine / (1 + (r.e / (2 * sd)) ** 2))
