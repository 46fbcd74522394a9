"""Several faces of a video, each tracked for itself: the portrait twice, side by side, in motions of its own."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import av
import numpy as np
import pytest

import mien
from mien.errors import MienError, MienWarning
from mien.faces.sightings import Sighting, appearances_in
from mien.faces.track import _Run, track_faces
from mien.faces.tracked import FaceBoxes, TrackedFace, is_known, unknown_part, without_other_faces
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.landmarks import Landmarks, Point, place_of
from mien.output.track import Track
from mien.pipeline.passes import Pass, run_passes
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.state import Estimate, Status, TrackedLandmarks, Tracker
from mien.video import decode_frame, open_video
from small_motion import face
from videos import write_video

COUNT, FPS = 40, 10
HERE = range(7, 32)
"""Frames in which the face on the right is there; a look is at every fifth."""
WIDTH, HEIGHT = 320, 240
FOCAL = face().camera.focal_px


@cache
def turning(way: int) -> SyntheticSequence:
    """The portrait that turns by half a degree a frame to one side."""
    angles = np.zeros((COUNT, 3))
    angles[:, 1] = 0.5 * way * np.arange(COUNT)
    return make_sequence(face(), moved(face(), angles, 0 * angles, np.zeros((COUNT, 6))))


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Two of them in one picture; the one on the right comes later and goes earlier."""
    left, right = ([frame.pixels for frame in turning(way).frames] for way in (1, -1))
    nobody = np.full_like(left[0], 90)
    pairs = [np.hstack([a, right[k] if k in HERE else nobody]) for k, a in enumerate(left)]
    return write_video(tmp_path / "two.mkv", pairs, fps=FPS)


