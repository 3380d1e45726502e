"""What a run learns about its own sensor: where it really sees, how much it sees that is nothing, how honest its noise is.

A data sheet's field of view is seldom the truth: far landmarks are missed, others hide behind each other. What counts for
a landmark's existence is how often one in its place would have been seen.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tomthumb.protocols import Sensor
from tomthumb.types import Array, Ids, Mask, Observations

EDGES = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0])  # m: rings, about a factor 1.5 each
TURN = 0.5  # m of path that a turn of 1 rad is worth: it changes what the sensor sees, but not from where
STILL = 1e-4  # m: a scan at rest still counts for that much
SECTORS = 6  # of 30 deg off the axis, left and right alike


@dataclass(slots=True)
class DetectionMap:
    """Share of opportunities taken in each cell (ring, sector), from `prior` (worth `weight` opportunities)."""

    prior: float = 0.95
    weight: float = 4.0
    seen: Array = field(default_factory=lambda: np.zeros((len(EDGES) + 1, SECTORS)))
    tried: Array = field(default_factory=lambda: np.zeros((len(EDGES) + 1, SECTORS)))

    def chance(self, points: Array) -> Array:
        """Probability of detection (n,) of points (n, 2) m in the sensor's frame, were they in its field of view."""
        cell = _cells(points)
        share: Array = (self.seen[cell] + self.prior * self.weight) / (self.tried[cell] + self.weight)
        return share

    def record(self, points: Array, seen: Mask) -> None:
        """Confirmed landmarks that stood in the field of view, and which of them were seen."""
        cell = _cells(points)
        np.add.at(self.tried, cell, 1.0)
        np.add.at(self.seen, cell, seen.astype(float))


def _cells(points: Array) -> tuple[Ids, Ids]:
    ring = np.searchsorted(EDGES, np.hypot(points[:, 0], points[:, 1]))
    off = np.abs(np.arctan2(points[:, 1], points[:, 0]))
    sector = np.minimum((off * SECTORS / np.pi).astype(np.int64), SECTORS - 1)
    return ring.astype(np.int64), sector


@dataclass(slots=True)
class Surprise:
    """How much the last residuals exceed what R claims: median and upper tenth of d2, of pairings and what all but paired.

    Noise that is said too small makes every gate reject right pairings; a log's data sheet often does. These quantiles do
    not mind a few walkers and outliers. Below `dead` (3 sigma of the median of 400 values) nothing happens, so a right
    model stays as it is; `most` keeps a lost filter from accepting everything.
    """

    dead: float = 1.25
    most: float = 9.0
    least: int = 100
    last: deque[float] = field(default_factory=lambda: deque(maxlen=400))
    scale: float = 1.0

    def record(self, d2: Iterable[float]) -> None:
        """Squared distances (2 degrees of freedom each: median 2 log 2), by the R that was claimed."""
        self.last.extend(d2)
        if len(self.last) >= self.least:
            middle, upper = _quantiles(self.last, (0.5, 0.9))
            ratio = float(max(middle / (2.0 * math.log(2.0)), upper / (2.0 * math.log(10.0))))
            self.scale = min(ratio, self.most) if ratio > self.dead else 1.0


def _quantiles(values: Sequence[float], shares: Iterable[float]) -> list[float]:
    """As numpy's (linear between neighbours), which takes three times as long over 400 values, after every scan."""
    ordered = sorted(values)
    places = [share * (len(ordered) - 1) for share in shares]
    ends = [(ordered[int(p)], ordered[min(int(p) + 1, len(ordered) - 1)], p - int(p)) for p in places]
    return [low + (high - low) * share for low, high, share in ends]


@dataclass(slots=True)
class Clutter:
    """Running estimate of the density of unexplained observations, per m2 and scan: starts at `prior`, worth `weight` scans."""

    area: float
    prior: float = 0.3
    weight: float = 5.0
    scans: float = 0.0
    count: float = 0.0

    @property
    def density(self) -> float:
        """Observations that nothing explained, per m2 and scan."""
        return (self.prior * self.weight + self.count / self.area) / (self.weight + self.scans)


def area_in_view(sensor: Sensor) -> float:
    """Plane in view, m2; a sensor without limit of range is given 10 m, since only the order of magnitude matters."""
    reach = sensor.max_range if math.isfinite(sensor.max_range) else 10.0
    return 0.5 * sensor.fov * reach * reach


def news(seen: Observations, memory: tuple[float, float], moved: float) -> Observations:
    """The scan with its noise raised to what it adds: errors that repeat over `memory` m are not averaged away.

    `moved`: m since the last scan. Many scans over a path hold the news of path / memory independent ones; `memory` is the
    area under the falling correlation of the errors (`benchmarks/repetition.py`).
    """
    if not any(memory) or not math.isfinite(moved):
        return seen
    share = [min(1.0, max(moved, STILL) / length) if length > 0.0 else 1.0 for length in memory]
    raised = 1.0 / np.sqrt(np.array(share))
    return replace(seen, R=seen.R * np.outer(raised, raised))


def travelled(delta: Array) -> float:
    """The path in m that a motion (3,) is worth, to a sensor whose errors repeat themselves."""
    return math.hypot(delta[0], delta[1]) + abs(float(delta[2])) * TURN
