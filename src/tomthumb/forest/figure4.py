"""Simulated Tom Thumb, figure 4 of the paper: steps 1 to 27, each named where it happens.

References:
    El-Dosuky, Rashad, Hamza, EL-Bassiouny, Simulated Tom Thumb, the Rule Of Thumb for Autonomous Robots, figure 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.forest.family import (
    Family,
    Ground,
    drift,
    eaten,
    ground_of,
    is_empty,
    palace_in_window,
    stdp_constants,
)
from tomthumb.forest.flights import Flights, alpha_of, lengths_of
from tomthumb.forest.rules import BOUNDARIES, Rules
from tomthumb.forest.world import Cell, Forest
from tomthumb.kernels.forest import CROWN, FREE, HAT, HOME, MOUNTAIN, OGRE, follow, learn_features, march, sense, wander
from tomthumb.types import Ids

_TOO_LATE = 2**31 - 2**24  # ticks are kept in 32 bits on the ground


def _nowhere() -> Ids:
    return np.zeros((0, 2), np.int64)


@dataclass(frozen=True)
class Event:
    """What one step of figure 4 did.

    Attributes:
        step: its number in the figure, 1 to 27.
        what: in words.
        iteration: pass of the WHILE, from 1 (0 before it).
        moves: family moves made in this step; `distance`: cells gone.
        path: cells entered or landed on in this step, (k, 2).
        family: the family after the step.
        ground: the trail and the memory as they are *now*: they change with the next step, so copy what you keep.
        palaces: where the palaces stand after the step (p, 2).
    """

    step: int
    what: str
    iteration: int
    family: Family
    ground: Ground
    palaces: Ids
    moves: int = 0
    distance: int = 0
    path: Ids = field(default_factory=_nowhere)


@dataclass
class _Tale:
    """What a run carries along between the steps."""

    forest: Forest
    rules: Rules
    rng: np.random.Generator
    ground: Ground
    family: Family
    walk: Flights
    boots: Flights
    palaces: Ids
    awards: list[float]
    chunk: int
    bare: bool
    day: Ids = field(default_factory=_nowhere)
    iteration: int = 0
    moves: int = 0
    stones: bool = True
    found: int = FREE

    def event(self, step: int, what: str, moves: int = 0, distance: int = 0, path: Ids | None = None) -> Event:
        self.moves += moves
        cells = _nowhere() if path is None else path
        return Event(step, what, self.iteration, self.family, self.ground, self.palaces, moves, distance, cells)

    @property
    def tired(self) -> bool:
        return self.moves >= self.rules.max_moves or self.ground.tick >= _TOO_LATE


def simulated_tom_thumb(
    forest: Forest, rng: np.random.Generator, rules: Rules | None = None, chunk: int = 4096
) -> Iterator[Event]:
    """Figure 4, literally: yields an Event for every step as it happens.

    Ends when the wallet is no longer EMPTY at step 6, when an award is INFINITY (step 27), or at the rules' limits.
    Same forest, generator and rules: same events.

    Args:
        forest: home, mountains, ogres, palaces (steps 2 and 3).
        rng: the only source of chance.
        rules: what the figure leaves open.
        chunk: most moves in one event of the search (steps 17 and 22); it changes how often the tale is told, not how
            it goes.

    Raises:
        TomThumbError: boots or rules that do not fit this forest, or a chunk below 1.
    """
    if chunk < 1:
        raise TomThumbError(f"an event holds at least one move, not {chunk}")
    tale = _begin(forest, rng, rules or Rules(), chunk)
    yield tale.event(1, "the family WINDOW: parents, Tom Thumb and his brothers")
    yield tale.event(2, f"a GRID of {forest.shape[0]} x {forest.shape[1]}")
    yield tale.event(3, f"mountains, {len(tale.palaces)} palaces and {len(forest.ogres)} ogre's houses in it")
    yield tale.event(4, "at HOME")
    yield tale.event(5, "the wallet is EMPTY, alpha is 1")
    while True:
        empty = is_empty(tale.family.wallet, tale.rules.enough)
        yield tale.event(6, "the wallet is EMPTY" if empty else f"the wallet holds {tale.family.wallet:g}")
        if not empty or tale.iteration >= tale.rules.max_iterations or tale.tired:
            return
        tale.iteration += 1
        yield from _iteration(tale)
        if math.isinf(tale.family.wallet):  # step 27 stops at once, without another look at step 6
            return


def _begin(forest: Forest, rng: np.random.Generator, rules: Rules, chunk: int) -> _Tale:
    """Steps 1 to 5."""
    alpha = alpha_of(rules, forest.shape)
    walk = Flights(rng, lengths_of(rules, forest.shape, 1.0), rules.directions)
    boots = Flights(rng, lengths_of(rules, forest.shape, alpha), rules.directions)
    palaces, awards = forest.palaces, forest.awards.tolist()
    bare = not (forest.cells == MOUNTAIN).any()
    ground, family = ground_of(forest, rules), Family(forest.home)
    return _Tale(forest, rules, rng, ground, family, walk, boots, palaces, awards, chunk, bare)


def _iteration(tale: _Tale) -> Iterator[Event]:
    """Steps 7 to 27: one pass of the WHILE."""
    yield from _leave_home(tale)
    if tale.rng.random() >= tale.rules.flee:
        back = int(tale.ground.counts[1])
        tale.family = replace(tale.family, place=tale.forest.home)
        yield tale.event(13, "the parents do not flee and lead everybody home", moves=back, distance=back)
        return
    yield tale.event(13, "the parents flee")
    tale.family = tale.family.without_parents()
    yield tale.event(14, "the parents' cell is zeroed")
    yield from _follow_trail(tale)
    if tale.found == HOME:
        return
    yield tale.event(16, "the trail has disappeared")
    yield from _search(tale, 17, tale.walk)
    if tale.found == HOME:
        yield tale.event(18, "HOME: the iteration ends")
    elif tale.found == OGRE:
        yield tale.event(19, "at the ogre's house")
        yield from _at_the_ogre(tale)
    elif tale.found != FREE:
        yield from _at_the_palace(tale)


def _leave_home(tale: _Tale) -> Iterator[Event]:
    """Steps 7 to 12: stones or bread, hats, and the way into the forest."""
    rules, ground = tale.rules, tale.ground
    tale.stones = rules.stones == "always" or (rules.stones == "first" and tale.iteration == 1)
    yield tale.event(7, "the parents allow little stones" if tale.stones else "the parents prevent little stones")
    if not tale.stones:
        yield tale.event(8, "Tom Thumb takes some bread")
    tale.family = replace(tale.family, wear=HAT, alpha=1.0, place=tale.forest.home).complete()
    yield tale.event(9, "heads' wear is HAT = 1")
    _set_out(tale)
    flights, path = _march(tale)
    yield tale.event(10, "the family goes to the forest", moves=flights, distance=len(path), path=path)
    yield tale.event(11, f"Tom Thumb drops {'stones' if tale.stones else 'crumbs'} on the way", path=path)
    if rules.plasticity is not None:
        m = ground.sights
        learn_features(tale.forest.features, path, ground.seen, m.w, m.x, m.y, stdp_constants(rules), _boundary(tale))
        yield tale.event(12, "the children learn features and way", path=path)


def _march(tale: _Tale) -> tuple[int, Ids]:
    """Steps 10 to 12 as one sweep, because marks and weights change at every cell of the way."""
    rules, g = tale.rules, tale.ground
    place, paths, left = np.array(tale.family.place), [_nowhere()], rules.outward
    while left:
        flights, _ = tale.walk.look(left)
        path = np.empty((int(np.abs(flights).max(axis=1).sum()), 2), np.int64)
        entered = march(
            g.cells, g.number, g.laid, g.way, g.touched, g.recent, g.counts, place, flights, tale.stones,
            _boundary(tale), rules.tau, rules.faintest, stdp_constants(rules), path,
        )  # fmt: skip
        tale.walk.use(len(flights))
        paths.append(path[:entered])
        left -= len(flights)
    tale.family = replace(tale.family, place=(int(place[0]), int(place[1])))
    tale.day = np.concatenate(paths)
    return rules.outward, tale.day


def _follow_trail(tale: _Tale) -> Iterator[Event]:
    """Step 15, after the birds had their share of the crumbs."""
    rules, g = tale.rules, tale.ground
    eaten(g, tale.day, rules.birds, tale.rng)
    place = np.array(tale.family.place)
    path = np.empty((int(g.counts[1]) + 1, 2), np.int64)
    count, tale.found = follow(
        g.cells, g.number, g.laid, g.counts, place, _eyes(tale), _boundary(tale), rules.tau, rules.faintest, path
    )
    tale.family = replace(tale.family, place=(int(place[0]), int(place[1])))
    what = "Tom Thumb follows the trail " + ("home" if tale.found == HOME else "until it is disappeared")
    yield tale.event(15, what, moves=count, distance=count, path=path[:count].copy())


def _search(tale: _Tale, step: int, flights: Flights) -> Iterator[Event]:
    """Steps 17 and 22: random walk, sensing around the window; the place where it begins is sensed first."""
    rules, g = tale.rules, tale.ground
    place, eyes, boundary = np.array(tale.family.place), _eyes(tale), _boundary(tale)
    booted = tale.family.alpha > 1.0
    trust = rules.trust if step == 17 and rules.plasticity is not None else 0.0
    royal = tale.family.wear == CROWN or rules.king_anywhere
    tale.found = sense(g.cells, place[0], place[1], eyes, tale.family.wear, royal, boundary)
    while tale.found == FREE and not tale.tired:
        moves, luck = flights.look(_most(tale))
        path = np.empty_like(moves)
        used, tale.found, distance = wander(
            g.cells, g.way, g.touched, g.counts, place, eyes, moves, luck, tale.family.wear, royal, booted, tale.bare,
            rules.sense == "walk", boundary, trust, rules.heat, rules.forgetting, path,
        )  # fmt: skip
        flights.use(used)
        tale.family = replace(tale.family, place=(int(place[0]), int(place[1])))
        yield tale.event(step, "faster random walk" if booted else "random walk", used, distance, path[:used])
        if rules.palace_every and tale.moves % rules.palace_every == 0:
            tale.palaces = drift(g.cells, tale.palaces, tale.rng)


def _at_the_ogre(tale: _Tale) -> Iterator[Event]:
    """Steps 20 to 24: hats for crowns, boots on, and away."""
    tale.family = tale.family.wearing(CROWN)
    yield tale.event(20, "heads' wear is CROWN = -1")
    tale.family = replace(tale.family, alpha=alpha_of(tale.rules, tale.forest.shape))
    yield tale.event(21, f"the magical boots: alpha is {tale.family.alpha:g}")
    yield from _search(tale, 22, tale.boots)
    if tale.found == HOME:
        yield tale.event(23, "HOME: the iteration ends")
    elif tale.found != FREE:
        yield from _at_the_palace(tale)


def _at_the_palace(tale: _Tale) -> Iterator[Event]:
    """Steps 24 to 27: the king carries the family home and fills the wallet."""
    yield tale.event(24, "at the king's palace")
    which = palace_in_window(tale.palaces, tale.family.place, tale.forest.shape)
    tale.family = replace(tale.family, place=tale.forest.home)
    yield tale.event(25, "the king moves the family HOME")
    award = tale.awards[which]
    if tale.rules.exhausts:
        tale.awards[which] = 0.0
    tale.family = replace(tale.family, wallet=tale.family.wallet + award)
    yield tale.event(26, f"the king's award is {award:g}")
    if math.isinf(award):
        yield tale.event(27, "the award is INFINITY: stop")


def _set_out(tale: _Tale) -> None:
    """Home is mark number 0, which nothing eats, and the first cell the children have in mind."""
    ground, home = tale.ground, tale.forest.home
    ground.number[home], ground.laid[home] = 0, -1
    ground.counts[1:] = 0
    ground.recent[:] = -1
    ground.recent[0] = (*home, ground.tick)
    ground.sights.rest()
    ground.seen[:] = False


def _boundary(tale: _Tale) -> int:
    return BOUNDARIES[tale.rules.boundary]


def _eyes(tale: _Tale) -> Ids:
    """Which of the nine cells sense."""
    return np.ones((3, 3), np.bool_) if tale.rules.parents_eyes else tale.family.window != 0.0


def _most(tale: _Tale) -> int:
    """Moves until the next event, the next drift of the palaces, or the end of the family's strength."""
    most = min(tale.chunk, tale.rules.max_moves - tale.moves)
    every = tale.rules.palace_every
    return most if not every else min(most, every - tale.moves % every)


__all__ = ["Cell", "Event", "simulated_tom_thumb"]
