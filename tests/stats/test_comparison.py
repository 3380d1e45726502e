"""False alarms as often as promised, true differences found as often as promised."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.stats import (
    BETTER,
    CANNOT_TELL,
    SAME,
    WORSE,
    compare,
    correct,
    error_bound,
    holm,
    mean_interval,
    normal_pilot,
    pilot,
    power,
    seeds_needed,
    signed_rank,
)

TRIALS = 1000
BAND = 3.29  # standard deviations: 1 in 1000


def binomial_band(p: float) -> tuple[float, float]:
    half = BAND * np.sqrt(p * (1 - p) / TRIALS)
    return p - half, p + half


def rejections(rng: np.random.Generator, draw, n: int) -> float:  # type: ignore[no-untyped-def]
    return float(np.mean([signed_rank(draw(n)).p < 0.05 for _ in range(TRIALS)]))


@pytest.mark.parametrize("family", ["normal", "skewed", "heavy"])
def test_two_samples_of_one_method_differ_as_often_as_they_should(family: str) -> None:
    rng = np.random.default_rng(5)
    families = {
        "normal": rng.standard_normal,
        "skewed": rng.standard_exponential,
        "heavy": lambda n: rng.standard_t(2, n),
    }
    one = families[family]
    low, high = binomial_band(0.05)
    assert low <= rejections(rng, lambda n: one(n) - one(n), 30) <= high


def test_coarse_values_never_alarm_more_often() -> None:
    """Match rates of 1390 decisions are mostly ties: the exact test may then be careful, never rash."""
    rng = np.random.default_rng(6)
    rate = rejections(rng, lambda n: (rng.binomial(1390, 0.003, n) - rng.binomial(1390, 0.003, n)) / 1390, 50)
    assert rate <= binomial_band(0.05)[1]
    assert rate >= 0.02


@pytest.mark.parametrize("size", [0.3, 0.5, 1.0])
def test_a_known_difference_is_found_at_the_promised_power(size: float) -> None:
    rng = np.random.default_rng(7)
    n = seeds_needed(normal_pilot(size), 0.8)
    assert n is not None
    found = rejections(rng, lambda k: rng.normal(size, 1, k), n)
    low, high = binomial_band(power(normal_pilot(size), n))
    assert low <= found <= high


def test_power_from_a_pilot_sample_of_another_family() -> None:
    rng = np.random.default_rng(8)
    sample = pilot(rng.laplace(0.4, 1, 1500))
    n = seeds_needed(sample, 0.9)
    assert n is not None
    assert rejections(rng, lambda k: rng.laplace(0.4, 1, k), n) == pytest.approx(0.9, abs=0.05)


def test_pilot_equals_the_closed_form_in_the_limit() -> None:
    sample, exact = pilot(np.random.default_rng(9).normal(0.5, 1, 2500)), normal_pilot(0.5)
    for name in ("moved", "one", "two", "mixed", "pair"):
        assert getattr(sample, name) == pytest.approx(getattr(exact, name), abs=0.02)


def test_no_number_of_seeds_tells_equals_apart() -> None:
    assert seeds_needed(normal_pilot(0.0)) is None
    assert seeds_needed(pilot(np.zeros(20))) is None
    assert seeds_needed(normal_pilot(10.0)) == 6  # 2 / 2^6 < .05 < 2 / 2^5


def test_words() -> None:
    rng = np.random.default_rng(0)
    base = rng.normal(0, 1, 40)
    assert compare(base + 1, base, rng).verdict == BETTER
    assert compare(base + 1, base, rng, larger_is_better=False).verdict == WORSE
    assert compare(base, base, rng).verdict == SAME
    assert compare(base + np.tile([0.5, -0.6, 0.7, -0.5], 10), base, rng).verdict == CANNOT_TELL
    assert compare(base[:3] + 1, base[:3], rng).verdict == CANNOT_TELL
    assert compare(np.array([]), np.array([]), rng).verdict == CANNOT_TELL


def test_a_mean_against_the_ranks_tells_nothing() -> None:
    d = np.concatenate([np.full(30, 0.1) + np.arange(30) * 1e-3, [-100.0]])
    found = compare(d, np.zeros(31), np.random.default_rng(0))
    assert found.p < 0.05
    assert found.mean < 0
    assert found.verdict == CANNOT_TELL


def test_rows_that_failed_on_either_side_are_left_out() -> None:
    found = compare(np.array([1.0, np.nan, 3.0]), np.array([0.0, 0.0, np.nan]), np.random.default_rng(0))
    assert found.n == 1


def test_holm_by_hand_and_in_order() -> None:
    np.testing.assert_allclose(holm([0.04, 0.01, 0.03]), [0.06, 0.03, 0.06])
    assert len(holm([])) == 0


def test_correction_takes_significance_away() -> None:
    rng = np.random.default_rng(3)
    d = rng.normal(0.38, 1, 40)
    single = compare(d, np.zeros(40), rng)
    assert single.verdict == BETTER
    others = [compare(rng.normal(0, 1, 40), np.zeros(40), rng) for _ in range(30)]
    assert correct([single, *others])[0].verdict == CANNOT_TELL


def test_holm_family_of_nulls_errs_in_five_percent_of_families() -> None:
    rng = np.random.default_rng(11)
    families = [min(holm([signed_rank(rng.normal(0, 1, 25)).p for _ in range(6)])) < 0.05 for _ in range(TRIALS)]
    assert np.mean(families) <= binomial_band(0.05)[1]


@pytest.mark.parametrize(("skewed", "least"), [(False, 0.91), (True, 0.87)])
def test_bootstrap_interval_covers(skewed: bool, least: float) -> None:
    """BCa with 40 runs: 94 % for normal values, about 92 % for exponential ones, here less 3 deviations."""
    rng = np.random.default_rng(4)
    draw = rng.standard_exponential if skewed else lambda n: rng.normal(1, 1, n)
    intervals = [mean_interval(draw(40), rng, resamples=1000) for _ in range(400)]
    assert least <= np.mean([low <= 1.0 <= high for low, high in intervals]) <= 0.98


def test_interval_of_equal_values_and_of_one_value() -> None:
    rng = np.random.default_rng(0)
    assert mean_interval(np.full(5, 1.0), rng) == (1.0, 1.0)
    assert mean_interval(np.array([1.0]), rng) == (-np.inf, np.inf)


def test_rule_of_three() -> None:
    assert error_bound(0, 300) == pytest.approx(3 / 300, rel=0.01)
    assert error_bound(5, 5) == 1.0
