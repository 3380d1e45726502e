"""Sequential compatibility: every accepted pairing sharpens the predictions for those that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.errors import TomThumbError
from tomthumb.kernels.gates import mahalanobis
from tomthumb.protocols import Rng
from tomthumb.types import Array, Association, AssociationProblem, Ids

REACH = 1.0 - 1e-6  # landmarks beyond this gate of every observation are left out of the conditioning


@dataclass(slots=True)
class Conditional:
    """Innovations nu (m, n, 2) and covariance C (2n, 2n) given the pairings accepted so far; its own copies."""

    nu: Array
    C: Array
    R: Array
    free: Array  # (m, n) 0 where the pairing may be made, inf where not
    match: Ids
    joint_d2: float = 0.0

    def d2(self, i: int) -> Array:
        """Conditional d2 (n,) of observation i; infinite where the pairing may not be made."""
        n = self.nu.shape[1]
        k = np.arange(n)
        blocks = np.ascontiguousarray(self.C.reshape(n, 2, n, 2)[k, :, k, :])
        d2: Array = mahalanobis(self.nu[i : i + 1], blocks, self.R[i : i + 1])[0] + self.free[i]
        return d2

    def accept(self, i: int, j: int) -> None:
        """K = C[:, j] (C_jj + R_i)^-1; z_hat += K nu; C -= K C[j, :].  D2 grows by the conditional d2 (chain rule)."""
        at = slice(2 * j, 2 * j + 2)
        column, nu = self.C[:, at].copy(), self.nu[i, j].copy()
        inverse = np.linalg.inv(column[at] + self.R[i])
        gain = column @ inverse
        self.joint_d2 += float(nu @ inverse @ nu)
        self.nu -= (gain @ nu).reshape(-1, 2)
        self.C -= gain @ column.T
        self.free[:, j] = np.inf
        self.match[i] = j


def begin(problem: AssociationProblem, gate: float) -> tuple[Conditional, Ids]:
    """Nothing accepted yet, cut down to the landmarks within reach of any observation; and those landmarks' columns."""
    near = np.flatnonzero((problem.d2 < chdtri(2, 1.0 - max(gate, REACH))).any(0))
    at = (2 * near[:, None] + np.arange(2)).ravel()
    free = np.where(np.isfinite(problem.d2[:, near]), 0.0, np.inf)
    match = np.full(len(problem.z), -1, np.int64)
    return Conditional(
        problem.innovation[:, near].copy(), problem.predictions.cov[np.ix_(at, at)], problem.R, free, match
    ), near


@dataclass(slots=True)
class SequentialNearestNeighbour:
    """Observations one after the other: the nearest landmark by d2 conditional on all pairings before, within `gate`.

    `order`: "given", or "nearest", the observation whose nearest landmark is nearest at first goes first.

    References: J. Neira, J. D. Tardos, IEEE T-RA 17(6), 2001 (sequential compatibility nearest neighbour).
    """

    gate: float = 0.99
    order: str = "given"

    def __post_init__(self) -> None:
        if self.order not in ("given", "nearest"):
            raise TomThumbError(f"order {self.order!r} is not known; valid: given, nearest")

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        if m == 0 or n == 0:
            return [Association(np.full(m, -1, np.int64))]
        state, near = begin(problem, self.gate)
        gate2 = chdtri(2, 1.0 - self.gate)
        order = np.argsort(problem.d2.min(1), kind="stable") if self.order == "nearest" else np.arange(m)
        for i in order if len(near) else ():
            d2 = state.d2(i)
            if d2.min() < gate2:
                state.accept(i, int(d2.argmin()))
        match = state.match.copy()
        match[match >= 0] = near[match[match >= 0]]
        return [Association(match, info={"joint_d2": state.joint_d2})]

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""
