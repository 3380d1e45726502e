"""Errors of the map: position error of each landmark, and GOSPA, which also counts the missed and the false."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tomthumb.geometry import align, to_world
from tomthumb.metrics.assignment import best_assignment
from tomthumb.metrics.trajectory import rms
from tomthumb.types import Array, Ids


@dataclass(frozen=True)
class Gospa:
    """The metric in m, and what it is made of: landmarks `missed` and `false`, RMS `location` error of the others."""

    distance: float
    missed: int
    false: int
    location: float


def map_errors(points: Array, identity: Ids, support: Ids, landmarks: Array) -> tuple[float, float]:
    """RMS distance, m, of points (n, 2) from their true landmarks: after SE(2) alignment of the map, and without.

    Of several points of one identity the one with the most observations (`support`) counts. NaN without any.
    """
    rows = np.flatnonzero((identity >= 0) & (identity < len(landmarks)))
    rows = rows[np.lexsort((-support[rows], identity[rows]))]
    rows = rows[np.unique(identity[rows], return_index=True)[1]]
    rows = rows[np.isfinite(landmarks[identity[rows]]).all(1)]
    if not len(rows):
        return float("nan"), float("nan")
    mine, real = points[rows], landmarks[identity[rows]]
    aligned = to_world(align(mine, real), mine) - real
    return rms(np.hypot(aligned[:, 0], aligned[:, 1])), rms(np.hypot(*(mine - real).T))


def gospa(points: Array, truth: Array, cutoff: float = 0.5) -> Gospa:
    """GOSPA distance of the map `points (n, 2)` from the true landmarks `truth (k, 2)`, m, with alpha = 2 and p = 2.

    References: A. S. Rahmathullah, A. F. Garcia-Fernandez and L. Svensson, FUSION 2017, definition 1 and proposition 1.
    """
    left, right, distance = _near(points, truth, cutoff)
    keep, saved = best_assignment(left, right, cutoff**2 - distance**2)
    matched = int(keep.sum())
    total = 0.5 * cutoff**2 * (len(points) + len(truth)) - saved
    return Gospa(float(np.sqrt(max(total, 0.0))), len(truth) - matched, len(points) - matched, rms(distance[keep]))


def _near(points: Array, truth: Array, cutoff: float) -> tuple[Ids, Ids, Array]:
    """All pairs nearer than `cutoff`: rows of each side and distances."""
    if not len(points) or not len(truth):
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    table = cKDTree(points).sparse_distance_matrix(cKDTree(truth), cutoff, output_type="ndarray")
    table = table[table["v"] < cutoff]
    return table["i"].astype(np.int64), table["j"].astype(np.int64), table["v"]
