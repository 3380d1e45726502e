"""Starting in a saved map: localisation, with a map that goes on growing or is frozen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tomthumb.doubt import Trials
from tomthumb.errors import TomThumbError
from tomthumb.lifecycle import Life, LifeCycle
from tomthumb.slam import Slam
from tomthumb.types import Estimate

FIRST = 10**12  # ids of landmarks that were known before: beyond the serial number of any observation
LONG_AGO = -(2**31)  # the scan in which such a landmark was founded: before anybody's time
FROZEN_STD = 1e-5  # m, so sure is a frozen map of its landmarks that no observation moves them
SIGHTINGS = 10.0  # what a saved stone counts for: it is known, and may still turn out to be gone


def start_in(slam: Slam, known: Estimate, frozen: bool = False) -> dict[int, int]:
    """Put the stones of a saved map into a `Slam` that has not begun; its prior pose is one in the map's frame.

    Landmarks keep their order and get ids from `FIRST` on; returned is the new id of each old one. `frozen`: their
    positions are taken as exact. Raises TomThumbError for covariances that are not positive definite.
    """
    points, covs = known.landmarks[known.stone], known.covs[known.stone]
    if frozen:
        covs = np.tile(FROZEN_STD**2 * np.eye(2), (len(points), 1, 1))
    if not (np.isfinite(points).all() and np.isfinite(covs).all() and (np.linalg.eigvalsh(covs) > 0.0).all()):
        raise TomThumbError("the map to start in has a landmark whose covariance is not positive definite")
    ids = FIRST + np.arange(len(points), dtype=np.int64)
    branch = slam.branches[0]
    branch.belief = slam.estimator.place(branch.belief, ids, points, covs)
    for i in ids.tolist():
        branch.ledger[i] = Life(0, hits=SIGHTINGS, chances=SIGHTINGS, static=slam.policy.hits, born=LONG_AGO)
    branch.trials = Trials(stood=len(points))
    return dict(zip(known.ids[known.stone].tolist(), ids.tolist(), strict=True))


def frozen_policy(policy: LifeCycle) -> LifeCycle:
    """The life cycle of a frozen map: nothing new is ever confirmed, nothing known is dropped or merged."""
    never = 2**31
    return replace(policy, hits=never, few=never, purge=0.0, merge=False)
