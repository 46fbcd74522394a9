"""Faces at the side of the image: the camera of the rendered sequences turned about itself, as two Markdown tables.

`OMP_NUM_THREADS=1 python benchmarks/beside.py PATH`, with PATH a folder of rendered sequences; those in uniform light
are taken, with landmarks from the detector. Turning a camera moves its image by a homography, so that the truth is
known: every rotation is turned alike. In the first table the camera has turned from the beginning, in the second
(without MediaPipe, whose detector finds no face so small in images so wide) it turns after the face was learned in the
middle. For each turn, in degrees: by how much the rotations differ from those of a camera that does not turn, once
turned back (mean angle), and the error by the protocol `rebased`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import TRACKERS, Run, rotations_of, scored, track

from mien.arrays import Array
from mien.errors import MienWarning
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.scores import pooled_errors
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between, matrix_from_euler
from mien.initialization.detector import detect
from mien.initialization.straight import straightened
from mien.tracking.state import Tracker
from mien.video import open_video

TURNS_DEG = ((0, 0), (0, 10), (0, 20), (0, -10), (0, -20), (8, 0), (-8, 0))
"""Tilt and pan of the camera from the beginning."""
LATER_DEG = ((0, 0), (8, 15), (8, 30), (8, -30))
"""Tilt and pan of the camera after `TURNING` frames."""
TURNING = 100


@dataclass(frozen=True)
class Setting:
    """What a table is of: tilts and pans of the camera in degrees, over how many frames it turns, what is added on
    either side of the images so that the face stays inside, and the trackers."""

    turns_deg: tuple[tuple[int, int], ...]
    turning: int
    border: tuple[int, int]
    trackers: tuple[str, ...]


SETTINGS = (
    Setting(TURNS_DEG, 0, (80, 20), ("realtime", "MediaPipe")),
    Setting(LATER_DEG, TURNING, (260, 60), ("realtime",)),
)


def turned(frame: Frame, camera: Camera, R: Array, border: tuple[int, int]) -> Frame:
    """A frame with a border as its camera sees it once that has turned by R (3, 3)."""
    dx, dy = border
    wide = cv2.copyMakeBorder(frame.pixels, dy, dy, dx, dx, cv2.BORDER_REPLICATE)
    homography = camera.matrix @ R @ np.linalg.inv(camera.matrix)
    size = (wide.shape[1], wide.shape[0])
    pixels = cv2.warpPerspective(wide, homography, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Frame(np.asarray(pixels, np.uint8), frame.index, frame.time)


def rotations(tracker: Tracker, run: Run) -> tuple[Array, float]:
    """Rotations (n, 3, 3) of all frames, NaN where the face is lost, and the error by `rebased`."""
    estimates = track(tracker, run)
    return rotations_of(estimates), float(pooled_errors([scored(estimates, run)]).mean())


def compared(sequence: Sequence, setting: Setting) -> Array:
    """(turns, trackers, 2): difference from a camera that does not turn, once it has turned, and error, degrees."""
    frames = list(open_video(sequence.video))
    (dx, dy), turning, camera = setting.border, setting.turning, sequence.camera_for(frames[0].width, frames[0].height)
    camera = replace(camera, cx=camera.cx + dx, cy=camera.cy + dy)
    truth, rows = sequence.read_truth(len(frames)), []
    middle: list[Array] = []
    done = np.minimum(np.arange(1, len(frames) + 1) / turning, 1) if turning else np.ones(len(frames))
    for turn in setting.turns_deg:
        R = matrix_from_euler(np.radians(np.outer(done, [*turn, 0])))
        seen = [turned(frame, camera, now, setting.border) for frame, now in zip(frames, R, strict=True)]
        assert truth.rotations is not None
        moved = replace(truth, rotations=R @ truth.rotations, angles_deg=None, landmarks=None)
        marks = straightened(seen[0], detect(seen[0])[0], camera)
        run = Run(replace(sequence, camera=camera), seen, moved, marks)
        found = [rotations(TRACKERS[name](), run) for name in setting.trackers]
        middle = middle or [made for made, _ in found]
        back = np.swapaxes(R, 1, 2)
        differ = [np.degrees(angle_between(back @ made, at)) for (made, _), at in zip(found, middle, strict=True)]
        rows.append([(np.nanmean(d[turning:]), error) for d, (_, error) in zip(differ, found, strict=True)])
    return np.array(rows)


def main() -> None:
    parser = parser_of(__doc__, "path")
    warnings.simplefilter("ignore", MienWarning)
    chosen = [s for s in load_dataset("rendered", parser.parse_args().path) if s.kind == "uniform"]
    for setting in SETTINGS:
        columns = [f"{name}: {what}" for name in setting.trackers for what in ("differs", "error")]
        mean = np.mean([compared(sequence, setting) for sequence in chosen], axis=0)
        print_heads("tilt, pan of the camera", *columns)
        for (tilt, pan), row in zip(setting.turns_deg, mean, strict=True):
            print(f"| {tilt}, {pan} | {' | '.join(f'{value:.2f}' for value in row.ravel())} |")
        print(flush=True)


if __name__ == "__main__":
    carry_out(main)
