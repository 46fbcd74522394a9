"""Puts the faces of recordings on heads with a relief of their own, moves them as the rendered heads move, and writes
them as another data set: the settings were chosen on three heads, these are others.

`python benchmarks/other_faces.py RECORDINGS PATH OUT`, with RECORDINGS a folder of videos whose first frame shows a
face, and PATH that of the rendered sequences; then `mien evaluate rendered OUT --trackers realtime,mediapipe -o
results`. The face is the detector's mesh, its depth made up to 12 per cent deeper or flatter and given six smooth bumps
or hollows, drawn at twice the size before a mottled background, with noise of two grey values. It shows no expression,
and the sides of the head end at the ears. In `light` a lamp swings from side to side, and the whole becomes brighter
and darker; in `occluded` something of the colour of the skin passes before the face for 30 frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from shared.command_line import carry_out, parser_of
from shared.filming import SWING_FRAMES, Studio, lamp_at, taken, write_film
from shared.inputs import truth_of, videos_of

from mien.appearance.rendering import Texture, render, vertex_normals
from mien.appearance.surface import face_surface
from mien.arrays import Array, Float32, Pixels
from mien.errors import MienError
from mien.evaluation.datasets.rendered import CAMERA
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.detector import detect
from mien.initialization.fit import fit_first_frame
from mien.video import open_video

MOTIONS = {
    "uniform1": "a_uniform1", "uniform2": "c_uniform2", "uniform3": "e_uniform3", "uniform4": "c_light1",
    "wide1": "a_wide1", "wide2": "e_wide1", "light1": "a_light1", "light2": "e_light1",
    "occluded1": "a_occluded1", "occluded2": "c_occluded1", "occluded3": "e_occluded1",
}  # fmt: skip
"""Of which rendered sequence each has the motion, and nothing else."""
POINTS, SKIN = 468, [4, 50, 280]
"""Of the detector's mesh: how many, and which are the tip of the nose and the cheeks."""
SUPERSAMPLING = 2
DISTANCE = 5.7
"""CANDIDE units from the camera in the first frame."""
RELIEF_SHARE, BUMPS, BUMP_SD, BUMP_WIDTH = 0.12, 6, 0.05, 0.3
AMBIENT, DIRECT = 0.8, 0.35
"""Light from everywhere, and what the lamp adds to it where it shines straight on the face."""
BRIGHTER, BRIGHTER_FRAMES = 0.2, 47
PASSES, FRAMES = 30, (55, 110)
"""For how many frames something is before the face, and between which frames it comes."""


@dataclass(frozen=True)
class Head:
    """Vertices (V, 3) in head axes, triangles (T, 3), and the picture that they show."""

    vertices: Array
    triangles: NDArray[np.intp]
    texture: Texture


def head_of(video: Path, rng: np.random.Generator) -> Head | None:
    """The face of a video's first frame on a relief of its own; None where there is no face or no video."""
    try:
        frame = next(iter(open_video(video)))
    except MienError:
        return None
    faces = detect(frame)
    if not faces:
        return None
    camera = Camera.unknown(frame.width, frame.height)
    fit = fit_first_frame(faces[0], camera)
    surface = face_surface(faces[0], fit, camera)
    X = (surface.vertices - fit.t) @ fit.R
    X[:, 2] *= rng.uniform(1 - RELIEF_SHARE, 1 + RELIEF_SHARE)
    middles = X[rng.integers(0, surface.face, BUMPS), :2]
    squared = ((X[:, None, :2] - middles) ** 2).sum(axis=2)
    X[:, 2] += np.exp(-squared / (2 * BUMP_WIDTH**2)) @ rng.normal(0, BUMP_SD, BUMPS)
    texture = Texture(frame.pixels.astype(np.float32), camera.project(surface.vertices)[0])
    return Head(X, surface.triangles, texture)


def pictures(head: Head, kind: str, R: Array, t: Array, rng: np.random.Generator) -> Iterator[Pixels]:
    """The head in the poses R (n, 3, 3), t (n, 3) of the camera of the rendered sequences, as a kind of these."""
    studio = Studio.build(SUPERSAMPLING, rng)
    height, width = studio.background.shape[:2]
    normals, occluder = vertex_normals(head.vertices, head.triangles), None
    begin = rng.uniform(0, SWING_FRAMES) if kind == "light" else 0.0
    for k, (R_frame, t_frame) in enumerate(zip(R, t, strict=True)):
        posed = head.vertices @ R_frame.T + t_frame
        light = brightness(normals @ R_frame.T, begin + k) if kind == "light" else None
        drawn = render(posed, head.triangles, head.texture, studio.camera, width, height, studio.background, light)
        if kind == "occluded":
            occluder = occluder or Occluder.before(studio.camera.project(posed[:POINTS])[0], drawn.image, rng)
            occluder.paint(drawn.lit, k)
        yield taken(drawn.lit, rng)


def brightness(normals: Array, frame: float) -> Array:
    """Of vertices with normals (V, 3), camera axes, (V,)."""
    whole = 1 + BRIGHTER * math.sin(math.tau * frame / BRIGHTER_FRAMES)
    return np.asarray(whole * (AMBIENT + DIRECT * np.maximum(normals @ lamp_at(frame), 0)))


@dataclass(frozen=True)
class Occluder:
    """An ellipse that passes before the face: its first frame; the middle of its way and the whole way (2,), its half
    axes in pixels, its angle in degrees, and its colour."""

    begin: int
    middle: Array
    way: Array
    axes: tuple[int, int]
    angle: float
    colour: Array

    @classmethod
    def before(cls, points: Array, image: Float32, rng: np.random.Generator) -> Occluder:
        """One that is made for a face with the points (468, 2) of the detector's mesh in an image."""
        width = float(np.ptp(points[:, 0]))
        u, v = points[SKIN].astype(int).T
        across, down = (int(width * rng.uniform(*between)) for between in ((0.22, 0.3), (0.33, 0.42)))
        middle = points.mean(axis=0) + np.array([0, rng.normal(0, 0.12) * width])
        way = np.array([2.2 * width * rng.choice([-1, 1]), 0])
        return cls(int(rng.integers(*FRAMES)), middle, way, (across, down), rng.uniform(-35, 35), image[v, u].mean(0))

    def paint(self, image: Float32, k: int) -> None:
        """Paint it before what is in frame k."""
        if self.begin <= k < self.begin + PASSES:
            x, y = self.middle + ((k - self.begin) / (PASSES - 1) - 0.5) * self.way
            cv2.ellipse(image, (int(x), int(y)), self.axes, self.angle, 0, 360, self.colour.tolist(), -1, cv2.LINE_AA)


def main() -> None:
    parser = parser_of(__doc__, "recordings", "path", "out")
    arguments = parser.parse_args()
    videos = videos_of(arguments.recordings)
    motions = {name: truth_of(arguments.path, motion) for name, motion in MOTIONS.items()}
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed, video in enumerate(videos):
        rng = np.random.default_rng(seed)
        head = head_of(video, rng)
        if head is None:
            print(f"{video} is left out: it shows no face in its first frame")
            continue
        for name, truth in motions.items():
            R, t = truth["R"], DISTANCE * truth["t"] / truth["t"][0, 2]
            output = arguments.out / f"{video.stem.replace('_', '-')}_{name}"
            write_film(Path(f"{output}.avi"), pictures(head, name.rstrip("0123456789"), FACING @ R, t, rng))
            np.savez(f"{output}_truth.npz", R=R, t=t, focal=CAMERA.focal_px)


if __name__ == "__main__":
    carry_out(main)
