"""``tomthumb bench``: a grid of runs, resumable, on many processes, a cluster or in shards."""

from __future__ import annotations

import json as json_module
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tomthumb.bench import Grid, Tally, Where
    from tomthumb.bench.compare import Watch

Many = list[str] | None


def bench(
    grid: Annotated[Path | None, typer.Argument(help="GRID.toml; without it, use the options.")] = None,
    scenario: Annotated[Many, typer.Option(help="A scenario; may be repeated.")] = None,
    associator: Annotated[Many, typer.Option(help="An associator; may be repeated.")] = None,
    estimator: Annotated[Many, typer.Option(help="An estimator; may be repeated.")] = None,
    set_: Annotated[Many, typer.Option("--set", help="key=value, associator.key=value; a [list] is swept.")] = None,
    seeds: Annotated[str | None, typer.Option(help='"20" (0 to 19) or "100..149".')] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of journal, rows and report.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores by default.")] = None,
    dask: Annotated[str | None, typer.Option(help="Address of a Dask scheduler, or 'local'.")] = None,
    patience: Annotated[float, typer.Option(min=1, help="Seconds without a Dask scheduler, or without workers.")] = 120,
    shard: Annotated[str | None, typer.Option(help="k/n: only this part, in a journal of its own.")] = None,
    merge: Annotated[bool, typer.Option("--merge", help="Unite the journals of the shards in --out.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say how many runs, and about how long.")] = False,
    retry: Annotated[bool, typer.Option("--retry", help="Try failed runs again.")] = False,
    against: Annotated[Path | None, typer.Option(help="ROWS of another day: say what changed; 1 if worse.")] = None,
    export: Annotated[list[Path] | None, typer.Option(help="Write rows to FILE.csv or FILE.parquet.")] = None,
    keep: Annotated[Path | None, typer.Option(help="Write rows for a later --against: no times, no machine.")] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Run a grid: every combination of scenarios, estimators, associators, parameters and seeds.

    Rows are safe in OUT/journal.sqlite as soon as their run ends; call again to continue.
    """
    from tomthumb.bench import Where, kept, read_rows, write_rows
    from tomthumb.bench.session import cores, parse_shard

    chosen = _grid(grid, scenario, estimator, associator, set_, seeds)
    folder = out or Path("bench") / chosen.name
    where = Where(workers or cores(), dask, patience_s=patience)
    part = parse_shard(shard) if shard else None
    then = read_rows(against) if against else None  # before anything runs: it may not be readable
    if dry_run:
        _say_estimate(chosen, folder, part, where, json)
        return
    said = _merge(chosen, folder) if merge else _run(chosen, folder, where, part, retry, json)
    rows = _rows(folder, part)
    for path in export or ([folder / "rows.csv"] if part is None else []):
        write_rows(path, rows)
    if keep is not None:
        write_rows(keep, kept(rows))
    watch = _watch(chosen, rows, then) if then is not None else None
    _report(chosen, rows, watch, said, json)
    if watch is not None and watch.worse:
        raise typer.Exit(1)


def _grid(path: Path | None, scenario: Many, estimator: Many, associator: Many, sets: Many, seeds: str | None) -> Grid:
    from tomthumb.bench import from_options, read_grid
    from tomthumb.errors import TomThumbError

    options = [name for name, given in (("--scenario", scenario), ("--estimator", estimator),
                                        ("--associator", associator), ("--set", sets)) if given]  # fmt: skip
    if path is not None and options:
        raise TomThumbError(f"bench: {options[0]} cannot be added to a grid file; write it there")
    if path is not None:
        return read_grid(path, seeds)
    return from_options(scenario or ["cloister"], estimator or [], associator or [], sets or [], seeds)


def _say_estimate(grid: Grid, out: Path, part: tuple[int, int] | None, where: Where, json: bool) -> None:
    from tomthumb.bench import dry_run

    found = dry_run(grid, out, part)
    share = {"runs": found.runs, "seconds": found.seconds / where.workers, "workers": where.workers}
    if json:
        typer.echo(json_module.dumps(share))
        return
    typer.echo(f"{grid.name}: {found.runs} runs to do, about {in_words(share['seconds'])} with {where}.")


def in_words(seconds: float) -> str:
    """About how long, as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _merge(grid: Grid, folder: Path) -> dict[str, Any]:
    from tomthumb.bench import merge
    from tomthumb.errors import TomThumbError

    shards = sorted(folder.glob("journal-*-of-*.sqlite"))
    if not shards:
        raise TomThumbError(f"{folder}: no journals of shards (journal-k-of-n.sqlite)")
    have, planned = merge(grid, folder, shards)
    return {"planned": planned, "rows": have, "shards": len(shards)}


def _run(
    grid: Grid, folder: Path, where: Where, part: tuple[int, int] | None, retry: bool, quiet: bool
) -> dict[str, Any]:
    """Run with a progress bar on standard error; what was done."""
    from rich import progress
    from rich.console import Console

    from tomthumb.bench import bench

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        progress.TextColumn("{task.fields[failed]} failed"),
    )
    bar = progress.Progress(*columns, console=Console(stderr=True), disable=quiet)
    task = bar.add_task(grid.name, total=None, failed=0)

    def show(rows: int, planned: int, failed: int) -> None:
        bar.start()  # first called when the grid is found to hold together
        bar.update(task, completed=rows, total=planned, failed=failed)

    def say(line: str) -> None:
        bar.console.print(line, highlight=False, markup=False, soft_wrap=True)

    try:
        tally = bench(grid, folder, where, shard=part, retry=retry, progress=show, notice=say)
    finally:
        if bar.live.is_started:
            bar.stop()
    return _told(tally, where, folder)


