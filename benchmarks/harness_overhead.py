"""What the harness of `tomthumb bench` costs beside the runs: once for each worker, and for every run.

    python benchmarks/harness_overhead.py [--workers 2] [--seeds 20 120]

Two grids of cloister runs (one lap, JCBB) that differ in length only. What their processes spend outside runs, against
the number of runs, is a line: its height is what starting costs (imports, kernels read from the cache, the warm-up
before the first row), its slope what every run costs (job in, row out, the journal).
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from tomthumb.bench import Tally, Where, bench, from_options


def measured(seeds: int, workers: int) -> Tally:
    """A grid of so many runs in a fresh folder."""
    grid = from_options(["cloister"], [], ["jcbb"], [], str(seeds))
    with tempfile.TemporaryDirectory() as folder:
        return bench(grid, Path(folder), Where(workers))


def outside(tally: Tally, workers: int) -> float:
    """Seconds of the workers' time that were not spent in runs."""
    return tally.seconds * workers - tally.busy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seeds", type=int, nargs=2, default=[20, 120])
    options = parser.parse_args()
    measured(2, 1)  # so that no kernel is compiled for the first time below
    short, long = (measured(seeds, options.workers) for seeds in options.seeds)
    run = long.busy / long.rows
    each = (outside(long, options.workers) - outside(short, options.workers)) / (long.rows - short.rows)
    start = (outside(short, options.workers) - each * short.rows) / options.workers
    print(f"a run: {1e3 * run:.0f} ms; besides, for every run: {1e3 * each:.1f} ms ({100 * each / run:.1f} %)")
    print(
        f"once for each worker: {start:.1f} s; so below 5 % from {start / max(0.05 * run - each, 1e-9):.0f} runs a worker"
    )


if __name__ == "__main__":
    main()
