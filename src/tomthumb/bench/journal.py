"""The journal: an SQLite file that gets each row as its run finishes, and loses none whatever dies.

One process writes (it holds a lock on the file beside); any number may read. A rollback journal with full
synchronisation survives a kill, a full disk and a power cut, also on network file systems, where SQLite's write-ahead
log does not work.
"""

from __future__ import annotations

import json
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from tomthumb.bench.execute import DONE, Row
from tomthumb.bench.spec import KINDS, RunSpec, canonical
from tomthumb.bench.supervisor import Strikes
from tomthumb.errors import BrokenFile, TomThumbError

FORMAT = 1
COLUMNS = ("key", "status", "reason", "detail", "metrics", "seconds", "attempts", "host", "pid", "finished")
PLAN = ("position", "key", "case_key", "world", "seed", "code", "data", "method", *KINDS, "config")
SCHEMA = f"""
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS runs (key TEXT PRIMARY KEY, {", ".join(COLUMNS[1:])}) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS plan (position INTEGER PRIMARY KEY, {", ".join(PLAN[1:])});
CREATE TABLE IF NOT EXISTS strikes (key TEXT PRIMARY KEY, deaths INTEGER, kills INTEGER, reason TEXT) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS sessions (started, seconds, rows, busy, workers, environment);
"""
PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Journal:
    """An open journal. Made by `writing` or `reading`."""

    path: Path
    base: sqlite3.Connection

    def record(self, rows: Sequence[Row]) -> None:
        """Keep rows, all or none. A key that has a finished row keeps it."""
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        full = [{"detail": None, "attempts": 1, "finished": now, **row} for row in rows]
        values = [[_stored(row[c]) for c in COLUMNS] for row in full]
        with self._transaction():
            self.base.executemany(
                f"INSERT INTO runs VALUES ({','.join('?' * len(COLUMNS))}) ON CONFLICT (key) DO UPDATE SET "
                f"{', '.join(f'{c} = excluded.{c}' for c in COLUMNS[1:])} WHERE runs.status != '{DONE}'",
                values,
            )

    def strike(self, key: str, strikes: Strikes, reason: str) -> None:
        """Remember that a run lost its worker, so that the bound on repetitions survives the driver."""
        with self._transaction():
            row = (key, strikes.deaths, strikes.kills, reason)
            self.base.execute("INSERT OR REPLACE INTO strikes VALUES (?, ?, ?, ?)", row)

    def set_plan(self, runs: Sequence[RunSpec], methods: Mapping[tuple[str, str, str], str]) -> None:
        """What this journal is to hold, in order; replaces what was planned before, and no row."""
        entries = (_planned(i, run, methods) for i, run in enumerate(runs))
        with self._transaction():
            self.base.execute("DELETE FROM plan")
            self.base.executemany(f"INSERT INTO plan VALUES ({','.join('?' * len(PLAN))})", entries)

    def set_about(self, **about: str) -> None:
        """The grid's text and name, and the like."""
        with self._transaction():
            self.base.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())

    def add_session(self, started: str, seconds: float, rows: int, busy: float, workers: str, environment: Any) -> None:
        """One call of the driver: how long it took, how long its runs took, where and by which command."""
        with self._transaction():
            entry = (started, seconds, rows, busy, workers, json.dumps(environment))
            self.base.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?, ?)", entry)

    def forget_failures(self) -> int:
        """Remove every row that is not done, and all strikes, so that those runs are tried again; how many."""
        with self._transaction():
            count = self.base.execute("DELETE FROM runs WHERE status != ?", (DONE,)).rowcount
            self.base.execute("DELETE FROM strikes")
        return count

    def keys(self) -> set[str]:
        """The runs that have their row."""
        return {key for (key,) in self.base.execute("SELECT key FROM runs")}

    def strikes(self) -> dict[str, Strikes]:
        """The lost workers so far, by run."""
        return {key: Strikes(d, k) for key, d, k in self.base.execute("SELECT key, deaths, kills FROM strikes")}

    def about(self) -> dict[str, str]:
        """What `set_about` kept."""
        return dict(self.base.execute("SELECT name, value FROM about"))

    def sessions(self) -> list[dict[str, Any]]:
        """All calls of the driver, in order."""
        names = ("started", "seconds", "rows", "busy", "workers", "environment")
        found = [dict(zip(names, row, strict=True)) for row in self.base.execute("SELECT * FROM sessions")]
        return [session | {"environment": json.loads(session["environment"])} for session in found]

    def planned(self) -> int:
        """How many runs are planned."""
        return int(self.base.execute("SELECT count(*) FROM plan").fetchone()[0])

    def rows(self) -> Iterator[dict[str, Any]]:
        """The planned runs that have a row, in the order of the plan, flat: labels, parameters, status, metrics."""
        wanted = [f"plan.{c}" for c in PLAN] + [f"runs.{c}" for c in COLUMNS[1:]]
        query = f"SELECT {', '.join(wanted)} FROM plan JOIN runs USING (key) ORDER BY position"
        for values in self.base.execute(query):
            yield _flat(dict(zip((*PLAN, *COLUMNS[1:]), values, strict=True)))

    def absorb(self, other: Path) -> int:
        """Take over the rows and sessions of another journal; how many rows were new. Finished rows win."""
        before = len(self.keys())
        with reading(other) as source:
            names = ", ".join(COLUMNS)
            rows = [dict(zip(COLUMNS, row, strict=True)) for row in source.base.execute(f"SELECT {names} FROM runs")]
            sessions = list(source.base.execute("SELECT * FROM sessions"))
        for row in rows:
            row["metrics"] = json.loads(row["metrics"])
        self.record(rows)
        with self._transaction():
            self.base.executemany("INSERT INTO sessions VALUES (?, ?, ?, ?, ?, ?)", sessions)
        return len(self.keys()) - before

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All or nothing; what the disk says against it as one line."""
        try:
            with self.base:
                yield
        except sqlite3.Error as reason:
            safe = "what was finished before is safe; make room and run again to continue"
            raise TomThumbError(f"{self.path}: cannot be written: {reason}; {safe}") from None


@contextmanager
def writing(path: Path) -> Iterator[Journal]:
    """The journal at `path`, made if need be, for the one process that may write. Raises TomThumbError, BrokenFile."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.with_suffix(".lock").open("a+") as lock, _opened(path) as base:
            _hold(lock, path)
            base.executescript(f"PRAGMA synchronous=FULL; PRAGMA journal_mode=TRUNCATE; {SCHEMA}")
            journal = Journal(path, base)
            _check_format(journal)
            yield journal
    except sqlite3.DatabaseError as reason:
        raise BrokenFile(path, f"cannot be used as a journal: {reason}") from None
    except OSError as reason:
        raise TomThumbError(f"{path}: cannot be written: {reason.strerror or reason}") from None


