"""What the commands share: options, settings, progress on stderr, rows."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tomthumb.config import Settings
    from tomthumb.storage import SavedRun
    from tomthumb.types import Scenario, StepRecord

ScenarioName = Annotated[
    str, typer.Argument(help="A scenario by name, a folder or file of a known log, or kind:path?key=value.")
]
AssociatorName = Annotated[
    str,
    typer.Option(
        "--associator", "-a", help="Who names the observations: a name, package.module:Class, ./file.py:Class."
    ),
]
EstimatorName = Annotated[str, typer.Option("--estimator", "-e", help="Who keeps the belief: a name as above.")]
Seed = Annotated[int, typer.Option("--seed", "-s", min=0, help="Seed of the world, the estimator and the associator.")]
Sets = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Repeatable. Bare keys go to the scenario, associator.KEY, estimator.KEY and slam.KEY to the parts.",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config", "-c", help="TOML with [scenario], [associator], [estimator], [slam]; --set comes after it."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")]


@dataclass(frozen=True)
class Job:
    """One run as asked for: names, seed and settings by part."""

    scenario: str
    associator: str = "stt"
    estimator: str = "iekf"
    seed: int = 0
    settings: Settings = field(default_factory=dict)

    def load(self) -> Scenario:
        """The scenario, with its own settings. Raises TomThumbError."""
        from tomthumb.scenarios import load

        return load(self.scenario, seed=self.seed, **self.settings.get("scenario", {}))

    @property
    def parts(self) -> dict[str, Mapping[str, Any]]:
        """The settings of all parts but the scenario."""
        return {part: values for part, values in self.settings.items() if part != "scenario"}

    def about(self) -> dict[str, Any]:
        """What to write beside the results."""
        return {
            "scenario": self.scenario,
            "associator": self.associator,
            "estimator": self.estimator,
            "seed": self.seed,
            "settings": {part: values for part, values in self.settings.items() if values},
        }


def job_of(about: Mapping[str, Any]) -> Job:
    """The job that a saved run tells of."""
    return Job(**about)


def read_settings(config: Path | None, sets: list[str] | None) -> Settings:
    """The file, then the --set options over it."""
    from tomthumb.config import empty, join, parse_sets, read_file

    return join(read_file(config) if config else empty(), parse_sets(sets or []))


def execute(
    job: Job, scenario: Scenario, start_map: Any = None, lessons: Any = None, quiet: bool = False, title: str = ""
) -> tuple[Row, SavedRun]:
    """Run and score: the row for tables and JSON, and the run with its truth for figures."""
    from tomthumb.metrics import collect, evaluate
    from tomthumb.runner import run
    from tomthumb.storage import SavedRun

    with progress(title or f"{job.scenario}: {job.associator}", scenario, quiet) as step:
        trace = run(
            scenario,
            associator=job.associator,
            estimator=job.estimator,
            seed=job.seed,
            settings=job.parts,
            start_map=start_map,
            lessons=lessons,
            progress=step,
        )
    row = job.about() | evaluate(trace, scenario)
    return row, SavedRun(trace, collect(scenario, trace), job.about())


Row = dict[str, Any]


@contextmanager
def progress(title: str, scenario: Scenario, quiet: bool) -> Iterator[Callable[[StepRecord], None] | None]:
    """A bar on stderr that goes away when done; nothing when `quiet` or when nobody is watching."""
    from rich.console import Console

    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} steps"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=len(scenario.steps) if hasattr(scenario.steps, "__len__") else None)
        yield lambda record: bar.update(task, completed=record.index + 1)


def say(text: str) -> None:
    """A line for whoever watches; never on stdout, which belongs to the result."""
    print(text, file=sys.stderr)


def print_json(row: Mapping[str, Any]) -> None:
    """One object, without NaN by construction."""
    print(json.dumps(row, allow_nan=False, default=str))


def command_line() -> str:
    """The command as it was typed."""
    return shlex.join(["tomthumb", *sys.argv[1:]])
