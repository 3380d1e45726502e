"""Who comes back: after each scan the place of every sighting is noted, and what was just founded looked up among graves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.special import gammainc

from tomthumb import lifecycle
from tomthumb.branches import Branch
from tomthumb.graves import WIDER, Grave
from tomthumb.lifecycle import LifeCycle
from tomthumb.protocols import Sensor
from tomthumb.types import Array, Ids, Mask, Observations


def look_back(
    branch: Branch,
    at: tuple[Array, Array],
    sensor: Sensor,
    scan: Observations,
    ids: Ids,
    born: Mask,
    policy: LifeCycle,
) -> None:
    """Landmarks `ids` (m,) were seen in a scan (-1: nobody) from the pose `at` (mean, covariance); `born` (m,) just now."""
    rows = np.flatnonzero(ids >= 0)
    if not len(rows) or policy.reference:
        return
    pose, P = at
    points, by_pose, by_z = sensor.locate(pose, scan.z[rows])
    covs = by_pose @ P @ by_pose.transpose(0, 2, 1) + by_z @ scan.R[rows] @ by_z.transpose(0, 2, 1)
    lifecycle.record_places(branch.ledger, ids[rows].tolist(), points, covs)
    new = np.flatnonzero(born[rows])
    found = branch.graves.at(points[new], covs[new], policy.apart2)
    for row, what in zip(rows[new].tolist(), found, strict=True):
        there = [branch.graves.graves[n] for n in what.there]
        i = int(ids[row])
        by_chance = chance(there, what.around, len(branch.graves.graves), branch.ledger[i].seen, policy.patience)
        branch.ledger[i] = lifecycle.risen(branch.ledger[i], there, by_chance, policy)
    branch.graves = branch.graves.without(np.concatenate([np.empty(0, np.int64), *[what.there for what in found]]))


def chance(there: Sequence[Grave], around: int, graves: int, now: int, patience: int) -> float:
    """Expected number of places in a map of `graves` that were visited as often as this one, before scan `now`, by chance alone.

    Visits by chance are Poisson, as dense here as `around`, in the ring that is WIDER^2 - 1 times as large as the gate; one more
    is counted, for none around does not mean none at all. Visits not more than `patience` scans apart are one.
    """
    visits = [*sorted(scan for grave in there for scan in grave.visits), now]
    separate = sum(1 for scan, later in pairwise(visits) if later - scan > patience)
    expected = (around + 1.0) / (WIDER * WIDER - 1.0)
    return graves * float(gammainc(separate, expected)) if separate else math.inf