@contextmanager
def reading(path: Path) -> Iterator[Journal]:
    """A journal to read, also while it is being written. Raises TomThumbError, BrokenFile."""
    if not path.is_file():
        raise TomThumbError(f"{path}: no such journal")
    try:
        with _opened(path) as base:
            base.execute("SELECT 1 FROM plan LIMIT 1")
            yield Journal(path, base)
    except sqlite3.DatabaseError as reason:
        raise BrokenFile(path, f"is no journal of tomthumb bench: {reason}") from None


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    base = sqlite3.connect(path, timeout=PATIENCE_S)
    try:
        yield base
    finally:
        base.close()


def _hold(lock: IO[str], path: Path) -> None:
    """Only one driver at a time: the system frees the lock however its holder ends."""
    import fcntl

    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.seek(0)
        raise TomThumbError(f"{path}: another bench is writing to it (process {lock.read().strip()})") from None
    lock.truncate(0)
    lock.write(str(os.getpid()))
    lock.flush()


def _check_format(journal: Journal) -> None:
    found = journal.about().get("format")
    if found is None:
        journal.set_about(format=str(FORMAT))
    elif found != str(FORMAT):
        raise BrokenFile(journal.path, f"has format {found}, this version reads {FORMAT}")


def _stored(value: Any) -> Any:
    return json.dumps(value, allow_nan=False) if isinstance(value, dict) else value


def _planned(position: int, run: RunSpec, methods: Mapping[tuple[str, str, str], str]) -> list[Any]:
    labels = {kind: part.label for kind, part in run.parts().items()}
    data = {part.use: part.files for part in run.parts().values() if part.files}
    config = {kind: {"use": part.use, "params": dict(part.params)} for kind, part in run.parts().items()}
    return [
        position, run.key, run.case, run.world, run.seed, run.code, " ".join(sorted(data.values())),
        methods[labels["estimator"], labels["associator"], labels["slam"]], *labels.values(), canonical(config),
    ]  # fmt: skip


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    """Parameters as columns like ``scenario.laps``, metrics as columns of their own."""
    config, metrics = json.loads(row.pop("config")), json.loads(row.pop("metrics"))
    row["case"] = row.pop("case_key")
    params = {f"{kind}.{key}": v for kind, part in config.items() for key, v in part["params"].items()}
    uses = {f"{kind}.use": part["use"] for kind, part in config.items()}
    return {**row, **uses, **params, **metrics}


def shard_of(worlds: Iterable[str], index: int, count: int) -> set[str]:
    """The worlds of shard `index` of 1..`count`: every count-th in the order they first occur."""
    seen = dict.fromkeys(worlds)
    return {world for i, world in enumerate(seen) if i % count == index - 1}
