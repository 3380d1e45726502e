"""Birth, trial, confirmation, ambiguity, merging and death of landmarks: one policy for every associator.

A *crumb* is a tentative landmark: the filter carries it as a considered state that never moves the pose. Static hits make
it a *stone*; too few hits for its opportunities end it. The existence of a landmark is (hits + 1/2) / (opportunities + 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtri

from tomthumb.appearance import Crowd, Looks, Weight
from tomthumb.errors import from_zero
from tomthumb.graves import Grave
from tomthumb.stillness import Drift
from tomthumb.types import Array, Ids, Mask, Observations, Predictions

SURE = 0.999  # no landmark exists more surely
ABSENT = 3.0  # sightings expected in vain, one after the other, of which chance makes as many once in twenty (Poisson)


@dataclass(frozen=True, slots=True)
class LifeCycle:
    """The policy's numbers; each has its reason in docs/lifecycle.md.

    hits: static sightings that turn a crumb into a stone (1: at once); `few` are enough while a scan shows less than
    `anchors` stones, for then the pose hangs in the air. patience: scans a crumb may stay unseen. doubt: what was made a
    stone with less goes back on trial where a smaller share of trials than this ends in a stone (0: never, see `doubt`), and
    only where a larger one does are there brothers, and `present`.
    gate: a sighting within it is static. still: a crumb whose sightings drift outside this gate begins its trial anew (0: never
    asked). apart: an observation outside it of every free landmark may found a new one.
    purge, trial: a stone seen in less than `purge` of at least `trial` good opportunities is gone, unless proven: seen
    `proof` times since it came back to where it was given up, or after `trial` sightings expected in vain. chance: where no more
    places of so many visits are to be expected by chance, in the whole map, all sightings there count (else see `risen`).
    in_view: chance of being in the field of view that makes a good opportunity. merge: unite duplicates.
    present: associators hold that a stone exists until three sightings were expected in vain (`ABSENT`). Its share of
    sightings, else taken for that, falls as well where a neighbour is given its sightings, and gives the neighbour the next
    ones too.
    reference: the reference program's rules (compatible with any landmark: left out; no death, no merging).
    signature, signature_gate, stray, confusion: how looks count as evidence, see `appearance.Weight`.
    """

    hits: int = 5
    few: int = 2
    anchors: int = 2
    patience: int = 100
    doubt: float = 0.5
    gate: float = 0.99
    still: float = 0.99
    apart: float = 0.9999
    purge: float = 0.35
    trial: int = 8
    proof: int = 3
    chance: float = 0.1
    in_view: float = 0.9
    merge: bool = True
    present: bool = False
    reference: bool = False
    signature: str = "off"
    signature_gate: float = 0.9999
    stray: float = 0.05
    confusion: float = 0.0

    def __post_init__(self) -> None:
        from_zero("slam", self, "hits few anchors patience trial proof chance")
        from_zero("slam", self, "doubt gate still apart purge in_view", 1.0)

    @property
    def looks_for_drift(self) -> bool:
        """Whether what drifts is told from what stands."""
        return self.still > 0.0 and not self.reference

    @property
    def apart2(self) -> float:
        """Squared distance within which two things may be one."""
        return float(chdtri(2, 1.0 - self.apart))

    @property
    def weight(self) -> Weight:
        """How looks count. Raises TomThumbError for values that cannot be."""
        return Weight(self.signature, self.signature_gate, self.stray, self.confusion)

    def faithful(self) -> LifeCycle:
        """The reference program's policy: landmarks at once, one gate, nothing merged, nothing forgotten."""
        return replace(self, hits=1, gate=0.99, apart=0.99, merge=False, reference=True)


@dataclass(slots=True)
class Life:
    """What has happened to one landmark. `companions` were seen in the same scan, so they are other landmarks.

    `seen` and `born`: scans of the last and the first sighting. silence: sightings expected in vain since the last one.
    returned: static sightings since it first came back from an absence; None before. place: of the last sighting, world
    point (2,) m and covariance (2, 2). apart: neighbours, and how often both were to be expected in one scan. visits: last scans
    of earlier stays there. drift: whether it stands still, while it is a crumb. believed: it was a stone before its trial.
    """

    seen: int
    hits: float = 1.0
    chances: float = 1.0
    static: int = 1
    companions: set[int] = field(default_factory=set)
    looks: Looks = field(default_factory=Looks)
    born: int = 0
    silence: float = 0.0
    returned: int | None = None
    place: tuple[Array, Array] | None = None
    apart: dict[int, float] = field(default_factory=dict)
    visits: tuple[int, ...] = ()
    drift: Drift = field(default_factory=Drift)
    believed: bool = False

    @property
    def exist(self) -> float:
        """Probability that there is such a landmark, from its sightings and its opportunities."""
        return min((self.hits + 0.5) / (self.chances + 1.0), SURE)


