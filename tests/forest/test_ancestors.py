"""Drogoul and Ferber's three kinds, Tzafestas' regulation, and the plain walkers."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.errors import UnknownName
from tomthumb.forest.ancestors import KINDS, Quarry, Regulation, foraging, quarry


def brought(kind: str, seed: int, steps: int = 600) -> int:
    world = quarry(np.random.default_rng(seed), size=31)
    return [c.brought for c in foraging(world, kind, np.random.default_rng([seed, 1]), steps)][-1]


@pytest.mark.parametrize("kind", KINDS)
def test_samples_are_neither_made_nor_lost(kind: str) -> None:
    world = quarry(np.random.default_rng(1), size=21)
    for colony in foraging(world, kind, np.random.default_rng(2), 300):
        assert colony.stock.sum() + colony.loaded.sum() + colony.brought == world.stock.sum()
        assert colony.stock.min() >= 0
        assert colony.marks.min() >= 0


@pytest.mark.slow
def test_every_kind_beats_the_brownian_walker() -> None:
    mean = {kind: np.mean([brought(kind, seed) for seed in range(5)]) for kind in KINDS}
    assert min(v for k, v in mean.items() if k != "brownian") > mean["brownian"]
    assert mean["gatherers"] > mean["levy"]  # marks are worth more than long flights here
    assert mean["gatherers"] > mean["droppers"]  # trails to exhausted sources mislead


@pytest.mark.parametrize("seed", range(3))
def test_regulated_robots_never_run_out_nor_overflow(seed: int) -> None:
    world, robots = quarry(np.random.default_rng(seed), size=31), 8
    budget = Regulation().budget
    for colony in foraging(world, "regulated", np.random.default_rng(seed), 800, robots):
        assert colony.carried.min() >= 0
        assert colony.carried.max() <= budget
        assert colony.carried.sum() + colony.marks.sum() == robots * (budget // 2)
        assert colony.set_point.min() >= 1.0
        assert colony.set_point.max() <= budget


def test_regulated_trail_grows_while_the_source_pays_and_decays_after() -> None:
    world = Quarry(31, np.array([[5, 6]]), np.array([60]))
    marks, stock = [], []
    for colony in foraging(world, "regulated", np.random.default_rng(0), 3500):
        marks.append(int(colony.marks.sum()))
        stock.append(int(colony.stock[0]))
    found, dry = int(np.argmax(np.array(stock) < 60)), int(np.argmin(stock))
    paying, after = np.array(marks[found:dry]), np.array(marks[dry:])
    assert marks[found] == 0
    assert paying[len(paying) // 2 :].mean() > 5
    assert after[-200:].mean() < 0.3 * paying[len(paying) // 2 :].mean()


def test_regulation_is_monotone_and_bounded() -> None:
    rule = Regulation()
    chances = [rule.chance(carried, 10.0) for carried in range(rule.budget + 1)]
    assert chances[0] == 0.0
    assert chances == sorted(chances)
    assert rule.adapt(20.0, paid=True) < 20.0 < rule.adapt(20.0, paid=False) <= rule.budget


def test_unknown_kind() -> None:
    with pytest.raises(UnknownName, match="gatherers"):
        next(foraging(quarry(np.random.default_rng(0)), "gatherer", np.random.default_rng(0), 1))
