"""What the loop carries: branches of the history, and one scan as it is used for gating, updating and founding."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tomthumb.graves import Graveyard
from tomthumb.lifecycle import Ledger
from tomthumb.types import Array, Ids, Observations


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
