"""The worker process: jobs come in on standard input, rows go out on standard output, a JSON line each.

Started as ``python -m tomthumb.bench.worker LIMITS``. It lives as long as its standard input is open: so it ends at
once, in the middle of a run if need be, when its driver is killed.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import queue
import signal
import socket
import sys
import threading
from collections.abc import Callable
from typing import Any, NoReturn

ENOUGH = 3  # after a run that hit its memory bound the process ends, and a fresh one takes its place
RUNNER = "tomthumb.bench.execute:Executor"


def main() -> NoReturn:
    """Work until standard input closes."""
    options = json.loads(sys.argv[1])
    out = _own_output()
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the driver's business
    jobs: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(jobs,), daemon=True).start()
    execute = _runner(options["runner"], options["memory_mb"])
    from tomthumb.bench.version import code_version

    place = {"host": socket.gethostname(), "pid": os.getpid()}
    _send(out, {"hello": place, "code": code_version()})
    while True:
        row = execute(jobs.get())
        _send(out, {**row, **place})
        if row["status"] == "memory":
            os._exit(ENOUGH)  # at once: an orderly end would wait for the thread that reads


def _own_output() -> int:
    """The channel to the driver; whatever a plug-in prints goes to standard error instead."""
    out = os.dup(1)
    os.dup2(2, 1)
    return out


def _read(jobs: queue.SimpleQueue[dict[str, Any]]) -> None:
    for line in sys.stdin.buffer:
        jobs.put(json.loads(line))
    os._exit(0)  # the driver is gone, or needs us no more: not even a run in progress is wanted


def _runner(name: str, memory_mb: float | None) -> Callable[[Any], dict[str, Any]]:
    module, _, attribute = name.partition(":")
    execute: Callable[[Any], dict[str, Any]] = getattr(importlib.import_module(module), attribute)(memory_mb)
    return execute


def _send(out: int, message: dict[str, Any]) -> None:
    data = json.dumps(message, allow_nan=False).encode() + b"\n"
    while data:
        data = data[os.write(out, data) :]


if __name__ == "__main__":
    main()
