"""The joint posterior L of a set of pairings, and searches for its maximum, on the full covariance of the predictions.

L(a) = sum of base gains - D2 / 2 - log det(2 pi S) / 2, relative to "nothing paired"; D2 and S are joint over all pairs.
The base gain of (i, j) is log P_D / (1 - P_D) - log lambda0 + prior. Everything here is array in, array out.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LOG_2PI = math.log(2.0 * math.pi)


@jit
def extend(L: Array, y: Array, k: int, C: Array, R: Array, chosen: Array, nu: Array, j: int) -> tuple[float, float]:
    """Append pairing number k (landmark j) to the factor L of S and to y = L^-1 nu: growth of D2 and of log det S."""
    d2, logdet = 0.0, 0.0
    for u in range(2):
        row = 2 * k + u
        residual = nu[u]
        for b in range(k):
            for v in range(2):
                column = 2 * b + v
                value = C[2 * j + u, 2 * chosen[b] + v]
                for q in range(column):
                    value -= L[row, q] * L[column, q]
                value /= L[column, column]
                L[row, column] = value
                residual -= value * y[column]
        if u == 1:
            value = C[2 * j + 1, 2 * j] + R[1, 0]
            for q in range(2 * k):
                value -= L[row, q] * L[row - 1, q]
            value /= L[row - 1, row - 1]
            L[row, row - 1] = value
            residual -= value * y[row - 1]
        pivot = C[2 * j + u, 2 * j + u] + R[u, u]
        for q in range(row):
            pivot -= L[row, q] * L[row, q]
        if not pivot > 0.0:
            return np.inf, 0.0
        L[row, row] = math.sqrt(pivot)
        y[row] = residual / L[row, row]
        d2 += y[row] * y[row]
        logdet += math.log(pivot)
    return d2, logdet


@jit
def value_of(match: Array, nu: Array, C: Array, R: Array, base: Array) -> tuple[float, float, int]:
    """L, D2 and number of pairings of a match (m,)."""
    m = match.shape[0]
    L, y, chosen = np.zeros((2 * m, 2 * m)), np.zeros(2 * m), np.empty(m, np.int64)
    k, total, d2 = 0, 0.0, 0.0
    for i in range(m):
        j = match[i]
        if j >= 0:
            more, logdet = extend(L, y, k, C, R[i], chosen, nu[i, j], j)
            chosen[k] = j
            k += 1
            d2 += more
            total += base[i, j] - 0.5 * (more + logdet) - LOG_2PI
    return total, d2, k


@jit
def complete(
    match: Array, nu: Array, C: Array, R: Array, base: Array, start: Array, columns: Array, gate2: float
) -> tuple[Array, float]:
    """Conditional greedy: the pairing of largest regret first, each conditioned on those before, while L grows.

    `columns[start[i]:start[i + 1]]` are the candidates of observation i; conditional d2 must stay within `gate2`.
    Regret is the gain of an observation's best choice over its second (or over staying unpaired). Begins with `match`.
    """
    m, n = nu.shape[0], nu.shape[1]
    z, S = nu.copy(), C.copy()
    out, used, total = np.full(m, -1, np.int64), np.zeros(n, np.bool_), 0.0
    for i in range(m):
        if match[i] >= 0:
            gain, d2 = _gain(z[i, match[i]], S, R[i], match[i], base[i, match[i]])
            _condition(z, S, R[i], i, match[i])
            out[i], used[match[i]] = match[i], True
            total += gain
    while True:
        pick_i, pick_j, pick_gain, pick_regret = -1, -1, 0.0, -1.0
        for i in range(m):
            if out[i] >= 0:
                continue
            first, second, first_j = 0.0, 0.0, -1
            for c in range(start[i], start[i + 1]):
                j = columns[c]
                if used[j]:
                    continue
                gain, d2 = _gain(z[i, j], S, R[i], j, base[i, j])
                if d2 < gate2 and gain > first:
                    first, second, first_j = gain, first, j
                elif d2 < gate2 and gain > second:
                    second = gain
            if first_j >= 0 and first - second > pick_regret:
                pick_i, pick_j, pick_gain, pick_regret = i, first_j, first, first - second
        if pick_i < 0:
            return out, total
        _condition(z, S, R[pick_i], pick_i, pick_j)
        out[pick_i], used[pick_j] = pick_j, True
        total += pick_gain


@jit
def _gain(nu: Array, S: Array, R: Array, j: int, base: float) -> tuple[float, float]:
    """Gain in L, and d2, of one pairing under the current conditional predictions."""
    a, d = S[2 * j, 2 * j] + R[0, 0], S[2 * j + 1, 2 * j + 1] + R[1, 1]
    b = S[2 * j, 2 * j + 1] + R[0, 1]
    det = a * d - b * b
    if not (det > 0.0 and a > 0.0):
        return -np.inf, np.inf
    d2 = (d * nu[0] * nu[0] - 2.0 * b * nu[0] * nu[1] + a * nu[1] * nu[1]) / det
    return base - 0.5 * (d2 + math.log(det)) - LOG_2PI, d2


@jit
def _condition(z: Array, S: Array, R: Array, i: int, j: int) -> None:
    """Condition all innovations z (m, n, 2) and the predictions' covariance S on the pairing (i, j), in place.

    K = S[:, j] (S_jj + R_i)^-1; z_hat += K nu; S -= K S[j, :].  Equals the chain rule exactly.
    """
    m, n = z.shape[0], z.shape[1]
    a, d = S[2 * j, 2 * j] + R[0, 0], S[2 * j + 1, 2 * j + 1] + R[1, 1]
    b = S[2 * j, 2 * j + 1] + R[0, 1]
    det = a * d - b * b
    u, v = z[i, j, 0], z[i, j, 1]
    p, q = S[:, 2 * j].copy(), S[:, 2 * j + 1].copy()
    for r in range(2 * n):
        k0, k1 = (p[r] * d - q[r] * b) / det, (q[r] * a - p[r] * b) / det
        change = k0 * u + k1 * v
        for o in range(m):
            z[o, r // 2, r % 2] -= change
        for c in range(2 * n):
            S[r, c] -= k0 * p[c] + k1 * q[c]


@jit
def search(
    nu: Array, C: Array, R: Array, base: Array, bound: Array, order: Array, start: Array, columns: Array, gates2: Array,
    incumbent: Array, incumbent_value: float, slack: float, budget: int, pool: Array, pool_value: Array,
) -> tuple[int, bool]:  # fmt: skip
    """Branch and bound for the maximum of L, warm-started; nodes spent, and whether it was finished (then proven).

    Fills `pool (K, m)` and `pool_value (K,)` with the best hypotheses met, best first; all within `slack` nats of the
    best are met if the search finishes. `bound (m,)` is the most observation order[s] could ever add. A set of k pairs
    must pass D2 < gates2[k] (inf: no test). Candidates as in `kernels.jcbb.search`.
    """
    m, K = order.shape[0], pool.shape[0]
    pool[:] = -1
    pool_value[:] = -np.inf
    pool[0], pool_value[0] = incumbent, incumbent_value
    rest = np.zeros(m + 1)
    for s in range(m - 1, -1, -1):
        rest[s] = rest[s + 1] + (bound[order[s]] if start[s + 1] > start[s] else 0.0)
    pick, match = np.full(m + 1, -1, np.int64), np.full(m, -1, np.int64)
    chosen, count = np.empty(m, np.int64), np.zeros(m + 1, np.int64)
    level, level_d2 = np.zeros(m + 1), np.zeros(m + 1)
    used = np.zeros(C.shape[0] // 2 + 1, np.bool_)
    L, y = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
    s, nodes = 0, 0
    if m > 0:
        pick[0] = start[0] - 1
    while s >= 0:
        if s == m:
            k = count[m]
            if level_d2[m] < gates2[k]:
                _keep(pool, pool_value, match, level[m], K)
            s -= 1
            _undo(s, pick, start, columns, match, used, order)
            continue
        pick[s] += 1
        threshold = max(pool_value[0] - slack, pool_value[K - 1])
        if pick[s] > start[s + 1] or level[s] + rest[s] <= threshold:
            pick[s] = start[s + 1]
            s -= 1
            _undo(s, pick, start, columns, match, used, order)
            continue
        nodes += 1
        if nodes > budget:
            return nodes, False
        level[s + 1], level_d2[s + 1], count[s + 1] = level[s], level_d2[s], count[s]
        if pick[s] < start[s + 1]:
            i, j, k = order[s], columns[pick[s]], count[s]
            if used[j]:
                continue
            d2, logdet = extend(L, y, k, C, R[i], chosen, nu[i, j], j)
            gain = base[i, j] - 0.5 * (d2 + logdet) - LOG_2PI
            if not (level[s] + gain + rest[s + 1] > threshold):
                continue
            chosen[k], used[j], match[i] = j, True, j
            level[s + 1], level_d2[s + 1], count[s + 1] = level[s] + gain, level_d2[s] + d2, k + 1
        s += 1
        if s < m:
            pick[s] = start[s] - 1
    return nodes, True


@jit
def _undo(s: int, pick: Array, start: Array, columns: Array, match: Array, used: Array, order: Array) -> None:
    """Take back what level s had chosen."""
    if s >= 0 and pick[s] < start[s + 1]:
        used[columns[pick[s]]] = False
        match[order[s]] = -1


@jit
def _keep(pool: Array, pool_value: Array, match: Array, value: float, K: int) -> None:
    """Insert a hypothesis into the pool, best first, once."""
    for k in range(K):
        if abs(pool_value[k] - value) < 1e-9 and np.array_equal(pool[k], match):
            return
    if value <= pool_value[K - 1]:
        return
    k = K - 1
    while k > 0 and pool_value[k - 1] < value:
        pool[k], pool_value[k] = pool[k - 1], pool_value[k - 1]
        k -= 1
    pool[k], pool_value[k] = match, value


@jit
def solve(
    nu: Array, C: Array, R: Array, base: Array, start: Array, columns: Array, gate2: float, slack: float, budget: int,
    size: int,
) -> tuple[Array, Array, int, bool]:  # fmt: skip
    """Greedy and certificate at once: `search` from the best of `complete`, observations of few candidates first.

    Where nobody's candidates are more than one or another's too, that one pairing each is where the search begins.
    Returns pool (size, m), its L (size,), nodes and whether the search was finished.
    """
    m, n = nu.shape[0], nu.shape[1]
    first, used, single = np.full(m, -1, np.int64), np.zeros(n, np.bool_), True
    for i in range(m):
        single &= start[i + 1] - start[i] <= 1
        if single and start[i + 1] > start[i]:
            first[i] = columns[start[i]]
            single &= not used[first[i]]
            used[first[i]] = True
    if single:
        value = value_of(first, nu, C, R, base)[0]
    else:
        first, value = complete(np.full(m, -1, np.int64), nu, C, R, base, start, columns, gate2)
    if not value > 0.0:
        first, value = np.full(m, -1, np.int64), 0.0
    order, ranked_start, ranked = rank(start, columns)
    bound = most_possible(start, columns, base, R)
    pool, values = np.full((size, m), -1, np.int64), np.full(size, -np.inf)
    nodes, proven = search(
        nu, C, R, base, bound, order, ranked_start, ranked, np.full(m + 1, np.inf), first, value, slack, budget, pool,
        values,
    )  # fmt: skip
    return pool, values, nodes, proven


@jit
def listed(
    nu: Array, C: Array, R: Array, base: Array, start: Array, columns: Array, gate2: float, slack: float, budget: int,
    size: int,
) -> tuple[bool, Array, Array, Array, float, int]:  # fmt: skip
    """Marginals p (m, n) and none (m,) by summing all hypotheses within `slack` nats of the best; its match, L, and nodes.

    The first is False where the budget, or `size` hypotheses, did not suffice: then the sums are not what they claim.
    """
    pool, values, nodes, proven = solve(nu, C, R, base, start, columns, gate2, slack, budget, size)
    p, none, total = np.zeros((nu.shape[0], nu.shape[1])), np.zeros(nu.shape[0]), 0.0
    for k in range(size):
        if values[k] > values[0] - slack:
            weight = math.exp(values[k] - values[0])
            total += weight
            for i in range(none.shape[0]):
                if pool[k, i] >= 0:
                    p[i, pool[k, i]] += weight
                else:
                    none[i] += weight
    return proven and values[size - 1] == -np.inf, p / total, none / total, pool[0], values[0], nodes


@jit
def bend(x: float, y: float, R: Array, turn: float) -> float:
    """What linearising the heading (variance `turn`) leaves out of a point, in standard deviations of its noise R (2, 2).

    An arc beside its tangent: r turn / 2 back along the line of sight, so turn / 2 times the length of (x, y) by R^-1.
    """
    square = R[1, 1] * x * x - (R[0, 1] + R[1, 0]) * x * y + R[0, 0] * y * y
    return 0.5 * turn * math.sqrt(square / (R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0]))


@jit
def bent(z: Array, R: Array, z_hat: Array, C: Array, turn: float, polar: bool) -> float:
    """What linearising the pose leaves out, one sigma, over the noise: the largest of all.

    For points z (m, 2) it is `bend`; for range and bearing the arc of the bearing, r v / 2, v its variance, and the range that a
    bearing was taken at: sigma of the one times that of the other, over the range, of predictions z_hat (n, 2) with covariance C.
    """
    most, across, along = 0.0, np.inf, np.inf
    for i in range(R.shape[0]):
        along, across = min(along, math.sqrt(R[i, 0, 0])), min(across, math.sqrt(R[i, 1, 1]))
        if not polar:
            most = max(most, bend(z[i, 0], z[i, 1], R[i], turn))
    if polar:
        for j in range(z_hat.shape[0]):
            v, r = C[2 * j + 1, 2 * j + 1], z_hat[j, 0]
            most = max(most, 0.5 * r * v / along, math.sqrt(C[2 * j, 2 * j] * v) / max(r, 1e-9) / across)
    return most


@jit
def rank(start: Array, columns: Array) -> tuple[Array, Array, Array]:
    """The order of the observations, fewest candidates first (ties by index), and their lists in that order."""
    m = start.shape[0] - 1
    order = np.argsort(start[1:] - start[:-1], kind="mergesort")
    ranked_start, ranked = np.zeros(m + 1, np.int64), np.empty_like(columns)
    for s in range(m):
        i = order[s]
        ranked_start[s + 1] = ranked_start[s] + start[i + 1] - start[i]
        ranked[ranked_start[s] : ranked_start[s + 1]] = columns[start[i] : start[i + 1]]
    return order, ranked_start, ranked


@jit
def most_possible(start: Array, columns: Array, base: Array, R: Array) -> Array:
    """Upper bound (m,) of what each observation can add to L: the best base gain at a perfect fit, S no less than R."""
    most = np.zeros(start.shape[0] - 1)
    for i in range(most.shape[0]):
        det = R[i, 0, 0] * R[i, 1, 1] - R[i, 0, 1] * R[i, 1, 0]
        for c in range(start[i], start[i + 1]):
            most[i] = max(most[i], base[i, columns[c]] - 0.5 * math.log(det) - LOG_2PI)
    return most


@jit
def ruin(
    match: Array, value: float, nu: Array, C: Array, R: Array, base: Array, start: Array, columns: Array,
    gate2: float, lengths: Array, uniform: Array, patience: int,
) -> tuple[Array, float, int]:  # fmt: skip
    """Levy flights inside a basin: take out r related or badly fitting pairs, forbid one of them, complete again.

    r is the flight's length (heavy tail); boots: after `patience` flights in vain, r grows by one (stagnation; 0: never). A better
    hypothesis becomes the place to start from. Returns it, its L, and the flights made.
    """
    best, best_value, vain, boots = match.copy(), value, 0, 0
    for flight in range(lengths.shape[0]):
        rows = np.flatnonzero(best >= 0)
        if rows.shape[0] == 0:
            return best, best_value, flight
        r = min(lengths[flight] + boots, rows.shape[0])
        trial = best.copy()
        seed = rows[int(uniform[flight, 0] * rows.shape[0])]
        gap = np.empty(rows.shape[0])
        for a in range(rows.shape[0]):  # related: predicted close to the one drawn
            d0 = C[2 * best[rows[a]], 2 * best[rows[a]]]
            gap[a] = np.sum((nu[seed, best[seed]] - nu[seed, best[rows[a]]]) ** 2) / (d0 + 1e-12)
        near = np.argsort(gap)
        for a in range(r):
            trial[rows[near[a]]] = -1
        forced = _alternative(seed, best, trial, start, columns, uniform[flight, 1])
        if forced >= 0:
            trial[seed] = forced
        found, found_value = complete(trial, nu, C, R, base, start, columns, gate2)
        if found_value > best_value + 1e-9:
            best, best_value, vain, boots = found, found_value, 0, 0
        else:
            vain += 1
            if 0 < patience <= vain:
                boots, vain = boots + 1, 0
    return best, best_value, lengths.shape[0]


@jit
def _alternative(i: int, best: Array, trial: Array, start: Array, columns: Array, u: float) -> int:
    """Another candidate from the window of observation i, not taken in `trial`; -1 when there is none."""
    count = start[i + 1] - start[i]
    for k in range(count):
        j = int(columns[start[i] + (int(u * count) + k) % count])
        if j != best[i] and not np.any(trial == j):
            return j
    return -1
