"""The change of coordinates that keeps the right-invariant error's covariance through an update (estimators.ekf)."""

from __future__ import annotations

from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def turned(change: Array, first: int) -> Array:
    """v (dim,): the position, and landmarks from row `first` on, turned by 90 deg; 0 for the heading and the rest."""
    v = np.zeros(change.shape[0])
    v[0], v[1] = -change[1], change[0]
    for r in range(first, change.shape[0], 2):
        v[r], v[r + 1] = -change[r + 1], change[r]
    return v


@jit
def heading_column(P: Array, W: Array) -> Array:
    """The heading's column of P - W W' (dim,)."""
    dim, k = W.shape
    h = np.empty(dim)
    for r in range(dim):
        h[r] = P[r, 2] if r >= 2 else P[2, r]
    for j in range(k):
        weight = W[2, j]
        for r in range(dim):
            h[r] -= weight * W[r, j]
    return h


@jit
def rebase_factors(W: Array, v: Array, h: Array, variance: float) -> tuple[Array, Array]:
    """A, B (dim, k + 2) with P - A B' = (I + v e') (P - W W') (I + v e')', e the heading's unit vector.

    (P - W W') + v a' + a v', where a = h + v / 2 times the heading's variance and h its column of P - W W'.
    """
    dim, k = W.shape
    A, B = np.empty((k + 2, dim)).T, np.empty((k + 2, dim)).T
    for j in range(k):
        A[:, j] = W[:, j]
        B[:, j] = W[:, j]
    for r in range(dim):
        a = h[r] + 0.5 * variance * v[r]
        A[r, k], B[r, k] = -v[r], a
        A[r, k + 1], B[r, k + 1] = -a, v[r]
    return A, B


@jit
def carry_factors(W: Array, v: Array, h: Array, Y: Array, w: Array, f: Array) -> tuple[Array, Array]:
    """A (dim, k + 2), B (width, k + 2) with T - A B' = (I + v e') (T - W Y' + h w'): rows of [W -h -v] and [Y w g].

    f (width,) is the heading's row of T - W Y'; g = f + h_e w what it is once the rest has turned.
    """
    dim, k = W.shape
    A, B = np.empty((k + 2, dim)).T, np.empty((k + 2, w.shape[0])).T
    for j in range(k):
        A[:, j] = W[:, j]
        B[:, j] = Y[:, j]
    A[:, k], A[:, k + 1] = -h, -v
    B[:, k], B[:, k + 1] = w, f + h[2] * w
    return A, B


@jit
def turn_jacobian(H_pose: Array, H_point: Array, moved_pose: Array, moved_points: Array) -> None:
    """The heading's column of a Jacobian at x0 + moved, in the coordinates of the invariant error at x0.

    H(x) T(x) T(x0)^-1 with T = I + J x e': J times how far position and landmark are from x0 is added through them.
    """
    for i in range(H_pose.shape[0]):
        for u in range(2):
            H_pose[i, u, 2] += H_pose[i, u, 1] * moved_pose[0] - H_pose[i, u, 0] * moved_pose[1]
            H_pose[i, u, 2] += H_point[i, u, 1] * moved_points[i, 0] - H_point[i, u, 0] * moved_points[i, 1]
