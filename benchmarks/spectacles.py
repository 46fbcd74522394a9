"""Puts spectacles on the rendered heads, whose exact pose is known, and writes them as another data set.

`python benchmarks/spectacles.py PATH OUT`, with PATH the folder of the rendered sequences; then
`mien evaluate rendered OUT --trackers realtime,mediapipe -o results`. Dark rims stand before the eyes, temples reach to
the ears, and a reflection moves in each lens as the head turns. The occluded sequences are left out: their object would
pass behind the rims.
"""

from __future__ import annotations

import shutil

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of
from shared.filming import triangulated, write_film
from shared.inputs import truth_of

from mien.arrays import Array, Pixels
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.rendered import CAMERA
from mien.geometry.rotation import FACING
from mien.video import open_video

RIM_COLOUR = (30, 25, 25)
RIM_WIDTH = 0.22
"""Width of the rims in units of the truth, about centimetres."""
LENS_SHADE, REFLECTION = 0.12, 35.0
SUPERSAMPLING = 4
_RIGHT_EYE, _LEFT_EYE, _RIGHT_EAR, _LEFT_EAR, _BRIDGE = slice(36, 42), slice(42, 48), 0, 16, 27


def spectacles(head: Array) -> tuple[list[Array], list[Array]]:
    """Closed rims (48, 3) and temples (2, 3) for the 68 points (68, 3) of a head, the right one first."""
    eyes = [head[_RIGHT_EYE].mean(axis=0), head[_LEFT_EYE].mean(axis=0)]
    between = float(np.linalg.norm(eyes[1] - eyes[0]))
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    across, up = (np.sign(x) * np.abs(x) ** 0.7 for x in (np.cos(angle), np.sin(angle)))
    rims, temples = [], []
    for eye, ear in zip(eyes, (head[_RIGHT_EAR], head[_LEFT_EAR]), strict=True):
        x = eye[0] + 0.4 * between * across
        z = head[_BRIDGE, 2] + 0.25 - 0.12 * np.abs(x - head[_BRIDGE, 0])
        rims.append(np.stack([x, eye[1] + between * (0.33 * up - 0.06), z], axis=1))
        hinge = rims[-1][np.argmax(np.abs(x - head[_BRIDGE, 0]))] + [0, 0.25, 0]
        temples.append(np.stack([hinge, ear + np.array([0, 0.8, -1.0])]))
    return rims, temples


def worn(
    pixels: Pixels, rims: list[Array], temples: list[Array], R: Array, t: Array, rim: float, reflection: float
) -> Pixels:
    """The image with spectacles on the head at R (3, 3), t (3,); rim: width of the rims; reflection: grey values."""
    s = SUPERSAMPLING
    height, width = pixels.shape[:2]
    image = cv2.resize(pixels, None, fx=s, fy=s, interpolation=cv2.INTER_CUBIC).astype(np.float32)
    lines = np.zeros(image.shape[:2], np.float32)
    thick = max(1, round(rim * CAMERA.focal_px / t[2] * s))

    def drawn(points: Array) -> Array:
        p = CAMERA.project(points @ R.T + t)[0]
        return np.asarray(((p + 0.5) * s - 0.5).round(), dtype=np.int32)

    for outline, temple, outwards in zip(rims, temples, (-1.0, 1.0), strict=True):
        p = drawn(outline)
        lens, spot = np.zeros_like(lines), np.zeros_like(lines)
        cv2.fillPoly(lens, [p], 1.0, cv2.LINE_AA)
        place = p.mean(axis=0) - s * (30 * R[:2, 2] + [4, 3])
        cv2.ellipse(spot, (int(place[0]), int(place[1])), (5 * s, 3 * s), -30, 0, 360, 1.0, -1, cv2.LINE_AA)
        image += (reflection * lens * cv2.GaussianBlur(spot, (0, 0), s) - LENS_SHADE * 128 * lens)[:, :, None]
        cv2.polylines(lines, [p], True, 1.0, thick, cv2.LINE_AA)
        if (temple[0] @ R.T + t) @ R[:, 0] * outwards < 0:  # its side of the head faces the camera
            cv2.polylines(lines, [drawn(temple)], False, 1.0, thick, cv2.LINE_AA)
    inner = [outline[np.argmin(np.abs(outline[:, 0]))] + [0, 0.3, 0] for outline in rims]
    cv2.polylines(lines, [drawn(np.array(inner))], False, 1.0, thick, cv2.LINE_AA)
    image += lines[:, :, None] * (np.array(RIM_COLOUR, np.float32) - image)
    small = cv2.resize(np.clip(image, 0, 255), (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small.round(), dtype=np.uint8)


def main() -> None:
    parser = parser_of(__doc__, "path", "out")
    parser.add_argument("--rim", type=float, default=RIM_WIDTH, help="width of the rims, units of the truth")
    parser.add_argument("--reflection", type=float, default=REFLECTION, help="grey values")
    arguments = parser.parse_args()
    sequences = load_dataset("rendered", arguments.path)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for sequence in sequences:
        if sequence.kind == "occluded":
            continue
        values = truth_of(arguments.path, sequence.name)
        R, t = FACING @ values["R"], values["t"]
        rims, temples = spectacles(triangulated(values["landmarks68"].astype(float), R, t))
        frames = list(open_video(sequence.video))
        pictures = (
            worn(frame.pixels, rims, temples, R_frame, t_frame, arguments.rim, arguments.reflection)
            for frame, R_frame, t_frame in zip(frames, R, t, strict=True)
        )
        write_film(arguments.out / f"{sequence.name}.avi", pictures)
        for truth in sequence.truth_files:
            shutil.copy(truth, arguments.out)


if __name__ == "__main__":
    carry_out(main)
