"""A scan linearised anew where its only pose basin is: there the full covariance may be summed over, as under a known pose.

The search over poses holds landmarks independent given the pose. What they err in common beyond a rigid motion is little, but
not beside a precise observation; and under a pose that is uncertain before the scan, not after it, nothing else is lost by
linearising once the basin is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tomthumb.associators.tom_thumb.basins import Basin
from tomthumb.associators.tom_thumb.scene import Rigid, lever
from tomthumb.gains import weighed
from tomthumb.kernels import posterior
from tomthumb.kernels import scene as kernel
from tomthumb.types import Array, AssociationProblem, Ids

LITTLE = 0.01  # of the least variance of the noise: errors in common below that change nothing
STRAIGHT = 1.0  # what linearising may leave out, over the noise, for linear sums to be believed
SAME = 30.66  # chi-square, 3 degrees of freedom, 1 - 1e-6: as the gates of pairings


def given_there(s: Rigid, pose: Array, some: Ids, left: Array) -> tuple[Array, Array, Array, Array]:
    """Innovation (m, k, 2), covariance (2k, 2k), R (m, 2, 2) and base gains (m, k) in the sensor's plane, linear at `pose`, of
    the predictions `some` (k,) with the remainder `left` (2k, 2k).

    q = Rot(theta) (p + e) + t, e what the rigid motion xi = (t, theta) leaves of the predictions' errors, E = C - B Xi B';
    so q - q(pose) + B pose has the covariance B Xi B' + Rot E Rot' + R, B = [I | J Rot p] at the pose.
    """
    c, sine = math.cos(pose[2]), math.sin(pose[2])
    turn = np.array([[c, -sine], [sine, c]])
    turned = s.p[some] @ turn.T
    there = lever(turned)
    C = _congruent(np.broadcast_to(turn, there[:, :, :2].shape), left) + _flat(there) @ s.Xi @ _flat(there).T
    expected = turned + pose[:2] - there @ pose
    evidence = None if s.evidence is None else s.evidence[:, some]
    return s.q[:, None] - expected[None], C, s.R, weighed(s.base[:, None] + s.odds[None, some], evidence)


def related(s: Rigid, left: Array) -> bool:
    """Whether two predictions with the remainder `left` (2k, 2k) err together by more than `LITTLE` of the least noise."""
    between = np.abs(left)
    for j in range(0, len(left), 2):
        between[j : j + 2, j : j + 2] = 0.0
    R = s.R
    half, gap = 0.5 * (R[:, 0, 0] + R[:, 1, 1]), 0.5 * (R[:, 0, 0] - R[:, 1, 1])
    least = (half - np.hypot(gap, R[:, 0, 1])).min()
    return bool(between.max(initial=0.0) > LITTLE * least)


def unshared(problem: AssociationProblem, s: Rigid, some: Ids) -> Array:
    """What the rigid motion leaves of the covariance of the predictions `some` (k,): E = C - B Xi B' (2k, 2k)."""
    B = _flat(lever(s.p[some]))
    T = kernel.points_of(problem.predictions.z_hat[some], bool(problem.angles))[1]
    rows = np.column_stack([2 * some, 2 * some + 1]).ravel()
    return _congruent(T, problem.predictions.cov[np.ix_(rows, rows)]) - B @ s.Xi @ B.T


def one_pose(found: Sequence[Basin]) -> bool:
    """Whether all hypotheses say that the robot is in the same place, within the gate of the best: then they are one basin."""
    best = found[0]
    if best.pose is None or best.M is None:
        return False
    gaps = [best.pose - other.pose for other in found if other.pose is not None]
    return all(float(gap @ best.M @ gap) < SAME for gap in gaps)


def straight(s: Rigid, basin: Basin) -> bool:
    """Whether the pose of a basin is known so well that linearising there leaves out less than the noise (`posterior.bend`)."""
    assert basin.M is not None
    turn = float(np.linalg.inv(basin.M)[2, 2])
    return max(posterior.bend(q[0], q[1], R, turn) for q, R in zip(s.q, s.R, strict=True)) < STRAIGHT


def bend_of(problem: AssociationProblem) -> float:
    """What linearising the pose leaves out, over the noise; nan, which passes no test, where the pose is not told."""
    given = problem.predictions
    if given.pose_cov is None:
        return np.nan
    shape = problem.z, problem.R, given.z_hat, given.cov
    return float(posterior.bent(*shape, given.pose_cov[2, 2], bool(problem.angles)))


def _flat(B: Array) -> Array:
    return np.ascontiguousarray(B.reshape(-1, 3))


def _congruent(T: Array, C: Array) -> Array:
    """blockdiag(T) C blockdiag(T)', T (n, 2, 2)."""
    half = (T @ C.reshape(len(T), 2, -1)).reshape(C.shape)  # the rows; the columns are those of the transpose
    out: Array = (T @ half.T.reshape(len(T), 2, -1)).reshape(C.shape).T
    return out
