"""Time of an EKF-SLAM step (10 observations) with Stone Soup's extended Kalman filter; prints JSON for step_cost.py --peer.

OPENBLAS_NUM_THREADS=1 python benchmarks/peers/stonesoup_step.py 100 200 500 1000
"""

from __future__ import annotations

import json
import sys
import time
from datetime import datetime, timedelta

import numpy as np
from stonesoup.base import Property
from stonesoup.models.base import GaussianModel
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater


class Sightings(MeasurementModel, GaussianModel):
    """Range and bearing of ten landmarks of the state, from the pose in its first three elements."""

    near: np.ndarray = Property(doc="the landmarks seen")

    @property
    def ndim_meas(self) -> int:
        return 20

    def function(self, state, noise=False, **kwargs):
        x = np.asarray(state.state_vector, float).ravel()
        away = x[3:].reshape(-1, 2)[self.near] - x[:2]
        return np.column_stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - x[2]]).reshape(-1, 1)

    def jacobian(self, state, **kwargs):
        x = np.asarray(state.state_vector, float).ravel()
        H = np.zeros((20, len(x)))
        for k, i in enumerate(self.near):
            dx, dy = x[3 + 2 * i : 5 + 2 * i] - x[:2]
            q = dx * dx + dy * dy
            r = np.sqrt(q)
            D = np.array([[dx / r, dy / r], [-dy / q, dx / q]])
            H[2 * k : 2 * k + 2, :2], H[2 * k + 1, 2] = -D, -1.0
            H[2 * k : 2 * k + 2, 3 + 2 * i : 5 + 2 * i] = D
        return H

    def covar(self, **kwargs):
        return np.diag([0.1, 0.02] * 10) ** 2

    def pdf(self, *args, **kwargs):
        raise NotImplementedError("the filter does not ask for it")

    rvs = logpdf = pdf


def measure(n: int) -> float:
    """Median ms of predict and update with ten stacked range-bearing observations."""
    rng = np.random.default_rng(0)
    size = 3 + 2 * n
    landmarks = rng.uniform(-50, 50, (n, 2))
    near = np.argsort((landmarks**2).sum(1))[:10]
    Q = np.zeros((size, size))
    Q[:3, :3] = np.diag([0.01, 0.01, 0.005]) ** 2
    motion = LinearGaussianTimeInvariantTransitionModel(np.eye(size), Q)
    sensor = Sightings(ndim_state=size, mapping=tuple(range(size)), near=near)
    predictor, updater = ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater(sensor)
    t = datetime(2020, 1, 1)
    state = GaussianState(np.concatenate([np.zeros(3), landmarks.ravel()])[:, None], np.eye(size) * 0.01, t)
    seconds = []
    for _ in range(5 if n >= 500 else 20):
        t += timedelta(seconds=1)
        z = sensor.function(state) + np.tile([0.1, 0.02], 10)[:, None] * rng.standard_normal((20, 1))
        begin = time.process_time()
        prediction = predictor.predict(state, timestamp=t)
        state = updater.update(SingleHypothesis(prediction, Detection(z, t, measurement_model=sensor)))
        seconds.append(time.process_time() - begin)
    return 1e3 * float(np.median(seconds))


if __name__ == "__main__":
    print(json.dumps({"name": "Stone Soup EKF", "ms": {n: measure(int(n)) for n in sys.argv[1:]}}))
