"""`minimize`: the family of figure 4 in a continuous landscape.

The words keep their meaning. Tom stands in the middle of the family and the children try places around him; the *ways*
they learn potentiate steps that led down and depress steps that led up, which for places in R^n is the active
covariance adaptation of Hansen, with its path length as the step size alpha. When a basin gives no more (the trail has
disappeared) its floor becomes a stone, and the ogre's house is built on it: its gain changes sign, and whoever comes
near again on a later walk turns round at once. Then the parents lead out from HOME, the best stone, by a Lévy flight
(equation 1); every other time with the magic boots on, from anywhere, with a larger family. The king's award is
INFINITY when the wanted value is reached.

References:
    N. Hansen, The CMA evolution strategy: a tutorial, arXiv:1604.00772 (ways, path and constants).
    N. Hansen, Benchmarking a BI-population CMA-ES on the BBOB-2009 function testbed (2009): the two kinds of restart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import OptimizeResult

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.tale.levy import pareto_lengths
from tomthumb.types import Array

Objective = Callable[[Array], float]
CHILDREN = 8  # Tom and his seven brothers
PARTS = ("ogre", "flights", "boots")


def minimize(
    f: Objective,
    bounds: Sequence[tuple[float, float]] | Array,
    rng: np.random.Generator | int | None = None,
    max_evaluations: int | None = None,
    target: float = -math.inf,
    x0: Sequence[float] | Array | None = None,
    lam: float = 2.0,
    without: Collection[str] = (),
) -> OptimizeResult:
    """Look for the least value of `f` within `bounds`; same generator, same result.

    Args:
        f: takes x (n,), gives a number; NaN counts as +infinity.
        bounds: (low, high) for each of n coordinates, finite.
        rng: a generator or a seed; None is seed 0.
        max_evaluations: budget; None is 1000 n.
        target: stop as soon as a value is at most this (the king's INFINITY).
        x0: where the first walk begins; None is a random place.
        lam: exponent of the Lévy flights between basins, > 1.
        without: parts of the tale to leave out, to see what they are worth: "ogre" (walks run again into basins that
            are known), "flights" (new walks on foot begin anywhere), "boots" (the family never grows).

    Returns:
        scipy's OptimizeResult: x (n,), fun, nfev, nit (generations), success (whether the target was met, or, without
        one, that the budget was used), message, and `basins`, the floors found as (x, fun) in the order of the walks.

    Raises:
        TomThumbError: bounds, x0, lam or budget that make no sense. UnknownName: no such part.
    """
    low, high = _box(bounds)
    if lam <= 1.0:
        raise TomThumbError(f"the Lévy exponent between basins is > 1, not {lam}")
    for part in without:
        if part not in PARTS:
            raise UnknownName("part of the tale", part, PARTS)
    budget = 1000 * len(low) if max_evaluations is None else int(max_evaluations)
    if budget < 1:
        raise TomThumbError(f"the budget is at least one evaluation, not {budget}")
    generator = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(0 if rng is None else rng)
    search = _Search(f, low, high, generator, budget, target, lam, frozenset(without))
    start = generator.random(len(low)) if x0 is None else _inside(x0, low, high)
    _wander_basins(search, start)
    return _result(search)


@dataclass
class _Search:
    """What the whole search shares; places are in the unit cube."""

    f: Objective
    low: Array
    high: Array
    rng: np.random.Generator
    budget: int
    target: float
    lam: float
    without: frozenset[str]
    evaluations: int = 0
    generations: int = 0
    best: Array = field(default_factory=lambda: np.zeros(0))
    best_value: float = math.inf
    basins: list[tuple[Array, float]] = field(default_factory=list)
    ogres: list[Array] = field(default_factory=list)

    @property
    def over(self) -> bool:
        return self.evaluations >= self.budget or self.best_value <= self.target

    def value(self, place: Array) -> float:
        """f at a place of the unit cube (mirrored into it), counted."""
        inside = _mirrored(place)
        value = float(self.f(self.low + inside * (self.high - self.low)))
        value = math.inf if math.isnan(value) else value
        self.evaluations += 1
        if value < self.best_value or not self.best.size:
            self.best, self.best_value = inside, value
        return value


@dataclass(frozen=True)
class _Rates:
    """How fast the children learn: weights of the ranked children (positive potentiate, negative depress) and rates."""

    weights: Array
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_path: float
    c_one: float
    c_mu: float
    chi: float  # mean length of a standard normal vector in n dimensions


@dataclass
class _Walk:
    """One walk in one basin: Tom's place, step size alpha (sigma), the ways learned (C) and the two paths."""

    mean: Array
    sigma: float
    C: Array
    B: Array
    D: Array
    path_sigma: Array
    path_way: Array
    age: int = 0


