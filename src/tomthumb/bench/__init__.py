"""Thousands of runs: a grid in, rows out, nothing lost. `docs/bench.md` is the manual.

from pathlib import Path
from tomthumb.bench import Where, bench, read_grid, read_rows

bench(read_grid(Path("grid.toml")), Path("out"), Where(workers=2))
rows = read_rows(Path("out"))
"""

from __future__ import annotations

from tomthumb.bench.grid import Claim, Grid, Limits, from_options, read_grid
from tomthumb.bench.rows import kept, lasting, read_rows, write_rows
from tomthumb.bench.session import Tally, Where, bench, dry_run, merge
from tomthumb.bench.spec import Part, RunSpec

__all__ = [
    "Claim",
    "Grid",
    "Limits",
    "Part",
    "RunSpec",
    "Tally",
    "Where",
    "bench",
    "dry_run",
    "from_options",
    "kept",
    "lasting",
    "merge",
    "read_grid",
    "read_rows",
    "write_rows",
]
