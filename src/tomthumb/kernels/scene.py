"""What an associator is given, made ready in few calls: gains, candidates, and the rigid motion that errors share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LEAST, MOST = 1e-6, 1.0 - 1e-4  # a detection's chance is taken between these
FLOOR = 1e-12  # m2, of a landmark's own covariance: rounding may have left it a little below zero
CHECKED = 64  # predictions on which the motion of the pose is fitted, at most


@jit
def log_odds(n: int, visible: Array, exist: Array) -> Array:
    """log P_D / (1 - P_D) of each prediction (n,), P_D = detection x existence; either of size 0: .95, and 1."""
    odds = np.empty(n)
    for j in range(n):
        chance = (visible[j] if visible.size else 0.95) * (exist[j] if exist.size else 1.0)
        chance = min(max(chance, LEAST), MOST)
        odds[j] = math.log(chance / (1.0 - chance))
    return odds


@jit
def own_gains(z: Array, clutter: Array, z_hat: Array, odds: Array, bearing: bool) -> Array:
    """-log lambda0 of each observation (m,): `clutter` (m,) as told, and less where the scan speaks against it.

    False ones cannot be denser than all m over the box that they fill. And where they are to be expected all over that box,
    or only where landmarks are (odds (n,) of each prediction, of size 0: not known), is weighed by how many there are: the
    box of the predictions (n, 2) may be far smaller, under a pose that is uncertain by more than the view is deep.
    """
    m, n, sides = z.shape[0], z_hat.shape[0], _box(z, bearing)[1]
    area, rates = sides[0] * sides[1], clutter.copy()
    if m >= 4 and n >= 2 and odds.size:
        corner, view = _box(z_hat, bearing)
        centre, view = corner + 0.5 * view, view * (n + 1.0) / (n - 1.0)  # n points fill so much less than their box
        told = clutter.sum() / m
        there = min(_excess(m, told * area, odds) - _excess(m, told * view[0] * view[1], odds), 700.0)
        for i in range(m):
            x, y = z[i, 0] - centre[0], z[i, 1] - centre[1]
            if bearing:
                y = (y + math.pi) % (2.0 * math.pi) - math.pi
            outside = abs(x) > 0.5 * view[0] or abs(y) > 0.5 * view[1]
            if outside and view[0] * view[1] < area and there > 0.0:
                rates[i] *= math.exp(-there)
    if m >= 4 and area > 0.0:
        rates = np.minimum(rates, m / area)
    return -np.log(rates)


@jit
def _box(z: Array, bearing: bool) -> tuple[Array, Array]:
    """Lowest corner (2,) and sides (2,) of the box that points (k, 2) fill; a bearing's side is a turn at most."""
    low, wide = np.zeros(2), np.zeros(2)
    for c in range(2):
        if z.shape[0]:
            low[c] = z[:, c].min()
            wide[c] = z[:, c].max() - low[c]
    if bearing:
        wide[1] = min(wide[1], 2.0 * math.pi)
    return low, wide


@jit
def _excess(m: int, false: float, odds: Array) -> float:
    """What m observations say against `false` expected beside the detections, nats; 0 where they are no fewer."""
    expected, variance = false, false
    for j in range(odds.shape[0]):
        chance = 1.0 / (1.0 + math.exp(-odds[j]))
        expected += chance
        variance += chance * (1.0 - chance)
    return 0.5 * max(expected - m, 0.0) ** 2 / variance


@jit
def candidates(d2: Array, gate2: float) -> tuple[Array, Array]:
    """Landmarks with d2 (m, n) below gate2, nearest first: those of i are columns[start[i]:start[i + 1]]."""
    m, n = d2.shape
    start, count = np.zeros(m + 1, np.int64), 0
    for i in range(m):
        for j in range(n):
            count += d2[i, j] < gate2
        start[i + 1] = count
    columns, count = np.empty(count, np.int64), 0
    for i in range(m):
        for j in range(n):
            if d2[i, j] < gate2:
                columns[count] = j
                count += 1
        mine = columns[start[i] : count].copy()
        if mine.shape[0] > 1:
            columns[start[i] : count] = mine[np.argsort(d2[i][mine], kind="mergesort")]
    return start, columns


