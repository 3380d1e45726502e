"""``tomthumb run``: one scenario, one associator, one estimator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tomthumb.cli import common

if TYPE_CHECKING:
    from tomthumb.storage import SavedRun

Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder for trajectory.tum, map.csv, trace.npz, figures, report.html."),
]
Map = Annotated[
    Path | None, typer.Option("--map", help="Start in a saved map: map.csv, trace.npz or a folder of --out.")
]


def run(
    scenario: common.ScenarioName,
    associator: common.AssociatorName = "stt",
    estimator: common.EstimatorName = "iekf",
    seed: common.Seed = 0,
    sets: common.Sets = None,
    config: common.Config = None,
    as_json: common.AsJson = False,
    out: Out = None,
    start_map: Map = None,
) -> None:
    """Run one scenario and print how good it was.

    Examples: tomthumb run cloister -a jcbb --set people=30; tomthumb run ../shared/data/car_park -o out/car_park
    """
    job = common.Job(scenario, associator, estimator, seed, common.read_settings(config, sets))
    world, (known, lessons) = job.load(), _known(start_map)
    row, saved = common.execute(job, world, known, lessons, quiet=as_json)
    if out is not None:
        write_outputs(out, row, saved)
    if as_json:
        common.print_json(row)
    else:
        _print_row(row, out)


def _known(path: Path | None) -> tuple[object, object]:
    """The map to start in, and what was learned about its landmarks (--set associator.memory=true uses it)."""
    if path is None:
        return None, None
    from tomthumb.storage import load_lessons, load_map

    return load_map(path), load_lessons(path)


def write_outputs(folder: Path, row: common.Row, saved: SavedRun) -> None:
    """Everything of one run: the files of `storage.save_run`, figures as PNG and SVG, and the page."""
    from tomthumb.report import figures, page
    from tomthumb.storage import save_run

    save_run(folder, saved)
    drawn = {name: paint(saved) for name, paint in figures.RUN_FIGURES.items()}
    for name, figure in drawn.items():
        figures.save(figure, folder / name)
    pictures = [page.Picture(*CAPTIONS[name][:1], figure, CAPTIONS[name][1]) for name, figure in drawn.items()]
    page.save(folder / "report.html", page.run_page(row, pictures, common.command_line()))


CAPTIONS = {
    "map": (
        "Trail and map",
        "True path and landmarks in red where they are known; estimated path, landmarks and their 99 % ellipses in "
        "blue. Crosses on the path show where an observation was missed or wrongly paired.",
    ),
    "error": ("Errors of the pose", "Estimated minus true, without alignment; shaded: 2.576 sigma of the filter."),
    "consistency": (
        "Mistakes and consistency",
        "Mistakes of each scan; normalised squared errors of the pose and of the innovations with the band that 95 % "
        "of them should keep to.",
    ),
}


def _print_row(row: common.Row, out: Path | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from tomthumb.report.tables import GROUPS

    table = Table(
        title=f"{row['scenario']}: {row['associator']}, {row['estimator']}, seed {row['seed']}", show_header=False
    )
    table.add_column(justify="left", style="bold")
    table.add_column(justify="right")
    table.add_column(style="dim")
    for name, columns in GROUPS.items():
        table.add_section()
        for k, column in enumerate(columns):
            table.add_row(f"{column.heading}", column.text(row), column.meaning if k else f"{column.meaning} [{name}]")
    Console().print(table)
    if row["failure"]:
        common.say(f"the filter failed: {row['failure']}")
    if out is not None:
        common.say(f"written to {out}: report.html, figures, trajectory.tum, map.csv, trace.npz")
