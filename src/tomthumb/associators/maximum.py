"""The most probable hypothesis, proven: branch and bound on the joint posterior that Simulated Tom Thumb searches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomthumb.associators.tom_thumb.scene import gate_of_two, window
from tomthumb.errors import TomThumbError
from tomthumb.gains import base_table
from tomthumb.kernels import posterior
from tomthumb.protocols import Rng
from tomthumb.types import Association, AssociationProblem, Ids

NO_LIMIT = int(np.iinfo(np.int64).max)


@dataclass(slots=True)
class MaximumPosterior:
    """The hypothesis of largest L(a) = sum [log P_D / (1 - P_D) - log lambda0] - D2 / 2 - log det(2 pi S) / 2.

    D2 and S are joint over all pairs. Every pairing lies within `gate` by itself, there is no joint test. `budget`
    bounds the nodes (0: no limit); `info` tells the nodes, the value reached and whether it is "optimal" or
    "truncated". `hypotheses` are returned at most, those within `slack` nats of the best, weighed by their L.
    """

    gate: float = 1.0 - 1e-6
    budget: int = 1_000_000
    hypotheses: int = 1
    slack: float = 3.0

    def __post_init__(self) -> None:
        if self.hypotheses < 1:
            raise TomThumbError(f"hypotheses must be at least 1, got {self.hypotheses}")

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64), info={"nodes": 0, "proof": "optimal", "objective": 0.0})]
        near, gate2 = window(problem.weighed_d2, self.gate), gate_of_two(self.gate)
        given = (problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, base_table(problem))
        pool, values, nodes, proven = posterior.solve(
            *given, near.start, near.columns, gate2, self.slack if self.hypotheses > 1 else 0.0,
            self.budget or NO_LIMIT, self.hypotheses,
        )  # fmt: skip
        info = {"nodes": nodes, "proof": "optimal" if proven else "truncated", "objective": float(values[0])}
        kept = np.flatnonzero(np.isfinite(values) & (values >= values[0] - self.slack))
        return [Association(pool[k], float(values[k]), info) for k in kept[: self.hypotheses]]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""
