"""A filter that runs for very long stays a filter."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.worlds import drive, models, ordered
from tomthumb.estimators.ekf import EKF, InvariantEKF


def live(make, steps):
    """A belief after `steps` steps round a small ring, all landmarks known; and the ids it knows."""
    motion, sensor = models("cartesian")
    ekf, rng = make(motion, sensor), np.random.default_rng(0)
    belief = ekf.init(np.array([2.0, 1.0, 0.0]), np.zeros((3, 3)), rng)
    known = np.empty(0, np.int64)
    lap = list(drive(sensor, rng, steps=40, side=4.0, count=8))
    for k in range(steps):
        _, control, seen, ids = lap[k % 40]
        belief = ekf.predict(belief, control, rng)
        named = np.where(np.isin(ids, known), ids, -1)
        belief = ekf.update(belief, seen, [named], rng)
        fresh = np.setdiff1d(ids, known)
        if len(fresh):
            belief = ekf.promote(ekf.add(belief, seen, [np.where(named < 0, ids, -1)], rng), fresh)
            known = np.union1d(known, fresh)
    return belief, known


@pytest.mark.parametrize("make", [EKF, InvariantEKF])
def test_positive_definite_after_many_steps(make):
    _, P = ordered(*live(make, 3000))
    assert np.linalg.eigvalsh(P)[0] > 0.0


@pytest.mark.slow
def test_positive_definite_after_a_million_steps():
    """One after the other, never symmetrised, never reset; some minutes."""
    _, P = ordered(*live(InvariantEKF, 1_000_000))
    assert np.linalg.eigvalsh(P)[0] > 0.0
