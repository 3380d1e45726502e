"""Time of an EKF-SLAM step (10 observations) with Stone Soup's extended Kalman filter; prints JSON for step_cost.py --peer.

OPENBLAS_NUM_THREADS=1 python benchmarks/peers/stonesoup_step.py 100 200 500 1000
"""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from scene import NOISE, Scene, told
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

    place: Scene = Property(doc="what is seen")

    @property
    def ndim_meas(self) -> int:
        return 20

    def function(self, state, noise=False, **kwargs):
        return self.place.expected(_plain(state))[:, None]

    def jacobian(self, state, **kwargs):
        return self.place.jacobian(_plain(state))

    def covar(self, **kwargs):
        return np.diag(NOISE**2)

    def pdf(self, *args, **kwargs):
        raise NotImplementedError("the filter does not ask for it")

    rvs = logpdf = pdf


def _plain(state) -> np.ndarray:
    return np.asarray(state.state_vector, float).ravel()


def of(place: Scene):
    """The filter's state when asked, and its step: predict and update with stacked observations."""
    size = len(place.x)
    motion = LinearGaussianTimeInvariantTransitionModel(np.eye(size), place.process_noise())
    sensor = Sightings(ndim_state=size, mapping=tuple(range(size)), place=place)
    predictor, updater = ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater(sensor)
    now = [GaussianState(place.x[:, None], np.eye(size) * 0.01, datetime(2020, 1, 1))]

    def step(z):
        t = now[0].timestamp + timedelta(seconds=1)
        prediction = predictor.predict(now[0], timestamp=t)
        seen = Detection(z[:, None], t, measurement_model=sensor)
        now[0] = updater.update(SingleHypothesis(prediction, seen))

    return lambda: _plain(now[0]), step


if __name__ == "__main__":
    told("Stone Soup EKF", of)
