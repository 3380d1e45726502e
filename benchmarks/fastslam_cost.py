"""Time of a FastSLAM 2.0 step, names decided in each particle by maximum likelihood, against the size of the map.

    OPENBLAS_NUM_THREADS=1 python benchmarks/fastslam_cost.py [--sizes 100 1000 10000] [--jcbb]

Predict, name, update, with 10 observations; `--jcbb` names by JCBB through the common interface instead.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from step_cost import MOVE, grown

from tomthumb import geometry
from tomthumb.associators.jcbb import JointCompatibility
from tomthumb.estimators.fastslam import FastSLAM
from tomthumb.kernels.gates import innovations
from tomthumb.types import AssociationProblem


def by_associator(fast, belief, seen, rng):
    """Ids of each particle by JCBB."""
    associator, out = JointCompatibility(), []
    wrapped = np.array([False, True])
    for p in fast.expect(belief):
        nu = innovations(seen.z, p.z_hat, wrapped)
        problem = AssociationProblem(seen.z, seen.R, nu, p, np.full(len(seen), 0.3), np.arange(len(seen)), (1,))
        match = associator.associate(problem, rng)[0].match
        out.append(np.where(match >= 0, p.ids[match], -1))
    return np.array(out)


def measure(n: int, particles: int, steps: int, jcbb: bool) -> tuple[float, float, float]:
    """Median and mean seconds a step, and the share of observations named rightly."""
    rng = np.random.default_rng(0)
    place, fast, belief = grown(n, lambda m, s: FastSLAM(m, s, particles=particles), rng, None)
    seconds, right, total = [], 0, 0
    for _ in range(steps):
        place.pose = geometry.compose(place.pose, MOVE.u)
        seen, ids = place.seen()
        begin = time.process_time()
        belief = fast.predict(belief, MOVE, rng)
        named = by_associator(fast, belief, seen, rng) if jcbb else fast.name(belief, seen)
        belief = fast.update(belief, seen, named, rng)
        seconds.append(time.process_time() - begin)
        right += int((named == ids).sum())
        total += named.size
    return float(np.median(seconds)), float(np.mean(seconds[5:])), right / total


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--jcbb", action="store_true")
    options = parser.parse_args()
    measure(64, options.particles, 10, options.jcbb)  # compiles
    for n in options.sizes:
        median, mean, right = measure(n, options.particles, options.steps, options.jcbb)
        print(
            f"landmarks {n}  median {1e3 * median:.2f} ms  mean {1e3 * mean:.2f} ms  named rightly {100 * right:.2f} %"
        )


if __name__ == "__main__":
    main()
