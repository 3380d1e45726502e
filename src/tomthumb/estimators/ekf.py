"""EKF-SLAM: one Gaussian over the pose and the landmarks.

Covariance. Only the lower triangle is kept, so it cannot become asymmetric. An update subtracts W W' (W = P H' L^-T,
L L' = S) in one BLAS call (dsyrk), with S computed from the same P; S that is not positive definite, a negative variance
or a value that is not finite is named: `Diverged`.

Update. Iterated (Gauss-Newton) until the linearisation error is below `tolerance` of the sensor's noise; one iteration
is enough most of the time and then costs one more evaluation of the sensor. Pairings with crumbs are Schmidt updates:
the crumb learns from the pose, never the other way round.

References: R. Smith, M. Self, P. Cheeseman, 1990; B. Bell, F. Cathey, IEEE T-AC 38(2), 1993 (iterated update is
Gauss-Newton); S. Schmidt, 1966 (considered states).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg.blas import dsyrk

from tomthumb import geometry
from tomthumb.errors import Diverged
from tomthumb.kernels import ekf as kernel
from tomthumb.kernels.gates import expect_cartesian
from tomthumb.protocols import Motion, Rng, Sensor
from tomthumb.types import Array, Control, Estimate, Ids, Mask, Observations, Predictions

GROWTH = 32  # landmarks of room added at least, when the buffers are full
UNSEEN = 1e-4  # a landmark less likely to be in view than this is not offered to the associator


@dataclass(slots=True)
class Gaussian:
    """Mean `x (3 + 2n,)` and covariance, lower triangle, in buffers with room to grow. `ids` and `stone` by slot."""

    x: Array
    P: Array
    ids: list[int]
    stone: list[bool]
    slot: dict[int, int]
    stats: dict[str, Any] = field(default_factory=dict)

    @property
    def dim(self) -> int:
        """Length of the state in use."""
        return 3 + 2 * len(self.ids)

    @property
    def pose(self) -> Array:
        """A view of the pose (3,)."""
        return self.x[:3]

    def landmarks(self) -> Array:
        """A view of the landmarks (n, 2)."""
        return self.x[3 : self.dim].reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class EKF:
    """The filter's settings. `iterations` at most; `fixed` runs exactly that many (the reference program's way)."""

    motion: Motion
    sensor: Sensor
    iterations: int = 10
    fixed: bool = False
    tolerance: float = 0.02

    def init(self, pose: Array, cov: Array, rng: Rng) -> Gaussian:
        """See `protocols.Estimator`."""
        size = 3 + 2 * GROWTH
        x, P = np.zeros(size), np.zeros((size, size), order="F")
        x[:3], P[:3, :3] = pose, cov
        return Gaussian(x, P, [], [], {})

    def fork(self, belief: Gaussian) -> Gaussian:
        """See `protocols.Estimator`."""
        b = belief
        return Gaussian(b.x.copy(), b.P.copy(order="F"), b.ids.copy(), b.stone.copy(), b.slot.copy(), dict(b.stats))

    def predict(self, belief: Gaussian, control: Control, rng: Rng) -> Gaussian:
        """See `protocols.Estimator`."""
        delta, cov = self.motion.increment(control)
        F, G = geometry.compose_jacobians(belief.pose, delta)
        belief.x[:3] = geometry.compose(belief.pose, delta)
        kernel.move_pose(belief.P, belief.dim, F, G @ cov @ G.T)
        return belief

    def expect(self, belief: Gaussian) -> Sequence[Predictions]:
        """See `protocols.Estimator`."""
        near = self._near(belief)
        points = belief.landmarks()[near]
        z_hat, H_pose, H_point = self.sensor.expect(belief.pose, points)
        own = kernel.own_blocks(belief.P, near, H_pose, H_point)
        chance = self.sensor.in_view(z_hat, np.maximum(own[:, [0, 1], [0, 1]], 0.0))
        keep = np.flatnonzero(chance > UNSEEN)
        slots = near[keep]
        C, cross = kernel.project(belief.P, slots, H_pose[keep], H_point[keep])
        ids = np.array(belief.ids, np.int64)[slots]
        pose_cov = _symmetric(belief.P[:3, :3])
        seen_from = self.sensor.frame(belief.pose)
        frame = expect_cartesian(seen_from, np.zeros(3), points[keep])[0]
        stone = np.array(belief.stone, bool)[slots]
        visible = chance[keep] * self.sensor.detect
        return [Predictions(ids, z_hat[keep], C, pose_cov, cross, frame, None, visible, stone)]

    def _near(self, belief: Gaussian) -> Ids:
        """Slots of landmarks that could be in view at all, by distance and the position's uncertainty (5 sigma)."""
        n, P = len(belief.ids), belief.P
        if n == 0 or not np.isfinite(self.sensor.max_range):
            return np.arange(n)
        spread = 5.0 * np.sqrt(max(P[0, 0] + P[1, 1], 0.0)) + 5.0 * np.sqrt(max(np.diag(P)[3 : belief.dim].max(), 0.0))
        offset = self.sensor.frame(belief.pose)[:2]
        reach = self.sensor.max_range + spread
        away = belief.landmarks() - offset
        return np.flatnonzero((away * away).sum(1) < reach * reach)

    def update(self, belief: Gaussian, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Gaussian:
        """See `protocols.Estimator`. Raises `Diverged`."""
        slots = np.array([belief.slot.get(int(i), -1) for i in ids[0]], np.int64)
        firm = np.array([s >= 0 and belief.stone[s] for s in slots], bool)
        belief.stats = {"nis": 0.0, "dof": 0, "iterations": 0}
        if firm.any():
            self._update_stones(belief, observations.take(firm), slots[firm])
        loose = np.flatnonzero((slots >= 0) & ~firm)
        for i in loose:
            self._update_crumb(belief, observations.z[i : i + 1], observations.R[i : i + 1], slots[i : i + 1])
        return self._checked(belief)

    def _update_stones(self, belief: Gaussian, seen: Observations, slots: Ids) -> None:
        H_pose, H_point, residual = self._linearise(belief, seen, slots)
        W = kernel.columns(belief.P, belief.dim, slots, H_pose, H_point)
        S = kernel.innovation_covariance(W, slots, H_pose, H_point, seen.R)
        good, L = kernel.cholesky(S)
        if not good:
            raise Diverged("the innovation covariance is not positive definite")
        kernel.whiten(W, belief.dim, L)
        belief.x += W @ kernel.forward(L, residual)
        belief.x[2] = geometry.wrap_angle(belief.x[2])
        belief.P = dsyrk(-1.0, W, beta=1.0, c=belief.P, lower=1, overwrite_c=1)

    def _linearise(self, belief: Gaussian, seen: Observations, slots: Ids) -> tuple[Array, Array, Array]:
        """Jacobians at the converged state, and the residual that leads there from the prior (Gauss-Newton)."""
        prior_pose, prior_points = belief.pose.copy(), belief.landmarks()[slots]
        pose, points = prior_pose, prior_points
        sigma = np.sqrt(seen.R[:, [0, 1], [0, 1]])
        z_hat, H_pose, H_point = self.sensor.expect(pose, points)
        for count in range(1, self.iterations + 1):
            nu = self._innovation(seen.z, z_hat)
            residual = kernel.linear_residual(nu, H_pose, H_point, prior_pose - pose, prior_points - points)
            local = kernel.local_cross(belief.P, belief.dim, slots, H_pose, H_point)
            good, change, nis = kernel.gain_step(local, slots, H_pose, H_point, seen.R, residual)
            if not good:
                raise Diverged("the innovation covariance is not positive definite")
            if count == 1:
                belief.stats = {"nis": nis, "dof": 2 * len(slots), "iterations": count}
            if count == self.iterations:
                break
            pose, old_pose = prior_pose + change[:3], pose
            points, old_points = prior_points + change[3:].reshape(-1, 2), points
            linear = nu - _applied(H_pose, H_point, pose - old_pose, points - old_points)
            z_new, H_pose_new, H_point_new = self.sensor.expect(pose, points)
            error = self._innovation(seen.z, z_new) - linear
            belief.stats["iterations"] = count
            if not self.fixed and np.max(np.abs(error) / sigma) < self.tolerance:
                break
            z_hat, H_pose, H_point = z_new, H_pose_new, H_point_new
        return H_pose, H_point, residual

    def _innovation(self, z: Array, z_hat: Array) -> Array:
        nu = z - z_hat
        for k in self.sensor.angles:
            nu[:, k] = geometry.wrap(nu[:, k])
        return nu

    def _update_crumb(self, belief: Gaussian, z: Array, R: Array, slot: Ids) -> None:
        z_hat, H_pose, H_point = self.sensor.expect(belief.pose, belief.landmarks()[slot])
        PHt = kernel.columns(belief.P, belief.dim, slot, H_pose, H_point)
        S = kernel.innovation_covariance(PHt, slot, H_pose, H_point, R)
        nu = self._innovation(z, z_hat)[0]
        if not kernel.consider(belief.P, belief.x, belief.dim, int(slot[0]), PHt, S, nu):
            raise Diverged("the innovation covariance of a tentative landmark is not positive definite")

    def _checked(self, belief: Gaussian) -> Gaussian:
        if not kernel.healthy(belief.P, belief.x, belief.dim):
            raise Diverged("a variance is negative or a state is not finite")
        return belief

    def add(self, belief: Gaussian, observations: Observations, ids: Sequence[Ids], rng: Rng) -> Gaussian:
        """See `protocols.Estimator`."""
        rows = np.flatnonzero(ids[0] >= 0)
        if not len(rows):
            return belief
        _make_room(belief, len(rows))
        points, G_pose, G_z = self.sensor.locate(belief.pose, observations.z[rows])
        noise = G_z @ observations.R[rows] @ G_z.transpose(0, 2, 1)
        dim = belief.dim
        belief.x[dim : dim + 2 * len(rows)] = points.ravel()
        kernel.append(belief.P, dim, G_pose, noise)
        for row in rows:
            belief.slot[int(ids[0][row])] = len(belief.ids)
            belief.ids.append(int(ids[0][row]))
            belief.stone.append(False)
        return belief

    def promote(self, belief: Gaussian, ids: Ids) -> Gaussian:
        """See `protocols.Estimator`."""
        for i in ids:
            belief.stone[belief.slot[int(i)]] = True
        return belief

    def forget(self, belief: Gaussian, ids: Ids) -> Gaussian:
        """See `protocols.Estimator`."""
        for i in ids:
            slot = belief.slot.pop(int(i))
            kernel.remove(belief.P, belief.x, belief.dim, slot)
            last_id, last_stone = belief.ids.pop(), belief.stone.pop()
            if slot < len(belief.ids):
                belief.ids[slot], belief.stone[slot], belief.slot[last_id] = last_id, last_stone, slot
        return belief

    def merge(self, belief: Gaussian, keep: int, drop: int) -> Gaussian:
        """See `protocols.Estimator`. Between two stones the constraint moves the pose; a crumb is just dropped."""
        a, b = belief.slot[keep], belief.slot[drop]
        if belief.stone[a] and belief.stone[b]:
            self._constrain(belief, a, b)
        elif belief.stone[b]:
            raise ValueError(f"crumb {keep} cannot absorb stone {drop}: merge the other way round")
        return self._checked(self.forget(belief, np.array([drop], np.int64)))

    def _constrain(self, belief: Gaussian, a: int, b: int) -> None:
        """The linear observation l_a - l_b = 0, exact but for 1e-6 m of standard deviation."""
        one, none = np.eye(2)[None], np.zeros((1, 2, 3))
        W = kernel.columns(belief.P, belief.dim, np.array([a]), none, one)
        W -= kernel.columns(belief.P, belief.dim, np.array([b]), none, one)
        rows_a, rows_b = slice(3 + 2 * a, 5 + 2 * a), slice(3 + 2 * b, 5 + 2 * b)
        S = _even(W[rows_a] - W[rows_b]) + 1e-12 * np.eye(2)
        good, L = kernel.cholesky(S)
        if not good:
            raise Diverged("two landmarks that should be one are not comparable")
        kernel.whiten(W, belief.dim, L)
        belief.x += W @ kernel.forward(L, belief.x[rows_b] - belief.x[rows_a])
        belief.P = dsyrk(-1.0, W, beta=1.0, c=belief.P, lower=1, overwrite_c=1)

    def pose(self, belief: Gaussian) -> tuple[Array, Array]:
        """See `protocols.Estimator`."""
        return belief.pose.copy(), _symmetric(belief.P[:3, :3])

    def estimate(self, belief: Gaussian) -> Estimate:
        """See `protocols.Estimator`."""
        k = 3 + 2 * np.arange(len(belief.ids))
        P = belief.P
        covs = np.stack([np.stack([P[k, k], P[k + 1, k]], -1), np.stack([P[k + 1, k], P[k + 1, k + 1]], -1)], -2)
        stone: Mask = np.array(belief.stone, bool)
        ids = np.array(belief.ids, np.int64)
        return Estimate(belief.pose.copy(), _symmetric(P[:3, :3]), ids, belief.landmarks().copy(), covs, stone)

    def stats(self, belief: Gaussian) -> dict[str, Any]:
        """See `protocols.Estimator`."""
        return belief.stats


def _applied(H_pose: Array, H_point: Array, pose: Array, points: Array) -> Array:
    moved: Array = H_pose @ pose + np.einsum("kij,kj->ki", H_point, points)
    return moved


def _symmetric(lower: Array) -> Array:
    """A full matrix from one whose lower triangle is right."""
    low: Array = np.tril(lower)
    return low + np.tril(lower, -1).T


def _even(S: Array) -> Array:
    mean: Array = 0.5 * (S + S.T)
    return mean


def _make_room(belief: Gaussian, count: int) -> None:
    """Buffers that hold `count` more landmarks; they grow by a twentieth at least, so copies stay rare."""
    need = belief.dim + 2 * count
    if need <= len(belief.x):
        return
    size = max(need, len(belief.x) + 2 * max(GROWTH, len(belief.x) // 40))
    x, P = np.zeros(size), np.zeros((size, size), order="F")
    x[: belief.dim], P[: belief.dim, : belief.dim] = belief.x[: belief.dim], belief.P[: belief.dim, : belief.dim]
    belief.x, belief.P = x, P
