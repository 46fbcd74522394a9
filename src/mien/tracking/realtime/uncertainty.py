"""The tracker's statement of its own error, calibrated against ground truth.

The inverse of the Gauss-Newton matrix at the optimum covers the noise of one frame, which grows where landmarks fit
worse. It does not cover what is wrong in the same way in every frame. With a wrong relief every turn away from the
first frame's view is too large or too small by a share of it, less so the more turns have taught the shape, and more so
the more they had to. With wrong head axes, which the first frame shows to a few degrees only, the error of a rotation
grows with the turn, too. As no face moves exactly as the animation units do, their error grows with the expression. All
are scaled to the errors measured on rendered sequences with exact truth; docs/benchmark.md has the coverage and the
reliability that result, and the commands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH
from mien.compiled import kernel
from mien.tracking.realtime.identity import logistic
from mien.tracking.realtime.pose import Pose

NOISE_SCALE = 0.16
"""Factor of the standard deviations from the Gauss-Newton matrix where the fit is perfect and nothing hidden."""
MISFIT_DISTANCE = 1.4
"""Median squared distance of the landmarks that doubles those variances."""
# Terms of the standard deviation of the share by which the turn out of the first image plane is wrong.
RELIEF_SCALE, LEAN_SCALE = 0.25, 0.65
"""Per standard deviation of the relief, and per radian by which the learned depths lean away from those of the first
frame: of a face whose depths turn out to be wrong, more is wrong than has been learned. Found by
benchmarks/calibration.py, as the two above and the axes' below."""
TURNED_SCALE = 0.18
"""Per sine of the angle from which the first frame sees the face: from the side it shows little of the relief."""
LEARNED_SCALE = 0.1
"""Where the appearance of the turned face was learned during the turn."""
FAR_SCALE, FAR_COSINE = 0.9, math.cos(math.radians(50.0))
"""By how far the cosine of the turn is below that of 50 degrees: of a face that has turned further the first frame
shows hardly anything. Fitted to modelled people."""
THIN_SCALE, THIN = 0.8, 0.09
"""By how much, in parts, the standard deviation of the depths of the landmarks that are seen is below the second
number, CANDIDE units: they lie in a thin layer across the first frame's view, as those of a cheek. Fitted to rendered
heads behind boards, and to modelled people."""
GRAPHICS_SCALE = 0.35
"""Per share of the landmarks that graphics cover in the first frame. Fitted to rendered heads behind graphics."""
FLAT_SCALE = 0.08
"""Where the landmarks of the first frame have no depths, so that CANDIDE's relief is learned. Fitted to rendered heads
that are marked by hand."""
SHARP = 0.48
"""`quality.sharpness` of the first frame's face below which the standard deviations of a frame's own error grow, with
its inverse square: found on rendered and modelled heads that were blurred by up to 2.5 pixels."""
COARSE = 0.08
"""Share by which the variances of a frame's own error grow with each grey value to which the first frame's face was
rounded at the resolution of the crop, see `Reference`: found on rendered heads of three sizes, in H.264 of all
rates."""
AXES_SCALE = np.array([1.1, 0.5, 0.8])
"""Factors of the standard deviations of the head's axes in tilt, pan and roll, which errors in turns share with the
lean."""
TILT_MOVED_SD = 0.012
"""Standard deviation in radians of the error of the tilt that an expression adds, by how far the units have moved in
all: a jaw that drops looks much like a nod. Found on the rendered heads and on modelled people."""
TILT_WORN_SD = 0.022
"""Standard deviation in radians of the error of the tilt where dark glasses or a mask are worn, which slide on the
face. Found with benchmarks/worn.py."""
TRANSLATION_SCALE = 2.0
"""Factor of the standard deviations of the translation beyond that of the rotation."""
ACROSS_TURNED_SD, ACROSS_MOVED_SD, ALONG_MOVED_SD = 0.005, 0.01, 0.02
"""Standard deviations of the error of the translation across the view, CANDIDE units, that a wrong relief adds, by the
sine of the turn; and that an expression adds by how far the units have moved in all, across the view and, as a share of
the distance, along it. Found with benchmarks/translation.py."""
UNIT_SCALE = np.array([0.65, 0.35, 0.4, 0.5, 0.25, 0.65])
"""Standard deviation of the error of each unit in an expression, as a share of how far the mouth, or for their two
units the brows, have moved in all: no face moves exactly as the units do, and what has moved far is often found less
far."""
UNSEEN_MOUTH_SD = np.array([0.3, 0.25, 0.3, 0.0, 0.2, 0.0])
"""Standard deviation of each unit of a mouth that is never seen, as behind a mask: root mean squares of their motion on
nineteen recordings of people who talk."""
_SCALES = np.outer(*[np.repeat([1.0, TRANSLATION_SCALE, 1.0], [3, 3, 6])] * 2)
_LEAST_LAYER = 0.02
"""Least standard deviation of depths, CANDIDE units: of a single landmark it is nothing."""
LEAST_SEEN = 0.04
"""Share of a single landmark, taken where none is seen."""
CONFIDENCE = (-6.2, -1.5)
"""Bias and weight of the logarithm of the spread in a logistic regression: fitted to the rendered sequences as they
are, with boards of all sizes before the face, and begun with a turned head, a wrong rotation counting twice."""
_HARDLY_SEEN = (0.2, 0.03)
"""Share of the landmarks seen below which nothing is believed, and the width of that step: with less a face is mostly
lost, so that no error can be measured."""
_VISIBLE, _VISIBLE_MOUTH = (21.8, -4.9, 3.5), 1.8
"""Logistic regression of visibility: bias, weights of the logarithm of the squared distance and of the agreement of the
patch, and an extra bias for a mouth, whose appearance changes as it moves. Fitted to recordings and rendered faces with
boards before them."""
_STILL_KNOWN = 0.9
"""Probability that a face which looks strange, but has been the same since it was known, is right: about how often its
rotation is, beyond what the covariance says."""


