"""On a Dask worker: supervised processes of our own, kept between tasks.

So a run on a cluster gets what it gets at home (its own process, one thread, memory and time bound, reasons for
failures), and nothing it does can harm the Dask worker.
"""

from __future__ import annotations

import queue
from collections import deque
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker

from tomthumb.bench.child import Child
from tomthumb.bench.execute import Job, Row
from tomthumb.bench.grid import Limits
from tomthumb.bench.supervisor import Supervisor
from tomthumb.bench.version import code_version
from tomthumb.errors import TomThumbError

NAME = "tomthumb-children"


class Children(WorkerPlugin):
    """The processes of one Dask worker; they end with it, however it ends, since their standard input closes."""

    name = NAME

    def setup(self, worker: Worker) -> None:
        """Dask calls this once on each worker."""
        self.idle: queue.SimpleQueue[Child] = queue.SimpleQueue()

    def teardown(self, worker: Worker) -> None:
        """And this when a worker is closed in good order."""
        while child := self.take():
            child.end()

    def take(self) -> Child | None:
        """A process that has nothing to do, if there is one."""
        try:
            return self.idle.get_nowait()
        except queue.Empty:
            return None


def work(jobs: list[Job], limits: Limits, runner: str, code: str) -> list[Row]:
    """The task: the rows of some jobs. Raises TomThumbError where this worker has other code than the driver."""
    if code != code_version():
        raise TomThumbError(f"a Dask worker has tomthumb {code_version()}, the driver {code}: install the same on both")
    children: Any = get_worker().plugins[NAME]
    rows: list[Row] = []
    idle = child_list(children.take())
    boss = Supervisor(deque(jobs), rows.extend, limits=limits, runner=runner, idle=idle)
    boss.run()
    for child in boss.idle:
        children.idle.put(child)
    return rows


def child_list(child: Child | None) -> list[Child]:
    """None or one, as a list."""
    return [] if child is None else [child]
