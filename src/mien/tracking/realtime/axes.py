"""The axes of the head, which the first frame shows to a few degrees, and the learned shape a little better.

In one frame a face that leans, with the chin forward or one cheek nearer, looks like a head that is turned. As turns
teach the depths they show which of the two it was: where the shape turns out to lean in the model's axes, the head's
own axes mostly lean with it, by a share that was chosen on heads whose axes are known. The axes are then found again
as in the first frame, for a person who probably looks into the camera there.

The rotation reported for the first frame stays, so that a head that comes back has the rotation with which it began. At
the end of a file all rotations are turned alike to what is then known of the first.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mien.arrays import Array
from mien.config.realtime import AxesSettings
from mien.geometry.rotation import exp
from mien.initialization.fit import FirstFrame, most_likely_facing
from mien.tracking.realtime.shape import ShapePosterior
from mien.tracking.realtime.uncertainty import Reference

_SD_DEG = (3.0, 1.25, 0.8)
"""Standard deviations of a person's own axes (tilt, pan, roll) from those of a model that leans as its shape does."""
_LEAST = 1e-3
"""Smallest change of the lean, in radians, that moves the axes."""


class HeadAxes:
    """The reference of later rotations, and the axes in which they are reported.

    first: rotation of the model in the first frame, and how well the axes are known; reported: (3, 3) rotation of the
    head that was reported for it; R_model_head: (3, 3) from its axes to those of the model.
    """

    def __init__(
        self,
        fit: FirstFrame,
        first: Reference,
        shape: ShapePosterior,
        settings: AxesSettings,
    ) -> None:
        """first: with the axes as the first frame alone shows them; shape: from which they are known better."""
        self.fit, self.first, self.reported = fit, first, first.R
        self.share = np.array([settings.tilt_share, settings.pan_share])
        self.R_model_head = np.eye(3)
        self._lean = np.zeros(2)
        self.learn(shape)

    def learn(self, shape: ShapePosterior) -> None:
        """Update the axes to a shape that has been learned further."""
        lean = self.share * shape.lean
        if math.dist(lean.tolist(), self._lean.tolist()) < _LEAST:
            return
        self._lean, fit = lean, self.fit
        R, sd = most_likely_facing(fit.R @ exp(np.append(lean, 0.0)) @ fit.R_head_fit, fit.t, _SD_DEG)
        self.R_model_head = fit.R.T @ R
        self.first = replace(self.first, axes_sd=sd)

    def rotation(self, R: Array) -> Array:
        """Rotation (3, 3) of the head where the model has R (3, 3): for the first frame the one that was reported, so
        that nothing learned later turns it; what has turned since is expressed in the axes of the head."""
        return np.asarray(self.reported @ self.R_model_head.T @ self.first.R.T @ R @ self.R_model_head)

    def model_rotation(self, R: Array) -> Array:
        """Rotation (3, 3) of the model where the head has R (3, 3): the inverse of `rotation`."""
        return np.asarray(self.first.R @ self.R_model_head @ self.reported.T @ R @ self.R_model_head.T)

    def report_anew(self) -> Array:
        """Report the first frame by what is known now; returns the rotation (3, 3), in camera axes, that corrects
        everything reported so far."""
        before, self.reported = self.reported, self.first.R @ self.R_model_head
        return np.asarray(self.reported @ before.T)
