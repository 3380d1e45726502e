"""The dense arithmetic of EKF-SLAM on a covariance of which only the lower triangle is kept (column-major).

Rows 0 to 2 are the pose, rows 3 + 2 s and 4 + 2 s landmark slot s. Nothing here reads above the diagonal.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def at(P: Array, i: int, j: int) -> Any:
    """Element (i, j) of the symmetric matrix whose lower triangle is stored."""
    return P[i, j] if i >= j else P[j, i]


@jit
def move_pose(P: Array, dim: int, F: Array, C: Array, Q: Array) -> None:
    """P_rr = [F C] P_(r,c)(r,c) [F C]' + Q and P_.r = P_.r F' + P_.c C', c the first states behind the pose."""
    c = C.shape[1]
    D = np.empty((3, 3 + c))
    D[:, :3], D[:, 3:] = F, C
    old = np.empty((3 + c, 3 + c))
    for i in range(3 + c):
        for j in range(3 + c):
            old[i, j] = at(P, i, j)
    new = D @ old @ D.T
    for i in range(3, dim):
        p, q, r = P[i, 0], P[i, 1], P[i, 2]
        for u in range(3):
            value = p * F[u, 0] + q * F[u, 1] + r * F[u, 2]
            for k in range(c):
                value += at(P, i, 3 + k) * C[u, k]
            P[i, u] = value
    for j in range(3):
        for i in range(j, 3):
            P[i, j] = 0.5 * (new[i, j] + new[j, i]) + Q[i, j]


@jit
def move(
    P: Array, x: Array, dim: int, dx: float, dy: float, turn: float, cov: Array, J: Array
) -> tuple[Array, Array]:  # fmt: skip
    """The pose x[:3] moved by an increment with covariance cov (3, 3) that depends on the next k states by J (3, k).

    Returns F (3, 3) and C (3, k), the derivatives of the new pose by the old one and by those states.
    """
    c, s = math.cos(x[2]), math.sin(x[2])
    F, G, noise, C = np.eye(3), np.eye(3), np.zeros((3, 3)), np.zeros((3, J.shape[1]))
    F[0, 2], F[1, 2] = -s * dx - c * dy, c * dx - s * dy
    G[0, 0], G[0, 1], G[1, 0], G[1, 1] = c, -s, s, c
    for i in range(3):
        for k in range(3):
            for j in range(J.shape[1]):
                C[i, j] += G[i, k] * J[k, j]
            part = G[i, 0] * cov[0, k] + G[i, 1] * cov[1, k] + G[i, 2] * cov[2, k]
            for j in range(3):
                noise[i, j] += part * G[j, k]
    x[0] += c * dx - s * dy
    x[1] += s * dx + c * dy
    x[2] = (x[2] + turn + math.pi) % (2.0 * math.pi) - math.pi
    move_pose(P, dim, F, C, noise)
    return F, C


