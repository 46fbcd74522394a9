"""Compresses rendered sequences as videos mostly are, in H.264, and writes them as another data set.

`python benchmarks/compressed.py PATH OUT --crf 23`, with PATH the folder of the rendered sequences; then `mien evaluate
rendered OUT --trackers realtime,mediapipe -o results`. The constant rate factor is x264's: 18 is hardly seen, 23 its
default, 28 plainly seen.
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


def write_compressed(path: Path, frames: Sequence[Frame], crf: int) -> None:
    """Write frames as an H.264 video with x264's usual settings but for its constant rate factor."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FRAMES_PER_SECOND, options={"crf": str(crf)})
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame.pixels, format="rgb24")))
        container.mux(stream.encode())


def main() -> None:
    parser = parser_of(__doc__, "path", "out")
    parser.add_argument("--crf", type=int, default=23, help="constant rate factor")
    arguments = parser.parse_args()
    sequences = load_dataset("rendered", arguments.path)
    arguments.out.mkdir(parents=True, exist_ok=True)
    size = seconds = 0.0
    for sequence in sequences:
        frames = list(open_video(sequence.video))
        output = arguments.out / f"{sequence.name}.mp4"
        write_compressed(output, frames, arguments.crf)
        for truth in sequence.truth_files:
            copy(truth, arguments.out)
        size += output.stat().st_size
        seconds += len(frames) / FRAMES_PER_SECOND
        print(output, flush=True)
    print(f"{8e-3 * size / seconds:.0f} kbit/s")


if __name__ == "__main__":
    carry_out(main)
