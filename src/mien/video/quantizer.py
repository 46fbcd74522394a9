"""How coarsely a video was compressed, by what its stream says: its images do not show how far they were rounded."""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mien.errors import MienError
from mien.video.container import decoded_images

_EXPORTED = {"export_side_data": "venc_params"}
"""Options of a decoder that tells its quantizers, if it can: those of H.264, MPEG-1, 2 and 4, and VP9 can."""
_HEADER = np.dtype(
    [("count", np.uint32), ("offset", np.uintp), ("bytes", np.uintp), ("codec", np.int32), ("level", np.int32)],
    align=True,
)
"""The beginning of FFmpeg's AVVideoEncParams: number, place and size of the blocks, codec, and the quantizer of the
image. The fifth number of a block is by how much its own differs."""
_IMAGES = 6
"""How many images are looked at: key frames are finer than the others, the more so the less moves."""
_VP9, _H264, _MPEG = 0, 1, 2


def quantizer_step(path: Path, time: float) -> float | None:
    """The step, in grey values of 8 bits, to which the coefficients of a video were rounded about a time in seconds:
    the mean over the blocks of the key frame before it and of the next images. None where the stream does not say."""
    steps = []
    try:
        # By one thread: several export what is not decoded yet.
        for image in islice(decoded_images(path, time, "NONE", _EXPORTED), _IMAGES):
            step = None if image is None else _step_of(image)
            if step is None:  # as of all images of most codecs
                break
            steps.append(step)
    except MienError:  # the file is gone
        return None
    return sum(steps) / len(steps) if steps else None


def _step_of(image: Any) -> float | None:
    """The mean step of a decoded image."""
    try:
        exported = image.side_data.get("VIDEO_ENC_PARAMS")
    except ValueError:  # it fails on side data of a kind that PyAV does not know, such as EXIF
        return None
    if exported is None:
        return None
    stated = bytes(exported)
    count, offset, size, codec, level = np.frombuffer(stated, _HEADER, 1)[0].tolist()
    if count:
        blocks = np.frombuffer(stated, np.int32, count * size // 4, offset).reshape(count, -1)
        level += float(blocks[:, 4].mean())
    if codec == _H264:  # it doubles every six levels, and is 1 at level 4 (ITU-T H.264, 8.5); 10 bits begin 12 higher
        return float(2.0 ** ((level - 4) / 6 - (image.format.components[0].bits - 8)))
    if codec == _MPEG:  # FFmpeg exports twice the quantizer scale, which is the step
        return float(level)
    if codec == _VP9:  # its table, to a tenth
        return (level + 7) / 8 if level <= 95 else 12.75 * math.exp(0.018 * (level - 95))
    return None
