"""What the loop carries: branches of the history, and one scan as it is used for gating, updating and founding."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tomthumb.graves import Graveyard
from tomthumb.lifecycle import Ledger
from tomthumb.protocols import Estimator
from tomthumb.types import Array, Ids, Observations

HOPELESS = 10.0  # nats behind the best branch at which a branch is given up


@dataclass(slots=True)
class Branch:
    """One history of associations: its belief, what its landmarks have lived through, and how likely it is.

    `log_weight` is relative to the best branch, `evidence` the sum of all its hypotheses' log weights.
    """

    belief: Any
    ledger: Ledger
    crumbs: set[int] = field(default_factory=set)
    graves: Graveyard = field(default_factory=Graveyard)
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
