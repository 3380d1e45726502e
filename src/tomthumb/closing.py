"""Loops closed by the king: what has been mapped since a doubt began, as a constellation, against what was mapped before.

Scan by scan a long loop does not close: the filter is sure of a pose that is metres off. What the robot has mapped lately
is right among itself all the same, and fits into the old map at one place only. Here the watch has a doubt that nothing
has settled, and the place may be anywhere; loops that nobody doubts are the scout's (`scout`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import fits
from tomthumb.king import Exile, King, Return, best_way, thinned
from tomthumb.protocols import Estimator, Sensor
from tomthumb.types import Array, Estimate, Mask

SLACK = 1.5  # how much less exact the recent map is in itself than one observation


@dataclass(frozen=True, slots=True)
class Loops:
    """every: scans between two looks. stars: youngest landmarks that make the constellation. poses: of the trail, from
    which old landmarks would have been seen.
    """

    every: int = 5
    stars: int = 25
    poses: int = 12


@dataclass(frozen=True, slots=True)
class Closure:
    """A loop that is closed: the way to the old map for all that was born after scan `since`."""

    way: Return
    since: int


def closure(
    king: King, loops: Loops, branch: Branch, estimator: Estimator[Any], sensor: Sensor, scan: int, since: int,
    noise: float,
) -> Closure | None:  # fmt: skip
    """The loop that is closed here, if one is. `since`: the scan from which on the pose is in doubt; noise: m."""
    born = np.array([life.born for life in branch.ledger.values()])
    if np.count_nonzero(born > since) < king.votes:
        return None
    whole = estimator.estimate(branch.belief)
    young, old = _parted(whole, branch, since, loops)
    if min(young.sum(), old.sum()) < king.votes:
        return None
    away = _away(branch, whole, old, loops, scan - since)
    q = whole.landmarks[young]
    found = fits(q, np.tile((SLACK * noise) ** 2 * np.eye(2), (len(q), 1, 1)), away.old.landmarks, np.zeros(3))
    way = best_way(king, found, q, whole.ids[young], away, sensor)
    return None if way is None else Closure(way, since)


def _parted(whole: Estimate, branch: Branch, since: int, loops: Loops) -> tuple[Mask, Mask]:
    """The youngest stones born after `since`, and those born before."""
    born = np.array([branch.ledger[i].born for i in whole.ids.tolist()])
    fresh = np.flatnonzero(whole.stone & (born > since))
    young = np.zeros(len(born), bool)
    young[fresh[np.argsort(-born[fresh], kind="stable")][: loops.stars]] = True
    return young, whole.stone & (born <= since)


def _away(branch: Branch, whole: Estimate, old: Mask, loops: Loops, scans: int) -> Exile:
    part = whole.only(old)
    exist = np.array([branch.ledger[i].exist for i in part.ids.tolist()])
    return Exile(branch, part, exist, trail=thinned(trail(branch, scans), loops.poses))


def trail(branch: Branch, scans: int) -> list[Array]:
    """Poses of the last scans, the last one at the end; of the steps before a scan only that of the scan itself."""
    poses: list[Array] = []
    node, last = branch.history, -1
    while node is not None and len(poses) < scans:
        node, _, pose, scan = node
        if scan != last:
            poses.append(pose)
        last = scan
    return poses[::-1]
