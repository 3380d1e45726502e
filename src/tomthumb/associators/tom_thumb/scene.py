"""What the family sees: base gains, candidates from the window, and the rigid motion that the predictions' errors share.

Cartesian quantities are in the sensor's frame: q observed, p predicted. Where the covariance of the predictions is a
common rigid motion plus an own error of each landmark, C = B Xi B' + blockdiag(D), B_j = [I | J p_j], the landmarks are
independent given the motion, and large motions need no linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from tomthumb.associators.nearest import log_odds
from tomthumb.types import Array, AssociationProblem, Ids, Mask

SAMPLE = 16  # predictions on which the common motion is fitted and checked
REMAINDER = 0.1  # covariance between landmarks left over by the motion, relative to their own and the noise


@dataclass(frozen=True, slots=True)
class Window:
    """Candidates of observation i: `columns[start[i]:start[i + 1]]`, nearest first."""

    start: Ids
    columns: Ids

    @property
    def counts(self) -> Ids:
        """Number of candidates of each observation (m,)."""
        return np.diff(self.start)


@dataclass(frozen=True, slots=True)
class Rigid:
    """The problem in the sensor's plane: q (m, 2), R (m, 2, 2), p (n, 2), D (n, 2, 2), Xi (3, 3); base (m,), odds (n,).

    allowed (m, n): pairings whose labels do not contradict each other, or None without labels. evidence (m, n): what is
    added to the gains of pairings for their looks, or None.
    """

    q: Array
    R: Array
    p: Array
    D: Array
    Xi: Array
    base: Array
    odds: Array
    allowed: Mask | None = None
    evidence: Array | None = None

    def of_looks(self, near: Window) -> Array | float:
        """Evidence of the pairings that are listed."""
        if self.evidence is None:
            return 0.0
        listed: Array = self.evidence[np.repeat(np.arange(len(self.q)), near.counts), near.columns]
        return listed

    def of_match(self, match: Ids) -> float:
        """Evidence of the pairings of a match (m,), together."""
        rows = np.flatnonzero(match >= 0)
        return 0.0 if self.evidence is None else float(self.evidence[rows, match[rows]].sum())


def base_gains(problem: AssociationProblem, prior: Array | None) -> tuple[Array, Array]:
    """(m,) -log lambda0 of each observation and (n,) log odds of detection plus the memory's prior, in z's units."""
    odds = log_odds(problem)
    density = np.minimum(problem.clutter, _observed_density(problem.z, problem.angles))
    return -np.log(density), odds if prior is None else odds + prior


def weighed(gains: Array, evidence: Array | None) -> Array:
    """Gains (m, n) with the evidence of what observations and landmarks look like, where there is any."""
    return gains if evidence is None else gains + evidence


def base_table(problem: AssociationProblem) -> Array:
    """Base gain (m, n) of each pairing: log P_D / (1 - P_D) - log lambda0 + evidence."""
    base, odds = base_gains(problem, None)
    return weighed(base[:, None] + odds[None], problem.evidence)


def _observed_density(z: Array, angles: tuple[int, ...]) -> float:
    """Observations per unit of z over the box they fill: false ones cannot be denser than all of them."""
    span = np.ptp(z, axis=0)
    if angles or len(z) < 4 or not span.all():
        span = np.array([span[0], min(span[1], 2.0 * np.pi)])
    area = float(span[0] * span[1])
    return len(z) / area if len(z) >= 4 and area > 0.0 else np.inf


def window(d2: Array, gate: float) -> Window:
    """Every landmark within `gate` of each observation, nearest first."""
    inside = d2 < chdtri(2, 1.0 - gate)
    counts = inside.sum(1)
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rows, columns = np.nonzero(inside)
    order = np.lexsort((d2[rows, columns], rows))
    return Window(start, columns[order].astype(np.int64))


def permitted(start: Ids, columns: Ids, allowed: Mask | None) -> Window:
    """The candidates that labels do not exclude."""
    if allowed is None:
        return Window(start, columns)
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    keep = allowed[rows, columns]
    counts = np.bincount(rows[keep], minlength=len(start) - 1)
    return Window(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), columns[keep])


def cartesian(z: Array, angles: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Points (k, 2) of observations and the Jacobian (k, 2, 2) by z; None when z is not a point in a plane we know."""
    if angles == ():
        return z, np.tile(np.eye(2), (len(z), 1, 1))
    if angles != (1,):
        return None
    c, s, r = np.cos(z[:, 1]), np.sin(z[:, 1]), z[:, 0]
    T = np.stack([np.stack([c, -r * s], -1), np.stack([s, r * c], -1)], -2)
    return np.column_stack([r * c, r * s]), T


