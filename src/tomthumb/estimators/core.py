"""The arithmetic of EKF-SLAM over one `Gaussian`, which is changed in place (see `estimators.ekf` for what and why)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from tomthumb import geometry
from tomthumb.errors import Diverged
from tomthumb.estimators.gaussian import Gaussian, Transfer, attach, empty, make_room
from tomthumb.kernels import ekf as kernel
from tomthumb.kernels import invariant, storage
from tomthumb.kernels.blas import subtract, subtract_lower
from tomthumb.kernels.gates import expect_cartesian
from tomthumb.models.calibration import sensitivity
from tomthumb.protocols import Motion, Sensor
from tomthumb.types import Array, Control, Ids, Observations, Predictions

UNSEEN = 1e-4  # a landmark less likely to be in view than this is not offered to the associator
CALIBRATION = -2  # the "id" of a pair of calibration states
NOWHERE = np.zeros(3)
NO_ROWS = np.empty((0, 0))
NO_COLUMNS = np.empty((3, 0))


@dataclass(frozen=True)
class Core:
    """The settings of `EKF` that concern one Gaussian."""

    motion: Motion
    sensor: Sensor
    invariant: bool
    iterations: int
    fixed: bool
    tolerance: float
    outliers: float
    calibrate: tuple[str, ...]
    calibrate_std: tuple[float, ...]

    def begin(self, pose: Array, cov: Array) -> Gaussian:
        """A belief without landmarks; calibration states in its first slots, an odd one beside a constant."""
        b = empty(np.asarray(pose, float), np.asarray(cov, float))
        for _ in range(0, len(self.calibrate), 2):
            b.ids.append(CALIBRATION)
            b.stone.append(True)
        b.hidden = len(b.ids)
        for k, std in enumerate(self.calibrate_std):
            b.P[3 + k, 3 + k] = std * std
        return b

    def predict(self, b: Gaussian, control: Control) -> None:
        """The pose moves; what depends on it follows. Linear in the number of landmarks."""
        if self.calibrate:
            delta, cov, J = sensitivity(self.motion, control, self.calibrate, b.x[3 : 3 + len(self.calibrate)])
        else:
            (delta, cov), J = self.motion.increment(control), NO_COLUMNS
        dx, dy, turn = delta.tolist()
        F, by_other = kernel.move(b.P, b.x, b.dim, dx, dy, turn, np.array(cov, float, order="C"), J)
        if b.transfer is not None:
            T = b.transfer.T
            T[:3] = F @ T[:3] + by_other @ T[3 : 3 + by_other.shape[1]]

    def calibration(self, b: Gaussian) -> dict[str, tuple[float, float]]:
        """Values and standard deviations of the calibration states."""
        return {name: (float(b.x[3 + k]), float(np.sqrt(b.P[3 + k, 3 + k]))) for k, name in enumerate(self.calibrate)}

    # --- expectation --------------------------------------------------------------------------------------------------

    def expect(self, b: Gaussian) -> Predictions:
        """What the sensor should see, with all covariances, of the landmarks likely enough to be in view."""
        seen_from = self.sensor.frame(b.pose)
        near = kernel.near(b.P, b.x, b.dim, b.hidden, seen_from, self.sensor.max_range)
        points = b.landmarks()[near]
        z_hat, H_pose, H_point = self.sensor.expect(b.pose, points)
        chance = self.sensor.in_view(z_hat, kernel.own_variances(b.P, near, H_pose, H_point))
        keep = np.flatnonzero(chance > UNSEEN)
        slots = near[keep]
        C, cross = kernel.project(b.P, slots, H_pose[keep], H_point[keep])
        names = slots.tolist()
        ids = np.array([b.ids[s] for s in names], np.int64)
        stone = np.array([b.stone[s] for s in names], bool)
        frame = expect_cartesian(seen_from, NOWHERE, points[keep])[0]
        visible = chance[keep] * self.sensor.detect
        return Predictions(ids, z_hat[keep], C, storage.pose_block(b.P), cross, frame, None, visible, stone)

    # --- update -------------------------------------------------------------------------------------------------------

    def update(self, b: Gaussian, seen: Observations, ids: Ids) -> None:
        """Pairings with stones jointly, those with crumbs one by one. Raises `Diverged`."""
        slots = np.array([b.slot.get(i, -1) for i in ids.tolist()], np.int64)
        firm = np.array([s >= 0 and b.stone[s] for s in slots.tolist()], bool)
        b.stats = {"nis": 0.0, "dof": 0, "iterations": 0}
        if self.outliers and firm.any():
            self._leave_outliers(b, seen, slots, firm)
        if firm.any():
            self._update_stones(b, seen.z[firm], seen.R[firm], slots[firm])
        loose = (slots >= 0) & ~firm & np.array([s < 0 or not b.stone[s] for s in slots.tolist()], bool)
        if loose.any():
            self._update_crumbs(b, seen.z[loose], seen.R[loose], slots[loose])
        _check_health(b)

    def _leave_outliers(self, b: Gaussian, seen: Observations, slots: Ids, firm: Any) -> None:
        """Pairings too far off by themselves are struck from `firm`."""
        rows = np.flatnonzero(firm)
        z_hat, H_pose, H_point = self.sensor.expect(b.pose, b.landmarks()[slots[rows]])
        S = kernel.own_blocks(b.P, slots[rows], H_pose, H_point) + seen.R[rows]
        nu = self._innovation(seen.z[rows], z_hat)
        d2 = np.einsum("ki,ki->k", nu, np.linalg.solve(S, nu[..., None])[..., 0])
        far = d2 > chdtri(2, 1.0 - self.outliers)
        firm[rows[far]] = False
        b.stats["outliers"] = int(far.sum())

    def _update_stones(self, b: Gaussian, z: Array, R: Array, slots: Ids) -> None:
        H_pose, H_point, residual = self._linearise(b, z, R, slots)
        W = kernel.columns(b.P, b.dim, slots, H_pose, H_point)
        S = kernel.innovation_covariance(W, slots, H_pose, H_point, R)
        HT = NO_ROWS if b.transfer is None else kernel.project_rows(b.transfer.T, slots, H_pose, H_point)
        self._apply(b, W, S, residual, HT)

    def _apply(self, b: Gaussian, W: Array, S: Array, residual: Array, HT: Array) -> None:
        """x += W y, P -= W W' with W = P H' L^-T and y = L^-1 residual; then the change of coordinates."""
        good, L = kernel.cholesky(S)
        if not good:
            raise Diverged("the innovation covariance is not positive definite")
        kernel.whiten(W, b.dim, L)
        y = kernel.forward(L, residual)
        change = W @ y
        b.x[: b.dim] += change
        b.x[2] = geometry.wrap_angle(b.x[2])
        v = h = None
        if self.invariant:
            v, h = invariant.turned(change, 3 + 2 * b.hidden), invariant.heading_column(b.P, W)
        if b.transfer is not None:
            kernel.forward_rows(L, HT)
            _carry(b.transfer, b.dim, W, HT.T, y, v, h)
        A, B = (W, W) if v is None or h is None else invariant.rebase_factors(W, v, h, h[2])
        subtract_lower(b.P, b.dim, A, B)

    def _linearise(self, b: Gaussian, z: Array, R: Array, slots: Ids) -> tuple[Array, Array, Array]:
        """Jacobians at the converged state, and the residual that leads there from the prior (Gauss-Newton)."""
        start_pose, start_points = b.pose.copy(), b.landmarks()[slots]
        moved_pose, moved_points = np.zeros(3), np.zeros_like(start_points)
        sigma = np.sqrt(R[:, [0, 1], [0, 1]])
        z_hat, H_pose, H_point = self.sensor.expect(start_pose, start_points)
        nu = self._innovation(z, z_hat)
        for count in range(1, self.iterations + 1):
            residual = kernel.linear_residual(nu, H_pose, H_point, moved_pose, moved_points)
            good, change, nis = kernel.gain_step(b.P, b.dim, slots, H_pose, H_point, R, residual)
            if not good:
                raise Diverged("the innovation covariance is not positive definite")
            if count == 1:
                b.stats.update(nis=nis, dof=2 * len(slots))
            b.stats["iterations"] = count
            if count == self.iterations:
                break
            step_pose, step_points = change[:3] - moved_pose, change[3:].reshape(-1, 2) - moved_points
            moved_pose, moved_points = change[:3], change[3:].reshape(-1, 2)
            z_new, new_pose, new_point = self.sensor.expect(start_pose + moved_pose, start_points + moved_points)
            nu_new = self._innovation(z, z_new)
            error = kernel.linear_residual(nu_new - nu, H_pose, H_point, step_pose, step_points)
            if not self.fixed and np.max(np.abs(error.reshape(-1, 2)) / sigma) < self.tolerance:
                break
            nu, H_pose, H_point = nu_new, new_pose, new_point
            if self.invariant:
                invariant.turn_jacobian(H_pose, H_point, moved_pose, moved_points)
        return H_pose, H_point, residual

    def _innovation(self, z: Array, z_hat: Array) -> Array:
        nu: Array = z - z_hat
        for k in self.sensor.angles:
            nu[:, k] = geometry.wrap(nu[:, k])
        return nu

    def _update_crumbs(self, b: Gaussian, z: Array, R: Array, slots: Ids) -> None:
        z_hat, H_pose, H_point = self.sensor.expect(b.pose, b.landmarks()[slots])
        nu = self._innovation(z, z_hat)
        T = NO_ROWS if b.transfer is None else b.transfer.T
        if not kernel.consider(b.P, b.x, b.dim, slots, H_pose, H_point, R, nu, self.invariant, T):
            raise Diverged("the innovation covariance of a tentative landmark is not positive definite")

    # --- landmarks ----------------------------------------------------------------------------------------------------

    def add(self, b: Gaussian, seen: Observations, ids: Ids) -> None:
        """New crumbs where the observations point, correlated with all else through the pose."""
        rows = np.flatnonzero(ids >= 0)
        if not len(rows):
            return
        make_room(b, len(rows))
        points, G_pose, G_z = self.sensor.locate(b.pose, seen.z[rows])
        noise = G_z @ seen.R[rows] @ G_z.transpose(0, 2, 1)
        self._append(b, points, G_pose, noise)
        attach(b, ids[rows].tolist(), False)

    def place(self, b: Gaussian, ids: Ids, landmarks: Array, covs: Array) -> None:
        """Known landmarks, as stones that owe nothing to the pose."""
        make_room(b, len(ids))
        self._append(b, landmarks, np.zeros((len(ids), 2, 3)), covs)
        attach(b, ids.tolist(), True)

    def _append(self, b: Gaussian, points: Array, G_pose: Array, noise: Array) -> None:
        dim, end = b.dim, b.dim + 2 * len(points)
        b.x[dim:end] = points.ravel()
        storage.append(b.P, dim, G_pose, noise)
        if b.transfer is not None:
            b.transfer.T[dim:end] = G_pose.reshape(-1, 3) @ b.transfer.T[:3]

    def unite(self, b: Gaussian, keep: int, drop: int) -> None:
        """The constraint that two stones are one; a crumb tells nothing. `drop` is still there afterwards."""
        i, j = b.slot[keep], b.slot[drop]
        if b.stone[j] and not b.stone[i]:
            raise ValueError(f"crumb {keep} cannot absorb stone {drop}: merge the other way round")
        if b.stone[i] and b.stone[j]:
            self._constrain(b, i, j)
            _check_health(b)

    def _constrain(self, b: Gaussian, i: int, j: int) -> None:
        """The observation l_i - l_j = 0, exact but for 1e-6 m of standard deviation.

        Where it holds, the invariant Jacobian knows no heading; so seen from the prior it has -J gap there, and the
        converged residual r = -gap - J gap e' K r follows from two linear equations.
        """
        one, by_pose = np.eye(2)[None], np.zeros((1, 2, 3))
        gap = b.landmarks()[i] - b.landmarks()[j]
        if self.invariant:
            by_pose[0, :, 2] = gap[1], -gap[0]
        first, second, none = np.array([i]), np.array([j]), np.zeros((1, 2, 3))
        W = kernel.columns(b.P, b.dim, first, by_pose, one) - kernel.columns(b.P, b.dim, second, none, one)
        W = np.asfortranarray(W)
        S = W[3 + 2 * i : 5 + 2 * i] - W[3 + 2 * j : 5 + 2 * j] + by_pose[0] @ W[:3]
        HT = NO_ROWS
        if b.transfer is not None:
            T = b.transfer.T
            HT = T[3 + 2 * i : 5 + 2 * i] - T[3 + 2 * j : 5 + 2 * j] + by_pose[0] @ T[:3]
        S = 0.5 * (S + S.T) + 1e-12 * np.eye(2)
        residual = np.linalg.solve(np.eye(2) - np.outer(by_pose[0, :, 2], np.linalg.solve(S, W[2])), -gap)
        self._apply(b, W, S, residual, HT)


def _carry(t: Transfer, dim: int, W: Array, Y: Array, y: Array, v: Array | None, h: Array | None) -> None:
    """An update, passed on to the rest of the map: P_AB -= W_A W_B', P_BB -= W_B W_B', x_B += W_B y, W_B = [G JG] Y.

    With the invariant error its coordinates change too, by v_B = J W_B y = [G JG] w; h is the heading's column.
    """
    change = Y @ y
    t.theta += change
    if v is None or h is None:
        subtract(t.T, dim, W, Y)
        subtract_lower(t.Psi, len(t.Psi), Y, Y)
        return
    half = len(change) // 2
    w = np.concatenate([-change[half:], change[:half]])
    f = t.T[2] - Y @ W[2]
    subtract(t.T, dim, *invariant.carry_factors(W, v, h, Y, w, f))
    subtract_lower(t.Psi, len(t.Psi), *invariant.rebase_factors(Y, w, f, h[2]))


def _check_health(b: Gaussian) -> None:
    if not storage.healthy(b.P, b.x, b.dim):
        raise Diverged("a variance is negative or a state is not finite")
