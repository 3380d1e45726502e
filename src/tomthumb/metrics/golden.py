"""Agreement with a recorded run of the reference program, decision by decision and in the final state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tomthumb.geometry import wrap_angle
from tomthumb.types import Array, Ids, Trace


def golden_metrics(trace: Trace, recorded: Mapping[str, Any]) -> dict[str, Any]:
    """`golden_agree`: observations named as in the recording, of `golden_of`; `golden_state_error`: of the final state.

    `recorded` is the scenario's ``info["golden"]``: "matches", for each step after the first the number (from 1, in
    order of birth) of each observation's landmark, or 0; "state (3 + 2n,)" at the end. The error, m and rad, is the
    largest absolute difference, and unknown (NaN) when the maps differ in size.
    """
    mine = map_numbers(trace)[trace.offsets[1] :]
    theirs = np.concatenate([np.atleast_1d(numbers) for numbers in recorded["matches"]])
    common = min(len(mine), len(theirs))
    return {
        "golden_agree": int((mine[:common] == theirs[:common]).sum()),
        "golden_of": len(theirs),
        "golden_state_error": _state_error(trace, recorded["state"]),
    }


def map_numbers(trace: Trace) -> Ids:
    """The number (from 1, in order of birth) of the landmark that each observation (M,) was paired with; 0 for none."""
    founded = np.flatnonzero(trace.ids == np.arange(len(trace.ids)))
    numbers = np.searchsorted(founded, trace.ids) + 1
    return np.where(trace.paired, numbers, 0)


def _state_error(trace: Trace, state: Array) -> float:
    order = np.argsort(trace.final.ids)
    mine = np.concatenate([trace.final.pose, trace.final.landmarks[order].ravel()])
    if len(mine) != len(state):
        return math.nan
    difference = mine - state
    difference[2] = wrap_angle(float(difference[2]))
    return float(np.abs(difference).max())
