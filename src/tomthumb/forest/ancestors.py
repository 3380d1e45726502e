"""The ancestors: Drogoul and Ferber's Tom Thumb robots, and Tzafestas' robots that never run out of crumbs.

Robots carry samples home, one each. What marks they lay, follow and pick up is their kind. The original equations were
not available to us: these are our readings of the descriptions, as `KINDS` and `Regulation` say.

References:
    A. Drogoul, J. Ferber, From Tom Thumb to the dockers: some experiments with foraging robots (SAB 1992).
    E. S. Tzafestas, Tom Thumb robots revisited: self-regulation as the basis of behavior (ALIFE 1998).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.tale.levy import LengthLaw, power_law
from tomthumb.types import Ids

_NEIGHBOURS = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])


@dataclass(frozen=True)
class Regulation:
    """Tzafestas' laydown and pickup, as a loop on what is carried and a slower one on its set point.

    A cell needs one crumb only. Laying it down has chance carried / (carried + set point), picking up its complement:
    whoever carries much lays, whoever carries little gathers, and nobody ever lays what it has not or takes more than
    `budget`. The set point begins at 1; a paying trip lowers it (bolder), a trip to a source that has nothing raises it
    (thriftier), by `rate` of the way.

    Attributes:
        budget: most crumbs a robot can carry, N0. It begins with half, so that there is room to gather what others
            laid; all that is carried and on the ground is conserved.
        rate: of the second loop, in [0, 1].
    """

    budget: int = 40
    rate: float = 0.2

    def chance(self, carried: int, set_point: float) -> float:
        """Of laying a crumb down; that of picking one up is 1 minus it."""
        return carried / (carried + set_point)

    def adapt(self, set_point: float, paid: bool) -> float:
        """The set point after a trip, in [1, budget]."""
        goal = 1.0 if paid else float(self.budget)
        return set_point + self.rate * (goal - set_point)


@dataclass(frozen=True)
class Habits:
    """What a robot does with marks: `drop` them when loaded, `follow` them outward, `pick` them up, hand over in a
    `chain`, draw its flights from `law`, and `regulate` its crumbs (None: as many as it likes)."""

    drop: bool = False
    follow: bool = False
    pick: bool = False
    chain: bool = False
    law: LengthLaw = field(default_factory=lambda: power_law(1.0, 1))
    regulate: Regulation | None = None


KINDS = {
    "brownian": Habits(),
    "levy": Habits(law=power_law(2.0, 16)),
    "droppers": Habits(drop=True, follow=True),
    "gatherers": Habits(drop=True, follow=True, pick=True),
    "dockers": Habits(chain=True),
    "regulated": Habits(drop=True, follow=True, pick=True, regulate=Regulation()),
}


@dataclass(frozen=True)
class Quarry:
    """Where samples lie: a clipped grid of side `size`, home in the middle, `sources (s, 2)` with `stock (s,)` each."""

    size: int
    sources: Ids
    stock: Ids

    @property
    def home(self) -> tuple[int, int]:
        """Row and column of home."""
        return self.size // 2, self.size // 2


@dataclass
class Colony:
    """The robots and their world at one moment; `foraging` yields the same object after every step.

    Attributes:
        place: (r, 2); loaded (r,); carried (r,) crumbs; set_point (r,); goal (r, 2), -1 where there is none.
        marks: crumbs on each cell (n, n); stock: what the sources still hold; brought: samples at home.
    """

    place: Ids
    loaded: np.ndarray[tuple[int], np.dtype[np.bool_]]
    carried: Ids
    set_point: np.ndarray[tuple[int], np.dtype[np.float64]]
    goal: Ids
    marks: Ids
    stock: Ids
    left: Ids
    heading: Ids
    brought: int = 0


def quarry(rng: np.random.Generator, size: int = 41, sources: int = 3, stock: int = 30) -> Quarry:
    """Sources at random, at least a quarter of the side away from home."""
    if size < 9 or sources < 1 or stock < 0:
        raise TomThumbError("a quarry has a side of at least 9, one source and a stock >= 0")
    places: list[Ids] = []
    while len(places) < sources:
        place = rng.integers(0, size, 2)
        if np.abs(place - size // 2).max() >= size // 4:
            places.append(place)
    return Quarry(size, np.array(places), np.full(sources, stock, np.int64))


def foraging(
    world: Quarry, kind: str | Habits, rng: np.random.Generator, steps: int, robots: int = 10
) -> Iterator[Colony]:
    """Let `robots` of one kind forage for `steps` unit steps, all from home; yields after each step.

    Raises:
        UnknownName: no such kind.
    """
    if isinstance(kind, str) and kind not in KINDS:
        raise UnknownName("kind of robot", kind, KINDS)
    habits = KINDS[kind] if isinstance(kind, str) else kind
    budget = habits.regulate.budget if habits.regulate else 0
    colony = Colony(
        place=np.tile(np.array(world.home), (robots, 1)),
        loaded=np.zeros(robots, np.bool_),
        carried=np.full(robots, budget // 2, np.int64),
        set_point=np.ones(robots),
        goal=np.full((robots, 2), -1, np.int64),
        marks=np.zeros((world.size, world.size), np.int64),
        stock=world.stock.copy(),
        left=np.zeros(robots, np.int64),
        heading=np.zeros((robots, 2), np.int64),
    )
    for _ in range(steps):
        for robot in rng.permutation(robots):
            _act(colony, world, habits, int(robot), rng)
        yield colony


def _act(c: Colony, world: Quarry, habits: Habits, r: int, rng: np.random.Generator) -> None:
    """One step of one robot: home with a load, to a source in the window, along marks or a chain, or at random."""
    home = np.array(world.home)
    if c.loaded[r]:
        if habits.drop:
            _lay(c, habits, r, rng)
        _step(c, world, r, np.sign(home - c.place[r]))
        if (c.place[r] == home).all():
            c.loaded[r], c.brought = False, c.brought + 1
            _learn_trip(c, habits, r, paid=True)
        return
    if habits.pick:
        _pick(c, habits, r, rng)
    if _load(c, world, habits, r) or (habits.chain and _take_over(c, world, r)):
        return
    heading = _outward_mark(c, world, r) if habits.follow else None
    if heading is None and c.goal[r, 0] >= 0:
        heading = np.sign(c.goal[r] - c.place[r])
        if not heading.any():
            c.goal[r] = -1
    _step(c, world, r, _random_heading(c, habits, r, rng) if heading is None or not heading.any() else heading)


def _step(c: Colony, world: Quarry, r: int, heading: Ids) -> None:
    c.place[r] = np.clip(c.place[r] + heading, 0, world.size - 1)


def _random_heading(c: Colony, habits: Habits, r: int, rng: np.random.Generator) -> Ids:
    """Unit step of the flight under way; a new flight where the last has ended."""
    if c.left[r] == 0:
        k = int(rng.integers(0, 8))
        c.heading[r] = _NEIGHBOURS[k if k < 4 else k + 1]
        c.left[r] = habits.law.draw(rng, 1)[0]
    c.left[r] -= 1
    heading: Ids = c.heading[r]
    return heading


def _load(c: Colony, world: Quarry, habits: Habits, r: int) -> bool:
    """Take a sample from a source in the window; a source found empty is a trip that did not pay."""
    near = np.flatnonzero(np.abs(world.sources - c.place[r]).max(axis=1) <= 1)
    paying = near[c.stock[near] > 0]
    if not near.size:
        return False
    if not paying.size:
        _learn_trip(c, habits, r, paid=False)
        return False
    c.stock[paying[0]] -= 1
    c.place[r], c.loaded[r] = world.sources[paying[0]], True
    if habits.chain:
        c.goal[r] = world.sources[paying[0]]
    return True


def _take_over(c: Colony, world: Quarry, r: int) -> bool:
    """Dockers: take the load of a robot in the window that has farther to go; it turns back to where it got it."""
    away = np.abs(c.place - np.array(world.home)).max(axis=1)
    near = (np.abs(c.place - c.place[r]).max(axis=1) <= 1) & c.loaded & (away > away[r])
    givers = np.flatnonzero(near)
    if not givers.size:
        return False
    giver = givers[0]
    c.loaded[giver], c.loaded[r] = False, True
    c.goal[r] = c.place[giver]
    return True


def _outward_mark(c: Colony, world: Quarry, r: int) -> Ids | None:
    """Heading to the mark in the window that is farthest from home, if farther than here."""
    home, here = np.array(world.home), c.place[r]
    cells = here + _NEIGHBOURS
    inside = ((cells >= 0) & (cells < world.size)).all(axis=1)
    away = np.abs(cells - home).sum(axis=1)
    kept = np.clip(cells, 0, world.size - 1)
    good = inside & (c.marks[kept[:, 0], kept[:, 1]] > 0) & (away > np.abs(here - home).sum())
    if not good.any():
        return None
    heading: Ids = _NEIGHBOURS[int(np.argmax(np.where(good, away, -1)))]
    return heading


def _lay(c: Colony, habits: Habits, r: int, rng: np.random.Generator) -> None:
    cell, rule = tuple(c.place[r]), habits.regulate
    if rule is None:
        c.marks[cell] += 1
    elif (
        c.marks[cell] == 0 and c.carried[r] > 0 and rng.random() < rule.chance(int(c.carried[r]), float(c.set_point[r]))
    ):
        c.marks[cell] += 1
        c.carried[r] -= 1


def _pick(c: Colony, habits: Habits, r: int, rng: np.random.Generator) -> None:
    cell, rule = tuple(c.place[r]), habits.regulate
    if c.marks[cell] == 0:
        return
    if rule is None:
        c.marks[cell] -= 1
    elif c.carried[r] < rule.budget and rng.random() >= rule.chance(int(c.carried[r]), float(c.set_point[r])):
        c.marks[cell] -= 1
        c.carried[r] += 1


def _learn_trip(c: Colony, habits: Habits, r: int, paid: bool) -> None:
    if habits.regulate is not None:
        c.set_point[r] = habits.regulate.adapt(float(c.set_point[r]), paid)
