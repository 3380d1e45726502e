"""Claims judged by the rows: holds, does not hold, cannot tell; with the interval that says so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tomthumb.bench.compare import signed, values
from tomthumb.bench.grid import Claim, Grid
from tomthumb.bench.measures import Measure, measure
from tomthumb.stats import BETTER, WORSE, compare, error_bound, mean_interval
from tomthumb.types import Array

HOLDS, FAILS, CANNOT_TELL = "holds", "does not hold", "cannot tell"
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Judgement:
    """What the rows say to a claim."""

    claim: Claim
    verdict: str
    evidence: str


def judge(claims: Sequence[Claim], rows: Sequence[Row], grid: Grid) -> list[Judgement]:
    """Every claim of the grid."""
    return [_against(c, rows, grid) if c.better_than else _bound(c, rows, grid) for c in claims]


def _mine(claim: Claim, rows: Sequence[Row], label: str) -> list[Row]:
    """Rows of a method, or of an associator, in the claim's scenario."""
    there = [row for row in rows if claim.scenario is None or row["scenario"] == claim.scenario]
    exact = [row for row in there if row["method"] == label]
    return exact or [row for row in there if row["associator"] == label]


def _bound(claim: Claim, rows: Sequence[Row], grid: Grid) -> Judgement:
    m = measure(claim.measure)
    found = values(_mine(claim, rows, claim.method), claim.measure)
    found = found[np.isfinite(found)]
    if len(found) == 0:
        return Judgement(claim, CANNOT_TELL, "no finished run")
    low, high = mean_interval(found, np.random.default_rng(0), grid.level)
    at_least = claim.at_least is not None
    bound = claim.at_least if claim.at_least is not None else claim.at_most
    assert bound is not None
    inside = low >= bound if at_least else high <= bound
    outside = high < bound if at_least else low > bound
    verdict = HOLDS if inside else FAILS if outside else CANNOT_TELL
    return Judgement(claim, verdict, f"mean {m.text(found.mean())} [{_range(m, low, high)}], {_spread(m, found)}")


def _range(m: Measure, low: float, high: float) -> str:
    return f"{m.text(low)}, {m.text(high)}"


def _spread(m: Measure, found: Array) -> str:
    """How many runs were perfect, and what that is worth; else the extremes."""
    runs, perfect = len(found), int((found == 1.0).sum())
    if m.unit == " %" and perfect:
        bound = 100 * error_bound(runs - perfect, runs)
        return f"{perfect} of {runs} runs without any mistake (a run errs with at most {bound:.2g} %, 95 % sure)"
    return f"{runs} runs from {m.text(found.min())} to {m.text(found.max())}"


def _against(claim: Claim, rows: Sequence[Row], grid: Grid) -> Judgement:
    assert claim.better_than is not None
    m = measure(claim.measure)
    mine, theirs = _paired(claim, rows)
    if m.larger is None or not len(mine):
        return Judgement(claim, CANNOT_TELL, "nothing to compare")
    found = compare(mine, theirs, np.random.default_rng(0), larger_is_better=m.larger, level=grid.level)
    verdict = {BETTER: HOLDS, WORSE: FAILS}.get(found.verdict, CANNOT_TELL)
    size = f"{signed(m, found.mean)} [{signed(m, found.low)}, {signed(m, found.high)}]"
    return Judgement(
        claim, verdict, f"{found.verdict}: {size}, p = {found.p:.2g}, {found.n} pairs, "
        f"{found.wins} won, {found.ties} equal, {found.losses} lost",
    )  # fmt: skip


def _paired(claim: Claim, rows: Sequence[Row]) -> tuple[Array, Array]:
    """The measure of both sides over the worlds, estimators and life cycles they share."""
    assert claim.better_than is not None
    sides = []
    for label in (claim.method, claim.better_than):
        chosen = _mine(claim, rows, label)
        exact = chosen and chosen[0]["method"] == label
        sides.append({(row["world"], *(() if exact else (row["estimator"], row["slam"]))): row for row in chosen})
    both = [key for key in sides[0] if key in sides[1]]
    mine, theirs = (values((side[key] for key in both), claim.measure) for side in sides)
    return mine, theirs
