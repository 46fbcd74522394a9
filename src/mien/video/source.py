"""What a source of frames is, and how one is opened.

A new kind of source gets a file of its own beside this one, and a line in `open_video`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from numbers import Integral, Real
from pathlib import Path
from typing import Protocol

import numpy as np

from mien.errors import MienError, require
from mien.files import user_path
from mien.frame import Frame
from mien.video.file import open_file
from mien.video.folder import ImageFolder, open_folder
from mien.video.given import CameraDevice, GivenFrames

_LEAST_FPS, _MOST_FPS = 1e-6, 1e6
"""Frames per second that a folder of images may have: one in eleven days, and as many as tables tell apart, which round
times to millionths of a second."""


class Video(Protocol):
    """A source of frames; each iteration begins with the first, if it is repeatable.

    name: in messages; path: the file or folder, None if there is none; repeatable: whether frames can be read again,
    and not only once; fps: mean frames per second; begin: time in seconds of the first frame, as far as it is known
    beforehand; frame_count: expected number of frames, None if unknown; stopped: why the frames ended that should have
    gone on, None if they did not.
    """

    @property
    def name(self) -> str: ...
    @property
    def path(self) -> Path | None: ...
    @property
    def repeatable(self) -> bool: ...
    @property
    def fps(self) -> float: ...
    @property
    def begin(self) -> float: ...
    @property
    def frame_count(self) -> int | None: ...
    @property
    def stopped(self) -> str | None: ...
    def __iter__(self) -> Iterator[Frame]: ...


Source = str | Path | int | Iterable[Frame]
"""A file, a folder of images, the number of a camera, or frames that your own program reads: in a list or tuple, which
is read like a file, or one after the other, like a camera's."""


def open_video(source: Source, fps: float | None = None) -> Video:
    """Open a video file, a folder of images sorted by name, a camera by its number, or an iterable of frames.

    fps: frames per second of a folder of images, by default `FOLDER_FPS`; all others have times of their own. Raises
    MienError if the file does not exist or is not a video.
    """
    check_fps(fps)
    video = _opened(source, fps)
    require(
        fps is None or isinstance(video, ImageFolder),
        f"{video.name} has times of its own; omit fps, which is for a folder of images",
    )
    return video


def check_fps(fps: float | None) -> None:
    """Raise MienError for a number of frames per second that no folder of images can have."""
    rate = fps is None or (isinstance(fps, Real) and _LEAST_FPS <= fps <= _MOST_FPS)
    require(
        rate,
        f"fps is {fps!r}; give a positive number of frames per second from {_LEAST_FPS:g} to {_MOST_FPS:g}, or omit it",
    )


def is_camera_number(source: str) -> bool:
    """Whether this is the number of a camera, and not the name of a file or folder."""
    return source.isdecimal() and not user_path(source).exists()


def _opened(source: Source, fps: float | None) -> Video:
    """The video of a source; see `open_video`."""
    number = isinstance(source, Integral) and not isinstance(source, bool)
    if isinstance(source, Iterable) and not isinstance(source, (str, bytes, np.ndarray)):
        return GivenFrames(source)
    require(
        number or isinstance(source, (str, Path)),
        f"a video is a file, a folder, a number or an iterable of mien.Frame, not {type(source)}",
    )
    require(str(source) != "", "the name of the video is empty; give a file, a folder of images or a camera's number")
    path = user_path(str(source))
    if number or is_camera_number(str(source)):
        return CameraDevice(int(str(source)))
    require(
        "://" not in str(source), f"{source} is not a file; read the stream yourself and pass frames to mien.stream"
    )
    device = re.fullmatch(r"/dev/video(\d+)", os.path.realpath(path)) if path.is_relative_to("/dev") else None
    if device is not None:
        raise MienError(f"{path} is a camera, which has a number; give {device[1]}")
    require(path.exists(), f"{path}: no such file; check the name")
    require(
        path.is_dir() or path.is_file(),
        f"{path} is a pipe or a device, but a video is read more than once; save it as a file, or pass its frames to "
        "mien.stream",
    )
    return open_folder(path, fps) if path.is_dir() else open_file(path)
