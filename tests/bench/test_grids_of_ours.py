"""The grids and job files that come with the project are what they say."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tomthumb.bench import read_grid, read_rows
from tomthumb.bench.validate import validate

ROOT = Path(__file__).parents[2]
GRIDS = sorted((ROOT / "benchmarks").glob("*.toml"))


@pytest.mark.parametrize("path", GRIDS, ids=[path.stem for path in GRIDS])
def test_grid_holds_together(path: Path) -> None:
    grid = read_grid(path)
    assert len({run.key for run in grid.runs()}) == len(grid.runs())
    validate(grid)


def test_full_grid_covers_what_makes_association_hard() -> None:
    grid = read_grid(ROOT / "benchmarks" / "full.toml")
    params = [part.params for part in grid.scenarios]
    assert len(grid.seeds) >= 50
    assert {p.get("odometry_noise", 1.0) for p in params} >= {1.0, 2.0, 4.0, 8.0}
    assert {p.get("people", 0) for p in params} >= {0, 10, 30, 50}
    assert {p.get("teach", 0) for p in params} == {0, 1}
    assert {part.params.get("gate") for part in grid.associators} >= {0.95, 0.99, 0.999, 0.9999}


def test_rows_of_the_watch_are_of_its_grid() -> None:
    cases = {(run.case, run.seed) for run in read_grid(ROOT / "benchmarks" / "ci.toml").runs()}
    rows = read_rows(ROOT / "benchmarks" / "ci_rows.csv")
    assert {(row["case"], row["seed"]) for row in rows} == cases


@pytest.mark.parametrize("path", sorted((ROOT / "examples" / "cluster").glob("*.sh")), ids=lambda path: path.stem)
def test_job_scripts_are_shell(path: Path) -> None:
    assert subprocess.run(["bash", "-n", str(path)], check=False).returncode == 0
