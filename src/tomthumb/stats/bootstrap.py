"""Bootstrap by run: the run, never the step, is the independent thing that is drawn again.

References: B. Efron, "Better bootstrap confidence intervals", JASA 82(397), 1987 (BCa).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from tomthumb.types import Array

BLOCK = 2_000_000  # numbers drawn at a time: bounds the memory, whatever the sample


def bootstrap_means(values: Array, rng: np.random.Generator, resamples: int = 4000) -> Array:
    """Means (resamples,) of samples drawn with replacement from `values (n,)`."""
    n = len(values)
    out = np.empty(resamples)
    step = max(1, BLOCK // max(n, 1))
    for first in range(0, resamples, step):
        rows = min(step, resamples - first)
        out[first : first + rows] = values[rng.integers(0, n, (rows, n))].mean(1)
    return out


def mean_interval(
    values: Array, rng: np.random.Generator, level: float = 0.05, resamples: int = 4000
) -> tuple[float, float]:
    """BCa interval of confidence 1 - level of the mean of `values (n,)`; a point where all are equal, NaN without any.

    One value tells nothing about its spread: its interval is infinite.
    """
    values = np.asarray(values, float)
    if len(values) == 0:
        return np.nan, np.nan
    if np.all(values == values[0]):
        return (-np.inf, np.inf) if len(values) == 1 else (float(values[0]), float(values[0]))
    means = np.sort(bootstrap_means(values, rng, resamples))
    low, high = _corrected(values, means, level)
    return float(np.quantile(means, low)), float(np.quantile(means, high))


def _corrected(values: Array, means: Array, level: float) -> tuple[float, float]:
    """The two shares of the bootstrap distribution that BCa takes instead of level / 2 and 1 - level / 2."""
    below = (np.count_nonzero(means < values.mean()) + 0.5 * np.count_nonzero(means == values.mean())) / len(means)
    bias = ndtri(np.clip(below, 1 / len(means), 1 - 1 / len(means)))
    centred = values.mean() - values  # of the jackknife: the leave-one-out means differ by this over n - 1
    skew = (centred**3).sum() / (6 * (centred**2).sum() ** 1.5)
    z = bias + ndtri(np.array([level / 2, 1 - level / 2]))
    low, high = ndtr(bias + z / (1 - skew * z))
    return float(low), float(high)


def error_bound(errors: int, runs: int) -> float:
    """Upper 95 % bound of the chance that a run errs, when `errors` of `runs` did: 3 / runs for none (Clopper-Pearson).

    So that "100 %" is never printed without what it rests on.
    """
    from scipy.special import betaincinv

    if runs == 0 or errors >= runs:
        return 1.0
    return float(betaincinv(errors + 1, runs - errors, 0.95))
