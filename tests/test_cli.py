"""The command line: what it writes, and each kind of bad input through the real command."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mien import cli
from mien.errors import warn
from mien.evaluation.benchmark import DEFAULT_TIME_LIMIT
from mien.evaluation.protocols import DEFAULT_LOST_DEG
from mien.frame import Frame
from mien.graphics import Graphics
from mien.initialization.landmark_files import write_landmarks
from mien.initialization.landmarks import LANDMARK_VERTICES, Landmarks, Point
from mien.output.track import Track
from mien.terminal import frames_bar, jobs_bar
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from small_motion import face
from videos import Device, portrait_images, portrait_landmarks, turn_by_metadata, write_images, write_video

TABLES = {"out.csv", "out.json", "out.parquet"}


@dataclass(frozen=True)
class Result:
    status: int
    out: str
    err: str


Command = Callable[..., Result]


@pytest.fixture
def mien(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run a command in the folder `tmp_path`; every file that the test made before is an input."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Result:
        capsys.readouterr()
        with warnings.catch_warnings(), pytest.raises(SystemExit) as end:
            cli.app([str(a) for a in arguments], prog_name="mien")
        written = capsys.readouterr()
        return Result(int(end.value.code or 0), written.out, written.err)

    return run


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "in.mkv", portrait_images())


@pytest.fixture
def marks(tmp_path: Path) -> Path:
    return portrait_landmarks(tmp_path / "marks.json")


def assert_refused(result: Result, folder: Path, before: set[str], *words: str) -> None:
    """Status 2, one sentence that holds the words, no traceback, and no new file, hidden or not."""
    assert result.status == 2
    lines = result.err.splitlines()
    assert len(lines) == 1, result.err
    for word in words:
        assert word in lines[0]
    assert {p.name for p in folder.iterdir()} == before


def names(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()}


@pytest.fixture
def refused(mien: Command, tmp_path: Path) -> Callable[..., None]:
    """Run a command that must be refused with these words."""

    def check(arguments: list[object], *words: str) -> None:
        before = names(tmp_path)
        assert_refused(mien(*arguments), tmp_path, before, *words)

    return check


# What it writes


def test_track_writes_the_files_and_says_where(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    others = ("over.mp4", "plot.png", "head.glb")
    asked = [
        part for option, name in zip(("--overlay", "--plot", "--gltf"), others, strict=True) for part in (option, name)
    ]
    result = mien("track", video, "-o", "out.csv", "--landmarks", marks, *asked)
    assert result.status == 0
    assert names(tmp_path) == {video.name, marks.name, *others, *TABLES}
    assert [line for line in result.out.splitlines() if line.startswith("wrote")] == [
        f"wrote {name}" for name in ("out.csv", "out.json", "out.parquet", *others)
    ]
    track = Track.read(tmp_path / "out.csv")
    assert track.status == ["initialized"] + ["tracked"] * 5
    np.testing.assert_allclose(track.time, np.arange(6) / 25, atol=1e-6)
    turned = track.euler_deg[:, 1] - track.euler_deg[0, 1]
    np.testing.assert_allclose(turned, np.arange(6), atol=2.0)
    with av.open("over.mp4") as container:
        assert sum(1 for _ in container.decode(video=0)) == 6
    camera, shown = track.metadata["camera"], track.landmarks
    assert shown is not None
    for row in (0, 5):  # the mesh lies where the landmarks are
        vertices = track.mesh(row)
        assert vertices is not None
        X = vertices[list(LANDMARK_VERTICES.values())]
        points = X[:, :2] / X[:, 2:] * camera["focal_px"] + [camera["cx"], camera["cy"]]
        assert np.abs(points - shown[row]).max() < 0.05 * np.ptp(shown[row][:, 0])
    assert track.save_gltf("again.glb").read_bytes() == (tmp_path / "head.glb").read_bytes()


def test_json_is_enough_to_get_the_same_numbers(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    mien("track", video, "-o", "out.csv", "--landmarks", marks, "--fov", "50", "--quiet")
    settings = json.loads((tmp_path / "out.json").read_text())
    assert settings["complete"] is True
    assert settings["frames"] == 6
    assert len(settings["video"]["sha256"]) == 64
    assert len(settings["landmark_names"]) == 26
    assert settings["settings"]["preset"] == "realtime"
    assert "head_height" in settings["shape_units"]
    mien("track", video, "-o", "again.csv", "--landmarks", "out.json", "--camera", "out.json", "--quiet")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()


def test_the_table_takes_the_videos_name(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    assert mien("track", video, "--landmarks", marks, "--quiet", "--end", "0.1").out == ""
    assert len(Track.read(tmp_path / "in.csv")) == 3
    (tmp_path / "tables").mkdir()
    assert "-o is empty; give the name of a file" in mien("track", video, "-o", "").err
    mien("track", video, "--landmarks", marks, "-o", "tables", "--quiet", "--end", "0.01")
    assert names(tmp_path / "tables") == {"in.csv", "in.json", "in.parquet"}


def test_the_track_of_another_video_of_the_same_name_is_not_replaced(
    mien: Command, video: Path, marks: Path, tmp_path: Path
) -> None:
    """As in a loop over the folders of several people; that of the same video is, wherever that is now."""
    asked = ("--landmarks", marks, "--end", "0.1", "--quiet")
    assert mien("track", video, *asked).status == 0
    before = (tmp_path / "in.csv").read_bytes()
    for folder in ("other", "moved"):
        (tmp_path / folder).mkdir()
    write_video(tmp_path / "other" / "in.mkv", portrait_images()[1:])
    (tmp_path / "moved" / "in.mkv").write_bytes(video.read_bytes())
    for output in ([], ["-o", "."], ["-o", "./"]):
        assert_refused(
            mien("track", "other/in.mkv", *asked, *output), tmp_path, names(tmp_path), "in.csv is the track of", "-o"
        )
    assert (tmp_path / "in.csv").read_bytes() == before
    assert mien("track", "moved/in.mkv", *asked).status == 0
    assert mien("track", "other/in.mkv", *asked, "-o", "in.csv").status == 0
    write_video(tmp_path / "other" / "in.mkv", portrait_images())
    assert mien("track", "other/in.mkv", *asked).status == 0  # its file was replaced


def test_what_a_camera_has_shown_is_never_replaced(
    mien: Command, marks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each recording has a name of its own, and one that was chosen must be free: it cannot be made again."""
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: Device(portrait_images(2)))
    asked = ("track", 0, "--landmarks", marks, "--quiet")
    assert mien(*asked).status == 0
    (first,) = tmp_path.glob("*.csv")
    assert re.fullmatch(r"camera-0(-[0-9]{2,4}){6}\.csv", first.name)
    assert_refused(
        mien(*asked, "-o", first), tmp_path, names(tmp_path), f"{first} exists", "choose another name, or move it away"
    )
    (tmp_path / "o.mp4").touch()
    named = (*asked, "-o", "session.csv")
    assert_refused(mien(*named, "--overlay", "o.mp4"), tmp_path, names(tmp_path), "o.mp4 exists")
    assert mien(*named).status == 0
    assert {path.name for path in tmp_path.glob("*.csv")} == {first.name, "session.csv"}


