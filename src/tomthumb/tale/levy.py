"""Lévy flights (paper, equations 1 and 2): laws of their lengths, samplers, and the fit of an exponent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.kernels.levy import levy_lengths
from tomthumb.types import Array, Ids


@dataclass(frozen=True)
class LengthLaw:
    """Probabilities `pmf (L,)` of the whole lengths 1..L and their running sum `cdf (L,)`, ending in exactly 1.

    `cdf` is what the jitted `tomthumb.kernels.levy.levy_length(cdf, u)` reads inside other kernels' callers.
    """

    pmf: Array
    cdf: Array

    @property
    def l_max(self) -> int:
        """The longest flight, in cells (or in pairings, for the associator's ruins)."""
        return int(self.pmf.size)

    @property
    def mean(self) -> float:
        """Mean length."""
        return float(self.pmf @ np.arange(1, self.l_max + 1))

    def draw(self, rng: np.random.Generator, size: int) -> Ids:
        """`size` independent lengths, int64 (size,)."""
        lengths: Ids = levy_lengths(self.cdf, rng.random(size))
        return lengths


def law_of(pmf: Array) -> LengthLaw:
    """The law with these weights, normalised.

    Raises:
        TomThumbError: a weight is negative or not finite, or all are nought.
    """
    weights = np.asarray(pmf, dtype=float)
    total = weights.sum() if weights.ndim == 1 and weights.size else math.nan
    if not (np.isfinite(total) and total > 0.0 and weights.min() >= 0.0):
        raise TomThumbError("a law of lengths needs weights >= 0 in one row, not all nought")
    weights = weights / total
    cdf = np.cumsum(weights)
    cdf[-1] = 1.0  # so that no uniform number below 1 falls off the end
    return LengthLaw(weights, cdf)


def power_law(lam: float, l_max: int) -> LengthLaw:
    """P(l) = l^-lam / sum over 1..l_max: the discrete truncated form of equation 2.

    Args:
        lam: exponent >= 0 (the paper: 1 < lambda <= 3).
        l_max: longest length, at least 1; 1 is the simple walk.

    Raises:
        TomThumbError: an argument outside these ranges.
    """
    if not (math.isfinite(lam) and lam >= 0.0):
        raise TomThumbError(f"the exponent of a Lévy law is a finite number >= 0, not {lam}")
    if l_max < 1:
        raise TomThumbError(f"the longest flight is at least 1, not {l_max}")
    return law_of(np.arange(1, l_max + 1, dtype=float) ** -lam)


def scaled_law(law: LengthLaw, alpha: float) -> LengthLaw:
    """The law of round(alpha X), where X spreads each whole length l evenly over [l - 1/2, l + 1/2); same l_max.

    Equation 1's step size, and the magic boots: scaled *before* rounding, so that every whole length stays possible
    and the walk is never confined to a sub-lattice, as it would be by alpha times a whole length. What would exceed
    l_max is drawn again (the law is cut and normalised). alpha = 1 gives the law itself.

    Raises:
        TomThumbError: alpha is not 1 and not in (1, 2 l_max - 1), where two neighbouring lengths remain possible.
    """
    if alpha == 1.0:
        return law
    if not 1.0 < alpha < 2 * law.l_max - 1:
        valid = f"1, or below {2 * law.l_max - 1} where no flight exceeds {law.l_max}"
        raise TomThumbError(f"the step size alpha is {valid}, not {alpha}")
    edges = alpha * (np.arange(law.l_max + 1) + 0.5)
    mass = np.concatenate(([0.0], np.cumsum(law.pmf)))
    targets = np.arange(law.l_max + 1) + 0.5
    below = np.interp(targets, edges, mass)
    return law_of(np.diff(below))


def pareto_lengths(rng: np.random.Generator, lam: float, size: int, l_min: float = 1.0) -> Array:
    """Continuous lengths l_min U^(-1/(lam - 1)), density ~ l^-lam above l_min; (size,).

    Raises:
        TomThumbError: lam <= 1 (no such density) or l_min <= 0.
    """
    if not (lam > 1.0 and l_min > 0.0):
        raise TomThumbError(f"a Pareto law needs lambda > 1 and a least length > 0, not {lam} and {l_min}")
    return l_min * (1.0 - rng.random(size)) ** (-1.0 / (lam - 1.0))


def mantegna_sigma(beta: float) -> float:
    """Standard deviation of the numerator in Mantegna's algorithm, for a stable law of index beta = lam - 1.

    References:
        R. N. Mantegna, Phys. Rev. E 49 (1994) 4677.

    Raises:
        TomThumbError: beta outside (0, 2).
    """
    if not 0.0 < beta < 2.0:
        raise TomThumbError(f"Mantegna's index is in (0, 2), not {beta}")
    top = math.gamma(1.0 + beta) * math.sin(math.pi * beta / 2.0)
    bottom = math.gamma((1.0 + beta) / 2.0) * beta * 2.0 ** ((beta - 1.0) / 2.0)
    return float((top / bottom) ** (1.0 / beta))


def mantegna_steps(rng: np.random.Generator, beta: float, size: int | tuple[int, ...]) -> Array:
    """Signed steps with a tail ~ |x|^-(1 + beta): u / |v|^(1/beta), u ~ N(0, sigma^2), v ~ N(0, 1)."""
    u = rng.normal(0.0, mantegna_sigma(beta), size)
    v = rng.normal(0.0, 1.0, size)
    steps: Array = u / np.abs(v) ** (1.0 / beta)
    return steps


def fit_exponent(lengths: Ids, l_max: int) -> tuple[float, float]:
    """Maximum-likelihood exponent of a truncated discrete power law, and its standard error.

    Args:
        lengths: whole numbers in 1..l_max, (n,), n >= 2.
        l_max: where the law is cut, at least 2.

    Raises:
        TomThumbError: a length outside 1..l_max, or nothing to fit.
    """
    data = np.asarray(lengths)
    if l_max < 2 or data.size < 2 or data.min() < 1 or data.max() > l_max:
        raise TomThumbError(f"the fit needs at least two lengths, all in 1..{l_max}")
    logs = np.log(np.arange(1, l_max + 1))
    wanted = float(np.log(data).mean())
    low, high = -20.0, 60.0  # mean log length falls monotonically with the exponent: bisect
    for _ in range(80):
        lam = 0.5 * (low + high)
        weights = np.exp(-lam * logs)
        low, high = (lam, high) if weights @ logs / weights.sum() > wanted else (low, lam)
    weights = np.exp(-lam * logs)
    weights /= weights.sum()
    information = weights @ logs**2 - (weights @ logs) ** 2
    return lam, float(1.0 / math.sqrt(max(information * data.size, 1e-300)))
