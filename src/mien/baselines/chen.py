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

from mien.appearance.views import view_rotations
from mien.arrays import Array, Float32
from mien.baselines.candide_tracker import SIMPLEX_SD, CandideTracker, CroppedFrame, SearchResult
from mien.baselines.patch_statistics import PatchStatistics, landmark_patches
from mien.frame import Frame
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.optimizers import Simplex


@dataclass(frozen=True)
class PatchLikelihood:
    """`-2 log p(frame | b)` without its constant."""

    landmarks: LandmarkModel
    frame: CroppedFrame
    statistics: PatchStatistics

    def observe(self, b: Array) -> Float32:
        """Patches (n, D) at the projected landmarks of state b."""
        return landmark_patches(self.frame.gray, self.frame.points(self.landmarks, b))

    def energy(self, b: Array) -> float:
        return float(self.statistics.squared_distance(self.observe(b)).sum())


class ChenTracker(CandideTracker):
    """Maximum likelihood of patches at CANDIDE's vertices by the simplex (Chen and Davoine 2006).

    The similarity is the mean correlation of the patches with their means.
    """

    least_similarity = 0.5

    def __init__(self, evaluations: int = 500) -> None:
        self._evaluations = evaluations

    def _learn(self, frame: Frame) -> None:
        self._simplex = Simplex(SIMPLEX_SD, self._evaluations, np.random.default_rng(0))
        self.statistics = PatchStatistics.of_views(self._views(frame, view_rotations()))

    def _search(self, frame: Frame) -> SearchResult:
        likelihood = PatchLikelihood(self.landmarks, CroppedFrame.around(self.b, frame, self.camera), self.statistics)
        b = self._simplex.minimize(likelihood, self.b).b
        return SearchResult(b, float(self.statistics.correlation(likelihood.observe(b)).mean()))
