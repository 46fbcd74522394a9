"""The table of a track, its files, and reading them again."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from csv import QUOTE_NONNUMERIC
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.geometry.rotation import FACING, euler_from_matrix, exp, matrix_from_euler
from mien.output import columns
from mien.output.columns import EYES_CLOSED_SD, ROTATION, sort_columns
from mien.output.destination import Destination
from mien.output.recorder import BATCH, Recorder
from mien.output.track import Track
from mien.output.track_files import track_paths
from mien.tracking.state import Closing, Estimate, Status, TrackedLandmarks


def estimate(index: int, landmarks: int = 3, covariance: bool = True) -> Estimate:
    """A face 10 units away that turns by 0.01 rad a frame about y."""
    points = np.arange(2.0 * landmarks).reshape(-1, 2) + index
    return Estimate(
        index=index,
        time=index / 30,
        status=Status.INITIALIZED if index == 0 else Status.TRACKED,
        rotation=matrix_from_euler(np.array([0.1, 0.01 * index, -0.2])) @ FACING,
        translation=np.array([0.5, -0.25, 10.0]),
        animation=np.arange(6) / 10,
        covariance=np.diag(np.arange(1.0, 13) ** 2) * 1e-6 if covariance else None,
        landmarks=TrackedLandmarks(
            tuple("abc"[:landmarks]), points, np.ones((landmarks, 3)), np.array([1.0, 0.5, 0.0])[:landmarks]
        ),
        confidence=0.875,
        mm_per_unit=100.0,
        closing=Closing(0.25, 0.125),
    )


BARE = replace(estimate(0), animation=None, covariance=None, landmarks=None, closing=None)
"""A face of which nothing but the pose is estimated."""


def lost(index: int) -> Estimate:
    return Estimate.lost(Frame(np.zeros((4, 4, 3), np.uint8), index, index / 30), 'nothing, "seen"')


@pytest.fixture
def track() -> Track:
    return Track.from_estimates([estimate(0), estimate(1), lost(2), estimate(3)], {"version": "1"})


def test_a_track_says_of_itself_how_long_it_is(track: Track) -> None:
    assert repr(track) == "<Track of 4 frames, 0.00 to 0.10 s, 1 lost>"
    assert repr(Track(track.table.slice(0, 0))) == "<Track of 0 frames>"


@pytest.mark.parametrize(("angle", "end", "goes"), [(0, (0, 0, 1), "y"), (1, (0, 0, 1), "-x"), (2, (0, 1, 0), "x")])
def test_positive_angles_nod_turn_left_and_lean_clockwise(angle: int, end: tuple[float, ...], goes: str) -> None:
    """Nose (z of the head) down and to the left, its top (y) to the right of the image."""
    R = matrix_from_euler(0.3 * np.eye(3)[angle]) @ FACING
    track = Track.from_estimates([replace(estimate(0), rotation=R)])
    np.testing.assert_allclose(track.euler_deg[0], np.degrees(0.3) * np.eye(3)[angle], atol=1e-3)
    moved = (R - FACING) @ end
    assert moved["xy".index(goes[-1])] * (-1 if goes[0] == "-" else 1) > 0.2


def test_estimates_of_a_stream_keep_their_landmarks_and_lengths(track: Track, tmp_path: Path) -> None:
    assert track.metadata == {"landmark_names": ["a", "b", "c"], "mm_per_unit": 100.0, "version": "1"}
    track.save(tmp_path / "out.csv")
    first, *_ = Track.read(tmp_path / "out.csv").estimates()
    assert first.landmarks is not None
    assert first.translation is not None
    np.testing.assert_allclose(first.translation, [0.5, -0.25, 10.0])
    np.testing.assert_allclose(first.landmarks.image, np.arange(6.0).reshape(3, 2))
    assert Track.from_estimates([estimate(0)], {"mm_per_unit": 2.0}).metadata["mm_per_unit"] == 2.0


def test_metadata_that_the_json_cannot_hold_are_told_before_anything_is_recorded() -> None:
    asked: list[int] = []
    estimates = (asked.append(index) or estimate(index) for index in range(3))
    with pytest.raises(MienError, match="cannot be written as JSON"):
        Track.from_estimates(estimates, {"subject": np.int64(3)})
    assert not asked


def test_estimates_of_several_streams_are_warned_of_once() -> None:
    with pytest.warns(MienWarning, match="frame 0 comes after frame 1, .* make a track of each stream") as told:
        track = Track.from_estimates([estimate(index) for index in (0, 1, 0, 1, 0)])
    assert len(told) == 1
    assert len(track) == 5


def test_header_has_the_names_and_the_order_of_openface_then_ours(track: Track) -> None:
    names = ["frame", "face_id", "timestamp", "confidence", "success", "pose_Tx", "pose_Ty", "pose_Tz"]
    names += ["pose_Rx", "pose_Ry", "pose_Rz", "status", "reason", *TRACKED_UNITS, "eyes_closed"]
    names += [f"{axis}_{i}" for axis in "xyXYZ" for i in range(3)]
    names += [f"pose_{n}_sd" for n in ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")] + [f"{u}_sd" for u in TRACKED_UNITS]
    names += ["eyes_closed_sd"] + [f"visibility_{i}" for i in range(3)]
    assert track.table.column_names == names


def test_units_are_millimetres_and_radians(track: Track) -> None:
    row = track.to_arrow().slice(1, 1).to_pylist()[0]
    assert (row["pose_Tx"], row["pose_Ty"], row["pose_Tz"]) == (50.0, -25.0, 1000.0)
    assert (row["pose_Rx"], row["pose_Ry"], row["pose_Rz"]) == pytest.approx((0.1, 0.01, -0.2), abs=1e-6)
    assert row["Z_2"] == 100.0
    assert (row["x_2"], row["y_2"]) == (5.0, 6.0)
    # The state's standard deviations are 1e-3 times 1, 2 .. 12; 4, 5, 6 of them are lengths.
    assert (row["pose_Tx_sd"], row["pose_Tz_sd"]) == pytest.approx((0.4, 0.6))
    assert row["upper_lip_raiser_sd"] == pytest.approx(0.007)


def test_sd_of_the_angles_is_that_of_the_rotation_vector_when_frontal() -> None:
    facing = replace(estimate(0), rotation=FACING)
    row = Track.from_estimates([facing]).table.to_pylist()[0]
    assert [row[f"pose_R{a}_sd"] for a in "xyz"] == pytest.approx([0.001, 0.002, 0.003])


def test_a_lost_frame_keeps_its_row_with_empty_cells(track: Track, tmp_path: Path) -> None:
    track.save(tmp_path / "out.csv")
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert len(lines) == 5
    assert lines[3].startswith("2,0,0.066667,0,0,,,,,,,lost,nothing; 'seen',,")
    assert set(lines[3].split("'seen'")[1]) == {","}
    assert all(line.count(",") == lines[0].count(",") for line in lines)


def test_the_estimates_come_back_from_the_table(track: Track) -> None:
    told = Track(track.table, {"landmark_names": ["a", "b", "c"], "mm_per_unit": 100.0})
    first, second, gone, _ = told.estimates()
    assert (first.status, second.status, second.index, second.time) == (Status.INITIALIZED, Status.TRACKED, 1, 0.033333)
    assert (gone.status, gone.reason, gone.rotation, gone.landmarks) == (Status.LOST, "nothing; 'seen'", None, None)
    known = estimate(1)
    for name in ("rotation", "translation", "animation"):
        np.testing.assert_allclose(getattr(second, name), getattr(known, name), atol=1e-6)
    assert second.landmarks is not None
    assert known.landmarks is not None
    assert second.landmarks.names == known.landmarks.names
    for name in ("image", "camera", "visibility"):
        np.testing.assert_allclose(getattr(second.landmarks, name), getattr(known.landmarks, name))
    assert (second.closing, second.confidence, second.mm_per_unit) == (known.closing, 0.875, 100.0)
    (back,) = Track.from_estimates([BARE]).estimates()
    assert (back.animation, back.landmarks, back.closing) == (None, None, None)


def test_what_is_not_estimated_has_no_column() -> None:
    names = Track.from_estimates([BARE]).table.column_names
    assert names[-5:] == ["pose_Rx", "pose_Ry", "pose_Rz", "status", "reason"]


def test_what_is_read_of_a_track_cannot_be_changed(track: Track) -> None:
    """It would no longer agree with the table."""
    for values in (track.euler_deg, track.time, track.animation, track.landmarks, track.euler_sd_deg):
        assert values is not None
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0


def test_a_landmark_whose_column_was_deleted_is_unknown(track: Track) -> None:
    short = replace(track, table=track.table.drop_columns(["x_1"])).landmarks
    assert short is not None
    assert track.landmarks is not None
    expected = track.landmarks.copy()
    expected[:, 1, 0] = np.nan
    np.testing.assert_array_equal(short, expected)
    own = replace(track, table=track.table.append_column("x_20240131", track.table["timestamp"])).landmarks
    np.testing.assert_array_equal(own, track.landmarks)


def test_estimates_without_the_json_keep_their_landmarks(track: Track) -> None:
    first = next(replace(track, metadata={}).estimates())
    assert first.landmarks is not None
    assert track.landmarks is not None
    assert first.landmarks.names[0] == "landmark_0"
    np.testing.assert_allclose(first.landmarks.image, track.landmarks[0])


@pytest.mark.parametrize(
    "damaged",
    [{"landmark_names": 3}, {"landmark_names": "nose"}, {"landmark_names": [1, 2, 3]}]
    + [{"mm_per_unit": value} for value in (0, -1.0, float("nan"), float("inf"), "long", None)],
)
def test_estimates_with_damaged_metadata_are_refused(damaged: dict[str, Any], track: Track) -> None:
    (name,) = damaged
    with pytest.raises(MienError, match=f"`{name}` of the track"):
        next(replace(track, metadata={**track.metadata, **damaged}).estimates())


def test_estimates_can_be_compared_and_kept_in_sets() -> None:
    one, other = estimate(0), estimate(0)
    assert one == one
    assert one != other
    assert len({one, other}) == 2


def test_columns_by_property(track: Track) -> None:
    assert len(track) == 4
    assert track.lost == 1
    np.testing.assert_array_equal(np.arange(4)[track.index], track.index)
    assert track.status == ["initialized", "tracked", "lost", "tracked"]
    np.testing.assert_allclose(track.time, np.arange(4) / 30, atol=1e-6)
    np.testing.assert_allclose(track.euler_deg[3], np.degrees([0.1, 0.03, -0.2]), atol=1e-4)
    assert np.isnan(track.euler_deg[2]).all()
    assert track.euler_sd_deg is not None
    assert track.euler_sd_deg.shape == (4, 3)
    assert track.animation is not None
    np.testing.assert_allclose(track.animation[0], np.arange(6) / 10)
    assert track.animation_sd is not None
    np.testing.assert_array_equal(track.eyes_closed, [0.25, 0.25, np.nan, 0.25])
    np.testing.assert_array_equal(track.eyes_closed_sd, [0.125, 0.125, np.nan, 0.125])
    assert track.landmarks is not None
    assert track.landmarks.shape == (4, 3, 2)
    assert track.translation_mm is not None


def test_properties_of_what_is_not_estimated_are_none() -> None:
    track = Track.from_estimates([BARE])
    assert track.euler_sd_deg is None
    assert track.animation is None
    assert track.animation_sd is None
    assert track.eyes_closed is None
    assert track.eyes_closed_sd is None
    assert track.landmarks is None


def test_csv_and_parquet_read_back_as_they_were(track: Track, tmp_path: Path) -> None:
    for path in track.save(tmp_path / "out.csv")[::2]:
        again = Track.read(path)
        assert again.table.equals(track.table)
        assert again.metadata == track.metadata


def test_save_takes_the_name_of_any_of_the_three_files() -> None:
    expected = (Path("a/b.csv"), Path("a/b.json"), Path("a/b.parquet"))
    assert track_paths("a/b.csv") == track_paths("a/b.parquet") == track_paths("a/b") == expected
    assert track_paths("run.1")[0] == Path("run.1.csv")


def test_a_folder_is_no_name_for_a_table(track: Track, tmp_path: Path) -> None:
    track.save(tmp_path / "a")
    (tmp_path / "a").mkdir()
    for path in (tmp_path / "a", f"{tmp_path}/new/"):
        with pytest.raises(MienError, match=r"is a folder; give the name of a table, such as .*(a|new)/out\.csv"):
            track.save(path)
        with pytest.raises(MienError, match="is a folder; give the name of a table"):
            Destination.checked(path, None, None, None)
    assert len(Track.read(tmp_path / "a")) == len(track)  # is no doubt


@pytest.mark.parametrize("name", ["out.mp4", "out.PNG", "out.glb"])
def test_a_picture_is_no_name_for_a_table(track: Track, tmp_path: Path, name: str) -> None:
    with pytest.raises(MienError, match=r"out\.csv, and use the options --overlay"):
        track.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_the_home_folder_may_be_named_as_in_a_shell(
    track: Track, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert track.save("~/a/out.csv")[0] == tmp_path / "a" / "out.csv"
    assert len(Track.read("~/a/out.csv")) == len(track)
    assert Destination.checked("~/b", "~/o.mp4", "~/p.png", None).paths()[-1] == tmp_path / "p.png"
    assert track.plot("~/p.png") == tmp_path / "p.png"


def test_pandas_has_numbers_and_missing_values(track: Track) -> None:
    table = track.to_pandas()
    assert table["pose_Ry"].isna().tolist() == [False, False, True, False]
    assert table["frame"].dtype == np.int64


def test_every_rotation_is_turned_alike(track: Track) -> None:
    turn = exp(np.array([0.02, -0.03, 0.01]))
    turned = track.turned(turn)
    for before, after in zip(track.euler_deg, turned.euler_deg, strict=True):
        if np.isnan(before).any():
            assert np.isnan(after).all()
        else:
            expected = euler_from_matrix(turn @ matrix_from_euler(np.radians(before)))
            np.testing.assert_allclose(np.radians(after), expected, atol=1e-6)
    assert turned.table.column_names == track.table.column_names
    assert turned.table.drop_columns(list(ROTATION)) == track.table.drop_columns(list(ROTATION))
    assert turned.table["pose_Rx"].null_count == track.table["pose_Rx"].null_count > 0


STILL = {name: {"moved": [], "by": []} for name in TRACKED_UNITS}
"""The `units` of a mesh that no unit moves."""


def test_the_mesh_of_a_row_by_hand() -> None:
    """A vertex that looks into the camera from 40 mm before the head's middle, which a unit moves up."""
    units = STILL | {"jaw_drop": {"moved": [1], "by": [[0, 10, 0]]}}
    frontal = replace(estimate(0), rotation=FACING, closing=None)  # the animation is 0, 0.1, 0.2 ..
    rest = {"vertices": [[10.0, 20.0, 30.0], [0.0, 0.0, 40.0]], "units": units}
    track = Track.from_estimates([frontal, lost(1)], {"mesh": rest})
    mesh = track.mesh(0)
    assert mesh is not None
    np.testing.assert_allclose(mesh, [[50 + 10, -25 - 20, 1000 - 30], [50, -25 - 1, 1000 - 40]])
    assert track.mesh(1) is None
    assert Track.from_estimates([frontal]).mesh(0) is None


