"""Time of an EKF-SLAM step (10 observations) with FilterPy's ExtendedKalmanFilter; prints JSON for step_cost.py --peer.

OPENBLAS_NUM_THREADS=1 python benchmarks/peers/filterpy_step.py 100 200 500 1000
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scene import NOISE, Scene, told


def of(place: Scene):
    """The filter's state when asked, and its step: predict and update with stacked observations."""
    size = len(place.x)
    ekf = ExtendedKalmanFilter(dim_x=size, dim_z=20)
    ekf.x, ekf.P = place.x[:, None].copy(), np.eye(size) * 0.01
    ekf.F, ekf.Q, ekf.R = np.eye(size), place.process_noise(), np.diag(NOISE**2)

    def step(z):
        ekf.predict()
        ekf.update(z[:, None], lambda x: place.jacobian(x.ravel()), lambda x: place.expected(x.ravel())[:, None])

    return lambda: ekf.x.ravel(), step


if __name__ == "__main__":
    told("FilterPy EKF", of)
