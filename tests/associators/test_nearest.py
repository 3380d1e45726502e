"""Nearest neighbour and global nearest neighbour against every assignment written out; what is near wraps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import chdtri

from associators.brute import matches, random_problem
from tomthumb.associators.nearest import GlobalNearestNeighbour, NearestNeighbour, pair_gains

RNG = np.random.default_rng(0)


def problems(seed, count, **settings):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        m, n = rng.integers(1, 6, 2)
        yield random_problem(rng, int(m), int(n), **settings)


def pair_d2(problem, i, j):
    S = problem.predictions.cov[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] + problem.R[i]
    return float(problem.innovation[i, j] @ np.linalg.solve(S, problem.innovation[i, j]))


def test_nearest_is_the_least_d2_within_the_gate():
    for problem in problems(1, 100):
        match = NearestNeighbour(unique=False).associate(problem, RNG)[0].match
        m, n = problem.shape
        for i in range(m):
            d2 = [pair_d2(problem, i, j) for j in range(n)]
            assert match[i] == (int(np.argmin(d2)) if min(d2) < chdtri(2, 0.01) else -1)


def test_a_landmark_claimed_twice_keeps_its_nearest_claimant():
    lost = 0
    for problem in problems(2, 200):
        free = NearestNeighbour(unique=False).associate(problem, RNG)[0].match
        match = NearestNeighbour().associate(problem, RNG)[0].match
        for j in np.unique(free[free >= 0]):
            claimants = np.flatnonzero(free == j)
            winner = claimants[np.argmin(problem.d2[claimants, j])]
            assert match[winner] == j
            assert (match[np.setdiff1d(claimants, winner)] == -1).all()
            lost += len(claimants) - 1
    assert lost > 0


def test_a_bearing_beyond_half_a_turn_is_near():
    """Seen at +179 deg, expected at -179 deg: 2 deg apart."""
    from tomthumb.kernels.gates import innovations
    from tomthumb.types import AssociationProblem, Predictions

    z, z_hat = np.array([[5.0, np.radians(179)]]), np.array([[5.0, np.radians(-179)], [5.0, np.radians(90)]])
    R = np.diag([0.1, np.radians(1.0)])[None] ** 2
    nu = innovations(z, z_hat, np.array([False, True]))
    problem = AssociationProblem(
        z, R, nu, Predictions(np.arange(2), z_hat, np.zeros((4, 4))), np.ones(1), np.zeros(1), (1,)
    )
    assert problem.d2[0, 0] == pytest.approx(4.0)
    for method in (NearestNeighbour(), GlobalNearestNeighbour()):
        assert method.associate(problem, RNG)[0].match.tolist() == [0]


@pytest.mark.parametrize("cost", ["d2", "likelihood"])
def test_the_assignment_is_the_best_of_all_by_its_stated_cost(cost):
    for problem in problems(3, 150):
        m, n = problem.shape
        gate2 = chdtri(2, 0.01)
        gain = gate2 - problem.d2 if cost == "d2" else pair_gains(problem)
        gain = np.where(problem.d2 < gate2, gain, -1e9)
        some = matches(m, n)
        total = np.where(some >= 0, gain[np.arange(m), np.maximum(some, 0)], 0.0).sum(1)
        match = GlobalNearestNeighbour(cost=cost).associate(problem, RNG)[0].match
        found = sum(gain[i, j] for i, j in enumerate(match) if j >= 0)
        assert found == pytest.approx(total.max(), abs=1e-9)


def test_the_gain_of_a_pair_is_its_log_likelihood_ratio():
    problem = next(problems(4, 1))
    gains, m_n = pair_gains(problem), problem.shape
    for i, j in np.ndindex(m_n):
        S = problem.predictions.cov[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] + problem.R[i]
        density = np.exp(-0.5 * pair_d2(problem, i, j)) / np.sqrt(np.linalg.det(2 * np.pi * S))
        assert gains[i, j] == pytest.approx(np.log(0.95 / 0.05 * density / 0.2), abs=1e-9)


@given(seed=st.integers(0, 2**32 - 1), m=st.integers(1, 9), n=st.integers(1, 9))
@settings(max_examples=50, deadline=None)
def test_no_landmark_twice_and_nothing_outside_the_gate(seed, m, n):
    problem = random_problem(np.random.default_rng(seed), m, n, labels=True)
    for method in (NearestNeighbour(), GlobalNearestNeighbour(), GlobalNearestNeighbour(cost="likelihood")):
        match = method.associate(problem, RNG)[0].match
        rows = np.flatnonzero(match >= 0)
        assert len(np.unique(match[rows])) == len(rows)
        assert (problem.d2[rows, match[rows]] < chdtri(2, 0.01)).all()
        assert problem.allowed[rows, match[rows]].all()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_order_of_the_observations_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, 6, 5)
    order = rng.permutation(6)
    turned = type(problem)(
        problem.z[order], problem.R[order], problem.innovation[order], problem.predictions, problem.clutter,
        problem.serials[order], (), None,
    )  # fmt: skip
    for method in (NearestNeighbour(), GlobalNearestNeighbour()):
        straight = method.associate(problem, RNG)[0].match
        assert np.array_equal(method.associate(turned, RNG)[0].match, straight[order])