Ledger = dict[int, Life]


def copy_ledger(ledger: Ledger) -> Ledger:
    """A copy that shares nothing that changes."""
    return {i: replace(life, companions=set(life.companions)) for i, life in ledger.items()}


def with_existence(predictions: Predictions, ledger: Ledger, present: bool) -> Predictions:
    """The predictions, told how likely each landmark is to exist; with `present` stones do until they are absent."""
    lives = [ledger[i] for i in predictions.ids.tolist()]
    exist = np.array([life.exist for life in lives], float)
    if present and predictions.stone is not None:
        absent = np.array([life.silence >= ABSENT for life in lives], bool)
        exist[predictions.stone & ~absent] = SURE
    return replace(predictions, exist=exist)


def record_hits(ledger: Ledger, ids: Iterable[int], d2: Iterable[float], scan: int, policy: LifeCycle) -> None:
    """Landmarks that were seen, with the squared distance of each sighting."""
    gate2 = chdtri(2, 1.0 - policy.gate)
    for i, distance in zip(ids, d2, strict=True):
        life = ledger[i]
        life.hits += 1.0
        life.chances += 1.0
        life.seen = scan
        life.static += bool(distance < gate2)
        if life.silence >= policy.trial and life.returned is None:
            life.returned = 0
        if life.returned is not None:
            life.returned += bool(distance < gate2)
        life.silence = 0.0


def record_places(ledger: Ledger, ids: Iterable[int], points: Array, covs: Array) -> None:
    """Where landmarks were just seen: world points (k, 2) with covariances (k, 2, 2)."""
    for i, point, cov in zip(ids, points, covs, strict=True):
        ledger[i].place = (point, cov)


def record_misses(ledger: Ledger, missed: Ids, chance: Array) -> None:
    """Landmarks well inside the field of view that were not seen: each opportunity counts as far as it was one."""
    for i, p in zip(missed.tolist(), chance.tolist(), strict=True):
        ledger[i].chances += p
        ledger[i].silence += p


def record_companions(ledger: Ledger, ids: list[int]) -> None:
    """Landmarks of one scan are different landmarks."""
    for i in ids:
        ledger[i].companions.update(ids)


def record_looks(ledger: Ledger, ids: Iterable[int], seen: Observations, rows: Ids, crowd: Crowd | None) -> None:
    """Classes and signatures of the observations `rows` of landmarks `ids`; `crowd` learns how far those vary."""
    if seen.labels is None and seen.signature is None:
        return
    for i, row in zip(ids, rows.tolist(), strict=True):
        life = ledger[i]
        if crowd is not None:
            crowd.record_sighting(life.looks, seen, row)
        life.looks = life.looks.and_seen(seen, row)


def promotions(
    ledger: Ledger, crumbs: Iterable[int], stones_seen: int, first: bool, policy: LifeCycle
) -> tuple[Ids, Ids]:
    """Crumbs with enough static hits, most of their hits static: those that stand still, and those that drift (outside the
    gate `still`). `first`: there is no map yet.
    """
    wanted = policy.hits if stones_seen >= policy.anchors else min(policy.few, policy.hits)
    wanted = 1 if first else wanted
    ready = [i for i in crumbs if ledger[i].static >= wanted and ledger[i].static > 0.5 * ledger[i].hits]
    gate2 = chdtri(2, 1.0 - policy.still) if policy.looks_for_drift else np.inf
    moving = np.array([ledger[i].drift.d2 >= gate2 for i in ready], bool)
    return np.array(ready, np.int64)[~moving], np.array(ready, np.int64)[moving]


def restart(ledger: Ledger, moving: Ids) -> None:
    """Their trial begins anew. Most of all hits must be static then as ever, so each trial is twice as long as the last."""
    for i in moving.tolist():
        ledger[i].static, ledger[i].drift = 1, Drift()


def deaths(ledger: Ledger, stones: Iterable[int], crumbs: Iterable[int], scan: int, policy: LifeCycle) -> Ids:
    """Stones that ought to have been seen, and crumbs that faded."""
    if policy.reference:
        return np.empty(0, np.int64)
    gone = [i for i in stones if _gone(ledger, i, policy)]
    gone += [i for i in crumbs if _faded(ledger[i], scan, policy)]
    return np.array(gone, np.int64)


