"""Joint compatibility by the posterior: the least cost of one rigid motion that explains all pairings, not linearised.

Cartesian, in the sensor's frame: a motion xi = (tx, ty, theta) with prior N(0, Xi) carries predicted points p to
observed q = R(theta) p + t + noise of covariance V = R_i + D_j.  chi2 = min over xi of xi' Xi^-1 xi + sum r' V^-1 r.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

ROUNDS = 6  # Gauss-Newton steps at most


@jit
def posterior_d2(
    pose: Array, rows: Array, chosen: Array, k: int, q: Array, R: Array, p: Array, D: Array, prior: Array
) -> float:
    """chi2 of the first k pairings (rows, chosen); `pose (3,)` is where to begin, and becomes the best motion."""
    A, g, cost = np.empty((3, 3)), np.empty(3), np.inf
    for step in range(ROUNDS + 1):
        cost = _normal(A, g, pose, rows, chosen, k, q, R, p, D, prior)
        if step == ROUNDS:
            break
        change = np.linalg.solve(A, g)
        for u in range(3):
            pose[u] += change[u]
        if g[0] * change[0] + g[1] * change[1] + g[2] * change[2] < 1e-9:  # what another step could still gain
            return _normal(A, g, pose, rows, chosen, k, q, R, p, D, prior)
    return cost


@jit
def _normal(
    A: Array, g: Array, pose: Array, rows: Array, chosen: Array, k: int,
    q: Array, R: Array, p: Array, D: Array, prior: Array,
) -> float:  # fmt: skip
    """The cost at `pose`; A and g become the matrix and the right side of Gauss-Newton."""
    cost = 0.0
    for u in range(3):
        g[u] = 0.0
        for v in range(3):
            A[u, v] = prior[u, v]
            g[u] -= prior[u, v] * pose[v]
        cost -= pose[u] * g[u]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for b in range(k):
        i, j = rows[b], chosen[b]
        gx, gy = c * p[j, 0] - s * p[j, 1], s * p[j, 0] + c * p[j, 1]
        x, y = q[i, 0] - gx - pose[0], q[i, 1] - gy - pose[1]
        a, o, d = R[i, 0, 0] + D[j, 0, 0], R[i, 0, 1] + D[j, 0, 1], R[i, 1, 1] + D[j, 1, 1]
        det = a * d - o * o
        wx, wy = (d * x - o * y) / det, (a * y - o * x) / det
        cost += x * wx + y * wy
        tx, ty = (-d * gy - o * gx) / det, (a * gx + o * gy) / det  # V^-1 times the derivative by theta, (-gy, gx)
        A[0, 0] += d / det
        A[1, 1] += a / det
        A[0, 1] -= o / det
        A[0, 2] += tx
        A[1, 2] += ty
        A[2, 2] += gx * ty - gy * tx
        g[0] += wx
        g[1] += wy
        g[2] += gx * wy - gy * wx
    A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    return cost


@jit
def single_d2(d2: Array, wide2: float, q: Array, R: Array, p: Array, D: Array, prior: Array) -> Array:
    """chi2 (m, n) of each pairing by itself, where its linear d2 is below `wide2`; infinite elsewhere."""
    m, n = d2.shape
    out = np.full((m, n), np.inf)
    row, column, pose = np.empty(1, np.int64), np.empty(1, np.int64), np.empty(3)
    for i in range(m):
        for j in range(n):
            if d2[i, j] < wide2:
                row[0], column[0] = i, j
                pose[:] = 0.0
                out[i, j] = posterior_d2(pose, row, column, 1, q, R, p, D, prior)
    return out


@jit
def search(
    q: Array, R: Array, p: Array, D: Array, prior: Array, order: Array, start: Array, candidates: Array,
    gates2: Array, budget: int,
) -> tuple[Array, float, int, bool]:  # fmt: skip
    """As `kernels.jcbb.search`: the most pairings whose every prefix has chi2 < gates2[k], then the least chi2.

    Returns the match (m,), its chi2, nodes spent, and whether the search was finished within the budget.
    """
    m = order.shape[0]
    best, best_count, best_d2 = np.full(m, -1, np.int64), 0, 0.0
    pick, rows, chosen = np.full(m + 1, -1, np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
    level_d2, poses = np.zeros(m + 1), np.zeros((m + 1, 3))
    used, useful = np.zeros(p.shape[0] + 1, np.bool_), np.zeros(m + 1, np.int64)
    for s in range(m - 1, -1, -1):
        useful[s] = useful[s + 1] + (1 if start[s + 1] > start[s] else 0)
    s, k, nodes = 0, 0, 0
    pick[0] = start[0] - 1
    while s >= 0:
        if s == m:
            if k > best_count or (k == best_count and level_d2[k] < best_d2):
                best_count, best_d2 = k, level_d2[k]
                best[:] = -1
                best[rows[:k]] = chosen[:k]
            s, k = _back(s, k, pick, start, chosen, used)
            continue
        pick[s] += 1
        reach = k + useful[s + 1] + (1 if pick[s] < start[s + 1] else 0)
        hopeless = reach < best_count or (reach == best_count and level_d2[k] >= best_d2)
        if pick[s] > start[s + 1] or hopeless:
            s, k = _back(s, k, pick, start, chosen, used)
            continue
        nodes += 1
        if nodes > budget:
            return best, best_d2, nodes, False
        if pick[s] < start[s + 1]:
            i, j = order[s], candidates[pick[s]]
            if used[j]:
                continue
            rows[k], chosen[k] = i, j
            poses[k + 1] = poses[k]
            d2 = posterior_d2(poses[k + 1], rows, chosen, k + 1, q, R, p, D, prior)
            if not d2 < gates2[k + 1]:
                continue
            used[j] = True
            k += 1
            level_d2[k] = d2
        s += 1
        if s < m:
            pick[s] = start[s] - 1
    return best, best_d2, nodes, True


@jit
def _back(s: int, k: int, pick: Array, start: Array, chosen: Array, used: Array) -> tuple[int, int]:
    """The level above, and the number of pairings after undoing what it had chosen."""
    s -= 1
    if s >= 0 and pick[s] < start[s + 1]:
        used[chosen[k - 1]] = False
        return s, k - 1
    return s, k
