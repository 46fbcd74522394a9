"""A folder of images as a video: which files count, in which order, and how an image becomes 8-bit RGB."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Pixels
from mien.errors import require, warn
from mien.files import printable, real_path
from mien.frame import Frame
from mien.video.container import VIDEO_SUFFIXES
from mien.video.opencv_log import opencv_silenced
from mien.video.scaling import same_size

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
_PAGED = (".tif", ".tiff", ".webp")
"""Endings of files that may hold several images."""
_SAMPLED_IMAGES = 16
"""Number of images that are looked at to find out how many bits a folder of 16-bit images uses."""
FOLDER_FPS = 25.0
"""Frame rate assumed for a folder of images, which carries no time stamps."""
_NUMBER = r"([0-9]+)"
_GAP = 1.5
"""Step between the numbers in two names, as a multiple of the smallest step, above which images are missing."""


@dataclass(frozen=True)
class ImageFolder:
    """The images of a folder in natural order of their names, at `fps` frames per second."""

    path: Path
    images: tuple[Path, ...]
    fps: float = FOLDER_FPS

    repeatable = True
    stopped = None
    begin = 0.0

    @property
    def name(self) -> str:
        return str(self.path)

    @property
    def frame_count(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[Frame]:
        return same_size(self._frames(), self.name)

    def _frames(self) -> Iterator[Frame]:
        count = 0
        for index, file in enumerate(self.images):
            image = _read_image(file)
            if image is None:
                warn(f"{file} {_why_unread(file)}")
                continue
            if image.dtype == np.uint16:
                image = _eight_bit(image, self._bits)
            yield Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), index, index / self.fps)
            count += 1
        require(count > 0, f"{self.path}: none of its {len(self.images)} images could be read; check the files")

    @cached_property
    def _bits(self) -> int:
        """How many of 16 bits the images use: as many as any of a sample, so that their brightness stays alike."""
        sample = (_read_image(file) for file in self.images[:: math.ceil(len(self.images) / _SAMPLED_IMAGES)])
        return max((int(image.max()).bit_length() for image in sample if image is not None), default=0)


def open_folder(path: Path, fps: float | None) -> ImageFolder:
    """A folder of images as a video, at `FOLDER_FPS` if no frame rate is given. Raises MienError if it holds none."""
    images = list_images(path)
    videos = sum(1 for file in path.iterdir() if file.suffix.lower() in VIDEO_SUFFIXES and file.is_file())
    batch = f"mien batch {path} tracks its videos"
    remedy = batch if videos else f"mien reads {', '.join(IMAGE_SUFFIXES)}"
    require(bool(images), f"{path} holds no images; {remedy}")
    _warn_of_others(path, images, videos, batch)
    _warn_of_gap(path, images)
    return ImageFolder(path, tuple(images), FOLDER_FPS if fps is None else float(fps))


def _warn_of_others(path: Path, images: list[Path], videos: int, batch: str) -> None:
    """Warn if a folder is probably not meant as one video of one image a frame. videos: their number in it; batch: how
    to track these."""
    if videos > len(images):  # and not an overlay or two of theirs
        warn(f"{path} holds {videos} videos beside the images that are read as one, {len(images)} of them; {batch}")
    stems = {file.stem for file in images}
    if len(stems) <= len(images) // 2:
        warn(f"{path} holds images of the same names in several formats; each is read as a frame of its own")
    if images[0].suffix.lower() in _PAGED and _count_in(images[0]) > 1:
        warn(f"{images[0]} holds several images, of which the first is read, as of others like it")


def _count_in(file: Path) -> int:
    """Number of images in a file; 1 for a name that is not valid UTF-8, at which OpenCV would crash."""
    name = str(file)
    with opencv_silenced():
        return int(cv2.imcount(name)) if printable(name) == name else 1


def _warn_of_gap(path: Path, images: list[Path]) -> None:
    """Warn if the numbers in the names of images grow by more in one place than in another."""
    steps = [_step(before.name, after.name) for before, after in itertools.pairwise(images)]
    usual = min((step for step in steps if step > 0), default=0)
    after = next((k for k, step in enumerate(steps, start=1) if step > _GAP * usual), None)
    if after is not None:
        warn(
            f"{path}: {images[after].name} comes after {images[after - 1].name}; gaps in the numbers have no frames "
            "and take no time"
        )


def _step(before: str, after: str) -> int:
    """The difference of the numbers in two names that differ in one number and nothing else; 0 for other names."""
    parts = zip(re.split(_NUMBER, before), re.split(_NUMBER, after), strict=False)
    changed = [pair for pair in parts if pair[0] != pair[1]]
    if len(changed) != 1 or not "".join(changed[0]).isdecimal():
        return 0
    return int(changed[0][1]) - int(changed[0][0])


def list_images(folder: Path) -> list[Path]:
    """The images of a folder in natural order: frame2 before frame10."""
    found = (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))
    return sorted(found, key=_natural_order)


def refuse_among_images(path: Path, video: Path) -> None:
    """Raise MienError if a file to be written would become one of the images of a folder that is a video."""
    among = path.suffix.lower() in IMAGE_SUFFIXES and video.is_dir() and real_path(path.parent) == real_path(video)
    require(not among, f"{path} would become an image of the video {video}; choose a place outside of it")


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort key for natural order."""
    parts = re.split(_NUMBER, path.name)  # text and numbers alternate
    return [(int(part), "") if k % 2 else (0, part) for k, part in enumerate(parts)] + [(0, path.name)]


def _read_image(file: Path) -> Any:
    """An image (H, W, 3) in BGR, uint8 or uint16, upright as its metadata says; None if it cannot be read."""
    image = _decoded(file, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if image is None or image.dtype.itemsize > 2:
        return None
    return image if image.dtype in (np.uint8, np.uint16) else _decoded(file, cv2.IMREAD_COLOR)


def _why_unread(file: Path) -> str:
    """Why an image was not read, and what helps, as the end of a sentence."""
    image = _decoded(file, cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype.itemsize <= 2:
        return "is not a readable image and was skipped"
    bits = 8 * image.dtype.itemsize
    return f"has {bits} bits per channel, which mien does not read, and was skipped; convert it to 8 or 16 bits"


def _decoded(file: Path, how: int) -> Any:
    """An image as OpenCV decodes it with these flags; None if it does not."""
    try:
        data = np.fromfile(file, np.uint8)
    except OSError:
        return None
    if not data.size:
        return None
    try:
        with opencv_silenced():
            return cv2.imdecode(data, how)
    except cv2.error:  # it states a size that no image has
        return None


def _eight_bit(image: NDArray[np.uint16], bits: int) -> Pixels:
    """The upper 8 of the bits that are used: cameras store 10 or 12 bits in files of 16. What exceeds them is white."""
    used = next(depth for depth in (8, 10, 12, 14, 16) if depth >= bits)
    return (np.minimum(image, (1 << used) - 1) >> (used - 8)).astype(np.uint8)
