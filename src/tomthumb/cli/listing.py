"""``tomthumb list``: what there is to choose from, with every parameter and its default."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from tomthumb.cli import common

KINDS = ("scenarios", "associators", "estimators")
GIVEN = ("motion", "sensor", "truth", "rng", "self", "path")  # supplied by the loop, not by the user


def listing(
    kind: Annotated[str, typer.Argument(help=f"{', '.join(KINDS)}; all of them if left out.")] = "",
    as_json: common.AsJson = False,
) -> None:
    """List scenarios, associators and estimators, what each needs, and its parameters with their defaults."""
    from tomthumb.errors import UnknownName

    if kind and kind not in KINDS:
        raise UnknownName("kind", kind, KINDS)
    found = {each: list(_entries(each)) for each in KINDS if kind in ("", each)}
    if as_json:
        common.print_json(found)
        return
    for each, entries in found.items():
        _print_table(each, entries)


def _entries(kind: str) -> Iterator[dict[str, Any]]:
    if kind == "scenarios":
        from tomthumb.scenarios import entries, parameters

        for entry in entries().values():
            yield {
                "name": entry.name,
                "needs": entry.needs,
                "help": entry.help,
                "parameters": _plain_values(parameters(entry.name)),
            }
        return
    from tomthumb import registry

    part = kind.removesuffix("s")
    for name in registry.names(part):
        factory = registry.find(part, name)
        yield {"name": name, "help": _first_line(factory), "parameters": _defaults(factory)}


def _first_line(factory: Any) -> str:
    return (inspect.getdoc(factory) or "").split("\n\n")[0].replace("\n", " ")


def _defaults(factory: Any) -> dict[str, Any]:
    from tomthumb.registry import parameters_of

    known = parameters_of(factory)
    given = {name: p.default for name, p in known.items() if name not in GIVEN and p.default is not p.empty}
    return _plain_values(given)


def _plain_values(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _plain(value) for key, value in values.items()}


def _plain(value: Any) -> Any:
    """As JSON can hold it: infinity by name, everything that is no scalar or sequence by its text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, (bool, int, float, str, list, tuple, type(None))) else str(value)


def _print_table(kind: str, entries: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=kind, show_lines=True, expand=True)
    keys = [key for key in ("name", "needs", "help", "parameters") if key in entries[0]]
    for key in keys:
        table.add_column(key, ratio=None if key == "name" else 3 if key == "help" else 2, no_wrap=key == "name")
    for entry in entries:
        table.add_row(*(escape(_text(entry[key])) for key in keys))
    Console().print(table)


def _text(value: Any) -> str:
    return "\n".join(f"{name}={default}" for name, default in value.items()) if isinstance(value, dict) else str(value)
