"""Joint compatibility branch and bound: the largest set of pairings that passes the joint chi-square test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.associators.candidates import gated
from tomthumb.kernels.jcbb import search
from tomthumb.protocols import Rng
from tomthumb.types import Association, AssociationProblem, Ids


@dataclass(slots=True)
class JointCompatibility:
    """Exact JCBB: among the one-to-one sets of pairings whose every prefix (in the search order) passes the joint test at
    `gate`, the largest; of those the one of least joint d2.

    Observations with the fewest candidates come first, candidates nearest first. `budget` bounds the nodes; `info` tells
    the nodes spent and whether the result is "optimal" or "truncated". `complete`: only the whole set has to pass.
    `faithful`: the reference program's choices (given order, landmarks by index, no uniqueness, the first best is kept).

    References: J. Neira, J. D. Tardos, IEEE T-RA 17(6), 2001, eq. 14 to 17 and the algorithm of its figure 3.
    """

    gate: float = 0.99
    budget: int = 1_000_000
    complete: bool = False
    faithful: bool = False

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64), info={"nodes": 0, "proof": "optimal", "joint_d2": 0.0})]
        gates2 = chdtri(2.0 * np.arange(m + 1), 1.0 - self.gate)
        gates2[0] = np.inf
        listed = gated(problem.d2, gates2[1], nearest_first=not self.faithful, fewest_first=not self.faithful)
        cov = np.ascontiguousarray(problem.predictions.cov)
        match, d2, nodes, finished = search(
            problem.innovation, cov, problem.R, listed.order, listed.start, listed.columns,
            gates2, not self.faithful, not self.faithful, self.complete, self.budget,
        )  # fmt: skip
        proof = "optimal" if finished else "truncated"
        return [Association(match, info={"nodes": nodes, "proof": proof, "joint_d2": d2, "order": listed.order})]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""
