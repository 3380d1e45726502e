"""A log of ten million observations, written and read back step by step: the peak memory it takes.

python benchmarks/stream_log.py [--observations 10000000] [--layout jsonl|csv]
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from tomthumb.scenarios import load
from tomthumb.scenarios.csv_save import save_csv
from tomthumb.scenarios.jsonl import save_jsonl
from tomthumb.scenarios.streaming import StreamedSteps
from tomthumb.types import Control, Observations, Step, Truth

PER_SCAN = 50


def steps(scans: int) -> Iterator[Step]:
    """Scans of `PER_SCAN` observations each."""
    rng = np.random.default_rng(0)
    R = np.tile(np.diag([0.01, 0.001]), (PER_SCAN, 1, 1))
    ids = np.arange(PER_SCAN)
    for k in range(scans):
        z = np.round(rng.random((PER_SCAN, 2)), 3)
        control = Control(np.array([0.1, 0.0, 0.01]), 1.0) if k else None
        yield Step(float(k), control, Observations(z, R), Truth(None, ids))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--observations", type=int, default=10_000_000)
    parser.add_argument("--layout", choices=("jsonl", "csv"), default="jsonl")
    options = parser.parse_args()
    scans = options.observations // PER_SCAN
    world = replace(load("random", steps=2, landmarks=0), steps=StreamedSteps(lambda: steps(scans)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("log.jsonl" if options.layout == "jsonl" else "log")
        start = time.monotonic()
        (save_jsonl if options.layout == "jsonl" else save_csv)(world, path)
        written = time.monotonic()
        seen = sum(0 if step.observations is None else len(step.observations) for step in load(str(path)).steps)
        done = time.monotonic()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row = {"observations": seen, "write_s": written - start, "read_s": done - written, "peak_mib": peak}
    print(json.dumps({k: round(v, 1) for k, v in row.items()}))


if __name__ == "__main__":
    main()
