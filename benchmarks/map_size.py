"""Time and memory of association against the number of landmarks on the map.

    OPENBLAS_NUM_THREADS=1 python benchmarks/map_size.py [--sizes 100 1000 10000 100000]

A robot in the middle of a grid of landmarks 2 m apart, each known, sees the 10 nearest; the estimator (FastSLAM with
one particle, which keeps 100 000) offers those in view, and each associator names the scan. Median and 99th percentile
of the CPU time of `associate`, and the largest memory it held at once beyond what it was given.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc

import numpy as np
from step_cost import MOVE, grown

from tomthumb import geometry, registry
from tomthumb.estimators.fastslam import FastSLAM
from tomthumb.kernels.gates import innovations
from tomthumb.protocols import Associator
from tomthumb.types import AssociationProblem

BEARING = np.array([False, True])


def problems(n: int, steps: int) -> list[AssociationProblem]:
    """The scans of a small tour on a map of n landmarks."""
    rng = np.random.default_rng(0)
    place, fast, belief = grown(n, lambda m, s: FastSLAM(m, s, particles=1), rng, None)
    found = []
    for _ in range(steps):
        place.pose = geometry.compose(place.pose, MOVE.u)
        belief = fast.predict(belief, MOVE, rng)
        seen, ids = place.seen()
        p = fast.expect(belief)[0]
        nu = innovations(seen.z, p.z_hat, BEARING)
        found.append(AssociationProblem(seen.z, seen.R, nu, p, np.full(len(seen), 0.3), np.arange(len(seen)), (1,)))
        belief = fast.update(belief, seen, ids[None], rng)
    return found


def cost(part: Associator, cell: list[AssociationProblem]) -> tuple[float, float, float]:
    """Median and 99th percentile of the time, us, and the most memory held at once, KiB."""
    rng, seconds, most = np.random.default_rng(0), [], 0
    part.associate(cell[0], rng)
    for problem in cell:
        begin = time.thread_time()
        part.associate(problem, rng)
        seconds.append(time.thread_time() - begin)
    tracemalloc.start()
    for problem in cell:
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        part.associate(problem, rng)
        most = max(most, tracemalloc.get_traced_memory()[1] - before)
    tracemalloc.stop()
    median, late = np.quantile(1e6 * np.array(seconds), [0.5, 0.99])
    return float(median), float(late), most / 1024.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 1000, 10_000, 100_000])
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--methods", nargs="+", default=["jcbb", "stt"])
    options = parser.parse_args()
    print("| landmarks | offered to it | method | median us | p99 us | memory KiB |\n|---|---|---|---|---|---|")
    for n in options.sizes:
        cell = problems(n, options.steps)
        offered = np.mean([len(p.predictions) for p in cell])
        for name in options.methods:
            median, late, memory = cost(registry.build("associator", name), cell)
            print(f"| {n} | {offered:.1f} | {name} | {median:.0f} | {late:.0f} | {memory:.0f} |", flush=True)


if __name__ == "__main__":
    main()
