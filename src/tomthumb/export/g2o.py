"""A run as a factor graph in g2o's format: odometry and observations with the identities that were found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from tomthumb.geometry import compose, compose_jacobians
from tomthumb.types import Array, Ids, Scenario, Trace

FLOOR = 1e-9  # added to covariances without noise in some direction, which have no information matrix


def save_g2o(trace: Trace, path: Path, scenario: Scenario) -> None:
    """VERTEX_SE2 for the first step and each with a scan, VERTEX_XY for each landmark, EDGE_SE2 and EDGE_SE2_XY.

    Poses are the run's, odometry between two vertices is composed with its covariance, observations are turned into the
    robot's frame; the ids are those after the run. Landmarks are numbered after the poses. The first vertex is fixed.
    """
    ids = trace.ids if trace.final_ids is None else trace.final_ids
    names = np.unique(np.concatenate([trace.final.ids, ids[ids >= 0]]))
    number = {int(name): len(trace.t) + k for k, name in enumerate(names)}
    place = dict(zip(trace.final.ids.tolist(), trace.final.landmarks.tolist(), strict=True))
    with open(path, "w", encoding="utf-8") as file:
        for name, (x, y) in place.items():
            file.write(f"VERTEX_XY {number[name]} {x:.9g} {y:.9g}\n")
        for line in _lines(trace, scenario, ids, {k: number[k] for k in place}):
            file.write(line + "\n")


def _lines(trace: Trace, scenario: Scenario, ids: Ids, number: dict[int, int]) -> Iterator[str]:
    motion, cov = np.zeros(3), np.zeros((3, 3))
    last: int | None = None
    vertex = 0
    for k, step in zip(range(len(trace.t)), scenario.steps, strict=False):
        if step.control is not None:
            delta, Q = scenario.motion.increment(step.control)
            A, B = compose_jacobians(motion, delta)
            motion, cov = compose(motion, delta), A @ cov @ A.T + B @ Q @ B.T
        if last is not None and step.observations is None:
            continue
        yield f"VERTEX_SE2 {vertex} {_text(trace.pose[k])}"
        yield "FIX 0" if last is None else f"EDGE_SE2 {last} {vertex} {_text(motion)} {_information(cov)}"
        if step.observations is not None:
            points, _, G = scenario.sensor.locate(np.zeros(3), step.observations.z)
            for row, name in enumerate(ids[trace.offsets[k] : trace.offsets[k + 1]]):
                if int(name) in number:
                    R = G[row] @ step.observations.R[row] @ G[row].T
                    yield f"EDGE_SE2_XY {vertex} {number[int(name)]} {_text(points[row])} {_information(R)}"
        last, vertex = vertex, vertex + 1
        motion, cov = np.zeros(3), np.zeros((3, 3))


def _text(values: Iterable[float]) -> str:
    return " ".join(f"{v:.12g}" for v in values)


def _information(cov: Array) -> str:
    """The upper triangle of the inverse."""
    info = np.linalg.inv(cov + FLOOR * np.eye(len(cov)))
    return _text(info[np.triu_indices(len(info))])
