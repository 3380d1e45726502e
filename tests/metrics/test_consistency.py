"""NEES and NIS against their distributions."""

from __future__ import annotations

import numpy as np
import pytest

from tomthumb.metrics.consistency import chi2_band, innovation_consistency, nees, pose_consistency


@pytest.mark.parametrize(("runs", "low", "high"), [(20, 2.02, 4.16), (50, 2.36, 3.72), (100, 2.54, 3.50)])
def test_bands_of_the_average_nees(runs, low, high):
    assert chi2_band(3, runs) == pytest.approx((low, high), abs=0.005)


def test_nees_of_a_filter_that_tells_the_truth():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    cov = root @ root.T
    pose = rng.multivariate_normal(np.zeros(3), cov * 1e-2, 20_000)  # small: headings must not wrap
    truth = np.zeros_like(pose)
    found = pose_consistency(pose, np.tile(cov * 1e-2, (len(pose), 1, 1)), truth, np.ones(len(pose), bool))
    low, high = chi2_band(3, len(pose), 0.9999)
    assert low < found.mean < high
    assert found.inside == pytest.approx(0.95, abs=0.01)


def test_nees_is_unknown_where_the_covariance_is_not_positive_or_truth_is_missing():
    pose = np.zeros((3, 3))
    cov = np.stack([np.zeros((3, 3)), np.eye(3), np.eye(3)])
    truth = np.array([[1.0, 0, 0], [1.0, 0, 0], [np.nan] * 3])
    np.testing.assert_array_equal(nees(pose, cov, truth), [np.nan, 1.0, np.nan])
    np.testing.assert_array_equal(pose, 0.0)


def test_nis_per_degree_of_freedom():
    rng = np.random.default_rng(4)
    dof = rng.integers(0, 20, 3000)
    nis = rng.chisquare(np.maximum(dof, 1)) * (dof > 0)
    found = innovation_consistency(nis, dof, np.ones(3000, bool))
    low, high = (end / dof.sum() for end in chi2_band(int(dof.sum()), 1, 0.9999))
    assert low < found.mean < high
    assert found.low < 1.0 < found.high
    assert found.inside == pytest.approx(0.95, abs=0.02)
