"""One Gaussian over the pose and the landmarks, in buffers with room to grow; of the covariance the lower triangle."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tomthumb.kernels import storage
from tomthumb.types import Array, Estimate, Ids, Mask

GROWTH = 32  # landmarks of room added at least, when the buffers are full


@dataclass(slots=True)
class Transfer:
    """What has happened to the rest of the map since these landmarks were taken out of it (see `estimators.local`).

    The rest's cross-covariance is P_AB = T [G J G]', its covariance P_BB + [G J G] Psi [G J G]', its mean
    x_B + [G J G] theta, with G = P_BA at the beginning and J a turn of every landmark by 90 deg. T (a, w) has room to
    grow in its rows; of Psi the lower triangle is kept; w is the size of A at the beginning, doubled where J is needed
    (invariant filter).
    """

    T: Array
    Psi: Array
    theta: Array


@dataclass(slots=True)
class Gaussian:
    """Mean `x (3 + 2n,)` and covariance, lower triangle, in buffers with room to grow. `ids` and `stone` by slot.

    The first `hidden` slots are not landmarks but pairs of other states (odometry calibration).
    """

    x: Array
    P: Array
    ids: list[int]
    stone: list[bool]
    slot: dict[int, int]
    stats: dict[str, Any] = field(default_factory=dict)
    hidden: int = 0
    transfer: Transfer | None = None

    @property
    def dim(self) -> int:
        """Length of the state in use."""
        return 3 + 2 * len(self.ids)

    @property
    def pose(self) -> Array:
        """A view of the pose (3,)."""
        return self.x[:3]

    def landmarks(self) -> Array:
        """A view of all slots (n, 2), the hidden ones too."""
        return self.x[3 : self.dim].reshape(-1, 2)


def empty(pose: Array, cov: Array) -> Gaussian:
    """The belief before the first scan."""
    size = 3 + 2 * GROWTH
    x, P = np.zeros(size), np.zeros((size, size), order="F")
    x[:3], P[:3, :3] = pose, cov
    return Gaussian(x, P, [], [], {})


def copy(b: Gaussian) -> Gaussian:
    """A copy that shares nothing that changes. What lies above the diagonal is not touched, so takes no memory."""
    P = np.zeros(b.P.shape, order="F")
    storage.copy_lower(b.P, P, b.dim)
    t = b.transfer
    transfer = None if t is None else Transfer(t.T.copy(order="F"), t.Psi.copy(order="F"), t.theta.copy())
    return Gaussian(b.x.copy(), P, b.ids.copy(), b.stone.copy(), b.slot.copy(), dict(b.stats), b.hidden, transfer)


def make_room(b: Gaussian, count: int) -> None:
    """Buffers that hold `count` more landmarks. They grow by a half: memory never touched is never taken."""
    need = b.dim + 2 * count
    if b.transfer is not None and need > len(b.transfer.T):
        T = np.zeros((need + 2 * GROWTH, b.transfer.T.shape[1]), order="F")
        T[: b.dim] = b.transfer.T[: b.dim]
        b.transfer.T = T
    if need <= len(b.x):
        return
    size = max(need, len(b.x) + 2 * max(GROWTH, len(b.x) // 4))
    x, P = np.zeros(size), np.zeros((size, size), order="F")
    x[: b.dim] = b.x[: b.dim]
    storage.copy_lower(b.P, P, b.dim)
    b.x, b.P = x, P


def attach(b: Gaussian, ids: list[int], stone: bool) -> None:
    """Names for the slots that have just been filled behind the last one."""
    for i in ids:
        b.slot[i] = len(b.ids)
        b.ids.append(i)
        b.stone.append(stone)


def detach(b: Gaussian, i: int) -> None:
    """Landmark `i` out of the state; the last one takes its slot. Linear in the size of the map."""
    slot, dim = b.slot.pop(i), b.dim
    storage.remove(b.P, b.x, dim, slot)
    if b.transfer is not None:
        b.transfer.T[3 + 2 * slot : 5 + 2 * slot] = b.transfer.T[dim - 2 : dim]
    last_id, last_stone = b.ids.pop(), b.stone.pop()
    if slot < len(b.ids):
        b.ids[slot], b.stone[slot], b.slot[last_id] = last_id, last_stone, slot


def estimate(b: Gaussian) -> Estimate:
    """See `protocols.Estimator`."""
    slots = np.arange(b.hidden, len(b.ids))
    k = 3 + 2 * slots
    P = b.P
    covs = np.stack([np.stack([P[k, k], P[k + 1, k]], -1), np.stack([P[k + 1, k], P[k + 1, k + 1]], -1)], -2)
    stone: Mask = np.array(b.stone, bool)[slots]
    ids: Ids = np.array(b.ids, np.int64)[slots]
    return Estimate(b.pose.copy(), storage.pose_block(P), ids, b.landmarks()[slots].copy(), covs, stone)
