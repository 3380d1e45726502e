"""``tomthumb report``: the rows of a grid as a static site that works offline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    folder: Annotated[Path, typer.Argument(help="The --out folder of `tomthumb bench`.")],
    grid: Annotated[Path | None, typer.Option(help="GRID.toml; by default the one the rows were made with.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Where to write; FOLDER/report by default.")] = None,
    pages: Annotated[int | None, typer.Option(min=0, help="Runs to repeat and draw; the grid's number.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes that draw; all cores by default.")] = None,
) -> None:
    """Write the report of a grid: tables that sort, verdicts, figures, a page for every run, rows to download."""
    from rich.console import Console

    from tomthumb.bench.session import cores, grid_of
    from tomthumb.site import build

    console = Console(stderr=True)
    with console.status("reading") as status:
        chosen = grid_of(folder, grid)
        first = build(chosen, folder, out, pages=pages, workers=workers or cores(), tell=status.update)
    typer.echo(str(first))