@pytest.mark.parametrize(
    "mesh",
    [
        {},
        [],
        "none",
        {"vertices": [[0, 0, 0]], "units": {"jaw_drop": 1}},
        {"vertices": [[0, 0, math.nan]], "units": STILL},
        {"vertices": [[0, 0, 10**400]], "units": STILL},
        {"vertices": [[0, 0, 0]], "units": STILL | {"jaw_drop": {"moved": [math.inf], "by": [[0, 1, 0]]}}},
    ],
)
def test_a_mesh_that_is_damaged_is_told(mesh: Any) -> None:
    table = Track.from_estimates([estimate(0)]).table
    with pytest.raises(MienError, match=r"`mesh` of the track is not as mien has written it; track the video again"):
        _ = Track(table, {"mesh": mesh}).rest


def test_landmarks_in_space_move_along_their_rays(track: Track) -> None:
    def in_space(of: Track) -> Array:
        return np.stack([[of.table[f"{axis}_{k}"].to_numpy() for k in range(3)] for axis in "XYZ"]).T

    before = in_space(track)
    depths = np.stack([[900.0, 1000, np.nan], [np.nan] * 3, [np.nan] * 3, [1100, 1100, 1100]])
    moved = track.with_depths(depths)
    after = in_space(moved)
    known = ~np.isnan(depths)
    np.testing.assert_allclose(after[..., 2][known], depths[known])
    np.testing.assert_allclose(after[~known], before[~known])
    rays = after[..., :2] / after[..., 2:]
    np.testing.assert_allclose(rays, before[..., :2] / before[..., 2:], atol=1e-5)
    assert moved.table.column_names == track.table.column_names
    assert moved.table["X_0"].null_count == track.table["X_0"].null_count > 0


