"""Starting in a saved map: localisation, with a map that goes on growing or is frozen."""

from __future__ import annotations

from dataclasses import dataclass, is_dataclass, replace
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.lifecycle import Life, LifeCycle
from tomthumb.slam import Slam
from tomthumb.types import Array, Control, Estimate, Ids, Observations, Prior

FIRST = 10**12  # ids of landmarks that were known before: beyond the serial number of any observation
FROZEN_STD = 1e-5  # m, so sure is a frozen map of its landmarks that no observation moves them
SIGHTINGS = 10.0  # what a saved stone counts for: it is known, and may still turn out to be gone


@dataclass(frozen=True)
class Jump:
    """A motion that goes nowhere, of a given covariance in the robot's frame: the uncertainty of the starting pose."""

    cov: Array
    rates: bool = False

    def increment(self, control: Control) -> tuple[Array, Array]:
        """See `protocols.Motion`."""
        return np.zeros(3), self.cov


def start_in(slam: Slam, known: Estimate, prior: Prior, frozen: bool = False) -> None:
    """Put the stones of a saved map into a `Slam` that has not begun; the robot is at `prior`, in the map's frame.

    Landmarks keep their order and get ids from `FIRST` on. `frozen`: their positions are taken as exact. Raises
    TomThumbError for covariances that are not positive definite, and where the estimator cannot start uncertain.
    """
    points, covs = known.landmarks[known.stone], known.covs[known.stone]
    if frozen:
        covs = np.tile(FROZEN_STD**2 * np.eye(2), (len(points), 1, 1))
    if not (np.isfinite(points).all() and np.isfinite(covs).all() and (np.linalg.eigvalsh(covs) > 0.0).all()):
        raise TomThumbError("the map to start in has a landmark whose covariance is not positive definite")
    ids = FIRST + np.arange(len(points), dtype=np.int64)
    branch = slam.branches[0]
    branch.belief = _believe(slam, prior, _as_seen(slam, prior.pose, points, covs), ids)
    for i in ids.tolist():
        branch.ledger[i] = Life(0, hits=SIGHTINGS, chances=SIGHTINGS, static=slam.policy.hits)


def frozen_policy(policy: LifeCycle) -> LifeCycle:
    """The life cycle of a frozen map: nothing new is ever confirmed, nothing known is dropped or merged."""
    never = 2**31
    return replace(policy, hits=never, few=never, purge=0.0, merge=False)


def _as_seen(slam: Slam, pose: Array, points: Array, covs: Array) -> Observations:
    """The observations that, made from an exactly known pose, would found the landmarks with their covariances."""
    z, _, by_point = slam.sensor.expect(pose, points)
    return Observations(z, by_point @ covs @ by_point.transpose(0, 2, 1))


def _believe(slam: Slam, prior: Prior, seen: Observations, ids: Ids) -> Any:
    estimator, rng = slam.estimator, slam.rng_estimator
    belief = estimator.init(prior.pose, np.zeros((3, 3)), rng)
    if len(ids):
        belief = estimator.add(belief, seen, [ids.copy() for _ in estimator.expect(belief)], rng)
        belief = estimator.promote(belief, ids)
    if not prior.cov.any():
        return belief
    if not is_dataclass(estimator) or isinstance(estimator, type):
        raise TomThumbError(f"{type(estimator).__name__} must be a dataclass to start in a map at an uncertain pose")
    c, s = np.cos(prior.pose[2]), np.sin(prior.pose[2])
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    still: Any = replace(estimator, motion=Jump(turn @ prior.cov @ turn.T))
    return still.predict(belief, Control(np.zeros(3), 1.0), rng)
