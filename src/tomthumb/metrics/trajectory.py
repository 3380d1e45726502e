"""Errors of the trajectory: absolute with and without alignment, by axis, and relative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.geometry import align, to_world, wrap
from tomthumb.types import Array, Mask


@dataclass(frozen=True)
class TrajectoryErrors:
    """Root mean squares in m and rad; NaN where there is no truth."""

    ate: float
    ate_raw: float
    x: float
    y: float
    heading: float
    final: float
    largest: float


def trajectory_errors(pose: Array, truth: Array, scored: Mask) -> TrajectoryErrors:
    """Compare `pose (K, 3)` with `truth (K, 3)` (NaN unknown) over the `scored (K,)` steps.

    `ate` is taken after the rigid SE(2) alignment of the positions (Umeyama, without scale), the others without.
    """
    valid = scored & np.isfinite(truth[:, :2]).all(1) & np.isfinite(pose).all(1)
    if not valid.any():
        return TrajectoryErrors(*[float("nan")] * 7)
    mine, real = pose[valid, :2], truth[valid, :2]
    error = mine - real
    distance = np.hypot(error[:, 0], error[:, 1])
    turned = wrap(pose[valid, 2] - truth[valid, 2])
    aligned = to_world(align(mine, real), mine) - real
    return TrajectoryErrors(
        ate=rms(np.hypot(aligned[:, 0], aligned[:, 1])),
        ate_raw=rms(distance),
        x=rms(error[:, 0]),
        y=rms(error[:, 1]),
        heading=rms(turned[np.isfinite(turned)]),
        final=float(distance[-1]),
        largest=float(distance.max()),
    )


def relative_errors(pose: Array, truth: Array, scored: Mask, length: float = 1.0) -> tuple[float, float]:
    """RMS error (m, rad) of the motion over each stretch of `length` m of the true path (relative pose error).

    NaN where the true headings are not known or the path is shorter. References: Sturm et al., IROS 2012, section IV.
    """
    valid = scored & np.isfinite(truth).all(1) & np.isfinite(pose).all(1)
    mine, real = pose[valid], truth[valid]
    if len(real) < 2:
        return float("nan"), float("nan")
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(real[:, :2], axis=0).T))])
    stop = np.searchsorted(path, path + length)
    start = np.flatnonzero(stop < len(path))
    stop = stop[start]
    moved, moved_really = _motions(mine[start], mine[stop]), _motions(real[start], real[stop])
    error = _motions(moved_really, moved)
    return rms(np.hypot(error[:, 0], error[:, 1])), rms(error[:, 2])


def _motions(a: Array, b: Array) -> Array:
    """Poses b (n, 3) seen from poses a (n, 3), row by row."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    return np.stack([c * dx + s * dy, -s * dx + c * dy, wrap(b[:, 2] - a[:, 2])], 1)


def rms(values: Array) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
