"""``tomthumb fetch``: a published log, verified, with its licence and citation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from tomthumb.cli import common


def fetch(
    name: Annotated[str, typer.Argument(help="Which log; without a name they are listed.")] = "",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder under which the log gets its own.")] = Path("data"),
    mirror: Annotated[str | None, typer.Option("--from", help="Another address to fetch from.")] = None,
    as_json: common.AsJson = False,
) -> None:
    """Download a log from its publisher at a pinned revision, check its SHA-256, tell its licence and citation.

    What is there already and right is not fetched again; what broke off is resumed.
    """
    from tomthumb import fetch as fetching

    if not name:
        _list(as_json)
        return
    with _bars(quiet=as_json) as progress:
        row = fetching.fetch(name, out, base=mirror, progress=progress)
    if as_json:
        common.print_json(row)
        return
    for key, value in row.items():
        typer.echo(f"{key}: {value}")


def _list(as_json: bool) -> None:
    from tomthumb.fetch import sources

    known = {
        s.name: {
            "megabytes": round(sum(f.bytes for f in s.files) / 1e6, 1),
            "licence": s.licence,
            "from": s.url,
            "address_seen": s.seen,
        }
        for s in sources().values()
    }
    if as_json:
        common.print_json(known)
        return
    for name, row in known.items():
        typer.echo(f"{name}: {row['megabytes']} MB, {row['licence']}, {row['from']}")
        typer.echo(f"    of the address, an index of public repositories has: {row['address_seen']}")
    typer.echo("Sizes and SHA-256 are those of copies on disk. The addresses were not tried when this list was made.")


@contextmanager
def _bars(quiet: bool) -> Iterator[Callable[[str, int, int], None] | None]:
    """One bar a file, on stderr."""
    from rich.console import Console

    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield None
        return
    from rich.progress import DownloadColumn, Progress

    with Progress(*Progress.get_default_columns(), DownloadColumn(), console=console) as shown:
        tasks = {}

        def tell(file: str, done: int, total: int) -> None:
            if file not in tasks:
                tasks[file] = shown.add_task(file, total=total)
            shown.update(tasks[file], completed=done)

        yield tell