def _told(tally: Tally, where: Where, folder: Path) -> dict[str, Any]:
    return {
        "planned": tally.planned, "rows": tally.before + tally.rows, "new": tally.rows, "failed": tally.failed,
        "seconds": tally.seconds, "overhead": tally.overhead(where.workers) if tally.rows else None,
        "out": str(folder), "reasons": tally.reasons[:5],
    }  # fmt: skip


def _rows(folder: Path, part: tuple[int, int] | None) -> list[dict[str, Any]]:
    from tomthumb.bench import read_rows
    from tomthumb.bench.session import journal_path

    return read_rows(journal_path(folder, part))


def _watch(grid: Grid, rows: Sequence[Any], then: Sequence[Any]) -> Watch:
    from tomthumb.bench.compare import against_rows

    return against_rows(rows, then, grid.measures, grid.level)


def _report(grid: Grid, rows: Sequence[Any], watch: Watch | None, said: dict[str, Any], json: bool) -> None:
    from tomthumb.bench.compare import against_baseline

    verdicts = against_baseline(rows, grid)
    if json:
        told = {**said, "verdicts": [v.sentence() for v in verdicts]}
        if watch is not None:
            told["against"] = {"shared": watch.shared, "broke": watch.broke, "worse": watch.worse,
                               "verdicts": [v.sentence() for v in watch.verdicts]}  # fmt: skip
        typer.echo(json_module.dumps(told, allow_nan=False))
        return
    _print_table(grid, rows)
    for verdict in verdicts:
        typer.echo(verdict.sentence())
    for reason in said.get("reasons", ()):
        typer.echo(f"failed: {reason}")
    if watch is not None:
        _print_watch(watch)
    typer.echo(f"{said['rows']} of {said['planned']} rows" + (f" in {said['out']}" if "out" in said else ""))


def _print_table(grid: Grid, rows: Sequence[Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from tomthumb.bench.compare import summary
    from tomthumb.bench.measures import measure

    measures = [measure(key) for key in grid.measures]
    table = Table("scenario", "method", "runs", *(m.title for m in measures))
    for cell in summary(rows, grid.measures):
        runs = str(cell.n) + (f" + {cell.failed} failed" if cell.failed else "")
        table.add_row(cell.scenario, cell.method, runs, *(m.text(cell.means[m.key][0]) for m in measures))
    Console().print(table)


def _print_watch(watch: Watch) -> None:
    from tomthumb.stats import BETTER, WORSE

    typer.echo(f"against before, {watch.shared} runs in common:")
    changed = [v for v in watch.verdicts if v.comparison.verdict in (BETTER, WORSE)]
    for verdict in changed:
        typer.echo(f"  {verdict.sentence()}")
    for text in watch.broke:
        typer.echo(f"  fails now: {text}")
    if not changed and not watch.broke:
        typer.echo("  nothing became better or worse")
