"""Everything a grid names is built once before anything runs; and how long all of it may take."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from tomthumb.bench.execute import load_world, measured
from tomthumb.bench.grid import Grid
from tomthumb.bench.spec import Part, RunSpec
from tomthumb.errors import TomThumbError
from tomthumb.runner import prepare
from tomthumb.types import Scenario, Step

PILOT_STEPS = 60
PILOT_BUDGET_S = 30.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """How many runs are still to do and about how long one core needs for them, s; `sure` share of it measured."""

    runs: int
    seconds: float
    measured: float


def validate(grid: Grid) -> None:
    """Build every world and every method once. Raises TomThumbError naming the entry that does not work."""
    methods = list(grid.methods().values())
    for i, part in enumerate(grid.scenarios):
        with_world = _built(part, grid.seeds[0])
        for method in methods if i == 0 else methods[:1]:
            _prepare(with_world, method)


def _built(part: Part, seed: int) -> Scenario:
    try:
        scenario = load_world({"scenario": {"use": part.use, "params": part.params}, "seed": seed})
    except TomThumbError as reason:
        raise TomThumbError(f"[[scenario]] {part.label!r}: {reason}") from None
    return scenario


def _prepare(scenario: Scenario, method: tuple[Part, Part, Part]) -> None:
    estimator, associator, slam = method
    settings = {"estimator": estimator.params, "associator": associator.params, "slam": slam.params}
    try:
        prepare(scenario, associator=associator.use, estimator=estimator.use, settings=settings)
    except TomThumbError as reason:
        raise TomThumbError(f"{associator.label!r} with {estimator.label!r}, {slam.label!r}: {reason}") from None


def estimate(runs: Sequence[RunSpec], known: Mapping[str, float]) -> Estimate:
    """About how long `runs` take on one core: from the seconds `known` by case, else from the first steps of a pilot.

    Pilots stop when their budget is spent; cases without one are taken to cost the mean of the others.
    """
    costs = dict(known)
    deadline = time.monotonic() + PILOT_BUDGET_S
    for run in {run.case: run for run in runs}.values():
        if run.case not in costs and time.monotonic() < deadline:
            costs[run.case] = pilot(run)
    counted = [costs[run.case] for run in runs if run.case in costs]
    mean = sum(counted) / len(counted) if counted else 0.0
    return Estimate(len(runs), mean * len(runs), len(counted) / len(runs) if runs else 1.0)


def pilot(run: RunSpec) -> float:
    """Seconds that `run` may take: its first steps, kernels warm, scaled to its length."""
    job = run.job()
    started = time.perf_counter()
    scenario = load_world(job)
    loading = time.perf_counter() - started
    short = replace(scenario, steps=list(islice(scenario.steps, PILOT_STEPS)), score_from=1, teach_steps=0)
    measured(short, job)
    started = time.perf_counter()
    measured(short, job)
    return loading + (time.perf_counter() - started) * _length(scenario.steps) / max(len(short.steps), 1)


def _length(steps: Iterable[Step]) -> int:
    return len(steps) if isinstance(steps, Sequence) else sum(1 for _ in steps)
