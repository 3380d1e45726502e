"""The grid: a TOML file, or the same by options, becomes a list of runs. Nothing is run here; see `docs/bench.md`."""

from __future__ import annotations

import itertools
import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from tomthumb.bench.measures import DEFAULT, measure
from tomthumb.bench.spec import KINDS, Part, RunSpec
from tomthumb.bench.version import code_version, data_checksum
from tomthumb.config import in_radians, parse_sets
from tomthumb.errors import BrokenFile, TomThumbError, UnknownName

KEYS = ("name", "description", "seeds", "baseline", "measures", "level", "limits", "report", "claim", *KINDS)
DEFAULT_USE = {"estimator": "iekf", "slam": "slam"}
MOST_SEEDS = 10_000_000


@dataclass(frozen=True)
class Limits:
    """Bounds on one run. `seconds` None: unbounded. `memory_mb` on top of what the worker holds at the start (Linux).

    A run that brings its worker down is tried `attempts` times; one whose worker was killed from outside, or lost with
    its node, `kills` times.
    """

    seconds: float | None = None
    memory_mb: float | None = 4096.0
    attempts: int = 3
    kills: int = 20


UNBOUNDED = Limits()


@dataclass(frozen=True)
class Claim:
    """A sentence to be judged by the rows: a measure of a method, against a bound or against another method."""

    text: str
    method: str
    measure: str = "match_rate"
    scenario: str | None = None
    better_than: str | None = None
    at_least: float | None = None
    at_most: float | None = None


@dataclass(frozen=True)
class Grid:
    """All axes with their choices. A method is an estimator with an associator and a life cycle.

    `baseline` is the label of a method, or of an associator: then each method is compared with the one that differs
    from it in the associator only. `pages`: how many runs the report draws; every method's run of the seed `show` comes
    first. `text` is the file it was read from, `source` all that it takes to make it again.
    """

    name: str
    scenarios: tuple[Part, ...]
    estimators: tuple[Part, ...]
    associators: tuple[Part, ...]
    slams: tuple[Part, ...]
    seeds: tuple[int, ...]
    baseline: str
    measures: tuple[str, ...] = DEFAULT
    level: float = 0.05
    limits: Limits = UNBOUNDED
    claims: tuple[Claim, ...] = ()
    pages: int = 60
    show: int | None = None
    description: str = ""
    text: str = ""
    source: str = ""

    def methods(self) -> dict[str, tuple[Part, Part, Part]]:
        """Estimator, associator and life cycle by label: the parts that vary, or the associator if none does."""
        axes = (self.associators, self.estimators, self.slams)
        varied = [i for i, axis in enumerate(axes) if len(axis) > 1] or [0]
        found = {}
        for parts in itertools.product(*axes):
            found[" / ".join(parts[i].label for i in varied)] = (parts[1], parts[0], parts[2])
        return found

    def runs(self) -> list[RunSpec]:
        """Every run, those of one world together: so paired runs share the world a worker has just built."""
        code = code_version()
        worlds = itertools.product(self.scenarios, self.seeds)
        methods = list(self.methods().values())
        return [RunSpec(s, e, a, life, seed, code) for s, seed in worlds for e, a, life in methods]


def read_grid(path: Path, seeds: str | None = None) -> Grid:
    """The grid of a TOML file; paths in it are relative to it. Raises BrokenFile, TomThumbError, UnknownName."""
    try:
        text = path.read_text("utf-8")
        table = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as reason:
        raise BrokenFile(path, f"cannot be read as TOML: {reason}") from None
    if seeds is not None:
        table["seeds"] = seeds
    table.setdefault("name", path.stem)
    try:
        return from_table(table, path.parent, text)
    except TomThumbError as reason:
        raise TomThumbError(f"{path}: {reason}") from None


