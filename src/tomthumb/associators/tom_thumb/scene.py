"""What the family sees: base gains, candidates from the window, and the rigid motion that the predictions' errors share.

Cartesian quantities are in the sensor's frame: q observed, p predicted. Where the covariance of the predictions is a
common rigid motion plus an own error of each landmark, C = B Xi B' + blockdiag(D), B_j = [I | J p_j], the landmarks are
independent given the motion, and large motions need no linearisation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tomthumb.kernels import arcs
from tomthumb.kernels import scene as kernel
from tomthumb.types import Array, AssociationProblem, Ids, Mask

SAMPLE = 16  # predictions on which the common motion is fitted and checked
REMAINDER = 0.1  # covariance between landmarks left over by the motion, relative to their own and the noise
LOOSE = 10.0  # the same where a linearised covariance would be wrong by more than that, and what is found is looked at again
NOTHING = np.empty((0, 0))
NO_LABELS: Mask = np.empty((0, 0), np.bool_)


@dataclass(frozen=True, slots=True)
class Window:
    """Candidates of observation i: `columns[start[i]:start[i + 1]]`, nearest first."""

    start: Ids
    columns: Ids

    @property
    def counts(self) -> Ids:
        """Number of candidates of each observation (m,)."""
        return self.start[1:] - self.start[:-1]


@dataclass(frozen=True, slots=True)
class Rigid:
    """The problem in the sensor's plane: q (m, 2), R (m, 2, 2), p (n, 2), D (n, 2, 2), Xi (3, 3); base (m,), odds (n,).

    prior (3, 3) is the inverse of Xi; allowed (m, n): pairings that neither labels nor the gates of looks rule out, or None where
    nothing is. evidence (m, n): what is added to the gains of pairings for their looks, or None.
    """

    q: Array
    R: Array
    p: Array
    D: Array
    Xi: Array
    base: Array
    odds: Array
    prior: Array
    allowed: Mask | None = None
    evidence: Array | None = None

    def of_looks(self, near: Window) -> Array:
        """Evidence of the pairings that are listed, (k,)."""
        if self.evidence is None:
            return np.zeros(len(near.columns))
        listed: Array = self.evidence[np.repeat(np.arange(len(self.q)), near.counts), near.columns]
        return listed

    def of_match(self, match: Ids) -> float:
        """Evidence of the pairings of a match (m,), together."""
        rows = np.flatnonzero(match >= 0)
        return 0.0 if self.evidence is None else float(self.evidence[rows, match[rows]].sum())


def gate_of_two(gate: float) -> float:
    """The chi-square value of a gate, 2 degrees of freedom."""
    return -2.0 * math.log1p(-gate)


def window(d2: Array, gate: float) -> Window:
    """Every landmark within `gate` of each observation, nearest first."""
    return Window(*kernel.candidates(d2, gate_of_two(gate)))


def curved_window(s: Rigid, gate: float) -> Window:
    """Every landmark within `gate` of each observation, nearest first, by the best motion of each pairing: not linearised."""
    allowed = NO_LABELS if s.allowed is None else s.allowed
    return Window(*arcs.by_itself(s.q, s.R, s.p, s.D, s.Xi, gate_of_two(gate), allowed))


def cartesian(z: Array, angles: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Points (k, 2) of observations and the Jacobian (k, 2, 2) by z; None when z is not a point in a plane we know."""
    if angles not in ((), (1,)):
        return None
    points: tuple[Array, Array] = kernel.points_of(z, bool(angles))
    return points


def rigid(problem: AssociationProblem, base: Array, odds: Array, remainder: float = REMAINDER) -> Rigid | None:
    """The problem as one rigid motion and independent landmarks, or None where that is not what the covariance says."""
    given = problem.predictions
    if problem.angles not in ((), (1,)) or len(given) < 3:
        return None
    pose_cov = NOTHING if given.pose_cov is None else np.ascontiguousarray(given.pose_cov)
    cross = NOTHING if given.cross is None else np.ascontiguousarray(given.cross)
    good, q, R, p, D, Xi, prior, area = kernel.decomposed(
        problem.z, problem.R, given.z_hat, np.ascontiguousarray(given.cov), pose_cov, cross, bool(problem.angles),
        SAMPLE, remainder,
    )  # fmt: skip
    if not good:
        return None
    ruled_out = problem.allowed is not None or problem.barred is not None
    allowed = np.isfinite(problem.weighed_d2) if ruled_out else None
    return Rigid(q, R, p, D, Xi, base + area, odds, prior, allowed, problem.evidence)


def lever(p: Array) -> Array:
    """B (k, 2, 3): how a small motion (tx, ty, theta) moves each point."""
    B = np.zeros((len(p), 2, 3))
    B[:, 0, 0] = B[:, 1, 1] = 1.0
    B[:, 0, 2], B[:, 1, 2] = -p[:, 1], p[:, 0]
    return B
