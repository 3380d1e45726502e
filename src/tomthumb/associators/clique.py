"""Pairwise consistency: the largest set of pairings that keep each other's distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.associators.tom_thumb.scene import cartesian
from tomthumb.errors import TomThumbError
from tomthumb.kernels import clique
from tomthumb.protocols import Rng
from tomthumb.types import Array, Association, AssociationProblem, Ids


@dataclass(slots=True)
class PairwiseConsistency:
    """Pairings within `gate` are joined where the distances they observe and predict agree (`pair_gate`, one degree of
    freedom); of this graph a dense subgraph is rounded to a clique, then enlarged by branch and bound.

    `budget` bounds the nodes (0: the dense subgraph alone), `rounds` the climb to it. The pose's prior counts through
    `gate` only. Raises `TomThumbError` for observations that are not points of a plane.

    References: T. Bailey, PhD thesis, Sydney 2002 (correspondence graph); P. Lusk, K. Fathian, J. How, CLIPPER, ICRA
    2021; M. Pavan, M. Pelillo, IEEE T-PAMI 29(1), 2007 (replicator dynamics).
    """

    gate: float = 0.9999
    pair_gate: float = 0.99
    budget: int = 20_000
    rounds: int = 200

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        m, n = problem.shape
        match = np.full(m, -1, np.int64)
        rows, columns = np.nonzero(problem.d2 < chdtri(2, 1.0 - self.gate)) if m and n else (match[:0], match[:0])
        if not len(rows):
            return [Association(match, info={"nodes": 0, "proof": "optimal", "pairings": 0})]
        start, neighbour, weight = self._graph(problem, rows, columns)
        climbed = clique.dense(start, neighbour, weight, self.rounds)
        chosen, nodes, proven = clique.rounded(climbed, start, neighbour), 0, False
        if self.budget:
            order, listed = _fewest_first(rows, climbed)
            chosen, nodes, proven = clique.largest(chosen, rows, order, listed, start, neighbour, self.budget)
        match[rows[chosen]] = columns[chosen]
        proof = "optimal" if proven else "truncated"
        return [Association(match, info={"nodes": nodes, "proof": proof, "pairings": len(rows)})]

    def _graph(self, problem: AssociationProblem, rows: Ids, columns: Ids) -> tuple[Ids, Ids, Array]:
        seen, expected = cartesian(problem.z, problem.angles), cartesian(problem.predictions.z_hat, problem.angles)
        if seen is None or expected is None:
            raise TomThumbError(f"associator clique: angles {problem.angles} are not points; valid: none, or (1,)")
        (q, Tq), (p, Tp) = seen, expected
        some, columns = np.unique(columns, return_inverse=True)
        at = (2 * some[:, None] + np.arange(2)).ravel()
        C = problem.predictions.cov[np.ix_(at, at)].reshape(len(some), 2, len(some), 2)
        C = np.einsum("aij,ajbk,blk->aibl", Tp[some], C, Tp[some], optimize=True).reshape(len(at), len(at))
        R = Tq @ problem.R @ Tq.transpose(0, 2, 1)
        found: tuple[Ids, Ids, Array] = clique.graph(
            rows,
            columns,
            np.ascontiguousarray(q),
            R,
            p[some],
            np.ascontiguousarray(C),
            float(chdtri(1, 1.0 - self.pair_gate)),
        )
        return found

    def learn(self, ids: Ids, t: float) -> None:
        """Nothing to learn."""


def _fewest_first(rows: Ids, climbed: Array) -> tuple[Ids, Ids]:
    """Pairings by observation, those with the fewest first, within one by falling membership; and where each begins."""
    counts = np.bincount(rows)
    order = np.lexsort((-climbed, rows, counts[rows]))
    begins = np.flatnonzero(np.diff(rows[order], prepend=-1))
    return order, np.append(begins, len(rows))
