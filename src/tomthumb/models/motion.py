"""Motion models: what the odometry says, turned into a relative motion of the robot and its covariance.

Every model gives an increment (dx m, dy m, dheading rad) in the robot's frame before the motion; the pose then becomes
``compose(pose, increment)``. So the pose's own Jacobian is the same for all of them (`geometry.compose_jacobians`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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
        delta, J = arc(control.u[0] * dt, control.u[1] * dt)
        J = J * dt
        noise = np.diag(np.square(self.std)) if control.cov is None else control.cov
        cov = J @ noise @ J.T
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
        speed, steering, dt = float(control.u[0]), float(control.u[1]), control.dt
        tan = math.tan(steering)
        k = 1.0 / (1.0 - tan * self.encoder_offset / self.wheel_base)
        distance, turn = speed * k * dt, speed * k * tan / self.wheel_base * dt
        delta, by_arc = arc(distance, turn)
        dtan = 1.0 + tan * tan
        dk = k * k * dtan * self.encoder_offset / self.wheel_base
        by_u = (
            np.array([[k, speed * dk], [k * tan / self.wheel_base, speed * (dk * tan + k * dtan) / self.wheel_base]])
            * dt
        )
        delta, by_arc = self._at_point(delta, by_arc)
        J = by_arc @ by_u
        noise = np.diag(np.square(self.std)) if control.cov is None else control.cov
        return delta, J @ noise @ J.T + np.diag(np.square(self.pose_std) * dt)

    def _at_point(self, delta: Array, by_arc: Array) -> tuple[Array, Array]:
        """The same motion for the point (ahead, left): p + R(turn) offset - offset."""
        c, s = math.cos(delta[2]), math.sin(delta[2])
        a, b = self.ahead, self.left
        moved = np.array([delta[0] + c * a - s * b - a, delta[1] + s * a + c * b - b, delta[2]])
        by_turn = np.array([-s * a - c * b, c * a - s * b, 0.0])
        return moved, by_arc + np.outer(by_turn, [0.0, 1.0])
