"""What a pairing gains before any distance counts: log P_D / (1 - P_D) - log lambda0, and what things look like."""

from __future__ import annotations

import numpy as np

from tomthumb.kernels import scene as kernel
from tomthumb.types import Array, AssociationProblem

UNKNOWN = np.empty(0)


def log_odds(problem: AssociationProblem) -> Array:
    """log P_D / (1 - P_D) of each prediction (n,), P_D = probability of existence and detection."""
    p = problem.predictions
    visible, exist = (UNKNOWN if chance is None else chance for chance in (p.visible, p.exist))
    odds: Array = kernel.log_odds(len(p), visible, exist)
    return odds


def base_gains(problem: AssociationProblem, prior: Array | None) -> tuple[Array, Array]:
    """(m,) -log lambda0 of each observation and (n,) log odds of detection plus the memory's prior, in z's units."""
    odds = log_odds(problem)
    known = odds if problem.predictions.visible is not None else UNKNOWN
    own = kernel.own_gains(problem.z, problem.clutter, problem.predictions.z_hat, known, bool(problem.angles))
    return own, odds if prior is None else odds + prior


def weighed(gains: Array, evidence: Array | None) -> Array:
    """Gains (m, n) with the evidence of what observations and landmarks look like, where there is any."""
    return gains if evidence is None else gains + evidence


def base_table(problem: AssociationProblem) -> Array:
    """Base gain (m, n) of each pairing: log P_D / (1 - P_D) - log lambda0 + evidence."""
    base, odds = base_gains(problem, None)
    return weighed(base[:, None] + odds[None], problem.evidence)
