"""What the children learn: spike-timing dependent plasticity (paper, equation 3), as pair rule and as log-probability.

`PairMemory` is the textbook rule with exponential traces and soft bounds, over a fixed number of neurons. `LogMemory`
is the form that serves data association: its weights converge to the logarithm of how often j was seen lately when i
is, so they can stand beside other log-likelihoods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.kernels.forest import depress, pair_spikes, potentiate
from tomthumb.types import Array, Ids, Lessons

__all__ = ["LogMemory", "PairMemory", "Plasticity", "depress", "fixed_point", "log_rule", "potentiate"]


@dataclass(frozen=True)
class Plasticity:
    """Constants of the pair rule: on post i, w_ij += A+ (1 - w_ij)^mu x_j; on pre j, w_ij -= A- w_ij^mu y_i.

    Attributes:
        tau_plus, tau_minus: time constants of the traces x and y, steps.
        a_plus, a_minus: A+ and A-.
        mu: softness of the bounds 0 and 1.
    """

    tau_plus: float = 3.0
    tau_minus: float = 3.0
    a_plus: float = 0.1
    a_minus: float = 0.105
    mu: float = 1.0

    def __post_init__(self) -> None:
        if not (self.tau_plus > 0.0 and self.tau_minus > 0.0):
            raise TomThumbError("the traces of STDP decay with time constants > 0 steps")
        if not (0.0 <= self.a_plus <= 1.0 and 0.0 <= self.a_minus <= 1.0 and self.mu >= 0.0):
            raise TomThumbError("STDP needs A+ and A- in [0, 1] and mu >= 0")


def fixed_point(plasticity: Plasticity, share: float) -> float:
    """Where a weight settles at mu = 1 when a `share` of its changes are potentiations: A+ q / (A+ q + A- (1 - q))."""
    up, down = plasticity.a_plus * share, plasticity.a_minus * (1.0 - share)
    return up / (up + down)


class PairMemory:
    """Weights `w (n, n)` in [0, 1], w[i, j] from j (seen before) to i (seen after), of n features or places."""

    def __init__(self, n: int, plasticity: Plasticity | None = None) -> None:
        self.plasticity = plasticity or Plasticity()
        self.w = np.zeros((n, n))
        self.x, self.y = np.zeros(n), np.zeros(n)
        self._t = 0.0

    def spike(self, neurons: Sequence[int] | Ids, t: float) -> None:
        """The `neurons` are seen at time `t` (steps, not falling); equation 3 with the traces at that time.

        Raises:
            TomThumbError: time runs backwards, or there is no such neuron.
        """
        if t < self._t:
            raise TomThumbError(f"STDP cannot see at {t} what comes before {self._t}")
        seen = np.asarray(neurons, dtype=np.int64)
        if seen.size and not (seen.min() >= 0 and seen.max() < len(self.w)):
            raise TomThumbError(f"neurons are 0 to {len(self.w) - 1}, not {seen.tolist()}")
        p, dt = self.plasticity, t - self._t
        self.x *= math.exp(-dt / p.tau_plus)
        self.y *= math.exp(-dt / p.tau_minus)
        self._t = t
        pair_spikes(self.w, self.x, self.y, seen, p.a_plus, p.a_minus, p.mu)

    def rest(self) -> None:
        """A pause long enough for the traces `x` (as pre) and `y` (as post) to die away; the weights stay."""
        self.x[:] = self.y[:] = 0.0

    def decay(self, factor: float) -> None:
        """Crumbs: every weight fades by `factor` in [0, 1]; with stones nobody calls this."""
        self.w *= factor


def log_rule(w: float, hit: bool, eta: float, c: float = 1.0) -> float:
    """One step of the log-probability rule: dw = eta (c exp(-w) - 1) on a hit, -eta otherwise.

    It converges to log(c P(hit)); `LogMemory` steps v = exp(w) exactly instead.

    References:
        Nessler, Pfeiffer, Buesing, Maass, PLoS Computational Biology 9 (2013) e1003037.
    """
    return w + eta * (c * math.exp(-w) * hit - 1.0)


class LogMemory:
    """Learned log prior over identities: who is seen, given who was just confirmed.

    For each landmark i, v_ij estimates P(j seen within the last `window` s | i is seen): on a confirmed sighting of i,
    v_i <- v_i + eta (hit - v_i) from v = 1/2. With `rate` None eta = 1/(n + 1), and v is exactly (hits + 1/2)/(n + 1);
    a rate keeps eta from falling below it, and so forgets old laps. "Lately" means in earlier steps, which is all that
    is known when the candidates of a step are weighed; a landmark may well be its own company.

    Bounded: of more than `size` landmarks those are forgotten that were seen least among the half unseen for longest
    (crumbs fade, stones stay). That is one number for each pair of those remembered, 8 MB at 1000.
    """

    def __init__(self, window: float = 3.0, rate: float | None = None, clip: float = 2.0, size: int = 1000) -> None:
        if not (window > 0.0 and clip >= 0.0 and (rate is None or 0.0 < rate < 1.0)):
            raise TomThumbError("the memory needs a window > 0 s, a clip >= 0 nats and a rate in (0, 1) or None")
        if size < 1:
            raise TomThumbError(f"the memory must have room for a landmark at least, size={size}")
        self.window, self.rate, self.clip, self.size = window, rate, clip, size
        self._slot: dict[int, int] = {}
        self._last: Array = np.full(0, -np.inf)
        self._sightings: Ids = np.zeros(0, np.int64)
        self._v: Array = np.zeros((0, 0))
        self._base: Array = np.zeros(0)
        self._total = 0

    def __len__(self) -> int:
        return len(self._slot)

    def learn(self, ids: Ids | Sequence[int], t: float) -> None:
        """Confirmed identities of one step at time `t` s (negative ones are nobody, and skipped)."""
        seen = list(dict.fromkeys(int(i) for i in ids if i >= 0))[: self.size]
        self._make_room(seen)
        slots = [self._slot_of(i) for i in seen]
        n = len(self._slot)
        hit = (t - self._last[:n] <= self.window).astype(float)
        for i in slots:
            self._v[i, :n] += self._eta(int(self._sightings[i])) * (hit - self._v[i, :n])
            self._base[:n] += (hit - self._base[:n]) / (self._total + 2)
            self._sightings[i] += 1
            self._total += 1
        self._last[slots] = t

    def known(self) -> Ids:
        """The landmarks that are remembered (k,)."""
        return np.array(list(self._slot), np.int64)

    def probability(self, j: int, i: int) -> float:
        """v_ij = P(j lately | i), 1/2 where nothing is known."""
        if i not in self._slot or j not in self._slot:
            return 0.5
        return float(self._v[self._slot[i], self._slot[j]])

    def recent(self, t: float) -> Ids:
        """Landmarks confirmed within the window before `t` s."""
        return np.array([i for i, k in self._slot.items() if t - self._last[k] <= self.window], dtype=np.int64)

    def prior(self, candidates: Ids | Sequence[int], t: float) -> Array:
        """Log prior (k,) in nats of each candidate at time `t`, within +-clip so that geometry can always win.

        Mean over the landmarks j confirmed lately of log P(j lately | i) - log P(j lately): the mean and not the sum,
        because neighbours on the trail are anything but independent. 0 for whoever was never learned.
        """
        lately = np.flatnonzero(t - self._last[: len(self._slot)] <= self.window)
        gains = np.zeros(len(candidates))
        known = [(k, self._slot[int(i)]) for k, i in enumerate(candidates) if int(i) in self._slot]
        if not known or not lately.size:
            return gains
        rows = np.array([slot for _, slot in known])
        ratio = np.log(self._v[np.ix_(rows, lately)]) - np.log(self._base[lately])
        gains[[k for k, _ in known]] = np.clip(ratio.mean(axis=1), -self.clip, self.clip)
        return gains

    def forget(self, ids: Ids | Sequence[int]) -> None:
        """What was learned about landmarks that are no more: they become strangers, and nobody's recent company."""
        for i in ids:
            if int(i) in self._slot:
                slot = self._slot.pop(int(i))
                self._drop(slot)

    def recall(self, ids: Ids | Sequence[int]) -> Lessons:
        """What was learned about those of the landmarks `ids` that are remembered."""
        known = [int(i) for i in ids if int(i) in self._slot]
        k = np.array([self._slot[i] for i in known], np.int64)
        together = self._v[np.ix_(k, k)]
        return Lessons(np.array(known, np.int64), self._sightings[k], together, self._base[k], self._total)

    def remind(self, lessons: Lessons) -> None:
        """Begin with these lessons; nobody was seen lately. Of too many those seen most stay."""
        best = np.sort(np.argsort(-lessons.sightings, kind="stable")[: self.size])
        self._slot = {int(i): k for k, i in enumerate(lessons.ids[best])}
        self._last = np.full(len(best), -np.inf)
        self._sightings, self._base = lessons.sightings[best].copy(), lessons.lately[best].copy()
        self._v, self._total = lessons.together[np.ix_(best, best)].copy(), lessons.total

    def fork(self) -> LogMemory:
        """An independent copy, for another brother."""
        twin = LogMemory(self.window, self.rate, self.clip, self.size)
        twin._slot, twin._total = dict(self._slot), self._total
        twin._last, twin._sightings, twin._base = self._last.copy(), self._sightings.copy(), self._base.copy()
        twin._v = self._v.copy()
        return twin

    def _make_room(self, seen: Sequence[int]) -> None:
        """Forget as many as needed for the new ones among `seen`, none of which is forgotten."""
        wanted = len(self._slot) + sum(i not in self._slot for i in seen) - self.size
        if wanted <= 0:
            return
        others = [i for i in self._slot if i not in set(seen)]
        others.sort(key=lambda i: float(self._last[self._slot[i]]))
        old = others[: max(wanted, (len(others) + 1) // 2)]
        old.sort(key=lambda i: int(self._sightings[self._slot[i]]))  # stable: of equals the longest unseen
        self.forget(old[:wanted])

    def _eta(self, seen: int) -> float:
        return max(1.0 / (seen + 2), self.rate or 0.0)

    def _unseen(self, seen: Ids) -> Array:
        """v of pairs that were never a hit in `seen` sightings, from 1/2: the product of all 1 - eta."""
        if self.rate is None:
            early: Array = np.asarray(0.5 / (seen + 1.0), dtype=np.float64)
            return early
        counted = np.minimum(seen, max(0, math.floor(1.0 / self.rate) - 1))
        v: Array = 0.5 / (counted + 1.0) * (1.0 - self.rate) ** (seen - counted)
        return v

    def _slot_of(self, i: int) -> int:
        slot = self._slot.get(i)
        if slot is None:
            slot = self._slot[i] = len(self._slot)
            if slot >= len(self._last):
                self._grow(min(max(64, 2 * len(self._last)), self.size))
            self._last[slot], self._sightings[slot] = -np.inf, 0
            self._v[: slot + 1, slot] = self._unseen(self._sightings[: slot + 1])
            self._v[slot, : slot + 1] = 0.5
            self._base[slot] = 0.5 / (self._total + 1)
        return slot

    def _grow(self, size: int) -> None:
        n = len(self._last)
        grown = np.full((size, size), 0.5)
        grown[:n, :n] = self._v
        self._v = grown
        self._last = np.concatenate((self._last, np.full(size - n, -np.inf)))
        self._sightings = np.concatenate((self._sightings, np.zeros(size - n, np.int64)))
        self._base = np.concatenate((self._base, np.full(size - n, 0.5)))

    def _drop(self, slot: int) -> None:
        """Close the gap at `slot` with the last one, so that the rows in use stay one block."""
        last = len(self._slot)
        if slot != last:
            moved = next(i for i, k in self._slot.items() if k == last)
            self._slot[moved] = slot
            self._last[slot], self._sightings[slot] = self._last[last], self._sightings[last]
            self._base[slot] = self._base[last]
            self._v[slot, : last + 1] = self._v[last, : last + 1]
            self._v[: last + 1, slot] = self._v[: last + 1, last]
