"""Average NEES (3 is right) and position error of the filters, association by the oracle, filter told the true noise.

    python benchmarks/consistency.py --seeds 50 --out consistency.json
    python benchmarks/consistency.py --seeds 50 --filters "the same, crumbs" --associator oracle stt

With several associators each row tells its share of observations named rightly, and the last column the ratio of its
NEES to the first associator's over the runs in which that share is above 99.8 % (n of them).

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
from tomthumb.metrics import evaluate
from tomthumb.runner import run

RIGHT = 0.998
AT_ONCE = {"slam": {"hits": 1}}  # association is known: nothing is tentative
FILTERS = {
    "ekf, one iteration": (lambda m, s: EKF(m, s, iterations=1), AT_ONCE),
    "ekf, iterated": (EKF, AT_ONCE),
    "invariant, iterated": (InvariantEKF, AT_ONCE),
    "the same, crumbs": (InvariantEKF, {}),
}
WORLDS = [("cloister", true_noise_cloister, k) for k in (1, 2, 4, 8)] + [("loop 120 m", loop, k) for k in (1, 2, 4)]


LINE = (
    "{world:11s} {noise}x {filter:20s} {associator:6s} NEES {nees:7.2f} +- {nees_se:5.2f}  "
    "second lap {nees_second_lap:7.2f}  RMSE {rmse_m:.3f} m  failed {failed}  right {right:.4f}  ratio {ratio} (n {good})"
)


def score(world, make, settings, seed: int, associator: str) -> dict[str, float]:
    """NEES over all steps and over the second half, position RMSE m, and share of right names, of one run."""
    trace = run(world, associator=associator, estimator=make(world.motion, world.sensor), seed=seed, settings=settings)
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
        "right": evaluate(trace, world)["match_rate"] or 0.0,
        "failed": trace.failure is not None,
    }


def summary(runs: list[dict[str, float]], like: list[dict[str, float]]) -> dict[str, float | None]:
    """What is printed of the runs; `like`: the same worlds with the first associator."""
    nees = np.array([r["nees"] for r in runs])
    good = np.array([r["right"] > RIGHT for r in runs])
    same = np.array([r["nees"] for r in like])[good]
    ratio = round(float(nees[good].sum() / same.sum()), 3) if good.any() else None
    return {
        "nees": float(nees.mean()), "nees_se": float(nees.std(ddof=1) / np.sqrt(len(nees))),
        "nees_second_lap": float(np.mean([r["late"] for r in runs])), "rmse_m": float(np.mean([r["rmse"] for r in runs])),
        "failed": int(sum(r["failed"] for r in runs)), "right": float(np.mean([r["right"] for r in runs])),
        "ratio": ratio, "good": int(good.sum()),
    }  # fmt: skip


def main() -> None:
    """Every world with every filter and associator, printed as it comes and kept as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--filters", nargs="+", default=list(FILTERS), choices=list(FILTERS))
    parser.add_argument("--associator", nargs="+", default=["oracle"])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    for name, make_world, noise in WORLDS:
        worlds = [make_world(np.random.default_rng([seed, 0]), odometry_noise=noise) for seed in range(options.seeds)]
        for title in options.filters:
            first: list[dict[str, float]] = []
            for associator in options.associator:
                runs = [score(world, *FILTERS[title], seed, associator) for seed, world in enumerate(worlds)]
                first = first or runs
                row = {"world": name, "noise": noise, "filter": title, "associator": associator, "seeds": options.seeds}
                rows.append(row | summary(runs, first))
                print(LINE.format(**rows[-1]), flush=True)
                if options.out:
                    options.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
