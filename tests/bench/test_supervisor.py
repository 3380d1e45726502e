"""Whatever a run does to its worker, its row tells it, and every other run has its own."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest
from bench_fakes import RUNNER, grid

from tomthumb.bench import Where, bench, lasting, read_rows
from tomthumb.bench.grid import Limits
from tomthumb.bench.supervisor import Strikes, run_jobs
from tomthumb.errors import TomThumbError


def statuses(out: Path) -> dict[tuple[str, int], str]:
    return {(row["method"], row["seed"]): row["status"] for row in read_rows(out)}


@pytest.mark.parametrize(
    ("deed", "status", "said"),
    [
        ("crash", "poisoned", "SIGSEGV"),
        ("leave", "poisoned", "code 7"),
        ("hang", "timeout", "more than 1 s"),
        ("hog", "memory", "too much"),
        ("suicide", "poisoned", "SIGKILL"),
    ],
)
def test_a_bad_run_is_a_row_with_its_reason(tmp_path: Path, deed: str, status: str, said: str,
                                            monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    monkeypatch.setattr("tomthumb.bench.supervisor.COMPILE_S", 0.0)
    limits = {"seconds": 1, "memory_mb": 500, "attempts": 2, "kills": 3}
    bench(grid(deed, seeds=4, limits=limits), tmp_path, Where(2, runner=RUNNER))
    rows = read_rows(tmp_path)
    assert len(rows) == 8
    for row in rows:
        assert row["status"] == (status if row["seed"] == 1 else "done")
        if row["seed"] == 1:
            assert said in row["reason"]


def test_repetitions_are_counted_over_the_death_of_the_driver(tmp_path: Path) -> None:
    told: list[tuple[str, Strikes]] = []
    job = next(iter(grid("crash", seeds=2).runs()[2:])).job()
    rows: list[dict[str, object]] = []
    run_jobs([job], rows.extend, workers=1, limits=Limits(attempts=3), runner=RUNNER,
             strike=lambda key, strikes, reason: told.append((key, strikes)),
             strikes={job["key"]: Strikes(deaths=2)})  # fmt: skip
    assert [strikes.deaths for _, strikes in told] == [3]
    assert rows[0]["status"] == "poisoned"


@pytest.mark.parametrize("workers", [1, 3])
def test_number_of_workers_makes_no_difference(tmp_path: Path, workers: int) -> None:
    bench(grid(seeds=20), tmp_path / "a", Where(2, runner=RUNNER))
    bench(grid(seeds=20), tmp_path / "b", Where(workers, runner=RUNNER))
    assert lasting(read_rows(tmp_path / "a")) == lasting(read_rows(tmp_path / "b"))


def test_workers_that_cannot_start_end_the_grid_with_their_reason(tmp_path: Path) -> None:
    with pytest.raises(TomThumbError, match=r"cannot be started.*no_such_module"):
        bench(grid(), tmp_path, Where(1, runner="no_such_module:Fake"))


def test_no_process_outlives_the_call(tmp_path: Path) -> None:
    bench(grid(), tmp_path, Where(2, runner=RUNNER))
    assert living_children() == set()


def test_ctrl_c_leaves_rows_and_no_process(tmp_path: Path) -> None:
    def interrupt(rows: int, planned: int, failed: int) -> None:
        if rows >= 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench(grid(sleep=0.02), tmp_path, Where(2, runner=RUNNER), progress=interrupt)
    assert living_children() == set()
    assert len(read_rows(tmp_path)) >= 3
    bench(grid(sleep=0.02), tmp_path, Where(2, runner=RUNNER))
    assert len(read_rows(tmp_path)) == 12


def test_a_killed_worker_costs_nothing(tmp_path: Path) -> None:
    bench(grid(seeds=30, sleep=0.03), tmp_path / "a", Where(2, runner=RUNNER))
    stop = threading.Event()

    def killer() -> None:
        while not stop.wait(0.35):
            for pid in list(living_children())[:1]:
                os.kill(pid, 9)

    thread = threading.Thread(target=killer)
    thread.start()
    bench(grid(seeds=30, sleep=0.03), tmp_path / "b", Where(2, runner=RUNNER))
    stop.set()
    thread.join()
    assert lasting(read_rows(tmp_path / "a")) == lasting(read_rows(tmp_path / "b"))


def living_children() -> set[int]:
    """Processes that this one has started and that still run (Linux)."""
    time.sleep(0.05)
    found = set()
    for task in Path(f"/proc/{os.getpid()}/task").iterdir():
        found |= {int(pid) for pid in (task / "children").read_text().split()}
    return {pid for pid in found if "worker" in Path(f"/proc/{pid}/cmdline").read_text()}
