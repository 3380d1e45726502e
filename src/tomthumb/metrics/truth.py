"""The truth of a run, stacked to the shape of its trace."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.types import Array, Ids, Mask, Scenario, Step, Trace

UNKNOWN = -2  # label not known: not scored
CLUTTER = -1  # no landmark: clutter, a walking person


@dataclass(frozen=True)
class TruthTable:
    """pose (K, 3), NaN where unknown; ids (M,) true landmark of each observation (-1 clutter, -2 unknown).

    landmarks (n, 2) m, row = true id, or None; steps before `score_from` are not scored.
    """

    pose: Array
    ids: Ids
    landmarks: Array | None
    score_from: int

    @property
    def has_ids(self) -> bool:
        """True when at least one observation is labelled."""
        return bool((self.ids != UNKNOWN).any())

    def scored_steps(self) -> Mask:
        """Steps (K,) that count."""
        return np.arange(len(self.pose)) >= self.score_from


def collect(scenario: Scenario, trace: Trace) -> TruthTable:
    """Truth of the steps that `trace` covers, in one pass over `scenario.steps` (which may be lazy).

    Raises TomThumbError when the trace is not of this scenario.
    """
    sizes = np.diff(trace.offsets)
    pose = np.full((len(sizes), 3), np.nan)
    ids = np.full(int(sizes.sum()), UNKNOWN, np.int64)
    seen = 0
    for k, step in _first(scenario, len(sizes)):
        m = 0 if step.observations is None else len(step.observations)
        if m != sizes[k]:
            raise TomThumbError(
                f"trace of {trace.scenario!r} has {sizes[k]} observations in step {k}, the scenario {m}"
            )
        if step.truth is not None and step.truth.pose is not None:
            pose[k] = step.truth.pose
        if step.truth is not None and step.truth.ids is not None and m:
            ids[trace.offsets[k] : trace.offsets[k + 1]] = step.truth.ids
        seen = k + 1
    if seen < len(sizes):
        raise TomThumbError(f"trace of {trace.scenario!r} has {len(sizes)} steps, the scenario only {seen}")
    return TruthTable(pose, ids, scenario.landmarks, scenario.score_from)


def _first(scenario: Scenario, count: int) -> Iterator[tuple[int, Step]]:
    for k, step in enumerate(scenario.steps):
        if k >= count:
            return
        yield k, step
