"""Paired comparison in words: better, worse or cannot tell, with the figures that say so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tomthumb.stats.bootstrap import mean_interval
from tomthumb.stats.signed_rank import hodges_lehmann, signed_rank
from tomthumb.types import Array

BETTER, WORSE, SAME, CANNOT_TELL = "better", "worse", "same", "cannot tell"


@dataclass(frozen=True, slots=True)
class Comparison:
    """One measure of a candidate against a baseline on the same worlds; differences are candidate minus baseline.

    mean, low, high: mean difference and its bootstrap interval; shift, shift_low, shift_high: Hodges-Lehmann estimate
    and the Wilcoxon interval; p: Wilcoxon's, two-sided, `p_holm` after Holm's correction; effect: matched-pairs
    rank-biserial; dz: mean over standard deviation (NaN where that is 0); wins, ties, losses of the candidate.
    """

    n: int
    mean: float
    low: float
    high: float
    shift: float
    shift_low: float
    shift_high: float
    p: float
    p_holm: float
    effect: float
    dz: float
    wins: int
    ties: int
    losses: int
    larger_is_better: bool
    level: float

    @property
    def verdict(self) -> str:
        """In words. "same" only where no world shows any difference; a test and a mean that disagree tell nothing."""
        if self.n and self.ties == self.n:
            return SAME
        gain = self.mean if self.larger_is_better else -self.mean
        rank = self.effect if self.larger_is_better else -self.effect
        if not self.p_holm < self.level or gain * rank <= 0:
            return CANNOT_TELL
        return BETTER if gain > 0 else WORSE


def compare(
    candidate: Array,
    baseline: Array,
    rng: np.random.Generator,
    *,
    larger_is_better: bool = True,
    level: float = 0.05,
    resamples: int = 4000,
) -> Comparison:
    """Compare two samples (n,), row i of both from the same world. Rows with a NaN in either are left out."""
    d = np.asarray(candidate, float) - np.asarray(baseline, float)
    d = d[np.isfinite(d)]
    test = signed_rank(d)
    low, high = mean_interval(d, rng, level, resamples)
    shift, shift_low, shift_high = hodges_lehmann(d, level)
    gain = d if larger_is_better else -d
    std = float(d.std(ddof=1)) if len(d) > 1 else 0.0
    return Comparison(
        n=len(d),
        mean=float(d.mean()) if len(d) else np.nan,
        low=low,
        high=high,
        shift=shift,
        shift_low=shift_low,
        shift_high=shift_high,
        p=test.p,
        p_holm=test.p,
        effect=test.effect,
        dz=float(d.mean()) / std if std > 0 else np.nan,
        wins=int((gain > 0).sum()),
        ties=int((gain == 0).sum()),
        losses=int((gain < 0).sum()),
        larger_is_better=larger_is_better,
        level=level,
    )


def holm(p: Sequence[float]) -> Array:
    """Holm's step-down adjusted p values (k,), in the order given: reject where they are below the level.

    References: S. Holm, Scand. J. Statist. 6(2), 1979.
    """
    values = np.asarray(p, float)
    order = np.argsort(values, kind="stable")
    scaled = values[order] * np.arange(len(values), 0, -1)
    adjusted = np.empty(len(values))
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return adjusted


def correct(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """The same comparisons, judged together: each with Holm's p over all that could have differed."""
    live = [c.p for c in comparisons if c.ties < c.n]
    adjusted = iter(holm(live).tolist())
    return [replace(c, p_holm=next(adjusted)) if c.ties < c.n else c for c in comparisons]
