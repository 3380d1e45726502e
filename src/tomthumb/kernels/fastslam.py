"""FastSLAM's arithmetic over all particles at once; maps are pages of landmarks shared until one of the owners writes.

Particle p keeps landmark slot s in page table[p, s // SIZE] at place s % SIZE. A page's `uses` counts its owners. The
geometry is done in the robot's frame, point b = R'(l - p), so that one call of the sensor at pose 0 serves all
particles; a small motion (e, a) of the robot in its own frame moves b by -e - J b a.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

SIZE = 16  # landmarks on a page


@jit
def near(pose: Array, box: Array, live: Array, reach: float) -> Array:
    """Slots whose box (x0, y0, x1, y1) over all particles comes within `reach` of the box of all poses."""
    x0, y0, x1, y1 = pose[:, 0].min(), pose[:, 1].min(), pose[:, 0].max(), pose[:, 1].max()
    found = np.empty(live.shape[0], np.int64)
    n = 0
    for s in range(live.shape[0]):
        dx, dy = max(box[s, 0] - x1, x0 - box[s, 2], 0.0), max(box[s, 1] - y1, y0 - box[s, 3], 0.0)
        if live[s] and dx * dx + dy * dy <= reach * reach:
            found[n] = s
            n += 1
    return found[:n].copy()


@jit
def to_body(pose: Array, slots: Array, table: Array, mean: Array, cov: Array, has: Array) -> tuple[Array, Array, Array]:
    """Landmarks `slots` (M, c) in the robots' frames: points (M, c, 2), covariances, which exist (M, c)."""
    M, c = slots.shape
    points, spread, there = np.ones((M, c, 2)), np.zeros((M, c, 2, 2)), np.zeros((M, c), np.bool_)
    for p in range(M):
        co, si = math.cos(pose[p, 2]), math.sin(pose[p, 2])
        for k in range(c):
            if slots[p, k] < 0:
                continue
            page, at = table[p, slots[p, k] // SIZE], slots[p, k] % SIZE
            if page < 0 or not has[page, at]:
                continue
            there[p, k] = True
            dx, dy = mean[page, at, 0] - pose[p, 0], mean[page, at, 1] - pose[p, 1]
            points[p, k, 0], points[p, k, 1] = co * dx + si * dy, -si * dx + co * dy
            a, b, d = cov[page, at, 0], cov[page, at, 1], cov[page, at, 2]
            spread[p, k, 0, 0] = co * co * a + 2.0 * co * si * b + si * si * d
            spread[p, k, 0, 1] = spread[p, k, 1, 0] = co * si * (d - a) + (co * co - si * si) * b
            spread[p, k, 1, 1] = si * si * a - 2.0 * co * si * b + co * co * d
    return points, spread, there


@jit
def _pose_jacobian(H: Array, b: Array, out: Array) -> None:
    """Derivative (2, 3) of the observation by the robot's own motion in its frame, into `out`."""
    for u in range(2):
        out[u, 0], out[u, 1] = -H[u, 0], -H[u, 1]
        out[u, 2] = H[u, 0] * b[1] - H[u, 1] * b[0]


@jit
def _body_cov(pose: Array, cov: Array) -> Array:
    """The pose's covariance in the robot's own frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    B = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return B @ cov @ B.T


@jit
def own_covariances(pose: Array, pose_cov: Array, points: Array, spread: Array, H: Array) -> tuple[Array, Array]:
    """H P H' (M, c, 2, 2) of each landmark by itself, and the pose's Jacobian (M, c, 2, 3) in the robot's frame."""
    M, c = points.shape[0], points.shape[1]
    C, Hx = np.empty((M, c, 2, 2)), np.empty((M, c, 2, 3))
    for p in range(M):
        S = _body_cov(pose[p], pose_cov[p])
        for k in range(c):
            _pose_jacobian(H[p, k], points[p, k], Hx[p, k])
            for u in range(2):
                for v in range(u + 1):
                    value = 0.0
                    for i in range(3):
                        for j in range(3):
                            value += Hx[p, k, u, i] * S[i, j] * Hx[p, k, v, j]
                    for i in range(2):
                        for j in range(2):
                            value += H[p, k, u, i] * spread[p, k, i, j] * H[p, k, v, j]
                    C[p, k, u, v] = C[p, k, v, u] = value
    return C, Hx


@jit
def name(z: Array, R: Array, z_hat: Array, C: Array, there: Array, wrapped: Array, gate2: float) -> Array:
    """Most likely landmark (M, m) of each observation in each particle, as a column, or -1.

    The greatest likelihood within the gate; where two observations choose one landmark the likelier keeps it.
    """
    M, m, c = z_hat.shape[0], z.shape[0], z_hat.shape[1]
    match, taken, best = np.full((M, m), -1, np.int64), np.empty(c, np.int64), np.empty(m)
    for p in range(M):
        taken[:] = -1
        for i in range(m):
            best[i], chosen = -np.inf, -1
            for k in range(c):
                if not there[p, k]:
                    continue
                u, v = z[i, 0] - z_hat[p, k, 0], z[i, 1] - z_hat[p, k, 1]
                if wrapped[0]:
                    u = (u + math.pi) % (2.0 * math.pi) - math.pi
                if wrapped[1]:
                    v = (v + math.pi) % (2.0 * math.pi) - math.pi
                a, d = C[p, k, 0, 0] + R[i, 0, 0], C[p, k, 1, 1] + R[i, 1, 1]
                if u * u > gate2 * a or v * v > gate2 * d:  # d2 is never less than either
                    continue
                b = C[p, k, 0, 1] + R[i, 0, 1]
                det = a * d - b * b
                d2 = (d * u * u - 2.0 * b * u * v + a * v * v) / det
                if d2 < gate2 and -d2 - math.log(det) > best[i]:
                    best[i], chosen = -d2 - math.log(det), k
            if chosen < 0:
                continue
            rival = taken[chosen]
            if rival >= 0 and best[rival] >= best[i]:
                continue
            if rival >= 0:
                match[p, rival] = -1
            taken[chosen], match[p, i] = i, chosen
    return match


@jit
def _wrap(value: float, angle: bool) -> float:
    """An angle brought to [-pi, pi), anything else as it is."""
    return (value + math.pi) % (2.0 * math.pi) - math.pi if angle else value


@jit
def propose(
    z: Array, R: Array, use: Array, z_hat: Array, Hx: Array, noise: Array, shift: Array, S: Array, wrapped: Array
) -> tuple[float, float, Array, Array]:
    """One particle's pose given its observations `use`: log-likelihood, NIS, mean shift (3,) and covariance (3, 3).

    z_hat (m, 2) and Hx (m, 2, 3) are at the prior moved by `shift`; noise (m, 2, 2) what the landmark adds to R; S the
    prior covariance; all in the robot's prior frame.
    """
    mean, cov, PH = np.zeros(3), S.copy(), np.empty((3, 2))
    total, nis = 0.0, 0.0
    for i in range(z.shape[0]):
        if not use[i]:
            continue
        a, d, b = noise[i, 0, 0] + R[i, 0, 0], noise[i, 1, 1] + R[i, 1, 1], noise[i, 0, 1] + R[i, 0, 1]
        u, v = _wrap(z[i, 0] - z_hat[i, 0], wrapped[0]), _wrap(z[i, 1] - z_hat[i, 1], wrapped[1])
        for r in range(3):
            PH[r, 0] = cov[r, 0] * Hx[i, 0, 0] + cov[r, 1] * Hx[i, 0, 1] + cov[r, 2] * Hx[i, 0, 2]
            PH[r, 1] = cov[r, 0] * Hx[i, 1, 0] + cov[r, 1] * Hx[i, 1, 1] + cov[r, 2] * Hx[i, 1, 2]
        for r in range(3):
            a += Hx[i, 0, r] * PH[r, 0]
            b += Hx[i, 0, r] * PH[r, 1]
            d += Hx[i, 1, r] * PH[r, 1]
            u -= Hx[i, 0, r] * (mean[r] - shift[r])
            v -= Hx[i, 1, r] * (mean[r] - shift[r])
        det = a * d - b * b
        p, q = (d * u - b * v) / det, (a * v - b * u) / det
        d2 = u * p + v * q
        total -= 0.5 * (d2 + math.log(det)) + math.log(2.0 * math.pi)
        nis += d2
        for r in range(3):
            mean[r] += PH[r, 0] * p + PH[r, 1] * q
            k, l = (PH[r, 0] * d - PH[r, 1] * b) / det, (PH[r, 1] * a - PH[r, 0] * b) / det
            for c in range(r + 1):
                cov[r, c] -= k * PH[c, 0] + l * PH[c, 1]
        for r in range(3):
            for c in range(r):
                cov[c, r] = cov[r, c]
    return total, nis, mean, cov


@jit
def propose_all(
    z: Array, R: Array, use: Array, z_hat: Array, Hx: Array, noise: Array, shift: Array,
    pose: Array, pose_cov: Array, wrapped: Array,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """`propose` for each particle: log-likelihoods (M,), NIS (M,), shifts (M, 3), covariances (M, 3, 3)."""
    M = pose.shape[0]
    total, nis, mean, cov = np.empty(M), np.empty(M), np.empty((M, 3)), np.empty((M, 3, 3))
    for p in range(M):
        S = _body_cov(pose[p], pose_cov[p])
        total[p], nis[p], mean[p], cov[p] = propose(
            z, R, use[p], z_hat[p], Hx[p], noise[p], shift[p], S, wrapped
        )  # fmt: skip
    return total, nis, mean, cov


@jit
def sample(pose: Array, shift: Array, cov: Array, normal: Array) -> None:
    """Every pose moved by its shift plus a draw from its covariance, both in its own frame; semi-definite is fine."""
    L = np.zeros((3, 3))
    for p in range(pose.shape[0]):
        L[:] = 0.0
        for j in range(3):
            pivot = cov[p, j, j] - L[j, :j] @ L[j, :j]
            if pivot <= 1e-12 * cov[p, j, j]:
                continue
            L[j, j] = math.sqrt(pivot)
            for i in range(j + 1, 3):
                L[i, j] = (cov[p, i, j] - L[i, :j] @ L[j, :j]) / L[j, j]
        e = shift[p] + L @ normal[p]
        c, s = math.cos(pose[p, 2]), math.sin(pose[p, 2])
        pose[p, 0] += c * e[0] - s * e[1]
        pose[p, 1] += s * e[0] + c * e[1]
        pose[p, 2] = (pose[p, 2] + e[2] + math.pi) % (2.0 * math.pi) - math.pi


@jit
def _own_page(p: int, column: int, table: Array, mean: Array, cov: Array, has: Array, uses: Array, free: Array) -> Any:
    """The page as particle p's own: a shared one is copied first. free[0] counts the free pages listed behind it."""
    page = table[p, column]
    if page >= 0 and uses[page] == 1:
        return page
    new = free[free[0]]
    free[0] -= 1
    uses[new] = 1
    if page >= 0:
        mean[new], cov[new], has[new] = mean[page], cov[page], has[page]
        uses[page] -= 1
    else:
        has[new] = False
    table[p, column] = new
    return new


@jit
def absorb(
    pose: Array, points: Array, spread: Array, slots: Array, z: Array, R: Array, z_hat: Array, H: Array, wrapped: Array,
    table: Array, mean: Array, cov: Array, has: Array, uses: Array, free: Array,
) -> None:  # fmt: skip
    """Each particle's landmarks `slots` (M, m; -1 none) updated by its observations, its pose being known."""
    b, P, PH = np.empty(2), np.empty((2, 2)), np.empty((2, 2))
    for p in range(pose.shape[0]):
        c, s = math.cos(pose[p, 2]), math.sin(pose[p, 2])
        for i in range(z.shape[0]):
            if slots[p, i] < 0:
                continue
            u, v = _wrap(z[i, 0] - z_hat[p, i, 0], wrapped[0]), _wrap(z[i, 1] - z_hat[p, i, 1], wrapped[1])
            for r in range(2):
                for k in range(2):
                    PH[r, k] = spread[p, i, r, 0] * H[p, i, k, 0] + spread[p, i, r, 1] * H[p, i, k, 1]
            e = H[p, i, 0, 0] * PH[0, 0] + H[p, i, 0, 1] * PH[1, 0] + R[i, 0, 0]
            f = H[p, i, 0, 0] * PH[0, 1] + H[p, i, 0, 1] * PH[1, 1] + R[i, 0, 1]
            g = H[p, i, 1, 0] * PH[0, 1] + H[p, i, 1, 1] * PH[1, 1] + R[i, 1, 1]
            det = e * g - f * f
            for r in range(2):
                k, l = (PH[r, 0] * g - PH[r, 1] * f) / det, (PH[r, 1] * e - PH[r, 0] * f) / det
                b[r] = points[p, i, r] + k * u + l * v
                for q in range(2):
                    P[r, q] = spread[p, i, r, q] - k * PH[q, 0] - l * PH[q, 1]
            page, at = _own_page(p, slots[p, i] // SIZE, table, mean, cov, has, uses, free), slots[p, i] % SIZE
            _write(mean, cov, page, at, pose[p], c, s, b, P)


@jit
def _write(mean: Array, cov: Array, page: int, at: int, pose: Array, c: float, s: float, b: Array, P: Array) -> None:
    """A landmark at b with covariance P in the robot's frame, turned into the world."""
    mean[page, at, 0], mean[page, at, 1] = pose[0] + c * b[0] - s * b[1], pose[1] + s * b[0] + c * b[1]
    a, o, d = P[0, 0], 0.5 * (P[0, 1] + P[1, 0]), P[1, 1]
    cov[page, at, 0] = c * c * a - 2.0 * c * s * o + s * s * d
    cov[page, at, 1] = c * s * (a - d) + (c * c - s * s) * o
    cov[page, at, 2] = s * s * a + 2.0 * c * s * o + c * c * d


@jit
def found(
    pose: Array, slots: Array, points: Array, noise: Array,
    table: Array, mean: Array, cov: Array, has: Array, uses: Array, free: Array,
) -> None:  # fmt: skip
    """New landmarks `slots` (M, m; -1 none) at points (m, 2) with noise (m, 2, 2) in the robot's frame."""
    for p in range(pose.shape[0]):
        c, s = math.cos(pose[p, 2]), math.sin(pose[p, 2])
        for i in range(slots.shape[1]):
            if slots[p, i] < 0:
                continue
            page, at = _own_page(p, slots[p, i] // SIZE, table, mean, cov, has, uses, free), slots[p, i] % SIZE
            _write(mean, cov, page, at, pose[p], c, s, points[i], noise[i])
            has[page, at] = True


@jit
def boxes(slots: Array, table: Array, mean: Array, has: Array, box: Array) -> None:
    """The box of each landmark in `slots` over all particles that hold it."""
    for s in slots:
        box[s, :2], box[s, 2:] = np.inf, -np.inf
        for p in range(table.shape[0]):
            page = table[p, s // SIZE]
            if page >= 0 and has[page, s % SIZE]:
                x, y = mean[page, s % SIZE]
                box[s, 0], box[s, 1] = min(box[s, 0], x), min(box[s, 1], y)
                box[s, 2], box[s, 3] = max(box[s, 2], x), max(box[s, 3], y)


@jit
def inherit(parents: Array, table: Array, uses: Array, free: Array) -> Array:
    """Page tables of the children; nothing else is copied. Pages without an owner become free.

    A particle with one child hands its pages on as they are; so only those with none or several are gone through.
    """
    count = np.zeros(table.shape[0], np.int64)
    for parent in parents:
        count[parent] += 1
    for p in range(table.shape[0]):
        if count[p] == 1:
            continue
        for page in table[p]:
            if page >= 0:
                uses[page] += count[p] - 1
                if uses[page] == 0:
                    free[0] += 1
                    free[free[0]] = page
    children = table[parents]
    return children


@jit
def systematic(weights: Array, start: float) -> Array:
    """Parents (M,) by systematic resampling of normalised weights; `start` is uniform in [0, 1)."""
    M = weights.shape[0]
    parents = np.empty(M, np.int64)
    total, k = weights[0], 0
    for p in range(M):
        while (p + start) / M > total and k < M - 1:
            k += 1
            total += weights[k]
        parents[p] = k
    return parents


@jit
def unite(keep: int, drop: int, table: Array, mean: Array, cov: Array, has: Array, uses: Array, free: Array) -> Array:
    """Landmark `drop` fused into `keep` in every particle; log-likelihood (M,) that the two are one place."""
    score = np.zeros(table.shape[0])
    for p in range(table.shape[0]):
        other, o = table[p, drop // SIZE], drop % SIZE
        if other < 0 or not has[other, o]:
            continue
        page, a = _own_page(p, keep // SIZE, table, mean, cov, has, uses, free), keep % SIZE
        other = table[p, drop // SIZE]  # `keep` may be on the same page, copied just now
        if not has[page, a]:
            mean[page, a], cov[page, a], has[page, a] = mean[other, o], cov[other, o], True
            continue
        A = np.array([[cov[page, a, 0], cov[page, a, 1]], [cov[page, a, 1], cov[page, a, 2]]])
        B = np.array([[cov[other, o, 0], cov[other, o, 1]], [cov[other, o, 1], cov[other, o, 2]]])
        V = A + B
        det = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
        inverse = np.array([[V[1, 1], -V[0, 1]], [-V[1, 0], V[0, 0]]]) / det
        gap = mean[other, o] - mean[page, a]
        score[p] = -0.5 * (gap @ inverse @ gap + math.log(det)) - math.log(2.0 * math.pi)
        mean[page, a] += A @ inverse @ gap
        P = A - A @ inverse @ A
        cov[page, a, 0], cov[page, a, 1], cov[page, a, 2] = P[0, 0], P[0, 1], P[1, 1]
    return score