def _rates(n: int, children: int) -> _Rates:
    raw = math.log((children + 1) / 2.0) - np.log(np.arange(1, children + 1))
    up, down = raw[raw > 0.0], raw[raw < 0.0]
    mu_eff = float(up.sum() ** 2 / (up**2).sum())
    mu_down = float(down.sum() ** 2 / (down**2).sum())
    c_one = 2.0 / ((n + 1.3) ** 2 + mu_eff)
    c_mu = min(1.0 - c_one, 2.0 * (0.25 + mu_eff + 1.0 / mu_eff - 2.0) / ((n + 2.0) ** 2 + mu_eff))
    # the depression's share is bounded so that C stays positive definite
    share = min(1.0 + c_one / c_mu, 1.0 + 2.0 * mu_down / (mu_eff + 2.0), (1.0 - c_one - c_mu) / (n * c_mu))
    weights = np.where(raw > 0.0, raw / up.sum(), share * raw / -down.sum())
    c_sigma = (mu_eff + 2.0) / (n + mu_eff + 5.0)
    return _Rates(
        weights=weights,
        mu_eff=mu_eff,
        c_sigma=c_sigma,
        d_sigma=1.0 + 2.0 * max(0.0, math.sqrt((mu_eff - 1.0) / (n + 1.0)) - 1.0) + c_sigma,
        c_path=(4.0 + mu_eff / n) / (n + 4.0 + 2.0 * mu_eff / n),
        c_one=c_one,
        c_mu=c_mu,
        chi=math.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
    )


def _wander_basins(search: _Search, start: Array) -> None:
    """Walk after walk until the budget is spent or the king has been found."""
    n = start.size
    family = max(CHILDREN, 4 + int(3.0 * math.log(n)))
    boots, spent = 0, {True: 0, False: 0}  # evaluations with boots and on foot
    booted, sigma = True, 0.25
    while not search.over:
        before = search.evaluations
        children = family * 2**boots if booted else family
        _walk(search, _begin(start, sigma), children)
        spent[booted] += search.evaluations - before
        booted = spent[True] <= spent[False] and "boots" not in search.without
        boots += booted
        start, sigma = _set_out(search, booted)


def _set_out(search: _Search, booted: bool) -> tuple[Array, float]:
    """Where the parents lead, and the first step size: far with the boots on, a Lévy flight from home on foot."""
    n = search.best.size
    if booted or "flights" in search.without:
        return search.rng.random(n), 0.25
    length = min(1.0, float(pareto_lengths(search.rng, search.lam, 1, 0.01)[0]))
    heading = search.rng.standard_normal(n)
    place = search.best + length * math.sqrt(n) * heading / np.linalg.norm(heading)
    return _mirrored(place), max(0.01, 0.25 * length)


def _begin(start: Array, sigma: float) -> _Walk:
    n = start.size
    return _Walk(start.copy(), sigma, np.eye(n), np.eye(n), np.ones(n), np.zeros(n), np.zeros(n))


def _walk(search: _Search, walk: _Walk, children: int) -> None:
    """One basin, to its floor: generations of children around Tom until nothing more is gained."""
    n = walk.mean.size
    rates = _rates(n, children)
    floor, place, history = math.inf, walk.mean, []
    patience = 10 + math.ceil(30.0 * n / children)
    while not search.over:
        steps = search.rng.standard_normal((children, n)) * walk.D @ walk.B.T
        values = _try(search, walk, steps)
        search.generations += 1
        if len(values) < children:  # the budget ran out, or the king was met, in the middle of a generation
            break
        order = np.argsort(values, kind="stable")
        if values[order[0]] < floor:
            floor, place = float(values[order[0]]), _mirrored(walk.mean + walk.sigma * steps[order[0]])
        _learn(walk, steps[order], rates)
        history.append(float(values[order[0]]))
        if _at_an_ogre(search, walk):
            return
        if _disappeared(walk, history, values, patience):
            search.ogres.append(place)
            break
    if math.isfinite(floor):
        search.basins.append((place, floor))


def _try(search: _Search, walk: _Walk, steps: Array) -> Array:
    values = []
    for step in steps:
        if search.over:
            break
        values.append(search.value(walk.mean + walk.sigma * step))
    return np.array(values)


