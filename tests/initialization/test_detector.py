"""The face of the first frame, as the detector finds it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization import detector
from mien.initialization.landmarks import Place, place_of
from mien.initialization.mediapipe_mesh import silenced
from mien.initialization.upright import Upright
from mien.start.live_search import Patience
from small_motion import face, small_motion, turned_portrait

needs_mediapipe = pytest.mark.skipif(
    importlib.util.find_spec("mediapipe") is None, reason="the extra `auto` is not installed"
)


@pytest.fixture(params=[pytest.param("MediaPipe", marks=needs_mediapipe), "OpenCV"], autouse=True)
def network(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What looks for faces."""

    def not_installed(faces: int) -> None:
        raise ImportError

    if request.param == "OpenCV":
        monkeypatch.setattr(detector, "MediaPipeMesh", not_installed)
        monkeypatch.setattr(detector, "_idle", defaultdict(list))
    return str(request.param)


def _texture() -> Frame:
    pixels = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    return Frame(pixels)


def test_standard_error_comes_back_after_the_last_of_those_who_silenced_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """As two threads do that look for faces at the same time: who began first ends first."""
    monkeypatch.setattr(sys, "stderr", sys.__stderr__)
    before, one, other = os.fstat(2).st_ino, silenced(), silenced()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert os.fstat(2).st_ino != before
    print("Python's own words", file=sys.stderr)
    other.__exit__(None, None, None)
    assert os.fstat(2).st_ino == before
    assert sys.stderr is sys.__stderr__


def test_of_standard_error_only_the_log_of_the_networks_is_silenced(capfd: pytest.CaptureFixture[str]) -> None:
    """Another thread may write there meanwhile, through a handler of `logging` that has kept it."""
    with silenced():
        os.write(2, b"W0000 00:00:1795817166.517954   15810 inference_feedback_manager.cc:114] Feedback manager\n")
        os.write(2, b"INFO:app:the driver is here\nINFO: Created TensorFlow Lite XNNPACK delegate for CPU.\n")
        os.write(2, b"WARNING: All log messages before absl::InitializeLog() is called are written to STDERR\n")
        os.write(2, b"WARNING:app:the driver has gone\n")
    assert capfd.readouterr().err == "INFO:app:the driver is here\nWARNING:app:the driver has gone\n"


def test_standard_error_is_the_programs_own_while_it_gives_the_next_frame() -> None:
    """A progress bar and warnings go there."""
    own = os.fstat(2).st_ino
    seen = []

    def frames() -> Iterator[Frame]:
        for frame in (_texture(), small_motion().frames[0]):
            seen.append(os.fstat(2).st_ino)
            yield frame

    assert detector.first_with_a_face(frames()) is not None
    face = detector.detect(small_motion().frames[0])[0]
    assert len(list(detector.follow(face, frames()))) == 1
    assert seen == [own] * 4


def test_threads_share_what_finds_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    """What MediaPipe keeps for each would otherwise stay after the thread has ended."""
    monkeypatch.setattr(detector, "_idle", defaultdict(list))
    for _ in range(3):
        thread = threading.Thread(target=detector.detect_once, args=(small_motion().frames[0],))
        thread.start()
        thread.join()
    assert [len(finders) for finders in detector._idle.values()] == [1]
    with detector.open_finder(8) as one, detector.open_finder(8) as other:
        assert one is not other  # at the same time each has its own


def test_the_portrait_is_found() -> None:
    (found,) = detector.detect(small_motion().frames[0])
    _, points, depths = found.correspondences()
    _, known, _ = face().landmarks.correspondences()
    assert np.abs(points.mean(axis=0) - known.mean(axis=0)).max() < 3
    assert depths is not None


@pytest.mark.parametrize("deg", [60.0, 90.0, 120.0, 150.0, 180.0, -120.0, -90.0])
def test_a_face_that_stands_on_its_head_is_not_taken_for_an_upright_one(deg: float) -> None:
    (known,), (picture, A) = detector.detect(small_motion().frames[0]), turned_portrait(deg)
    (found,) = detector.detect(Frame(picture))
    apart = np.linalg.norm(known.points @ A[:, :2].T + A[:, 2] - found.points, axis=1)
    assert apart.mean() < 0.02 * np.ptp(known.points, axis=0).max()


