"""Where frames come from: a file, a folder of images, a camera, a program that reads them itself.

Times are the container's own time stamps in seconds, also where the frame rate varies. Everything becomes
RGB with 8 bits, turned and mirrored as the container says, and its pixels square. A frame whose size differs from the
first one's is scaled into it without distortion, with black borders and a warning. Frames are decoded one at a time.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import cv2
import numpy as np

from mien.errors import MienError, require, warn
from mien.frame import Decoded, Frame, Pixels

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
VIDEO_SUFFIXES = (
    ".3gp", ".asf", ".avi", ".dv", ".flv", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf",
    ".ogv", ".ts", ".vob", ".webm", ".wmv",
)  # fmt: skip
"""What is a video where a folder is searched for them; a file that is named may have any ending."""
FOLDER_FPS = 25.0
"""Frames per second of a folder of images, which carries no time."""
_JUMP_S = 1.0
"""By how much time jumps back where files were joined; by less where a time stamp is wrong alone."""
HELD_BYTES = 1 << 29
"""How much of a video is held in memory to play it backwards."""
_NARROWEST = 4.0
"""Proportion of a pixel's sides beyond which a header that states it is wrong."""


class Video(Protocol):
    """Where frames come from; iterating decodes from the beginning.

    path: the file or folder, None where every frame is shown once; fps: frames per second, on average;
    frame_count: how many frames to expect, None where nothing says so.
    """

    @property
    def name(self) -> str: ...
    @property
    def path(self) -> Path | None: ...
    @property
    def fps(self) -> float: ...
    @property
    def frame_count(self) -> int | None: ...
    def __iter__(self) -> Iterator[Frame]: ...


Source = str | Path | int | Iterable[Frame]
"""A file, a folder of images, a camera's number, or frames that a program of yours reads."""


def open_video(source: Source) -> Video:
    """The frames of a video file, of a folder of images sorted by name, of a camera by its number, or these frames.

    Raises MienError where there is no such file or it is not a video.
    """
    number = isinstance(source, Integral) and not isinstance(source, bool)
    if isinstance(source, Iterable) and not isinstance(source, (str, bytes, np.ndarray)):
        return GivenFrames(source)
    require(
        number or isinstance(source, (str, Path)),
        f"a video is a file, a folder, a number or an iterable of mien.Frame, not {type(source)}",
    )
    require(str(source) != "", "the name of the video is empty; give a file, a folder of images or a camera's number")
    path = Path(str(source))
    if number or (str(source).isdecimal() and not path.exists()):
        return CameraDevice(int(str(source)))
    require("://" not in str(source), f"{source} is no file; of a stream give the frames, see mien.stream")
    require(path.exists(), f"{path}: no such file; check the name")
    require(
        path.is_dir() or path.is_file(),
        f"{path} is a pipe or a device, and a video is read more than once; save it as a file, or give its frames to "
        "mien.stream",
    )
    return _open_folder(path) if path.is_dir() else _open_file(path)


def select(video: Video, start: float | None = None, end: float | None = None) -> Iterator[Frame]:
    """The frames with `start <= time < end` (seconds), each with its index in the whole video.

    Frames before `start` are decoded and passed over, so that indices stay exact. Raises MienError if the
    interval is empty or holds no frame.
    """
    require(start is None or end is None or start < end, f"the start {start} s must come before the end {end} s")
    last, found, ended = 0.0, False, False
    for frame in video:
        last = frame.time
        ended = end is not None and last >= end
        if ended:
            break
        if start is None or last >= start:
            found = True
            yield frame
    after = "" if start is None else f" from {start:g} s" + (" on" if end is None else "")
    before = "" if end is None else f" before {end:g} s"
    there = "the next" if ended else "its last"
    require(found, f"{video.name} has no frame{after}{before}; {there} is at {last:g} s")


