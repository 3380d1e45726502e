"""A log run, and then smoothed as a whole: ATE of the filter, of the smoothed poses, and the time both take.

    python benchmarks/smoothing.py DATA/victoria_park --associator stt

"oracle" names by the log's labels. ATE is after rigid alignment, over the scans with truth; seconds are CPU time.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from tomthumb import geometry
from tomthumb.runner import run
from tomthumb.scenarios.catalogue import load
from tomthumb.smoothing import graph_of, solve


def ate(poses: np.ndarray, truth: np.ndarray) -> float:
    """Position RMSE after rigid alignment, m."""
    known = np.isfinite(truth[:, 0])
    placed = geometry.to_world(geometry.align(poses[known, :2], truth[known, :2]), poses[known, :2])
    return float(np.sqrt(((placed - truth[known, :2]) ** 2).sum(1).mean()))


def main() -> None:
    """One JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log")
    parser.add_argument("--associator", default="oracle")
    parser.add_argument("--estimator", default="iekf")
    parser.add_argument("--robust", nargs="+", default=["none", "huber"])
    options = parser.parse_args()
    scenario = load(options.log)
    begin = time.process_time()
    trace = run(scenario, associator=options.associator, estimator=options.estimator)
    spent = time.process_time() - begin
    graph = graph_of(trace, scenario)
    steps = list(scenario.steps)[: len(trace.t)]
    poses = [np.full(3, np.nan) if s.truth is None or s.truth.pose is None else s.truth.pose for s in steps]
    truth = np.array(poses)[graph.steps]
    result = {
        "log": scenario.name, "associator": options.associator, "failure": trace.failure, "run_s": spent,
        "poses": len(graph.poses), "sightings": len(graph.sightings), "landmarks": len(graph.landmarks),
        "filter_ate_m": ate(trace.pose[graph.steps], truth),
    }  # fmt: skip
    print(json.dumps(result), flush=True)
    for robust in options.robust:
        begin = time.process_time()
        solved = solve(graph, robust=robust).graph
        print(
            json.dumps(
                {"robust": robust, "ate_m": ate(solved.robot(solved.poses), truth), "s": time.process_time() - begin}
            )
        )


if __name__ == "__main__":
    main()
