"""What landmarks look like, class and signature (a diameter, a colour), as evidence of who is who.

Each landmark keeps its votes of classes and the running mean and spread of its signature (`Looks`); the run keeps those
of everything it sees (`Crowd`). A pairing's evidence is one formula for both, a ratio of likelihoods:

    log [ (1 - c) p(looks | this landmark) / p(looks | anything) + c ]

c is the share of sightings whose looks say nothing (a confused class, a trunk half hidden), so that evidence against a
pairing never exceeds -log c and geometry can win. Signatures are Gaussian, and evidence for a pairing is held to -log c
too, since the tails of what is common are not to be trusted; the spread of a landmark's own is drawn
towards that of all landmarks, which is worth `PRIOR` sightings.

References: the ratio is the feature-aided tracking score of S. Blackman, R. Popoli, Design and Analysis of Modern
Tracking Systems, 1999, ch. 6.2 and 9.5; running moments after B. Welford 1962, T. Chan, G. Golub, R. LeVeque 1979.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtri

from tomthumb.errors import TomThumbError
from tomthumb.types import NONE, Array, Ids, Mask, Observations, Predictions

PRIOR = 5.0  # sightings that the spread common to all landmarks is worth, beside a landmark's own
ENOUGH = 20.0  # signatures seen before they are evidence of anything
WAYS = ("off", "gate", "ratio")


@dataclass(frozen=True, slots=True)
class Moments:
    """Running mean of `count` values and the sum of their squared deviations from it, `square`."""

    count: float = 0.0
    mean: float = 0.0
    square: float = 0.0

    def and_one(self, value: float) -> Moments:
        """With one value more; one that is not finite changes nothing."""
        return self.and_all(Moments(1.0, value)) if np.isfinite(value) else self

    def and_all(self, other: Moments) -> Moments:
        """Of both samples together."""
        if not other.count:
            return self
        n, gap = self.count + other.count, other.mean - self.mean
        square = self.square + other.square + gap * gap * self.count * other.count / n
        return Moments(n, self.mean + gap * other.count / n, square)

    @property
    def variance(self) -> float:
        """About the mean, unbiased; 0 of fewer than two."""
        return self.square / (self.count - 1.0) if self.count > 1.0 else 0.0


@dataclass(frozen=True, slots=True)
class Looks:
    """What one landmark was seen to look like: `votes` by class, and its signature."""

    votes: Mapping[int, int] = field(default_factory=dict)
    signature: Moments = Moments()

    @property
    def label(self) -> int:
        """The class with most votes, the first voted for among equals; -1 without any."""
        return max(self.votes, key=lambda label: self.votes[label], default=NONE)

    def and_seen(self, seen: Observations, row: int) -> Looks:
        """With the looks of one observation more."""
        return self.and_also(_look(seen, row))

    def and_also(self, other: Looks) -> Looks:
        """With what another turned out to have seen of the same landmark."""
        votes = {k: self.votes.get(k, 0) + other.votes.get(k, 0) for k in (*self.votes, *other.votes)}
        return Looks(votes, self.signature.and_all(other.signature))


def _look(seen: Observations, row: int) -> Looks:
    label = NONE if seen.labels is None else int(seen.labels[row])
    value = np.nan if seen.signature is None else float(seen.signature[row])
    return Looks({label: 1} if label >= 0 else {}, Moments().and_one(value))


@dataclass(slots=True)
class Crowd:
    """The looks of everything seen in a run; `within` and `freedom`: squared deviations of signatures from their own
    landmark's mean, summed, and how many.
    """

    all: Moments = Moments()
    within: float = 0.0
    freedom: float = 0.0
    classes: dict[int, int] = field(default_factory=dict)

    def record(self, seen: Observations) -> None:
        """One scan, whoever was seen."""
        if seen.signature is not None:
            values = seen.signature[np.isfinite(seen.signature)]
            if len(values):
                self.all = self.all.and_all(
                    Moments(float(len(values)), float(values.mean()), float(values.var() * len(values)))
                )
        if seen.labels is not None:
            for label, count in zip(*np.unique(seen.labels[seen.labels >= 0], return_counts=True), strict=True):
                self.classes[int(label)] = self.classes.get(int(label), 0) + int(count)

    def record_sighting(self, known: Looks, seen: Observations, row: int) -> None:
        """An observation of a landmark that was seen before, with what is `known` of it before this one."""
        before = known.signature
        after = before.and_all(_look(seen, row).signature)
        if before.count and after.count > before.count:
            self.within += after.square - before.square
            self.freedom += 1.0

    def spread(self, own: Moments) -> float:
        """Variance of a landmark's next signature about its mean: its own, drawn towards that of all landmarks."""
        common = (PRIOR * self.all.variance + self.within) / (PRIOR + self.freedom)
        freedom = max(own.count - 1.0, 0.0)
        v = (PRIOR * common + own.square) / (PRIOR + freedom)
        return v * (1.0 + 1.0 / own.count)

    def share(self, labels: Ids) -> Array:
        """How common each class (m,) is, one more of each counted than seen; 1 for an unknown one."""
        counts = np.array([self.classes.get(int(k), 0) for k in labels], float)
        return np.where(labels < 0, 1.0, (counts + 1.0) / (sum(self.classes.values()) + len(self.classes) + 1.0))


