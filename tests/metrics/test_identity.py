"""Purity, IDF1, duplicates and the assignment behind them, against brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handmade import estimate, trace, truth
from tomthumb.metrics.assignment import best_assignment
from tomthumb.metrics.identity import duplicates_and_ghosts, final_ids, identify, purity_and_idf1


def brute_force(table: np.ndarray) -> float:
    wide = table if table.shape[0] <= table.shape[1] else table.T
    columns = itertools.permutations(range(wide.shape[1]), wide.shape[0])
    return max(sum(wide[i, j] for i, j in enumerate(chosen)) for chosen in columns)


@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_assignment_equals_brute_force(rows, cols, seed):
    rng = np.random.default_rng(seed)
    table = rng.integers(0, 4, (rows, cols)).astype(float)  # many zeros: many pieces
    left, right = np.nonzero(table)
    keep, total = best_assignment(left, right, table[left, right])
    assert total == pytest.approx(brute_force(table))
    assert len(set(left[keep])) == len(set(right[keep])) == keep.sum()


def test_a_perfect_run_is_pure():
    run = trace([[0, 1], [0, 1], [0, 1]], estimate([0, 1]))
    assert purity_and_idf1(run, truth([7, 8] * 3, 3, score_from=0)) == (1.0, 1.0)


def test_one_wrong_birth_label_costs_one_observation_not_all():
    run = trace([[0], [0], [0], [0]], estimate([0]))
    purity, idf1 = purity_and_idf1(run, truth([9, 7, 7, 7], 4, score_from=0))
    assert purity == 0.75
    assert idf1 == 0.75


def test_a_split_landmark_is_pure_but_not_one():
    run = trace([[0], [0], [0], [3], [3]], estimate([0, 3]))
    purity, idf1 = purity_and_idf1(run, truth([7] * 5, 5, score_from=0))
    assert purity == 1.0
    assert idf1 == pytest.approx(2 * 3 / (5 + 5))


def test_crumbs_of_clutter_do_not_count_but_clutter_on_a_landmark_does():
    run = trace([[0, 1], [0, 1], [0, 0]], estimate([0, 1]))
    purity, idf1 = purity_and_idf1(run, truth([7, -1, 7, -1, 7, -1], 3, score_from=0))
    assert purity == 0.75
    assert idf1 == pytest.approx(2 * 3 / (3 + 4))


def test_merged_ids_are_mapped_to_the_last_survivor():
    run = trace([[0, 1], [2, 1], [2, 1]], estimate([1]), merged=[[0, 2, 1], [2, 1, 2]])
    assert final_ids(run).tolist() == [1] * 6


def test_duplicates_and_ghosts_are_counted_by_majority_among_confirmed_landmarks():
    scans = [[0, 1, 2, 3], [0, 1, 2, 3]]
    run = trace(scans, estimate([0, 1, 2, 3], stone=[True, True, True, False]))
    _, identity, support = identify(run, truth([7, 7, -1, 7, 7, 7, -1, 7], 2))
    assert identity.tolist() == [7, 7, -1]
    assert support.tolist() == [2, 2, 2]
    assert duplicates_and_ghosts(identity) == (1, 1)
