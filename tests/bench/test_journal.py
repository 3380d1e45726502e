"""The journal keeps what is finished: over kills, a full disk, two drivers at once, merging and other versions."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bench_fakes import RUNNER, grid

from tomthumb.bench import Where, bench, lasting, merge, read_rows, write_rows
from tomthumb.bench.journal import reading, writing
from tomthumb.bench.session import journal_path, parse_shard, part_of
from tomthumb.bench.supervisor import Strikes
from tomthumb.errors import BrokenFile, TomThumbError


def row(key: str, status: str = "done", value: float = 1.0) -> dict[str, object]:
    metrics = {"match_rate": value}
    return {"key": key, "status": status, "reason": None, "metrics": metrics, "seconds": 0.1, "host": "h", "pid": 1}


def test_a_finished_row_is_never_replaced_and_a_failed_one_is(tmp_path: Path) -> None:
    with writing(tmp_path / "j.sqlite") as journal:
        journal.record([row("a", "poisoned", 0.0), row("b", value=0.5)])
        journal.record([row("a", value=0.7), row("b", "error", 0.1)])
        found = dict(journal.base.execute("SELECT key, metrics FROM runs WHERE status = 'done'"))
    assert found == {"a": '{"match_rate": 0.7}', "b": '{"match_rate": 0.5}'}


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "j.sqlite"
    with writing(path) as journal:
        journal.record([row("first")])
        pages = journal.base.execute("PRAGMA page_count").fetchone()[0]
        journal.base.execute(f"PRAGMA max_page_count = {pages + 2}")
        with pytest.raises(TomThumbError, match=r"full.*what was finished before is safe"):
            journal.record([row(f"{i:032d}") | {"reason": "x" * 500} for i in range(200)])
    with reading(path) as journal:
        assert journal.keys() == {"first"}
        assert journal.base.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_full_disk_in_the_middle_of_a_grid_then_continued(tmp_path: Path) -> None:
    script = (
        "import resource, signal, sys; from pathlib import Path; from bench_fakes import *; "
        "from tomthumb.bench import *; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "out = Path(sys.argv[1]); size = lambda: (out / 'journal.sqlite').stat().st_size + 9000; "
        "fill = lambda rows, *_: rows or resource.setrlimit(resource.RLIMIT_FSIZE, (size(), size())); "
        "bench(grid(seeds=60), out, Where(1, runner=RUNNER), progress=fill)"
    )
    path = ":".join([*sys.path, str(Path(__file__).parent)])
    end = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "b")], env={"PYTHONPATH": path}, capture_output=True, check=False
    )
    assert b"TomThumbError" in end.stderr
    kept = len(read_rows(tmp_path / "b"))
    assert 0 < kept < 120
    bench(grid(seeds=60), tmp_path / "a", Where(2, runner=RUNNER))
    tally = bench(grid(seeds=60), tmp_path / "b", Where(2, runner=RUNNER))
    assert tally.before == kept
    assert lasting(read_rows(tmp_path / "a")) == lasting(read_rows(tmp_path / "b"))


def test_a_killed_driver_takes_its_workers_with_it_and_is_continued(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from bench_fakes import *; from tomthumb.bench import *; "
        "bench(grid(seeds=30, sleep=0.02), Path(sys.argv[1]), Where(2, runner=RUNNER))"
    )
    path = ":".join([*sys.path, str(Path(__file__).parent)])
    for _ in range(3):
        driver = subprocess.Popen([sys.executable, "-c", script, str(tmp_path / "b")], env={"PYTHONPATH": path})
        before = rows_there(tmp_path / "b")
        deadline = time.monotonic() + 30
        while rows_there(tmp_path / "b") < before + 4 and time.monotonic() < deadline and driver.poll() is None:
            time.sleep(0.02)
        driver.kill()
        driver.wait()
    bench(grid(seeds=30, sleep=0.02), tmp_path / "b", Where(2, runner=RUNNER))
    bench(grid(seeds=30, sleep=0.02), tmp_path / "a", Where(2, runner=RUNNER))
    rows = read_rows(tmp_path / "b")
    assert lasting(read_rows(tmp_path / "a")) == lasting(rows)
    assert len({r["key"] for r in rows}) == len(rows) == 60


def rows_there(out: Path) -> int:
    try:
        return len(read_rows(out))
    except TomThumbError:
        return 0


def test_only_one_driver_writes(tmp_path: Path) -> None:
    with (
        writing(tmp_path / "j.sqlite"),
        pytest.raises(TomThumbError, match="another bench"),
        writing(tmp_path / "j.sqlite"),
    ):
        pass


def test_anything_else_is_no_journal(tmp_path: Path) -> None:
    (tmp_path / "j.sqlite").write_bytes(b"SQLite format 3\0" + bytes(range(256)) * 20)
    with pytest.raises(BrokenFile, match="journal"), reading(tmp_path / "j.sqlite"):
        pass
    with pytest.raises(BrokenFile, match="journal"), writing(tmp_path / "j.sqlite"):
        pass
    sqlite3.connect(tmp_path / "other.sqlite").close()
    with pytest.raises(BrokenFile, match="no journal of"), reading(tmp_path / "other.sqlite"):
        pass


def test_strikes_outlive_the_driver(tmp_path: Path) -> None:
    with writing(tmp_path / "j.sqlite") as journal:
        journal.strike("a", Strikes(1, 2), "why")
    with writing(tmp_path / "j.sqlite") as journal:
        assert journal.strikes() == {"a": Strikes(1, 2)}
        assert journal.forget_failures() == 0
        assert journal.strikes() == {}


def test_shards_unite_to_the_whole(tmp_path: Path) -> None:
    whole = grid(seeds=11)
    bench(whole, tmp_path / "whole", Where(2, runner=RUNNER))
    for k in (3, 1, 2):
        bench(whole, tmp_path / "parts", Where(1, runner=RUNNER), shard=(k, 3))
    have, planned = merge(whole, tmp_path / "parts", sorted((tmp_path / "parts").glob("journal-*.sqlite")))
    assert have == planned == 22
    assert lasting(read_rows(tmp_path / "whole")) == lasting(read_rows(tmp_path / "parts"))


def test_shards_are_a_partition_and_keep_pairs_together() -> None:
    runs = grid(seeds=11).runs()
    parts = [part_of(runs, (k, 4)) for k in (1, 2, 3, 4)]
    assert sorted(run.key for part in parts for run in part) == sorted(run.key for run in runs)
    worlds = [{run.world for run in part} for part in parts]
    assert sum(len(world) for world in worlds) == 11


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "a/b", "-1/2"])
def test_a_shard_that_is_none(text: str) -> None:
    with pytest.raises(TomThumbError, match="k/n"):
        parse_shard(text)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_rows_come_back_as_they_were(tmp_path: Path, ending: str) -> None:
    if ending == "parquet":
        pytest.importorskip("pyarrow")
    bench(grid("crash", seeds=2, limits={"attempts": 1}), tmp_path, Where(1, runner=RUNNER))
    rows = read_rows(tmp_path)
    write_rows(tmp_path / f"rows.{ending}", rows)
    back = read_rows(tmp_path / f"rows.{ending}")
    for old, new in zip(rows, back, strict=True):
        for key in ("case", "seed", "method", "scenario", "status", "reason", "match_rate", "associator.sleep"):
            assert new[key] == old.get(key), key


def test_rows_of_something_else(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises(BrokenFile, match="no column case"):
        read_rows(tmp_path / "x.csv")
    with pytest.raises(TomThumbError, match="no such file"):
        read_rows(tmp_path / "y.csv")
    (tmp_path / "z.txt").write_text("")
    with pytest.raises(TomThumbError, match="are read from"):
        read_rows(tmp_path / "z.txt")


def test_the_plan_says_what_is_missing(tmp_path: Path) -> None:
    bench(grid(seeds=2), tmp_path, Where(1, runner=RUNNER))
    with writing(journal_path(tmp_path)) as journal:
        labels = {("iekf", a, "slam"): a for a in ("one", "two")}
        journal.set_plan(grid(seeds=5).runs(), labels)
        assert journal.planned() == 10
        assert len(list(journal.rows())) == 4
