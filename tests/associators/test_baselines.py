"""The other associators, each by its own criterion against brute force, and on problems where their answer is known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import chdtri

from associators.brute import random_problem, tabulate
from tomthumb.associators.clique import PairwiseConsistency
from tomthumb.associators.ipjc import PosteriorCompatibility
from tomthumb.associators.jcbb import JointCompatibility
from tomthumb.associators.maximum import MaximumPosterior
from tomthumb.associators.randomized import RandomizedCompatibility
from tomthumb.associators.sequential import SequentialNearestNeighbour, begin
from tomthumb.associators.singles import Singles
from tomthumb.associators.tom_thumb.scene import lever, rigid
from tomthumb.errors import TomThumbError
from tomthumb.gains import base_gains
from tomthumb.kernels import clique, ipjc
from tomthumb.kernels.gates import innovations
from tomthumb.types import AssociationProblem, Predictions

RNG = np.random.default_rng(0)


def problems(seed, count, most=5, **settings):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        m, n = rng.integers(1, most + 1, 2)
        yield random_problem(rng, int(m), int(n), spread=float(rng.uniform(0.4, 2.0)), **settings)


# --- map --------------------------------------------------------------------------------------------------------------


def test_map_is_the_most_probable_hypothesis():
    for problem in problems(1, 200):
        found = MaximumPosterior().associate(problem, RNG)[0]
        own, odds = base_gains(problem, None)
        table = tabulate(problem, 1 - 1e-6)
        dense = np.where(table.compatible, table.posterior(own[:, None] + odds[None]), -np.inf)
        assert found.info["proof"] == "optimal"
        assert found.info["objective"] == pytest.approx(dense.max(), abs=1e-8)
        assert dense[np.flatnonzero((table.matches == found.match).all(1))[0]] == pytest.approx(dense.max(), abs=1e-8)


def test_map_returns_the_next_best_in_order():
    for problem in problems(2, 40, most=4):
        found = MaximumPosterior(hypotheses=4).associate(problem, RNG)
        own, odds = base_gains(problem, None)
        table = tabulate(problem, 1 - 1e-6)
        dense = np.where(table.compatible, table.posterior(own[:, None] + odds[None]), -np.inf)
        best = np.sort(dense)[::-1][:4]
        wanted = best[best >= best[0] - 3.0]
        assert [h.log_weight for h in found] == pytest.approx(list(wanted), abs=1e-8)


def test_map_tells_a_spent_budget_and_knows_no_limit():
    problem = random_problem(np.random.default_rng(3), 9, 9, spread=0.5, pose=0.5)
    cut = MaximumPosterior(budget=20).associate(problem, RNG)[0]
    whole = MaximumPosterior(budget=0).associate(problem, RNG)[0]
    assert cut.info["proof"] == "truncated"
    assert whole.info["proof"] == "optimal"
    assert whole.info["objective"] >= cut.info["objective"]


# --- ipjc -------------------------------------------------------------------------------------------------------------


def turned(rng, m, n, degrees, metres=0.3, angles=()):
    """Correlated only by a rigid motion, which may turn far: where linearisation fails."""
    points = rng.uniform(-4, 4, (n, 2)) + (np.array([12.0, 0.0]) if angles else 0.0)
    Xi = np.diag([metres, metres, np.radians(degrees)]) ** 2
    tx, ty, theta = np.linalg.cholesky(Xi) @ rng.standard_normal(3)
    c, s = np.cos(theta), np.sin(theta)
    moved = points @ np.array([[c, -s], [s, c]]).T + [tx, ty]
    truth = rng.permutation(n)[:m]
    z = moved[truth] + 0.05 * rng.standard_normal((m, 2))
    B = lever(points).reshape(-1, 3)
    predictions = Predictions(np.arange(n), points, B @ Xi @ B.T + 0.02**2 * np.eye(2 * n), Xi, B @ Xi)
    R = np.tile(0.05**2 * np.eye(2), (m, 1, 1))
    nu = innovations(z, points, np.zeros(2, bool))
    return AssociationProblem(z, R, nu, predictions, np.full(m, 0.1), np.arange(m)), truth


def test_posterior_d2_is_the_minimum_over_all_motions():
    rng = np.random.default_rng(4)
    for _ in range(15):
        problem, truth = turned(rng, 5, 6, 6.0)
        s = rigid(problem, np.zeros(5), np.zeros(6))
        prior = np.linalg.inv(s.Xi)

        def cost(xi, s=s, prior=prior, truth=truth):
            c, d = np.cos(xi[2]), np.sin(xi[2])
            r = s.q - (s.p[truth] @ np.array([[c, -d], [d, c]]).T + xi[:2])
            V = s.R + s.D[truth]
            return float(xi @ prior @ xi + np.einsum("ki,kij,kj->", r, np.linalg.inv(V), r))

        pose = np.zeros(3)
        found = ipjc.posterior_d2(pose, np.arange(5), truth, 5, s.q, s.R, s.p, s.D, prior)
        best = min(
            minimize(cost, x0, method="Nelder-Mead", options={"fatol": 1e-9, "xatol": 1e-9}).fun
            for x0 in (pose, np.zeros(3))
        )
        assert found == pytest.approx(best, rel=1e-4, abs=1e-4)
        assert found == pytest.approx(cost(pose), abs=1e-9)


def test_ipjc_is_jcbb_where_the_motion_is_small():
    """Linear problems: the same chi2, so the same decisions."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        problem, _ = turned(rng, 5, 6, 0.1, metres=0.02)
        found, plain = (
            method.associate(problem, RNG)[0] for method in (PosteriorCompatibility(), JointCompatibility())
        )
        assert found.info["form"] == "posterior"
        assert np.array_equal(found.match, plain.match)
        assert found.info["joint_d2"] == pytest.approx(plain.info["joint_d2"], rel=0.01, abs=0.01)


