"""Exact hitting times: every value of the table, to its last digit, and simulated flights within their error."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tomthumb.errors import TomThumbError
from tomthumb.forest.exact import (
    FOUR,
    hitting,
    hitting_one_cell,
    loop_odds,
    step_table,
    transition,
    window_cells,
)
from tomthumb.forest.rules import Rules
from tomthumb.forest.tell import tell
from tomthumb.forest.walkers import flights_until_seen
from tomthumb.forest.world import bare
from tomthumb.tale.levy import LengthLaw, power_law, scaled_law

N = 32
# lambda (None: the simple walk), H one cell, H through 3x3, mean length, distance to one cell, distance through 3x3
TABLE = [
    (1.2, 1057.5146, 161.0571, 4.0327, 4264.6, 649.5),
    (1.5, 1083.6666, 186.8261, 3.1433, 3406.3, 587.2),
    (2.0, 1157.2735, 251.2290, 2.1338, 2469.4, 536.1),
    (2.5, 1267.7929, 343.6517, 1.5922, 2018.6, 547.2),
    (3.0, 1400.1565, 453.9874, 1.3200, 1848.3, 599.3),
    (None, 1877.7300, 846.8621, 1.0, 1877.7, 846.9),
]
HOME, OGRE, KING = (0, 0), (5, 6), (11, 3)
LOOP = [(1.5, 0.496541, 0.248969, 4.0166), (2.0, 0.481195, 0.244011, 4.0982), (3.0, 0.410164, 0.212390, 4.7083)]


def law_of(lam: float | None, n: int = N) -> LengthLaw:
    return power_law(lam, n // 2) if lam else power_law(1.0, 1)


def through_window(law: LengthLaw, n: int = N) -> float:
    return float(hitting(transition(step_table(law, n)), window_cells(n, (3, 5))).mean())


@pytest.mark.parametrize(("lam", "one", "window", "mean", "distance", "window_distance"), TABLE)
def test_every_value_of_the_table(
    lam: float | None, one: float, window: float, mean: float, distance: float, window_distance: float
) -> None:
    law = law_of(lam)
    table = step_table(law, N)
    assert table.sum() == pytest.approx(1.0)
    assert round(hitting_one_cell(table), 4) == one
    assert round(law.mean, 4) == mean
    assert round(hitting_one_cell(table) * law.mean, 1) == distance
    solved = through_window(law)
    assert round(solved, 4) == window
    assert round(solved * law.mean, 1) == window_distance


def test_the_smaller_torus() -> None:
    law = power_law(2.0, 8)
    assert round(hitting_one_cell(step_table(law, 16)), 4) == 283.7145
    assert round(through_window(law, 16), 4) == 56.6564


@pytest.mark.parametrize("law", [power_law(2.0, 5), scaled_law(power_law(1.7, 6), 2.5)])
def test_fourier_sum_is_the_linear_solve(law: LengthLaw) -> None:
    for directions in (None, FOUR):
        table = step_table(law, 12) if directions is None else step_table(law, 12, directions)
        one = np.zeros(144, bool)
        one[77] = True
        assert hitting(transition(table), one).mean() == pytest.approx(hitting_one_cell(table))


def test_distance_is_least_near_two_through_the_window_and_not_for_one_cell() -> None:
    exponents = np.arange(1.1, 3.01, 0.1)
    laws = [power_law(float(lam), N // 2) for lam in exponents]
    window = [through_window(law) * law.mean for law in laws]
    single = [hitting_one_cell(step_table(law, N)) * law.mean for law in laws]
    assert 1.9 <= exponents[int(np.argmin(window))] <= 2.3
    assert (np.diff(single) < 0).all()  # a single cell: the shorter the flights, the shorter the way


@pytest.mark.parametrize("row", TABLE)
@pytest.mark.parametrize("through", ["one cell", "3x3"])
def test_simulated_flights_agree(row: tuple[float | None, ...], through: str) -> None:
    lam, expected = row[0], row[1] if through == "one cell" else row[2]
    flights, distances = flights_until_seen(
        law_of(lam), N, through == "3x3", repeats=2500, rng=np.random.default_rng([int((lam or 9) * 10), len(through)])
    )
    assert expected is not None
    assert abs(flights.mean() - expected) < 3 * flights.std() / math.sqrt(len(flights))
    assert distances.sum() / flights.sum() == pytest.approx(law_of(lam).mean, rel=0.02)


@pytest.mark.parametrize(("lam", "ogre", "success", "iterations"), LOOP)
def test_whole_loop_odds(lam: float, ogre: float, success: float, iterations: float) -> None:
    table = step_table(power_law(lam, 8), 16)
    odds = loop_odds(table, table, HOME, OGRE, KING, outward=10)
    assert round(odds.ogre, 6) == ogre
    assert round(odds.success, 6) == pytest.approx(success, abs=1e-9)
    assert round(odds.iterations, 4) == iterations


@pytest.mark.parametrize(("lam", "ogre", "success", "iterations"), LOOP)
def test_the_family_itself_has_these_odds(lam: float, ogre: float, success: float, iterations: float) -> None:
    rules = Rules(lam=lam, stones="never", birds=1.0, plasticity=None, boots=1.0)
    rng, forest = np.random.default_rng(7), bare(16, HOME, OGRE, KING)
    tales = [tell(forest, rng, rules) for _ in range(1500)]
    passes = np.array([t.iterations for t in tales])
    total = passes.sum()
    for count, p in ((sum(t.ogre_visits for t in tales), ogre), (sum(t.awards for t in tales), success)):
        assert abs(count / total - p) < 3 * math.sqrt(p * (1 - p) / total)
    assert abs(passes.mean() - iterations) < 3 * passes.std() / math.sqrt(len(passes))


def test_boots_have_their_exact_odds_too() -> None:
    law = power_law(2.0, 8)
    walk, boots = step_table(law, 16), step_table(scaled_law(law, 5.0), 16)
    p = loop_odds(walk, boots, HOME, OGRE, KING, outward=10).success
    rules = Rules(stones="never", birds=1.0, plasticity=None, boots=5.0)
    rng, forest = np.random.default_rng(8), bare(16, HOME, OGRE, KING)
    passes = sum(tell(forest, rng, rules).iterations for _ in range(1500))
    assert abs(1500 / passes - p) < 3 * math.sqrt(p * (1 - p) / passes)


def test_too_large_for_a_dense_solve() -> None:
    with pytest.raises(TomThumbError, match="at most"):
        transition(np.zeros((200, 200)))
