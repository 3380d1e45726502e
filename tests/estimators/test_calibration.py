"""Systematic errors of the odometry as states: derivatives, recovery with honest intervals, names."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.worlds import STD, drive, models
from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.estimators.ekf import EKF, InvariantEKF
from tomthumb.models.calibration import corrected, known, sensitivity
from tomthumb.models.motion import Ackermann, OdometryIncrement, Velocity
from tomthumb.types import Control

READINGS = [
    (OdometryIncrement(), Control(np.array([0.4, 0.02, 0.1]), 1.0)),
    (Velocity(), Control(np.array([1.2, 0.3]), 0.5)),
    (Ackermann(ahead=3.8, left=0.5), Control(np.array([2.0, 0.2]), 0.3)),
]


@pytest.mark.parametrize(("motion", "control"), READINGS)
def test_the_derivative_equals_a_difference(motion, control):
    names = known(motion)
    values = np.linspace(-0.02, 0.03, len(names))
    delta, _, J = sensitivity(motion, control, names, values)
    for k in range(len(names)):
        step = np.zeros(len(names))
        step[k] = 1e-4
        model, reading = corrected(motion, control, names, values + step)
        np.testing.assert_allclose(model.increment(reading)[0], delta + J[:, k] * 1e-4, atol=1e-7)


@pytest.mark.parametrize(("motion", "control"), READINGS)
def test_no_error_changes_nothing(motion, control):
    delta, cov, _ = sensitivity(motion, control, known(motion), np.zeros(len(known(motion))))
    np.testing.assert_allclose(delta, motion.increment(control)[0])
    np.testing.assert_allclose(cov, motion.increment(control)[1])


@pytest.mark.parametrize("make", [EKF, InvariantEKF])
@pytest.mark.parametrize("local", [0, 10])
def test_scale_and_bias_are_recovered_with_honest_intervals(make, local):
    """Readings 5 % too long and 8 mrad short a step, over many seeds: the errors' own NEES fits chi-square."""
    scores = []
    for seed in range(12):
        motion, sensor = models("cartesian")
        rng = np.random.default_rng(seed)
        ekf = make(motion, sensor, calibrate=("scale", "heading_bias"), calibrate_std=(0.1, 0.02), local=local)
        belief = ekf.init(np.array([6.0, 3.0, 0.0]), np.zeros((3, 3)), rng)
        names = np.empty(0, np.int64)
        for _, control, seen, ids in drive(sensor, rng, steps=120):
            wrong = Control(control.u * [1 / 0.95, 1 / 0.95, 1.0] - [0.0, 0.0, 0.008], 1.0, np.diag(STD**2))
            belief = ekf.predict(belief, wrong, rng)
            named = np.where(np.isin(ids, names), ids, -1)
            belief = ekf.update(belief, seen, [named], rng)
            belief = ekf.add(belief, seen, [np.where(named < 0, ids, -1)], rng)
            names = np.union1d(names, ids)
            belief = ekf.promote(belief, names)
        found = ekf.calibration(belief)
        errors = [
            (found["scale"][0] + 0.05) / found["scale"][1],
            (found["heading_bias"][0] - 0.008) / found["heading_bias"][1],
        ]
        scores.append(errors)
        assert found["scale"][1] < 0.01
        assert found["heading_bias"][1] < 0.003
    assert 0.4 < np.mean(np.square(scores)) < 2.0  # 24 squares of standard normals: 99.9 % within


def test_calibration_states_are_not_landmarks():
    motion, sensor = models("cartesian")
    ekf = InvariantEKF(motion, sensor, calibrate=("scale",), calibrate_std=(0.1,))
    rng = np.random.default_rng(1)
    belief = ekf.init(np.array([6.0, 3.0, 0.0]), np.zeros((3, 3)), rng)
    (_, control, seen, ids), *_ = drive(sensor, rng, steps=1)
    belief = ekf.add(ekf.predict(belief, control, rng), seen, [ids], rng)
    assert set(ekf.expect(belief)[0].ids.tolist()) <= set(ids.tolist())
    np.testing.assert_array_equal(np.sort(ekf.estimate(belief).ids), np.sort(ids))
    belief = ekf.forget(belief, ids[:2])
    assert set(ekf.calibration(belief)) == {"scale"}


def test_what_cannot_be_estimated_is_named():
    motion, sensor = models("cartesian")
    with pytest.raises(UnknownName, match="heading_bias"):
        EKF(motion, sensor, calibrate=("heading_bais",), calibrate_std=(0.1,))
    with pytest.raises(TomThumbError, match="once"):
        EKF(motion, sensor, calibrate=("scale", "scale"), calibrate_std=(0.1, 0.1))
    with pytest.raises(TomThumbError, match="positive"):
        EKF(motion, sensor, calibrate=("scale",), calibrate_std=(0.0,))