def test_ipjc_keeps_right_pairs_that_linearisation_loses():
    rng, right, linear = np.random.default_rng(6), 0, 0
    for _ in range(40):
        problem, truth = turned(rng, 6, 8, 12.0)
        right += int((PosteriorCompatibility().associate(problem, RNG)[0].match == truth).sum())
        linear += int((JointCompatibility().associate(problem, RNG)[0].match == truth).sum())
    assert right > 0.95 * 240
    assert right > linear + 10


def test_ipjc_keeps_its_own_joint_test_and_the_criterion_of_jcbb():
    """Against all hypotheses up to 4 x 4, chi2 by the kernel that the test above holds against a minimiser."""
    rng = np.random.default_rng(7)
    for _ in range(40):
        problem, _ = turned(rng, 4, 4, 8.0, metres=1.5)
        found = PosteriorCompatibility(0.95).associate(problem, RNG)[0]
        s = rigid(problem, np.zeros(4), np.zeros(4))
        prior = np.linalg.inv(s.Xi)
        best = (0, np.inf)
        for some in itertools.permutations([0, 1, 2, 3, -1, -1, -1, -1], 4):
            match = np.array(some)
            rows = np.flatnonzero(match >= 0)
            ok, d2 = True, 0.0
            for k in range(1, len(rows) + 1):
                d2 = ipjc.posterior_d2(np.zeros(3), rows, match[rows], k, s.q, s.R, s.p, s.D, prior)
                ok &= d2 < chdtri(2 * len(rows), 0.05)
            if ok and (len(rows), -d2) > (best[0], -best[1]):
                best = (len(rows), d2)
        pairs = int((found.match >= 0).sum())
        assert pairs <= best[0]  # brute force asks the whole set only, the search every prefix by its own gate
        assert pairs == 0 or found.info["joint_d2"] < chdtri(2 * pairs, 0.05)


def test_ipjc_falls_back_to_the_linear_test():
    for problem in problems(8, 20, most=2):
        found = PosteriorCompatibility().associate(problem, RNG)[0]
        assert found.info["form"] == "linear"
        assert np.array_equal(found.match, JointCompatibility().associate(problem, RNG)[0].match)


# --- singles, scnn, rjc -----------------------------------------------------------------------------------------------


def test_singles_are_the_pairs_without_rivals():
    for problem in problems(9, 100):
        match = Singles().associate(problem, RNG)[0].match
        inside = problem.d2 < chdtri(2, 0.01)
        for i, j in np.ndindex(*problem.shape):
            lonely = inside[i, j] and inside[i].sum() == 1 and inside[:, j].sum() == 1
            assert (match[i] == j) == lonely


def test_conditioning_is_that_of_the_joint_gaussian():
    """Conditional d2 after two pairings, against the dense chain rule D2(three) - D2(two)."""
    from tomthumb.kernels.posterior import value_of

    for problem in problems(10, 60, most=5):
        m, n = problem.shape
        if m < 3 or n < 3:
            continue
        state, near = begin(problem, 1 - 1e-12)
        if len(near) < n:
            continue
        state.accept(0, 0)
        state.accept(1, 1)
        args = (problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, np.zeros((m, n)))
        match = np.full(m, -1)
        match[:2] = 0, 1
        two = value_of(match, *args)[1]
        assert state.joint_d2 == pytest.approx(two, abs=1e-8)
        match[2] = 2
        assert state.d2(2)[2] == pytest.approx(value_of(match, *args)[1] - two, abs=1e-7)
        assert np.isinf(state.d2(2)[:2]).all()


def test_scnn_resolves_what_the_first_pairing_explains():
    """A shift of 1 m: by itself the second observation is nearer to the wrong landmark, after the first it is not."""
    points, shift = np.array([[20.0, 0.0], [0.0, 0.0], [1.4, 0.0]]), np.array([1.0, 0.0])
    cov = np.kron(np.ones((3, 3)), np.eye(2)) + 1e-4 * np.eye(6)
    z = points[[0, 1]] + shift
    nu = innovations(z, points, np.zeros(2, bool))
    R = np.tile(1e-3 * np.eye(2), (2, 1, 1))
    problem = AssociationProblem(z, R, nu, Predictions(np.arange(3), points, cov), np.ones(2), np.arange(2))
    assert problem.d2[1].argmin() == 2
    assert SequentialNearestNeighbour().associate(problem, RNG)[0].match.tolist() == [0, 1]