def _learn(walk: _Walk, steps: Array, rates: _Rates) -> None:
    """The children's places, best first, move Tom, the step size and the ways; `walk` is changed in place."""
    n = walk.mean.size
    good = np.maximum(rates.weights, 0.0)
    move = good @ steps
    walk.mean = walk.mean + walk.sigma * move
    white = walk.B @ ((walk.B.T @ move) / walk.D)
    keep = math.sqrt(rates.c_sigma * (2.0 - rates.c_sigma) * rates.mu_eff)
    walk.path_sigma = (1.0 - rates.c_sigma) * walk.path_sigma + keep * white
    length = float(np.linalg.norm(walk.path_sigma))
    walk.age += 1
    fresh = length / math.sqrt(1.0 - (1.0 - rates.c_sigma) ** (2 * walk.age)) < (1.4 + 2.0 / (n + 1.0)) * rates.chi
    keep = math.sqrt(rates.c_path * (2.0 - rates.c_path) * rates.mu_eff)
    walk.path_way = (1.0 - rates.c_path) * walk.path_way + fresh * keep * move
    _potentiate_and_depress(walk, steps, rates, bool(fresh))
    walk.sigma *= math.exp(min(1.0, rates.c_sigma / rates.d_sigma * (length / rates.chi - 1.0)))


def _potentiate_and_depress(walk: _Walk, steps: Array, rates: _Rates, fresh: bool) -> None:
    """C learns from the trail (rank one) and from every child by its rank; then its axes are found anew."""
    n = walk.mean.size
    white = (steps @ walk.B) / walk.D
    norms = np.maximum((white**2).sum(axis=1), 1e-300)
    weights = np.where(rates.weights >= 0.0, rates.weights, rates.weights * n / norms)
    lost = 0.0 if fresh else rates.c_one * rates.c_path * (2.0 - rates.c_path)
    forget = 1.0 + lost - rates.c_one - rates.c_mu * rates.weights.sum()
    C = (
        forget * walk.C
        + rates.c_one * np.outer(walk.path_way, walk.path_way)
        + rates.c_mu * (steps.T * weights) @ steps
    )
    walk.C = 0.5 * (C + C.T)
    # finding the axes costs n^3: seldom enough to stay below the cost of the children
    if walk.age % max(1, int(1.0 / (10.0 * n * (rates.c_one + rates.c_mu)))) == 0:
        squares, walk.B = np.linalg.eigh(walk.C)
        walk.D = np.sqrt(np.maximum(squares, 1e-20 * squares[-1]))


def _disappeared(walk: _Walk, history: list[float], values: Array, patience: int) -> bool:
    """Whether the basin gives no more: steps vanish, ways degenerate, or values stay the same for too long."""
    if walk.sigma * walk.D.max() < 1e-12 or walk.D.max() > 1e7 * walk.D.min() or walk.sigma > 1e3:
        return True
    recent = history[-patience:]
    if len(recent) == patience and max(recent) - min(recent) <= min(1e-11, 1e-9 * (history[0] - min(history))):
        return True
    if values.max() == values.min() and len(history) > patience:
        return True
    if len(history) < 120 + 30 * walk.mean.size:
        return False
    half = min(len(history) // 3, 400)
    return bool(np.median(history[-half // 2 :]) >= np.median(history[-half : -half // 2]))


def _at_an_ogre(search: _Search, walk: _Walk) -> bool:
    """Whether this walk runs down into a basin whose floor was reached before: an ogre's house within a few steps.

    Only a walk whose steps have become small against the distance between basins can tell.
    """
    reach = walk.sigma * float(walk.D.max())
    if reach > 1e-3 or walk.age % 10 or "ogre" in search.without:
        return False
    here = _mirrored(walk.mean)
    return any(float(np.abs(here - house).max()) < 5.0 * reach for house in search.ogres)


def _mirrored(place: Array) -> Array:
    """A place folded into the unit cube at its faces."""
    inside: Array = np.abs((place + 1.0) % 2.0 - 1.0)
    return inside


def _box(bounds: Sequence[tuple[float, float]] | Array) -> tuple[Array, Array]:
    box = np.asarray(bounds, dtype=float)
    if box.ndim != 2 or box.shape[1] != 2 or not len(box) or not np.isfinite(box).all():
        raise TomThumbError("bounds are finite (low, high) pairs, one for each coordinate")
    if not (box[:, 0] < box[:, 1]).all():
        raise TomThumbError(
            f"in bounds each low is below its high; coordinate {int(np.argmax(box[:, 0] >= box[:, 1]))} is not"
        )
    return box[:, 0].copy(), box[:, 1].copy()


def _inside(x0: Sequence[float] | Array, low: Array, high: Array) -> Array:
    start = np.asarray(x0, dtype=float)
    if start.shape != low.shape or not ((start >= low) & (start <= high)).all():
        raise TomThumbError(f"x0 is a place of {low.size} coordinates within the bounds")
    unit: Array = (start - low) / (high - low)
    return unit


def _result(search: _Search) -> OptimizeResult:
    scale = search.high - search.low
    met = search.best_value <= search.target
    return OptimizeResult(
        x=search.low + search.best * scale,
        fun=search.best_value,
        nfev=search.evaluations,
        nit=search.generations,
        success=bool(met or search.target == -math.inf),
        message="the target was met" if met else "the budget of evaluations was used",
        basins=[(search.low + place * scale, value) for place, value in search.basins],
    )
