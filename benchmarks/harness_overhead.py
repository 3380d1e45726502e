"""What the harness of `tomthumb bench` costs beside the runs: once for each worker, and for every run.

    python benchmarks/harness_overhead.py [--workers 2] [--seeds 20 120]

Two grids of cloister runs (one lap, JCBB) that differ in length only. What their processes spend outside runs, against
the number of runs, is a line: its height is what starting costs (imports, kernels read from the cache, the warm-up
before the first row), its slope what every run costs (job in, row out, the journal). The same for processor time, which
other work on the machine disturbs less.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from tomthumb.bench import Tally, Where, bench, from_options


def measured(seeds: int, workers: int) -> tuple[Tally, float, float]:
    """A grid of so many runs in a fresh folder; the processor time of the workers and of the driver, s."""
    grid = from_options(["cloister"], [], ["jcbb"], [], str(seeds))
    before = os.times()
    with tempfile.TemporaryDirectory() as folder:
        tally = bench(grid, Path(folder), Where(workers))
    after = os.times()
    children = after.children_user + after.children_system - before.children_user - before.children_system
    return tally, children, after.user + after.system - before.user - before.system


def outside(tally: Tally, workers: int) -> float:
    """Seconds of the workers' time that were not spent in runs."""
    return tally.seconds * workers - tally.busy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seeds", type=int, nargs=2, default=[20, 120])
    options = parser.parse_args()
    measured(2, 1)  # so that no kernel is compiled for the first time below
    (short, *short_cpu), (long, *long_cpu) = (measured(seeds, options.workers) for seeds in options.seeds)
    more = long.rows - short.rows
    run = long.busy / long.rows
    each = (outside(long, options.workers) - outside(short, options.workers)) / more
    start = (outside(short, options.workers) - each * short.rows) / options.workers
    print(f"a run: {1e3 * run:.0f} ms; besides, for every run: {1e3 * each:.1f} ms ({100 * each / run:.1f} %)")
    print(
        f"once for each worker: {start:.1f} s; so below 5 % from {start / max(0.05 * run - each, 1e-9):.0f} runs a worker"
    )
    worker, driver = ((b - a) / more for a, b in zip(short_cpu, long_cpu, strict=True))
    begin = (short_cpu[0] - worker * short.rows) / options.workers
    print(
        f"processor time: {begin:.1f} s once for each worker, {1e3 * worker:.0f} ms a run, driver {1e3 * driver:.1f} ms a run"
    )


if __name__ == "__main__":
    main()
