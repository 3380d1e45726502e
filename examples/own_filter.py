"""`tomthumb.associate` behind a filter of your own: here a small localisation filter on a known map.

The filter predicts what it expects to see and how sure it is; `associate` says which observation is which landmark; the
filter updates. Run it: python examples/own_filter.py
"""

import numpy as np

import tomthumb

SENSOR_STD = np.array([0.05, np.radians(1.0)])  # range m, bearing rad
STEP, STEP_STD = np.array([0.25, 0.0, np.radians(3.6)]), np.array([0.02, 0.02, np.radians(1.0)])


def move(pose, step):
    """A motion (forward m, left m, turn rad) added to a pose (x m, y m, heading rad)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose + np.array([c * step[0] - s * step[1], s * step[0] + c * step[1], step[2]])


def expect(pose, landmarks):
    """Range and bearing of each landmark (n, 2), and their derivatives by the pose (2n, 3)."""
    dx, dy = (landmarks - pose[:2]).T
    r = np.hypot(dx, dy)
    bearing = (np.arctan2(dy, dx) - pose[2] + np.pi) % (2 * np.pi) - np.pi
    zero, one = np.zeros_like(r), np.ones_like(r)
    H = np.stack([[-dx / r, -dy / r, zero], [dy / r**2, -dx / r**2, -one]]).transpose(2, 0, 1).reshape(-1, 3)
    return np.stack([r, bearing], 1), H


def main(steps=100, seed=1):
    """Drive a circle among 40 landmarks; returns the share of observations rightly named and the last error in m."""
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-6, 10, (40, 2))
    truth, pose, P, right, total = np.zeros(3), np.zeros(3), np.diag([0.1, 0.1, 0.05]) ** 2, 0, 0
    for _ in range(steps):
        truth = move(truth, STEP)
        reading = STEP + STEP_STD * rng.standard_normal(3)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        F = np.array([[1, 0, -s * reading[0]], [0, 1, c * reading[0]], [0, 0, 1]])
        G = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        pose, P = move(pose, reading), F @ P @ F.T + G @ np.diag(STEP_STD**2) @ G.T

        z, _ = expect(truth, landmarks)
        seen = rng.permutation(np.flatnonzero(z[:, 0] < 5.0))
        z = z[seen] + SENSOR_STD * rng.standard_normal((len(seen), 2))

        z_hat, H = expect(pose, landmarks)
        R = np.diag(SENSOR_STD**2)
        found = tomthumb.associate(z, z_hat, H @ P @ H.T, R, method="jcbb", pose_cov=P, cross=H @ P)
        right, total = right + int((found.match == seen).sum()), total + len(seen)

        for i, j in enumerate(found.match):  # the filter's own update, one pairing after the other
            if j >= 0:
                z_hat, H = expect(pose, landmarks[[j]])
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                innovation = z[i] - z_hat[0]
                innovation[1] = (innovation[1] + np.pi) % (2 * np.pi) - np.pi
                pose, P = pose + K @ innovation, P - K @ H @ P
    return right / total, float(np.hypot(*(pose - truth)[:2]))


if __name__ == "__main__":
    rate, error = main()
    print(f"{100 * rate:.2f} % of the observations rightly named, {100 * error:.1f} cm off at the end")
