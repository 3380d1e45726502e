"""An associator of your own in one file: mutual nearest neighbours, by Mahalanobis distance.

tomthumb check ./examples/my_associator.py:Mine
tomthumb demo --associator ./examples/my_associator.py:Mine
tomthumb run cloister --associator ./examples/my_associator.py:Mine --set associator.gate=0.999
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb import Association, AssociationProblem


@dataclass
class Mine:
    """Pairs an observation and a landmark that are each other's nearest, within a chi-square gate."""

    gate: float = 0.99

    def associate(self, problem: AssociationProblem, rng: np.random.Generator) -> list[Association]:
        m, n = problem.shape
        match = np.full(m, -1)
        if m and n:
            d2 = problem.d2  # (m, n); infinite where the labels exclude the pairing
            nearest, claimant = d2.argmin(1), d2.argmin(0)
            for i, j in enumerate(nearest):
                if claimant[j] == i and d2[i, j] < chdtri(2, 1 - self.gate):
                    match[i] = j
        return [Association(match)]

    def learn(self, ids: np.ndarray, t: float) -> None:
        """Nothing to learn."""
