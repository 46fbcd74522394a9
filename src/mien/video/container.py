"""What PyAV is asked for: to open a file, which of its streams is shown, and the images decoded from that."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from mien.errors import MienError, require
from mien.files import reason_of, size_of

VIDEO_SUFFIXES = (
    ".3gp", ".asf", ".avi", ".dv", ".flv", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf",
    ".ogv", ".ts", ".vob", ".webm", ".wmv",
)  # fmt: skip
"""What counts as a video when a folder is searched; a file given by name may have any suffix."""
DTS_ONLY = ("asf", "avi")
"""Formats with decoding time stamps (DTS), but no presentation time stamps (PTS). What FFmpeg takes for the latter is
wrong where images are not shown in the order in which they are decoded."""


def open_container(path: Path) -> Any:
    """The container of a file with a video stream. Raises MienError for any other file."""
    import av

    require(size_of(path) != 0, f"{path} is empty; copy or record the video again")
    try:
        # An absolute path, since what stands before a colon would be taken for a protocol.
        container = av.open(os.path.abspath(path), metadata_errors="ignore")
    except (av.error.FFmpegError, OSError) as error:
        raise MienError(f"{path} cannot be read as a video ({reason_of(error)}); check or convert the file") from error
    stream = shown_stream(container)
    # FFmpeg accepts any text file as the format "tty", terminal output.
    if stream is None or container.format.name == "tty":
        container.close()
        raise MienError(f"{path} is not a video; give a video file or a folder of images")
    if stream.codec_context is None:
        container.close()
        raise MienError(f"{path}: the video is damaged, or of a kind that is not supported; convert it to MP4")
    return container


def shown_stream(container: Any) -> Any:
    """The video stream that players show; None if there is none but the cover picture of a sound file."""
    from av.stream import Disposition

    streams = [stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic]
    best = container.streams.best("video")
    return best if best in streams else next(iter(streams), None)


def start_of(container: Any) -> Fraction:
    """Seconds at which a file starts, with its video or its sound, from which times are counted, as players do; 0 if it
    states none, or a negative one."""
    stated = Fraction(max(container.start_time or 0, 0), 1_000_000)
    starts = (stream.start_time * stream.time_base for stream in container.streams if stream.start_time)
    return next((start for start in starts if abs(start - stated) < 1e-6), stated)  # FFmpeg rounds it


def decoded_images(
    path: Path, begin: float | None = None, threads: str = "AUTO", options: Mapping[str, str] | None = None
) -> Iterator[Any]:
    """Images as PyAV decodes them, with None for a damaged packet, from the beginning or from the key frame before
    `begin` (seconds since the file's start). threads, options: of the decoder."""
    import av

    with open_container(path) as container:
        stream = shown_stream(container)
        stream.thread_type = threads
        stream.codec_context.options = dict(options or {})
        for packet in packets_from(container, begin):
            try:
                images = [None] if packet is None else packet.decode()
            except av.error.EOFError:
                return
            except av.error.FFmpegError:
                images = [None]
            yield from images


def packets_from(container: Any, begin: float | None = None) -> Iterator[Any]:
    """The packets of the video that is shown, with None for a damaged one, from the beginning or from the key frame
    before `begin` (seconds since the file's start)."""
    import av

    stream = shown_stream(container)
    try:
        if begin is not None:
            container.seek(math.floor((begin + start_of(container)) / stream.time_base), stream=stream)
        yield from container.demux(stream)
    except (av.error.EOFError, IndexError):  # at its end PyAV may stumble over streams that began after the first
        return
    except av.error.FFmpegError:
        yield None
