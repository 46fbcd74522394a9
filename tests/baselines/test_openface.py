"""OpenFace's CSV as a tracker's output."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mien.baselines.openface import OpenFaceTracker
from mien.errors import MienError
from mien.evaluation.points12 import POINT_NAMES
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Landmarks
from mien.output.track import Track
from mien.registry import create_tracker
from mien.tracking.state import Estimate, Status

FIRST = Landmarks(np.zeros((68, 2)), "ibug68")
CAMERA = Camera(500, 160, 120)
PIXELS = np.zeros((4, 4, 3), np.uint8)


def _track(file: Path, frames: int) -> list[Estimate]:
    tracker = OpenFaceTracker(str(file))
    first = tracker.initialize(Frame(PIXELS, 0, 0.0), FIRST, CAMERA)
    return [first, *(tracker.track(Frame(PIXELS, i, i / 25)) for i in range(1, frames))]


def _openface(path: Path) -> Path:
    """As OpenFace writes it: a space after every comma, frames from 1, the third without a face."""
    names = ["frame", "face_id", "timestamp", "confidence", "success"]
    names += [f"pose_{a}" for a in ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")]
    names += [f"{axis}_{i}" for axis in "xy" for i in range(68)]
    rows = []
    for i, success in enumerate((1, 1, 0)):
        pose = [10 * i, 0, 630, 0.1 * i, -0.2 * i, 0.3 * i] if success else [0] * 6
        points = [*(100 + k for k in range(68)), *(50 + k for k in range(68))]
        rows.append([i + 1, 0, i / 25, 0.98, success, *pose, *points])
    path.write_text("\n".join(", ".join(map(str, r)) for r in [names, *rows]) + "\n")
    return path


def test_pose_landmarks_and_losses(tmp_path: Path) -> None:
    first, second, lost, missing = _track(_openface(tmp_path / "a.csv"), 4)
    assert [e.status for e in (first, second)] == [Status.INITIALIZED, Status.TRACKED]
    np.testing.assert_allclose(second.euler, [0.1, -0.2, 0.3], atol=1e-12)
    assert second.translation is not None
    np.testing.assert_allclose(second.translation * second.mm_per_unit, [10, 0, 630])
    assert second.landmarks is not None
    assert set(POINT_NAMES) <= set(second.landmarks.names)
    tip = second.landmarks.names.index("nose_tip")
    np.testing.assert_allclose(second.landmarks.image[tip], [130, 80])
    assert second.confidence == 0.98
    for e in (lost, missing):
        assert e.status is Status.LOST
        assert "no face" in e.reason


def test_a_track_of_mien_is_read_alike(tmp_path: Path) -> None:
    estimates = _track(_openface(tmp_path / "a.csv"), 3)
    Track.from_estimates(estimates).save(tmp_path / "mien.csv")
    again = _track(tmp_path / "mien.csv", 3)
    assert [e.status.success for e in again] == [True, True, False]
    np.testing.assert_allclose(again[1].euler, estimates[1].euler, atol=1e-6)


def test_by_name(tmp_path: Path) -> None:
    file = _openface(tmp_path / "a.csv")
    assert isinstance(create_tracker(f"openface:{file}"), OpenFaceTracker)
    with pytest.raises(MienError, match="openface:PATH"):
        create_tracker("openface")
    with pytest.raises(MienError, match="no such file"):
        create_tracker("openface:/no/such.csv")
