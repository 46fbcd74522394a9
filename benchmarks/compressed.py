"""Compresses rendered sequences as videos mostly are, and writes them as another data set.

`python benchmarks/compressed.py PATH OUT --crf 23`, with PATH the folder of the rendered sequences; then `mien evaluate
rendered OUT --trackers realtime,mediapipe -o results`. The constant rate factor of x264, which makes H.264: 18 is
hardly seen, 23 its default, 28 plainly seen; x265 is much like it, those of VP8, VP9 and AV1 end at 63. `--codec`: what
encodes, of `ENCODERS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shutil import copy

import av
from shared.command_line import carry_out, parser_of

from mien.evaluation.datasets import load_dataset
from mien.frame import Frame
from mien.video import open_video

FRAMES_PER_SECOND = 30
ENCODERS: dict[str, dict[str, str]] = {
    "libx264": {"crf": "{}"},
    "libx265": {"crf": "{}"},
    "libsvtav1": {"crf": "{}", "preset": "8"},
    "libvpx-vp9": {"crf": "{}", "b": "0"},
    "libvpx": {"qmin": "{}", "qmax": "{}", "b": "9M"},
}
"""Encoders, and their options with the constant rate factor in place of the braces."""


def write_compressed(path: Path, frames: Sequence[Frame], crf: int, codec: str = "libx264") -> None:
    """Write frames as a video with an encoder's usual settings but for its constant rate factor."""
    options = {name: value.format(crf) for name, value in ENCODERS[codec].items()}
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=FRAMES_PER_SECOND, options=options)
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame.pixels, format="rgb24")))
        container.mux(stream.encode())


def main() -> None:
    parser = parser_of(__doc__, "path", "out")
    parser.add_argument("--crf", type=int, default=23, help="constant rate factor")
    parser.add_argument("--codec", choices=ENCODERS, default="libx264", help="encoder")
    arguments = parser.parse_args()
    sequences = load_dataset("rendered", arguments.path)
    arguments.out.mkdir(parents=True, exist_ok=True)
    size = seconds = 0.0
    for sequence in sequences:
        frames = list(open_video(sequence.video))
        output = arguments.out / f"{sequence.name}.mkv"
        write_compressed(output, frames, arguments.crf, arguments.codec)
        for truth in sequence.truth_files:
            copy(truth, arguments.out)
        size += output.stat().st_size
        seconds += len(frames) / FRAMES_PER_SECOND
        print(output, flush=True)
    print(f"{8e-3 * size / seconds:.0f} kbit/s")


if __name__ == "__main__":
    carry_out(main)
