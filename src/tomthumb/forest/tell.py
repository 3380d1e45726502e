"""A whole tale in numbers: what one run of figure 4 came to, leg by leg."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from tomthumb.forest.figure4 import Event, simulated_tom_thumb
from tomthumb.forest.rules import Rules
from tomthumb.forest.world import Forest

LEGS = {10: "outward", 13: "led home", 15: "trail", 17: "walk", 22: "boots"}


@dataclass
class Outcome:
    """What a tale came to.

    Attributes:
        iterations: passes of the WHILE; moves: of the family (flights, and cells of a followed trail); distance: cells.
        ogre_visits, awards: how often step 19 and step 26 came true; award: the wallet at the end.
        home: whether the family is at home in the end; homes: iterations that ended there without the king.
        moves_by_leg, distance_by_leg: of the outward way, the trail, the walk, and the boots.
    """

    iterations: int = 0
    moves: int = 0
    distance: int = 0
    ogre_visits: int = 0
    awards: int = 0
    award: float = 0.0
    home: bool = True
    homes: int = 0
    moves_by_leg: dict[str, int] = field(default_factory=lambda: dict.fromkeys(LEGS.values(), 0))
    distance_by_leg: dict[str, int] = field(default_factory=lambda: dict.fromkeys(LEGS.values(), 0))


def outcome_of(events: Iterable[Event]) -> Outcome:
    """The sum of a tale's events, all of them."""
    out, last = Outcome(), 0
    for event in events:
        out.iterations = event.iteration
        out.moves += event.moves
        out.distance += event.distance
        if event.moves:
            leg = LEGS[event.step]
            out.moves_by_leg[leg] += event.moves
            out.distance_by_leg[leg] += event.distance
        out.ogre_visits += event.step == 19
        out.awards += event.step == 26
        out.award = event.family.wallet
        out.home = _is_home(event.step, last, out.home)
        out.homes += event.step in (18, 23) or (event.step, last) in {(6, 15), (6, 13)}
        last = event.step
    return out


def tell(forest: Forest, rng: np.random.Generator, rules: Rules | None = None) -> Outcome:
    """Run figure 4 to its end; see `simulated_tom_thumb` for the arguments."""
    return outcome_of(simulated_tom_thumb(forest, rng, rules))


def as_json(outcome: Outcome) -> dict[str, object]:
    """The outcome as JSON takes it: an award of INFINITY is null, with a flag of its own."""
    infinite = math.isinf(outcome.award)
    return {
        "iterations": outcome.iterations,
        "moves": outcome.moves,
        "distance": outcome.distance,
        "ogre_visits": outcome.ogre_visits,
        "award": None if infinite else outcome.award,
        "award_infinite": infinite,
        "home": outcome.home,
        "homes": outcome.homes,
        "moves_by_leg": outcome.moves_by_leg,
        "distance_by_leg": outcome.distance_by_leg,
    }


def _is_home(step: int, last: int, before: bool) -> bool:
    """Whether the family is at home after this step: left at 10, back at 18, 23, 25, or by trail or parents."""
    if step in (4, 18, 23, 25):
        return True
    if step == 10:
        return False
    return before or (step, last) in {(6, 15), (6, 13)}
