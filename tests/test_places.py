"""Places weighed: the true one wins, twins of it are recognised, and a map that is not the world's says nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tomthumb.constellation import fits, fitted, perfect
from tomthumb.geometry import compose, inverse, to_world
from tomthumb.king import LEAST, King
from tomthumb.models.sensor import RangeBearing
from tomthumb.places import Guess, Local, _occam_here, bare, clear, evidence, most_elsewhere, stones, view, weighed
from tomthumb.sensing import DetectionMap

SENSOR = RangeBearing(max_range=5.0, fov=2.0 * np.pi, std=(0.05, 0.01), detect=0.95)
NOBODY_KNOWS = Guess(np.zeros(3), np.eye(3), 0.0)
NOISE = 0.04


def seen_from(points: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> tuple[Local, np.ndarray]:
    """What is within range of a pose, in a frame of its own that begins there."""
    q = to_world(inverse(pose), points)
    q = q[np.hypot(*q.T) < SENSOR.max_range]
    q = q + NOISE * rng.standard_normal(q.shape)
    here = np.zeros(3)
    return Local(q, here, view(SENSOR, DetectionMap(0.95), [here], q)), np.tile(NOISE**2 * np.eye(2), (len(q), 1, 1))


def places(points: np.ndarray, local: Local, covs: np.ndarray, guess: Guess = NOBODY_KNOWS):
    old = stones(points, np.full(len(points), 0.95))
    found = fits(local.q, covs, points, compose(guess.pose, inverse(local.pose)))
    rest = float(np.logaddexp(bare(local, old, guess), guess.odds[1]))
    return found, weighed(found, local, old, guess), rest, old


@pytest.mark.parametrize("seed", range(8))
def test_the_true_place_outweighs_all_others(seed):
    rng = np.random.default_rng(seed)
    points, pose = 40.0 * rng.random((320, 2)), np.array([20.0, 17.0, 2.0])
    found, weights, rest, _ = places(points, *seen_from(points, pose, rng))
    best = clear(weights, rest, 7.0)
    assert best is not None
    np.testing.assert_allclose(found[best].motion, pose, atol=0.15)


@pytest.mark.parametrize("seed", range(8))
def test_land_that_is_not_on_the_map_is_nowhere(seed):
    rng = np.random.default_rng(seed)
    points, other = 40.0 * rng.random((320, 2)), 40.0 * rng.random((320, 2))
    _, weights, rest, _ = places(points, *seen_from(other, np.array([20.0, 17.0, 2.0]), rng))
    assert clear(weights, rest, 7.0) is None


@pytest.mark.parametrize("seed", range(4))
def test_of_two_places_that_are_alike_none_is_chosen_unless_one_is_believed(seed):
    rng = np.random.default_rng(seed)
    half = 15.0 * rng.random((45, 2))
    points, pose = np.concatenate([half, half + np.array([40.0, 0.0])]), np.array([7.0, 8.0, 0.4])
    local, covs = seen_from(points, pose, rng)
    assert clear(*places(points, local, covs)[1:3], 7.0) is None
    found, weights, rest, _ = places(points, local, covs, Guess(pose, np.diag([0.1, 0.1, 0.02]) ** 2, 0.9))
    best = clear(weights, rest, 7.0)
    assert best is not None
    np.testing.assert_allclose(found[best].motion, pose, atol=0.15)


def test_what_is_missing_and_what_is_strange_both_speak_against_a_place():
    rng = np.random.default_rng(3)
    points, pose = 20.0 * rng.random((80, 2)), np.array([10.0, 10.0, 0.0])
    local, covs = seen_from(points, pose, rng)
    old = stones(points, np.full(len(points), 0.95))
    fit = fitted(local.q, covs, points, pose)
    whole = evidence(fit.motion, fit, local, old)
    lonely = replace(fit, match=np.where(np.arange(len(local.q)) == 0, -1, fit.match))
    assert evidence(fit.motion, lonely, local, old) < whole - 3.0
    more = np.concatenate([points, pose[:2] + 3.0 * rng.random((4, 2))])
    assert evidence(fit.motion, fit, local, stones(more, np.full(len(more), 0.95))) < whole - 4.0


@pytest.mark.parametrize("seed", range(20))
def test_no_place_weighs_more_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    points, pose = 30.0 * rng.random((150, 2)), np.array([15.0, 12.0, -1.0])
    local, covs = seen_from(points, pose, rng)
    guess = Guess(np.array([1.0, 1.0, 1.0]), np.diag([0.1, 0.1, 0.02]) ** 2, 0.99999)
    _, weights, _, old = places(points, local, covs, guess)
    assert weights.max() <= most_elsewhere(perfect(local.q, covs, points), old, guess) + 1e-9


def test_a_view_is_what_the_sensor_sees():
    ahead = RangeBearing(max_range=4.0, fov=np.pi, detect=0.9)
    seen = view(ahead, DetectionMap(0.9), [np.zeros(3)], np.array([[3.9, 0.0]]))
    chance = seen.at(np.array([[2.0, 0.5], [-2.0, 0.5], [6.0, 0.0], [100.0, 0.0]]))
    np.testing.assert_allclose(chance, [0.9, 0.0, 0.0, 0.0], atol=0.02)
    twice = view(ahead, DetectionMap(0.9), [np.zeros(3), np.array([0.1, 0.0, 0.0])], np.array([[3.9, 0.0]]))
    assert twice.at(np.array([[2.0, 0.5]]))[0] == pytest.approx(0.99, abs=0.01)


def half_seen(seed: int) -> tuple[float, bool] | None:
    """A few landmarks of a wood that is on the map, or of one that is not: the odds of the best place, nats, and whether
    it is right. Both are as likely beforehand as `NOBODY_KNOWS` has them.
    """
    rng = np.random.default_rng(seed)
    points, pose = 40.0 * rng.random((320, 2)), np.array([*(10.0 + 20.0 * rng.random(2)), 2.0 * np.pi * rng.random()])
    on_the_map = seed % 2 == 1
    q = to_world(inverse(pose), points if on_the_map else 40.0 * rng.random((320, 2)))
    q = q[(np.hypot(*q.T) < SENSOR.max_range) & (rng.random(len(q)) < 0.5)]
    q = q + NOISE * rng.standard_normal(q.shape)
    if len(q) < LEAST:
        return None
    local = Local(q, np.zeros(3), view(SENSOR, DetectionMap(0.5), [np.zeros(3)], q))
    found, weights, _, _ = places(points, local, np.tile(NOISE**2 * np.eye(2), (len(q), 1, 1)))
    if not found:
        return None
    best = int(np.argmax(weights))
    rest = np.logaddexp.reduce(np.append(np.delete(weights, best), NOBODY_KNOWS.odds[1]))
    right = on_the_map and bool(np.hypot(*(found[best].motion - pose)[:2]) < 0.5)
    return float(weights[best] - rest), right


def test_what_is_believed_is_wrong_at_most_as_often_as_its_odds_say():
    """The lead is an error rate, so odds must not be claimed that are not there."""
    odds, right = np.array([one for one in map(half_seen, range(160)) if one is not None]).T
    near = (odds > 0.0) & (odds < 7.0)
    assert near.sum() >= 8  # some of them are doubtful
    assert right[near].mean() >= np.mean(1.0 / (1.0 + np.exp(-odds[near]))) - 1.0 / near.sum()
    believed = odds >= King().lead
    assert believed.sum() >= 40
    assert right[believed].all()


def test_how_likely_a_pose_was_does_not_hang_on_where_the_local_map_has_its_origin():
    """A brother's map begins where he set out, and the fit's covariance is of that frame: the robot is metres away."""
    rng = np.random.default_rng(0)
    points, pose = 20.0 * rng.random((80, 2)), np.array([10.0, 10.0, 0.4])
    local, covs = seen_from(points, pose, rng)
    guess = Guess(pose + np.array([0.1, -0.1, 0.05]), np.diag([0.02, 0.02, 0.01]) ** 2, 0.99)
    shift = np.array([30.0, -20.0, 1.0])
    away = Local(to_world(shift, local.q), compose(shift, local.pose), local.view)
    near, far = (
        _occam_here(fitted(one.q, covs, points, compose(pose, inverse(one.pose))), one, guess) for one in (local, away)
    )
    assert far == pytest.approx(near, abs=1e-6)
