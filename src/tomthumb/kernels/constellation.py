"""Where a small map fits into a large one: motions from pairs of equal distance, and the vote of all its points.

A motion (x, y, theta) carries local points q to the map, p = R(theta) q + t. Points of the map come with their grid
(`kernels.grid`): cell, low, shape, start, index.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def nearest(
    x: float, y: float, reach: float, points: Array, cell: float, low: Array, shape: Array, start: Array, index: Array
) -> tuple[int, float]:
    """The nearest point within `reach` <= cell of (x, y) and its squared distance; -1 if there is none."""
    cx, cy = math.floor((x - low[0]) / cell), math.floor((y - low[1]) / cell)
    best, found = reach * reach, -1
    for a in range(max(cx - 1, 0), min(cx + 2, shape[0])):
        first, last = max(cy - 1, 0), min(cy + 2, shape[1])
        if last <= first:
            continue
        for c in range(start[a * shape[1] + first], start[a * shape[1] + last]):
            j = index[c]
            d2 = (x - points[j, 0]) ** 2 + (y - points[j, 1]) ** 2
            if d2 < best:
                best, found = d2, j
    return found, best


@jit
def _beyond(within: Array, x: float, y: float, theta: float, co: float, si: float) -> bool:
    """Whether a motion (x, y, theta), with its cosine and sine, lies outside `within` as `search` has it."""
    if abs((theta - within[2] + math.pi) % (2.0 * math.pi) - math.pi) > within[4]:
        return True
    u = co * within[5] - si * within[6] + x - within[0]
    v = si * within[5] + co * within[6] + y - within[1]
    return bool(u * u + v * v > within[3] * within[3])


@jit
def search(
    q: Array, spread: Array, gain: Array, anchors: Array, tolerance: Array, points: Array, cell: float, low: Array,
    shape: Array, start: Array, index: Array, apart: Array, within: Array, basins: int, budget: int,
) -> tuple[Array, Array, int]:  # fmt: skip
    """The best distinct motions, best first: (basins, 3), their votes (basins,) in nats (-inf: none), motions tried.

    q (k, 2) local points about their centre; spread (k,) m, standard deviation of a vote; gain (k,) what a perfect one
    adds; anchors (a, 2) pairs of local points with tolerance (a,) m on their distance; apart (2,) m, rad: basins nearer
    than this are one; within (7,): only motions that turn by theta and carry the local point u, v to (x, y), as near as
    m, rad: (x, y, theta, m, rad, u, v).
    """
    k, n = q.shape[0], points.shape[0]
    motions, votes = np.zeros((basins, 3)), np.full(basins, -np.inf)
    rest = np.zeros(k + 1)
    for i in range(k - 1, -1, -1):
        rest[i] = rest[i + 1] + max(gain[i], 0.0)
    tried = 0
    for r in range(anchors.shape[0]):
        a, b = anchors[r, 0], anchors[r, 1]
        qx, qy = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1]
        length = math.sqrt(qx * qx + qy * qy)
        near, far = max(length - tolerance[r], 1e-9), length + tolerance[r]
        rings = int(far / cell) + 1
        for ja in range(n):
            px, py = points[ja, 0], points[ja, 1]
            cx, cy = int((px - low[0]) / cell), int((py - low[1]) / cell)
            first, last = max(cy - rings, 0), min(cy + rings + 1, shape[1])
            for u in range(max(cx - rings, 0), min(cx + rings + 1, shape[0])):
                for c in range(start[u * shape[1] + first], start[u * shape[1] + last]):
                    jb = index[c]
                    vx, vy = points[jb, 0] - px, points[jb, 1] - py
                    square = vx * vx + vy * vy
                    if square < near * near or square > far * far:
                        continue
                    tried += 1
                    theta = math.atan2(qx * vy - qy * vx, qx * vx + qy * vy)
                    co, si = math.cos(theta), math.sin(theta)
                    mx, my = 0.5 * (q[a, 0] + q[b, 0]), 0.5 * (q[a, 1] + q[b, 1])
                    tx = px + 0.5 * vx - co * mx + si * my
                    ty = py + 0.5 * vy - si * mx - co * my
                    if _beyond(within, tx, ty, theta, co, si):
                        continue
                    vote, floor = 0.0, votes[basins - 1]
                    for i in range(k):
                        if vote + rest[i] <= floor:
                            vote = -np.inf
                            break
                        x = co * q[i, 0] - si * q[i, 1] + tx
                        y = si * q[i, 0] + co * q[i, 1] + ty
                        j, d2 = nearest(x, y, cell, points, cell, low, shape, start, index)
                        if j >= 0:
                            vote += max(gain[i] - 0.5 * d2 / (spread[i] * spread[i]), 0.0)
                    if vote > floor:
                        _keep(motions, votes, tx, ty, theta, vote, apart)
                    if tried >= budget:
                        return motions, votes, tried
    return motions, votes, tried


@jit
def _keep(motions: Array, votes: Array, x: float, y: float, t: float, vote: float, apart: Array) -> None:
    """Put a motion into the list, best first; of one basin the best is kept."""
    size = votes.shape[0]
    k = size - 1
    for r in range(size):
        if votes[r] == -np.inf:
            k = r
            break
        turn = abs((t - motions[r, 2] + math.pi) % (2.0 * math.pi) - math.pi)
        if math.hypot(x - motions[r, 0], y - motions[r, 1]) < apart[0] and turn < apart[1]:
            k = r
            break
    if votes[k] >= vote:
        return
    while k > 0 and votes[k - 1] < vote:
        motions[k], votes[k] = motions[k - 1], votes[k - 1]
        k -= 1
    motions[k, 0], motions[k, 1], motions[k, 2], votes[k] = x, y, t, vote


@jit
def pair_up(
    motion: Array, q: Array, reach: Array, points: Array, cell: float, low: Array, shape: Array, start: Array,
    index: Array,
) -> Array:  # fmt: skip
    """Match (k,): the map point nearest to each local one within its reach, and nearest to none better; else -1."""
    k, n = q.shape[0], points.shape[0]
    match, owner = np.full(k, -1, np.int64), np.full(n, -1, np.int64)
    distance = np.full(n, np.inf)
    co, si = math.cos(motion[2]), math.sin(motion[2])
    for i in range(k):
        x, y = co * q[i, 0] - si * q[i, 1] + motion[0], si * q[i, 0] + co * q[i, 1] + motion[1]
        j, d2 = nearest(x, y, min(reach[i], cell), points, cell, low, shape, start, index)
        if j >= 0 and d2 < distance[j]:
            distance[j], owner[j] = d2, i
    for j in range(n):
        if owner[j] >= 0:
            match[owner[j]] = j
    return match
