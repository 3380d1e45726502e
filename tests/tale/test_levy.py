"""Lengths of flights: exact laws, goodness of fit, fitted exponents, Mantegna's constants, and the boots' lattice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import gammaincc

from tomthumb.errors import TomThumbError
from tomthumb.kernels.levy import levy_length
from tomthumb.tale.levy import (
    fit_exponent,
    law_of,
    mantegna_sigma,
    mantegna_steps,
    pareto_lengths,
    power_law,
    scaled_law,
)

EXPONENTS = [1.5, 2.0, 2.5, 3.0]


def chi_square_p(counts: np.ndarray, expected: np.ndarray) -> float:
    statistic = float(((counts - expected) ** 2 / expected).sum())
    return float(gammaincc((len(counts) - 1) / 2, statistic / 2))


@pytest.mark.parametrize("lam", EXPONENTS)
def test_lengths_fit_their_law(lam: float) -> None:
    law = power_law(lam, 64)
    lengths = law.draw(np.random.default_rng(11), 200_000)
    counts = np.bincount(lengths, minlength=65)[1:]
    assert chi_square_p(counts, law.pmf * lengths.size) > 0.001


@pytest.mark.parametrize("lam", EXPONENTS)
def test_fitted_exponent_covers_the_set_one(lam: float) -> None:
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(40):
        fitted, se = fit_exponent(power_law(lam, 128).draw(rng, 5000), 128)
        errors.append((fitted - lam) / se)
    assert np.mean(np.abs(errors) < 1.96) >= 0.85  # 95 % nominal; 34 of 40 has a chance of 0.4 % to be missed
    assert abs(np.mean(errors)) < 3 / math.sqrt(40)


@pytest.mark.parametrize("l_max", [1, 2, 3, 7, 16, 1000])
def test_galloping_search_is_the_plain_one(l_max: int) -> None:
    law = power_law(1.3, l_max)
    for u in np.concatenate((np.random.default_rng(0).random(300), law.cdf[:-1], [0.0, 1 - 2**-53])):
        assert levy_length(law.cdf, u) == int(np.searchsorted(law.cdf, u, side="right")) + 1


@pytest.mark.parametrize(("beta", "sigma"), [(1.0, 1.000000), (1.5, 0.696575), (1.9, 0.333819)])
def test_mantegna_constants(beta: float, sigma: float) -> None:
    assert mantegna_sigma(beta) == pytest.approx(sigma, abs=5e-7)


def test_mantegna_tail() -> None:
    steps = np.abs(mantegna_steps(np.random.default_rng(3), 1.0, 400_000))
    # beta = 1 is exactly Cauchy: P(|x| > q) = 1 - 2 atan(q) / pi
    for q in (1.0, 5.0, 50.0):
        share = 1 - 2 * math.atan(q) / math.pi
        assert np.mean(steps > q) == pytest.approx(share, abs=4 * math.sqrt(share / steps.size))


@pytest.mark.parametrize("lam", EXPONENTS)
def test_pareto_tail(lam: float) -> None:
    lengths = pareto_lengths(np.random.default_rng(3), lam, 100_000, l_min=2.0)
    assert lengths.min() >= 2.0
    share = 4.0 ** (1 - lam)
    assert np.mean(lengths > 8.0) == pytest.approx(share, abs=4 * math.sqrt(share / lengths.size))


@pytest.mark.parametrize("alpha", [1.0, 1.5, 2.0, 3.0, 4.0, 7.0, 16.0, 30.9])
def test_boots_never_confine_the_walk_to_a_sublattice(alpha: float) -> None:
    law = scaled_law(power_law(2.0, 16), alpha)
    possible = np.flatnonzero(law.pmf > 0) + 1
    assert math.gcd(*possible.tolist()) == 1


def test_scaled_lengths_are_the_rounded_ones() -> None:
    rng = np.random.default_rng(8)
    base, alpha = power_law(2.0, 32), 3.0
    spread = base.draw(rng, 400_000) + rng.random(400_000) - 0.5
    rounded = np.floor(alpha * spread + 0.5).astype(int)
    counts = np.bincount(rounded[rounded <= 32], minlength=33)[1:]
    law = scaled_law(base, alpha)
    possible = law.pmf > 0
    assert not counts[~possible].any()
    assert chi_square_p(counts[possible], law.pmf[possible] * counts.sum()) > 0.001


def test_alpha_one_is_the_law_itself_and_boots_lengthen() -> None:
    law = power_law(2.0, 16)
    assert scaled_law(law, 1.0) is law
    assert np.allclose(scaled_law(law, 1.0 + 1e-12).pmf, law.pmf, atol=1e-10)
    means = [scaled_law(law, alpha).mean for alpha in (1.0, 2.0, 4.0, 7.0)]
    assert means == sorted(means)


def test_bad_input_is_one_clear_line() -> None:
    for wrong in (
        lambda: power_law(math.nan, 4),
        lambda: power_law(2.0, 0),
        lambda: law_of(np.zeros(3)),
        lambda: scaled_law(power_law(2, 8), 15.0),
        lambda: scaled_law(power_law(2, 8), 0.5),
        lambda: pareto_lengths(np.random.default_rng(0), 1.0, 3),
        lambda: mantegna_sigma(2.0),
        lambda: fit_exponent(np.array([1, 9]), 8),
    ):
        with pytest.raises(TomThumbError, match=r"^[^\n]+$"):
            wrong()
