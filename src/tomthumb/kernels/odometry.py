"""The motion of a wheeled robot over one reading, with its covariance (see `models.motion` for what and why)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any


@jit
def arc(distance: float, turn: float) -> tuple[Array, Array]:
    """The increment of a drive of `distance` m while turning by `turn` rad, with its Jacobian (3, 2) by the two.

    x = d sin(w)/w, y = d (1 - cos(w))/w; series near w = 0.
    """
    if abs(turn) < 1e-4:
        s, c = 1.0 - turn * turn / 6.0, turn / 2.0 - turn**3 / 24.0
        ds, dc = -turn / 3.0, 0.5 - turn * turn / 8.0
    else:
        s, c = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
        ds, dc = (math.cos(turn) - s) / turn, (math.sin(turn) - c) / turn
    jacobian = np.array([[s, distance * ds], [c, distance * dc], [0.0, 1.0]])
    return np.array([distance * s, distance * c, turn]), jacobian


@jit
def spread(J: Array, noise: Array) -> Array:
    """J noise J' (3, 3) for J (3, 2) and a symmetric noise (2, 2)."""
    out = np.empty((3, 3))
    for i in range(3):
        p = J[i, 0] * noise[0, 0] + J[i, 1] * noise[1, 0]
        q = J[i, 0] * noise[0, 1] + J[i, 1] * noise[1, 1]
        for j in range(3):
            out[i, j] = p * J[j, 0] + q * J[j, 1]
    return out


@jit
def ackermann(
    speed: float, steering: float, dt: float, wheel_base: float, encoder_offset: float, ahead: float, left: float,
    noise: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Increment (3,) and covariance (3, 3) of the point (ahead, left) m of a car; noise (2, 2) of speed and steering."""
    tan = math.tan(steering)
    k = 1.0 / (1.0 - tan * encoder_offset / wheel_base)
    delta, by_arc = arc(speed * k * dt, speed * k * tan / wheel_base * dt)
    c, s = math.cos(delta[2]), math.sin(delta[2])
    delta[0] += c * ahead - s * left - ahead
    delta[1] += s * ahead + c * left - left
    by_arc[0, 1] += -s * ahead - c * left
    by_arc[1, 1] += c * ahead - s * left
    dtan = 1.0 + tan * tan
    dk = k * k * dtan * encoder_offset / wheel_base
    by_speed, by_steering = k * tan / wheel_base * dt, speed * (dk * tan + k * dtan) / wheel_base * dt
    J = np.empty((3, 2))
    for i in range(3):
        J[i, 0] = by_arc[i, 0] * k * dt + by_arc[i, 1] * by_speed
        J[i, 1] = by_arc[i, 0] * speed * dk * dt + by_arc[i, 1] * by_steering
    return delta, spread(J, noise)
