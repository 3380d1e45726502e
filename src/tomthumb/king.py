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
POSES = 40  # of the trail, at least where it has so many, from which a place is judged: each costs a look at the map
NEVER = 1.0  # no hit that is one: what is known from before may stand here


@dataclass(frozen=True, slots=True)
class King:
    """When a fit is believed; reasons in docs/stt.md.

    votes: pairs at least, and `share` of the landmarks that both maps ought to have. lead: nats before the next place,
    whose votes must weigh less than `rival` of the best one's. home: nats in favour of the place where the robot believes
    itself, by its covariance and `drift` (m, rad); there a rival is no hindrance. every: scans between two attempts.
    """

    votes: int = 8
    share: float = 0.7
    lead: float = 10.0
    rival: float = 0.75
    home: float = 12.0
    drift: tuple[float, float] = (0.05, 0.03)
    every: int = 1


@dataclass(slots=True)
class Exile:
    """A family away from home: the branch it left, the old map's stones, and where it has scanned since (new frame).

    `exist` (n,) of the stones; `believed`: whether anything is known of where it is.
    """

    home: Branch
    old: Estimate
    exist: Array
    believed: bool = True
    trail: list[Array] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Return:
    """A verified way home: `fit` of the local landmarks `ids (k,)` on the old ones `named (k,)` (-1: not there)."""

    fit: Fit
    ids: Ids
    named: Ids


def left_behind(branch: Branch, old: Estimate) -> Exile:
    """What a family leaves behind when it flees."""
    stones = old.only(old.stone)
    exist = np.array([branch.ledger[i].exist for i in stones.ids.tolist()])
    return Exile(branch, stones, exist)


def way_home(king: King, away: Exile, here: Estimate, ledger: dict[int, Life], sensor: Sensor) -> Return | None:
    """Where the local map `here` lies in the old one, if that can be verified; None otherwise."""
    known = np.array([len(away.trail) < 3 or ledger[i].hits > NEVER for i in here.ids.tolist()], bool)
    q, covs, ids = here.landmarks[known], here.covs[known], here.ids[known]
    if len(q) < king.votes or len(away.old.ids) < king.votes:
        return None
    return best_way(king, fits(q, covs, away.old.landmarks, np.zeros(3)), q, ids, away, sensor)


def best_way(king: King, found: list[Fit], q: Array, ids: Ids, away: Exile, sensor: Sensor) -> Return | None:
    """The fit of the local landmarks q (k, 2) with `ids (k,)` that is good and has no rival, if there is one."""
    chosen = clear(king, [judged(king, fit, q, away, sensor) for fit in found])
    if chosen is None:
        return None
    fit = found[chosen]
    return Return(fit, ids, np.where(fit.match >= 0, away.old.ids[fit.match], -1))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Nats that speak for a place: by its votes alone, and in all; whether it holds on both sides, and is at home."""

    gain: float
    score: float
    holds: bool
    home: bool


def clear(king: King, verdicts: list[Verdict]) -> int | None:
    """The place that is good and has no rival, if there is one."""
    order = sorted(range(len(verdicts)), key=lambda k: -verdicts[k].score)
    if not order or not verdicts[order[0]].holds:
        return None
    best, others = verdicts[order[0]], [verdicts[k] for k in order[1:]]
    if any(best.score - other.score < king.lead for other in others) or best.score < king.lead:
        return None
    alone = best.home or all(other.gain < king.rival * best.gain for other in others)
    return order[0] if alone else None


def judged(king: King, fit: Fit, q: Array, away: Exile, sensor: Sensor) -> Verdict:
    old, hit = away.old.landmarks, fit.match >= 0
    both = _covered(to_world(fit.motion, q), old) | hit
    chance = _seen(sensor, [compose(fit.motion, pose) for pose in thinned(away.trail, POSES)], old) * away.exist
    due = chance > SURE
    met = np.zeros(len(old), bool)
    met[fit.match[hit]] = True
    missing = due & ~met
    score = fit.gain + float(np.maximum(np.log1p(-np.minimum(chance[missing], 0.999)), -MISSING).sum())
    score -= STRANGE * float(np.count_nonzero(both & ~hit))
    bonus = king.home - 0.5 * _from_home(king, fit, away) if away.believed else 0.0
    enough = fit.votes >= max(king.votes, king.share * both.sum())
    holds = bool(enough and (due & met).sum() >= king.share * due.sum())
    return Verdict(fit.gain, score + max(bonus, 0.0), holds, bonus > 0.0)


def thinned(poses: list[Array], wanted: int) -> list[Array]:
    """Every so many-th pose, the last one among them: `wanted` of them to twice as many, or all."""
    return poses[:: -max(1, len(poses) // wanted)][::-1]


def _from_home(king: King, fit: Fit, away: Exile) -> float:
    """Squared distance of the pose that the fit gives from the one that was believed, by its covariance times 9."""
    pose, (metres, radians) = away.trail[-1], king.drift
    gap = compose(fit.motion, pose) - pose
    gap[2] = wrap_angle(gap[2])
    spread = 9.0 * away.old.pose_cov + np.diag([metres, metres, radians]) ** 2
    return float(gap @ np.linalg.solve(spread, gap))


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
