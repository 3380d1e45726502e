"""Against all sign patterns counted one by one, and against scipy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tomthumb.stats import hodges_lehmann, signed_rank, walsh_averages
from tomthumb.stats.signed_rank import EXACT, doubled_ranks


def counted_p(d: np.ndarray) -> float:
    d = d[d != 0]
    ranks = doubled_ranks(np.abs(d))
    got = abs(ranks[d > 0].sum() - ranks.sum() / 2)
    sums = [abs(sum(r for r, s in zip(ranks, signs, strict=True) if s) - ranks.sum() / 2)
            for signs in itertools.product((0, 1), repeat=len(d))]  # fmt: skip
    return float(np.mean(np.array(sums) >= got - 1e-9))


@pytest.mark.parametrize("seed", range(20))
def test_exact_p_equals_counting_with_ties_and_zeros(seed: int) -> None:
    rng = np.random.default_rng(seed)
    d = rng.integers(-4, 6, rng.integers(1, 11)).astype(float)
    assert signed_rank(d).p == pytest.approx(min(1.0, counted_p(d)), abs=1e-12)


def test_equals_scipy_without_ties() -> None:
    from scipy.stats import wilcoxon

    d = np.random.default_rng(1).normal(0.3, 1, 40)
    assert signed_rank(d).p == pytest.approx(wilcoxon(d, method="exact").pvalue, rel=1e-9)


def test_normal_approximation_joins_the_exact_one() -> None:
    d = np.random.default_rng(2).normal(0.15, 1, EXACT + 1)
    assert signed_rank(d).p == pytest.approx(signed_rank(d[:-1]).p, abs=0.03)
    from scipy.stats import wilcoxon

    assert signed_rank(d).p == pytest.approx(wilcoxon(d, method="exact").pvalue, rel=5e-3)


def test_no_difference_at_all() -> None:
    assert signed_rank(np.zeros(7)).p == 1.0
    assert signed_rank(np.zeros(7)).effect == 0.0
    assert signed_rank(np.empty(0)).p == 1.0


def test_effect_is_one_for_a_clean_sweep() -> None:
    assert signed_rank(np.array([0.1, 2.0, 3.0])).effect == 1.0


def test_walsh_averages_by_hand() -> None:
    np.testing.assert_allclose(walsh_averages(np.array([1.0, 3.0])), [1.0, 2.0, 3.0])


@pytest.mark.parametrize("n", [6, 12, 25, 200])
def test_interval_holds_just_what_the_test_does_not_reject(n: int) -> None:
    d = np.random.default_rng(n).normal(1, 1, n)
    _, low, high = hodges_lehmann(d)
    assert signed_rank(d - (low + 1e-9)).p > 0.05 - 1e-3
    assert signed_rank(d - (low - 1e-9)).p <= 0.05 + 1e-3
    assert signed_rank(d - (high + 1e-9)).p <= 0.05 + 1e-3


def test_interval_is_infinite_when_the_sample_cannot_tell() -> None:
    _, low, high = hodges_lehmann(np.array([1.0, 2.0, 3.0]))
    assert (low, high) == (-np.inf, np.inf)
