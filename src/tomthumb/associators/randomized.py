"""Randomized joint compatibility: a few observations by branch and bound, the rest one by one, many times."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.associators.candidates import gated
from tomthumb.associators.sequential import Conditional, begin
from tomthumb.errors import TomThumbError
from tomthumb.kernels.jcbb import search
from tomthumb.protocols import Rng
from tomthumb.types import Array, Association, AssociationProblem, Ids


@dataclass(slots=True)
class RandomizedCompatibility:
    """The best of several trials: JCBB on `seeds` observations drawn at random, then each of the others goes to its
    nearest landmark given those, if it keeps the joint test at `gate`. Most pairings win, then the least joint d2.

    Trials T = log(fail) / log(1 - (k / m)^seeds): with probability 1 - `fail` one trial starts from right pairings
    only, k being the pairings of the best so far; at most `trials`.

    References: after L. M. Paz, J. Guivant, J. D. Tardos, J. Neira, Data association in O(n) for divide and conquer
    SLAM, RSS 2007, algorithm RJC.
    """

    gate: float = 0.99
    seeds: int = 3
    fail: float = 0.01
    trials: int = 200
    budget: int = 10_000

    def __post_init__(self) -> None:
        if self.seeds < 1 or self.trials < 1 or not 0.0 < self.fail < 1.0:
            raise TomThumbError("rjc needs seeds and trials of at least 1, and fail between 0 and 1")

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        best, best_d2 = np.full(m, -1, np.int64), 0.0
        if m == 0 or n == 0:
            return [Association(best, info={"trials": 0, "joint_d2": 0.0})]
        gates2 = chdtri(2.0 * np.arange(1, m + 2), 1.0 - self.gate)
        promising = np.flatnonzero((problem.d2 < gates2[0]).any(1))
        done, wanted = 0, self.trials if len(promising) else 0
        fresh, near = begin(problem, self.gate)
        while done < wanted:
            found = self._trial(problem, deepcopy(fresh), near, promising, gates2, rng)
            done += 1
            k, most = int((found.match >= 0).sum()), int((best >= 0).sum())
            if k > most or (k == most and found.joint_d2 < best_d2):
                best, best_d2 = found.match, found.joint_d2
                wanted = min(self.trials, self._enough(k / len(promising)))
        best = np.where(best >= 0, near[best], -1) if len(near) else best
        return [Association(best, info={"trials": done, "joint_d2": best_d2})]

    def _trial(
        self, problem: AssociationProblem, state: Conditional, near: Ids, promising: Ids, gates2: Array, rng: Rng
    ) -> Conditional:
        """Seeds by branch and bound, the rest in random order by conditional nearest neighbour."""
        order = rng.permutation(promising)
        some = order[: self.seeds]
        listed = gated(problem.d2[np.ix_(some, near)], gates2[0])
        seeded = search(
            state.nu[some], state.C, problem.R[some], listed.order, listed.start, listed.columns,
            np.concatenate([[np.inf], gates2]), True, True, False, self.budget,
        )[0]  # fmt: skip
        for i, j in zip(some, seeded, strict=True):
            if j >= 0:
                state.accept(i, j)
        for i in order[self.seeds :]:
            d2 = state.d2(i)
            k = int((state.match >= 0).sum())
            if d2.min() < gates2[0] and state.joint_d2 + d2.min() < gates2[k]:
                state.accept(i, int(d2.argmin()))
        return state

    def _enough(self, share: float) -> int:
        """Trials after which one has drawn right observations only, but for a chance of `fail`."""
        good = min(max(share, 1e-3), 1.0 - 1e-9) ** self.seeds
        return int(np.ceil(np.log(self.fail) / np.log1p(-good)))

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""
