"""Map errors and GOSPA, against brute force over all assignments."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomthumb.geometry import to_world
from tomthumb.metrics.mapping import gospa, map_errors


def brute_gospa(points: np.ndarray, truth: np.ndarray, c: float) -> float:
    """The definition: the least over all partial assignments of sum d^2 + c^2/2 for every point left over."""
    few, many = (points, truth) if len(points) <= len(truth) else (truth, points)
    best = math.inf
    for size in range(len(few) + 1):
        for rows in itertools.combinations(range(len(few)), size):
            for cols in itertools.permutations(range(len(many)), size):
                cost = sum(np.sum((few[i] - many[j]) ** 2) for i, j in zip(rows, cols, strict=True))
                best = min(best, cost + 0.5 * c**2 * (len(few) + len(many) - 2 * size))
    return math.sqrt(best)


@given(st.integers(0, 4), st.integers(0, 4), st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_gospa_equals_its_definition(n, k, seed):
    rng = np.random.default_rng(seed)
    points, truth = rng.uniform(0, 1, (n, 2)), rng.uniform(0, 1, (k, 2))
    assert gospa(points, truth).distance == pytest.approx(brute_gospa(points, truth, 0.5), abs=1e-9)


def test_gospa_tells_missed_from_false():
    found = gospa(np.array([[0.0, 0.1], [9.0, 9.0]]), np.array([[0.0, 0.0], [5.0, 5.0], [6.0, 6.0]]))
    assert (found.missed, found.false) == (2, 1)
    assert found.location == pytest.approx(0.1)
    assert found.distance == pytest.approx(math.sqrt(0.01 + 3 * 0.125))


def test_map_errors_with_and_without_alignment():
    landmarks = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [np.nan, np.nan]])
    points = to_world(np.array([1.0, 2.0, 0.3]), landmarks[:3])
    aligned, raw = map_errors(points, np.arange(3), np.ones(3, int), landmarks)
    assert aligned == pytest.approx(0.0, abs=1e-12)
    assert raw > 1.0


def test_of_duplicates_the_best_supported_counts_and_unknown_positions_do_not():
    landmarks = np.array([[0.0, 0.0], [4.0, 0.0], [np.nan, np.nan]])
    points = np.array([[9.0, 9.0], [0.0, 0.0], [4.0, 0.0], [7.0, 7.0], [8.0, 8.0]])
    identity, support = np.array([0, 0, 1, 2, -1]), np.array([1, 5, 5, 5, 9])
    assert map_errors(points, identity, support, landmarks)[1] == 0.0
