"""Sensors that see points: range and bearing, or Cartesian, with a field of view, an offset on the robot, and clutter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from tomthumb.geometry import compose, wrap
from tomthumb.kernels import gates
from tomthumb.types import Array


@dataclass(frozen=True, slots=True)
class RangeBearing:
    """z = (range m, bearing rad; 0 ahead, left positive).

    Sees landmarks between `min_range` and `max_range` m, within `fov` rad (the full opening angle) about its axis.
    `mount` is the sensor's pose on the robot (m, m, rad). `std` of range m and bearing rad; `clutter` false observations
    per m2 and scan; `detect` the probability of detection inside the field of view. `memory` m: the path over which the
    errors of range and of bearing repeat themselves (0: every scan errs anew); a real sensor at rest repeats its errors.
    """

    max_range: float = math.inf
    fov: float = 2.0 * math.pi
    min_range: float = 0.0
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float] = (0.1, 0.02)
    detect: float = 0.95
    clutter: float = 0.01
    memory: tuple[float, float] = (0.0, 0.0)
    angles: tuple[int, ...] = (1,)

    def frame(self, pose: Array) -> Array:
        """See `protocols.Sensor`."""
        return compose(pose, np.array(self.mount))

    def expect(self, pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        """See `protocols.Sensor`."""
        return gates.expect_range_bearing(pose, np.array(self.mount), landmarks)

    def locate(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """See `protocols.Sensor`."""
        return gates.locate_range_bearing(pose, np.array(self.mount), z)

    def in_view(self, z_hat: Array, var: Array) -> Array:
        """See `protocols.Sensor`."""
        return _in_sector(z_hat[:, 0], z_hat[:, 1], np.sqrt(var), self.min_range, self.max_range, self.fov)

    def scale(self, z: Array) -> Array:
        """See `protocols.Sensor`: dx dy = r dr db."""
        return np.maximum(z[:, 0], 1e-3)

    def noise(self, z: Array) -> Array:
        """R (m, 2, 2) of observations that bring none."""
        return np.tile(np.diag(np.square(self.std)), (len(z), 1, 1))


@dataclass(frozen=True, slots=True)
class Cartesian:
    """z = (x m, y m) in the sensor's frame. `facing` rad is the direction of its axis in that frame.

    The rest as in `RangeBearing`; `std` of x and y, m.
    """

    max_range: float = math.inf
    fov: float = 2.0 * math.pi
    min_range: float = 0.0
    facing: float = 0.0
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float] = (0.05, 0.05)
    detect: float = 0.95
    clutter: float = 0.01
    memory: tuple[float, float] = (0.0, 0.0)
    angles: tuple[int, ...] = ()

    def frame(self, pose: Array) -> Array:
        """See `protocols.Sensor`."""
        return compose(pose, np.array(self.mount))

    def expect(self, pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        """See `protocols.Sensor`."""
        return gates.expect_cartesian(pose, np.array(self.mount), landmarks)

    def locate(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """See `protocols.Sensor`."""
        return gates.locate_cartesian(pose, np.array(self.mount), z)

    def in_view(self, z_hat: Array, var: Array) -> Array:
        """See `protocols.Sensor`."""
        r = np.maximum(np.hypot(z_hat[:, 0], z_hat[:, 1]), 1e-9)
        unit = z_hat / r[:, None]
        along = np.sqrt((unit**2 * var).sum(1))
        across = np.sqrt((unit[:, ::-1] ** 2 * var).sum(1)) / r
        bearing = wrap(np.arctan2(z_hat[:, 1], z_hat[:, 0]) - self.facing)
        return _in_sector(r, bearing, np.column_stack([along, across]), self.min_range, self.max_range, self.fov)

    def scale(self, z: Array) -> Array:
        """See `protocols.Sensor`."""
        return np.ones(len(z))

    def noise(self, z: Array) -> Array:
        """R (m, 2, 2) of observations that bring none."""
        return np.tile(np.diag(np.square(self.std)), (len(z), 1, 1))


def _in_sector(r: Array, bearing: Array, std: Array, near: float, far: float, fov: float) -> Array:
    """Probability that a point is between two ranges and within an opening angle, errors taken as independent."""
    s_r = np.maximum(std[:, 0], 1e-12)
    chance: Array = ndtr((far - r) / s_r) if math.isfinite(far) else np.ones(len(r))
    if near > 0.0:
        chance = chance * ndtr((r - near) / s_r)
    if fov < 2.0 * math.pi:
        s_b = np.maximum(std[:, 1], 1e-12)
        chance = chance * (ndtr((fov / 2 - bearing) / s_b) - ndtr((-fov / 2 - bearing) / s_b))
    return chance
