"""``tomthumb demo``: the main job on the built-in cloister, and the paper's figures 5 to 7."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tomthumb.cli import common

if TYPE_CHECKING:
    from tomthumb.report.page import Picture
    from tomthumb.storage import SavedRun

UNTAUGHT: dict[str, Any] = {}
TAUGHT: dict[str, Any] = {"laps": 2, "teach": 1}


@dataclass(frozen=True)
class Contender:
    """A line of the table: what it is called, who names the observations, and in which world."""

    label: str
    associator: str
    world: dict[str, Any]


CONTENDERS = (
    Contender("ground truth", "oracle", UNTAUGHT),
    Contender("NN", "nn", UNTAUGHT),
    Contender("JCBB", "jcbb", UNTAUGHT),
    Contender("STT untaught", "stt", UNTAUGHT),
    Contender("STT taught", "stt", TAUGHT),
)


@dataclass(frozen=True)
class Outcome:
    """A contender's row and run."""

    row: common.Row
    run: SavedRun


def demo(
    associators: Annotated[
        list[str] | None, typer.Option("--associator", "-a", help="Repeatable: another one to put into the table.")
    ] = None,
    seed: common.Seed = 0,
    sets: common.Sets = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the figures and report.html.")] = Path(
        "demo-out"
    ),
    as_json: common.AsJson = False,
) -> None:
    """Who is who in the cloister: ground truth, NN, JCBB and STT on the paper's world, side by side.

    A robot with drifting odometry goes round a square; each associator has to say which observation is which landmark.
    Example of your own beside them: tomthumb demo --associator ./examples/my_associator.py:Mine
    """
    contenders = [*CONTENDERS, *(Contender(name, name, UNTAUGHT) for name in associators or [])]
    jobs = [_job(contender, seed, sets) for contender in contenders]
    with _compiling_ahead():
        outcomes = [_run(c.label, job, as_json) for c, job in zip(contenders, jobs, strict=True)]
    write_outputs(out, outcomes, seed)
    if as_json:
        common.print_json({"rows": [outcome.row for outcome in outcomes]})
    else:
        _print(outcomes, out)


@contextmanager
def _compiling_ahead() -> Iterator[None]:
    """The first time, compiling takes longer than running: a second process fills the cache with what STT needs."""
    if (os.cpu_count() or 1) < 2:
        yield
        return
    code = "from tomthumb.cli.main import main; main()"
    command = [sys.executable, "-c", code, "run", "cloister", "--associator", "stt", "--json"]
    ahead = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        ahead.terminate()
        ahead.wait()


def _job(contender: Contender, seed: int, sets: list[str] | None) -> common.Job:
    settings = common.read_settings(None, sets)
    settings["scenario"] = {**settings["scenario"], **contender.world}
    return common.Job("cloister", contender.associator, seed=seed, settings=settings)


def _run(label: str, job: common.Job, quiet: bool) -> Outcome:
    row, run = common.execute(job, job.load(), quiet=quiet, title=label)
    return Outcome({"label": label} | row, run)


def write_outputs(folder: Path, outcomes: Sequence[Outcome], seed: int) -> None:
    """The paper's figures, one of every further contender, and the page. Raises TomThumbError."""
    from tomthumb.report import figures, page, tables
    from tomthumb.storage import writing

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    pictures = _pictures(outcomes)
    for name, picture in pictures.items():
        figures.save(picture.figure, folder / name)
    body = f"<p>{_INTRODUCTION}</p>" + page.comparison_table(tables.OVERVIEW, [o.row for o in outcomes], "label")
    body += page.pictures_html(list(pictures.values()))
    title = f"tomthumb demo: who is who in the cloister (seed {seed})"
    page.save(folder / "report.html", page.page(title, body, common.command_line()))


_INTRODUCTION = (
    "A robot walks round a square between two double walls of 88 landmarks, with noisy odometry. Each line is the same "
    "filter on the same readings; only who says which observation is which landmark differs. The taught line is shown "
    "the truth for one lap and scored on the next. One seed is an example, not a statistic."
)


def _pictures(outcomes: Sequence[Outcome]) -> dict[str, Picture]:
    """Figure 5, then trail and error of every other contender; JCBB and STT carry the paper's numbers."""
    from tomthumb.report.figures import trail_and_error_figure, truth_figure
    from tomthumb.report.page import Picture

    pictures = {"figure_5_ground_truth": Picture("Figure 5: ground truth", truth_figure(outcomes[0].run), _FIGURE_5)}
    for outcome in outcomes[1:]:
        label, associator = outcome.row["label"], outcome.row["associator"]
        number = _PAPER.get(label, "")
        name = (f"figure_{number.split()[-1]}_" if number else "") + _file_name(label)
        figure = trail_and_error_figure(outcome.run, label)
        title = f"{number}: {label}" if number else f"Trail and error: {label}"
        pictures[name] = Picture(title, figure, _FIGURE_6.format(associator=associator))
    return pictures


_PAPER = {"JCBB": "Figure 6", "STT taught": "Figure 7"}
_FIGURE_5 = "Red: the true landmarks and the true path of the robot, as in the paper's figure 5."
_FIGURE_6 = (
    "Trail, map and the errors in x and y with their 99 % bounds, associations by {associator}. Crosses on the trail: "
    "scans in which an observation was missed (orange) or wrongly paired (black)."
)


_WIDE = 130  # columns of a terminal that take the whole table


def _file_name(label: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in label.lower()).strip("_").replace("__", "_")


def _print(outcomes: Sequence[Outcome], out: Path) -> None:
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from tomthumb.report.tables import NARROW, OVERVIEW

    console = Console()
    columns = OVERVIEW if console.width >= _WIDE else [c for c in OVERVIEW if c.key in NARROW]
    table = Table(title="who is who in the cloister", box=SIMPLE, padding=0)
    table.add_column("")
    for column in columns:
        table.add_column(column.heading, justify="right")
    for outcome in outcomes:
        table.add_row(escape(outcome.row["label"]), *(column.text(outcome.row) for column in columns))
    console.print(table)
    for outcome in outcomes:
        if outcome.row["failure"]:
            common.say(f"{outcome.row['label']}: the filter failed: {outcome.row['failure']}")
    common.say(f"figures and report: {out / 'report.html'}")
