"""Landmarks from and to JSON, .pts and the CSV of OpenFace."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from mien.errors import MienError, MienWarning
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import SCHEMES, Landmarks
from small_motion import face

RNG = np.random.default_rng(2)
POINTS = np.round(RNG.uniform(50, 200, (68, 2)), 3)
IBUG = Landmarks(POINTS, "ibug68", None, 7, 0.28)


def openface(path: Path, rows: list[dict[str, object]], spaced: bool = True) -> Path:
    separator = ", " if spaced else ","
    names = list(rows[0])
    lines = [separator.join(names)] + [separator.join(str(r[n]) for n in names) for r in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def row(
    time: float, shift: float = 0.0, success: int = 1, confidence: float = 0.98, face: int = 0
) -> dict[str, object]:
    """A row of OpenFace whose landmarks are `POINTS`, shifted."""
    head: dict[str, object] = {"frame": round(time * 25) + 1, "face_id": face, "timestamp": time}
    head |= {"confidence": confidence, "success": success}
    return head | {f"{axis}_{i}": POINTS[i, k] + shift for k, axis in enumerate("xy") for i in range(68)}


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("deep", [False, True])
def test_json_reads_back_as_it_was(tmp_path: Path, scheme: str, deep: bool) -> None:
    count = {"candide26": 26, "ibug68": 68, "mediapipe478": 478, "mediapipe468": 468}[scheme]
    points, depths = np.round(RNG.uniform(0, 300, (count, 2)), 3), np.round(RNG.normal(0, 20, count), 3)
    written = Landmarks(points, scheme, depths if deep else None, 12, 0.48)
    write_landmarks(tmp_path / "l.json", written)
    read = read_landmarks(tmp_path / "l.json", index=3, time=9.0)
    np.testing.assert_array_equal(read.points, points)
    assert (read.depths is not None) == deep
    assert (read.scheme, read.frame_index, read.time) == (scheme, 12, 0.48)
    assert read.source == str(tmp_path / "l.json")


def test_json_of_an_editor_that_marks_its_encoding_is_read(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "marks.json", IBUG)
    (tmp_path / "marks.json").write_text((tmp_path / "marks.json").read_text(), encoding="utf-8-sig")
    np.testing.assert_array_equal(read_landmarks(tmp_path / "marks.json").points, IBUG.points)


def test_null_in_a_json_is_as_nothing(tmp_path: Path) -> None:
    unknown = {"frame": None, "time": None, "depths": None, "graphics": None}
    (tmp_path / "marks.json").write_text(json.dumps({"scheme": "ibug68", "points": POINTS.tolist()} | unknown))
    read = read_landmarks(tmp_path / "marks.json", index=3, time=9.0)
    assert (read.frame_index, read.time, read.depths, read.graphics) == (3, 9.0, None, None)


def test_json_has_a_point_on_each_line(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "l.json", IBUG)
    x, y = POINTS[0].tolist()
    assert f"  [{x}, {y}],\n" in (tmp_path / "l.json").read_text()


def test_json_of_a_track_holds_its_first_frames_landmarks(tmp_path: Path) -> None:
    (tmp_path / "out.json").write_text(json.dumps({"mien": "1", "landmarks": IBUG.to_dict()}))
    np.testing.assert_array_equal(read_landmarks(tmp_path / "out.json").points, POINTS)


def test_pts_counts_pixels_from_one(tmp_path: Path) -> None:
    lines = "\n".join(f"{x + 1} {y + 1}" for x, y in POINTS)
    (tmp_path / "l.pts").write_text(f"version: 1\nn_points:  68\n{{\n{lines}\n}}")
    read = read_landmarks(tmp_path / "l.pts", index=4, time=0.16)
    np.testing.assert_allclose(read.points, POINTS)
    assert (read.scheme, read.frame_index, read.time) == ("ibug68", 4, 0.16)


def test_pts_reads_back_as_it_was(tmp_path: Path) -> None:
    write_landmarks(tmp_path / "l.pts", IBUG)
    np.testing.assert_allclose(read_landmarks(tmp_path / "l.pts").points, POINTS, atol=1e-9)
    with pytest.raises(MienError, match=r"write a \.json"):
        write_landmarks(tmp_path / "m.pts", Landmarks(np.ones((26, 2)), "candide26"))


@pytest.mark.parametrize("spaced", [False, True])
def test_csv_takes_the_row_that_is_nearest_in_time(tmp_path: Path, spaced: bool) -> None:
    path = openface(tmp_path / "l.csv", [row(0.0), row(0.04, 1.0), row(0.08, 2.0)], spaced)
    np.testing.assert_allclose(read_landmarks(path).points, POINTS)
    read = read_landmarks(path, index=1, time=0.043)
    np.testing.assert_allclose(read.points, POINTS + 1)
    assert (read.scheme, read.time) == ("ibug68", 0.04)


@pytest.mark.parametrize("point", [".", ","])
def test_csv_with_semicolons_is_read(tmp_path: Path, point: str) -> None:
    text = openface(tmp_path / "l.csv", [row(0.0), row(0.04, 1.0)], spaced=False).read_text()
    spreadsheet = text.replace(",", ";").replace(".", point).replace("\n", "\r\n")
    (tmp_path / "l.csv").write_bytes(spreadsheet.encode("utf-8-sig"))
    np.testing.assert_allclose(read_landmarks(tmp_path / "l.csv", index=1, time=0.04).points, POINTS + 1)


def test_csv_of_several_faces_gives_the_surest(tmp_path: Path) -> None:
    path = openface(tmp_path / "l.csv", [row(0.0, 5.0, confidence=0.6), row(0.0, 1.0, face=1), row(0.04, 2.0)])
    np.testing.assert_allclose(read_landmarks(path).points, POINTS + 1)


def test_csv_that_pandas_or_r_have_saved_is_read(tmp_path: Path) -> None:
    """Truth values are then words, and what is missing NA."""
    lost = row(0.04, 9.0) | {"success": "FALSE", "x_0": "NA", "confidence": "NA"}
    rows = [row(0.0, 2.0) | {"success": "True"}, lost, row(0.08) | {"timestamp": ""}]
    path = openface(tmp_path / "l.csv", rows)
    np.testing.assert_allclose(read_landmarks(path).points, POINTS + 2)
    with pytest.raises(MienError, match=r"no face at 0\.04 s"):
        read_landmarks(path, time=0.04)


def test_csv_may_have_columns_of_ones_own(tmp_path: Path) -> None:
    path = openface(tmp_path / "l.csv", [row(0.0, 2.0) | {"x_offset": 5}])
    np.testing.assert_allclose(read_landmarks(path).points, POINTS + 2)


def test_csv_without_times_goes_by_the_row(tmp_path: Path) -> None:
    rows = [{k: v for k, v in row(0.0, s).items() if k != "timestamp"} for s in (0.0, 3.0)]
    path = openface(tmp_path / "l.csv", rows)
    np.testing.assert_allclose(read_landmarks(path, index=1, time=99.0).points, POINTS + 3)
    with pytest.raises(MienError, match="2 rows and tracking begins at frame 2"):
        read_landmarks(path, index=2)


def test_csv_refuses_a_row_without_a_face_and_times_elsewhere(tmp_path: Path) -> None:
    path = openface(tmp_path / "l.csv", [row(0.0, success=0), row(0.04)])
    with pytest.raises(MienError, match=r"no face at 0\.00 s"):
        read_landmarks(path)
    with pytest.raises(MienError, match=r"no row near 3\.00 s"):
        read_landmarks(path, time=3.0)


def _json(**changes: object) -> str:
    return json.dumps(IBUG.to_dict() | changes)


BROKEN = {
    "broken.json": ("{", "not valid JSON"),
    "list.json": ("[1, 2]", "needs `scheme` and `points`"),
    "lacking.json": ('{"scheme": "ibug68"}', "needs `scheme` and `points`"),
    "ragged.json": (_json(points=[[1, 2], [3]]), "needs `scheme` and `points`"),
    "words.json": (_json(points=[["a", "b"]] * 68), "needs `scheme` and `points`"),
    "count.json": (_json(points=POINTS[:60].tolist()), "ibug68 needs 68 points"),
    "scheme.json": (_json(scheme="ibug51"), "unknown scheme 'ibug51'"),
    "schemes.json": (_json(scheme=["ibug68"]), "unknown scheme"),
    "nan.json": (_json(points=[[float("nan"), 1.0]] * 68), "not a finite number"),
    "null.json": (_json(points=[[None, 1.0]] * 68), "not a finite number"),
    "depths.json": (_json(depths=[1.0, 2.0]), "`depths` must have one finite number per point"),
    "open.pts": ("version: 1\nn_points: 68\n1 2\n", "no points between braces"),
    "endless.json": (_json(frame=float("inf")), "needs `scheme` and `points`"),
    "bare.pts": ("n_points 68\n{\n" + "1 2\n" * 60 + "}", "states 68 points and holds 60"),
    "count.pts": ("n_points: 68\n{\n" + "1 2\n" * 60 + "}", "states 68 points and holds 60"),
    "few.pts": ("{\n" + "1 2\n" * 60 + "}", "ibug68 needs 68 points"),
    "odd.pts": ("{\n" + "1 2\n" * 67 + "1\n}", "lacks a coordinate"),
    "words.pts": ("{\n" + "one two\n" * 68 + "}", "not a number"),
    "nan.pts": ("{\n" + "nan 2\n" * 68 + "}", "not a finite number"),
    "empty.csv": ("", "holds no row"),
    "other.csv": ("a,b\n1,2\n", "has 0 landmark columns"),
    "words.csv": ("timestamp,x_0\nsoon,2\n", "not a number"),
    "binary.json": (b"\xff\xfe\x00\x81".decode("latin-1"), "not a text file"),
    "x.txt": ("1 2", r"read from \.json, \.pts, \.csv"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_named_with_its_fault(tmp_path: Path, name: str) -> None:
    content, fault = BROKEN[name]
    (tmp_path / name).write_text(content, encoding="latin-1" if name == "binary.json" else "utf-8")
    with pytest.raises(MienError, match=fault) as caught:
        read_landmarks(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize("name", ["x.json", "x.pts", "x.csv"])
def test_a_file_that_the_system_refuses_to_read_is_named(tmp_path: Path, name: str) -> None:
    refused = Path("/proc/self/mem")
    if not refused.is_file():
        pytest.skip("there is no such file here")
    (tmp_path / name).symlink_to(refused)
    with pytest.raises(MienError, match=f"{name} cannot be read .*; check the file"):
        read_landmarks(tmp_path / name)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"none\.json: no such file"):
        read_landmarks(tmp_path / "none.json")


def test_csv_that_lacks_a_column(tmp_path: Path) -> None:
    path = openface(tmp_path / "l.csv", [{k: v for k, v in row(0.0).items() if k != "y_33"}])
    with pytest.raises(MienError, match="lacks the column y_33"):
        read_landmarks(path)


def test_json_of_a_video_of_another_size_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    content = {"video": {"width": 240, "height": 240}, "landmarks": face().landmarks.to_dict()}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.warns(MienWarning, match="of a video of 240x240 pixels, and this one has 480x360"):
        read_landmarks(path, size=(480, 360))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_landmarks(path, size=(240, 240))


def test_json_of_another_frame_needs_its_time(tmp_path: Path) -> None:
    path = tmp_path / "marks.json"
    values = face().landmarks.to_dict() | {"frame": 60}
    del values["time"]
    path.write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(MienError, match=r"marks\.json states no time of its frame 60; add `time`, in seconds$"):
        read_landmarks(path)
    assert read_landmarks(path, 60, 2.0).time == 2.0