def test_columns_of_your_own_stay_behind_those_of_mien(track: Track) -> None:
    own = pa.array(["still"] * len(track))
    table = track.table.add_column(0, "my_note", own).add_column(1, "my_note_2", own)
    lost = Track(table, track.metadata).without(["it was told to", *[None] * (len(track) - 1)])
    assert lost.table.column_names[-2:] == ["my_note", "my_note_2"]
    assert lost.status[0] == "lost"


def test_a_track_without_rotations_has_none_to_turn() -> None:
    track = Track.from_estimates([lost(0), lost(1)])
    assert track.turned(exp(np.array([0.1, 0.0, 0.0]))) is track


def test_without_pandas_the_remedy_is_named(track: Track, monkeypatch: pytest.MonkeyPatch) -> None:
    class NoPandas:
        column_names = track.table.column_names

        def to_pandas(self) -> None:
            raise ImportError("No module named 'pandas'")

    with pytest.raises(MienError, match="pip install pandas"):
        Track(NoPandas()).to_pandas()


@pytest.mark.parametrize("kind", [np.float32, np.int64])
def test_recorder_joins_batches_whose_numbers_are_of_different_types(kind: type) -> None:
    """As of a tracker of one's own that begins with what a network has said, and filters it later."""
    first = [replace(estimate(i), animation=np.zeros(6, kind)) for i in range(BATCH)]
    track = Track.from_estimates([*first, estimate(BATCH)])
    assert track.table.schema.field("jaw_drop").type == pa.float64()