@pytest.mark.parametrize("quarters", [1, 3])
def test_a_face_that_lies_on_its_side_is_found_as_well_as_an_upright_one(quarters: int) -> None:
    (upright,), pixels = detector.detect(small_motion().frames[0]), small_motion().frames[0].pixels
    lying = Upright(Frame(np.ascontiguousarray(np.rot90(pixels, -quarters))), quarters)
    (found,) = detector.detect(lying.seen)
    apart = np.linalg.norm(lying.points_upright(found.points) - upright.points, axis=1)
    assert apart.mean() < 0.0015 * upright.size
    assert found.disagreement is not None
    assert upright.disagreement is not None
    assert found.disagreement < 1.3 * upright.disagreement


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_face_is_followed_as_an_upright_one(quarters: int) -> None:
    (face,), later = detector.detect(small_motion().frames[0]), small_motion().frames[-1]
    ((_, upright),) = detector.follow(face, [later])
    lying = Upright(Frame(np.ascontiguousarray(np.rot90(later.pixels, -quarters))), quarters)
    ((frame, followed),) = detector.follow(lying.seen_by_camera(face), [lying.seen])
    assert frame is lying.seen
    np.testing.assert_array_equal(followed.points, lying.points_seen(upright.points))


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_face_that_is_not_seen_as_it_is_is_looked_for_turned(quarters: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of faces in poor images, which the networks see upright only. One frame in fifteen is turned."""
    upright = small_motion().frames[0]
    lying = Upright(Frame(np.ascontiguousarray(np.rot90(upright.pixels, -quarters))), quarters)
    seen, near = list[Frame](), detector.Finder.near

    def only_upright(finder: detector.Finder, frame: Frame) -> list[Array]:
        seen.append(frame)
        return near(finder, frame) if np.array_equal(frame.pixels, upright.pixels) else []

    monkeypatch.setattr(detector.Finder, "near", only_upright)
    monkeypatch.setattr(detector.Finder, "distant", lambda finder, frame, near=None: [])
    (known,), (found,) = detector.detect(upright), detector.detect(lying.seen)
    np.testing.assert_array_equal(found.points, lying.points_seen(known.points))
    x, y = (float(value) for value in found.points.mean(axis=0))
    assert detector.detect(lying.seen, (x, y))
    assert not detector.detect(lying.seen, (0.0, 0.0))
    seen.clear()
    grey = Frame(np.full_like(upright.pixels, 90))
    assert detector.first_with_a_face([grey] * 30) is None
    assert len(seen) == 30 + 2 * 3


def test_what_is_dark_is_not_made_black() -> None:
    """A picture of 25 grey values is seen as the bright one is, though most of the looks at it are darkened."""
    bright = small_motion().frames[0]
    (known,), (found,) = detector.detect(bright), detector.detect(Frame((bright.pixels // 10).astype(np.uint8)))
    assert np.abs(found.points - known.points).mean() < 1.0
    values = np.arange(201)
    np.testing.assert_array_equal(detector._tones(1.0, 200)[:201], values)
    darker = detector._tones(2.0, 200)[:201].astype(int)
    assert darker[0] == 0
    assert darker[200] == 200
    assert (np.diff(darker) >= 0).all()
    assert (darker <= values).all()


def _far_away(
    corner: tuple[int, int], face_px: int = 60, room_px: tuple[int, int] = (1280, 720)
) -> tuple[Frame, Array]:
    """The portrait, its face this large, in a large room; and the size of the portrait over its own."""
    portrait = small_motion().frames[0]
    scale = face_px / float(np.ptp(face().landmarks.points, axis=0).max())
    room = np.full((*room_px[::-1], 3), 90, np.uint8)
    small = cv2.resize(portrait.pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    x, y = corner
    room[y : y + small.shape[0], x : x + small.shape[1]] = small
    (near,) = detector.detect(portrait)
    return Frame(room), scale * (near.points + 0.5) - 0.5 + corner


@pytest.mark.parametrize("face_px", [50, 60, 90, 150])
def test_a_face_that_is_small_in_the_image_is_found(face_px: int) -> None:
    frame, known = _far_away((800, 400), face_px)
    (found,) = detector.detect(frame)
    assert np.abs(found.points - known).mean() < 1.5
    (once,) = detector.detect_once(frame)
    assert np.abs(once.points - known).mean() < 2.5


@pytest.mark.parametrize("corner", [(40, 150), (300, 900)])
def test_a_face_that_is_small_in_an_upright_image_is_found(corner: tuple[int, int]) -> None:
    """As of a phone that is held upright; however narrow, it is shrunk by its height."""
    frame, known = _far_away(corner, 48, (720, 1280))
    (found,) = detector.detect(frame)
    assert np.abs(found.points - known).mean() < 1.5


def test_a_face_that_is_small_in_the_image_is_followed() -> None:
    first, _ = _far_away((900, 400))
    later, known = _far_away((910, 395))
    ((frame, found),) = detector.follow(detector.detect_once(first)[0], [Frame(later.pixels, 7)])
    assert frame.index == found.frame_index == 7
    assert np.abs(found.points - known).mean() < 2.5


def test_beside_a_near_face_a_distant_one_is_found() -> None:
    near, _ = _far_away((20, 20), 300)
    far, known = _far_away((1000, 400))
    near.pixels[400:, 1000:] = far.pixels[400:, 1000:]
    assert len(detector.detect_once(near)) == 1
    large, small = detector.detect_all(near)
    assert np.ptp(large.points, axis=0).max() > 250
    assert np.abs(small.points - known).mean() < 2.5


def test_a_face_that_is_too_small_to_be_tracked_is_passed_over() -> None:
    assert detector.detect(_far_away((900, 400), face_px=30)[0]) == []


def test_what_is_seen_once_and_in_no_copy_is_no_face(monkeypatch: pytest.MonkeyPatch) -> None:
    """The network takes a texture for a face; turned and scaled it does not."""
    texture, portrait = _texture(), Frame(small_motion().frames[1].pixels, 1)
    near = detector.Finder.near
    seen_once = np.random.default_rng(1).uniform(60, 180, (478, 3))

    def fooled(finder: Any, frame: Frame) -> Any:
        return [seen_once] if frame is texture else near(finder, frame)

    monkeypatch.setattr(detector.Finder, "near", fooled)
    assert detector.detect(texture) == []
    found = detector.first_with_a_face([texture, portrait])
    assert found is not None
    assert found[0].index == 1
    assert len(found[1]) == 1


def test_a_face_that_is_too_small_is_left_for_a_later_one_that_is_not() -> None:
    """In a small image, in which no search for distant faces leaves it out; if it stays small, it is what is found."""
    portrait = small_motion().frames[1]
    place, size = place_of(small_motion().landmarks[1])
    share = 24 / size
    side = round(2 * size * share)
    corner = np.round(place * share - 0.5 * side).astype(int)
    shrunk = cv2.resize(portrait.pixels, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    small = Frame(np.ascontiguousarray(shrunk[max(corner[1], 0) :, max(corner[0], 0) :][:side, :side]), 0)
    found = detector.first_with_a_face([small, Frame(portrait.pixels, 1)])
    assert found is not None
    assert found[0].index == 1
    alone = detector.first_with_a_face([small])
    assert alone is not None
    assert 25 < alone[1][0].size < 40
    assert Patience(Camera.centred(100, side, side))(small) == []


def _moved(across: float, scale: float = 1.0) -> Any:
    """Points (478, 3) of one face, moved by a share of its size, larger or smaller."""
    points = np.random.default_rng(2).uniform(0, 100, (478, 3))
    return scale * points + [100 * across, 0, 0]


@pytest.mark.parametrize("others", [[], [_moved(2.0)], [_moved(0.4)]])
def test_a_face_is_followed_beside_others_while_it_moves_little(
    others: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = [[*others, _moved(0.1)], others[:0], [_moved(0.3, 1.1), *others], [_moved(3.0)], [_moved(0.2)]]
    frames = [Frame(small_motion().frames[0].pixels, k) for k in range(1, 1 + len(answers))]
    shown = iter(answers)
    monkeypatch.setattr(detector.Finder, "near", lambda finder, frame: next(shown))
    monkeypatch.setattr(detector.Finder, "in_crop", lambda finder, frame, place: [])
    monkeypatch.setattr(detector, "roll_of", lambda face: 0.0)
    first = detector.landmarks_of(small_motion().frames[0], _moved(0.0))
    followed = list(detector.follow(first, frames))
    assert [frame.index for frame, _ in followed] == [1, 3, 5]
    for (_, found), there in zip(followed, (_moved(0.1), _moved(0.3, 1.1), _moved(0.2)), strict=True):
        np.testing.assert_allclose(found.points, there[:, :2])


def test_a_closer_look_is_that_of_detection() -> None:
    frame = small_motion().frames[0]
    (once,), (several,) = detector.detect_once(frame), detector.detect(frame)
    refined = detector.refine(frame, once)
    assert refined is not None
    np.testing.assert_allclose(refined.points, several.points)
    assert refined.disagreement == several.disagreement
    assert 0 < refined.disagreement < 0.003
    assert once.disagreement is None
    assert detector.refine(_texture(), once) is None


@needs_mediapipe
def test_the_network_comes_without_what_it_does_not_need() -> None:
    asked = """
import sys
from mien.initialization.mediapipe_mesh import import_solution
assert import_solution("face_mesh", "FaceMesh").__name__ == "FaceMesh"
print("matplotlib" in sys.modules, "sounddevice" in sys.modules)
from mediapipe.python.solutions import drawing_utils
print(callable(drawing_utils.plt.figure), "matplotlib.figure" in sys.modules)
"""
    answer = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["False", "False", "True", "True"]


FACE = np.random.default_rng(2).uniform(60, 180, (478, 3))
TURNED = np.column_stack([240 - FACE[:, :2], FACE[:, 2]])


@pytest.mark.parametrize(
    ("upright", "turned", "found"),
    [
        (0.003, None, FACE),  # turned copies are not looked at
        (0.008, None, FACE),
        (0.008, (TURNED, 0.05), FACE),
        (0.03, (TURNED, 0.002), TURNED),
        (None, (TURNED, 0.003), TURNED),
        (None, (TURNED, 0.01), None),  # of a face that the border cuts, as the next ones
        (0.0062, (TURNED, 0.0061), None),
        (0.0073, (TURNED, 0.0048), None),
        (0.0044, (FACE + 2, 0.0026), FACE + 2),  # a face that lies on its side is found either way
        (None, None, None),
    ],
)
def test_a_face_is_upside_down_only_if_it_is_seen_far_better_so(
    upright: float | None, turned: tuple[Array, float] | None, found: Array | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def consensus(frame: Frame, place: Place, turn_deg: float = 0.0) -> tuple[Array, float] | None:
        return turned if turn_deg else None if upright is None else (FACE, upright)

    monkeypatch.setattr(detector, "_consensus", consensus)
    monkeypatch.setattr(detector, "roll_of", lambda face: 0.0)
    averaged = detector._average(Frame(np.zeros((240, 240, 3), np.uint8)), FACE)
    assert (averaged is None) == (found is None)
    if averaged is not None:
        np.testing.assert_array_equal(averaged[0], found)


FORKED = """
import os
from mien.errors import MienError
from mien.initialization.detector import detect
from small_motion import face

assert detect(face().frame)
child = os.fork()
if not child:
    try:
        detect(face().frame)
    except MienError as error:
        os._exit(7 if "forked from one that had looked for a face" in str(error) else 8)
    os._exit(9)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@needs_mediapipe
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_process_that_was_forked_too_late_is_told_so(network: str) -> None:
    """It would wait for ever for MediaPipe's threads, which it does not have."""
    if network == "OpenCV":
        pytest.skip("OpenCV may be forked")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", FORKED]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split() == ["7"], done.stderr
