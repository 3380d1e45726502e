"""Loops closed by the king: what has been mapped lately, as a constellation, against what was mapped before.

Scan by scan a long loop does not close: the filter is sure of a pose that is metres off. What the robot has mapped lately
is right among itself all the same, and fits into the old map at one place only. Two occasions:

- a doubt of the watch that nothing has settled: everything mapped since is laid on everything mapped before, anywhere;
- without a doubt, only within the drift that odometry may have gathered since the old part was seen. A periodic world
  would close onto itself otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import Fit, fits
from tomthumb.geometry import compose, wrap_angle
from tomthumb.king import Exile, King, Return, clear, judged, thinned
from tomthumb.protocols import Estimator, Sensor
from tomthumb.types import Array, Estimate, Mask

SLACK = 1.5  # how much less exact the recent map is in itself than one observation


@dataclass(frozen=True, slots=True)
class Loops:
    """every: scans between two looks. stars: youngest landmarks that make the constellation. window: scans in which
    they were born. drift: m per m of path, rad per m: what odometry may have gathered. poses: of the trail, from which
    old landmarks would have been seen. drifting: look without a doubt too.
    """

    every: int = 5
    stars: int = 25
    window: int = 60
    drift: tuple[float, float] = (0.05, 0.005)
    poses: int = 12
    drifting: bool = False


@dataclass(frozen=True, slots=True)
class Closure:
    """A loop that is closed: the way to the old map for all that was born after scan `since`."""

    way: Return
    since: int


def closure(
    king: King, loops: Loops, branch: Branch, estimator: Estimator[Any], sensor: Sensor, scan: int, doubt: int | None,
    noise: float,
) -> Closure | None:  # fmt: skip
    """The loop that is closed here, if one is. `doubt`: the scan since which the pose is in doubt; noise: m."""
    since = scan - loops.window if doubt is None else doubt
    born = np.array([life.born for life in branch.ledger.values()])
    if np.count_nonzero(born > since) < king.votes:
        return None
    whole = estimator.estimate(branch.belief)
    young, old = _parted(whole, branch, since, loops, doubt is not None)
    if min(young.sum(), old.sum()) < king.votes:
        return None
    away = _away(branch, whole, old, loops, scan - since)
    away.believed = doubt is not None
    q = whole.landmarks[young]
    found = fits(q, np.tile((SLACK * noise) ** 2 * np.eye(2), (len(q), 1, 1)), away.old.landmarks, np.zeros(3))
    if doubt is None:
        found = [fit for fit in found if _drifted(fit, branch, whole, away, loops)]
        king = replace(king, rival=1.0)  # the drift has ruled out the other places already
    chosen = clear(king, [judged(king, fit, q, away, sensor) for fit in found])
    if chosen is None:
        return None
    named = np.where(found[chosen].match >= 0, away.old.ids[found[chosen].match], -1)
    return Closure(Return(found[chosen], whole.ids[young], named), since)


def _parted(whole: Estimate, branch: Branch, since: int, loops: Loops, doubt: bool) -> tuple[Mask, Mask]:
    """The youngest stones born after `since`, and those not seen after it; in doubt all that were born before."""
    lives = [branch.ledger[i] for i in whole.ids.tolist()]
    born, seen = np.array([life.born for life in lives]), np.array([life.seen for life in lives])
    fresh = np.flatnonzero(whole.stone & (born > since))
    young = np.zeros(len(born), bool)
    young[fresh[np.argsort(-born[fresh], kind="stable")][: loops.stars]] = True
    return young, whole.stone & ((born if doubt else seen) <= since)


def _away(branch: Branch, whole: Estimate, old: Mask, loops: Loops, scans: int) -> Exile:
    part = Estimate(whole.pose, whole.pose_cov, whole.ids[old], whole.landmarks[old], whole.covs[old], whole.stone[old])
    exist = np.array([branch.ledger[i].exist for i in part.ids.tolist()])
    return Exile(branch, part, exist, believed=False, trail=thinned(trail(branch, scans), loops.poses))


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


def _drifted(fit: Fit, branch: Branch, whole: Estimate, away: Exile, loops: Loops) -> bool:
    """The fit moves the robot no farther than odometry may have drifted since the old part was last seen."""
    matched = away.old.ids[fit.match[fit.match >= 0]]
    if not len(matched):
        return False
    last = int(np.median([branch.ledger[i].seen for i in matched.tolist()]))
    newest = max(life.seen for life in branch.ledger.values())
    poses = np.array(trail(branch, newest - last))
    path = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) if len(poses) > 1 else 0.0
    gap = compose(fit.motion, whole.pose) - whole.pose
    std = 5.0 * np.sqrt(np.diag(whole.pose_cov))
    near = np.hypot(*gap[:2]) < max(loops.drift[0] * path, float(np.hypot(*std[:2])))
    return bool(near and abs(wrap_angle(gap[2])) < max(loops.drift[1] * path, std[2]))
