"""Pose basins: hypotheses with the pose that each implies, found by anchored flights over the rigid motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from tomthumb.associators.tom_thumb.scene import NO_LABELS, Rigid, Window
from tomthumb.kernels import flights, motion
from tomthumb.kernels.grid import fill_grid
from tomthumb.types import Array, Ids

POLISHED = 4  # basins, best first, whose assignment is made optimal
BEHIND = 15.0  # nats behind the best L at which a vote is not refined; twice that behind the best vote, not counted out


@dataclass(frozen=True, slots=True)
class Basin:
    """One pose basin: its best hypothesis, L, and the gains of all listed pairings given the others.

    `pose (3,)` and its inverse covariance `M (3, 3)` where the search went over poses.
    """

    match: Ids
    value: float
    gains: Array
    window: Window
    pose: Array | None = None
    M: Array | None = None


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is flown: anchors (pairs of observations), basins kept, poses tried; basins `reach` nats behind are dropped."""

    anchors: int
    basins: int
    poses: int
    reach: float


def anchored(s: Rigid, near: Window, gate2: float, gate3: float, budget: Budget) -> tuple[list[Basin], dict[str, Any]]:
    """Poses from anchors, refined; one basin for each distinct pose, best first.

    `near`: candidates of the anchors. gate2, gate3: chi-square values of 2 (a pairing) and 3 (a pose by the prior) dof.
    """
    W, gain, worth, cell, apart, pairs, tolerance = flights.ready(
        s.q, s.R, s.D, s.base, s.odds, near.counts, budget.anchors
    )
    grid = fill_grid(s.p, cell)
    side, table = flights.nearness(s.p, *grid[:3], pairs, near.counts)
    poses, scores, tried, used = flights.explore(
        s.q, W, gain, pairs, tolerance, near.start, near.columns, s.p, worth, s.prior, gate3, *grid, side, table, apart,
        budget.basins, budget.poses, 2.0 * BEHIND,
    )  # fmt: skip
    kept = np.isfinite(scores)
    poses, votes = np.concatenate([poses[kept], np.zeros((1, 3))]), np.append(scores[kept], np.inf)
    reach = motion.reaches(s.R, s.D, gate2)
    seen = (reach, s.p, *grid, NO_LABELS if s.allowed is None else s.allowed)
    args = (s.q, s.R, s.p, s.D, s.base, s.odds)
    ends, Ms, matches, values = motion.descend(
        poses, votes, *args, s.prior, reach, *seen[2:], gate2, apart, 3, BEHIND
    )  # fmt: skip
    found: list[Basin] = []
    for k in _leaders(matches, values, budget.reach):
        listed = Window(*motion.local_candidates(poses[k], s.q, *seen))
        basin = _looked_over(s, ends[k], Ms[k], matches[k], values[k], listed, gate2)
        found.append(untangled(s, basin) if len(found) < POLISHED else basin)
    return found, {"poses": tried, "anchors": used, "proof": "truncated"}


def _leaders(matches: Ids, values: Array, reach: float) -> list[int]:
    """Rows within `reach` nats of the best, best first, each hypothesis once."""
    kept: list[int] = []
    near = np.flatnonzero(values >= values.max() - reach)
    for k in near[np.argsort(-values[near], kind="stable")]:
        if not any(np.array_equal(matches[k], matches[r]) for r in kept):
            kept.append(int(k))
    return kept


def _looked_over(s: Rigid, pose: Array, M: Array, match: Ids, value: float, near: Window, gate2: float) -> Basin:
    """A hypothesis with the gains of all its window's pairings; `value` and those by place, looks come to both."""
    args = (s.q, s.R, s.p, s.D, s.base, s.odds)
    gains = motion.left_out_gains(pose, M, match, *args, near.start, near.columns, gate2)
    return Basin(match, value + s.of_match(match), gains + s.of_looks(near), near, pose, M)


def at_pose(s: Rigid, basin: Basin, gate2: float) -> Basin:
    """A hypothesis from the full covariance, with the pose that it implies."""
    near, args = basin.window, (s.q, s.R, s.p, s.D, s.base, s.odds)
    pose, M, value, gains = motion.place(basin.match, *args, s.prior, near.start, near.columns, gate2)
    return Basin(basin.match, value + s.of_match(basin.match), gains + s.of_looks(near), near, pose, M)


def untangled(s: Rigid, basin: Basin) -> Basin:
    """The basin with the best assignment at its pose, and the pose of that, until it stays: greedy leaves pairs swapped."""
    assert basin.pose is not None
    args = (s.q, s.R, s.p, s.D, s.base, s.odds)
    near, pose, best = basin.window, basin.pose, basin
    for _ in range(3):
        gains = motion.pose_gains(pose, np.zeros((3, 3)), *args, near.start, near.columns, np.inf) + s.of_looks(near)
        if motion.uncontested(gains, near.start, near.columns, best.match):
            break
        match = assigned(gains, near)
        if np.array_equal(match, best.match):
            break
        pose, M, value = motion.fit(pose, match, *args, s.prior, 2)
        if value + s.of_match(match) <= best.value:
            break
        best = _looked_over(s, pose, M, match, value, near, np.inf)
    return best


def assigned(gains: Array, near: Window) -> Ids:
    """The one-to-one match of greatest total gain over the listed pairings; a pairing without gain is left out."""
    names, table = motion.worth(gains, near.start, near.columns)
    rows, picked = linear_sum_assignment(table, maximize=True)
    match = np.full(len(table), -1, np.int64)
    good = table[rows, picked] > 0.0
    match[rows[good]] = names[picked[good]]
    return match


def distinct(found: list[Basin], reach: float) -> list[Basin]:
    """Basins within `reach` nats of the best, best first, each hypothesis once."""
    ranked = sorted(found, key=lambda b: -b.value)
    kept: list[Basin] = []
    for basin in ranked:
        if basin.value < ranked[0].value - reach:
            break
        if not any(np.array_equal(basin.match, other.match) for other in kept):
            kept.append(basin)
    return kept
