"""One job becomes one row. Whatever goes wrong in it is the row's reason, never the end of the worker."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

from tomthumb.errors import TomThumbError
from tomthumb.types import Scenario

DONE, REFUSED, ERROR, MEMORY, TIMEOUT, POISONED = "done", "refused", "error", "memory", "timeout", "poisoned"
WARM_STEPS = 30
MEGABYTE = 1 << 20

Job = Mapping[str, Any]
Row = dict[str, Any]


@dataclass(slots=True)
class Executor:
    """Runs jobs one after another; keeps the last world, which the next job of a pair needs again.

    `memory_mb` bounds what one run may take on top of what the process holds when it starts; `measure` is what is done
    with a world and a job, the metrics of the run by default.
    """

    memory_mb: float | None = None
    measure: Callable[[Scenario, Job], dict[str, Any]] | None = None
    world: str = ""
    scenario: Scenario | None = None
    warm: set[str] = field(default_factory=set)
    checked: set[str] = field(default_factory=set)

    def __call__(self, job: Job) -> Row:
        """The row of one job: status, reason, metrics and the seconds it took (kernels warm)."""
        row: Row = {"key": job["key"], "status": DONE, "reason": None, "detail": None, "metrics": {}}
        started = time.perf_counter()
        try:
            with memory_bound(self.memory_mb):
                scenario = self._world(job)
                started += self._warm_up(scenario, job)
                row["metrics"] = (self.measure or measured)(scenario, job)
        except TomThumbError as reason:
            row |= {"status": REFUSED, "reason": str(reason)}
        except MemoryError:
            row |= {"status": MEMORY, "reason": f"needs more than {self.memory_mb:g} MB"}
        except Exception as bug:
            row |= {"status": ERROR, "reason": f"{type(bug).__name__}: {bug}", "detail": traceback.format_exc()}
        row["seconds"] = time.perf_counter() - started
        return row

    def _world(self, job: Job) -> Scenario:
        if self.scenario is None or self.world != job["world"]:
            self.world, self.scenario = "", None  # let the old one go before the new one is built
            self._check_files(job["files"])
            self.scenario = load_world(job)
            self.world = job["world"]
        return self.scenario

    def _check_files(self, files: Mapping[str, str]) -> None:
        """The files of a job are those that its key was made from, also on this machine."""
        from tomthumb.bench.version import data_checksum

        for use, wanted in files.items():
            if use in self.checked:
                continue
            path = path_in(use)
            if not path.exists():
                raise TomThumbError(f"{path}: no such file or folder on this machine")
            if data_checksum(path) != wanted:
                raise TomThumbError(f"{path}: is not what the grid was made with")
            self.checked.add(use)

    def _warm_up(self, scenario: Scenario, job: Job) -> float:
        """Let the kernels of this combination compile on the first steps, so that no row times it; the seconds it
        took.
        """
        name = f"{job['scenario']['use']} {job['estimator']} {job['associator']}"
        if name in self.warm:
            return 0.0
        started = time.perf_counter()
        run_world(replace(scenario, steps=list(islice(scenario.steps, WARM_STEPS))), job)
        self.warm.add(name)
        return time.perf_counter() - started


def path_in(use: str) -> Path:
    """The path within ``kind:path?query`` or ``file.py:Name``; `use` holds a full path."""
    plain = use.partition("?")[0]
    before, _, _ = plain.rpartition(":")
    if before.endswith(".py"):
        return Path(before)
    start = plain.find(":/") + 1 if ":/" in plain else 0
    return Path(plain[start:])


def load_world(job: Job) -> Scenario:
    """The scenario of a job."""
    from tomthumb.scenarios import load

    return load(job["scenario"]["use"], seed=job["seed"], **job["scenario"]["params"])


def run_world(scenario: Scenario, job: Job) -> Any:
    """The trace of a job in its scenario."""
    from tomthumb.runner import run

    settings = {kind: job[kind]["params"] for kind in ("estimator", "associator", "slam")}
    associator, estimator = job["associator"]["use"], job["estimator"]["use"]
    return run(scenario, associator=associator, estimator=estimator, seed=job["seed"], settings=settings)


def measured(scenario: Scenario, job: Job) -> dict[str, Any]:
    """The metrics of a job in its scenario."""
    from tomthumb.metrics import evaluate

    return evaluate(run_world(scenario, job), scenario)


@contextmanager
def memory_bound(megabytes: float | None) -> Iterator[None]:
    """More than `megabytes` on top of the present size raises MemoryError inside. Linux only; elsewhere unbounded."""
    size = _address_space()
    if megabytes is None or size is None:
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = size + int(megabytes * MEGABYTE)
    resource.setrlimit(resource.RLIMIT_AS, (bound if hard == resource.RLIM_INFINITY else min(bound, hard), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _address_space() -> int | None:
    """Bytes of address space in use, None where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * 4096
    except OSError:
        return None
