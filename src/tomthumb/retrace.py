"""The trail gone over again: the whole run filtered once more with names that are known better now.

When a loop is closed late, what was mapped in between hangs on a wrong pose, and the filter is sure of it: to carry the
robot over leaves a torn map behind. Where all that was given to the loop is kept, the filter can go through it again
with the names that the closed loop implies, and no linearisation or covariance of the wrong past is left.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import Branch, Scan
from tomthumb.types import Array, Control, Ids

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
    """The belief that the run began with, and all that was given to it since."""

    start: Any = None
    entries: list[Entry] = field(default_factory=list)


def retrace(slam: Slam, diary: Diary, names: Sequence[Ids], keep: set[int]) -> tuple[Any, list[Array]]:
    """The belief after all entries of the diary with each entry's `names`, and the pose (3,) after each.

    Landmarks of `keep` are founded as stones when they are first named; all other names are passed over.
    """
    walker = copy.copy(slam)
    branch = Branch(slam.estimator.fork(diary.start), {})
    walker.branches, walker.t, walker.last_control, walker.moved = [branch], -math.inf, None, math.inf
    have = set(slam.estimator.estimate(branch.belief).ids.tolist())
    poses = []
    for entry, ids in zip(diary.entries, names, strict=True):
        walker._predict(branch, entry.t, entry.control)
        walker.t = entry.t
        if entry.scan is not None and len(entry.scan):
            _take_in(walker, branch, entry.scan, np.where(np.isin(ids, list(keep)), ids, -1), have)
        poses.append(slam.estimator.pose(branch.belief)[0])
    return branch.belief, poses


def _take_in(walker: Slam, branch: Branch, scan: Scan, ids: Ids, have: set[int]) -> None:
    estimator = walker.estimator
    known = np.isin(ids, list(have))
    times = len(estimator.expect(branch.belief))
    branch.belief = estimator.update(
        branch.belief, scan.news, [np.where(known, ids, -1)] * times, walker.rng_estimator
    )
    fresh = np.where(known, -1, ids)
    if (fresh >= 0).any():
        branch.belief = estimator.add(branch.belief, scan.raw, [fresh] * times, walker.rng_estimator)
        branch.belief = estimator.promote(branch.belief, fresh[fresh >= 0])
        have.update(fresh[fresh >= 0].tolist())
