"""The joint posterior: value, conditional form, search and marginals, against dense and exhaustive ones."""

from __future__ import annotations

import numpy as np
import pytest

from associators.brute import random_problem, tabulate
from tomthumb.associators.candidates import gated
from tomthumb.associators.tom_thumb.scene import window
from tomthumb.gains import base_gains
from tomthumb.kernels import marginals, posterior
from tomthumb.kernels.left_out import left_out_gains

WIDE = 1.0 - 1e-6


def problems(seed, count, most=5, **settings):
    """(problem, its base gains (m, n), all hypotheses, their L; -inf where a pairing is outside the window)."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        m, n = rng.integers(1, most + 1, 2)
        problem = random_problem(rng, int(m), int(n), spread=float(rng.uniform(0.4, 2.0)), **settings)
        own, odds = base_gains(problem, None)
        base = own[:, None] + odds[None]
        table = tabulate(problem, WIDE)
        yield problem, base, table, np.where(table.compatible, table.posterior(base), -np.inf)


def arrays(problem, base):
    return problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, base


def test_the_value_of_a_match_is_the_dense_one():
    for problem, base, table, _ in problems(1, 40):
        dense = table.posterior(base)
        for row in np.linspace(0, len(dense) - 1, 12).astype(int):
            value, d2, count = posterior.value_of(table.matches[row], *arrays(problem, base))
            assert value == pytest.approx(dense[row], abs=1e-8)
            assert d2 == pytest.approx(table.d2[row], abs=1e-8)
            assert count == table.count[row]


def searched(problem, base, slack, budget=10**6, size=64, gates2=None):
    near = window(problem.d2, WIDE)
    order = np.argsort(near.counts, kind="stable")
    listed = gated(problem.d2, 27.6310211159, nearest_first=True)  # chi-square, 2 dof, 1 - 1e-6
    assert np.array_equal(listed.order, order)
    m = len(problem.z)
    pool, values = np.full((size, m), -1, np.int64), np.full(size, -np.inf)
    nodes, proven = posterior.search(
        *arrays(problem, base), posterior.most_possible(near.start, near.columns, base, problem.R),
        listed.order, listed.start, listed.columns,
        np.full(m + 1, np.inf) if gates2 is None else gates2, np.full(m, -1, np.int64), 0.0, slack, budget, pool, values,
    )  # fmt: skip
    return pool, values, nodes, proven


def test_the_search_finds_the_maximum_of_all_hypotheses():
    for problem, base, table, dense in problems(2, 200):
        pool, values, _, proven = searched(problem, base, 0.0)
        assert proven
        assert values[0] == pytest.approx(dense.max(), abs=1e-8)
        row = np.flatnonzero((table.matches == pool[0]).all(1))[0]
        assert dense[row] == pytest.approx(dense.max(), abs=1e-8)


def test_the_pool_holds_all_hypotheses_within_the_slack():
    fullest = 0
    for problem, base, table, dense in problems(3, 120, most=4):
        pool, values, _, proven = searched(problem, base, 4.0)
        near = np.flatnonzero(dense > dense.max() - 4.0 + 1e-9)
        if len(near) > len(values):
            continue
        assert proven
        kept = {tuple(a) for a, v in zip(pool, values, strict=True) if v > values[0] - 4.0}
        assert {tuple(a) for a in table.matches[near]} <= kept
        fullest = max(fullest, len(near))
        assert (np.diff(values[np.isfinite(values)]) <= 1e-12).all()
    assert fullest > 8


def test_listed_hypotheses_add_up_to_the_marginals_of_all():
    for problem, base, table, dense in problems(12, 60, most=4):
        near = window(problem.d2, WIDE)
        args = (*arrays(problem, base), near.start, near.columns, 27.6)
        weights = np.exp(dense - dense.max())
        weights /= weights.sum()
        whole, p, none, best, value, _ = posterior.listed(*args, 60.0, 10**6, len(dense) + 1)
        assert whole
        assert value == pytest.approx(dense.max(), abs=1e-8)
        assert dense[np.flatnonzero((table.matches == best).all(1))[0]] == pytest.approx(value, abs=1e-8)
        assert np.allclose(none, weights @ (table.matches < 0), atol=1e-9)
        for j in range(problem.shape[1]):
            assert np.allclose(p[:, j], weights @ (table.matches == j), atol=1e-9)
        if np.isfinite(dense).sum() > 2:
            assert not posterior.listed(*args, 60.0, 10**6, 2)[0]
            assert not posterior.listed(*args, 60.0, 1, len(dense) + 1)[0]


@pytest.mark.parametrize(
    ("polar", "r", "turn", "side"), [(True, 5.0, 0.01, 0.3), (True, 2.0, 0.01, 0.5), (False, 8.0, 0.2, 0.0)]
)
def test_what_linearising_leaves_out_is_what_large_motions_show(polar, r, turn, side):
    """The second order of a prediction under drawn motions, against its closed form."""
    rng = np.random.default_rng(13)
    motions = rng.standard_normal((200_000, 3)) * [side, side, turn]
    c, s = np.cos(motions[:, 2]), np.sin(motions[:, 2])
    x, y = r - motions[:, 0], -motions[:, 1]
    moved = np.column_stack([c * x + s * y, -s * x + c * y])
    noise = np.diag([0.1**2, 0.02**2])[None]
    if polar:
        errors = np.column_stack([np.hypot(*moved.T) - r + motions[:, 0], np.arctan2(y, x) + motions[:, 1] / r])
        cov = np.diag([side**2, (side / r) ** 2 + turn**2])
        told = posterior.bent(np.array([[r, 0.0]]), noise, np.array([[r, 0.0]]), cov, turn**2, True)
        seen = np.abs(errors).mean(0) / [0.1, 0.02]
    else:
        errors = moved[:, :1] - r
        told = posterior.bent(np.array([[r, 0.0]]), noise, np.empty((0, 2)), np.empty((0, 0)), turn**2, False)
        seen = np.abs(errors).mean(0) / 0.1
    assert seen.max() / 2.0 < told < 3.0 * seen.max()


@pytest.mark.parametrize("R", [np.diag([0.04, 0.04]), np.array([[0.09, 0.05], [0.05, 0.04]]), np.diag([4e-4, 4e-2])])
def test_what_a_heading_bends_is_the_arc_beside_its_tangent(R):
    """The shift of the mean of a turned point, measured by the noise: the root of its d2."""
    rng, x, y = np.random.default_rng(12), 3.0, 4.0
    turn = 0.05 * rng.standard_normal(400_000)
    shift = np.array([(x * np.cos(turn)).mean(), (y * np.cos(turn)).mean()]) - [x, y]
    assert posterior.bend(x, y, R, 0.05**2) == pytest.approx(np.sqrt(shift @ np.linalg.solve(R, shift)), rel=0.02)
    assert posterior.bend(0.0, 0.0, R, 0.05**2) == 0.0


def test_with_a_joint_test_it_is_the_maximum_of_those_that_pass():
    from scipy.special import chdtri

    refused = 0
    for problem, base, table, dense in problems(4, 80):
        gates2 = np.append(np.inf, chdtri(2.0 * np.arange(1, len(problem.z) + 1), 0.3))
        _, values, _, proven = searched(problem, base, 0.0, gates2=gates2)
        passing = np.where(table.passes(0.7), dense, -np.inf)
        assert proven
        assert values[0] == pytest.approx(passing.max(), abs=1e-8)
        refused += passing.max() < dense.max() - 1e-6
    assert refused > 5


def test_flights_inside_a_basin_never_lose():
    rng, gained = np.random.default_rng(10), 0
    for problem, base, _, dense in problems(11, 60):
        near = window(problem.d2, WIDE)
        args = (*arrays(problem, base), near.start, near.columns)
        m = len(problem.z)
        begin, value = posterior.complete(np.full(m, -1, np.int64), *args, 27.6)
        lengths, uniform = rng.integers(1, m + 1, 30), rng.random((30, 2))
        found, reached, flown = posterior.ruin(begin, value, *args, 27.6, lengths, uniform, 15)
        assert value - 1e-9 <= reached <= dense.max() + 1e-8
        assert reached == pytest.approx(posterior.value_of(found, *arrays(problem, base))[0], abs=1e-7)
        assert flown <= 30
        gained += reached > value + 1e-6
    assert gained > 0


def test_a_spent_budget_is_told():
    problem = random_problem(np.random.default_rng(5), 10, 10, spread=0.5, pose=0.5)
    own, odds = base_gains(problem, None)
    base = own[:, None] + odds[None]
    _, _, nodes, proven = searched(problem, base, 0.0, budget=50)
    assert not proven
    assert nodes == 51


def test_greedy_completion_adds_up_by_the_chain_rule():
    """Its total of conditional gains is L of what it returns; what it was given stays; L has not fallen."""
    for problem, base, table, dense in problems(6, 100):
        near = window(problem.d2, WIDE)
        args = (*arrays(problem, base), near.start, near.columns)
        begin = table.matches[np.argmax(np.where(table.count <= 2, dense, -np.inf))]
        found, total = posterior.complete(begin, *args, 27.6)
        assert total == pytest.approx(posterior.value_of(found, *arrays(problem, base))[0], abs=1e-7)
        assert (found[begin >= 0] == begin[begin >= 0]).all()
        assert total >= dense[np.flatnonzero((table.matches == begin).all(1))[0]] - 1e-9


def test_gains_left_out_are_differences_of_l():
    for problem, base, table, dense in problems(7, 40):
        near = window(problem.d2, WIDE)
        match = table.matches[np.argmax(dense)]
        gains = left_out_gains(match, *arrays(problem, base), near.start, near.columns)
        for i in range(len(match)):
            without = match.copy()
            without[i] = -1
            below = posterior.value_of(without, *arrays(problem, base))[0]
            for c in range(near.start[i], near.start[i + 1]):
                if near.columns[c] in without:
                    continue  # a landmark already taken: no one-to-one hypothesis to compare with
                paired = without.copy()
                paired[i] = near.columns[c]
                direct = posterior.value_of(paired, *arrays(problem, base))[0] - below
                assert gains[c] == pytest.approx(direct, abs=1e-7)


def exact_marginals(gains, start, columns, m, n):
    """By the sum over every one-to-one assignment of the product of exp(gain)."""
    from associators.brute import matches

    table = np.full((m, n), -np.inf)
    for i in range(m):
        table[i, columns[start[i] : start[i + 1]]] = gains[start[i] : start[i + 1]]
    some = matches(m, n)
    logs = np.where(some >= 0, table[np.arange(m), np.maximum(some, 0)], 0.0).sum(1)
    weights = np.exp(logs)
    z = weights.sum()
    p = np.array([weights[some[:, i] == j].sum() / z for i in range(m) for j in columns[start[i] : start[i + 1]]])
    return p, np.array([weights[some[:, i] < 0].sum() / z for i in range(m)]), np.log(z)


def test_marginals_are_exact_without_loops():
    """A chain: observation i may be landmark i or i + 1."""
    rng = np.random.default_rng(8)
    for m in (1, 2, 3, 4):
        start = 2 * np.arange(m + 1)
        columns = np.column_stack([np.arange(m), np.arange(1, m + 1)]).ravel()
        gains = rng.normal(0.0, 2.0, 2 * m)
        p, none, log_z = marginals.marginals(gains, start, columns, m + 1, 500)
        exact = exact_marginals(gains, start, columns, m, m + 1)
        assert np.allclose(p, exact[0], atol=1e-3)  # it stops when messages change by less than 1e-4
        assert np.allclose(none, exact[1], atol=1e-3)
        assert log_z == pytest.approx(exact[2], abs=1e-3)


def test_marginals_with_loops_are_close():
    """Belief propagation is approximate there: within .15 everywhere and .02 on average for 4 x 4 random gains."""
    rng, errors = np.random.default_rng(9), []
    start, columns = 4 * np.arange(5), np.tile(np.arange(4), 4)
    for _ in range(100):
        gains = rng.normal(0.0, 2.0, 16)
        p, none, log_z = marginals.marginals(gains, start, columns, 4, 500)
        exact = exact_marginals(gains, start, columns, 4, 4)
        errors.append(np.abs(np.concatenate([p - exact[0], none - exact[1]])))
        sums = np.array([p[start[i] : start[i + 1]].sum() + none[i] for i in range(4)])
        assert np.allclose(sums, 1.0)
        assert log_z <= exact[2] + 1e-3  # Bethe's permanent is a lower bound (Gurvits)
    assert np.max(errors) < 0.15
    assert np.mean(errors) < 0.02