@dataclass(frozen=True)
class Reference:
    """The frame of reference of all later rotations. R: (3, 3) rotation of the first frame; line_of_sight: (3,) unit
    vector to the head there, camera axes; axes_sd: (3,) standard deviations in radians of the head's axes there in
    tilt, pan and roll; covered: share of the landmarks that graphics cover there; sharpness: of the face there, see
    `quality.sharpness`; rounding: how coarsely it was compressed there, grey values: `Frame.quantizer_step`, which the
    crop's pixels average where they are larger than the frame's; flat: whether its landmarks have no depths there;
    worn: whether dark glasses or a mask are worn there."""

    R: Array
    line_of_sight: Array
    axes_sd: Array
    covered: float = 0.0
    sharpness: float = 1.0
    rounding: float = 0.0
    flat: bool = False
    worn: bool = False

    @cached_property
    def scaled_axes_sd(self) -> Array:
        """(3,) calibrated standard deviations of the axes."""
        return np.asarray(self.axes_sd * AXES_SCALE)

    @cached_property
    def seen_from(self) -> Array:
        """(3,) `line_of_sight` in head axes."""
        return np.asarray(self.R.T @ self.line_of_sight)

    @cached_property
    def vagueness(self) -> float:
        """Factor of the variances of each frame's own error, from a blurred or coarsely compressed face."""
        return max(SHARP / self.sharpness, 1.0) ** 4 * (1 + COARSE * self.rounding)

    @cached_property
    def obliqueness(self) -> float:
        """Sine of the angle from which the first frame sees the face."""
        return math.sqrt(max(0.0, 1 - float(self.seen_from[2]) ** 2))


