"""The trail gone over again: all that was given to the loop, filtered once more with names that are known better now.

When a loop is closed late, what was mapped in between hangs on a wrong pose, and the filter is sure of it: to carry the
robot over leaves a torn map behind. Gone through again with the names that the closed loop implies, no linearisation and
no covariance of the wrong past is left.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import Branch, Scan
from tomthumb.doubt import untried_of
from tomthumb.errors import Diverged
from tomthumb.geometry import wrapped
from tomthumb.graves import Graveyard
from tomthumb.kernels.gates import paired_distances
from tomthumb.lifecycle import Life
from tomthumb.types import Array, Control, Ids, Mask, Predictions
from tomthumb.watch import Consistency

if TYPE_CHECKING:
    from tomthumb.slam import Slam


@dataclass(slots=True)
class Entry:
    """What one step was given: time s, control, and the scan as the filter took it (None: there was none)."""

    t: float
    control: Control | None
    scan: Scan | None = None


@dataclass(slots=True)
class Diary:
    """The belief it begins with, when that was (t s, the control held), and all that was given to the loop since."""

    start: Any
    t: float = -math.inf
    held: Control | None = None
    entries: list[Entry] = field(default_factory=list)


def begun(slam: Slam) -> Diary:
    """A diary that begins here."""
    return Diary(slam.estimator.fork(slam.branches[0].belief), slam.t, slam.last_control)


def retraced(
    slam: Slam,
    diary: Diary,
    names: Sequence[Ids],
    lives: Mapping[int, Life],
    tear: float = math.inf,
    claimed: Sequence[Mask] | None = None,
) -> Branch:
    """The best branch after all entries of the diary with each entry's `names`; `lives` are the landmarks it will hold.

    Landmarks are founded as stones when they are first named; names without a life are passed over. Raises Diverged if the
    filter does not survive the names, or if the NIS of ten scans is `tear` standard deviations above what it should be.
    `claimed`: masks (m,), entry by entry, of the names that must hold (None: all). Of the others the filter leaves out those
    that the trail refutes, so that they do not tear it; the names themselves stay, in the history and in the lives.
    """
    claimed = [np.ones(len(ids), bool) for ids in names] if claimed is None else claimed
    belief, poses = _filtered(slam, diary, names, set(lives), tear, claimed)
    best = slam.branches[0]
    held = set(slam.estimator.estimate(belief).ids.tolist())
    ledger = {i: life for i, life in lives.items() if i in held}
    events = best.events
    for i in sorted(set(best.ledger) - set(ledger)):
        events = (events, "died", i, -1, slam.index)
    paired = np.where(np.isin(names[-1], list(ledger)), names[-1], -1)
    return replace(
        best, belief=belief, ledger=ledger, crumbs=set(), graves=Graveyard(), events=events,
        untried=untried_of(ledger, ledger, slam.policy),
        history=_rewritten(best.history, names[:-1], poses[:-1]), ids=names[-1], paired=paired,
    )  # fmt: skip


def _rewritten(history: Any, names: Sequence[Ids], poses: Sequence[Array]) -> Any:
    """A history whose last entries have these names and poses."""
    scans = []
    for _ in names:
        history, _, _, scan = history
        scans.append(scan)
    for ids, pose, scan in zip(names, poses, reversed(scans), strict=True):
        history = (history, ids, pose, scan)
    return history


def _filtered(
    slam: Slam, diary: Diary, names: Sequence[Ids], kept: set[int], tear: float, claimed: Sequence[Mask]
) -> tuple[Any, list[Array]]:
    """The belief at the end, and the pose (3,) after each entry."""
    walker = copy.copy(slam)
    walker.rng_estimator = copy.deepcopy(slam.rng_estimator)  # if this comes to nothing, nothing has happened
    branch = Branch(slam.estimator.fork(diary.start), {})
    walker.branches, walker.t, walker.last_control = [branch], diary.t, diary.held
    held = set(slam.estimator.estimate(branch.belief).ids.tolist())
    if held - kept:
        branch.belief = slam.estimator.forget(branch.belief, np.array(sorted(held - kept), np.int64))
    poses, consistency = [], Consistency()
    for entry, ids, sure in zip(diary.entries, names, claimed, strict=True):
        walker.predict(branch, entry.t, entry.control)
        walker.t = entry.t
        if entry.scan is not None and len(entry.scan):
            mine = np.where(np.isin(ids, list(kept)), ids, -1)
            nis, dof = _take_in(walker, branch, entry.scan, mine, held, sure)
            consistency.record(nis, dof)
            if consistency.excess > tear:
                raise Diverged(f"the trail tears at {entry.t} s: it cannot be gone over with these names")
        poses.append(slam.estimator.pose(branch.belief)[0])
    return branch.belief, poses


def _take_in(walker: Slam, branch: Branch, scan: Scan, ids: Ids, held: set[int], sure: Mask) -> tuple[float, int]:
    """One scan: known landmarks move the pose, new ones are founded and believed. NIS and degrees of freedom."""
    estimator, rng = walker.estimator, walker.rng_estimator
    known = np.isin(ids, list(held))
    every = estimator.expect(branch.belief)
    taken = known & (sure | ~_refuted(walker, every[0], scan, np.where(known & ~sure, ids, -1)))
    branch.belief = estimator.update(branch.belief, scan.news, [np.where(taken, ids, -1)] * len(every), rng)
    stats = estimator.stats(branch.belief) if taken.any() else {}
    fresh = np.where(known, -1, ids)
    if (fresh >= 0).any():
        branch.belief = estimator.add(branch.belief, scan.raw, [fresh] * len(every), rng)
        branch.belief = estimator.promote(branch.belief, fresh[fresh >= 0])
        held.update(fresh[fresh >= 0].tolist())
    return float(stats.get("nis", 0.0)), int(stats.get("dof", 0))


def _refuted(walker: Slam, predictions: Predictions, scan: Scan, ids: Ids) -> Mask:
    """Names (m,) so far from where their landmarks are now expected, by the first particle, that no scan would have been given
    them, or not expected at all; not -1.
    """
    column = {i: k for k, i in enumerate(predictions.ids.tolist())}
    match = np.array([column.get(i, -1) for i in ids.tolist()], np.int64)
    d2 = np.inf + np.zeros(len(ids))
    rows = np.flatnonzero(match >= 0)
    if len(rows):
        flags = wrapped(walker.sensor.angles)
        d2[rows] = paired_distances(
            scan.honest.z, scan.honest.R, predictions.z_hat, predictions.cov, rows, match[rows], flags
        )
    out: Mask = (ids >= 0) & (d2 >= walker.policy.apart2)
    return out
