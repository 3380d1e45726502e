"""Small traces written by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tomthumb.metrics import TruthTable
from tomthumb.types import Estimate, Trace


def estimate(ids: Sequence[int] = (), points: Any = None, stone: Any = None) -> Estimate:
    n = len(ids)
    return Estimate(
        pose=np.zeros(3),
        pose_cov=np.eye(3),
        ids=np.array(ids, np.int64),
        landmarks=np.zeros((n, 2)) if points is None else np.array(points, float).reshape(n, 2),
        covs=np.tile(np.eye(2), (n, 1, 1)),
        stone=np.ones(n, bool) if stone is None else np.array(stone, bool),
    )


def trace(scans: Sequence[Sequence[int]], final: Estimate, **other: Any) -> Trace:
    """`scans[k]` are the ids given out in step k; an id first met as its own serial is new, later ones are paired."""
    sizes = [len(scan) for scan in scans]
    ids = np.array([i for scan in scans for i in scan], np.int64)
    serials = np.arange(len(ids))
    steps = len(scans)
    fields: dict[str, Any] = {
        "scenario": "by hand",
        "t": np.arange(steps, dtype=float),
        "pose": np.zeros((steps, 3)),
        "pose_cov": np.tile(np.eye(3), (steps, 1, 1)),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        "ids": ids,
        "paired": (ids >= 0) & (ids != serials),
        "with_stone": (ids >= 0) & (ids != serials),
        "seconds": np.full((steps, 4), 1e-3),
        "nis": np.zeros(steps),
        "dof": np.zeros(steps, np.int64),
        "died": np.empty((0, 2), np.int64),
        "merged": np.empty((0, 3), np.int64),
        "final": final,
    }
    for key in ("died", "merged", "final_ids"):
        if other.get(key) is not None:
            other[key] = np.array(other[key], np.int64)
    return Trace(**(fields | other))


def truth(ids: Sequence[int], steps: int, score_from: int = 1, **other: Any) -> TruthTable:
    fields: dict[str, Any] = {"pose": np.zeros((steps, 3)), "landmarks": None}
    return TruthTable(ids=np.array(ids, np.int64), score_from=score_from, **(fields | other))
