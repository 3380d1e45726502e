"""`minimize`: known minima, reproducibility, budgets, bounds, targets, and the part that makes it find basins."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tomthumb
from tomthumb.errors import TomThumbError
from tomthumb.optimize import minimize


def sphere(x: Any) -> float:
    return float(((x - 0.3) ** 2).sum())


def rosenbrock(x: Any) -> float:
    return float((100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2).sum())


def ellipsoid(x: Any) -> float:
    """Rotated, condition 1e6: only ways that are learned lead down."""
    n = x.size
    Q, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((n, n)))
    return float((10.0 ** np.linspace(0, 6, n) * (Q @ x) ** 2).sum())


def rastrigin(x: Any) -> float:
    return float((x**2 - 10.0 * np.cos(2.0 * math.pi * x) + 10.0).sum())


@pytest.mark.parametrize(
    ("f", "n", "budget"), [(sphere, 1, 1500), (sphere, 2, 1500), (sphere, 20, 8000), (rosenbrock, 5, 8000),
                           (rosenbrock, 10, 20000), (ellipsoid, 8, 12000), (rastrigin, 2, 40_000)]
)  # fmt: skip
def test_known_minima(f: Callable[[Any], float], n: int, budget: int) -> None:
    for seed in range(3):
        found = minimize(f, [(-4.0, 5.0)] * n, rng=seed, max_evaluations=budget, target=1e-9)
        assert found.success, found
        assert found.fun <= 1e-9
        assert found.fun == f(found.x)
        assert found.nfev <= budget


def test_ogre_and_flights_visit_several_basins() -> None:
    found = minimize(rastrigin, [(-4.0, 5.0)] * 3, rng=1, max_evaluations=12_000)
    floors = {tuple(np.round(place).astype(int)) for place, _ in found.basins}
    assert len(floors) >= 2
    assert found.fun == pytest.approx(min(value for _, value in found.basins), abs=1e-6)


def test_same_seed_same_result_and_a_generator_serves() -> None:
    one = minimize(rastrigin, [(-4, 5)] * 2, rng=7, max_evaluations=500)
    two = minimize(rastrigin, [(-4, 5)] * 2, rng=np.random.default_rng(7), max_evaluations=500)
    assert (one.x == two.x).all()
    assert one.nfev == two.nfev == 500


@pytest.mark.parametrize("budget", [1, 7, 100])
def test_the_budget_is_kept_to_the_evaluation_and_the_box_to_the_place(budget: int) -> None:
    asked: list[Any] = []

    def f(x: Any) -> float:
        asked.append(x.copy())
        return float(-x.sum())  # the least value is in a corner

    low, high = np.array([-1.0, 2.0, 10.0]), np.array([1.0, 3.0, 20.0])
    found = minimize(f, np.stack((low, high), axis=1), rng=0, max_evaluations=budget)
    assert len(asked) == found.nfev == budget
    assert (np.array(asked) >= low).all()
    assert (np.array(asked) <= high).all()


def test_starts_where_it_is_told() -> None:
    asked: list[Any] = []

    def f(x: Any) -> float:
        asked.append(x.copy())
        return sphere(x)

    minimize(f, [(-100.0, 100.0)] * 2, rng=0, x0=[90.0, -90.0], max_evaluations=8)
    assert np.abs(np.mean(asked, axis=0) - (90.0, -90.0)).max() < 90.0


def test_nowhere_to_go_and_nan_are_no_reason_to_fail() -> None:
    flat = minimize(lambda x: 3.0, [(0, 1)] * 2, rng=0, max_evaluations=2000)
    assert flat.fun == 3.0
    holes = minimize(lambda x: math.nan if x[0] < 0.0 else sphere(x), [(-1, 1)] * 2, rng=0, target=1e-9)
    assert holes.success
    assert minimize(lambda x: math.nan, [(0, 1)], rng=0, max_evaluations=50).fun == math.inf


def test_scale_of_the_values_does_not_matter() -> None:
    for scale in (1e-12, 1.0, 1e12):
        found = minimize(lambda x, s=scale: s * sphere(x), [(-4, 5)] * 3, rng=2, max_evaluations=2500)
        assert sphere(found.x) < 1e-6


@pytest.mark.parametrize("part", ["ogre", "flights", "boots"])
def test_every_part_can_be_left_out(part: str) -> None:
    whole = minimize(rastrigin, [(-4, 5)] * 2, rng=1, max_evaluations=12_000)
    less = minimize(rastrigin, [(-4, 5)] * 2, rng=1, max_evaluations=12_000, without=[part])
    assert less.nfev == 12_000
    assert less.nit != whole.nit  # the search went another way
    assert less.fun < 1.0


def test_it_is_public() -> None:
    assert tomthumb.minimize is minimize


def test_bad_input_is_one_clear_line() -> None:
    for wrong in (
        lambda: minimize(sphere, [(0, math.inf)]),
        lambda: minimize(sphere, [(1, 0)]),
        lambda: minimize(sphere, []),
        lambda: minimize(sphere, [(0, 1)], x0=[2.0]),
        lambda: minimize(sphere, [(0, 1)], lam=1.0),
        lambda: minimize(sphere, [(0, 1)], max_evaluations=0),
        lambda: minimize(sphere, [(0, 1)], without=["boot"]),
    ):
        with pytest.raises(TomThumbError, match=r"^[^\n]+$"):
            wrong()
