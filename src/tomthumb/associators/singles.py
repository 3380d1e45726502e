"""Singles: only what cannot be mistaken is paired."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.protocols import Rng
from tomthumb.types import Association, AssociationProblem, Ids


@dataclass(slots=True)
class Singles:
    """Pairs i and j when j is the only landmark within `gate` of i, and i the only observation within it of j.

    References: J. Neira, J. D. Tardos, Data association for SLAM, exercise SINGLES of the SLAM summer schools.
    """

    gate: float = 0.99

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        match = np.full(m, -1, np.int64)
        if m and n:
            inside = problem.d2 < chdtri(2, 1.0 - self.gate)
            alone = inside & (inside.sum(1) == 1)[:, None] & (inside.sum(0) == 1)[None]
            rows, columns = np.nonzero(alone)
            match[rows] = columns
        return [Association(match)]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""
