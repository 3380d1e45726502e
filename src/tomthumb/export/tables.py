"""A run as three tables of columns: trajectory, map, observations. Units are in the names."""

from __future__ import annotations

from typing import Any

import numpy as np

from tomthumb.types import Scenario, Trace

Table = dict[str, Any]


def trajectory(trace: Trace) -> Table:
    """One row a step: time, pose, covariance of the pose, NIS."""
    cov = trace.pose_cov
    return {
        "t_s": trace.t,
        "x_m": trace.pose[:, 0],
        "y_m": trace.pose[:, 1],
        "heading_rad": trace.pose[:, 2],
        "cov_xx_m2": cov[:, 0, 0],
        "cov_xy_m2": cov[:, 0, 1],
        "cov_yy_m2": cov[:, 1, 1],
        "cov_xh_m_rad": cov[:, 0, 2],
        "cov_yh_m_rad": cov[:, 1, 2],
        "cov_hh_rad2": cov[:, 2, 2],
        "nis": trace.nis,
        "nis_dof": trace.dof,
    }


def landmarks(trace: Trace) -> Table:
    """One row a landmark of the final map."""
    final = trace.final
    return {
        "id": final.ids,
        "x_m": final.landmarks[:, 0],
        "y_m": final.landmarks[:, 1],
        "cov_xx_m2": final.covs[:, 0, 0],
        "cov_xy_m2": final.covs[:, 0, 1],
        "cov_yy_m2": final.covs[:, 1, 1],
        "confirmed": final.stone.astype(bool),
    }


def observations(trace: Trace, scenario: Scenario | None = None) -> Table:
    """One row an observation: step, time, identity given at the step and after the run, and, if known, the true one."""
    step = np.repeat(np.arange(len(trace.t)), np.diff(trace.offsets))
    table: Table = {
        "step": step,
        "t_s": trace.t[step],
        "landmark_id": trace.ids,
        "final_landmark_id": trace.ids if trace.final_ids is None else trace.final_ids,
        "paired": trace.paired.astype(bool),
        "with_confirmed": trace.with_stone.astype(bool),
    }
    if scenario is not None:
        table["true_id"] = scenario.true_ids()[: len(trace.ids)]
    return table


def tables(trace: Trace, scenario: Scenario | None = None) -> dict[str, Table]:
    """All three by name."""
    return {
        "trajectory": trajectory(trace),
        "map": landmarks(trace),
        "observations": observations(trace, scenario),
    }