@pytest.fixture
def detector(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that finds the true landmarks, on the left and, while it is there, on the right."""

    def look(frame: Frame, at: Point | None = None) -> list[Landmarks]:
        k = frame.index
        points = [turning(1).landmarks[k], *[turning(-1).landmarks[k] + [WIDTH, 0]] * (k in HERE)]
        faces = [Landmarks(p, "candide26", frame_index=k, time=frame.time) for p in points]
        return [face for face in faces if at is None or np.linalg.norm(place_of(face.points)[0] - at) < 60]

    def first_with_a_face(frames: Iterable[Frame], at: Point | None = None) -> tuple[Frame, list[Landmarks]] | None:
        return next(((frame, look(frame, at)) for frame in frames if look(frame, at)), None)

    for name, stands_for in (("detect_all", look), ("detect", look), ("first_with_a_face", first_with_a_face)):
        monkeypatch.setattr(f"mien.initialization.detector.{name}", stands_for)


@pytest.mark.usefixtures("detector")
def test_each_face_has_a_track_and_all_are_drawn(video: Path, tmp_path: Path) -> None:
    """The one that comes later is seen in a look after it came, and tracked back to where it came."""
    endings = {"save": ".csv", "overlay": ".mp4", "plot": ".png", "gltf": ".glb"}
    files = {argument: tmp_path / f"out{ending}" for argument, ending in endings.items()}
    heard: list[tuple[int, int | None]] = []
    tracks = track_faces(
        video, 5, focal_px=FOCAL, at_once=True, progress=lambda e, total: heard.append((e.index, total)), **files
    )
    assert len(tracks) == 2
    for face_id, (track, way) in enumerate(zip(tracks, (1, -1), strict=True)):
        assert set(track.table.column("face_id").to_pylist()) == {face_id}
        there = np.array([status != "lost" for status in track.status])
        assert np.flatnonzero(there).tolist() == (list(HERE) if face_id else list(range(COUNT)))
        by_frame = np.polyfit(np.flatnonzero(there), track.euler_deg[there, 1], 1)[0]
        assert by_frame == pytest.approx(0.5 * way, rel=0.2)  # what one camera for both pictures leaves of it
        assert track.landmarks is not None
        assert (np.nanmean(track.landmarks[:, :, 0]) > WIDTH) == bool(face_id)
    assert len(heard) == 3 * COUNT  # both faces, and drawing them
    assert heard[-1][1] == 3 * COUNT
    for name in ("out.csv", "out.face1.csv", "out.face1.png", "out.png", "out.glb", "out.face1.glb"):
        assert (tmp_path / name).exists()
    assert not (tmp_path / "out.face1.mp4").exists()
    about = json.loads((tmp_path / "out.json").read_text())
    assert (about["complete"], about["faces"], about["face_id"]) == (True, 2, 0)
    with av.open(str(tmp_path / "out.mp4")) as container:
        pictures = [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]
    assert len(pictures) == COUNT
    green = [(p[:, :, 1] - p[:, :, 0] > 80).any(axis=0) for p in (pictures[2], pictures[20])]  # landmarks
    assert [g[:WIDTH].any() and g[WIDTH:].any() for g in green] == [False, True]


@pytest.mark.usefixtures("detector")
def test_a_face_that_comes_later_is_tracked_back_also_at_times_below_zero(video: Path) -> None:
    """As those that a program counts from an event."""
    frames = [Frame(frame.pixels, frame.index, frame.time - 100) for frame in open_video(video)]
    _, second = track_faces(frames, 2, focal_px=FOCAL, at_once=True)
    assert [k for k, status in enumerate(second.status) if status != "lost"] == list(HERE)


@pytest.mark.usefixtures("detector")
def test_no_more_faces_than_are_wanted(video: Path, tmp_path: Path) -> None:
    """And the track says what was warned of."""
    (tmp_path / "out.face1.csv").write_bytes(b"")
    with (
        pytest.warns(MienWarning, match="2 faces are seen at the same time"),
        pytest.warns(MienWarning, match=r"out\.face1\.csv is left from an earlier run"),
    ):
        (track,) = track_faces(video, 1, focal_px=FOCAL, at_once=True, save=tmp_path / "out.csv")
    assert track.lost == 0
    first, *_, last = track.metadata["warnings"]
    assert first.endswith("2 faces are seen at the same time; --faces 2 tracks all of them")
    assert last.endswith("this one has 1 face")


@pytest.mark.usefixtures("detector")
def test_what_is_done_is_written_when_it_is_stopped(video: Path, tmp_path: Path) -> None:
    """The first face is done, the second half: neither is lost, and neither says that it is complete."""
    heard: list[Estimate] = []

    def progress(estimate: Estimate, total: int | None) -> None:
        heard.append(estimate)
        if len(heard) == COUNT + 20:
            raise KeyboardInterrupt

    with pytest.warns(MienWarning, match="out.face1.csv"), pytest.raises(KeyboardInterrupt):
        track_faces(video, 2, focal_px=FOCAL, at_once=True, progress=progress, save=tmp_path / "out.csv")
    first, second = (Track.read(tmp_path / name) for name in ("out.csv", "out.face1.csv"))
    assert len(first) == COUNT
    assert 10 < len(second) < COUNT
    assert [track.metadata["complete"] for track in (first, second)] == [False, False]


@pytest.mark.usefixtures("detector")
def test_what_the_second_pass_finds_to_be_another_face_leaves_no_files(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The face on the right, whose second pass follows the one on the left."""

    def run_twice(first: Pass) -> Iterator[tuple[Track, Tracker]]:
        passed = list(run_passes(first))
        tracks.append(passed[-1][0])
        yield from passed
        if first.face_id == 1:
            yield replace(tracks[0], metadata=tracks[1].metadata), passed[-1][1]

    tracks: list[Track] = []
    monkeypatch.setattr("mien.faces.track.run_passes", run_twice)
    files = {"save": tmp_path / "out.csv", "plot": tmp_path / "out.png", "gltf": tmp_path / "out.glb"}
    (track,) = track_faces(video, 2, focal_px=FOCAL, at_once=True, **files)
    assert len(tracks) == 2
    assert track.metadata["warnings"] == []
    assert {path.name for path in tmp_path.glob("out*")} == {"out.csv", "out.json", "out.parquet", "out.png", "out.glb"}


def test_what_cannot_be_had(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mien.initialization.detector.detect_all", lambda frame: [])
    with pytest.raises(MienError, match=r"two\.mkv: no face was found"):
        track_faces(video, 2)
    with pytest.raises(MienError, match="0 faces to track"):
        track_faces(video, 0)
    with pytest.raises(MienError, match="'2' faces to track"):
        track_faces(video, "2")  # type: ignore[arg-type]


# What is known of where the faces are


def _at(k: int, x: float, confidence: float, status: Status = Status.TRACKED) -> Estimate:
    points = np.array([[x, 100.0], [x + 50, 150.0]])
    if status is Status.LOST:
        return Estimate(k, k / FPS, status)
    known = TrackedLandmarks(("a", "b"), points)
    return Estimate(k, k / FPS, status, FACING, np.array([0, 0, 9.0]), landmarks=known, confidence=confidence)


def _followed(estimates: Iterable[Estimate], face_id: int = 0) -> TrackedFace:
    track = Track.from_estimates(estimates, {"face_id": face_id})
    return TrackedFace(track, FaceBoxes(track), None, Camera.from_fov(WIDTH, HEIGHT))  # type: ignore[arg-type]


def test_of_two_tracks_with_a_face_the_less_certain_has_none() -> None:
    sure = _followed([_at(k, 100.0, 0.9) for k in range(4)] + [_at(4, 0, 0, Status.LOST)], 0)
    other = _followed(
        [_at(0, 110.0, 0.5), _at(1, 110.0, 0.95), _at(2, 200.0, 0.5), *(_at(k, 110.0, 0.5) for k in (3, 4))], 1
    )
    apart = without_other_faces(other, [sure, other])
    assert apart.status == ["lost", "tracked", "tracked", "lost", "tracked"]
    assert apart.table.column("reason").to_pylist() == ["face 0 is here", None, None, "face 0 is here", None]
    lost = apart.table.slice(0, 1).to_pylist()[0]
    assert {name for name, value in lost.items() if value is not None} == {
        "frame", "face_id", "timestamp", "confidence", "success", "status", "reason",
    }  # fmt: skip
    assert (lost["confidence"], lost["success"]) == (0, 0)
    assert apart.table.slice(1, 2).equals(other.track.table.slice(1, 2))
    assert without_other_faces(sure, [sure, other]).status == ["tracked", "lost", "tracked", "tracked", "lost"]
    assert without_other_faces(sure, [sure]) is sure.track


def _seen(k: int, x: float, size: float = 50.0) -> Sighting:
    return Sighting(k, k / FPS, np.array([x + 25, 125.0]), size)


def test_an_appearance_is_what_is_seen_again_in_its_place() -> None:
    face, flash, other = (_seen(0, 100), _seen(5, 110), _seen(20, 125)), _seen(5, 300), (_seen(20, 200), _seen(25, 200))
    late = _seen(45, 100), _seen(50, 100)  # somebody may have come in the meantime
    looks = [[face[0]], [face[1], flash], [], [other[0], face[2]], [other[1]], [late[0]], [late[1]]]
    assert appearances_in(looks) == [list(face), list(other), list(late)]
    assert appearances_in([[flash]]) == [[flash]]  # of a video too short for two looks
    shots = [[replace(flash, index=10 * k, time=0.5 * k, cuts=k)] for k in range(3)]
    assert appearances_in(shots) == shots  # each of which is over before the next look
    assert not _seen(0, 100).is_at(_seen(0, 100, 100.0))
    assert replace(_seen(5, 100), cuts=1).distance_after([_seen(0, 100)]) == np.inf


def test_an_appearance_goes_on_where_it_went() -> None:
    """A face that walks by, faster than its size in a look, and one that stands where it passes."""
    walks, stands = [_seen(5 * k, 100 + 70 * k) for k in range(5)], [_seen(5 * k, 232) for k in range(5)]
    looks = [[w] if k == 2 else [w, s] for k, (w, s) in enumerate(zip(walks, stands, strict=True))]
    assert appearances_in(looks) == [walks, [s for k, s in enumerate(stands) if k != 2]]


def test_a_face_is_known_where_a_track_has_it() -> None:
    other = _followed(_at(k, 100.0, 0.9 if k < 5 else 0.4, Status.LOST if k > 7 else Status.TRACKED) for k in range(10))
    assert is_known(_seen(4, 105), [other])
    for k, x in ((4, 200), (6, 100), (9, 100)):
        assert not is_known(_seen(k, x), [other])
    assert not is_known(_seen(4, 100), [])
    gaps = _followed(_at(k, 100.0, 0.9 if k < 5 else 0.4) for k in (0, 3, 4, 8, 9))  # images that could not be read
    assert is_known(_seen(4, 100), [gaps])
    assert not is_known(_seen(9, 100), [gaps])


def test_an_appearance_may_be_of_several_people(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who follow each other in one place, where a cut was not noticed."""
    asked: list[tuple[str, int]] = []
    people = {"first": 2, "second": 0, "third": 4}

    def track(self: object, appearance: str, found: list[str]) -> str | None:
        asked.append((appearance, len(found)))
        people[appearance] -= 1
        return appearance if people[appearance] >= 0 else None

    monkeypatch.setattr(_Run, "_track", track)
    run = _Run(*[None] * 5, 4, 1, None)  # type: ignore[arg-type]
    assert run.track_all(list(people)) == ["first", "first", "third", "third"]  # type: ignore[arg-type]
    assert asked == [("first", 0), ("first", 1), ("first", 2), ("second", 2), ("third", 2), ("third", 3)]


def test_the_part_of_an_appearance_that_no_track_has() -> None:
    """All of it; or, where somebody else was taken for it, more than a second of it; a short part may be a track's own
    that was lost there."""
    looks = [_seen(k, 100) for k in range(0, 40, 5)]

    def unknown(have: Iterable[int]) -> list[Sighting]:
        track = _followed(_at(k, 100.0, 0.9 if k in have else 0.1) for k in range(40))
        return unknown_part(looks, [track])

    assert unknown(range(0)) == looks
    assert unknown(range(15)) == looks[3:]
    assert unknown(range(10, 15)) == looks[3:]
    assert unknown(range(30)) == []
    assert unknown(range(40)) == []


@pytest.mark.usefixtures("detector")
def test_a_face_is_not_taken_for_one_that_passes_it(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the looks of the face on the left end with the one on the right, that one is tracked back to where the
    looks show the other."""

    def best_look(first: Frame, landmarks: Landmarks, *_: object) -> tuple[Frame, list[Landmarks], None]:
        looks = [replace(landmarks, points=turning(1).landmarks[k], frame_index=k, time=k / FPS) for k in (0, 10, 20)]
        looks[-1] = replace(looks[-1], points=turning(-1).landmarks[20] + [WIDTH, 0])
        return decode_frame(open_video(video), first, 20, 20 / FPS), looks, None

    monkeypatch.setattr("mien.start.first_frame.best_look", best_look)
    heard: list[int] = []
    with pytest.warns(MienWarning, match=r"two\.mkv: faces pass each other after 0\.00 s"):
        track = mien.track(video, focal_px=FOCAL, progress=lambda estimate, total: heard.append(estimate.index))
    assert track.landmarks is not None
    assert track.lost == 0
    assert (track.landmarks[:, :, 0].max(axis=1) < WIDTH).all()
    assert track.metadata["landmarks"]["frame"] == 0
    assert sorted(heard) == list(range(COUNT))


def test_it_is_part_of_mien() -> None:
    assert mien.track_faces is track_faces


def test_of_two_tracks_of_one_face_that_are_as_sure_the_earlier_has_it() -> None:
    """Some trackers are always sure."""
    boxes = FaceBoxes.__new__(FaceBoxes)
    boxes.centre, boxes.size, boxes.confidence = np.full((3, 2), 50.0), np.full(3, 40.0), np.ones(3)
    assert boxes.taken_by(boxes, earlier=True).all()
    assert not boxes.taken_by(boxes, earlier=False).any()
