"""The lookout: brothers who walk beside the family and know no old map, so that a wrong pose cannot talk them round.

A robot that was carried away in a dense map finds partners by chance, and every wrong pairing draws the pose to the next:
scan by scan nothing seems amiss (DLR: over half of the observations get an old name). So where the last scans are not
nearly all explained, a brother sets out who maps afresh; what he has seen in the last scans is right among itself and is
laid on the old map. If another place outweighs the one that is believed, the king carries the family there (`places`).
"""

from __future__ import annotations

import copy
import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import CERTAIN, Branch, told
from tomthumb.errors import Diverged, TomThumbError
from tomthumb.king import Exile, King, Return, Small, answered, left_behind, question, small
from tomthumb.places import Guess
from tomthumb.revision import Moment, apart_from
from tomthumb.types import Array, Control, Estimate

if TYPE_CHECKING:
    from tomthumb.slam import Slam


@dataclass(frozen=True, slots=True)
class Keeping:
    """every: scans between two looks, and between the starts of two brothers; what one has seen from before the robot was
    carried away is of no use to him, so he is there for at most so many scans in vain. life: scans that a brother walks.
    content: share of the last observations with an old name from which on none sets out. long: scans ago it was given,
    that a name may be called old.
    """

    every: int = 3
    life: int = 24
    content: float = 0.8
    long: int = 80

    def __post_init__(self) -> None:
        if not (1 <= self.every <= self.life and self.content >= 0.0 and self.long >= 1):
            raise TomThumbError(f"{self}: every from 1 to life, content at least 0, long at least 1")


@dataclass(frozen=True, slots=True)
class Note:
    """A step as it was given to the loop, and what the loop's own counts and clock were before."""

    moment: Moment
    t: float
    held: Control | None
    index: int
    scan: int
    serial: int


@dataclass(slots=True)
class Walker:
    """A brother's loop, where it began, and his poses at each scan since.

    `unsettled`: when he was last asked, another place might have outweighed the one that is believed.
    """

    loop: Slam
    since: Note
    trail: list[Array] = field(default_factory=list)
    unsettled: bool = False

    @property
    def branch(self) -> Branch:
        """His map, and what he calls its landmarks."""
        return self.loop.branches[0]

    def go_along(self, moment: Moment) -> bool:
        """One step; False when his filter is lost."""
        try:
            record = self.loop.step(moment.t, moment.control, moment.observations)
        except Diverged:
            return False
        if moment.observations is not None:
            self.trail.append(record.pose)
        return True


@dataclass(frozen=True, slots=True)
class Found:
    """What a brother has found: the way to another place, and he himself."""

    way: Return
    walker: Walker
    away: Exile


@dataclass(slots=True)
class Lookout:
    """The brothers who are out, the steps since the last look, and how many of each scan's observations had old names."""

    rules: Keeping = field(default_factory=Keeping)
    recent: deque[Note] = field(default_factory=deque)
    walkers: list[Walker] = field(default_factory=list)
    named: deque[tuple[int, int]] = field(default_factory=deque)

    def before(self, slam: Slam, moment: Moment) -> None:
        """Before each step: all who are out go along."""
        held = copy.copy(slam.last_control)
        self.recent.append(Note(moment, slam.t, held, slam.index, slam.scan, slam.serial))
        while self.recent[0].scan < slam.scan - self.rules.every + 1:
            self.recent.popleft()
        self.walkers = [walker for walker in self.walkers if walker.go_along(moment)]

    def after(self, slam: Slam, king: King) -> Found | None:
        """After each scan: who sets out, who has walked enough, and what those who are asked have found: at every look
        all of them, in between who was not far from an answer.
        """
        self._count(slam)
        due = (slam.scan + 1) % self.rules.every == 0
        if due and self._discontent():
            self._set_out(slam)
        self.walkers = [walker for walker in self.walkers if len(walker.trail) <= self.rules.life]
        asked = [walker for walker in self.walkers if due or walker.unsettled]
        if not asked:
            return None
        whole = slam.estimator.estimate(slam.branches[0].belief)
        for walker in asked:
            found = ask(walker, slam, king, whole)
            if found is not None:
                return found
        return None

    def _count(self, slam: Slam) -> None:
        """How many of this scan's observations were given names of landmarks older than anybody who is out."""
        branch, oldest = slam.branches[0], slam.scan - self.rules.long
        lives = [branch.ledger.get(i) for i in branch.paired.tolist() if i not in branch.crumbs]
        self.named.append((sum(life is not None and life.born <= oldest for life in lives), len(branch.ids)))
        if len(self.named) > self.rules.every:
            self.named.popleft()

    def _discontent(self) -> bool:
        """Whether the last scans are not nearly all explained by what was known long ago."""
        return sum(old for old, _ in self.named) < self.rules.content * sum(count for _, count in self.named)

    def _set_out(self, slam: Slam) -> None:
        """A new brother, who has seen the last `every` scans."""
        walker = Walker(_loop(slam, self.recent[0]), self.recent[0])
        if all(walker.go_along(note.moment) for note in self.recent):
            self.walkers.append(walker)


