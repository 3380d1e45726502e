"""What each pairing adds to the joint posterior, given all the other pairings of a hypothesis."""

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
