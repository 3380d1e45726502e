"""The same graphs in gtsam (extra `gtsam`): its solver, for those who have it and for comparison."""

from __future__ import annotations

from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.smoothing.graph import Graph
from tomthumb.types import Array

KERNELS = {"none": None, "huber": ("Huber", 1.345), "cauchy": ("Cauchy", 2.385)}


def solve_with_gtsam(graph: Graph, *, robust: str = "none", iterations: int = 100) -> tuple[Array, Array]:
    """Poses (K, 3) of the sensor and landmarks (n, 2). gtsam has no factor for a point: Cartesian sightings are given
    to it as range and bearing, with covariances carried over to first order. Raises TomThumbError without gtsam."""
    gtsam = _module()
    factors = _factors(gtsam, graph, robust)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")  # its Cholesky may throw after a loop is closed
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    result = gtsam.LevenbergMarquardtOptimizer(factors, _guess(gtsam, graph), parameters).optimize()
    K = len(graph.poses)
    poses = [result.atPose2(k) for k in range(K)]
    points = np.array([result.atPoint2(K + n) for n in range(len(graph.landmarks))]).reshape(-1, 2)
    return np.array([[p.x(), p.y(), p.theta()] for p in poses]), points


def _module() -> Any:
    try:
        import gtsam
    except ImportError as reason:
        raise TomThumbError("this needs gtsam: pip install 'tomthumb[gtsam]'") from reason
    return gtsam


def _guess(gtsam: Any, graph: Graph) -> Any:
    values = gtsam.Values()
    for k, pose in enumerate(graph.poses):
        values.insert(k, gtsam.Pose2(*pose))
    for n, point in enumerate(graph.landmarks):
        values.insert(len(graph.poses) + n, np.asarray(point))
    return values


def _factors(gtsam: Any, graph: Graph, robust: str) -> Any:
    if robust not in KERNELS:
        raise UnknownName("robust kernel", robust, KERNELS)
    factors, noise = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Gaussian.Covariance
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.prior), noise(graph.prior_cov)))
    for (i, j), delta, cov in zip(graph.edges.tolist(), graph.delta, graph.delta_cov, strict=True):
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*delta), noise(cov)))
    z, R = (graph.z, graph.R) if graph.polar else _as_polar(graph.z, graph.R)
    for (k, n), (r, b), cov in zip(graph.sightings.tolist(), z, R, strict=True):
        model = _robust(gtsam, noise(cov[::-1, ::-1].copy()), robust)  # gtsam puts the bearing first
        factors.add(gtsam.BearingRangeFactor2D(k, len(graph.poses) + n, gtsam.Rot2(b), r, model))
    return factors


def _robust(gtsam: Any, model: Any, name: str) -> Any:
    chosen = KERNELS[name]
    if chosen is None:
        return model
    kernel = getattr(gtsam.noiseModel.mEstimator, chosen[0]).Create(chosen[1])
    return gtsam.noiseModel.Robust.Create(kernel, model)


def _as_polar(z: Array, R: Array) -> tuple[Array, Array]:
    r = np.hypot(z[:, 0], z[:, 1])
    unit = z / r[:, None]
    J = np.stack([unit, np.column_stack([-unit[:, 1], unit[:, 0]]) / r[:, None]], 1)
    return np.column_stack([r, np.arctan2(z[:, 1], z[:, 0])]), J @ R @ J.transpose(0, 2, 1)
