"""What the loop does when the family flees, and when the king has carried it home (`king` says when)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tomthumb.branches import Branch
from tomthumb.geometry import compose, rotation
from tomthumb.king import Exile, Return, left_behind, pose_home
from tomthumb.lifecycle import Life
from tomthumb.protocols import Estimator, Rng
from tomthumb.types import Array, Estimate

CERTAIN = 1e-12 * np.eye(3)  # the first pose of a new map is the map's own frame


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
