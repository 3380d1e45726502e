"""``tomthumb info``: what is in a log, and what settings it suggests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from tomthumb.cli import common

Suggest = Annotated[bool, typer.Option("--suggest", help="Estimate noise, detection and clutter, and print settings.")]


def info(
    scenario: common.ScenarioName,
    seed: common.Seed = 0,
    sets: common.Sets = None,
    suggest: Suggest = False,
    as_json: common.AsJson = False,
) -> None:
    """Tell what a scenario or log holds: steps, scans, spacing against noise, drift of dead reckoning, truth.

    Example: tomthumb info ../shared/data/car_park --suggest
    """
    from tomthumb.scenarios import inspection

    world = common.Job(scenario, seed=seed, settings=common.read_settings(None, sets)).load()
    row = inspection.info(world)
    if suggest:
        row["suggested"] = inspection.suggest(world)
    if as_json:
        common.print_json(row)
    else:
        _print(row)


def _print(row: Mapping[str, Any]) -> None:
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=SIMPLE, show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for key, value in _flat(row):
        table.add_row(key, escape(value))
    Console(highlight=False).print(table)


def _flat(row: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested tables as dotted keys, numbers to four digits."""
    for key, value in row.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
