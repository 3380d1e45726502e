"""All hypotheses of a scan that count, listed and summed, where the predictions' errors are the robot's pose and their own.

C = G G' + blkdiag(D): given u (3,), the pose's error made standard normal, pairings are independent. So what a set of them
says about u adds up, L = sum of constants + h' A^-1 h / 2 - log det A / 2 with A = I + sum J' V^-1 J, h = sum J' V^-1 nu, and a
node of the search costs a 3 x 3 system however deep it lies.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

LOG_2PI = math.log(2.0 * math.pi)
PLACED = 3  # observations that tell where the robot is, one of them to spare: the others are looked over from there
LARGE = 12  # observations from which that saves more than it costs
AT_ONCE = 5  # pairings that a look weighs in the time of one node
AGAIN = 3  # levels after which the others are looked over again: each pairing tells the motion better
REMAINDER = 0.05  # covariance of a landmark with all others, beside the pose's, over the noise, that is held to be none


@jit
def listed(
    nu: Array, C: Array, R: Array, base: Array, pose_cov: Array, cross: Array, start: Array, columns: Array, slack: float,
    budget: int,
) -> tuple[bool, Array, Array, Array, float, int]:  # fmt: skip
    """Marginals p (m, n) and none (m,) by summing all hypotheses within `slack` nats of the best; its match, L, and nodes.

    Depth first, observations of few candidates first, the best choice given those before first. `base (m, n)`: base gains;
    cross (2n, 3): covariance of predictions and pose. The first is False where the budget did not suffice (then the sums are
    not what they claim), and where C is not of that form (then nodes are 0).
    """
    m, n = base.shape
    p, none, best, most = np.zeros((m, n)), np.zeros(m), np.full(m, -1, np.int64), -np.inf
    order = np.argsort(start[1:] - start[:-1], kind="mergesort")
    G = _levers(pose_cov, cross)
    good, told, V, worth = _forms(nu, C, R, base, G, start, columns)
    if not good or not _common(C, G, V, columns):
        return False, p, none, best, most, 0
    rest, known, value, loose, sums, choice, gains, at, count = _levels(order, start, worth)
    match, used, form = np.full(m, -1, np.int64), np.zeros(n, np.bool_), _formed(nu, G, V, worth, start, columns)
    ideal, look = np.zeros((m // AGAIN + 1, columns.shape[0] + 1)), np.zeros(m + 1, np.int64)
    s, nodes, first, floor, looked = 0, 0, 0.0, -np.inf, False
    while True:
        if s < m:  # entered from above
            ahead = np.inf
            at[s], sums[s], count[s], look[s] = 0, 0.0, 0, look[s - 1] if s > PLACED else 0
            if m >= LARGE and s >= PLACED and (s - PLACED) % AGAIN == 0 and s + 2 < m:
                looked, look[s], loose[s] = True, (s - PLACED) // AGAIN, value[s]
                nodes += columns.shape[0] // AT_ONCE
                ahead = _looked_over(rest, ideal[look[s]], order, s, known, form, start, columns, used)
                if s == PLACED and value[s] + ahead > floor:
                    _put_in_order(rest, ideal[0], order, s, value[s], known, slack, form, told, start, columns, used)
            i = order[s]
            nodes += start[i + 1] - start[i] + 1
            if nodes > budget:
                return False, p, none, best, most, nodes
            if value[s] + ahead > floor:
                limit, least = floor - rest[0, s + 1], floor - loose[s] - rest[1, s + 1] if looked else -np.inf
                count[s] = _choices(
                    choice, gains, s, i, value[s], known, told, start, columns, used, limit, ideal[look[s]], least
                )
        else:
            first = value[m] if most == -np.inf else first
            if value[m] > most:
                most, floor = value[m], value[m] - slack
                best[:] = match
            sums[m] = math.exp(value[m] - first)
        while True:
            while s == m or at[s] == count[s] or gains[s, at[s]] + rest[0, s + 1] <= floor:
                if s == 0:
                    return True, p / sums[0], none / sums[0], best, most, nodes
                looked = looked and s != PLACED
                s -= 1
                _taken_back(order[s], sums[s + 1], p, none, match, used)
                sums[s] += sums[s + 1]
                at[s] += 1
            c = choice[s, at[s]]
            loose[s + 1] = loose[s] + ideal[look[s], c]  # the last of ideal, 0, is that of nothing, -1
            if not looked or loose[s + 1] + rest[1, s + 1] > floor:
                break
            at[s] += 1
        value[s + 1] = gains[s, at[s]]
        for k in range(10):
            known[s + 1, k] = known[s, k] + (told[c, k] if c >= 0 else 0.0)
        if c >= 0:
            match[order[s]] = columns[c]
            used[columns[c]] = True
        s += 1


@jit
def _taken_back(i: int, weight: float, p: Array, none: Array, match: Array, used: Array) -> None:
    """What observation i was, with all that came of it, has this weight; it is nothing again."""
    if match[i] >= 0:
        p[i, match[i]] += weight
        used[match[i]] = False
    else:
        none[i] += weight
    match[i] = -1


@jit
def _levers(P: Array, cross: Array) -> Array:
    """G (2n, 3) = cross P^-1/2: what a standard normal motion of the pose makes of the predictions.

    Where P (3, 3) is singular, what does not move moves nothing.
    """
    half, G = np.zeros((3, 3)), np.zeros((cross.shape[0], 3))
    for r in range(3):
        for t in range(r + 1):
            left = P[r, t] - half[r, 0] * half[t, 0] - half[r, 1] * half[t, 1]
            if t < r and half[t, t] > 0.0:
                half[r, t] = left / half[t, t]
            elif t == r and left > 1e-12 * P[r, r]:
                half[r, r] = math.sqrt(left)
    for j in range(cross.shape[0]):
        for r in range(3):
            if half[r, r] > 0.0:
                G[j, r] = (cross[j, r] - half[r, 0] * G[j, 0] - half[r, 1] * G[j, 1]) / half[r, r]
    return G


@jit
def _forms(
    nu: Array, C: Array, R: Array, base: Array, G: Array, start: Array, columns: Array
) -> tuple[bool, Array, Array, Array]:
    """What each listed pairing adds: to A (its lower half by rows), h and the constant (k, 10); its V (k, 3) and gain at d2 = 0.

    False where a V is no covariance.
    """
    size = columns.shape[0]
    told, V, worth = np.empty((size, 10)), np.empty((size, 3)), np.empty(size)
    for i in range(start.shape[0] - 1):
        for c in range(start[i], start[i + 1]):
            j = columns[c]
            e, f = 2 * j, 2 * j + 1
            a, b, d = C[e, e] + R[i, 0, 0], C[e, f] + R[i, 0, 1], C[f, f] + R[i, 1, 1]
            for r in range(3):
                a, b, d = a - G[e, r] * G[e, r], b - G[e, r] * G[f, r], d - G[f, r] * G[f, r]
            det = a * d - b * b
            if not (det > 0.0 and a > 0.0):
                return False, told, V, worth
            V[c, 0], V[c, 1], V[c, 2] = a, b, d
            worth[c] = base[i, j] - 0.5 * math.log(det) - LOG_2PI
            x, y = (d * nu[i, j, 0] - b * nu[i, j, 1]) / det, (a * nu[i, j, 1] - b * nu[i, j, 0]) / det
            k = 0
            for r in range(3):
                u, v = (d * G[e, r] - b * G[f, r]) / det, (a * G[f, r] - b * G[e, r]) / det
                for t in range(r + 1):
                    told[c, k] = u * G[e, t] + v * G[f, t]
                    k += 1
                told[c, 6 + r] = G[e, r] * x + G[f, r] * y
            told[c, 9] = worth[c] - 0.5 * (nu[i, j, 0] * x + nu[i, j, 1] * y)
    return True, told, V, worth


@jit
def _common(C: Array, G: Array, V: Array, columns: Array) -> bool:
    """True when G leaves nothing between a listed landmark and all others together that counts beside the noise of a pairing.

    The noise is that of a component given the other, the least of all pairings (V): it decides where it is narrow.
    """
    least, named = np.full(2, np.inf), np.zeros(C.shape[0] // 2, np.bool_)
    for c in range(columns.shape[0]):
        det = V[c, 0] * V[c, 2] - V[c, 1] * V[c, 1]
        least[0], least[1] = min(least[0], det / V[c, 2]), min(least[1], det / V[c, 0])
        named[columns[c]] = True
    some = np.flatnonzero(named)
    for a in some:
        for u in range(2):
            over = 0.0
            for b in some:
                for v in range(2):
                    r, t = 2 * a + u, 2 * b + v
                    left = C[r, t] - G[r, 0] * G[t, 0] - G[r, 1] * G[t, 1] - G[r, 2] * G[t, 2]
                    over += abs(left) / math.sqrt(least[u] * least[v]) if a != b else 0.0
            if over > REMAINDER:
                return False
    return True


@jit
def _levels(
    order: Array, start: Array, worth: Array
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """What is kept of each level s: rest, known, L, a bound of it, sums of weights, choices and their L, the one tried, how many.

    rest[0, s]: what the observations order[s:] could add at perfect fits. known[s]: A (lower half by rows), h and the constant.
    """
    m, width = order.shape[0], 1 + (start[1:] - start[:-1]).max()
    rest, known = np.zeros((2, m + 1)), np.zeros((m + 1, 10))
    known[0, 0], known[0, 2], known[0, 5] = 1.0, 1.0, 1.0
    for s in range(m - 1, -1, -1):
        most = 0.0
        for c in range(start[order[s]], start[order[s] + 1]):
            most = max(most, worth[c])
        rest[0, s] = rest[0, s + 1] + most
    choice, gains = np.empty((m, width), np.int64), np.empty((m, width))
    value, loose, sums = np.zeros(m + 1), np.zeros(m + 1), np.zeros(m + 1)
    return rest, known, value, loose, sums, choice, gains, np.zeros(m, np.int64), np.zeros(m, np.int64)


@jit
def _choices(
    choice: Array, gains: Array, s: int, i: int, value: float, known: Array, told: Array, start: Array, columns: Array,
    used: Array, limit: float, ideal: Array, least: float,
) -> int:  # fmt: skip
    """What observation i can be (c, or -1: nothing), with L then, above `limit`, best first; how many.

    Of what cannot gain more than `least` by its bound, `ideal`, L is not asked for.
    """
    choice[s, 0], gains[s, 0] = -1, value
    count = 1
    for c in range(start[i], start[i + 1]):
        if used[columns[c]] or not ideal[c] > least:
            continue
        gain = _posterior(known, s, told, c)
        if not gain > limit:
            continue
        k = count
        while k > 0 and gains[s, k - 1] < gain:
            choice[s, k], gains[s, k] = choice[s, k - 1], gains[s, k - 1]
            k -= 1
        choice[s, k], gains[s, k] = c, gain
        count += 1
    return count


@jit
def _posterior(known: Array, s: int, told: Array, c: int) -> float:
    """L = constant + h' A^-1 h / 2 - log det A / 2, of what is known at level s and what pairing c adds."""
    a00, a10, a11 = known[s, 0] + told[c, 0], known[s, 1] + told[c, 1], known[s, 2] + told[c, 2]
    a20, a21, a22 = known[s, 3] + told[c, 3], known[s, 4] + told[c, 4], known[s, 5] + told[c, 5]
    y0 = known[s, 6] + told[c, 6]
    r0 = 1.0 / a00
    l10, l20 = a10 * r0, a20 * r0
    d1, e = a11 - l10 * a10, a21 - l20 * a10
    r1 = 1.0 / d1
    l21 = e * r1
    d2 = a22 - l20 * a20 - l21 * e
    y1 = known[s, 7] + told[c, 7] - l10 * y0
    y2 = known[s, 8] + told[c, 8] - l20 * y0 - l21 * y1
    fit = y0 * y0 * r0 + y1 * y1 * r1 + y2 * y2 / d2
    return float(known[s, 9] + told[c, 9] + 0.5 * (fit - math.log(a00 * d1 * d2)))


