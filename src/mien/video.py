"""Sources of frames: a file, a folder of images, a camera, or frames that a program reads itself.

Times are the container's time stamps in seconds, even if the frame rate varies. Every frame becomes 8-bit RGB with
square pixels, rotated and mirrored as the container says. A frame whose size differs from that of the first is scaled
to fit it, with black borders and a warning. Frames are decoded one at a time.
"""

from __future__ import annotations

import itertools
import math
import os
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
from numpy.typing import NDArray

from mien.arrays import Pixels
from mien.errors import MienError, require, warn
from mien.files import real_path, reason_of
from mien.frame import Decoded, Display, Frame

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
VIDEO_SUFFIXES = (
    ".3gp", ".asf", ".avi", ".dv", ".flv", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf",
    ".ogv", ".ts", ".vob", ".webm", ".wmv",
)  # fmt: skip
"""What counts as a video when a folder is searched; a file given by name may have any suffix."""
FOLDER_FPS = 25.0
"""Frame rate assumed for a folder of images, which carries no time stamps."""
_JUMP_S = 1.0
"""A backward step in time larger than this means that files were joined; a smaller one is a single wrong time stamp."""
BUFFER_BYTES = 1 << 29
"""Memory, in bytes, for the frames that are buffered to play a video backwards."""
_MAXIMUM_ASPECT = 4.0
"""Pixel aspect ratio above which (or below whose inverse) the header is taken to be wrong."""


class Video(Protocol):
    """A source of frames; each iteration decodes from the beginning.

    path: the file or folder, None for a source that yields each frame only once; fps: mean frames per second;
    frame_count: expected number of frames, None if unknown.
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
"""A file, a folder of images, the number of a camera, or frames that your own program reads."""


def open_video(source: Source) -> Video:
    """Open a video file, a folder of images sorted by name, a camera by its number, or an iterable of frames.

    Raises MienError if the file does not exist or is not a video.
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
    require(
        "://" not in str(source), f"{source} is not a file; read the stream yourself and pass frames to mien.stream"
    )
    require(path.exists(), f"{path}: no such file; check the name")
    require(
        path.is_dir() or path.is_file(),
        f"{path} is a pipe or a device, but a video is read more than once; save it as a file, or pass its frames to "
        "mien.stream",
    )
    return _open_folder(path) if path.is_dir() else _open_file(path)


def select(video: Video, start: float | None = None, end: float | None = None) -> Iterator[Frame]:
    """The frames in the half-open interval `start <= time < end` (seconds), with their indices in the whole video.

    Frames before `start` are decoded and skipped, so that indices stay exact. Raises MienError if the interval is
    empty or contains no frame.
    """
    require(start is None or end is None or start < end, f"the start {start} s must come before the end {end} s")
    last, found, ended = -math.inf, False, False
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
    require(found or last > -math.inf, f"{video.name}: there is no frame")
    nearest = "the next" if ended else "its last"
    require(found, f"{video.name} has no frame{after}{before}; {nearest} is at {last:g} s")


def backwards(video: Video, begin: float, end: int) -> Iterator[Frame]:
    """The frames with `time >= begin` (seconds) and `index < end`, in reverse order.

    At most `BUFFER_BYTES` of frames are buffered at a time; a longer interval is decoded again in parts.
    """
    remaining: list[tuple[int, float]] = []
    buffer: deque[Frame] = deque()
    for frame in video:
        if frame.index >= end:
            break
        if frame.time >= begin:
            remaining.append((frame.index, frame.time))
            buffer.append(frame)
            if len(buffer) > 1 and len(buffer) * 3 * frame.height * frame.width > BUFFER_BYTES:
                buffer.popleft()
    capacity = len(buffer)
    while buffer:
        remaining = remaining[: -len(buffer)]
        size = buffer[0].height, buffer[0].width
        while buffer:
            yield buffer.pop()
        buffer.extend(_decode_frames(video, remaining[-capacity:], size))


