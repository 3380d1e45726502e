"""Trunks and poles in a 2-D laser scan: isolated round things, from the arc of returns they give."""

from __future__ import annotations

import math

import numpy as np

from tomthumb.detectors.laser import Detections, check_scan, cluster
from tomthumb.types import Array, Ids, Mask


def trunks(
    ranges: Array,
    angles: Array,
    *,
    max_range: float = 75.0,
    gap: float = 1.5,
    clearance: float = 3.0,
    min_diameter: float = 0.0,
    max_diameter: float = 1.4,
    min_range: float = 1.0,
    margin: float = math.radians(2.5),
    range_std: float = 0.05,
    min_returns: int = 1,
) -> Detections:
    """Round, free-standing things in a scan of `ranges (B,)` m at rising `angles (B,)` rad (0 ahead, left positive).

    Returns from `min_range` to `max_range` m away and at most `gap` m apart form a cluster, beams without return being
    skipped. A cluster is a trunk if it is as wide as `min_diameter` to `max_diameter` m, no deeper than a round thing
    of that width, at least `clearance` m from its neighbours in the scan, not cut by a nearer one (so that both its
    edges are seen), and `margin` rad from the scan's ends. Its diameter is the width of its arc, its range that of the
    arc's middle plus half the diameter.

    R adds to `range_std` the error of the diameter (uniform within one beam's width, half of which goes into the range)
    and takes the bearing as uniform within one beam, less with more returns. Raises TomThumbError where shapes do not
    fit.
    """
    check_scan(ranges, angles)
    beam = float(np.median(np.diff(angles))) if len(angles) > 1 else math.radians(0.5)
    valid = np.isfinite(ranges) & (ranges >= min_range) & (ranges <= max_range)
    groups = cluster(ranges, angles, valid, gap)
    rows = [_arc(ranges, angles, group, beam) for group in groups]
    found = np.array(rows).reshape(-1, 4)
    r, b, diameter, depth = found.T
    count = np.array([len(group) for group in groups], np.int64)
    good = (diameter >= min_diameter) & (diameter <= max_diameter) & (depth <= 0.6 * diameter + 3 * range_std)
    if len(groups):
        good &= (b > angles[0] + margin) & (b < angles[-1] - margin)
        good &= (count >= min_returns) & _free(ranges, angles, groups, clearance)
    return _detections(r[good], b[good], diameter[good], count[good], beam, range_std)


def poles(
    ranges: Array, angles: Array, *, max_diameter: float = 0.3, clearance: float = 0.5, **rest: float
) -> Detections:
    """Thin posts: `trunks` with limits for poles. Raises TomThumbError where shapes do not fit."""
    return trunks(ranges, angles, max_diameter=max_diameter, clearance=clearance, **rest)  # type: ignore[arg-type]


def _arc(ranges: Array, angles: Array, group: Ids, beam: float) -> tuple[float, float, float, float]:
    """Range to the centre, bearing, diameter and depth of a cluster of beams `group`."""
    r = ranges[group]
    n = len(group)
    width = (angles[group[-1]] - angles[group[0]] + beam) * (r[0] + r[-1]) / 2
    middle = r[(n - 1) // 2 : n // 2 + 1].mean()
    bearing = (angles[group[0]] + angles[group[-1]]) / 2
    return float(middle + width / 2), float(bearing), float(width), float(np.ptp(r))


def _free(ranges: Array, angles: Array, groups: list[Ids], clearance: float) -> Mask:
    """Which clusters are `clearance` m from the ones before and after, and not cut by a nearer one beside them."""
    first, last = np.array([g[0] for g in groups]), np.array([g[-1] for g in groups])
    apart = _distance(ranges, angles, last[:-1], first[1:])
    behind = ranges[first[1:]] - ranges[last[:-1]]  # how much the next cluster is farther away than this one
    touching = first[1:] - last[:-1] == 1
    hides = apart < clearance
    right_ok = ~(hides | (touching & (behind < 0)))
    left_ok = ~(hides | (touching & (behind > 0)))
    return np.asarray(np.append(True, left_ok) & np.append(right_ok, True))


def _distance(ranges: Array, angles: Array, a: Ids, b: Ids) -> Array:
    """Distance between the points of beams a and b, m."""
    points = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(np.linalg.norm(points[a] - points[b], axis=1))


def _detections(r: Array, b: Array, diameter: Array, count: Ids, beam: float, range_std: float) -> Detections:
    R = np.zeros((len(r), 2, 2))
    R[:, 0, 0] = range_std**2 + (r * beam) ** 2 / 48
    R[:, 1, 1] = beam**2 / 12 * (1 + 1 / np.maximum(count, 1))
    return Detections(np.column_stack([r, b]), R, diameter, count)
