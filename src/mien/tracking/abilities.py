"""What a tracker may offer beside `Tracker`; what it does not offer is left out of overlays and files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from mien.arrays import Array
from mien.graphics import Graphics
from mien.initialization.fit import FirstFrame
from mien.tracking.state import Estimate, Tracker


@runtime_checkable
class FittedTracker(Protocol):
    """A tracker that fits CANDIDE to the first frame, so that files can store the fit and overlays show its mesh.

    mesh: vertices (V, 3) at an estimate, camera axes, CANDIDE units; None where the face is lost.
    """

    fit: FirstFrame

    def mesh(self, estimate: Estimate) -> Array | None: ...


@runtime_checkable
class ShapeTracker(Protocol):
    """A tracker that learns the depths of the landmarks while it tracks.

    landmark_depths: of the n reported landmarks, (n,) along the optical axis in CANDIDE units, where the model has the
    rotation R (3, 3), t (3,) and the animation (6,), and the eyes have closed by a share.
    """

    def landmark_depths(self, R: Array, t: Array, animation: Array, closed: float) -> Array: ...


@runtime_checkable
class Axes(Protocol):
    """The head axes as they are known now: R_model_head (3, 3), from them to the model's; `report_anew` returns the
    rotation (3, 3), in camera axes, that corrects everything reported so far."""

    R_model_head: Array

    def report_anew(self) -> Array: ...


@runtime_checkable
class GraphicsTracker(Protocol):
    """A tracker that paints over the graphics that come with the landmarks of the first frame."""

    graphics: Graphics | None


@runtime_checkable
class RepeatableTracker(Protocol):
    """A tracker that can start again with what it has learned."""

    def again(self) -> Tracker: ...


@runtime_checkable
class ReplayedTracker(Protocol):
    """A tracker that repeats what a file says.

    source: the file; rows: (n,) indices of the frames of which it says anything.
    """

    source: Path
    rows: NDArray[np.intp]


def axes_of(tracker: object) -> Axes | None:
    """What a tracker that learns the axes of the head while it tracks knows of them, its `axes`; None for others."""
    axes = getattr(tracker, "axes", None)
    return axes if isinstance(axes, Axes) else None


def settings_of(tracker: Tracker) -> dict[str, Any]:
    """The settings of a tracker as plain values, those that JSON does not know as null; empty if it has none."""
    own = getattr(tracker, "settings", None)
    return dict(json.loads(own.model_dump_json())) if isinstance(own, BaseModel) else {}
