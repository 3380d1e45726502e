"""A small map laid on a large one: found without a prior, not found where it is not, and exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomthumb.constellation import Within, fits, fitted, shares, shares_at_most, spacing, standing
from tomthumb.geometry import align, compose, inverse, to_world


def scattered(rng: np.random.Generator, n: int = 200, side: float = 30.0) -> np.ndarray:
    return side * rng.random((n, 2))


def part_of(points: np.ndarray, rng: np.random.Generator, noise: float, motion: np.ndarray, k: int = 12):
    """The k points nearest to one of them, as seen from another frame, with noise."""
    centre = points[rng.integers(len(points))]
    chosen = np.argsort(((points - centre) ** 2).sum(1))[:k]
    q = to_world(inverse(motion), points[chosen]) + noise * rng.standard_normal((k, 2))
    return q, chosen


@pytest.mark.parametrize("seed", range(10))
def test_a_part_is_found_wherever_it_lies_with_all_its_pairs(seed):
    rng = np.random.default_rng(seed)
    points, motion = scattered(rng), np.array([12.0, -7.0, 2.5])
    q, chosen = part_of(points, rng, 0.02, motion)
    best, *others = fits(q, np.tile(0.02**2 * np.eye(2), (len(q), 1, 1)), points)
    assert best.votes >= 11
    hit = best.match >= 0
    assert (best.match[hit] == chosen[hit]).mean() > 0.9
    np.testing.assert_allclose(to_world(best.motion, q), points[chosen], atol=0.15)
    assert all(other.gain < 0.75 * best.gain for other in others)


@pytest.mark.parametrize(("shift", "turn", "there"), [(1.5, 0.1, True), (3.0, 0.0, False), (0.0, 0.5, False)])
def test_places_beyond_the_bounds_are_not_looked_at(shift, turn, there):
    rng = np.random.default_rng(5)
    points, motion = scattered(rng), np.array([12.0, -7.0, 2.5])
    q, _ = part_of(points, rng, 0.02, motion)
    pivot = q.mean(0)
    place = to_world(motion, pivot[None])[0] + [shift, 0.0]
    also = np.append(place - to_world(np.array([0.0, 0.0, motion[2] + turn]), pivot[None])[0], motion[2] + turn)
    np.testing.assert_allclose(compose(also, np.append(pivot, 0.0))[:2], place)
    found = fits(q, np.tile(0.02**2 * np.eye(2), (len(q), 1, 1)), points, also, Within(pivot, 2.0, 0.3))
    right = [np.abs(fit.motion - motion).max() < 0.2 for fit in found]
    assert any(right) == there


def test_the_motion_is_that_of_least_squares_and_its_covariance_what_repetition_shows():
    rng = np.random.default_rng(3)
    points, motion = scattered(rng), np.array([2.0, 1.0, -0.7])
    chosen = np.argsort(((points - points[0]) ** 2).sum(1))[:15]
    exact = to_world(inverse(motion), points[chosen])
    found, told = [], None
    for _ in range(200):
        q = exact + 0.03 * rng.standard_normal(exact.shape)
        best = fits(q, np.tile(0.03**2 * np.eye(2), (15, 1, 1)), points)[0]
        np.testing.assert_allclose(
            best.motion, align(q[best.match >= 0], points[best.match[best.match >= 0]]), atol=1e-9
        )
        found.append(best.motion)
        told = best.cov
    # votes are given the local noise twice (for the map's own), so the covariance is twice what the map as truth shows
    assert told is not None
    ratio = np.diag(np.cov(np.array(found).T)) / np.diag(told)
    assert ((ratio > 0.35) & (ratio < 0.75)).all()


def test_what_is_not_there_gets_few_votes():
    rng = np.random.default_rng(5)
    points, q = scattered(rng), scattered(rng, 12, 6.0)
    found = fits(q, np.tile(0.02**2 * np.eye(2), (12, 1, 1)), points)
    assert not found or found[0].votes < 8


def test_a_periodic_map_has_rivals():
    x, y = np.meshgrid(np.arange(20.0), np.arange(3.0))
    points = np.column_stack([x.ravel(), y.ravel()])
    q = points[:12] - points[0]
    best, second, *_ = fits(q, np.tile(1e-4 * np.eye(2), (12, 1, 1)), points)
    assert best.votes == second.votes == 12


def test_the_believed_place_is_looked_at_in_any_case():
    x, y = np.meshgrid(np.arange(60.0), np.arange(3.0))
    points = np.column_stack([x.ravel(), y.ravel()])
    q = points[(points[:, 0] > 30) & (points[:, 0] < 36)]
    found = fits(q, np.tile(1e-4 * np.eye(2), (len(q), 1, 1)), points, np.zeros(3))
    assert any(np.abs(fit.motion).max() < 1e-6 for fit in found)


@given(st.integers(0, 2**31), st.integers(0, 2))
def test_too_few_points_fit_nowhere(seed, k):
    rng = np.random.default_rng(seed)
    assert fits(rng.random((k, 2)), np.tile(np.eye(2), (k, 1, 1)), rng.random((10, 2))) == []


def test_spacing_is_the_distance_to_the_nearest_neighbour():
    points = scattered(np.random.default_rng(1), 50)
    distance = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    np.testing.assert_allclose(spacing(points), distance.min(1))


def test_shares_are_what_a_gain_is_made_of():
    rng = np.random.default_rng(7)
    points = scattered(rng)
    q = np.concatenate([points[:8], [[900.0, 900.0]]]) + 0.02 * rng.standard_normal((9, 2))
    covs = np.tile(0.02**2 * np.eye(2), (9, 1, 1))
    fit = fits(q, covs, points)[0]
    each = shares(fit, q, covs, points)
    assert each.sum() == pytest.approx(fit.gain)
    assert (each[fit.match < 0] == 0.0).all()
    assert (each <= shares_at_most(covs, points) + 1e-12).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_that_stands_is_not_moved_and_every_pair_speaks_for_it(seed):
    rng = np.random.default_rng(seed)
    points = scattered(rng)
    motion = np.array([3.0, -2.0, 0.4])
    q = to_world(inverse(motion), points[:9] + 0.05 * rng.standard_normal((9, 2)))
    covs = np.tile(0.05**2 * np.eye(2), (9, 1, 1))
    fit = standing(q, covs, points, motion)
    np.testing.assert_array_equal(fit.motion, motion)
    assert (shares(fit, q, covs, points)[fit.match >= 0] >= -1e-9).all()
    assert fit.gain == pytest.approx(shares(fit, q, covs, points).sum())
    assert standing(q, covs, points, motion + np.array([500.0, 0.0, 0.0])).gain == -np.inf


def test_a_pose_that_stands_keeps_its_pairs_where_wide_gates_draw_a_fit_away():
    """Six landmarks lie just where the map has them; new ones, a metre beside the others, are no pairs of theirs."""
    points = np.array([[x, y] for x in range(6) for y in (0.0, 0.2)] + [[40.0, 0.0], [40.0, 5.0], [45.0, 5.0]])
    q = np.concatenate([points[:6], points[6:12] + np.array([0.45, 0.35])])
    covs = np.tile(0.3**2 * np.eye(2), (12, 1, 1))
    fit = standing(q, covs, points, np.zeros(3))
    assert fit.match[:6].tolist() == [0, 1, 2, 3, 4, 5]
    assert np.abs(fitted(q, covs, points, np.zeros(3)).motion[:2]).max() > 0.1
    np.testing.assert_array_equal(fit.motion, np.zeros(3))
