"""One call of the driver: plan, run what has no row yet, keep the journal."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tomthumb.bench.execute import DONE, Row
from tomthumb.bench.grid import Grid, from_table, read_grid
from tomthumb.bench.journal import Journal, reading, shard_of, writing
from tomthumb.bench.spec import RunSpec
from tomthumb.bench.supervisor import run_jobs
from tomthumb.bench.validate import Estimate, estimate, validate
from tomthumb.bench.version import environment
from tomthumb.bench.worker import RUNNER
from tomthumb.errors import TomThumbError

PATIENCE_S = 120.0
Progress = Callable[[int, int, int], None]  # rows, planned rows, rows that failed
Notice = Callable[[str], None]  # a line for whoever waits


@dataclass(frozen=True, slots=True)
class Where:
    """Where the runs go: `workers` processes of this machine, or the Dask scheduler at `dask` ("local" for one of
    ours), which may be away, or without workers, for `patience_s`.
    """

    workers: int = 1
    dask: str | None = None
    runner: str = RUNNER
    patience_s: float = PATIENCE_S

    def __str__(self) -> str:
        return f"{self.workers} processes" if self.dask is None else f"dask {self.dask}"


@dataclass(slots=True)
class Tally:
    """What one call did: rows written, of which `failed`; seconds that passed, and that the runs themselves took."""

    planned: int
    before: int
    rows: int = 0
    failed: int = 0
    seconds: float = 0.0
    busy: float = 0.0
    reasons: list[str] = field(default_factory=list)

    def add(self, row: Row) -> None:
        """Count a row."""
        self.rows += 1
        self.busy += row["seconds"] or 0.0
        if row["status"] != DONE:
            self.failed += 1
            self.reasons.append(f"{row['status']}: {row['reason']}")

    def overhead(self, workers: int) -> float:
        """Share of the processes' time that was not spent in runs (starting them included)."""
        total = self.seconds * workers
        return 1.0 - self.busy / total if total > 0 else 0.0


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def journal_path(out: Path, shard: tuple[int, int] | None = None) -> Path:
    """The journal of a grid in the folder `out`, or that of one shard."""
    return out / ("journal.sqlite" if shard is None else f"journal-{shard[0]}-of-{shard[1]}.sqlite")


def bench(
    grid: Grid,
    out: Path,
    where: Where = Where(),
    *,
    shard: tuple[int, int] | None = None,
    retry: bool = False,
    progress: Progress = lambda rows, planned, failed: None,
    notice: Notice = lambda line: None,
) -> Tally:
    """Run what has no row yet; every row is in the journal below `out` as soon as its run ends. Safe to call again.

    `shard` (k, n) takes the k-th of n parts of the worlds and a journal of its own. `retry` forgets rows that failed.
    `notice` is told what a cluster lets us wait for. Raises TomThumbError before anything runs where the grid does not
    hold together, and when a cluster is of no use for too long.
    """
    if where.runner == RUNNER:
        validate(grid)
    runs = part_of(grid.runs(), shard)
    with writing(journal_path(out, shard)) as journal:
        plan(journal, grid, runs)
        if retry:
            journal.forget_failures()
        have = journal.keys()
        todo = [run for run in runs if run.key not in have]
        tally = Tally(len(runs), len(runs) - len(todo))
        progress(tally.before, tally.planned, 0)
        _run(journal, todo, grid, where, tally, (progress, notice))
    return tally


def part_of(runs: Sequence[RunSpec], shard: tuple[int, int] | None) -> list[RunSpec]:
    """The runs of a shard, all for None; runs that are the same under two labels stay once each. Pairs stay
    together.
    """
    if shard is None:
        return list(runs)
    mine = shard_of((run.world for run in runs), *shard)
    return [run for run in runs if run.world in mine]


def plan(journal: Journal, grid: Grid, runs: Sequence[RunSpec]) -> None:
    """Write down what is to be run and by which grid."""
    labels = {(e.label, a.label, s.label): name for name, (e, a, s) in grid.methods().items()}
    journal.set_plan(runs, labels)
    journal.set_about(grid=grid.source, name=grid.name)


def _run(
    journal: Journal, todo: Sequence[RunSpec], grid: Grid, where: Where, tally: Tally, told: tuple[Progress, Notice]
) -> None:
    progress, notice = told
    started, clock = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), time.monotonic()

    def record(rows: list[Row]) -> None:
        journal.record(rows)
        for row in rows:
            tally.add(row)
        progress(tally.before + tally.rows, tally.planned, tally.failed)

    jobs = [run.job() for run in {run.key: run for run in todo}.values()]
    try:
        if where.dask is not None and jobs:
            from tomthumb.bench.cluster import run_on_cluster

            run_on_cluster(
                jobs, record, where, limits=grid.limits,
                strike=journal.strike, strikes=journal.strikes(), notice=notice,
            )  # fmt: skip
        elif jobs:
            run_jobs(
                jobs, record, workers=where.workers, limits=grid.limits,
                strike=journal.strike, strikes=journal.strikes(), runner=where.runner,
            )  # fmt: skip
    finally:
        tally.seconds = time.monotonic() - clock
        if tally.rows:
            journal.add_session(started, tally.seconds, tally.rows, tally.busy, str(where), environment())


def dry_run(grid: Grid, out: Path, shard: tuple[int, int] | None = None) -> Estimate:
    """What `bench` would still have to run, and about how long. Writes nothing."""
    validate(grid)
    runs = part_of(grid.runs(), shard)
    have: set[str] = set()
    known: dict[str, float] = {}
    if journal_path(out, shard).exists():
        with reading(journal_path(out, shard)) as journal:
            have, known = journal.keys(), _means(journal)
    return estimate([run for run in runs if run.key not in have], known)


def _means(journal: Journal) -> dict[str, float]:
    """Mean seconds of the finished runs of each case."""
    times: dict[str, list[float]] = {}
    for row in journal.rows():
        if row["status"] == DONE:
            times.setdefault(row["case"], []).append(row["seconds"])
    return {case: sum(values) / len(values) for case, values in times.items()}


def merge(grid: Grid, out: Path, shards: Iterable[Path]) -> tuple[int, int]:
    """Unite journals of shards in `out`'s journal, under the whole grid's plan: (rows there now, rows planned)."""
    runs = grid.runs()
    with writing(journal_path(out)) as journal:
        plan(journal, grid, runs)
        for path in shards:
            journal.absorb(path)
        have = journal.keys()
    return sum(run.key in have for run in runs), len(runs)


def grid_of(out: Path, path: Path | None = None) -> Grid:
    """The grid that the journal in `out` was made with; or that of a file. Raises TomThumbError."""
    if path is not None:
        return read_grid(path)
    with reading(journal_path(out)) as journal:
        source = json.loads(journal.about()["grid"])
    return from_table(source["table"], Path(source["home"]), source["text"])


def parse_shard(text: str) -> tuple[int, int]:
    """``3/8`` is the third of eight. Raises TomThumbError."""
    index, _, count = text.partition("/")
    if not (index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise TomThumbError(f"--shard {text!r}: write k/n with 1 <= k <= n, as in 3/8")
    return int(index), int(count)
