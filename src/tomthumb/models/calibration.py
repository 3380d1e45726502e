"""Systematic errors of odometry, each a number that a filter may estimate: what the reading becomes once corrected.

| name | the corrected reading | unit |
|---|---|---|
| scale | distances, speeds times (1 + scale) | 1 |
| turn_scale | turns, rates of turn times (1 + turn_scale) | 1 |
| heading_bias | turn + heading_bias for each increment; rate of turn + heading_bias | rad; rad/s |
| steering_gain | steering angle times (1 + steering_gain) | 1 |
| steering_bias | steering angle + steering_bias | rad |
| wheel_base | wheel base times (1 + wheel_base) | 1 |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.models.motion import Ackermann
from tomthumb.protocols import Motion
from tomthumb.types import Array, Control

STEP = 1e-6  # of the central differences; the motions are smooth in the errors

_PLACES: dict[str, dict[str, tuple[list[int], bool]]] = {  # entries of u, and whether it multiplies them
    "OdometryIncrement": {"scale": ([0, 1], True), "turn_scale": ([2], True), "heading_bias": ([2], False)},
    "Velocity": {"scale": ([0], True), "turn_scale": ([1], True), "heading_bias": ([1], False)},
    "Ackermann": {"scale": ([0], True), "steering_gain": ([1], True), "steering_bias": ([1], False)},
}


def known(motion: Motion) -> list[str]:
    """Names of the errors that can be estimated for a motion model."""
    names = sorted(_PLACES.get(type(motion).__name__, {}))
    return [*names, "wheel_base"] if isinstance(motion, Ackermann) else names


def check(motion: Motion, names: Sequence[str], std: Sequence[float]) -> None:
    """Raises `UnknownName` or `TomThumbError` for what cannot be estimated."""
    for name in names:
        if name not in known(motion):
            raise UnknownName(f"systematic error of {type(motion).__name__}", name, known(motion))
    if len(set(names)) < len(names):
        raise TomThumbError(f"calibrate={','.join(names)}: each error once")
    if any(not 0.0 < s < np.inf for s in std):
        raise TomThumbError(f"calibrate_std={tuple(std)}: positive standard deviations")


def corrected(motion: Motion, control: Control, names: Sequence[str], values: Array) -> tuple[Motion, Control]:
    """The motion model and the control with errors of the given values (k,) taken out."""
    u = np.array(control.u, float)
    places = _PLACES.get(type(motion).__name__, {})
    for name, value in zip(names, values.tolist(), strict=True):
        if name == "wheel_base" and isinstance(motion, Ackermann):
            motion = replace(motion, wheel_base=motion.wheel_base * (1.0 + value))
            continue
        entries, multiplies = places[name]
        u[entries] = u[entries] * (1.0 + value) if multiplies else u[entries] + value
    return motion, replace(control, u=u)


def sensitivity(motion: Motion, control: Control, names: Sequence[str], values: Array) -> tuple[Array, Array, Array]:
    """Increment (3,), its covariance (3, 3), and its derivative (3, k) by the errors."""
    delta, cov = _increment(motion, control, names, values)
    J = np.empty((3, len(names)))
    for k in range(len(names)):
        shift = np.zeros(len(names))
        shift[k] = STEP
        after = _increment(motion, control, names, values + shift)[0]
        before = _increment(motion, control, names, values - shift)[0]
        J[:, k] = (after - before) / (2.0 * STEP)
    return delta, cov, J


def _increment(motion: Motion, control: Control, names: Sequence[str], values: Array) -> Any:
    model, reading = corrected(motion, control, names, values)
    return model.increment(reading)
