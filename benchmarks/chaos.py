"""Kill workers and drivers at random times during a grid: the rows must be those of an undisturbed run, none doubled.

    python benchmarks/chaos.py --workers 50 --drivers 10
    python benchmarks/chaos.py --dask            # a Dask worker, a node and the scheduler, twice each

Linux only: processes are found through /proc.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tomthumb.bench import Where, bench, lasting, read_grid, read_rows
from tomthumb.bench.journal import reading
from tomthumb.bench.session import journal_path
from tomthumb.errors import BrokenFile

GRID = """
seeds = {seeds}
[[scenario]]
use = "cloister"
[[associator]]
use = "nn"
[[associator]]
use = "jcbb"
"""
DRIVE = """
import sys
from pathlib import Path
from tomthumb.bench import Where, bench, read_grid
bench(read_grid(Path(sys.argv[1])), Path(sys.argv[2]), Where(2, sys.argv[3] or None))
"""


def main() -> int:
    """Run the trial asked for; 0 when the rows are the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=50, help="kills of workers")
    parser.add_argument("--drivers", type=int, default=10, help="kills of the driver")
    parser.add_argument("--seeds", type=int, default=400, help="seeds of the grid (two runs each)")
    parser.add_argument("--dask", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        (home / "grid.toml").write_text(GRID.format(seeds=options.seeds))
        print("undisturbed", flush=True)
        tally = bench(read_grid(home / "grid.toml"), home / "calm", Where(2))
        print(f"{tally.rows} rows in {tally.seconds:.0f} s, overhead {100 * tally.overhead(2):.1f} %", flush=True)
        if options.dask:
            done = dask_chaos(home, rounds=2)
        else:
            done = chaos(home, options.workers, options.drivers, random.Random(1))
        return judge(home, done)


def judge(home: Path, done: dict[str, int]) -> int:
    """Compare the two journals and say so."""
    calm, wild = read_rows(home / "calm"), read_rows(home / "wild")
    same = lasting(calm) == lasting(wild)
    doubled = len(wild) - len({row["key"] for row in wild})
    repeated = sum(row["attempts"] > 1 for row in wild)
    print(f"killed: {done}; {len(wild)} rows, {doubled} doubled, {repeated} repeated; same as undisturbed: {same}")
    return 0 if same and not doubled else 1


def chaos(home: Path, workers: int, drivers: int, rng: random.Random) -> dict[str, int]:
    """Kill so many workers and drivers, in random order at random times, restarting the driver; then let it finish."""
    victims = ["worker"] * workers + ["driver"] * drivers
    rng.shuffle(victims)
    killed = {"worker": 0, "driver": 0}
    driver = drive(home)
    for victim in victims:
        wait_for_rows(home, driver, count_rows(home) + 1)  # so that most kills hit a run, and few a start
        time.sleep(rng.uniform(0.0, 0.7))
        pids = [driver.pid] if victim == "driver" else busy_workers(driver)
        if driver.poll() is not None or not pids:
            break  # the grid is done: too few seeds for so many kills
        kill(rng.choice(pids))
        killed[victim] += 1
        if victim == "driver":
            driver.wait()
            driver = drive(home)
    driver.wait()
    return killed


def drive(home: Path, dask: str = "") -> subprocess.Popen[bytes]:
    """A driver of its own."""
    return subprocess.Popen([sys.executable, "-c", DRIVE, str(home / "grid.toml"), str(home / "wild"), dask])


def busy_workers(driver: subprocess.Popen[bytes], patience_s: float = 60.0) -> list[int]:
    """The driver's worker processes, waited for."""
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline and driver.poll() is None:
        if pids := [pid for pid in descendants(driver.pid) if "tomthumb.bench.worker" in command(pid)]:
            return pids
        time.sleep(0.05)
    return []


def descendants(pid: int) -> Iterator[int]:
    """All processes below `pid`."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        below = [int(child) for task in tasks for child in (task / "children").read_text().split()]
    except OSError:  # it ended meanwhile
        return
    for child in below:
        yield child
        yield from descendants(child)


def command(pid: int) -> str:
    """The command line of a process, "" if it ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def kill(pid: int) -> None:
    """kill -9, if it still lives."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def dask_chaos(home: Path, rounds: int, pause_s: float = 6.0) -> dict[str, int]:
    """A Dask worker, a node (the nanny with all below it) and the scheduler killed, `rounds` times each."""
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    cluster: dict[str, Any] = {"scheduler": scheduler(port), "nodes": [node(address), node(address)]}
    driver = drive(home, address)
    deeds: dict[str, Callable[[], None]] = {
        "dask worker": lambda: kill(dask_worker(cluster)),
        "node": lambda: lose_node(cluster, address),
        "scheduler": lambda: lose_scheduler(cluster, port, address),
    }
    killed = dict.fromkeys(deeds, 0)
    try:
        while wait_for_rows(home, driver, 1) and min(killed.values()) < rounds:
            name = min(killed, key=lambda deed: killed[deed])
            time.sleep(pause_s)
            if driver.poll() is not None:
                break
            deeds[name]()
            killed[name] += 1
        driver.wait()
    finally:
        for process in [driver, cluster["scheduler"], *cluster["nodes"]]:
            end_tree(process)
    return killed


def scheduler(port: int) -> subprocess.Popen[bytes]:
    """A Dask scheduler."""
    arguments = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-show"]
    return dask(*arguments)


def node(address: str) -> subprocess.Popen[bytes]:
    """A Dask worker under its nanny, as a batch system would start it on a node."""
    return dask("worker", address, "--nworkers", "1", "--nthreads", "1", "--no-dashboard", "--death-timeout", "60")


def dask(*arguments: str) -> subprocess.Popen[bytes]:
    """A process of Dask, quiet."""
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, "-m", "dask", *arguments], stdout=quiet, stderr=quiet)


def dask_worker(cluster: dict[str, Any]) -> int:
    """The worker process below the first nanny that has one."""
    pids = [pid for process in cluster["nodes"] for pid in descendants(process.pid) if "spawn_main" in command(pid)]
    return pids[0] if pids else cluster["nodes"][0].pid


def lose_node(cluster: dict[str, Any], address: str) -> None:
    """Everything on one node dies at once; another node joins."""
    end_tree(cluster["nodes"].pop(0))
    cluster["nodes"].append(node(address))


def lose_scheduler(cluster: dict[str, Any], port: int, address: str) -> None:
    """The scheduler dies; a new one comes up at the same place, with new nodes."""
    end_tree(cluster["scheduler"])
    cluster["scheduler"] = scheduler(port)
    for process in cluster["nodes"]:
        end_tree(process)
    cluster["nodes"] = [node(address), node(address)]


def end_tree(process: subprocess.Popen[bytes]) -> None:
    """Kill a process of ours and all below it."""
    for pid in [*descendants(process.pid), process.pid]:
        kill(pid)
    process.wait()


def wait_for_rows(home: Path, driver: subprocess.Popen[bytes], count: int) -> bool:
    """Until the journal has rows; False if the driver ended first."""
    while driver.poll() is None:
        if count_rows(home) >= count:
            return True
        time.sleep(0.2)
    return False


def count_rows(home: Path) -> int:
    """Rows of the disturbed grid so far."""
    if not journal_path(home / "wild").exists():
        return 0
    try:
        with reading(journal_path(home / "wild")) as journal:
            return len(journal.keys())
    except BrokenFile:  # its tables are being made
        return 0


def free_port() -> int:
    """A port nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    sys.exit(main())