@jit
def points_of(z: Array, polar: bool) -> tuple[Array, Array]:
    """Points (k, 2) of observations and the Jacobian (k, 2, 2) by z: as they are, or from range and bearing."""
    k = z.shape[0]
    q, T = np.empty((k, 2)), np.empty((k, 2, 2))
    for i in range(k):
        if polar:
            r, c, s = z[i, 0], math.cos(z[i, 1]), math.sin(z[i, 1])
            q[i, 0], q[i, 1] = r * c, r * s
            T[i, 0, 0], T[i, 0, 1], T[i, 1, 0], T[i, 1, 1] = c, -r * s, s, r * c
        else:
            q[i, 0], q[i, 1] = z[i, 0], z[i, 1]
            T[i, 0, 0], T[i, 0, 1], T[i, 1, 0], T[i, 1, 1] = 1.0, 0.0, 0.0, 1.0
    return q, T


@jit
def decomposed(
    z: Array, R: Array, z_hat: Array, cov: Array, pose_cov: Array, cross: Array, polar: bool, most: int, remainder: float
) -> tuple[bool, Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """C = B Xi B' + blockdiag(D), B_j = [I | J p_j]: whether the covariance is that, and q, R, p, D, Xi, Xi^-1, log |det dq/dz|.

    Xi is taken from the pose, G = cross pose_cov^-1 being B times one 3 x 3 matrix if landmarks do not move with it
    (pose_cov (3, 3) and cross (2n, 3), or of size 0), else from the least-squares motion of some points. It is held good
    when, between `most` points, it leaves no more than `remainder` of their own covariance and the noise.
    """
    q, Tq = points_of(z, polar)
    p, Tp = points_of(z_hat, polar)
    n = p.shape[0]
    noise_of, own, area = np.empty_like(R), np.empty((n, 2, 2)), np.empty(q.shape[0])
    noise = 0.0
    for i in range(q.shape[0]):
        _turn(Tq[i], R[i], 0, 0, Tq[i], noise_of[i])
        if polar:
            _bent(q[i], noise_of[i], z[i, 0], Tq[i], R[i, 1, 1])
        noise += (noise_of[i, 0, 0] + noise_of[i, 1, 1]) / q.shape[0]
        area[i] = math.log(max(abs(Tq[i, 0, 0] * Tq[i, 1, 1] - Tq[i, 0, 1] * Tq[i, 1, 0]), 1e-300))
    for j in range(n):
        _turn(Tp[j], cov, 2 * j, 2 * j, Tp[j], own[j])
    some = np.argsort(p[:, 0] ** 2 + p[:, 1] ** 2, kind="mergesort")[:: max(1, n // (4 * most))][:most]
    C, D = _sampled(cov, Tp, some), np.empty_like(own)
    for attempt in range(2):
        if attempt == 0:
            known, Xi = _from_pose(p, Tp, pose_cov, cross)
        else:
            known, Xi = _from_covariance(C, p[some])
        if known and _explained(C, Xi, p[some], noise, remainder) and _left(own, Xi, p, -remainder * noise, D):
            return True, q, noise_of, p, D, Xi, np.linalg.inv(Xi), area
    return False, q, noise_of, p, D, np.zeros((3, 3)), np.zeros((3, 3)), area


@jit
def _sampled(cov: Array, T: Array, some: Array) -> Array:
    """Covariance (s, s, 2, 2) between the sampled predictions, Cartesian."""
    k = some.shape[0]
    C, out = np.empty((k, k, 2, 2)), np.empty((2, 2))
    for a in range(k):
        for b in range(a + 1):
            _turn(T[some[a]], cov, 2 * some[a], 2 * some[b], T[some[b]], out)
            for s in range(2):
                for t in range(2):
                    C[a, b, s, t] = C[b, a, t, s] = out[s, t]
    return C


@jit
def _bent(q: Array, noise: Array, r: float, T: Array, variance: float) -> None:
    """What an arc lies beside its tangent, along the line of sight: r v / 2 on average, r v / sqrt 2 about that.

    v is the variance of the bearing; taken off the point and put into its covariance, in place. Far off with a coarse
    bearing it counts. Reference: D. Lerro, Y. Bar-Shalom, IEEE T-AES 29(3), 1993 (debiased conversion).
    """
    for s in range(2):
        q[s] -= 0.5 * r * variance * T[s, 0]
    more = 0.5 * (r * variance) ** 2
    for s in range(2):
        for t in range(2):
            noise[s, t] += more * T[s, 0] * T[t, 0]


@jit
def _turn(A: Array, M: Array, r: int, c: int, B: Array, out: Array) -> None:
    """out = A M[r:r+2, c:c+2] B'."""
    for s in range(2):
        x = A[s, 0] * M[r, c] + A[s, 1] * M[r + 1, c]
        y = A[s, 0] * M[r, c + 1] + A[s, 1] * M[r + 1, c + 1]
        for t in range(2):
            out[s, t] = x * B[t, 0] + y * B[t, 1]


@jit
def _lever(p: Array, Xi: Array, other: Array) -> tuple[float, float, float, float]:
    """B_p Xi B_other' by rows, B = [I | (-y, x)']: what a common motion makes of two points."""
    a0, a1, a2 = Xi[0, 0] - p[1] * Xi[2, 0], Xi[0, 1] - p[1] * Xi[2, 1], Xi[0, 2] - p[1] * Xi[2, 2]
    b0, b1, b2 = Xi[1, 0] + p[0] * Xi[2, 0], Xi[1, 1] + p[0] * Xi[2, 1], Xi[1, 2] + p[0] * Xi[2, 2]
    x, y = other[0], other[1]
    return a0 - y * a2, a1 + x * a2, b0 - y * b2, b1 + x * b2


@jit
def _least_squares(p: Array) -> tuple[bool, Array]:
    """(B'B)^-1 of points (k, 2); False where they do not fix a motion."""
    k, x, y, square = p.shape[0], p[:, 0].sum(), p[:, 1].sum(), (p**2).sum()
    spread = square - (x * x + y * y) / max(k, 1)
    if not spread > 1e-12 * (1.0 + square):
        return False, np.zeros((3, 3))
    out = np.empty((3, 3))  # the turn about the centre, and the shift of the centre, are independent
    out[2, 2] = 1.0 / spread
    out[0, 2], out[1, 2] = y / k / spread, -x / k / spread
    out[0, 0], out[1, 1] = 1.0 / k + (y / k) ** 2 / spread, 1.0 / k + (x / k) ** 2 / spread
    out[0, 1] = -x * y / (k * k) / spread
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return True, out


@jit
def _from_pose(p: Array, T: Array, pose_cov: Array, cross: Array) -> tuple[bool, Array]:
    n, Xi = p.shape[0], np.zeros((3, 3))
    if pose_cov.size == 0 or cross.size == 0 or np.linalg.eigvalsh(pose_cov)[0] <= 1e-14:
        return False, Xi
    some = np.linspace(0, n - 1, min(n, CHECKED)).astype(np.int64)
    good, inner = _least_squares(p[some])
    back = np.linalg.inv(pose_cov)
    right = np.zeros((3, 3))  # B' G, before the division by pose_cov
    for j in some:
        for c in range(3):
            x = T[j, 0, 0] * cross[2 * j, c] + T[j, 0, 1] * cross[2 * j + 1, c]
            y = T[j, 1, 0] * cross[2 * j, c] + T[j, 1, 1] * cross[2 * j + 1, c]
            right[0, c] += x
            right[1, c] += y
            right[2, c] += -p[j, 1] * x + p[j, 0] * y
    # M = (B'B)^-1 B'G and Xi = M pose_cov M', with G = T cross pose_cov^-1
    N = _product(inner, right)
    Xi = _product(_product(N, back), N.T.copy())
    return good and _regular(Xi), Xi


@jit
def _regular(Xi: Array) -> bool:
    """Whether the motion is uncertain in all its directions; whatever the units."""
    a, b, c, d, e, f = Xi[0, 0], Xi[1, 0], Xi[1, 1], Xi[2, 0], Xi[2, 1], Xi[2, 2]
    return bool(a * (c * f - e * e) - b * (b * f - d * e) + d * (b * e - c * d) > 1e-12 * a * c * f)


@jit
def _from_covariance(C: Array, p: Array) -> tuple[bool, Array]:
    """Xi as the covariance of the least-squares motion of the sampled points."""
    good, inner = _least_squares(p)
    middle = np.zeros((3, 3))  # B' C B
    for a in range(p.shape[0]):
        for b in range(p.shape[0]):
            c = C[a, b]
            turn_a = np.array([-p[a, 1] * c[0, 0] + p[a, 0] * c[1, 0], -p[a, 1] * c[0, 1] + p[a, 0] * c[1, 1]])
            middle[:2, :2] += c
            middle[2, 0] += turn_a[0]
            middle[2, 1] += turn_a[1]
            middle[0, 2] += -c[0, 0] * p[b, 1] + c[0, 1] * p[b, 0]
            middle[1, 2] += -c[1, 0] * p[b, 1] + c[1, 1] * p[b, 0]
            middle[2, 2] += -turn_a[0] * p[b, 1] + turn_a[1] * p[b, 0]
    Xi = _product(_product(inner, middle), inner)
    return good and np.linalg.eigvalsh(Xi)[0] > 0.0, Xi


@jit
def _product(A: Array, B: Array) -> Array:
    out = np.zeros((3, 3))
    for r in range(3):
        for c in range(3):
            out[r, c] = A[r, 0] * B[0, c] + A[r, 1] * B[1, c] + A[r, 2] * B[2, c]
    return out


@jit
def _explained(C: Array, Xi: Array, p: Array, noise: float, remainder: float) -> bool:
    """True when what the motion leaves over, between any two of the points, is little beside what is their own."""
    k = p.shape[0]
    own = np.empty(k)
    for a in range(k):
        m00, _, _, m11 = _lever(p[a], Xi, p[a])
        own[a] = max(C[a, a, 0, 0] - m00 + C[a, a, 1, 1] - m11, 0.0)
    for a in range(k):
        for b in range(a):
            m00, m01, m10, m11 = _lever(p[a], Xi, p[b])
            apart = abs(C[a, b, 0, 0] - m00) + abs(C[a, b, 0, 1] - m01)
            apart += abs(C[a, b, 1, 0] - m10) + abs(C[a, b, 1, 1] - m11)
            if not apart <= remainder * (own[a] + own[b] + 2.0 * noise):
                return False
    return True


@jit
def _left(own: Array, Xi: Array, p: Array, lowest: float, D: Array) -> bool:
    """D (n, 2, 2) = own - B Xi B', in place, no eigenvalue below FLOOR; False when one is not above `lowest`."""
    for j in range(own.shape[0]):
        m00, m01, m10, m11 = _lever(p[j], Xi, p[j])
        a, d = own[j, 0, 0] - m00, own[j, 1, 1] - m11
        b = 0.5 * (own[j, 0, 1] - m01 + own[j, 1, 0] - m10)
        half = math.sqrt(0.25 * (a - d) ** 2 + b * b)
        small, large = 0.5 * (a + d) - half, 0.5 * (a + d) + half
        if not small > lowest:
            return False
        if large <= FLOOR:
            a, b, d = FLOOR, 0.0, FLOOR
        elif small < FLOOR:  # the small eigenvalue is lifted, along its own direction
            lift = (FLOOR - small) / (small - large)
            a, b, d = a + lift * (a - large), b + lift * b, d + lift * (d - large)
        D[j, 0, 0], D[j, 0, 1], D[j, 1, 0], D[j, 1, 1] = a, b, b, d
    return True
