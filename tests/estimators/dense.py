"""A textbook EKF-SLAM on full matrices, slow and plain, to hold the real one against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb import geometry
from tomthumb.types import Control, Observations

J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass
class Dense:
    """State (pose, calibration, landmarks in order of `ids`), full covariance. `fixed` Gauss-Newton iterations."""

    motion: object
    sensor: object
    invariant: bool
    iterations: int
    x: np.ndarray
    P: np.ndarray
    ids: list
    stones: set

    def rows(self, i):
        k = 3 + 2 * self.ids.index(i)
        return [k, k + 1]

    def predict(self, control: Control) -> None:
        delta, cov = self.motion.increment(control)
        F, G = geometry.compose_jacobians(self.x[:3], delta)
        big = np.eye(len(self.x))
        big[:3, :3] = F
        self.x[:3] = geometry.compose(self.x[:3], delta)
        self.P = big @ self.P @ big.T
        self.P[:3, :3] += G @ cov @ G.T

    def jacobian(self, x, ids):
        """z_hat and the full H by the usual error at x."""
        points = np.array([x[self.rows(i)] for i in ids])
        z_hat, by_pose, by_point = self.sensor.expect(x[:3], points)
        H = np.zeros((2 * len(ids), len(x)))
        for k, i in enumerate(ids):
            H[2 * k : 2 * k + 2, :3] = by_pose[k]
            H[2 * k : 2 * k + 2, self.rows(i)] = by_point[k]
        return z_hat, H

    def chart(self, x):
        """T: usual error = T xi."""
        T = np.eye(len(x))
        T[:2, 2] = J @ x[:2]
        T[3:, 2] = (x[3:].reshape(-1, 2) @ J.T).ravel()
        return T

    def innovation(self, z, z_hat):
        nu = z - z_hat
        for k in self.sensor.angles:
            nu[:, k] = geometry.wrap(nu[:, k])
        return nu.ravel()

    def update(self, seen: Observations, ids) -> None:
        firm = [k for k, i in enumerate(ids) if i in self.stones]
        if firm:
            self.update_stones(seen.take(np.array(firm)), [ids[k] for k in firm])
        for k, i in enumerate(ids):
            if i in self.ids and i not in self.stones:
                self.update_crumb(seen.z[k : k + 1], seen.R[k], i)

    def update_stones(self, seen, ids) -> None:
        x0, R = self.x.copy(), np.zeros((2 * len(ids), 2 * len(ids)))
        for k in range(len(ids)):
            R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = seen.R[k]
        moved = np.zeros_like(x0)
        for _ in range(self.iterations):
            z_hat, H = self.jacobian(x0 + moved, ids)
            if self.invariant:
                H = H @ self.chart(x0 + moved) @ np.linalg.inv(self.chart(x0))
            r = self.innovation(seen.z, z_hat) + H @ moved
            S = H @ self.P @ H.T + R
            K = self.P @ H.T @ np.linalg.inv(S)
            moved = K @ r
        self.finish(x0 + moved, K, H, R)

    def update_crumb(self, z, R, i) -> None:
        """Joseph form with zero rows of the gain for all but the crumb."""
        z_hat, H = self.jacobian(self.x, [i])
        S = H @ self.P @ H.T + R
        K = np.zeros((len(self.x), 2))
        K[self.rows(i)] = (self.P @ H.T @ np.linalg.inv(S))[self.rows(i)]
        self.finish(self.x + K @ self.innovation(z, z_hat), K, H, R)

    def finish(self, x, K, H, R) -> None:
        keep = np.eye(len(x)) - K @ H
        P = keep @ self.P @ keep.T + K @ R @ K.T
        if self.invariant:
            M = self.chart(x) @ np.linalg.inv(self.chart(self.x))
            P = M @ P @ M.T
        self.x, self.P = x, 0.5 * (P + P.T)
        self.x[2] = geometry.wrap_angle(self.x[2])

    def add(self, seen: Observations, ids) -> None:
        rows = [k for k, i in enumerate(ids) if i >= 0]
        points, by_pose, by_z = self.sensor.locate(self.x[:3], seen.z[rows])
        for k, point, A, B in zip(rows, points, by_pose, by_z, strict=True):
            across = A @ self.P[:3]
            own = A @ self.P[:3, :3] @ A.T + B @ seen.R[k] @ B.T
            self.P = np.block([[self.P, across.T], [across, own]])
            self.x = np.concatenate([self.x, point])
            self.ids.append(ids[k])

    def forget(self, i) -> None:
        gone = self.rows(i)
        self.x, self.P = np.delete(self.x, gone), np.delete(np.delete(self.P, gone, 0), gone, 1)
        self.ids.remove(i)
        self.stones.discard(i)

    def merge(self, keep, drop) -> None:
        H = np.zeros((2, len(self.x)))
        H[:, self.rows(keep)], H[:, self.rows(drop)] = np.eye(2), -np.eye(2)
        gap = self.x[self.rows(keep)] - self.x[self.rows(drop)]
        if self.invariant:
            H[:, 2] = -J @ gap
        R = 1e-12 * np.eye(2)
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        r = -gap
        for _ in range(100):  # the converged iterated update: r = -gap(x0 + K r) + H K r, with gap(...) = 0
            moved = K @ r
            r = -(gap + moved[self.rows(keep)] - moved[self.rows(drop)]) + H @ moved
        self.finish(self.x + K @ r, K, H, R)
        self.forget(drop)
