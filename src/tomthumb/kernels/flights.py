"""Anchored flights: poses from pairs of pairings whose distance a rigid motion keeps, and the vote of the other observations.

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
def fill_grid(points: Array, cell: float) -> tuple[Array, Array, Array, Array]:
    """Points sorted into square cells: origin (2,), shape (2,), start of each cell, index. Cells in row-major order."""
    n = points.shape[0]
    low, high = np.array([np.inf, np.inf]), np.array([-np.inf, -np.inf])
    for j in range(n):
        for u in range(2):
            low[u], high[u] = min(low[u], points[j, u]), max(high[u], points[j, u])
    shape = np.ones(2, np.int64)
    for u in range(2):
        shape[u] = int((high[u] - low[u]) / cell) + 1 if n > 0 else 1
    counts = np.zeros(shape[0] * shape[1] + 1, np.int64)
    home = np.empty(n, np.int64)
    for j in range(n):
        home[j] = int((points[j, 0] - low[0]) / cell) * shape[1] + int((points[j, 1] - low[1]) / cell)
        counts[home[j] + 1] += 1
    start = np.cumsum(counts)
    index, fill = np.empty(n, np.int64), start[:-1].copy()
    for j in range(n):
        index[fill[home[j]]] = j
        fill[home[j]] += 1
    return low, shape, start, index


@jit
def best_near(
    x: float, y: float, W: Array, points: Array, worth: Array, cell: float, low: Array, shape: Array, start: Array,
    index: Array,
) -> float:  # fmt: skip
    """max over the points in the 3 x 3 window around (x, y) of worth_j - d2 / 2, d2 by the inverse covariance W (3,)."""
    cx, cy = math.floor((x - low[0]) / cell), math.floor((y - low[1]) / cell)
    best = -np.inf
    for a in range(max(cx - 1, 0), min(cx + 2, shape[0])):
        first, last = max(cy - 1, 0), min(cy + 2, shape[1])
        if last <= first:
            continue
        for c in range(start[a * shape[1] + first], start[a * shape[1] + last]):
            j = index[c]
            u, v = x - points[j, 0], y - points[j, 1]
            value = worth[j] - 0.5 * (W[0] * u * u + 2.0 * W[1] * u * v + W[2] * v * v)
            if value > best:
                best = value
    return best


@jit
def explore(
    q: Array, W: Array, gain: Array, anchors: Array, tolerance: Array, start: Array, columns: Array, points: Array,
    worth: Array, prior_inverse: Array, prior_gate2: float, cell: float, low: Array, shape: Array, cells: Array,
    index: Array, apart: Array, basins: int, budget: int,
) -> tuple[Array, Array, int, int]:  # fmt: skip
    """Poses from all anchors' pairs of candidates, voted on by all observations; the best distinct ones, best first.

    q (m, 2) observations; W (m, 3) inverse covariances for the vote; gain (m,) what a perfect vote adds; anchors (a, 2)
    pairs of observations, tolerance (a,) m on their distance; candidates of i in columns[start[i]:start[i + 1]]; worth (n,)
    log odds of each point relative to the best. apart (2,): two poses nearer than this (m, rad) are one basin.
    Stops early when two anchors agree on a basin that leads by 10 nats and explains 60 % of what can be gained.
    Returns poses (basins, 3), scores (-inf where none), poses tried and anchors used.
    """
    m = q.shape[0]
    poses, scores = np.zeros((basins, 3)), np.full(basins, -np.inf)
    possible, tried = 0.0, 0
    rest = np.zeros(m + 1)
    for i in range(m - 1, -1, -1):
        rest[i] = rest[i + 1] + max(gain[i], 0.0)
    possible = rest[0]
    support = np.zeros(basins, np.int64)  # anchors that led to each basin
    for k in range(anchors.shape[0]):
        if k >= 2 and support[0] >= 2 and scores[0] > 0.6 * possible and (basins < 2 or scores[0] - scores[1] > 10.0):
            return poses, scores, tried, k
        a, b = anchors[k, 0], anchors[k, 1]
        qx, qy = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1]
        q_length = math.sqrt(qx * qx + qy * qy)
        near, far = max(q_length - tolerance[k], 1e-9), q_length + tolerance[k]
        touched = np.zeros(basins, np.bool_)
        for ca in range(start[a], start[a + 1]):
            ja = columns[ca]
            for cb in range(start[b], start[b + 1]):
                jb = columns[cb]
                px, py = points[jb, 0] - points[ja, 0], points[jb, 1] - points[ja, 1]
                square = px * px + py * py
                if ja == jb or square < near * near or square > far * far:
                    continue
                scale = 1.0 / (math.sqrt(square) * q_length)
                c, s = (px * qx + py * qy) * scale, (px * qy - py * qx) * scale
                mx, my = 0.5 * (points[ja, 0] + points[jb, 0]), 0.5 * (points[ja, 1] + points[jb, 1])
                tx, ty = 0.5 * (q[a, 0] + q[b, 0]) - c * mx + s * my, 0.5 * (q[a, 1] + q[b, 1]) - s * mx - c * my
                theta = math.atan2(s, c)
                cost = 0.5 * _quadratic(prior_inverse, tx, ty, theta)
                if 2.0 * cost > prior_gate2:
                    continue
                tried += 1
                score = -cost
                floor = scores[basins - 1]
                for i in range(m):
                    if score + rest[i] <= floor:
                        score = -np.inf
                        break
                    # the observation carried back to where the map would have it
                    ox, oy = q[i, 0] - tx, q[i, 1] - ty
                    x, y = c * ox + s * oy, -s * ox + c * oy
                    vote = gain[i] + best_near(x, y, W[i], points, worth, cell, low, shape, cells, index)
                    if vote > 0.0:
                        score += vote
                if score > floor:
                    _settle(poses, scores, support, touched, tx, ty, theta, score, apart)
                if tried >= budget:
                    return poses, scores, tried, k
        for r in range(basins):
            support[r] += touched[r]
    return poses, scores, tried, anchors.shape[0]


@jit
def _quadratic(M: Array, x: float, y: float, t: float) -> float:
    squares = M[0, 0] * x * x + M[1, 1] * y * y + M[2, 2] * t * t
    return float(squares + 2.0 * (M[0, 1] * x * y + M[0, 2] * x * t + M[1, 2] * y * t))


@jit
def _settle(
    poses: Array,
    scores: Array,
    support: Array,
    touched: Array,
    x: float,
    y: float,
    t: float,
    score: float,
    apart: Array,
) -> None:
    """Put a pose into the list of basins, best first; a basin keeps the best of its poses."""
    size = scores.shape[0]
    k = size - 1
    for r in range(size):
        if scores[r] == -np.inf:
            k = r
            break
        turn = abs((t - poses[r, 2] + math.pi) % (2.0 * math.pi) - math.pi)
        if math.hypot(x - poses[r, 0], y - poses[r, 1]) < apart[0] and turn < apart[1]:
            touched[r] = True
            if score <= scores[r]:
                return
            k = r
            break
    if scores[k] >= score:
        return
    if k == size - 1 and not touched[k]:
        support[k] = 0
    votes = support[k] if scores[k] > -np.inf else 0
    if k == size - 1 and scores[k] > -np.inf and not touched[k]:
        votes = 0
    while k > 0 and scores[k - 1] < score:
        poses[k], scores[k], support[k], touched[k] = poses[k - 1], scores[k - 1], support[k - 1], touched[k - 1]
        k -= 1
    poses[k, 0], poses[k, 1], poses[k, 2], scores[k] = x, y, t, score
    support[k], touched[k] = votes, True


@jit
def local_candidates(
    pose: Array,
    q: Array,
    reach: Array,
    points: Array,
    cell: float,
    low: Array,
    shape: Array,
    cells: Array,
    index: Array,
) -> tuple[Array, Array]:
    """Points within reach (m,) of where each observation falls under `pose`, as (start, columns)."""
    m = q.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    start, found = np.zeros(m + 1, np.int64), []
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
                if math.hypot(points[j, 0] - x, points[j, 1] - y) <= reach[i]:
                    found.append(j)
        start[i + 1] = len(found)
    columns = np.empty(len(found), np.int64)
    for k in range(len(found)):
        columns[k] = found[k]
    return start, columns


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
            M, g = _normal(at, q, R, points, D, match, prior_inverse)
            at = at + np.linalg.solve(M, g)
        spread = np.linalg.inv(M)
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
        M, g = _normal(at, q, R, points, D, match, prior_inverse)
        at = at + np.linalg.solve(M, g)
    M, g = _normal(at, q, R, points, D, match, prior_inverse)
    value = -0.5 * _quadratic(prior_inverse, at[0], at[1], at[2])
    value += 0.5 * (math.log(np.linalg.det(prior_inverse)) - math.log(np.linalg.det(M)))
    c, s = math.cos(at[2]), math.sin(at[2])
    for i in range(q.shape[0]):
        j = match[i]
        if j >= 0:
            u = q[i, 0] - c * points[j, 0] + s * points[j, 1] - at[0]
            v = q[i, 1] - s * points[j, 0] - c * points[j, 1] - at[1]
            d2, det = _distance(u, v, R[i], D[j])
            value += base[i] + odds[j] - 0.5 * (d2 + math.log(det)) - LOG_2PI
    return at, M, value


@jit
def _distance(u: float, v: float, A: Array, B: Array) -> tuple[float, float]:
    """d2 and determinant of (u, v) under A + B."""
    a, b, d = A[0, 0] + B[0, 0], A[0, 1] + B[0, 1], A[1, 1] + B[1, 1]
    det = a * d - b * b
    return (d * u * u - 2.0 * b * u * v + a * v * v) / det, det


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
    for c in np.argsort(-gains):
        if gains[c] <= 0.0:
            break
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
    c, s = math.cos(at[2]), math.sin(at[2])
    for i in range(q.shape[0]):
        for k in range(start[i], start[i + 1]):
            j = columns[k]
            gx, gy = c * points[j, 0] - s * points[j, 1], s * points[j, 0] + c * points[j, 1]
            V = R[i] + D[j] + _lever(gx, gy, spread)
            d2, det = _distance(q[i, 0] - gx - at[0], q[i, 1] - gy - at[1], V, np.zeros((2, 2)))
            gains[k] = base[i] + odds[j] - 0.5 * (d2 + math.log(det)) - LOG_2PI if d2 < gate2 else -np.inf
    return gains


@jit
def _lever(gx: float, gy: float, P: Array) -> Array:
    """J P J' with J = [I | (-gy, gx)']."""
    out = np.empty((2, 2))
    out[0, 0] = P[0, 0] - 2.0 * gy * P[0, 2] + gy * gy * P[2, 2]
    out[0, 1] = P[0, 1] + gx * P[0, 2] - gy * P[1, 2] - gx * gy * P[2, 2]
    out[1, 0] = out[0, 1]
    out[1, 1] = P[1, 1] + 2.0 * gx * P[1, 2] + gx * gx * P[2, 2]
    return out


@jit
def _normal(
    at: Array, q: Array, R: Array, points: Array, D: Array, match: Array, prior_inverse: Array
) -> tuple[Array, Array]:
    """Gauss-Newton's matrix and right side at the pose, prior at zero motion."""
    M, g = prior_inverse.copy(), -prior_inverse @ at
    for i in range(q.shape[0]):
        if match[i] >= 0:
            A, h = normal_part(at, q[i], R[i], points[match[i]], D[match[i]])
            M += A
            g += h
    return M, g


