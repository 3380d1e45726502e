"""What the loop does when the family flees, when the king carries it home, and when he closes a loop.

`watch` says when to flee, `king` when to go home, `closing` when a loop is closed; here the branches are changed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.branches import Branch, Scan
from tomthumb.closing import Loops, closures
from tomthumb.geometry import compose, rotation
from tomthumb.king import Exile, King, Return, left_behind, pose_home, way_home
from tomthumb.lifecycle import Life
from tomthumb.protocols import Estimator, Rng
from tomthumb.types import Array, Estimate, Ids, Mask
from tomthumb.watch import Watch

if TYPE_CHECKING:
    from tomthumb.slam import Slam

CERTAIN = 1e-12 * np.eye(3)  # the first pose of a new map is the map's own frame


@dataclass(slots=True)
class Court:
    """The king, where there is one, the watch, and what was left behind when the family fled."""

    king: King | None
    loops: Loops | None = None
    watch: Watch = field(default_factory=Watch)
    exile: Exile | None = None

    def attend(self, slam: Slam, scan: Scan) -> dict[str, Any]:
        """After each scan: flee, seek the way home, or look for a closed loop."""
        if self.king is None or slam.index < slam.teach_steps:
            return {}
        if self.exile is None and self.watch.lost:
            self.lose_the_way(slam, slam.branches[0])
            slam.found(slam.branches[0], scan)
        if self.exile is not None:
            return self._seek(slam, self.king, self.exile)
        return self._close(slam, self.king, scan)

    def look(self, branch: Branch, ids: Ids, known: Mask, seen: Mask, chance: Array, count: int, scan: int) -> None:
        """The landmarks `ids` (n,) of a scan of `count`: confirmed and due, seen, and with what chance of that (n,)."""
        lives = [branch.ledger[i] for i in ids.tolist()]
        old = np.array([life.born <= self.watch.since for life in lives], bool)
        due = known & old
        exist = np.array([life.exist for life in lives])
        self.watch.look((chance * exist)[due], seen[due], count - int((seen & old).sum()), scan)

    def lose_the_way(self, slam: Slam, branch: Branch) -> None:
        """The pose of a branch is not believed any more: its map is put aside, a new one begun."""
        self.exile, fresh = flee(slam.estimator, branch, slam.index, slam.rng_estimator)
        slam.branches, self.watch = [fresh], Watch()

    def whole(self, here: Estimate) -> Estimate:
        """The estimate; while the family is away, with the old map beside the new one."""
        return here if self.exile is None else both(self.exile.old, here)

    def _seek(self, slam: Slam, king: King, away: Exile) -> dict[str, Any]:
        here = slam.branches[0]
        away.trail.append(slam.estimator.pose(here.belief)[0])
        if len(away.trail) % king.every:
            return {"king": "away"}
        way = way_home(king, away, slam.estimator.estimate(here.belief), here.ledger, slam.sensor)
        if way is None:
            return {"king": "away"}
        slam.branches = [go_home(slam.estimator, away, here, way, slam.index, slam.scan, slam.policy.hits)]
        self.exile = None
        return {"king": "home", "votes": way.fit.votes}

    def _close(self, slam: Slam, king: King, scan: Scan) -> dict[str, Any]:
        if self.loops is None or slam.scan % self.loops.every or not len(scan):
            return {}
        best = slam.branches[0]
        G = slam.sensor.locate(slam.estimator.pose(best.belief)[0], scan.honest.z)[2]
        noise = float(np.sqrt(0.5 * np.trace(G @ scan.honest.R @ G.transpose(0, 2, 1), axis1=1, axis2=2).mean()))
        pairs = closures(king, self.loops, best, slam.estimator, slam.sensor, slam.scan, noise)
        for keep, drop in pairs:
            slam.unite(best, keep, drop)
        return {"king": "loop", "votes": len(pairs)} if pairs else {}


def flee(estimator: Estimator[Any], branch: Branch, index: int, rng: Rng) -> tuple[Exile, Branch]:
    """The old map put aside without its crumbs, and a new branch that begins at the pose that is believed."""
    crumbs = np.array(sorted(branch.crumbs), np.int64)
    branch.belief = estimator.forget(branch.belief, crumbs)
    for i in crumbs.tolist():
        del branch.ledger[i]
        branch.events = (branch.events, "died", i, -1, index)
    branch.crumbs = set()
    old = estimator.estimate(branch.belief)
    fresh = Branch(estimator.init(old.pose, CERTAIN, rng), {}, history=branch.history, events=branch.events)
    return left_behind(branch, old), fresh


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
        _inherit(home.ledger[j], here.ledger[i], scan)
        home.events = (home.events, "merged", i, j, index)
    _bring_along(estimator, home, here, way, local, named, index, wanted)
    home.history = _moved_history(here, way.fit.motion, len(away.trail) - 1)
    home.ids, home.paired = (_renamed(ids, named) for ids in (here.ids, here.paired))
    return home


def _inherit(life: Life, lost: Life, scan: int) -> None:
    life.hits += lost.hits
    life.chances += lost.hits
    life.static += lost.static
    life.looks = life.looks.and_also(lost.looks)
    life.seen = scan


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
    R = rotation(way.fit.motion[2])
    for k, i in enumerate(local.ids.tolist()):
        if i in named:
            continue
        if here.ledger[i].static < wanted:
            home.events = (home.events, "died", i, -1, index)
            continue
        x, y = R @ local.landmarks[k]
        J = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        place = way.fit.motion[:2] + np.array([x, y])
        cov = R @ local.covs[k] @ R.T + J @ way.fit.cov @ J.T
        home.belief = estimator.place(home.belief, np.array([i]), place[None], cov[None])
        home.ledger[i] = replace(here.ledger[i], companions=set())


def _moved_history(here: Branch, motion: Array, scans: int) -> Any:
    """The history with the poses of the time away as the old map has them."""
    nodes: list[Any] = []
    node = here.history
    while node is not None and len(nodes) < scans:
        nodes.append(node)
        node = node[0]
    for _, ids, pose in reversed(nodes):
        node = (node, ids, compose(motion, pose))
    return node


def _renamed(ids: Any, named: dict[int, int]) -> Any:
    return np.array([named.get(i, i) for i in ids.tolist()], np.int64)


def both(old: Estimate, here: Estimate) -> Estimate:
    """The map of the time away beside the one that was left, each where the odometry would have it."""
    joined = [
        np.concatenate([getattr(old, name), getattr(here, name)]) for name in ("ids", "landmarks", "covs", "stone")
    ]
    return Estimate(here.pose, here.pose_cov, *joined)
