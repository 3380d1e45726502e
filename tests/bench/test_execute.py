"""Real runs: the same rows whatever the order, the number of workers and what ran before; plug-ins and their bugs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tomthumb.bench import Where, bench, lasting, read_rows
from tomthumb.bench.execute import Executor, path_in
from tomthumb.bench.grid import from_table
from tomthumb.bench.supervisor import run_jobs

MINE = """
import numpy as np
from tomthumb.types import Association

class Mine:
    def associate(self, problem, rng):
        return [Association(np.full(problem.shape[0], -1))]
    def learn(self, ids, t):
        pass

class Broken(Mine):
    def associate(self, problem, rng):
        raise ZeroDivisionError("a bug of its author")
"""


def table(**more: object) -> dict[str, object]:
    return {
        "seeds": 2,
        "scenario": {"use": "cloister", "odometry_noise": [1.0, 4.0]},
        "associator": [{"use": "nn"}, {"use": "jcbb"}],
        **more,
    }


def test_rows_depend_on_nothing_but_the_grid(tmp_path: Path) -> None:
    grid = from_table(table(), tmp_path)
    bench(grid, tmp_path / "out", Where(2))
    expected = {row["key"]: row for row in lasting(read_rows(tmp_path / "out"))}
    backwards: list[dict[str, object]] = []
    run_jobs([run.job() for run in reversed(grid.runs())], backwards.extend, workers=1)
    fresh = Executor()(grid.runs()[3].job())
    assert len(backwards) == 8
    for row in [*backwards, fresh]:
        metrics = lasting([row["metrics"]])[0]  # type: ignore[list-item]
        assert metrics == {key: expected[row["key"]][key] for key in metrics}


def test_a_second_call_runs_nothing_and_more_seeds_only_the_new_ones(tmp_path: Path) -> None:
    bench(from_table(table(), tmp_path), tmp_path / "out", Where(2))
    assert bench(from_table(table(), tmp_path), tmp_path / "out", Where(2)).rows == 0
    more = bench(from_table(table(seeds=3), tmp_path), tmp_path / "out", Where(2))
    assert (more.before, more.rows) == (8, 4)


def test_a_plug_in_from_a_file_and_one_with_a_bug(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    plug_ins = [{"use": "./mine.py:Mine"}, {"use": "./mine.py:Broken"}]
    grid = from_table(table(seeds=1, scenario={"use": "cloister"}, associator=plug_ins), tmp_path)
    bench(grid, tmp_path / "out", Where(1))
    fine, broken = read_rows(tmp_path / "out")
    assert fine["status"] == "done"
    assert fine["recall"] < 0.1
    assert broken["status"] == "error"
    assert broken["reason"] == "ZeroDivisionError: a bug of its author"
    assert "mine.py" in broken["detail"]


def test_files_that_are_not_those_of_the_grid_are_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    grid = from_table(table(seeds=1, associator={"use": "./mine.py:Mine"}), tmp_path)
    job = grid.runs()[0].job()
    (tmp_path / "mine.py").write_text(MINE + "# other\n")
    row = Executor()(job)
    assert row["status"] == "refused"
    assert "is not what the grid was made with" in str(row["reason"])
    (tmp_path / "mine.py").unlink()
    assert "no such file" in str(Executor()(job)["reason"])


def test_memory_bound_is_a_row(tmp_path: Path) -> None:
    (tmp_path / "hog.py").write_text("def world(rng):\n    return bytearray(1 << 32)\n")
    job = from_table(table(seeds=1, scenario={"use": "./hog.py:world"}), tmp_path).runs()[0].job()
    row = Executor(memory_mb=200)(job)
    assert (row["status"], row["reason"]) == ("memory", "needs more than 200 MB")


@pytest.mark.parametrize(
    ("use", "path"),
    [
        ("/a/b.py:Mine", "/a/b.py"),
        ("mrclam:/a/b?robot=2", "/a/b"),
        ("/a/b", "/a/b"),
        ("/a/b?x=1", "/a/b"),
    ],
)
def test_path_within_a_name(use: str, path: str) -> None:
    assert path_in(use) == Path(path)
