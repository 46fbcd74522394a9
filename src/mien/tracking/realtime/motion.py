"""The motion since the last frame, measured by direct alignment of the patches that the last frame showed.

Descriptors locate the face to a fifth of a degree, with an error that differs from frame to frame. The pixels measure
the motion since the last frame to a fraction of that, but the errors of such measurements add up. Eq. (4) takes the
state to stay where it was; here it moves with the pixels, and Psi is the uncertainty of that motion: the descriptors
correct the sum of the motions, and the motions remove the noise of the descriptors. Nothing is delayed, since a motion
is measured in the frame in which it happens.

After B. Lucas and T. Kanade, An iterative image registration technique, IJCAI 1981, with the warp that the pose makes
(S. Baker and I. Matthews, Lucas-Kanade 20 years on, IJCV 56, 2004), gradients of the last frame, and the brightness and
contrast of each patch left free.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mien.arrays import Array, Float32, Mask
from mien.candide.model import MOVES_MOUTH
from mien.compiled import kernel
from mien.config.realtime import MotionSettings
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.definite import inverse, solve_positive
from mien.tracking.realtime.kernels import PriorArrays, linearize_prior
from mien.tracking.realtime.pose_geometry import (
    STATE_SIZE,
    PersonArrays,
    PoseArrays,
    ViewArrays,
    gradient_by_pose,
    head_to_crop,
    landmark,
    project_to_crop,
    projection_of,
    rotated,
    step_back,
)

_RIGID = 6
"""Entries of a pose step that rotate and translate the head, before those of the animation."""
_HELD = 1e12
"""Information that keeps an entry of a pose step at zero."""
_LEAST_GREY = 1.0
"""Grey values: a smaller residual is due to chance."""


def holding_all_but(free: Mask) -> Array:
    """Information (12, 12) that holds the head, and all animation units but those which are free (6,)."""
    return np.diag(np.append(np.full(_RIGID, _HELD), np.where(free, 0.0, _HELD)))


class Template(NamedTuple):
    """Patches of n landmarks, m points each, in one frame.

    values (n, m), less their mean, and norms (n,) of these; J (n, 6, m), derivatives by rotation and translation, less
    their mean; JJ (n, 12, 12), sums of the products of the derivatives by the whole pose step; units (n, 6, 3), the
    displacements by the animation units in camera axes.
    """

    values: Float32
    norms: Array
    J: Float32
    JJ: Array
    units: Array


class Motion:
    """The patches around the landmarks in the last frame, and their alignment with the next. weight: (n,) how far each
    patch counts in the next measurement."""

    def __init__(self, patches: Array, mouth: Mask, jaw: float, settings: MotionSettings) -> None:
        """patches: (n, m, 3) points around each landmark, relative to it, head axes; mouth: (n,) which of them are on
        the mouth; jaw: standard deviation of the change of `jaw_drop` in a frame."""
        self.settings = settings
        self.patches = np.ascontiguousarray(np.swapaxes(patches, 1, 2))  # by coordinate: read several points at a time
        floor = np.repeat(
            [math.radians(settings.rotation_deg), settings.translation, settings.animation],
            [3, 3, 6],
        )
        floor[6 + JAW_DROP] = jaw  # a mouth that opens shows what the last frame did not
        self.least_drift = floor**2
        self.template: Template | None = None
        self.weight = np.zeros(len(patches))
        self.mouth = mouth
        self.held = holding_all_but(MOVES_MOUTH)

    def remember(
        self, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays
    ) -> tuple[Float32, Array]:
        """Take the patches from a crop in which the face is at a pose; returns their values (n, m) less their mean, and
        norms (n,)."""
        self.template = Template(*extract_patches(image, person, self.patches, pose, view))
        return self.template.values, self.template.norms

    def measure(
        self, image: Float32, person: PersonArrays, prior: PriorArrays, view: ViewArrays
    ) -> tuple[PoseArrays, Array]:
        """The pose at which a crop shows the patches best, and the information (12, 12) that they have of a step from
        it, see `information_of`.

        The head's motion is that of most patches. A mouth moves differently, and is an outlier among them: its units
        are aligned once more with the head held, and each of its patches compared with its own contrast."""
        s = self.settings
        assert self.template is not None, "the last frame is remembered before a motion is measured"
        template = tuple(self.template)
        (R, t, a), information = align(
            image, person, self.patches, template, self.weight, tuple(prior), view, s.robust_factor, 0.0, s.iterations,
            s.tolerance,
        )  # fmt: skip
        held = prior._replace(pose=(R, t, a), information=prior.information + self.held)
        (_, _, a), _ = align(
            image, person, self.patches, template, self.weight * self.mouth, tuple(held), view, s.robust_factor,
            s.mouth_share, s.iterations, s.tolerance,
        )  # fmt: skip
        return (R, t, a), information

    def information_of(self, measured: Array, prior: Array, since: Array, step: Array) -> Array:
        """Information (12, 12) of a step from the measured pose, in units of the energy of Eq. (9): of what the patches
        have `measured` (12, 12), with that of the prior (12, 12), less what the last pose is uncertain by, its
        covariance `since` (12, 12), and the systematic error of the measured step (12,): a share of it, and a
        constant."""
        s = self.settings
        information: Array = _of_measured_step(measured, 1 / s.noise, prior, since, step, s.share, self.least_drift)
        return information


@kernel()
def _of_measured_step(
    measured: Any, scale: float, prior: Any, since: Any, step: Any, share: float, least_drift: Any
) -> Any:
    """What `Motion.information_of` returns; scale: the information of the patches over `measured`; least_drift: (12,)
    variances of the constant."""
    total = np.empty((STATE_SIZE, STATE_SIZE))
    for r in range(STATE_SIZE):
        for c in range(STATE_SIZE):
            total[r, c] = scale * measured[r, c] + prior[r, c]
    covariance, _ = inverse(total)
    turned = step[0] * step[0] + step[1] * step[1] + step[2] * step[2]
    moved = step[3] * step[3] + step[4] * step[4] + step[5] * step[5]
    for r in range(STATE_SIZE):
        for c in range(STATE_SIZE):
            covariance[r, c] += since[r, c]
        squared = turned if r < 3 else moved if r < _RIGID else step[r] * step[r]
        covariance[r, r] += least_drift[r] + share * share * squared
    information, _ = inverse(covariance)
    return information


@kernel()
def bilinear(image: Any, x: float, y: float) -> Any:
    """Bilinear value of an image at a point, and its derivatives by the point; beyond the border the border repeats."""
    height, width = image.shape
    x, y = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001)
    ix, iy = int(x), int(y)
    fx, fy = np.float32(x - ix), np.float32(y - iy)
    a, b, c, d = image[iy, ix], image[iy, ix + 1], image[iy + 1, ix], image[iy + 1, ix + 1]
    upper, lower = a + fx * (b - a), c + fx * (d - c)
    return upper + fy * (lower - upper), (np.float32(1.0) - fy) * (b - a) + fy * (d - c), lower - upper


@kernel(inline="always")  # so that it runs several points at a time
def _place_patch(i: int, person: Any, patches: Any, a: Any, to_crop: Any, q: Any) -> None:
    """The points of patch i in the crop: u, v and depth (3, m)."""
    x, y, z = landmark(i, person, a)
    for j in range(q.shape[1]):
        q[0, j], q[1, j], q[2, j] = project_to_crop(
            x + patches[i, 0, j], y + patches[i, 1, j], z + patches[i, 2, j], to_crop
        )


@kernel()
def extract_patches(image: Any, person: Any, patches: Any, pose: Any, view: Any) -> Any:
    """The entries of the `Template` of a face at a pose. patches (n, 3, m): points, relative to their landmarks in the
    model's axes.

    All points of a patch move alike with the units, so that the derivatives by these are sums of those by translation.
    """
    R, t, a = pose
    units, projection, to_crop = person[1], projection_of(view), head_to_crop(R, t, view)
    n, m = patches.shape[0], patches.shape[2]
    values, norms = np.empty((n, m), np.float32), np.empty(n)
    J, JJ, turned = (
        np.empty((n, _RIGID, m), np.float32),
        np.empty((n, STATE_SIZE, STATE_SIZE)),
        np.empty((n, STATE_SIZE - _RIGID, 3)),
    )
    q, slope = np.empty((3, m)), np.empty((2, m))
    for i in range(n):
        _place_patch(i, person, patches, a, to_crop, q)
        for j in range(m):
            values[i, j], slope[0, j], slope[1, j] = bilinear(image, q[0, j], q[1, j])
        x, y, z = landmark(i, person, a)
        for j in range(m):
            Y = rotated(R, x + patches[i, 0, j], y + patches[i, 1, j], z + patches[i, 2, j])
            by_pose = gradient_by_pose(slope[0, j], slope[1, j], (q[0, j], q[1, j], q[2, j]), Y, projection)
            for k in range(_RIGID):
                J[i, k, j] = by_pose[k]
        norms[i] = np.sqrt(center(values[i]))
        for k in range(_RIGID):
            center(J[i, k])
            for r in range(k + 1):
                s = np.float32(0.0)
                for j in range(m):
                    s += J[i, k, j] * J[i, r, j]
                JJ[i, k, r] = s
                JJ[i, r, k] = s
        for k in range(STATE_SIZE - _RIGID):
            x, y, z = rotated(R, units[k, i, 0], units[k, i, 1], units[k, i, 2])
            turned[i, k, 0], turned[i, k, 1], turned[i, k, 2] = x, y, z
            for r in range(_RIGID + k + 1):
                s = x * JJ[i, r, 3] + y * JJ[i, r, 4] + z * JJ[i, r, 5]
                JJ[i, r, _RIGID + k] = s
                JJ[i, _RIGID + k, r] = s
    return values, norms, J, JJ, turned


@kernel()
def center(x: Any) -> Any:
    """Subtract its mean from an array (m,); returns the sum of squares of the rest."""
    mean, squared = np.float32(0.0), np.float32(0.0)
    for j in range(x.size):
        mean += x[j]
    mean /= x.size
    for j in range(x.size):
        x[j] -= mean
        squared += x[j] * x[j]
    return squared


@kernel()
def _compare(patch: Any, values: Any, norm: float) -> Any:
    """Give a patch (m,) the brightness and contrast of the last frame's and subtract the values seen there; returns the
    mean square of the residual."""
    contrast = np.float32(min(max(norm / np.sqrt(center(patch) + 1e-9), 0.5), 2.0))
    squared = np.float32(0.0)
    for j in range(values.size):
        patch[j] = contrast * patch[j] - values[j]
        squared += patch[j] * patch[j]
    return squared / values.size


@kernel(inline="always")
def _weight(squared: float, tolerated: float) -> float:
    """Weight of Geman and McClure of a patch with a mean square residual: a quarter at `tolerated`."""
    ratio = 1.0 / (1.0 + squared / tolerated)
    return ratio * ratio


@kernel(inline="always")
def _add_patch(J: Any, residual: Any, units: Any, JJ: Any, w: float, down: Any, G: Any, D: Any) -> None:
    """Add one patch of a `Template`, with its residual (m,) and weight, to the gradient G (12,) and the information D
    (12, 12). down: (12,) memory for its own gradient."""
    for r in range(_RIGID):
        s = np.float32(0.0)
        for j in range(residual.size):
            s += J[r, j] * residual[j]
        down[r] = s
    for k in range(STATE_SIZE - _RIGID):
        down[_RIGID + k] = down[3] * units[k, 0] + down[4] * units[k, 1] + down[5] * units[k, 2]
    for r in range(STATE_SIZE):
        G[r] += w * down[r]
        for c in range(STATE_SIZE):
            D[r, c] += w * JJ[r, c]


@kernel()
def align(
    image: Any, person: Any, patches: Any, template: Any, active: Any, prior: Any, view: Any, robust: float,
    share: float, iterations: int, tolerance: float,
) -> Any:  # fmt: skip
    """Gauss-Newton from the prior's pose, with the derivatives of the last frame, until a step promises a gain below
    `tolerance`. Returns the pose and the information (12, 12) of the pixels, taken as independent. A patch loses its
    weight (Geman and McClure) where its residual exceeds `robust` times the usual one of this frame, and `share` of its
    own contrast."""
    values, norms, J, JJ, turned = template
    n, m = values.shape
    pose = prior[0]
    residual, off, tolerated = np.empty((n, m), np.float32), np.zeros(n), np.empty(n)
    for i in range(n):
        tolerated[i] = share * share * norms[i] * norms[i] / m
    q = np.empty((3, m))
    H, G, D, down = (
        np.empty((STATE_SIZE, STATE_SIZE)),
        np.empty(STATE_SIZE),
        np.empty((STATE_SIZE, STATE_SIZE)),
        np.empty(STATE_SIZE),
    )
    usual = 1e9  # at first every patch counts
    for _ in range(iterations):
        R, t, a = pose
        to_crop = head_to_crop(R, t, view)
        total, squared = 1e-9, 0.0
        for i in range(n):
            if active[i] > 0.0:
                _place_patch(i, person, patches, a, to_crop, q)
                for j in range(m):
                    residual[i, j] = bilinear(image, q[0, j], q[1, j])[0]
                off[i] = _compare(residual[i], values[i], norms[i])
                w = active[i] * _weight(off[i], max(robust * robust * usual, tolerated[i]))
                total += w
                squared += w * off[i]
        usual = max(squared / total, _LEAST_GREY * _LEAST_GREY)
        linearize_prior(pose, prior, H, G)
        for r in range(STATE_SIZE):
            for c in range(STATE_SIZE):
                D[r, c] = 0.0
        for i in range(n):
            if active[i] <= 0.0:
                continue
            w = active[i] * _weight(off[i], max(robust * robust * usual, tolerated[i])) / usual
            _add_patch(J[i], residual[i], turned[i], JJ[i], w, down, G, D)
        for r in range(STATE_SIZE):
            for c in range(STATE_SIZE):
                H[r, c] += D[r, c]
        step = solve_positive(H, G)
        pose = step_back(pose, step)
        gain = 0.0
        for k in range(STATE_SIZE):
            gain += step[k] * G[k]
        if gain < tolerance:
            break
    return pose, D
