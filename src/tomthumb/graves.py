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
WIDER = 20.0  # gates around a place in which graves are counted, to tell how many there would be by chance


@dataclass(frozen=True, slots=True)
class Grave:
    """A landmark given up: world point (2,) m and covariance (2, 2) of its last sighting, and its static sightings, in all
    and since it first came back. visits: the last scan of each stay there, oldest first.
    """

    place: Array
    cov: Array
    static: int
    returned: int
    visits: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Found:
    """What lies where something was founded: graves `there` by index, oldest first, and how many visits `around` are told of
    by graves within WIDER gates of it, but not within one.
    """

    there: Ids
    around: int


@dataclass(frozen=True, slots=True)
class Graveyard:
    """All graves of one branch; beside them places (n, 2), covs (n, 2, 2) and numbers of visits (n,). It never changes, so
    branches may share it.
    """

    graves: tuple[Grave, ...] = ()
    places: Array = field(default_factory=lambda: np.empty((0, 2)))
    covs: Array = field(default_factory=lambda: np.empty((0, 2, 2)))
    visits: Ids = field(default_factory=lambda: np.empty(0, np.int64))

    def and_buried(self, dead: Sequence[Grave]) -> Graveyard:
        """With those as well."""
        if not dead:
            return self
        places = np.concatenate([self.places, [grave.place for grave in dead]])
        covs = np.concatenate([self.covs, [grave.cov for grave in dead]])
        visits = np.concatenate([self.visits, [len(grave.visits) for grave in dead]])
        return Graveyard((*self.graves, *dead)[-MOST:], places[-MOST:], covs[-MOST:], visits[-MOST:])

    def without(self, indices: Ids) -> Graveyard:
        """With those empty."""
        if not len(indices):
            return self
        kept: Mask = np.ones(len(self.graves), bool)
        kept[indices] = False
        rest = tuple(grave for grave, stays in zip(self.graves, kept.tolist(), strict=True) if stays)
        return Graveyard(rest, self.places[kept], self.covs[kept], self.visits[kept])

    def at(self, places: Array, covs: Array, gate2: float) -> list[Found]:
        """What lies at each of places (m, 2) with covariances (m, 2, 2), by Mahalanobis distance within the gate.

        A grave within the gates of several places is that of the nearest.
        """
        if not self.graves or not len(places):
            return [Found(np.empty(0, np.int64), 0) for _ in places]
        gap, S = self.places[None] - places[:, None], self.covs[None] + covs[:, None]
        x, y, det = gap[..., 0], gap[..., 1], S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
        d2 = (S[..., 1, 1] * x * x - 2.0 * S[..., 0, 1] * x * y + S[..., 0, 0] * y * y) / det
        nearest = d2.argmin(0)
        found = []
        for k, row in enumerate(d2):
            around = int(self.visits[(row >= gate2) & (row < WIDER * WIDER * gate2)].sum())
            found.append(Found(np.flatnonzero((row < gate2) & (nearest == k)), around))
        return found
