"""``tomthumb forest``: the paper's figure 4 in a grid world, as numbers, live, or as an animation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tomthumb.forest import Forest, Outcome, Rules

_COLUMNS = ("seed", "iterations", "moves", "distance", "ogre_visits", "award", "home")


def forest(
    seed: Annotated[int, typer.Option("--seed", "-s", min=0, help="Seed of the forest and of the family.")] = 1,
    runs: Annotated[int, typer.Option("--runs", "-n", min=1, help="How many tales: seed, seed + 1, ...")] = 1,
    size: Annotated[int, typer.Option(help="Cells on a side.")] = 32,
    mountains: Annotated[float, typer.Option(help="Share of cells that block, 0 to 0.5.")] = 0.05,
    palaces: Annotated[int, typer.Option(min=0, help="How many kings.")] = 1,
    award: Annotated[float, typer.Option(min=0.0, help="What a king gives; inf stops at once (step 27).")] = 1.0,
    world: Annotated[
        Path | None,
        typer.Option("--map", help="Forest drawn in letters: . ^ H O K and a to z; instead of a random one."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Repeatable. A rule: lam=1.5, boots=4, stones=always, ..."),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Watch it in the terminal.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write an animation: .gif, .html, .mp4 (with ffmpeg), or a .png.")
    ] = None,
    fps: Annotated[float, typer.Option(min=0.0, help="Frames a second of --live and --out.")] = 8.0,
    frames: Annotated[int, typer.Option(min=2, help="Most frames of an animation, about.")] = 160,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")] = False,
) -> None:
    """Walk Tom Thumb's family through a forest: the paper's algorithm, figure 4, step by step."""
    import numpy as np

    from tomthumb.forest import tell

    rules = _rules(sets or [])
    told: list[tuple[int, Outcome]] = []
    for number in range(seed, seed + runs):
        here = _world(world, number, size, mountains, palaces, award)
        if number == seed and (live or out is not None):
            told.append((number, _watch(here, number, rules, live, out, fps, frames)))
        else:
            told.append((number, tell(here, np.random.default_rng([number, 1]), rules)))
    _print(told, as_json)


def _rules(sets: list[str]) -> Rules:
    from tomthumb.config import parse_value
    from tomthumb.errors import TomThumbError
    from tomthumb.forest.rules import rules_from

    values: dict[str, object] = {}
    for text in sets:
        key, equals, value = text.partition("=")
        if not equals:
            raise TomThumbError(f"--set {text!r}: write key=value, as in --set lam=1.5")
        values[key.strip()] = parse_value(value.strip())
    return rules_from(values)


def _world(path: Path | None, seed: int, size: int, mountains: float, palaces: int, award: float) -> Forest:
    import numpy as np

    from tomthumb.errors import BrokenFile, TomThumbError
    from tomthumb.forest import plant, read_forest

    if path is None:
        return plant(np.random.default_rng([seed, 0]), size, mountains, palaces=palaces, award=award)
    try:
        return read_forest(path.read_text("utf-8"), award)
    except (OSError, UnicodeDecodeError) as reason:
        raise BrokenFile(path, f"cannot be read: {reason}") from None
    except TomThumbError as reason:
        raise BrokenFile(path, str(reason)) from None


def _watch(here: Forest, seed: int, rules: Rules, live: bool, out: Path | None, fps: float, most: int) -> Outcome:
    """Tell one tale to the terminal, or to a file, or both."""
    import numpy as np

    from tomthumb.forest import Event, simulated_tom_thumb
    from tomthumb.forest.animation import animate, check_target
    from tomthumb.forest.frames import frames, gather
    from tomthumb.forest.tell import outcome_of

    if out is not None:
        check_target(out, max(here.shape))
    events: list[Event] = []

    def noted() -> Any:
        for event in simulated_tom_thumb(here, np.random.default_rng([seed, 1]), rules, chunk=8):
            events.append(event)
            yield event

    moments = frames(noted(), rules.tau)
    if live:
        from rich.console import Console

        from tomthumb.forest.terminal import show_live

        moments = show_live(here, moments, Console(stderr=True), fps)
    taken = gather(moments, most)
    if out is not None:
        animate(here, taken, out, fps or 8.0)
    return outcome_of(events)


def _print(told: list[tuple[int, Outcome]], as_json: bool) -> None:
    from tomthumb.forest.tell import as_json as plain

    rows = [{"seed": seed} | plain(outcome) for seed, outcome in told]
    if as_json:
        import json

        print(json.dumps(rows[0] if len(rows) == 1 else {"runs": rows, "mean": _means(rows)}, allow_nan=False))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(*_COLUMNS)
    for row in rows:
        table.add_row(*("INFINITY" if c == "award" and row["award_infinite"] else str(row[c]) for c in _COLUMNS))
    Console().print(table)
    if len(rows) > 1:
        print("mean  " + "  ".join(f"{name} {value:.1f}" for name, value in _means(rows).items()))


def _means(rows: list[dict[str, Any]]) -> dict[str, float]:
    names = ("iterations", "moves", "distance", "ogre_visits")
    return {name: sum(row[name] for row in rows) / len(rows) for name in names}