@jit
def normal_part(at: Array, q: Array, R: Array, p: Array, D: Array) -> tuple[Array, Array]:
    """J' V^-1 J and J' V^-1 r of one pairing."""
    c, s = math.cos(at[2]), math.sin(at[2])
    gx, gy = c * p[0] - s * p[1], s * p[0] + c * p[1]
    u, v = q[0] - gx - at[0], q[1] - gy - at[1]
    a, b, d = R[0, 0] + D[0, 0], R[0, 1] + D[0, 1], R[1, 1] + D[1, 1]
    det = a * d - b * b
    w00, w01, w11 = d / det, -b / det, a / det
    A, h = np.empty((3, 3)), np.empty(3)
    j0, j1 = -gy, gx
    A[0, 0], A[0, 1], A[1, 1] = w00, w01, w11
    A[0, 2], A[1, 2] = w00 * j0 + w01 * j1, w01 * j0 + w11 * j1
    A[2, 2] = j0 * A[0, 2] + j1 * A[1, 2]
    A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    h[0], h[1] = w00 * u + w01 * v, w01 * u + w11 * v
    h[2] = j0 * h[0] + j1 * h[1]
    return A, h


@jit
def left_out_gains(
    at: Array, M: Array, match: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array,
    start: Array, columns: Array, gate2: float,
) -> Array:  # fmt: skip
    """Gain of each listed pairing of each observation at the pose that the *other* pairings give, with its covariance."""
    gains = np.empty(columns.shape[0])
    whole = np.linalg.inv(M)
    for i in range(q.shape[0]):
        pose, spread = at, whole
        if match[i] >= 0:
            A, h = normal_part(at, q[i], R[i], points[match[i]], D[match[i]])
            spread = np.linalg.inv(M - A)
            pose = at - spread @ h
        one_start = np.array([0, start[i + 1] - start[i]])
        part = columns[start[i] : start[i + 1]]
        gains[start[i] : start[i + 1]] = pose_gains(
            pose, spread, q[i : i + 1], R[i : i + 1], points, D, base[i : i + 1], odds, one_start, part, gate2
        )
    return gains


@jit
def log_prior(pose: Array, prior_inverse: Array) -> float:
    """Log density of the motion's prior, but for a constant."""
    return -0.5 * _quadratic(prior_inverse, pose[0], pose[1], pose[2])
