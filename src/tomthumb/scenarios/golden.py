"""The golden traces: runs of the reference cloister program, with every association and state that it computed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import BrokenFile
from tomthumb.models.motion import OdometryIncrement
from tomthumb.models.sensor import Cartesian
from tomthumb.scenarios.matfile import load_mat, matrix
from tomthumb.scenarios.reading import whole
from tomthumb.scenarios.simulate import CLUTTER_FLOOR, DETECT_CAP
from tomthumb.types import Array, Control, Ids, Observations, Prior, Scenario, Step, Truth


def golden(path: Path, *, faithful: bool = False) -> Scenario:
    """The recorded odometry (with the covariance the filter used) and observations of one reference run.

    ``info["golden"]`` is what the reference made of them: `matches` one array (m,) a step after the first (1-based
    number of the map's feature, 0 unpaired), `map_ids` the true landmark (0-based) of each feature before that step,
    `poses (K, 3)` its estimates, `state (3 + 2n,)` and `variances` the last state and the diagonal of its covariance,
    `state_first`, `cov_first` the state after the first scan. `faithful` is passed on in `info`.

    Raises BrokenFile where the file is not such a recording.
    """
    path = Path(path)
    run = load_mat(path, ["o"])["o"]
    trace = run.get("trace") if isinstance(run, dict) else None
    if not isinstance(trace, list) or not all(isinstance(row, dict) for row in trace) or not trace:
        raise BrokenFile(path, "holds no trace of a reference run")
    truth = matrix(run, "truth", path, (3, len(trace) + 1)).T
    landmarks = matrix(run, "points", path, (2, None)).T
    first = Step(0.0, None, *_scan(run, "z1", "R1", "ground_id1", truth[0], path))
    rest = [_step(k, row, truth[k], path) for k, row in enumerate(trace, 1)]
    return Scenario(
        name=f"golden {path.stem}",
        motion=OdometryIncrement(),
        sensor=Cartesian(max_range=3.5, fov=np.pi, detect=DETECT_CAP, clutter=CLUTTER_FLOOR),
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        steps=[first, *rest],
        landmarks=landmarks,
        info={"faithful": faithful, "golden": _reference(run, trace, path)},
    )


def _step(k: int, row: Mapping[str, Any], pose: Array, path: Path) -> Step:
    control = Control(matrix(row, "odom_x", path, (3,)), 1.0, matrix(row, "odom_P", path, (3, 3)))
    return Step(float(k), control, *_scan(row, "z", "R", "ground_id", pose, path))


def _scan(row: Mapping[str, Any], z: str, R: str, ids: str, pose: Array, path: Path) -> tuple[Observations, Truth]:
    names = whole(matrix(row, ids, path, (None,)), path, ids) - 1
    m = len(names)
    points = matrix(row, z, path, (2 * m,)).reshape(m, 2)
    full = matrix(row, R, path, (2 * m, 2 * m)).reshape(m, 2, m, 2)
    k = np.arange(m)
    return Observations(points, full[k, :, k, :]), Truth(pose, names)


def _reference(run: Mapping[str, Any], trace: list[dict[str, Any]], path: Path) -> dict[str, Any]:
    def each(name: str) -> list[Ids]:
        return [whole(matrix(row, name, path, (None,)), path, name) for row in trace]

    return {
        "associator": str(run.get("algo", "")),
        "matches": each("H"),
        "map_ids": [ids - 1 for ids in each("map_ground_id")],
        "poses": matrix(run, "est", path, (3, len(trace) + 1)).T,
        "state": matrix(trace[-1], "x", path, (None,)),
        "variances": matrix(trace[-1], "Pdiag", path, (None,)),
        "state_first": matrix(run, "x1", path, (None,)),
        "cov_first": matrix(run, "P1", path, (None, None)),
    }
