"""Rows put into, taken out of and moved between covariances of which only the lower triangle is kept."""

from __future__ import annotations

from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def at(P: Array, i: int, j: int) -> Any:
    """Element (i, j) of the symmetric matrix whose lower triangle is stored."""
    return P[i, j] if i >= j else P[j, i]


@jit
def pose_block(P: Array) -> Array:
    """The pose's covariance (3, 3), whole."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = at(P, i, j)
    return out


@jit
def copy_lower(source: Array, target: Array, dim: int) -> None:
    """The lower triangle in use, and nothing else."""
    for j in range(dim):
        target[j:dim, j] = source[j:dim, j]


@jit
def append(P: Array, dim: int, G_pose: Array, noise: Array) -> None:
    """New landmarks behind row `dim`: covariance G P_r. with everything before, and G P_rr G' + noise of their own."""
    for i in range(G_pose.shape[0]):
        base = dim + 2 * i
        for u in range(2):
            for r in range(base):
                P[base + u, r] = (
                    G_pose[i, u, 0] * at(P, r, 0) + G_pose[i, u, 1] * at(P, r, 1) + G_pose[i, u, 2] * at(P, r, 2)
                )
        own = np.empty((2, 2))
        for u in range(2):
            for v in range(2):
                value = 0.5 * (noise[i, u, v] + noise[i, v, u])
                for k in range(3):
                    value += P[base + u, k] * G_pose[i, v, k]
                own[u, v] = value
        P[base, base], P[base + 1, base + 1] = own[0, 0], own[1, 1]
        P[base + 1, base] = 0.5 * (own[0, 1] + own[1, 0])


@jit
def remove(P: Array, x: Array, dim: int, slot: int) -> None:
    """Slot `slot` is given the last landmark's rows; the caller shortens `dim` by 2."""
    last, base = dim - 2, 3 + 2 * slot
    if last != base:
        for u in range(2):
            x[base + u] = x[last + u]
            for r in range(base):
                P[base + u, r] = P[last + u, r]
            for r in range(base + 2, last):
                P[r, base + u] = P[last + u, r]
        P[base, base], P[base + 1, base], P[base + 1, base + 1] = (
            P[last, last],
            P[last + 1, last],
            P[last + 1, last + 1],
        )
    P[last : last + 2, : last + 2] = 0.0


@jit
def healthy(P: Array, x: Array, dim: int) -> bool:
    """Every state finite and every variance positive or zero."""
    good = True
    for i in range(dim):
        good &= P[i, i] >= 0.0 and P[i, i] < 1e12 and abs(x[i]) < 1e12
    return good


@jit
def gather_columns(P: Array, dim: int, rows: Array) -> Array:
    """The columns `rows` (a,) of the symmetric matrix: (dim, a), column-major."""
    out = np.empty((rows.shape[0], dim)).T
    for k in range(rows.shape[0]):
        j = rows[k]
        for i in range(j):
            out[i, k] = P[j, i]
        for i in range(j, dim):
            out[i, k] = P[i, j]
    return out


@jit
def gather_block(P: Array, rows: Array, out: Array) -> None:
    """The block of `rows` (a,), ascending or not, into the lower triangle of `out`."""
    for k in range(rows.shape[0]):
        for l in range(k + 1):
            out[k, l] = at(P, rows[k], rows[l])


@jit
def scatter(P: Array, rows: Array, block: Array, others: Array, cross: Array) -> None:
    """Lower triangle of `block` to the rows and columns `rows` (a,) of P, and cross (dim, a) to the rows `others`."""
    for k in range(rows.shape[0]):
        i = rows[k]
        for l in range(k + 1):
            j = rows[l]
            if i >= j:
                P[i, j] = block[k, l]
            else:
                P[j, i] = block[k, l]
        for j in others:
            if i >= j:
                P[i, j] = cross[j, k]
            else:
                P[j, i] = cross[j, k]


@jit
def add_turned(G: Array, first: int) -> Array:
    """[G, J G] (dim, 2a), column-major: J turns every pair of rows from `first` on by 90 deg; the rows before are 0."""
    dim, a = G.shape
    out = np.zeros((2 * a, dim)).T
    for k in range(a):
        for r in range(first, dim, 2):
            out[r, k], out[r + 1, k] = G[r, k], G[r + 1, k]
            out[r, a + k], out[r + 1, a + k] = -G[r + 1, k], G[r, k]
    return out