def test_missing_folders_are_made(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    mien("track", video, "-o", "a/b/out", "--landmarks", marks, "--quiet")
    assert names(tmp_path / "a" / "b") == TABLES


def test_the_home_folder_may_be_named_within_an_option(
    mien: Command, video: Path, marks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where shells leave it as it is; alone, as the value of an option, they have replaced it."""
    for variable in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    assert mien("landmarks", video, "--output=~/a/", "--landmarks", marks).status == 0
    assert names(tmp_path / "home" / "a") == {"in.landmarks.json", "in.landmarks.png"}
    assert names(tmp_path) == {video.name, marks.name, "home"}


def test_a_folder_is_named_by_the_slash_at_its_end(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    assert mien("track", video, "-o", "a/b/", "--landmarks", marks, "--end", "0.1").status == 0
    assert names(tmp_path / "a" / "b") == {"in.csv", "in.json", "in.parquet"}
    assert mien("landmarks", video, "-o", "c/", "--landmarks", marks).status == 0
    assert names(tmp_path / "c") == {"in.landmarks.json", "in.landmarks.png"}
    assert names(tmp_path) == {video.name, marks.name, "a", "c"}


def test_a_long_name_leaves_no_room_for_that_of_a_further_face(
    mien: Command, video: Path, marks: Path, tmp_path: Path
) -> None:
    name = 247 * "n"
    assert mien("track", video, "-o", f"{name}.csv", "--landmarks", marks, "--end", "0.01").status == 0
    assert (tmp_path / f"{name}.csv").exists()


def test_landmarks_writes_file_and_picture(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    result = mien("landmarks", video, "--landmarks", marks)
    assert result.status == 0
    assert "pixels (root mean square)" in result.out
    assert names(tmp_path) == {video.name, marks.name, "in.landmarks.json", "in.landmarks.png"}
    written = json.loads((tmp_path / "in.landmarks.json").read_text())
    assert written == json.loads(marks.read_text()) | {"video": {"width": 320, "height": 240}}
    assert 1200 < cv2.imread("in.landmarks.png").shape[1] < 2000


def test_landmarks_of_a_video_of_another_size_are_warned_of(
    mien: Command, video: Path, marks: Path, tmp_path: Path
) -> None:
    """They may lie beside the face, and fit one all the same."""
    assert mien("landmarks", video, "--landmarks", marks, "-o", "found.json").status == 0
    larger = [cv2.copyMakeBorder(image, 0, 240, 0, 320, cv2.BORDER_REPLICATE) for image in portrait_images(1)]
    write_images(tmp_path / "larger", larger)
    for name, said in (("in.mkv", False), ("larger", True)):
        result = mien("landmarks", name, "--landmarks", "found.json", "-o", f"{name}.json")
        assert ("found.json has landmarks of a video of 320x240 pixels, and this one has 640x480" in result.err) == said


def test_landmarks_that_were_corrected_are_not_overwritten(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path
) -> None:
    assert mien("landmarks", video, "--landmarks", marks).status == 0
    written = tmp_path / "in.landmarks.json"
    for of in ("points", "graphics"):
        values = json.loads(marks.read_text())
        if of == "points":
            values["points"][3][0] += 0.5
        else:
            mask = np.ones((20, 30), dtype=bool)
            values["graphics"] = Graphics(320, 240, 100, 90, mask).to_dict()
        written.write_text(json.dumps(values))
        refused(["landmarks", video, "--landmarks", marks], "in.landmarks.json exists with other landmarks", "-o")
        assert json.loads(written.read_text()) == values
    assert mien("landmarks", video, "--landmarks", written).status == 0


def test_landmarks_that_are_there_are_left_as_they_are(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    own = tmp_path / "in.landmarks.json"
    own.write_text(json.dumps({**json.loads(marks.read_text()), "annotator": "Mia"}))
    before = own.read_bytes()
    for given in (own, marks):
        result = mien("landmarks", video, "--landmarks", given)
        assert [line for line in result.out.splitlines() if line.startswith("wrote")] == ["wrote in.landmarks.png"]
        assert own.read_bytes() == before


def test_landmarks_do_not_replace_the_settings_of_a_track(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path
) -> None:
    mien("track", video, "-o", "out.csv", "--landmarks", marks, "--end", "0.01")
    before = (tmp_path / "out.json").read_bytes()
    refused(["landmarks", video, "--landmarks", marks, "-o", "out.json"], "out.json holds the settings", "-o")
    assert mien("landmarks", video, "--landmarks", "out.json", "-o", "out.json").status == 0
    assert (tmp_path / "out.json").read_bytes() == before


def test_landmarks_replace_no_picture_that_is_not_named(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "me.png"
    picture.write_bytes(b"somebody's")
    asked = ["landmarks", video, "--landmarks", marks, "-o", "me.json"]
    refused(asked, "me.png exists and is not the picture of me.json", "--plot")
    assert picture.read_bytes() == b"somebody's"
    for options in (["--plot", picture], []):  # then it is that of these landmarks
        assert mien(*asked, *options).status == 0


def test_the_image_in_which_points_were_marked_is_not_replaced(
    refused: Callable[..., None], video: Path, tmp_path: Path
) -> None:
    points = np.random.default_rng(0).uniform(90, 150, (68, 2))
    write_landmarks(tmp_path / "me.pts", Landmarks(points, "ibug68"))
    (tmp_path / "me.png").touch()
    refused(["landmarks", video, "--landmarks", "me.pts", "-o", "me.pts"], "me.png exists", "--plot")


@pytest.mark.parametrize(
    ("name", "text"),
    [("in.csv", "frame,pose_Rx\n0,0.1\n"), ("in.json", '{"focal_px": 500}'), ("in.parquet", "somebody's")],
)
def test_what_mien_has_not_written_is_not_overwritten(
    name: str, text: str, refused: Callable[..., None], mien: Command, video: Path, marks: Path, tmp_path: Path
) -> None:
    """Like the truth beside a video, which has its name."""
    (tmp_path / name).write_text(text)
    refused(["track", video, "--landmarks", marks], f"{name} exists and is not the track of a video by mien", "-o")
    assert (tmp_path / name).read_text() == text
    (tmp_path / "other.csv").touch()  # as of `mktemp`
    assert mien("track", video, "--landmarks", marks, "-o", "other.csv", "--end", "0.1").status == 0
    (tmp_path / "other.json").write_text("{}")
    assert mien("track", video, "--landmarks", marks, "-o", "other.csv", "--end", "0.1").status == 0
    (tmp_path / "third.face1.csv").write_text("mine")
    refused(["track", video, "--faces", "2", "-o", "third.csv"], "third.face1.csv exists and is not the track")


def test_a_video_that_is_no_overlay_is_not_overwritten(
    refused: Callable[..., None], mien: Command, video: Path, marks: Path, tmp_path: Path
) -> None:
    holiday = write_video(tmp_path / "holiday.mp4", portrait_images(2), codec="libx264", pix_fmt="yuv420p")
    before = holiday.read_bytes()
    asked = ["track", video, "--landmarks", marks, "--end", "0.1", "-o", "out.csv", "--overlay"]
    refused([*asked, holiday], "holiday.mp4 exists and is not an overlay by mien", "--overlay")
    assert holiday.read_bytes() == before
    for _ in range(2):
        assert mien(*asked, "over.mp4").status == 0


def test_a_head_that_was_edited_is_not_overwritten(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path
) -> None:
    asked = ["track", video, "-o", "out.csv", "--landmarks", marks, "--end", "0.1", "--gltf", "head.glb"]
    assert mien(*asked).status == 0
    written = (tmp_path / "head.glb").read_bytes()
    assert mien(*asked).status == 0
    edited = written.replace(b"mien", b"else", 1)
    (tmp_path / "head.glb").write_bytes(edited)
    refused(asked, "head.glb exists and is not as mien wrote it", "another name")
    assert (tmp_path / "head.glb").read_bytes() == edited


@pytest.mark.parametrize(("off", "warned"), [(0.0, False), (30.0, True)])
def test_a_landmark_far_off_is_warned_of(off: float, warned: bool, mien: Command, video: Path, marks: Path) -> None:
    values = json.loads(marks.read_text())
    values["points"][61][0] += off  # a corner of the mouth
    marks.write_text(json.dumps(values))
    result = mien("track", video, "--landmarks", marks, "-o", "out.csv", "--end", "0.1")
    assert result.status == 0
    assert ("fit a face only to" in result.err) == ("point 61 may be wrong" in result.err) == warned


def test_landmarks_in_one_place_are_no_face(refused: Callable[..., None], video: Path, marks: Path) -> None:
    values = json.loads(marks.read_text())
    marks.write_text(json.dumps(values | {"points": [[5, 5]] * len(values["points"])}))
    for command in (["track", video, "-o", "out.csv"], ["landmarks", video]):
        refused([*command, "--landmarks", marks], "the face measures 0.0 pixels")


def test_landmarks_overwrites_no_camera(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path
) -> None:
    """The landmarks themselves may be written again."""
    camera = tmp_path / "camera.json"
    camera.write_text('{"focal_px": 400, "cx": 160, "cy": 120}')
    asked = ["landmarks", video, "--landmarks", marks, "--camera", camera]
    refused([*asked, "-o", camera], "camera.json would overwrite", "choose another name")
    assert mien(*asked, "-o", marks).status == 0


def test_the_face_is_detected(mien: Command, video: Path, tmp_path: Path) -> None:
    assert mien("track", video, "-o", "out.csv", "--quiet").status == 0
    assert names(tmp_path) == {video.name, *TABLES}
    assert json.loads((tmp_path / "out.json").read_text())["landmarks"]["scheme"] in ("mediapipe478", "mediapipe468")


def test_help_names_the_commands(mien: Command) -> None:
    result = mien("--help")
    assert result.status == 0
    assert all(command in result.out for command in ("demo", "track", "landmarks"))


def test_the_help_of_evaluate_states_its_defaults(mien: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    text = mien("evaluate", "--help").out
    assert f"{DEFAULT_LOST_DEG:g} if not given" in text
    assert f"{DEFAULT_TIME_LIMIT:g} if not given" in text


def test_help_is_quick_because_it_imports_nothing_heavy() -> None:
    code = "import sys; from mien import cli; print({'numpy', 'cv2', 'av', 'numba', 'pyarrow'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


# Bad input: the video


def test_not_a_video(refused: Callable[..., None], tmp_path: Path, marks: Path) -> None:
    (tmp_path / "notes.mp4").write_text("no video\n" * 1000)
    refused(["track", tmp_path / "notes.mp4", "--landmarks", marks], "notes.mp4", "video")
    refused(["landmarks", tmp_path / "notes.mp4"], "notes.mp4", "video")
    refused(["track", "missing.mp4"], "missing.mp4: no such file")


def test_no_frame_decodes(refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path) -> None:
    path = write_video(tmp_path / "header.avi", portrait_images())
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"movi") + 4])
    refused(["track", path, "--landmarks", marks], "header.avi", "no frame could be decoded", "convert it")


def test_truncated_in_the_middle(mien: Command, marks: Path, tmp_path: Path) -> None:
    path = write_video(tmp_path / "cut.avi", portrait_images())
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    result = mien("track", path, "-o", "out.csv", "--landmarks", marks)
    assert result.status == 0
    assert "cut.avi is truncated or damaged" in result.err
    assert "of 6 frames were decoded" in result.err
    assert 2 <= len(Track.read(tmp_path / "out.csv")) < 6


def test_one_frame_only(mien: Command, marks: Path, tmp_path: Path) -> None:
    path = write_video(tmp_path / "one.mkv", portrait_images()[:1])
    result = mien("track", path, "-o", "out.csv", "--landmarks", marks, "--overlay", "o.mp4", "--plot", "p.png")
    assert result.status == 0
    assert Track.read(tmp_path / "out.csv").status == ["initialized"]
    assert {"o.mp4", "p.png"} <= names(tmp_path)


def test_frames_of_changing_size(mien: Command, marks: Path, tmp_path: Path) -> None:
    images = [*portrait_images()[:3], *(cv2.resize(i, (160, 120)) for i in portrait_images()[3:])]
    path = tmp_path / "sizes.mjpeg"
    path.write_bytes(b"".join(cv2.imencode(".jpg", i[..., ::-1])[1].tobytes() for i in images))
    result = mien("track", path, "-o", "out.csv", "--landmarks", marks, "--overlay", "o.mp4")
    assert result.status == 0
    assert "sizes.mjpeg: frame 3 has 160x120 pixels and the first 320x240" in result.err
    track = Track.read(tmp_path / "out.csv")
    assert track.lost == 0
    assert abs(track.euler_deg[5, 1] - track.euler_deg[0, 1] - 5) < 3


def test_variable_frame_rate(mien: Command, marks: Path, tmp_path: Path) -> None:
    times = [0, 10, 300, 310, 900, 950]
    path = write_video(tmp_path / "vfr.mkv", portrait_images(), times_ms=times)
    assert mien("track", path, "-o", "out.csv", "--landmarks", marks, "--overlay", "o.mp4").status == 0
    np.testing.assert_allclose(Track.read(tmp_path / "out.csv").time, np.array(times) / 1000, atol=1e-6)


def test_rotation_metadata(mien: Command, marks: Path, tmp_path: Path) -> None:
    """A phone that was held sideways: the pictures are stored turned, and shown upright."""
    stored = [np.rot90(i) for i in portrait_images()]
    path = write_video(tmp_path / "phone.mp4", stored, codec="libx264", pix_fmt="yuv420p", options={"crf": "10"})
    turn_by_metadata(path)
    assert mien("track", path, "-o", "out.csv", "--landmarks", marks).status == 0
    assert np.abs(Track.read(tmp_path / "out.csv").euler_deg[:, 2]).max() < 15


@pytest.mark.parametrize("interlaced", [0, 1])
def test_interlaced_video_is_noted(interlaced: int, mien: Command, marks: Path, tmp_path: Path) -> None:
    how = {"x264-params": f"interlaced={interlaced}"}
    path = write_video(tmp_path / "tv.mp4", portrait_images(), codec="libx264", pix_fmt="yuv420p", options=how)
    assert mien("track", path, "-o", "out.csv", "--landmarks", marks).status == 0
    assert json.loads((tmp_path / "out.json").read_text())["video"]["interlaced"] is bool(interlaced)


@pytest.mark.parametrize("pix_fmt", ["gray", "bgra", "gray16le"])
def test_other_kinds_of_pixels(mien: Command, marks: Path, tmp_path: Path, pix_fmt: str) -> None:
    gray = [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in portrait_images(3)]
    images = {
        "gray": gray,
        "bgra": [cv2.cvtColor(i, cv2.COLOR_RGB2BGRA) for i in portrait_images(3)],
        "gray16le": [i.astype(np.uint16) * 257 for i in gray],
    }[pix_fmt]
    path = write_video(tmp_path / "in.mkv", images, pix_fmt=pix_fmt, of=pix_fmt)
    assert mien("track", path, "-o", "out.csv", "--landmarks", marks).status == 0
    assert Track.read(tmp_path / "out.csv").lost == 0


# Bad input: the face


def _detects(monkeypatch: pytest.MonkeyPatch, faces: list[Landmarks], at: int = 0) -> None:
    """The detector finds these faces in the frame with the index `at` and none before."""

    def first_with_a_face(frames: Iterable[Frame], place: Point | None = None) -> tuple[Frame, list[Landmarks]] | None:
        return next(((frame, faces) for frame in frames if faces and frame.index == at), None)

    monkeypatch.setattr("mien.initialization.detector.first_with_a_face", first_with_a_face)


def _faces(count: int) -> list[Landmarks]:
    known = face().landmarks
    return [replace(known, points=known.points + 5 * k) for k in range(count)]


def test_no_face(refused: Callable[..., None], video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _detects(monkeypatch, [])
    refused(
        ["track", video], "in.mkv: no face was found in its 6 frames from 0.00 s to 0.20 s", "--landmarks", "it upright"
    )
    refused(["landmarks", video], "in.mkv: no face", "--landmarks")


def test_a_face_that_comes_later(mien: Command, video: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What comes before it is tracked backwards; its landmarks, from NAME.json, give the same track."""
    _detects(monkeypatch, [replace(face().landmarks, frame_index=2, time=0.08)], at=2)
    result = mien("track", video, "-o", "out.csv", "--overlay", "out.mp4", "--passes", "2")
    assert result.status == 0
    assert "in.mkv: a face is first found at 0.08 s" in result.err
    track = Track.read(tmp_path / "out.csv")
    assert track.status == ["tracked", "tracked", "initialized", "tracked", "tracked", "tracked"]
    assert mien("track", video, "-o", "again.csv", "--landmarks", "out.json", "--passes", "2").status == 0
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()


def test_a_face_that_comes_much_later(mien: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What comes long before it has rows without a pose, which say so."""
    video = write_video(tmp_path / "in.mkv", portrait_images(), times_ms=[0, 40, 99960, 100000, 100040, 100080])
    _detects(monkeypatch, [replace(face().landmarks, frame_index=3, time=100.0)], at=3)
    assert mien("track", video, "-o", "out.csv").status == 0
    track = Track.read(tmp_path / "out.csv")
    assert track.status == ["lost", "lost", "tracked", "initialized", "tracked", "tracked"]
    assert track.table.column("reason").to_pylist()[:2] == ["tracking begins later"] * 2


def test_landmarks_of_a_time_that_the_video_does_not_have(
    refused: Callable[..., None], video: Path, tmp_path: Path
) -> None:
    write_landmarks(tmp_path / "late.json", replace(face().landmarks, time=9.0))
    refused(["track", video, "--landmarks", "late.json"], "late.json belongs to 9.00 s", "in.mkv has no frame")


def test_several_faces(mien: Command, video: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    _detects(monkeypatch, _faces(3))
    result = mien("track", video, "-o", "out.csv")
    assert result.status == 0
    assert "in.mkv: 3 faces in the frame at 0.00 s; the largest is tracked" in result.err
    first = json.loads((tmp_path / "out.json").read_text())["landmarks"]["points"][0]
    assert first == pytest.approx(face().landmarks.points[0].tolist(), abs=1e-3)


def test_a_file_that_is_read_often_is_complained_of_once(
    mien: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Found in the third image, the face is tracked backwards, forwards, and all of it again."""
    write_images(tmp_path / "images", portrait_images())
    (tmp_path / "images" / "1.png").write_bytes(b"no image")
    _detects(monkeypatch, [replace(face().landmarks, frame_index=2, time=0.08)], at=2)
    result = mien("track", tmp_path / "images", "-o", "out.csv", "--passes", "2")
    assert result.status == 0
    assert result.err.count("1.png is not a readable image and was skipped") == 1


def test_no_face_and_two_faces_with_the_real_detector(
    mien: Command, refused: Callable[..., None], tmp_path: Path
) -> None:
    gray = write_video(tmp_path / "gray.mkv", [np.full((240, 320, 3), 127, np.uint8)] * 3)
    refused(["track", gray], "gray.mkv: no face was found in its 3 frames from 0.00 s to 0.08 s")
    image = portrait_images()[0]
    pair = np.hstack([image, cv2.resize(image, (240, 240))])
    two = write_video(tmp_path / "two.mkv", [pair] * 2)
    result = mien("track", two, "-o", "out.csv")
    assert "two.mkv: 2 faces" in result.err
    assert result.status == 0
    asked = ("--face", 320 + 0.75 * face().landmarks.points[:, 0].mean(), 120)
    result = mien("track", two, "-o", "right.csv", *asked)
    assert "faces" not in result.err
    left, right = (Track.read(tmp_path / name).table.column("x_0")[0].as_py() for name in ("out.csv", "right.csv"))
    assert left < 320 < right
    refused(["track", two, "--face", 320, 230], "two.mkv: no face was found at 320, 230 in its 2 frames")
    refused(["track", two, "--face", 800, 10], "the face at 800, 10 lies outside the image of 560x240 pixels")
    refused(["track", two, *asked, "--landmarks", "out.json"], "landmarks are given", "omit its point")
    refused(["track", two, "--faces", 2, *asked, "--show"], "--face, --show: for one face only", "omit it")
    result = mien("track", two, "-o", "both.csv", "--faces", 4, "--plot", "both.png")
    assert "2 frames, face 1 lost in 0" in result.out
    assert "wrote both.face1.png" in result.out
    both = [Track.read(tmp_path / name).table for name in ("both.csv", "both.face1.csv")]
    assert [table.column("x_0")[0].as_py() < 320 for table in both] == [True, False]
    assert [table.column("face_id").to_pylist() for table in both] == [[0, 0], [1, 1]]
    refused(["track", gray, "--faces", 2], "gray.mkv: no face was found in it", "turn it upright")
    refused(["track", 0, "--faces", 2], "camera 0 can be read only once; several faces need a file")


def test_face_under_40_pixels(refused: Callable[..., None], video: Path, tmp_path: Path) -> None:
    known = face().landmarks
    small = replace(known, points=100 + 30 * (known.points - known.points.min(axis=0)) / np.ptp(known.points, axis=0))
    write_landmarks(tmp_path / "small.json", small)
    refused(["track", video, "--landmarks", "small.json"], "small.json: the face measures 30", "enlarge")


def test_detected_face_under_40_pixels(
    refused: Callable[..., None], video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = face().landmarks
    _detects(monkeypatch, [replace(known, points=100 + 0.1 * known.points)])
    refused(["track", video], "in.mkv", "pixels", "enlarge or crop")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda points: points[:20], "points"),
        (lambda points: [[None, 1.0], *points[1:]], "not a finite number"),
        (lambda points: [[x + 400, y] for x, y in points], "outside the image of 320x240"),
    ],
)
def test_landmark_file(
    refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path, change: Callable[..., object], words: str
) -> None:
    values = json.loads(marks.read_text())
    (tmp_path / "bad.json").write_text(json.dumps(values | {"depths": None, "points": change(values["points"])}))
    refused(["track", video, "--landmarks", "bad.json"], "bad.json", words)
    refused(["landmarks", video, "--landmarks", "bad.json"], "bad.json", words)


def test_landmarks_of_another_time(mien: Command, video: Path, marks: Path) -> None:
    result = mien("track", video, "-o", "out.csv", "--landmarks", marks, "--start", "0.1")
    assert result.status == 0
    assert "belongs to 0.00 s and tracking begins at 0.12 s" in result.err


# Bad input: options


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--preset", "unknown"], "unknown tracker 'unknown'"),
        (["--focal", "500", "--fov", "60"], "more than one way"),
        (["--focal", "-3"], "focal length must be positive"),
        (["--fov", "190"], "between 0 and 180"),
        (["--camera", "missing.json"], "missing.json cannot be read"),
        (["--camera", "marks.json"], 'marks.json needs {"focal_px"'),
        (["--start", "nan"], "start is nan; give a number"),
        (["--fov", "170"], "sees more than 150 degrees"),
        (["--focal", "1e30"], "a focal length of 1e+30 pixels sees less than 0.001 degrees"),
        (["--end", "inf"], "end is inf; give a number"),
        (["--start", "9"], "no frame from 9 s"),
        (["--start", "2", "--end", "1"], "must come before the end"),
        (["--plot", "plot.docx"], "plot.docx: mien writes .png"),
        (["--gltf", "head.gltf"], "head.gltf: mien writes .glb"),
        (["--overlay", "over.avi"], "over.avi: mien writes .mp4"),
        (["--fps", "50"], "in.mkv has times of its own; omit fps"),
        (["-o", "marks.json"], "marks.json would overwrite an input"),
    ],
)
def test_options(refused: Callable[..., None], video: Path, marks: Path, options: list[str], words: str) -> None:
    refused(["track", video, "--landmarks", "marks.json", *options], words)


