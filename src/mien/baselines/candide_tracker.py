"""Shared by the CANDIDE-based trackers of Table 1: the first frame, the rendered views, the detection of loss."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from mien.appearance.crop import Crop
from mien.appearance.views import crop_of_face, rendered_views
from mien.arrays import Array, Float32
from mien.candide.model import MOUTH_TRIANGLES
from mien.errors import require
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import LANDMARK_NAMES, VERTICES, Landmarks
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.paper import CROP_SIZE_UNITS, in_view
from mien.tracking.prior import state_sd
from mien.tracking.state import (
    Estimate,
    Status,
    TrackedLandmarks,
    pack,
    require_begun,
    require_first,
    require_next_of,
    unpack,
)

PIXELS_PER_UNIT = 64.0
"""Size of a CANDIDE unit in the trackers' crops, in pixels."""
CROP_SIZE = round(CROP_SIZE_UNITS * PIXELS_PER_UNIT)
BLUR = 1.0
"""Standard deviation, in crop pixels, of the Gaussian that smooths frames and views."""
SIMPLEX_SD = state_sd(2.0, 0.05, 0.15, 0.05)
"""Standard deviations of the initial simplex around the last state, in the trackers that minimise by one."""


@dataclass(frozen=True)
class CroppedFrame:
    """A smoothed frame around a face, in which the face has the same size as in the rendered views."""

    camera: Camera
    crop: Crop
    gray: Float32

    @classmethod
    def around(cls, b: Array, frame: Frame, camera: Camera, *, upright: bool = True) -> CroppedFrame:
        """Around the face in state b; without `upright`, the crop rolls with the face."""
        R, t, _ = unpack(b)
        crop = crop_of_face(R, t, camera, PIXELS_PER_UNIT, CROP_SIZE, upright=upright)
        return cls(camera, crop, crop.sample(frame, BLUR))

    def points(self, model: LandmarkModel, b: Array) -> Array:
        """Crop points (n, 2) of what a model has, in state b."""
        p, _ = self.camera.project(model.in_camera(b))
        return self.crop.to_crop(p)


@dataclass(frozen=True)
class SearchResult:
    """Result of a search: state (12,), and similarity of the face found there to that of the first frame.

    The similarity is at most 1, for an identical face; each tracker defines its own measure.
    """

    b: Array
    similarity: float


class CandideTracker(ABC):
    """A tracker of CANDIDE's state b, Eq. (2), that learns from the first frame and searches in every other.

    A face is lost if no more than a quarter of the landmarks are in the image, or if the similarity of the result is
    below `least_similarity`. The search then continues from the first frame's state in the first case, and from the
    last good state in the second.
    """

    least_similarity: float
    animated = True
    """Whether the tracker estimates the animation; otherwise it stays that of the first frame."""
    size: tuple[int, int] | None = None
    """Width and height of the first frame."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Fit the first frame and learn the appearance of its face. Raises MienError for landmarks that cannot be
        tracked."""
        require_first(frame, landmarks, camera)
        self.size, self.camera = None, camera  # until the face is known
        self.fit = fit_first_frame(landmarks, camera)
        self.landmarks = LandmarkModel.of_first_frame(self.fit)
        self.b = pack(self.fit.R, self.fit.t, self.fit.animation)
        self._was_lost = False
        self._learn(frame)
        self.size = frame.width, frame.height
        return self._estimate(frame, Status.INITIALIZED)

    def track(self, frame: Frame) -> Estimate:
        """Search for the face in the next frame. Raises MienError before `initialize`, and for a frame whose size
        differs from the first one's."""
        require_next_of(self.size, frame)
        found = self._search(frame)
        if not in_view(self.landmarks.in_camera(found.b), self.camera, frame):
            self.b = pack(self.fit.R, self.fit.t, self.fit.animation)
            return self._lost(frame, "the face left the image")
        if found.similarity < self.least_similarity:
            return self._lost(
                frame, f"nothing found that looks like the face: {found.similarity:.2f} < {self.least_similarity:g}"
            )
        self.b = found.b
        self._adapt(frame)
        status = Status.RECOVERED if self._was_lost else Status.TRACKED
        self._was_lost = False
        return self._estimate(frame, status)

    def mesh(self, estimate: Estimate) -> Array | None:
        """Vertices (113, 3) in camera axes for an estimate of this tracker, None if the face is lost. Raises
        MienError before `initialize`."""
        require_begun(self.size)
        return self.fit.mesh(estimate.rotation, estimate.translation, estimate.animation)

    @abstractmethod
    def _learn(self, frame: Frame) -> None:
        """Learn from the first frame, whose fit is `fit`."""

    @abstractmethod
    def _search(self, frame: Frame) -> SearchResult:
        """Find the state of a frame, starting from the last one, `b`."""

    def _adapt(self, frame: Frame) -> None:  # noqa: B027 (most of these trackers do not)
        """Learn from a tracked frame, whose state is `b`."""

    def _views(self, frame: Frame, rotations: Sequence[Array]) -> Iterator[tuple[Float32, Array]]:
        """Rotated views of the first frame's face: smoothed grey crops, and the landmarks (26, 2) in them.

        The mouth opening has its own triangles; otherwise features at the lips would see through it.
        """
        triangles = np.vstack([self.fit.model.triangles, MOUTH_TRIANGLES])
        views = rendered_views(frame, self.fit, self.camera, triangles, rotations, PIXELS_PER_UNIT, CROP_SIZE, BLUR)
        return ((image, p[VERTICES]) for image, p in views)

    def _lost(self, frame: Frame, reason: str) -> Estimate:
        self._was_lost = True
        return Estimate.lost(frame, reason, self.fit.mm_per_unit)

    def _estimate(self, frame: Frame, status: Status) -> Estimate:
        R, t, animation = unpack(self.b)
        X = self.landmarks.in_camera(self.b)
        tracked = TrackedLandmarks(LANDMARK_NAMES, self.camera.project(X)[0], X)
        return Estimate(
            frame.index,
            frame.time,
            status,
            rotation=R,
            translation=t,
            animation=animation if self.animated else None,
            landmarks=tracked,
            confidence=1.0,
            mm_per_unit=self.fit.mm_per_unit,
        )


def require_scikit_learn(tracker: str) -> None:
    """Raise MienError, naming the tracker, if scikit-learn is not installed."""
    require(
        find_spec("sklearn") is not None,
        f"the tracker {tracker!r} needs scikit-learn: pip install scikit-learn",
    )
