"""Where landmarks were given up: what is met at such a place again is no passer-by.

Crossing people and chance echoes are seen for one stay. A tree behind other trees is seen for a while, then from most of
the way not, and then again at the very same place. So the place of what was given up is remembered, with how often it was
seen; what is founded there takes that up and is known to have come back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tomthumb.types import Array, Ids

MOST = 20_000  # graves that are kept, newest first: bounds memory only
WEIGHTY = 2  # static sightings that leave a grave: a single one may be clutter


@dataclass(frozen=True, slots=True)
class Grave:
    """A landmark given up: place (2,) m and covariance (2, 2) of its last sighting, static sightings in all and since it
    first came back.
    """

    place: Array
    cov: Array
    static: int
    returned: int


@dataclass(frozen=True, slots=True)
class Graveyard:
    """All graves of one branch. It never changes, so that branches may share it."""

    graves: tuple[Grave, ...] = ()
    places: Array = field(default_factory=lambda: np.empty((0, 2)))
    covs: Array = field(default_factory=lambda: np.empty((0, 2, 2)))

    def and_buried(self, dead: Sequence[Grave]) -> Graveyard:
        """With those as well."""
        kept = (*self.graves, *(g for g in dead if g.static >= WEIGHTY))[-MOST:]
        return _of(kept) if len(kept) and kept[-1] is not (self.graves or (None,))[-1] else self

    def at(self, places: Array, covs: Array, gate2: float) -> Ids:
        """The nearest grave (m,) by Mahalanobis distance within the gate of each place (m, 2), covariance (m, 2, 2); -1: none."""
        found = np.full(len(places), -1, np.int64)
        if not self.graves or not len(places):
            return found
        gap = self.places[None] - places[:, None]
        reach = np.sqrt(gate2 * (np.trace(covs, axis1=1, axis2=2).max() + np.trace(self.covs, axis1=1, axis2=2).max()))
        best = np.full(len(places), gate2)
        for k, n in np.argwhere((np.abs(gap) < reach).all(2)):
            d2 = float(gap[k, n] @ np.linalg.solve(self.covs[n] + covs[k], gap[k, n]))
            if d2 < best[k]:
                found[k], best[k] = n, d2
        return found

    def without(self, indices: Ids) -> Graveyard:
        """With those empty."""
        gone = set(indices.tolist())
        return _of(tuple(g for n, g in enumerate(self.graves) if n not in gone)) if gone else self


def _of(graves: tuple[Grave, ...]) -> Graveyard:
    if not graves:
        return Graveyard()
    return Graveyard(graves, np.array([g.place for g in graves]), np.array([g.cov for g in graves]))
