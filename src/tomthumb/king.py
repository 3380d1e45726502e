"""The king: a family that is lost maps where it is, until that small map fits into the old one; then he carries it home.

    flee      the watch says that the pose is wrong: the old map is put aside, a new one begun where the robot stands
    seek      after each scan the new map is laid on the old one as a constellation
    verify    one place outweighs all the others, and that the robot is nowhere on the map (`places`)
    home      the robot is put where the fit says, what it has met is merged into the old map

A kidnapped robot, a start at an unknown place of a known map, and a filter that has gone astray are one and the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import Fit, fits, fitted, perfect
from tomthumb.geometry import compose, compose_jacobians, inverse
from tomthumb.lifecycle import Ledger
from tomthumb.places import Guess, Local, as_believed, clear, most_elsewhere, stones, unknown, view, weighed
from tomthumb.protocols import Sensor
from tomthumb.sensing import DetectionMap
from tomthumb.types import Array, Estimate, Ids, Mask

LEAST = 4  # landmarks, and pairs: two give a motion, and one more would be no proof of it


@dataclass(frozen=True, slots=True)
class King:
    """When a place is believed; reasons in docs/lost.md.

    lead: nats by which it must outweigh all else together. rare: nats against having been carried away, for a robot that
    has not fled. every: scans between two attempts of one that has.
    """

    lead: float = 10.0
    rare: float = 12.0
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
    """A verified way home: `fit` of the local landmarks `ids (k,)` on the old ones `named (k,)` (-1: not there).

    `expected`: it leads where the robot is believed to be.
    """

    fit: Fit
    ids: Ids
    named: Ids
    expected: bool = False


def left_behind(branch: Branch, old: Estimate) -> Exile:
    """What a family leaves behind when it flees."""
    rocks = old.only(old.stone)
    exist = np.array([branch.ledger[i].exist for i in rocks.ids.tolist()])
    return Exile(branch, rocks, exist)


def way_home(
    king: King, away: Exile, here: Estimate, ledger: Ledger, guess: Guess, sensor: Sensor, detection: DetectionMap
) -> Return | None:
    """Where the local map `here` lies in the old one, if that can be verified; None otherwise. `guess`: where the robot
    is believed to be in the old map.
    """
    part = here.only(_seen_again(here, ledger, len(away.trail)))
    if min(len(part.ids), len(away.old.ids)) < LEAST:
        return None
    q, covs, old = part.landmarks, part.covs, stones(away.old.landmarks, away.exist)
    most = most_elsewhere(perfect(q, covs, old.points), old, guess)
    if guess.weight > 0.5 and most - guess.odds[1] < king.lead:
        return None
    local = Local(q, here.pose, view(sensor, detection, away.trail, q))
    believed, rest = compose(guess.pose, inverse(local.pose)), unknown(local, old, guess)
    if guess.weight > 0.5 and most < king.lead + max([rest, *weighed([fitted(q, covs, old.points, believed)], local, old, guess)]):
        return None
    found = [fit for fit in fits(q, covs, old.points, believed) if fit.votes >= LEAST]
    chosen = clear(weighed(found, local, old, guess), rest, king.lead)
    if chosen is None:
        return None
    fit = found[chosen]
    named = np.where(fit.match >= 0, away.old.ids[fit.match], -1)
    return Return(fit, part.ids, named, as_believed(fit, local, old, guess))


def _seen_again(here: Estimate, ledger: Ledger, scans: int) -> Mask:
    """Local landmarks that are no single sightings, once there has been time to see them again."""
    return np.array([scans < 3 or ledger[i].hits > 1.0 for i in here.ids.tolist()], bool)


def pose_home(fit: Fit, pose: Array, cov: Array) -> tuple[Array, Array]:
    """The robot's pose in the old map, and its covariance: that of the fit and that of the pose in the new one."""
    by_fit, by_pose = compose_jacobians(fit.motion, pose)
    return compose(fit.motion, pose), by_fit @ fit.cov @ by_fit.T + by_pose @ cov @ by_pose.T
