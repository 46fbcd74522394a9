"""Puts the faces of recordings on heads with a relief of their own, moves them as the rendered heads move, and writes
them as another data set: the settings were chosen on three heads, these are others.

`python benchmarks/other_faces.py RECORDINGS PATH OUT`, with RECORDINGS a folder of videos whose first frame shows a
face, and PATH that of the rendered sequences; then `mien evaluate rendered OUT --trackers realtime,mediapipe -o
results`. The face is the detector's mesh, its depth made up to 12 per cent deeper or flatter and given six smooth bumps
or hollows, drawn at twice the size before a mottled background, with noise of two grey values. It shows no expression,
and the sides of the head end at the ears.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from shared.command_line import carry_out, parser_of
from shared.filming import Studio, taken, write_film
from shared.inputs import truth_of, videos_of

from mien.appearance.rendering import Texture, render
from mien.appearance.surface import face_surface
from mien.arrays import Array, Pixels
from mien.errors import MienError
from mien.evaluation.datasets.rendered import CAMERA
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.detector import detect
from mien.initialization.fit import fit_first_frame
from mien.video import open_video

MOTIONS = ("a_uniform1", "c_uniform2", "e_uniform3", "c_light1", "a_wide1", "e_wide1")
"""Of `c_light1` only the motion is taken, as `uniform4`."""
NAMES = ("uniform1", "uniform2", "uniform3", "uniform4", "wide1", "wide2")
SUPERSAMPLING = 2
DISTANCE = 5.7
"""CANDIDE units from the camera in the first frame."""
RELIEF_SHARE, BUMPS, BUMP_SD, BUMP_WIDTH = 0.12, 6, 0.05, 0.3


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


def pictures(head: Head, R: Array, t: Array, rng: np.random.Generator) -> Iterator[Pixels]:
    """The head in the poses R (n, 3, 3), t (n, 3) of the camera of the rendered sequences."""
    studio = Studio.build(SUPERSAMPLING, rng)
    height, width = studio.background.shape[:2]
    for R_frame, t_frame in zip(R, t, strict=True):
        posed = head.vertices @ R_frame.T + t_frame
        drawn = render(posed, head.triangles, head.texture, studio.camera, width, height, studio.background)
        yield taken(drawn.image, rng)


def main() -> None:
    parser = parser_of(__doc__, "recordings", "path", "out")
    arguments = parser.parse_args()
    videos = videos_of(arguments.recordings)
    motions = {name: truth_of(arguments.path, motion) for name, motion in zip(NAMES, MOTIONS, strict=True)}
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
            write_film(Path(f"{output}.avi"), pictures(head, FACING @ R, t, rng))
            np.savez(f"{output}_truth.npz", R=R, t=t, focal=CAMERA.focal_px)


if __name__ == "__main__":
    carry_out(main)