def test_recorder_joins_batches_whose_columns_differ(tmp_path: Path) -> None:
    with Recorder(tmp_path / "out.csv") as recorder:
        for i in range(BATCH):
            recorder.add(estimate(i, covariance=False))
        for i in range(BATCH, BATCH + 5):
            recorder.add(estimate(i))
        track = Track(recorder.table())
    assert track.index.tolist() == list(range(BATCH + 5))
    assert track.euler_sd_deg is not None
    assert np.isnan(track.euler_sd_deg[:BATCH]).all()
    assert np.isfinite(track.euler_sd_deg[BATCH:]).all()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mapped_bytes", [0, 1 << 24])
def test_recorder_can_give_what_there_is_and_go_on(mapped_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mien.output.recorder._MAPPED_BYTES", mapped_bytes)
    with Recorder() as recorder:
        recorder.add(estimate(0))
        assert len(recorder.table()) == 1
        recorder.add(estimate(1))
        assert recorder.table().column("frame").to_pylist() == [0, 1]


def test_recorder_that_is_interrupted_while_it_writes_has_each_row_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """By Ctrl-C after a batch is in the file; `Track.read` takes no two rows for one frame."""

    @contextmanager
    def interrupted(*arguments: Any) -> Iterator[pa.ipc.RecordBatchStreamWriter]:
        monkeypatch.undo()
        with pa.ipc.new_stream(*arguments) as stream:
            yield stream
        raise KeyboardInterrupt

    monkeypatch.setattr(pa.ipc, "new_stream", interrupted)
    with Recorder() as recorder:
        for k in range(BATCH - 1):
            recorder.add(estimate(k))
        with pytest.raises(KeyboardInterrupt):
            recorder.add(estimate(BATCH - 1))
        assert recorder.table().column("frame").to_pylist() == list(range(BATCH))
        recorder.add(estimate(BATCH))
        assert recorder.table().column("frame").to_pylist() == list(range(BATCH + 1))


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs Linux, which says what files are open")
def test_tracks_that_are_kept_hold_no_files_open() -> None:
    """A process may have 1024 of them, on macOS 256: tracking many videos would end there."""
    before = os.listdir("/proc/self/fd")
    kept = [Track.from_estimates([estimate(0)]) for _ in range(3)]
    assert [len(track) for track in kept] == [1, 1, 1]
    assert len(os.listdir("/proc/self/fd")) == len(before)


def test_lengths_of_a_tracker_may_be_in_numbers_of_numpy(tmp_path: Path) -> None:
    track = Track.from_estimates([replace(estimate(0), mm_per_unit=np.float32(110))])
    track.save(tmp_path / "out.csv")
    assert Track.read(tmp_path / "out.csv").metadata["mm_per_unit"] == 110.0


def test_all_rows_have_the_same_landmarks() -> None:
    """As of a tracker of one's own that reports those that it sees."""
    seen = [TrackedLandmarks(names, np.zeros((len(names), 2))) for names in (("tip", "chin"), ("chin",))]
    rows = [Estimate(i, i / 25, Status.TRACKED, landmarks=landmarks) for i, landmarks in enumerate(seen)]
    with pytest.raises(MienError, match=r"frame 1 has 1 landmarks, \('chin',\) first, and an earlier one 2"):
        Track.from_estimates(rows)


def test_nothing_tracked_is_an_error() -> None:
    with pytest.raises(MienError, match="no frame was tracked"):
        Track.from_estimates([])


def test_an_interruption_while_pandas_is_imported_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(columns, "import_module", interrupted)
    columns.import_pandas.cache_clear()
    with pytest.raises(KeyboardInterrupt):
        Track.from_estimates([estimate(0)])


def test_files_appear_all_or_none(track: Track, tmp_path: Path) -> None:
    broken = Track(track.table, {"bad": object()})
    with pytest.raises(MienError, match="cannot be written as JSON"):
        broken.save(tmp_path / "out.csv")
    assert list(tmp_path.iterdir()) == []


def test_saving_again_replaces(track: Track, tmp_path: Path) -> None:
    track.save(tmp_path / "out.csv")
    Track.from_estimates([estimate(0)]).save(tmp_path / "out.csv")
    assert len(Track.read(tmp_path / "out.csv")) == 1
    assert {p.name for p in tmp_path.iterdir()} == {"out.csv", "out.json", "out.parquet"}


@pytest.mark.skipif(sys.platform == "win32", reason="permissions of POSIX")
def test_files_have_the_permissions_of_new_files(track: Track, tmp_path: Path) -> None:
    mask = os.umask(0o022)
    try:
        paths = track.save(tmp_path / "out.csv")
    finally:
        os.umask(mask)
    assert {p.stat().st_mode & 0o777 for p in paths} == {0o644}


def test_a_folder_that_is_missing_is_created(track: Track, tmp_path: Path) -> None:
    track.save(tmp_path / "nowhere" / "out.csv")
    assert len(Track.read(tmp_path / "nowhere" / "out.csv")) == len(track)
    assert track.plot(tmp_path / "pictures" / "out.png").exists()


def test_a_folder_that_cannot_be_created_is_named(track: Track, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MienError, match=r"file/out.* cannot be written"):
        track.save(tmp_path / "file" / "out.csv")


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "frame,timestamp,status\n0,0,tracked\n", "frame,timestamp,status\n0,zero,tracked\n"]
)
def test_read_refuses_what_is_no_track(text: str, tmp_path: Path) -> None:
    (tmp_path / "out.csv").write_text(text)
    with pytest.raises(MienError, match=r"out\.csv"):
        Track.read(tmp_path / "out.csv")


