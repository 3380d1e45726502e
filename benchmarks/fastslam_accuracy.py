"""FastSLAM's accuracy beside the EKF's on a log, association by its labels.

python benchmarks/fastslam_accuracy.py DATA/utias_lost_in_the_woods [--steps 4000]
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


def ate(trace, truth: np.ndarray) -> float:
    """Position RMSE after rigid alignment, m."""
    known = np.isfinite(truth[:, 0])
    placed = geometry.to_world(geometry.align(trace.pose[known, :2], truth[known, :2]), trace.pose[known, :2])
    return float(np.sqrt(((placed - truth[known, :2]) ** 2).sum(1).mean()))


def main() -> None:
    """One line for each filter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--particles", type=int, default=100)
    options = parser.parse_args()
    scenario = load(options.log)
    scenario = replace(scenario, steps=list(scenario.steps)[: options.steps])
    truth = np.array(
        [np.full(3, np.nan) if s.truth is None or s.truth.pose is None else s.truth.pose for s in scenario.steps]
    )
    filters = {
        "invariant EKF": InvariantEKF(scenario.motion, scenario.sensor),
        "FastSLAM 2.0": FastSLAM(scenario.motion, scenario.sensor, particles=options.particles),
    }
    for name, estimator in filters.items():
        trace = run(scenario, associator="oracle", estimator=estimator)
        ms = 1e3 * trace.seconds.sum() / len(trace.t)
        print(
            f"{name:14s} ATE {ate(trace, truth[: len(trace.t)]):.4f} m  {ms:.1f} ms a step  {trace.failure or ''}",
            flush=True,
        )


if __name__ == "__main__":
    main()
