"""Time of a gtsam iSAM2 step (one pose, 10 known landmarks); prints JSON for step_cost.py --peer.

OPENBLAS_NUM_THREADS=1 python benchmarks/peers/gtsam_step.py 100 1000
"""

from __future__ import annotations

import json
import sys
import time

import gtsam
import numpy as np


def measure(n: int) -> float:
    """Median ms of an update once all n landmarks are in the graph."""
    isam, rng = gtsam.ISAM2(), np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(n)))
    points = 2.0 * np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)[:n] - side + 0.7
    noise = gtsam.noiseModel.Diagonal.Sigmas
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), noise(np.array([0.01, 0.01, 0.002]))))
    values.insert(0, gtsam.Pose2())
    for i, point in enumerate(points):
        values.insert(10**6 + i, point)
        graph.add(_sight(0, i, point, noise, rng))
    isam.update(graph, values)
    near = np.argsort((points**2).sum(1))[:10]
    seconds = []
    for k in range(1, 201):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        move = noise(np.array([0.01, 0.01, 0.005]))
        graph.add(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(), move))
        values.insert(k, gtsam.Pose2())
        for i in near:
            graph.add(_sight(k, int(i), points[i], noise, rng))
        begin = time.process_time()
        isam.update(graph, values)
        isam.calculateEstimatePose2(k)
        seconds.append(time.process_time() - begin)
    return 1e3 * float(np.median(seconds))


def _sight(k, i, point, noise, rng):
    r, b = np.hypot(*point) + 0.1 * rng.standard_normal(), np.arctan2(point[1], point[0]) + 0.02 * rng.standard_normal()
    return gtsam.BearingRangeFactor2D(k, 10**6 + i, gtsam.Rot2(b), max(r, 0.05), noise(np.array([0.02, 0.1])))


if __name__ == "__main__":
    print(json.dumps({"name": "gtsam iSAM2, median", "ms": {n: measure(int(n)) for n in sys.argv[1:]}}))
