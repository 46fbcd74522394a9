"""The pipeline from Python, with a tracker that does next to nothing."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import BaseModel
from threadpoolctl import threadpool_info, threadpool_limits

import mien
from mien.arrays import Array, Pixels
from mien.config import RealtimeSettings
from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp
from mien.graphics import Graphics
from mien.initialization.landmarks import VERTICES, Landmarks, Point
from mien.output.destination import Destination
from mien.output.recorder import Recorder
from mien.pipeline import passes, run
from mien.pipeline import track as pipeline
from mien.pipeline.landmarks import write_first_frame
from mien.start import first_frame
from mien.start.footage import Footage
from mien.tracking.state import Estimate, Status
from mien.video import open_video
from own_trackers import use_tracker
from small_motion import face
from videos import Device, portrait_images, write_images, write_video


class StillTracker:
    """Says that the face looks into the camera; loses it in the frames whose index is in `lost`."""

    lost: tuple[int, ...] = ()
    rotation = FACING

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        self.landmarks, self.camera = landmarks, camera
        return self._estimate(frame, Status.INITIALIZED)

    def track(self, frame: Frame) -> Estimate:
        if frame.index in self.lost:
            return Estimate.lost(frame, "it was told to")
        return self._estimate(frame, Status.TRACKED)

    def _estimate(self, frame: Frame, status: Status) -> Estimate:
        return Estimate(frame.index, frame.time, status, self.rotation, np.array([0.0, 0.0, 9.0]), confidence=0.5)


@pytest.fixture
def tracker(monkeypatch: pytest.MonkeyPatch) -> StillTracker:
    tracker = StillTracker()
    use_tracker(monkeypatch, lambda name: tracker)
    return tracker


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_images(tmp_path / "images", portrait_images())


def test_run_gives_each_frame_with_its_estimate(folder: Path) -> None:
    begin = first_frame.prepare(Footage(open_video(folder)), face().landmarks)
    pairs = list(run.run(StillTracker(), begin))
    assert [frame.index for frame, _ in pairs] == [estimate.index for _, estimate in pairs] == list(range(6))
    assert [estimate.status for _, estimate in pairs] == [Status.INITIALIZED, *[Status.TRACKED] * 5]


def test_a_folder_of_images_gives_a_row_for_each_frame(tracker: StillTracker, folder: Path) -> None:
    tracker.lost = (2,)
    track = mien.track(folder, landmarks=face().landmarks)
    assert track.status == ["initialized", "tracked", "lost", "tracked", "tracked", "tracked"]
    np.testing.assert_allclose(track.time, np.arange(6) / 25, atol=1e-6)
    assert track.metadata["video"]["width"] == 320
    assert "settings" not in track.metadata


@pytest.mark.parametrize(("method", "frame"), [("initialize", 0), ("track", 1)])
@pytest.mark.parametrize("returned", [None, (FACING, np.zeros(3))])
def test_a_tracker_that_returns_no_estimate_is_named(
    method: str, frame: int, returned: object, tracker: StillTracker, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracker, method, lambda *_: returned)
    message = rf":StillTracker returned {type(returned).__name__} for frame {frame}; its initialize and track must"
    with pytest.raises(MienError, match=message):
        mien.track(folder, landmarks=face().landmarks)


@pytest.mark.parametrize("method", ["initialize", "track"])
def test_a_tracker_does_not_end_the_program(
    method: str, tracker: StillTracker, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracker, method, lambda *_: sys.exit(0))
    with pytest.raises(MienError, match=r":StillTracker called sys\.exit\(0\); a tracker must not"):
        mien.track(folder, landmarks=face().landmarks)


def test_frames_of_a_program_are_tracked_until_it_fails(tracker: StillTracker, tmp_path: Path) -> None:
    def frames() -> Iterator[Frame]:
        for index, image in enumerate(portrait_images()):
            yield Frame(image, index, index / 30)
        raise OSError("the camera was unplugged")

    with pytest.raises(OSError, match="unplugged"), pytest.warns(MienWarning, match="stopped after 6 frames"):
        mien.track(frames(), landmarks=face().landmarks, save=tmp_path / "out")
    track = mien.Track.read(tmp_path / "out.csv")
    np.testing.assert_allclose(track.time, np.arange(6) / 30, atol=1e-6)
    assert track.metadata["video"]["name"] == "the frames"
    assert track.metadata["video"]["fps"] is None  # nobody has said it
    assert track.metadata["stopped"] == "OSError: the camera was unplugged"


def test_a_warning_that_is_made_an_error_does_not_hide_what_has_ended_the_track(
    tracker: StillTracker, tmp_path: Path
) -> None:
    def frames() -> Iterator[Frame]:
        yield Frame(portrait_images()[0])
        raise KeyboardInterrupt

    with warnings.catch_warnings():
        warnings.simplefilter("error", MienWarning)
        with pytest.raises(KeyboardInterrupt):
            mien.track(frames(), landmarks=face().landmarks, save=tmp_path / "out", plot=tmp_path / "out.png")
    assert len(mien.Track.read(tmp_path / "out.csv")) == 1
    assert (tmp_path / "out.png").exists()


def test_a_camera_is_free_again_though_the_error_that_ended_it_is_kept(
    tracker: StillTracker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Python and Jupyter keep the last one: else nothing could be tracked before it a second time."""
    device = Device(portrait_images())
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)

    def stop(estimate: Estimate, count: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as kept:
        mien.track(0, landmarks=face().landmarks, progress=stop)
    assert kept.tb is not None
    assert device.released


def test_a_camera_is_free_again_though_its_first_frame_was_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    device = Device(portrait_images())
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    with pytest.raises(MienError, match="lies outside the image") as kept:
        write_first_frame(0, tmp_path / "found.json", face=(1e4, 0))
    assert kept.tb is not None
    assert device.released


def test_what_a_camera_has_shown_until_it_failed_is_not_complete(
    tracker: StillTracker, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But it is where it was to end, as a video and what a program reads are where they end."""
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: Device(portrait_images()))
    with pytest.warns(MienWarning, match="no more images after"):
        known = mien.track(0, landmarks=face().landmarks).metadata
    assert not known["complete"]
    assert known["stopped"].startswith("camera 0 gives no more images after")
    ended = mien.track(0, landmarks=face().landmarks, end=1e-6)
    for track in (
        ended,
        *(mien.track(video, landmarks=face().landmarks) for video in (folder, iter(open_video(folder)))),
    ):
        assert track.metadata["complete"]
        assert track.metadata["warnings"] == []


@pytest.mark.parametrize(("pan_deg", "warned"), [(10, False), (25, True)])
def test_a_face_that_is_turned_in_the_first_frame_is_warned_of(
    pan_deg: float, warned: bool, tracker: StillTracker, folder: Path, recwarn: pytest.WarningsRecorder
) -> None:
    tracker.rotation = FACING @ exp(np.radians([0, pan_deg, 0]))
    track = mien.track(folder, landmarks=face().landmarks)
    assert ["turned by 25 degrees at 0.00 s" in str(w.message) for w in recwarn] == [True] * warned
    assert track.metadata["warnings"] == [str(w.message) for w in recwarn]


def test_numbers_do_not_depend_on_the_threads_of_a_program(tracker: StillTracker, folder: Path) -> None:
    """While a video is tracked, BLAS has one; the program then has its own again."""

    def threads() -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    counts: list[set[int]] = []
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        mien.track(folder, landmarks=face().landmarks, progress=lambda e, total: counts.append(threads()))
        assert threads() == before
    assert counts == [{1}] * 6


def test_progress_hears_of_every_frame(tracker: StillTracker, folder: Path) -> None:
    heard: list[tuple[int, int | None]] = []
    mien.track(folder, landmarks=face().landmarks, end=0.1, progress=lambda e, total: heard.append((e.index, total)))
    assert [index for index, _ in heard] == [0, 1, 2]
    assert {total for _, total in heard} == {3}


def test_an_overlay_is_drawn_for_trackers_without_a_mesh(tracker: StillTracker, folder: Path, tmp_path: Path) -> None:
    mien.track(folder, landmarks=face().landmarks, overlay=tmp_path / "o.mp4", plot=tmp_path / "p.svg")
    assert (tmp_path / "o.mp4").stat().st_size > 0
    assert (tmp_path / "p.svg").stat().st_size > 0


def test_a_head_is_refused_for_trackers_without_a_mesh(tracker: StillTracker, folder: Path, tmp_path: Path) -> None:
    """Before anything is tracked."""
    with pytest.raises(MienError, match=r"realtime fits no face model and has no head for .*head\.glb; omit that"):
        mien.track(folder, save=tmp_path / "out", gltf=tmp_path / "head.glb")
    assert list(tmp_path.iterdir()) == [folder]


def test_landmarks_are_those_of_the_file_to_the_last_digit(tracker: StillTracker, folder: Path, tmp_path: Path) -> None:
    """Detected landmarks are rounded before they are used, so that a run from NAME.json is the same run."""
    known = face().landmarks
    noisy = Landmarks(known.points + 1 / 3, known.scheme, None, source="test")
    mien.track(folder, landmarks=noisy, save=tmp_path / "out")
    used = tracker.landmarks.points
    mien.track(folder, landmarks=tmp_path / "out.json", save=tmp_path / "again")
    np.testing.assert_array_equal(tracker.landmarks.points, used)


def test_selection_of_frames_and_landmarks_of_another_time(tracker: StillTracker, folder: Path) -> None:
    with pytest.warns(MienWarning, match=r"0\.00 s and tracking begins at 0\.12 s; a start at 0\.0 s begins"):
        track = mien.track(folder, landmarks=face().landmarks, start=0.1)
    assert track.index.tolist() == [3, 4, 5]


def test_where_given_landmarks_belong_is_told_to_the_last_digit(tracker: StillTracker, tmp_path: Path) -> None:
    """A third of a second has no end in decimals: it must not be rounded past its frame."""
    video = write_video(tmp_path / "in.avi", portrait_images(), fps=3)
    marks = replace(face().landmarks, frame_index=2, time=2 / 3)
    with pytest.warns(MienWarning, match=r"begins at 1\.33 s; a start at 0\.666667 s begins where it belongs"):
        mien.track(video, landmarks=marks, start=1.2)
    track = mien.track(video, landmarks=marks, start=0.666667)
    assert track.index[track.status.index("initialized")] == track.index[0] == 2


@pytest.mark.parametrize("passes", [1, 2])
def test_progress_hears_of_the_search_for_a_face(passes: int, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    def third_frame(frames: Iterator[Frame], at: Point | None) -> tuple[Frame, list[Landmarks]]:
        frame = next(frame for frame in frames if frame.index == 2)
        assert heard == [(0, "lost"), (1, "lost")]  # while it is looked for
        return frame, [replace(face().landmarks, frame_index=2, time=frame.time)]

    heard: list[tuple[int, str]] = []
    use_tracker(monkeypatch, lambda name: PatientTracker())
    monkeypatch.setattr("mien.initialization.detector.first_with_a_face", third_frame)
    with pytest.warns(MienWarning, match="first found"):
        mien.track(folder, passes=passes, progress=lambda e, total: heard.append((e.index, e.status.value)))
    behind = list(enumerate(["initialized", "tracked", "tracked", "tracked"], start=2))
    backwards = [(1, "tracked"), (0, "tracked")]  # of which the first pass has told already
    assert heard == [(0, "lost"), (1, "lost"), *behind, *(backwards + behind) * (passes - 1)]


class Diary(StillTracker):
    """Writes down in which order it sees the frames, with a line for each beginning; stops at a frame."""

    def __init__(self, seen: list[list[int]], stops: int | None = None) -> None:
        self.seen, self.stops = seen, stops

    def again(self) -> Diary:
        return Diary(self.seen, self.stops)

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        self.seen.append([])
        return super().initialize(frame, landmarks, camera)

    def _estimate(self, frame: Frame, status: Status) -> Estimate:
        if frame.index == self.stops:
            raise KeyboardInterrupt
        self.seen[-1].append(frame.index)
        return replace(super()._estimate(frame, status), confidence=0.1 * len(self.seen))


def test_tracking_goes_both_ways_from_landmarks_of_a_later_frame(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    """Backwards first, so that what is learned there is known on the way on; rows are in the order of the video."""
    seen: list[list[int]] = []
    heard: list[int] = []
    use_tracker(monkeypatch, lambda name: Diary(seen))
    marks = replace(face().landmarks, frame_index=3, time=0.12)
    track = mien.track(folder, landmarks=marks, progress=lambda e, total: heard.append(e.index))
    assert seen == [[3, 2, 1, 0], [3, 4, 5]]
    assert heard == [2, 1, 0, 3, 4, 5]
    assert track.index.tolist() == list(range(6))
    assert track.status == ["tracked"] * 3 + ["initialized"] + ["tracked"] * 2
    np.testing.assert_allclose(track.confidence, [0.1, 0.1, 0.1, 0.2, 0.2, 0.2])


def test_tracking_begins_where_the_row_of_a_table_belongs(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    """Not before, where the face is elsewhere, if the table has no row of the first frame."""
    seen: list[list[int]] = []
    use_tracker(monkeypatch, lambda name: Diary(seen))
    points = face().camera.project(face().fit.in_camera())[0][VERTICES].ravel()
    names = [f"{axis}_{i}" for i in range(26) for axis in "xy"]
    lines = [",".join(["timestamp", *names])] + [",".join(map(str, [time, *points])) for time in (0.08, 0.12)]
    (tmp_path / "marks.csv").write_text("\n".join(lines))
    track = mien.track(folder, landmarks=tmp_path / "marks.csv", camera=face().camera)
    assert seen == [[2, 1, 0], [2, 3, 4, 5]]
    assert (track.metadata["landmarks"]["frame"], track.metadata["landmarks"]["time"]) == (2, 0.08)


def test_a_face_that_was_not_there_long_before_the_first_frame_is_not_looked_for(
    tracker: StillTracker, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "_FACELESS_SECONDS", 0.05)
    tracker.lost = (0, 1, 2, 3)
    marks = replace(face().landmarks, frame_index=5, time=0.2)
    track = mien.track(folder, landmarks=marks)
    reasons = [*["tracking begins later"] * 2, *["it was told to"] * 2, None, None]
    assert track.table.column("reason").to_pylist() == reasons


def test_the_mesh_is_drawn_on_what_comes_before_the_first_frame(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    class Fitted(Diary):
        settings = RealtimeSettings()

        def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
            self.fit = face().fit
            return super().initialize(frame, landmarks, camera)

        def again(self) -> Fitted:
            return Fitted(self.seen)

        def mesh(self, estimate: Estimate) -> None:
            drawn.append(estimate.index)

    drawn: list[int] = []
    use_tracker(monkeypatch, lambda name: Fitted([]))
    marks = replace(face().landmarks, frame_index=3, time=0.12)
    mien.track(folder, landmarks=marks, overlay=tmp_path / "out.mp4")
    assert drawn == list(range(6))


def test_stopped_on_the_way_back_the_rows_are_kept(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    use_tracker(monkeypatch, lambda name: Diary([], stops=0))
    marks = replace(face().landmarks, frame_index=3, time=0.12)
    with pytest.warns(MienWarning, match="stopped after 2 frames"), pytest.raises(KeyboardInterrupt):
        mien.track(folder, landmarks=marks, save=tmp_path / "out")
    kept = mien.Track.read(tmp_path / "out")
    assert kept.index.tolist() == [1, 2]
    assert not kept.metadata["complete"]


def assert_all_rows_are_kept_on_the_way_back(folder: Path, out: Path) -> None:
    """With a tracker that is interrupted there."""
    marks = replace(face().landmarks, frame_index=3, time=0.12)
    with pytest.warns(MienWarning, match="stopped after 3 frames"), pytest.raises(KeyboardInterrupt):
        mien.track(folder, landmarks=marks, save=out)
    assert mien.Track.read(out).index.tolist() == [0, 1, 2]


def test_stopped_while_the_way_back_is_drawn_all_rows_are_kept(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    @contextmanager
    def drawing(*_: Any) -> Iterator[Callable[[Frame, Estimate, Any], None]]:
        def draw(frame: Frame, estimate: Estimate, tracker: Any) -> None:
            if frame.index == 1:
                raise KeyboardInterrupt

        yield draw

    use_tracker(monkeypatch, lambda name: Diary([]))
    monkeypatch.setattr(passes, "drawing", drawing)
    assert_all_rows_are_kept_on_the_way_back(folder, tmp_path / "out")


def test_stopped_while_a_row_of_the_way_back_is_recorded_it_is_there_once(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    def add(recorder: Recorder, estimate: Estimate) -> None:
        recorded(recorder, estimate)
        if estimate.index == 1:
            monkeypatch.setattr(Recorder, "add", recorded)
            raise KeyboardInterrupt

    recorded = Recorder.add
    use_tracker(monkeypatch, lambda name: Diary([]))
    monkeypatch.setattr(Recorder, "add", add)
    assert_all_rows_are_kept_on_the_way_back(folder, tmp_path / "out")


def test_stopped_after_the_last_frame_all_rows_are_kept(
    tracker: StillTracker, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a large file is read for its checksum, which is then not begun again."""

    def checksum(path: Path) -> str:
        read.append(path)
        raise KeyboardInterrupt

    read: list[Path] = []
    monkeypatch.setattr("mien.start.footage.checksum", checksum)
    with pytest.warns(MienWarning, match="stopped after 6 frames"), pytest.raises(KeyboardInterrupt):
        mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out")
    assert read == [folder]
    kept = mien.Track.read(tmp_path / "out")
    assert len(kept) == 6
    assert (kept.metadata["complete"], kept.metadata["video"]["sha256"]) == (False, None)


def test_stopped_while_the_files_are_written_they_are_written_all_the_same(
    tracker: StillTracker, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(table: Any, path: Path) -> None:
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr("mien.output.track.write_parquet", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out", plot=tmp_path / "out.png")
    kept = mien.Track.read(tmp_path / "out.parquet")
    assert (len(kept), kept.metadata["complete"]) == (6, True)
    assert (tmp_path / "out.png").exists()


def test_the_window_shows_every_frame_also_before_there_is_a_face(
    tracker: StillTracker, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Window(nullcontext[Any]):
        def __init__(self, title: str) -> None:
            super().__init__(self)

        def show(self, pixels: Pixels) -> None:
            shown.append(pixels)

    def find_face(
        frames: Iterator[Frame], video: Any, without_face: Callable[[Frame], None], *_: Any
    ) -> tuple[Frame, Landmarks]:
        without_face(next(frames))
        first = next(frames)
        return first, replace(face().landmarks, frame_index=first.index, time=first.time)

    shown: list[Pixels] = []
    monkeypatch.setattr(pipeline, "Window", Window)
    monkeypatch.setattr(pipeline, "require_screen", lambda: None)
    monkeypatch.setattr(first_frame, "find_face", find_face)
    frames = list(open_video(folder))
    track = mien.track(iter(frames), show=True)
    assert track.index.tolist() == list(range(6))
    assert len(shown) == 6
    assert len({picture.shape for picture in shown}) == 1


def test_a_list_of_frames_is_tracked_like_a_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Back from where the face is learned, and twice if asked."""
    use_tracker(monkeypatch, lambda name: PatientTracker())
    marks = replace(face().landmarks, frame_index=3, time=0.12)
    frames = list(open_video(folder))
    tables = [mien.track(video, landmarks=marks, passes=2).table for video in (folder, frames)]
    assert tables[0].equals(tables[1])
    assert None not in tables[1].column("pose_Rx").to_pylist()


@pytest.mark.parametrize(
    ("pan_deg", "disagreement", "warned"),
    [(0, None, ""), (0, 0.0027, ""), (0, 0.005, "cover a part of the face at 0.00 s"), (25, 0.005, "turned by 25")],
)
def test_a_face_that_is_covered_in_the_first_frame_is_warned_of(
    pan_deg: float,
    disagreement: float | None,
    warned: str,
    tracker: StillTracker,
    folder: Path,
    recwarn: pytest.WarningsRecorder,
) -> None:
    tracker.rotation = FACING @ exp(np.radians([0, pan_deg, 0]))
    mien.track(folder, landmarks=replace(face().landmarks, disagreement=disagreement))
    assert [warned in str(w.message) for w in recwarn] == [True] * bool(warned)


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize(("time", "first"), [(0.5, 3), (0.499, 3), (0.43, 2), (0.46, 3), (0.1, 1), (0.51, 3)])
def test_landmarks_belong_to_the_frame_that_is_nearest_in_time(
    time: float, first: int, at_once: bool, tracker: StillTracker
) -> None:
    """However irregular the times of the video are."""
    stamps = (0.0, 0.1, 0.4, 0.5, 3.0, 6.0)
    frames = [Frame(image, k, t) for k, (image, t) in enumerate(zip(portrait_images(), stamps, strict=True))]
    marks = replace(face().landmarks, frame_index=first, time=time)
    track = mien.track(frames if at_once else iter(frames), landmarks=marks)
    assert track.status.index("initialized") == first
    assert track.index.tolist() == list(range(6))


def test_frames_before_the_given_landmarks_have_rows_as_of_a_file(tracker: StillTracker, folder: Path) -> None:
    marks = replace(face().landmarks, frame_index=3, time=0.12)
    track = mien.track(iter(list(open_video(folder))), landmarks=marks)
    assert track.index.tolist() == list(range(6))
    assert track.table.column("reason").to_pylist() == [*["tracking begins later"] * 3, None, None, None]


class WiserTracker(StillTracker):
    """Knows in the end that all it has told was turned."""

    def __init__(self, stops: bool = False) -> None:
        self.stops = stops

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        self.axes = SimpleNamespace(R_model_head=np.eye(3), report_anew=lambda: exp(np.array([0.0, 0.05, 0.0])))
        return super().initialize(frame, landmarks, camera)

    def track(self, frame: Frame) -> Estimate:
        if self.stops and frame.index == 4:
            raise KeyboardInterrupt
        return super().track(frame)


class WithAxes(StillTracker):
    """A tracker of one's own whose attribute `axes` means something else, with a setting that JSON does not know."""

    class Own(BaseModel):
        patience: float = float("inf")

    axes = ("x", "y", "z")
    settings = Own()


def test_a_tracker_of_ones_own_may_have_axes_of_another_kind(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    use_tracker(monkeypatch, lambda name: WithAxes())
    mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out")
    assert mien.Track.read(tmp_path / "out").metadata["settings"] == {"patience": None}


@pytest.mark.parametrize(
    ("known", "then"), [(False, "this tracker takes them for it"), (True, "they are painted over")]
)
def test_graphics_before_the_face_are_warned_of(
    known: bool, then: str, tracker: StillTracker, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if known:
        monkeypatch.setattr(StillTracker, "graphics", None, raising=False)
    graphics = Graphics(320, 240, 100, 90, np.ones((20, 30), dtype=bool))
    with pytest.warns(MienWarning, match=f"stand still before the face; {then}"):
        mien.track(folder, landmarks=replace(face().landmarks, graphics=graphics))


def test_landmarks_and_options_may_have_numbers_of_numpy(tracker: StillTracker, folder: Path, tmp_path: Path) -> None:
    marks = replace(face().landmarks, frame_index=np.int64(0), time=np.float32(0))
    given: dict[str, Any] = {"at_once": np.bool_(True), "end": np.float32(100), "passes": np.int64(1)}
    assert len(mien.track(folder, landmarks=marks, **given, save=tmp_path / "out")) == 6


@pytest.mark.parametrize("stops", [False, True])
def test_all_rotations_are_told_as_they_are_known_in_the_end(
    stops: bool, monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    use_tracker(monkeypatch, lambda name: WiserTracker(stops))
    marks = face().landmarks
    if stops:
        with pytest.warns(MienWarning, match="stopped after 4 frames"), pytest.raises(KeyboardInterrupt):
            mien.track(folder, landmarks=marks, save=tmp_path / "out")
    else:
        mien.track(folder, landmarks=marks, save=tmp_path / "out")
    kept = mien.Track.read(tmp_path / "out")
    np.testing.assert_allclose(np.radians(kept.euler_deg), [[0.0, 0.05, 0.0]] * (4 if stops else 6), atol=1e-6)


def test_stopped_while_rotations_are_corrected_they_are_corrected_once(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    class OnceTracker(StillTracker):
        def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
            told = iter([exp(np.array([0.0, 0.05, 0.0]))])
            self.axes = SimpleNamespace(R_model_head=np.eye(3), report_anew=lambda: next(told, np.eye(3)))
            return super().initialize(frame, landmarks, camera)

    def interrupted(track: mien.Track, R: Array) -> mien.Track:
        monkeypatch.undo()
        raise KeyboardInterrupt

    use_tracker(monkeypatch, lambda name: OnceTracker())
    monkeypatch.setattr(mien.Track, "turned", interrupted)
    with pytest.warns(MienWarning, match="stopped after 6 frames"), pytest.raises(KeyboardInterrupt):
        mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out")
    kept = mien.Track.read(tmp_path / "out")
    np.testing.assert_allclose(np.radians(kept.euler_deg), [[0.0, 0.05, 0.0]] * 6, atol=1e-6)


class PatientTracker(StillTracker):
    """Knows how often it has begun."""

    def __init__(self, turn: int = 1, stops: BaseException | None = None) -> None:
        self.turn, self.stops = turn, stops

    def again(self) -> PatientTracker:
        return PatientTracker(self.turn + 1, self.stops)

    def _estimate(self, frame: Frame, status: Status) -> Estimate:
        if self.stops and self.turn > 1 and frame.index == 3:
            raise self.stops
        return replace(super()._estimate(frame, status), confidence=0.25 * self.turn)


def test_the_second_pass_begins_with_what_the_first_has_learned(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    use_tracker(monkeypatch, lambda name: PatientTracker())
    heard: list[tuple[int, int | None]] = []
    track = mien.track(
        folder,
        landmarks=face().landmarks,
        passes=2,
        save=tmp_path / "out",
        progress=lambda e, total: heard.append((e.index, total)),
    )
    assert heard == [(index, 12) for index in (*range(6), *range(6))]
    assert track.table["confidence"].to_pylist() == [0.5] * 6
    assert mien.Track.read(tmp_path / "out").metadata["passes"] == 2


@pytest.mark.parametrize(
    ("first", "stops", "drawn"),
    [(0, KeyboardInterrupt(), True), (0, OSError(), False), (4, KeyboardInterrupt(), False)],
)
def test_stopped_in_the_second_pass_the_first_is_kept(
    first: int, stops: BaseException, drawn: bool, monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    """The overlay is that of the second, as far as it was drawn: not at all where it was stopped on the way back."""
    use_tracker(monkeypatch, lambda name: PatientTracker(stops=stops))
    marks = replace(face().landmarks, frame_index=first, time=first / 25)
    overlay = tmp_path / "out.mp4"
    message = "holds the first" + r", and .*out\.mp4 ends where it was stopped" * drawn + "$"
    with pytest.warns(MienWarning, match=f"stopped in the second pass; .* {message}"), pytest.raises(type(stops)):
        mien.track(folder, landmarks=marks, passes=2, save=tmp_path / "out", overlay=overlay)
    assert overlay.exists() == drawn
    kept = mien.Track.read(tmp_path / "out")
    assert kept.table["confidence"].to_pylist()[:4] == [0.25] * 4
    assert kept.metadata["complete"]
    assert kept.metadata["passes"] == 1


def test_passes_that_cannot_be_had_are_refused(tracker: StillTracker, folder: Path) -> None:
    with pytest.raises(MienError, match="learns nothing"):
        mien.track(folder, landmarks=face().landmarks, passes=2)
    for wrong in (0, 3):
        with pytest.raises(MienError, match=f"passes is {wrong}"):
            mien.track(folder, landmarks=face().landmarks, passes=wrong)


def test_an_error_on_the_way_keeps_the_rows_and_says_so(
    tracker: StillTracker, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(frame: Frame) -> Estimate:
        if frame.index == 4:
            raise ZeroDivisionError("a bug")
        return Estimate(frame.index, frame.time, Status.TRACKED, FACING)

    monkeypatch.setattr(tracker, "track", fail)
    with pytest.warns(MienWarning, match="stopped after 4 frames"), pytest.raises(ZeroDivisionError):
        mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out.csv")
    assert len(mien.Track.read(tmp_path / "out.csv")) == 4
    assert json.loads((tmp_path / "out.json").read_text())["stopped"] == "ZeroDivisionError: a bug"


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_a_stopped_track_names_an_overlay_only_where_there_is_one(
    error: type[BaseException], tracker: StillTracker, folder: Path, tmp_path: Path
) -> None:
    """That of what fails is discarded."""

    def stop(estimate: Estimate, count: int | None) -> None:
        if estimate.index == 4:
            raise error

    files = {"save": tmp_path / "out.csv", "overlay": tmp_path / "out.mp4"}
    with pytest.warns(MienWarning, match="stopped after 5 frames"), pytest.raises(error):
        mien.track(folder, landmarks=face().landmarks, progress=stop, **files)
    named = json.loads((tmp_path / "out.json").read_text())["overlay"]
    assert (named is not None) == (tmp_path / "out.mp4").exists() == (error is KeyboardInterrupt)


def test_stopped_before_there_is_a_head_to_write_it_says_so_and_where_the_rows_are(
    tracker: StillTracker, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(frame: Frame) -> Estimate:
        raise KeyboardInterrupt

    monkeypatch.setattr(tracker, "mesh", lambda estimate: None, raising=False)
    monkeypatch.setattr(tracker, "track", interrupted)
    with pytest.warns(MienWarning) as warned, pytest.raises(KeyboardInterrupt):
        mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out", gltf=tmp_path / "out.glb")
    said = [str(warning.message) for warning in warned]
    assert len(said) == 2
    assert said[0].startswith("stopped after 1 frames, which are in ")
    assert "out.glb: the track has no mesh" in said[1]
    assert len(mien.Track.read(tmp_path / "out")) == 1
    assert not (tmp_path / "out.glb").exists()


def test_what_is_no_input_is_named(tracker: StillTracker, folder: Path) -> None:
    marks: Any = face().landmarks
    wrong: list[tuple[Any, dict[str, Any], str]] = [
        (folder, {"landmarks": marks.points}, r"landmarks are .*ndarray"),
        (folder, {"face": (1, 2, 3)}, r"face is \(1, 2, 3\)"),
        (folder, {"landmarks": marks, "camera": {"focal_px": 1}}, "the camera is .*dict"),
        (folder, {"landmarks": marks, "start": "1"}, "start is '1'"),
        (folder, {"landmarks": marks, "passes": 2.0}, "passes is 2.0; give 1 or 2"),
        (np.zeros((2, 2)), {"landmarks": marks}, "a video is a file, .*ndarray"),
        ("", {"landmarks": marks}, "the name of the video is empty"),
    ]
    for video, how, words in wrong:
        with pytest.raises(MienError, match=words):
            mien.track(video, **how)


def test_a_further_face_of_an_earlier_run_is_warned_of(tracker: StillTracker, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "out.face1.csv").write_text("")
    with pytest.warns(MienWarning, match=r"out\.face1\.csv is left from an earlier run; this one has 1 face$"):
        mien.track(folder, landmarks=face().landmarks, save=tmp_path / "out")


def test_all_further_faces_of_an_earlier_run_are_named(tmp_path: Path) -> None:
    """In the order of their numbers, also where one between has been removed; not those of another table."""
    for name in ("out.face1", "out.face2", "out.face10", "out.face4", "about.face5", "out.face3.face6"):
        (tmp_path / f"{name}.csv").touch()
    with pytest.warns(MienWarning) as told:
        Destination(tmp_path / "out.csv").warn_if_stale(2)
    left = ", ".join(str(tmp_path / f"out.face{k}.csv") for k in (2, 4, 10))
    assert [str(one.message) for one in told] == [f"{left} are left from an earlier run; this one has 2 faces"]


def test_outputs_never_replace_inputs_or_each_other(tracker: StillTracker, tmp_path: Path) -> None:
    video = write_video(tmp_path / "in.mp4", portrait_images(2), codec="libx264", pix_fmt="yuv420p")
    before = video.read_bytes()
    with pytest.raises(MienError, match=r"in\.mp4 would overwrite an input"):
        mien.track(video, landmarks=face().landmarks, overlay=tmp_path / "x" / ".." / "in.mp4")
    assert video.read_bytes() == before
