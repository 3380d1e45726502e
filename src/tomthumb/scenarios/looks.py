"""What simulated landmarks look like: a class and a trunk's diameter for each, read with errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tomthumb.scenarios.simulate import require
from tomthumb.types import Array, Ids, Observations

MEDIAN, SPREAD = 0.4, 0.5  # m, and of the logarithm: the trunks of Victoria Park, about


@dataclass(frozen=True, slots=True)
class Dress:
    """`classes` different ones (0: none), read wrongly with probability `confusion`; diameters read with `diameter_std`
    m (0: none).
    """

    classes: int = 0
    confusion: float = 0.0
    diameter_std: float = 0.0

    def check(self, name: str) -> None:
        """Raises TomThumbError for values out of range."""
        require(0 <= self.classes <= 1000, f"{name}: classes={self.classes}: 0 (none) to 1000")
        require(0.0 <= self.confusion <= 1.0, f"{name}: confusion={self.confusion}: 0 to 1")
        require(0.0 <= self.diameter_std < math.inf, f"{name}: diameter_std={self.diameter_std}: 0 (none) or more, m")


Seen = Sequence[tuple[Observations, Ids]]


def dressed(seen: Seen, landmarks: int, dress: Dress, rng: np.random.Generator) -> list[tuple[Observations, Ids]]:
    """The scans with classes and diameters as read; whoever is no landmark looks like anybody, anew in each scan."""
    if not dress.classes and not dress.diameter_std:
        return list(seen)
    own, reading = rng.spawn(2)
    kind, width = _drawn(landmarks, dress, own)
    return [(_read(scan, ids, kind, width, dress, reading), ids) for scan, ids in seen]


def _drawn(count: int, dress: Dress, rng: np.random.Generator) -> tuple[Ids, Array]:
    """Classes and diameters, m, of `count` things."""
    kind = rng.integers(0, max(dress.classes, 1), count)
    return kind, MEDIAN * np.exp(SPREAD * rng.standard_normal(count))


def _read(
    scan: Observations, ids: Ids, kind: Ids, width: Array, dress: Dress, rng: np.random.Generator
) -> Observations:
    m = len(ids)
    any_kind, any_width = _drawn(m, dress, rng)
    wrong, noise, other = rng.random(m), rng.standard_normal(m), rng.integers(0, max(dress.classes, 1), m)
    known, at = ids >= 0, np.maximum(ids, 0)
    labels = np.where(known & (wrong >= dress.confusion), kind[at], np.where(known, other, any_kind))
    diameter = np.maximum(np.where(known, width[at], any_width) + dress.diameter_std * noise, 0.01)
    out = replace(scan, labels=labels) if dress.classes else scan
    return replace(out, signature=diameter) if dress.diameter_std else out