@jit
def _formed(nu: Array, G: Array, V: Array, worth: Array, start: Array, columns: Array) -> Array:
    """What `_ideals` asks of each listed pairing, in columns (12, k): its two rows of G, nu, V and its gain at d2 = 0."""
    form = np.empty((12, columns.shape[0]))
    for i in range(start.shape[0] - 1):
        for c in range(start[i], start[i + 1]):
            j = columns[c]
            for r in range(3):
                form[r, c], form[3 + r, c], form[8 + r, c] = G[2 * j, r], G[2 * j + 1, r], V[c, r]
            form[6, c], form[7, c], form[11, c] = nu[i, j, 0], nu[i, j, 1], worth[c]
    return form


@jit
def _looked_over(
    rest: Array, ideal: Array, order: Array, s: int, known: Array, form: Array, start: Array, columns: Array, used: Array
) -> float:  # fmt: skip
    """The most that order[s:] can add to the L of level s, now that so many pairings tell the motion.

    ideal: the most that each pairing can gain from here on, for its share of what moving the motion costs; rest[1] after s: sums
    of the best. All of a hypothesis's together bound its L, not those of the open ones after the others' true gains: who came
    first has paid for the motion already. The pairings above s keep the `ideal` of the look that they were bound by.
    """
    _ideals(ideal, known, s, form, order.shape[0] - s)
    ahead = 0.0
    for t in range(order.shape[0] - 1, s - 1, -1):
        i, top = order[t], 0.0
        for c in range(start[i], start[i + 1]):
            if ideal[c] > top and not used[columns[c]]:
                top = ideal[c]
        ahead += top
        if t > s:  # rest[:, s] itself is for the level above, whose other choices leave other landmarks
            rest[1, t] = ahead
    return ahead


