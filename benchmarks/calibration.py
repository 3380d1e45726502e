"""Systematic errors of the odometry of real logs, estimated as states: values with 95 % intervals, before and after.

    python benchmarks/calibration.py "dlr:DATA/dlr_spatial_cognition?camera=rectified" \\
        --calibrate scale heading_bias --std 0.05 0.002
    python benchmarks/calibration.py "victoria_park:DATA/victoria_park?odometry=aa3" \\
        --calibrate steering_gain steering_bias scale --std 0.1 0.02 0.1

Association by the log's labels. Printed: each error, and the one that fits the odometry best to the log's batch
solution (the motions between poses `STRIDE` apart, robust least squares); dead reckoning's end-point and RMS error with
the errors left in and taken out; the filter's NEES (3 is right, 2 where the log has no true heading) and RMS error
without and with them.
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares

from tomthumb import geometry
from tomthumb.estimators.ekf import InvariantEKF
from tomthumb.models.calibration import corrected
from tomthumb.runner import collect, prepare
from tomthumb.scenarios.catalogue import load
from tomthumb.smoothing.graph import controls

STRIDE = 5  # poses of the batch solution from one to the next that are compared


def dead_reckoning(scenario, steps, names=(), values=()) -> np.ndarray:
    """Poses (K, 3) by odometry alone."""
    pose, poses, moves = scenario.prior.pose, [], dict(controls(steps, scenario.motion))
    for k in range(len(steps)):
        if k in moves:
            motion, control = corrected(scenario.motion, moves[k], names, np.asarray(values, float))
            pose = geometry.compose(pose, motion.increment(control)[0])
        poses.append(pose)
    return np.array(poses)


def errors(poses: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """RMS and last position error where the truth is known, m."""
    known = np.isfinite(truth[:, 0])
    away = np.linalg.norm((poses - truth)[known, :2], axis=1)
    return {"rms_m": float(np.sqrt((away**2).mean())), "end_m": float(away[-1])}


def reference(scenario, steps, truth: np.ndarray, names) -> list[float]:
    """The errors that bring the odometry nearest to the motions of the batch solution."""
    moves = dict(controls(steps, scenario.motion))
    marks = np.flatnonzero(np.isfinite(truth).all(1))[::STRIDE]
    true = np.array([geometry.between(truth[a], truth[b]) for a, b in pairwise(marks)])

    def residual(values: np.ndarray) -> np.ndarray:
        away = np.empty_like(true)
        for n, (a, b) in enumerate(pairwise(marks)):
            moved = np.zeros(3)
            for k in range(a + 1, b + 1):
                if k in moves:
                    motion, control = corrected(scenario.motion, moves[k], names, values)
                    moved = geometry.compose(moved, motion.increment(control)[0])
            away[n] = moved - true[n]
        away[:, 2] = geometry.wrap(away[:, 2])
        return away

    scale = 1.4826 * np.median(np.abs(residual(np.zeros(len(names)))), axis=0)
    fit = least_squares(
        lambda v: (residual(v) / scale).ravel(), np.zeros(len(names)), loss="soft_l1", diff_step=1e-4, max_nfev=8
    )
    return fit.x.tolist()


def nees(trace, truth: np.ndarray) -> float:
    """Average over the steps with truth; over position alone where the heading is not known."""
    known = np.isfinite(truth[:, 0])
    size = 3 if np.isfinite(truth[known, 2]).all() else 2
    error = (trace.pose - truth)[known]
    error[:, 2] = geometry.wrap(error[:, 2])
    cov = trace.pose_cov[known][:, :size, :size] + 1e-12 * np.eye(size)
    solved = np.linalg.solve(cov, error[:, :size, None])[..., 0]
    return float((error[:, :size] * solved).sum(1)[1:].mean())


def filtered(scenario, steps, **settings):
    """The trace of a run by the log's labels, and the calibration at its end."""
    ekf = InvariantEKF(scenario.motion, scenario.sensor, **settings)
    slam = prepare(scenario, associator="oracle", estimator=ekf)
    records = list(slam.stream(steps))
    return collect(scenario.name, slam, records), ekf.calibration(slam.branches[0].belief)


def main() -> None:
    """One log, before and after."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log")
    parser.add_argument("--calibrate", nargs="+", required=True)
    parser.add_argument("--std", nargs="+", type=float, required=True, help="prior standard deviations")
    parser.add_argument("--steps", type=int, help="only so many")
    options = parser.parse_args()
    scenario = load(options.log)
    steps = list(scenario.steps)[: options.steps]
    truth = np.array([np.full(3, np.nan) if s.truth is None or s.truth.pose is None else s.truth.pose for s in steps])
    before, _ = filtered(scenario, steps)
    after, found = filtered(scenario, steps, calibrate=tuple(options.calibrate), calibrate_std=tuple(options.std))
    values = [found[name][0] for name in options.calibrate]
    result = {
        "log": scenario.name,
        "calibration": {k: {"value": v, "low": v - 1.96 * s, "high": v + 1.96 * s} for k, (v, s) in found.items()},
        "reference": dict(zip(options.calibrate, reference(scenario, steps, truth, options.calibrate), strict=True)),
        "dead_reckoning_before": errors(dead_reckoning(scenario, steps), truth),
        "dead_reckoning_after": errors(dead_reckoning(scenario, steps, options.calibrate, values), truth),
        "filter_before": {**errors(before.pose, truth[: len(before.t)]), "nees": nees(before, truth[: len(before.t)])},
        "filter_after": {**errors(after.pose, truth[: len(after.t)]), "nees": nees(after, truth[: len(after.t)])},
        "failures": [before.failure, after.failure],
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