@dataclass(frozen=True)
class ReliefError:
    """What tells, in a frame, how wrong the relief of the face may be. sd: what the shape's posterior leaves open,
    `ShapePosterior.relief_sd`; lean: how far, in radians, the learned depths lean away from those of the first frame;
    learned: the share of the appearance that was learned in the turn, where the tracker believed the face to be; layer:
    the standard deviation of the depths, along the first frame's view, of the landmarks that are seen: in a thin layer,
    errors of single depths turn the whole, instead of averaging."""

    sd: float
    lean: float = 0.0
    learned: float = 0.0
    layer: float = math.inf


def state_covariance(
    spread: Array, d2: float, seen: float, pose: Pose, moved: Array, first: Reference, relief: ReliefError
) -> Array:
    """Covariance (12, 12) of `[w, t, a]` from the inverse (12, 12) of the Gauss-Newton matrix and the median squared
    distance of the landmarks that are seen, a share `seen` of all, at a pose whose units have moved by `moved` (6,)
    since the first frame; w, in camera axes, is the error that the rotation has beyond that of the first frame's, a
    likewise, and t has the unit of length of the fitted face."""
    seen_from, expression = pose.seen_from, float(moved @ moved)
    turned = max(0.0, 1 - float(seen_from @ first.seen_from) ** 2)
    across = ACROSS_TURNED_SD**2 * turned + ACROSS_MOVED_SD**2 * expression
    along = (ALONG_MOVED_SD * float(pose.t[2])) ** 2 * expression
    systematic = systematic_covariance(pose.R, seen_from, first, relief, expression)
    own = first.vagueness * frame_variance(d2, seen)
    covariance: Array = _total_covariance(own, spread, across, along, systematic, moved)
    return covariance


@kernel()
def _total_covariance(variance: float, spread: Any, across: float, along: float, systematic: Any, moved: Any) -> Any:
    """Covariance (12, 12): a frame's own, with the scale of the translation, and the systematic errors: of the
    translation, per axis across the view and along it, of the rotation (3, 3), and of units that have moved by `moved`
    (6,)."""
    out = np.empty(spread.shape)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = variance * spread[i, j] * _SCALES[i, j]
    for i in range(3):
        for j in range(3):
            out[i, j] += systematic[i, j]
    out[3, 3] += across
    out[4, 4] += across
    out[5, 5] += along
    for k in range(6):
        for j in range(6):
            if MOVES_MOUTH[j] == MOVES_MOUTH[k]:
                out[6 + k, 6 + k] += (UNIT_SCALE[k] * moved[j]) ** 2
    return out


@kernel()
def focal_covariance(t: Any, first_ray: Any, log_sd: float) -> Any:
    """Covariance (6, 6) of `[w, t]` from a focal length whose logarithm has an error with standard deviation log_sd,
    for a head at t (3,), camera axes, that the first frame saw along a ray (3,).

    If it is too long by a share d, the ray to a head at an angle a from the optical axis has an error of `d sin(a)
    cos(a)`, by which all that is seen there seems turned, and the head seems further away by the share d."""
    error, squared = np.zeros(6), t[0] * t[0] + t[1] * t[1] + t[2] * t[2]
    error[0] = t[2] * t[1] / squared - first_ray[2] * first_ray[1]
    error[1] = first_ray[2] * first_ray[0] - t[2] * t[0] / squared
    error[5] = t[2]
    out = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            out[i, j] = log_sd * log_sd * error[i] * error[j]
    return out


def frame_variance(d2: float, seen: float) -> float:
    """Factor from the inverse of the Gauss-Newton matrix to the covariance of one frame's own error; d2 and seen as of
    `state_covariance`."""
    # What is wrong with the landmarks is not independent: with few of them it averages less than the matrix thinks.
    return NOISE_SCALE**2 * (1 + d2 / MISFIT_DISTANCE) / max(seen, LEAST_SEEN)


