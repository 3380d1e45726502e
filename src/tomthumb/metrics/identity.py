"""Identity by majority and by the best assignment: what remains fair when a log's labels contain errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.metrics.assignment import best_assignment
from tomthumb.metrics.lifetimes import step_of_observation
from tomthumb.metrics.truth import CLUTTER, UNKNOWN, TruthTable
from tomthumb.types import Array, Ids, Mask, Trace


@dataclass(frozen=True)
class Overlaps:
    """How often landmark `landmark (e,)` was given to an observation of the true `identity (e,)`: `count (e,)`."""

    landmark: Ids
    identity: Ids
    count: Ids


def final_ids(trace: Trace) -> Ids:
    """Identities (M,) in the final map, merged ones mapped to their survivors."""
    if trace.final_ids is not None:
        return trace.final_ids
    ids = trace.ids.copy()
    for dropped, kept, _ in trace.merged[np.argsort(trace.merged[:, 2], kind="stable")]:
        ids[ids == dropped] = kept
    return ids


def overlaps(ids: Ids, truth_ids: Ids, rows: Mask) -> Overlaps:
    """Count the labelled observations among `rows (M,)`, landmark by landmark."""
    use = rows & (ids >= 0) & (truth_ids != UNKNOWN)
    pairs, count = np.unique(np.stack([ids[use], truth_ids[use]], 1), axis=0, return_counts=True)
    return Overlaps(pairs[:, 0], pairs[:, 1], count)


def majority(table: Overlaps) -> tuple[Ids, Ids]:
    """Landmarks (n,) and the true identity (n,) that most of their observations have; the lowest id among equals."""
    order = np.lexsort((table.identity, -table.count, table.landmark))
    landmarks, first = np.unique(table.landmark[order], return_index=True)
    return landmarks, table.identity[order][first]


def purity_and_idf1(trace: Trace, truth: TruthTable) -> tuple[float, float]:
    """Purity: share of named observations that agree with their landmark's majority. IDF1: after Ristani et al., 2016.

    IDF1 = 2 IDTP / (true + named), IDTP the observations on the one landmark assigned to their true identity by the
    best one-to-one assignment. Landmarks that never met a true landmark are left to `ghosts`.
    """
    ids, scored = final_ids(trace), step_of_observation(trace.offsets) >= truth.score_from
    table = overlaps(ids, truth.ids, scored)
    real = np.isin(table.landmark, table.landmark[table.identity >= 0])
    table = Overlaps(table.landmark[real], table.identity[real], table.count[real])
    named, true = int(table.count.sum()), int((scored & (truth.ids >= 0)).sum())
    if not named:
        return float("nan"), 0.0 if true else float("nan")
    landmarks, best = majority(table)
    agree = table.identity == best[np.searchsorted(landmarks, table.landmark)]
    matched = table.identity >= 0
    left = np.searchsorted(landmarks, table.landmark[matched])
    right = np.unique(table.identity[matched], return_inverse=True)[1]
    _, idtp = best_assignment(left, right, table.count[matched].astype(float))
    return float(table.count[agree].sum() / named), 2.0 * idtp / (true + named)


def identify(trace: Trace, truth: TruthTable) -> tuple[Array, Ids, Ids]:
    """The confirmed landmarks of the final map: points (n, 2), majority identity (n,), observations behind it (n,)."""
    table = overlaps(final_ids(trace), truth.ids, np.ones(len(truth.ids), bool))
    landmarks, best = majority(table)
    weight = np.zeros(len(landmarks), np.int64)
    np.add.at(weight, np.searchsorted(landmarks, table.landmark), table.count)
    points, ids = trace.final.landmarks[trace.final.stone], trace.final.ids[trace.final.stone]
    identity, support = np.full(len(ids), UNKNOWN, np.int64), np.zeros(len(ids), np.int64)
    if len(landmarks):
        at = np.minimum(np.searchsorted(landmarks, ids), len(landmarks) - 1)
        known = landmarks[at] == ids
        identity[known], support[known] = best[at[known]], weight[at[known]]
    return points, identity, support


def duplicates_and_ghosts(identity: Ids) -> tuple[int, int]:
    """Confirmed landmarks beyond the first of their identity, and those that are clutter."""
    real = identity[identity >= 0]
    return len(real) - len(np.unique(real)), int((identity == CLUTTER).sum())
