"""A stand-in for runs: quick, the same on every machine, and able to go wrong in every way that a run can."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from typing import Any

from tomthumb.bench.execute import memory_bound
from tomthumb.bench.grid import Grid, from_table
from tomthumb.bench.spec import digest

RUNNER = "bench_fakes:Fake"


class Fake:
    """Does what the associator's parameter `do` says; the result depends on the job alone."""

    def __init__(self, memory_mb: float | None) -> None:
        self.memory_mb = memory_mb

    def __call__(self, job: dict[str, Any]) -> dict[str, Any]:
        started = time.perf_counter()
        params = job["associator"]["params"]
        time.sleep(params.get("sleep", 0.0))
        row: dict[str, Any] = {"key": job["key"], "status": "done", "reason": None, "detail": None}
        try:
            with memory_bound(self.memory_mb):
                DEEDS[params.get("do", "work")](job["seed"])
        except MemoryError:
            row |= {"status": "memory", "reason": "too much"}
        value = int(digest({"key": job["key"]}), 16) / 16**32
        return row | {"metrics": {"match_rate": value}, "seconds": time.perf_counter() - started}


def _work(seed: int) -> None:
    print("a plug-in that prints")


def _crash(seed: int) -> None:
    if seed == 1:
        ctypes.string_at(0)


def _hang(seed: int) -> None:
    if seed == 1:
        time.sleep(3600)


def _hog(seed: int) -> None:
    if seed == 1:
        _ = bytearray(1 << 31)


def _leave(seed: int) -> None:
    if seed == 1:
        os._exit(7)


def _suicide(seed: int) -> None:
    if seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)


DEEDS = {"work": _work, "crash": _crash, "hang": _hang, "hog": _hog, "leave": _leave, "suicide": _suicide}


def grid(do: str = "work", seeds: int = 6, sleep: float = 0.0, limits: dict[str, float] | None = None) -> Grid:
    """A grid of stand-ins: two methods on one world."""
    axis = {"use": "nn", "do": do, "sleep": sleep}
    table = {
        "seeds": seeds,
        "scenario": [{"use": "cloister"}],
        "associator": [{**axis, "label": "one"}, {**axis, "label": "two", "extra": 1}],
        "limits": limits or {},
    }
    from pathlib import Path

    return from_table({"name": "stand-ins", **table}, Path.cwd())
