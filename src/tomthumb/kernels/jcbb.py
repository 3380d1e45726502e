"""Depth-first search for the largest jointly compatible set of pairings, with an incremental Cholesky factor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def extend(L: Array, y: Array, k: int, C: Array, R: Array, chosen: Array, nu: Array, j: int) -> float:
    """Append pairing number k (landmark j, noise R, innovation nu) to the factor L of S; the growth of joint d2.

    Rows 2k and 2k + 1 of L, and of y = L^-1 nu, are written; infinite when S is not positive definite.
    """
    gain = 0.0
    for u in range(2):
        row = 2 * k + u
        for b in range(k):
            for v in range(2):
                column = 2 * b + v
                value = C[2 * j + u, 2 * chosen[b] + v]
                for q in range(column):
                    value -= L[row, q] * L[column, q]
                L[row, column] = value / L[column, column]
        for v in range(u + 1):
            column = 2 * k + v
            value = C[2 * j + u, 2 * j + v] + R[u, v]
            for q in range(column):
                value -= L[row, q] * L[column, q]
            if v < u:
                L[row, column] = value / L[column, column]
            elif value > 0.0:
                L[row, row] = math.sqrt(value)
            else:
                return np.inf
        value = nu[u]
        for q in range(row):
            value -= L[row, q] * y[q]
        y[row] = value / L[row, row]
        gain += y[row] * y[row]
    return gain


@jit
def search(
    nu: Array, C: Array, R: Array, order: Array, start: Array, candidates: Array, gates2: Array,
    unique: bool, tie_break: bool, complete: bool, budget: int,
) -> tuple[Array, float, int, bool]:  # fmt: skip
    """The best match (m,), its joint d2, nodes spent, and whether the search was finished within the budget.

    `candidates[start[s]:start[s + 1]]` are the landmarks to try for observation `order[s]`, in that order. `gates2[k]` is
    the chi-square value for k pairings. `complete`: only the whole set has to pass, prefixes are pruned by what the
    remaining pairings could still allow.
    """
    m = order.shape[0]
    best, best_count, best_d2 = np.full(m, -1, np.int64), 0, 0.0
    pick = np.full(m, -1, np.int64)  # candidate tried at each level; start[s + 1] stands for the star
    rows, chosen, level_d2 = np.empty(m, np.int64), np.empty(m, np.int64), np.zeros(m + 1)
    used = np.zeros(C.shape[0] // 2 + 1, np.bool_)
    L, y = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
    useful = _useful(start)
    s, k, nodes = 0, 0, 0
    if m > 0:
        pick[0] = start[0] - 1
    while s >= 0:
        if s == m:
            better = k > best_count or (tie_break and k == best_count and level_d2[k] < best_d2)
            if better and (not complete or level_d2[k] < gates2[k]):
                best_count, best_d2 = k, level_d2[k]
                best[:] = -1
                best[rows[:k]] = chosen[:k]
            s -= 1
            k = _retreat(s, k, pick, start, chosen, used)
            continue
        pick[s] += 1
        reach = k + useful[s + 1] + (1 if pick[s] < start[s + 1] else 0)
        hopeless = reach < best_count or (reach == best_count and not (tie_break and level_d2[k] < best_d2))
        if pick[s] > start[s + 1] or hopeless:  # the star, tried last, can reach no more than a candidate
            pick[s] = start[s + 1]
            s -= 1
            k = _retreat(s, k, pick, start, chosen, used)
            continue
        nodes += 1
        if nodes > budget:
            return best, best_d2, nodes, False
        if pick[s] < start[s + 1]:
            i, j = order[s], candidates[pick[s]]
            if unique and used[j]:
                continue
            d2 = level_d2[k] + extend(L, y, k, C, R[i], chosen, nu[i, j], j)
            limit = gates2[k + 1 + useful[s + 1]] if complete else gates2[k + 1]
            if not d2 < limit:
                continue
            rows[k], chosen[k], used[j] = i, j, True
            k += 1
            level_d2[k] = d2
        s += 1
        if s < m:
            pick[s] = start[s] - 1
    return best, best_d2, nodes, True


@jit
def _useful(start: Array) -> Array:
    """How many observations from each level on have any candidate at all."""
    m = start.shape[0] - 1
    useful = np.zeros(m + 1, np.int64)
    for s in range(m - 1, -1, -1):
        useful[s] = useful[s + 1] + (1 if start[s + 1] > start[s] else 0)
    return useful


@jit
def _retreat(s: int, k: int, pick: Array, start: Array, chosen: Array, used: Array) -> int:
    """Number of pairings after undoing what level s had chosen."""
    if s >= 0 and pick[s] < start[s + 1]:
        used[chosen[k - 1]] = False
        return k - 1
    return k
