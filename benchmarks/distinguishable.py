"""Can a place be told at all? By true names and an exhaustive search, without any part of our own matcher.

What was seen in the steps is laid by odometry alone, averaged for each true name, and laid on the true map: the place is
the true one, its noise the misfit. It is distinguishable where at no other place of the map so many of these landmarks
have anything within that noise, by a margin of `MARGIN`. A landmark that matches is worth log(1 / (2 pi s^2 density)), in these
worlds some 3 to 4 nats: three of them make 7 nats or more, one error in 1000 or fewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomthumb.geometry import align, compose, to_world
from tomthumb.types import Array, Ids, Scenario, Step

MARGIN = 3  # landmarks more than at any other place
REACH = 2.5  # times the misfit: within that a landmark is matched
SAME = 0.5, 0.2  # m, rad: motions nearer than this are the same place
LIMIT = 0.02  # m, the least misfit that is reckoned with


@dataclass(frozen=True)
class Known:
    """The true landmarks (n, 2) m, and the rows (k,) of those that the robot has mapped."""

    landmarks: Array
    mapped: Ids

    @property
    def points(self) -> Array:
        """Those that are mapped (k, 2)."""
        return self.landmarks[self.mapped]


def needed(known: Known, scenario: Scenario, steps: Sequence[Step], within: Sequence[int]) -> int | None:
    """The least of `within` steps after which the place can be told; None if it cannot."""
    seen = laid_out(scenario, steps)
    for count in within:
        if distinguishable(known, seen[:count]):
            return count
    return None


def laid_out(scenario: Scenario, steps: Sequence[Step]) -> list[tuple[Ids, Array]]:
    """Of each step the true names (m,) of what was seen and where (m, 2) odometry alone has it."""
    pose, out = np.zeros(3), []
    for k, step in enumerate(steps):
        if k and step.control is not None:
            pose = compose(pose, scenario.motion.increment(step.control)[0])
        if step.observations is None or step.truth is None or step.truth.ids is None:
            out.append((np.empty(0, np.int64), np.empty((0, 2))))
            continue
        named = step.truth.ids >= 0
        out.append((step.truth.ids[named], scenario.sensor.locate(pose, step.observations.z[named])[0]))
    return out


def distinguishable(known: Known, seen: Sequence[tuple[Ids, Array]]) -> bool:
    """Whether the true place of what was seen leads by `MARGIN` landmarks."""
    names, points = (np.concatenate([part[k] for part in seen]) for k in (0, 1))
    both = np.intersect1d(names, known.mapped)
    if len(both) < MARGIN:
        return False
    q = np.array([points[names == i].mean(0) for i in both])
    place = align(q, known.landmarks[both])
    gaps = np.hypot(*(to_world(place, q) - known.landmarks[both]).T)
    reach = REACH * max(float(np.sqrt((gaps**2).mean())), LIMIT)
    count = int((gaps < reach).sum())
    return count > MARGIN and best_elsewhere(q, known.points, place, reach, count - MARGIN + 1) <= count - MARGIN


def best_elsewhere(q: Array, points: Array, place: Array, reach: float, least: int) -> int:
    """The most of q (n, 2) that have one of the points within `reach` under a motion that is not `place`.

    Exact as to whether `least` are reached: who has so many has two of any n - least + 2, so pairs among those give all
    the motions there are.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    some = _apart(q, min(len(q), len(q) - least + 2))
    best = 0
    for a, b in zip(*np.triu_indices(len(some), 1), strict=True):
        best = max(best, _best(q, q[some[a]], q[some[b]], tree, place, reach))
        if best >= least:
            return best
    return best


def _apart(q: Array, count: int) -> list[int]:
    """So many points, each as far from those before as can be: few motions fit a long pair."""
    chosen = [int(np.argmax(((q - q.mean(0)) ** 2).sum(1)))]
    while len(chosen) < count:
        chosen.append(int(np.argmax(((q[:, None] - q[chosen][None]) ** 2).sum(2).min(1))))
    return chosen


def _best(q: Array, a: Array, b: Array, tree: object, place: Array, reach: float) -> int:
    """The most matches under the motions that carry a and b to two of the points, each within `reach`."""
    points = tree.data  # type: ignore[attr-defined]
    length = float(np.hypot(*(b - a)))
    pairs = np.array(list(tree.query_pairs(length + 2 * reach)), np.int64).reshape(-1, 2)  # type: ignore[attr-defined]
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    gap = points[pairs[:, 1]] - points[pairs[:, 0]]
    near = np.hypot(*gap.T) > length - 2 * reach
    pairs, gap = pairs[near], gap[near]
    theta = np.arctan2(gap[:, 1], gap[:, 0]) - np.arctan2(*(b - a)[::-1])
    co, si = np.cos(theta), np.sin(theta)
    middle, centre = 0.5 * (points[pairs[:, 0]] + points[pairs[:, 1]]), 0.5 * (a + b)
    at = q - centre
    x = middle[:, :1] + co[:, None] * at[:, 0] - si[:, None] * at[:, 1]
    y = middle[:, 1:] + si[:, None] * at[:, 0] + co[:, None] * at[:, 1]
    own = to_world(place, q).mean(0)
    moved = np.hypot(x.mean(1) - own[0], y.mean(1) - own[1]) > SAME[0]
    turned = np.abs((theta - place[2] + np.pi) % (2 * np.pi) - np.pi) > SAME[1]
    other = moved | turned
    if not other.any():
        return 0
    where = np.stack([x[other], y[other]], 2)
    gaps = tree.query(where, distance_upper_bound=reach)[0]  # type: ignore[attr-defined]
    return int((gaps < reach).sum(1).max())