def _faded(life: Life, scan: int, policy: LifeCycle) -> bool:
    """A crumb seen too seldom, unless it is proven; or not seen for too long, unless it was a stone."""
    late = scan - life.seen > policy.patience and not life.believed
    return late or (life.exist < policy.purge and not _proven(life, policy))


def _proven(life: Life, policy: LifeCycle) -> bool:
    """It came back from an absence, and was confirmed anew: it is only hidden, for what passes by does not come back."""
    return life.returned is not None and life.returned >= policy.proof


def _gone(ledger: Ledger, i: int, policy: LifeCycle) -> bool:
    """A stone seen too seldom. One that is proven stays, unless it is the lesser of two beside each other that are never
    seen together.
    """
    life = ledger[i]
    if life.chances < policy.trial or life.exist >= policy.purge:
        return False
    return not _proven(life, policy) or any(j in ledger and _lesser(ledger, i, j) for j in life.apart)


def _lesser(ledger: Ledger, i: int, j: int) -> bool:
    return j not in ledger[i].companions and (ledger[i].hits, j) < (ledger[j].hits, i)


def bequeath(ledger: Ledger, gone: Ids) -> None:
    """What is proven and ends as the lesser of two that are one thing leaves that proof to the other."""
    for i in gone.tolist():
        for j in ledger[i].apart:
            if j in ledger and _lesser(ledger, i, j) and ledger[i].returned is not None:
                ledger[j].returned = max(ledger[j].returned or 0, ledger[i].returned or 0)


def graves(ledger: Ledger, gone: Ids) -> list[Grave]:
    """What is remembered of landmarks that are given up."""
    lives = [ledger[i] for i in gone.tolist()]
    return [
        Grave(*life.place, life.static, life.returned or 0, (*life.visits, life.seen))
        for life in lives
        if life.place is not None
    ]


def risen(life: Life, there: Sequence[Grave], by_chance: float, policy: LifeCycle) -> Life:
    """A new landmark at graves, oldest first: it has come back. Two single sightings may be clutter both, so the first one of
    each does not count towards confirmation, and `few` new ones are needed; unless so many visits cannot be chance.

    `by_chance`: places of as many visits that are to be expected in the whole map.
    """
    if not there:
        return life
    since = there[0].returned + sum(grave.returned or grave.static for grave in there[1:])
    static = min(sum(grave.static - 1 for grave in there), max(policy.hits - policy.few, 0))
    if by_chance < policy.chance:
        static = max(static, 1 + since)
    visits = tuple(sorted(scan for grave in there for scan in grave.visits))
    return replace(life, static=life.static + static, returned=life.static + since, visits=visits)


def inherit(ledger: Ledger, keep: int, drop: int) -> None:
    """Two landmarks become one: the survivor has the life of both, as if seen whenever either was.

    What was expected in vain of the one while the other was seen is not known any more: `returned` is the greater of both,
    `chances` are the survivor's and the other's sightings, and the end of the earlier stay counts as a visit. Neighbours of the
    one are the other's as well. `drift` is that of the survivor, for what is united stands still.
    """
    lost, life = ledger.pop(drop), ledger[keep]
    life.visits = tuple(sorted({*life.visits, *lost.visits, min(life.seen, lost.seen)}))
    life.silence = _since_seen(life, lost)
    if lost.seen >= life.seen:
        life.seen, life.place = lost.seen, lost.place or life.place
    life.born = min(life.born, lost.born)
    life.hits, life.chances, life.static = life.hits + lost.hits, life.chances + lost.hits, life.static + lost.static
    life.companions |= lost.companions
    life.returned = max((r for r in (life.returned, lost.returned) if r is not None), default=None)
    life.looks = life.looks.and_also(lost.looks)
    beside = (life.apart.keys() | lost.apart.keys()) - {keep, drop}
    life.apart = {j: life.apart.get(j, 0.0) + lost.apart.get(j, 0.0) for j in beside}
    for j in (ledger.keys() & (lost.companions | lost.apart.keys())) - {keep}:
        _renamed_beside(ledger[j], keep, drop)


def _since_seen(life: Life, lost: Life) -> float:
    """Sightings of what both are that were expected in vain since the last one of either."""
    if life.seen == lost.seen:
        return min(life.silence, lost.silence)
    return life.silence if life.seen > lost.seen else lost.silence


