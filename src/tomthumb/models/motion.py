"""Motion models: what the odometry says, turned into a relative motion of the robot and its covariance.

Every model gives an increment (dx m, dy m, dheading rad) in the robot's frame before the motion; the pose then becomes
``compose(pose, increment)``. So the pose's own Jacobian is the same for all of them (`geometry.compose_jacobians`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.kernels.odometry import ackermann, arc, spread
from tomthumb.types import Array, Control


@dataclass(frozen=True, slots=True)
class OdometryIncrement:
    """u = (dx m, dy m, dheading rad) in the robot's frame. `std (3,)` applies where the control brings no covariance."""

    std: tuple[float, float, float] = (0.01, 0.01, 0.01)
    rates: bool = False

    def increment(self, control: Control) -> tuple[Array, Array]:
        """See `protocols.Motion`."""
        cov = np.diag(np.square(self.std)) if control.cov is None else control.cov
        return control.u, cov


@dataclass(frozen=True, slots=True)
class Velocity:
    """u = (v m/s, omega rad/s), held for dt: an exact arc. `std` of v and omega as sampled once per control.

    `slip_std` m is an additional sideways and lengthways error per square root of second (0 for none).
    """

    std: tuple[float, float] = (0.05, 0.05)
    slip_std: float = 0.0
    rates: bool = True

    def increment(self, control: Control) -> tuple[Array, Array]:
        """See `protocols.Motion`."""
        dt = control.dt
        delta, J = arc(float(control.u[0] * dt), float(control.u[1] * dt))
        cov = spread(J * dt, _of_reading(self.std, control))
        cov[0, 0] += self.slip_std**2 * dt
        cov[1, 1] += self.slip_std**2 * dt
        return delta, cov


@dataclass(frozen=True, slots=True)
class Ackermann:
    """u = (encoder speed m/s, steering angle rad) of a car whose encoder sits on a rear wheel.

    Speed of the axle's centre: v = v_encoder / (1 - tan(steering) encoder_offset / wheel_base). The pose is that of the
    point `ahead` m before and `left` m beside the centre of the rear axle. `std` of (speed, steering); `pose_std (3,)` is
    an additive error a step that stands for slip (in m, m, rad per square root of second).

    References: J. Guivant, E. Nebot, IEEE T-RA 17(3), 2001, eq. 4 to 6 (there the point is the laser).
    """

    wheel_base: float = 2.83
    encoder_offset: float = 0.76
    ahead: float = 0.0
    left: float = 0.0
    std: tuple[float, float] = (0.5, 0.05)
    pose_std: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rates: bool = True

    def increment(self, control: Control) -> tuple[Array, Array]:
        """See `protocols.Motion`."""
        dt = control.dt
        delta, cov = ackermann(
            float(control.u[0]), float(control.u[1]), float(dt), float(self.wheel_base), float(self.encoder_offset),
            float(self.ahead), float(self.left), _of_reading(self.std, control),
        )  # fmt: skip
        for i, std in enumerate(self.pose_std):
            cov[i, i] += std * std * dt
        return delta, cov


def _of_reading(std: tuple[float, float], control: Control) -> Array:
    """The covariance (2, 2) of a reading: what it brings, else that of the model."""
    if control.cov is not None:
        return np.array(control.cov, float, order="C")
    return np.array([[std[0] * std[0], 0.0], [0.0, std[1] * std[1]]], float)
