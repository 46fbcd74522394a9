"""Rendered heads with exact ground truth, in BUFT's layout: `NAME.avi`, `NAME.dat`, `NAME_truth.npz`.

The kind of a sequence is part of its name: `a_uniform1` is of kind `uniform`. `NAME_truth.npz` contains `R` (n, 3, 3)
and `t` with `X_camera = diag(1, -1, -1) R X + t`, `landmarks68` (n, 68, 2), `expression` and `expression_names`, and
`focal`, pixels. If there is only the `.dat`, it is read like BUFT's. Measured on these sequences, the `.dat` contains
tilt, pan and roll of `R_0^T R_t = Rx(tilt) Ry(pan) Rz(roll)`, as the protocol `rebased` interprets it. The points are
shifted to where the images show them.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, require
from mien.evaluation.datasets import buft
from mien.evaluation.datasets.sequence import (
    Sequence,
    Truth,
    found_in,
    require_finite,
    require_frames,
    warn_of_videos_without_truth,
)
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.video import VIDEO_SUFFIXES

CAMERA = Camera(500.0, 160.0, 120.0)
"""The camera of these heads; `NAME_truth.npz` may have another focal length."""
IMAGE_OFFSET = -0.25
"""Shift in pixels, to the right and down, from `landmarks68` to where the images show them. Measured from the images
alone: -0.22 and -0.38, each to 0.03 (`benchmarks/picture_offset.py`); -0.25 follows if they were rendered at twice the
size, by a camera with twice the numbers, and averaged."""


def load(root: Path) -> tuple[Sequence, ...]:
    """Load all sequences of a folder: videos that have a `_truth.npz` or a `.dat` of the same name. Warns of those that
    have neither."""
    videos = [p for p in found_in(root, "*") if p.suffix.lower() in VIDEO_SUFFIXES]
    found = [s for video in videos if (s := _sequence(video)) is not None]
    require(
        bool(found),
        f"{root} contains no rendered sequence; it needs NAME.avi with NAME_truth.npz or NAME.dat beside it",
    )
    warn_of_videos_without_truth(root, videos, found, "NAME_truth.npz or NAME.dat beside it")
    return tuple(found)


def read_truth(path: Path, frames: int) -> Truth:
    """Read the exact truth from a `NAME_truth.npz`, for a video with this number of frames."""
    values = _read_npz(path)
    _camera(values, path)  # raises for a focal length that is none
    names = tuple(str(n) for n in np.atleast_1d(values.get("expression_names", ())))
    R = _array(values, "R", (3, 3), path)
    landmarks = _array(values, "landmarks68", (68, 2), path)
    expression = _array(values, "expression", (len(names),), path)
    if R is None:
        raise MienError(f"{path} has no rotations R of shape (n, 3, 3); create the file again")
    for name, array in (("the rotation", R), ("a landmark", landmarks), ("the expression", expression)):
        if array is not None:
            require_frames(len(array), frames, path)
            require_finite(array, path, name)
    determinant = np.linalg.det(R)
    require(bool((determinant > 0).all()), f"{path}: R of frame {int(np.argmin(determinant))} is no rotation")
    if landmarks is not None:
        landmarks = landmarks + IMAGE_OFFSET
    return Truth(frames, rotations=FACING @ R, landmarks=landmarks, expression=expression, expression_names=names)


def _sequence(video: Path) -> Sequence | None:
    exact, dat = video.with_name(f"{video.stem}_truth.npz"), video.with_suffix(".dat")
    kind = re.sub(r"\d+$", "", video.stem.split("_", 1)[-1])
    if exact.exists():
        try:
            camera = _camera(_read_npz(exact), exact)
        except MienError:  # which `read_truth` raises for this sequence alone
            camera = CAMERA
        return Sequence(video.stem, kind, video, (exact,), partial(read_truth, exact), camera)
    if dat.exists():
        return Sequence(video.stem, kind, video, (dat,), partial(buft.read_truth, dat), CAMERA)
    return None


def _camera(values: Mapping[str, Any], path: Path) -> Camera:
    """The camera with the `focal` of a truth file; `CAMERA` if it has none."""
    if "focal" not in values:
        return CAMERA
    focal = values["focal"]
    require(
        focal.size == 1,
        f"{path}: focal is no focal length in pixels, but {focal.size} values; write one number, that of all frames",
    )
    try:
        return replace(CAMERA, focal_px=float(focal.item()))
    except ValueError as e:
        raise MienError(f"{path}: focal is no focal length in pixels ({e}); create the file again") from e


def _read_npz(path: Path) -> Mapping[str, Any]:
    try:
        with np.load(path) as file:
            return dict(file)
    # Of a single array TypeError, on Python 3.10 AttributeError.
    except (OSError, ValueError, TypeError, AttributeError, EOFError, BadZipFile, zlib.error) as e:
        raise MienError(f"{path} is not a readable npz file ({e}); create it again") from e


def _array(values: Mapping[str, Any], key: str, shape: tuple[int, ...], path: Path) -> Array | None:
    """The numbers (frames, *shape) with this name; None if there are none."""
    if key not in values:
        return None
    try:
        array = np.asarray(values[key], dtype=float)
    except ValueError as e:
        raise MienError(f"{path}: {key} holds no numbers ({e}); create the file again") from e
    fits = array.ndim > 0 and array.shape[1:] == shape
    require(fits, f"{path}: {key} of each frame must have the shape {shape}; create the file again")
    return array