def test_a_column_that_is_there_twice_is_named(track: Track, tmp_path: Path) -> None:
    twice = replace(track, table=track.table.append_column("success", track.table.column("success")))
    twice.save(tmp_path / "out.csv")
    with pytest.raises(MienError, match=r"out\.csv has several columns 'success'; rename or delete all but one"):
        Track.read(tmp_path / "out.csv")


def test_read_refuses_a_damaged_parquet(track: Track, tmp_path: Path) -> None:
    track.save(tmp_path / "out")
    path = tmp_path / "out.parquet"
    content = bytearray(path.read_bytes())
    content[50:-500] = bytes(len(content) - 550)
    path.write_bytes(content)
    with pytest.raises(MienError, match=r"out\.parquet"):
        Track.read(path)


@pytest.mark.parametrize(
    ("column", "cell", "told"), [("status", "seen", "unknown status seen"), ("confidence", "", "is empty")]
)
def test_read_names_a_cell_that_no_track_has(column: str, cell: str, told: str, track: Track, tmp_path: Path) -> None:
    track.save(tmp_path / "out.csv")
    header, first, *rows = (tmp_path / "out.csv").read_text().splitlines()
    cells = first.split(",")
    cells[header.split(",").index(column)] = cell
    (tmp_path / "out.csv").write_text("\n".join([header, ",".join(cells), *rows]))
    with pytest.raises(MienError, match=rf"out\.csv.*{told}"):
        Track.read(tmp_path / "out.csv")


