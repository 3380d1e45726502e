"""Anchored flights: poses from pairs of pairings whose distance a rigid motion keeps, and the vote of the other observations.

Everything is Cartesian in the sensor's frame. A motion xi = (tx, ty, theta) carries predicted points p to q = R(theta) p + t.
Nothing is linearised: the prior of the motion only weighs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LOG_2PI = math.log(2.0 * math.pi)
FINE, SPREAD = 4, 1 << 18  # small cells along a side of a cell, and in all, at most
MANY = 4000  # pairs of candidates of two observations from which a table of what is near pays


@jit
def ready(
    q: Array, R: Array, D: Array, base: Array, odds: Array, counts: Array, most: int
) -> tuple[Array, Array, Array, float, Array, Array, Array]:  # fmt: skip
    """What `explore` works with, from observations q (m, 2) with noise R, own covariances D (n, 2, 2) and gains.

    A pose from two observations is itself uncertain by about their noise: votes are weighed by three times it.
    Returns W (m, 3), gain (m,), worth (n,), the side m of a cell that holds every vote worth casting, apart (2,), and up
    to `most` pairs of observations (a, 2) with the tolerance (a,) m on their distance, 3.5 sigma of the two: those that
    share no observation first, of them few candidates and a long baseline; each observation is used at most three times.
    """
    m, n = q.shape[0], D.shape[0]
    own, top = np.zeros(3), odds.max()
    for j in range(n):
        own += np.array([D[j, 0, 0], 0.5 * (D[j, 0, 1] + D[j, 1, 0]), D[j, 1, 1]]) / n
    W, gain, sigma, cell, noise = np.empty((m, 3)), np.empty(m), np.empty(m), 1e-9, 0.0
    for i in range(m):
        a, b, d = R[i, 0, 0] + own[0], 0.5 * (R[i, 0, 1] + R[i, 1, 0]) + own[1], R[i, 1, 1] + own[2]
        det = a * d - b * b
        W[i, 0], W[i, 1], W[i, 2] = d / det / 3.0, -b / det / 3.0, a / det / 3.0
        gain[i] = base[i] + top - 0.5 * math.log(det) - LOG_2PI
        large = 0.5 * (a + d) + math.sqrt(0.25 * (a - d) ** 2 + b * b)
        sigma[i] = math.sqrt(large)
        cell = max(cell, math.sqrt(6.0 * max(gain[i], 1.0) * large))
        noise += (a + d) / m
    apart = np.array([2.0 * math.sqrt(noise), 2.0 * math.sqrt(noise) / max(np.abs(q).max(), 1e-9)])
    pairs, tolerance = _anchors(q, sigma, counts, most)
    return W, gain, odds - top, cell, apart, pairs, tolerance


@jit
def _anchors(q: Array, sigma: Array, counts: Array, most: int) -> tuple[Array, Array]:
    """The pairs of observations to anchor on and their tolerances."""
    m = q.shape[0]
    size = m * (m - 1) // 2
    first, second, rank, found = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size), 0
    for a in range(m):
        for b in range(a + 1, m):
            work = float(counts[a] * counts[b])
            square = (q[a, 0] - q[b, 0]) ** 2 + (q[a, 1] - q[b, 1]) ** 2
            if work > 0.0 and square > 9.0 * (sigma[a] + sigma[b]) ** 2:
                first[found], second[found], rank[found] = a, b, work / square
                found += 1
    times, pairs, tolerance, kept = np.zeros(m, np.int64), np.empty((most, 2), np.int64), np.empty(most), 0
    for uses in range(1, 4):  # anchors that share no observation first: a false one must not speak twice
        while kept < most:
            best, least = -1, np.inf
            for k in range(found):
                if rank[k] < least and times[first[k]] < uses and times[second[k]] < uses:
                    best, least = k, rank[k]
            if best < 0:
                break
            a, b = first[best], second[best]
            times[a] += 1
            times[b] += 1
            pairs[kept, 0], pairs[kept, 1] = a, b
            tolerance[kept] = 3.5 * math.hypot(sigma[a], sigma[b])
            rank[best] = np.inf
            kept += 1
    return pairs[:kept], tolerance[:kept]


@jit
def best_near(
    x: float, y: float, W: Array, points: Array, worth: Array, cell: float, low: Array, shape: Array, start: Array,
    index: Array,
) -> float:  # fmt: skip
    """max over the points in the 3 x 3 window around (x, y) of worth_j - d2 / 2, d2 by the inverse covariance W (3,)."""
    cx, cy = math.floor((x - low[0]) / cell), math.floor((y - low[1]) / cell)
    best = -np.inf
    for a in range(max(cx - 1, 0), min(cx + 2, shape[0])):
        first, last = max(cy - 1, 0), min(cy + 2, shape[1])
        if last <= first:
            continue
        for c in range(start[a * shape[1] + first], start[a * shape[1] + last]):
            j = index[c]
            u, v = x - points[j, 0], y - points[j, 1]
            value = worth[j] - 0.5 * (W[0] * u * u + 2.0 * W[1] * u * v + W[2] * v * v)
            if value > best:
                best = value
    return best


@jit
def nearness(points: Array, cell: float, low: Array, shape: Array, pairs: Array, counts: Array) -> tuple[float, Array]:
    """Side of a small cell, and the least squared distance from anywhere in each to a point (a, b), inf from `cell` on.

    The small cells cover those of the grid from `low` on, one more on each side. Filling them costs what some hundred votes do: of
    size 0 where the candidates of the first of the `pairs` of observations, `counts` (m,), are too few for it.
    """
    if pairs.shape[0] == 0 or counts[pairs[0, 0]] * counts[pairs[0, 1]] < MANY:
        return cell, np.empty((0, 0))
    fine = FINE
    while fine > 1 and (shape[0] + 2) * (shape[1] + 2) * fine * fine > SPREAD:
        fine -= 1
    side = cell / fine
    table = np.full(((shape[0] + 2) * fine, (shape[1] + 2) * fine), np.inf)
    for j in range(points.shape[0]):
        x, y = points[j, 0] - low[0] + cell, points[j, 1] - low[1] + cell
        a, b = int(x / side), int(y / side)
        for r in range(max(a - fine, 0), min(a + fine + 1, table.shape[0])):
            u = max(r * side - x, x - (r + 1) * side, 0.0)
            for t in range(max(b - fine, 0), min(b + fine + 1, table.shape[1])):
                v = max(t * side - y, y - (t + 1) * side, 0.0)
                table[r, t] = min(table[r, t], u * u + v * v)
    return side, table


@jit
def explore(
    q: Array, W: Array, gain: Array, anchors: Array, tolerance: Array, start: Array, columns: Array, points: Array,
    worth: Array, prior_inverse: Array, prior_gate2: float, cell: float, low: Array, shape: Array, cells: Array,
    index: Array, side: float, table: Array, apart: Array, basins: int, budget: int, behind: float,
) -> tuple[Array, Array, int, int]:  # fmt: skip
    """Poses from all anchors' pairs of candidates, voted on by all observations; the best distinct ones, best first.

    q (m, 2) observations; W (m, 3) inverse covariances for the vote; gain (m,) what a perfect vote adds; anchors (a, 2)
    pairs of observations, tolerance (a,) m on their distance; candidates of i in columns[start[i]:start[i + 1]]; worth (n,)
    log odds of each point relative to the best. apart (2,): two poses nearer than this (m, rad) are one basin.
    A pose is given up once it cannot come within `behind` nats of the best any more, most by the `table` of `nearness`. Stops
    early when two anchors agree on a basin that leads by 10 nats and explains 60 % of what can be gained; while only one does,
    those that it explains come first: no others can agree.
    Returns poses (basins, 3), scores (-inf where none), poses tried and anchors used.
    """
    poses, scores, tried = np.zeros((basins, 3)), np.full(basins, -np.inf), 0
    rest = np.zeros(q.shape[0] + 1)  # what the observations from each on can gain
    for i in range(q.shape[0] - 1, -1, -1):
        rest[i] = rest[i + 1] + max(gain[i], 0.0)
    support, loose = np.zeros(basins, np.int64), _loosest(W)  # anchors that led to each basin
    turn = np.arange(anchors.shape[0])
    for k in range(anchors.shape[0]):
        if scores[0] > 0.6 * rest[0] and (basins < 2 or scores[0] - scores[1] > 10.0):
            if k >= 2 and support[0] >= 2:
                return poses, scores, tried, k
            _bring_forward(turn, k, anchors, poses[0], q, W, gain, points, worth, cell, low, shape, cells, index)
        at = turn[k]
        a, b = anchors[at, 0], anchors[at, 1]
        qx, qy = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1]
        q_length = math.sqrt(qx * qx + qy * qy)
        near, far = max(q_length - tolerance[at], 1e-9), q_length + tolerance[at]
        touched = np.zeros(basins, np.bool_)
        for ca in range(start[a], start[a + 1]):
            ja = columns[ca]
            for cb in range(start[b], start[b + 1]):
                jb = columns[cb]
                px, py = points[jb, 0] - points[ja, 0], points[jb, 1] - points[ja, 1]
                square = px * px + py * py
                if ja == jb or square < near * near or square > far * far:
                    continue
                scale = 1.0 / (math.sqrt(square) * q_length)
                c, s = (px * qx + py * qy) * scale, (px * qy - py * qx) * scale
                mx, my = 0.5 * (points[ja, 0] + points[jb, 0]), 0.5 * (points[ja, 1] + points[jb, 1])
                tx, ty = 0.5 * (q[a, 0] + q[b, 0]) - c * mx + s * my, 0.5 * (q[a, 1] + q[b, 1]) - s * mx - c * my
                theta = math.atan2(s, c)
                cost = 0.5 * _quadratic(prior_inverse, tx, ty, theta)
                if 2.0 * cost > prior_gate2:
                    continue
                tried += 1
                floor = max(scores[basins - 1], scores[0] - behind)
                if table.size == 0 or _hopeful(
                    q, loose, gain, rest, tx, ty, c, s, -cost, floor, low, cell, side, table
                ):
                    score = _vote(
                        q, W, gain, rest, points, worth, tx, ty, c, s, -cost, floor, cell, low, shape, cells, index
                    )  # fmt: skip
                    if score > floor:
                        _settle(poses, scores, support, touched, tx, ty, theta, score, apart)
                if tried >= budget:
                    return poses, scores, tried, k
        for r in range(basins):
            support[r] += touched[r]
    return poses, scores, tried, anchors.shape[0]


@jit
def _bring_forward(
    turn: Array, k: int, anchors: Array, pose: Array, q: Array, W: Array, gain: Array, points: Array, worth: Array,
    cell: float, low: Array, shape: Array, cells: Array, index: Array,
) -> None:  # fmt: skip
    """Put the first anchor of turn[k:] both of whose observations the pose explains at k, in place; the others follow."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for r in range(k, turn.shape[0]):
        explained = True
        for side in range(2):
            i = anchors[turn[r], side]
            ox, oy = q[i, 0] - pose[0], q[i, 1] - pose[1]
            x, y = c * ox + s * oy, -s * ox + c * oy
            explained &= gain[i] + best_near(x, y, W[i], points, worth, cell, low, shape, cells, index) > 0.0
        if explained:
            first = turn[r]
            turn[k + 1 : r + 1] = turn[k:r].copy()
            turn[k] = first
            return


