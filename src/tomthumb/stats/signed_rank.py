"""Wilcoxon's signed-rank test and its interval, exact for small samples, ties and zeros included.

Given the sizes of the differences, every pattern of signs is equally likely under "no difference": so the distribution
of the statistic is that of a random subset sum of the (mid)ranks, which is counted exactly up to `EXACT` differences.

References: F. Wilcoxon, Biometrics Bulletin 1(6), 1945; J. Hodges, E. Lehmann, Ann. Math. Stat. 34(2), 1963 (estimate
and interval from the Walsh averages).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from tomthumb.types import Array

EXACT = 120  # above this the normal approximation is good to three digits and counting starts to cost


@dataclass(frozen=True, slots=True)
class SignedRank:
    """`positive`, `negative`: rank sums; `n`: differences that are not zero; `p`: two-sided."""

    positive: float
    negative: float
    n: int
    p: float

    @property
    def effect(self) -> float:
        """Matched-pairs rank-biserial correlation, -1 to 1: (positive - negative) / all rank sums."""
        total = self.positive + self.negative
        return (self.positive - self.negative) / total if total > 0 else 0.0


def signed_rank(differences: Array) -> SignedRank:
    """The test that `differences (n,)` are symmetric about zero. Zeros are left out; equal sizes share a mid-rank."""
    d = np.asarray(differences, float)
    d = d[d != 0.0]
    doubled = doubled_ranks(np.abs(d))
    positive, total = int(doubled[d > 0].sum()), int(doubled.sum())
    low = min(positive, total - positive)
    p = _exact(doubled, low) if len(d) <= EXACT else _normal(doubled, low)
    return SignedRank(positive / 2, (total - positive) / 2, len(d), min(1.0, p))


def doubled_ranks(sizes: Array) -> np.ndarray:
    """Twice the mid-rank of each of `sizes (n,)`: whole numbers even with ties."""
    _, group, count = np.unique(sizes, return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    return (2 * last - count + 1)[group].astype(np.int64) if len(sizes) else np.empty(0, np.int64)


def subset_sums(weights: np.ndarray) -> Array:
    """Probability of each total 0..sum(weights) when every whole weight is taken or left by a fair coin."""
    chance = np.zeros(int(weights.sum()) + 1)
    chance[0] = 1.0
    top = 0
    for w in weights.tolist():
        chance[w : top + w + 1] += chance[: top + 1].copy()
        top += w
        chance[: top + 1] *= 0.5
    return chance


def _exact(doubled: np.ndarray, low: int) -> float:
    return 2.0 * float(subset_sums(doubled)[: low + 1].sum())


def _normal(doubled: np.ndarray, low: int) -> float:
    mean, std = doubled.sum() / 2, np.sqrt(np.square(doubled, dtype=float).sum()) / 2
    return 2.0 * float(ndtr((low + 1 - mean) / std))


def walsh_averages(differences: Array) -> Array:
    """The sorted means of all pairs, each difference with itself included: (n (n + 1) / 2,)."""
    d = np.asarray(differences, float)
    i, j = np.triu_indices(len(d))
    averages: Array = np.sort((d[i] + d[j]) / 2)
    return averages


def hodges_lehmann(differences: Array, level: float = 0.05) -> tuple[float, float, float]:
    """The median of the Walsh averages and the interval of confidence 1 - level that inverts the test.

    Infinite ends where the sample is too small for the level.
    """
    averages = walsh_averages(differences)
    n = len(differences)
    if n == 0:
        return np.nan, -np.inf, np.inf
    k = _cut(n, level)
    estimate = float(np.median(averages))
    if k < 1:
        return estimate, -np.inf, np.inf
    return estimate, float(averages[k - 1]), float(averages[-k])


def _cut(n: int, level: float) -> int:
    """Largest k with P(W <= k - 1) <= level / 2: the k-th Walsh average from each end bounds the interval."""
    if n > EXACT:
        std = np.sqrt(n * (n + 1) * (2 * n + 1) / 24)
        return int(np.floor(n * (n + 1) / 4 + ndtri(level / 2) * std))
    below = np.cumsum(subset_sums(np.arange(1, n + 1)))
    return int(np.searchsorted(below, level / 2, side="right"))
