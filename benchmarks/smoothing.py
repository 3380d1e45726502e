"""A run, and then smoothed as a whole: ATE of the filter, of the smoothed poses, and the time both take.

    python benchmarks/smoothing.py DATA/victoria_park --associator stt [--noise 1 16] [--memory 1.1 3.1]
    python benchmarks/smoothing.py --worlds 10 [--associator stt]

"oracle" names by the log's labels. ATE is after rigid alignment, over the scans with truth; seconds are CPU time.
`--noise` multiplies the variances of range and bearing in the graph; `--memory` is the path in m over which the
sensor's errors in both repeat themselves, for filter and graph. Where a log brings GPS, the median distance of the
sensor to the fixes is told too: they are in neither the graph nor the truth. `--worlds`: so many seeds of two simulated
worlds, where the noise is what the graph is told.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from worlds import loop, true_noise_cloister

from tomthumb import geometry
from tomthumb.runner import run
from tomthumb.scenarios.catalogue import load
from tomthumb.smoothing import Graph, graph_of, solve
from tomthumb.types import Scenario, Trace

WORLDS = {"cloister, 2x": (true_noise_cloister, 2), "loop 120 m, 1x": (loop, 1)}


def ate(poses: np.ndarray, truth: np.ndarray) -> float:
    """Position RMSE after rigid alignment, m."""
    known = np.isfinite(truth[:, 0])
    placed = geometry.to_world(geometry.align(poses[known, :2], truth[known, :2]), poses[known, :2])
    return float(np.sqrt(((placed - truth[known, :2]) ** 2).sum(1).mean()))


def true_poses(scenario: Scenario, graph: Graph) -> np.ndarray:
    """The truth at every pose of the graph, NaN where there is none."""
    steps = scenario.steps
    found = [steps[int(k)].truth for k in graph.steps]
    return np.array([np.full(3, np.nan) if t is None or t.pose is None else t.pose for t in found])


def from_gps(fixes: np.ndarray | None, t: np.ndarray, poses: np.ndarray, mount: np.ndarray | None) -> float | None:
    """Median distance m of the sensor to the fixes (n, 3), aligned with those within 3 m; None without any."""
    if fixes is None:
        return None
    points = np.array([geometry.compose(pose, np.zeros(3) if mount is None else mount)[:2] for pose in poses])
    fixes = fixes[(fixes[:, 0] >= t[0]) & (fixes[:, 0] <= t[-1])]
    at = np.column_stack([np.interp(fixes[:, 0], t, points[:, k]) for k in range(2)])
    good = np.ones(len(at), bool)
    for _ in range(10):
        away = np.linalg.norm(geometry.to_world(geometry.align(at[good], fixes[good, 1:]), at) - fixes[:, 1:], axis=1)
        good = away < 3.0
    return float(np.median(away))


def scores(scenario: Scenario, trace: Trace, graph: Graph, poses: np.ndarray) -> dict[str, float | None]:
    """ATE m, and where there is GPS the median distance to it, m."""
    gps = scenario.info.get("gps")
    near = from_gps(gps, trace.t[graph.steps], poses, graph.mount)
    found: dict[str, float | None] = {"ate_m": ate(poses, true_poses(scenario, graph))}
    return found if gps is None else {**found, "gps_median_m": near}


def tell(scenario: Scenario, options: Any) -> None:
    """One log: the filter, and the smoothed poses by each kernel."""
    begin = time.process_time()
    trace = run(scenario, associator=options.associator, estimator=options.estimator)
    spent = time.process_time() - begin
    graph = graph_of(trace, scenario)
    counts = {name: len(getattr(graph, name)) for name in ("poses", "sightings", "landmarks")}
    told = {"log": scenario.name, "associator": options.associator, "failure": trace.failure, "run_s": spent, **counts}
    print(json.dumps({**told, **scores(scenario, trace, graph, trace.pose[graph.steps])}), flush=True)
    scale = np.sqrt(np.array(options.noise))
    graph = replace(graph, R=graph.R * np.outer(scale, scale))
    for robust in options.robust:
        begin = time.process_time()
        solved = solve(graph, robust=robust).graph
        told = {"robust": robust, "noise": options.noise, "s": time.process_time() - begin}
        print(json.dumps({**told, **scores(scenario, trace, graph, solved.robot(solved.poses))}), flush=True)


def in_simulation(seeds: int, associator: str) -> None:
    """ATE of filter and smoothed poses over the seeds of each world, and in how many the smoothed one is not above."""
    for name, (make, noise) in WORLDS.items():
        pairs: list[Sequence[float]] = []
        for seed in range(seeds):
            world = make(np.random.default_rng([seed, 0]), odometry_noise=noise)
            trace = run(world, associator=associator, seed=seed)
            graph = graph_of(trace, world)
            truth, solved = true_poses(world, graph), solve(graph).graph
            pairs.append((ate(trace.pose[graph.steps], truth), ate(solved.robot(solved.poses), truth)))
        before, after = np.array(pairs).T
        told = {"world": name, "associator": associator, "seeds": seeds, "not_above": int((after <= before).sum())}
        print(json.dumps({**told, "filter_ate_m": float(before.mean()), "ate_m": float(after.mean())}), flush=True)


def main() -> None:
    """JSON, an object a line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", nargs="?")
    parser.add_argument("--worlds", type=int, metavar="SEEDS")
    parser.add_argument("--associator", default="oracle")
    parser.add_argument("--estimator", default="iekf")
    parser.add_argument("--robust", nargs="+", default=["none", "huber"])
    parser.add_argument("--memory", nargs=2, type=float, metavar=("RANGE_M", "BEARING_M"))
    parser.add_argument("--noise", nargs=2, type=float, default=[1.0, 1.0], metavar=("RANGE", "BEARING"))
    options = parser.parse_args()
    if options.worlds:
        in_simulation(options.worlds, options.associator)
    elif options.log:
        log = load(options.log)
        memory = log.sensor.memory if options.memory is None else tuple(options.memory)
        tell(replace(log, sensor=replace(log.sensor, memory=memory)), options)
    else:
        parser.error("a log, or --worlds")


if __name__ == "__main__":
    main()
