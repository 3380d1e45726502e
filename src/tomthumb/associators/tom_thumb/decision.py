"""From hypotheses to a decision: the most probable partner of each observation over all of them, one to one."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from tomthumb.associators.tom_thumb.basins import Basin
from tomthumb.associators.tom_thumb.scene import Rigid
from tomthumb.kernels import marginals, motion
from tomthumb.protocols import Rng
from tomthumb.types import Array, Association, Ids

ROUNDS = 50  # of belief propagation, at most
WIDER = 1.5  # poses are drawn from each basin's Gaussian, so many times wider: a weight must not explode in the tails


def mixed_marginals(found: list[Basin], n: int) -> tuple[Array, Array]:
    """Probability of each pairing (m, n) and of staying unpaired (m,), over all basins, each by its weight."""
    if len(found) == 1:
        near, gains = found[0].window, found[0].gains
        alone: tuple[Array, Array] = marginals.spread_out(gains, near.start, near.columns, n, ROUNDS)
        return alone
    values = np.array([b.value for b in found])
    weights = np.exp(values - values.max())
    weights /= weights.sum()
    m = len(found[0].match)
    p, none = np.zeros((m, n)), np.zeros(m)
    for basin, weight in zip(found, weights, strict=True):
        if weight >= 1e-4:
            near = basin.window
            marginals.add_marginals(p, none, weight, basin.gains, near.start, near.columns, ROUNDS)
    return p, none


def sampled_marginals(
    found: list[Basin], s: Rigid, samples: int, gate2: float, rng: Rng
) -> tuple[Array, Array]:  # fmt: skip
    """The same with the pose integrated out by importance sampling: given the pose, the pairings are independent.

    `samples` poses are drawn around each basin's, from a mixture of the basins' Gaussians, widened; each is weighed by
    its prior times the sum over all assignments (Bethe), divided by the mixture's density (deterministic mixture weights).
    """
    centres, Ms = np.array([b.pose for b in found]), np.array([b.M for b in found])
    starts = np.array([b.window.start for b in found])
    offsets = np.concatenate([[0], np.cumsum(starts[:, -1])])
    columns = np.concatenate([b.window.columns for b in found])
    args = (s.q, s.R, s.p, s.D, s.base, s.odds)
    looks = np.concatenate([s.of_looks(b.window) for b in found])
    gains = looks + np.concatenate(
        [
            motion.pose_gains(b.pose, P, *args, b.window.start, b.window.columns, np.inf)
            for b, P in zip(found, np.linalg.inv(Ms), strict=True)
        ]
    )
    steps = rng.standard_normal((len(found), samples, 3))
    p, none = marginals.integrated(
        steps, centres, Ms, WIDER, starts, offsets, columns, gains, looks, *args, s.prior, gate2
    )
    return p, none


def most_probable(p: Array, none: Array, least: float) -> tuple[Ids, Array]:
    """The one-to-one assignment that maximises the expected number of right decisions, and each decision's chance (m,)."""
    match, chance, free = marginals.pick(p, none, least)
    if free:
        return match, chance
    match = np.full(len(p), -1, np.int64)
    columns = np.flatnonzero((p > max(least, 1e-3)).any(0))
    gain = np.where(p[:, columns] > least, p[:, columns] - none[:, None], 0.0)
    rows, picked = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
    good = gain[rows, picked] > 0.0
    match[rows[good]] = columns[picked[good]]
    return match, chances(match, p, none)


def chances(match: Ids, p: Array, none: Array) -> Array:
    """Probability (m,) of each decision of a match."""
    chance: Array = np.where(match >= 0, p[np.arange(len(match)), np.maximum(match, 0)], none)
    return chance


def beside(first: Association, others: list[Basin], ambiguity: float, most: int) -> list[Association]:
    """Brothers of a decision, `most` of them within `ambiguity` nats, to be carried on until later scans decide.

    The decision need not be the best hypothesis: where that is among the others, it comes after it.
    """
    best = first.log_weight
    near = [b for b in others if b.value > best - ambiguity and not np.array_equal(b.match, first.match)]
    return [Association(b.match, min(b.value, best), {"brother": k + 1}) for k, b in enumerate(near[:most])]
