"""What happens to all particles alike: motion, a shifted point of view, stones that were not seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def move(pose: Array, cov: Array, delta: Array, Q: Array) -> None:
    """Every pose composed with `delta`, its covariance carried along; Q (3, 3) in the robot's frame."""
    for p in range(pose.shape[0]):
        c, s = math.cos(pose[p, 2]), math.sin(pose[p, 2])
        dx, dy = c * delta[0] - s * delta[1], s * delta[0] + c * delta[1]
        P = cov[p]
        for k in range(3):  # F P, with F = I but for the heading's column
            P[0, k] -= dy * P[2, k]
            P[1, k] += dx * P[2, k]
        for k in range(3):
            P[k, 0] -= dy * P[k, 2]
            P[k, 1] += dx * P[k, 2]
        a, b, d = Q[0, 0], 0.5 * (Q[0, 1] + Q[1, 0]), Q[1, 1]
        P[0, 0] += c * c * a - 2.0 * c * s * b + s * s * d
        off = c * s * (a - d) + (c * c - s * s) * b
        P[0, 1] += off
        P[1, 0] += off
        P[1, 1] += s * s * a + 2.0 * c * s * b + c * c * d
        u, v = c * Q[0, 2] - s * Q[1, 2], s * Q[0, 2] + c * Q[1, 2]
        P[0, 2] += u
        P[2, 0] += u
        P[1, 2] += v
        P[2, 1] += v
        P[2, 2] += Q[2, 2]
        pose[p, 0] += dx
        pose[p, 1] += dy
        pose[p, 2] = (pose[p, 2] + delta[2] + math.pi) % (2.0 * math.pi) - math.pi


@jit
def after(shift: Array, points: Array, spread: Array) -> tuple[Array, Array]:
    """Points (M, m, 2) and covariances (M, m, 2, 2) seen from robots moved by `shift` (M, 3) in their own frames."""
    moved, turned = np.empty_like(points), np.empty_like(spread)
    for p in range(points.shape[0]):
        c, s = math.cos(shift[p, 2]), math.sin(shift[p, 2])
        for k in range(points.shape[1]):
            dx, dy = points[p, k, 0] - shift[p, 0], points[p, k, 1] - shift[p, 1]
            moved[p, k, 0], moved[p, k, 1] = c * dx + s * dy, -s * dx + c * dy
            a, b, d = spread[p, k, 0, 0], spread[p, k, 0, 1], spread[p, k, 1, 1]
            turned[p, k, 0, 0] = c * c * a + 2.0 * c * s * b + s * s * d
            turned[p, k, 0, 1] = turned[p, k, 1, 0] = c * s * (d - a) + (c * c - s * s) * b
            turned[p, k, 1, 1] = s * s * a - 2.0 * c * s * b + c * c * d
    return moved, turned


@jit
def by_motion(H: Array, moved: Array, turned: Array, shift: Array) -> tuple[Array, Array]:
    """Derivative (M, m, 2, 3) by the motion in the frame before the shift, and H P H' (M, m, 2, 2) of the landmark.

    db = -B de - J b da, B the turn into the frame after the shift.
    """
    M, m = moved.shape[0], moved.shape[1]
    Hx, noise = np.empty((M, m, 2, 3)), np.empty((M, m, 2, 2))
    for p in range(M):
        c, s = math.cos(shift[p, 2]), math.sin(shift[p, 2])
        for k in range(m):
            x, y = moved[p, k, 0], moved[p, k, 1]
            for u in range(2):
                g, h = H[p, k, u, 0], H[p, k, u, 1]
                Hx[p, k, u, 0], Hx[p, k, u, 1], Hx[p, k, u, 2] = s * h - c * g, -s * g - c * h, g * y - h * x
                for v in range(2):
                    noise[p, k, u, v] = g * (
                        turned[p, k, 0, 0] * H[p, k, v, 0] + turned[p, k, 0, 1] * H[p, k, v, 1]
                    ) + h * (turned[p, k, 1, 0] * H[p, k, v, 0] + turned[p, k, 1, 1] * H[p, k, v, 1])
    return Hx, noise


@jit
def missed(near: Array, chance: Array, there: Array, stone: Array, slots: Array, firm: Array, detect: float) -> Array:
    """Log-probability (M,) of which stones in view were paired (slots (M, m), where firm) and which were not."""
    total = np.zeros(chance.shape[0])
    for p in range(chance.shape[0]):
        for k in range(near.shape[0]):
            if not (there[p, k] and stone[near[k]]):
                continue
            seen = False
            for i in range(slots.shape[1]):
                seen |= firm[p, i] and slots[p, i] == near[k]
            likely = min(max(chance[p, k] * detect, 1e-6), 0.999)
            total[p] += math.log(likely) if seen else math.log1p(-likely)
    return total
