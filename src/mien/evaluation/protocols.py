"""Protocols that compare a track with the truth: which angles, relative to what, over which frames.

Every protocol compares the rotation since the first frame with truth, because a tracker starts there and the axes of a
sensor are not those of the camera. Angles are tilt (about x), pan (about y) and roll (about z) in head axes, in
degrees; so the signs of pan and roll are opposite to OpenFace's, and the absolute errors are the same.

| protocol | relative rotation | angles of | frames that count |
|---|---|---|---|
| `rebased` | `R_0^T R_t` | `Rx Ry Rz` | all; a lost frame holds the last rotation |
| `sensor` | `R_t R_0^T` | `Ry Rx Rz` | all; a lost frame holds the last rotation |
| `paper` | `R_0^T R_t` | `Rx Ry Rz` | the tracked ones: `e_i` of the paper at most the threshold |

`rebased` is the published OpenFace evaluation of BUFT. `sensor` is the other interpretation of the undocumented
`.dat`. If the truth is a file of angles, they are composed in the order of the protocol; exact rotations need no such
convention.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from mien.arrays import Array, Mask
from mien.errors import MienError, require
from mien.evaluation.datasets.sequence import Truth
from mien.geometry.rotation import FACING, angle_between, rotation_onto

ANGLE_NAMES = ("tilt", "pan", "roll")

DEFAULT_LOST_DEG = 30.0
"""In the protocol `paper`, a frame is lost if the root of its error e_i exceeds this many degrees.

The paper gives no threshold. Beyond 30 degrees a track no longer indicates which way the face looks; every report
includes the curve of P_s against the threshold."""


class Protocol(str, Enum):
    """An evaluation protocol, named in every table."""

    PAPER = "paper"
    REBASED = "rebased"
    SENSOR = "sensor"

    @property
    def order(self) -> str:
        """Order of the intrinsic rotations, in SciPy's notation."""
        return "YXZ" if self is Protocol.SENSOR else "XYZ"

    @property
    def in_head_axes(self) -> bool:
        """Whether rotations are expressed in the head axes of the tracker; `sensor` uses axes fixed to the camera."""
        return self is not Protocol.SENSOR


def protocol_named(name: str) -> Protocol:
    """The protocol with this name. Raises MienError for an unknown name, listing the known ones."""
    names = [p.value for p in Protocol]
    require(name in names, f"unknown protocol {name!r}; the protocols are {', '.join(names)}")
    return Protocol(name)


@dataclass(frozen=True)
class Comparison:
    """Truth and estimate of n frames in the angles of one protocol.

    truth_deg, estimate_deg: (n, 3) tilt, pan, roll since the first frame, with the last estimate held in lost frames;
    rotation_error_deg: (n,) angle between the two rotations; lost: (n,) frames in which the tracker gave no pose;
    covariance_deg2: (n, 3, 3) of the estimated angles, NaN if not given. Angles are NaN in frames without truth.
    """

    protocol: Protocol
    truth_deg: Array
    estimate_deg: Array
    rotation_error_deg: Array
    lost: Mask
    covariance_deg2: Array

    @property
    def error_deg(self) -> Array:
        """(n, 3) estimate minus truth, between -180 and 180."""
        return wrap_deg(self.estimate_deg - self.truth_deg)

    @cached_property
    def aligned_error_deg(self) -> Array:
        """(n, 3) the same after aligning the head axes, which no tracker can know exactly, to the true ones: by one
        rotation for all frames, fitted to those that are not lost. This is a lower bound, as the fit also removes part
        of the other errors, the more the less the head turns."""
        seen = self.known & ~self.lost
        if not seen.any():
            return np.full_like(self.error_deg, np.nan)
        order = self.protocol.order
        angles = (np.nan_to_num(known) for known in (self.truth_deg, self.estimate_deg))
        truth, estimate = (rotation_of(a, order).as_rotvec() for a in angles)
        turn, _ = rotation_onto(estimate[seen], truth[seen])
        aligned = angles_deg(Rotation.from_rotvec(estimate @ turn.T).as_matrix(), order)
        return np.where(self.known[:, None], wrap_deg(aligned - self.truth_deg), np.nan)

    @property
    def sd_deg(self) -> Array:
        """(n, 3) standard deviations of the estimated angles."""
        return np.sqrt(np.diagonal(self.covariance_deg2, axis1=1, axis2=2))

    @property
    def known(self) -> Mask:
        """(n,) frames that have truth."""
        return np.asarray(np.isfinite(self.truth_deg).all(axis=1))

    @property
    def squared_error(self) -> Array:
        """(n,) e_i of the paper, degrees squared; infinite if the tracker gave no pose."""
        e = (self.error_deg**2).sum(axis=1)
        return np.where(self.lost, np.inf, e)

    def tracked(self, lost_deg: float = DEFAULT_LOST_DEG) -> Mask:
        """(n,) frames of the paper's S_s: with truth, and not lost."""
        return self.known & (self.squared_error <= lost_deg**2)

    def counted(self, lost_deg: float = DEFAULT_LOST_DEG) -> Mask:
        """(n,) frames whose errors the protocol averages."""
        return self.tracked(lost_deg) if self.protocol is Protocol.PAPER else self.known


