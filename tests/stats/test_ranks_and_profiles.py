"""Ranks against scipy and Demsar's table, profiles by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.stats import critical_difference, growth, performance_profiles, rank


@pytest.mark.parametrize(("k", "q"), [(2, 1.960), (3, 2.343), (5, 2.728), (10, 3.164)])
def test_nemenyi_values_of_demsar(k: int, q: float) -> None:
    assert critical_difference(k, 1) == pytest.approx(q * np.sqrt(k * (k + 1) / 6), rel=1e-3)


def test_friedman_equals_scipy_with_ties() -> None:
    from scipy.stats import friedmanchisquare

    values = np.random.default_rng(0).integers(0, 4, (15, 4)).astype(float)
    assert rank(tuple("abcd"), values).p == pytest.approx(friedmanchisquare(*values.T).pvalue, rel=1e-9)


def test_best_has_rank_one_and_groups_are_what_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(1)
    quality = np.array([3.0, 0.0, 0.05])
    found = rank(("good", "bad", "bad too"), quality + 0.5 * rng.normal(0, 1, (60, 3)))
    assert found.ranks[0] == pytest.approx(1.0, abs=0.05)
    assert found.groups() == [(1, 2)]
    assert rank(("a", "b"), np.array([[1.0, 2.0]]), larger_is_better=False).ranks.tolist() == [1.0, 2.0]


def test_worlds_where_somebody_failed_are_left_out() -> None:
    assert rank(("a", "b"), np.array([[1.0, np.nan], [2.0, 1.0]])).worlds == 1


def test_profiles_by_hand() -> None:
    one, two = performance_profiles(("one", "two"), np.array([[1.0, 2.0], [4.0, 1.0], [1.0, np.nan], [np.inf, np.inf]]))
    assert one.ratio.tolist() == [1.0, 4.0]
    assert one.share.tolist() == [0.5, 0.75]
    assert two.ratio.tolist() == [1.0, 2.0]
    assert two.share.tolist() == [0.25, 0.5]


def test_a_best_cost_of_zero() -> None:
    one, two = performance_profiles(("one", "two"), np.array([[0.0, 1.0]]))
    assert one.share.tolist() == [1.0]
    assert two.share.tolist() == []


def test_growth_of_a_power_law() -> None:
    n = np.array([10.0, 20, 40, 80])
    assert growth(n, 3 * n**1.5) == pytest.approx(1.5)
    assert np.isnan(growth(np.array([5.0]), np.array([1.0])))