@jit
def _loosest(W: Array) -> Array:
    """Half the least eigenvalue (m,) of inverse covariances W (m, 3): what a squared distance costs at least."""
    least = np.empty(W.shape[0])
    for i in range(W.shape[0]):
        least[i] = 0.25 * (W[i, 0] + W[i, 2] - math.sqrt((W[i, 0] - W[i, 2]) ** 2 + 4.0 * W[i, 1] ** 2))
    return least


@jit
def _hopeful(
    q: Array, loose: Array, gain: Array, rest: Array, tx: float, ty: float, c: float, s: float, score: float,
    floor: float, low: Array, cell: float, side: float, table: Array,
) -> bool:  # fmt: skip
    """Whether `_vote` may end above `floor`: no vote is more than that of the best point at the table's distance.

    Nobody votes for a point farther than a cell.
    """
    x0, y0, back = cell - low[0], cell - low[1], 1.0 / side
    for i in range(q.shape[0]):
        if score + rest[i] <= floor:
            return False
        ox, oy = q[i, 0] - tx, q[i, 1] - ty
        a, b = math.floor((c * ox + s * oy + x0) * back), math.floor((c * oy - s * ox + y0) * back)
        if 0 <= a < table.shape[0] and 0 <= b < table.shape[1]:
            score += max(gain[i] - loose[i] * table[a, b], 0.0)
    return score > floor


