"""Clusters of laser returns, and bright reflectors among them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.types import Array, Ids, Mask, Observations


@dataclass(frozen=True, slots=True)
class Detections:
    """Round things found in one scan: `z (m, 2)` range to the centre m and bearing rad, with `R (m, 2, 2)`.

    `diameter (m,)` m; `returns (m,)` the number of laser returns on each.
    """

    z: Array
    R: Array
    diameter: Array
    returns: Ids

    def observations(self) -> Observations:
        """The same as a scan, the diameter as its signature."""
        return Observations(self.z, self.R, signature=self.diameter)


def check_scan(ranges: Array, angles: Array) -> None:
    """Raise TomThumbError unless `ranges (B,)` m fit increasing `angles (B,)` rad."""
    if ranges.ndim != 1 or ranges.shape != angles.shape:
        raise TomThumbError(f"a scan of shape {ranges.shape} with angles of shape {angles.shape}: both must be (B,)")
    if (np.diff(angles) <= 0).any():
        raise TomThumbError("the angles of a scan must increase")


def cluster(ranges: Array, angles: Array, valid: Mask, gap: float) -> list[Ids]:
    """Beams (B,) grouped: those `valid` whose points are at most `gap` m from the last one's. In order of angle."""
    beams = np.flatnonzero(valid)
    if not len(beams):
        return []
    points = ranges[beams, None] * np.column_stack([np.cos(angles[beams]), np.sin(angles[beams])])
    far = np.linalg.norm(np.diff(points, axis=0), axis=1) > gap
    return np.split(beams, np.flatnonzero(far) + 1)


def reflectors(
    ranges: Array,
    intensity: Array,
    angles: Array,
    *,
    gap: float = 0.6,
    max_range: float = 80.0,
    min_returns: int = 1,
    radius: float = 0.03,
    range_std: float = 0.03,
    beam: float = np.radians(0.5),
) -> Detections:
    """Reflective posts of `radius` m: bright returns (`intensity` > 0) at most `gap` m apart are one post.

    ranges (B,) m, intensity (B,), angles (B,) rad (0 ahead, left positive). The bearing is the mean of the returns, its
    variance that of a uniform error within one spacing of the beams (`beam` rad), less with more returns. Raises
    TomThumbError where shapes do not fit.
    """
    check_scan(ranges, angles)
    bright = (intensity > 0) & np.isfinite(ranges) & (ranges > 0) & (ranges < max_range)
    groups = [g for g in cluster(ranges, angles, bright, gap) if len(g) >= min_returns]
    if not groups:
        return Detections(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0), np.empty(0, np.int64))
    count = np.array([len(g) for g in groups])
    r = np.array([ranges[g].mean() for g in groups]) + radius
    b = np.array([angles[g].mean() for g in groups])
    var_b = beam**2 / 12 * (1 + 1 / count)
    R = np.zeros((len(r), 2, 2))
    R[:, 0, 0], R[:, 1, 1] = range_std**2 * (1 + 1 / count) / 2, var_b
    return Detections(np.column_stack([r, b]), R, np.full(len(r), 2 * radius), count)
