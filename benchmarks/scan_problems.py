"""Single scans with known truth, from scans anybody names to scans from an unknown place.

sep, mid, mid+sp, dense+sp: n range-bearing observations (m, rad) of n predicted landmarks in a sector of 120 deg,
whose errors share that of the robot's pose (.3 m, .3 m, 2 deg). The farthest range is set so that on average 1, 2, 4
landmarks lie within the 99 % gate of a true observation; "+sp": a fifth of the landmarks is missed, and as many false
observations stand in their place.

wide, lost: about m Cartesian observations (m, m) all round, of a known cloud with one landmark a square metre, from a
pose uncertain by (.6 m, 4 deg) and (2 m, 15 deg): detection .9, false observations .1 a square metre. Linearised at the
prior such an error is poor; a rigid motion of the predicted points is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import chdtri

from tomthumb.kernels.gates import innovations
from tomthumb.protocols import Rng
from tomthumb.types import Array, AssociationProblem, Ids, Predictions

SECTOR_CLASSES = {"sep": (1.03, 0.0), "mid": (2.0, 0.0), "mid+sp": (2.0, 0.2), "dense+sp": (4.0, 0.2)}
CLOUD_CLASSES = {"wide": (0.6, np.radians(4.0)), "lost": (2.0, np.radians(15.0))}
CLASSES = (*SECTOR_CLASSES, *CLOUD_CLASSES)

POSE_STD = np.array([0.3, 0.3, np.radians(2.0)])
SENSOR_STD = np.array([0.1, np.radians(1.0)])
OWN_STD = 0.05  # m, each landmark by itself
NEAREST, HALF_SECTOR = 3.0, np.pi / 3
CLOUD_NOISE, CLOUD_OWN, CLOUD_DETECT, CLOUD_CLUTTER = 0.05, 0.02, 0.9, 0.1


@dataclass(frozen=True)
class Scan:
    """What an associator is told, piece by piece, and `truth (m,)`: the prediction of each observation, -1 if false."""

    z: Array
    R: Array
    predictions: Predictions
    truth: Ids
    clutter: float
    angles: tuple[int, ...]

    def problem(self) -> AssociationProblem:
        """A fresh problem: nothing of it is computed yet, so that a timing holds all of it."""
        m, n = len(self.z), len(self.predictions)
        nu = innovations(self.z, self.predictions.z_hat, np.isin([0, 1], self.angles))
        noise = np.tile(self.R, (m, 1, 1))
        return AssociationProblem(
            self.z, noise, nu, self.predictions, np.full(m, self.clutter), n + np.arange(m), self.angles
        )


def scans(kind: str, size: int, count: int, seed: int) -> list[Scan]:
    """`count` problems of one class and size, the same for the same seed."""
    rng = np.random.default_rng([seed, CLASSES.index(kind), size])
    if kind in CLOUD_CLASSES:
        return [_cloud(rng, size, *CLOUD_CLASSES[kind]) for _ in range(count)]
    wanted, false = SECTOR_CLASSES[kind]
    reach = _reach(size, wanted)
    return [_sector(rng, size, reach, false) for _ in range(count)]


# --- a sector in front of the robot -----------------------------------------------------------------------------------


def _sector(rng: Rng, n: int, reach: float, false: float) -> Scan:
    polar = _in_sector(rng, n, reach)
    points = _flat(polar)
    by_pose, by_point = _jacobians(points)
    G = by_pose.reshape(2 * n, 3)
    cov = G @ np.diag(POSE_STD**2) @ G.T
    k = np.arange(n)
    cov.reshape(n, 2, n, 2)[k, :, k, :] += OWN_STD**2 * by_point @ by_point.transpose(0, 2, 1)
    pose = POSE_STD * rng.standard_normal(3)
    z = _polar(points + OWN_STD * rng.standard_normal((n, 2)) - pose[:2]) - [0.0, pose[2]]
    z += SENSOR_STD * rng.standard_normal((n, 2))
    truth, wrong = np.arange(n), rng.choice(n, int(false * n), replace=False)
    z[wrong], truth[wrong] = _in_sector(rng, len(wrong), reach), -1
    order = rng.permutation(n)
    area = (reach - NEAREST) * 2.0 * HALF_SECTOR
    visible = np.full(n, 1.0 - false if false else 0.99)
    predictions = Predictions(k, polar, cov, np.diag(POSE_STD**2), G @ np.diag(POSE_STD**2), points, visible=visible)
    clutter = max(false, 0.01) * n / area
    return Scan(z[order], np.diag(SENSOR_STD**2), predictions, truth[order], clutter, (1,))


def _in_sector(rng: Rng, count: int, reach: float) -> Array:
    """Range and bearing (count, 2) of points uniform over the sector's area."""
    u = rng.random((count, 2))
    r = np.sqrt(NEAREST**2 + u[:, 0] * (reach**2 - NEAREST**2))
    return np.column_stack([r, HALF_SECTOR * (2.0 * u[:, 1] - 1.0)])


