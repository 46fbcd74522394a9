"""A tiny data set in each layout, read by its reader, and what the readers refuse."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from evaluation import tiny
from evaluation.tiny import FRAMES, angles_deg, face68, head_rotations
from mien.arrays import Array
from mien.errors import MienError, MienWarning
from mien.evaluation.datasets import buft, load_dataset
from mien.evaluation.datasets.sequence import Truth
from mien.evaluation.datasets.talking_face import FGNET_POINTS
from mien.evaluation.points12 import points_of_scheme
from mien.evaluation.pose_csv import read_pose_csv
from mien.evaluation.protocols import Protocol, compare, truth_rotations
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING


def _truth(dataset: str, root: Path, frames: int = FRAMES) -> Truth:
    return load_dataset(dataset, root)[0].read_truth(frames)


# BUFT


@pytest.mark.parametrize("columns", [6, 7])
def test_buft_reads_six_and_seven_columns(tmp_path: Path, columns: int) -> None:
    tiny.buft(tmp_path)
    tiny.write_dat(tmp_path / "jam1.dat", angles_deg(), columns)
    (sequence,) = load_dataset("buft", tmp_path)
    assert (sequence.name, sequence.kind) == ("jam1", "uniform-light")
    np.testing.assert_allclose(sequence.read_truth(FRAMES).angles_deg, angles_deg(), atol=1e-6)
    assert sequence.camera_for(320, 240) == Camera(500, 159.5, 119.5)
    assert sequence.with_focal(320).camera_for(320, 240).focal_px == 320


def test_buft_as_editors_of_windows_write_it(tmp_path: Path) -> None:
    dat = tiny.buft(tmp_path) / "jam1.dat"
    dat.write_text(dat.read_text(), encoding="utf-8-sig", newline="\r\n")
    np.testing.assert_allclose(_truth("buft", tmp_path).angles_deg, angles_deg(), atol=1e-6)


def test_buft_drops_the_first_row_also_where_there_are_as_many_as_frames(tmp_path: Path) -> None:
    truth = _truth("buft", tiny.buft(tmp_path), FRAMES + 1)
    assert truth.angles_deg is not None
    assert np.isnan(truth.angles_deg[0]).all()
    np.testing.assert_allclose(truth.angles_deg[1:], angles_deg(), atol=1e-6)


@pytest.mark.parametrize("frames", [FRAMES - 1, FRAMES + 2])
def test_buft_refuses_any_other_length(tmp_path: Path, frames: int) -> None:
    (sequence,) = load_dataset("buft", tiny.buft(tmp_path))
    with pytest.raises(MienError, match=f"has 7 rows and its video {frames} frames"):
        sequence.read_truth(frames)


def test_buft_finds_tables_in_a_folder_of_their_own_and_both_lights(tmp_path: Path) -> None:
    tiny.buft(tmp_path / "uniform-light", ("jam1", "vam9"))
    tiny.buft(tmp_path / "varying-light", ("llm2",))
    tables = tmp_path / "truth" / "uniform-light"
    tables.mkdir(parents=True)
    (tmp_path / "uniform-light" / "jam1.dat").rename(tables / "jam1.dat")
    found = load_dataset("buft", tmp_path)
    kinds = {s.name: s.kind for s in found}
    assert kinds == {"jam1": "uniform-light", "vam9": "uniform-light", "llm2": "varying-light"}
    assert found[0].truth_files == (tables / "jam1.dat",)
    assert len(buft.missing(("jam1", "vam9"))) == 43
    assert len(buft.COMPLETE) == 45


def test_of_two_tables_of_buft_that_of_the_same_light_is_read(tmp_path: Path) -> None:
    tiny.buft(tmp_path / "vary")
    tables = [tmp_path / "truth" / light / "jam1.dat" for light in ("uniform", "vary")]
    for table in tables:
        table.parent.mkdir(parents=True)
        table.write_bytes((tmp_path / "vary" / "jam1.dat").read_bytes())
    (tmp_path / "vary" / "jam1.dat").unlink()
    (found,) = load_dataset("buft", tmp_path)
    assert found.truth_files == (tables[1],)
    (tmp_path / "truth" / "vary" / "old").mkdir()
    tables[1].rename(tmp_path / "truth" / "vary" / "old" / "jam1.dat")
    tables[1].write_text("1 2 3 4 5 6\n")
    with pytest.raises(MienError, match=r"jam1\.avi has several tables, .*vary.jam1\.dat, .*old.jam1\.dat; keep one"):
        load_dataset("buft", tmp_path)


def test_the_rule_of_buft_is_that_of_rebased() -> None:
    """The `.dat` of a rendered sequence gives back the rotations that it was written from."""
    angles = np.array([[0.0, 0, 0], [10, -20, 30], [-5, 40, -15]])
    exact = Truth(3, rotations=FACING @ head_rotations(angles))
    from_angles = truth_rotations(Protocol.REBASED, Truth(3, angles_deg=angles))
    c = compare(Protocol.REBASED, exact, from_angles)
    np.testing.assert_allclose(c.error_deg, 0, atol=1e-9)


def test_buft_refuses_what_it_cannot_read(tmp_path: Path) -> None:
    with pytest.raises(MienError, match="contains no sequence of BUFT"):
        load_dataset("buft", tmp_path)
    tiny.buft(tmp_path)
    dat = tmp_path / "jam1.dat"
    dat.write_text("1 2 3\n4 5 6\n")
    with pytest.raises(MienError, match="2 rows of 3 columns"):
        _truth("buft", tmp_path)
    dat.write_text("1 2 3 4 5 six\n")
    with pytest.raises(MienError, match="not a table of numbers"):
        _truth("buft", tmp_path)
    tiny.write_dat(dat, np.where(np.arange(18).reshape(6, 3) == 4, np.nan, 1.0))
    with pytest.raises(MienError, match=r"jam1\.dat: the truth in row 2 is not a finite number"):
        _truth("buft", tmp_path)
    tiny.buft(tmp_path / "again")
    with pytest.raises(MienError, match="more than one sequence named jam1"):
        load_dataset("buft", tmp_path)


# Rendered


def test_rendered_reads_the_exact_truth(tmp_path: Path) -> None:
    (sequence,) = load_dataset("rendered", tiny.rendered(tmp_path, ("b_wide12",), angles_deg()))
    assert (sequence.name, sequence.kind) == ("b_wide12", "wide")
    assert sequence.camera_for(320, 240) == Camera(500, 160, 120)
    truth = sequence.read_truth(FRAMES)
    np.testing.assert_allclose(truth.rotations, FACING @ head_rotations(angles_deg()))
    assert truth.expression_names == ("jawOpen", "browDown_L")
    # The pictures lie a quarter of a pixel to the left of the points, and above.
    points = np.load(tmp_path / "b_wide12_truth.npz")["landmarks68"][0]
    np.testing.assert_allclose(truth.first_landmarks("x").points, points - 0.25)


def test_rendered_reads_the_focal_length(tmp_path: Path) -> None:
    exact = tiny.rendered(tmp_path) / "a_uniform1_truth.npz"
    R = head_rotations(angles_deg())
    np.savez(exact, R=R, focal=800.0)
    (sequence,) = load_dataset("rendered", tmp_path)
    assert sequence.camera_for(320, 240) == Camera(800, 160, 120)
    assert sequence.with_focal(600.0).camera_for(320, 240) == Camera(600, 160, 120)
    for none in (-3.0, np.nan, "long", [500.0, 500.0]):
        np.savez(exact, R=R, focal=none)
        with pytest.raises(MienError, match="focal is no focal length in pixels"):
            _truth("rendered", tmp_path)


@pytest.mark.parametrize("focal", [[500.0, 510.0], []])
def test_a_truth_file_with_another_number_of_focal_lengths_than_one_is_told(focal: list[float], tmp_path: Path) -> None:
    exact = tiny.rendered(tmp_path) / "a_uniform1_truth.npz"
    np.savez(exact, R=head_rotations(angles_deg()), focal=focal)
    with pytest.raises(MienError) as told:
        _truth("rendered", tmp_path)
    assert str(told.value) == (
        f"{exact}: focal is no focal length in pixels, but {len(focal)} values; write one number, that of all frames"
    )


def test_rendered_without_exact_truth_reads_the_dat(tmp_path: Path) -> None:
    tiny.rendered(tmp_path)
    (tmp_path / "a_uniform1_truth.npz").unlink()
    tiny.write_dat(tmp_path / "a_uniform1.dat", angles_deg())
    np.testing.assert_allclose(_truth("rendered", tmp_path).angles_deg, angles_deg(), atol=1e-6)


def test_rendered_refuses_what_it_cannot_read(tmp_path: Path) -> None:
    with pytest.raises(MienError, match="contains no rendered sequence"):
        load_dataset("rendered", tmp_path)
    tiny.rendered(tmp_path)
    with pytest.raises(MienError, match="describes 6 frames and its video has 5"):
        _truth("rendered", tmp_path, 5)
    exact = tmp_path / "a_uniform1_truth.npz"
    R = head_rotations(angles_deg())
    R[3, 0, 0] = np.nan
    np.savez(exact, R=R)
    with pytest.raises(MienError, match="the rotation in row 3 is not a finite number"):
        _truth("rendered", tmp_path)
    np.savez(exact, Q=R)
    with pytest.raises(MienError, match="no rotations R"):
        _truth("rendered", tmp_path)
    R = head_rotations(angles_deg())
    for more, words in (
        ({"landmarks68": np.zeros((FRAMES, 136))}, "landmarks68 of each frame must have the shape"),
        ({"expression": np.zeros((FRAMES, 2))}, "expression of each frame must have the shape"),
        ({"landmarks68": np.array(0.0)}, "landmarks68 of each frame must have the shape"),
        ({"expression": np.zeros((FRAMES, 2)), "expression_names": "jawOpen"}, "expression of each frame must have"),
        ({"expression": np.full((FRAMES, 1), "wide"), "expression_names": ["jawOpen"]}, "expression holds no numbers"),
        ({"R": 0 * R}, "R of frame 0 is no rotation"),
    ):
        np.savez(exact, **({"R": R} | more))
        with pytest.raises(MienError, match=words):
            _truth("rendered", tmp_path)
    with exact.open("wb") as file:
        np.save(file, R)
    with pytest.raises(MienError, match="not a readable npz file"):
        _truth("rendered", tmp_path)
    for broken in ("no archive", ""):
        exact.write_text(broken)
        with pytest.raises(MienError, match="not a readable npz file"):
            _truth("rendered", tmp_path)


def test_sequences_have_names_of_their_own(tmp_path: Path) -> None:
    tiny.rendered(tmp_path)
    (tmp_path / "a_uniform1.MKV").write_bytes(b"")
    with pytest.raises(MienError, match="more than one sequence named a_uniform1"):
        load_dataset("rendered", tmp_path)


# Talking Face


def _fgnet_points() -> Array:
    """68 points with a pupil amid the four points of each eye."""
    points = face68()
    points[27:31] = [[20, 15], [23, 13], [26, 15], [23, 17]]
    points[32:36] = [[44, 15], [41, 13], [38, 15], [41, 17]]
    points[31], points[36] = points[27:31].mean(axis=0), points[32:36].mean(axis=0)
    return points


def test_talking_face_of_ibug_in_plain_lines_counts_pixels_from_zero(tmp_path: Path) -> None:
    plain = "\n".join(f"{x:.4f} {y:.4f}" for x, y in face68())
    for mark_of_windows in ("", "\ufeff"):
        truth = _truth("talking-face", tiny.talking_face(tmp_path, face68(), mark_of_windows + plain, (0, 3)))
        assert truth.landmarks is not None
        np.testing.assert_allclose(truth.landmarks[3], face68(), atol=1e-4)


@pytest.mark.parametrize("as_video", [False, True])
def test_talking_face_of_ibug(tmp_path: Path, as_video: bool) -> None:
    tiny.talking_face(tmp_path, face68(), tiny.pts(face68()), (0, 2, 5), as_video)
    (sequence,) = load_dataset("talking-face", tmp_path)
    truth = sequence.read_truth(FRAMES)
    assert truth.landmarks is not None
    np.testing.assert_array_equal(np.isfinite(truth.landmarks).all(axis=(1, 2)), np.isin(range(6), (0, 2, 5)))
    np.testing.assert_allclose(truth.landmarks[2], face68(), atol=1e-3)
    np.testing.assert_allclose(truth.first_landmarks("x").points, face68(), atol=1e-3)


@pytest.mark.parametrize("braces", [False, True])
def test_talking_face_of_fgnet(tmp_path: Path, braces: bool) -> None:
    points = _fgnet_points()
    plain = "\n".join(f"{x} {y}" for x, y in points)
    tiny.talking_face(tmp_path, points, tiny.pts(points, origin=0.0) if braces else plain, (0, 1))
    truth = _truth("talking-face", tmp_path)
    assert truth.landmarks is not None
    twelve = points_of_scheme(truth.landmarks, truth.landmark_scheme)
    np.testing.assert_allclose(twelve[1], points[list(FGNET_POINTS)], atol=1e-3)
    with pytest.raises(MienError, match="use detected landmarks"):
        truth.first_landmarks("x")


def test_talking_face_refuses_what_it_cannot_read(tmp_path: Path) -> None:
    with pytest.raises(MienError, match="contains no point file"):
        load_dataset("talking-face", tmp_path)
    tiny.talking_face(tmp_path, face68(), tiny.pts(face68()), (0, 3))
    with pytest.raises(MienError, match="belongs to frame 3 and the video has 2"):
        _truth("talking-face", tmp_path, 2)
    (tmp_path / "franck_00003.pts").write_text("1 2\n" * 68)
    with pytest.raises(MienError, match="another format than the first"):
        _truth("talking-face", tmp_path)
    (tmp_path / "franck_00003.pts").write_text(tiny.pts(face68()[:60]))
    with pytest.raises(MienError, match="needs 68 points"):
        _truth("talking-face", tmp_path)


@pytest.mark.parametrize(("as_video", "other"), [(False, "old/franck_00002.pts"), (True, "franck_2.pts")])
def test_talking_face_refuses_two_annotations_of_one_frame(as_video: bool, other: str, tmp_path: Path) -> None:
    tiny.talking_face(tmp_path, face68(), tiny.pts(face68()), (0, 2), as_video)
    assert len(load_dataset("talking-face", tmp_path)) == 1
    (tmp_path / other).parent.mkdir(exist_ok=True)
    (tmp_path / other).write_text(tiny.pts(face68() + 7))
    with pytest.raises(MienError, match=rf"{other}.* belong to the same frame; keep one of them"):
        load_dataset("talking-face", tmp_path)


def test_talking_face_tells_of_points_without_an_image(tmp_path: Path) -> None:
    """As of images in another folder, of which nothing is tracked."""
    tiny.talking_face(tmp_path, face68(), tiny.pts(face68()), (0, 2))
    tiny.talking_face(tmp_path / "more", face68(), tiny.pts(face68()), (1,))
    (tmp_path / "more" / "franck_00001.pts").rename(tmp_path / "more" / "franck_00009.pts")
    with pytest.warns(MienWarning, match=r"no image for 1 of the 3 point files, such as .*franck_00009\.pts"):
        load_dataset("talking-face", tmp_path)


# Annotated video


def _annotate(root: Path, header: str, rows: list[str]) -> Path:
    root.mkdir(exist_ok=True)
    tiny.video(root / "mine.mkv")
    (root / "mine.csv").write_text("\n".join([header, *rows]) + "\n")
    return root


@pytest.mark.parametrize("first", [0, 1])
def test_a_video_with_poses_counts_frames_from_zero_or_as_openface_from_one(tmp_path: Path, first: int) -> None:
    rows = [f"{i + first}, 1, 0.{i}, 0, 0" for i in range(FRAMES)]
    truth = _truth("video", _annotate(tmp_path, "frame, success, pose_Rx, pose_Ry, pose_Rz", rows))
    c = compare(Protocol.REBASED, truth, np.tile(FACING, (FRAMES, 1, 1)))
    np.testing.assert_allclose(c.truth_deg[:, 0], np.degrees(0.1 * np.arange(FRAMES)), atol=1e-9)


@pytest.mark.parametrize("first", [0, 1])
def test_the_time_says_from_where_some_frames_are_counted(tmp_path: Path, first: int) -> None:
    rows = [f"{i + first},{i / 25 + 0.001},{i / 10},0,0" for i in (2, 4)]
    truth = _truth("video", _annotate(tmp_path, "frame,timestamp,pose_Rx,pose_Ry,pose_Rz", rows))
    assert truth.rotations is not None
    np.testing.assert_array_equal(np.isfinite(truth.rotations).all(axis=(1, 2)), np.isin(range(FRAMES), (2, 4)))


def test_times_far_from_the_first_frame_say_nothing_of_it(tmp_path: Path) -> None:
    """As times are rounded to milliseconds, a line through ten of them misses the first frame."""
    for start in (300, 1000, 3000):
        rows = [f"{k},{k / 29.97:.3f},0,0,0" for k in range(start, start + 10)]
        (tmp_path / "some.csv").write_text("\n".join(["frame,timestamp,pose_Rx,pose_Ry,pose_Rz", *rows]))
        assert read_pose_csv(tmp_path / "some.csv").first is None


@pytest.mark.parametrize("begin", [1.7e9, 1.7e12, 1.7e18])
@pytest.mark.parametrize("rows", [2, 5, 50])
def test_times_since_1970_do_not_say_which_frame_is_the_first(begin: float, rows: int, tmp_path: Path) -> None:
    """As loggers write them, in seconds, milliseconds or nanoseconds: no line through them is known at time zero."""
    step = 0.04 * {1.7e9: 1, 1.7e12: 1e3, 1.7e18: 1e9}[begin]
    lines = [f"{i + 1},{begin + step * i:.6f},0,0,0" for i in range(rows)]
    (tmp_path / "logged.csv").write_text("\n".join(["frame,timestamp,pose_Rx,pose_Ry,pose_Rz", *lines]))
    table = read_pose_csv(tmp_path / "logged.csv")
    assert table.first is None
    assert table.rate == pytest.approx(1 / step, rel=1e-4)


@pytest.mark.parametrize(("rows", "first"), [(slice(None), 1), (slice(10, None), None)])
def test_uneven_times_say_it_by_the_row_of_time_zero_alone(tmp_path: Path, rows: slice, first: int | None) -> None:
    """Of a camera that drops three frames: the line through all others passes a whole frame beside the first."""
    steps = np.ones(199)
    steps[[17, 33, 91]] = 2
    times = np.cumsum(steps) - 1
    texts = [f"{k + 1},{time / 30:.3f},0,0,0" for k, time in enumerate(times)]
    (tmp_path / "some.csv").write_text("\n".join(["frame,timestamp,pose_Rx,pose_Ry,pose_Rz", *texts[rows]]))
    assert read_pose_csv(tmp_path / "some.csv").first == first


def test_frames_that_may_be_counted_from_zero_or_one_are_warned_of(tmp_path: Path) -> None:
    root = _annotate(tmp_path, "frame,pose_Rx,pose_Ry,pose_Rz", [f"{i},0,0,0" for i in (1, 3)])
    with pytest.warns(MienWarning, match=r"mine\.csv has no row of the frame 0"):
        truth = _truth("video", root)
    assert truth.rotations is not None
    np.testing.assert_array_equal(np.isfinite(truth.rotations).all(axis=(1, 2)), np.isin(range(FRAMES), (1, 3)))


@pytest.mark.parametrize("rate", [12.5, 25.0, 50.0])
def test_truth_of_another_frame_rate_is_warned_of(tmp_path: Path, rate: float) -> None:
    rows = [f"{i},{i / rate},0,0,0" for i in range(FRAMES)]
    root = _annotate(tmp_path, "frame,timestamp,pose_Rx,pose_Ry,pose_Rz", rows)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        _truth("video", root)
    told = [str(warning.message) for warning in caught]
    assert told == [] if rate == 25 else f"has {rate:g} frames a second by its timestamps" in told[0]


def test_a_track_of_mien_as_truth_is_warned_of(tmp_path: Path) -> None:
    rows = [f"{i},{i / 25},1,1,tracked,0,0,0" for i in range(FRAMES)]
    root = _annotate(tmp_path, "frame,timestamp,confidence,success,status,pose_Rx,pose_Ry,pose_Rz", rows)
    with pytest.warns(MienWarning, match=r"mine\.csv is a track of mien's own"):
        _truth("video", root)


def test_other_files_beside_an_annotated_video_are_no_videos(tmp_path: Path) -> None:
    """A folder of images may have a dot in its name."""
    root = _annotate(tmp_path, "frame,pose_Rx,pose_Ry,pose_Rz", [f"{i},0,0,0" for i in range(FRAMES)])
    for name in ("mine.wav", "mine.xlsx", "mine.pts"):
        (root / name).write_bytes(b"0")
    (root / "subject.01").mkdir()
    cv2.imwrite(str(root / "subject.01" / "0.png"), np.zeros((48, 64, 3), np.uint8))
    (root / "subject.01.csv").write_text("frame,pose_Rx,pose_Ry,pose_Rz\n0,0,0,0\n")
    assert [sequence.name for sequence in load_dataset("video", root)] == ["mine", "subject.01"]
    assert [sequence.name for sequence in load_dataset("video", root / "subject.01")] == ["subject.01"]


def test_a_video_with_some_frames_annotated(tmp_path: Path) -> None:
    header = "frame," + ",".join(f"x_{i},y_{i}" for i in range(68))
    values = ",".join(f"{x},{y}" for x, y in face68())
    root = _annotate(tmp_path, header, [f"0,{values}", f"4,{values}"])
    truth = _truth("video", root / "mine.mkv")
    assert truth.landmarks is not None
    assert not truth.has_pose
    np.testing.assert_array_equal(np.isfinite(truth.landmarks).all(axis=(1, 2)), np.isin(range(6), (0, 4)))
    np.testing.assert_allclose(truth.landmarks[4], face68())


def test_a_video_without_numbers_of_frames_needs_a_row_for_each(tmp_path: Path) -> None:
    header, row = "pose_Rx,pose_Ry,pose_Rz", "0,0,0"
    assert _truth("video", _annotate(tmp_path, header, [row] * FRAMES)).frames == FRAMES
    with pytest.raises(MienError, match="describes 5 frames and its video has 6"):
        _truth("video", _annotate(tmp_path, header, [row] * 5))


def test_annotations_that_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MienError, match="contains no annotated video"):
        load_dataset("video", tmp_path)
    header = "frame,success,pose_Rx,pose_Ry,pose_Rz"
    for rows, message in (
        (["0,1,0,0,"], "the pose in row 1 is not a finite number"),
        (["0,1,0,0,nan"], "the pose in row 1 is not a finite number"),
        (["0,1,0,0,x"], "a cell is not a number"),
        (["9,1,0,0,0"], "frames up to 9"),
        (["0,1,0,0,0", "1,1,12,0,0"], "an angle is 12, more than a full turn; .* are in radians"),
        (["2,1,0,0,0", "2,1,0,0,0"], "two rows for one frame"),
        ([], "has no rows"),
    ):
        with pytest.raises(MienError, match=message):
            _truth("video", _annotate(tmp_path, header, rows))
    with pytest.raises(MienError, match="neither the columns"):
        _truth("video", _annotate(tmp_path, "frame,tilt", ["0,1"]))


@pytest.mark.parametrize(("first", "last"), [(-1, 4), (0, 8)])
def test_rows_of_frames_that_the_video_does_not_have_are_refused(first: int, last: int, tmp_path: Path) -> None:
    rows = [f"{i},0,0,0" for i in range(first, last + 1)]
    root = _annotate(tmp_path, "frame,pose_Rx,pose_Ry,pose_Rz", rows)
    with pytest.raises(MienError, match=f"describes frames up to {last}, from {first} on, and its video has 6;"):
        _truth("video", root)


def test_a_row_without_success_is_no_truth_also_with_a_pose(tmp_path: Path) -> None:
    rows = [f"{i},{int(i != 2)},0.1,0,0" for i in range(FRAMES)]
    truth = _truth("video", _annotate(tmp_path, "frame,success,pose_Rx,pose_Ry,pose_Rz", rows))
    np.testing.assert_array_equal(truth.known, np.arange(FRAMES) != 2)


def test_a_row_without_success_is_no_truth(tmp_path: Path) -> None:
    rows = ["0,1,0,0,0", "1,0,,,", "2,0,-999,inf,0", "3,False,,,", "4,FALSE,NA,NA,NA", "5,True,0,0,0"]
    root = _annotate(tmp_path, "frame,success,pose_Rx,pose_Ry,pose_Rz", rows)
    truth = _truth("video", root)
    assert truth.rotations is not None
    np.testing.assert_array_equal(np.isfinite(truth.rotations[:, 0, 0]), np.isin(np.arange(FRAMES), [0, 5]))


def test_rows_of_separators_as_spreadsheets_leave_them_are_none(tmp_path: Path) -> None:
    rows = ["0,0,0.1,0,0", ",,,,", "1,0,0.2,0,0", ",,,,", ",,,,"]
    truth = _truth("video", _annotate(tmp_path, "frame,face_id,pose_Rx,pose_Ry,pose_Rz", rows))
    np.testing.assert_array_equal(truth.known, np.arange(FRAMES) < 2)


def test_a_table_in_another_encoding_says_which_is_read(tmp_path: Path) -> None:
    root = _annotate(tmp_path, "frame,pose_Rx,pose_Ry,pose_Rz", ["0,0,0,0"])
    (root / "mine.csv").write_text("frame,pose_Rx,pose_Ry,pose_Rz\n0,0,0,0\n", encoding="utf-16")
    with pytest.raises(MienError, match=r"mine\.csv is not a readable CSV .*; save it again, as UTF-8"):
        _truth("video", root)


def test_a_table_that_the_system_refuses_to_read_is_named(tmp_path: Path) -> None:
    refused = Path("/proc/self/mem")
    if not refused.is_file():
        pytest.skip("there is no such file here")
    (tmp_path / "x.csv").symlink_to(refused)
    with pytest.raises(MienError, match=r"x\.csv cannot be read .*; check the file"):
        read_pose_csv(tmp_path / "x.csv")


def test_the_first_face_of_several_is_read(tmp_path: Path) -> None:
    file = tmp_path / "two.csv"
    file.write_text("frame,face_id,pose_Rx,pose_Ry,pose_Rz\n1,0,0.1,0,0\n1,1,0.2,0,0\n2,0,0.3,0,0\n")
    with pytest.warns(MienWarning, match=r"two\.csv has several faces, .* face_id 0"):
        table = read_pose_csv(file)
    np.testing.assert_array_equal(table.index, [0, 1])


TRUE_R = FACING @ head_rotations(angles_deg())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rotations": TRUE_R[:-1]}, r"must be an array \(6, 3, 3\), but there is one \(5, 3, 3\)"),
        ({"rotations": TRUE_R.tolist()}, "but there is list"),
        ({"rotations": 2 * TRUE_R}, "the true rotation of frame 0 is no rotation matrix"),
        ({"rotations": TRUE_R * [1, 1, -1]}, "is no rotation matrix"),
        ({"angles_deg": np.zeros((FRAMES, 4))}, "the angles_deg of the truth"),
        ({"landmarks": np.zeros((FRAMES, 49, 2))}, "the landmarks of the truth"),
        ({"landmarks": np.zeros((FRAMES, 68, 2)), "landmark_scheme": "own"}, "unknown scheme, 'own'"),
        ({"expression": np.zeros((FRAMES, 2)), "expression_names": ("jawOpen",)}, "the expression of the truth"),
    ],
)
def test_truth_of_a_reader_of_ones_own_that_is_not_as_it_must_be(given: dict[str, Any], message: str) -> None:
    with pytest.raises(MienError, match=message):
        Truth(FRAMES, **given)


def test_true_rotations_may_have_few_digits_and_gaps() -> None:
    rounded = np.round(TRUE_R, 2)
    rounded[1] = np.nan
    assert Truth(FRAMES, rotations=rounded).known.sum() == FRAMES - 1


@pytest.mark.parametrize("dataset", ["buft", "rendered", "video"])
def test_videos_without_their_truth_are_warned_of(dataset: str, tmp_path: Path) -> None:
    poses = [f"{i},0,0,0" for i in range(FRAMES)]
    make = {
        "buft": tiny.buft,
        "rendered": tiny.rendered,
        "video": lambda root: _annotate(root, "frame,pose_Rx,pose_Ry,pose_Rz", poses),
    }
    root = make[dataset](tmp_path)
    for name in ("c_uniform1.avi", "d_uniform1.mkv"):
        tiny.video(root / name)
    with pytest.warns(MienWarning, match=r"has no truth for c_uniform1\.avi, d_uniform1\.mkv, without which") as told:
        found = load_dataset(dataset, root)
    assert (len(found), len(told)) == (1, 1)


def test_a_folder_of_images_without_its_truth_is_warned_of(tmp_path: Path) -> None:
    """Not one of other files."""
    root = _annotate(tmp_path, "frame,pose_Rx,pose_Ry,pose_Rz", [f"{i},0,0,0" for i in range(FRAMES)])
    for name, file in (("taken", "0.png"), ("figures", "a.svg")):
        (root / name).mkdir()
        (root / name / file).touch()
    with pytest.warns(
        MienWarning, match="has no truth for taken, without which a video is left out; it needs a CSV"
    ) as told:
        load_dataset("video", root)
    assert len(told) == 1


# Names


def test_unknown_names_and_folders(tmp_path: Path) -> None:
    with pytest.raises(MienError, match="buft, talking-face, rendered, video"):
        load_dataset("bu", tmp_path)
    with pytest.raises(MienError, match="does not exist"):
        load_dataset("buft", tmp_path / "nothing")


def test_the_folder_that_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`.` is called what that folder is called: by a CSV beside it, and by the light of its videos."""
    truth = tmp_path / "subject.csv"
    truth.write_text("frame,pose_Rx,pose_Ry,pose_Rz\n0,0,0,0\n")
    (tmp_path / "subject" / "inner").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "subject" / "0.png"), np.zeros((48, 64, 3), np.uint8))
    for folder, here in ((tmp_path / "subject", "."), (tmp_path / "subject" / "inner", "..")):
        monkeypatch.chdir(folder)
        assert [sequence.truth_files for sequence in load_dataset("video", Path(here))] == [(truth,)]
    monkeypatch.chdir(tiny.buft(tmp_path / "varying", ("jam1",)))
    assert [sequence.kind for sequence in load_dataset("buft", Path())] == ["varying-light"]


def test_hidden_files_are_no_sequences(tmp_path: Path) -> None:
    """As macOS puts beside every file on a disk that is not its own."""
    text = tiny.pts(face68())
    poses = ["0,0,0,0", "1,0,0,0"]
    roots = {
        "buft": tiny.buft(tmp_path / "buft", ("jam1",)),
        "rendered": tiny.rendered(tmp_path / "rendered"),
        "talking-face": tiny.talking_face(tmp_path / "talking", face68(), text, (0,)),
        "video": _annotate(tmp_path / "video", "frame,pose_Rx,pose_Ry,pose_Rz", poses),
    }
    before = {name: load_dataset(name, root) for name, root in roots.items()}
    for root in roots.values():
        for file in [p for p in root.iterdir() if p.is_file()]:
            file.with_name(f"._{file.name}").write_bytes(b"Mac OS X")
        (root / ".thumbnails").mkdir()
        (root / ".thumbnails" / "franck_00000.jpg").touch()
    for name, root in roots.items():
        after = load_dataset(name, root)
        assert [(s.name, s.video, s.truth_files) for s in after] == [
            (s.name, s.video, s.truth_files) for s in before[name]
        ]
