"""What a tracker says of a frame, and the protocol that every tracker follows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy as np

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.errors import MienError, require
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, euler_from_matrix, euler_jacobian, exp, log
from mien.initialization.landmarks import Landmarks

STATE_NAMES = ("rx", "ry", "rz", "tx", "ty", "tz", *TRACKED_UNITS)
"""The twelve entries of the state b, Eq. (2)."""
EYES_CLOSED = "eyes_closed"
EXPRESSION_NAMES = (*TRACKED_UNITS, EYES_CLOSED)
"""What is told of the expression: the animation units of the state, and beside it how far the eyes have closed."""


class Status(str, Enum):
    """What became of the face in a frame."""

    INITIALIZED = "initialized"
    TRACKED = "tracked"
    RECOVERED = "recovered"
    LOST = "lost"

    __str__ = str.__str__  # as in tables; what Python would write differs from version to version

    @property
    def success(self) -> bool:
        """Whether the frame has the face."""
        return self is not Status.LOST


class _Protected:
    """A frozen value whose arrays cannot be written to: a tracker may go on in its own. They are copies."""

    def __post_init__(self) -> None:
        fields = vars(self)
        for name, array in fields.items():
            if isinstance(array, np.ndarray):
                fields[name] = np.array(array)
                fields[name].setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:  # what pickle reads can be written to
        vars(self).update(state)
        self.__post_init__()


@dataclass(frozen=True, eq=False)
class TrackedLandmarks(_Protected):
    """Landmarks of one frame: n names, (n, 2) pixels, (n, 3) CANDIDE units in camera axes.

    visibility: (n,) probability that nothing hides the landmark; distance: (n,) Mahalanobis distance of what was
    seen from what was expected, NaN where the landmark does not face the camera. What a tracker does not estimate is
    None. The arrays cannot be written to.
    """

    names: tuple[str, ...]
    image: Array
    camera: Array | None = None
    visibility: Array | None = None
    distance: Array | None = None

    def __repr__(self) -> str:
        return f"<TrackedLandmarks: {len(self.names)}>"


@dataclass(frozen=True)
class Closing:
    """How far both eyes have closed, 0 being as in the first frame and 1 shut: mean and standard deviation."""

    share: float
    sd: float


@dataclass(frozen=True, eq=False)
class Estimate(_Protected):
    """What a tracker knows after one frame. A lost face has status LOST and no rotation. Estimates compare by identity.

    index, time: of the frame, in seconds; rotation: (3, 3) from head axes (x to its own left, y up, z out of the face)
    to camera axes (x right, y down, z away); translation: (3,) CANDIDE units, camera axes; animation: (6,) in the order
    of `EXPRESSION_NAMES`, without the last; covariance: (12, 12) of `[w, t, a]`, with w the rotation vector in camera
    axes that corrects what has turned since the first frame, whose own error is not in it; landmarks: `image` (n, 2) in
    pixels, `camera` (n, 3) in CANDIDE units, `visibility` (n,), and their `names`, see `TrackedLandmarks`; confidence
    in [0, 1]: the probability that the rotation is right to 5 degrees and the face the one that was learned;
    mm_per_unit: millimetres of a CANDIDE unit; reason: why the face is lost; closing: `share` and `sd` of how far the
    eyes have closed, see `Closing`; model_rotation: (3, 3) from the axes of the model, which stay while those of the
    head are learned, to the camera's.
    What a tracker does not estimate is None, and no array can be written to.
    """

    index: int
    time: float
    status: Status
    rotation: Array | None = None
    translation: Array | None = None
    animation: Array | None = None
    covariance: Array | None = None
    landmarks: TrackedLandmarks | None = None
    confidence: float = 0.0
    mm_per_unit: float = 1.0
    reason: str = ""
    closing: Closing | None = None
    model_rotation: Array | None = None

    @classmethod
    def lost(cls, frame: Frame, reason: str, mm_per_unit: float = 1.0) -> Estimate:
        """The estimate of a frame without a face, and why."""
        return cls(frame.index, frame.time, Status.LOST, mm_per_unit=mm_per_unit, reason=reason)

    def __repr__(self) -> str:
        told = [self.status.value]
        if self.euler is not None:
            pitch, yaw, roll = np.degrees(self.euler)
            told += [f"yaw {yaw:+.1f}", f"pitch {pitch:+.1f}", f"roll {roll:+.1f} degrees"]
        if self.status.success:
            told.append(f"confidence {100 * self.confidence:.0f}%")
        if self.reason:
            told.append(self.reason)
        return f"<Estimate of frame {self.index} at {self.time:.2f} s: {', '.join(told)}>"

    @property
    def expression(self) -> Array:
        """(7,) in the order of `EXPRESSION_NAMES`, NaN where it is not estimated."""
        units = np.full(len(TRACKED_UNITS), np.nan) if self.animation is None else self.animation
        return np.append(units, np.nan if self.closing is None else self.closing.share)

    @property
    def translation_mm(self) -> Array | None:
        """`translation` (3,) in millimetres."""
        return None if self.translation is None else np.asarray(self.translation * self.mm_per_unit)

    @property
    def euler(self) -> Array | None:
        """Angles (3,) in radians of `R = Rx Ry Rz` in camera axes, zero when facing the camera."""
        return None if self.rotation is None else euler_from_matrix(self.rotation @ FACING)

    @property
    def euler_sd(self) -> Array | None:
        """Standard deviations (3,) in radians of `euler`."""
        if self.rotation is None or self.covariance is None:
            return None
        J = euler_jacobian(self.rotation @ FACING)
        return np.asarray(np.sqrt(np.maximum(np.diag(J @ self.covariance[:3, :3] @ J.T), 0.0)))


class Tracker(Protocol):
    """A tracker of one face. It never raises for a lost face: that is a status."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Learn the face of a first frame, in which its landmarks are known. Raises MienError for landmarks that cannot
        be tracked."""
        ...

    def track(self, frame: Frame) -> Estimate:
        """The face in the next frame, of the size of the first."""
        ...


def require_first(frame: Frame, landmarks: Landmarks, camera: Camera) -> None:
    """Raise MienError if a tracker cannot begin with these, as they are something else or the landmarks are wrong."""
    for given, kind in ((frame, Frame), (landmarks, Landmarks), (camera, Camera)):
        require(
            isinstance(given, kind),
            f"{type(given)} is no mien.{kind.__name__}; initialize takes a frame, its landmarks and the camera",
        )
    landmarks.check(frame.width, frame.height)


def require_begun(size: tuple[int, int] | None) -> None:
    """Raise MienError if a tracker has not begun, so that the size of its first frame is None."""
    require(size is not None, "the tracker knows no face yet; call initialize first")


def require_next_of(size: tuple[int, int] | None, frame: Frame) -> None:
    """Raise MienError if a tracker that began with a frame of this width and height, None if it has not begun, cannot
    track a frame: the camera's numbers hold for that size."""
    require(isinstance(frame, Frame), f"{type(frame)} is no frame; give each as mien.Frame(pixels, index, time)")
    if size == (frame.width, frame.height):
        return
    require_begun(size)
    raise MienError(
        f"frame {frame.index} has the size {(frame.width, frame.height)}, the first had {size}; "
        "scale it, as mien.stream does"
    )


def landmark_names_with(before: tuple[str, ...], estimate: Estimate) -> tuple[str, ...]:
    """The names of the landmarks of an estimate, or those `before`, () for none yet, if it has no landmarks. Raises
    MienError if it has others than those before, as a table has a column for each."""
    if estimate.landmarks is None:
        return before
    names = estimate.landmarks.names
    require(
        before in ((), names),
        f"frame {estimate.index} has {len(names)} landmarks, {names[:1]} first, and an earlier one {len(before)}, "
        f"{before[:1]} first; a tracker gives the same in every frame",
    )
    return names


def pack(R: Array, t: Array, animation: Array) -> Array:
    """State b of Eq. (2): (3, 3), (3,), (6,) -> (12,), the rotation as the vector from `FACING`."""
    return np.concatenate([log(R @ FACING), t, animation])


def unpack(b: Array) -> tuple[Array, Array, Array]:
    """Inverse of `pack`: (12,) -> R (3, 3) head -> camera, t (3,), animation (6,)."""
    return exp(b[:3]) @ FACING, b[3:6], b[6:]
