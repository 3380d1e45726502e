"""What the tables of paired runs share: grids run to their end, differences with intervals, Markdown between marks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.bench import Where, bench, read_rows
from tomthumb.bench.compare import values
from tomthumb.bench.grid import from_table
from tomthumb.bench.measures import measure
from tomthumb.bench.session import journal_path
from tomthumb.stats import Comparison, compare, correct

Row = Mapping[str, Any]
Key = tuple[str, str]  # scenario, method


def parser(about: str | None, out: str, workers: int = 1) -> argparse.ArgumentParser:
    """The options that all of them have; rows are kept in --out."""
    found = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    found.add_argument("--out", type=Path, default=Path(out))
    found.add_argument("--seeds", help="in place of the plan's, as 1000..1049")
    found.add_argument("--workers", type=int, default=workers)
    found.add_argument("--write", type=Path, help="put the tables between their marks in this document")
    return found


def run(table: Mapping[str, Any], home: Path, out: Path, workers: int) -> list[Row]:
    """The rows of a grid given as a table; those that are there from another time are not run again."""
    grid = from_table(table, home)

    def show(rows: int, planned: int, failed: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{grid.name}: {rows} of {planned} runs, {failed} failed", end="", file=sys.stderr, flush=True)

    bench(grid, out, Where(workers), progress=show)
    planned = {(run.scenario.label, run.seed) for run in grid.runs()}
    return [row for row in read_rows(journal_path(out)) if (row["scenario"], row["seed"]) in planned]


def differences(rows: Sequence[Row], key: str, baseline: str) -> dict[Key, Comparison]:
    """Every method against `baseline` on the same worlds, by the measure `key`, Holm's correction over all of them."""
    by: dict[Key, dict[int, Row]] = {}
    for row in rows:
        by.setdefault((row["scenario"], row["method"]), {})[row["seed"]] = row
    found = {}
    for (scenario, method), mine in by.items():
        base = by.get((scenario, baseline), {})
        seeds = sorted(set(mine) & set(base))
        if method == baseline or not seeds:
            continue
        a, b = (values([group[seed] for seed in seeds], key) for group in (mine, base))
        found[scenario, method] = compare(a, b, np.random.default_rng(0), larger_is_better=bool(measure(key).larger))
    return dict(zip(found, correct(list(found.values())), strict=True))


def mean(rows: Sequence[Row], scenario: str, method: str, key: str) -> float:
    """Over the runs that finished; NaN without any."""
    found = values([row for row in rows if row["scenario"] == scenario and row["method"] == method], key)
    found = found[np.isfinite(found)]
    return float(found.mean()) if len(found) else np.nan


def points(c: Comparison | None, scale: float = 100.0, digits: int = 2) -> str:
    """A difference with its 95 % interval, bold where Holm's test tells it from none."""
    if c is None or not c.n:
        return "–"
    if c.ties == c.n:
        return "0"
    text = f"{scale * c.mean:+.{digits}f} [{scale * c.low:+.{digits}f}, {scale * c.high:+.{digits}f}]"
    return f"**{text}**" if c.verdict in ("better", "worse") else text


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write(document: Path, name: str, text: str) -> None:
    """Put `text` between the marks ``<!-- NAME: ... -->`` and ``<!-- end of NAME -->`` of a document."""
    whole = document.read_text("utf-8")
    begin = whole.index("-->", whole.index(f"<!-- {name}:")) + 3
    end = whole.index(f"<!-- end of {name} -->")
    document.write_text(f"{whole[:begin]}\n\n{text}\n\n{whole[end:]}", "utf-8")