def _loop(slam: Slam, since: Note) -> Slam:
    """A loop without a map that begins before the step of `since`, with the family's counts and clock."""
    loop = apart_from(slam, Branch(slam.estimator.init(np.zeros(3), CERTAIN, copy.deepcopy(slam.rng_estimator)), {}))
    loop.teacher, loop.teach_steps, loop.width, loop.moved = None, 0, 1, math.inf
    loop.t, loop.last_control, loop.index, loop.scan, loop.serial = (
        since.t, since.held, since.index, since.scan, since.serial,
    )  # fmt: skip
    return loop


def ask(walker: Walker, slam: Slam, king: King, whole: Estimate) -> Found | None:
    """The place that a brother has found, if it is another one than the family believes; `whole`: what it believes."""
    away, mine, guess = asked_of(walker, slam, king, whole)
    asked = question(king, away, mine, guess, slam.sensor, slam.detection)
    walker.unsettled = asked is not None
    way = None if asked is None else answered(king, asked)
    return None if way is None or way.expected else Found(way, walker, away)


def asked_of(walker: Walker, slam: Slam, king: King, whole: Estimate) -> tuple[Exile, Small, Guess]:
    """The old map that a brother is asked about, his own, and where the family believes to be.

    He set out up to `every` scans after the robot was carried away. What the family has founded since then stands
    where it would have it, be it right or wrong, and says nothing of which it is: that is not asked.
    """
    home = slam.branches[0]
    before = walker.since.scan - slam.court.lookout.rules.every + 1
    old = np.array([home.ledger[i].born < before for i in whole.ids.tolist()], bool)
    away = left_behind(home, whole.only(old))
    away.trail = walker.trail
    here = walker.loop.estimator.estimate(walker.branch.belief)
    guess = Guess(whole.pose, whole.pose_cov, 1.0 - math.exp(-king.rare), slam.court.watch.doubtful)
    return away, small(here, walker.branch.ledger, slam.scan), guess


def spliced(home: Branch, walker: Walker, index: int) -> Branch:
    """The brother's branch with the family's past before him; this step's own entry is still to come."""
    history: Any = home.history
    for _ in range(index - walker.since.index):
        history = history[0]
    nodes = []
    node = walker.branch.history
    while node is not None:
        nodes.append(node)
        node = node[0]
    for _, ids, pose, scan in reversed(nodes[1:]):
        history = (history, ids, pose, scan)
    walker.branch.history = history
    walker.branch.events = _joined(home, walker)
    return walker.branch


def _joined(home: Branch, walker: Walker) -> Any:
    """What became of landmarks: of the old ones as the family has it, of those founded since as the brother has."""
    young = range(walker.since.serial, walker.loop.serial)
    events: Any = None
    for kind, one, other, step in told(home):
        if one not in young:  # an old one that went into a young one of the family's is gone with that
            merged = kind == "merged" and other not in young
            events = (events, "merged" if merged else "died", one, other if merged else -1, step)
    for event in told(walker.branch):
        events = (events, *event)
    return events