@jit
def _vote(
    q: Array, W: Array, gain: Array, rest: Array, points: Array, worth: Array, tx: float, ty: float, c: float, s: float,
    score: float, floor: float, cell: float, low: Array, shape: Array, cells: Array, index: Array,
) -> float:  # fmt: skip
    """`score` of a pose with all that the observations add; -inf once what is left cannot lift it above `floor`."""
    for i in range(q.shape[0]):
        if score + rest[i] <= floor:
            return -np.inf
        # the observation carried back to where the map would have it
        ox, oy = q[i, 0] - tx, q[i, 1] - ty
        x, y = c * ox + s * oy, -s * ox + c * oy
        vote = gain[i] + best_near(x, y, W[i], points, worth, cell, low, shape, cells, index)
        if vote > 0.0:
            score += vote
    return score


@jit
def _quadratic(M: Array, x: float, y: float, t: float) -> float:
    squares = M[0, 0] * x * x + M[1, 1] * y * y + M[2, 2] * t * t
    return float(squares + 2.0 * (M[0, 1] * x * y + M[0, 2] * x * t + M[1, 2] * y * t))


@jit
def _settle(
    poses: Array,
    scores: Array,
    support: Array,
    touched: Array,
    x: float,
    y: float,
    t: float,
    score: float,
    apart: Array,
) -> None:
    """Put a pose into the list of basins, best first; a basin keeps the best of its poses."""
    size = scores.shape[0]
    k = size - 1
    for r in range(size):
        if scores[r] == -np.inf:
            k = r
            break
        turn = abs((t - poses[r, 2] + math.pi) % (2.0 * math.pi) - math.pi)
        if math.hypot(x - poses[r, 0], y - poses[r, 1]) < apart[0] and turn < apart[1]:
            touched[r] = True
            if score <= scores[r]:
                return
            k = r
            break
    if scores[k] >= score:
        return
    if k == size - 1 and not touched[k]:
        support[k] = 0
    votes = support[k] if scores[k] > -np.inf else 0
    if k == size - 1 and scores[k] > -np.inf and not touched[k]:
        votes = 0
    while k > 0 and scores[k - 1] < score:
        poses[k], scores[k], support[k], touched[k] = poses[k - 1], scores[k - 1], support[k - 1], touched[k - 1]
        k -= 1
    poses[k, 0], poses[k, 1], poses[k, 2], scores[k] = x, y, t, score
    support[k], touched[k] = votes, True