def backwards(video: Video, begin: float, end: int) -> Iterator[Frame]:
    """The frames from `begin` (seconds) on whose index is less than `end`, the last first.

    No more of them are held at a time than `HELD_BYTES` allow: where there are more, each part is decoded anew.
    """
    there: list[tuple[int, float]] = []
    held: deque[Frame] = deque()
    for frame in video:
        if frame.index >= end:
            break
        if frame.time >= begin:
            there.append((frame.index, frame.time))
            held.append(frame)
            if len(held) > 1 and len(held) * 3 * frame.height * frame.width > HELD_BYTES:
                held.popleft()
    most = len(held)
    while held:
        there = there[: -len(held)]
        size = held[0].height, held[0].width
        while held:
            yield held.pop()
        held.extend(_part(video, there[-most:], size))


def decoded_again(video: Video, frame: Frame, index: int, time: float) -> Frame:
    """The frame of a video with an index and a time (seconds), as large as another one of its frames: from the nearest
    key frame on, where that finds it."""
    return _part(video, [(index, time)], (frame.height, frame.width))[0]


def _part(video: Video, there: Sequence[tuple[int, float]], size: tuple[int, int]) -> list[Frame]:
    """The frames with these indices and times: from the nearest key frame on, or, where time jumps back, or the
    container does not find them all so, from the beginning."""
    if not there:
        return []
    indices, times = zip(*there, strict=True)
    if isinstance(video, VideoFile) and video.in_order:
        found = list(video.between(times[0], times[-1]))
        if [f.time for f in found] == list(times) and all((f.height, f.width) == size for f in found):
            return [Frame(f.image, index, f.time) for f, index in zip(found, indices, strict=True)]
    until = itertools.takewhile(lambda frame: frame.index <= indices[-1], video)
    wanted = set(indices)
    return [frame for frame in until if frame.index in wanted]


def expected_count(video: Video, start: float | None = None, end: float | None = None) -> int | None:
    """How many frames `select` will give, about; None where nothing says so."""
    if video.frame_count is None:
        return None
    first = 0 if start is None else math.ceil(start * video.fps - 1e-6)
    behind = video.frame_count if end is None else math.ceil(end * video.fps - 1e-6)
    return max(min(behind, video.frame_count) - first, 1)


@dataclass(frozen=True)
class VideoFile:
    """A file that FFmpeg reads: what its header states of it, 0 where it states nothing.

    begin, duration: seconds; declared: number of frames; aspect: width of a pixel over its height; may_jump: whether
    files of its kind may be joined, so that time jumps back.
    """

    path: Path
    fps: float
    begin: float
    duration: float
    declared: int
    aspect: float = 1.0
    may_jump: bool = False

    @property
    def name(self) -> str:
        return str(self.path)

    @property
    def frame_count(self) -> int | None:
        return self.declared or round(self.duration * self.fps) or None

    def __iter__(self) -> Iterator[Frame]:
        return _one_size(self._frames(), self.name)

    @cached_property
    def in_order(self) -> bool:
        """Whether time never jumps back; in files that were joined it does, and a time may be that of two frames. Where
        it may, the file is read once to know."""
        if not self.may_jump:
            return True
        import av

        with _container(self.path) as container:
            packets = container.demux(container.streams.video[0])
            times = (packet.dts for packet in packets if packet.dts is not None)
            try:
                return all(before <= after for before, after in itertools.pairwise(times))
            except av.error.FFmpegError:
                return False

    def between(self, begin: float, until: float) -> Iterator[Frame]:
        """The frames from one time to another, both in seconds and included, without index and as large as they are.
        They are decoded from the last key frame on: some containers do not find that, and frames are missing."""
        converter = _converter()
        for image in _decoded(self.path, begin):
            if image is None or image.time is None or image.time > until:
                return
            if image.time >= begin:
                yield Frame(Decoded(image, converter, self.aspect), time=float(image.time))

    def _frames(self) -> Iterator[Frame]:
        converter = _converter()
        count, time, until, damaged = 0, self.begin, self.begin, False
        later = 0.0  # than the time stamps say
        for image in _decoded(self.path):
            if image is None:
                damaged = True
                continue
            told = until if image.time is None else float(image.time) + later
            if count > 0 and told < time - _JUMP_S:
                if later == 0:
                    warn(f"{self.path}: time jumps back from {time:.2f} to {told:.2f} s, and goes on as if it did not")
                later += until - told
            time = told if count == 0 or told > time else until
            until = time + (float(image.duration * image.time_base) if image.duration else 1 / self.fps)
            yield Frame(Decoded(image, converter, self.aspect), count, time)
            count += 1
        require(
            count > 0,
            f"{self.path}: no frame could be decoded; the file is empty, damaged, or of a kind that is not read; "
            "convert it to MP4",
        )
        if damaged or self._ends_early(count, until):
            of = f" of {self.declared}" if self.declared else ""
            warn(f"{self.path} is truncated or damaged: {count}{of} frames were decoded, to {time:.2f} s")

    def _ends_early(self, count: int, until: float) -> bool:
        """Whether frames are missing after `until`; with no count stated the length may be the sound's."""
        missing = self.begin + self.duration - until
        return missing > 0.5 / self.fps and (
            count < self.declared or (self.declared == 0 and missing > max(1.0, 0.05 * self.duration))
        )


