"""Poses in the plane: SE(2) composed, inverted, differenced; angles wrapped.

A pose is ``(3,)``: x m, y m, heading rad. ``pose_a_c = compose(pose_a_b, pose_b_c)``.
Every function takes and returns plain float64 arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TWO_PI = 2.0 * math.pi


def wrap(angle: Array) -> Array:
    """Angles brought to [-pi, pi), element by element, rad."""
    wrapped: Array = (np.asarray(angle, float) + math.pi) % TWO_PI - math.pi
    return wrapped


def wrap_angle(angle: float) -> float:
    """One angle brought to [-pi, pi), rad."""
    return (angle + math.pi) % TWO_PI - math.pi


def wrapped(angles: Sequence[int]) -> npt.NDArray[np.bool_]:
    """Which of the two components of z (2,) are angles and wrap, of their indices, as a sensor gives them."""
    flags = np.zeros(2, np.bool_)
    flags[list(angles)] = True
    return flags


def rotation(heading: float) -> Array:
    """The 2 x 2 matrix that turns a vector by `heading` rad."""
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s], [s, c]])


def compose(a: Array, b: Array) -> Array:
    """Pose `b`, given in the frame of pose `a`, expressed in the frame of `a` itself: a (+) b."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return np.array([a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrap_angle(a[2] + b[2])])


def inverse(a: Array) -> Array:
    """The pose that undoes `a`: compose(a, inverse(a)) is the identity."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return np.array([-c * a[0] - s * a[1], s * a[0] - c * a[1], wrap_angle(-a[2])])


def between(a: Array, b: Array) -> Array:
    """Pose `b` seen from pose `a`: inverse(a) (+) b."""
    return compose(inverse(a), b)


def compose_jacobians(a: Array, b: Array) -> tuple[Array, Array]:
    """Derivatives of compose(a, b) by `a` (3, 3) and by `b` (3, 3)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    by_a = np.array([[1.0, 0.0, -s * b[0] - c * b[1]], [0.0, 1.0, c * b[0] - s * b[1]], [0.0, 0.0, 1.0]])
    by_b = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return by_a, by_b


def to_world(pose: Array, points: Array) -> Array:
    """Points (n, 2) in the frame of `pose`, expressed in the world."""
    moved: Array = points @ rotation(pose[2]).T + pose[:2]
    return moved


def to_frame(pose: Array, points: Array) -> Array:
    """World points (n, 2), expressed in the frame of `pose`."""
    moved: Array = (points - pose[:2]) @ rotation(pose[2])
    return moved


def align(source: Array, target: Array) -> Array:
    """The pose that carries `source` (n, 2) onto `target` (n, 2) with the least squared error, without scale.

    References: S. Umeyama, IEEE T-PAMI 13(4), 1991, eq. 40 to 42 in two dimensions and with c = 1.
    """
    mean_source, mean_target = source.mean(0), target.mean(0)
    covariance = (target - mean_target).T @ (source - mean_source)
    heading = math.atan2(covariance[1, 0] - covariance[0, 1], covariance[0, 0] + covariance[1, 1])
    return np.array([*(mean_target - rotation(heading) @ mean_source), heading])
