"""What each part is worth, over 200 forests with intervals: the claims of the forest's page."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.forest.exact import hitting, step_table, transition, window_cells
from tomthumb.forest.experiments import boots_contrasts, coming_home, whole_tale
from tomthumb.tale.levy import power_law, scaled_law

FORESTS = 200


@pytest.mark.slow
def test_taught_families_and_stones_come_home_sooner() -> None:
    found = {c.name: c for c in coming_home(FORESTS)}
    for name in (
        "moves home, taught against untaught, crumbs eaten",
        "moves home, taught against untaught, crumbs left",
        "moves home, stones against crumbs",
    ):
        assert found[name].high < 0.0
        assert found[name].forests >= 200


@pytest.mark.slow
def test_boots_shorten_the_way_in_flights_and_lengthen_it_in_distance() -> None:
    flights, distance = boots_contrasts(FORESTS)
    assert flights.high < 0.0
    assert distance.low > 0.0


def test_boots_by_exact_values() -> None:
    walk = power_law(2.0, 16)
    times, ways = [], []
    for alpha in (1.0, 2.0, 4.0, 7.0):
        law = scaled_law(walk, alpha)
        t = float(hitting(transition(step_table(law, 32)), window_cells(32, (0, 0))).mean())
        times.append(t)
        ways.append(t * law.mean)
    assert (np.diff(times) < 0).all()
    assert (np.diff(ways) > 0).all()


@pytest.mark.slow
def test_each_part_of_the_whole_tale_can_be_taken_out() -> None:
    found = {c.name: c for c in whole_tale(FORESTS)}
    assert found["moves to the award, boots"].high < 0.0
    assert found["moves to the award, Lévy flights (against unit steps)"].high < 0.0
