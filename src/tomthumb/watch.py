"""The watch: is the pose still right? What ought to be seen and is not, together with what is seen and ought not to be.

Either alone has other reasons: new country shows what is unknown, a blind sensor misses what is known. A wrong pose does
both at once, so missing landmarks count only as far as there are unexplained observations beside them. What was mapped
since the first doubt proves nothing: a wrong pose confirms its own new landmarks.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtr

from tomthumb.types import Array, Mask

BY_CHANCE = 0.3  # how often, when lost, an expected landmark finds a partner, relative to when not
SURE = 0.95  # no landmark is seen more surely than that
LEAK = 0.95  # per scan: doubts that nothing feeds are forgotten
SCANS, TAIL = 10, 1e-3  # of the windowed test of NIS
DOUBT = 6.0  # nats: worth a look whether this is a place that is known
PATIENCE = 40  # scans after which a doubt that came to nothing is dropped
ALARM = 12.0  # nats: one false alarm in 10^5 independent looks


@dataclass(slots=True)
class Watch:
    """One-sided CUSUM of log P(scan | lost) - log P(scan | here) over the confirmed landmarks that are due.

    `since` is the scan of the last look without doubt, `peak` the greatest one after it;
    landmarks born later are not asked. References: E. Page, Biometrika 41, 1954.
    """

    level: float = 0.0
    since: int = 0
    peak: float = 0.0

    def look(self, chance: Array, seen: Mask, unexplained: int, scan: int) -> None:
        """`chance` (n,) of seeing each confirmed landmark well in view, `seen` (n,); observations that none explains."""
        here = np.minimum(chance, SURE)
        missed = ~seen
        against = float(np.log((1.0 - BY_CHANCE * here[missed]) / (1.0 - here[missed])).sum())
        share = min(1.0, unexplained / max(int(missed.sum()), 1))
        self.level = LEAK * self.level + share * against + float(seen.sum()) * math.log(BY_CHANCE)
        if self.level <= 0.0 or (self.level < DOUBT and scan - self.since > PATIENCE):
            self.level, self.peak, self.since = 0.0, 0.0, scan
        self.peak = max(self.peak, self.level)

    @property
    def doubtful(self) -> bool:
        """Something was wrong, and no old landmark has been met since that would settle it."""
        return self.peak > DOUBT

    @property
    def lost(self) -> bool:
        """The family should flee."""
        return self.level > ALARM


@dataclass(slots=True)
class Consistency:
    """NIS of the last scans against its chi-square distribution, two-sided at 99.9 %.

    Too much says that a pairing or the model is wrong, too little that the noise is said too large.
    """

    last: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=SCANS))
    verdict: str = (
        "fine"  # fine, surprised (NIS too large) or timid (too small): asked for at every step, so it is kept
    )

    def record(self, nis: float, dof: int) -> None:
        """One scan's NIS; a scan without pairings says nothing."""
        if dof:
            self.last.append((nis, dof))
            self.verdict = self._judged()

    @property
    def excess(self) -> float:
        """By how many standard deviations the NIS is above its mean."""
        total, dof = sum(nis for nis, _ in self.last), sum(d for _, d in self.last)
        return (total - dof) / math.sqrt(2.0 * dof) if dof else 0.0

    def _judged(self) -> str:
        total, dof = sum(nis for nis, _ in self.last), sum(d for _, d in self.last)
        p = float(chdtr(dof, total))
        return "surprised" if p > 1.0 - 0.5 * TAIL else "timid" if p < 0.5 * TAIL else "fine"
