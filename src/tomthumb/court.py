"""What the loop does when the family flees, and when the king carries it home.

`watch` says when to flee, `king` when to go home, `lookout` that the family is elsewhere; here the branches are changed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import CERTAIN, Branch, Scan, renamed, told
from tomthumb.errors import Diverged
from tomthumb.geometry import compose, rotation
from tomthumb.king import Exile, King, Return, left_behind, pose_home, small, way_home
from tomthumb.lifecycle import inherit
from tomthumb.lookout import Found, Lookout, spliced
from tomthumb.places import Guess
from tomthumb.protocols import Estimator, Rng
from tomthumb.renaming import put_right
from tomthumb.revision import Moment
from tomthumb.scout import Scout, Scouting, go_along, look, refuse, sent_out, take_notes
from tomthumb.types import Array, Estimate, Ids, Mask
from tomthumb.watch import Consistency, Watch

if TYPE_CHECKING:
    from tomthumb.slam import Slam


@dataclass(slots=True)
class Court:
    """The king and the scout, where there are any, the watch, and what was left behind when the family fled."""

    king: King | None
    scouting: Scouting | None = None
    scout: Scout | None = None
    lookout: Lookout = field(default_factory=Lookout)
    watch: Watch = field(default_factory=Watch)
    exile: Exile | None = None
    consistency: Consistency = field(default_factory=Consistency)

    @property
    def well(self) -> bool:
        """No doubt of the watch, and the filter's surprise is what it should be."""
        return not self.watch.doubtful and self.consistency.verdict != "surprised"

    def before(self, slam: Slam, moment: Moment) -> None:
        """Before each step: the scout goes along by himself. A robot that was carried has a new one, and a new diary."""
        if self.king is not None and self.exile is None and slam.index >= slam.teach_steps:
            self.lookout.before(slam, moment)
        if self.scouting is None:
            return
        if self.exile is not None:
            self.scout = None
            return
        self.scout = self.scout or sent_out(slam, self.scouting)
        if not go_along(self.scout, moment):
            self.scout = None

    def attend(self, slam: Slam, scan: Scan) -> dict[str, Any]:
        """After each scan: is all well? Flee, seek the way home, or look for a closed loop, as far as that is wanted."""
        stats = slam.estimator.stats(slam.branches[0].belief)
        self.consistency.record(float(stats.get("nis", 0.0)), int(stats.get("dof", 0)))
        told = {} if self.consistency.verdict == "fine" else {"watch": self.consistency.verdict}
        return told | self._ask_scout(slam, scan) | self._follow(slam, scan)

    def _ask_scout(self, slam: Slam, scan: Scan) -> dict[str, Any]:
        if self.scout is None:
            return {}
        take_notes(self.scout, scan)
        if slam.scan % self.scout.rules.every or slam.index < slam.teach_steps or slam.scan < self.scout.rest:
            return {}
        torn = False
        for found in look(self.scout, slam):
            try:
                slam.branches = [put_right(self.scout, slam, found)]
            except Diverged:
                torn = True  # no filter survives these names: they were wrong
                continue
            self.watch, self.scout.refused = Watch(since=slam.scan), 0
            return {"king": "loop", "votes": found.votes, "twins": len(found.same)}
        if torn:
            refuse(self.scout)
        return {}

    def _follow(self, slam: Slam, scan: Scan) -> dict[str, Any]:
        if self.king is None or slam.index < slam.teach_steps:
            return {}
        if self.exile is None and self.watch.lost:
            self.lose_the_way(slam, slam.branches[0])
            slam.found(slam.branches[0], scan)
        if self.exile is not None:
            return self._seek(slam, self.king, self.exile)
        return self._look_out(slam, self.king)

    def look(self, branch: Branch, ids: Ids, known: Mask, seen: Mask, chance: Array, count: int, scan: int) -> None:
        """The landmarks `ids` (n,) of a scan of `count`: confirmed and due, seen, and with what chance of that (n,)."""
        lives = [branch.ledger[i] for i in ids.tolist()]
        old = np.array([life.born <= self.watch.since for life in lives], bool)
        due = known & old
        exist = np.array([life.exist for life in lives])
        self.watch.look((chance * exist)[due], seen[due], count - int((seen & old).sum()), scan)

    def lose_the_way(self, slam: Slam, branch: Branch, believed: bool = True) -> None:
        """The pose of a branch is not believed any more: its map is put aside, a new one begun.

        `believed`: where the robot thinks it is may still be worth something.
        """
        self.exile, fresh = flee(slam.estimator, branch, slam.index, slam.rng_estimator)
        self.exile.believed = believed
        slam.branches, self.watch, self.lookout = [fresh], Watch(), Lookout(self.lookout.rules)
        self.scout = slam.revision.older = slam.revision.newest = None  # what they remember ends elsewhere

    def whole(self, here: Estimate) -> Estimate:
        """The estimate; while the family is away, with the old map beside the new one."""
        return here if self.exile is None else both(self.exile.old, here)

    def _seek(self, slam: Slam, king: King, away: Exile) -> dict[str, Any]:
        here = slam.branches[0]
        away.trail.append(slam.estimator.pose(here.belief)[0])
        if len(away.trail) % king.every:
            return {"king": "away"}
        now = slam.estimator.estimate(here.belief)
        guess = Guess(now.pose, away.old.pose_cov, 0.5 if away.believed else 0.0)
        mine = small(now, here.ledger, slam.scan)
        way = way_home(king, away, mine, guess, slam.sensor, slam.detection)
        if way is None:
            return {"king": "away"}
        slam.branches = [go_home(slam.estimator, away, here, way, slam.index, slam.scan, slam.policy.hits)]
        self.exile, self.watch = None, Watch(since=slam.scan)
        return {"king": "home", "votes": way.fit.votes}

    def _look_out(self, slam: Slam, king: King) -> dict[str, Any]:
        found = self.lookout.after(slam, king)
        if found is None:
            return {}
        slam.branches = [recalled(slam, found)]
        self.scout = slam.revision.older = slam.revision.newest = None  # what they remember ends elsewhere
        self.lookout, self.watch = Lookout(self.lookout.rules), Watch(since=slam.scan)
        return {"king": "home", "votes": found.way.fit.votes}


