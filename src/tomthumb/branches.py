"""What the loop carries: branches of the history, and one scan as it is used for gating, updating and founding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tomthumb.doubt import Trials
from tomthumb.graves import Graveyard
from tomthumb.lifecycle import Ledger
from tomthumb.protocols import Estimator
from tomthumb.types import Array, Ids, Mask, Observations, Predictions

CERTAIN = 1e-12 * np.eye(3)  # the first pose of a new map is the map's own frame
HOPELESS = 10.0  # nats behind the best branch at which a branch is given up


@dataclass(slots=True)
class Branch:
    """One history of associations: its belief, what its landmarks have lived through, and how likely it is.

    trials: how those of its crumbs ended; untried: what was made a stone before its own.
    land: where it has looked from, as far as that was asked for (`copies.Land`).
    `log_weight` is relative to the best branch, `evidence` the sum of all its hypotheses' log weights.
    """

    belief: Any
    ledger: Ledger
    crumbs: set[int] = field(default_factory=set)
    graves: Graveyard = field(default_factory=Graveyard)
    trials: Trials = field(default_factory=Trials)
    untried: frozenset[int] = frozenset()
    land: Any = None
    log_weight: float = 0.0
    evidence: float = 0.0
    history: tuple[Any, Ids, Array, int] | None = None  # (earlier history, ids, pose, scans before): one a step, shared
    ids: Ids = field(default_factory=lambda: np.empty(0, np.int64))
    paired: Ids = field(default_factory=lambda: np.empty(0, np.int64))
    events: tuple[Any, str, int, int, int] | None = None  # (earlier events, kind, id, other id, step)

    def weigh(self, log_weight: float) -> None:
        """One more scan explained."""
        self.log_weight += log_weight
        self.evidence += log_weight


# a branch after a scan, with what was expected and matched (of each prediction), and what was spent
Child = tuple[Branch, Sequence[Predictions], Sequence[Ids], dict[str, Any]]


def ranked(children: list[Child]) -> None:
    """Best first, and weighed relative to the best."""
    children.sort(key=lambda c: -c[0].log_weight)
    top = children[0][0].log_weight
    for branch, *_ in children:
        branch.log_weight -= top


def told(branch: Branch) -> list[tuple[str, int, int, int]]:
    """What became of the branch's landmarks, in order: "died" or "merged", id, the id it went into (or -1), step."""
    out, node = [], branch.events
    while node is not None:
        node, kind, one, other, step = node
        out.append((kind, one, other, step))
    return out[::-1]


def merged_into(branch: Branch) -> dict[int, int]:
    """What each merged landmark of the branch is in the end: a into b and b into c is a into c."""
    return followed({one: other for kind, one, other, _ in told(branch) if kind == "merged"})


def followed(into: Mapping[int, int]) -> dict[int, int]:
    """Each to its end."""

    def end(i: int) -> int:
        while i in into:
            i = into[i]
        return i

    return {i: end(i) for i in into}


def renamed(ids: Ids, into: Mapping[int, int]) -> Ids:
    """Names (m,) after the change `into`; those that are not in it stay."""
    return np.array([into.get(i, i) for i in ids.tolist()], np.int64)


@dataclass(frozen=True, slots=True)
class Scan:
    """One scan three times over: as it came, with honest noise (for gates), and with the noise of what is news in it."""

    raw: Observations
    honest: Observations
    news: Observations
    serials: Ids

    def __len__(self) -> int:
        return len(self.serials)


def apart(branches: list[Branch], estimator: Estimator[Any]) -> list[Branch]:
    """Branches, best first, without those that have come to agree with a better one, or fallen `HOPELESS` behind.

    They agree when the last scan's names and the pose (within a tenth of its standard deviation) are the same.
    """
    kept = branches[:1]
    for branch in branches[1:]:
        pose, cov = estimator.pose(branch.belief)
        close = 0.1 * np.sqrt(np.maximum(np.diag(cov), 1e-12))
        same = [
            np.array_equal(branch.ids, other.ids)
            and bool((np.abs(pose - estimator.pose(other.belief)[0]) < close).all())
            for other in kept
        ]
        if branch.log_weight > -HOPELESS and not any(same):
            kept.append(branch)
    return kept


def among(ids: Ids, crumbs: set[int]) -> Mask:
    """Which ids (m,) are crumbs. Looked up one by one: most steps have no scan, and m is small beside their number."""
    found: Mask = np.array([i in crumbs for i in ids.tolist()], bool)
    return found
