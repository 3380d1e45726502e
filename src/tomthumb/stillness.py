"""Does it stand still? What a thing on trial was seen aside of where it was expected, added up.

The gate of each sighting alone lets slow walkers pass, for the estimate follows them. A landmark's innovations are white; a
walker's all point his way, the farther the longer he has been walking.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tomthumb.geometry import rotation, wrapped
from tomthumb.kernels.gates import innovations
from tomthumb.kernels.posterior import bend
from tomthumb.protocols import Sensor
from tomthumb.types import Array, Ids, Observations, Predictions

BENT = 0.3  # of the noise: a sighting whose linearisation leaves out more says nothing, for that all points one way too


@dataclass(frozen=True, slots=True)
class Drift:
    """Innovations (2,) of one thing by the world's axes, each in its own standard deviations, times its age in scans; and
    the sum of the squared ages. Of a landmark, the one by the root of the other is standard normal.
    """

    way: tuple[float, float] = (0.0, 0.0)
    ages: float = 0.0

    def and_seen(self, age: int, nu: Array, S: Array) -> Drift:
        """One more sighting, `age` scans after the first, nu (2,) m from where it was expected with covariance S (2, 2) m2."""
        values, axes = np.linalg.eigh(S)
        white = axes @ ((axes.T @ nu) / np.sqrt(np.maximum(values, 1e-12)))
        way = (self.way[0] + age * float(white[0]), self.way[1] + age * float(white[1]))
        return Drift(way, self.ages + age * age)

    @property
    def d2(self) -> float:
        """Chi-square of 2 degrees of freedom for what stands still."""
        return (self.way[0] ** 2 + self.way[1] ** 2) / self.ages if self.ages > 0.0 else 0.0


class OnTrial(Protocol):
    """What may still turn out to move: the scan of its first sighting, and its drift since."""

    born: int
    drift: Drift


def record_drifts(
    ledger: Mapping[int, OnTrial],
    crumbs: set[int],
    expected: tuple[Predictions, Ids],
    seen: Observations,
    sensor: Sensor,
    pose: Array,
    scan: int,
) -> None:
    """Crumbs that were seen in scan number `scan`, each beside what the stones of that scan say of pose and map.

    expected: the predictions, and which of them (m,) each observation is, or -1. pose (3,): after the update.
    """
    predictions, match = expected
    rows = np.flatnonzero(match >= 0)
    ids = predictions.ids[match[rows]].tolist()
    tried = np.flatnonzero([i in crumbs for i in ids])
    if not len(tried) or predictions.points is None or predictions.pose_cov is None:
        return
    nu, S = joint(predictions, match[rows], seen.take(rows), sensor)
    left, own = given_others(nu, S, np.setdiff1d(np.arange(len(rows)), tried), tried)
    *_, by_z = sensor.locate(pose, seen.z[rows[tried]])
    turned, heading = rotation(float(sensor.frame(pose)[2])), float(predictions.pose_cov[2, 2])
    for k, T, x, C in zip(tried.tolist(), by_z, left, own, strict=True):
        point, noise = turned @ predictions.points[match[rows[k]]], T @ seen.R[rows[k]] @ T.T
        if bend(point[0], point[1], noise, heading) < BENT:
            life = ledger[ids[k]]
            life.drift = life.drift.and_seen(scan - life.born, T @ x, T @ C @ T.T)


def joint(predictions: Predictions, columns: Ids, seen: Observations, sensor: Sensor) -> tuple[Array, Array]:
    """Innovations (k, 2) of pairings and their joint covariance (2k, 2k)."""
    k = len(columns)
    nu = innovations(seen.z, predictions.z_hat[columns], wrapped(sensor.angles))[np.arange(k), np.arange(k)]
    where = (2 * columns[:, None] + np.arange(2)).ravel()
    S = predictions.cov[np.ix_(where, where)]
    for i in range(k):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += seen.R[i]
    return nu, S


def given_others(nu: Array, S: Array, known: Ids, tried: Ids) -> tuple[Array, Array]:
    """Innovations (t, 2) of the pairings `tried`, and covariances (t, 2, 2), given those of the pairings `known`.

    nu (k, 2) and S (2k, 2k) are joint. Pose and map err alike for both: what is left over is the thing's own.
    """
    every = np.arange(2 * len(nu)).reshape(-1, 2)
    rest, mine = every[known].ravel(), every[tried].ravel()
    gain = np.linalg.solve(S[np.ix_(rest, rest)], S[np.ix_(rest, mine)]).T
    left = nu.ravel()[mine] - gain @ nu.ravel()[rest]
    own = S[np.ix_(mine, mine)] - gain @ S[np.ix_(rest, mine)]
    return left.reshape(-1, 2), np.array([own[k : k + 2, k : k + 2] for k in range(0, len(mine), 2)])
