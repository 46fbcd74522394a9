"""One size for all frames of a source: that of the first; and what was made from frames of another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np

from mien.arrays import Pixels
from mien.errors import warn
from mien.frame import Frame


def same_size(frames: Iterator[Frame], name: str) -> Iterator[Frame]:
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


def warn_of_another_size(what: str, content: Mapping[str, Any], size: tuple[int, int], remedy: str) -> None:
    """Warn if a NAME.json is that of a video of another size. what: is taken from it, as the beginning of a sentence;
    content: of the file, which may be another JSON; size: width and height of the frames; remedy: if one was scaled."""
    video = content.get("video")
    known = (video.get("width"), video.get("height")) if isinstance(video, Mapping) else (None, None)
    if None not in known and known != size:
        warn(
            f"{what} of a video of {known[0]}x{known[1]} pixels, and this one has {size[0]}x{size[1]}; "
            f"if it was scaled, {remedy}"
        )


def _letterboxed(pixels: Pixels, size: tuple[int, int]) -> Pixels:
    """The image scaled to fit `size` (width, height), with its aspect ratio kept and black borders."""
    height, width = pixels.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    inner = (max(round(scale * width), 1), max(round(scale * height), 1))
    x, y = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    fitted = np.zeros((size[1], size[0], 3), np.uint8)
    fitted[y : y + inner[1], x : x + inner[0]] = cv2.resize(pixels, inner, interpolation=cv2.INTER_AREA)
    return fitted
