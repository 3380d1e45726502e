"""The king: a family that is lost maps where it is, until that small map fits into the old one; then he carries it home.

    flee      the watch says that the pose is wrong: the old map is put aside, a new one begun where the robot stands
    seek      after each scan the new map is laid on the old one as a constellation
    verify    one place outweighs all the others, and that the robot is nowhere on the map (`places`)
    home      the robot is put where the fit says, what it has met is merged into the old map

A kidnapped robot, a start at an unknown place of a known map, and a filter that has gone astray are one and the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tomthumb.branches import Branch
from tomthumb.constellation import Fit, fits, fitted, perfect, shares, shares_at_most, standing
from tomthumb.errors import TomThumbError
from tomthumb.geometry import compose, compose_jacobians, inverse, to_world, wrap_angle
from tomthumb.lifecycle import Ledger
from tomthumb.places import (
    Guess,
    Local,
    Stones,
    bare,
    clear,
    copied,
    most_elsewhere,
    stones,
    view,
    weighed,
)
from tomthumb.protocols import Sensor
from tomthumb.sensing import DetectionMap
from tomthumb.types import Array, Estimate, Ids, Mask

LATELY = 5  # scans: what was seen in them is here
NEAR = 16.27  # chi-square, 3 degrees of freedom, 99.9 %
LEAST = 4  # landmarks, and pairs: two give a motion, and one more would be no proof of it


@dataclass(frozen=True, slots=True)
class King:
    """When a place is believed; reasons in docs/lost.md.

    lead: nats by which it must outweigh all else together, one error in 1000; no rival's pairs may weigh `rival` of its
    own. rare: nats against having been carried away, for a robot that has not fled. every: scans between two attempts of
    one that has.
    """

    lead: float = 7.0
    rival: float = 0.8
    rare: float = 12.0
    every: int = 1

    def __post_init__(self) -> None:
        if not (0.0 < self.rare <= 30.0 and self.lead > 0.0 and 0.0 < self.rival <= 1.0 and self.every >= 1):
            raise TomThumbError(f"{self}: lead above 0, rival in (0, 1], rare in (0, 30] nats, every at least 1")


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

    `expected`: it leads where the robot is believed to be, within the gate of that pose or by the same pairs.
    """

    fit: Fit
    ids: Ids
    named: Ids
    expected: bool = False


@dataclass(frozen=True, slots=True)
class Small:
    """The map of the time away, and which of its landmarks (k,) were seen lately: the robot is there, not where it was."""

    part: Estimate
    lately: Mask


@dataclass(frozen=True, slots=True)
class Question:
    """Where does the map `here` lie on the stones `old`? `believed` (3,) is the motion by which the robot is where it is
    believed to be, `beside` the fits there and next to it, `stay` their log weight; `new` (k,) are landmarks that would
    then lie where nothing is known.
    """

    away: Exile
    here: Small
    guess: Guess
    old: Stones
    local: Local
    believed: Array
    beside: list[Fit]
    new: Mask
    stay: float


def left_behind(branch: Branch, old: Estimate) -> Exile:
    """What a family leaves behind when it flees."""
    rocks = old.only(old.stone)
    exist = np.array([branch.ledger[i].exist for i in rocks.ids.tolist()])
    return Exile(branch, rocks, exist)


def way_home(
    king: King, away: Exile, here: Small, guess: Guess, sensor: Sensor, detection: DetectionMap
) -> Return | None:
    """Where the small map `here` lies in the old one, if that can be verified; None otherwise. `guess`: where the robot
    is believed to be in the old map.
    """
    asked = question(king, away, here, guess, sensor, detection)
    return None if asked is None else answered(king, asked)


def question(
    king: King, away: Exile, here: Small, guess: Guess, sensor: Sensor, detection: DetectionMap
) -> Question | None:
    """What there is to be searched for; None where no place, be it ever so good, could outweigh what is believed."""
    q, covs = here.part.landmarks, here.part.covs
    if min(len(q), len(away.old.ids)) < LEAST or not here.lately.any():
        return None
    old = stones(away.old.landmarks, away.exist)
    best = perfect(q, covs, old.points)
    most = most_elsewhere(best, old, guess)
    if guess.firm and most < king.lead + guess.odds[1]:
        return None
    asked = posed(away, here, guess, old, sensor, detection)
    alike = copied(best, shares_at_most(covs, old.points), asked.new, old, asked.stay)
    if guess.firm and (max(asked.stay, alike) if guess.may_walk_on else asked.stay) > most - king.lead:
        return None
    return asked


