"""Pairwise consistency of pairings as a sparse graph, its dense subgraph, and its largest clique."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def consistency(a: int, b: int, rows: Array, columns: Array, q: Array, R: Array, p: Array, C: Array) -> float:
    """Squared difference of the distances observed and predicted, over its variance; infinite for rivals.

    A rigid motion keeps distances, so the variance is that of q_a - q_b and p_a - p_b along the line: what the pose
    adds to the covariance C of the points cancels.
    """
    i, k, j, l = rows[a], rows[b], columns[a], columns[b]
    if i == k or j == l:
        return np.inf
    qx, qy, px, py = q[i, 0] - q[k, 0], q[i, 1] - q[k, 1], p[j, 0] - p[l, 0], p[j, 1] - p[l, 1]
    far, mapped = max(math.hypot(qx, qy), 1e-9), max(math.hypot(px, py), 1e-9)
    ex, ey, fx, fy = qx / far, qy / far, px / mapped, py / mapped
    var = ex * ex * (R[i, 0, 0] + R[k, 0, 0]) + ey * ey * (R[i, 1, 1] + R[k, 1, 1])
    var += 2.0 * ex * ey * (R[i, 0, 1] + R[k, 0, 1])
    x, y, u, v = 2 * j, 2 * j + 1, 2 * l, 2 * l + 1
    var += fx * fx * (C[x, x] + C[u, u] - 2.0 * C[x, u]) + fy * fy * (C[y, y] + C[v, v] - 2.0 * C[y, v])
    var += 2.0 * fx * fy * (C[x, y] + C[u, v] - C[x, v] - C[u, y])
    d2: float = (far - mapped) ** 2 / max(var, 1e-12)
    return d2


@jit
def graph(
    rows: Array, columns: Array, q: Array, R: Array, p: Array, C: Array, gate2: float
) -> tuple[Array, Array, Array]:
    """Neighbours of each pairing (sorted), as (start, neighbour), and the edges' weights exp(-d2 / 2)."""
    size = rows.shape[0]
    start = np.zeros(size + 1, np.int64)
    for a in range(size):
        for b in range(size):
            start[a + 1] += consistency(a, b, rows, columns, q, R, p, C) < gate2
    start = np.cumsum(start)
    neighbour, weight = np.empty(start[-1], np.int64), np.empty(start[-1])
    for a in range(size):
        at = start[a]
        for b in range(size):
            d2 = consistency(a, b, rows, columns, q, R, p, C)
            if d2 < gate2:
                neighbour[at], weight[at] = b, math.exp(-0.5 * d2)
                at += 1
    return start, neighbour, weight


@jit
def dense(start: Array, neighbour: Array, weight: Array, rounds: int) -> Array:
    """Membership u of a dense subgraph: replicator dynamics u <- u * (M u) / (u' M u) climb u' M u on the simplex."""
    size = start.shape[0] - 1
    u = np.full(size, 1.0 / max(size, 1))
    for _ in range(rounds):
        support, total = np.zeros(size), 0.0
        for a in range(size):
            if u[a] > 1e-12:
                for e in range(start[a], start[a + 1]):
                    support[neighbour[e]] += weight[e] * u[a]
        for a in range(size):
            total += u[a] * support[a]
        if total <= 0.0:
            return u
        change = 0.0
        for a in range(size):
            new = u[a] * support[a] / total
            change = max(change, abs(new - u[a]))
            u[a] = new
        if change < 1e-6:
            return u
    return u


@jit
def rounded(u: Array, start: Array, neighbour: Array) -> Array:
    """A clique (flags) grown by falling membership; ties by index."""
    size = u.shape[0]
    chosen, votes, count = np.zeros(size, np.bool_), np.zeros(size, np.int64), 0
    for a in np.argsort(-u, kind="mergesort"):
        if votes[a] == count:
            chosen[a] = True
            count += 1
            for e in range(start[a], start[a + 1]):
                votes[neighbour[e]] += 1
    return chosen


@jit
def largest(
    first: Array, rows: Array, order: Array, listed: Array, start: Array, neighbour: Array, budget: int
) -> tuple[Array, int, bool]:
    """The largest clique (flags), begun with the clique `first`; nodes spent, and whether it was finished.

    `order` lists the pairings, those of one observation together; `listed[s]:listed[s + 1]` are those of the s-th.
    Pairings of one observation exclude each other, so the observations that still have one left bound the size.
    """
    size, m = rows.shape[0], listed.shape[0] - 1
    best, best_count = first.copy(), int(first.sum())
    votes, pick = np.zeros(size, np.int64), np.full(m + 1, -1, np.int64)
    s, k, nodes = 0, 0, 0
    pick[0] = listed[0] - 1
    while s >= 0:
        if s == m or k + _left(s, k, order, listed, votes, pick[s] + 1) <= best_count:
            if s == m and k > best_count:
                best_count = k
                best[:] = False
                for t in range(m):
                    if pick[t] < listed[t + 1]:
                        best[order[pick[t]]] = True
            s -= 1
            if s >= 0 and pick[s] < listed[s + 1]:
                k -= 1
                _vote(order[pick[s]], -1, votes, start, neighbour)
            continue
        pick[s] += 1
        if pick[s] > listed[s + 1]:
            s -= 1
            if s >= 0 and pick[s] < listed[s + 1]:
                k -= 1
                _vote(order[pick[s]], -1, votes, start, neighbour)
            continue
        nodes += 1
        if nodes > budget:
            return best, nodes, False
        if pick[s] < listed[s + 1]:
            if votes[order[pick[s]]] < k:
                continue
            _vote(order[pick[s]], 1, votes, start, neighbour)
            k += 1
        s += 1
        if s < m:
            pick[s] = listed[s] - 1
    return best, nodes, True


@jit
def _vote(a: int, sign: int, votes: Array, start: Array, neighbour: Array) -> None:
    for e in range(start[a], start[a + 1]):
        votes[neighbour[e]] += sign


@jit
def _left(s: int, k: int, order: Array, listed: Array, votes: Array, begin: int) -> int:
    """Observations from level s on with a pairing that agrees with all k chosen; at level s counted from `begin` on."""
    count = 0
    for t in range(s, listed.shape[0] - 1):
        for c in range(begin if t == s else listed[t], listed[t + 1]):
            if votes[order[c]] == k:
                count += 1
                break
    return count
