"""S. Lefevre and J.-M. Odobez, Structure and appearance features for robust 3D facial actions tracking, ICME 2009.

One error combines two kinds of features. Structure: patches around landmarks, normalised for brightness and contrast,
whose statistics are learned from rendered views and never change; they prevent drift. Appearance: grey values at many
random points of the mesh, each modelled by a Gaussian that starts at the first frame and adapts to every tracked frame;
they provide accuracy. The mesh extends around the sides of the head, and the appearance of the points there is learned
when a turned head first shows them. A dynamic term keeps the state close to the last one; the downhill simplex
minimises the error.

Simplifications: the sides of the head are two flat strips that extend back from the mesh's outline; a point counts as
visible if its surface faces the camera; visibility is decided once per frame, at the last state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mien.appearance.views import view_rotations
from mien.arrays import Array, Float32, Mask
from mien.baselines.candide_tracker import SIMPLEX_SD, CandideTracker, CroppedFrame, SearchResult
from mien.baselines.patch_statistics import PatchStatistics, landmark_patches
from mien.baselines.patches import sample
from mien.frame import Frame
from mien.initialization.fit import FirstFrame
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.optimizers import Simplex
from mien.tracking.prior import GaussianPrior, state_sd
from mien.tracking.state import unpack

FACE_POINTS, SIDE_POINTS = 200, 60
"""Number of random points on the face, and on both sides of the head together."""
SIDES = ((47, 62, 61, 63), (14, 29, 28, 30))
"""The mesh's outline on the right and on the left of the subject, from the temple to the jaw."""
SIDE_DEPTH = 0.7
"""Extent of the sides behind the outline, in CANDIDE units."""
FACING_COSINE = 0.3
"""Cosine between normal and viewing ray below which a point counts as hidden."""
INITIAL_SD, LEAST_SD = 12.0, 6.0
"""Initial and minimum standard deviation of a point's appearance, in grey values."""
FORGETTING = 0.1
STRUCTURE_WEIGHT, APPEARANCE_WEIGHT = 30.0, 30.0
DYNAMIC_SD = state_sd(5.0, 0.15, 0.4, 0.15)


@dataclass(frozen=True)
class SurfacePoints:
    """n random points of the head's surface, those on the face first.

    model: positions and animation units of the points; normals: (n, 3) outward, head axes, of the first frame's face.
    """

    model: LandmarkModel
    normals: Array

    @classmethod
    def draw(cls, fit: FirstFrame, rng: np.random.Generator, side_points: int = SIDE_POINTS) -> SurfacePoints:
        """Sample points of the fitted face and of the sides of the head, uniformly by area."""
        units = fit.model.animation_units
        vertices, fields, sides = with_sides(fit.shape, units)
        face, face_units, face_normals = _draw(vertices, fields, fit.model.triangles, FACE_POINTS, rng)
        side, side_units, side_normals = _draw(vertices, fields, sides, side_points, rng)
        model = LandmarkModel(np.vstack([face, side]), np.concatenate([face_units, side_units], axis=1))
        return cls(model, np.vstack([face_normals, side_normals]))

    def facing(self, b: Array) -> Mask:
        """Which points (n,) face the camera in state b."""
        X = self.model.in_camera(b)
        view = -X / np.linalg.norm(X, axis=1, keepdims=True)
        return np.asarray(((self.normals @ unpack(b)[0].T) * view).sum(axis=1) > FACING_COSINE)


