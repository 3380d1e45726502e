"""Probabilities of one-to-one pairings: by belief propagation, and with the pose integrated out over drawn poses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LOG_2PI = math.log(2.0 * math.pi)
HOPELESS = -40.0  # nats at a basin's pose: a draw from its widened Gaussian is too near to make it count


@jit
def marginals(gains: Array, start: Array, columns: Array, n: int, rounds: int) -> tuple[Array, Array, float]:
    """Probability of each listed pairing, of each observation being unpaired (m,), and the log of their normaliser.

    One-to-one, by belief propagation; the normaliser (the sum over all assignments of exp L) is Bethe's.
    `gains` are log ratios against "unpaired". References: J. Williams, R. Lau, IEEE T-AES 50(4), 2014, eq. 28 to 30;
    P. Vontobel, IEEE T-IT 59(3), 2013 (the Bethe permanent).
    """
    m, size = start.shape[0] - 1, columns.shape[0]
    psi, to_i, to_j = np.empty(size), np.ones(size), np.zeros(size)
    for c in range(size):
        psi[c] = math.exp(min(max(gains[c], -60.0), 60.0))
    sums = np.zeros(n)
    for _ in range(rounds):
        for c in range(size):
            sums[columns[c]] = 0.0
        for i in range(m):
            total = 1.0
            for c in range(start[i], start[i + 1]):
                total += psi[c] * to_i[c]
            for c in range(start[i], start[i + 1]):
                to_j[c] = psi[c] / max(total - psi[c] * to_i[c], 1e-300)
                sums[columns[c]] += to_j[c]
        change = 0.0
        for c in range(size):
            new = 1.0 / (1.0 + max(sums[columns[c]] - to_j[c], 0.0))
            change = max(change, abs(new - to_i[c]))
            to_i[c] = new
        if change < 1e-4:
            break
    p, none, log_z = np.empty(size), np.empty(m), 0.0
    for i in range(m):
        total = 1.0
        for c in range(start[i], start[i + 1]):
            total += psi[c] * to_i[c]
        none[i] = 1.0 / total
        log_z += math.log(total)
        for c in range(start[i], start[i + 1]):
            p[c] = psi[c] * to_i[c] / total
            log_z -= math.log(1.0 + to_j[c] * to_i[c])
    for c in range(size):
        if sums[columns[c]] >= 0.0:  # each landmark once
            log_z += math.log(1.0 + sums[columns[c]])
            sums[columns[c]] = -1.0
    return p, none, log_z


@jit
def add_marginals(
    p: Array, none: Array, weight: float, gains: Array, start: Array, columns: Array, rounds: int
) -> None:  # fmt: skip
    """Add `weight` times the marginals to p (m, n) and none (m,), in place."""
    chance, alone, _log_z = marginals(gains, start, columns, p.shape[1], rounds)
    _blend(p, none, weight, chance, alone, start, columns)


@jit
def spread_out(gains: Array, start: Array, columns: Array, n: int, rounds: int) -> tuple[Array, Array]:
    """The marginals of one hypothesis as p (m, n) and none (m,)."""
    p = np.zeros((start.shape[0] - 1, n))
    chance, none, _log_z = marginals(gains, start, columns, n, rounds)
    for i in range(none.shape[0]):
        for k in range(start[i], start[i + 1]):
            p[i, columns[k]] = chance[k]
    return p, none


@jit
def integrated(
    steps: Array, centres: Array, Ms: Array, wider: float, starts: Array, offsets: Array, columns: Array, gains: Array,
    looks: Array, q: Array, R: Array, points: Array, D: Array, base: Array, odds: Array, prior: Array, gate2: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Marginals p (m, n) and none (m,) with the pose integrated out by importance sampling.

    Poses are drawn from an equal mixture of g Gaussians at centres (g, 3), covariance wider^2 Ms^-1, by the standard
    normal steps (g, S, 3). Given the pose the pairings are independent but for being one-to-one; each pose weighs its
    prior times the sum over all assignments (Bethe) over the mixture's density. Basin b lists its candidates in
    columns[offsets[b]:offsets[b + 1]] by starts[b] (m + 1), with their `gains` at its pose, no gate applied (the
    hopeless are left out), and what `looks` adds to gains.
    """
    g, S, m, n = steps.shape[0], steps.shape[1], q.shape[0], points.shape[0]
    logs, alone, done = np.empty(g * S), np.empty((g * S, m)), 0
    chances, p, none = np.empty(S * columns.shape[0]), np.zeros((m, n)), np.zeros(m)
    factors = np.empty((g, 3, 3))
    for b in range(g):
        factors[b] = wider * np.linalg.cholesky(np.linalg.inv(Ms[b]))
        starts[b] = _shortened(starts[b], offsets[b], columns, looks, gains)
    for b in range(g):
        mine = columns[offsets[b] : offsets[b] + starts[b, m]]
        W, worth = _forms(starts[b], mine, R, D, base, odds)
        worth += looks[offsets[b] : offsets[b] + mine.shape[0]]
        for s in range(S):
            pose = centres[b] + _turned(factors[b], steps[b, s])
            here = _at_pose(pose, W, worth, q, points, starts[b], mine, gate2)
            chance, alone[b * S + s], log_z = marginals(here, starts[b], mine, n, 10)
            chances[done : done + mine.shape[0]] = chance
            done += mine.shape[0]
            back = _turned(prior, pose)
            before = -0.5 * (back[0] * pose[0] + back[1] * pose[1] + back[2] * pose[2])
            logs[b * S + s] = before + log_z - _mixture(pose, centres, factors)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    done = 0
    for b in range(g):
        mine = columns[offsets[b] : offsets[b] + starts[b, m]]
        for s in range(S):
            _blend(p, none, weights[b * S + s], chances[done:], alone[b * S + s], starts[b], mine)
            done += mine.shape[0]
    return p, none


