"""The inner loop of real-time tracking, compiled: Eq. (9) linearised and minimised.

Everything here works on plain arrays: `RealtimeTracker` says what they are. A pose step is
`[w, t, a]`: a rotation vector in camera axes applied on the left, a translation, animation units.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from mien.appearance.descriptors import _FAST, _describe_with_jacobian

DEGREE = 4
POLYNOMIAL_TERMS = (DEGREE + 1) * (DEGREE + 2) // 2
STATE = 12


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def view_angles(M: Any) -> Any:
    """(tilt, pan) of M = Rz(roll) Rx(tilt) Ry(pan), and their derivative (2, 3) by a rotation vector on the left."""
    roll = np.arctan2(-M[0, 1], M[1, 1])
    cr, sr = np.cos(roll), np.sin(roll)
    tilt = np.arcsin(min(max(M[2, 1], -1.0), 1.0))
    pan = np.arctan2(-M[2, 0], M[2, 2])
    ct = max(np.cos(tilt), 1e-3)
    # w = z roll' + Rz x tilt' + Rz Rx y pan', solved for tilt' and pan'.
    J = np.zeros((2, 3))
    J[0, 0], J[0, 1] = cr, sr
    J[1, 0], J[1, 1] = -sr / ct, cr / ct
    return tilt, pan, J


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def polynomial(tilt: float, pan: float, limit: float) -> Any:
    """Terms (3, 15) of the quartic in tilt and pan (radians), and their two derivatives; constant past the limit."""
    out = np.zeros((3, POLYNOMIAL_TERMS), np.float32)
    x, y = min(max(tilt / limit, -1.0), 1.0), min(max(pan / limit, -1.0), 1.0)
    dx = 1.0 / limit if abs(tilt) < limit else 0.0
    dy = 1.0 / limit if abs(pan) < limit else 0.0
    k = 0
    for degree in range(DEGREE + 1):
        for j in range(degree + 1):
            i = degree - j
            out[0, k] = x**i * y**j
            out[1, k] = i * x ** max(i - 1, 0) * y**j * dx
            out[2, k] = j * x**i * y ** max(j - 1, 0) * dy
            k += 1
    return out


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def project(neutral: Any, units: Any, R: Any, t: Any, a: Any, camera: Any, linear: Any, offset: Any) -> Any:
    """Landmarks in the crop (n, 2) and their derivative (n, 2, 12) by [rotation vector, t, animation]."""
    n = neutral.shape[0]
    q = np.empty((n, 2))
    J = np.empty((n, 2, STATE))
    f = camera[0]
    for i in range(n):
        h0, h1, h2 = neutral[i, 0], neutral[i, 1], neutral[i, 2]
        for k in range(6):
            h0 += a[k] * units[k, i, 0]
            h1 += a[k] * units[k, i, 1]
            h2 += a[k] * units[k, i, 2]
        x = R[0, 0] * h0 + R[0, 1] * h1 + R[0, 2] * h2
        y = R[1, 0] * h0 + R[1, 1] * h1 + R[1, 2] * h2
        z = R[2, 0] * h0 + R[2, 1] * h1 + R[2, 2] * h2
        X, Y, Z = x + t[0], y + t[1], max(z + t[2], 0.1)
        u, v = f * X / Z + camera[1], f * Y / Z + camera[2]
        q[i, 0] = linear[0, 0] * u + linear[0, 1] * v + offset[0]
        q[i, 1] = linear[1, 0] * u + linear[1, 1] * v + offset[1]
        fz = f / Z
        for r in range(2):
            # crop by camera point
            j0, j1 = linear[r, 0] * fz, linear[r, 1] * fz
            j2 = -(j0 * X + j1 * Y) / Z
            J[i, r, 0] = -j1 * z + j2 * y
            J[i, r, 1] = j0 * z - j2 * x
            J[i, r, 2] = -j0 * y + j1 * x
            J[i, r, 3], J[i, r, 4], J[i, r, 5] = j0, j1, j2
            m0 = j0 * R[0, 0] + j1 * R[1, 0] + j2 * R[2, 0]
            m1 = j0 * R[0, 1] + j1 * R[1, 1] + j2 * R[2, 1]
            m2 = j0 * R[0, 2] + j1 * R[1, 2] + j2 * R[2, 2]
            for k in range(6):
                J[i, r, 6 + k] = m0 * units[k, i, 0] + m1 * units[k, i, 1] + m2 * units[k, i, 2]
    return q, J


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def linearize_landmarks(
    maps: Any, cell: int, root: float, q: Any, coefficients: Any, delta: Any, terms: Any, U: Any, gain: Any,
    inverse_floor: Any, active: Any, y: Any, M: Any, g: Any, d2: Any,
) -> None:  # fmt: skip
    """Distance of every active landmark and its derivatives by [u, v, tilt, pan] of the crop.

    Fills y (n, 128), M (n, 4, 4) Gauss-Newton information, g (n, 4) gradient, d2 (n,) squared distance, in the
    metric `I inverse_floor + U diag(gain) U^T`, U (n, k, 128).
    """
    n, rank = q.shape[0], U.shape[1]
    J = np.empty((1, 2, 128), np.float32)
    D = np.empty((5, 128), np.float32)  # residual, then its derivatives by u, v, tilt, pan
    V = np.empty((5, rank), np.float32)
    for i in range(n):
        if active[i] <= 0.0:
            continue
        _describe_with_jacobian(maps, q[i : i + 1], cell, root, y[i : i + 1], J)
        for c in range(128):
            D[0, c] = y[i, c] - delta[i, c]
            D[1, c] = J[0, 0, c]
            D[2, c] = J[0, 1, c]
            D[3, c] = 0.0
            D[4, c] = 0.0
        for p in range(POLYNOMIAL_TERMS):
            w0, w1, w2 = terms[0, p], terms[1, p], terms[2, p]
            for c in range(128):
                m = coefficients[i, p, c]
                D[0, c] -= w0 * m
                D[3, c] -= w1 * m
                D[4, c] -= w2 * m
        for k in range(rank):
            for a in range(5):
                s = np.float32(0.0)
                for c in range(128):
                    s += U[i, k, c] * D[a, c]
                V[a, k] = s
        for a in range(5):
            for b in range(a, 5):
                s = np.float32(0.0)
                for c in range(128):
                    s += D[a, c] * D[b, c]
                s *= inverse_floor[i]
                for k in range(rank):
                    s += gain[i, k] * V[a, k] * V[b, k]
                if a == 0:
                    if b == 0:
                        d2[i] = s
                    else:
                        g[i, b - 1] = s
                else:
                    M[i, a - 1, b - 1] = s
                    M[i, b - 1, a - 1] = s


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def temper(M: Any, g: Any, d2: float, variance: Any) -> float:
    """Give a landmark a systematic error of its own, and marginalise it: changes M and g, returns the new d2.

    variance (4,): of the misplacement in [u, v, tilt, pan]. With P = diag(1 / variance) and A = (M + P)^-1 the
    landmark's quadratic form becomes M - M A M, its gradient g - M A g, its distance d2 - g A g.
    """
    # Cholesky factor L of M + P, then X = L^-1 [M, g], so that M A M = X^T X.
    L = np.zeros((4, 4))
    X = np.zeros((4, 5))
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


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def rotate(w: Any, R: Any) -> Any:
    """exp(w) R (Rodrigues): (3,), (3, 3) -> (3, 3)."""
    angle = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a, b = 1.0, 0.5
    if angle > 1e-6:
        a, b = np.sin(angle) / angle, (1 - np.cos(angle)) / (angle * angle)
    out = np.empty((3, 3))
    for c in range(3):
        x, y, z = R[0, c], R[1, c], R[2, c]
        # K v = w x v and K K v = w (w . v) - |w|^2 v
        along = w[0] * x + w[1] * y + w[2] * z
        keep = 1.0 - b * angle * angle
        out[0, c] = keep * x + a * (w[1] * z - w[2] * y) + b * along * w[0]
        out[1, c] = keep * y + a * (w[2] * x - w[0] * z) + b * along * w[1]
        out[2, c] = keep * z + a * (w[0] * y - w[1] * x) + b * along * w[2]
    return out


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def transposed_product(A: Any, B: Any) -> Any:
    """A^T B of small matrices, without a call to BLAS: (k, m), (k, n) -> (m, n)."""
    out = np.zeros((A.shape[1], B.shape[1]))
    for i in range(A.shape[1]):
        for j in range(B.shape[1]):
            for k in range(A.shape[0]):
                out[i, j] += A[k, i] * B[k, j]
    return out


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def solve_positive(A: Any, b: Any) -> Any:
    """x with A x = b for a symmetric positive definite A (d, d), by Cholesky; A is overwritten."""
    d = b.size
    x = b.copy()
    for i in range(d):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(max(s, 1e-12)) if i == j else s / A[j, j]
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for i in range(d - 1, -1, -1):
        for k in range(i + 1, d):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]
    return x


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def rotation_vector(R: Any) -> Any:
    """Rotation vector of a rotation by less than about 170 degrees: (3, 3) -> (3,)."""
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1)
    return w * (np.arctan2(sine, cosine) / sine) if sine > 1e-9 else w


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def add_prior(R: Any, t: Any, a: Any, prior: Any, H: Any, G: Any) -> float:
    """The prior's part of Eq. (9): returns its energy, and begins H (12, 12) and G (12,) with its derivatives."""
    R_prior, t_prior, a_prior, information, a_rest, rest_information = prior
    turn = rotation_vector(transposed_product(R.T, R_prior.T))
    step = np.empty(STATE)
    for k in range(3):
        step[k] = turn[k]
        step[3 + k] = t[k] - t_prior[k]
    for k in range(6):
        step[6 + k] = a[k] - a_prior[k]
    energy = 0.0
    for r in range(STATE):
        G[r] = 0.0
        for c in range(STATE):  # entry by entry: an assignment of whole arrays takes seconds to compile
            H[r, c] = information[r, c]
            G[r] += information[r, c] * step[c]
        energy += G[r] * step[r]
    for k in range(6):
        from_rest = a[k] - a_rest[k]
        H[6 + k, 6 + k] += rest_information[k]
        G[6 + k] += rest_information[k] * from_rest
        energy += rest_information[k] * from_rest * from_rest
    return energy


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def add_landmark(M: Any, g: Any, B: Any, w: float, H: Any, G: Any) -> None:
    """Add one landmark's w B^T M B to the upper triangle of H (12, 12), and its w B^T g to G (12,)."""
    MB = transposed_product(M, B)  # M is symmetric
    for r in range(STATE):
        for k in range(4 if r < 3 else 2):  # the angles depend on the rotation alone
            x = w * B[k, r]
            G[r] += x * g[k]
            for c in range(r, STATE):
                H[r, c] += x * MB[k, c]


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def evaluate(
    R: Any, t: Any, a: Any, maps: Any, cell: int, root: float, person: Any, appearance: Any, active: Any, scale: Any,
    prior: Any, view: Any, y: Any, M: Any, g: Any, d2: Any, B: Any, w: Any, H: Any, G: Any,
) -> Any:  # fmt: skip
    """Eq. (9) at a state: returns the robust energy; fills its Gauss-Newton matrix H (12, 12) and gradient G (12,).

    The derivatives are those of half the energy. Also fills, per landmark, y, M, g, d2 (see
    `linearize_landmarks`), B (n, 4, 12) = [u, v, tilt, pan] by pose step, and the weight w in the solution.
    """
    neutral, units = person
    coefficients, delta, U, gain, inverse_floor, limit, variance = appearance
    camera, linear, offset, ray = view
    q, J = project(neutral, units, R, t, a, camera, linear, offset)
    # FACING as a product of columns: R_camera_head @ diag(1, -1, -1).
    V = transposed_product(ray, R)
    for r in range(3):
        V[r, 1], V[r, 2] = -V[r, 1], -V[r, 2]
    tilt, pan, J_angles = view_angles(V)
    J_angles = transposed_product(J_angles.T, ray.T)
    terms = polynomial(tilt, pan, limit)
    linearize_landmarks(maps, cell, root, q, coefficients, delta, terms, U, gain, inverse_floor, active, y, M, g, d2)
    energy = add_prior(R, t, a, prior, H, G)
    for i in range(q.shape[0]):
        w[i] = 0.0
        if active[i] <= 0.0:
            continue
        d2[i] = temper(M[i], g[i], d2[i], variance[i])
        # Geman and McClure: c d^2 / (c + d^2), its weight (c / (c + d^2))^2
        ratio = scale[i] / (scale[i] + d2[i])
        energy += active[i] * d2[i] * ratio
        w[i] = active[i] * ratio * ratio
        for k in range(2):
            for r in range(STATE):
                B[i, k, r] = J[i, k, r]
            for r in range(3):
                B[i, 2 + k, r] = J_angles[k, r]
        add_landmark(M[i], g[i], B[i], w[i], H, G)
    for r in range(STATE):
        for c in range(r):
            H[r, c] = H[c, r]
    return energy


