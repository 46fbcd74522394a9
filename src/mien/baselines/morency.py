"""Morency, Whitehill, Movellan 2008: GAVAM, an ellipsoid and an adaptive set of keyframes in a Kalman filter.

L.-P. Morency, J. Whitehill, J. Movellan, "Generalized adaptive view-based appearance model: integrated
framework for monocular head pose estimation", IEEE Conference on Automatic Face and Gesture Recognition, 2008.

Every frame is registered, by the normal flow of the ellipsoid's surface, with several frames of known pose: the
previous one, the first one and the keyframes nearest in pose. A Kalman filter, whose state contains the poses of all
these frames, fuses the measured pose changes; it also corrects the poses of the keyframes, which were measured with
error. A keyframe is added when the head turns to a pose without one.

Simplifications: the ellipsoid and the initial pose come from the fitted CANDIDE instead of a detector's window, and
the static pose estimator (a classifier trained on a corpus) is omitted; a pose change is a difference in rotation
vector and translation; the covariance of a measurement has a term for the mismatch between ellipsoid and face, which
grows with the change; a lost head is searched for by the normalised correlation of the first face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mien.arrays import Array
from mien.baselines.registration import Registration, Residuals, register, robust_sd
from mien.baselines.rigid_tracker import RigidTracker
from mien.baselines.surface import Pose, ellipsoid
from mien.baselines.view import Template, View, take_template
from mien.geometry.rotation import angle_between, log

KEYFRAME_SPACING_DEG = 10.0
KEYFRAMES_USED, MOST_KEYFRAMES = 2, 24
LEAST_CORRELATION, LEAST_KEYFRAME_CORRELATION = 0.7, 0.75
FIRST_REACH_DEG = 40.0
"""Largest rotation of the head from the first frame at which it is still registered with it."""

MOTION_SD = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.3])
"""Standard deviation of the motion between two frames: radians, CANDIDE units in camera axes."""
CORRELATED_POINTS = 30.0
"""Errors of neighbouring points are correlated: this many count as one in the covariance of a registration."""
MISMATCH = 0.1
"""Standard deviation of a measured pose change as the head is no ellipsoid, as a fraction of the rotation."""


@dataclass(frozen=True)
class BaseFrame:
    """A frame with which others are registered: its view, and the current estimate of its pose."""

    view: View
    pose: Pose


class MorencyTracker(RigidTracker):
    """GAVAM; without `keyframes`, every frame is registered only with the previous one."""

    surface_of = staticmethod(ellipsoid)

    def __init__(self, *, keyframes: bool = True) -> None:
        self.keyframes = keyframes

    def _learn(self, view: View) -> None:
        first = BaseFrame(view, self.pose)  # its pose is known exactly
        self.frames = [first, first]  # the filter state: first frame, keyframes, previous frame, six entries each
        self.covariance = 1e-8 * np.eye(6 * len(self.frames))

    def _follow(self, view: View) -> Pose | None:
        measured = self._measure(view, self.pose, self._base_frames())
        return self._fuse(view, measured) if measured else None

    def _recover(self, view: View, start: Pose) -> Pose | None:
        """Register with every keyframe; the best result replaces the predicted pose."""
        keyframes = range(len(self.frames) - 1)
        tried = [m for i in keyframes for m in self._measure(view, Pose(self.frames[i].pose.R, start.t), [i])]
        if not tried:
            return None
        best = max(tried, key=lambda m: m[1].correlation)
        self.pose = best[1].pose
        n = len(self.covariance)  # the previous pose carries no information about this one
        self.covariance[n - 6 :, :] = self.covariance[:, n - 6 :] = 0
        self.covariance[n - 6 :, n - 6 :] = np.eye(6)
        return self._fuse(view, [best])

    def _base_frames(self) -> list[int]:
        """Indices of the `frames` to register with: the previous one and, with keyframes, the first and the nearest."""
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
        """Successful registrations, with the indices of their base frames; each starts at the result of the previous
        one."""
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
        """The template of a base frame, at its current pose estimate."""
        return take_template(self.head.surface, self.frames[i].view, self.frames[i].pose)

    def _fuse(self, view: View, measured: list[tuple[int, Registration]]) -> Pose:
        """Kalman update of the poses of all base frames and of this frame, which becomes the previous one; its pose."""
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
        return self.pose

    def _predicted_covariance(self) -> Array:
        """Covariance of the base frames and of this frame, predicted at the pose of the previous one."""
        P, previous = self.covariance, slice(-6, None)
        cross = P[:, previous]
        return np.block([[P, cross], [cross.T, P[previous, previous] + np.diag(MOTION_SD**2)]])

    def _keep(self, frame: BaseFrame, P: Array) -> None:
        """Replace the previous frame by this one, and also add it as a keyframe if no other is close."""
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


def _difference(a: Pose, b: Pose) -> Array:
    """Step (6,) with `b.moved(step) == a`."""
    return np.concatenate([log(a.R @ b.R.T), a.t - b.t])


def _measurement_covariance(r: Registration, base: Pose) -> Array:
    """Covariance (6, 6) of a registration: least squares with correlated points, and the ellipsoid's mismatch."""
    turn = float(angle_between(base.R, r.pose.R))
    return np.asarray(CORRELATED_POINTS * r.covariance + (MISMATCH * turn) ** 2 * np.eye(6) + 1e-8 * np.eye(6))


def weights(r: Residuals) -> Array:
    """Weights by projected density, reduced at points where the frame differs much from the template."""
    return np.asarray(1e-6 + r.cosine / (1 + (r.e / (2 * robust_sd(r.e))) ** 2))
