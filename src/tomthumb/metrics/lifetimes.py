"""When each landmark was in the map, and which true landmark it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomthumb.metrics.truth import UNKNOWN
from tomthumb.types import Array, Ids, Mask, Trace

FOREVER = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Lifetimes:
    """Landmarks `ids (n,)` ascending, with their true `identity (n,)` and the steps between which they were known.

    A landmark can be paired at step k when birth < k <= end.
    """

    ids: Ids
    identity: Ids
    birth: Ids
    end: Ids

    def identity_of(self, ids: Ids) -> Ids:
        """The true landmark (M,) behind each map id (M,); -2 for ids that are none or unknown."""
        found = np.full(len(ids), UNKNOWN, np.int64)
        if len(self.ids):
            at = np.minimum(np.searchsorted(self.ids, ids), len(self.ids) - 1)
            known = self.ids[at] == ids
            found[known] = self.identity[at[known]]
        return found

    def first_known(self, identity: Ids, step: Ids) -> Ids:
        """The landmark born first among those of `identity (q,)` that are in the map at `step (q,)`, or -1.

        Clutter is nobody: negative identities are not looked for.
        """
        first = np.full(len(identity), -1, np.int64)
        order = np.argsort(identity, kind="stable")
        ranked = identity[order]
        latest_first = np.lexsort((self.ids, self.birth))[::-1]
        for row in latest_first[self.identity[latest_first] >= 0]:
            low, high = np.searchsorted(ranked, [self.identity[row], self.identity[row] + 1])
            asked = order[low:high]
            alive = (self.birth[row] < step[asked]) & (step[asked] <= self.end[row])
            first[asked[alive]] = self.ids[row]  # an earlier one, which comes later here, takes its place
        return first


def step_of_observation(offsets: Ids) -> Ids:
    """The step (M,) in which each observation was made."""
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def online_lifetimes(trace: Trace, truth_ids: Ids) -> Lifetimes:
    """Lifetimes as the run lived them: born at the first mention, ended by death, merging or the loss of a branch."""
    landmarks, identity, first, last = _mentions(trace.ids, trace.paired, trace.offsets, truth_ids)
    gone = np.concatenate([trace.died[:, :2], trace.merged[:, ::2]])
    end = _ends(landmarks, gone)
    survives = np.isin(landmarks, trace.final.ids)
    end = np.where((end == FOREVER) & ~survives, last, end)
    return Lifetimes(landmarks, identity, first, end)


def final_lifetimes(trace: Trace, final_ids: Ids, truth_ids: Ids) -> Lifetimes:
    """Lifetimes as seen after revision and merging: a survivor has lived since the first of all that it absorbed."""
    known = final_pairings(trace, final_ids)
    landmarks, identity, first, _ = _mentions(final_ids, known, trace.offsets, truth_ids)
    return Lifetimes(landmarks, identity, first, _ends(landmarks, trace.died[:, :2]))


def final_pairings(trace: Trace, final_ids: Ids) -> Mask:
    """True (M,) where an observation was, in the end, paired with a landmark rather than the first of it."""
    known = final_ids >= 0
    named = np.flatnonzero(known)
    first = named[np.unique(final_ids[named], return_index=True)[1]]
    known[first] = trace.paired[first] & (final_ids[first] != first)  # only a map given at the start was there before
    return known


def _mentions(ids: Ids, paired: Mask, offsets: Ids, truth_ids: Ids) -> tuple[Ids, Ids, Ids, Ids]:
    """Landmarks with their identity, first and last step of mention; one first seen as known was there before."""
    step = step_of_observation(offsets)
    named = np.flatnonzero(ids >= 0)
    landmarks, index, inverse = np.unique(ids[named], return_index=True, return_inverse=True)
    first, last = step[named[index]], np.zeros(len(landmarks), np.int64)
    np.maximum.at(last, inverse, step[named])
    birth = np.where(paired[named[index]], first - 1, first)
    return landmarks, _identities(landmarks, first, ids, truth_ids, step), birth, last


def _identities(landmarks: Ids, first: Ids, ids: Ids, truth_ids: Ids, step: Ids) -> Ids:
    """The label of the observation that gave birth; where that is unknown, of the first labelled one paired with it."""
    identity = np.full(len(landmarks), UNKNOWN, np.int64)
    own = (landmarks < len(truth_ids)) & (landmarks >= 0)
    own[own] = step[landmarks[own]] <= first[own]
    identity[own] = truth_ids[landmarks[own]]
    labelled = np.flatnonzero((ids >= 0) & (truth_ids != UNKNOWN))
    named, index = np.unique(ids[labelled], return_index=True)
    by_pairing = np.full(len(landmarks), UNKNOWN, np.int64)
    by_pairing[np.searchsorted(landmarks, named)] = truth_ids[labelled[index]]
    return np.where(identity == UNKNOWN, by_pairing, identity)


def _ends(landmarks: Ids, gone: Array | Ids) -> Ids:
    end = np.full(len(landmarks), FOREVER, np.int64)
    known = np.isin(gone[:, 0], landmarks)
    end[np.searchsorted(landmarks, gone[known, 0])] = gone[known, -1]
    return end
