"""Metrics, as pure functions of arrays with one row per frame; missing values are NaN."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import ndtri

from mien.arrays import Array, Mask

COVERAGE_LEVELS = (0.50, 0.90, 0.95)
ANGLE_LEVEL = 0.90
"""Level of the intervals that are checked per angle: too narrow in one and too wide in another would cancel out."""

RIGHT_DEG = 5.0
"""`Estimate.confidence` is the probability that the rotation error is below this many degrees."""
_BINS = 10
"""Number of equal intervals of confidence in a `Reliability`."""

UNIT_COUNTERPARTS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "upper_lip_raiser": {"mouthUpperUp": 1.0, "noseSneer": 1.0},
        "jaw_drop": {"jawOpen": 1.0},
        "lip_stretcher": {"mouthStretch": 1.0, "mouthSmile": 1.0, "mouthFunnel": -1.0, "mouthPucker": -1.0},
        "brow_lowerer": {"browDown": 1.0, "browInnerUp": -1.0},
        "lip_corner_depressor": {"mouthFrown": 1.0, "mouthSmile": -1.0},
        "outer_brow_raiser": {"browOuterUp": 1.0},
        "eyes_closed": {"eyeBlink": 1.0},
    }
)
"""Each animation unit, and eye closure, as a sum of ARKit blend shapes, averaged over left and right."""


# Pose


def mean_absolute_error(error_deg: Array, counted: Mask) -> Array:
    """(n, 3) degrees -> (3,): E_tilt, E_pan, E_roll over the frames that count; NaN if there are none."""
    if not counted.any():
        return np.full(3, np.nan)
    return np.asarray(np.abs(error_deg[counted]).mean(axis=0))


def success_rate(squared_error: Array, known: Mask, threshold_deg: float) -> float:
    """P_s: fraction of the frames with truth whose squared error e_i is at most the threshold squared."""
    return float(np.mean(squared_error[known] <= threshold_deg**2)) if known.any() else float("nan")


def jitter_deg(error_deg: Array, lost: Mask) -> Array:
    """(n, 3) -> (3,): standard deviation of the second difference of the error, e[t-1] - 2 e[t] + e[t+1].

    Only over three consecutive tracked frames. White noise with standard deviation s gives sqrt(6) s.
    """
    e = np.where(lost[:, None], np.nan, error_deg)
    second = e[:-2] - 2 * e[1:-1] + e[2:]
    second = second[np.isfinite(second).all(axis=1)]
    return np.asarray(second.std(axis=0)) if len(second) else np.full(3, np.nan)


# Landmarks


def landmark_rms(estimate: Array, truth: Array) -> Array:
    """(n, k, 2), (n, k, 2) pixels -> (n,): root mean square distance of the points in each frame."""
    return np.asarray(np.sqrt(((estimate - truth) ** 2).sum(axis=-1).mean(axis=-1)))


def without_offset(estimate: Array, truth: Array) -> Array:
    """The estimate minus each point's offset from the truth in the first frame that has both; (n, k, 2) pixels.

    Definitions of a landmark differ by a few pixels, which are not a tracking error.
    """
    both = np.isfinite(estimate).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2))
    if not both.any():
        return estimate
    first = int(np.argmax(both))
    return np.asarray(estimate - (estimate[first] - truth[first]))


def root_mean_square(values: Array) -> float:
    """Root mean square of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


# Animation


def counterpart(unit: str, expression: Array, names: tuple[str, ...]) -> Array | None:
    """The ARKit movement (n,) that corresponds to an animation unit; None if the truth has none of its shapes."""
    total = None
    for shape, sign in UNIT_COUNTERPARTS.get(unit, {}).items():
        columns = [i for i, n in enumerate(names) if n == shape or n.removesuffix("_L").removesuffix("_R") == shape]
        if columns:
            term = sign * expression[:, columns].mean(axis=1)
            total = term if total is None else total + term
    return total


def correlation(a: Array, b: Array) -> float:
    """Pearson correlation over the frames that have both; NaN for fewer than three, or if one is constant."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if len(a) < 3 or np.ptp(a) < 1e-9 or np.ptp(b) < 1e-9:
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])


def false_movement(expression: Array) -> Array:
    """(n, m) units without expression -> (m,): largest deviation of each from its value in its first known frame."""
    known = (unit[np.isfinite(unit)] for unit in expression.T)
    return np.array([np.abs(unit - unit[0]).max() if len(unit) else np.nan for unit in known])


# Calibration


def coverage(error: Array, sd: Array, level: float) -> float:
    """Fraction of errors inside the central interval of this level, for Gaussian errors with standard deviation sd.

    Entries that lack either, or whose sd is 0, are excluded; NaN if none remain.
    """
    both = np.isfinite(error) & np.isfinite(sd) & (sd > 0)
    if not both.any():
        return float("nan")
    half_width = float(ndtri(0.5 + 0.5 * level)) * sd[both]
    return float(np.mean(np.abs(error[both]) <= half_width))


def normalised_error_squared(error: Array, covariance: Array) -> Array:
    """(n, d), (n, d, d) -> (n,): `e^T C^-1 e / d`, whose mean is 1 for a calibrated tracker.

    NaN if the covariance is missing or singular.
    """
    out = np.full(len(error), np.nan)
    for i in np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(error).all(axis=1)):
        if np.linalg.cond(covariance[i]) < 1e12:
            out[i] = error[i] @ np.linalg.solve(covariance[i], error[i]) / error.shape[1]
    return out


@dataclass(frozen=True)
class Reliability:
    """A reliability diagram: the fraction of correct frames in each confidence bin.

    edges: (b + 1,); confidence: (b,) mean in the bin; right: (b,) fraction with an error below `RIGHT_DEG`;
    count: (b,). Empty bins are NaN. gap: expected calibration error, the mean of |right - confidence| over frames.
    """

    edges: Array
    confidence: Array
    right: Array
    count: Array
    gap: float


def reliability(confidence: Array, rotation_error_deg: Array) -> Reliability:
    """Bin the confidence (n,), and compare it with the fraction of frames whose rotation error is below 5 degrees."""
    both = np.isfinite(confidence) & np.isfinite(rotation_error_deg)
    c, right = confidence[both], rotation_error_deg[both] < RIGHT_DEG
    edges = np.linspace(0.0, 1.0, _BINS + 1)
    which = np.clip(np.digitize(c, edges) - 1, 0, _BINS - 1)
    count = np.bincount(which, minlength=_BINS).astype(float)
    safe = np.where(count > 0, count, np.nan)
    mean = np.bincount(which, weights=c, minlength=_BINS) / safe
    share = np.bincount(which, weights=right.astype(float), minlength=_BINS) / safe
    gap = float(np.nansum(np.abs(share - mean) * count) / count.sum()) if count.sum() else float("nan")
    return Reliability(edges, mean, share, count, gap)
