"""New land may look just like old: then it tells nothing between a branch that is there and one that is back in the old.

Eight brothers are weighed by what they explain, and a pairing is worth nats, a new landmark none. In a world that repeats itself
a brother one post back finds an old post wherever the right one finds a new one, and would win by that alone. So what a
branch finds in land that it has never looked at counts for it as much as for who takes it for old.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import Branch, Child, Scan
from tomthumb.gains import base_table
from tomthumb.geometry import to_frame, wrap_angle
from tomthumb.kernels import posterior
from tomthumb.protocols import Sensor
from tomthumb.types import Array, AssociationProblem, Ids, Mask

if TYPE_CHECKING:
    from tomthumb.slam import Slam

ORIGIN = np.zeros(3)
STEP, TURN = 0.05, 0.1  # of the sensor's range, and rad: poses nearer than that have looked at the same land
FAR = 1e3  # m, for the range of a sensor that has no limit
BLOCK = 64  # poses asked at once, newest first: mostly the first of them have seen what is asked for


@dataclass(frozen=True, slots=True)
class Land:
    """Where a branch has looked from: poses (k, 3) of its scans, thinned, up to the node `upto` of its history."""

    poses: Array
    upto: Any = None

    def until(self, history: Any, scans: int, reach: float) -> Land:
        """The same, up to the newest node of the history, of `scans` scans; made anew where that has been rewritten."""
        poses, node = [], history
        while node is not None and node is not self.upto:
            earlier, _, pose, before = node
            if before < scans:  # else nothing but a control came then: nobody has looked
                poses.append(pose)
            node, scans = earlier, before
        kept = self.poses if node is self.upto else np.empty((0, 3))
        return Land(_thinned(kept, poses[::-1], reach), history)

    def is_new(self, points: Array, sensor: Sensor) -> Mask:
        """Which of the points (n, 2) m have not been in view from any of the poses (n,)."""
        new, near = np.ones(len(points), bool), self._near(points, sensor)
        for end in range(len(near), 0, -BLOCK):
            rest = np.flatnonzero(new)
            if not len(rest):
                break
            new[rest] = ~_in_view(near[max(end - BLOCK, 0) : end], points[rest], sensor)
        return new

    def _near(self, points: Array, sensor: Sensor) -> Array:
        """The poses from which the sensor reaches to one of the points (n, 2)."""
        reach = sensor.max_range + float(np.hypot(*sensor.frame(ORIGIN)[:2]))
        apart = np.hypot(*(self.poses[:, None, :2] - points).transpose(2, 0, 1))
        near: Array = self.poses[apart.min(1, initial=np.inf) <= reach]
        return near


NOWHERE = Land(np.empty((0, 3)))


def _thinned(before: Array, poses: Sequence[Array], reach: float) -> Array:
    kept = list(before[-1:])
    for pose in poses:
        last = kept[-1] if kept else None
        if last is None or math.dist(pose[:2], last[:2]) > reach or abs(float(wrap_angle(pose[2] - last[2]))) > TURN:
            kept.append(pose)
    return np.concatenate([before[:-1], np.array(kept).reshape(-1, 3)])


def _in_view(poses: Array, points: Array, sensor: Sensor) -> Mask:
    """Which of the points (n, 2) are in view from any of the poses (k, 3): one question, of points in the robot's frame."""
    local = np.concatenate([to_frame(pose, points) for pose in poses])
    chance = sensor.in_view(sensor.expect(ORIGIN, local)[0], np.full((len(local), 2), 1e-4))
    seen: Mask = chance.reshape(len(poses), len(points)).max(0) > 0.5
    return seen


def level(slam: Slam, children: Sequence[Child], scan: Scan) -> None:
    """Weighs the branches for copies, each against the best: what one finds in new land may look just as the other says."""
    best = children[0]
    for other in children[1:]:
        other[0].log_weight += _favour(slam, scan, other, best) - _favour(slam, scan, best, other)


def _favour(slam: Slam, scan: Scan, new: Child, old: Child) -> float:
    """Nats that a branch is given for what it finds in new land, where another takes it for old: as much as that one.

    The sides of a cloister look alike. By Poisson's land alone each new post would tell for the branch that is one post
    off, and nobody would ever believe to be in new land that repeats the old.
    """
    (branch, _, (mine, *_), _), (other, (predictions, *_), (match, *_), _) = new, old
    rows = np.flatnonzero((mine < 0) & (match >= 0))
    if len(rows):
        rows = rows[_elsewhere(slam, branch, other, scan.honest.z[rows])]
    return max(_worth(slam.problem(predictions, scan.honest, scan.serials), match, rows), 0.0) if len(rows) else 0.0


def _elsewhere(slam: Slam, branch: Branch, other: Branch, z: Array) -> Mask:
    """Which observations (k, 2) lie in new land by the one branch, and at another place by the other."""
    here, there = (slam.sensor.locate(slam.estimator.pose(b.belief)[0], z)[0] for b in (branch, other))
    reach = STEP * min(slam.sensor.max_range, FAR)
    apart: Mask = np.hypot(*(here - there).T) > reach
    if apart.any():
        branch.land = (branch.land or NOWHERE).until(branch.history, slam.scan, reach)
        apart[apart] = branch.land.is_new(here[apart], slam.sensor)
    return apart


def _worth(problem: AssociationProblem, match: Ids, rows: Ids) -> float:
    """What the pairings of `rows` add to L."""
    given = problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, base_table(problem)
    without = match.copy()
    without[rows] = -1
    return float(posterior.value_of(match, *given)[0] - posterior.value_of(without, *given)[0])
