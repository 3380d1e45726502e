"""Does the filter know how wrong it is? NEES and NIS over seeds, against the chi-square bands of the right model."""

from __future__ import annotations

import numpy as np
import pytest

import tomthumb
from tomthumb.metrics.consistency import chi2_band, nees

SEEDS = 20
LEVEL = 0.999  # of each band: the tests look at a few, and a sound filter must not fail by chance


@pytest.fixture(scope="module", params=["ekf", "iekf"])
def runs(request):
    """Square worlds of known noise, named by the oracle; landmarks enter at once, as the filter's theory has it."""
    found = []
    for seed in range(SEEDS):
        scenario = tomthumb.load("square", seed=seed)
        settings = {"slam": {"hits": 1, "merge": False}}
        trace = tomthumb.run(scenario, associator="oracle", estimator=request.param, seed=seed, settings=settings)
        found.append((trace, np.array([step.truth.pose for step in scenario.steps])))
    return found


@pytest.mark.parametrize("share", [0.25, 0.5, 0.95])
def test_nees_over_seeds_is_chi_square(runs, share):
    values = [nees(t.pose, t.pose_cov, truth)[int(share * (len(truth) - 1))] for t, truth in runs]
    low, high = chi2_band(3, SEEDS, LEVEL)
    assert low < np.mean(values) < high


def test_nis_over_seeds_is_chi_square(runs):
    total, dof = sum(t.nis.sum() for t, _ in runs), sum(int(t.dof.sum()) for t, _ in runs)
    low, high = chi2_band(dof, 1, LEVEL)
    assert low < total < high
