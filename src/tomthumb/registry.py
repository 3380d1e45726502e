"""Names for associators, estimators and scenarios, and how each is built. Nothing is imported before it is asked for.

A name is looked up in this order: the table below; entry points of installed packages (groups `tomthumb.associators`,
`tomthumb.estimators`, `tomthumb.scenarios`); ``package.module:Class``; ``./file.py:Class``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.modules import module_at

BUILT_IN: dict[str, dict[str, str]] = {
    "associator": {
        "oracle": "tomthumb.associators.oracle:Oracle",
        "nn": "tomthumb.associators.nearest:NearestNeighbour",
        "gnn": "tomthumb.associators.nearest:GlobalNearestNeighbour",
        "jcbb": "tomthumb.associators.jcbb:JointCompatibility",
        "stt": "tomthumb.associators.tom_thumb:TomThumb",
        "map": "tomthumb.associators.maximum:MaximumPosterior",
        "ipjc": "tomthumb.associators.ipjc:PosteriorCompatibility",
        "singles": "tomthumb.associators.singles:Singles",
        "scnn": "tomthumb.associators.sequential:SequentialNearestNeighbour",
        "rjc": "tomthumb.associators.randomized:RandomizedCompatibility",
        "clique": "tomthumb.associators.clique:PairwiseConsistency",
    },
    "estimator": {
        "ekf": "tomthumb.estimators.ekf:EKF",
        "iekf": "tomthumb.estimators.ekf:InvariantEKF",
        "fastslam": "tomthumb.estimators.fastslam:FastSLAM",
    },
    "scenario": {},  # scenarios have a catalogue of their own: tomthumb.scenarios
}

Factory = Callable[..., Any]


def names(kind: str) -> list[str]:
    """All short names of a kind: built in, then from entry points of installed packages. Imports none of them."""
    return [*_table(kind), *(name for name in _entry_points(kind) if name not in _table(kind))]


def find(kind: str, name: str) -> Factory:
    """The class or function behind a name. Raises UnknownName, or TomThumbError for a file or module without it."""
    if name in _table(kind):
        return _load(_table(kind)[name], kind)
    if ":" in name:
        return _load(name, kind)
    entries = _entry_points(kind)
    if name in entries:
        found: Factory = entries[name].load()
        return found
    raise UnknownName(kind, name, [*_table(kind), *entries])


def build(kind: str, name: str, parameters: Mapping[str, Any] | None = None, /, **given: Any) -> Any:
    """What the name stands for, built with `parameters`; `given` is what the caller supplies (models, truth).

    A parameter that does not exist is an UnknownName that lists the valid ones, a value of the wrong type a
    TomThumbError. `faithful`, which is set for all parts at once, is left out where a part knows no such thing.
    """
    factory = find(kind, name)
    known = parameters_of(factory)
    wanted = dict(parameters or {})
    if "faithful" not in known:
        wanted.pop("faithful", None)
    for key, value in wanted.items():
        if key not in known or key in given:
            raise UnknownName(f"parameter of {kind} {name!r}:", key, [k for k in known if k not in given])
        wanted[key] = checked(f"{kind}.{key}", value, known[key])
    return factory(**{key: value for key, value in given.items() if key in known}, **wanted)


def parameters_of(factory: Factory) -> dict[str, inspect.Parameter]:
    """The keyword arguments that a class or function takes, by name."""
    parameters = inspect.signature(factory).parameters.values()
    return {p.name: p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}


def checked(key: str, value: Any, parameter: inspect.Parameter) -> Any:
    """The value as the annotation wants it: whole numbers become floats; a plain type that does not fit is refused."""
    types = [part.strip() for part in str(parameter.annotation).split("|")]
    if not set(types) <= {"int", "float", "bool", "str", "None"}:
        return value  # more than a plain type: the part itself must judge
    got = "None" if value is None else type(value).__name__
    if got in types:
        return value
    if got == "int" and "float" in types:
        return float(value)
    raise TomThumbError(f"{key} must be {' or '.join(_in_words(t) for t in types)}, got {value!r}")


def _in_words(plain: str) -> str:
    words = {"int": "a whole number", "float": "a number", "bool": "true or false", "str": "a word", "None": "nothing"}
    return words[plain]


def _table(kind: str) -> dict[str, str]:
    if kind not in BUILT_IN:
        raise UnknownName("kind of part", kind, BUILT_IN)
    return BUILT_IN[kind]


def _entry_points(kind: str) -> dict[str, Any]:
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=f"tomthumb.{kind}s")}


def _load(target: str, kind: str) -> Factory:
    """``module:Name`` or ``file.py:Name``."""
    where, _, attribute = target.rpartition(":")
    module = module_at(where, f"{kind} {target!r}")
    found = getattr(module, attribute, None)
    if found is None:
        public = [
            name for name, value in vars(module).items() if callable(value) and value.__module__ == module.__name__
        ]
        raise UnknownName(f"{kind} in {where}:", attribute, public)
    factory: Factory = found
    return factory
