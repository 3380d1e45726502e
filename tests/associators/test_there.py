"""The scan linearised at its pose basin: the same problem at no motion, the nonlinear posterior at a large one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from associators.test_stt import wide
from tomthumb.associators.maximum import MaximumPosterior
from tomthumb.associators.tom_thumb import TomThumb
from tomthumb.associators.tom_thumb.scene import Rigid, base_gains, curved_window, lever, rigid
from tomthumb.associators.tom_thumb.there import given_there
from tomthumb.kernels import posterior
from tomthumb.kernels import scene as kernel
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
    predictions = Predictions(np.arange(6), p, B @ Xi @ B.T + E)
    problem = AssociationProblem(q, R, q[:, None] - p[None], predictions, np.full(6, 0.1), np.arange(6))
    D = np.array([E[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(6)])
    return problem, Rigid(q, R, p, D, Xi, np.ones(6), np.ones(6), np.linalg.inv(Xi)), E


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
    nu, C, R, _ = given_there(problem, s, np.zeros(3), np.arange(len(s.p)))
    assert np.allclose(nu, problem.innovation, atol=1e-12)
    assert np.allclose(C, problem.predictions.cov, atol=1e-12)
    assert np.array_equal(R, s.R)


def test_at_the_pose_it_is_the_nonlinear_posterior():
    motion, match = np.array([0.4, -0.2, 0.6]), np.arange(6)
    for seed in range(5):
        problem, s, E = related(np.random.default_rng(seed), 0.5, motion)
        wanted, pose = squared_distance(problem, s, E)
        there = posterior.value_of(match, *given_there(problem, s, pose, match))[1]
        here = posterior.value_of(match, *given_there(problem, s, np.zeros(3), match))[1]
        assert abs(there / wanted - 1.0) < 0.02
        assert here > 10.0 * wanted


def test_what_points_err_together_does_not_count_once_for_each():
    """Held independent, six points that err alike are far too sure of where they are: what one lies off seems a wonder."""
    problem, s, E = related(np.random.default_rng(1), 0.1, np.zeros(3))
    wanted, pose = squared_distance(problem, s, E)
    match = np.arange(6)
    together = posterior.value_of(match, *given_there(problem, s, pose, match))[1]
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
    assert abs(posterior.value_of(match, *given_there(alone, s, pose, match))[1] - wanted) > 0.05 * wanted


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


def test_the_curved_window_holds_the_second_moment_of_a_turn():
    """Along the line of sight a turned point lies off by 3/4 (r v)^2 in the mean square, across it by r^2 v."""
    p, Xi = np.array([[4.0, 0.0]]), np.diag([1e-12, 1e-12, 0.2**2])
    angle = 0.2 * np.random.default_rng(0).standard_normal(200_000)
    off = 4.0 * np.column_stack([np.cos(angle) - 1.0, np.sin(angle)])
    nothing = np.full((1, 2, 2), 0.0)
    for axis in range(2):
        q = p + np.eye(2)[axis] * 0.1
        d2 = kernel.curved(q, nothing, p, nothing, Xi)[0, 0]
        assert abs(0.01 / d2 / (off[:, axis] ** 2).mean() - 1.0) < 0.06


def test_in_the_curved_window_labels_still_rule_out():
    problem, _ = turned_scan(np.random.default_rng(0), 6, 30.0)
    labels, theirs = np.zeros(6, np.int64), np.arange(14) % 2
    told = replace(problem, labels=labels, predictions=replace(problem.predictions, labels=theirs))
    s = rigid(told, *base_gains(told, None))
    near = curved_window(told, s, 1.0 - 1e-6)
    assert set(theirs[near.columns]) == {0}
    assert len(near.columns) < len(curved_window(problem, s, 1.0 - 1e-6).columns)


def test_linear_sums_are_believed_where_that_is_asked_for():
    """`bent` without end is STT on the linearised covariance, as the exact maximum is."""
    problem, truth = turned_scan(np.random.default_rng(0), 6, 30.0)
    curved, linear = (TomThumb(bent=b).associate(problem, np.random.default_rng(0))[0] for b in (1.0, 1e9))
    assert (curved.match == truth).all()
    assert curved.info["proof"] == "truncated"
    assert (linear.match != truth).any()
