"""How long a report of many runs takes to open in a browser and to sort: python benchmarks/report_opening.py

The rows are drawn from a random generator (no run is made); the browser is Debian's Chromium, driven by Playwright.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tomthumb.bench.grid import Grid, from_table
from tomthumb.bench.journal import writing
from tomthumb.bench.session import journal_path, plan
from tomthumb.site import build

BROWSER = Path("/usr/bin/chromium")
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


def main() -> int:
    """Build, open, sort, and print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000)
    rows = parser.parse_args().rows
    with tempfile.TemporaryDirectory() as folder:
        grid = invented(rows, Path(folder))
        started = time.perf_counter()
        index = build(grid, Path(folder), pages=0)
        built = time.perf_counter() - started
        size = sum(path.stat().st_size for path in index.parent.rglob("*") if path.is_file())
        print(f"{rows} rows: built in {built:.1f} s, {size / 1e6:.1f} MB")
        for name, seconds in opened(index).items():
            print(f"{name}: {seconds:.2f} s")
    return 0


def invented(count: int, out: Path) -> Grid:
    """A grid of four methods in five scenarios with a journal full of made-up rows."""
    table = {
        "name": "invented", "seeds": max(1, count // 20), "baseline": "nn",
        "scenario": [{"use": "cloister", "odometry_noise": [1.0, 2.0, 4.0, 6.0, 8.0]}],
        "associator": [{"use": "nn"}, {"use": "gnn"}, {"use": "jcbb", "gate": [0.99, 0.9999]}],
    }  # fmt: skip
    grid, rng = from_table(table, out), np.random.default_rng(0)
    keys = ("match_rate", "precision", "recall", "ate_m", "ate_raw_m", "rmse_x_m", "rmse_y_m", "nees", "map_rmse_m",
            "gospa_m", "step_ms_p50", "associate_us_p50", "associate_us_p99", "run_s", "purity", "idf1")  # fmt: skip
    with writing(journal_path(out)) as journal:
        runs = grid.runs()
        plan(journal, grid, runs)
        rows = [
            {"key": run.key, "status": "done", "reason": None, "seconds": 0.1, "host": "invented", "pid": 1,
             "metrics": dict(zip(keys, rng.random(len(keys)).tolist(), strict=True))
             | {"wrong_ids": int(rng.integers(9)), "duplicates": int(rng.integers(5)), "failure": None}}
            for run in runs
        ]  # fmt: skip
        journal.record(rows)
    return grid


def opened(index: Path) -> dict[str, float]:
    """Seconds until the list of runs is there, and that sorting it takes."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=str(BROWSER), args=FLAGS)
        page = browser.new_page()
        times = {}
        for name in ("first opening", "second opening"):
            started = time.perf_counter()
            page.goto(index.as_uri())
            page.wait_for_selector("#runs tbody tr")
            times[name] = time.perf_counter() - started
        started = time.perf_counter()
        page.click("#runs th:has-text('ATE [m]')")
        page.wait_for_selector("#runs th[aria-sort=ascending]")
        times["sorting all runs"] = time.perf_counter() - started
        browser.close()
    return times


if __name__ == "__main__":
    sys.exit(main())
