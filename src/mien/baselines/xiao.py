"""Xiao, Moriyama, Kanade, Cohn 2003: a cylinder, a dynamic template, and re-registration.

J. Xiao, T. Moriyama, T. Kanade, J. F. Cohn, "Robust full-motion recovery of head by dynamic templates and
re-registration techniques", International Journal of Imaging Systems and Technology 13(1), 2003.

The full motion of the head between two frames is the twist that best aligns the cylinder's surface with the last frame,
by iteratively re-weighted least squares. The template is then replaced in every frame, which follows changes of light
and expression but accumulates error. That drift is corrected whenever the head comes close to the pose of a reference,
a template stored earlier: the frame is then registered with it as well.

Simplifications: the radius, position and initial pose of the cylinder come from the fitted CANDIDE instead of a
rectangle around the face; images are compared at the points of a grid on the cylinder instead of at the pixels of the
template; a lost head is searched for by the normalised correlation of the first face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mien.arrays import Array
from mien.baselines.rigid_head import RigidHead
from mien.baselines.surface import (
    Pose,
    Registration,
    Residuals,
    Template,
    View,
    cylinder,
    look,
    look_first,
    register,
    take_template,
)
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import Landmarks
from mien.tracking.state import Estimate, Status, require_next_of

LEAST_CORRELATION = 0.7
"""Correlation below which a frame does not match the template."""
LEAST_REFERENCE_CORRELATION = 0.8
REFERENCE_SPACING_DEG = 15.0
"""A frame is registered with the nearest reference within this angle; if there is none, it becomes a new reference."""


@dataclass(frozen=True)
class Reference:
    """A template and the pose at which it was taken."""

    template: Template
    pose: Pose


class XiaoTracker:
    """Cylinder with a dynamic template and re-registration; without `reregister`, only the template."""

    def __init__(self, *, reregister: bool = True) -> None:
        self.reregister = reregister
        self.size: tuple[int, int] | None = None

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Fit the cylinder to the face; its appearance is the template and the first reference."""
        landmarks.check(frame.width, frame.height)
        self.size = frame.width, frame.height
        fit = fit_first_frame(landmarks, camera)
        self.head = RigidHead.from_first_frame(frame, fit, camera, cylinder(fit))
        self.pose, self.status = self.head.first, Status.INITIALIZED
        self.template = take_template(self.head.surface, look_first(frame, self.pose, camera), self.pose)
        self.references = [Reference(self.template, self.pose)]
        return self.head.estimate(frame, self.status, self.pose)

    def track(self, frame: Frame) -> Estimate:
        """Register with the last frame, then with the nearest reference, and update the template."""
        require_next_of(self.size, frame)
        view = look(frame, self.pose, self.head.camera)
        found = None if view is None else self._register(self.template, view, self.pose, LEAST_CORRELATION)
        if found is None and self.status is Status.LOST:
            view, found = self._search(frame)
        if found is None or view is None or not self.head.in_sight(frame, found.pose):
            return self._lost(frame)
        self.pose = self._reregister(view, found.pose) if self.reregister else found.pose
        self._update_template(view)
        self.status = Status.RECOVERED if self.status is Status.LOST else Status.TRACKED
        return self.head.estimate(frame, self.status, self.pose)

    def _register(self, template: Template, view: View, start: Pose, least: float) -> Registration | None:
        r = register(self.head.surface, template, view, start, weights)
        return r if r is not None and r.correlation >= least else None

    def _reregister(self, view: View, pose: Pose) -> Pose:
        """The pose from registration with the nearest reference, if one is close and matches; else the given pose."""
        angles = [float(angle_between(r.pose.R, pose.R)) for r in self.references]
        nearest = int(np.argmin(angles))
        if angles[nearest] > np.radians(REFERENCE_SPACING_DEG):
            self.references.append(Reference(take_template(self.head.surface, view, pose), pose))
            return pose
        r = self._register(self.references[nearest].template, view, pose, LEAST_REFERENCE_CORRELATION)
        return pose if r is None else r.pose

    def _update_template(self, view: View) -> None:
        """Replace the template by this frame, except at points that are outliers, which keep their values."""
        new = take_template(self.head.surface, view, self.pose)
        both = self.template.known & new.known
        e = np.where(both, self.template.values[-1] - new.values[-1], 0.0)
        outlier = both & (np.abs(e) > 3 * _scale(e[both])) if both.any() else both
        self.template = replace(new, values=np.where(outlier, self.template.values, new.values))

    def _search(self, frame: Frame) -> tuple[View | None, Registration | None]:
        """Search for a lost head: at the best match of the first face, register with every reference, and take the
        best."""
        t = self.head.relocate(frame).t
        view = look(frame, Pose(self.pose.R, t), self.head.camera)
        if view is None:
            return None, None
        starts = [(r.template, Pose(r.pose.R, t)) for r in self.references]
        tried = [self._register(template, view, start, LEAST_REFERENCE_CORRELATION) for template, start in starts]
        return view, max((r for r in tried if r is not None), key=lambda r: r.correlation, default=None)

    def _lost(self, frame: Frame) -> Estimate:
        self.status = Status.LOST
        return self.head.lost(frame, self.pose)


def weights(r: Residuals) -> Array:
    """Product of the paper's three weights: residual (non-rigid motion, occlusion), projection density, gradient."""
    residual = np.exp(-0.5 * (r.e / (2 * _scale(r.e))) ** 2)
    gradient = 1 - np.exp(-0.5 * (r.gradient / (np.median(r.gradient) + 1e-6)) ** 2)
    return np.asarray(1e-6 + residual * r.cosine * gradient)


def _scale(e: Array) -> float:
    """Robust standard deviation of residuals in grey values, at least one."""
    return 1.0 + 1.4826 * float(np.median(np.abs(e)))
