"""Time of an EKF-SLAM step (10 observations) with FilterPy's ExtendedKalmanFilter; prints JSON for step_cost.py --peer.

OPENBLAS_NUM_THREADS=1 python benchmarks/peers/filterpy_step.py 100 200 500 1000
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter


def measure(n: int) -> float:
    """Median ms of predict and update with ten stacked range-bearing observations."""
    rng = np.random.default_rng(0)
    size = 3 + 2 * n
    ekf = ExtendedKalmanFilter(dim_x=size, dim_z=20)
    landmarks = rng.uniform(-50, 50, (n, 2))
    ekf.x = np.concatenate([np.zeros(3), landmarks.ravel()])[:, None]
    ekf.P = np.eye(size) * 0.01
    ekf.F, ekf.Q = np.eye(size), np.zeros((size, size))
    ekf.Q[:3, :3] = np.diag([0.01, 0.01, 0.005]) ** 2
    ekf.R = np.diag([0.1, 0.02] * 10) ** 2
    near = np.argsort((landmarks**2).sum(1))[:10]

    def expected(x):
        away = x[3:].reshape(-1, 2)[near] - x[:2].T
        return np.column_stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - x[2, 0]]).reshape(-1, 1)

    def jacobian(x):
        H = np.zeros((20, size))
        for k, i in enumerate(near):
            dx, dy = (x[3 + 2 * i : 5 + 2 * i] - x[:2])[:, 0]
            q = dx * dx + dy * dy
            r = np.sqrt(q)
            D = np.array([[dx / r, dy / r], [-dy / q, dx / q]])
            H[2 * k : 2 * k + 2, :2], H[2 * k + 1, 2] = -D, -1.0
            H[2 * k : 2 * k + 2, 3 + 2 * i : 5 + 2 * i] = D
        return H

    seconds = []
    for _ in range(5 if n >= 500 else 20):
        z = expected(ekf.x) + np.tile([0.1, 0.02], 10)[:, None] * rng.standard_normal((20, 1))
        begin = time.process_time()
        ekf.predict()
        ekf.update(z, jacobian, expected)
        seconds.append(time.process_time() - begin)
    return 1e3 * float(np.median(seconds))


if __name__ == "__main__":
    print(json.dumps({"name": "FilterPy EKF", "ms": {n: measure(int(n)) for n in sys.argv[1:]}}))
