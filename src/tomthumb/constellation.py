"""A constellation: a few landmarks whose places relative to each other are well known, looked for in a large map.

The same move as the anchored flights of one scan, with the landmarks of the recent trail in place of the scan: a pair of
local points and a pair of map points of equal distance give a motion, the other points vote, the best basins are refined.
Nothing is linearised, and no prior is needed. References: T. Bailey, E. Nebot, "Localisation in
large-scale environments", Robotics and Autonomous Systems 37, 2001 (the idea of matching constellations).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomthumb.geometry import rotation, to_world, wrap_angle
from tomthumb.kernels import constellation as kernel
from tomthumb.kernels.grid import fill_grid
from tomthumb.types import Array, Ids

ANCHORS = 12  # pairs of local points that give motions, for each of
BASELINES = (1.0, 0.5, 0.25)  # of the longest distance
BASINS = 16  # motions refined
BUDGET = 2_000_000  # motions tried at most
GATE = 3.5  # standard deviations of a vote
BEND = 0.01  # m per m: how much a local map may be bent by what its covariance does not know


@dataclass(frozen=True, slots=True)
class Fit:
    """A local map laid on a large one: p = R(theta) q + t for motion (x, y, theta), covariance (3, 3) of the motion.

    match (k,): map point of each local point, or -1. votes: pairs, gain: nats they speak for the motion.
    """

    motion: Array
    cov: Array
    match: Ids
    votes: int
    gain: float


@dataclass(frozen=True, slots=True)
class Within:
    """Motions that carry the local `point` (2,) m at most `metres` away, and turn by `radians` more or less at most."""

    point: Array
    metres: float
    radians: float


def fits(q: Array, covs: Array, points: Array, also: Array | None = None, within: Within | None = None) -> list[Fit]:
    """All good ways to lay local points q (k, 2) m, covariances (k, 2, 2) m2, on map points (n, 2) m, best first.

    `also` (3,) is a motion that is refined in any case (where the robot believes it is); `within` bounds how far from it
    the others may lie.
    """
    if len(q) < 3 or len(points) < 3:
        return []
    centre = q.mean(0)
    at = q - centre
    spread = _spread(covs)
    gain = _gains(spread, points)
    grid = fill_grid(points, GATE * float(spread.max()))
    anchors, tolerance = _anchors(at, spread)
    size = max(float(np.abs(at).max()), 1e-9)
    apart = np.array([2.0 * spread.mean(), 2.0 * spread.mean() / size])
    motions, votes, _ = kernel.search(
        at, spread, gain, anchors, tolerance, points, *grid, apart, _near(also, centre, within), BASINS, BUDGET
    )
    starts = [m for m, v in zip(motions, votes, strict=True) if np.isfinite(v)]
    if also is not None:
        starts.append(_about_centre(also, centre))
    found = [_refined(m, at, spread, gain, points, grid) for m in starts]
    return [_about(fit, centre) for fit in _distinct(found, apart)]


def fitted(q: Array, covs: Array, points: Array, motion: Array) -> Fit:
    """The way to lay the local points on the map that lies next to `motion` (3,); gain -inf where there is none."""
    centre, spread = q.mean(0), _spread(covs)
    grid = fill_grid(points, GATE * float(spread.max()))
    start = _about_centre(motion, centre)
    return _about(_refined(start, q - centre, spread, _gains(spread, points), points, grid), centre)


def standing(q: Array, covs: Array, points: Array, motion: Array) -> Fit:
    """The pairs that speak for a `motion` (3,) as it is; gain -inf where there are none.

    Where a local map is known poorly, wide gates let wrong pairs draw the refined fit away from a pose that is right.
    """
    spread, centre = _spread(covs), q.mean(0)
    gain = _gains(spread, points)
    reach = np.minimum(np.sqrt(2.0 * gain), GATE) * spread
    grid = fill_grid(points, float(reach.max()))
    match = kernel.pair_up(_about_centre(motion, centre), q - centre, reach, points, *grid)
    rows = np.flatnonzero(match >= 0)
    if len(rows) < 2:
        return Fit(motion, np.eye(3), match, len(rows), -np.inf)
    cov = _laid(q[rows] - centre, points[match[rows]], spread[rows])[1]
    gaps = points[match[rows]] - to_world(motion, q[rows])
    total = float((gain[rows] - 0.5 * (gaps**2).sum(1) / spread[rows] ** 2).sum())
    return replace(_about(Fit(_about_centre(motion, centre), cov, match, len(rows), total), centre), motion=motion)


def shares_at_most(covs: Array, points: Array) -> Array:
    """The most that each local point (k,) can add to the gain of a fit, nats."""
    return _gains(_spread(covs), points)


def shares(fit: Fit, q: Array, covs: Array, points: Array) -> Array:
    """What each local point (k,) adds to the gain of a fit, nats; 0 where it has no partner."""
    spread, rows = _spread(covs), np.flatnonzero(fit.match >= 0)
    gaps = points[fit.match[rows]] - to_world(fit.motion, q[rows])
    out = np.zeros(len(q))
    out[rows] = _gains(spread, points)[rows] - 0.5 * (gaps**2).sum(1) / spread[rows] ** 2
    return out


def perfect(q: Array, covs: Array, points: Array) -> Fit:
    """As good a fit as there can be: every local point has a partner just where it should be."""
    spread, centre = _spread(covs), q.mean(0)
    motion, cov = _laid(q - centre, q - centre, spread)
    gain = float(_gains(spread, points).sum())
    return _about(Fit(motion, cov, np.arange(len(q)), len(q), gain), centre)


def _about_centre(motion: Array, centre: Array) -> Array:
    return np.append(rotation(motion[2]) @ centre + motion[:2], motion[2])


def _near(also: Array | None, centre: Array, within: Within | None) -> Array:
    """(x, y, theta, m, rad, u, v): where the local point (u, v), from the centre, may be carried, and with what turn."""
    if also is None or within is None:
        return np.array([0.0, 0.0, 0.0, np.inf, np.inf, 0.0, 0.0])
    place = rotation(also[2]) @ within.point + also[:2]
    return np.array([*place, also[2], within.metres, within.radians, *(within.point - centre)])


def _spread(covs: Array) -> Array:
    """Standard deviation (k,) m of a vote: the point's own, beside a map point that is about as well known."""
    own = np.sqrt(np.maximum(0.5 * np.trace(covs, axis1=1, axis2=2), 1e-8))
    spread: Array = np.hypot(own, np.median(own))
    return spread


