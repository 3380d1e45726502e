"""Innovations, Mahalanobis distances and expected observations of points: array in, array out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def mahalanobis(nu: Array, C: Array, R: Array) -> Array:
    """d2 (m, n) of innovations nu (m, n, 2) under C_j + R_i, both 2 x 2."""
    m, n = nu.shape[0], nu.shape[1]
    d2 = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            a = C[j, 0, 0] + R[i, 0, 0]
            b = 0.5 * (C[j, 0, 1] + C[j, 1, 0] + R[i, 0, 1] + R[i, 1, 0])
            d = C[j, 1, 1] + R[i, 1, 1]
            det = a * d - b * b
            u, v = nu[i, j, 0], nu[i, j, 1]
            d2[i, j] = (d * u * u - 2.0 * b * u * v + a * v * v) / det if det > 0.0 else np.inf
    return d2


@jit
def innovations(z: Array, z_hat: Array, wrapped: Array) -> Array:
    """z_i - z_hat_j (m, n, d); components flagged in `wrapped (d,)` brought to [-pi, pi)."""
    m, n, d = z.shape[0], z_hat.shape[0], z.shape[1]
    nu = np.empty((m, n, d))
    for i in range(m):
        for j in range(n):
            for k in range(d):
                value = z[i, k] - z_hat[j, k]
                if wrapped[k]:
                    value = (value + math.pi) % (2.0 * math.pi) - math.pi
                nu[i, j, k] = value
    return nu


@jit
def expect_cartesian(pose: Array, mount: Array, landmarks: Array) -> tuple[Array, Array, Array]:
    """Points in the sensor's frame, with Jacobians by pose and landmark; the sensor sits at `mount` on the robot."""
    n = landmarks.shape[0]
    z, H_pose, H_point = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 2))
    heading = pose[2] + mount[2]
    c, s = math.cos(heading), math.sin(heading)
    cp, sp = math.cos(pose[2]), math.sin(pose[2])
    ox, oy = cp * mount[0] - sp * mount[1], sp * mount[0] + cp * mount[1]
    for j in range(n):
        dx, dy = landmarks[j, 0] - pose[0] - ox, landmarks[j, 1] - pose[1] - oy
        z[j, 0], z[j, 1] = c * dx + s * dy, -s * dx + c * dy
        H_point[j, 0, 0], H_point[j, 0, 1] = c, s
        H_point[j, 1, 0], H_point[j, 1, 1] = -s, c
        H_pose[j, 0, 0], H_pose[j, 0, 1] = -c, -s
        H_pose[j, 1, 0], H_pose[j, 1, 1] = s, -c
        # d/dheading: the rotation turns, and so does the mount's lever arm
        H_pose[j, 0, 2] = -s * dx + c * dy + c * oy - s * ox
        H_pose[j, 1, 2] = -c * dx - s * dy - s * oy - c * ox
    return z, H_pose, H_point


@jit
def expect_range_bearing(pose: Array, mount: Array, landmarks: Array) -> tuple[Array, Array, Array]:
    """Range m and bearing rad (0 ahead, left positive) of points, with Jacobians by pose and landmark."""
    p, H_pose, H_point = expect_cartesian(pose, mount, landmarks)
    z = np.empty_like(p)
    for j in range(p.shape[0]):
        x, y = p[j, 0], p[j, 1]
        q = max(x * x + y * y, 1e-12)
        r = math.sqrt(q)
        z[j, 0], z[j, 1] = r, math.atan2(y, x)
        for k in range(3):
            u, v = H_pose[j, 0, k], H_pose[j, 1, k]
            H_pose[j, 0, k], H_pose[j, 1, k] = (x * u + y * v) / r, (x * v - y * u) / q
        for k in range(2):
            u, v = H_point[j, 0, k], H_point[j, 1, k]
            H_point[j, 0, k], H_point[j, 1, k] = (x * u + y * v) / r, (x * v - y * u) / q
    return z, H_pose, H_point


@jit
def locate_cartesian(pose: Array, mount: Array, z: Array) -> tuple[Array, Array, Array]:
    """World points of Cartesian observations, with Jacobians by pose and z."""
    m = z.shape[0]
    points, G_pose, G_z = np.empty((m, 2)), np.zeros((m, 2, 3)), np.empty((m, 2, 2))
    heading = pose[2] + mount[2]
    c, s = math.cos(heading), math.sin(heading)
    cp, sp = math.cos(pose[2]), math.sin(pose[2])
    ox, oy = cp * mount[0] - sp * mount[1], sp * mount[0] + cp * mount[1]
    for i in range(m):
        dx, dy = c * z[i, 0] - s * z[i, 1] + ox, s * z[i, 0] + c * z[i, 1] + oy
        points[i, 0], points[i, 1] = pose[0] + dx, pose[1] + dy
        G_pose[i, 0, 0] = G_pose[i, 1, 1] = 1.0
        G_pose[i, 0, 2], G_pose[i, 1, 2] = -dy, dx
        G_z[i, 0, 0], G_z[i, 0, 1] = c, -s
        G_z[i, 1, 0], G_z[i, 1, 1] = s, c
    return points, G_pose, G_z


@jit
def locate_range_bearing(pose: Array, mount: Array, z: Array) -> tuple[Array, Array, Array]:
    """World points of range-bearing observations, with Jacobians by pose and z."""
    m = z.shape[0]
    flat = np.empty((m, 2))
    for i in range(m):
        flat[i, 0], flat[i, 1] = z[i, 0] * math.cos(z[i, 1]), z[i, 0] * math.sin(z[i, 1])
    points, G_pose, G = locate_cartesian(pose, mount, flat)
    for i in range(m):
        cb, sb, r = math.cos(z[i, 1]), math.sin(z[i, 1]), z[i, 0]
        for k in range(2):
            u, v = G[i, k, 0], G[i, k, 1]
            G[i, k, 0], G[i, k, 1] = u * cb + v * sb, r * (v * cb - u * sb)
    return points, G_pose, G


@jit
def paired_distances(z: Array, R: Array, z_hat: Array, C: Array, rows: Array, columns: Array, wrapped: Array) -> Array:
    """d2 of the pairings (rows[k], columns[k]), each by its own innovation covariance."""
    out = np.empty(rows.shape[0])
    for k in range(rows.shape[0]):
        i, j = rows[k], columns[k]
        u, v = z[i, 0] - z_hat[j, 0], z[i, 1] - z_hat[j, 1]
        if wrapped[0]:
            u = (u + math.pi) % (2.0 * math.pi) - math.pi
        if wrapped[1]:
            v = (v + math.pi) % (2.0 * math.pi) - math.pi
        a, d = C[2 * j, 2 * j] + R[i, 0, 0], C[2 * j + 1, 2 * j + 1] + R[i, 1, 1]
        b = C[2 * j, 2 * j + 1] + R[i, 0, 1]
        out[k] = (d * u * u - 2.0 * b * u * v + a * v * v) / (a * d - b * b)
    return out
