"""The systematic error of where a landmark is found, and of the angles that its patch shows.

It is marginalised in Eq. (9), so that it moves the face no further than it may, and learned from frame to frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.compiled import kernel
from mien.tracking.realtime.pose_geometry import displacement

_LIKE_ITSELF = 1e-3
"""Robust weight above which a landmark still looks so much like itself that its place can be found."""
_LARGEST = 4.0
"""Pixels of the crop: what is found further from where the pose puts a landmark is something else."""


@kernel()
def marginalize_misplacement(M: Any, g: Any, d2: float, variance: Any) -> float:
    """Marginalise a systematic error of one landmark: changes M and g, returns the new d2.

    variance (4,): of the error in [u, v, tilt, pan]. With P = diag(1 / variance) and A = (M + P)^-1 the quadratic form
    of the landmark becomes M - M A M, its gradient g - M A g, its distance d2 - g A g.
    """
    # Cholesky factor L of M + P, then X = L^-1 [M, g], so that M A M = X^T X.
    L = np.empty((4, 4))
    X = np.empty((4, 5))
    for i in range(4):
        for j in range(i + 1):
            s = M[i, j] + (1.0 / variance[i] if i == j else 0.0)
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(s, 1e-12)) if i == j else s / L[j, j]
        for c in range(5):
            s = M[i, c] if c < 4 else g[i]
            for k in range(i):
                s -= L[i, k] * X[k, c]
            X[i, c] = s / L[i, i]
    for i in range(4):
        d2 -= X[i, 4] * X[i, 4]
        for k in range(4):
            g[i] -= X[k, i] * X[k, 4]
            for j in range(4):
                M[i, j] -= X[k, i] * X[k, j]
    return max(d2, 0.0)


@kernel()
def misplacement_variance(variance: Any, scale: float, units: Any, a: Any, rest: Any, share: float) -> Any:
    """Variances (n, 4) of the systematic error of landmarks in [u, v, tilt, pan]: to those measured, in a crop of which
    a pixel is `scale` pixels of this one, how far an animation (6,) is from rest (6,) adds its part in u and v, times
    `share`, pixels per unit of length."""
    out, error = variance.copy(), np.empty(rest.size)
    for k in range(error.size):
        error[k] = share * (a[k] - rest[k])
    for i in range(out.shape[0]):
        x, y, z = displacement(i, units, error)
        squared = x * x + y * y + z * z
        out[i, 0] = scale * scale * out[i, 0] + squared
        out[i, 1] = scale * scale * out[i, 1] + squared
    return out


@kernel()
def learn_misplacement(variance: Any, least: Any, M: Any, g: Any, facing: Any, w: Any, rate: float) -> None:
    """Moving average of the variance (n, 4) of the position of the landmarks that look like themselves: of the square,
    per axis, of the step that each alone would take, see `squared_misplacement`, and at least `least` (n,)."""
    for i in range(w.size):
        if facing[i] and w[i] > _LIKE_ITSELF:
            squared = squared_misplacement(M[i], g[i], _LARGEST)
            for k in range(2):
                variance[i, k] += rate * (least[i] + squared - variance[i, k])


@kernel()
def squared_misplacement(M: Any, g: Any, most: float) -> float:
    """Mean square per axis, in pixels of the crop, of the step that a landmark alone would take from where the pose
    puts it, limited to `most`. M (4, 4), g (4,): of a `Linearization`."""
    a, b, c = M[0, 0] + 1e-6, M[0, 1], M[1, 1] + 1e-6
    determinant = a * c - b * b
    u, v = (b * g[1] - c * g[0]) / determinant, (b * g[0] - a * g[1]) / determinant
    return float(0.5 * (min(u * u, most * most) + min(v * v, most * most)))
