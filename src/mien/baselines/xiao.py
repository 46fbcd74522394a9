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
from mien.baselines.registration import Registration, Residuals, register, robust_sd
from mien.baselines.rigid_tracker import RigidTracker
from mien.baselines.surface import Pose, cylinder
from mien.baselines.view import Template, View, take_template
from mien.geometry.rotation import angle_between

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


class XiaoTracker(RigidTracker):
    """Cylinder with a dynamic template and re-registration; without `reregister`, only the template."""

    surface_of = staticmethod(cylinder)

    def __init__(self, *, reregister: bool = True) -> None:
        self.reregister = reregister

    def _learn(self, view: View) -> None:
        self.template = take_template(self.head.surface, view, self.pose)
        self.references = [Reference(self.template, self.pose)]

    def _follow(self, view: View) -> Pose | None:
        found = self._register(self.template, view, self.pose, LEAST_CORRELATION)
        return None if found is None else found.pose

    def _recover(self, view: View, start: Pose) -> Pose | None:
        """Register with every reference, and take the best."""
        starts = [(r.template, Pose(r.pose.R, start.t)) for r in self.references]
        tried = [self._register(template, view, start, LEAST_REFERENCE_CORRELATION) for template, start in starts]
        best = max((r for r in tried if r is not None), key=lambda r: r.correlation, default=None)
        return None if best is None else best.pose

    def _adapt(self, view: View) -> None:
        if self.reregister:
            self.pose = self._reregister(view, self.pose)
        self._update_template(view)

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
        outlier = both & (np.abs(e) > 3 * robust_sd(e[both])) if both.any() else both
        self.template = replace(new, values=np.where(outlier, self.template.values, new.values))


def weights(r: Residuals) -> Array:
    """Product of the paper's three weights: residual (non-rigid motion, occlusion), projection density, gradient."""
    residual = np.exp(-0.5 * (r.e / (2 * robust_sd(r.e))) ** 2)
    gradient = 1 - np.exp(-0.5 * (r.gradient / (np.median(r.gradient) + 1e-6)) ** 2)
    return np.asarray(1e-6 + residual * r.cosine * gradient)