@dataclass(frozen=True)
class ImageFolder:
    """Images of a folder in the order of their names and of the numbers in these, `FOLDER_FPS` a second."""

    path: Path
    images: tuple[Path, ...]
    fps: float = FOLDER_FPS

    @property
    def name(self) -> str:
        return str(self.path)

    @property
    def frame_count(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[Frame]:
        return _one_size(self._frames(), self.name)

    def _frames(self) -> Iterator[Frame]:
        count = 0
        for index, file in enumerate(self.images):
            image = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if image is None:
                warn(f"{file} is not a readable image and was left out")
                continue
            yield Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), index, index / self.fps)
            count += 1
        require(count > 0, f"{self.path}: none of its {len(self.images)} images could be read; check the files")


@dataclass(frozen=True)
class CameraDevice:
    """A camera by its number; times are seconds since its first frame. It ends when the camera does."""

    number: int
    path: None = None
    frame_count: None = None
    fps: float = 30.0

    @property
    def name(self) -> str:
        return f"camera {self.number}"

    def __iter__(self) -> Iterator[Frame]:
        log: Any = getattr(cv2.utils, "logging", cv2)  # where OpenCV 5 keeps it, and where 4 does
        level = log.getLogLevel()
        log.setLogLevel(0)  # what is wrong is said below
        device = cv2.VideoCapture(self.number)
        log.setLogLevel(level)
        try:
            require(device.isOpened(), f"camera {self.number} cannot be opened; check that it is connected")
            first: float | None = None
            for index in itertools.count():
                there, image = device.read()
                if not there:
                    return
                now = perf_counter()
                first = now if first is None else first
                yield Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), index, now - first)
        finally:
            device.release()


@dataclass(frozen=True)
class GivenFrames:
    """Frames that a program reads itself, each once, as of a camera; they end when it ends them."""

    frames: Iterable[Frame]
    path: None = None
    frame_count: None = None
    fps: float = 30.0
    name: str = "the frames"

    def __iter__(self) -> Iterator[Frame]:
        return _one_size(self._checked(), self.name)

    def _checked(self) -> Iterator[Frame]:
        last, time = -1, -math.inf
        for frame in self.frames:
            require(
                isinstance(frame, Frame), f"{type(frame)} is no frame; give each as mien.Frame(pixels, index, seconds)"
            )
            require(
                frame.index > last,
                f"frame {frame.index} comes after frame {last}; number them, as mien.Frame(pixels, index, seconds)",
            )
            require(
                frame.time > time,
                f"frame {frame.index} has the time {frame.time:g} s after {time:g} s; give seconds that grow, as "
                "mien.Frame(pixels, index, time.perf_counter())",
            )
            last, time = frame.index, frame.time
            yield frame


