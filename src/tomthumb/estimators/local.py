"""Work on one region of a large map, exactly: while the robot is among A's landmarks the rest, B, is left alone.

All that a step among A does to B is linear in what B was when A was taken out: with G = P_BA of that moment and J a
turn of every landmark by 90 deg (the invariant filter's change of coordinates needs it), P_BA = [G JG] T', P_BB gains
[G JG] Psi [G JG]' and x_B gains [G JG] theta. T, Psi and theta have the size of A. They are applied when the robot
leaves, so that a step costs the same on any map. Nothing is approximated.

References: J. Guivant, E. Nebot, IEEE T-RA 17(3), 2001, sec. III (compressed filter); J. Knight, A. Davison, I. Reid,
"Towards constant time SLAM using postponement", IROS 2001. The invariant form is ours.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgeqrf, dormqr

from tomthumb.estimators import gaussian
from tomthumb.estimators.gaussian import Gaussian, Transfer
from tomthumb.kernels import ekf as kernel
from tomthumb.kernels import storage
from tomthumb.kernels.blas import subtract_lower
from tomthumb.protocols import Sensor
from tomthumb.types import Array, Ids

EPS = float(np.finfo(float).eps)
WORTH = 8  # times wider than a region must a map be for its rank to be looked for


@dataclass(slots=True)
class Atlas:
    """The belief: the `whole` map and, while one region of it is worked on, that region as a `work` of its own.

    `taken`: slots of the whole that are in the work; `gone`: landmarks of the whole forgotten meanwhile. The work holds
    every landmark that the sensor could see from within `free` m of `centre`.
    """

    whole: Gaussian
    work: Gaussian | None = None
    taken: Ids = field(default_factory=lambda: np.empty(0, np.int64))
    gone: list[int] = field(default_factory=list)
    centre: Array = field(default_factory=lambda: np.zeros(2))
    free: float = 0.0

    @property
    def active(self) -> Gaussian:
        """What the filter works on now."""
        return self.whole if self.work is None else self.work

    @property
    def parts(self) -> list[Gaussian]:
        """The whole, and the work if there is one."""
        return [self.whole] if self.work is None else [self.whole, self.work]


def copy(a: Atlas) -> Atlas:
    """A copy that shares nothing that changes."""
    work = None if a.work is None else gaussian.copy(a.work)
    return Atlas(gaussian.copy(a.whole), work, a.taken.copy(), a.gone.copy(), a.centre.copy(), a.free)


def settle(a: Atlas, sensor: Sensor, margin: float, crowd: float, turned: bool) -> None:
    """Stay in the region while it surely holds all that can be seen; else leave it and take the one around here.

    It reaches `margin` times the sensor's range beyond what is seen here, farther where that is less than `crowd` times
    the square root of the map's number of landmarks. One of more than half of the map is not worth it: then the whole
    is worked on.
    """
    place = sensor.frame(a.active.pose)
    if a.free > 0.0 and float(np.hypot(*(place[:2] - a.centre))) <= a.free:
        return
    leave(a)
    if not np.isfinite(sensor.max_range):
        return
    whole = a.whole
    a.centre, a.free = place[:2].copy(), max(margin * sensor.max_range, _radius(whole, place, crowd) - sensor.max_range)
    slots = kernel.near(whole.P, whole.x, whole.dim, whole.hidden, place, sensor.max_range + a.free)
    if 2 * len(slots) <= len(whole.ids):
        enter(a, slots, turned)


def _radius(whole: Gaussian, place: Array, crowd: float) -> float:
    """Distance within which `crowd` times the square root of the number of landmarks stand.

    A step costs as the square of the region's size n, leaving it about as the square of the map's size N, and the less
    often the larger it is: where n^2 + N^2 / n is least, or nearly, n grows as the square root of N (measured: 2).
    """
    points = whole.landmarks()[whole.hidden :]
    count = min(int(crowd * np.sqrt(len(points))), len(points) // 2)
    away = np.hypot(*(points - place[:2]).T)
    return float(np.partition(away, count)[count])


def bring(a: Atlas, ids: Iterable[int]) -> None:
    """Back to the whole map if a landmark is needed that the region does not hold."""
    if a.work is not None and any(i not in a.work.slot and i in a.whole.slot for i in ids):
        leave(a)


def enter(a: Atlas, slots: Ids, turned: bool) -> None:
    """Take the landmarks in `slots` (hidden states come along) out of the whole to work on them alone."""
    whole = a.whole
    a.taken = np.concatenate([np.arange(whole.hidden), slots])
    rows = _rows(a.taken)
    m = len(rows)
    room = m + 2 * gaussian.GROWTH
    x, P, T = np.zeros(room), np.zeros((room, room), order="F"), np.zeros((room, 2 * m if turned else m), order="F")
    x[:m] = whole.x[rows]
    storage.gather_block(whole.P, rows, P)
    T[:m, :m] = np.eye(m)
    width = T.shape[1]
    transfer = Transfer(T, np.zeros((width, width), order="F"), np.zeros(width))
    ids = [whole.ids[s] for s in a.taken.tolist()]
    stone = [whole.stone[s] for s in a.taken.tolist()]
    slot = {i: s for s, i in enumerate(ids) if s >= whole.hidden}
    a.work = Gaussian(x, P, ids, stone, slot, whole.stats, whole.hidden, transfer)


def leave(a: Atlas) -> None:
    """Bring the whole map up to date and work on it. Does nothing where the whole is worked on already."""
    if a.work is None:
        return
    whole, work = a.whole, a.work
    t = work.transfer
    assert t is not None
    dim = whole.dim
    U = _influence(whole, _rows(a.taken), len(t.theta))
    inside = np.zeros(dim, bool)
    inside[_rows(a.taken)] = True
    subtract_lower(whole.P, dim, *_factors(U, np.tril(t.Psi) + np.tril(t.Psi, -1).T, np.diagonal(whole.P)[:dim].max()))
    whole.x[:dim] += U @ t.theta
    cross = np.asfortranarray(U @ t.T[: work.dim].T)
    fresh = [i for i in work.ids[work.hidden :] if i not in whole.slot]
    gaussian.make_room(whole, len(fresh))
    gaussian.attach(whole, fresh, False)
    home = np.concatenate([np.arange(work.hidden), [whole.slot[i] for i in work.ids[work.hidden :]]]).astype(np.int64)
    rows = _rows(home)
    whole.x[rows] = work.x[: work.dim]
    storage.scatter(whole.P, rows, work.P, np.flatnonzero(~inside), cross)
    _tidy(a, home)


def _influence(whole: Gaussian, rows: Ids, width: int) -> Array:
    """[G] or [G, JG] (dim, width) with zero rows for what is worked on."""
    G = storage.gather_columns(whole.P, whole.dim, rows)
    G[rows] = 0.0
    turned: Array = G if width == len(rows) else storage.add_turned(G, 3 + 2 * whole.hidden)
    return turned


def _factors(U: Array, Psi: Array, largest: float) -> tuple[Array, Array]:
    """A, B (dim, k) with -U Psi U' = A B' of its numerical rank k: what is left out is below the rounding of P.

    U = Q R, R Psi R' = V diag(mu) V': eigenvalues mu below eps times the largest variance change no element of P by
    more than that. Far landmarks learn from a region little but where it is as a whole, so k is far below its size. On
    a small map finding that out costs more than it saves.
    """
    if len(U) < WORTH * U.shape[1]:
        return np.asfortranarray(U @ -Psi), U
    packed, tau, R = _reflectors(U)
    mu, V = np.linalg.eigh(R @ Psi @ R.T)
    kept = np.abs(mu) > EPS * largest
    A = np.zeros((len(U), int(kept.sum())), order="F")
    A[: len(V)] = V[:, kept]
    A = dormqr("L", "N", packed, tau, A, 64 * max(A.shape[1], 1), overwrite_c=True)[0]
    return A, np.asfortranarray(A * -mu[kept])


def _reflectors(U: Array) -> tuple[Array, Array, Array]:
    """U = Q R with Q as LAPACK's reflectors: Q itself is never formed, for that costs as much as R and few columns of
    Q V are wanted."""
    packed, tau, _, _ = dgeqrf(U, 64 * U.shape[1])
    return packed, tau, np.triu(packed[: U.shape[1]])


def _tidy(a: Atlas, home: Ids) -> None:
    """The work has come home; what was forgotten meanwhile goes."""
    assert a.work is not None
    for s, stone in zip(home.tolist(), a.work.stone, strict=True):
        a.whole.stone[s] = stone
    a.whole.stats = a.work.stats
    a.work, a.free = None, 0.0
    for i in a.gone:
        gaussian.detach(a.whole, i)
    a.gone = []


def forget(a: Atlas, i: int) -> None:
    """Landmark `i` out of the map; out of the whole only when that is brought up to date."""
    if a.work is None:
        gaussian.detach(a.whole, i)
        return
    if i in a.work.slot:
        gaussian.detach(a.work, i)
    if i in a.whole.slot:
        a.gone.append(i)


def _rows(slots: Any) -> Ids:
    """Rows of the state: the pose's, then two for each slot."""
    slots = np.asarray(slots, np.int64)
    return np.concatenate([np.arange(3), np.column_stack([3 + 2 * slots, 4 + 2 * slots]).ravel()])
