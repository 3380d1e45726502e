"""Many methods over many worlds: average ranks, Friedman's test and the critical difference.

References: J. Demsar, "Statistical comparisons of classifiers over multiple data sets", JMLR 7, 2006.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from tomthumb.types import Array


@dataclass(frozen=True, slots=True)
class Ranking:
    """`ranks (k,)` averages over `worlds`, 1 is best; `p` Friedman's; closer than `critical` cannot be told apart."""

    names: tuple[str, ...]
    ranks: Array
    worlds: int
    p: float
    critical: float

    def groups(self) -> list[tuple[int, int]]:
        """Maximal runs [first, last] in the order of rank whose ends differ by less than `critical`."""
        ranks = np.sort(self.ranks)
        found: list[tuple[int, int]] = []
        for first, rank in enumerate(ranks):
            last = int(np.searchsorted(ranks, rank + self.critical)) - 1
            if last > first and (not found or last > found[-1][1]):
                found.append((first, last))
        return found


def rank(names: tuple[str, ...], values: Array, *, larger_is_better: bool = True, level: float = 0.05) -> Ranking:
    """Rank `values (worlds, k)`; worlds with a NaN are left out, ties share their mean rank."""
    table = np.asarray(values, float)
    table = table[np.isfinite(table).all(1)]
    worlds, k = table.shape
    order = -table if larger_is_better else table
    each = (order[:, :, None] > order[:, None, :]).sum(2) + (order[:, :, None] == order[:, None, :]).sum(2) / 2 + 0.5
    ranks = each.mean(0) if worlds else np.full(k, np.nan)
    return Ranking(names, ranks, worlds, _friedman(each), critical_difference(k, worlds, level))


def _friedman(each: Array) -> float:
    """p of Friedman's test corrected for ties, from the ranks (worlds, k)."""
    worlds, k = each.shape
    if worlds < 2 or k < 2:
        return 1.0
    spread = np.square(each - (k + 1) / 2).sum() / (k - 1)
    if spread == 0:
        return 1.0
    between = np.square(each.sum(0) - worlds * (k + 1) / 2).sum()
    return float(chdtrc(k - 1, between / spread))


def critical_difference(k: int, worlds: int, level: float = 0.05) -> float:
    """Nemenyi's: average ranks of `k` methods over `worlds` that differ by more are different at `level`."""
    if k < 2 or worlds < 1:
        return np.inf
    return float(range_quantile(k, 1 - level) / np.sqrt(2) * np.sqrt(k * (k + 1) / (6 * worlds)))


def range_quantile(k: int, share: float) -> float:
    """Quantile of the range of `k` standard normal variables (the studentised range, infinite degrees of freedom)."""
    low, high = 0.0, 20.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _range_below(k, middle) < share else (low, middle)
    return (low + high) / 2


def _range_below(k: int, q: float) -> float:
    z = np.linspace(-9.0, 9.0 + q, 4001)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return float(k * np.trapezoid(density * (ndtr(z) - ndtr(z - q)) ** (k - 1), z))