def from_options(
    scenarios: Sequence[str],
    estimators: Sequence[str],
    associators: Sequence[str],
    sets: Sequence[str],
    seeds: str | None,
    name: str = "options",
) -> Grid:
    """The same by options. A list in `sets` is swept; its keys go to every part of the kind they are prefixed with."""
    settings = parse_sets(sets)
    given = {"scenario": scenarios, "estimator": estimators or ["iekf"], "associator": associators or ["stt", "jcbb"]}
    table: dict[str, Any] = {
        kind: [{"use": use, **settings[kind]} for use in uses] for kind, uses in given.items() if uses
    }
    if settings["slam"]:
        table["slam"] = [settings["slam"]]
    return from_table({"name": name, "seeds": seeds or "20", **table}, Path.cwd())


def from_table(table: Mapping[str, Any], home: Path, text: str = "") -> Grid:
    """The grid of a table already read. Raises TomThumbError for what does not fit, with the valid choices."""
    for key in table:
        if key not in KEYS:
            raise UnknownName("key of a grid", key, KEYS)
    scenarios, estimators, associators, slams = (_axis(kind, table.get(kind), home) for kind in KINDS)
    grid = Grid(
        name=str(table.get("name", "grid")),
        scenarios=scenarios,
        estimators=estimators,
        associators=associators,
        slams=slams,
        seeds=_seeds(table.get("seeds", 20)),
        baseline=str(table.get("baseline", associators[0].label)),
        measures=tuple(table.get("measures", DEFAULT)),
        level=_level(table.get("level", 0.05)),
        limits=_limits(table.get("limits", {})),
        claims=tuple(_claim(one) for one in table.get("claim", ())),
        **_report(table.get("report", {})),
        description=str(table.get("description", "")),
        text=text,
        source=json.dumps({"table": table, "home": str(home.resolve()), "text": text}),
    )
    _check_labels(grid)
    return grid


def _check_labels(grid: Grid) -> None:
    """What the grid says of itself must be in it."""
    methods = [*grid.methods(), *(part.label for part in grid.associators)]
    _one_of("baseline", grid.baseline, methods)
    for key in grid.measures:
        measure(key)
    for claim in grid.claims:
        _one_of("method of a claim", claim.method, methods)
        _one_of("better_than of a claim", claim.better_than, methods)
        _one_of("scenario of a claim", claim.scenario, [part.label for part in grid.scenarios])
        measure(claim.measure)


def _axis(kind: str, entries: Any, home: Path) -> tuple[Part, ...]:
    """All choices of one kind: each entry, once for every combination of the values it lists."""
    if entries is None and kind in DEFAULT_USE:
        entries = [{}]
    if isinstance(entries, Mapping):
        entries = [entries]
    if not isinstance(entries, list) or not entries:
        raise TomThumbError(f"[[{kind}]] is missing: at least one is needed")
    parts = [part for entry in entries for part in _choices(kind, entry, home)]
    labels = [part.label for part in parts]
    for label in labels:
        if labels.count(label) > 1:
            raise TomThumbError(f"[[{kind}]]: {label!r} occurs twice; give one of them another label")
    return tuple(parts)


def _choices(kind: str, entry: Any, home: Path) -> Iterable[Part]:
    if not isinstance(entry, Mapping):
        raise TomThumbError(f"[[{kind}]] must be a table, got {entry!r}")
    rest = dict(entry)
    use = rest.pop("use", DEFAULT_USE.get(kind))
    if not isinstance(use, str):
        raise TomThumbError(f"[[{kind}]]: 'use' must name one, got {use!r}")
    full, files = _located(use, home)
    base = Part(full, files=files)
    label = rest.pop("label", None) or _short(kind, use, rest)
    swept = [key for key, value in rest.items() if isinstance(value, list)]
    for values in itertools.product(*(rest[key] for key in swept)):
        chosen = {**rest, **dict(zip(swept, values, strict=True))}
        tail = "".join(f" {key}={_word(chosen[key])}" for key in swept)
        params = dict(in_radians(key, value) for key, value in chosen.items())
        yield replace(base, params=params, label=label + tail)


def _short(kind: str, use: str, rest: Mapping[str, Any]) -> str:
    """A label made of the name and the fixed parameters."""
    name = Path(use.partition("?")[0]).name if "/" in use else use
    fixed = [f"{key}={_word(value)}" for key, value in rest.items() if not isinstance(value, list)]
    return " ".join(fixed if kind == "slam" and fixed else [name, *fixed])


