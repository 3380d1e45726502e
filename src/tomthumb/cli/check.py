"""``tomthumb check``: does a foreign associator or estimator keep the contract?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from tomthumb.cli import common

if TYPE_CHECKING:
    from tomthumb import testing


def check(
    name: Annotated[str, typer.Argument(help="./file.py:Class, package.module:Class, or a registered name.")],
    sets: common.Sets = None,
    as_json: common.AsJson = False,
) -> None:
    """Check that an associator (or an estimator) keeps the contract of `docs/extending.md`; exit code 1 if it does not.

    Example: tomthumb check ./examples/my_associator.py:Mine --set gate=0.99
    """
    from tomthumb import testing
    from tomthumb.config import parse_sets

    results = testing.check(name, parse_sets(sets or []))
    if as_json:
        common.print_json({"name": name, "passed": not any(r.problem for r in results), "checks": _rows(results)})
    else:
        _print(name, results)
    if any(r.problem for r in results):
        raise typer.Exit(1)


def _rows(results: list[testing.Result]) -> list[dict[str, str | None]]:
    return [{"check": r.name, "problem": r.problem} for r in results]


def _print(name: str, results: list[testing.Result]) -> None:
    from rich.console import Console

    console = Console(highlight=False)
    for result in results:
        mark = "[green]ok[/]  " if result.problem is None else "[red]FAIL[/]"
        console.print(mark, result.name.replace("_", " "), "" if result.problem is None else f": {result.problem}")
    failed = sum(r.problem is not None for r in results)
    console.print(f"{name}: {len(results) - failed} of {len(results)} checks passed")
