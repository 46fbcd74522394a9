"""Where tracking begins: a face is learned in the frame of its first seconds that shows it best."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mien
from long_motion import NOISE_SD
from mien.arrays import Array
from mien.errors import MienError, MienWarning, require
from mien.frame import Frame
from mien.geometry.camera import Camera, line_of_sight
from mien.geometry.rotation import FACING, angle_between, matrix_from_euler
from mien.initialization import detector as mien_detector
from mien.initialization.fit import FirstFrame, fit_first_frame, turned_deg
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import Landmarks, Point, place_of, rows_by_name, rows_of_scheme
from mien.initialization.upright import Upright
from mien.start import live_search, search
from mien.start.first_frame import prepare
from mien.start.footage import Footage
from mien.synthetic import FPS, SyntheticSequence, make_sequence, moved
from mien.tracking.state import Status
from mien.video import open_video
from small_motion import face, small_motion
from videos import write_video

PANS_DEG = np.concatenate([np.linspace(34, 0, 16), np.linspace(0, -15, 8)])


@pytest.fixture(scope="module")
def turning() -> SyntheticSequence:
    """A face that is turned by 34 degrees, looks into the camera, and turns to the other side."""
    angles = np.outer(PANS_DEG, [0, 1, 0])
    return make_sequence(face(), moved(face(), angles, 0 * angles, np.zeros((len(angles), 6))), noise_sd=NOISE_SD)


@pytest.fixture
def video(turning: SyntheticSequence, tmp_path: Path) -> Path:
    return write_video(tmp_path / "turning.mkv", [frame.pixels for frame in turning.frames])


@pytest.fixture
def detector(monkeypatch: pytest.MonkeyPatch, turning: SyntheticSequence) -> set[int]:
    """One that finds the true landmarks, but not in the frames of this set, which a test fills."""
    hidden: set[int] = set()
    _detect_in(turning, hidden, monkeypatch)
    return hidden


def _detect_in(sequence: SyntheticSequence, hidden: set[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the detector find the true landmarks of a sequence, but not in the frames that are hidden."""

    def seen(frame: Frame) -> Landmarks:
        return _true_look(sequence, frame.index)

    def first_with_a_face(frames: Iterable[Frame], at: Point | None) -> tuple[Frame, list[Landmarks]]:
        return next((frame, [seen(frame)]) for frame in frames)

    def follow(face: Landmarks, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Landmarks]]:
        yield from ((frame, seen(frame)) for frame in frames if frame.index not in hidden)

    monkeypatch.setattr("mien.initialization.detector.first_with_a_face", first_with_a_face)
    monkeypatch.setattr("mien.initialization.detector.follow", follow)
    monkeypatch.setattr("mien.initialization.detector.detect", lambda frame, at: [seen(frame)])
    monkeypatch.setattr(
        "mien.initialization.detector.detect_once",
        lambda frame, at, distant: [] if frame.index in hidden else [seen(frame)],
    )
    monkeypatch.setattr("mien.initialization.detector.refine", lambda frame, face: face)
    monkeypatch.setattr(search, "DETECTION_INTERVAL", 0.2)


def _true_look(sequence: SyntheticSequence, index: int) -> Landmarks:
    """What a perfect detector would find in a frame: MediaPipe's points that are vertices, and the others in the
    middle."""
    vertices, rows = rows_of_scheme("mediapipe478")
    relative = face().fit.vertices(sequence.animation[index])[vertices] @ sequence.R[index].T
    posed, camera = relative + sequence.t[index], face().camera
    points, depths = np.tile(camera.project(posed.mean(axis=0))[0], (478, 1)), np.zeros(478)
    points[rows] = camera.project(posed)[0][:, None]
    depths[rows] = (relative @ line_of_sight(points, camera) * camera.focal_px / sequence.t[index, 2])[:, None]
    return Landmarks(points, "mediapipe478", depths, index, index / FPS, "detected face")


def _errors_deg(track: mien.Track, truth: SyntheticSequence) -> Array:
    """(n,) angle in degrees between a track's rotations and the true ones, head axes aligned to these."""
    R = np.stack([matrix_from_euler(angles) for angles in np.radians(track.euler_deg)])
    D = np.swapaxes(truth.R @ FACING, 1, 2) @ R
    U, _, Vt = np.linalg.svd(D.mean(axis=0))
    return np.asarray(np.degrees(angle_between(D, U @ Vt)))


