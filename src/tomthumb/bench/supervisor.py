"""Local processes under supervision: a dead worker is replaced, its run repeated a bounded number of times.

The driver is one thread around a selector. Each worker is kept about a second of jobs ahead, so that neither messages
nor the journal make it wait; towards the end of the grid the lead shrinks so that nobody is left with all that remains.
"""

from __future__ import annotations

import selectors
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from tomthumb.bench.child import Child, Death, start
from tomthumb.bench.execute import POISONED, TIMEOUT, Job, Row
from tomthumb.bench.grid import UNBOUNDED, Limits
from tomthumb.bench.version import code_version
from tomthumb.bench.worker import ENOUGH, RUNNER
from tomthumb.errors import TomThumbError

LEAD_S = 1.0  # of jobs given ahead
MOST_AHEAD = 64
TICK_S = 1.0
COMPILE_S = 300.0  # more for a worker's first run, which may have to wait for kernels that were never compiled here
STILLBORN = 5  # workers in a row that die before they say hello: something is wrong with all of them


@dataclass(frozen=True, slots=True)
class Strikes:
    """How often a run brought its worker down (`deaths`), or lost it through no fault of its own (`kills`)."""

    deaths: int = 0
    kills: int = 0


@dataclass(slots=True)
class Supervisor:
    """Runs jobs on `workers` processes. `record` gets rows as they finish, several at a time where they come together.

    `strike(key, strikes, reason)` is told of every lost worker; `idle` are children that live on between calls.
    """

    jobs: deque[Job]
    record: Callable[[list[Row]], None]
    workers: int = 1
    limits: Limits = UNBOUNDED
    strike: Callable[[str, Strikes, str], None] = lambda key, strikes, reason: None
    strikes: dict[str, Strikes] = field(default_factory=dict)
    runner: str = RUNNER
    idle: list[Child] = field(default_factory=list)
    children: list[Child] = field(default_factory=list)
    selector: selectors.BaseSelector = field(default_factory=selectors.DefaultSelector)
    average: float = 0.0
    stillborn: int = 0

    def run(self) -> None:
        """Until every job has its row. Raises TomThumbError when workers cannot even be started."""
        try:
            while self.jobs or any(child.jobs for child in self.children):
                self._staff()
                self._feed()
                if rows := self._listen():
                    self.record(rows)
                self._end_overdue()
        except BaseException:
            for child in self.children:
                child.end()
            raise
        finally:
            self.selector.close()
        self.idle.extend(self.children)

    def _staff(self) -> None:
        """As many workers as there is work for."""
        wanted = min(self.workers, len(self.jobs) + sum(1 for child in self.children if child.jobs))
        while len(self.children) < wanted:
            child = self.idle.pop() if self.idle else start(self.limits.memory_mb, self.runner)
            self.children.append(child)
            assert child.process.stdout is not None
            self.selector.register(child.process.stdout, selectors.EVENT_READ, child)

    def _feed(self) -> None:
        for child in self.children:
            ahead = self._lead()
            if self.jobs and len(child.jobs) <= ahead // 2:
                count = min(ahead - len(child.jobs), len(self.jobs))
                child.give([self.jobs.popleft() for _ in range(count)])

    def _lead(self) -> int:
        """Jobs that one worker should have before it."""
        fair = len(self.jobs) // (2 * self.workers) + 1
        wanted = int(LEAD_S / self.average) if self.average else 2
        return max(1, min(MOST_AHEAD, fair, max(2, wanted)))

    def _listen(self) -> list[Row]:
        rows: list[Row] = []
        for event, _ in self.selector.select(TICK_S):
            child: Child = event.data
            messages = child.read()
            if messages is None:
                rows += self._bury(child)
                continue
            for message in messages:
                rows += self._heard(child, message)
        return rows

    def _heard(self, child: Child, message: Row) -> list[Row]:
        if "hello" in message:
            if message["code"] != code_version():
                raise TomThumbError("the code was changed while the grid was running: start again with the new code")
            child.ready, child.since, self.stillborn = True, time.monotonic(), 0
            return []
        child.answered(message["key"])
        seconds = message["seconds"]
        self.average = seconds if not self.average else 0.9 * self.average + 0.1 * seconds
        return [self._finished(message)]

    def _finished(self, row: Row) -> Row:
        spent = self.strikes.get(row["key"], Strikes())
        return row | {"attempts": 1 + spent.deaths + spent.kills}

    def _bury(self, child: Child) -> list[Row]:
        """A dead worker: its run gets a strike, the runs behind it go back untouched."""
        self._dismiss(child)
        death = child.end()
        if not child.ready:
            return self._never_lived(child, death)
        if not child.jobs:
            return []
        if death.code == ENOUGH or child.late not in (None, child.jobs[0]["key"]):
            self.jobs.extendleft(reversed(child.jobs))  # it ended between two runs: nobody's fault
            return []
        job, *rest = child.jobs
        self.jobs.extendleft(reversed(rest))
        if child.late:
            return [self._lost(job, TIMEOUT, f"took more than {self.limits.seconds:g} s")]
        before = self.strikes.get(job["key"], Strikes())
        now = Strikes(before.deaths + (not death.from_outside), before.kills + death.from_outside)
        reason = f"its worker {death}"
        self.strikes[job["key"]] = now
        self.strike(job["key"], now, reason)
        if now.deaths >= self.limits.attempts or now.kills >= self.limits.kills:
            return [self._lost(job, POISONED, f"{now.deaths + now.kills} times {reason}")]
        self.jobs.append(job)
        return []

    def _never_lived(self, child: Child, death: Death) -> list[Row]:
        self.jobs.extendleft(reversed(child.jobs))
        self.stillborn += not death.from_outside
        if self.stillborn >= STILLBORN:
            raise TomThumbError(f"workers cannot be started: the last one {death}")
        return []

    def _lost(self, job: Job, status: str, reason: str) -> Row:
        row: Row = {"key": job["key"], "status": status, "reason": reason, "detail": None, "metrics": {}}
        return self._finished(row | {"seconds": None, "host": None, "pid": None})

    def _dismiss(self, child: Child) -> None:
        self.children.remove(child)
        assert child.process.stdout is not None
        self.selector.unregister(child.process.stdout)

    def _end_overdue(self) -> None:
        """Kill whoever has been at one run for too long; the end of its output does the rest."""
        if self.limits.seconds is None:
            return
        for child in self.children:
            allowed = self.limits.seconds + (0.0 if child.answers else COMPILE_S)
            if child.ready and child.jobs and child.late is None and time.monotonic() - child.since > allowed:
                child.late = child.jobs[0]["key"]
                child.process.kill()


def run_jobs(
    jobs: Iterable[Job],
    record: Callable[[list[Row]], None],
    *,
    workers: int,
    limits: Limits = UNBOUNDED,
    strike: Callable[[str, Strikes, str], None] = lambda key, strikes, reason: None,
    strikes: Mapping[str, Strikes] | None = None,
    runner: str = RUNNER,
) -> None:
    """Run `jobs` on `workers` supervised processes that end with the call. Raises TomThumbError as `Supervisor.run`."""
    boss = Supervisor(deque(jobs), record, workers, limits, strike, dict(strikes or {}), runner)
    try:
        boss.run()
    finally:
        for child in boss.idle:
            child.end()