def systematic_covariance(
    R: Array, seen_from: Array, first: Reference, relief: ReliefError, expression: float = 0.0
) -> Array:
    """Covariance (3, 3) of the part of w that comes from the model and not from the frame: from the relief, the head's
    axes, and an expression. seen_from: (3,) from where, `Pose.seen_from`; expression: squared length of how far the
    units have moved.

    A relief that is too deep along the first frame's view turns too little, about the axis that is perpendicular to
    both views: also where a head crosses the image without a rotation. The standard deviation of the share by which it
    does is made of what may be wrong with the relief, of what the first frame does not show of it, where it sees the
    face from the side or graphics cover a part, and of a turn beyond 50 degrees, of which it shows next to nothing.

    With axes wrong by d every R is R exp(d), an error of R d, of which the first frame has first.R d. An expression
    that is not quite followed tilts the head, and so does something worn that slides."""
    far = FAR_SCALE * max(FAR_COSINE - float(seen_from @ first.seen_from), 0.0)
    shown = math.hypot(TURNED_SCALE * first.obliqueness, GRAPHICS_SCALE * first.covered, FLAT_SCALE * first.flat)
    thin = THIN_SCALE * max(THIN / max(relief.layer, _LEAST_LAYER) - 1, 0.0)
    known = math.hypot(RELIEF_SCALE * relief.sd, LEAN_SCALE * relief.lean, LEARNED_SCALE * relief.learned)
    share = math.hypot(known, shown, far, thin)
    tilted = TILT_MOVED_SD**2 * expression + TILT_WORN_SD**2 * first.worn
    covariance: Array = _of_model(R, seen_from, first.R, first.seen_from, first.scaled_axes_sd, share, tilted)
    return covariance


@kernel()
def _of_model(R: Any, seen_from: Any, R_first: Any, first_from: Any, axes_sd: Any, share: float, tilted: float) -> Any:
    """`systematic_covariance`, with the share by which the turn is too large or too small, and the variance of the tilt
    by the expression."""
    out, turn = np.empty((3, 3)), np.zeros(3)
    for k in range(3):
        m, n = (k + 1) % 3, (k + 2) % 3
        across = share * (seen_from[m] * first_from[n] - seen_from[n] * first_from[m])
        for i in range(3):
            turn[i] += R[i, k] * across
    for i in range(3):
        for j in range(3):
            out[i, j] = turn[i] * turn[j] + tilted * R[i, 0] * R[j, 0]
            for k in range(3):
                out[i, j] += (R[i, k] - R_first[i, k]) * (R[j, k] - R_first[j, k]) * axes_sd[k] * axes_sd[k]
    return out


def confidence(covariance: Array, seen: float, familiar: float, known: float = 0.0) -> float:
    """Probability that the rotation is right to 5 degrees and the face the one that was learned.

    seen: share of all landmarks that are seen; familiar: see `identity.familiarity`; known: see `identity.Identity`. A
    logistic regression on the spread of the rotation, fitted to measured errors, where enough of the face is seen,
    times the probability that this is the face of the first frame at all.
    """
    bias, by_spread = CONFIDENCE
    least, width = _HARDLY_SEEN
    spread = float(covariance[0, 0] + covariance[1, 1] + covariance[2, 2])
    right = logistic(bias + by_spread * math.log(spread))
    return right * logistic((seen - least) / width) * max(familiar, _STILL_KNOWN * known)


@kernel()
def visibility(d2: Any, facing: Any, agreement: Any, mouth: Any) -> Any:
    """Probability (n,) that nothing covers a landmark, from the squared distances d2 (n,); 0 for those that do not face
    the camera.

    agreement: (n,) of the patches with the frames before, see `PatchHistory`; mouth: (n,) which landmarks belong to
    mouth and chin. What covers a face looks strange and comes suddenly. An expression looks strange as well, but mostly
    comes gradually, and stays on the face.
    """
    bias, by_distance, by_agreement = _VISIBLE
    visible = np.zeros(d2.size)
    for i in range(d2.size):
        if facing[i]:
            evidence = bias + by_distance * np.log(max(d2[i], 1.0)) + by_agreement * agreement[i]
            visible[i] = 1 / (1 + np.exp(-evidence - _VISIBLE_MOUTH * mouth[i]))
    return visible
