"""Loops closed by the king: the landmarks of the recent trail, as a constellation, against those not seen for long.

Scan by scan a long loop does not close: the filter is sure of a pose that is metres off. What the robot has mapped lately
is right among itself all the same, and fits into the old map at one place only. There both are made one, landmark by
landmark (l_a - l_b = 0), and the whole map moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import fits
from tomthumb.king import Exile, King, clear, judged
from tomthumb.lifecycle import Ledger
from tomthumb.protocols import Estimator, Sensor
from tomthumb.types import Array, Estimate, Ids, Mask


@dataclass(frozen=True, slots=True)
class Loops:
    """every: scans between two looks. stars: landmarks seen last that make the constellation. old: scans that a
    landmark must have been out of sight. poses: of the trail, from which the old ones would have been seen."""

    every: int = 10
    stars: int = 40
    old: int = 100
    poses: int = 20


def closures(
    king: King, loops: Loops, branch: Branch, estimator: Estimator[Any], sensor: Sensor, scan: int, noise: float
) -> list[tuple[int, int]]:
    """Pairs (keep, drop) of stones that are one, if a loop is closed here; noise: m, of one observation."""
    seen = np.array([life.seen for life in branch.ledger.values()])
    if np.count_nonzero(seen <= scan - loops.old) < king.votes:
        return []
    whole = estimator.estimate(branch.belief)
    recent, old = _parted(whole, branch.ledger, scan, loops)
    if recent.sum() < king.votes or old.sum() < king.votes:
        return []
    own = np.sqrt(0.5 * np.trace(whole.covs[recent], axis1=1, axis2=2))
    relative = np.abs(own**2 - np.median(own**2)) + noise**2
    away = _away(branch, whole, old, loops)
    q = whole.landmarks[recent]
    found = fits(q, relative[:, None, None] * np.eye(2), away.old.landmarks)
    chosen = clear(king, [judged(king, fit, q, away, sensor) for fit in found])
    if chosen is None:
        return []
    match = found[chosen].match
    pairs = [(int(away.old.ids[j]), int(i)) for i, j in zip(whole.ids[recent], match, strict=True) if j >= 0]
    apart = [(keep, drop) for keep, drop in pairs if drop not in branch.ledger[keep].companions]
    return apart if len(apart) > 0.9 * len(pairs) else []


def _parted(whole: Estimate, ledger: Ledger, scan: int, loops: Loops) -> tuple[Mask, Mask]:
    """Stones of the constellation and stones that have been out of sight."""
    seen = np.array([ledger[i].seen for i in whole.ids.tolist()])
    last = np.flatnonzero(whole.stone & (seen > scan - loops.old))
    newest: Ids = last[np.argsort(-seen[last], kind="stable")][: loops.stars]
    recent = np.zeros(len(seen), bool)
    recent[newest] = True
    return recent, whole.stone & (seen <= scan - loops.old)


def _away(branch: Branch, whole: Estimate, old: Mask, loops: Loops) -> Exile:
    part = Estimate(whole.pose, whole.pose_cov, whole.ids[old], whole.landmarks[old], whole.covs[old], whole.stone[old])
    exist = np.array([branch.ledger[i].exist for i in part.ids.tolist()])
    return Exile(branch, part, exist, believed=False, trail=_trail(branch, loops))


def _trail(branch: Branch, loops: Loops) -> list[Array]:
    """Poses of the last scans, some of them."""
    poses: list[Array] = []
    node = branch.history
    while node is not None and len(poses) < loops.old // 2:
        node, _, pose = node
        poses.append(pose)
    return poses[:: max(1, len(poses) // loops.poses)]