@dataclass(frozen=True, slots=True)
class Weight:
    """How looks count. `signature`: "off", "gate" (pairings outside `gate` are excluded for everybody) or "ratio" (for
    associators that weigh evidence; the others take the gate). `stray`: share of signatures that say nothing.
    `confusion`: share of classes that are wrong; 0 excludes pairings of different classes.
    """

    signature: str = "off"
    gate: float = 0.9999
    stray: float = 0.05
    confusion: float = 0.0

    def __post_init__(self) -> None:
        if self.signature not in WAYS:
            raise TomThumbError(f"slam.signature={self.signature!r} is not known; valid: {', '.join(WAYS)}")
        if not (0.0 < self.gate < 1.0 and 0.0 < self.stray < 1.0 and 0.0 <= self.confusion < 1.0):
            raise TomThumbError("slam.signature_gate and slam.stray lie within (0, 1), slam.confusion within [0, 1)")


def with_looks(predictions: Predictions, every: Iterable[Looks], crowd: Crowd) -> Predictions:
    """The predictions told each landmark's class and the mean and spread of its next signature (NaN where none)."""
    if not crowd.classes and not crowd.all.count:
        return predictions  # a world without looks does not pay for them
    known = list(every)
    labels = np.array([looks.label for looks in known], np.int64)
    named = replace(predictions, labels=labels) if (labels >= 0).any() else predictions
    if not any(looks.signature.count for looks in known):
        return named
    own = [looks.signature for looks in known]
    mean = np.array([s.mean if s.count else np.nan for s in own])
    return replace(named, signature=mean, signature_var=np.array([crowd.spread(s) if s.count else np.nan for s in own]))


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the looks of a scan say: `ratio (m, n)` log likelihood ratios or None, `barred (m, n)` or None. `soft`:
    classes are in the ratio, and exclude nothing by themselves. `gated`: signatures are not in it, so that what is barred is so
    for those who weigh as well.
    """

    ratio: Array | None = None
    barred: Mask | None = None
    soft: bool = False
    gated: bool = False


def weigh(seen: Observations, predictions: Predictions, crowd: Crowd, weight: Weight) -> Evidence:
    """The evidence of one scan's looks against one set of predictions."""
    ratio, barred = None, None
    if weight.signature != "off" and crowd.all.count >= ENOUGH:
        found = _by_signature(seen, predictions, crowd, weight)
        if found is not None:
            ratio, barred = (found[0] if weight.signature == "ratio" else None), found[1]
    if not weight.confusion or seen.labels is None or predictions.labels is None:
        return Evidence(ratio, barred)
    by_class = class_ratio(seen.labels, predictions.labels, crowd, weight.confusion)
    return Evidence(by_class if ratio is None else ratio + by_class, barred, soft=True, gated=ratio is None)


def _by_signature(
    seen: Observations, predictions: Predictions, crowd: Crowd, weight: Weight
) -> tuple[Array, Mask] | None:
    if seen.signature is None or predictions.signature is None or predictions.signature_var is None:
        return None
    s, var, total = seen.signature[:, None], predictions.signature_var[None], crowd.all.variance
    if not total > 0.0:
        return None
    d2 = (s - predictions.signature[None]) ** 2 / np.maximum(var, 1e-12)
    away = (s - crowd.all.mean) ** 2 / total
    same = 0.5 * (away - d2) - 0.5 * np.log(np.maximum(var, 1e-12) / total)
    known, most = np.isfinite(same), -np.log(weight.stray)
    ratio = np.logaddexp(np.log1p(-weight.stray) + np.where(known, np.minimum(same, most), 0.0), -most)
    return np.where(known, ratio, 0.0), d2 > chdtri(1, 1.0 - weight.gate)  # NaN, nothing known, is within the gate


def class_ratio(mine: Ids, theirs: Ids, crowd: Crowd, confusion: float) -> Array:
    """log [(1 - c) [same] / share + c] (m, n); 0 where either class is unknown."""
    same = mine[:, None] == theirs[None]
    known = (mine[:, None] >= 0) & (theirs[None] >= 0)
    ratio: Array = np.log((1.0 - confusion) * same / crowd.share(mine)[:, None] + confusion)
    return np.where(known, ratio, 0.0)
