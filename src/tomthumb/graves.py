"""Where landmarks were given up: what is met at such a place again is no passer-by.

Crossing people and chance echoes are seen for one stay. A tree behind other trees is seen for a while, then from most of
the way not, and then again at the very same place. So the place of what was given up is remembered, with how often it was
seen; what is founded there takes that up and is known to have come back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tomthumb.types import Array, Ids, Mask

MOST = 5000  # graves that are kept, newest first: bounds memory only


@dataclass(frozen=True, slots=True)
class Grave:
    """A landmark given up: world point (2,) m and covariance (2, 2) of its last sighting, and its static sightings, in all
    and since it first came back.
    """

    place: Array
    cov: Array
    static: int
    returned: int


@dataclass(frozen=True, slots=True)
class Graveyard:
    """All graves of one branch, places (n, 2) and covs (n, 2, 2) beside them. It never changes, so branches may share it."""

    graves: tuple[Grave, ...] = ()
    places: Array = field(default_factory=lambda: np.empty((0, 2)))
    covs: Array = field(default_factory=lambda: np.empty((0, 2, 2)))

    def and_buried(self, dead: Sequence[Grave]) -> Graveyard:
        """With those as well."""
        if not dead:
            return self
        places = np.concatenate([self.places, [grave.place for grave in dead]])
        covs = np.concatenate([self.covs, [grave.cov for grave in dead]])
        return Graveyard((*self.graves, *dead)[-MOST:], places[-MOST:], covs[-MOST:])

    def without(self, indices: Ids) -> Graveyard:
        """With those empty."""
        if not len(indices):
            return self
        kept: Mask = np.ones(len(self.graves), bool)
        kept[indices] = False
        rest = tuple(grave for grave, stays in zip(self.graves, kept.tolist(), strict=True) if stays)
        return Graveyard(rest, self.places[kept], self.covs[kept])

    def at(self, places: Array, covs: Array, gate2: float) -> Ids:
        """For places (m, 2) with covariances (m, 2, 2) the grave (m,) nearest by Mahalanobis distance within the gate; -1: none."""
        found = np.full(len(places), -1, np.int64)
        if not self.graves or not len(places):
            return found
        best = np.full(len(places), gate2)
        gap = self.places[None] - places[:, None]
        var = np.diagonal(covs, axis1=1, axis2=2)[:, None] + np.diagonal(self.covs, axis1=1, axis2=2)[None]
        for k, n in np.argwhere((gap * gap < gate2 * var).all(2)):
            d2 = float(gap[k, n] @ np.linalg.solve(self.covs[n] + covs[k], gap[k, n]))
            if d2 < best[k]:
                found[k], best[k] = n, d2
        return found
