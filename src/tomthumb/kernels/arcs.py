"""Pairings by themselves: which some motion of the robot brings within the gate, however far it turns.

Everything is Cartesian in the sensor's frame. A motion xi = (tx, ty, theta) carries predicted points p to q = R(theta) p + t.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def by_itself(
    q: Array, R: Array, points: Array, D: Array, Xi: Array, gate2: float, allowed: Array
) -> tuple[Array, Array]:  # fmt: skip
    """Landmarks whose squared distance by itself is below gate2, nearest first: those of i are columns[start[i]:start[i + 1]].

    The least of xi' Xi^-1 xi + r' V^-1 r over the motion xi, or, as that is all a gate asks, that of the first motion tried
    below the gate. Chi-square of two degrees of freedom, however far the turn: no arc is linearised. Given the turn t the best
    shift is known, and leaves t^2 / v + e' A e, e(t) = q - Rot(t) p - k t, A = (V + S)^-1; S is the shift's covariance given
    the turn, k what a turn shifts on average. allowed (m, n): pairings that labels do not exclude; of size 0 when there are
    no labels. A row at a time: distances of all pairings would be written and read again only to be sifted.
    """
    m, n, v = q.shape[0], points.shape[0], Xi[2, 2]
    kx, ky = Xi[0, 2] / v, Xi[1, 2] / v
    S = Xi[0, 0] - kx * Xi[0, 2], Xi[0, 1] - kx * Xi[1, 2], Xi[1, 1] - ky * Xi[1, 2]
    more = 1.0 + math.sqrt((kx * kx + ky * ky) * v / _greatest(S))
    lengths, bearings = _polar(points)
    far, ahead = _polar(q)
    start, columns, count = np.zeros(m + 1, np.int64), np.empty(8 * m, np.int64), 0
    mine, d2 = np.empty(n, np.int64), np.empty(n)
    for i in range(m):
        few = 0
        for j in range(n):
            if allowed.size and not allowed[i, j]:
                continue
            V = R[i, 0, 0] + D[j, 0, 0] + S[0], R[i, 0, 1] + D[j, 0, 1] + S[1], R[i, 1, 1] + D[j, 1, 1] + S[2]
            turn = ahead[i] - bearings[j]
            turn -= 2.0 * math.pi if turn > math.pi else (-2.0 * math.pi if turn < -math.pi else 0.0)
            if not _beyond(far[i], lengths[j], turn, V, more, v, gate2):
                back = 1.0 / (V[0] * V[2] - V[1] * V[1])
                A = V[2] * back, -V[1] * back, V[0] * back
                ex, ey = q[i, 0] - points[j, 0], q[i, 1] - points[j, 1]
                mine[few], d2[few] = j, A[0] * ex * ex + 2.0 * A[1] * ex * ey + A[2] * ey * ey
                if not d2[few] < gate2:
                    d2[few] = _tried(turn, q[i, 0], q[i, 1], points[j, 0], points[j, 1], kx, ky, v, A, gate2)
                few += d2[few] < gate2
        while count + few > columns.shape[0]:
            columns = np.concatenate((columns, np.empty_like(columns)))
        columns[count : count + few] = mine[:few][np.argsort(d2[:few], kind="mergesort")] if few > 1 else mine[:few]
        count += few
        start[i + 1] = count
    return start, columns[:count].copy()


@jit
def _polar(points: Array) -> tuple[Array, Array]:
    """Distances and bearings (n,) of points (n, 2)."""
    lengths, bearings = np.empty(points.shape[0]), np.empty(points.shape[0])
    for j in range(points.shape[0]):
        lengths[j] = math.hypot(points[j, 0], points[j, 1])
        bearings[j] = math.atan2(points[j, 1], points[j, 0])
    return lengths, bearings


@jit
def _greatest(V: tuple[float, float, float]) -> float:
    """The greatest eigenvalue of a symmetric matrix, told by its lower half."""
    return 0.5 * (V[0] + V[2] + math.sqrt((V[0] - V[2]) ** 2 + 4.0 * V[1] * V[1]))


@jit
def _beyond(
    one: float, two: float, turn: float, V: tuple[float, float, float], more: float, v: float, gate2: float
) -> bool:  # fmt: skip
    """Whether no motion brings two points, so far from the robot and their bearings a `turn` apart, within the gate.

    After a turn t they are a chord apart, (one - two)^2 + 4 one two sin^2((turn - t) / 2), and its sine is no less than its
    angle times 1 - turn^2 / 24. Over the greatest variance of V, and with t^2 / v, the least of that over t is known. What
    turns within the gate shift, d at most, makes variance and gate larger, both `more` = 1 + w times: (s + d)^2 is no more than
    (1 + w) s^2 + (1 + 1 / w) d^2, whatever w; and d^2 is no more than w^2 gates of that variance where w^2 is |k|^2 v over it,
    or larger.
    """
    wide, bow = _greatest(V) * more, 1.0 - turn * turn / 24.0
    left = gate2 * more * (1.0 + 1e-9) - (one - two) ** 2 / wide
    return bool(left < 0.0 or turn * turn > left * (v + wide / (one * two * bow * bow)))


@jit
def _tried(
    turn: float, qx: float, qy: float, x: float, y: float, kx: float, ky: float, v: float, A: tuple[float, float, float],
    gate2: float,
) -> float:  # fmt: skip
    """The squared distance at the first turn within the gate of four by Gauss-Newton, or at the last.

    They begin at `turn`, that between the two bearings, or at the farthest that the gate allows.
    """
    far, cost = math.sqrt(gate2 * v), np.inf
    turn = min(max(turn, -far), far)
    for _ in range(4):
        cost, step = _turned(turn, qx, qy, x, y, kx, ky, v, A)
        if cost < gate2:
            break
        turn += step
    return cost


@jit
def _turned(
    t: float, qx: float, qy: float, x: float, y: float, kx: float, ky: float, v: float, A: tuple[float, float, float]
) -> tuple[float, float]:  # fmt: skip
    """t^2 / v + e' A e, and Gauss-Newton's next step of t."""
    c, s = math.cos(t), math.sin(t)
    px, py = c * x - s * y, s * x + c * y
    ex, ey = qx - px - kx * t, qy - py - ky * t
    fx, fy = A[0] * ex + A[1] * ey, A[1] * ex + A[2] * ey
    gx, gy = kx - py, ky + px  # minus the derivative of e
    slope = fx * gx + fy * gy - t / v
    curve = A[0] * gx * gx + 2.0 * A[1] * gx * gy + A[2] * gy * gy + 1.0 / v
    return t * t / v + fx * ex + fy * ey, slope / curve
