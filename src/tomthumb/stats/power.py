"""How many seeds it takes to tell: the power of Wilcoxon's test from a pilot sample.

References: E. Lehmann, Nonparametrics, 1975, sec. 4.2 (mean and variance of the statistic under an alternative).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from tomthumb.types import Array

MOST = 1_000_000  # seeds: more than anyone would run


@dataclass(frozen=True, slots=True)
class Pilot:
    """What the power depends on: `moved` share of differences that are not zero and, among those, four chances.

    `one`: one is positive; `two`: two have a positive sum; `mixed`: both of these; `pair`: one has a positive sum with
    each of two others.
    """

    moved: float
    one: float
    two: float
    mixed: float
    pair: float


def pilot(differences: Array) -> Pilot:
    """Estimated from at least three differences that are not zero; unbiased (U-statistics)."""
    d = np.asarray(differences, float)
    live = d[d != 0.0]
    n = len(live)
    if n < 3:
        return Pilot(n / max(len(d), 1), 0.5, 0.5, 0.25, 1 / 3)
    total = live[:, None] + live[None]
    half = (total > 0) + 0.5 * (total == 0)
    np.fill_diagonal(half, 0.0)
    partners = half.sum(1)
    return Pilot(
        moved=n / len(d),
        one=float((live > 0).mean()),
        two=float(partners.mean() / (n - 1)),
        mixed=float(((live > 0) * partners).mean() / (n - 1)),
        pair=float((partners**2 - np.square(half).sum(1)).mean() / ((n - 1) * (n - 2))),
    )


def normal_pilot(size: float) -> Pilot:
    """The same for normal differences whose mean is `size` standard deviations."""
    z = np.linspace(-9.0, 9.0, 4001)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) * (z[1] - z[0])
    partner = ndtr(z + 2 * size)  # chance that another difference outweighs one of z standard deviations
    positive = z + size > 0
    return Pilot(
        moved=1.0,
        one=float(ndtr(size)),
        two=float(ndtr(np.sqrt(2) * size)),
        mixed=float((density * partner)[positive].sum()),
        pair=float((density * partner**2).sum()),
    )


def power(sample: Pilot, n: int, level: float = 0.05) -> float:
    """Chance that Wilcoxon's two-sided test at `level` rejects with `n` seeds."""
    k = n * sample.moved
    if k < 1:
        return 0.0
    mean = k * sample.one + k * (k - 1) / 2 * sample.two
    var = k * sample.one * (1 - sample.one)
    var += k * (k - 1) / 2 * sample.two * (1 - sample.two)
    var += 2 * k * (k - 1) * (sample.mixed - sample.one * sample.two)
    var += k * (k - 1) * max(0.0, k - 2) * (sample.pair - sample.two**2)
    null_mean, null_std = k * (k + 1) / 4, np.sqrt(k * (k + 1) * (2 * k + 1) / 24)
    reach = -ndtri(level / 2) * null_std
    std = np.sqrt(max(var, 1e-12 * k))
    high = ndtr((mean - null_mean - reach) / std)
    low = ndtr((null_mean - reach - mean) / std)
    return float(high + low)


def seeds_needed(sample: Pilot, power_wanted: float = 0.8, level: float = 0.05) -> int | None:
    """The fewest seeds that tell with the power wanted; None when even a million would not."""
    if power(sample, MOST, level) < power_wanted:
        return None
    low, high = _floor(level), MOST
    while low < high:
        middle = (low + high) // 2
        if power(sample, middle, level) >= power_wanted:
            high = middle
        else:
            low = middle + 1
    return low


def _floor(level: float) -> int:
    """With fewer differences than this even a clean sweep is not significant: 2 / 2^n > level."""
    return int(np.ceil(np.log2(2 / level)))