@jit
def _put_in_order(
    rest: Array, ideal: Array, order: Array, s: int, value: float, known: Array, slack: float, form: Array, told: Array,
    start: Array, columns: Array, used: Array,
) -> None:  # fmt: skip
    """order[s:], with what follows level s in `rest`, in place: first the observations whose best choice lies farthest below its
    bound, by how many choices they have within `slack`: they settle most at least cost.
    """
    m = order.shape[0]
    urgent, most, perfect, gains = np.empty(m), np.empty(m), np.empty(m), np.empty(columns.shape[0])
    for t in range(s, m):
        i, top, high, best, choices = order[t], 0.0, 0.0, 0.0, 0.0
        for c in range(start[i], start[i + 1]):
            gains[c] = -np.inf
            if not used[columns[c]]:
                gains[c] = _posterior(known, s, told, c) - value
                best, top, high = max(best, gains[c]), max(top, ideal[c]), max(high, form[11, c])
        for c in range(start[i], start[i + 1]):
            choices += gains[c] > best - slack
        urgency, k = (top - best) / (choices + (best < slack)), t
        while k > s and urgent[k - 1] < urgency:
            urgent[k], most[k], perfect[k], order[k] = urgent[k - 1], most[k - 1], perfect[k - 1], order[k - 1]
            k -= 1
        urgent[k], most[k], perfect[k], order[k] = urgency, top, high, i
    rest[1, m] = 0.0
    for t in range(m - 1, s, -1):
        rest[0, t], rest[1, t] = rest[0, t + 1] + perfect[t], rest[1, t + 1] + most[t]


