"""The driver's handle on one worker process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from dataclasses import dataclass, field
from typing import IO, Any

from tomthumb.bench.execute import Job
from tomthumb.bench.worker import RUNNER

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS")
BLOCK = 1 << 16
WORDS = 300


@dataclass(frozen=True, slots=True)
class Death:
    """How a worker ended: `code` is its return code, minus the signal; `words` the end of what it said to nobody."""

    code: int
    words: str

    @property
    def from_outside(self) -> bool:
        """Signals that a process does not send itself: an operator, the out-of-memory killer, a batch system."""
        return -self.code in (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP)

    def __str__(self) -> str:
        how = f"ended with code {self.code}" if self.code >= 0 else f"died of {_signal(-self.code)}"
        return f"{how}: {self.words}" if self.words else how


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


@dataclass(slots=True)
class Child:
    """A worker with the jobs it was given and has not answered; the first of them is the one it is at.

    `since` is when it began that one; `ready` is True once it has said hello; `late` is the key of the run that took
    too long, if one did.
    """

    process: subprocess.Popen[bytes]
    errors: IO[bytes]
    jobs: deque[Job] = field(default_factory=deque)
    since: float = field(default_factory=time.monotonic)
    ready: bool = False
    late: str | None = None
    answers: int = 0
    rest: bytes = b""

    def give(self, jobs: list[Job]) -> None:
        """More jobs. A worker that has just died is noticed when its output ends, not here."""
        if not self.jobs:
            self.since = time.monotonic()
        self.jobs.extend(jobs)
        assert self.process.stdin is not None
        try:
            for job in jobs:
                self.process.stdin.write(json.dumps(job).encode() + b"\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return  # the end of its output tells the rest, with the reason

    def read(self) -> list[dict[str, Any]] | None:
        """The messages that are there; None when it is dead and all it said was read."""
        assert self.process.stdout is not None
        block = os.read(self.process.stdout.fileno(), BLOCK)
        if not block:
            return None
        *lines, self.rest = (self.rest + block).split(b"\n")
        return [json.loads(line) for line in lines]

    def answered(self, key: str) -> None:
        """The row of its present job has come."""
        assert self.jobs[0]["key"] == key, "a worker answers in the order of its jobs"
        self.jobs.popleft()
        self.answers += 1
        self.since = time.monotonic()

    def end(self) -> Death:
        """Kill it if it still lives; its return code (minus the signal) and last words."""
        self.process.kill()
        death = Death(self.process.wait(), self._last_words())
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            close_quietly(pipe)
        return death

    def _last_words(self) -> str:
        """The end of what it wrote to standard error, on one line."""
        size = self.errors.seek(0, os.SEEK_END)
        self.errors.seek(max(0, size - 4096))
        lines = [line.strip() for line in self.errors.read().decode(errors="replace").splitlines() if line.strip()]
        return next((line for line in lines if "Error" in line or "Fatal" in line), lines[-1] if lines else "")[:WORDS]


def start(memory_mb: float | None, runner: str = RUNNER) -> Child:
    """A new worker process: one thread for linear algebra, hash order fixed, memory bound per run."""
    environment = os.environ | dict.fromkeys(THREADS, "1") | {"PYTHONHASHSEED": "0"}
    environment["PYTHONPATH"] = os.pathsep.join(path or os.getcwd() for path in sys.path)
    errors = tempfile.TemporaryFile()  # noqa: SIM115 (it lives as long as the child)
    options = json.dumps({"memory_mb": memory_mb, "runner": runner})
    process = subprocess.Popen(
        [sys.executable, "-m", "tomthumb.bench.worker", options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        env=environment,
    )
    return Child(process, errors)


def close_quietly(pipe: IO[bytes] | None) -> None:
    """Close a pipe whose other end may be gone, with bytes still unwritten."""
    if pipe is None:
        return
    try:
        pipe.close()
    except BrokenPipeError:
        return
