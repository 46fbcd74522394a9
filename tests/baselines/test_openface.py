"""OpenFace's CSV as a tracker's output."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mien.baselines.openface import OpenFaceTracker
from mien.errors import MienError, MienWarning
from mien.evaluation.points12 import POINT_NAMES
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Landmarks
from mien.output.track import Track
from mien.registry import create_tracker
from mien.tracking.state import Closing, Estimate, Status

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


def test_semicolons_are_read_as_commas(tmp_path: Path) -> None:
    spreadsheet = _openface(tmp_path / "a.csv").read_text().replace(", ", ";").replace(".", ",")
    (tmp_path / "b.csv").write_text(spreadsheet)
    for e, same in zip(_track(tmp_path / "a.csv", 2), _track(tmp_path / "b.csv", 2), strict=True):
        np.testing.assert_array_equal(e.rotation, same.rotation)
        assert e.confidence == same.confidence == 0.98


def test_it_says_that_it_has_not_begun(tmp_path: Path) -> None:
    with pytest.raises(MienError, match="call initialize first"):
        OpenFaceTracker(str(_openface(tmp_path / "a.csv"))).track(Frame(PIXELS, 0, 0.0))


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


def test_what_a_track_of_mien_says_of_the_eyes_is_kept(tmp_path: Path) -> None:
    first, second, third = _track(_openface(tmp_path / "a.csv"), 3)
    assert second.closing is None
    blink = [first, replace(second, closing=Closing(0.75, 0.125)), third]
    file = Track.from_estimates(blink).save(tmp_path / "mien.csv")[0]
    again = _track(file, 3)
    assert [e.closing for e in again] == [e.closing for e in blink] == [None, Closing(0.75, 0.125), None]
    assert again[1].expression[-1] == 0.75
    file.write_text(file.read_text().replace("eyes_closed_sd", "other"))  # as from a tracker that does not tell it
    without_sd = _track(file, 3)[1].closing
    assert without_sd is not None
    assert without_sd.share == 0.75
    assert np.isnan(without_sd.sd)


def test_by_name(tmp_path: Path) -> None:
    file = _openface(tmp_path / "a.csv")
    assert isinstance(create_tracker(f"openface:{file}"), OpenFaceTracker)
    with pytest.raises(MienError, match="openface:PATH"):
        create_tracker("openface")
    with pytest.raises(MienError, match="no such file"):
        create_tracker("openface:/no/such.csv")


@pytest.mark.parametrize(
    ("frames", "message"),
    [((1, 2, 2, 3), "two rows for one frame"), ((1, 1.04, 1.08), r"frame 1\.04 is no whole number")],
)
def test_frames_that_are_not_counted_once_each_are_refused(
    frames: tuple[float, ...], message: str, tmp_path: Path
) -> None:
    rows = "".join(f"{frame},0,0,0\n" for frame in frames)
    (tmp_path / "own.csv").write_text(f"frame,pose_Rx,pose_Ry,pose_Rz\n{rows}")
    with pytest.raises(MienError, match=message):
        OpenFaceTracker(str(tmp_path / "own.csv"))


def test_a_misspelt_column_of_the_pose_is_not_passed_over_silently(tmp_path: Path) -> None:
    file = tmp_path / "own.csv"
    names = [f"{axis}_{i}" for axis in "xy" for i in range(68)]
    file.write_text(",".join(["frame,pose_Rx,pose_ry,pose_Rz", *names]) + "\n1,0,0,0" + ",5" * 2 * 68 + "\n")
    with pytest.warns(MienWarning, match="only its landmarks are read, and no pose, as it lacks the column pose_Ry"):
        (first,) = _track(file, 1)
    assert first.rotation is None
    assert first.landmarks is not None


def test_landmarks_of_an_unknown_scheme_are_not_passed_over_silently(tmp_path: Path) -> None:
    file, count = tmp_path / "own.csv", 478
    names = [f"{axis}_{i}" for axis in "xy" for i in range(count)]
    file.write_text(",".join(["frame,pose_Rx,pose_Ry,pose_Rz", *names]) + "\n1,0,0,0" + ",5" * 2 * count + "\n")
    with pytest.warns(MienWarning, match="only its pose is read, and none of its 478 landmarks"):
        (first,) = _track(file, 1)
    assert first.rotation is not None
    assert first.landmarks is None


def test_a_place_that_is_missing_is_none(tmp_path: Path) -> None:
    names = "frame,pose_Tx,pose_Ty,pose_Tz,pose_Rx,pose_Ry,pose_Rz"
    (tmp_path / "own.csv").write_text(f"{names}\n1,1,2,630,0,0,0\n2,,,,0,0,0\n")
    first, second = _track(tmp_path / "own.csv", 2)
    assert first.translation is not None
    assert second.rotation is not None
    assert second.translation is None


@pytest.mark.parametrize("confidence", [97, -1])
def test_a_confidence_that_is_no_probability_is_refused(confidence: float, tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text(f"frame,confidence,pose_Rx,pose_Ry,pose_Rz\n1,{confidence},0,0,0\n")
    with pytest.raises(MienError, match=f"the confidence {confidence} is not between 0 and 1"):
        OpenFaceTracker(str(tmp_path / "own.csv"))


@pytest.mark.parametrize("rate", [12.5, 25.0, 30.0, np.inf])  # images have no times; some files then have zeros
@pytest.mark.parametrize("backwards", [False, True])  # as from the frame in which a face is learned to the first
def test_rows_of_another_frame_rate_are_warned_of(tmp_path: Path, rate: float, backwards: bool) -> None:
    rows = [f"{i + 1},{i / rate},1,0,0,0" for i in range(50)]
    (tmp_path / "other.csv").write_text("\n".join(["frame,timestamp,success,pose_Rx,pose_Ry,pose_Rz", *rows]))
    first, *later = [Frame(PIXELS, i, i / 25) for i in range(50)][:: -1 if backwards else 1]
    tracker = OpenFaceTracker(str(tmp_path / "other.csv"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tracker.initialize(first, FIRST, CAMERA)
        for frame in later:
            tracker.track(frame)
    assert len(caught) == (rate == 12.5)