def decode_frame(video: Video, like: Frame, index: int, time: float) -> Frame:
    """Decode the frame with this index and time (seconds), in the size of the frame `like`, if possible from the
    nearest key frame."""
    return _decode_frames(video, [(index, time)], (like.height, like.width))[0]


def _decode_frames(video: Video, stamps: Sequence[tuple[int, float]], size: tuple[int, int]) -> list[Frame]:
    """Decode the frames with these indices and times: from the nearest key frame, or from the beginning if time jumps
    back or seeking does not find them all."""
    if not stamps:
        return []
    indices, times = zip(*stamps, strict=True)
    if isinstance(video, VideoFile) and video.in_order:
        found = list(video.between(times[0], times[-1]))
        if [f.time for f in found] == list(times) and all((f.height, f.width) == size for f in found):
            return [Frame(f.image, index, f.time) for f, index in zip(found, indices, strict=True)]
    until = itertools.takewhile(lambda frame: frame.index <= indices[-1], video)
    wanted = set(indices)
    return [frame for frame in until if frame.index in wanted]


def expected_count(video: Video, start: float | None = None, end: float | None = None) -> int | None:
    """Approximate number of frames that `select` will yield; None if unknown."""
    if video.frame_count is None:
        return None
    first = 0 if start is None else math.ceil(start * video.fps - 1e-6)
    stop = video.frame_count if end is None else math.ceil(end * video.fps - 1e-6)
    return max(min(stop, video.frame_count) - first, 1)


