"""Why one observation was named as it was: what the pairing gains, the gates it passes, and what came second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from tomthumb.errors import TomThumbError
from tomthumb.gains import base_table
from tomthumb.kernels import posterior
from tomthumb.kernels.left_out import left_out_gains
from tomthumb.types import Array, Association, AssociationProblem, Ids


@dataclass(frozen=True, slots=True)
class Explanation:
    """One decision of an association. Gates are the narrowest (probabilities) that let the pairing through.

    landmark: column of the predictions, or -1; gain: growth of the joint posterior L by the pairing, nats, given all
    the other pairings (0 unpaired); d2, gate: of the pairing by itself; conditional_d2, conditional_gate: given the
    others; joint_d2, joint_gate: of the whole hypothesis. All but the joint ones are NaN for an unpaired observation.
    runner_up: the column of the next best partner that no other observation holds, or -1 for staying unpaired, and its
    gain. evidence: nats of the gain that are due to labels and signature; confidence: the associator's own, NaN unknown.
    """

    observation: int
    landmark: int
    gain: float
    d2: float
    gate: float
    conditional_d2: float
    conditional_gate: float
    joint_d2: float
    joint_gate: float
    runner_up: int
    runner_up_gain: float
    evidence: float = 0.0
    confidence: float = np.nan

    @property
    def lead(self) -> float:
        """Nats by which the decision beats the runner-up; negative where another would have been more probable."""
        return self.gain - self.runner_up_gain

    def __str__(self) -> str:
        second = "staying unpaired" if self.runner_up < 0 else f"landmark {self.runner_up}"
        after = f"; next comes {second} ({self.runner_up_gain:+.2f} nats), {self.lead:.2f} nats behind"
        if self.landmark < 0 and self.runner_up < 0:
            after = "; no landmark is free"
        whole = f"; the whole scan passes a joint gate of {self.joint_gate:.6g} (d2 {self.joint_d2:.2f})"
        sure = "" if np.isnan(self.confidence) else f" ({100 * self.confidence:.2f} % sure)"
        if self.landmark < 0:
            return f"observation {self.observation} is unpaired{sure}{after}{whole}"
        looks = f" ({self.evidence:+.2f} for its looks)" if self.evidence else ""
        return (
            f"observation {self.observation} is landmark {self.landmark}{sure}: gain {self.gain:+.2f} nats{looks}, by itself gate "
            f"{self.gate:.6g} (d2 {self.d2:.2f}), given the others {self.conditional_gate:.6g} "
            f"(d2 {self.conditional_d2:.2f}){after}{whole}"
        )


def explain(problem: AssociationProblem, association: Association | Ids, i: int) -> Explanation:
    """Explains observation `i` of an association (or of a match (m,)) by the joint posterior, whoever made it.

    Raises `TomThumbError` when the problem has no observation i, or the match is not one of this problem.
    """
    match = np.asarray(association.match if isinstance(association, Association) else association, np.int64)
    m, n = problem.shape
    if match.shape != (m,) or ((match < -1) | (match >= n)).any():
        raise TomThumbError(
            f"match has {match.shape[0]} entries up to {match.max(initial=-1)}; the problem is {m} x {n}"
        )
    if not 0 <= i < m:
        raise TomThumbError(f"observation {i} does not exist; valid: 0 to {m - 1}")
    given = problem.innovation, np.ascontiguousarray(problem.predictions.cov), problem.R, base_table(problem)
    joint_d2, pairs = posterior.value_of(match, *given)[1:]
    j = int(match[i])
    gain, alone, conditional = (0.0, np.nan, np.nan) if j < 0 else _pairing(problem, match, i, given)
    second, second_gain = _runner_up(problem, match, i, given)
    return Explanation(
        i, j, gain, alone, _gate(alone, 1), conditional, _gate(conditional, 1), joint_d2, _gate(joint_d2, pairs),
        second, second_gain,
        0.0 if j < 0 or problem.evidence is None else float(problem.evidence[i, j]), _confidence(association, i),
    )  # fmt: skip


def _confidence(association: Association | Ids, i: int) -> float:
    known = isinstance(association, Association) and association.confidence is not None
    return float(association.confidence[i]) if known else np.nan  # type: ignore[union-attr,index]


Given = tuple[Array, Array, Array, Array]


def _pairing(problem: AssociationProblem, match: Ids, i: int, given: Given) -> tuple[float, float, float]:
    """What the pairing of i adds to L, its own d2, and what it adds to the joint d2."""
    without = match.copy()
    without[i] = -1
    (value, d2, _), (less, rest, _) = posterior.value_of(match, *given), posterior.value_of(without, *given)
    return value - less, float(problem.weighed_d2[i, match[i]]), d2 - rest


def _runner_up(problem: AssociationProblem, match: Ids, i: int, given: Given) -> tuple[int, float]:
    """The best other partner of i that is free and allowed, and its gain; staying unpaired (-1, 0) counts as one."""
    free = np.isfinite(problem.weighed_d2[i])
    free[match[match >= 0]] = False  # held by others, or by i itself
    columns = np.flatnonzero(free).astype(np.int64)
    start = np.zeros(len(match) + 1, np.int64)
    start[i + 1 :] = len(columns)
    gains = left_out_gains(match, *given, start, columns)
    best = int(gains.argmax()) if len(columns) else -1
    if best < 0 or (match[i] >= 0 and gains[best] <= 0.0):
        return -1, 0.0
    return int(columns[best]), float(gains[best])


def _gate(d2: float, pairs: int) -> float:
    """The chi-square probability of 2 * pairs degrees of freedom that d2 just fills."""
    return float(gammainc(pairs, 0.5 * d2)) if pairs else 0.0
