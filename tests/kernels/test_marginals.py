"""Probabilities of pairings with the pose integrated out, and the decision by them, against exhaustive ones."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from associators.brute import random_problem, tabulate
from tomthumb.associators.tom_thumb.basins import Basin, at_pose
from tomthumb.associators.tom_thumb.decision import most_probable, sampled_marginals
from tomthumb.associators.tom_thumb.scene import rigid, window
from tomthumb.gains import base_gains
from tomthumb.kernels import marginals, posterior
from tomthumb.kernels.left_out import left_out_gains

WIDE = 1.0 - 1e-6


def small_problem(rng):
    """Three observations of three landmarks, the pose a little uncertain, so that linearisation is exact enough."""
    return random_problem(rng, 3, 3, spread=1.0, pose=0.06, own=0.1, noise=0.1)


def exact(problem, base):
    """Probabilities (m, n) and (m,) by the sum over every one-to-one hypothesis."""
    table = tabulate(problem, WIDE)
    L = np.where(table.compatible, table.posterior(base), -np.inf)
    weights = np.exp(L - L.max())
    weights /= weights.sum()
    m, n = problem.shape
    p = np.array([[weights[table.matches[:, i] == j].sum() for j in range(n)] for i in range(m)])
    return p, np.array([weights[table.matches[:, i] < 0].sum() for i in range(m)]), table.matches[L.argmax()]


def test_poses_integrated_out_give_the_exhaustive_probabilities():
    """Belief propagation and linearisation are approximate: .02 on average, .2 at worst."""
    rng, errors = np.random.default_rng(1), []
    for _ in range(30):
        problem = small_problem(rng)
        own, odds = base_gains(problem, None)
        base = own[:, None] + odds
        p, none, best = exact(problem, base)
        s, near = rigid(problem, own, odds), window(problem.d2, WIDE)
        assert s is not None
        given = problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, base
        gains = left_out_gains(best, *given, near.start, near.columns)
        basin = at_pose(s, Basin(best, posterior.value_of(best, *given)[0], gains, near), 27.6)
        q, alone = sampled_marginals([basin], s, 1500, 27.6, rng)
        assert np.allclose(q.sum(1) + alone, 1.0)
        errors += [np.abs(q - p).max(), np.abs(alone - none).max()]
    assert np.mean(errors) < 0.02
    assert np.max(errors) < 0.2


def test_the_decision_is_the_assignment_of_greatest_expected_number_of_right_ones():
    rng, contested = np.random.default_rng(2), 0
    for _ in range(300):
        m, n = rng.integers(1, 7, 2)
        p = rng.dirichlet(np.full(n + 1, 0.4), m)
        none, p = p[:, -1].copy(), np.ascontiguousarray(p[:, :-1])
        p[p < 2e-3] = 0.0
        match, chance = most_probable(p, none, 0.0)
        gain = np.maximum(p - none[:, None], 0.0)
        best = none.sum() + gain[linear_sum_assignment(gain, maximize=True)].sum()
        paired = match[match >= 0]
        assert len(np.unique(paired)) == len(paired)
        assert np.isclose(chance.sum(), best)
        contested += not marginals.pick(p, none, 0.0)[2]
    assert contested > 50


def test_a_pairing_less_probable_than_the_level_is_left_unpaired():
    p, none = np.array([[0.6, 0.1], [0.1, 0.8]]), np.array([0.3, 0.1])
    assert most_probable(p, none, 0.0)[0].tolist() == [0, 1]
    assert most_probable(p, none, 0.7)[0].tolist() == [-1, 1]
