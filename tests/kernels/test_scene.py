"""What an observation is worth by itself: the density of false ones, as told, and where the scan contradicts it."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.kernels import flights
from tomthumb.kernels.scene import own_gains

UNKNOWN = np.empty(0)


def odds(n, chance):
    return np.full(n, np.log(chance / (1.0 - chance)))


def square(rng, m, side=1.0, at=0.0):
    """m points in a square, two of them in opposite corners."""
    return np.vstack([[[at, at], [at + side, at + side]], at + side * rng.random((m - 2, 2))])


def test_a_density_that_the_scan_bears_out_is_taken_as_told():
    rng = np.random.default_rng(1)
    z, expected = square(rng, 10), square(rng, 10)
    told = np.full(10, 1.9)  # 1.9 false ones in the unit square; 10 seen and 8 expected leave room for 2
    assert np.allclose(own_gains(z, told, expected, odds(10, 0.8), False), -np.log(told))


def test_the_box_bounds_the_density_where_no_detection_is_foretold():
    z = square(np.random.default_rng(2), 10)
    for told, held in ((4.0, 4.0), (400.0, 10.0)):
        assert np.allclose(own_gains(z, np.full(10, told), z, UNKNOWN, False), -np.log(held))


def test_false_ones_are_not_expected_beside_the_landmarks_where_there_are_too_few():
    """10 told in the unit square, 8 detections expected, 10 seen: 8 too many. In the landmarks' box .6 of them: none too many."""
    rng = np.random.default_rng(3)
    z, expected = square(rng, 10), square(rng, 10, side=0.2)
    side = 0.2 * 11 / 9  # of what ten points come from, by the box they fill
    rates = np.exp(-own_gains(z, np.full(10, 10.0), expected, odds(10, 0.8), False))
    inside = (np.abs(z - 0.1) <= side / 2).all(1)
    assert 0 < inside.sum() < 10
    assert np.allclose(rates[inside], 10.0)
    assert np.allclose(rates[~inside], 10.0 * np.exp(-0.5 * 8.0**2 / (10.0 + 8 * 0.2)))


def test_more_observations_than_expected_leave_the_density_alone():
    """Most of the scan is new: three landmarks in a corner do not tell where false ones are."""
    rng = np.random.default_rng(8)
    z, expected = square(rng, 12), square(rng, 3, side=0.2)
    assert np.allclose(own_gains(z, np.full(12, 5.0), expected, odds(3, 0.8), False), -np.log(5.0))


def test_predictions_that_cannot_all_be_in_view_leave_the_density_alone():
    z = square(np.random.default_rng(4), 10)
    everywhere = square(np.random.default_rng(5), 200, side=5.0, at=-2.0)
    assert np.allclose(own_gains(z, np.full(10, 7.0), everywhere, odds(200, 0.9), False), -np.log(7.0))


@pytest.mark.parametrize("turn", [-3.0, 0.5, 3.1])
def test_what_is_behind_the_sensor_counts_like_what_is_before_it(turn):
    """Bearings about any direction, +-pi among them, but that a box across +-pi is a whole turn wide."""
    rng = np.random.default_rng(6)
    z, expected = square(rng, 8, 0.1), square(rng, 8, 0.02, 0.04)
    turned = np.array([0.0, turn])
    before = own_gains(z, np.full(8, 9000.0), expected, odds(8, 0.8), True)
    behind = own_gains(z + turned, np.full(8, 9000.0), expected + turned, odds(8, 0.8), True)
    assert np.allclose(before, behind)


def test_anchors_share_no_observation_before_they_must():
    rng = np.random.default_rng(7)
    q, counts = rng.uniform(-5.0, 5.0, (12, 2)), np.full(12, 3)
    pairs, tolerance = flights._anchors(q, np.full(12, 0.05), counts, 15)
    assert len(np.unique(pairs[:6])) == 12
    assert len({tuple(sorted(p)) for p in pairs.tolist()}) == len(pairs) == len(tolerance) == 15
    assert np.bincount(pairs.ravel(), minlength=12).max() <= 3
    lengths = np.linalg.norm(q[pairs[:, 0]] - q[pairs[:, 1]], axis=1)
    assert lengths[0] == max(np.linalg.norm(q[:, None] - q[None], axis=2).ravel())
