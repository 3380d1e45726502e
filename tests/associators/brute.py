"""Every one-to-one set of pairings of a small problem, written out: what the searches are held against."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import chdtri

from tomthumb.kernels.gates import innovations
from tomthumb.types import AssociationProblem, Predictions

WRAPPED = np.array([False, True])


def random_problem(rng, m, n, *, spread=1.0, pose=0.3, own=0.15, noise=0.15, angles=(), labels=False):
    """Correlated predictions in a small square, so that gates overlap; about a quarter of the scan is clutter."""
    points = rng.uniform(-spread, spread, (n, 2)) + (np.array([4.0, 0.0]) if angles else 0.0)
    B = np.zeros((2 * n, 3))
    B[0::2, 0] = B[1::2, 1] = 1.0
    B[0::2, 2], B[1::2, 2] = -points[:, 1], points[:, 0]
    A = rng.standard_normal((3, 3)) * pose
    pose_cov = A @ A.T + 1e-4 * np.eye(3)
    cov = B @ pose_cov @ B.T + np.kron(np.diag(rng.uniform(0.5, 1.5, n) * own**2), np.eye(2))
    error = (np.linalg.cholesky(cov + 1e-12 * np.eye(2 * n)) @ rng.standard_normal(2 * n)).reshape(n, 2)
    z = rng.uniform(-spread, spread, (m, 2)) + (np.array([4.0, 0.0]) if angles else 0.0)
    truth = np.full(m, -1)
    some = min(m, n)
    truth[:some] = np.where(rng.random(some) < 0.75, rng.permutation(n)[:some], -1)
    z[truth >= 0] = (points + error)[truth[truth >= 0]] + noise * rng.standard_normal(((truth >= 0).sum(), 2))
    R = np.tile(noise**2 * np.eye(2), (m, 1, 1)) * rng.uniform(0.7, 1.4, (m, 1, 1))
    mine, theirs = (rng.integers(-1, 2, m), rng.integers(-1, 2, n)) if labels else (None, None)
    predictions = Predictions(np.arange(n), points, cov, pose_cov, B @ pose_cov, points.copy(), labels=theirs)
    nu = innovations(z, points, np.isin([0, 1], angles))
    clutter = np.full(m, 0.2)
    return AssociationProblem(z, R, nu, predictions, clutter, n + np.arange(m), tuple(angles), mine)


@cache
def matches(m, n):
    """All one-to-one matches (g, m) of m observations and n landmarks, -1 unpaired."""
    every = itertools.product(range(-1, n), repeat=m)
    kept = [a for a in every if len({j for j in a if j >= 0}) == sum(j >= 0 for j in a)]
    return np.array(kept, np.int64).reshape(-1, m)


def joint(problem, some):
    """D2 and log det(2 pi S) of each match (g, m), by dense linear algebra."""
    d2, logdet = np.zeros(len(some)), np.zeros(len(some))
    count = (some >= 0).sum(1)
    for k in range(1, count.max(initial=0) + 1):
        rows = np.flatnonzero(count == k)
        who = np.array([np.flatnonzero(some[r] >= 0) for r in rows])
        where = np.take_along_axis(some[rows], who, 1)
        index = (2 * where[..., None] + np.arange(2)).reshape(len(rows), 2 * k)
        S = problem.predictions.cov[index[:, :, None], index[:, None, :]].copy()
        for b in range(k):
            S[:, 2 * b : 2 * b + 2, 2 * b : 2 * b + 2] += problem.R[who[:, b]]
        v = problem.innovation[who, where].reshape(len(rows), 2 * k)
        d2[rows] = np.einsum("gi,gi->g", v, np.linalg.solve(S, v[..., None])[..., 0])
        logdet[rows] = np.linalg.slogdet(2.0 * np.pi * S)[1]
    return d2, logdet


@dataclass(frozen=True)
class Table:
    """All hypotheses of a problem: matches (g, m), number of pairings, D2, log det(2 pi S); `compatible` one by one."""

    matches: np.ndarray
    count: np.ndarray
    d2: np.ndarray
    logdet: np.ndarray
    compatible: np.ndarray

    def passes(self, gate):
        """The joint test of each hypothesis: D2 < chi2(2 k)."""
        limit = chdtri(2.0 * np.maximum(self.count, 1), 1.0 - gate)
        return (self.count == 0) | (self.d2 < limit)

    def prefixes_pass(self, gate, order):
        """True where all prefixes in the search order pass as well."""
        ok = self.passes(gate)
        lookup = {tuple(a): k for k, a in enumerate(self.matches)}
        good = ok.copy()
        for length in range(1, len(order)):
            cut = self.matches.copy()
            cut[:, order[length:]] = -1
            good &= ok[[lookup[tuple(a)] for a in cut]]
        return good

    def best_by_count(self, allowed):
        """Row of the most pairings, then of the least D2, among the allowed."""
        rows = np.flatnonzero(allowed)
        return rows[np.lexsort((self.d2[rows], -self.count[rows]))[0]]

    def posterior(self, base):
        """L of each hypothesis for base gains (m, n)."""
        i = np.arange(self.matches.shape[1])
        gains = np.where(self.matches >= 0, base[i, np.maximum(self.matches, 0)], 0.0).sum(1)
        return gains - 0.5 * self.d2 - 0.5 * self.logdet


def tabulate(problem, gate):
    """The table of a problem; compatible: each pairing by itself within `gate` (and by its labels)."""
    some = matches(*problem.shape)
    d2, logdet = joint(problem, some)
    inside = problem.d2 < chdtri(2, 1.0 - gate)
    i = np.arange(some.shape[1])
    compatible = np.where(some >= 0, inside[i, np.maximum(some, 0)], True).all(1)
    return Table(some, (some >= 0).sum(1), d2, logdet, compatible)
