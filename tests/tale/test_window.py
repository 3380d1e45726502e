"""The 3 x 3 window: figure 3's layout, the majority filter, and the property that nothing inside a gate is missed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomthumb.errors import TomThumbError
from tomthumb.tale.window import PARENTS, TOM, WINDOW, candidates, grid_of, majority_error

coordinate = st.floats(-1e4, 1e4, allow_nan=False)
points = st.lists(st.tuples(coordinate, coordinate), max_size=40).map(lambda p: np.array(p, dtype=float).reshape(-1, 2))


def test_layout_is_figure_3() -> None:
    assert WINDOW == (
        ("parents", "brother1", "brother2"),
        ("brother3", "Tom", "brother5"),
        ("brother4", "brother7", "brother6"),
    )
    assert WINDOW[PARENTS[0]][PARENTS[1]] == "parents"
    assert WINDOW[TOM[0]][TOM[1]] == "Tom"


def test_majority_of_nine_errs_as_the_binomial() -> None:
    assert majority_error(0.1) == pytest.approx(8.9e-4, abs=5e-6)
    wrong = np.random.default_rng(2).random((200_000, 9)) < 0.3
    share = majority_error(0.3)
    assert np.mean(wrong.sum(axis=1) >= 5) == pytest.approx(share, abs=4 * np.sqrt(share / 200_000))


@settings(max_examples=200, deadline=None)
@given(points, points, st.floats(0.01, 5e3), st.floats(0.0, 3e4))
def test_window_contains_the_gate_by_brute_force(cloud, queries, cell: float, reach: float) -> None:  # type: ignore[no-untyped-def]
    start, index = candidates(grid_of(cloud, cell), queries, reach)
    for i, query in enumerate(queries):
        found = index[start[i] : start[i + 1]]
        assert len(set(found.tolist())) == len(found)
        near = np.flatnonzero(np.hypot(*(cloud - query).T) <= reach) if len(cloud) else np.zeros(0, int)
        assert set(near) <= set(found.tolist())


def test_without_reach_it_is_exactly_the_nine_cells() -> None:
    rng = np.random.default_rng(4)
    cloud, queries = rng.uniform(-9, 9, (500, 2)), rng.uniform(-11, 11, (50, 2))
    start, index = candidates(grid_of(cloud, 1.5), queries)
    cells, middle = np.floor(cloud / 1.5), np.floor(queries / 1.5)
    for i in range(len(queries)):
        expected = np.flatnonzero(np.abs(cells - middle[i]).max(axis=1) <= 1)
        assert index[start[i] : start[i + 1]].tolist() == expected.tolist()


def test_each_query_has_its_own_reach_and_infinity_takes_all() -> None:
    cloud = np.array([[0.0, 0.0], [10.0, 0.0], [1e6, -1e6]])
    start, index = candidates(grid_of(cloud, 1.0), np.zeros((3, 2)), np.array([0.0, 10.0, np.inf]))
    assert [index[a:b].tolist() for a, b in pairwise(start)] == [[0], [0, 1], [0, 1, 2]]


def test_no_points_no_candidates() -> None:
    start, index = candidates(grid_of(np.zeros((0, 2)), 1.0), np.ones((2, 2)), 5.0)
    assert start.tolist() == [0, 0, 0]
    assert not index.size


def test_bad_input_is_one_clear_line() -> None:
    good = grid_of(np.zeros((1, 2)), 1.0)
    for wrong in (
        lambda: grid_of(np.zeros((1, 2)), 0.0),
        lambda: grid_of(np.array([[np.nan, 0.0]]), 1.0),
        lambda: grid_of(np.array([[1e12, 0.0]]), 1.0),
        lambda: candidates(good, np.array([[np.inf, 0.0]])),
        lambda: candidates(good, np.zeros((1, 2)), -1.0),
        lambda: candidates(good, np.zeros((1, 2)), np.nan),
    ):
        with pytest.raises(TomThumbError, match=r"^[^\n]+$"):
            wrong()
