"""Small worlds for estimator tests: a robot drives a loop among random points, everything named by the truth."""

from __future__ import annotations

import numpy as np

from tomthumb import geometry
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import Cartesian, RangeBearing
from tomthumb.types import Control, Observations

STD = np.array([0.02, 0.02, 0.01])


def models(kind):
    """Motion and sensor of a world whose sensor is `kind`."""
    sensor = RangeBearing(max_range=4.0, std=(0.05, 0.02), mount=(0.3, 0.1, 0.2))
    if kind == "cartesian":
        sensor = Cartesian(max_range=4.0, std=(0.05, 0.05), mount=(0.2, 0.0, -0.1))
    return OdometryIncrement(std=tuple(STD)), sensor


def drive(sensor, rng, *, steps, side=12.0, count=60, step=0.5, noise=1.0):
    """Yields (true pose, control, observations, true ids); a circle of diameter side / 2 about the square's centre."""
    points = side * rng.random((count, 2))
    turn = step / (side / 4)
    true = np.array([side / 2, side / 4, 0.0])
    for _ in range(steps):
        motion = np.array([step, 0.0, turn])
        true = geometry.compose(true, motion)
        control = Control(motion + noise * STD * rng.standard_normal(3), 1.0)
        z_hat = sensor.expect(true, points)[0]
        seen = np.flatnonzero(np.hypot(*geometry.to_frame(sensor.frame(true), points).T) < sensor.max_range)
        std = np.array(sensor.std)
        z = z_hat[seen] + std * rng.standard_normal((len(seen), 2))
        yield true, control, Observations(z, np.tile(np.diag(std**2), (len(seen), 1, 1))), seen


def ordered(belief, ids):
    """State and full covariance of an Atlas with its landmarks in the order of `ids`."""
    b = belief.active
    rows = np.concatenate([np.arange(3 + 2 * b.hidden), *[3 + 2 * b.slot[i] + np.arange(2) for i in ids]]).astype(int)
    P = np.tril(b.P[: b.dim, : b.dim])
    P = P + np.tril(P, -1).T
    return b.x[rows], P[np.ix_(rows, rows)]
