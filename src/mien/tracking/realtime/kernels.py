"""The inner loop of real-time tracking, compiled: Eq. (9) linearised and minimised.

What the kernels take together is named in Python and plain in the kernels, which unpack it in the order of its fields:
Numba takes longer to recognise named tuples at every call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mien.appearance.descriptors import describe_into
from mien.arrays import Array, Float32
from mien.compiled import kernel
from mien.tracking.realtime.definite import solve_positive, transposed_product
from mien.tracking.realtime.misplacement import marginalize_misplacement
from mien.tracking.realtime.pose_geometry import (
    STATE_SIZE,
    PoseArrays,
    angles_along_ray,
    project,
    step_back,
    step_between,
)

DEGREE = 4
POLYNOMIAL_TERMS = (DEGREE + 1) * (DEGREE + 2) // 2


class AppearanceArrays(NamedTuple):
    """What n landmarks are expected to look like, by tilt and pan.

    coefficients (n, 15, 128): of the mean descriptor, see `polynomial`; limit (2,): of tilt and pan, radians;
    offset (n, 128): added to the mean by adaptation; U (n, k, 128), gain (n, k), inverse_floor (n,): the metric, see
    `linearize_landmarks`, trust (n,) a factor of it, and `learned` the number of the last rows that were added to it
    while tracking; variance (n, 4): of the systematic error, see `misplacement`.
    """

    coefficients: Float32
    offset: Float32
    U: Float32
    gain: Float32
    learned: int
    inverse_floor: Float32
    trust: Float32
    limit: Array
    variance: Array


class PriorArrays(NamedTuple):
    """The prior of Eq. (9): a predicted pose and the information (12, 12) of a step away from it; the rest of the
    animation (6,) and the information (6,) of each unit about it."""

    pose: PoseArrays
    information: Array
    rest: Array
    rest_information: Array


class Linearization(NamedTuple):
    """Eq. (9) about a pose.

    Of each of n landmarks: residual (n, 128), observed less expected descriptor; M (n, 4, 4), g (n, 4) and d2 (n,),
    information, gradient and squared distance by [u, v, tilt, pan]; B (n, 4, 12), derivative of those four by the pose
    step; w (n,), robust weight. Of all: H (12, 12), Gauss-Newton matrix, and G (12,), gradient of half the energy.
    """

    residual: Float32
    M: Array
    g: Array
    d2: Array
    B: Array
    w: Array
    H: Array
    G: Array


@kernel()
def polynomial(tilt: float, pan: float, limit: Any) -> Any:
    """Terms (3, 15) of the quartic in tilt and pan (radians) and their derivatives by both; constant beyond the limits
    (2,)."""
    out = np.empty((3, POLYNOMIAL_TERMS), np.float32)
    x, y = min(max(tilt / limit[0], -1.0), 1.0), min(max(pan / limit[1], -1.0), 1.0)
    dx = 1.0 / limit[0] if abs(tilt) < limit[0] else 0.0
    dy = 1.0 / limit[1] if abs(pan) < limit[1] else 0.0
    xs, ys = np.empty(DEGREE + 1), np.empty(DEGREE + 1)  # powers
    xs[0], ys[0] = 1.0, 1.0
    for k in range(DEGREE):
        xs[k + 1], ys[k + 1] = x * xs[k], y * ys[k]
    k = 0
    for degree in range(DEGREE + 1):
        for j in range(degree + 1):
            i = degree - j
            out[0, k] = xs[i] * ys[j]
            out[1, k] = i * xs[i - 1] * ys[j] * dx  # where i is 0 the power before does not matter
            out[2, k] = j * xs[i] * ys[j - 1] * dy
            k += 1
    return out


@kernel()
def linearize_landmarks(
    maps: Any, sampling: Any, q: Any, stretch: Any, appearance: Any, terms: Any, active: Any, at: Any
) -> None:
    """Squared distance of every active landmark at q (n, 2), and its derivatives by [u, v, tilt, pan] of the crop.

    Fills residual, M, g and d2 of a `Linearization`, in the metric `trust (I inverse_floor + U^T diag(gain) U)`; d2
    without its learned rows: how strange a landmark looks is judged by the views alone. stretch: see
    `descriptors.StretchArrays`; terms (3, 15): see `polynomial`.
    """
    coefficients, offset, U, gain, learned, inverse_floor, trust, _, _ = appearance
    residuals, M, g, d2, _, _, _, _ = at
    still, follows = stretch
    n, rank = q.shape[0], U.shape[1]
    J = np.empty((1, 2, 128), np.float32)
    D = np.empty((5, 128), np.float32)  # residual, then its derivatives by u, v, tilt, pan
    residual, by_u, by_v, by_tilt, by_pan = D[0], D[1], D[2], D[3], D[4]
    V = np.empty((5, rank), np.float32)
    for i in range(n):
        if active[i] <= 0.0:
            continue
        describe_into(maps, q[i : i + 1], sampling, D[:1], J, (still[i : i + 1], follows[i : i + 1]))
        for c in range(128):
            residual[c] -= offset[i, c]
            by_u[c] = J[0, 0, c]
            by_v[c] = J[0, 1, c]
            by_tilt[c] = 0.0
            by_pan[c] = 0.0
        for p in range(0, POLYNOMIAL_TERMS, 3):  # three at a time, as most of the time goes to fetching them
            first, second, third, T = coefficients[i, p], coefficients[i, p + 1], coefficients[i, p + 2], terms[:, p:]
            for c in range(128):
                residual[c] -= T[0, 0] * first[c] + T[0, 1] * second[c] + T[0, 2] * third[c]
                by_tilt[c] -= T[1, 0] * first[c] + T[1, 1] * second[c] + T[1, 2] * third[c]
                by_pan[c] -= T[2, 0] * first[c] + T[2, 1] * second[c] + T[2, 2] * third[c]
        for c in range(128):
            residuals[i, c] = residual[c]
        for k in range(rank):
            v0 = v1 = v2 = v3 = v4 = np.float32(0.0)
            for c in range(128):
                u = U[i, k, c]
                v0 += u * residual[c]
                v1 += u * by_u[c]
                v2 += u * by_v[c]
                v3 += u * by_tilt[c]
                v4 += u * by_pan[c]
            V[0, k], V[1, k], V[2, k], V[3, k], V[4, k] = v0, v1, v2, v3, v4
        for a in range(5):
            for b in range(a, 5):
                s = np.float32(0.0)
                for c in range(128):
                    s += D[a, c] * D[b, c]
                s *= inverse_floor[i]
                for k in range(rank - learned if b == 0 else rank):
                    s += gain[i, k] * V[a, k] * V[b, k]
                s *= trust[i]
                if a == 0:
                    if b == 0:
                        d2[i] = s
                    else:
                        g[i, b - 1] = s
                else:
                    M[i, a - 1, b - 1] = s
                    M[i, b - 1, a - 1] = s


@kernel()
def linearize_prior(pose: Any, prior: Any, H: Any, G: Any) -> float:
    """The part of the prior in Eq. (9): returns its energy, and sets H (12, 12) and G (12,) to its derivatives."""
    start, information, rest, rest_information = prior
    step = step_between(*start, *pose)
    energy = 0.0
    for r in range(STATE_SIZE):
        G[r] = 0.0
        for c in range(STATE_SIZE):  # entry by entry: an assignment of whole arrays takes seconds to compile
            H[r, c] = information[r, c]
            G[r] += information[r, c] * step[c]
        energy += G[r] * step[r]
    for k in range(6):
        from_rest = pose[2][k] - rest[k]
        H[6 + k, 6 + k] += rest_information[k]
        G[6 + k] += rest_information[k] * from_rest
        energy += rest_information[k] * from_rest * from_rest
    return energy


@kernel()
def add_landmark(M: Any, g: Any, B: Any, w: float, H: Any, G: Any) -> Any:
    """Add w B^T M B of one landmark to the upper triangle of H (12, 12), and its w B^T g to G (12,). Returns M B."""
    MB = transposed_product(M, B)  # M is symmetric
    for r in range(STATE_SIZE):
        for k in range(4 if r < 3 else 2):  # the angles depend on the rotation alone
            x = w * B[k, r]
            G[r] += x * g[k]
            for c in range(r, STATE_SIZE):
                H[r, c] += x * MB[k, c]
    return MB


@kernel(inline="always")  # only `solve` calls it: compiled within it, and not on its own before
def evaluate(pose: Any, problem: Any, at: Any) -> Any:
    """Eq. (9), a `PosePosterior`, at a pose: returns the robust energy, and fills a `Linearization`."""
    maps, sampling, person, appearance, active, scale, prior, view, stretch = problem
    _, _, _, _, _, _, _, limit, variance = appearance
    ray = view[1]
    q, J = project(person, pose, view)
    tilt, pan, by_ray = angles_along_ray(ray, pose[0])
    J_angles = np.empty((2, 3))  # by a rotation vector in camera axes
    for k in range(2):
        for r in range(3):
            J_angles[k, r] = by_ray[k, 0] * ray[r, 0] + by_ray[k, 1] * ray[r, 1] + by_ray[k, 2] * ray[r, 2]
    terms = polynomial(tilt, pan, limit)
    linearize_landmarks(maps, sampling, q, stretch, appearance, terms, active, at)
    _, M, g, d2, B, w, H, G = at
    energy = linearize_prior(pose, prior, H, G)
    for i in range(q.shape[0]):
        w[i] = 0.0
        if active[i] <= 0.0:
            continue
        d2[i] = marginalize_misplacement(M[i], g[i], d2[i], variance[i])
        # Geman and McClure: c d^2 / (c + d^2), its weight (c / (c + d^2))^2
        ratio = scale[i] / (scale[i] + d2[i])
        energy += active[i] * d2[i] * ratio
        w[i] = active[i] * ratio * ratio
        for k in range(2):
            for r in range(STATE_SIZE):
                B[i, k, r] = J[i, k, r]
            for r in range(3):
                B[i, 2 + k, r] = J_angles[k, r]
        add_landmark(M[i], g[i], B[i], w[i], H, G)
    for r in range(STATE_SIZE):
        for c in range(r):
            H[r, c] = H[c, r]
    return energy


def workspace(n: int) -> tuple[Array | Float32, ...]:
    """Two linearisations of n landmarks for `solve`, zero for those that take no part, with one more dimension: of the
    lowest point so far, and of the next one."""
    return (
        np.zeros((2, n, 128), np.float32), np.zeros((2, n, 4, 4)), np.zeros((2, n, 4)), np.zeros((2, n)),
        np.zeros((2, n, 4, STATE_SIZE)), np.zeros((2, n)),
        np.zeros((2, STATE_SIZE, STATE_SIZE)), np.zeros((2, STATE_SIZE)),
    )  # fmt: skip


@kernel(inline="always")
def _one_of(k: int, buffers: Any) -> Any:
    """Linearisation k of a `workspace`."""
    residual, M, g, d2, B, w, H, G = buffers
    return residual[k], M[k], g[k], d2[k], B[k], w[k], H[k], G[k]


@kernel()
def solve(start: Any, problem: Any, iterations: int, tolerance: float, buffers: Any) -> Any:
    """Levenberg-Marquardt on Eq. (9), a `PosePosterior`, from a pose; the set of active landmarks is frozen.

    Stops where the next step promises a gain below `tolerance`, and takes that step without evaluating it. Returns the
    pose, the energy and the index in the buffers of the lowest point evaluated, which may be a step before it, and the
    number of evaluations.
    """
    _, _, _, _, _, _, H, G = buffers
    lowest, free = 0, 1
    energy, damping = np.inf, 1e-3
    pose, best = start, start
    evaluations = 0
    while evaluations < iterations:
        here = evaluate(pose, problem, _one_of(free, buffers))
        evaluations += 1
        if here < energy:
            energy, best = here, pose
            lowest, free = free, lowest
            damping *= 0.2
        else:
            damping *= 10.0
            if damping > 1e6:
                break
        A = H[lowest].copy()
        for k in range(STATE_SIZE):
            A[k, k] *= 1.0 + damping
        step = solve_positive(A, G[lowest])
        pose = step_back(best, step)
        gain = 0.0  # that the quadratic model promises
        for k in range(STATE_SIZE):
            gain += G[lowest, k] * step[k]
        if gain < tolerance:
            best = pose
            break
    return best, energy, lowest, evaluations
