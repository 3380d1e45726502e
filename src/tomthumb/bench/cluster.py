"""A Dask cluster as the place of the runs. Dask moves the work; what is finished is in our journal only.

Workers, nodes and the scheduler may die: what was fetched is safe, everything else is sent again. Nothing is asked of
the cluster but a Python with the same tomthumb.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from tomthumb.bench.execute import POISONED, Job, Row
from tomthumb.bench.grid import UNBOUNDED, Limits
from tomthumb.bench.session import Notice, Where
from tomthumb.bench.supervisor import Strikes
from tomthumb.bench.version import code_version
from tomthumb.errors import TomThumbError

TASK_S = 1.0  # of runs in a task: Dask's own 2 ms are then nothing, and a lost worker costs little
BACKLOG = 3  # tasks in flight for each thread of the cluster
MOST = 256
SAFE = "what was finished is safe; run again to continue"


@dataclass(slots=True)
class Drought:
    """How long the scheduler at `address` has been without a worker: told once, and borne for `patience_s`."""

    address: str
    patience_s: float
    notice: Notice
    since: float | None = None

    def look(self, threads: int, now: float) -> None:
        """The cluster has so many threads at the time `now` s. Raises TomThumbError after too long with none."""
        if threads:
            self.since = None
        elif self.since is None:
            self.since = now
            self.notice(
                f"--dask {self.address}: the scheduler has no worker; waiting up to {self.patience_s:g} s for one"
            )
        elif now - self.since > self.patience_s:
            raise TomThumbError(
                f"--dask {self.address}: the scheduler has had no worker for {self.patience_s:g} s: start some "
                f"(dask worker ADDRESS) or wait longer (--patience); {SAFE}"
            )


@dataclass(slots=True)
class Fleet:
    """What is still to do, and what a lost task costs: `lost` counts how often a task with this run first was lost."""

    jobs: deque[Job]
    record: Callable[[list[Row]], None]
    limits: Limits
    runner: str
    strike: Callable[[str, Strikes, str], None]
    strikes: dict[str, Strikes]
    average: float = 0.0
    flying: dict[Any, list[Job]] = field(default_factory=dict)

    def chunk(self, threads: int) -> list[Job]:
        """The next task: about a second of runs, single ones while nothing is known and for runs that lost a worker."""
        if self.jobs[0]["key"] in self.strikes:
            return [self.jobs.popleft()]
        fair = len(self.jobs) // (2 * threads) + 1
        size = min(MOST, fair, max(1, int(TASK_S / self.average))) if self.average else 1
        return [self.jobs.popleft() for _ in range(min(size, len(self.jobs)))]

    def landed(self, rows: list[Row]) -> None:
        """Rows have come home."""
        for row in rows:
            row["attempts"] += self.strikes.get(row["key"], Strikes()).kills
        self.record(rows)
        for row in rows:
            seconds = row["seconds"] or self.average
            self.average = seconds if not self.average else 0.9 * self.average + 0.1 * seconds

    def crashed(self, jobs: Sequence[Job], reason: str) -> None:
        """Dask gave a task up, since every worker that took it died: its runs are sent again one by one, not for
        ever.
        """
        for job in jobs:
            before = self.strikes.get(job["key"], Strikes())
            now = Strikes(before.deaths, before.kills + 1)
            self.strikes[job["key"]] = now
            self.strike(job["key"], now, reason)
            if now.kills < self.limits.kills:
                self.jobs.append(job)
            else:
                row = {"key": job["key"], "status": POISONED, "reason": f"{now.kills} times {reason}", "metrics": {}}
                self.record([row | {"detail": None, "seconds": None, "host": None, "pid": None, "attempts": now.kills}])

    def recall(self) -> None:
        """The scheduler is gone, and with it all that was flying."""
        for jobs in self.flying.values():
            self.jobs.extendleft(reversed(jobs))
        self.flying.clear()


def run_on_cluster(
    jobs: Sequence[Job],
    record: Callable[[list[Row]], None],
    where: Where,
    *,
    limits: Limits = UNBOUNDED,
    strike: Callable[[str, Strikes, str], None] = lambda key, strikes, reason: None,
    strikes: Mapping[str, Strikes] | None = None,
    notice: Notice = lambda line: None,
) -> None:
    """Run `jobs` on the Dask cluster `where` says, through any number of losses.

    Raises TomThumbError when for `where.patience_s` no scheduler answers or it has no worker, when Dask is not
    installed, or the code differs.
    """
    _dask()
    fleet = Fleet(deque(jobs), record, limits, where.runner, strike, dict(strikes or {}))
    with _quiet():
        _through_losses(fleet, where, notice)


def _through_losses(fleet: Fleet, where: Where, notice: Notice) -> None:
    patience_s = where.patience_s
    drought = Drought(str(where.dask), patience_s, notice)
    deadline = time.monotonic() + patience_s
    while fleet.jobs or fleet.flying:
        before = len(fleet.jobs)
        try:
            with _client(where) as client, client.as_current():
                _fly(fleet, client, drought)
        except (OSError, TimeoutError, asyncio.CancelledError, CancelledError, SchedulerLost) as reason:
            fleet.recall()
            if len(fleet.jobs) < before:
                deadline = time.monotonic() + patience_s
            if time.monotonic() > deadline:
                raise TomThumbError(
                    f"--dask {where.dask}: no scheduler for {patience_s:g} s ({reason}); {SAFE}"
                ) from None
            time.sleep(1.0)


class SchedulerLost(Exception):
    """The cluster as we knew it is gone."""


def _fly(fleet: Fleet, client: Any, drought: Drought) -> None:
    """Keep the cluster busy until all is home. Raises SchedulerLost, and TomThumbError when no worker comes."""
    from distributed import wait

    from tomthumb.bench.cluster_children import Children

    client.register_plugin(Children())
    while fleet.jobs or fleet.flying:
        threads = sum(client.nthreads().values())
        drought.look(threads, time.monotonic())
        _launch(fleet, client, max(1, threads))
        try:
            done = wait(list(fleet.flying), timeout=2.0, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            done = set()
        if client.status != "running":
            raise SchedulerLost(f"the connection is {client.status}")
        for future in done:
            _land(fleet, future)


def _launch(fleet: Fleet, client: Any, threads: int) -> None:
    from tomthumb.bench.cluster_children import work

    while fleet.jobs and len(fleet.flying) < BACKLOG * threads:
        jobs = fleet.chunk(threads)
        fleet.flying[client.submit(work, jobs, fleet.limits, fleet.runner, code_version(), pure=False)] = jobs


def _land(fleet: Fleet, future: Any) -> None:
    from distributed import KilledWorker

    if future.status in ("cancelled", "lost"):
        raise SchedulerLost(f"a task is {future.status}")
    jobs = fleet.flying.pop(future)
    if future.status == "finished":
        fleet.landed(future.result())
        return
    reason = future.exception()
    if not isinstance(reason, KilledWorker):
        raise reason
    fleet.crashed(jobs, "the Dask workers that took it died")


@contextmanager
def _client(where: Where) -> Iterator[Any]:
    """A client of the scheduler at the address, or of a cluster of our own that ends with it."""
    from distributed import Client, LocalCluster

    if where.dask != "local":
        with Client(where.dask, timeout="5s", set_as_default=False) as client:
            yield client
        return
    options = {"n_workers": where.workers, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster, set_as_default=False) as client:
        yield client


@contextmanager
def _quiet() -> Iterator[None]:
    """A lost scheduler is our business: Dask need not print pages about it."""
    logger = logging.getLogger("distributed.client")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _dask() -> None:
    try:
        import distributed  # noqa: F401
    except ModuleNotFoundError:
        raise TomThumbError("--dask needs Dask: pip install 'tomthumb[dask]'") from None