def _flat(polar: Array) -> Array:
    return polar[:, :1] * np.column_stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])])


def _polar(points: Array) -> Array:
    return np.column_stack([np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])])


def _jacobians(points: Array) -> tuple[Array, Array]:
    """Of range and bearing at the origin by the pose (n, 2, 3) and by the point (n, 2, 2)."""
    r = np.hypot(*points.T)[:, None]
    along, across = points / r, np.column_stack([-points[:, 1], points[:, 0]]) / r**2
    by_point = np.stack([along, across], 1)
    turn = np.tile([[0.0], [-1.0]], (len(points), 1, 1))
    return np.concatenate([-by_point, turn], 2), by_point


@cache
def _reach(n: int, wanted: float) -> float:
    """The farthest range, m, at which a true observation has `wanted` landmarks within its 99 % gate on average."""
    low, high = NEAREST + 0.02 * np.sqrt(n), NEAREST + 200.0 * np.sqrt(n)
    for _ in range(24):
        middle = NEAREST + np.sqrt((low - NEAREST) * (high - NEAREST))
        rng = np.random.default_rng(1)
        crowding = np.mean([crowd(_sector(rng, n, middle, 0.0)) for _ in range(60)])
        low, high = (middle, high) if crowding > wanted else (low, middle)
    return float(np.sqrt((low - NEAREST) * (high - NEAREST)) + NEAREST)


def crowd(scan: Scan) -> float:
    """Mean number of predictions within the 99 % gate of a true observation."""
    d2 = scan.problem().d2[scan.truth >= 0]
    return float((d2 < chdtri(2, 0.01)).sum(1).mean())


# --- a cloud all round the robot --------------------------------------------------------------------------------------


def _cloud(rng: Rng, m: int, metres: float, turn: float) -> Scan:
    reach = np.sqrt(m / np.pi)
    half = reach * (1.0 + 4.0 * turn) + 4.0 * metres
    n = int(rng.poisson(4.0 * half**2))
    points = rng.uniform(-half, half, (n, 2))
    std = np.array([metres, metres, turn])
    x, y, theta = std * rng.standard_normal(3)
    c, s = np.cos(theta), np.sin(theta)
    seen = (points + CLOUD_OWN * rng.standard_normal((n, 2)) - [x, y]) @ np.array([[c, -s], [s, c]])
    found = np.flatnonzero((np.hypot(*seen.T) < reach) & (rng.random(n) < CLOUD_DETECT))
    false = int(rng.poisson(CLOUD_CLUTTER * np.pi * reach**2))
    disc = np.column_stack([reach * np.sqrt(rng.random(false)), rng.uniform(-np.pi, np.pi, false)])
    z = np.vstack([seen[found] + CLOUD_NOISE * rng.standard_normal((len(found), 2)), _flat(disc)])
    truth = np.append(found, np.full(false, -1))
    order = rng.permutation(len(z))
    G = np.zeros((n, 2, 3))
    G[:, 0, 0] = G[:, 1, 1] = -1.0
    G[:, 0, 2], G[:, 1, 2] = points[:, 1], -points[:, 0]
    G = G.reshape(2 * n, 3)
    pose_cov = np.diag(std**2)
    cov = G @ pose_cov @ G.T + CLOUD_OWN**2 * np.eye(2 * n)
    predictions = Predictions(
        np.arange(n), points, cov, pose_cov, G @ pose_cov, points, visible=np.full(n, CLOUD_DETECT)
    )
    return Scan(z[order], CLOUD_NOISE**2 * np.eye(2), predictions, truth[order], CLOUD_CLUTTER, ())
