"""Nearest neighbour and global nearest neighbour: each pairing judged by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from tomthumb.gains import log_odds, weighed
from tomthumb.protocols import Rng
from tomthumb.types import Array, Association, AssociationProblem, Ids


@dataclass(slots=True)
class NearestNeighbour:
    """Every observation goes to its nearest landmark (d2) within the gate.

    `unique`: a landmark claimed twice keeps its nearest claimant, the other stays unpaired. `faithful`: the reference
    program's way, which lets several observations share one landmark and takes the gate's border as inside.

    References: Y. Bar-Shalom, T. Fortmann, Tracking and Data Association, 1988.
    """

    gate: float = 0.99
    unique: bool = True
    faithful: bool = False

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64))]
        gate2 = chdtri(2, 1.0 - self.gate)
        nearest = problem.d2.argmin(1)
        distance = problem.d2[np.arange(m), nearest]
        inside = distance <= gate2 if self.faithful else distance < gate2
        match = np.where(inside, nearest, -1)
        if self.unique and not self.faithful:
            match = _keep_nearest(match, distance)
        return [Association(match)]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""


def _keep_nearest(match: Ids, distance: Array) -> Ids:
    kept = np.full_like(match, -1)
    taken: set[int] = set()
    for i in np.argsort(distance, kind="stable"):
        if match[i] >= 0 and int(match[i]) not in taken:
            kept[i] = match[i]
            taken.add(int(match[i]))
    return kept


@dataclass(slots=True)
class GlobalNearestNeighbour:
    """The one-to-one assignment of least total cost (Hungarian), observations being free to stay unpaired.

    `cost` "d2": a pairing costs its d2 and an unpaired observation the gate's d2; the errors that pairings share are
    ignored. `cost` "likelihood": minus the log-likelihood ratio against clutter (with S, detection and density).

    References: S. Blackman, R. Popoli, Design and Analysis of Modern Tracking Systems, 1999, ch. 6.
    """

    gate: float = 0.99
    cost: str = "d2"

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64))]
        gate2 = chdtri(2, 1.0 - self.gate)
        d2 = problem.d2 if self.cost == "d2" else problem.weighed_d2
        gain = gate2 - d2 if self.cost == "d2" else pair_gains(problem)
        gain = np.where(d2 < gate2, gain, 0.0)
        rows, columns = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
        match = np.full(m, -1, np.int64)
        good = gain[rows, columns] > 0.0
        match[rows[good]] = columns[good]
        return [Association(match)]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""


def pair_gains(problem: AssociationProblem) -> Array:
    """Log-likelihood ratio (m, n) of each pairing, by itself, against clutter: log PD/(1-PD) - log lambda0 + log N, and
    the evidence of what it looks like.
    """
    odds = log_odds(problem)
    S = problem.S
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] * S[..., 1, 0]
    gains: Array = (
        odds[None] - np.log(problem.clutter)[:, None] - 0.5 * problem.weighed_d2 - 0.5 * np.log(4 * np.pi**2 * det)
    )
    return weighed(gains, problem.evidence)
