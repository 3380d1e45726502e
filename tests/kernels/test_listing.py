"""Listing given the pose: its sums against those over all hypotheses, written out or searched on the full covariance."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from associators.brute import random_problem, tabulate
from tomthumb.associators.tom_thumb.scene import curved_window, rigid, window
from tomthumb.gains import base_gains, base_table
from tomthumb.kernels import flights, listing, posterior
from tomthumb.kernels.grid import fill_grid

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from scan_problems import scans

WIDE = 1.0 - 1e-6


def arrays(problem, cov=None):
    """What `listed` takes before the lists of candidates."""
    given = problem.predictions
    cov = np.ascontiguousarray(given.cov if cov is None else cov)
    return problem.innovation, cov, problem.R, base_table(problem), given.pose_cov, np.ascontiguousarray(given.cross)


@pytest.mark.parametrize("angles", [(), (1,)])
def test_it_is_the_sum_over_all_hypotheses(angles):
    rng = np.random.default_rng(5)
    for _ in range(40):
        m, n = rng.integers(1, 5, 2)
        problem = random_problem(rng, int(m), int(n), spread=float(rng.uniform(0.4, 2.0)), angles=angles)
        near, table = window(problem.d2, WIDE), tabulate(problem, WIDE)
        dense = np.where(table.compatible, table.posterior(base_table(problem)), -np.inf)
        weights = np.exp(dense - dense.max())
        weights /= weights.sum()
        whole, p, none, best, value, nodes = listing.listed(*arrays(problem), near.start, near.columns, 60.0, 10**6)
        assert whole
        assert nodes > 0
        assert value == pytest.approx(dense.max(), abs=1e-8)
        assert dense[np.flatnonzero((table.matches == best).all(1))[0]] == pytest.approx(value, abs=1e-8)
        assert np.allclose(none, weights @ (table.matches < 0), atol=1e-9)
        for j in range(n):
            assert np.allclose(p[:, j], weights @ (table.matches == j), atol=1e-9)


@pytest.mark.parametrize(("kind", "size"), [("mid", 16), ("mid", 24), ("mid+sp", 12), ("dense+sp", 12)])
def test_a_larger_scan_has_the_hypotheses_that_the_full_covariance_gives(kind, size):
    """From `listing.LARGE` observations on their order and the bound change on the way; nothing may be lost by it."""
    assert size >= listing.LARGE
    several = 0
    for scan in scans(kind, size, 12, 4):
        problem = scan.problem()
        near, base = window(problem.d2, WIDE), base_table(problem)
        m, slack, given = len(problem.z), 4.0, arrays(problem)
        whole, p, none, best, value, _ = listing.listed(*given, near.start, near.columns, slack, 10**7)
        pool, values = np.full((400, m), -1, np.int64), np.full(400, -np.inf)
        _, proven = posterior.search(
            *given[:4], posterior.most_possible(near.start, near.columns, base, problem.R),
            *posterior.rank(near.start, near.columns), np.full(m + 1, np.inf), np.full(m, -1, np.int64), 0.0, slack,
            10**7, pool, values,
        )  # fmt: skip
        assert whole
        assert proven
        assert np.array_equal(best, pool[0])
        assert value == pytest.approx(values[0], abs=1e-7)
        inside = values > values[0] - slack
        weights = np.exp(values[inside] - values[0])
        several += inside.sum() > 1
        # the listing holds them all, and may hold less probable ones besides
        share = (weights[:, None] * (pool[inside] < 0)).sum(0) / weights.sum()
        assert np.abs(none - share).max() < np.exp(-slack) * 10
        assert np.allclose(p.sum(1) + none, 1.0)
    assert several >= 3


@pytest.mark.parametrize("level", [3, 5, 7])
def test_nothing_can_add_more_than_a_look_over_the_others_says(level):
    """All ways on from a few pairings, most of them not the true ones, against the bound; it stays below that at perfect fits."""
    tighter = 0
    for k, scan in enumerate(scans("mid+sp", 9, 12, 6)):
        problem, rng = scan.problem(), np.random.default_rng(k)
        near, given = window(problem.d2, WIDE), arrays(problem)
        nu, C, R, base = given[:4]
        m, n, lists = *base.shape, [near.columns[a:b] for a, b in zip(near.start, near.start[1:], strict=False)]
        _, told, V, worth = listing._forms(nu, C, R, base, listing._levers(*given[4:]), near.start, near.columns)
        form = listing._formed(nu, listing._levers(*given[4:]), V, worth, near.start, near.columns)
        order = rng.permutation(m)
        rest, known = listing._levels(order, near.start, worth)[:2]
        used, match = np.zeros(n, bool), np.full(m, -1)
        for s, i in enumerate(order[:level]):
            free = [c for c in range(near.start[i], near.start[i + 1]) if not used[near.columns[c]]]
            known[s + 1] = known[s]
            if free and rng.random() < 0.8:
                c = rng.choice(free)
                known[s + 1], match[i], used[near.columns[c]] = known[s] + told[c], near.columns[c], True
        here = posterior.value_of(match, nu, C, R, base)[0]
        perfect, ideal = rest[0, level], np.zeros(len(near.columns) + 1)
        ahead = listing._looked_over(rest, ideal, order, level, known, form, near.start, near.columns, used)
        best = max(posterior.value_of(way, nu, C, R, base)[0] for way in ways_on(match, order[level:], lists))
        assert best - here <= ahead + 1e-9
        tighter += ahead < perfect - 1.0
    assert tighter >= 6


def ways_on(match, left, lists):
    """All matches that agree with `match` but for the observations `left`."""
    if len(left) == 0:
        yield match
        return
    for j in (-1, *lists[left[0]]):
        if j < 0 or j not in match:
            way = match.copy()
            way[left[0]] = j
            yield from ways_on(way, left[1:], lists)


@pytest.mark.parametrize("sigma", [2.0, 4.5, 5.4, 6.0])
def test_a_pose_far_from_where_it_was_believed_is_found(sigma):
    """Twelve sightings agree on it, the first three tell little, and the last has a decoy where it was believed to be."""
    m, n, own, noise = 12, 13, 0.01, 0.01
    turn = np.linspace(0.0, 2.0 * np.pi, m, endpoint=False)
    points = 5.0 * np.column_stack([np.cos(turn), np.sin(turn)])[[*range(m), m - 1]]
    R = np.tile(noise**2 * np.eye(2), (m, 1, 1))
    R[:3, 0, 0] = 10.0
    B = np.zeros((2 * n, 3))
    B[0::2, 0], B[1::2, 1], B[0::2, 2], B[1::2, 2] = 1.0, 1.0, -points[:, 1], points[:, 0]
    P = np.diag([1.0, 1e-8, 1e-8])
    C = B @ P @ B.T + own**2 * np.eye(2 * n)
    nu = np.full((m, n, 2), 50.0)
    nu[np.arange(m), np.arange(m)] = [sigma, 0.0]
    nu[m - 1, n - 1] = 0.0
    V = R + own**2 * np.eye(2)
    base = np.tile(0.5 * np.log(np.linalg.det(V))[:, None] + np.log(2.0 * np.pi) + 2.0, (1, n))
    start, columns = np.array([*range(m), n]), np.arange(n)
    whole, p, none, best, value, _ = listing.listed(nu, C, R, base, P, B @ P, start, columns, 6.0, 10**7)
    weights, shares, left = [], np.zeros((m, n)), np.zeros(m)
    for which in range(1 << (m - 1)):  # every hypothesis: those of all but the last, and three of that
        for last in (-1, m - 1, n - 1):
            match = np.array([k if which >> k & 1 else -1 for k in range(m - 1)] + [last])
            weights.append((posterior.value_of(match, nu, C, R, base)[0], match))
    top = max(w for w, _ in weights)
    for w, match in weights:
        left += np.exp(w - top) * (match < 0)
        shares[np.flatnonzero(match >= 0), match[match >= 0]] += np.exp(w - top)
    total = sum(np.exp(w - top) for w, _ in weights)
    assert whole
    assert value == pytest.approx(top, abs=1e-6)
    beyond = sum(np.exp(w - top) for w, _ in weights if w <= top - 6.0) / total  # of these some may be listed, or none
    assert np.abs(none - left / total).max() <= beyond + 1e-9
    assert np.abs(p - shares / total).max() <= beyond + 1e-9
    assert posterior.value_of(best, nu, C, R, base)[0] == pytest.approx(top, abs=1e-6)


def test_landmarks_that_err_together_given_the_pose_are_refused():
    problem = random_problem(np.random.default_rng(6), 4, 4, spread=0.8)
    near = window(problem.d2, WIDE)
    together = problem.predictions.cov + 0.01 * np.kron(np.ones((4, 4)), np.eye(2))
    hardly = problem.predictions.cov + 1e-5 * np.kron(np.ones((4, 4)), np.eye(2))
    for cov, taken in ((together, False), (hardly, True)):
        whole, _, _, _, _, nodes = listing.listed(*arrays(problem, cov), near.start, near.columns, 6.0, 10**6)
        assert whole == taken
        assert (nodes > 0) == taken


def test_a_spent_budget_is_told():
    problem = random_problem(np.random.default_rng(7), 5, 5, spread=0.5)
    near = window(problem.d2, WIDE)
    whole, _, _, _, _, nodes = listing.listed(*arrays(problem), near.start, near.columns, 6.0, 8)
    assert not whole
    assert nodes > 8


def test_without_candidates_everything_is_unpaired():
    problem = random_problem(np.random.default_rng(8), 3, 4)
    whole, p, none, best, value, _ = listing.listed(
        *arrays(problem), np.zeros(4, np.int64), np.empty(0, np.int64), 6.0, 100
    )
    assert whole
    assert value == 0.0
    assert not p.any()
    assert (none == 1.0).all()
    assert (best == -1).all()


def test_a_pose_known_in_one_direction_moves_nothing_that_way():
    P = np.diag([0.04, 0.0, 0.01])
    B = np.array([[1.0, 0.0, -2.0], [0.0, 1.0, 3.0], [1.0, 0.0, 0.5], [0.0, 1.0, -1.0]])
    G = listing._levers(P, B @ P)
    assert np.allclose(G @ G.T, B @ P @ B.T)
    whole = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
    G = listing._levers(whole, B @ whole)
    assert np.allclose(G @ G.T, B @ whole @ B.T)


def test_anchors_that_the_pose_explains_are_brought_forward():
    points = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [4.0, 4.0]])
    q = np.vstack([points, [[9.0, 9.0]]])  # the last one is of nothing
    grid = fill_grid(points, 0.5)
    pose = np.array([1.0, -2.0, 0.7])  # the motion from where they were predicted to where they are seen
    c, s = np.cos(pose[2]), np.sin(pose[2])
    q = q @ np.array([[c, s], [-s, c]]) + pose[:2]
    turn, anchors = np.arange(4), np.array([[0, 1], [2, 4], [4, 3], [2, 3]])
    W, gain, worth = np.tile([100.0, 0.0, 100.0], (5, 1)), np.full(5, 4.0), np.zeros(4)
    flights._bring_forward(turn, 1, anchors, pose, q, W, gain, points, worth, *grid)
    assert turn.tolist() == [0, 3, 1, 2]
    flights._bring_forward(turn, 2, anchors, pose, q, W, gain, points, worth, *grid)
    assert turn.tolist() == [0, 3, 1, 2]


def test_votes_by_a_table_of_what_is_near_are_those_without():
    """No pose is lost by it, and none scores otherwise: what it gives up could not have been kept."""
    several = 0
    for scan in scans("lost", 12, 8, 3):
        problem = scan.problem()
        s = rigid(problem, *base_gains(problem, None))
        near = curved_window(s, WIDE)
        W, gain, worth, cell, apart, pairs, tolerance = flights.ready(s.q, s.R, s.D, s.base, s.odds, near.counts, 15)
        grid = fill_grid(s.p, cell)
        side, table = flights.nearness(s.p, *grid[:3], pairs, near.counts)
        assert table.size
        given = s.q, W, gain, pairs, tolerance, near.start, near.columns, s.p, worth, s.prior, 30.66, *grid
        found, slow = (
            flights.explore(*given, side, told, apart, 12, 200_000, 30.0) for told in (table, np.empty((0, 0)))
        )
        several += np.isfinite(slow[1]).sum() > 3
        assert np.array_equal(found[0], slow[0])
        assert np.array_equal(found[1], slow[1])
        assert found[2:] == slow[2:]
    assert several >= 4


def test_the_table_of_what_is_near_is_never_too_far():
    rng = np.random.default_rng(4)
    points, many = rng.uniform(-5.0, 5.0, (80, 2)), np.full(2, 1000)
    cell, low, shape, *_ = fill_grid(points, 0.7)
    side, table = flights.nearness(points, cell, low, shape, np.array([[0, 1]]), many)
    close = 0
    for at in rng.uniform(-5.5, 5.5, (3000, 2)):
        least = ((points - at) ** 2).sum(1).min()
        a, b = np.floor((at - low + cell) / side).astype(int)
        inside = 0 <= a < table.shape[0] and 0 <= b < table.shape[1]
        told = table[a, b] if inside else np.inf
        assert least >= min(told, cell**2) - 1e-12
        close += least < cell**2 and np.sqrt(least) < np.sqrt(told) + 1.5 * side
    assert close > 1500
    assert flights.nearness(points, cell, low, shape, np.array([[0, 1]]), np.full(2, 3))[1].size == 0