def test_a_column_of_ones_own_may_contain_commas(track: Track, tmp_path: Path) -> None:
    words = ['smiles, "broadly"'] * len(track)
    replace(track, table=track.table.append_column("note", pa.array(words))).save(tmp_path / "out.csv")
    assert Track.read(tmp_path / "out.csv").table["note"].to_pylist() == words


def test_a_column_of_ones_own_may_have_had_commas_where_the_face_is_lost(track: Track, tmp_path: Path) -> None:
    words = ["smiles, broadly", *["calm"] * (len(track) - 1)]
    own = replace(track, table=track.table.append_column("note", pa.array(words)))
    own.without(["hidden", *[None] * (len(track) - 1)]).save(tmp_path / "out.csv")
    assert Track.read(tmp_path / "out.csv").table["note"].to_pylist() == [None, *words[1:]]


@pytest.mark.parametrize("kind", [pa.large_string(), pa.dictionary(pa.int32(), pa.string())])
def test_text_as_other_programs_store_it_is_written(kind: pa.DataType, track: Track, tmp_path: Path) -> None:
    """Polars and pandas 3 write large strings to a Parquet file, and pandas its categories."""
    words = pa.array(["smiles, broadly", None] * (len(track) // 2))
    table = track.table.append_column("note", words.cast(kind))
    for name in ("status", "reason"):
        table = table.set_column(table.column_names.index(name), name, table.column(name).cast(kind))
    parquet.write_table(table, tmp_path / "others.parquet")
    Track.read(tmp_path / "others.parquet").save(tmp_path / "out.csv")
    again = Track.read(tmp_path / "out.csv")
    assert again.table["note"].to_pylist() == words.to_pylist()
    assert again.status == track.status


def test_other_types_of_the_columns_of_a_parquet_are_read_as_those_of_mien(track: Track, tmp_path: Path) -> None:
    """As pandas makes them of what somebody has computed with."""
    kinds = {"success": pa.bool_(), "frame": pa.float32(), "confidence": pa.float32(), "status": pa.large_string()}
    fields = [(field.name, kinds.get(field.name, field.type)) for field in track.table.schema]
    parquet.write_table(track.table.cast(pa.schema(fields)), tmp_path / "others.parquet")
    again = Track.read(tmp_path / "others.parquet")
    assert again.table.equals(track.table)
    assert again.without(["hidden"] * len(track)).lost == len(track)


def test_a_reason_of_ones_own_may_contain_commas(track: Track, tmp_path: Path) -> None:
    """Also where the table, of another tool, had no reasons."""
    reasons = ["behind a hand, it seems", *([None] * (len(track) - 1))]
    for table in (track.table, track.table.drop_columns(["reason"])):
        replace(track, table=table).without(reasons).save(tmp_path / "out.csv")
        again = Track.read(tmp_path / "out.csv").table
        assert again["reason"].to_pylist()[0] == reasons[0]
        assert again["status"].to_pylist()[0] == "lost"
    assert '"' not in _saved_text(track, tmp_path)


def _saved_text(track: Track, folder: Path) -> str:
    track.save(folder / "plain.csv")
    return (folder / "plain.csv").read_text()


def test_the_name_of_a_column_of_ones_own_may_contain_commas(track: Track, tmp_path: Path) -> None:
    own = track.table.append_column("stimulus, shown", pa.array(["a"] * len(track)))
    Track(own, track.metadata).save(tmp_path / "out")
    assert Track.read(tmp_path / "out.csv").table.column_names[-1] == "stimulus, shown"


@pytest.mark.parametrize("name", ["visibility", "x", "Z", "confidence_2", "pose_Rx_1"])
def test_a_column_of_ones_own_may_be_called_almost_like_one_of_mien(name: str, track: Track, tmp_path: Path) -> None:
    words = ["good"] * len(track)
    own = track.table.append_column(name, pa.array(words))
    Track(own, track.metadata).save(tmp_path / "out")
    table = Track.read(tmp_path / "out.csv").table
    assert table[name].to_pylist() == words
    assert sort_columns([name, *track.table.column_names])[-1] == name


def test_pairs_of_a_stream_are_no_estimates() -> None:
    with pytest.raises(MienError, match="yields pairs of a frame and its estimate"):
        Track.from_estimates([(None, None)])  # type: ignore[list-item]


def test_a_track_without_the_deviation_of_the_eyes_is_plotted(track: Track, tmp_path: Path) -> None:
    part = replace(track, table=track.table.drop_columns([EYES_CLOSED_SD]))
    assert part.eyes_closed is not None
    part.plot(tmp_path / "out.png")


def test_columns_of_ones_own_are_no_landmarks(track: Track) -> None:
    landmarks = track.landmarks
    noted = replace(track, table=track.table.append_column("x_note", pa.nulls(len(track), pa.string())))
    assert landmarks is not None
    np.testing.assert_array_equal(noted.landmarks, landmarks)


def test_a_landmark_that_is_never_known_keeps_its_place() -> None:
    points = np.array([[np.nan, np.nan], [3.0, 4.0], [5.0, 6.0]])
    known = TrackedLandmarks(("a", "b", "c"), points)
    estimates = [Estimate(k, k / 25, Status.TRACKED, FACING, np.zeros(3), landmarks=known) for k in range(2)]
    track = Track.from_estimates(estimates)
    assert track.landmarks is not None
    np.testing.assert_array_equal(track.landmarks[0], points)
    (again, _) = track.estimates()
    assert again.landmarks is not None
    np.testing.assert_array_equal(again.landmarks.image, points)


def test_a_long_name_is_written(track: Track, tmp_path: Path) -> None:
    name = 240 * "n"
    track.save(tmp_path / f"{name}.csv")
    assert len(Track.read(tmp_path / f"{name}.csv")) == len(track)


def test_read_names_the_missing_file_and_the_settings(track: Track, tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"out.csv: no such file"):
        Track.read(tmp_path / "out")
    (tmp_path / "out.png").touch()
    with pytest.raises(MienError, match=r"out\.png is not a track; give its \.csv"):
        Track.read(tmp_path / "out.png")
    track.save(tmp_path / "out")
    assert json.loads((tmp_path / "out.json").read_text()) == track.metadata
    with pytest.raises(MienError, match=r"read the \.csv"):
        Track.read(tmp_path / "out.json")
    (tmp_path / "out.csv").rename(tmp_path / "OUT.CSV")
    assert len(Track.read(tmp_path / "OUT.CSV")) == len(track)
    (tmp_path / "OUT.json").write_text("{")
    with pytest.raises(MienError, match=r"OUT\.json is not a track"):
        Track.read(tmp_path / "OUT.CSV")


@pytest.mark.parametrize(
    "how",
    [
        {"quoting": QUOTE_NONNUMERIC},
        {"na_rep": "NA"},
        {"encoding": "utf-8-sig"},
        {"lineterminator": "\r\n"},
        {"sep": ";"},
        {"sep": "\t"},
        {"sep": ";", "decimal": ",", "encoding": "utf-8-sig", "lineterminator": "\r\n"},
    ],
)
def test_a_table_that_others_have_written_again_is_read(how: dict[str, Any], track: Track, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    frame = track.to_pandas().assign(condition='control, left; "1,5"', age=31)
    frame.to_csv(tmp_path / "out.csv", index=False, **how)
    again = Track.read(tmp_path / "out.csv")
    assert again.table.select(track.table.column_names).equals(track.table)
    assert again.table.column("condition").to_pylist() == ['control, left; "1,5"'] * 4
    assert again.table.column("age").to_pylist() == [31] * 4


def test_a_table_that_was_sorted_otherwise_is_read_in_the_order_of_its_frames(track: Track, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    table = track.to_pandas()
    table.iloc[[2, 0, 3, 1]].to_csv(tmp_path / "out.csv", index=False)
    assert Track.read(tmp_path / "out.csv").table.equals(track.table)
    table.iloc[[0, 1, 2, 3, 0]].to_csv(tmp_path / "out.csv", index=False)
    with pytest.raises(MienError, match=r"out\.csv has two rows for one frame; keep one"):
        Track.read(tmp_path / "out.csv")


def test_whole_numbers_that_have_become_decimals_or_truth_values_are_read(track: Track, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    table = track.to_pandas()
    table.astype({"frame": float, "success": float}).to_csv(tmp_path / "out.csv", index=False)
    assert Track.read(tmp_path / "out.csv").table.equals(track.table)
    for word in ({1: True, 0: False}, {1: "TRUE", 0: "FALSE"}):  # of pandas, of R
        table.assign(success=table.success.map(word)).to_csv(tmp_path / "out.csv", index=False)
        assert Track.read(tmp_path / "out.csv").table.equals(track.table)
    table.assign(frame=table.frame + 0.5).to_csv(tmp_path / "out.csv", index=False)
    with pytest.raises(MienError, match=r"out\.csv is not a track of mien"):
        Track.read(tmp_path / "out.csv")


def test_a_plot_has_the_ending_of_a_picture(track: Track, tmp_path: Path) -> None:
    for name in ("angles", "angles.abc"):
        with pytest.raises(MienError, match=rf"{name}: mien writes \.png"):
            track.plot(tmp_path / name)
    assert not list(tmp_path.iterdir())
