"""Given a pose: which landmarks each observation may be, what each pairing gains, and the pose that a match implies.

Everything is Cartesian in the sensor's frame. A motion xi = (tx, ty, theta) carries predicted points p to q = R(theta) p + t.
Nothing is linearised: the prior of the motion only weighs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LOG_2PI = math.log(2.0 * math.pi)


@jit
def local_candidates(
    pose: Array, q: Array, reach: Array, points: Array, cell: float, low: Array, shape: Array, cells: Array,
    index: Array, allowed: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Points within reach (m,) of where each observation falls under `pose`, as (start, columns).

    allowed (m, n): pairings that labels do not exclude; of size 0 when there are no labels.
    """
    m = q.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    start, columns, count = np.zeros(m + 1, np.int64), np.empty(8 * m, np.int64), 0
    for i in range(m):
        ox, oy = q[i, 0] - pose[0], q[i, 1] - pose[1]
        x, y = c * ox + s * oy, -s * ox + c * oy
        rings = int(reach[i] / cell) + 1
        cx, cy = math.floor((x - low[0]) / cell), math.floor((y - low[1]) / cell)
        first, last = max(cy - rings, 0), min(cy + rings + 1, shape[1])
        for a in range(max(cx - rings, 0), min(cx + rings + 1, shape[0])):
            if last <= first:
                continue
            for k in range(cells[a * shape[1] + first], cells[a * shape[1] + last]):
                j = index[k]
                square = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2
                if square > reach[i] * reach[i] or (allowed.size and not allowed[i, j]):
                    continue
                if count == columns.shape[0]:
                    columns = np.concatenate((columns, np.empty_like(columns)))
                columns[count] = j
                count += 1
        start[i + 1] = count
    return start, columns[:count].copy()


@jit
def reaches(R: Array, D: Array, gate2: float) -> Array:
    """How far from an observation (m,) its landmark may be, m: the largest variance, three mean own ones of a landmark in it."""
    a, b, d = 3.0 * D[:, 0, 0].mean(), 3.0 * D[:, 0, 1].mean(), 3.0 * D[:, 1, 1].mean()
    far = np.empty(R.shape[0])
    for i in range(R.shape[0]):
        half, skew = 0.5 * (R[i, 0, 0] + a + R[i, 1, 1] + d), R[i, 0, 1] + b
        far[i] = 1.5 * math.sqrt(gate2 * (half + math.hypot(half - R[i, 1, 1] - d, skew)))
    return far


