"""Was each observation rightly named? By physical identity, and as the reference program counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tomthumb.metrics.lifetimes import Lifetimes, final_lifetimes, final_pairings, online_lifetimes, step_of_observation
from tomthumb.metrics.truth import CLUTTER, UNKNOWN, TruthTable
from tomthumb.types import Ids, Mask, Trace

SKIPPED, TP, TN, FP, FN = range(5)
NAMES = ("skipped", "tp", "tn", "fp", "fn")


@dataclass(frozen=True)
class Decisions:
    """`outcome (M,)` of each observation: SKIPPED, TP, TN, FP or FN; `wrong_id (M,)`: paired with another landmark."""

    outcome: npt.NDArray[np.int8]
    wrong_id: Mask

    def count(self, outcome: int) -> int:
        """How many observations had this outcome."""
        return int((self.outcome == outcome).sum())

    @property
    def scored(self) -> int:
        """Observations that count."""
        return int((self.outcome != SKIPPED).sum())

    @property
    def match_rate(self) -> float:
        """Share of right decisions, pairings and non-pairings together; NaN without labels."""
        return _ratio(self.count(TP) + self.count(TN), self.scored)

    @property
    def precision(self) -> float:
        """Right pairings of all pairings."""
        return _ratio(self.count(TP), self.count(TP) + self.count(FP))

    @property
    def recall(self) -> float:
        """Right pairings of those and the ones missed."""
        return _ratio(self.count(TP), self.count(TP) + self.count(FN))


def decide(trace: Trace, truth: TruthTable) -> Decisions:
    """Score the identities given out at each step (`docs/metrics.md`, Associations)."""
    lives = online_lifetimes(trace, truth.ids)
    return _decide(trace.ids, trace.paired, trace.with_stone, lives, trace.offsets, truth)


def decide_final(trace: Trace, truth: TruthTable) -> Decisions:
    """Score the identities as they stand after revision and merging; the same as `decide` where there was neither."""
    if trace.final_ids is None:
        return decide(trace, truth)
    ids = trace.final_ids
    lives = final_lifetimes(trace, ids, truth.ids)
    stone = np.isin(ids, trace.final.ids[trace.final.stone])
    return _decide(ids, final_pairings(trace, ids), stone, lives, trace.offsets, truth)


def decide_as_reference(trace: Trace, truth: TruthTable) -> Decisions:
    """The reference program's score: a pairing is right only with the FIRST landmark of that true id in the map."""
    lives = online_lifetimes(trace, truth.ids)
    step = step_of_observation(trace.offsets)
    scored = _scored(truth, step)
    first = lives.first_known(truth.ids, step)
    outcome = np.full(len(truth.ids), SKIPPED, np.int8)
    outcome[scored & trace.paired] = FP
    outcome[scored & trace.paired & (truth.ids >= 0) & (first == trace.ids)] = TP
    outcome[scored & ~trace.paired] = TN
    outcome[scored & ~trace.paired & (first >= 0)] = FN
    return Decisions(outcome, np.zeros(len(outcome), bool))


def _decide(ids: Ids, paired: Mask, stone: Mask, lives: Lifetimes, offsets: Ids, truth: TruthTable) -> Decisions:
    step = step_of_observation(offsets)
    scored = _scored(truth, step)
    identity = lives.identity_of(ids)
    scored &= ~(paired & (identity == UNKNOWN))  # nobody knows what this landmark is
    real = truth.ids >= 0
    own_crumb = paired & ~real & (identity == CLUTTER) & ~stone
    right = paired & real & (identity == truth.ids)
    known = _in_map(lives, truth.ids, step, scored & ~paired & real)
    outcome = np.full(len(ids), SKIPPED, np.int8)
    outcome[scored] = TN
    outcome[scored & known] = FN
    outcome[scored & paired & ~own_crumb] = FP
    outcome[scored & right] = TP
    wrong_id = scored & paired & ~right & (real | (identity >= 0))
    return Decisions(outcome, wrong_id)


def _in_map(lives: Lifetimes, truth_ids: Ids, step: Ids, asked: Mask) -> Mask:
    known = np.zeros(len(truth_ids), bool)
    known[asked] = lives.first_known(truth_ids[asked], step[asked]) >= 0
    return known


def _scored(truth: TruthTable, step: Ids) -> Mask:
    scored: Mask = (truth.ids != UNKNOWN) & (step >= truth.score_from)
    return scored


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
