"""Landmarks that were believed before their trial go back on it, where most of what is tried turns out not to stand.

The first scan of a map is believed at once, and two sightings are enough while few stones are in view: a pose needs something
to hang on. Among people some of that has walked away before it could be told from the rest, and nobody comes back to the place
until the loop closes, where it is just what others are mistaken for.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tomthumb.lifecycle import Ledger, LifeCycle
from tomthumb.types import Ids


@dataclass(frozen=True, slots=True)
class Trials:
    """How the trials of a map's crumbs ended so far: in a stone, which counts once for each, or in nothing."""

    stood: int = 0
    faded: int = 0

    def and_ended(self, stood: int = 0, faded: int = 0) -> Trials:
        """So many more."""
        return replace(self, stood=self.stood + stood, faded=self.faded + faded)

    @property
    def share(self) -> float:
        """The next one's chance to end in a stone, by Laplace's rule of succession."""
        return (self.stood + 1.0) / (self.stood + self.faded + 2.0)


def mostly_stands(trials: Trials, policy: LifeCycle) -> bool:
    """Whether what is new is known to stand in more than `policy.doubt` of the cases: no passers-by, and no clutter."""
    return trials.share > policy.doubt


def untried_of(ledger: Ledger, some: Iterable[int], policy: LifeCycle) -> frozenset[int]:
    """Those with less than `policy.hits` static sightings. What was given up and came back has been tried before."""
    lives = ((i, ledger[i]) for i in some if i in ledger)
    return frozenset(i for i, life in lives if life.static < policy.hits and life.returned is None)


def put_on_trial(
    ledger: Ledger, crumbs: set[int], untried: Iterable[int], hit: Sequence[int], trials: Trials, policy: LifeCycle
) -> Ids:
    """Those of the stones `untried` that still are, when a scan shows `policy.anchors` stones that have been tried and so hold
    the pose: their lives say from now on that they were believed, and they are to be crumbs again.

    `hit`: landmarks named in this scan. What is among them has just moved the pose, and is not doubted yet.
    """
    if not untried or policy.reference or trials.share >= policy.doubt:
        return np.empty(0, np.int64)
    firm = [i for i in hit if i in ledger and i not in crumbs and ledger[i].static >= policy.hits]
    if len(firm) < max(policy.anchors, 1):
        return np.empty(0, np.int64)
    doubted = sorted(untried_of(ledger, untried, policy) - crumbs - set(hit))
    for i in doubted:
        ledger[i].believed = True
    return np.array(doubted, np.int64)
