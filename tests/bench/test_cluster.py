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
from tomthumb.errors import TomThumbError

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

DRY = """
import sys
from pathlib import Path
from threading import Timer
from distributed import LocalCluster
from bench_fakes import RUNNER, grid
from tomthumb.bench import Where, bench
from tomthumb.errors import TomThumbError
if __name__ == "__main__":
    with LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=None) as cluster:
        where = Where(1, cluster.scheduler_address, RUNNER, float(sys.argv[2]))
        if sys.argv[3] == "late":
            Timer(3.0, cluster.scale, (1,)).start()
        try:
            bench(grid(seeds=3), Path(sys.argv[1]), where, notice=print)
        except TomThumbError as reason:
            print("GAVE UP", reason)
"""


def drive(out: Path, *arguments: str, script: str = DRIVE) -> str:
    """What a process of its own says: Dask leaves threads and sockets behind that the tests' strictness about warnings
    would hit.
    """
    file = out.parent / "drive.py"
    file.write_text(script)
    path = ":".join([*sys.path, str(Path(__file__).parent)])
    command = [sys.executable, str(file), str(out), *arguments]
    end = subprocess.run(command, env={"PYTHONPATH": path}, capture_output=True, text=True, timeout=180, check=False)
    assert end.returncode == 0, end.stderr[-2000:]
    return end.stdout


def test_rows_do_not_depend_on_where_they_were_made(tmp_path: Path) -> None:
    drive(tmp_path / "dask", "work", "12")
    bench(grid(seeds=12, limits={"attempts": 2}), tmp_path / "here", Where(2, runner=RUNNER))
    assert lasting(read_rows(tmp_path / "dask")) == lasting(read_rows(tmp_path / "here"))


def test_a_run_that_kills_its_process_is_a_row_and_the_dask_worker_lives(tmp_path: Path) -> None:
    drive(tmp_path / "dask", "crash", "3")
    found = {(row["method"], row["seed"]): row["status"] for row in read_rows(tmp_path / "dask")}
    assert found == {(m, s): "poisoned" if s == 1 else "done" for m in ("one", "two") for s in range(3)}


def test_a_scheduler_that_never_has_a_worker_ends_in_one_line(tmp_path: Path) -> None:
    said = drive(tmp_path / "dask", "2", "never", script=DRY).splitlines()
    assert [line for line in said if "waiting up to 2 s" in line]
    (end,) = [line for line in said if line.startswith("GAVE UP")]
    assert "has had no worker for 2 s" in end
    assert "run again to continue" in end
    assert read_rows(tmp_path / "dask") == []


def test_workers_may_come_late(tmp_path: Path) -> None:
    said = drive(tmp_path / "dask", "60", "late", script=DRY)
    assert "waiting up to 60 s" in said
    assert "GAVE UP" not in said
    assert [row["status"] for row in read_rows(tmp_path / "dask")] == ["done"] * 6


def test_each_time_without_workers_is_told_once_and_counts_anew() -> None:
    from tomthumb.bench.cluster import Drought

    told: list[str] = []
    drought = Drought("tcp://x:1", 10.0, told.append)
    for threads, now in [(0, 0.0), (0, 9.0), (2, 10.5), (0, 11.0), (0, 20.5)]:
        drought.look(threads, now)
    assert len(told) == 2
    with pytest.raises(TomThumbError, match="no worker for 10 s"):
        drought.look(0, 21.5)


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
