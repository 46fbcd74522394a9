"""Replays the output of OpenFace from its CSV like a tracker: `--trackers openface:PATH`.

PATH is one CSV, or a folder with one per sequence, named after it. CSV files of mien can be read as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mien.candide.model import Candide, mm_per_unit
from mien.errors import MienError, require, warn
from mien.evaluation.points12 import names_of_scheme
from mien.evaluation.pose_csv import read_pose_csv
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Landmarks
from mien.tracking.state import Closing, Estimate, Status, TrackedLandmarks, require_begun

_LATE_S, _OTHER_RATE = 0.25, 0.3
"""Difference in seconds between the times of a row and its frame, and that over the time passed, from which they do not
belong together. Images have no times of their own; taken to be 25 a second, they may have been 30."""


class OpenFaceTracker:
    """Returns the row of a CSV for each frame. A frame without a row, or with success 0, is lost.

    Raises MienError if the file is not such a table. Camera and first landmarks are ignored.
    """

    size: tuple[int, int] | None = None
    """Width and height of the first frame."""

    def __init__(self, path: str = "") -> None:
        require(bool(path), "the tracker 'openface' needs a CSV or a folder of them: openface:PATH")
        self._table = read_pose_csv(Path(path))
        wrong = [c for c in self._table.confidence if not 0 <= c <= 1]
        if wrong:
            raise MienError(f"{path}: the confidence {wrong[0]:g} is not between 0 and 1; correct the column")
        self.source, self.rows = self._table.source, self._table.index
        self._row_of = {int(i): row for row, i in enumerate(self._table.index) if self._table.tracked[row]}
        self._mm_per_unit = mm_per_unit(Candide.default().vertices())

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """The row of the first frame."""
        self.size, self._begun, self._warned = (frame.width, frame.height), frame, False
        return self._estimate(frame, Status.INITIALIZED)

    def track(self, frame: Frame) -> Estimate:
        """The row of a frame. Raises MienError before `initialize`."""
        require_begun(self.size)
        return self._estimate(frame, Status.TRACKED)

    def _estimate(self, frame: Frame, status: Status) -> Estimate:
        if frame.index not in self._row_of:
            return Estimate.lost(frame, f"{self._table.source.name} has no face in this frame", self._mm_per_unit)
        table, row = self._table, self._row_of[frame.index]
        self._compare_times(frame, row)
        t = None if table.translation_mm is None else table.translation_mm[row] / self._mm_per_unit
        known = t is not None and bool(np.isfinite(t).all())
        return Estimate(
            frame.index,
            frame.time,
            status,
            rotation=None if table.rotation is None else table.rotation[row],
            translation=t if known else None,
            animation=None if table.animation is None else table.animation[row],
            landmarks=self._landmarks(row),
            confidence=float(table.confidence[row]),
            mm_per_unit=self._mm_per_unit,
            closing=self._closing(row),
        )

    def _compare_times(self, frame: Frame, row: int) -> None:
        """Warn once if a row lies elsewhere in time than its frame, as if it counted other frames than the video's."""
        first = self._row_of.get(self._begun.index)
        if self._warned or first is None or self._table.rate is None:
            return
        times = self._table.time
        stated, passed = float(times[row] - times[first]), frame.time - self._begun.time
        if abs(stated - passed) > max(_LATE_S, _OTHER_RATE * abs(passed)):  # never of NaN; a track may run backwards
            self._warned = True
            warn(
                f"{self._table.source}: the row of frame {frame.index} lies {stated:.2f} s after the first, and the "
                f"frame {passed:.2f} s; it seems to be of a video with another frame rate"
            )

    def _closing(self, row: int) -> Closing | None:
        if self._table.eyes_closed is None:
            return None
        share, sd = map(float, self._table.eyes_closed[row])
        return Closing(share, sd) if np.isfinite(share) else None

    def _landmarks(self, row: int) -> TrackedLandmarks | None:
        if self._table.landmarks is None:
            return None
        points = self._table.landmarks[row]
        return TrackedLandmarks(names_of_scheme(self._table.scheme, len(points)), points)
