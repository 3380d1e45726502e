"""Flights of the family: equation 1, as whole displacements drawn in batches from one generator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from tomthumb.forest.exact import EIGHT, FOUR
from tomthumb.forest.rules import Rules
from tomthumb.tale.levy import LengthLaw, law_of, mantegna_steps, power_law, scaled_law
from tomthumb.types import Array, Ids

BATCH = 1024
Lengths = Callable[[np.random.Generator, int], Ids]


def longest(rules: Rules, shape: tuple[int, int]) -> int:
    """The longest flight: as the rules say, or half the shorter side."""
    return rules.l_max if rules.l_max is not None else max(1, min(shape) // 2)


def alpha_of(rules: Rules, shape: tuple[int, int]) -> float:
    """The boots' step size: as the rules say, or seven, or what still leaves every flight within the longest."""
    if rules.boots is not None:
        return rules.boots
    return float(max(1, min(7, longest(rules, shape) - 1)))


def pareto_law(lam: float, l_max: int, alpha: float = 1.0) -> LengthLaw:
    """The law of round(alpha X) for X >= 1 with density ~ x^-lam, cut at l_max and normalised."""
    edges = np.maximum(1.0, (np.arange(l_max + 1) + 0.5) / alpha)
    return law_of(-np.diff(edges ** (1.0 - lam)))


def _mantegna(lam: float, l_max: int, alpha: float) -> Lengths:
    def draw(rng: np.random.Generator, size: int) -> Ids:
        kept: list[Ids] = []
        while sum(map(len, kept)) < size:
            lengths = np.floor(np.abs(alpha * mantegna_steps(rng, lam - 1.0, 2 * size)) + 0.5)
            kept.append(lengths[(lengths >= 1) & (lengths <= l_max)].astype(np.int64))
        return np.concatenate(kept)[:size]

    return draw


def lengths_of(rules: Rules, shape: tuple[int, int], alpha: float) -> Lengths:
    """The sampler of whole lengths 1..l_max at step size alpha.

    Raises:
        TomThumbError: alpha leaves no two neighbouring lengths.
    """
    l_max = longest(rules, shape)
    if rules.lengths == "mantegna":
        return _mantegna(rules.lam, l_max, alpha)
    return _table(rules.lengths, rules.lam, l_max, alpha).draw


@lru_cache(maxsize=64)
def _table(lengths: str, lam: float, l_max: int, alpha: float) -> LengthLaw:
    """Laws never change, and short tales would spend their time on building them."""
    if lengths == "pareto":
        return pareto_law(lam, l_max, alpha)
    return scaled_law(power_law(lam, l_max), alpha)


def displacements(rng: np.random.Generator, lengths: Lengths, directions: str, size: int) -> Ids:
    """`size` flights as whole displacements (size, 2), rows and columns."""
    if directions == "entrywise":
        signs = rng.integers(0, 2, (size, 2)) * 2 - 1
        return np.stack((lengths(rng, size), lengths(rng, size)), axis=1) * signs
    if directions == "angle":
        angle = rng.random(size) * 2.0 * math.pi
        unit: Array = np.stack((np.sin(angle), np.cos(angle)), axis=1)
        return np.floor(lengths(rng, size)[:, None] * unit + 0.5).astype(np.int64)
    units = EIGHT if directions == "eight" else FOUR
    headings = (rng.random(size) * len(units)).astype(np.int64)
    moves: Ids = lengths(rng, size)[:, None] * units[headings]
    return moves


@dataclass
class Flights:
    """A stream of flights and of the uniform numbers that go with them; batches do not show in what is drawn."""

    rng: np.random.Generator
    lengths: Lengths
    directions: str
    batch: int = BATCH
    _moves: Ids = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    _luck: Array = field(default_factory=lambda: np.zeros((0, 2)))
    _used: int = 0

    def look(self, most: int) -> tuple[Ids, Array]:
        """The next flights (k, 2) and uniform numbers (k, 2), 1 <= k <= most, without using them up."""
        if self._used >= len(self._moves):
            self._moves = displacements(self.rng, self.lengths, self.directions, self.batch)
            self._luck = self.rng.random((self.batch, 2))
            self._used = 0
        stop = self._used + most
        return self._moves[self._used : stop], self._luck[self._used : stop]

    def use(self, k: int) -> None:
        """The first `k` of those looked at are spent."""
        self._used += k