def posed(away: Exile, here: Small, guess: Guess, old: Stones, sensor: Sensor, detection: DetectionMap) -> Question:
    """The question as it is, whether or not there can be an answer."""
    q, covs, pose = here.part.landmarks, here.part.covs, here.part.pose
    believed = compose(guess.pose, inverse(pose))
    new = ~old.cover(to_world(believed, q))
    local = Local(q, pose, view(sensor, detection, away.trail, q))
    beside = [make(q, covs, old.points, believed) for make in (fitted, standing)]
    return Question(away, here, guess, old, local, believed, beside, new, _staying(beside, local, old, guess))


def answered(king: King, asked: Question) -> Return | None:
    """The place that outweighs all others, and that the robot is where it is believed to be, or nowhere on the map."""
    found = found_for(asked)
    chosen = clear(*weights(found, asked), king.lead)
    if chosen is None or not holds(king, found, chosen, asked):
        return None
    fit = found[chosen]
    named = np.where(fit.match >= 0, asked.away.old.ids[fit.match], -1)
    return Return(fit, asked.here.part.ids, named, expected(fit, asked))


def found_for(asked: Question) -> list[Fit]:
    """The places that are weighed."""
    fitting = fits(asked.local.q, asked.here.part.covs, asked.old.points, asked.believed)
    return [fit for fit in fitting if fit.votes >= LEAST]


def weights(found: Sequence[Fit], asked: Question) -> tuple[Array, float]:
    """Log weights (f,) of the places, and of all else together: the believed place, as it is or as a copy, and nowhere."""
    q, covs, old, guess = asked.local.q, asked.here.part.covs, asked.old, asked.guess
    rest = [asked.stay if guess.firm else bare(asked.local, old, guess), guess.odds[1]]
    if guess.may_walk_on:
        rest += [copied(fit, shares(fit, q, covs, old.points), asked.new, old, asked.stay) for fit in found]
    return weighed(found, asked.local, old, guess), float(np.logaddexp.reduce(rest))


def holds(king: King, found: Sequence[Fit], chosen: int, asked: Question) -> bool:
    """Whether what a place explains is where the robot is now, and no other place explains as much."""
    return _is_here(found[chosen], asked.here.lately) and not _rivalled(king, found, chosen)


def _staying(beside: Sequence[Fit], local: Local, old: Stones, guess: Guess) -> float:
    """Log weight of being where the robot is believed to be, or next to it, by the best of the fits or without any."""
    best = weighed([fit for fit in beside if np.isfinite(fit.gain)], local, old, guess)
    return float(max([bare(local, old, guess), *best]))


def expected(fit: Fit, asked: Question) -> bool:
    """Whether a place is the one where the robot is believed to be: within the gate of its pose, or by the same pairs."""
    pose, cov = pose_home(fit, asked.local.pose, asked.here.part.pose_cov)
    gap = pose - asked.guess.pose
    gap[2] = wrap_angle(gap[2])
    near = bool(gap @ np.linalg.solve(asked.guess.cov + cov, gap) < NEAR)
    return near or any(_same(fit, other) for other in asked.beside)


def _same(fit: Fit, other: Fit) -> bool:
    """Whether most pairs of a fit are those of the other too: then both say that the robot is in the same place."""
    return bool(2 * np.count_nonzero((fit.match >= 0) & (fit.match == other.match)) > fit.votes)


def _rivalled(king: King, found: Sequence[Fit], chosen: int) -> bool:
    """Whether another place explains the local map nearly as well, and only what it lacks speaks for the one: where the old
    map has something too much, that says nothing.
    """
    return any(fit.gain > king.rival * found[chosen].gain for k, fit in enumerate(found) if k != chosen)


def _is_here(fit: Fit, lately: Mask) -> bool:
    """Whether half of what was seen lately is part of the fit: not only of where the robot was before it was carried."""
    return bool(2 * np.count_nonzero(fit.match[lately] >= 0) >= max(int(lately.sum()), 1))


def small(here: Estimate, ledger: Ledger, scan: int) -> Small:
    """The map of the time away after that scan. What was seen once is part of it: a sensor that sees one in three has seen
    much of it once, and what is not there is weighed as a stranger (`places`).
    """
    return Small(here, np.array([ledger[i].seen > scan - LATELY for i in here.ids.tolist()], bool))


def pose_home(fit: Fit, pose: Array, cov: Array) -> tuple[Array, Array]:
    """The robot's pose in the old map, and its covariance: that of the fit and that of the pose in the new one."""
    by_fit, by_pose = compose_jacobians(fit.motion, pose)
    return compose(fit.motion, pose), by_fit @ fit.cov @ by_fit.T + by_pose @ cov @ by_pose.T