def recalled(slam: Slam, found: Found) -> Branch:
    """The family where a brother has found it to be, with his map of the time that he was out instead of its own."""
    home, walker = slam.branches[0], found.walker
    young = {i for i, life in home.ledger.items() if life.born >= walker.since.scan}
    gone = young | _never_believed(home)
    home.belief = slam.estimator.forget(home.belief, np.array(sorted(gone), np.int64))
    home.crumbs -= gone
    for i in gone:
        del home.ledger[i]
    here = spliced(home, walker, slam.index)
    ended = {one for _, one, *_ in told(here)}
    for i in sorted(gone - here.ledger.keys() - ended):
        here.events = (here.events, "died", i, -1, slam.index)
    return go_home(slam.estimator, found.away, here, found.way, slam.index, slam.scan, slam.policy.hits)


def flee(estimator: Estimator[Any], branch: Branch, index: int, rng: Rng) -> tuple[Exile, Branch]:
    """The old map put aside without its crumbs, and a new branch that begins at the pose that is believed.

    Crumbs that were stones stay, and wait for their trial until the robot is back.
    """
    crumbs = np.array(sorted(_never_believed(branch)), np.int64)
    branch.belief = estimator.forget(branch.belief, crumbs)
    for i in crumbs.tolist():
        del branch.ledger[i]
        branch.events = (branch.events, "died", i, -1, index)
    branch.crumbs -= set(crumbs.tolist())
    old = estimator.estimate(branch.belief)
    fresh = Branch(estimator.init(old.pose, CERTAIN, rng), {}, history=branch.history, events=branch.events)
    return left_behind(branch, old), fresh


def _never_believed(branch: Branch) -> set[int]:
    return {i for i in branch.crumbs if not branch.ledger[i].believed}


def go_home(
    estimator: Estimator[Any], away: Exile, here: Branch, way: Return, index: int, scan: int, wanted: int
) -> Branch:
    """The old branch with the robot where `way` says, the new map's landmarks merged into it or, if firm, added.

    `wanted`: static hits that make a landmark of the new map firm.
    """
    local = estimator.estimate(here.belief)
    pose, cov = pose_home(way.fit, *estimator.pose(here.belief))
    home = away.home
    home.belief = estimator.relocate(home.belief, pose, cov)
    named = {i: j for i, j in zip(way.ids.tolist(), way.named.tolist(), strict=True) if j >= 0 and j in home.ledger}
    home.events = here.events
    for i, j in named.items():
        inherit(home.ledger | {i: here.ledger[i]}, j, i)
        home.events = (home.events, "merged", i, j, index)
    _bring_along(estimator, home, here, way, local, named, index, wanted)
    home.history = _moved_history(here, way.fit.motion, scan - len(away.trail))
    home.ids, home.paired = (renamed(ids, named) for ids in (here.ids, here.paired))
    return home


def _bring_along(
    estimator: Estimator[Any],
    home: Branch,
    here: Branch,
    way: Return,
    local: Estimate,
    named: dict[int, int],
    index: int,
    wanted: int,
) -> None:
    """Landmarks that only the new map has: the firm ones are placed in the old one, the others end."""
    for k, i in enumerate(local.ids.tolist()):
        if i in named:
            continue
        if here.ledger[i].static < wanted:
            home.events = (home.events, "died", i, -1, index)
            continue
        place, cov = _placed(way, local.landmarks[k], local.covs[k])
        home.belief = estimator.place(home.belief, np.array([i]), place[None], cov[None])
        home.ledger[i] = replace(here.ledger[i], companions=set(), place=None, apart={})


def _placed(way: Return, point: Array, cov: Array) -> tuple[Array, Array]:
    """A landmark of the new map in the old one, with the uncertainty of the fit."""
    R = rotation(way.fit.motion[2])
    x, y = R @ point
    J = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
    return way.fit.motion[:2] + np.array([x, y]), R @ cov @ R.T + J @ way.fit.cov @ J.T


def _moved_history(here: Branch, motion: Array, since: int) -> Any:
    """The history with the poses after scan `since` as the old map has them, those of steps without a scan too."""
    nodes: list[Any] = []
    node = here.history
    while node is not None and node[3] > since:
        nodes.append(node)
        node = node[0]
    for _, ids, pose, scan in reversed(nodes):
        node = (node, ids, compose(motion, pose), scan)
    return node


def both(old: Estimate, here: Estimate) -> Estimate:
    """The map of the time away beside the one that was left, each where the odometry would have it."""
    joined = [
        np.concatenate([getattr(old, name), getattr(here, name)]) for name in ("ids", "landmarks", "covs", "stone")
    ]
    return Estimate(here.pose, here.pose_cov, *joined)
