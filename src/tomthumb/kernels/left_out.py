"""What each pairing adds to the joint posterior, given all the others; and the scan in which that settles everything."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LOG_2PI = math.log(2.0 * math.pi)


@jit
def left_out_gains(match: Array, nu: Array, C: Array, R: Array, base: Array, start: Array, columns: Array) -> Array:
    """Gain in L of each candidate (as listed in `columns`) of each observation, given all the *other* pairings of match.

    From one inverse Q = S^-1 and e = Q nu: leaving out block b, Q' = Q - Q[:, b] Q_bb^-1 Q[b, :].
    """
    rows = np.flatnonzero(match >= 0)
    k = rows.shape[0]
    S, v = np.empty((2 * k, 2 * k)), np.empty(2 * k)
    for a in range(k):
        ja = match[rows[a]]
        v[2 * a], v[2 * a + 1] = nu[rows[a], ja, 0], nu[rows[a], ja, 1]
        for b in range(k):
            jb = match[rows[b]]
            for s in range(2):
                for t in range(2):
                    S[2 * a + s, 2 * b + t] = C[2 * ja + s, 2 * jb + t]
        for s in range(2):
            for t in range(2):
                S[2 * a + s, 2 * a + t] += R[rows[a], s, t]
    Q = np.linalg.inv(S) if k > 0 else S
    gains, e, W, B = np.empty(columns.shape[0]), _product(Q, v), np.empty((2, 2 * k)), np.zeros((2, 2))
    at = 0
    for i in range(match.shape[0]):
        out = -1
        if match[i] >= 0:
            out, at = at, at + 2
            det = Q[out, out] * Q[out + 1, out + 1] - Q[out, out + 1] * Q[out + 1, out]
            B[0, 0], B[1, 1] = Q[out + 1, out + 1] / det, Q[out, out] / det
            B[0, 1], B[1, 0] = -Q[out, out + 1] / det, -Q[out + 1, out] / det
        for c in range(start[i], start[i + 1]):
            j = columns[c]
            if j == match[i]:  # what the others leave of this very pairing: mean B e_b, covariance B
                u0, u1 = B[0, 0] * e[out] + B[0, 1] * e[out + 1], B[1, 0] * e[out] + B[1, 1] * e[out + 1]
                gains[c] = base[i, j] - _surprise(u0, u1, B[0, 0], B[0, 1], B[1, 1])
            else:
                gains[c] = base[i, j] - _given_rest(i, j, out, match, rows, nu, C, R, Q, e, v, B, W)
    return gains


@jit
def _given_rest(
    i: int, j: int, out: int, match: Array, rows: Array, nu: Array, C: Array, R: Array, Q: Array, e: Array, v: Array,
    B: Array, W: Array,
) -> float:  # fmt: skip
    """Minus log density of observation i at landmark j, given the pairings of `rows` but for the block at `out`."""
    size = v.shape[0]
    for s in range(2):
        W[s] = 0.0
        for b in range(rows.shape[0]):
            for t in range(2):
                own = C[2 * j + s, 2 * match[rows[b]] + t]
                for q in range(size):
                    W[s, q] += own * Q[2 * b + t, q]
    u0, u1 = nu[i, j, 0], nu[i, j, 1]
    a, d = C[2 * j, 2 * j] + R[i, 0, 0], C[2 * j + 1, 2 * j + 1] + R[i, 1, 1]
    b01 = C[2 * j, 2 * j + 1] + R[i, 0, 1]
    for q in range(size):
        jb = 2 * match[rows[q // 2]] + q % 2
        u0 -= W[0, q] * v[q]
        u1 -= W[1, q] * v[q]
        a -= W[0, q] * C[2 * j, jb]
        b01 -= W[0, q] * C[2 * j + 1, jb]
        d -= W[1, q] * C[2 * j + 1, jb]
    if out >= 0:
        for s in range(2):
            for t in range(2):
                w0, w1 = W[0, out + s] * B[s, t], W[1, out + s] * B[s, t]
                u0 += w0 * e[out + t]
                u1 += w1 * e[out + t]
                a += w0 * W[0, out + t]
                b01 += w0 * W[1, out + t]
                d += w1 * W[1, out + t]
    return _surprise(u0, u1, a, b01, d)


@jit
def _surprise(u: float, v: float, a: float, b: float, d: float) -> float:
    """Minus log density of (u, v) under [[a, b], [b, d]]; infinite when that is no covariance."""
    det = a * d - b * b
    if not (det > 0.0 and a > 0.0):
        return np.inf
    return float(0.5 * ((d * u * u - 2.0 * b * u * v + a * v * v) / det + math.log(det)) + LOG_2PI)


@jit
def _product(Q: Array, v: Array) -> Array:
    out = np.zeros(v.shape[0])
    for r in range(v.shape[0]):
        for c in range(v.shape[0]):
            out[r] += Q[r, c] * v[c]
    return out


@jit
def unambiguous(
    nu: Array, C: Array, R: Array, own: Array, odds: Array, start: Array, columns: Array, doubt: float
) -> tuple[bool, Array, Array, float]:
    """The quick path: whether nobody has two candidates or another's, and every pairing gains `doubt` nats given the rest.

    Then match (m,), the probability of each decision (m,) and L; base gains are own (m,) + odds (n,).
    """
    m = start.shape[0] - 1
    match, used, k = np.full(m, -1, np.int64), np.zeros(odds.shape[0], np.bool_), 0
    for i in range(m):
        if start[i + 1] > start[i]:
            j = columns[start[i]]
            if start[i + 1] > start[i] + 1 or used[j]:
                return False, match, odds, 0.0
            match[i], used[j], k = j, True, k + 1
    rows = np.flatnonzero(match >= 0)
    L, y = np.empty((2 * k, 2 * k)), np.empty(2 * k)
    if not _factor(L, y, rows, match, nu, C, R):
        return False, match, odds, 0.0
    T, e = _inverted(L), np.zeros(2 * k)
    chance, total = np.ones(m), 0.0
    for c in range(2 * k):
        total -= 0.5 * y[c] * y[c] + math.log(L[c, c])
        for r in range(c, 2 * k):
            e[c] += T[c, r] * y[r]
    for b in range(k):
        i, j, c = rows[b], match[rows[b]], 2 * b
        q00, q01, q11 = 0.0, 0.0, 0.0  # the block of S^-1, whose inverse is the covariance given the others
        for r in range(c, 2 * k):
            q00 += T[c, r] * T[c, r]
            q01 += T[c, r] * T[c + 1, r]
            q11 += T[c + 1, r] * T[c + 1, r]
        det = q00 * q11 - q01 * q01
        d2 = (q11 * e[c] * e[c] - 2.0 * q01 * e[c] * e[c + 1] + q00 * e[c + 1] * e[c + 1]) / det
        gain = own[i] + odds[j] - 0.5 * (d2 - math.log(det)) - LOG_2PI
        if not gain >= doubt:
            return False, match, odds, 0.0
        chance[i] = 1.0 / (1.0 + math.exp(-gain))
        total += own[i] + odds[j] - LOG_2PI
    return True, match, chance, total


@jit
def _factor(L: Array, y: Array, rows: Array, match: Array, nu: Array, C: Array, R: Array) -> bool:
    """Cholesky factor L of the joint S and y = L^-1 nu, in place; False where S is no covariance."""
    for r in range(L.shape[0]):
        i, u = rows[r // 2], r % 2
        y[r] = nu[i, match[i], u]
        for c in range(r + 1):
            j, v = match[rows[c // 2]], c % 2
            value = C[2 * match[i] + u, 2 * j + v] + (R[i, u, v] if rows[c // 2] == i else 0.0)
            for q in range(c):
                value -= L[r, q] * L[c, q]
            if c < r:
                L[r, c], L[c, r] = value / L[c, c], 0.0
                y[r] -= L[r, c] * y[c]
            elif value > 0.0:
                L[r, r] = math.sqrt(value)
            else:
                return False
        y[r] /= L[r, r]
    return True


@jit
def _inverted(L: Array) -> Array:
    """The inverse of a lower triangular matrix, transposed: row c holds its column c."""
    T = np.zeros_like(L)
    for c in range(L.shape[0]):
        T[c, c] = 1.0 / L[c, c]
        for r in range(c + 1, L.shape[0]):
            value = 0.0
            for q in range(c, r):
                value -= L[r, q] * T[c, q]
            T[c, r] = value / L[r, r]
    return T
