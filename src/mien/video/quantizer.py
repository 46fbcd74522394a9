"""How coarsely a video was compressed, by what its stream says: its images do not show how far they were rounded."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import islice, product
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from mien.errors import MienError
from mien.video.container import decoded_images, open_container, packets_from, shown_stream

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
_EARLIER_S = 10.0
"""How many seconds earlier is looked where nothing is found: in some containers seeking leads to the next key frame,
and there may be none. Key frames are mostly less apart."""
_VP9, _H264, _MPEG = 0, 1, 2
_FIELD = re.compile(r"(\w+) +[01]+ = (-?\d+)\s*$")
"""Name and value, at the end of a line of FFmpeg's filter `trace_headers`."""


def quantizer_step(path: Path, time: float) -> float | None:
    """The step, in grey values of 8 bits, to which the coefficients of a video were rounded about a time in seconds:
    the mean over the blocks of the key frame before it and of the next images. None where the stream does not say."""
    try:
        for begin, steps_from in product((time, time - _EARLIER_S), (_exported_steps, _header_steps)):
            steps = list(islice(steps_from(path, begin), _IMAGES))
            if steps:
                return sum(steps) / len(steps)
    except MienError:  # the file is gone
        return None
    return None


def _exported_steps(path: Path, time: float) -> Iterator[float]:
    """The mean steps of images whose decoder exports them; none of most codecs."""
    # By one thread: several export what is not decoded yet.
    for image in decoded_images(path, time, "NONE", _EXPORTED):
        step = None if image is None else _step_of(image)
        if step is None:
            return
        yield step


def _header_steps(path: Path, time: float) -> Iterator[float]:
    """The steps of images, or of their first slices, by the headers of a stream whose decoder exports none."""
    with open_container(path) as container:
        step_of = _BY_HEADER.get(shown_stream(container).codec_context.codec.canonical_name)
        if step_of is None:
            return
        fields = _header_fields(container, time)
    usual: dict[int, int] = {}
    parameters, first = 0, True
    for name, value in fields:
        if name in _PARAMETERS:
            parameters = value
        elif name == "init_qp_minus26":
            usual[parameters] = 26 + value
        elif name == "first_slice_segment_in_pic_flag":
            first = value == 1
        elif name in _LEVELS and first:
            yield step_of(usual.get(parameters, 0) + value)


def _header_fields(container: Any, time: float) -> list[tuple[str, int]]:
    """Names and values of what the headers of a stream state about a time, as FFmpeg's filter `trace_headers` writes
    them into its log: there is no other way to them."""
    import av
    from av.bitstream import BitStreamFilterContext

    with _logged() as lines, suppress(av.error.FFmpegError):  # damaged, or an FFmpeg without the filter
        headers = BitStreamFilterContext("trace_headers", shown_stream(container))
        for packet in islice(packets_from(container, time), 4 * _IMAGES):
            if packet is not None:
                headers.filter(packet)
    found = (_FIELD.search(text) for _, _, text in lines)
    return [(field[1], int(field[2])) for field in found if field is not None]


_LOGGING = Lock()
"""The level of the log is one for all threads: each would restore what another has set."""


@contextmanager
def _logged() -> Iterator[list[tuple[int, str, str]]]:
    """What FFmpeg logs in this thread meanwhile: level, context and text. What it logs in others, as those that decode,
    is discarded as before, unless a program wants it."""
    from av import logging

    with _LOGGING:
        # Set and restored rarely: PyAV prints a traceback where another thread logs at the moment of the latter.
        level = logging.get_level()
        others = logging.Capture(local=False) if level is None else nullcontext()
        logging.set_level(logging.INFO)
        try:
            with others, logging.Capture() as lines:
                yield lines
        finally:
            logging.set_level(level)


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
    if codec == _H264:  # its levels for 10 bits begin 12 higher
        return _h26x_step(level - 6 * (image.format.components[0].bits - 8))
    if codec == _MPEG:  # FFmpeg exports twice the quantizer scale, which is the step
        return float(level)
    return _vp9_step(level) if codec == _VP9 else None


def _h26x_step(level: float) -> float:
    """It doubles every six levels, and is 1 at level 4 (ITU-T H.264, 8.5, and H.265, 8.6)."""
    return float(2.0 ** ((level - 4) / 6))


def _vp9_step(level: float) -> float:
    """The table of VP9 and AV1, to a tenth."""
    return (level + 7) / 8 if level <= 95 else 12.75 * math.exp(0.018 * (level - 95))


def _vp8_step(level: float) -> float:
    """The table of VP8 (RFC 6386, 14.1), to a tenth."""
    return 0.5 * (level + 4) if level <= 54 else 29 * math.exp(0.0218 * (level - 54))


_BY_HEADER: dict[str, Callable[[float], float]] = {
    "hevc": _h26x_step,
    "av1": lambda level: 1.6 * _vp9_step(level),
    "vp8": lambda level: 0.6 * _vp8_step(level),
}
"""The step by the level that a header states. What a face teaches in AV1, whose filters smooth more, is as exact as in
H.264 of 1.6 times the step, and in VP8 as of 0.6 times; found on rendered heads."""
_LEVELS = ("slice_qp_delta", "base_q_idx", "base_qindex")
"""Fields of these that state the quantizer of an image; in HEVC, as a difference from that of its parameter set."""
_PARAMETERS = ("pps_pic_parameter_set_id", "slice_pic_parameter_set_id")
"""Fields of HEVC with the number of the parameter set that is described, or that an image has."""
