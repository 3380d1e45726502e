"""``tomthumb plot``: the figures of a saved run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tomthumb.cli import common

FIGURES = ("map", "error", "consistency", "truth", "trail")


def plot(
    saved: Annotated[Path, typer.Argument(help="A folder written by --out, or its trace.npz.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the figures; the run's own if left out.")
    ] = None,
    figure: Annotated[
        list[str] | None,
        typer.Option("--figure", "-f", help=f"Repeatable: {', '.join(FIGURES)}; the first three if left out."),
    ] = None,
) -> None:
    """Draw the figures of a run saved by `tomthumb run -o DIR`, as PNG and SVG."""
    from tomthumb.errors import UnknownName
    from tomthumb.report import figures
    from tomthumb.storage import load_run, writing

    painters = figures.RUN_FIGURES | {"truth": figures.truth_figure, "trail": figures.trail_and_error_figure}
    wanted = figure or list(figures.RUN_FIGURES)
    for name in wanted:
        if name not in painters:
            raise UnknownName("figure", name, painters)
    run = load_run(saved)
    folder = out or (saved if saved.is_dir() else saved.parent)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name in wanted:
        for path in figures.save(painters[name](run), folder / name):
            common.say(str(path))
