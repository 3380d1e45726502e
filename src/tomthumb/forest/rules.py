"""The options of figure 4: what the paper leaves open, each with its default."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.kernels.forest import CLIP, REFLECT, TORUS
from tomthumb.tale.stdp import Plasticity

BOUNDARIES = {"torus": TORUS, "reflect": REFLECT, "clip": CLIP}


@dataclass(frozen=True)
class Rules:
    """How the family lives. Lengths are in cells, times in unit steps of the family.

    Attributes:
        lam: exponent of equation 2, in (1, 3].
        l_max: longest flight; None is half the forest's shorter side.
        directions: "eight", "four", "angle" (continuous), or "entrywise" (equation 1 literally, anisotropic).
        lengths: "power" (discrete, truncated), "pareto" or "mantegna" (continuous, scaled, then rounded and truncated).
        sense: a "flight" senses where it lands, a "walk" at every cell on the way.
        boundary: "torus", "reflect" or "clip".
        outward: flights of the parents before they would flee (step 10).
        flee: chance that they do (step 13); otherwise they lead everybody home by the same way.
        stones: stones in the "first" iteration only, "always", or "never" (step 7); all else is bread.
        tau: time constant of a crumb's fading; `faintest` is the strength below which it has disappeared.
        birds: chance of each crumb of the day to be eaten when the parents flee.
        parents_eyes: whether the cell that step 14 zeroes still senses.
        plasticity: the STDP of step 12, or None for children who never learn.
        forgetting: time constant of what was learned with crumbs; what was learned with stones stays.
        trust: chance to walk back as learned instead of flying, wherever something was learned (step 17, A11).
        heat: temperature of the draw among the learned ways, exp(w / heat).
        boots: step size alpha with the magic boots on (step 21), at least 1; 1 is no boots. None is the largest that
            serves: seven, for seven-mile boots, or less where l_max - 1 is less.
        king_anywhere: whether a palace counts for a family that has not met the ogre.
        palace_every: moves of the family after which every palace moves by one cell; 0 for palaces that stand still.
        exhausts: whether a king who has given has nothing left.
        enough: the wallet counts as EMPTY while it holds no more than this (step 6).
        max_iterations, max_moves: when to stop a tale without an end.
    """

    lam: float = 2.0
    l_max: int | None = None
    directions: Literal["eight", "four", "angle", "entrywise"] = "eight"
    lengths: Literal["power", "pareto", "mantegna"] = "power"
    sense: Literal["flight", "walk"] = "flight"
    boundary: Literal["torus", "reflect", "clip"] = "torus"
    outward: int = 10
    flee: float = 1.0
    stones: Literal["first", "always", "never"] = "first"
    tau: float = 30.0
    faintest: float = 0.25
    birds: float = 0.2
    parents_eyes: bool = True
    plasticity: Plasticity | None = field(default_factory=Plasticity)
    forgetting: float = 1000.0
    trust: float = 0.5
    heat: float = 0.05
    boots: float | None = None
    king_anywhere: bool = False
    palace_every: int = 0
    exhausts: bool = False
    enough: float = 0.0
    max_iterations: int = 1_000_000
    max_moves: int = 100_000_000

    def __post_init__(self) -> None:
        checks = {
            "lambda is in (1, 3]": 1.0 < self.lam <= 3.0,
            "Mantegna's lengths need lambda < 3": self.lengths != "mantegna" or self.lam < 3.0,
            "the longest flight is at least 1": self.l_max is None or self.l_max >= 1,
            "directions are eight, four, angle or entrywise": self.directions
            in ("eight", "four", "angle", "entrywise"),
            "lengths are power, pareto or mantegna": self.lengths in ("power", "pareto", "mantegna"),
            "a family senses in flight or on its walk": self.sense in ("flight", "walk"),
            "the boundary is torus, reflect or clip": self.boundary in BOUNDARIES,
            "at least one outward flight": self.outward >= 1,
            "stones are first, always or never": self.stones in ("first", "always", "never"),
            "flee, birds and trust are chances, faintest a strength, in [0, 1]": all(
                0.0 <= p <= 1.0 for p in (self.flee, self.birds, self.trust, self.faintest)
            ),
            "palaces move after a number of moves >= 0": self.palace_every >= 0,
            "tau, forgetting and heat are > 0": min(self.tau, self.forgetting, self.heat) > 0.0,
            "the boots' alpha is at least 1": self.boots is None or (math.isfinite(self.boots) and self.boots >= 1.0),
            "the wallet's enough is a number >= 0": self.enough >= 0.0,
            "at least one iteration, and 1 to 1e9 moves": self.max_iterations >= 1 and 1 <= self.max_moves <= 10**9,
        }
        for rule, kept in checks.items():
            if not kept:
                raise TomThumbError(f"forest rules: {rule}")


def rules_from(settings: Mapping[str, object]) -> Rules:
    """Rules from plain values by name, as a command line or a file gives them; `plasticity = false` turns learning off.

    Raises:
        UnknownName: no such rule. TomThumbError: a value of the wrong kind.
    """
    known = {f.name: f for f in fields(Rules)}
    values: dict[str, object] = {}
    for name, value in settings.items():
        if name not in known:
            raise UnknownName("forest rule", name, known)
        values[name] = _checked(name, value, str(known[name].type))
    return Rules(**values)  # type: ignore[arg-type]


def _checked(name: str, value: object, declared: str) -> object:
    """The value if it is of the declared kind; whole numbers serve as numbers."""
    if name == "plasticity":
        if not isinstance(value, bool):
            raise TomThumbError(f"forest rule plasticity is true or false here, not {value!r}")
        return Plasticity() if value else None
    kinds: dict[str, tuple[type, ...]] = {"float": (int, float), "int": (int,), "bool": (bool,), "Literal": (str,)}
    wanted = next(types for kind, types in kinds.items() if declared.startswith(kind))
    if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted):
        raise TomThumbError(f"forest rule {name} is a {declared}, not {value!r}")
    return value