def compare(protocol: Protocol, truth: Truth, rotations: Array, covariance: Array | None = None) -> Comparison:
    """Compare a track with its truth, in the angles of a protocol.

    rotations: (n, 3, 3) head -> camera, NaN where lost; covariance: (n, 3, 3) of the rotation vector in camera axes
    (radians squared). Raises MienError if the truth has fewer than two poses, or the track none in the first frame.
    """
    require(truth.has_pose, "the sequence has no true pose; only its landmarks can be compared")
    require(len(rotations) == truth.frames, f"the track has {len(rotations)} frames and the truth {truth.frames}")
    true_R = truth_rotations(protocol, truth)
    known = np.isfinite(true_R).all(axis=(1, 2))
    require(bool(known.any()), "the truth gives no pose for any frame")
    require(
        int(known.sum()) > 1,
        "the truth gives a pose for one frame only, whose error is zero by definition, as all rotations are compared "
        "since then; it needs those of more frames",
    )
    lost = ~np.isfinite(rotations).all(axis=(1, 2))
    held = hold(rotations)
    first = int(np.argmax(known))
    if not np.isfinite(held[first]).all():
        raise MienError("the tracker gave no pose in the first frame, which is the reference of every protocol")
    A_true, A = relative(protocol, true_R, first), relative(protocol, held, first)
    return Comparison(
        protocol,
        angles_deg(A_true, protocol.order),
        np.where(known[:, None], angles_deg(A, protocol.order), np.nan),
        np.degrees(angle_between(A_true, A)),
        lost & known,
        _angle_covariance(protocol, A, held[first], np.full_like(held, np.nan) if covariance is None else covariance),
    )


def truth_rotations(protocol: Protocol, truth: Truth) -> Array:
    """(n, 3, 3) head -> camera: exact rotations, or the sensor's angles composed in the order of the protocol."""
    if truth.rotations is not None:
        return truth.rotations
    assert truth.angles_deg is not None
    out = np.full((truth.frames, 3, 3), np.nan)
    known = np.isfinite(truth.angles_deg).all(axis=1)
    out[known] = FACING @ rotation_of(truth.angles_deg[known], protocol.order).as_matrix()
    return out


def relative(protocol: Protocol, rotations: Array, first: int = 0) -> Array:
    """(n, 3, 3) rotations since the first frame, in head axes; for `sensor`, in axes fixed to the camera."""
    if protocol.in_head_axes:
        return np.asarray(rotations[first].T @ rotations)
    return np.asarray(FACING @ rotations @ rotations[first].T @ FACING)


def hold(rotations: Array) -> Array:
    """(n, 3, 3) with every lost row replaced by the last known one."""
    known = np.isfinite(rotations).all(axis=(1, 2))
    last = np.maximum.accumulate(np.where(known, np.arange(len(rotations)), -1))
    return np.where((last >= 0)[:, None, None], rotations[np.maximum(last, 0)], np.nan)


def rotation_of(angles_deg: Array, order: str) -> Rotation:
    """The n rotations with tilt, pan, roll (n, 3) in degrees."""
    return Rotation.from_euler(order, angles_deg[:, ["XYZ".index(axis) for axis in order]], degrees=True)


def angles_deg(rotations: Array, order: str) -> Array:
    """(n, 3, 3) -> (n, 3) tilt, pan, roll in degrees; NaN rows stay NaN."""
    known = np.isfinite(rotations).all(axis=(1, 2))
    out = np.full((len(rotations), 3), np.nan)
    if known.any():
        angles = Rotation.from_matrix(rotations[known]).as_euler(order, degrees=True)
        out[known] = angles[:, [order.index(c) for c in "XYZ"]]
    return out


def wrap_deg(angles: Array) -> Array:
    """Wrap angles to the half-open interval [-180, 180)."""
    return np.asarray((angles + 180.0) % 360.0 - 180.0)


def _angle_covariance(protocol: Protocol, A: Array, R_first: Array, covariance: Array) -> Array:
    """(n, 3, 3) degrees squared: covariance of the protocol's angles, propagated from that of the rotation vector.

    The reported uncertainty is interpreted as that of the rotation since the first frame.
    """
    to_relative = FACING if protocol is Protocol.SENSOR else R_first.T
    J = _angle_jacobian(A, protocol.order) @ to_relative
    return np.asarray(np.degrees(1.0) ** 2 * (J @ covariance @ np.swapaxes(J, 1, 2)))


def _angle_jacobian(A: Array, order: str) -> Array:
    """(n, 3, 3) with `angles(exp(w) A) = angles(A) + J w`, radians, by central differences."""
    step, columns = 1e-5, []
    for axis in np.eye(3):
        plus, minus = (Rotation.from_rotvec(s * step * axis).as_matrix() @ A for s in (1.0, -1.0))
        difference = wrap_deg(angles_deg(plus, order) - angles_deg(minus, order))
        columns.append(np.radians(difference) / (2 * step))
    return np.stack(columns, axis=-1)
