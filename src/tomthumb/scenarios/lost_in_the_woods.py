"""UTIAS Lost in the Woods: one robot with a laser among 17 tubes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.models.motion import Velocity
from tomthumb.models.sensor import RangeBearing
from tomthumb.scenarios.matfile import load_mat, matrix
from tomthumb.scenarios.reading import Steps, increasing
from tomthumb.types import Control, Observations, Prior, Scenario, Step, Truth

WOODS_FILE = "dataset2.mat"
WOODS_RANGE, WOODS_FOV = 5.7, math.radians(242.0)  # nothing is seen beyond 5.64 m or 120.1 deg to a side


def lost_in_the_woods(path: Path, *, r_max: float = math.inf) -> Scenario:
    """UTIAS "Lost in the Woods": one robot, 17 tubes, 12609 steps of 0.1 s; a folder or its dataset2.mat.

    Observations beyond `r_max` m are left out. The noise is the publishers' (their variances fit the residuals). Of the
    tubes in view 94 % are seen within 2 m, 60 % in all, because they hide one another.

    Raises BrokenFile where the file is not this log, TomThumbError for an `r_max` that is not positive.
    """
    if not r_max > 0.0:
        raise TomThumbError(f"lost_in_the_woods: r_max={r_max}: more than 0 m")
    path = Path(path)
    path = path / WOODS_FILE if path.is_dir() else path
    scalars = ("d", "r_var", "b_var", "v_var", "om_var")
    columns = ("t", "x_true", "y_true", "th_true", "true_valid", "v", "om")
    raw = load_mat(path, [*scalars, *columns, "r", "b", "l"])
    landmarks = matrix(raw, "l", path, (None, 2))
    r = matrix(raw, "r", path, (None, len(landmarks)))
    b = matrix(raw, "b", path, r.shape)
    t, x, y, heading, valid, v, omega = (matrix(raw, name, path, (len(r),)) for name in columns)
    ahead, *variances = (float(matrix(raw, name, path, (1,))[0]) for name in scalars)
    increasing(t, path)
    if min(variances) <= 0.0 or not len(t):
        raise BrokenFile(path, "a variance is not positive, or there are no steps")
    stds = np.sqrt(variances)
    R = np.diag(variances[:2])
    poses = np.column_stack([x, y, heading])

    def step(k: int) -> Step:
        seen = np.flatnonzero((r[k] > 0.0) & (r[k] < r_max))
        scan = Observations(np.column_stack([r[k, seen], b[k, seen]]), np.tile(R, (len(seen), 1, 1)))
        control = Control(np.array([v[k], omega[k]]), float(t[k] - t[k - 1])) if k else None
        return Step(float(t[k]), control, scan, Truth(poses[k] if valid[k] > 0 else None, seen))

    return Scenario(
        name="lost_in_the_woods",
        motion=Velocity(std=(float(stds[2]), float(stds[3]))),
        sensor=RangeBearing(
            max_range=min(WOODS_RANGE, r_max),
            fov=WOODS_FOV,
            mount=(ahead, 0.0, 0.0),
            std=(float(stds[0]), float(stds[1])),
            detect=0.94 if r_max <= 2.0 else 0.6,
            clutter=1e-3,
            memory=(0.0, 0.3),  # m: the correlation length of the bearing residuals (see docs/estimators.md)
        ),
        prior=Prior(poses[0], np.zeros((3, 3))),
        steps=Steps(len(t), step),
        landmarks=landmarks,
        info={"file": str(path), "r_max": r_max if math.isfinite(r_max) else None},
    )
