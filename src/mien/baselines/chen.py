"""Y. Chen and F. Davoine, Simultaneous tracking of rigid head motion and non-rigid facial animation by
analyzing local features statistically, BMVC 2006.

The local features are image patches at vertices of CANDIDE. The mean and variance of each of their values are learned
from views of the first frame's face; in later frames the downhill simplex maximises the likelihood, starting from the
state of the last frame. There is no adaptation and no motion prior.

Simplifications: the features are at the 26 landmarks of this package; patches are normalised for brightness and
contrast, where the paper compares local distributions; the first frame is fitted to landmarks instead of by hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.appearance.crop import Crop
from mien.appearance.views import view_rotations
from mien.arrays import Array, Float32
from mien.baselines.candide_tracker import BLUR, CandideTracker, SearchResult, face_crop, views_of_first_frame
from mien.baselines.patches import read_patches
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import VERTICES
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.optimizers import Simplex
from mien.tracking.prior import state_sd

PATCH_SIZE, PATCH_STEP = 9, 2.0
VARIANCE_FLOOR = 2e-3
SIMPLEX_SD = state_sd(2.0, 0.05, 0.15, 0.05)
"""Standard deviations of the initial simplex around the last state."""


@dataclass(frozen=True)
class PatchStatistics:
    """Mean (n, D) and variance (n, D) of the patch of each of n landmarks over the views."""

    mean: Float32
    variance: Float32

    @classmethod
    def learn(cls, samples: Float32, floor: float) -> PatchStatistics:
        """Statistics of samples (views, n, D); a variance is at least `floor`."""
        return cls(samples.mean(axis=0), np.maximum(samples.var(axis=0), np.float32(floor)))

    def squared_distance(self, patches: Float32) -> Float32:
        """Squared distances (n,) of patches (n, D) from their means, in standard deviations."""
        return np.asarray(((patches - self.mean) ** 2 / self.variance).sum(axis=1))

    def correlation(self, patches: Float32) -> Float32:
        """Correlation (n,) of patches (n, D) with their means."""
        return np.asarray((patches * self.mean).sum(axis=1) / np.linalg.norm(self.mean, axis=1))


@dataclass(frozen=True)
class PatchLikelihood:
    """`-2 log p(frame | b)` without its constant."""

    landmarks: LandmarkModel
    camera: Camera
    crop: Crop
    gray: Float32
    statistics: PatchStatistics

    def observe(self, b: Array) -> Float32:
        """Patches (n, D) at the projected landmarks of state b."""
        p, _ = self.camera.project(self.landmarks.in_camera(b))
        return read_patches(self.gray, self.crop.to_crop(p), PATCH_SIZE, PATCH_STEP)

    def energy(self, b: Array) -> float:
        return float(self.statistics.squared_distance(self.observe(b)).sum())


class ChenTracker(CandideTracker):
    """Maximum likelihood of patches at CANDIDE's vertices by the simplex (Chen and Davoine 2006).

    The similarity is the mean correlation of the patches with their means.
    """

    least_similarity = 0.5

    def __init__(self, evaluations: int = 500) -> None:
        self._simplex = Simplex(SIMPLEX_SD, evaluations, np.random.default_rng(0))

    def _learn(self, frame: Frame) -> None:
        views = views_of_first_frame(frame, self.fit, self.camera, view_rotations())
        samples = [read_patches(image, p[VERTICES], PATCH_SIZE, PATCH_STEP) for image, p in views]
        self.statistics = PatchStatistics.learn(np.stack(samples), VARIANCE_FLOOR)

    def _search(self, frame: Frame) -> SearchResult:
        crop = face_crop(self.b, self.camera)
        gray = crop.sample(frame, BLUR)
        likelihood = PatchLikelihood(self.landmarks, self.camera, crop, gray, self.statistics)
        b = self._simplex.minimize(likelihood, self.b).b
        return SearchResult(b, float(self.statistics.correlation(likelihood.observe(b)).mean()))
