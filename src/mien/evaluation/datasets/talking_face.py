"""Talking Face: 5000 frames of one talking person, 68 points in each (FGnet, 2004).

PATH is a folder with `franck_00000.jpg` .. and `franck_00000.pts` .., or with one video and such point files, also in
subfolders; frames without a point file have no truth, and point files without an image are warned of. A point file
belongs to the image with its name, or to the frame of the video with its number, starting at 0.

The first point file determines the format of all. The points are between braces (`version: 1`, `n_points: 68`), or are
68 plain lines of x and y. Their order is that of iBUG, or that of FGnet's own annotation (the same as XM2VTS's), in
which points 31 and 36 are the pupils, surrounded by 27 to 30 and 32 to 35. From FGnet's order only the twelve points of
the paper's Fig. 3 are used. Pixel coordinates of points in iBUG's order between braces start at 1, all others at 0.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, require, warn
from mien.evaluation.datasets.sequence import Sequence, Truth, found_in, require_finite
from mien.evaluation.points12 import POINT_NAMES, TWELVE
from mien.initialization.landmark_files import PTS_ORIGIN, read_landmarks
from mien.video import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_images

FGNET_POINTS = (27, 29, 34, 32, 67, 41, 39, 43, 48, 54, 51, 57)
"""Indices in FGnet's annotation of the twelve points, in the order of `points12.POINT_NAMES`."""


def load(root: Path) -> tuple[Sequence, ...]:
    """Load the one sequence of a folder."""
    require(root.is_dir(), f"{root} is not a folder; give the one with the images or the video and the point files")
    found = found_in(root, "**/*.pts")
    points = {p.stem: p for p in found}
    require(
        bool(points),
        f"{root} contains no point file; Talking Face has franck_00000.pts .. beside its images or its video",
    )
    frame_of, video = _frames(root, points)
    numbered = [(frame_of[file.stem], file) for file in found if file.stem in frame_of]
    files = dict(numbered)
    require(bool(files), f"{root}: none of the {len(points)} point files has the name of an image")
    without = [file for file in found if file.stem not in frame_of]
    if without:
        warn(
            f"{video} has no image for {len(without)} of the {len(found)} point files, such as {without[0]}, which are "
            "not used; keep all images in one folder"
        )
    twice = [f"{file} and {files[frame]}" for frame, file in numbered if file != files[frame]]
    if twice:
        raise MienError(f"{twice[0]} belong to the same frame; keep one of them")
    return (Sequence("talking_face", "talking-face", video, tuple(files.values()), partial(read_truth, files)),)


def read_truth(files: Mapping[int, Path], frames: int) -> Truth:
    """Read the points of a video with this number of frames from its point files, given by frame."""
    last = max(files)
    require(
        last < frames,
        f"{files[last]} belongs to frame {last} and the video has {frames}; check that they belong together",
    )
    first = files[min(files)]
    braces = _has_braces(first)
    fgnet = is_fgnet(_read_points(first, braces))
    landmarks = np.full((frames, len(POINT_NAMES) if fgnet else 68, 2), np.nan)
    for frame, file in files.items():
        points = _read_points(file, braces)
        landmarks[frame] = points[list(FGNET_POINTS)] if fgnet else points - (PTS_ORIGIN if braces else 0.0)
    return Truth(frames, landmarks=landmarks, landmark_scheme=TWELVE if fgnet else "ibug68")


def is_fgnet(points: Array) -> bool:
    """Whether 68 points are in FGnet's order: both pupils lie at the centre of the four points of their eye."""
    size = float(np.ptp(points, axis=0).max())
    pupils = [(31, slice(27, 31)), (36, slice(32, 36))]
    return all(bool(np.linalg.norm(points[pupil] - points[eye].mean(axis=0)) < 0.05 * size) for pupil, eye in pupils)


def _frames(root: Path, points: Mapping[str, Path]) -> tuple[dict[str, int], Path]:
    """The frame index for each name, and the video or the folder of images."""
    images = [p for p in found_in(root, "**/*") if p.suffix.lower() in IMAGE_SUFFIXES]
    if images:
        folder = images[0].parent
        return {p.stem: i for i, p in enumerate(list_images(folder))}, folder
    videos = [p for p in found_in(root, "**/*") if p.suffix.lower() in VIDEO_SUFFIXES]
    require(len(videos) == 1, f"{root} contains no images and {len(videos)} videos; it needs the images or one video")
    return {name: _number(file) for name, file in points.items()}, videos[0]


def _number(file: Path) -> int:
    digits = re.search(r"(\d+)$", file.stem)
    if digits is None:
        raise MienError(f"{file} has no frame number at the end of its name; rename it like franck_00000.pts")
    return int(digits.group(1))


def _has_braces(file: Path) -> bool:
    return "{" in file.read_text(encoding="utf-8", errors="replace")


def _read_points(file: Path, braces: bool) -> Array:
    """The points (68, 2) as in the file."""
    require(
        _has_braces(file) == braces,
        f"{file} has another format than the first point file; all must have the same",
    )
    if braces:
        return read_landmarks(file).points + PTS_ORIGIN
    try:
        points = np.loadtxt(file, ndmin=2, encoding="utf-8-sig")
    except ValueError as e:
        raise MienError(f"{file} is not a list of points ({e}); it needs 68 lines of x and y") from e
    require(points.shape == (68, 2), f"{file} has points of shape {points.shape}; it needs 68 lines of x and y")
    require_finite(points, file, "the point")
    return np.asarray(points)
