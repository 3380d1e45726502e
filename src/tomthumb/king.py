"""The king: a family that is lost maps where it is, until that small map fits into the old one; then he carries it home.

    flee      the watch says that the pose is wrong: the old map is put aside, a new one begun where the robot stands
    seek      after each scan the new map is laid on the old one as a constellation
    verify    enough votes, few landmarks missing on either side, no other place nearly as good
    home      the robot is put where the fit says, what it has met is merged into the old map

A kidnapped robot, a start at an unknown place of a known map, and a filter that has gone astray are one and the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import Fit, fits, spacing
from tomthumb.geometry import compose, compose_jacobians, to_world, wrap_angle
from tomthumb.lifecycle import Life
from tomthumb.protocols import Sensor
from tomthumb.types import Array, Estimate, Ids, Mask

SURE = 0.5  # a landmark seen with more than this chance counts as missing where it is not
MISSING = 2.3  # nats: log of 1 in 10, that a landmark which ought to be there is gone or hidden
STRANGE = 1.0  # nats for a landmark that the old map does not have where it has others
NEVER = 1.0  # no hit that is one: what is known from before may stand here


@dataclass(frozen=True, slots=True)
class King:
    """When a fit is believed; reasons in docs/stt.md.

    votes: pairs at least, and `share` of the landmarks that both maps ought to have. lead: nats before the next place.
    home: nats in favour of the place where the robot believes itself, within `drift` (m, rad). every: scans between two
    attempts.
    """

    votes: int = 8
    share: float = 0.7
    lead: float = 10.0
    home: float = 12.0
    drift: tuple[float, float] = (1.0, 0.3)
    every: int = 1


@dataclass(slots=True)
class Exile:
    """A family away from home: the branch it left, the old map's stones, and where it has scanned since (new frame)."""

    home: Branch
    old: Estimate
    exist: Array
    trail: list[Array] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Return:
    """A verified way home: `fit` of the local landmarks `ids (k,)` on the old ones `named (k,)` (-1: not there)."""

    fit: Fit
    ids: Ids
    named: Ids


def left_behind(branch: Branch, old: Estimate) -> Exile:
    """What a family leaves behind when it flees."""
    stones = Estimate(
        old.pose, old.pose_cov, old.ids[old.stone], old.landmarks[old.stone], old.covs[old.stone], old.stone[old.stone]
    )
    exist = np.array([branch.ledger[i].exist for i in stones.ids.tolist()])
    return Exile(branch, stones, exist)


def way_home(king: King, away: Exile, here: Estimate, ledger: dict[int, Life], sensor: Sensor) -> Return | None:
    """Where the local map `here` lies in the old one, if that can be verified; None otherwise."""
    known = np.array([len(away.trail) < 3 or ledger[i].hits > NEVER for i in here.ids.tolist()], bool)
    q, covs, ids = here.landmarks[known], here.covs[known], here.ids[known]
    if len(q) < king.votes or len(away.old.ids) < king.votes:
        return None
    found = fits(q, covs, away.old.landmarks, np.zeros(3))
    judged = [_judged(king, fit, q, away, sensor) for fit in found]
    if not judged:
        return None
    order = np.argsort([-score for score, _ in judged], kind="stable")
    best, good = judged[order[0]]
    second = judged[order[1]][0] if len(order) > 1 else 0.0
    if not good or best - max(second, 0.0) < king.lead:
        return None
    fit = found[int(order[0])]
    named = np.where(fit.match >= 0, away.old.ids[fit.match], -1)
    return Return(fit, ids, named)


def _judged(king: King, fit: Fit, q: Array, away: Exile, sensor: Sensor) -> tuple[float, bool]:
    """Nats that speak for a fit, and whether it holds on both sides."""
    old, hit = away.old.landmarks, fit.match >= 0
    both = _covered(to_world(fit.motion, q), old) | hit
    chance = _seen(sensor, [compose(fit.motion, pose) for pose in away.trail], old) * away.exist
    due = chance > SURE
    met = np.zeros(len(old), bool)
    met[fit.match[hit]] = True
    missing = due & ~met
    score = fit.gain + float(np.maximum(np.log1p(-np.minimum(chance[missing], 0.999)), -MISSING).sum())
    score -= STRANGE * float(np.count_nonzero(both & ~hit))
    score += king.home * float(_at_home(king, fit, away.trail[-1]))
    enough = fit.votes >= max(king.votes, king.share * both.sum())
    return score, bool(enough and (due & met).sum() >= king.share * due.sum())


def _at_home(king: King, fit: Fit, pose: Array) -> bool:
    """The fit leaves the robot about where it believes itself."""
    moved = compose(fit.motion, pose)
    metres, radians = king.drift
    return bool(np.hypot(*(moved[:2] - pose[:2])) < metres and abs(wrap_angle(moved[2] - pose[2])) < radians)


def _covered(points: Array, old: Array) -> Mask:
    """Points that fall where the old map has landmarks: within twice the usual spacing of one."""
    from scipy.spatial import cKDTree

    covered: Mask = cKDTree(old).query(points)[0] < 2.0 * float(np.median(spacing(old)))
    return covered


def _seen(sensor: Sensor, poses: Iterable[Array], points: Array) -> Array:
    """Chance (n,) that each point would have been seen at least once from the poses."""
    unseen = np.ones(len(points))
    still = np.full((len(points), 2), 1e-4)
    for pose in poses:
        near = np.flatnonzero(np.hypot(*(points - sensor.frame(pose)[:2]).T) < sensor.max_range)
        if len(near):
            z_hat = sensor.expect(pose, points[near])[0]
            unseen[near] *= 1.0 - sensor.in_view(z_hat, still[near]) * sensor.detect
    return 1.0 - unseen


def pose_home(fit: Fit, pose: Array, cov: Array) -> tuple[Array, Array]:
    """The robot's pose in the old map, and its covariance: that of the fit and that of the pose in the new one."""
    by_fit, by_pose = compose_jacobians(fit.motion, pose)
    return compose(fit.motion, pose), by_fit @ fit.cov @ by_fit.T + by_pose @ cov @ by_pose.T
