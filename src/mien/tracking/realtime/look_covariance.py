"""Eq. (8): the covariance of the descriptors follows what is seen.

The views of the first frame show how a landmark's descriptor varies with the pose, and a little of how it varies with
the light. How a lamp that moves changes this face, or how its skin folds, they do not show. What is left of a
descriptor where the face has been found changes mostly along one or two directions for seconds: those are added to the
covariance, so that what is seen along them moves the face no longer, and what is seen across them still does; the more
of them, the stranger the landmark mostly looks, as what is left where it looks as usual is small and of many kinds.

How strange a landmark looks is still judged by the views alone, as something else may come slowly.

The paper adds the squared norm of the residual to every eigenvalue, which weighs a landmark less without saying in what
it is wrong.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.appearance.regression import PoseRegression
from mien.arrays import Array, Float32, Mask
from mien.compiled import kernel
from mien.config.realtime import CovarianceSettings
from mien.tracking.realtime.definite import cholesky

_EVERY = 5
"""Frames after which the metric of a landmark is made anew; in each frame that of every fifth landmark is."""


class LearnedCovariance:
    """The metric of n landmarks, `I inverse_floor + U^T diag(gain) U`, of their learned covariance and of what is added
    to it while tracking.

    U (n, k + m, 128), gain (n, k + m): the last m rows, with gains of -1, belong to what is added; directions (n, m,
    128): leading eigenvectors of the moving average of the residuals' outer products, as long as their eigenvalues.
    """

    def __init__(self, appearance: PoseRegression, settings: CovarianceSettings) -> None:
        n, _, entries = appearance.U.shape
        self.settings, self.inverse_floor = settings, appearance.inverse_floor
        self.directions = np.zeros((n, settings.learned, entries), np.float32)
        self.U: Float32 = np.concatenate([appearance.U, self.directions], axis=1)
        self.gain: Float32 = np.concatenate([appearance.gain, -np.ones(self.directions.shape[:2], np.float32)], axis=1)
        self.frames = 0

    def learn(self, residual: Float32, trusted: Mask, expected: Array, covered: bool, worth: float) -> None:
        """Take a frame: residual (n, 128), observed less expected descriptors, of the landmarks that are trusted (n,);
        worth: in [0, 1], how much the frame can teach.

        The larger the squared distance that is expected of a landmark, expected (n,), the larger the share of the
        variance that is added. covered: whether something lies on the face; then a landmark may look strange because of
        that, and all have the same share."""
        s, metric = self.settings, (self.U, self.gain, self.inverse_floor)
        self.frames += 1
        share, usual = (s.covered_share, 0.0) if covered else (s.share, s.usual_distance)
        turn = self.frames % _EVERY
        _learn(self.directions, metric, residual, trusted, s.rate, worth, expected, share, usual, turn)


@kernel()
def _learn(
    directions: Any, metric: Any, residual: Any, trusted: Any, rate: float, worth: float, expected: Any, share: float,
    usual: float, turn: int,
) -> None:  # fmt: skip
    """What `LearnedCovariance.learn` does: the share of a landmark's variance that is added is `share` of the part by
    which its expected (n,) squared distance exceeds the usual one; turn: which landmarks' metrics are made anew, as a
    remainder."""
    for i in range(trusted.size):
        if trusted[i]:
            follow(directions[i], residual[i].copy(), rate, worth)
        if i % _EVERY == turn:
            added = share * max(1.0 - usual / expected[i], 0.0)
            _renew(metric[0][i], metric[1][i], metric[2][i], directions[i], added)


@kernel()
def follow(directions: Any, residual: Any, rate: float, worth: float) -> None:
    """Take a residual (d,), which is overwritten, into the leading eigenvectors (m, d) of the moving average of outer
    products, as long as their eigenvalues.

    Candid covariance-free incremental principal component analysis: J. Weng, Y. Zhang, W. Hwang, PAMI 25, 2003."""
    d = residual.size
    for k in range(directions.shape[0]):
        v = directions[k]
        along, squared, own = 0.0, 0.0, 0.0
        for c in range(d):
            along += residual[c] * v[c]
            squared += v[c] * v[c]
            own += residual[c] * residual[c]
        # A direction that is still nothing becomes that of the residual.
        length = np.sqrt(squared)
        gained = rate * worth * (along / length if length > 0.0 else np.sqrt(own))
        squared, along = 0.0, 0.0
        for c in range(d):
            v[c] = np.float32((1.0 - rate) * v[c] + gained * residual[c])
            squared += v[c] * v[c]
            along += residual[c] * v[c]
        if squared > 0.0:
            for c in range(d):  # the next direction is that of what is left
                residual[c] -= np.float32(along / squared) * v[c]


@kernel()
def _renew(U: Any, gain: Any, inverse_floor: float, directions: Any, share: float) -> None:
    """Make the last rows of the metric U (k + m, d), gain (k + m,) of one landmark anew.

    By the lemma of Woodbury, with the rows of C the directions, scaled to `share` of their variance, and P the metric
    without them, the inverse of `P^-1 + C^T C` is `P - Z^T Z`, with Z = L^-1 C P and L L^T = I + C P C^T."""
    m, d = directions.shape
    k = U.shape[0] - m
    C, S = np.empty((m, d)), np.empty((m, m))
    for j in range(m):
        squared = 0.0
        for c in range(d):
            squared += directions[j, c] * directions[j, c]
        scale = np.sqrt(share / max(np.sqrt(squared), 1e-12))  # of a vector as long as its eigenvalue
        for c in range(d):
            C[j, c] = scale * directions[j, c]
            U[k + j, c] = inverse_floor * C[j, c]
        for row in range(k):
            along = 0.0
            for c in range(d):
                along += U[row, c] * C[j, c]
            for c in range(d):
                U[k + j, c] += np.float32(gain[row] * along) * U[row, c]
    for j in range(m):
        for i in range(m):
            S[j, i] = 1.0 if i == j else 0.0
            for c in range(d):
                S[j, i] += C[j, c] * U[k + i, c]
    cholesky(S)
    for j in range(m):
        for i in range(j):
            for c in range(d):
                U[k + j, c] -= np.float32(S[j, i]) * U[k + i, c]
        for c in range(d):
            U[k + j, c] /= np.float32(S[j, j])
