"""Two landmarks that stand for one thing: so near that a sighting could be of either, and never both in one scan.

A double takes a share of its twin's sightings, so it is seen too often to be given up as gone, and may lie too far off, by
the filter's own reckoning, to be merged. What gives it away is that two things would now and then be seen together.
"""

from __future__ import annotations

import math

import numpy as np

from tomthumb.lifecycle import Ledger, LifeCycle
from tomthumb.sensing import DetectionMap
from tomthumb.types import Array, Mask, Observations, Predictions

CROWDED = 0.25  # of the usual distance to the next stone: nearer ones may be one
PAIRS = 0.03  # share of landmarks beside which another stands on purpose, however near: double trunks, gate posts
NEVER = 7.0  # nats: seven sightings of both were to be expected and none was (Poisson), fewer where few stand so near


def record_apart(
    ledger: Ledger,
    predictions: Predictions,
    hit: set[int],
    detection: DetectionMap,
    scan: Observations,
    policy: LifeCycle,
) -> list[tuple[int, int]]:
    """Notes for stones of which one was seen and one in view not; returned are pairs (keep, drop) that are one thing.

    `hit`: landmarks that were seen in `scan`. Kept is the one of more sightings.
    """
    if predictions.stone is None or predictions.visible is None or predictions.points is None:
        return []
    chance = detection.chance(predictions.points)
    seen = np.array([i in hit for i in predictions.ids.tolist()], bool)
    alive = predictions.stone & np.array([i in ledger for i in predictions.ids.tolist()], bool)
    due = alive & ~seen & (predictions.visible > policy.in_view * np.minimum(chance, 0.999))
    found = []
    for a, b, crowd in _beside(predictions, alive & seen, due, scan.R.mean(0), policy.apart2):
        i, j = int(predictions.ids[a]), int(predictions.ids[b])
        if j in ledger[i].companions:
            continue
        due_together = ledger[i].apart.get(j, 0.0) + float(chance[b]) * ledger[j].exist
        ledger[i].apart = {**ledger[i].apart, j: due_together}
        ledger[j].apart = {**ledger[j].apart, i: due_together}
        if due_together - math.log(crowd) >= NEVER:
            found.append((i, j) if ledger[i].hits >= ledger[j].hits else (j, i))
    return found


def _beside(predictions: Predictions, hit: Mask, missed: Mask, R: Array, gate2: float) -> list[tuple[int, int, float]]:
    """Pairs of columns (seen, not seen) so near that a sighting could be of either, or far nearer than others stand.

    With each the number of others that would stand so near by chance: half of all have one at the usual distance (Poisson).
    """
    from scipy.spatial import cKDTree

    a, b = np.flatnonzero(hit), np.flatnonzero(missed)
    if not len(a) or not len(b):
        return []
    assert predictions.points is not None
    points = predictions.points[predictions.stone]
    usual = float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))
    gap = np.linalg.norm(predictions.points[a][:, None] - predictions.points[b][None], axis=2)
    found = []
    for k, n in np.argwhere(gap < usual):
        if gap[k, n] < CROWDED * usual or _d2(predictions, int(a[k]), int(b[n]), R) < gate2:
            crowd = min(1.0, max(PAIRS, math.log(2.0) * float(gap[k, n] / usual) ** 2))
            found.append((int(a[k]), int(b[n]), crowd))
    return found


def _d2(predictions: Predictions, a: int, b: int, R: Array) -> float:
    i, j = slice(2 * a, 2 * a + 2), slice(2 * b, 2 * b + 2)
    C, nu = predictions.cov, predictions.z_hat[a] - predictions.z_hat[b]
    S = C[i, i] + C[j, j] - C[i, j] - C[j, i] + R
    return float(nu @ np.linalg.solve(S, nu))
