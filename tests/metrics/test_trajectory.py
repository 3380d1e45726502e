"""Trajectory errors in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomthumb.geometry import compose
from tomthumb.metrics.trajectory import relative_errors, trajectory_errors

ALL = np.ones(40, bool)


def path(count: int = 40) -> np.ndarray:
    """A quarter circle of radius 10 m, headings along it."""
    angle = np.linspace(0.0, 0.5 * math.pi, count)
    return np.stack([10 * np.sin(angle), 10 - 10 * np.cos(angle), angle], 1)


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
def test_a_rigid_motion_leaves_aligned_and_relative_errors_at_zero(x, y, heading):
    moved = np.array([compose(np.array([x, y, heading]), pose) for pose in path()])
    errors = trajectory_errors(moved, path(), ALL)
    assert errors.ate == pytest.approx(0.0, abs=1e-9)
    assert relative_errors(moved, path(), ALL) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_raw_errors_by_axis():
    moved = path() + np.array([3.0, -4.0, math.radians(2.0)])
    errors = trajectory_errors(moved, path(), ALL)
    assert errors.ate_raw == pytest.approx(5.0)
    assert (errors.x, errors.y) == pytest.approx((3.0, 4.0))
    assert errors.heading == pytest.approx(math.radians(2.0))
    assert (errors.final, errors.largest) == pytest.approx((5.0, 5.0))


def test_headings_are_compared_the_short_way_round():
    real, mine = path(), path()
    real[:, 2], mine[:, 2] = math.pi - 0.01, -math.pi + 0.01
    assert trajectory_errors(mine, real, ALL).heading == pytest.approx(0.02)


def test_alignment_does_not_scale():
    mine = path() * [1.1, 1.1, 1.0]
    assert trajectory_errors(mine, path(), ALL).ate > 0.1


def test_unknown_truth_is_left_out():
    real = path()
    real[::2] = np.nan
    mine = path()
    mine[::2] += 100.0
    assert trajectory_errors(mine, real, ALL).ate_raw == 0.0
    assert math.isnan(trajectory_errors(mine, np.full((40, 3), np.nan), ALL).ate)


def test_positions_without_headings_still_give_ate():
    real = path()
    real[:, 2] = np.nan
    errors = trajectory_errors(path(), real, ALL)
    assert errors.ate == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(errors.heading)
    assert math.isnan(relative_errors(path(), real, ALL)[0])


def test_relative_error_of_a_scale_of_ten_percent():
    real = np.stack([np.linspace(0.0, 39.0, 40), np.zeros(40), np.zeros(40)], 1)
    assert relative_errors(real * [1.1, 1.0, 1.0], real, ALL)[0] == pytest.approx(0.1)


def test_relative_error_of_a_short_path_is_unknown():
    assert math.isnan(relative_errors(path() * 0.01, path() * 0.01, ALL)[0])
