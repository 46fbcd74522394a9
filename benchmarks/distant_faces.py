"""Faces that are small in the image, and what it costs to look for a face that is gone.

`OMP_NUM_THREADS=1 python benchmarks/distant_faces.py RECORDINGS`, with RECORDINGS a folder of videos. The face of each
one's first frame is painted in several sizes into a picture of 1280x720 pixels; printed is how often it is found by
Face Mesh alone and by `mien.initialization.detector`. Then, by the size of the image: milliseconds a frame while no
face was seen yet, and while one that was tracked is gone.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import videos_of
from skimage import data

from mien.arrays import Pixels
from mien.frame import Frame
from mien.geometry.camera import DEFAULT_FOV_DEG, Camera
from mien.initialization import detector
from mien.initialization.landmarks import Landmarks, place_of
from mien.tracking.realtime import RealtimeTracker
from mien.video import open_video

FACES_PX = (40, 50, 60, 80, 100, 120, 140, 160, 200)
PLACES = 3
"""Places into which each face is painted."""
ROOM = (1280, 720)
SIZES = ((320, 240), (640, 480), (1280, 720), (1920, 1080))
FRAMES = 100
SHIFTS = 10
"""Pictures without a face, each moved on by a pixel, that come in turn."""


def faces(recordings: Path) -> Iterator[tuple[Frame, Landmarks]]:
    """The first frame of every recording that shows a face, and that face."""
    for path in videos_of(recordings):
        frame = next(iter(open_video(path)))
        found = detector.detect_once(frame)
        if found:
            yield frame, found[0]


def painted(frame: Frame, face: Landmarks, size_px: int, centre: tuple[int, int]) -> Pixels:
    """The room with a face, and as much around it as it is large, of a size in pixels at a place."""
    middle, size = place_of(face.points)
    x, y = np.maximum(middle - size, 0).astype(int)
    part = frame.pixels[y : int(middle[1] + size), x : int(middle[0] + size)]
    small = cv2.resize(part, None, fx=size_px / size, fy=size_px / size, interpolation=cv2.INTER_AREA)
    room = np.asarray(cv2.resize(data.coffee(), ROOM), np.uint8)
    height, width = small.shape[:2]
    left, top = centre[0] - width // 2, centre[1] - height // 2
    room[top : top + height, left : left + width] = small
    return room


def is_there(found: list[Landmarks], centre: tuple[int, int], size_px: int) -> bool:
    """Whether one of the faces is the painted one."""
    return any(np.abs(face.points.mean(axis=0) - centre).max() < 0.7 * size_px for face in found)


def shares_found(known: list[tuple[Frame, Landmarks]], size_px: int, rng: np.random.Generator) -> tuple[float, float]:
    """How often faces of a size are found by Face Mesh alone, and by the detector."""
    alone, found = [], []
    for frame, face in known:
        for _ in range(PLACES):
            centre = (int(rng.integers(size_px, ROOM[0] - size_px)), int(rng.integers(size_px, ROOM[1] - size_px)))
            room = Frame(painted(frame, face, size_px, centre))
            with detector.open_finder(detector.MAXIMUM_FACES) as finder:
                near = [detector.landmarks_of(room, points) for points in finder.near(room)]
            alone.append(is_there(near, centre, size_px))
            found.append(is_there(detector.detect_once(room), centre, size_px))
    return float(np.mean(alone)), float(np.mean(found))


def empty_rooms(width: int, height: int) -> list[Pixels]:
    """Pictures of a size that show no face."""
    empty = np.asarray(cv2.resize(data.coffee(), (width, height)), np.uint8)
    return [np.roll(empty, k, axis=1) for k in range(SHIFTS)]


def searching_ms(width: int, height: int) -> float:
    """Milliseconds a frame in which no face was seen yet."""
    empty = empty_rooms(width, height)
    since = perf_counter()
    assert detector.first_with_a_face(Frame(empty[k % SHIFTS], k) for k in range(FRAMES)) is None
    return 1e3 * (perf_counter() - since) / FRAMES


def lost_ms(width: int, height: int) -> float:
    """Milliseconds a frame in which a face that was tracked is gone."""
    empty = empty_rooms(width, height)
    portrait = data.astronaut()[:240, 64:384]
    first = Frame(np.asarray(cv2.resize(portrait, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8))
    tracker = RealtimeTracker()
    camera = Camera.from_fov(width, height, DEFAULT_FOV_DEG)
    tracker.initialize(first, detector.detect(first)[0], camera)
    since = perf_counter()
    estimates = [tracker.track(Frame(empty[k % SHIFTS], k, k / 30)) for k in range(1, 1 + FRAMES)]
    assert not any(estimate.status.success for estimate in estimates)
    return 1e3 * (perf_counter() - since) / FRAMES


def main() -> None:
    parser = parser_of(__doc__, "recordings")
    known = list(faces(parser.parse_args().recordings))
    rng = np.random.default_rng(0)
    print_heads("size (pixels)", "of the width", "Face Mesh", "found")
    for size_px in FACES_PX:
        alone, found = shares_found(known, size_px, rng)
        print(f"| {size_px} | {100 * size_px / ROOM[0]:.1f} % | {alone:.2f} | {found:.2f} |", flush=True)
    print()
    print_heads("image", "no face yet (ms)", "lost (ms)")
    for width, height in SIZES:
        print(f"| {width}x{height} | {searching_ms(width, height):.1f} | {lost_ms(width, height):.1f} |", flush=True)


if __name__ == "__main__":
    carry_out(main)