def _open_file(path: Path) -> VideoFile:
    with _container(path) as container:
        stream = container.streams.video[0]
        fps = float(stream.average_rate or stream.guessed_rate or FOLDER_FPS)
        begin = stream.start_time * stream.time_base if stream.start_time else 0.0
        length = stream.duration * stream.time_base if stream.duration else (container.duration or 0) * 1e-6
        if container.format.name == "avi" and stream.frames:  # FFmpeg shortens it where the file is cut
            length = stream.frames / fps
        matroska = "matroska" in container.format.name
        if matroska:  # there it is when the last frame ends
            length = max(length - begin, 0)
        aspect = float(stream.sample_aspect_ratio or 1)
        aspect = aspect if 1 / _NARROWEST <= aspect <= _NARROWEST else 1.0
        may_jump = not (stream.frames or matroska)
        return VideoFile(path, fps, float(begin), float(length), int(stream.frames), aspect, may_jump)


def images_of(folder: Path) -> list[Path]:
    """The images of a folder in the order of their names and of the numbers in these."""
    found = (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))
    return sorted(found, key=_by_number)


def _open_folder(path: Path) -> ImageFolder:
    images = images_of(path)
    require(bool(images), f"{path} holds no image; mien reads {', '.join(IMAGE_SUFFIXES)}")
    return ImageFolder(path, tuple(images))


def _by_number(path: Path) -> list[tuple[int, str]]:
    """What sorts names with numbers in them as people count: frame2 before frame10."""
    parts = re.split(r"([0-9]+)", path.name)  # text and numbers by turns
    return [(int(part), "") if k % 2 else (0, part) for k, part in enumerate(parts)] + [(0, path.name)]


def _container(path: Path) -> Any:
    import av

    try:
        container = av.open(str(path), metadata_errors="ignore")
    except (av.error.FFmpegError, OSError) as error:
        reason = (error.strerror or str(error)).lower()
        raise MienError(f"{path} cannot be read as a video ({reason}); check or convert the file") from error
    # FFmpeg reads any text as the output of a terminal.
    if not container.streams.video or container.format.name == "tty":
        container.close()
        raise MienError(f"{path} is not a video; give a video file or a folder of images")
    return container


def _decoded(path: Path, begin: float | None = None) -> Iterator[Any]:
    """Images as PyAV decodes them, and None for a packet that is damaged; from the last key frame before `begin`
    (seconds) on."""
    import av

    with _container(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        try:
            if begin is not None:
                container.seek(math.floor(begin / stream.time_base), stream=stream)
        except av.error.FFmpegError:
            return
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets)
                images = packet.decode()
            except StopIteration:
                return
            except av.error.EOFError:
                return
            except av.error.FFmpegError:
                yield None
                continue
            yield from images


def _converter() -> Any:
    from av.video.reformatter import VideoReformatter

    return VideoReformatter()


def _one_size(frames: Iterator[Frame], name: str) -> Iterator[Frame]:
    """The frames, all of the size of the first."""
    size: tuple[int, int] | None = None
    warned = False
    for frame in frames:
        size = size or (frame.width, frame.height)
        if (frame.width, frame.height) != size:
            if not warned:
                warn(
                    f"{name}: frame {frame.index} has {frame.width}x{frame.height} pixels and the first "
                    f"{size[0]}x{size[1]}; frames of another size are scaled to fit the first"
                )
            warned = True
            frame = Frame(_fitted(frame.pixels, size), frame.index, frame.time)
        yield frame


def _fitted(pixels: Pixels, size: tuple[int, int]) -> Pixels:
    """The image scaled into `size` (width, height), its proportions kept, the rest black."""
    height, width = pixels.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    inner = (max(round(scale * width), 1), max(round(scale * height), 1))
    x, y = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    fitted = np.zeros((size[1], size[0], 3), np.uint8)
    fitted[y : y + inner[1], x : x + inner[0]] = cv2.resize(pixels, inner, interpolation=cv2.INTER_AREA)
    return fitted
