"""The scan linearised at its pose basin: the same problem at no motion, the nonlinear posterior at a large one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from associators.test_stt import wide
from tomthumb.associators.maximum import MaximumPosterior
from tomthumb.associators.tom_thumb import TomThumb
from tomthumb.associators.tom_thumb.basins import Basin
from tomthumb.associators.tom_thumb.scene import (
    LOOSE,
    NO_LABELS,
    Rigid,
    Window,
    curved_window,
    lever,
    rigid,
)
from tomthumb.associators.tom_thumb.there import given_there, straight, unshared
from tomthumb.associators.tom_thumb.there import related as related_there
from tomthumb.gains import base_gains
from tomthumb.kernels import arcs, posterior
from tomthumb.types import AssociationProblem, Predictions


def related(rng, heading, motion):
    """Six points seen after a motion of the pose, with errors of their own that all have in common but for a part."""
    p = rng.uniform(-4.0, 4.0, (6, 2))
    Xi = np.diag([0.5, 0.3, heading]) ** 2
    E = 0.004**2 * (np.kron(np.full((6, 6), 0.7), np.eye(2)) + 0.3 * np.eye(12))
    B = lever(p).reshape(-1, 3)
    c, s = np.cos(motion[2]), np.sin(motion[2])
    turn = np.array([[c, -s], [s, c]])
    e = (np.linalg.cholesky(E) @ rng.standard_normal(12)).reshape(-1, 2)
    q = (p + e) @ turn.T + motion[:2] + 0.003 * rng.standard_normal((6, 2))
    R = np.tile(0.003**2 * np.eye(2), (6, 1, 1))
    predictions = Predictions(np.arange(6), p, B @ Xi @ B.T + E, Xi, B @ Xi)
    problem = AssociationProblem(q, R, q[:, None] - p[None], predictions, np.full(6, 0.1), np.arange(6))
    D = np.array([E[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(6)])
    return problem, Rigid(q, R, p, D, Xi, np.ones(6), np.ones(6), np.linalg.inv(Xi)), E


def with_one_off(seed, moved):
    """Six points that err together, one of them seen 18 mm from where it is, at a noise of 3."""
    problem, _, _ = related(np.random.default_rng(seed), 0.5, moved)
    z = problem.z.copy()
    z[3] += 0.018 * np.array([np.cos(seed), np.sin(seed)])
    problem = replace(problem, z=z, innovation=z[:, None] - problem.predictions.z_hat[None])
    return problem, rigid(problem, *base_gains(problem, None), LOOSE)


def given_at(problem, s, pose, some):
    return given_there(s, pose, some, unshared(problem, s, some))


def squared_distance(problem, s, E):
    """The least of the nonlinear sum of squares over the motion and the points' own errors, and the motion there."""
    half, own = np.linalg.cholesky(np.linalg.inv(s.Xi)).T, np.linalg.cholesky(np.linalg.inv(E)).T

    def residuals(x):
        c, sine = np.cos(x[2]), np.sin(x[2])
        at = (s.p + x[3:].reshape(-1, 2)) @ np.array([[c, -sine], [sine, c]]).T + x[:2]
        return np.concatenate([half @ x[:3], own @ x[3:], (problem.z - at).ravel() / 0.003])

    found = least_squares(residuals, np.zeros(15), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return 2.0 * found.cost, found.x[:3]


def test_at_no_motion_it_is_the_problem_itself():
    problem, _, _ = wide(np.random.default_rng(3), 12)
    s = rigid(problem, *base_gains(problem, None))
    nu, C, R, _ = given_at(problem, s, np.zeros(3), np.arange(len(s.p)))
    assert np.allclose(nu, problem.innovation, atol=1e-12)
    assert np.allclose(C, problem.predictions.cov, atol=1e-12)
    assert np.array_equal(R, s.R)


def test_at_the_pose_it_is_the_nonlinear_posterior():
    moved, match = np.array([0.4, -0.2, 0.6]), np.arange(6)
    for seed in range(5):
        problem, s, E = related(np.random.default_rng(seed), 0.5, moved)
        wanted, pose = squared_distance(problem, s, E)
        there = posterior.value_of(match, *given_at(problem, s, pose, match))[1]
        here = posterior.value_of(match, *given_at(problem, s, np.zeros(3), match))[1]
        assert abs(there / wanted - 1.0) < 0.02
        assert here > 10.0 * wanted


def test_what_points_err_together_does_not_count_once_for_each():
    """Held independent, six points that err alike are far too sure of where they are: what one lies off seems a wonder."""
    problem, s, E = related(np.random.default_rng(1), 0.1, np.zeros(3))
    wanted, pose = squared_distance(problem, s, E)
    match = np.arange(6)
    together = posterior.value_of(match, *given_at(problem, s, pose, match))[1]
    apart, B = np.kron(np.eye(6), np.ones((2, 2))) * E, lever(s.p).reshape(-1, 3)
    alone = AssociationProblem(
        problem.z,
        problem.R,
        problem.innovation,
        Predictions(match, s.p, B @ s.Xi @ B.T + apart),
        problem.clutter,
        match,
    )
    assert abs(together - wanted) < 0.02 * wanted
    assert abs(posterior.value_of(match, *given_at(alone, s, pose, match))[1] - wanted) > 0.05 * wanted


def turned_scan(rng, m, degrees):
    """m landmarks of a known cloud, seen as points after a turn of `degrees`, under a heading known to 15 deg."""
    points = rng.uniform([2.0, -3.0], [8.0, 3.0], (14, 2))
    Xi = np.diag([0.1, 0.1, np.radians(15.0)]) ** 2
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    truth = rng.permutation(len(points))[:m]
    z = points[truth] @ np.array([[c, -s], [s, c]]).T + 0.02 * rng.standard_normal((m, 2))
    G = lever(points).reshape(-1, 3)
    cov = G @ Xi @ G.T + 1e-4 * np.eye(2 * len(points))
    predictions = Predictions(np.arange(len(points)), points, cov, Xi, -G @ Xi)
    R = np.tile(0.02**2 * np.eye(2), (m, 1, 1))
    return AssociationProblem(z, R, z[:, None] - points[None], predictions, np.full(m, 1e-3), np.arange(m)), truth


def test_a_large_turn_is_found_where_the_linear_posterior_is_sure_of_something_else():
    """Two sigma of the heading, 30 deg: what the certificate proves there is the optimum of the wrong sum."""
    right = linear = 0
    for seed in range(10):
        problem, truth = turned_scan(np.random.default_rng(seed), 6, 30.0)
        right += int((TomThumb().associate(problem, np.random.default_rng(0))[0].match == truth).sum())
        linear += int((MaximumPosterior().associate(problem, np.random.default_rng(0))[0].match == truth).sum())
    assert right >= 57
    assert linear < 45


def test_under_a_bent_pose_nothing_may_be_near_at_all():
    problem, _ = turned_scan(np.random.default_rng(0), 4, 30.0)
    far = problem.z + 1000.0
    away = replace(problem, z=far, innovation=far[:, None] - problem.predictions.z_hat[None])
    found = TomThumb().associate(away, np.random.default_rng(0))[0]
    assert (found.match == -1).all()


def test_no_turn_is_too_large_for_the_curved_window():
    """Three and four sigma of the heading; a window by the second moment of the arc lost all pairings beyond 2.8 at once."""
    for degrees in (-60.0, 45.0, 60.0):
        right = 0
        for seed in range(5):
            problem, truth = turned_scan(np.random.default_rng(seed), 6, degrees)
            near = curved_window(rigid(problem, *base_gains(problem, None)), 1.0 - 1e-6)
            assert all(truth[i] in near.columns[near.start[i] : near.start[i + 1]] for i in range(6))
            right += int((TomThumb().associate(problem, np.random.default_rng(0))[0].match == truth).sum())
        assert right >= 28


def test_a_pairing_by_itself_is_chi_square_of_two_degrees():
    """Under the motion's own prior, and however far it turns: the share outside the 90 % gate is a tenth."""
    rng, sd = np.random.default_rng(0), np.array([0.1, 0.1, np.radians(15.0)])
    half = np.array([[1.0, 0.0, 0.0], [0.2, 0.8, 0.0], [0.6, -0.5, 0.6]]) * sd[:, None]  # shift and turn go together
    Xi = half @ half.T
    inside, trials, p, V = 0, 2000, np.array([[5.0, 1.0]]), np.full((1, 2, 2), 0.0)
    noise = np.tile(0.02**2 * np.eye(2), (1, 1, 1))
    for x in rng.standard_normal((trials, 3)) @ half.T:
        c, s = np.cos(x[2]), np.sin(x[2])
        q = p @ np.array([[c, -s], [s, c]]).T + x[:2] + 0.02 * rng.standard_normal((1, 2))
        inside += len(arcs.by_itself(q, noise, p, V, Xi, 4.605, NO_LABELS)[1])
    assert abs(inside / trials - 0.9) < 0.02


def least_of_all_turns(q, p, V, Xi):
    """The squared distance of a pairing by itself, over a fine grid of turns, the best shift of each known."""
    turns = np.linspace(-np.pi, np.pi, 20001)
    k, v = Xi[:2, 2] / Xi[2, 2], Xi[2, 2]
    A = np.linalg.inv(V + Xi[:2, :2] - np.outer(k, k) * v)
    c, s = np.cos(turns), np.sin(turns)
    e = q - np.column_stack([c * p[0] - s * p[1], s * p[0] + c * p[1]]) - turns[:, None] * k
    return float((turns**2 / v + ((e @ A) * e).sum(1)).min())


def test_what_no_motion_brings_within_the_gate_is_all_that_is_left_out_untried():
    """Shift and turn go together here; what a first look leaves out has no turn within the gate, and it leaves out a lot."""
    rng, gate2, out, beyond = np.random.default_rng(2), 9.0, 0, 0
    for _ in range(400):
        half = rng.standard_normal((3, 3)) * np.array([0.3, 0.3, rng.uniform(0.02, 0.6)])[:, None]
        Xi, V = half @ half.T, np.diag(rng.uniform(0.001, 0.5, 2)) ** 2
        q, p = rng.uniform(-4.0, 4.0, (2, 2))
        v, k = Xi[2, 2], Xi[:2, 2] / Xi[2, 2]
        W = V + Xi[:2, :2] - np.outer(k, k) * v
        turn = (np.arctan2(q[1], q[0]) - np.arctan2(p[1], p[0]) + np.pi) % (2.0 * np.pi) - np.pi
        least = least_of_all_turns(q, p, V, Xi)
        more = 1.0 + np.sqrt(k @ k * v / np.linalg.eigvalsh(W - V)[1])
        left_out = arcs._beyond(np.hypot(*q), np.hypot(*p), turn, (W[0, 0], W[0, 1], W[1, 1]), more, v, gate2)
        assert not (left_out and least < gate2)
        listed = arcs.by_itself(q[None], V[None], p[None], np.zeros((1, 2, 2)), Xi, gate2, NO_LABELS)[1]
        assert not (len(listed) and least > gate2 + 1e-3)
        out, beyond = out + left_out, beyond + (least > gate2)
    assert out > 0.5 * beyond


def test_what_looks_bar_is_barred_over_the_poses_too():
    problem, truth = turned_scan(np.random.default_rng(0), 6, 20.0)
    barred = np.zeros(problem.shape, bool)
    barred[0, truth[0]] = True
    found = TomThumb().associate(replace(problem, barred=barred), np.random.default_rng(0))[0]
    assert found.match[0] != truth[0]
    assert (found.match[1:] == truth[1:]).all()


def test_in_the_curved_window_labels_still_rule_out():
    problem, _ = turned_scan(np.random.default_rng(0), 6, 30.0)
    labels, theirs = np.zeros(6, np.int64), np.arange(14) % 2
    told = replace(problem, labels=labels, predictions=replace(problem.predictions, labels=theirs))
    s = rigid(told, *base_gains(told, None))
    near = curved_window(s, 1.0 - 1e-6)
    assert set(theirs[near.columns]) == {0}
    every = curved_window(rigid(problem, *base_gains(problem, None)), 1.0 - 1e-6)
    assert len(near.columns) < len(every.columns)


def test_linear_sums_are_believed_where_that_is_asked_for():
    """`bent` without end is STT on the linearised covariance, as the exact maximum is."""
    problem, truth = turned_scan(np.random.default_rng(0), 6, 30.0)
    curved, linear = (TomThumb(bent=b).associate(problem, np.random.default_rng(0))[0] for b in (1.0, 1e9))
    assert (curved.match == truth).all()
    assert curved.info["proof"] == "truncated"
    assert (linear.match != truth).any()


def test_a_doubt_is_weighed_on_the_full_covariance():
    """One observation 9 sigma off. What all points err in common explains none of it; held independent they explain some."""
    moved, differ = np.array([0.4, -0.2, 0.6]), 0
    for seed in range(10):
        problem, s = with_one_off(seed, moved)
        every = np.arange(0, 42, 6), np.tile(np.arange(6), 6)
        given = given_at(problem, s, moved, np.arange(6))
        whole, p, none, *_ = posterior.listed(*given, *every, 27.6, 12.0, 1_000_000, 10_000)
        assert whole
        found, apart = (TomThumb(listed=x).associate(problem, np.random.default_rng(0))[0] for x in (6.0, 0.0))
        wanted = np.where(found.match >= 0, p[np.arange(6), found.match], none)
        assert np.allclose(
            found.confidence, wanted, atol=0.03
        )  # the poses at which both are linearised differ a little
        differ += apart.match[3] != found.match[3] or abs(apart.confidence[3] - wanted[3]) > 0.1
    assert differ >= 2


def test_only_what_errs_together_is_looked_at_again():
    problem, s, E = related(np.random.default_rng(0), 0.5, np.zeros(3))
    B = lever(s.p).reshape(-1, 3)
    own = np.kron(np.eye(6), np.ones((2, 2))) * E
    alone = replace(problem, predictions=replace(problem.predictions, cov=B @ s.Xi @ B.T + own))
    assert related_there(s, unshared(problem, s, np.arange(6)))
    assert not related_there(s, unshared(alone, s, np.arange(6)))
    assert not related_there(s, unshared(problem, s, np.arange(1)))


def test_a_pose_is_straight_where_its_turn_bends_less_than_the_noise():
    """r v / 2 of the farthest point is the noise at a variance of 2 sigma / r."""
    _, s, _ = related(np.random.default_rng(0), 0.5, np.zeros(3))
    far = float(np.hypot(*s.q.T).max())
    limit = 2.0 * 0.003 / far
    for variance, wanted in ((0.9 * limit, True), (1.1 * limit, False)):
        M = np.diag([1e4, 1e4, 1.0 / variance])
        near = Window(np.zeros(7, np.int64), np.empty(0, np.int64))
        assert straight(s, Basin(np.full(6, -1), 0.0, np.empty(0), near, np.zeros(3), M)) == wanted


def test_brothers_of_a_scan_that_is_listed_anew_are_weighed_by_the_same_sum():
    """One observation in doubt: with it and without it are two hypotheses at one pose, on the full covariance both."""
    moved, met = np.array([0.4, -0.2, 0.6]), 0
    for seed in range(10):
        problem, s = with_one_off(seed, moved)
        given = given_at(problem, s, moved, np.arange(6))
        first, *brothers = TomThumb(brothers=8, ambiguity=5.0).associate(problem, np.random.default_rng(0))
        for brother in brothers:
            gap = posterior.value_of(first.match, *given)[0] - posterior.value_of(brother.match, *given)[0]
            assert first.log_weight - brother.log_weight == pytest.approx(max(gap, 0.0), abs=0.2)
        met += len(brothers) > 0
    assert met > 3
