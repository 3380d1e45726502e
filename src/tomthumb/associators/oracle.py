"""The teacher: told the truth, it names every observation whose landmark is expected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tomthumb.protocols import Rng
from tomthumb.types import Array, Association, AssociationProblem, Ids

FAR = 1e300  # a gate or a misread class excludes the pairing for others; the teacher knows better


class Oracle:
    """Names by `truth (M,)`, the true id of every observation of the run by serial number (-1 clutter, -2 not known).

    A landmark's own true id is that of the observation it was born from. Of several landmarks with one true id the
    nearest takes the observation (duplicates can only come from an earlier, untaught time).
    """

    def __init__(self, truth: Ids) -> None:
        self.truth = truth

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        mine = self.truth[problem.serials]
        theirs = self.truth[problem.predictions.ids]
        same = (mine[:, None] == theirs[None]) & (mine[:, None] >= 0)
        cost = np.where(same, np.minimum(problem.d2, FAR), np.inf)
        return [Association(one_to_one(cost))]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""


def one_to_one(cost: Array) -> Ids:
    """Greedy: the cheapest finite pairings (m, n) first, each row and column at most once."""
    match = np.full(cost.shape[0], -1, np.int64)
    used: set[int] = set()
    rows, columns = np.nonzero(np.isfinite(cost))
    for k in np.argsort(cost[rows, columns], kind="stable"):
        i, j = int(rows[k]), int(columns[k])
        if match[i] < 0 and j not in used:
            match[i] = j
            used.add(j)
    return match
