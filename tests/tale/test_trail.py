"""Stones keep, crumbs fade, and the followed length of a trail with losses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tomthumb.errors import TomThumbError
from tomthumb.tale.trail import followed_length, mark_strength, next_mark, strengths


def test_crumbs_fade_with_their_time_constant_and_stones_do_not() -> None:
    ages = np.arange(200)
    stones = strengths(ages, 30.0, np.ones(200, bool))
    crumbs = strengths(ages, 30.0, np.zeros(200, bool))
    assert (stones == 1.0).all()
    assert crumbs[1:] / crumbs[:-1] == pytest.approx(math.exp(-1 / 30.0))
    assert [mark_strength(float(a), 30.0, False) for a in ages] == pytest.approx(crumbs)
    assert mark_strength(1e9, 30.0, True) == 1.0


def test_next_mark_is_the_highest_lower_number() -> None:
    numbers = np.array([-1, 3, 7, 9, 8])
    full = np.ones(5)
    assert next_mark(numbers, full, 9, 0.5) == 4
    assert next_mark(numbers, full, 8, 0.5) == 2
    assert next_mark(numbers, np.array([1, 1, 0.2, 1, 1]), 8, 0.5) == 1
    assert next_mark(numbers, full, 3, 0.5) == -1


@pytest.mark.parametrize(("loss", "length"), [(0.0, 12), (0.1, 30), (0.3, 5), (1.0, 9)])
def test_followed_length_on_a_straight_trail(loss: float, length: int) -> None:
    kept = np.random.default_rng(6).random((100_000, length)) >= loss
    followed = np.cumprod(kept, axis=1).sum(axis=1)
    tolerance = 4 * followed.std() / math.sqrt(len(followed)) + 1e-12
    assert followed.mean() == pytest.approx(followed_length(loss, length), abs=tolerance)


def test_bad_time_constant() -> None:
    with pytest.raises(TomThumbError, match="time constant"):
        strengths(np.arange(2), 0.0, np.zeros(2, bool))