@jit
def near(P: Array, x: Array, dim: int, hidden: int, eye: Array, reach: float) -> Array:
    """Slots of landmarks nearer to `eye` than `reach` and five standard deviations of their distance to the robot."""
    found = np.empty((dim - 3) // 2, np.int64)
    count = 0
    for slot in range(hidden, (dim - 3) // 2):
        i = 3 + 2 * slot
        dx, dy = x[i] - eye[0], x[i + 1] - eye[1]
        over = math.sqrt(dx * dx + dy * dy) - reach
        if over > 0.0:
            apart = P[i, i] + P[i + 1, i + 1] + P[0, 0] + P[1, 1] - 2.0 * (P[i, 0] + P[i + 1, 1])
            if over * over > 25.0 * max(apart, 0.0):
                continue
        found[count] = slot
        count += 1
    return found[:count].copy()


@jit
def own_blocks(P: Array, slots: Array, H_pose: Array, H_point: Array) -> Array:
    """Diagonal blocks (n, 2, 2) of H P H' for the landmarks in `slots`."""
    n = slots.shape[0]
    blocks = np.empty((n, 2, 2))
    G, M = np.empty((2, 5)), np.empty((5, 5))
    for k in range(n):
        _local(P, slots[k], M)
        G[:, :3], G[:, 3:] = H_pose[k], H_point[k]
        blocks[k] = G @ M @ G.T
    return blocks


@jit
def _local(P: Array, slot: int, M: Array) -> None:
    """Covariance (5, 5) of the pose and one landmark, into M."""
    base = 3 + 2 * slot
    for a in range(5):
        i = a if a < 3 else base + a - 3
        for b in range(5):
            j = b if b < 3 else base + b - 3
            M[a, b] = at(P, i, j)


@jit
def own_variances(P: Array, slots: Array, H_pose: Array, H_point: Array) -> Array:
    """The diagonal (n, 2) of H P H', not below 0."""
    blocks = own_blocks(P, slots, H_pose, H_point)
    out = np.empty((slots.shape[0], 2))
    for k in range(slots.shape[0]):
        out[k, 0], out[k, 1] = max(blocks[k, 0, 0], 0.0), max(blocks[k, 1, 1], 0.0)
    return out


@jit
def project(P: Array, slots: Array, H_pose: Array, H_point: Array) -> tuple[Array, Array]:
    """H P H' (2n, 2n) with all cross terms, and H P[:, pose] (2n, 3), of the landmarks in `slots`."""
    n = slots.shape[0]
    C, cross, back = np.empty((2 * n, 2 * n)), np.empty((2 * n, 3)), np.empty((2, 2))
    for a in range(n):
        base = 3 + 2 * slots[a]
        for u in range(2):
            for c in range(3):
                value = H_point[a, u, 0] * P[base, c] + H_point[a, u, 1] * P[base + 1, c]
                for k in range(3):
                    value += H_pose[a, u, k] * at(P, k, c)
                cross[2 * a + u, c] = value
    for a in range(n):
        base_a = 3 + 2 * slots[a]
        for b in range(a + 1):
            base_b = 3 + 2 * slots[b]
            for u in range(2):
                for v in range(2):  # covariance of prediction a with the point of landmark b
                    value = H_point[a, u, 0] * at(P, base_a, base_b + v) + H_point[a, u, 1] * at(
                        P, base_a + 1, base_b + v
                    )
                    for k in range(3):
                        value += H_pose[a, u, k] * P[base_b + v, k]
                    back[u, v] = value
            for u in range(2):
                for v in range(2):
                    value = back[u, 0] * H_point[b, v, 0] + back[u, 1] * H_point[b, v, 1]
                    for k in range(3):
                        value += cross[2 * a + u, k] * H_pose[b, v, k]
                    C[2 * a + u, 2 * b + v] = value
                    C[2 * b + v, 2 * a + u] = value
    return C, cross


@jit
def columns(P: Array, dim: int, slots: Array, H_pose: Array, H_point: Array) -> Array:
    """P H' (dim, 2k), column-major."""
    k = slots.shape[0]
    out = np.empty((2 * k, dim)).T
    for i in range(k):
        base = 3 + 2 * slots[i]
        for u in range(2):
            column = out[:, 2 * i + u]
            a, b, c = H_pose[i, u, 0], H_pose[i, u, 1], H_pose[i, u, 2]
            d, e = H_point[i, u, 0], H_point[i, u, 1]
            for r in range(3):
                column[r] = a * at(P, r, 0) + b * at(P, r, 1) + c * at(P, r, 2) + d * P[base, r] + e * P[base + 1, r]
            for r in range(3, base + 1):
                column[r] = a * P[r, 0] + b * P[r, 1] + c * P[r, 2] + d * P[base, r] + e * P[base + 1, r]
            r = base + 1
            column[r] = a * P[r, 0] + b * P[r, 1] + c * P[r, 2] + d * P[r, base] + e * P[r, r]
            for r in range(base + 2, dim):
                column[r] = a * P[r, 0] + b * P[r, 1] + c * P[r, 2] + d * P[r, base] + e * P[r, base + 1]
    return out


@jit
def innovation_covariance(PHt: Array, slots: Array, H_pose: Array, H_point: Array, R: Array) -> Array:
    """S (2k, 2k) = H (P H') + R, symmetrised."""
    k = slots.shape[0]
    S = np.empty((2 * k, 2 * k))
    for i in range(k):
        base = 3 + 2 * slots[i]
        for u in range(2):
            for c in range(2 * k):
                value = H_point[i, u, 0] * PHt[base, c] + H_point[i, u, 1] * PHt[base + 1, c]
                for r in range(3):
                    value += H_pose[i, u, r] * PHt[r, c]
                S[2 * i + u, c] = value
    S = 0.5 * (S + S.T)
    for i in range(k):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += 0.5 * (R[i] + R[i].T)
    return S


@jit
def cholesky(S: Array) -> tuple[bool, Array]:
    """Lower factor of S, and whether S is positive definite (numba's own would raise instead of telling)."""
    n = S.shape[0]
    L = np.zeros((n, n))
    for j in range(n):
        pivot = S[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not pivot > 0.0:
            return False, L
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            value = S[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value / L[j, j]
    return True, L


@jit
def forward(L: Array, b: Array) -> Array:
    """L^-1 b for a vector b."""
    y = b.copy()
    for i in range(L.shape[0]):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    return y


@jit
def whiten(PHt: Array, dim: int, L: Array) -> None:
    """W = P H' L^-T in place: then P - W W' is the updated covariance and W L^-1 nu the state's change."""
    for j in range(L.shape[0]):
        target = PHt[:, j]
        for k in range(j):
            factor, source = L[j, k], PHt[:, k]
            for r in range(dim):
                target[r] -= factor * source[r]
        scale = 1.0 / L[j, j]
        for r in range(dim):
            target[r] *= scale


@jit
def linear_residual(nu: Array, H_pose: Array, H_point: Array, moved_pose: Array, moved_points: Array) -> Array:
    """nu + H (x_i - x0), the innovation of the iterated update (2k,)."""
    k = nu.shape[0]
    out = np.empty(2 * k)
    for i in range(k):
        for u in range(2):
            value = nu[i, u] + H_point[i, u, 0] * moved_points[i, 0] + H_point[i, u, 1] * moved_points[i, 1]
            for r in range(3):
                value += H_pose[i, u, r] * moved_pose[r]
            out[2 * i + u] = value
    return out


@jit
def local_cross(P: Array, dim: int, slots: Array, H_pose: Array, H_point: Array) -> Array:
    """Rows of P H' for the pose and the landmarks in `slots`: (3 + 2k, 2k), all that an iteration needs."""
    k = slots.shape[0]
    rows = np.empty(3 + 2 * k, np.int64)
    rows[:3] = np.arange(3)
    for i in range(k):
        rows[3 + 2 * i], rows[4 + 2 * i] = 3 + 2 * slots[i], 4 + 2 * slots[i]
    out = np.empty((3 + 2 * k, 2 * k))
    for a in range(3 + 2 * k):
        r = rows[a]
        for i in range(k):
            base = 3 + 2 * slots[i]
            p0, p1, p2 = at(P, r, 0), at(P, r, 1), at(P, r, 2)
            q0, q1 = at(P, r, base), at(P, r, base + 1)
            for u in range(2):
                out[a, 2 * i + u] = (
                    H_pose[i, u, 0] * p0
                    + H_pose[i, u, 1] * p1
                    + H_pose[i, u, 2] * p2
                    + H_point[i, u, 0] * q0
                    + H_point[i, u, 1] * q1
                )
    return out


@jit
def gain_step(
    P: Array, dim: int, slots: Array, H_pose: Array, H_point: Array, R: Array, residual: Array
) -> tuple[bool, Array, float]:
    """One Gauss-Newton step in the space of the pose and the observed landmarks: change (3 + 2k,), and NIS."""
    k = slots.shape[0]
    local = local_cross(P, dim, slots, H_pose, H_point)
    S = innovation_covariance(local, np.arange(k), H_pose, H_point, R)
    good, L = cholesky(S)
    if not good:
        return False, np.zeros(local.shape[0]), np.nan
    y = forward(L, residual)
    nis = 0.0
    for i in range(y.shape[0]):
        nis += y[i] * y[i]
    for i in range(y.shape[0] - 1, -1, -1):
        for j in range(i + 1, y.shape[0]):
            y[i] -= L[j, i] * y[j]
        y[i] /= L[i, i]
    return True, local @ y, nis


@jit
def consider(
    P: Array, x: Array, dim: int, slots: Array, H_pose: Array, H_point: Array, R: Array, nu: Array, turn: bool, T: Array
) -> bool:
    """Schmidt's updates of crumbs, one by one: their own rows learn, the pose and the stones are only considered.

    P_co -= K (H P)_o, P_cc -= K S K', with K = P_c H' S^-1: the Joseph form of a gain that is zero elsewhere.
    """
    K = np.empty((2, 2))
    for i in range(slots.shape[0]):
        PHt = columns(P, dim, slots[i : i + 1], H_pose[i : i + 1], H_point[i : i + 1])
        S = innovation_covariance(PHt, slots[i : i + 1], H_pose[i : i + 1], H_point[i : i + 1], R[i : i + 1])
        det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
        if not (det > 0.0 and S[0, 0] > 0.0):
            return False
        base = 3 + 2 * slots[i]
        for a in range(2):
            p, q = PHt[base + a, 0], PHt[base + a, 1]
            K[a, 0] = (p * S[1, 1] - q * S[1, 0]) / det
            K[a, 1] = (q * S[0, 0] - p * S[0, 1]) / det
        if T.shape[0] > 0:
            T[base : base + 2] -= K @ project_rows(T, slots[i : i + 1], H_pose[i : i + 1], H_point[i : i + 1])
        KS = K @ S @ K.T
        v0, v1 = K[0, 0] * nu[i, 0] + K[0, 1] * nu[i, 1], K[1, 0] * nu[i, 0] + K[1, 1] * nu[i, 1]
        x[base] += v0
        x[base + 1] += v1
        for a in range(2):
            for r in range(base):
                P[base + a, r] -= K[a, 0] * PHt[r, 0] + K[a, 1] * PHt[r, 1]
            for r in range(base + 2, dim):
                P[r, base + a] -= K[a, 0] * PHt[r, 0] + K[a, 1] * PHt[r, 1]
        P[base, base] -= KS[0, 0]
        P[base + 1, base] -= 0.5 * (KS[1, 0] + KS[0, 1])
        P[base + 1, base + 1] -= KS[1, 1]
        if turn:
            turn_landmark(P, dim, base, -v1, v0)
            for w in range(T.shape[1]):
                T[base, w] -= v1 * T[2, w]
                T[base + 1, w] += v0 * T[2, w]
    return True


@jit
def turn_landmark(P: Array, dim: int, base: int, v0: float, v1: float) -> None:
    """P <- (I + v e') P (I + v e')' with v zero but in the two rows from `base`, e the heading's unit vector."""
    h0, h1, var = P[base, 2], P[base + 1, 2], P[2, 2]
    P[base, base] += 2.0 * v0 * h0 + v0 * v0 * var
    P[base + 1, base] += v0 * h1 + v1 * h0 + v0 * v1 * var
    P[base + 1, base + 1] += 2.0 * v1 * h1 + v1 * v1 * var
    for r in range(base):
        weight = at(P, r, 2)
        P[base, r] += v0 * weight
        P[base + 1, r] += v1 * weight
    for r in range(base + 2, dim):
        P[r, base] += v0 * P[r, 2]
        P[r, base + 1] += v1 * P[r, 2]


@jit
def project_rows(T: Array, slots: Array, H_pose: Array, H_point: Array) -> Array:
    """H T (2k, w) for rows ordered as the state is."""
    k, w = slots.shape[0], T.shape[1]
    out = np.empty((2 * k, w))
    for i in range(k):
        base = 3 + 2 * slots[i]
        for u in range(2):
            a, b, c = H_pose[i, u, 0], H_pose[i, u, 1], H_pose[i, u, 2]
            d, e = H_point[i, u, 0], H_point[i, u, 1]
            for j in range(w):
                out[2 * i + u, j] = a * T[0, j] + b * T[1, j] + c * T[2, j] + d * T[base, j] + e * T[base + 1, j]
    return out


@jit
def forward_rows(L: Array, B: Array) -> None:
    """B <- L^-1 B in place."""
    for i in range(L.shape[0]):
        for k in range(i):
            factor = L[i, k]
            for j in range(B.shape[1]):
                B[i, j] -= factor * B[k, j]
        for j in range(B.shape[1]):
            B[i, j] /= L[i, i]
