"""Rows against rows: every method against the baseline, and today's against those of another day."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tomthumb.bench.execute import DONE
from tomthumb.bench.grid import Grid
from tomthumb.bench.measures import Measure, directed, measure
from tomthumb.errors import TomThumbError
from tomthumb.stats import CANNOT_TELL, SAME, WORSE, Comparison, compare, correct, mean_interval, pilot, seeds_needed
from tomthumb.types import Array

Row = Mapping[str, Any]
Group = dict[int, Row]  # by seed


@dataclass(frozen=True, slots=True)
class Verdict:
    """A method in a scenario against something, by one measure. `needed`: seeds that would tell, None if no number
    would.
    """

    scenario: str
    method: str
    against: str
    measure: Measure
    comparison: Comparison
    differences: Array
    needed: int | None = None

    def sentence(self) -> str:
        """In words, with the figures."""
        c, m = self.comparison, self.measure
        head = f"{self.scenario}: {self.method} is {_words(c.verdict)} {self.against} by {m.title}"
        if c.verdict == SAME:
            return f"{head} (all {c.n} seeds)"
        size = f"{signed(m, c.mean)} [{signed(m, c.low)}, {signed(m, c.high)}], p = {c.p_holm:.2g}, {c.n} seeds"
        more = f"; about {self.needed} seeds would tell" if c.verdict == CANNOT_TELL and self.needed else ""
        return f"{head}: {size}{more}"


def _words(verdict: str) -> str:
    return {SAME: "the same as", CANNOT_TELL: "not to be told from"}.get(verdict, f"{verdict} than")


def signed(m: Measure, value: float) -> str:
    """A difference as printed, with its sign."""
    return ("+" if value > 0 else "") + m.text(value)


@dataclass(frozen=True, slots=True)
class Cell:
    """One method in one scenario: `n` finished runs, `failed` others, `diverged` of the finished; mean and interval."""

    scenario: str
    method: str
    n: int
    failed: int
    diverged: int
    means: Mapping[str, tuple[float, float, float]]
    perfect: Mapping[str, int]


def groups(rows: Iterable[Row]) -> dict[tuple[str, str], Group]:
    """Rows by (scenario, method), then by seed; in the order they come."""
    found: dict[tuple[str, str], Group] = {}
    for row in rows:
        found.setdefault((row["scenario"], row["method"]), {})[row["seed"]] = row
    return found


def values(rows: Iterable[Row], key: str) -> Array:
    """One measure of rows as numbers; NaN where a run failed or the measure is not known."""
    found = [row.get(key) if row["status"] == DONE else None for row in rows]
    return np.array([np.nan if value is None else float(value) for value in found])


def summary(rows: Sequence[Row], measures: Sequence[str]) -> list[Cell]:
    """Every method in every scenario."""
    return [_cell(*key, list(group.values()), measures) for key, group in groups(rows).items()]


def _cell(scenario: str, method: str, rows: Sequence[Row], measures: Sequence[str]) -> Cell:
    done = [row for row in rows if row["status"] == DONE]
    columns = {key: values(done, key) for key in measures}
    known = {key: column[np.isfinite(column)] for key, column in columns.items()}
    means = {key: _mean(column) for key, column in known.items()}
    perfect = {key: int((column == 1.0).sum()) for key, column in known.items() if measure(key).unit == " %"}
    diverged = sum(row.get("failure") is not None for row in done)
    return Cell(scenario, method, len(done), len(rows) - len(done), diverged, means, perfect)


def _mean(column: Array) -> tuple[float, float, float]:
    low, high = mean_interval(column, np.random.default_rng(0))
    return (float(column.mean()) if len(column) else np.nan), low, high


def against_baseline(rows: Sequence[Row], grid: Grid) -> list[Verdict]:
    """Every method against its counterpart with the baseline, by every directed measure, corrected all together."""
    found = groups(rows)
    verdicts = []
    for (scenario, method), group in found.items():
        base = counterpart(grid, method)
        if base is None or (scenario, base) not in found:
            continue
        for m in directed(grid.measures):
            verdicts.append(_verdict(scenario, method, base, m, group, found[scenario, base], grid.level))
    return together(verdicts)


def counterpart(grid: Grid, method: str) -> str | None:
    """What `method` is compared with: the baseline; or, if that is an associator, the method that has it instead."""
    methods = grid.methods()
    if grid.baseline in methods:
        return None if method == grid.baseline else grid.baseline
    estimator, associator, slam = methods[method]
    if associator.label == grid.baseline:
        return None
    wanted = (estimator.label, grid.baseline, slam.label)
    return next((name for name, parts in methods.items() if tuple(p.label for p in parts) == wanted), None)


def _verdict(scenario: str, method: str, base: str, m: Measure, mine: Group, theirs: Group, level: float) -> Verdict:
    seeds = [seed for seed in mine if seed in theirs]
    a = values((mine[seed] for seed in seeds), m.key)
    b = values((theirs[seed] for seed in seeds), m.key)
    found = compare(a, b, np.random.default_rng(0), larger_is_better=bool(m.larger), level=level)
    return Verdict(scenario, method, base, m, found, (a - b)[np.isfinite(a - b)])


def together(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """The same verdicts with Holm's correction over all of them."""
    judged = correct([v.comparison for v in verdicts])
    family = sum(c.verdict != SAME for c in judged)
    return [replace(v, comparison=c, needed=_needed(v, family)) for v, c in zip(verdicts, judged, strict=True)]


def _needed(verdict: Verdict, family: int) -> int | None:
    """Seeds that would tell with 80 % power, also as the hardest to tell of so many comparisons."""
    level = verdict.comparison.level / max(1, family)
    return seeds_needed(pilot(verdict.differences), level=level)


@dataclass(frozen=True, slots=True)
class Watch:
    """What changed since: verdicts over the runs in common, `shared` of them; runs that fail now and did not
    (`broke`).
    """

    verdicts: list[Verdict]
    shared: int
    broke: list[str]

    @property
    def worse(self) -> bool:
        """True when something became worse."""
        return bool(self.broke) or any(v.comparison.verdict == WORSE for v in self.verdicts)


def against_rows(now: Sequence[Row], then: Sequence[Row], measures: Sequence[str], level: float = 0.05) -> Watch:
    """The same configurations and seeds, then and now, whatever the code. Raises TomThumbError without any in
    common.
    """
    before = {(row["case"], row["seed"]): row for row in then}
    shared = [row for row in now if (row["case"], row["seed"]) in before]
    if not shared:
        raise TomThumbError("--against: no run of these rows has the configuration and seed of one of this grid")
    verdicts = [
        _verdict(scenario, method, "before", m, group, _before(group, before), level)
        for (scenario, method), group in groups(shared).items()
        for m in directed(measures)
    ]
    return Watch(together(verdicts), len(shared), [text for row in shared if (text := _broken(row, before))])


def _before(group: Group, before: Mapping[tuple[str, int], Row]) -> Group:
    return {seed: before[row["case"], seed] for seed, row in group.items()}


def _broken(row: Row, before: Mapping[tuple[str, int], Row]) -> str:
    """A run that was fine and now is not, in words; "" otherwise."""
    old = before[row["case"], row["seed"]]
    name = f"{row['scenario']}: {row['method']}, seed {row['seed']}"
    if row["status"] != DONE and old["status"] == DONE:
        return f"{name}: {row['status']}: {row['reason']}"
    if row.get("failure") and not old.get("failure") and old["status"] == DONE:
        return f"{name}: {row['failure']}"
    return ""
