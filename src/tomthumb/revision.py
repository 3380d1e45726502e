"""Revision: when the evidence turns, the last scans are named again from the newest good checkpoint.

A pairing that was the best one when it was made may look wrong ten scans later. From the last moment at which all was
well the scans since are taken in again with up to eight hypotheses side by side, and that past is kept if it explains
the scans better by more than `gain` nats.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, is_dataclass, replace
from typing import TYPE_CHECKING

from tomthumb.branches import Branch
from tomthumb.errors import Diverged
from tomthumb.lifecycle import copy_ledger
from tomthumb.types import Control, Observations

if TYPE_CHECKING:
    from tomthumb.slam import Slam


@dataclass(frozen=True, slots=True)
class Moment:
    """What was given to `Slam.step`."""

    t: float
    control: Control | None
    observations: Observations | None


@dataclass(slots=True)
class Checkpoint:
    """A twin of the loop at a good moment (it shares nothing that changes), and what has come since, `scans` of them."""

    twin: Slam
    since: list[Moment] = field(default_factory=list)
    scans: int = 0

    def note(self, moment: Moment) -> None:
        """One moment more."""
        self.since.append(moment)
        self.scans += moment.observations is not None


@dataclass(slots=True)
class Revision:
    """window: scans that a checkpoint may lie back, 0: none are made. every: scans between two. brothers: hypotheses
    side by side when the past is gone through again. gain: nats by which a new past must be better. revised: how
    often it was.
    """

    window: int = 0
    every: int = 5
    brothers: int = 8
    gain: float = 3.0
    newest: Checkpoint | None = None
    older: Checkpoint | None = None
    good: bool = True
    revised: int = 0

    def before(self, slam: Slam, moment: Moment, well: bool) -> None:
        """Before a step: a checkpoint where all is well and the last one is `every` scans old; the step is noted.

        None outlives an exile: the map of the time away and the one that was left have frames of their own.
        """
        if not self.window:
            return
        if slam.court.exile is not None:
            self.older = self.newest = None
            return
        if self.newest is None or (well and self.newest.scans >= self.every):
            self.older, self.newest = self.newest, Checkpoint(twin_of(slam))
        if self.newest.scans >= self.window:
            self.older, self.newest = None, Checkpoint(twin_of(slam))
        for point in (self.older, self.newest):
            if point is not None:
                point.note(moment)

    def after(self, slam: Slam) -> None:
        """After a step: where the evidence has just turned, the past is gone through again."""
        turned = self.good and not slam.court.well
        self.good = slam.court.well
        if self.window and turned and slam.court.exile is None:
            best = self._better_past(slam)
            if best is not None:
                slam.branches, self.revised = [best], self.revised + 1

    def _better_past(self, slam: Slam) -> Branch | None:
        """The last scans gone through again from the older checkpoint; its best branch, if that explains them better."""
        point = self.older or self.newest
        if point is None:
            return None
        twin = point.twin
        twin.width = self.brothers
        if is_dataclass(twin.associator) and hasattr(twin.associator, "brothers"):
            twin.associator = replace(twin.associator, brothers=self.brothers)
        self.older = self.newest = None
        try:
            for moment in point.since:
                twin.step(moment.t, moment.control, moment.observations)
        except Diverged:
            return None  # that past leads nowhere: what has happened stands
        best = twin.branches[0]
        return best if best.evidence > slam.branches[0].evidence + self.gain else None


def twin_of(slam: Slam) -> Slam:
    """The loop as it is, to go on by itself: one branch, no king, no revision, a random stream of its own."""
    best = slam.branches[0]
    belief = slam.estimator.fork(best.belief)
    return apart_from(slam, replace(best, belief=belief, ledger=copy_ledger(best.ledger), crumbs=set(best.crumbs)))


def apart_from(slam: Slam, branch: Branch) -> Slam:
    """The loop with this branch alone, which shares nothing with it that changes."""
    twin = copy.copy(slam)
    twin.branches = [branch]
    for name in ("clutter", "detection", "surprise", "crowd"):
        setattr(twin, name, copy.deepcopy(getattr(slam, name)))
    twin.rng_estimator, twin.rng_associator = (copy.deepcopy(rng) for rng in (slam.rng_estimator, slam.rng_associator))
    twin.associator = copy.deepcopy(slam.associator)  # its memory too: the past must not be learnt twice
    twin.court, twin.revision = type(slam.court)(None), Revision()
    return twin