@jit
def descend(
    poses: Array, scores: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    prior_inverse: Array, reach: Array, cell: float, low: Array, shape: Array, cells: Array, index: Array, allowed: Array,
    gate2: float, apart: Array, rounds: int, behind: float,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Every pose (k, 3) refined: where it ended (k, 3), M (k, 3, 3), match (k, m) and L (k,), -inf where not entered.

    scores (k,): of the vote. What is `behind` nats behind the best L so far is not entered: behind L, for the vote of a
    wrong pose flatters (two observations may vote for one landmark), and that of a rough one says too little.
    The ogre: a pose that stands, within a tenth of `apart` (2,) (m, rad), where an earlier one ended belongs to that
    basin, whether it won or lost, and is not entered again.
    """
    size = poses.shape[0]
    ends, Ms, values = poses.copy(), np.zeros((size, 3, 3)), np.full(size, -np.inf)
    matches = np.full((size, q.shape[0]), -1, np.int64)
    for k in range(size):
        known = scores[k] < values.max() - behind
        for r in range(k):
            gap = math.hypot(poses[k, 0] - ends[r, 0], poses[k, 1] - ends[r, 1])
            turn = abs((poses[k, 2] - ends[r, 2] + math.pi) % (2.0 * math.pi) - math.pi)
            known |= values[r] > -np.inf and gap < 0.1 * apart[0] and turn < 0.1 * apart[1]
        if known:
            continue
        start, columns = local_candidates(poses[k], q, reach, points, cell, low, shape, cells, index, allowed)
        ends[k], Ms[k], matches[k], values[k] = refine(
            poses[k], q, R, points, D, base, odds, prior_inverse, start, columns, gate2, rounds
        )
    return ends, Ms, matches, values


@jit
def refine(
    pose: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array, prior_inverse: Array,
    start: Array, columns: Array, gate2: float, rounds: int,
) -> tuple[Array, Array, Array, float]:  # fmt: skip
    """Assign greedily at the pose, move the pose by Gauss-Newton, again; L of the end in its nonlinear (Laplace) form.

    L = sum [base_i + odds_j - r' V^-1 r / 2 - log det(2 pi V) / 2] - xi' P^-1 xi / 2 - log det(P M) / 2, V = R_i + D_j,
    M = P^-1 + sum J' V^-1 J.  Returns pose, M, match and L.
    """
    m, n = q.shape[0], points.shape[0]
    at, match, M = pose.copy(), np.full(m, -1, np.int64), prior_inverse.copy()
    spread = np.zeros((3, 3))  # the first round trusts the pose, later ones know its covariance
    for _round in range(rounds):
        match = _assign(at, spread, q, R, points, D, base, odds, start, columns, gate2, n)
        for _ in range(2):
            M = _step(at, q, R, points, D, match, prior_inverse)
        spread = inverse(M)
    at, M, value = fit(at, match, q, R, points, D, base, odds, prior_inverse, 1)
    return at, M, match, value


@jit
def fit(
    pose: Array, match: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    prior_inverse: Array, rounds: int,
) -> tuple[Array, Array, float]:  # fmt: skip
    """The most probable pose of a given match by Gauss-Newton from `pose`, M there, and L in its Laplace form."""
    at = pose.copy()
    for _ in range(rounds):
        _step(at, q, R, points, D, match, prior_inverse)
    M, _g = _normal(at, q, R, points, D, match, prior_inverse)
    value = log_prior(at, prior_inverse)
    value += 0.5 * (math.log(np.linalg.det(prior_inverse)) - math.log(np.linalg.det(M)))
    c, s = math.cos(at[2]), math.sin(at[2])
    for i in range(q.shape[0]):
        j = match[i]
        if j >= 0:
            u = q[i, 0] - c * points[j, 0] + s * points[j, 1] - at[0]
            v = q[i, 1] - s * points[j, 0] - c * points[j, 1] - at[1]
            a, b, d = R[i, 0, 0] + D[j, 0, 0], R[i, 0, 1] + D[j, 0, 1], R[i, 1, 1] + D[j, 1, 1]
            det = a * d - b * b
            d2 = (d * u * u - 2.0 * b * u * v + a * v * v) / det
            value += base[i] + odds[j] - 0.5 * (d2 + math.log(det)) - LOG_2PI
    return at, M, value


@jit
def _assign(
    at: Array, spread: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    start: Array, columns: Array, gate2: float, n: int,
) -> Array:  # fmt: skip
    """Greedy one-to-one assignment by gain at a pose whose covariance is `spread`."""
    gains = pose_gains(at, spread, q, R, points, D, base, odds, start, columns, gate2)
    match, used = np.full(q.shape[0], -1, np.int64), np.zeros(n, np.bool_)
    owner = np.empty(columns.shape[0], np.int64)
    for i in range(q.shape[0]):
        owner[start[i] : start[i + 1]] = i
    useful = np.flatnonzero(gains > 0.0)
    for c in useful[np.argsort(-gains[useful])]:
        if match[owner[c]] < 0 and not used[columns[c]]:
            match[owner[c]] = columns[c]
            used[columns[c]] = True
    return match


@jit
def pose_gains(
    at: Array, spread: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    start: Array, columns: Array, gate2: float,
) -> Array:  # fmt: skip
    """Gain of each listed pairing at a pose with covariance `spread`; -inf outside the gate."""
    gains = np.empty(columns.shape[0])
    for i in range(q.shape[0]):
        _row_gains(at, spread, i, q, R, points, D, base, odds, start, columns, gate2, gains)
    return gains


@jit
def _row_gains(
    at: Array, P: Array, i: int, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    start: Array, columns: Array, gate2: float, gains: Array,
) -> None:  # fmt: skip
    """The gains of one observation's listed pairings, at a pose `at` with covariance P: V = R + D + J P J'."""
    c, s = math.cos(at[2]), math.sin(at[2])
    for k in range(start[i], start[i + 1]):
        j = columns[k]
        gx, gy = c * points[j, 0] - s * points[j, 1], s * points[j, 0] + c * points[j, 1]
        a = R[i, 0, 0] + D[j, 0, 0] + P[0, 0] - 2.0 * gy * P[0, 2] + gy * gy * P[2, 2]
        b = R[i, 0, 1] + D[j, 0, 1] + P[0, 1] + gx * P[0, 2] - gy * P[1, 2] - gx * gy * P[2, 2]
        d = R[i, 1, 1] + D[j, 1, 1] + P[1, 1] + 2.0 * gx * P[1, 2] + gx * gx * P[2, 2]
        u, v = q[i, 0] - gx - at[0], q[i, 1] - gy - at[1]
        det = a * d - b * b
        d2 = (d * u * u - 2.0 * b * u * v + a * v * v) / det
        gains[k] = base[i] + odds[j] - 0.5 * (d2 + math.log(det)) - LOG_2PI if d2 < gate2 else -np.inf


@jit
def left_out_gains(
    at: Array, M: Array, match: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    start: Array, columns: Array, gate2: float,
) -> Array:  # fmt: skip
    """Gain of each listed pairing of each observation at the pose that the *other* pairings give, with its covariance."""
    gains = np.empty(columns.shape[0])
    whole, A, h = inverse(M), np.empty((3, 3)), np.empty(3)
    for i in range(q.shape[0]):
        pose, spread = at, whole
        if match[i] >= 0:
            A[:], h[:] = 0.0, 0.0
            _add_part(A, h, at, q[i], R[i], points[match[i]], D[match[i]])
            spread = inverse(M - A)
            pose = at - _times(spread, h)
        _row_gains(pose, spread, i, q, R, points, D, base, odds, start, columns, gate2, gains)
    return gains


@jit
def place(
    match: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array, prior_inverse: Array,
    start: Array, columns: Array, gate2: float,
) -> tuple[Array, Array, float, Array]:  # fmt: skip
    """The pose that a match implies, from no motion: pose, M, L and the gains of the listed pairings, each left out."""
    at, M, value = fit(np.zeros(3), match, q, R, points, D, base, odds, prior_inverse, 4)
    gains = left_out_gains(at, M, match, q, R, points, D, base, odds, start, columns, gate2)
    return at, M, value, gains


@jit
def uncontested(gains: Array, start: Array, columns: Array, match: Array) -> bool:
    """True when every observation has its own best choice (or none is worth it): no assignment can be better."""
    for i in range(match.shape[0]):
        best, most = -1, 0.0
        for k in range(start[i], start[i + 1]):
            if gains[k] > most:
                best, most = columns[k], gains[k]
        if best != match[i]:
            return False
    return True


@jit
def worth(gains: Array, start: Array, columns: Array) -> tuple[Array, Array]:
    """The landmarks that are listed (k,), and what each observation gains by each of them (m, k), at least 0."""
    names = np.unique(columns)
    table = np.zeros((start.shape[0] - 1, names.shape[0]))
    for i in range(table.shape[0]):
        for c in range(start[i], start[i + 1]):
            table[i, np.searchsorted(names, columns[c])] = max(gains[c], 0.0)
    return names, table


@jit
def log_prior(pose: Array, prior_inverse: Array) -> float:
    """Log density of the motion's prior, but for a constant."""
    v = _times(prior_inverse, pose)
    return float(-0.5 * (v[0] * pose[0] + v[1] * pose[1] + v[2] * pose[2]))


@jit
def _step(at: Array, q: Array, R: Array, points: Array, D: Array, match: Array, prior_inverse: Array) -> Array:
    """One step of Gauss-Newton, in place; the matrix at the pose it left."""
    M, g = _normal(at, q, R, points, D, match, prior_inverse)
    at += _times(inverse(M), g)
    return M


@jit
def _normal(
    at: Array, q: Array, R: Array, points: Array, D: Array, match: Array, prior_inverse: Array
) -> tuple[Array, Array]:
    """Gauss-Newton's matrix and right side at the pose, prior at zero motion."""
    M, g = prior_inverse.copy(), -_times(prior_inverse, at)
    for i in range(q.shape[0]):
        if match[i] >= 0:
            _add_part(M, g, at, q[i], R[i], points[match[i]], D[match[i]])
    return M, g


@jit
def _add_part(M: Array, g: Array, at: Array, q: Array, R: Array, p: Array, D: Array) -> None:
    """Add J' V^-1 J and J' V^-1 r of one pairing to the normal equations."""
    c, s = math.cos(at[2]), math.sin(at[2])
    gx, gy = c * p[0] - s * p[1], s * p[0] + c * p[1]
    u, v = q[0] - gx - at[0], q[1] - gy - at[1]
    a, b, d = R[0, 0] + D[0, 0], R[0, 1] + D[0, 1], R[1, 1] + D[1, 1]
    det = a * d - b * b
    w00, w01, w11 = d / det, -b / det, a / det
    m02, m12 = -w00 * gy + w01 * gx, -w01 * gy + w11 * gx
    h0, h1 = w00 * u + w01 * v, w01 * u + w11 * v
    M[0, 0] += w00
    M[0, 1] += w01
    M[1, 0] += w01
    M[1, 1] += w11
    M[0, 2] += m02
    M[2, 0] += m02
    M[1, 2] += m12
    M[2, 1] += m12
    M[2, 2] += -gy * m02 + gx * m12
    g[0] += h0
    g[1] += h1
    g[2] += -gy * h0 + gx * h1


@jit
def inverse(M: Array) -> Array:
    """Inverse of a symmetric positive definite (3, 3), scaled to a unit diagonal first: m and rad may differ by far."""
    s0, s1, s2 = 1.0 / math.sqrt(M[0, 0]), 1.0 / math.sqrt(M[1, 1]), 1.0 / math.sqrt(M[2, 2])
    b, c, e = M[0, 1] * s0 * s1, M[0, 2] * s0 * s2, M[1, 2] * s1 * s2
    det = 1.0 - e * e - b * (b - c * e) + c * (b * e - c)
    out = np.empty((3, 3))
    out[0, 0], out[1, 1], out[2, 2] = (1.0 - e * e) * s0 * s0, (1.0 - c * c) * s1 * s1, (1.0 - b * b) * s2 * s2
    out[0, 1], out[0, 2], out[1, 2] = (c * e - b) * s0 * s1, (b * e - c) * s0 * s2, (b * c - e) * s1 * s2
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return out / det


@jit
def _times(M: Array, v: Array) -> Array:
    out = np.empty(3)
    for r in range(3):
        out[r] = M[r, 0] * v[0] + M[r, 1] * v[1] + M[r, 2] * v[2]
    return out
