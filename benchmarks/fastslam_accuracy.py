"""FastSLAM's accuracy beside the EKF's on a log, association by its labels.

    python benchmarks/fastslam_accuracy.py DATA/utias_lost_in_the_woods --steps 3000 [--quick] [--associator nn]
    python benchmarks/fastslam_accuracy.py DATA/utias_lost_in_the_woods --steps 3000 --given --plain --noise 1 16

The second form gives the names directly and lets landmarks count at once, so that nothing but the filters is compared;
`--plain` turns FastSLAM's whitening off, `--noise` multiplies the variances that both filters are told of the two
components of z (range, bearing), `--motion` the standard deviations of the odometry.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from tomthumb import geometry
from tomthumb.estimators.ekf import InvariantEKF
from tomthumb.estimators.fastslam import FastSLAM
from tomthumb.runner import run
from tomthumb.scenarios.catalogue import load
from tomthumb.types import Observations

NOBODY = np.empty(0, np.int64)


def ate(poses, truth: np.ndarray) -> float:
    """Position RMSE after rigid alignment, m."""
    known = np.isfinite(truth[:, 0])
    placed = geometry.to_world(geometry.align(poses[known, :2], truth[known, :2]), poses[known, :2])
    return float(np.sqrt(((placed - truth[known, :2]) ** 2).sum(1).mean()))


def given(estimator, scenario, noise, seed: int) -> np.ndarray:
    """Poses (K, 3) of a filter that is told every name; what has no name is left out."""
    rng, known, poses = np.random.default_rng(seed), NOBODY, []
    belief = estimator.init(scenario.prior.pose, scenario.prior.cov, rng)
    many, factor = getattr(estimator, "particles", 1), np.sqrt(np.outer(noise, noise))
    for step in scenario.steps:
        if step.control is not None:
            belief = estimator.predict(belief, step.control, rng)
        if step.observations is not None and step.truth is not None and step.truth.ids is not None:
            rows = np.flatnonzero(step.truth.ids >= 0)
            ids, z = step.truth.ids[rows], step.observations.z[rows]
            seen, met = Observations(z, step.observations.R[rows] * factor), np.isin(ids, known)
            belief = estimator.update(belief, seen, [np.where(met, ids, -1)] * many, rng)
            belief = estimator.add(belief, seen, [np.where(met, -1, ids)] * many, rng)
            belief = estimator.promote(belief, ids[~met])
            known = np.union1d(known, ids)
        poses.append(estimator.pose(belief)[0])
    return np.array(poses)


def parsed() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--associator", default="oracle")
    parser.add_argument("--quick", action="store_true", help="the associator names for the heaviest particle alone")
    parser.add_argument("--plain", action="store_true", help="no whitening")
    parser.add_argument("--given", action="store_true")
    parser.add_argument("--noise", type=float, nargs=2, default=[1.0, 1.0])
    parser.add_argument("--motion", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def main() -> None:
    """One line for each filter."""
    options = parsed()
    scenario = load(options.log)
    scenario = replace(scenario, steps=list(scenario.steps)[: options.steps])
    poses = [np.full(3, np.nan) if s.truth is None or s.truth.pose is None else s.truth.pose for s in scenario.steps]
    motion = scenario.motion
    if options.motion != 1.0:
        motion = replace(motion, std=tuple(options.motion * s for s in motion.std))
    filters = {
        "invariant EKF": InvariantEKF(motion, scenario.sensor),
        "FastSLAM 2.0": FastSLAM(
            motion, scenario.sensor, particles=options.particles, whiten=not options.plain, quick=options.quick
        ),
    }
    for name, estimator in filters.items():
        if options.given:
            found = given(estimator, scenario, np.array(options.noise), options.seed)
            print(f"{name:14s} ATE {ate(found, np.array(poses)):.4f} m", flush=True)
            continue
        trace = run(scenario, associator=options.associator, estimator=estimator, seed=options.seed)
        ms = 1e3 * trace.seconds.sum() / len(trace.t)
        score = ate(trace.pose, np.array(poses)[: len(trace.t)])
        print(f"{name:14s} ATE {score:.4f} m  {ms:.1f} ms a step  {trace.failure or ''}", flush=True)


if __name__ == "__main__":
    main()