@jit
def _motion(known: Array, s: int) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Mean (3) and covariance (its lower half by rows, 6) of the motion, by what is known at level s."""
    a, b, c, d, e, f = known[s, 0], known[s, 1], known[s, 2], known[s, 3], known[s, 4], known[s, 5]
    u, v, w = known[s, 6], known[s, 7], known[s, 8]
    p, q, r = c * f - e * e, e * d - b * f, b * e - c * d
    det = a * p + b * q + d * r
    p, q, r, g, h, k = p / det, q / det, r / det, (a * f - d * d) / det, (b * d - a * e) / det, (a * c - b * b) / det
    return p * u + q * v + r * w, q * u + g * v + h * w, r * u + h * v + k * w, p, q, g, r, h, k


@jit
def _ideals(ideal: Array, known: Array, s: int, form: Array, shares: int) -> None:
    """What each pairing gains less the least that it costs, where each of so many may move the motion as it likes for its share.

    d2 / 2 under V + shares J U J'; one motion for all cannot cost less than these together. All of them, in place, whether
    open or not: without a question in the loop several are done at once.
    """
    x, y, z, u00, u10, u11, u20, u21, u22 = _motion(known, s)
    u00, u10, u11, u20, u21, u22 = shares * u00, shares * u10, shares * u11, shares * u20, shares * u21, shares * u22
    for c in range(form.shape[1]):
        e0, e1, e2, f0, f1, f2 = form[0, c], form[1, c], form[2, c], form[3, c], form[4, c], form[5, c]
        u, v = form[6, c] - e0 * x - e1 * y - e2 * z, form[7, c] - f0 * x - f1 * y - f2 * z
        p0, q0 = u00 * e0 + u10 * e1 + u20 * e2, u00 * f0 + u10 * f1 + u20 * f2
        p1, q1 = u10 * e0 + u11 * e1 + u21 * e2, u10 * f0 + u11 * f1 + u21 * f2
        p2, q2 = u20 * e0 + u21 * e1 + u22 * e2, u20 * f0 + u21 * f1 + u22 * f2
        a = form[8, c] + e0 * p0 + e1 * p1 + e2 * p2
        b = form[9, c] + e0 * q0 + e1 * q1 + e2 * q2
        d = form[10, c] + f0 * q0 + f1 * q1 + f2 * q2
        ideal[c] = form[11, c] - 0.5 * (d * u * u - 2.0 * b * u * v + a * v * v) / (a * d - b * b)