@dataclass(frozen=True)
class VideoFile:
    """A file that FFmpeg reads, with what its header states; 0 means not stated.

    begin, duration: seconds; declared: number of frames; aspect: width of a pixel over its height; may_jump: whether
    the container format allows files to be concatenated, so that time may jump back.
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
        return _same_size(self._frames(), self.name)

    @cached_property
    def in_order(self) -> bool:
        """Whether time never jumps back; in concatenated files it does, and two frames may have the same time. If the
        format allows it, the packets of the whole file are read once to find out."""
        if not self.may_jump:
            return True
        import av

        with _container(self.path) as container:
            packets = container.demux(_stream(container))
            times = (packet.dts for packet in packets if packet.dts is not None)
            try:
                return all(before <= after for before, after in itertools.pairwise(times))
            except av.error.FFmpegError:
                return False

    def between(self, begin: float, until: float) -> Iterator[Frame]:
        """The frames in the closed interval [begin, until] (seconds), without index and in their original size.

        Decoding starts at the key frame before `begin`; in some containers seeking misses it, and frames are missing.
        """
        display = Display()
        for image in _decoded(self.path, begin):
            if image is None or image.time is None or image.time > until:
                return
            if image.time >= begin:
                yield Frame(Decoded(image, display, self.aspect), time=float(image.time))

    def _frames(self) -> Iterator[Frame]:
        display = Display()
        count, time, until, damaged = 0, self.begin, self.begin, False
        offset = 0.0  # added to the time stamps after a backward jump
        for image in _decoded(self.path):
            if image is None:
                damaged = True
                continue
            stamp = until if image.time is None else float(image.time) + offset
            if count > 0 and stamp < time - _JUMP_S:
                if offset == 0:
                    warn(f"{self.path}: time jumps back from {time:.2f} to {stamp:.2f} s; later times are shifted")
                offset += until - stamp
            time = stamp if count == 0 or stamp > time else until
            until = time + (float(image.duration * image.time_base) if image.duration else 1 / self.fps)
            yield Frame(Decoded(image, display, self.aspect), count, time)
            count += 1
        require(
            count > 0,
            f"{self.path}: no frame could be decoded; the file is empty, damaged, or of a kind that is not supported; "
            "convert it to MP4",
        )
        if damaged or self._ends_early(count, until):
            of = f" of {self.declared}" if self.declared else ""
            warn(f"{self.path} is truncated or damaged: {count}{of} frames were decoded, to {time:.2f} s")

    def _ends_early(self, count: int, until: float) -> bool:
        """Whether frames are missing after `until`; without a stated count, the duration may be that of the audio."""
        missing = self.begin + self.duration - until
        if self.declared == 0:
            return missing > max(1.0, 0.05 * self.duration)
        # A part that was cut out without decoding has frames before it that count, but are not shown.
        return missing * self.fps > max(0.5, 0.5 * (self.declared - count)) and count < self.declared


@dataclass(frozen=True)
class ImageFolder:
    """The images of a folder in natural order of their names, at `FOLDER_FPS` frames per second."""

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
        return _same_size(self._frames(), self.name)

    def _frames(self) -> Iterator[Frame]:
        count = bits = 0
        for index, file in enumerate(self.images):
            image = _read_image(file)
            if image is None:
                warn(f"{file} is not a readable image and was skipped")
                continue
            if image.dtype == np.uint16:
                bits = max(bits, int(image.max()).bit_length())
                image = _eight_bit(image, bits)
            yield Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), index, index / self.fps)
            count += 1
        require(count > 0, f"{self.path}: none of its {len(self.images)} images could be read; check the files")


def _read_image(file: Path) -> Any:
    """An image (H, W, 3) in BGR, uint8 or uint16, upright as its metadata says; None if it cannot be read."""
    try:
        data = np.fromfile(file, np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH) if data.size else None
    if image is None or image.dtype in (np.uint8, np.uint16):
        return image
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def _eight_bit(image: NDArray[np.uint16], bits: int) -> Pixels:
    """The upper 8 of the bits that are used: cameras store 10 or 12 bits in files of 16."""
    used = next(depth for depth in (8, 10, 12, 14, 16) if depth >= bits)
    return (image >> (used - 8)).astype(np.uint8)


@dataclass(frozen=True)
class CameraDevice:
    """A camera by its number; times are seconds since its first frame. Iteration ends when the camera stops."""

    number: int
    path: None = None
    frame_count: None = None
    fps: float = 30.0

    @property
    def name(self) -> str:
        return f"camera {self.number}"

    def __iter__(self) -> Iterator[Frame]:
        log: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5, else OpenCV 4
        level = log.getLogLevel()
        log.setLogLevel(0)  # the error below replaces OpenCV's messages
        device = cv2.VideoCapture(self.number)
        log.setLogLevel(level)
        try:
            require(device.isOpened(), f"camera {self.number} cannot be opened; check that it is connected")
            first: float | None = None
            for index in itertools.count():
                success, image = device.read()
                if not success:
                    return
                now = perf_counter()
                first = now if first is None else first
                yield Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), index, now - first)
        finally:
            device.release()


@dataclass(frozen=True)
class GivenFrames:
    """Frames that a program reads itself; like those of a camera, each can be read only once."""

    frames: Iterable[Frame]
    path: None = None
    frame_count: None = None
    fps: float = 30.0
    name: str = "the frames"

    def __iter__(self) -> Iterator[Frame]:
        return _same_size(self._checked(), self.name)

    def _checked(self) -> Iterator[Frame]:
        last, time = -1, -math.inf
        for frame in self.frames:
            require(
                isinstance(frame, Frame), f"{type(frame)} is no frame; give each as mien.Frame(pixels, index, time)"
            )
            require(frame.index >= 0, f"a frame has the index {frame.index}; count them from 0")
            require(
                frame.index > last,
                f"frame {frame.index} comes after frame {last}; number them in order: mien.Frame(pixels, index, time)",
            )
            require(
                frame.time > time,
                f"frame {frame.index} has the time {frame.time:g} s after {time:g} s; give increasing seconds, as in "
                "mien.Frame(pixels, index, time.perf_counter())",
            )
            last, time = frame.index, frame.time
            yield frame


def _open_file(path: Path) -> VideoFile:
    with _container(path) as container:
        stream = _stream(container)
        fps = float(stream.average_rate or stream.guessed_rate or FOLDER_FPS)
        begin = stream.start_time * stream.time_base if stream.start_time else 0.0
        length = stream.duration * stream.time_base if stream.duration else (container.duration or 0) * 1e-6
        if container.format.name == "avi" and stream.frames:  # FFmpeg shortens the duration of a truncated file
            length = stream.frames / fps
        matroska = "matroska" in container.format.name
        if matroska:  # its duration is the end time of the last frame
            length = max(length - begin, 0)
        aspect = float(stream.sample_aspect_ratio or 1)
        aspect = aspect if 1 / _MAXIMUM_ASPECT <= aspect <= _MAXIMUM_ASPECT else 1.0
        may_jump = not (stream.frames or matroska)
        return VideoFile(path, fps, float(begin), float(length), int(stream.frames), aspect, may_jump)


def list_images(folder: Path) -> list[Path]:
    """The images of a folder in natural order: frame2 before frame10."""
    found = (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))
    return sorted(found, key=_natural_order)


def refuse_among_images(path: Path, video: Path) -> None:
    """Raise MienError if a file to be written would become one of the images of a folder that is a video."""
    among = path.suffix.lower() in IMAGE_SUFFIXES and video.is_dir() and real_path(path.parent) == real_path(video)
    require(not among, f"{path} would become an image of the video {video}; choose a place outside of it")


def _open_folder(path: Path) -> ImageFolder:
    images = list_images(path)
    require(bool(images), f"{path} holds no images; mien reads {', '.join(IMAGE_SUFFIXES)}")
    return ImageFolder(path, tuple(images))


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort key for natural order."""
    parts = re.split(r"([0-9]+)", path.name)  # text and numbers alternate
    return [(int(part), "") if k % 2 else (0, part) for k, part in enumerate(parts)] + [(0, path.name)]


