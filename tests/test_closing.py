"""A doubt settled: a part of the map that was mapped twice, once where the robot believed to be."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.branches import Branch
from tomthumb.closing import Loops, closure
from tomthumb.court import carry
from tomthumb.estimators.ekf import InvariantEKF
from tomthumb.geometry import compose, to_world
from tomthumb.king import King
from tomthumb.lifecycle import Life
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import RangeBearing

SENSOR = RangeBearing(max_range=6.0, fov=2.0 * np.pi, std=(0.05, 0.01))
NOISE, SCAN = 0.05, 400
RNG = np.random.default_rng(0)


def twice(drift: np.ndarray, seed: int = 0, alike: bool = False):
    """A belief that holds 14 posts near the robot twice: old ones, and young ones moved by `drift`; and far others."""
    rng = np.random.default_rng(seed)
    near, far = 5.0 * rng.random((14, 2)), 5.0 * rng.random((60, 2)) + [20.0, 0.0]
    if alike:
        far[:14] = near + np.array([20.0, 0.0])
    ekf = InvariantEKF(OdometryIncrement(), SENSOR)
    pose = np.array([2.5, 2.5, 0.3])
    belief = ekf.init(compose(drift, pose), np.diag([0.05, 0.05, 0.01]) ** 2, RNG)
    branch = Branch(belief, {})
    spread = 0.02**2 * np.eye(2)
    for first, points, born, seen in (
        (0, near, 0, 30),
        (100, far, 100, 250),
        (500, to_world(drift, near) + 0.02 * rng.standard_normal(near.shape), SCAN - 20, SCAN),
    ):
        ids = first + np.arange(len(points))
        belief = ekf.place(belief, ids, points, np.tile(spread, (len(points), 1, 1)))
        for i in ids.tolist():
            branch.ledger[i] = Life(seen, hits=12.0, chances=12.0, static=12, born=born)
    path = np.linspace([40.0, 2.5, np.pi], compose(drift, pose), SCAN)
    path[-25:] = compose(drift, pose)
    for scan, step in enumerate(path):
        branch.history = (branch.history, np.empty(0, np.int64), step, scan)
    branch.belief = belief
    return ekf, branch, pose


def look(ekf, branch, doubt=SCAN - 25, **loops):
    return closure(King(), Loops(**loops), branch, ekf, SENSOR, SCAN, doubt, NOISE)


@pytest.mark.parametrize("seed", range(4))
def test_a_doubt_is_settled_with_the_right_pairs(seed):
    drift = np.array([0.7, -0.5, 0.08])
    ekf, branch, pose = twice(drift, seed)
    found = look(ekf, branch)
    assert found is not None
    hit = found.way.named >= 0
    assert hit.sum() >= 12
    assert (found.way.ids[hit] - 500 == found.way.named[hit]).all()
    carry(ekf, branch, found, 7, SCAN)
    moved, cov = ekf.pose(branch.belief)
    np.testing.assert_allclose(moved, pose, atol=0.08)
    assert np.linalg.eigvalsh(cov).min() > 0.0
    assert not any(i in branch.ledger for i in found.way.ids[hit].tolist())
    estimate = ekf.estimate(branch.belief)
    assert set(estimate.ids.tolist()) == set(branch.ledger)
    np.testing.assert_allclose(branch.history[2], pose, atol=0.08)


def test_a_doubt_is_settled_anywhere():
    ekf, branch, _ = twice(np.array([6.0, 4.0, 1.2]))
    assert look(ekf, branch) is not None


def test_in_doubt_a_second_place_like_this_one_forbids_it():
    ekf, branch, _ = twice(np.array([6.0, 4.0, 1.2]), alike=True)
    assert look(ekf, branch) is None


def test_few_young_landmarks_close_nothing():
    ekf, branch, _ = twice(np.array([0.7, -0.5, 0.08]))
    assert look(ekf, branch, stars=7) is None
    assert look(ekf, branch, doubt=SCAN - 5) is None
