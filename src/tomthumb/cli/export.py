"""``tomthumb export``: a saved run on its way to other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tomthumb.cli import common

Format = Annotated[
    str | None,
    typer.Option(
        "--format", "-f", help="tum, kitti, json, csv, g2o, parquet, rrd, gif, mp4, rosbag; by the suffix if left out."
    ),
]


def export(
    saved: Annotated[Path, typer.Argument(help="A folder written by `tomthumb run -o`, or its trace.npz.")],
    out: Annotated[Path, typer.Argument(help="File (or folder, for csv, parquet and rosbag) to write.")],
    format: Format = None,
) -> None:
    """Write a saved run for evo, g2o, rerun, notebooks or as a film.

    Example: tomthumb run cloister -o out && tomthumb export out run.g2o
    """
    from tomthumb.export import export as write
    from tomthumb.storage import load_run

    run = load_run(saved)
    write(run.trace, out, format=format, scenario=common.job_of(run.about).load() if run.about else None)
    common.say(str(out))