def _gains(spread: Array, points: Array) -> Array:
    """log(1 / (2 pi s2 density)), at most 5 nats: how much less a vote is to be expected by chance."""
    gains: Array = np.clip(-np.log(2.0 * np.pi * spread**2 * density(points)), 0.5, 5.0)
    return gains


def density(points: Array) -> float:
    """Points per m2 where there are some: strewn evenly, half of them have a neighbour within .47 of the root of 1/density."""
    return float(1.0 / np.maximum(4.0 * np.median(spacing(points)) ** 2, 1e-9))


def spacing(points: Array) -> Array:
    """Distance (n,) m of each point to its nearest neighbour."""
    from scipy.spatial import cKDTree

    distance: Array = cKDTree(points).query(points, k=2)[0][:, 1]
    return distance


def _anchors(q: Array, spread: Array) -> tuple[Ids, Array]:
    """Pairs of local points, long baseline first, each used at most three times; tolerance m on their distance.

    Then the same among pairs of half that length at most, and of a quarter: where a part of the points only is on the
    map, the longest pairs all lead out of it.
    """
    a, b = np.triu_indices(len(q), 1)
    length = np.hypot(*(q[a] - q[b]).T)
    order = np.argsort(-length, kind="stable")
    chosen: list[int] = []
    for longest in length.max() * np.array(BASELINES):
        times = np.zeros(len(q), np.int64)
        wanted = len(chosen) + ANCHORS
        for k in order[length[order] <= longest].tolist():
            if times[a[k]] < 3 and times[b[k]] < 3 and k not in chosen and len(chosen) < wanted:
                times[[a[k], b[k]]] += 1
                chosen.append(k)
    picked = np.array(chosen, np.int64)
    tolerance: Array = 2.5 * np.hypot(spread[a[picked]], spread[b[picked]]) + BEND * length[picked]
    return np.column_stack([a[picked], b[picked]]), tolerance


Grid = tuple[float, Array, Array, Array, Array]


def _refined(motion: Array, q: Array, spread: Array, gain: Array, points: Array, grid: Grid) -> Fit:
    """Pair up and lay on by least squares, three times over."""
    cov = np.eye(3)
    match = np.full(len(q), -1, np.int64)
    for _ in range(3):
        match = kernel.pair_up(motion, q, GATE * spread, points, *grid)
        rows = np.flatnonzero(match >= 0)
        if len(rows) < 2:
            return Fit(motion, cov, match, len(rows), -np.inf)
        motion, cov = _laid(q[rows], points[match[rows]], spread[rows])
    gaps = points[match[rows]] - to_world(motion, q[rows])
    total = float((gain[rows] - 0.5 * (gaps**2).sum(1) / spread[rows] ** 2).sum())
    return Fit(motion, cov, match, len(rows), total)


def _laid(q: Array, p: Array, spread: Array) -> tuple[Array, Array]:
    """The motion of weighted least squares that carries q to p (closed form), and its covariance."""
    w = 1.0 / spread**2
    share = w / w.sum()
    mq, mp = share @ q, share @ p
    dq, dp = q - mq, p - mp
    dot, cross = (w * (dq * dp).sum(1)).sum(), (w * (dq[:, 0] * dp[:, 1] - dq[:, 1] * dp[:, 0])).sum()
    theta = float(np.arctan2(cross, dot))
    motion = np.append(mp - rotation(theta) @ mq, theta)
    turned = to_world(np.array([0.0, 0.0, theta]), q)
    J = np.zeros((len(q), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -turned[:, 1], turned[:, 0]
    cov: Array = np.linalg.inv(np.einsum("k,kia,kib->ab", w, J, J))
    return motion, cov


def _distinct(found: list[Fit], apart: Array) -> list[Fit]:
    """The best of each basin, best first."""
    kept: list[Fit] = []
    for fit in sorted(found, key=lambda f: -f.gain):
        near = [
            np.hypot(*(fit.motion[:2] - other.motion[:2])) < apart[0]
            and abs(wrap_angle(fit.motion[2] - other.motion[2])) < apart[1]
            for other in kept
        ]
        if np.isfinite(fit.gain) and not any(near):
            kept.append(fit)
    return kept


def _about(fit: Fit, centre: Array) -> Fit:
    """The motion of points about their centre as one of the points themselves."""
    x, y = rotation(fit.motion[2]) @ centre
    J = np.eye(3)
    J[0, 2], J[1, 2] = y, -x
    motion = np.array([fit.motion[0] - x, fit.motion[1] - y, fit.motion[2]])
    return Fit(motion, J @ fit.cov @ J.T, fit.match, fit.votes, fit.gain)