def _word(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _located(use: str, home: Path) -> tuple[str, str]:
    """`use` with the path it names in full, and the checksum of what lies there ("" where it names no path)."""
    use = _expand(use)
    plain, mark, query = use.partition("?")
    for kind, path, end in _readings(plain):
        full = (home / Path(path).expanduser()).resolve()
        if full.exists():
            return f"{kind}{full}{end}{mark}{query}", data_checksum(full)
    if "/" in plain or ".py:" in plain:
        raise TomThumbError(f"{use}: no such file or folder (looked from {home.resolve()})")
    return use, ""


def _readings(plain: str) -> Iterable[tuple[str, str, str]]:
    """How a name may hold a path: ``file.py:Name``, ``kind:path``, a path alone; as (before, path, after)."""
    before, colon, after = plain.rpartition(":")
    if before.endswith(".py"):
        yield "", before, colon + after
    first, colon, path = plain.partition(":")
    if colon and path:
        yield first + colon, path, ""
    if "/" in plain or Path(plain).suffix:
        yield "", plain, ""


def _expand(use: str) -> str:
    """Names like $TOMTHUMB_DATA replaced by the environment's values."""
    full = os.path.expandvars(use)
    missing = re.search(r"\$\{?(\w+)", full)
    if missing:
        raise TomThumbError(f"{use}: the environment variable {missing[1]} is not set")
    return full


def _seeds(given: Any) -> tuple[int, ...]:
    """20 means 0 to 19; "100..149"; [3, 5, 8]."""
    if isinstance(given, str) and ".." in given:
        first, _, last = given.partition("..")
        given = range(_whole(first), _whole(last) + 1)
    elif isinstance(given, (int, str)):
        given = range(_whole(given))
    seeds = tuple(_whole(seed) for seed in given) if isinstance(given, (list, range)) else ()
    if not seeds or len(seeds) > MOST_SEEDS or len(set(seeds)) < len(seeds) or min(seeds) < 0:
        raise TomThumbError('seeds: a number of them, "100..149" or a list of different whole numbers, 0 or more')
    return seeds


def _whole(text: Any) -> int:
    try:
        if isinstance(text, (bool, float)):
            raise ValueError
        return int(text)
    except ValueError:
        raise TomThumbError(f"seeds: {text!r} is not a whole number") from None


def _limits(table: Mapping[str, Any]) -> Limits:
    known = {f.name for f in fields(Limits)}
    for key, value in table.items():
        if key not in known:
            raise UnknownName("key of [limits]", key, known)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value <= 0:
            raise TomThumbError(f"limits.{key} = {value!r}: a number above 0")
    return Limits(**table)


def _claim(table: Mapping[str, Any]) -> Claim:
    known = [f.name for f in fields(Claim)]
    for key in table:
        if key not in known:
            raise UnknownName("key of [[claim]]", key, known)
    if not {"text", "method"} <= set(table):
        raise TomThumbError("[[claim]] needs text and method")
    claim = Claim(**table)
    if sum(bound is not None for bound in (claim.better_than, claim.at_least, claim.at_most)) != 1:
        raise TomThumbError(f"claim {claim.text!r}: exactly one of better_than, at_least, at_most")
    return claim


def _level(level: Any) -> float:
    if not isinstance(level, float) or not 0.0 < level < 0.5:
        raise TomThumbError(f"level = {level!r}: a number above 0 and below 0.5")
    return level


def _report(table: Mapping[str, Any]) -> dict[str, int]:
    """`pages` and `show` of [report]."""
    for key, value in table.items():
        if key not in ("pages", "show"):
            raise UnknownName("key of [report]", key, ["pages", "show"])
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise TomThumbError(f"report.{key} = {value!r}: a whole number, 0 or more")
    return dict(table)


def _one_of(what: str, label: str | None, valid: Sequence[str]) -> None:
    if label is not None and label not in valid:
        raise UnknownName(what, label, valid)
