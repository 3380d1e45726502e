"""Walkers add up, landmarks do not: closed forms, statistical bands, and a conditional Gaussian by its precision."""

import math

import numpy as np
import pytest
from scipy.special import chdtri

import tomthumb
from tomthumb.kernels.gates import innovations
from tomthumb.lifecycle import Life, LifeCycle, promotions, restart
from tomthumb.models.sensor import Cartesian
from tomthumb.stillness import Drift, given_others, record_drifts
from tomthumb.types import Observations, Predictions

GATE2 = float(chdtri(2, 0.01))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def followed(steps: np.ndarray, S: np.ndarray) -> Drift:
    drift = Drift()
    for age, nu in enumerate(steps, start=1):
        drift = drift.and_seen(age, nu, S)
    return drift


def test_drift_of_what_stands_still_is_chi_square(rng: np.random.Generator) -> None:
    S = np.array([[0.04, 0.015], [0.015, 0.02]])
    white = rng.multivariate_normal(np.zeros(2), S, (4000, 5))
    d2 = np.array([followed(steps, S).d2 for steps in white])
    assert d2.mean() == pytest.approx(2.0, abs=3 * 2.0 / math.sqrt(4000))
    assert np.mean(d2 > GATE2) == pytest.approx(0.01, abs=3 * math.sqrt(0.0099 / 4000))


def test_drift_of_a_walker_grows_as_the_sum_of_squared_ages() -> None:
    v, sigma = 0.03, 0.05
    ages = np.arange(1, 6)
    drift = followed(np.outer(ages, [v, 0.0]), sigma**2 * np.eye(2))
    assert drift.d2 == pytest.approx(np.sum(ages**2) * (v / sigma) ** 2)


def test_nothing_seen_is_no_drift() -> None:
    assert Drift().d2 == 0.0
    assert Drift().and_seen(0, np.ones(2), np.eye(2)).d2 == 0.0  # the founding sighting tells nothing


def test_given_others_is_the_conditional_gaussian(rng: np.random.Generator) -> None:
    A = rng.standard_normal((8, 8))
    S, nu = A @ A.T + np.eye(8), rng.standard_normal((4, 2))
    known, tried = np.array([0, 2]), np.array([1, 3])
    left, own = given_others(nu, S, known, tried)
    order = [2, 3, 6, 7, 0, 1, 4, 5]
    precision = np.linalg.inv(S[np.ix_(order, order)])
    cov = np.linalg.inv(precision[:4, :4])
    mean = -cov @ precision[:4, 4:] @ nu[known].ravel()
    np.testing.assert_allclose(left.ravel(), nu[tried].ravel() - mean)
    np.testing.assert_allclose(own, [cov[:2, :2], cov[2:, 2:]])


def test_given_nobody_nothing_changes(rng: np.random.Generator) -> None:
    nu, S = rng.standard_normal((2, 2)), np.diag([1.0, 2.0, 3.0, 4.0])
    left, own = given_others(nu, S, np.empty(0, np.int64), np.arange(2))
    np.testing.assert_array_equal(left, nu)
    np.testing.assert_array_equal(own, [np.diag([1.0, 2.0]), np.diag([3.0, 4.0])])


def scene(turn: float) -> tuple[Predictions, Observations]:
    """A stone ahead and a crumb beside it, both expected .2 m off by an error of the pose that they share."""
    points = np.array([[2.0, 0.0], [2.0, 1.0]])
    cov = np.kron(np.ones((2, 2)), 0.04 * np.eye(2)) + 1e-4 * np.eye(4)
    seen = Observations(points + np.array([0.2, 0.0]), np.tile(1e-4 * np.eye(2), (2, 1, 1)))
    pose_cov = np.diag([0.04, 0.04, turn])
    return Predictions(np.array([7, 8]), points, cov, points=points, pose_cov=pose_cov), seen


@pytest.mark.parametrize(("turn", "ages"), [(1e-4, 9.0), (0.04, 0.0)])
def test_an_error_of_the_pose_is_no_drift_and_a_bent_sighting_tells_nothing(turn: float, ages: float) -> None:
    predictions, seen = scene(turn)
    ledger = {7: Life(0), 8: Life(0)}
    record_drifts(ledger, {8}, (predictions, np.array([0, 1])), seen, Cartesian(), np.zeros(3), 3)
    assert ledger[8].drift.ages == ages
    assert ledger[8].drift.d2 < 0.1
    assert ledger[7].drift.ages == 0.0  # a stone is on trial no more


def test_a_crumb_that_was_seen_aside_of_the_stone_drifts() -> None:
    predictions, seen = scene(1e-4)
    moved = Observations(seen.z + np.array([[0.0, 0.0], [0.1, 0.0]]), seen.R)
    ledger = {7: Life(0), 8: Life(0)}
    record_drifts(ledger, {8}, (predictions, np.array([0, 1])), moved, Cartesian(), np.zeros(3), 3)
    assert ledger[8].drift.d2 > GATE2
    assert innovations(moved.z, predictions.z_hat, np.zeros(2, bool))[1, 1] @ [1.0, 0.0] == pytest.approx(0.3)


def test_one_that_drifts_begins_its_trial_anew_and_each_trial_is_twice_as_long() -> None:
    policy = LifeCycle()
    still, walker = Life(0, hits=6, chances=6, static=6), Life(0, hits=6, chances=6, static=6)
    walker.drift = Drift((math.sqrt(1.1 * GATE2), 0.0), 1.0)
    ready, moving = promotions({1: still, 2: walker}, [1, 2], policy.anchors, False, policy)
    assert (ready.tolist(), moving.tolist()) == ([1], [2])
    restart({2: walker}, moving)
    assert (walker.static, walker.drift.ages) == (1, 0.0)
    waits = 0
    while not promotions({2: walker}, [2], policy.anchors, False, policy)[0].size:
        walker.hits, walker.static, waits = walker.hits + 1, walker.static + 1, waits + 1
    assert waits == 5


@pytest.mark.parametrize("policy", [LifeCycle().faithful(), LifeCycle(still=0.0)])
def test_who_does_not_ask_lets_walkers_pass(policy: LifeCycle) -> None:
    walker = Life(0, hits=6, chances=6, static=6, drift=Drift((9.0, 0.0), 1.0))
    ready, moving = promotions({2: walker}, [2], 5, False, policy)
    assert (ready.tolist(), moving.tolist()) == ([2], [])


def test_among_people_fewer_become_landmarks() -> None:
    """Whole runs: the same worlds with and without."""
    ghosts = dict.fromkeys((0.0, 0.99), 0)
    for seed in (3, 4):
        for still in ghosts:
            world = tomthumb.load("cloister", seed=seed, people=50)
            trace = tomthumb.run(world, associator="jcbb", seed=seed, settings={"slam": {"still": still}})
            ghosts[still] += tomthumb.evaluate(trace, world)["ghosts"]
    assert ghosts[0.99] < ghosts[0.0]
