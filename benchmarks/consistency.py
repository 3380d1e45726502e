"""Average NEES (3 is right) and position error of the filters, association by the oracle, filter told the true noise.

    python benchmarks/consistency.py --seeds 50 --out consistency.json

Rows: cloister at 1x to 8x the reference's odometry noise, and a loop of 120 m with landmarks 1.5 m apart at 1x to 4x;
two laps each. Filters: the usual EKF with one iteration, iterated, and the right-invariant one, iterated; landmarks
enter at once, since their names are known. The last has the default life cycle, in which a landmark must be seen five
times before it moves the pose. The spread given is the standard error over seeds (steps of a run are correlated).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from worlds import loop, true_noise_cloister

from tomthumb import geometry
from tomthumb.estimators.ekf import EKF, InvariantEKF
from tomthumb.runner import run

AT_ONCE = {"slam": {"hits": 1}}  # association is known: nothing is tentative
FILTERS = {
    "ekf, one iteration": (lambda m, s: EKF(m, s, iterations=1), AT_ONCE),
    "ekf, iterated": (EKF, AT_ONCE),
    "invariant, iterated": (InvariantEKF, AT_ONCE),
    "the same, crumbs": (InvariantEKF, {}),
}
WORLDS = [("cloister", true_noise_cloister, k) for k in (1, 2, 4, 8)] + [("loop 120 m", loop, k) for k in (1, 2, 4)]


LINE = (
    "{world:11s} {noise}x {filter:20s} NEES {nees:7.2f} +- {nees_se:5.2f}  second lap {nees_second_lap:7.2f}  "
    "RMSE {rmse_m:.3f} m  failed {failed}"
)


def score(world, make, settings, seed: int) -> dict[str, float]:
    """NEES over all steps and over the second half, and position RMSE m, of one run."""
    trace = run(world, associator="oracle", estimator=make(world.motion, world.sensor), seed=seed, settings=settings)
    truth = np.array([s.truth.pose for s in world.steps[: len(trace.t)]])
    error = trace.pose - truth
    error[:, 2] = geometry.wrap(error[:, 2])
    error, cov = error[1:], trace.pose_cov[1:]
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0])
    late = len(nees) // 2
    rmse = float(np.sqrt((error[:, :2] ** 2).sum(1).mean()))
    return {
        "nees": float(nees.mean()),
        "late": float(nees[late:].mean()),
        "rmse": rmse,
        "failed": trace.failure is not None,
    }


def main() -> None:
    """Every world with every filter, printed as it comes and kept as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    for name, make_world, noise in WORLDS:
        worlds = [make_world(np.random.default_rng([seed, 0]), odometry_noise=noise) for seed in range(options.seeds)]
        for title, (make, settings) in FILTERS.items():
            runs = [score(world, make, settings, seed) for seed, world in enumerate(worlds)]
            nees = np.array([r["nees"] for r in runs])
            row = {
                "world": name, "noise": noise, "filter": title, "seeds": options.seeds,
                "nees": float(nees.mean()), "nees_se": float(nees.std(ddof=1) / np.sqrt(len(nees))),
                "nees_second_lap": float(np.mean([r["late"] for r in runs])),
                "rmse_m": float(np.mean([r["rmse"] for r in runs])), "failed": int(sum(r["failed"] for r in runs)),
            }  # fmt: skip
            rows.append(row)
            print(LINE.format(**row), flush=True)
            if options.out:
                options.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
