"""Worlds and problems small enough to try a part on, drawn from the model that the parts assume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tomthumb.geometry import compose, to_frame
from tomthumb.kernels.gates import innovations
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import Cartesian
from tomthumb.protocols import Rng
from tomthumb.types import (
    Array,
    AssociationProblem,
    Control,
    Ids,
    Observations,
    Predictions,
    Prior,
    Scenario,
    Step,
    Truth,
)

NOISE = 0.02  # m, standard deviation of an observation's components
MOVE = np.array([0.3, 0.0, 0.1])  # m, m, rad, a step
MOVE_STD = (0.01, 0.01, 0.005)


@dataclass(frozen=True)
class Trial:
    """A problem with the right answer: `truth (m,)` is the column of each observation, -1 for false ones."""

    problem: AssociationProblem
    truth: Ids


def trial(rng: Rng, m: int, n: int, *, spread: float = 10.0, labels: bool = False, bare: bool = False) -> Trial:
    """`m` observations of `n` landmarks drawn from the model: an uncertain pose, uncertain landmarks, noise.

    Landmarks lie within `spread` m; observations beyond the n-th are false and far away from all others. `bare` leaves
    out everything that a `Predictions` may do without.
    """
    points = rng.uniform(-spread, spread, (n, 2))
    pose_cov = np.diag([0.02, 0.02, 0.01]) ** 2
    by_pose = np.array([[[-1.0, 0.0, y], [0.0, -1.0, -x]] for x, y in points]).reshape(2 * n, 3)
    own = np.kron(np.eye(n), 0.02**2 * np.eye(2))
    cov, R = by_pose @ pose_cov @ by_pose.T + own, np.tile(0.02**2 * np.eye(2), (m, 1, 1))
    truth = np.full(m, -1, np.int64)
    truth[: min(m, n)] = rng.permutation(n)[: min(m, n)]
    error = (np.linalg.cholesky(cov + 1e-12 * np.eye(2 * n)) @ rng.standard_normal(2 * n)).reshape(n, 2)
    z = rng.uniform(3.0, 4.0, (m, 2)) * spread
    z[truth >= 0] = (points + error)[truth[truth >= 0]] + 0.02 * rng.standard_normal((int((truth >= 0).sum()), 2))
    more: dict[str, Any] = {} if bare else _more(by_pose, pose_cov, points)
    theirs = np.arange(n) % 2 if labels else None
    mine = np.where(truth >= 0, truth % 2, -1) if labels else None
    predictions = Predictions(np.arange(n), points, cov, labels=theirs, **more)
    nu = innovations(z, points, np.zeros(2, bool))
    return Trial(AssociationProblem(z, R, nu, predictions, np.full(m, 0.1), n + np.arange(m), (), mine), truth)


def _more(by_pose: Array, pose_cov: Array, points: Array) -> dict[str, Any]:
    n = len(points)
    cross = by_pose @ pose_cov
    sure = {"exist": np.full(n, 0.99), "visible": np.full(n, 0.95), "stone": np.ones(n, bool)}
    return {"pose_cov": pose_cov, "cross": cross, "points": points.copy(), **sure}


def trials() -> list[Trial]:
    """Sparse and crowded scans, with more observations than landmarks and the other way round."""
    rng = np.random.default_rng(11)
    shapes = [(1, 1), (4, 4), (8, 5), (5, 12), (12, 12)]
    return [trial(rng, m, n, spread=spread) for m, n in shapes for spread in (0.3, 10.0)]


def observe(pose: Array, points: Array, rng: Rng) -> Observations:
    """All `points (n, 2)` as a robot at `pose` sees them, with noise, in their order."""
    z = to_frame(pose, points) + NOISE * rng.standard_normal(points.shape)
    return Observations(z, np.tile(NOISE**2 * np.eye(2), (len(points), 1, 1)))


def sensor() -> Cartesian:
    """A sensor that sees all round, to 50 m."""
    return Cartesian(max_range=50.0)


def motion() -> OdometryIncrement:
    """Odometry whose readings carry no covariance of their own."""
    return OdometryIncrement(std=MOVE_STD)


def small_world(steps: int = 12, landmarks: int = 6) -> Scenario:
    """A robot on a bend among landmarks metres apart, all seen at every step."""
    rng = np.random.default_rng(16)
    angle = np.arange(landmarks) * 2.0 * np.pi / landmarks
    points = np.column_stack([8.0 * np.cos(angle), 6.0 * np.sin(angle)])
    pose, told, track = np.zeros(3), np.arange(landmarks), []
    for k in range(steps):
        reading = MOVE + np.array(MOVE_STD) * rng.standard_normal(3)
        pose = compose(pose, MOVE) if k else pose
        control = Control(reading, 1.0) if k else None
        track.append(Step(float(k), control, observe(pose, points, rng), Truth(pose, told)))
    return Scenario("small world", motion(), sensor(), Prior(np.zeros(3), np.zeros((3, 3))), track, points)