def with_sides(shape: Array, units: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Vertices (V, 3) and animation units (6, V, 3) with those of the sides' far edges appended, and the triangles of
    the sides."""
    triangles, first = [], len(shape)
    edges = [v for side in SIDES for v in side]
    far = shape[edges] - np.array([0.0, 0.0, SIDE_DEPTH])
    for k, (side, outward) in enumerate(zip(SIDES, (False, True), strict=True)):
        start = first + k * len(side)
        for i in range(len(side) - 1):
            a, b, c, d = side[i], side[i + 1], start + i, start + i + 1
            triangles += [(a, b, c), (b, d, c)] if outward else [(a, c, b), (b, c, d)]
    still = np.zeros((len(units), len(edges), 3))
    return np.vstack([shape, far]), np.concatenate([units, still], axis=1), np.array(triangles)


def _draw(
    vertices: Array, units: Array, triangles: NDArray[np.intp], count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Positions (count, 3), animation units (6, count, 3) and normals (count, 3) of random points of a surface."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(triangles), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), count)
    corners = triangles[chosen]
    neutral = np.einsum("nk,nki->ni", weights, vertices[corners])
    moved = np.einsum("nk,mnki->mni", weights, units[:, corners])
    return neutral, moved, cross[chosen] / area[chosen, None]


@dataclass(frozen=True)
class Appearance:
    """Gaussians of the grey values of n points: mean (n,), variance (n,), and a mask (n,) of points seen so far."""

    mean: Float32
    variance: Float32
    known: Mask

    @classmethod
    def unseen(cls, count: int) -> Appearance:
        """Of so many points, none of which was seen yet."""
        mean, variance = np.zeros(count, np.float32), np.full(count, INITIAL_SD**2, np.float32)
        return cls(mean, variance, known=np.zeros(count, dtype=bool))

    def squared_distance(self, values: Float32) -> Float32:
        """Squared distances (n,) of grey values (n,) from the means, in standard deviations."""
        return np.asarray((values - self.mean) ** 2 / self.variance)

    def adapt(self, values: Float32, seen: Mask) -> Appearance:
        """Update the Gaussians with grey values (n,) of visible points; new points start at their value."""
        again = seen & self.known
        innovation = (values - self.mean) ** 2
        mean = np.where(again, (1 - FORGETTING) * self.mean + FORGETTING * values, self.mean)
        variance = np.where(again, (1 - FORGETTING) * self.variance + FORGETTING * innovation, self.variance)
        return Appearance(
            np.where(seen & ~self.known, values, mean), np.maximum(variance, LEAST_SD**2), self.known | seen
        )


def robust(squared: Float32) -> Float32:
    """Cauchy's robust function of a squared distance, which limits the influence of outliers."""
    return np.asarray(np.log1p(squared))


@dataclass(frozen=True)
class StructureAndAppearance:
    """The error of a state in one frame. visible: (n,) mask of the surface points that are used in this frame."""

    frame: CroppedFrame
    landmarks: LandmarkModel
    structure: PatchStatistics
    points: SurfacePoints
    appearance: Appearance
    visible: Mask
    prior: GaussianPrior

    def patches(self, b: Array) -> Float32:
        """Patches (26, D) around the projected landmarks of state b."""
        return landmark_patches(self.frame.gray, self.frame.points(self.landmarks, b))

    def values(self, b: Array) -> Float32:
        """Grey values (n,) at the points of the surface."""
        return sample(self.frame.gray, self.frame.points(self.points.model, b))

    def energy(self, b: Array) -> float:
        patches = self.patches(b)
        structure = robust(self.structure.squared_distance(patches) / patches.shape[1]).mean()
        appearance = robust(self.appearance.squared_distance(self.values(b))[self.visible])
        seen = appearance.mean() if appearance.size else 0.0
        return float(STRUCTURE_WEIGHT * structure + APPEARANCE_WEIGHT * seen) + self.prior.energy(b)


class LefevreTracker(CandideTracker):
    """Structure and appearance features with a dynamic term (Lefevre and Odobez 2009).

    The similarity is the mean correlation of the landmarks' patches with their means.
    """

    least_similarity = 0.4

    def __init__(self, evaluations: int = 500, side_points: int = SIDE_POINTS) -> None:
        self._evaluations, self._side_points = evaluations, side_points

    def _learn(self, frame: Frame) -> None:
        self._simplex = Simplex(SIMPLEX_SD, self._evaluations, np.random.default_rng(0))
        self.structure = PatchStatistics.of_views(self._views(frame, view_rotations()))
        self.points = SurfacePoints.draw(self.fit, np.random.default_rng(0), self._side_points)
        self.appearance = Appearance.unseen(len(self.points.normals))
        self._adapt(frame)

    def _search(self, frame: Frame) -> SearchResult:
        problem = self._problem(frame)
        b = self._simplex.minimize(problem, self.b).b
        return SearchResult(b, float(self.structure.correlation(problem.patches(b)).mean()))

    def _adapt(self, frame: Frame) -> None:
        values = self._problem(frame).values(self.b)
        self.appearance = self.appearance.adapt(values, self.points.facing(self.b))

    def _problem(self, frame: Frame) -> StructureAndAppearance:
        return StructureAndAppearance(
            CroppedFrame.around(self.b, frame, self.camera),
            self.landmarks,
            self.structure,
            self.points,
            self.appearance,
            self.points.facing(self.b) & self.appearance.known,
            GaussianPrior(self.b, DYNAMIC_SD),
        )