@jit
def _shortened(start: Array, at: int, columns: Array, looks: Array, gains: Array) -> Array:
    """New starts of a basin's lists without pairings HOPELESS nats below "unpaired"; columns and looks close up, in place."""
    shorter, count = np.zeros_like(start), 0
    for i in range(start.shape[0] - 1):
        for k in range(start[i], start[i + 1]):
            if gains[at + k] > HOPELESS:
                columns[at + count], looks[at + count] = columns[at + k], looks[at + k]
                count += 1
        shorter[i + 1] = count
    return shorter


@jit
def _blend(p: Array, none: Array, weight: float, chance: Array, alone: Array, start: Array, columns: Array) -> None:
    """Add `weight` times the marginals of listed pairings to p (m, n) and none (m,), in place."""
    for i in range(none.shape[0]):
        none[i] += weight * alone[i]
        for k in range(start[i], start[i + 1]):
            p[i, columns[k]] += weight * chance[k]


@jit
def _forms(start: Array, columns: Array, R: Array, D: Array, base: Array, odds: Array) -> tuple[Array, Array]:
    """What of a pairing does not depend on the pose: its inverse covariance (k, 3) and its gain at a perfect fit (k,)."""
    W, worth = np.empty((columns.shape[0], 3)), np.empty(columns.shape[0])
    for i in range(start.shape[0] - 1):
        for k in range(start[i], start[i + 1]):
            j = columns[k]
            a, b, d = R[i, 0, 0] + D[j, 0, 0], R[i, 0, 1] + D[j, 0, 1], R[i, 1, 1] + D[j, 1, 1]
            det = a * d - b * b
            W[k, 0], W[k, 1], W[k, 2] = d / det, -b / det, a / det
            worth[k] = base[i] + odds[j] - 0.5 * math.log(det) - LOG_2PI
    return W, worth


@jit
def _at_pose(
    pose: Array, W: Array, worth: Array, q: Array, points: Array, start: Array, columns: Array, gate2: float
) -> Array:  # fmt: skip
    gains, c, s = np.empty(columns.shape[0]), math.cos(pose[2]), math.sin(pose[2])
    for i in range(q.shape[0]):
        for k in range(start[i], start[i + 1]):
            j = columns[k]
            u = q[i, 0] - c * points[j, 0] + s * points[j, 1] - pose[0]
            v = q[i, 1] - s * points[j, 0] - c * points[j, 1] - pose[1]
            d2 = W[k, 0] * u * u + 2.0 * W[k, 1] * u * v + W[k, 2] * v * v
            gains[k] = worth[k] - 0.5 * d2 if d2 < gate2 else -np.inf
    return gains


@jit
def _turned(M: Array, v: Array) -> Array:
    out = np.empty(3)
    for r in range(3):
        out[r] = M[r, 0] * v[0] + M[r, 1] * v[1] + M[r, 2] * v[2]
    return out


@jit
def _mixture(pose: Array, centres: Array, factors: Array) -> float:
    """Log density of an equal mixture of Gaussians given by centres and Cholesky factors, but for a constant."""
    g, y, logs = centres.shape[0], np.empty(3), np.empty(centres.shape[0])
    for b in range(g):
        logs[b] = 0.0
        for r in range(3):
            rest = pose[r] - centres[b, r]
            for c in range(r):
                rest -= factors[b, r, c] * y[c]
            y[r] = rest / factors[b, r, r]
            logs[b] -= 0.5 * y[r] * y[r] + math.log(factors[b, r, r])
    top = logs.max()
    return float(top + math.log(np.exp(logs - top).mean()))


@jit
def pick(p: Array, none: Array, least: float) -> tuple[Array, Array, bool]:
    """The most probable partner of each observation (-1: none), its probability, and whether nobody else wants it.

    Where that is so for all, it is the one-to-one assignment that maximises the expected number of right decisions.
    """
    m, n = p.shape
    match, chance, taken, free = np.full(m, -1, np.int64), none.copy(), np.zeros(n, np.bool_), True
    for i in range(m):
        most = none[i]
        for j in range(n):
            if p[i, j] > most and p[i, j] > max(least, 1e-3):
                match[i], most = j, p[i, j]
        if match[i] >= 0:
            chance[i] = most
            free &= not taken[match[i]]
            taken[match[i]] = True
    return match, chance, free