def _renamed_beside(neighbour: Life, keep: int, drop: int) -> None:
    """What a neighbour knew of the one that is dropped it knows of the one that is kept."""
    if drop in neighbour.companions:
        neighbour.companions = (neighbour.companions - {drop}) | {keep}
    if drop in neighbour.apart:
        rest = {j: due for j, due in neighbour.apart.items() if j != drop}
        neighbour.apart = {**rest, keep: rest.get(keep, 0.0) + neighbour.apart[drop]}


def may_be_born(d2: Array, taken: Mask, policy: LifeCycle) -> Mask:
    """Observations (m,) that no landmark still free explains: d2 (m, n) after the update, taken (n,) landmarks.

    The rest is ambiguous: too near to a known landmark to be new, not near enough to be it; it is left out.
    """
    gate2 = chdtri(2, 1.0 - policy.apart)
    free = np.ones_like(taken) if policy.reference else ~taken
    new: Mask = ~(d2[:, free] < gate2).any(1) if d2.shape[1] else np.ones(len(d2), bool)
    return new


def named_late(d2: Array, taken: Mask, predictions: Predictions, policy: LifeCycle) -> Ids:
    """Columns (m,) of ambiguous observations that only one free stone explains, and that alone explain it; else -1.

    A gate must not cost pairs by itself: such an observation is given the landmark's name, but never moves the filter.
    """
    late = np.full(len(d2), -1, np.int64)
    if policy.reference or predictions.stone is None or not d2.size:
        return late
    close = (d2 < chdtri(2, 1.0 - policy.apart)) & ~taken[None]
    alone = close & (close.sum(1) == 1)[:, None] & (close.sum(0) == 1)[None] & predictions.stone[None]
    rows, columns = np.nonzero(alone)
    late[rows] = columns
    return late


def duplicates(ledger: Ledger, predictions: Predictions, seen: set[int], policy: LifeCycle) -> list[tuple[int, int]]:
    """Pairs (keep, drop) of stones that are jointly compatible with being one, never seen together, one seen now.

    Compatible: the difference of the two predictions passes the gate of its own covariance (cross terms included).
    It must mean something too: the gate's area may hold at most a twentieth of a landmark at the scan's own density.
    """
    if not policy.merge or predictions.stone is None or len(predictions) < 2:
        return []
    gate2 = chdtri(2, 1.0 - policy.gate)
    found, used = [], set[int]()
    for a, b in _near_pairs(predictions, seen):
        i, j = int(predictions.ids[a]), int(predictions.ids[b])
        if i not in ledger or j not in ledger:  # buried in this very step
            continue
        if j in ledger[i].companions or i in used or j in used:
            continue
        difference = predictions.z_hat[a] - predictions.z_hat[b]
        S = _relative(predictions.cov, a, b)
        det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
        if det <= 0.0 or difference @ np.linalg.solve(S, difference) >= gate2:
            continue
        if np.pi * gate2 * np.sqrt(det) * _density(predictions) < 0.05:
            found.append((min(i, j), max(i, j)))
            used.update((i, j))
    return found


def _near_pairs(predictions: Predictions, seen: set[int]) -> list[tuple[int, int]]:
    """Pairs of stones, one of them seen in this scan and the other not, nearest first in z, within 5 sigma by each component."""
    stones = np.flatnonzero(predictions.stone) if predictions.stone is not None else np.empty(0, np.int64)
    mask = np.array([int(i) in seen for i in predictions.ids[stones]], bool)
    hit, missed = stones[mask], stones[~mask]
    if not len(hit) or not len(missed):
        return []
    gap = np.abs(predictions.z_hat[hit][:, None] - predictions.z_hat[missed][None])
    var = np.diag(predictions.cov).reshape(-1, 2)
    limit = 5.0 * (np.sqrt(np.maximum(var[hit], 0.0))[:, None] + np.sqrt(np.maximum(var[missed], 0.0))[None]) + 1e-9
    close = np.argwhere((gap < limit).all(2))
    order = np.argsort(gap[close[:, 0], close[:, 1]].sum(1), kind="stable")
    return [(int(hit[a]), int(missed[b])) for a, b in close[order]]


def _relative(cov: Array, a: int, b: int) -> Array:
    """Covariance of prediction a minus prediction b."""
    i, j = slice(2 * a, 2 * a + 2), slice(2 * b, 2 * b + 2)
    S: Array = cov[i, i] + cov[j, j] - cov[i, j] - cov[j, i]
    return S


def _density(predictions: Predictions) -> float:
    """Landmarks per unit of z around here: their number over the box they fill."""
    span = np.ptp(predictions.z_hat, axis=0)
    return len(predictions) / max(float(span[0] * span[1]), 1e-9)