def rigid(problem: AssociationProblem, base: Array, odds: Array) -> Rigid | None:
    """The problem as one rigid motion and independent landmarks, or None where that is not what the covariance says."""
    seen, expected = cartesian(problem.z, problem.angles), cartesian(problem.predictions.z_hat, problem.angles)
    if seen is None or expected is None or len(problem.predictions) < 3:
        return None
    (q, Tq), (p, Tp) = seen, expected
    R = Tq @ problem.R @ Tq.transpose(0, 2, 1)
    own = Tp @ problem.blocks @ Tp.transpose(0, 2, 1)
    sample = np.argsort((p * p).sum(1), kind="stable")[:: max(1, len(p) // (4 * SAMPLE))][:SAMPLE]
    C = _sampled(problem.predictions.cov, Tp, sample)
    noise = float(np.trace(R.mean(0)))
    for Xi in (_from_pose(problem, p, Tp), _from_covariance(C, p[sample])):
        if Xi is None:
            continue
        B = lever(p)
        D = own - B @ Xi @ B.transpose(0, 2, 1)
        if _explained(C, Xi, p[sample], noise) and (np.linalg.eigvalsh(D)[:, 0] > -REMAINDER * noise).all():
            area = np.abs(np.linalg.det(Tq))
            return Rigid(q, R, p, _floored(D), Xi, base + np.log(area), odds, problem.allowed, problem.evidence)
    return None


def lever(p: Array) -> Array:
    """B (k, 2, 3): how a small motion (tx, ty, theta) moves each point."""
    B = np.zeros((len(p), 2, 3))
    B[:, 0, 0] = B[:, 1, 1] = 1.0
    B[:, 0, 2], B[:, 1, 2] = -p[:, 1], p[:, 0]
    return B


def _sampled(cov: Array, T: Array, sample: Ids) -> Array:
    """Covariance (2s, 2s) of the sampled predictions, Cartesian."""
    rows = (2 * sample[:, None] + np.arange(2)).ravel()
    C = cov[np.ix_(rows, rows)].reshape(len(sample), 2, len(sample), 2)
    turned: Array = np.einsum("aij,ajbk,blk->aibl", T[sample], C, T[sample])
    return turned.reshape(len(rows), len(rows))


def _from_pose(problem: AssociationProblem, p: Array, T: Array) -> Array | None:
    """Xi from the robot's pose: G = cross pose_cov^-1 is B times one 3 x 3 matrix if the landmarks do not move with it."""
    pose_cov, cross = problem.predictions.pose_cov, problem.predictions.cross
    if pose_cov is None or cross is None or np.linalg.matrix_rank(pose_cov, tol=1e-14) < 3:
        return None
    some = np.linspace(0, len(p) - 1, min(len(p), 4 * SAMPLE)).astype(np.int64)
    G = T[some] @ np.linalg.solve(pose_cov, cross.reshape(-1, 2, 3)[some].transpose(0, 2, 1)).transpose(0, 2, 1)
    M = np.linalg.lstsq(lever(p[some]).reshape(-1, 3), G.reshape(-1, 3), rcond=None)[0]
    Xi: Array = M @ pose_cov @ M.T
    return Xi


def _from_covariance(C: Array, p: Array) -> Array | None:
    """Xi as the covariance of the least-squares motion of the sampled points."""
    fit = np.linalg.pinv(lever(p).reshape(-1, 3))
    Xi: Array = fit @ C @ fit.T
    return Xi if np.linalg.eigvalsh(Xi)[0] > 0.0 else None


def _explained(C: Array, Xi: Array, p: Array, noise: float) -> bool:
    """True when what the motion leaves over is each landmark's own."""
    B = lever(p).reshape(-1, 3)
    rest = (C - B @ Xi @ B.T).reshape(len(p), 2, len(p), 2)
    own = np.einsum("aiai->a", rest)
    apart = np.abs(rest).sum((1, 3))
    np.fill_diagonal(apart, 0.0)
    return bool((apart <= REMAINDER * (np.maximum(own, 0.0)[:, None] + np.maximum(own, 0.0)[None] + 2.0 * noise)).all())


def _floored(D: Array) -> Array:
    """Own covariances made positive semi-definite: rounding may have left them a little below."""
    values, vectors = np.linalg.eigh(D)
    fixed: Array = (vectors * np.maximum(values, 1e-12)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return fixed
