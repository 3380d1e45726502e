"""What each part of the tale is worth: the same forests and seeds with the part and without it, with intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tomthumb.forest.figure4 import simulated_tom_thumb
from tomthumb.forest.flights import alpha_of, longest
from tomthumb.forest.rules import Rules
from tomthumb.forest.tell import Outcome, outcome_of
from tomthumb.forest.walkers import search
from tomthumb.forest.world import Forest, plant
from tomthumb.kernels.forest import HOME, OGRE
from tomthumb.tale.levy import LengthLaw, power_law, scaled_law
from tomthumb.types import Array

Measure = Callable[[int], float]


@dataclass(frozen=True)
class Contrast:
    """A part's worth over forests: means with the part and without, and their paired difference.

    Attributes:
        name: of the part and of what is measured.
        with_part, without: mean over the forests.
        difference: mean of with minus without; low, high: its 95 % bootstrap interval over forests.
        forests: how many.
    """

    name: str
    with_part: float
    without: float
    difference: float
    low: float
    high: float
    forests: int


def contrast(name: str, with_part: Measure, without: Measure, forests: int, seed: int = 0) -> Contrast:
    """Measure both on forests `seed`, `seed + 1`, ... and bootstrap the paired difference."""
    pairs = np.array([(with_part(k), without(k)) for k in range(seed, seed + forests)])
    low, high = interval(pairs[:, 0] - pairs[:, 1], np.random.default_rng(seed))
    mean = pairs.mean(axis=0)
    return Contrast(name, float(mean[0]), float(mean[1]), float(mean[0] - mean[1]), low, high, forests)


def interval(values: Array, rng: np.random.Generator, draws: int = 2000) -> tuple[float, float]:
    """95 % bootstrap interval of the mean of `values (n,)`."""
    means = values[rng.integers(0, len(values), (draws, len(values)))].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def _tale(forest: Forest, seed: int, rules: Rules) -> Outcome:
    return outcome_of(simulated_tom_thumb(forest, np.random.default_rng([seed, 1]), rules))


def moves_home(seed: int, rules: Rules, size: int = 48, laps: int = 1) -> float:
    """Moves from where the parents flee until HOME is seen, in the pass after `laps` others; no ogre, no king.

    What the first passes cost is not counted.
    """
    forest = plant(np.random.default_rng([seed, 0]), size, ogres=0, palaces=0)
    told = simulated_tom_thumb(forest, np.random.default_rng([seed, 1]), replace(rules, max_iterations=laps + 1))
    return float(sum(e.moves for e in told if e.iteration == laps + 1 and e.step in (15, 17)))


def moves_to_award(seed: int, rules: Rules, size: int = 48) -> float:
    """Moves of a whole tale, until the king's award."""
    return float(_tale(plant(np.random.default_rng([seed, 0]), size), seed, rules).moves)


def ogre_to_palace(seed: int, law: LengthLaw, size: int = 48, mountains: float = 0.0) -> tuple[float, float]:
    """Flights and distance from beside the ogre's house until the palace is seen: means of 20 tries."""
    forest = plant(np.random.default_rng([seed, 0]), size, mountains)
    cells = forest.cells.copy()
    palace = (int(forest.palaces[0, 0]), int(forest.palaces[0, 1]))
    cells[cells == HOME] = cells[cells == OGRE] = 0
    cells[palace] = HOME  # the plain walkers look for what is marked so
    starts = np.repeat(forest.ogres, 20, axis=0)
    flights, distance = search(
        Forest(cells, forest.features, palace, forest.awards), law, np.random.default_rng([seed, 1]), starts
    )
    return float(flights.mean()), float(distance.mean())


def coming_home(forests: int) -> list[Contrast]:
    """Taught against untaught, stones against crumbs, trail against none, for coming home."""
    eaten, learner = Rules(birds=1.0), Rules(birds=1.0, plasticity=None)
    always = Rules(stones="always", plasticity=None)
    crumbs = Rules(plasticity=None)
    pairs = {
        "taught against untaught, crumbs eaten": (eaten, learner),
        "taught against untaught, crumbs left": (Rules(), crumbs),
        "stones against crumbs": (always, crumbs),
        "crumbs against no trail": (crumbs, learner),
        "trusting what was learned: .9 against .5": (replace(eaten, trust=0.9), eaten),
        "remembering: no forgetting against 1000 steps": (replace(eaten, forgetting=1e9), eaten),
    }
    return [
        contrast(f"moves home, {name}", partial(moves_home, rules=a), partial(moves_home, rules=b), forests)
        for name, (a, b) in pairs.items()
    ]


def boots_contrasts(forests: int, size: int = 48) -> list[Contrast]:
    """Boots on against off, from the ogre to the palace: flights, and distance."""
    rules = Rules()
    walk = power_law(rules.lam, longest(rules, (size, size)))
    boots = scaled_law(walk, alpha_of(rules, (size, size)))

    def measure(law: LengthLaw, which: int) -> Measure:
        return lambda seed: ogre_to_palace(seed, law, size)[which]

    return [
        contrast(f"ogre to palace, boots against none, {what}", measure(boots, i), measure(walk, i), forests)
        for i, what in enumerate(("flights", "distance"))
    ]


def whole_tale(forests: int) -> list[Contrast]:
    """Moves until the award with each part taken out, one at a time."""
    whole = Rules()
    parts = {
        "boots": replace(whole, boots=1.0),
        "learning": replace(whole, plasticity=None),
        "crumbs": replace(whole, birds=1.0),
        "stones in the first pass": replace(whole, stones="never"),
        "Lévy flights (against unit steps)": replace(whole, l_max=1, boots=1.0),
    }
    return [
        contrast(
            f"moves to the award, {name}",
            partial(moves_to_award, rules=whole),
            partial(moves_to_award, rules=without),
            forests,
        )
        for name, without in parts.items()
    ]


__all__ = ["Contrast", "boots_contrasts", "coming_home", "contrast", "whole_tale"]