@numba.njit(cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator]
def solve(
    R: Any, t: Any, a: Any, maps: Any, cell: int, root: float, person: Any, appearance: Any, active: Any, scale: Any,
    prior: Any, view: Any, iterations: int, tolerance: float,
) -> Any:  # fmt: skip
    """Levenberg-Marquardt on Eq. (9) from a state; the set of active landmarks is frozen.

    Stops where the next step promises a gain below `tolerance`, and takes that step unseen. Returns R, t, a, energy,
    H (12, 12), y (n, 128), M (n, 4, 4), g (n, 4), d2 (n,), B (n, 4, 12), w (n,) of the lowest point that was seen, and
    how often the energy was evaluated.
    """
    n = person[0].shape[0]
    y, best_y = np.zeros((n, 128), np.float32), np.zeros((n, 128), np.float32)
    M, best_M = np.zeros((n, 4, 4)), np.zeros((n, 4, 4))
    g, best_g = np.zeros((n, 4)), np.zeros((n, 4))
    d2, best_d2 = np.zeros(n), np.zeros(n)
    B, best_B = np.zeros((n, 4, STATE)), np.zeros((n, 4, STATE))
    w, best_w = np.zeros(n), np.zeros(n)
    H, best_H, G, best_G = np.empty((STATE, STATE)), np.empty((STATE, STATE)), np.empty(STATE), np.empty(STATE)
    best = np.inf
    damping = 1e-3
    best_R, best_t, best_a = R, t, a
    evaluations = 0
    while evaluations < iterations:
        energy = evaluate(
            R, t, a, maps, cell, root, person, appearance, active, scale, prior, view, y, M, g, d2, B, w, H, G
        )
        evaluations += 1
        if energy < best:
            best, best_R, best_t, best_a = energy, R, t, a
            y, best_y = best_y, y
            M, best_M = best_M, M
            g, best_g = best_g, g
            d2, best_d2 = best_d2, d2
            B, best_B = best_B, B
            w, best_w = best_w, w
            H, best_H = best_H, H
            G, best_G = best_G, G
            damping *= 0.2
        else:
            damping *= 10.0
            if damping > 1e6:
                break
        A = best_H.copy()
        for k in range(STATE):
            A[k, k] *= 1.0 + damping
        step = solve_positive(A, best_G)
        R, t, a = rotate(-step[:3], best_R), best_t - step[3:6], best_a - step[6:]
        gain = 0.0  # that the quadratic model promises
        for k in range(STATE):
            gain += best_G[k] * step[k]
        if gain < tolerance:
            best_R, best_t, best_a = R, t, a
            break
    return best_R, best_t, best_a, best, best_H, best_y, best_M, best_g, best_d2, best_B, best_w, evaluations