def test_a_face_that_is_turned_is_learned_where_it_looks_into_the_camera(detector: set[int], video: Path) -> None:
    begin = prepare(Footage(open_video(video), face().camera))
    assert begin.first.index == begin.landmarks.frame_index == 15
    assert begin.since == 0
    assert [frame.index for frame in begin.frames] == list(range(len(PANS_DEG)))


def test_the_best_look_is_taken_where_none_is_good(detector: set[int], video: Path) -> None:
    detector.update(range(11, 24))
    assert prepare(Footage(open_video(video), face().camera)).first.index == 10


def test_a_blurred_look_is_left_for_one_that_is_turned_a_little(
    detector: set[int], turning: SyntheticSequence, tmp_path: Path
) -> None:
    pictures = [frame.pixels for frame in turning.frames]
    pictures[15] = np.asarray(cv2.GaussianBlur(pictures[15], (0, 0), 4), np.uint8)
    video = write_video(tmp_path / "blurred.mkv", pictures)
    assert prepare(Footage(open_video(video), face().camera)).first.index == 20


@pytest.mark.parametrize(
    ("covered", "start", "most", "index"),
    [
        ((15,), 0.0, 8, 20),  # a hand is before the mouth for a moment
        ((15,), 0.0, 1, 15),  # the best of those that are looked at
        ((), 0.36, 8, 14),
        (range(12, 24), 0.36, 8, 9),  # for good: as in the first frame, before it was
        (range(12), 0.36, 8, 14),
    ],
)
def test_a_covered_look_is_left_for_another(
    covered: Sequence[int],
    start: float,
    most: int,
    index: int,
    detector: set[int],
    turning: SyntheticSequence,
    video: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Copies of its frame show the landmarks at different places."""
    monkeypatch.setattr(search, "_MOST_REFINED", most)

    def refine(frame: Frame, face: Landmarks) -> Landmarks:
        return replace(face, disagreement=0.009 if frame.index in covered else 0.001)

    def first_with_a_face(frames: Iterable[Frame], at: Point | None) -> tuple[Frame, list[Landmarks]]:
        return next((frame, [refine(frame, _true_look(turning, frame.index))]) for frame in frames)

    monkeypatch.setattr("mien.initialization.detector.refine", refine)
    monkeypatch.setattr("mien.initialization.detector.first_with_a_face", first_with_a_face)
    assert prepare(Footage(open_video(video), face().camera, start=start)).first.index == index


def test_a_look_that_copies_do_not_confirm_is_left(
    detector: set[int], video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mien.initialization.detector.refine", lambda frame, face: None if frame.index == 15 else face)
    assert prepare(Footage(open_video(video), face().camera)).first.index == 20


@pytest.mark.parametrize(("search_s", "index"), [(60.0, 15), (0.3, 5)])
def test_a_face_is_looked_at_until_it_looks_into_the_camera(
    search_s: float, index: int, detector: set[int], video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does at 0.6 s; but not for ever. Everything since the first frame is tracked."""
    monkeypatch.setattr(search, "_SEARCH_SECONDS", search_s)
    monkeypatch.setattr(search, "_LOOK_SECONDS", 0.1)
    begin = prepare(Footage(open_video(video), face().camera))
    assert begin.first.index == index
    assert begin.since == 0


def test_a_look_that_is_hardly_better_is_not_worth_it(detector: set[int], video: Path) -> None:
    detector.update(range(19))
    assert prepare(Footage(open_video(video), face().camera, start=0.48)).first.index == 12


@pytest.mark.parametrize("first_deg", [0.0, 30.0])
def test_graphics_before_the_face_are_found_and_kept_with_its_landmarks(
    first_deg: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Be it learned in the first frame or in a later one."""
    shift = np.outer(np.sin(np.arange(40) / 6), [0.2, 0.1, 0.0])
    angles = np.outer(np.clip(1 - np.arange(40) / 10, 0, 1), [0.0, first_deg, 0.0])
    moving = make_sequence(face(), moved(face(), angles, shift, np.zeros((40, 6))), noise_sd=NOISE_SD)
    _detect_in(moving, set(), monkeypatch)
    (x, y), size = (np.asarray(value, int) for value in place_of(face().landmarks.points))
    corner, other = (int(x - size // 6), int(y - size // 8)), (int(x + size // 6), int(y + size // 8))
    pictures = [cv2.rectangle(frame.pixels.copy(), corner, other, (10, 40, 160), -1) for frame in moving.frames]
    begin = prepare(Footage(open_video(write_video(tmp_path / "logo.mkv", pictures)), face().camera))
    assert (begin.first.index == 0) == (first_deg == 0)
    found = begin.landmarks.graphics
    assert found is not None
    assert found.x <= corner[0] < other[0] < found.x + found.mask.shape[1]
    assert found.y <= corner[1] < other[1] < found.y + found.mask.shape[0]
    write_landmarks(tmp_path / "logo.json", begin.landmarks)
    again = read_landmarks(tmp_path / "logo.json").graphics
    assert again is not None
    assert (again.x, again.y) == (found.x, found.y)
    np.testing.assert_array_equal(again.mask, found.mask)


def test_looks_that_copies_do_not_confirm_count_too(
    detector: set[int], video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def refine(frame: Frame, face: Landmarks) -> None:
        tried.append(frame.index)

    monkeypatch.setattr("mien.initialization.detector.refine", refine)
    monkeypatch.setattr(search, "_MOST_REFINED", 2)
    assert prepare(Footage(open_video(video), face().camera)).first.index == 0
    assert len(tried) == 2


@pytest.mark.parametrize(("rate", "fps"), [(25.0, 25.0), (25.0, 1000.0), (25.0, 1.0), (30.0, 29.97)])
def test_frames_are_sampled_by_their_time_and_not_by_the_rate_that_a_file_states(rate: float, fps: float) -> None:
    frames = [Frame(np.full((8, 8, 3), 100, np.uint8), k, k / rate) for k in range(40)]
    sampled = search.sampled_frames(Footage(Live(frames, repeatable=True, fps=fps), face().camera))
    step = round(0.5 * rate)
    assert [frame.index for _, frame in sampled] == list(range(0, 40, step))


def test_after_a_gap_sampling_goes_on() -> None:
    frames = [Frame(np.full((8, 8, 3), 100, np.uint8), k, t) for k, t in enumerate([0.0, 0.1, 3.0, 3.1, 3.4, 3.5])]
    sampled = search.sampled_frames(Footage(Live(frames, repeatable=True), face().camera))
    assert [frame.index for _, frame in sampled] == [0, 2, 4]


def test_what_is_behind_the_end_is_not_looked_at(detector: set[int], video: Path) -> None:
    assert prepare(Footage(open_video(video), face().camera, end=0.5)).first.index == 10


def test_what_is_behind_a_cut_is_not_looked_at(detector: set[int], turning: SyntheticSequence, tmp_path: Path) -> None:
    """Who is there may be somebody else."""
    pictures = [frame.pixels if k < 12 else 255 - frame.pixels for k, frame in enumerate(turning.frames)]
    video = write_video(tmp_path / "cut.mkv", pictures)
    assert prepare(Footage(open_video(video), face().camera)).first.index == 10


def test_who_asks_for_it_begins_at_once(detector: set[int], video: Path, turning: SyntheticSequence) -> None:
    assert prepare(Footage(open_video(video), face().camera), at_once=True).first.index == 0
    assert prepare(Footage(Live(turning.frames), face().camera), at_once=True).first.index == 0


@pytest.mark.parametrize(("patience_s", "index"), [(3.0, 11), (0.15, 4)])
def test_a_camera_waits_a_while_for_the_face_to_look_into_it(
    patience_s: float, index: int, detector: set[int], turning: SyntheticSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_search, "_PATIENCE", patience_s)
    camera = Live(turning.frames)
    shown: list[str] = []
    with pytest.warns(MienWarning, match="a face is first found"):
        begin = prepare(Footage(camera, face().camera), show=lambda frame, estimate: shown.append(estimate.reason))
    assert begin.first.index == index
    assert begin.since == begin.first.time
    assert len(list(begin.frames)) == len(PANS_DEG) - index
    assert camera.shown == len(PANS_DEG)
    assert [(e.index, e.status) for e in begin.passed] == [(k, Status.LOST) for k in range(index)]
    assert {e.reason for e in begin.passed} == {"waiting for the face to look into the camera"}
    assert shown == [e.reason for e in begin.passed]


@pytest.mark.parametrize(("patience_s", "index"), [(3.0, 15), (0.5, 13)])
def test_a_camera_waits_a_while_for_open_eyes(
    patience_s: float, index: int, detector: set[int], turning: SyntheticSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As there is no going back to a frame before a blink, from which eyes could be learned."""
    shut = range(11, 15)

    def detect_once(frame: Frame, at: Point | None, distant: bool) -> list[Landmarks]:
        look = _true_look(turning, frame.index)
        if frame.index not in shut:
            return [look]
        rows, points = rows_by_name(look.scheme), look.points.copy()
        for side in ("right", "left"):
            points[rows[f"{side}_eyelid_upper_mid"]] = points[rows[f"{side}_eyelid_lower_mid"]]
        return [replace(look, points=points)]

    monkeypatch.setattr("mien.initialization.detector.detect_once", detect_once)
    monkeypatch.setattr(live_search, "_PATIENCE", patience_s)
    patience = live_search.Patience(face().camera)
    assert next(frame.index for frame in turning.frames if patience(frame)) == index


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_camera_that_hangs_turned_finds_a_face_as_soon_as_an_upright_one(
    quarters: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the networks: upside down they see an upright face, with the mouth taken for the eyes."""
    monkeypatch.setattr(live_search, "_PATIENCE", 60.0)
    upright = small_motion().frames[0]
    (known,) = mien_detector.detect(upright)
    turned = Frame(np.ascontiguousarray(np.rot90(upright.pixels, -quarters)))
    patience = live_search.Patience(Camera.centred(face().camera.focal_px, turned.width, turned.height))
    found = next(faces for k in range(4) if (faces := patience(Frame(turned.pixels, k, k / FPS))) or k == 3)
    assert len(found) == 1
    assert found[0].frame_index <= 1
    np.testing.assert_allclose(found[0].points, Upright(turned, quarters).points_seen(known.points), atol=0.5)
    assert patience.first_detection is not None
    fit = patience.first_detection[1]
    assert turned_deg(fit.R, fit.t) < 10
    (again,) = patience.anew()(Frame(turned.pixels, 9, 9 / FPS))  # the next face, in the first frame that shows it
    np.testing.assert_allclose(again.points, found[0].points)


def test_only_where_no_upright_face_is_seen_frames_are_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    """By every quarter turn, one in each frame, at the point that is asked for; and both are searched for distant faces
    in turn, as that takes long."""
    asked: list[tuple[int, Point | None, bool]] = []
    upright = np.zeros((240, 320, 3), np.uint8)
    upright[0, 0] = 255
    known = face().landmarks

    def detect_once(frame: Frame, at: Point | None, distant: bool) -> list[Landmarks]:
        (turns,) = (k for k in range(4) if np.array_equal(np.rot90(upright, k), frame.pixels))
        asked.append((turns, at, distant))
        return [known] * (frame.index >= 12)

    monkeypatch.setattr("mien.initialization.detector.detect_once", detect_once)
    monkeypatch.setattr("mien.initialization.detector.refine", lambda frame, face: face)
    monkeypatch.setattr("mien.initialization.detector.detect", lambda frame, at: [known])
    patience = live_search.Patience(face().camera, (200.0, 100.0))
    found = [bool(patience(Frame(upright, k, k / FPS))) for k in range(14)]
    assert found == [False] * 12 + [True] * 2
    assert [turns for turns, _, _ in asked] == [0, 2, 0, 1, 0, 3] * 4 + [0, 0]
    places = {0: (200.0, 100.0), 1: (100.0, 119.0), 2: (119.0, 139.0), 3: (139.0, 200.0)}
    assert {turns: at for turns, at, _ in asked} == places
    assert {turns for turns, _, distant in asked if distant} == {0, 1, 2, 3}
    assert all(one[2] is not other[2] for one, other in zip(asked[:24:2], asked[1:24:2], strict=True))


@pytest.mark.parametrize(("disagreement", "begins"), [(0.003, True), (0.02, False)])
def test_what_turned_copies_do_not_agree_on_is_no_face(
    disagreement: float, begins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an upright one that is turned upside down."""
    known = replace(face().landmarks, disagreement=disagreement)

    def detect_once(frame: Frame, at: Point | None, distant: bool) -> list[Landmarks]:
        return [known] * (frame.pixels.shape[:2] == (320, 240))

    monkeypatch.setattr("mien.initialization.detector.detect_once", detect_once)
    monkeypatch.setattr("mien.initialization.detector.refine", lambda frame, face: face)
    monkeypatch.setattr("mien.initialization.detector.detect", lambda frame, at: [known])
    patience = live_search.Patience(face().camera)
    found = [bool(patience(Frame(np.zeros((240, 320, 3), np.uint8), k, k / FPS))) for k in range(6)]
    assert any(found) is begins


def test_frames_that_end_before_the_face_looks_into_the_camera(detector: set[int], turning: SyntheticSequence) -> None:
    with pytest.raises(MienError, match=r"no face looks into the camera in its 5 frames .*; at_once learns"):
        prepare(Footage(Live(turning.frames[:5]), face().camera))
    detector.update(range(5))
    with pytest.raises(MienError, match=r"no face was found in its 5 frames .*; bring it nearer, or into more light$"):
        prepare(Footage(Live(turning.frames[:5]), face().camera))


def test_of_several_faces_before_a_camera_no_more_than_one_can_be_chosen(
    turning: SyntheticSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them only in a file: what a camera has shown cannot be tracked once more."""
    two = [face().landmarks] * 2
    monkeypatch.setattr("mien.initialization.detector.first_with_a_face", lambda frames, at: (next(frames), two))
    for video, told in (
        (Live(turning.frames), "chooses another$"),
        (Live(turning.frames, repeatable=True), "--faces 2"),
    ):
        with pytest.warns(MienWarning, match=f"2 faces in the frame at 0.00 s; .*{told}"):
            search.find_face(iter(turning.frames), video, lambda frame: None)


def test_a_face_that_was_away_is_waited_for_anew(
    detector: set[int], turning: SyntheticSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_search, "_PATIENCE", 0.15)
    monkeypatch.setattr(live_search, "_GONE_SECONDS", 1 / FPS)
    detector.update((3, 4))
    patience = live_search.Patience(face().camera)
    assert [bool(patience(frame)) for frame in turning.frames[:10]] == [False] * 9 + [True]


def test_a_face_that_was_missed_once_is_not_waited_for_anew(
    detector: set[int], turning: SyntheticSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_search, "_PATIENCE", 0.15)
    detector.add(3)
    patience = live_search.Patience(face().camera)
    assert [bool(patience(frame)) for frame in turning.frames[:5]] == [False] * 4 + [True]


def test_landmarks_that_are_no_faces_do_not_end_the_wait(
    detector: set[int], turning: SyntheticSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = [True]

    def fit(landmarks: Landmarks, camera: Camera) -> FirstFrame:
        require(not bad or not bad.pop(), "no face fits the landmarks")
        return fit_first_frame(landmarks, camera)

    monkeypatch.setattr(live_search, "fit_first_frame", fit)
    monkeypatch.setattr(live_search, "_PATIENCE", 0.0)
    patience = live_search.Patience(face().camera)
    assert [bool(patience(frame)) for frame in turning.frames[:2]] == [False, True]


@dataclass
class Live:
    """A camera before which a sequence happens; it shows each frame once."""

    frames: Sequence[Frame]
    shown: int = 0
    name: str = "camera 0"
    path: None = None
    repeatable: bool = False
    fps: float = FPS
    frame_count: None = None

    def __iter__(self) -> Iterator[Frame]:
        for frame in self.frames:
            self.shown += 1
            yield frame


@dataclass
class Counted(Live):
    """A video that can be read again, and counts its readings that have not ended."""

    repeatable: bool = True
    readings: int = 0

    def __iter__(self) -> Iterator[Frame]:
        self.readings += 1
        try:
            yield from self.frames
        finally:
            self.readings -= 1


def test_the_search_leaves_no_reading_open(detector: set[int], turning: SyntheticSequence) -> None:
    """A file that is open keeps a decoder and its threads."""
    video = Counted(turning.frames)
    begin = prepare(Footage(video, face().camera))
    assert begin.first.index > 0
    assert video.readings == 0
    assert next(begin.frames) is turning.frames[0]


def test_landmarks_that_are_given_are_those_of_the_beginning(
    detector: set[int], turning: SyntheticSequence, video: Path
) -> None:
    marks = Landmarks(turning.landmarks[0], "candide26")
    assert prepare(Footage(open_video(video), face().camera), marks).first.index == 0


def test_begun_in_front_a_turned_head_is_tracked_better(turning: SyntheticSequence, video: Path) -> None:
    """With the real detector, from the first frame to the last."""
    with pytest.warns(MienWarning, match="where tracking begins, and all angles will be less certain"):
        turned = _errors_deg(mien.track(video, camera=face().camera, at_once=True), turning)
    frontal = _errors_deg(mien.track(video, camera=face().camera), turning)
    assert len(frontal) == len(turned) == len(PANS_DEG)
    assert frontal.mean() < 0.8 * turned.mean()
    assert frontal.max() < 2