def test_a_settings_file_is_an_input(refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path) -> None:
    (tmp_path / "own.json").write_text('{"adaptation": {"view_rate": 0}}')
    asked = ["--preset", "realtime:own.json", "-o", "own.csv"]
    refused(["track", video, "--landmarks", marks, *asked], "own.json would overwrite an input")
    refused(["track", video, "--faces", "2", *asked], "own.json would overwrite an input")


def test_camera_file(mien: Command, video: Path, marks: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text('{"focal_px": 400, "cx": 160, "cy": 120}')
    mien("track", video, "-o", "out.csv", "--landmarks", marks, "--camera", "camera.json")
    camera = json.loads((tmp_path / "out.json").read_text())["camera"]
    assert camera == {"focal_px": 400.0, "cx": 160.0, "cy": 120.0, "focal_log_sd": 0.0}


def test_the_frame_rate_of_a_folder_is_known_for_another_run(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path
) -> None:
    write_images(tmp_path / "images", portrait_images())
    asked = ["track", "images", "--landmarks", marks, "-o", "out.csv"]
    for options, fps in (([], None), (["--fps", "50"], 50.0)):
        assert mien(*asked, *options).status == 0
        np.testing.assert_allclose(Track.read(tmp_path / "out.csv").time, np.arange(6) / (fps or 25), atol=1e-6)
        settings = json.loads((tmp_path / "out.json").read_text())
        assert settings["video"]["fps"] == (fps or 25)
        assert settings["asked"]["fps"] == fps
    marked = json.loads(marks.read_text())
    (tmp_path / "m.json").write_text(json.dumps(marked | {"frame": 2, "time": 0.04}))
    assert mien("landmarks", "images", "--landmarks", "m.json", "--fps", "50", "-o", "l.json").status == 0
    first = json.loads((tmp_path / "l.json").read_text())
    assert (first["frame"], first["time"]) == (2, 0.04)
    refused(["track", video, "--faces", "2", "--fps", "50"], "in.mkv has times of its own; omit fps")


# The place for the output


def test_a_picture_among_the_images_of_the_video_is_refused(
    refused: Callable[..., None], marks: Path, tmp_path: Path
) -> None:
    """It would be a frame of the next run, or take the place of one."""
    write_images(tmp_path / "images", portrait_images())
    for options in (["track", "--plot", "images/0.png"], ["landmarks", "--plot", "images/x.png"],
                    ["landmarks", "-o", "images/x.json"]):  # fmt: skip
        refused([options[0], "images", "--landmarks", marks, *options[1:]], "would become an image of the video images")


def test_folder_that_cannot_be_written(refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    names = {"-o": "out.csv", "--overlay": "out.mp4", "--plot": "out.png", "--gltf": "out.glb"}
    for option, name in names.items():
        refused(["track", video, "--landmarks", marks, option, f"file/{name}"], f"file/{name} cannot be written")
    refused(["landmarks", video, "--landmarks", marks, "-o", "file/out.json"], "file/out.json cannot be written")


@contextmanager
def _file_size_limit(size: int) -> Iterator[None]:
    """No file of this process may grow beyond this: to a program that writes, the disk is full."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


@pytest.mark.parametrize("options", [[], ["--overlay", "over.mp4"]])
def test_disk_full(
    mien: Command, refused: Callable[..., None], video: Path, marks: Path, tmp_path: Path, options: list[str]
) -> None:
    mien("track", video, "--landmarks", marks, "-o", "warm/out.csv")  # compiled kernels are cached on disk, too
    with _file_size_limit(4096):
        refused(["track", video, "--landmarks", marks, "-o", "out.csv", *options], "cannot be written")


def test_disk_full_for_the_overlay_leaves_the_table(mien: Command, marks: Path, tmp_path: Path) -> None:
    """The overlay is by far the largest file: when it does not fit, the numbers are still written."""
    path = write_video(tmp_path / "in.mkv", portrait_images() * 8)
    mien("track", path, "--landmarks", marks, "-o", "warm/out.csv", "--end", "0.1")
    with _file_size_limit(120_000):
        result = mien("track", path, "--landmarks", marks, "-o", "out.csv", "--overlay", "over.mp4")
    assert result.status == 2
    assert "over.mp4 cannot be written" in result.err
    assert names(tmp_path) == {"in.mkv", marks.name, "warm", *TABLES}
    assert json.loads((tmp_path / "out.json").read_text())["complete"] is False


# Stopped on the way


def _stop_at(frame: int, error: BaseException) -> Callable[[RealtimeTracker, Frame], Estimate]:
    original = RealtimeTracker.track

    def track(self: RealtimeTracker, image: Frame) -> Estimate:
        if image.index == frame:
            raise error
        return original(self, image)

    return track


def test_interrupt_writes_what_was_tracked(
    mien: Command, video: Path, marks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RealtimeTracker, "track", _stop_at(4, KeyboardInterrupt()))
    result = mien("track", video, "-o", "out.csv", "--landmarks", marks, "--overlay", "over.mp4", "--plot", "plot.png")
    assert result.status == 130
    assert "stopped after 4 frames, which are in out.csv" in result.err
    assert len(Track.read(tmp_path / "out.csv")) == 4
    settings = json.loads((tmp_path / "out.json").read_text())
    assert settings["complete"] is False
    assert settings["stopped"] == "KeyboardInterrupt"
    assert names(tmp_path) == {video.name, marks.name, "over.mp4", "plot.png", *TABLES}


def test_compiled_code_can_be_interrupted(
    mien: Command, video: Path, marks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A compiled function in which Ctrl-C arrives raises a SystemError from it."""
    within = SystemError("CPUDispatcher(<function solve>) returned a result with an exception set")
    within.__cause__ = KeyboardInterrupt()
    monkeypatch.setattr(RealtimeTracker, "track", _stop_at(4, within))
    result = mien("track", video, "-o", "out.csv", "--landmarks", marks)
    assert result.status == 130
    assert result.err.splitlines()[-1] == "mien: interrupted"
    assert json.loads((tmp_path / "out.json").read_text())["stopped"] == "KeyboardInterrupt"

    def begin(*_: object) -> None:
        raise within

    monkeypatch.setattr(RealtimeTracker, "initialize", begin)
    assert mien("track", video, "-o", "other.csv", "--landmarks", marks).status == 130


@pytest.mark.parametrize("number", [errno.EAGAIN, errno.ENOMEM])
def test_where_memory_or_processes_are_short_no_file_is_blamed(
    number: int, mien: Command, video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("mien.pipeline.landmarks.prepare", refuse)
    result = mien("landmarks", video)
    assert result.status == 2
    assert f"mien: memory or processes are short ({os.strerror(number)}); close other programs" in result.err


def test_an_import_can_be_interrupted(mien: Command, video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to Python 3.11 Ctrl-C while a class is defined raises a RuntimeError from it."""

    class Attribute:
        def __set_name__(self, owner: type, name: str) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr("mien.pipeline.landmarks.prepare", lambda *_: type("Imported", (), {"name": Attribute()}))
    result = mien("landmarks", video)
    assert (result.status, result.err.splitlines()[-1]) == (130, "mien: interrupted")


def test_a_crash_writes_what_was_tracked_and_goes_on(
    video: Path, marks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(RealtimeTracker, "track", _stop_at(2, RuntimeError("a bug")))
    with warnings.catch_warnings(), pytest.raises(RuntimeError, match="a bug"):
        cli.app(["track", str(video), "-o", "out.csv", "--landmarks", str(marks)])
    assert len(Track.read(tmp_path / "out.csv")) == 2


def test_interrupt_before_the_first_frame_writes_nothing(
    mien: Command, video: Path, marks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(RealtimeTracker, "initialize", interrupted)
    assert mien("track", video, "-o", "out.csv", "--landmarks", marks).status == 130
    assert names(tmp_path) == {video.name, marks.name}


def _in_a_process(
    first: str, before_frame: str, video: Path, marks: Path, folder: Path
) -> subprocess.CompletedProcess[str]:
    """`mien track` in a process that executes one line first, and another before each `frame` after the first."""
    code = f"""
import os, signal
{first}
from mien.cli import main
from mien.tracking.realtime import RealtimeTracker
original = RealtimeTracker.track
def track(self, frame):
    {before_frame}
    return original(self, frame)
RealtimeTracker.track = track
main()
"""
    command = [sys.executable, "-c", code, "track", str(video), "-o", "out.csv", "--landmarks", str(marks)]
    environment = os.environ | {"NO_COLOR": "1"}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=environment)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_writes_what_was_tracked(video: Path, marks: Path, tmp_path: Path, number: int) -> None:
    """A whole process, which sends itself the signal before the fourth frame, Ctrl-C also as a background job."""
    first = "signal.signal(signal.SIGINT, signal.default_int_handler)"
    done = _in_a_process(first, f"if frame.index == 3: os.kill(os.getpid(), {int(number)})", video, marks, tmp_path)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert len(Track.read(tmp_path / "out.csv")) == 3


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("more", [1, 2])
def test_a_second_signal_does_not_stop_the_writing_and_a_third_does(
    video: Path, marks: Path, tmp_path: Path, more: int
) -> None:
    """Impatient users press Ctrl-C twice, and some programs pass on to others what the terminal has sent to both."""
    code = (
        "import os, signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from mien.cli import main\nfrom mien.output.track import Track\n"
        "from mien.tracking.realtime import RealtimeTracker\n"
        "original, save = RealtimeTracker.track, Track.save\n"
        "def track(self, frame):\n"
        "    if frame.index == 3: os.kill(os.getpid(), signal.SIGINT)\n"
        "    return original(self, frame)\n"
        "def save_meanwhile(self, path):\n"
        f"    for _ in range({more}): os.kill(os.getpid(), signal.SIGTERM)\n"
        "    return save(self, path)\n"
        "RealtimeTracker.track, Track.save = track, save_meanwhile\nmain()\n"
    )
    command = [sys.executable, "-c", code, "track", str(video), "-o", "out.csv", "--landmarks", str(marks)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert "mien: stopping, and writing what there is; once more" in done.stderr
    assert (tmp_path / "out.csv").exists() == (more == 1)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_nohup_keeps_it_going(video: Path, marks: Path, tmp_path: Path) -> None:
    """nohup starts a program with the signal of a closed terminal ignored."""
    first = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    done = _in_a_process(first, "os.kill(os.getpid(), signal.SIGHUP)", video, marks, tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(Track.read(tmp_path / "out.csv")) == 6


@pytest.mark.skipif(sys.platform == "win32", reason="file descriptors of POSIX")
def test_without_standard_streams(video: Path, tmp_path: Path) -> None:
    """As a program starts it that has no terminal; the face is found by the real detector, whose log is silenced."""
    code = "import os\nfor number in range(3): os.close(number)\nfrom mien.cli import main\nmain()\n"
    command = [sys.executable, "-c", code, "track", str(video), "-o", "out.csv"]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0
    assert len(Track.read(tmp_path / "out.csv")) == 6


def test_where_there_is_no_terminal_nothing_but_messages_is_printed(
    mien: Command, video: Path, marks: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before version 14.3 Rich ends even a bar that is disabled with an empty line."""
    monkeypatch.setattr("rich.progress.Progress.stop", lambda self: print(file=sys.stderr))
    assert mien("track", video, "--landmarks", marks, "--end", "0.01").err == ""
    with jobs_bar("looking for videos", quiet=False) as progress:
        progress(1, 1, "in.mkv")
    assert capsys.readouterr().err == ""


def test_on_a_terminal_messages_have_lines_of_their_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # for Rich, a terminal
    monkeypatch.setenv("TERM", "xterm")
    with frames_bar(quiet=False), warnings.catch_warnings():
        cli._common()
        warn("in.mkv: the face is turned")
    lines = [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line) for line in capsys.readouterr().err.splitlines()]
    assert "mien: in.mkv: the face is turned" in lines, lines