def test_scnn_refuses_an_unknown_order():
    with pytest.raises(TomThumbError, match="valid: given, nearest"):
        SequentialNearestNeighbour(order="random")


def test_rjc_never_beats_jcbb_and_mostly_equals_it():
    equal = total = 0
    for problem in problems(11, 100):
        rng = np.random.default_rng(1)
        found = RandomizedCompatibility().associate(problem, rng)[0]
        pairs = int((found.match >= 0).sum())
        assert pairs == 0 or found.info["joint_d2"] < chdtri(2 * pairs, 0.01)
        whole = JointCompatibility(complete=True).associate(problem, RNG)[0]
        assert pairs <= (whole.match >= 0).sum()
        equal += pairs == (whole.match >= 0).sum()
        total += 1
    assert equal > 0.95 * total


def test_rjc_stops_by_its_own_bound():
    """(k / m)^seeds = 1 after a full match: one trial is enough. With half the pairs: log .01 / log(1 - 1/8) = 35."""
    assert RandomizedCompatibility()._enough(0.5) == 35
    problem = random_problem(np.random.default_rng(12), 5, 5, spread=20.0, pose=0.02)
    assert RandomizedCompatibility().associate(problem, np.random.default_rng(0))[0].info["trials"] <= 200


def test_rjc_refuses_settings_without_meaning():
    with pytest.raises(TomThumbError, match="at least 1"):
        RandomizedCompatibility(seeds=0)


# --- clique -----------------------------------------------------------------------------------------------------------


def consistent(problem, a, b, gate2):
    """Distances agree within their variance, by the derivative of the difference and the whole covariance."""
    (i, j), (k, l) = a, b
    if i == k or j == l:
        return False
    p, C = problem.predictions.z_hat, problem.predictions.cov
    e, f = problem.z[i] - problem.z[k], p[j] - p[l]
    far, mapped = np.hypot(*e), np.hypot(*f)
    e, f = e / far, f / mapped
    H = np.zeros(C.shape[0])
    H[2 * j : 2 * j + 2], H[2 * l : 2 * l + 2] = f, -f
    var = e @ (problem.R[i] + problem.R[k]) @ e + H @ C @ H
    return (far - mapped) ** 2 / var < gate2


def largest_clique(adjacent):
    """Size, by trying sets from large to small."""
    size = len(adjacent)
    for k in range(size, 0, -1):
        for some in itertools.combinations(range(size), k):
            if all(adjacent[a][b] for a, b in itertools.combinations(some, 2)):
                return k
    return 0


def test_the_clique_is_a_largest_one():
    compared = 0
    for problem in problems(13, 120, most=4):
        pairs = np.argwhere(problem.d2 < chdtri(2, 1e-4))
        found = PairwiseConsistency().associate(problem, RNG)[0]
        assert found.info["proof"] == "optimal"
        mine = [(i, j) for i, j in enumerate(found.match) if j >= 0]
        gate2 = chdtri(1, 0.01)
        assert all(consistent(problem, a, b, gate2) for a, b in itertools.combinations(mine, 2))
        if len(pairs) > 12:
            continue
        adjacent = [[consistent(problem, a, b, gate2) for b in pairs] for a in pairs]
        assert len(mine) == largest_clique(adjacent)
        compared += 1
    assert compared > 60


def test_replicator_dynamics_climb_and_stay_on_the_simplex():
    rng = np.random.default_rng(14)
    A = np.triu(rng.random((12, 12)) * (rng.random((12, 12)) < 0.5), 1)
    A = A + A.T
    start = np.concatenate([[0], np.cumsum((A > 0).sum(1))])
    neighbour, weight = np.nonzero(A)[1], A[A > 0]
    values = []
    for rounds in (0, 1, 5, 50, 500):
        u = clique.dense(start, neighbour, weight, rounds)
        assert u.sum() == pytest.approx(1.0)
        values.append(u @ A @ u)
    assert (np.diff(values) >= -1e-12).all()
    assert values[-1] > 1.3 * values[0]


def test_the_dense_subgraph_alone_finds_a_scan_among_outliers():
    rng, right = np.random.default_rng(15), 0
    for _ in range(10):
        problem, truth = turned(rng, 12, 14, 10.0, metres=1.0)
        found = PairwiseConsistency(budget=0).associate(problem, RNG)[0]
        right += int((found.match == truth).sum())
    assert right > 0.95 * 120


def test_observations_that_are_no_points_are_refused():
    problem = random_problem(np.random.default_rng(16), 3, 3, angles=())
    odd = AssociationProblem(
        problem.z, problem.R, problem.innovation, problem.predictions, problem.clutter, problem.serials, (0,)
    )
    with pytest.raises(TomThumbError, match="are not points"):
        PairwiseConsistency().associate(odd, RNG)
