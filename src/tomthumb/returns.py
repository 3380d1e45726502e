"""Who comes back: after each scan the place of every sighting is noted, and what was just founded looked up among graves."""

from __future__ import annotations

import numpy as np

from tomthumb import lifecycle
from tomthumb.branches import Branch
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
    graves = branch.graves.at(points[new], covs[new], policy.apart2)
    for row, grave in zip(rows[new].tolist(), graves.tolist(), strict=True):
        if grave >= 0:
            i = int(ids[row])
            branch.ledger[i] = lifecycle.risen(branch.ledger[i], branch.graves.graves[grave], policy)
    branch.graves = branch.graves.without(graves[graves >= 0])