def _container(path: Path) -> Any:
    import av

    try:
        # An absolute path, since what stands before a colon would be taken for a protocol.
        container = av.open(os.path.abspath(path), metadata_errors="ignore")
    except (av.error.FFmpegError, OSError) as error:
        raise MienError(f"{path} cannot be read as a video ({reason_of(error)}); check or convert the file") from error
    # FFmpeg accepts any text file as the format "tty", terminal output.
    if _stream(container) is None or container.format.name == "tty":
        container.close()
        raise MienError(f"{path} is not a video; give a video file or a folder of images")
    return container


def _stream(container: Any) -> Any:
    """The video stream that players show; None if there is none but the cover picture of a sound file."""
    from av.stream import Disposition

    streams = [stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic]
    best = container.streams.best("video")
    return best if best in streams else next(iter(streams), None)


def _decoded(path: Path, begin: float | None = None) -> Iterator[Any]:
    """Images as PyAV decodes them, with None for a damaged packet, from the beginning or from the key frame before
    `begin` (seconds)."""
    import av

    with _container(path) as container:
        stream = _stream(container)
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


def _same_size(frames: Iterator[Frame], name: str) -> Iterator[Frame]:
    """The frames, all scaled to the size of the first; warns once."""
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
            frame = Frame(_letterboxed(frame.pixels, size), frame.index, frame.time)
        yield frame


def _letterboxed(pixels: Pixels, size: tuple[int, int]) -> Pixels:
    """The image scaled to fit `size` (width, height), with its aspect ratio kept and black borders."""
    height, width = pixels.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    inner = (max(round(scale * width), 1), max(round(scale * height), 1))
    x, y = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    fitted = np.zeros((size[1], size[0], 3), np.uint8)
    fitted[y : y + inner[1], x : x + inner[0]] = cv2.resize(pixels, inner, interpolation=cv2.INTER_AREA)
    return fitted
