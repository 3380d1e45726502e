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

FINE = 6.0  # squares of the field to a cell: about half a standard deviation of a vote
MOST = 1 << 21  # squares, about: 16 MB


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
def _field(points: Array, cell: float, low: Array, shape: Array) -> tuple[Array, float]:
    """About the nearest point within `cell` of everywhere, -1 where there is none, in squares of the side returned.

    One look instead of nine cells searched. The grid (low, shape) with a margin of one cell on all sides is covered.
    """
    side = max(cell / FINE, cell * math.sqrt((shape[0] + 2.0) * (shape[1] + 2.0) / MOST))
    rows, columns = int((shape[0] + 2) * cell / side) + 1, int((shape[1] + 2) * cell / side) + 1
    owner, distance = np.full((rows, columns), -1, np.int32), np.full((rows, columns), np.inf, np.float32)
    span = int(cell / side) + 1
    for j in range(points.shape[0]):
        x, y = (points[j, 0] - low[0] + cell) / side, (points[j, 1] - low[1] + cell) / side
        for a in range(max(int(x) - span, 0), min(int(x) + span + 1, rows)):
            for b in range(max(int(y) - span, 0), min(int(y) + span + 1, columns)):
                d2 = (a + 0.5 - x) ** 2 + (b + 0.5 - y) ** 2
                if d2 < distance[a, b]:
                    distance[a, b], owner[a, b] = d2, j
    return owner, side


@jit
def _beyond(within: Array, x: float, y: float, co: float, si: float) -> bool:
    """Whether a motion to (x, y), with the cosine and sine of its turn, lies outside `within` as `search` has it."""
    u = co * within[5] - si * within[6] + x - within[0]
    v = si * within[5] + co * within[6] + y - within[1]
    if u * u + v * v > within[3] * within[3]:
        return True
    straight = co * math.cos(within[2]) + si * math.sin(within[2])
    return bool(within[4] < math.pi and straight < math.cos(within[4]))


@jit
def _vote(
    q: Array, spread: Array, gain: Array, rest: Array, points: Array, owner: Array, side: float, west: float,
    south: float, x: float, y: float, co: float, si: float, floor: float,
) -> float:  # fmt: skip
    """What all local points say of a motion; -inf as soon as those that are left cannot lift it above `floor`."""
    vote = 0.0
    for i in range(q.shape[0]):
        if vote + rest[i] <= floor:
            return -np.inf
        u, v = co * q[i, 0] - si * q[i, 1] + x, si * q[i, 0] + co * q[i, 1] + y
        a, b = (u - west) / side, (v - south) / side
        if a < 0.0 or b < 0.0 or a >= owner.shape[0] or b >= owner.shape[1]:
            continue
        j = owner[int(a), int(b)]
        if j >= 0:
            d2 = (u - points[j, 0]) ** 2 + (v - points[j, 1]) ** 2
            vote += max(gain[i] - 0.5 * d2 / (spread[i] * spread[i]), 0.0)
    return vote


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
    owner, side = _field(points, cell, low, shape)
    tried = 0
    for r in range(anchors.shape[0]):
        a, b = anchors[r, 0], anchors[r, 1]
        qx, qy = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1]
        length = math.sqrt(qx * qx + qy * qy)
        if length == 0.0:
            continue
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
                    longer = length * math.sqrt(square)
                    co, si = (qx * vx + qy * vy) / longer, (qx * vy - qy * vx) / longer
                    mx, my = 0.5 * (q[a, 0] + q[b, 0]), 0.5 * (q[a, 1] + q[b, 1])
                    tx = px + 0.5 * vx - co * mx + si * my
                    ty = py + 0.5 * vy - si * mx - co * my
                    if _beyond(within, tx, ty, co, si):
                        continue
                    floor = votes[basins - 1]
                    vote = _vote(
                        q, spread, gain, rest, points, owner, side, low[0] - cell, low[1] - cell, tx, ty, co, si, floor
                    )
                    if vote > floor:
                        _keep(motions, votes, tx, ty, math.atan2(si, co), vote, apart)
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
