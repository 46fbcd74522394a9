"""N.-T. Tran, J. Feldmar, M. Charbit, D. Petrovska-Delacretaz and G. Chollet, 3D face pose tracking from monocular
camera via sparse representation of synthesized faces, VISAPP 2013.

Each landmark has a codebook of patches from views of the first frame's face. The energy of a pose is the sum of the
residuals of the l1-regularised sparse representations of the patches at its landmarks in their codebooks. The downhill
simplex minimises it, starting from the last frame's pose. The expression is not estimated.

Simplifications: the landmarks are the 26 of this package; a codebook has one patch for each of 25 views without
in-plane rotation, as frames are sampled in a crop that rotates with the last pose; the sparse representations of all
landmarks are one lasso with a block-diagonal dictionary, warm-started from the previous solution, so that an energy
differs from the exact one by the solver's tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.sparse import block_diag

from mien.appearance.views import rotation
from mien.arrays import Array, Float32
from mien.baselines.candide_tracker import (
    SIMPLEX_SD,
    CandideTracker,
    CroppedFrame,
    SearchResult,
    require_scikit_learn,
)
from mien.baselines.patches import read_patches
from mien.frame import Frame
from mien.initialization.landmarks import VERTICES
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.optimizers import Simplex

PATCH_SIZE, PATCH_STEP = 7, 2.5
VIEW_ANGLES_DEG = (-30.0, -15.0, 0.0, 15.0, 30.0)
SPARSITY = 0.1
"""Weight of the l1 norm of a patch's coefficients against half its squared residual; the patch has unit length."""
TOLERANCE, SWEEPS = 1e-2, 1000
"""Stopping criteria of coordinate descent: the relative dual gap, and the maximum number of passes."""


class Codebook:
    """Codebooks (n, K, D) of n landmarks, each with K patches of unit length."""

    def __init__(self, patches: Float32) -> None:
        from sklearn.linear_model import Lasso

        self._dictionary = block_diag([codewords.T for codewords in patches.astype(float)]).tocsc()
        weight = SPARSITY / self._dictionary.shape[0]  # scikit-learn divides the squared residual by its length
        self._lasso: Any = Lasso(weight, fit_intercept=False, tol=TOLERANCE, max_iter=SWEEPS, warm_start=True)

    def residuals(self, patches: Float32) -> Float32:
        """Squared residuals (n,) of the sparse representations of patches (n, D) of unit length.

        A flat patch is zero, which any codebook represents exactly; it is given the largest residual instead.
        """
        from sklearn import config_context

        observed = patches.astype(float).ravel()
        with config_context(assume_finite=True, skip_parameter_validation=True):
            self._lasso.fit(self._dictionary, observed)
        rest = observed - self._dictionary @ self._lasso.coef_
        return np.asarray((rest.reshape(patches.shape) ** 2).sum(axis=1) + 1 - (patches**2).sum(axis=1))


@dataclass(frozen=True)
class SparseEnergy:
    """The energy of a pose (6,) in one frame, for a fixed animation (6,)."""

    landmarks: LandmarkModel
    animation: Array
    frame: CroppedFrame
    codebook: Codebook

    def residuals(self, pose: Array) -> Float32:
        """Squared residuals (26,) of the patches around the projected landmarks; see `Codebook.residuals`."""
        p = self.frame.points(self.landmarks, np.concatenate([pose, self.animation]))
        return self.codebook.residuals(read_patches(self.frame.gray, p, PATCH_SIZE, PATCH_STEP))

    def energy(self, pose: Array) -> float:
        return float(self.residuals(pose).sum())


class Tran2013Tracker(CandideTracker):
    """Residuals of sparse representations in codebooks of rendered patches (Tran and others 2013).

    The similarity is one minus the mean residual of the patches, which have unit length.
    """

    least_similarity = 0.4
    animated = False

    def __init__(self, evaluations: int = 150) -> None:
        require_scikit_learn("tran-2013")
        self._evaluations = evaluations

    def _learn(self, frame: Frame) -> None:
        self._simplex = Simplex(SIMPLEX_SD[:6], self._evaluations, np.random.default_rng(0))
        rotations = [rotation(*np.radians([*angles, 0.0])) for angles in product(VIEW_ANGLES_DEG, VIEW_ANGLES_DEG)]
        patches = [read_patches(image, p, PATCH_SIZE, PATCH_STEP) for image, p in self._views(frame, rotations)]
        self.codebook = Codebook(np.stack(patches, axis=1))

    def _search(self, frame: Frame) -> SearchResult:
        cropped = CroppedFrame.around(self.b, frame, self.camera, upright=False)
        problem = SparseEnergy(self.landmarks, self.fit.animation, cropped, self.codebook)
        found = self._simplex.minimize(problem, self.b[:6])
        return SearchResult(np.concatenate([found.b, self.fit.animation]), 1 - found.energy / len(VERTICES))
