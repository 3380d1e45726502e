"""The same rows from a Dask cluster, with a worker killed on the way; a bad run harms nobody there either."""

from __future__ import annotations

import subprocess
import sys
from collections import deque
from pathlib import Path

import pytest
from bench_fakes import RUNNER, grid

from tomthumb.bench import Where, bench, lasting, read_rows
from tomthumb.bench.grid import Limits
from tomthumb.bench.supervisor import Strikes

pytest.importorskip("distributed", reason="the cluster needs the extra dask")

DRIVE = """
import sys
from pathlib import Path
from bench_fakes import RUNNER, grid
from tomthumb.bench import Where, bench
if __name__ == "__main__":
    chosen = grid(sys.argv[2], seeds=int(sys.argv[3]), limits={"attempts": 2})
    bench(chosen, Path(sys.argv[1]), Where(2, "local", RUNNER))
"""


def drive(out: Path, deed: str, seeds: int) -> None:
    """A process of its own: Dask leaves threads and sockets behind that the tests' strictness about warnings would
    hit.
    """
    script = out.parent / "drive.py"
    script.write_text(DRIVE)
    path = ":".join([*sys.path, str(Path(__file__).parent)])
    command = [sys.executable, str(script), str(out), deed, str(seeds)]
    end = subprocess.run(command, env={"PYTHONPATH": path}, capture_output=True, text=True, timeout=180, check=False)
    assert end.returncode == 0, end.stderr[-2000:]


def test_rows_do_not_depend_on_where_they_were_made(tmp_path: Path) -> None:
    drive(tmp_path / "dask", "work", 12)
    bench(grid(seeds=12, limits={"attempts": 2}), tmp_path / "here", Where(2, runner=RUNNER))
    assert lasting(read_rows(tmp_path / "dask")) == lasting(read_rows(tmp_path / "here"))


def test_a_run_that_kills_its_process_is_a_row_and_the_dask_worker_lives(tmp_path: Path) -> None:
    drive(tmp_path / "dask", "crash", 3)
    found = {(row["method"], row["seed"]): row["status"] for row in read_rows(tmp_path / "dask")}
    assert found == {(m, s): "poisoned" if s == 1 else "done" for m in ("one", "two") for s in range(3)}


def test_lost_tasks_come_back_one_by_one_and_not_for_ever() -> None:
    from tomthumb.bench.cluster import Fleet

    jobs = [{"key": k} for k in "abc"]
    rows: list[dict[str, object]] = []
    fleet = Fleet(deque(jobs), rows.extend, Limits(kills=2), RUNNER, lambda key, strikes, reason: None, {})
    fleet.average = 0.001
    first = fleet.chunk(threads=1)
    fleet.crashed(first, "lost")
    assert {job["key"] for job in fleet.jobs} == {"a", "b", "c"}
    while fleet.jobs[0]["key"] not in fleet.strikes:
        fleet.jobs.rotate(-1)
    again = fleet.chunk(threads=1)
    assert len(again) == 1
    fleet.crashed(again, "lost")
    assert [row["status"] for row in rows] == ["poisoned"]
    assert fleet.strikes[again[0]["key"]] == Strikes(0, 2)


def test_recall_brings_back_what_was_flying_in_order() -> None:
    from tomthumb.bench.cluster import Fleet

    fleet = Fleet(deque([{"key": "c"}]), list, Limits(), RUNNER, lambda key, strikes, reason: None, {})
    fleet.flying = {"task": [{"key": "a"}, {"key": "b"}]}
    fleet.recall()
    assert [job["key"] for job in fleet.jobs] == ["a", "b", "c"]
