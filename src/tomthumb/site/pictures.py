"""What a run's page shows, as compact plain data. The run is repeated for it (same seed, same result) and then checked.

So no trace is kept for ten thousand runs of which a few are ever looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tomthumb.bench.execute import DONE, Executor, Job, Row, run_world
from tomthumb.bench.grid import Grid
from tomthumb.bench.measures import is_time_or_place
from tomthumb.bench.supervisor import run_jobs
from tomthumb.geometry import wrap
from tomthumb.metrics import decide, score
from tomthumb.metrics.decisions import FN, FP, NAMES, Decisions
from tomthumb.metrics.lifetimes import step_of_observation
from tomthumb.metrics.truth import TruthTable, collect
from tomthumb.types import Array, Ids, Scenario, Trace

RUNNER = "tomthumb.site.pictures:painter"
SIGMA_99 = 2.576
MOST_POINTS = 4000
MOST_MISTAKES = 200
DIGITS = 3  # millimetres
Picture = dict[str, Any]


def painter(memory_mb: float | None) -> Executor:
    """A worker's runner that answers with pictures in place of metrics."""
    return Executor(memory_mb, measure=lambda scenario, job: {"picture": draw(scenario, job)})


def choose(rows: Sequence[Mapping[str, Any]], count: int, show: int | None = None) -> list[int]:
    """Rows to draw, at most `count`: those of seed `show`, then of each method in each scenario the worst, the median,
    the next worst and so on, in turn.
    """
    cells: dict[tuple[str, str], list[int]] = {}
    for i, row in enumerate(rows):
        if row["status"] == DONE:
            cells.setdefault((row["scenario"], row["method"]), []).append(i)
    queues = [_interesting(rows, members) for members in cells.values()]
    chosen = [i for members in cells.values() for i in members if rows[i]["seed"] == show][:count]
    queues = [[i for i in queue if i not in chosen] for queue in queues]
    while len(chosen) < count and any(queues):
        chosen += [queue.pop(0) for queue in queues if queue]
    return sorted(chosen[:count])


def _interesting(rows: Sequence[Mapping[str, Any]], members: list[int]) -> list[int]:
    def badness(i: int) -> tuple[bool, float, float]:
        row = rows[i]
        return row.get("failure") is None, row.get("match_rate") or 0.0, -(row.get("ate_m") or 0.0)

    order = sorted(members, key=badness)
    middle = order.pop(len(order) // 2) if len(order) > 1 else None
    return order if middle is None else [order[0], middle, *order[1:]]


def paint(
    rows: Sequence[Mapping[str, Any]],
    chosen: Sequence[int],
    grid: Grid,
    workers: int,
    tell: Callable[[int], None] = lambda count: None,
) -> dict[int, Picture]:
    """Pictures of the chosen rows; a run that cannot be repeated has one that says why."""
    specs = {run.key: run for run in grid.runs()}
    place = {rows[i]["key"]: i for i in chosen if rows[i]["key"] in specs}
    found: dict[int, Picture] = {}

    def record(drawn: list[Row]) -> None:
        for row in drawn:
            i = place[row["key"]]
            found[i] = _checked(row, rows[i])
        tell(len(drawn))

    run_jobs([specs[key].job() for key in place], record, workers=workers, limits=grid.limits, runner=RUNNER)
    for i in chosen:
        found.setdefault(i, {"note": "The code or the data have changed since: this run cannot be drawn any more."})
    return found


def _checked(drawn: Row, row: Mapping[str, Any]) -> Picture:
    if drawn["status"] != DONE:
        return {"note": f"Repeating the run failed: {drawn['reason']}"}
    picture: Picture = drawn["metrics"]["picture"]
    again = {key: value for key, value in picture.pop("metrics").items() if not is_time_or_place(key)}
    different = [key for key, value in again.items() if key in row and row[key] != value]
    note = "Repeated for this page: every figure is that of the row."
    if different:
        note = f"Repeated for this page, with other figures than the row in {', '.join(different)}."
    return {**picture, "note": note}


def draw(scenario: Scenario, job: Job) -> Picture:
    """Run a job and keep what its page shows: poses, errors with 99 % bounds, map, associations, the first mistake."""
    trace: Trace = run_world(scenario, job)
    truth = collect(scenario, trace)
    decisions = decide(trace, truth)
    seen = points(scenario, trace)
    return {
        "metrics": score(trace, truth),
        "pose": rounded(trace.pose[:, :2]),
        "truth": rounded(truth.pose[:, :2]) if np.isfinite(truth.pose).any() else None,
        "landmarks": None if truth.landmarks is None else rounded(truth.landmarks),
        "map": rounded(trace.final.landmarks[trace.final.stone]),
        "crumbs": rounded(trace.final.landmarks[~trace.final.stone]),
        **errors(trace, truth),
        **associations(trace, decisions, seen),
        "first": first_mistake(trace, truth, decisions, seen),
    }


def points(scenario: Scenario, trace: Trace) -> Array:
    """Where each observation (M, 2) lies in the world, seen from the pose given out at its step, m."""
    parts = [np.empty((0, 2))]
    for pose, step in zip(trace.pose, scenario.steps, strict=False):
        if step.observations is not None:
            parts.append(scenario.sensor.locate(pose, step.observations.z)[0])
    return np.vstack(parts)


def errors(trace: Trace, truth: TruthTable) -> Picture:
    """Errors in x, y and heading with their 99 % bounds, over time; thinned to what a screen can show."""
    rows = np.unique(np.linspace(0, len(trace.t) - 1, min(len(trace.t), MOST_POINTS)).astype(int))
    error = trace.pose - truth.pose
    error[:, 2] = wrap(error[:, 2])
    bound = SIGMA_99 * np.sqrt(np.maximum(np.einsum("kii->ki", trace.pose_cov), 0.0))
    return {"t": rounded(trace.t[rows]), "error": rounded(error[rows], 5), "bound": rounded(bound[rows], 5)}


def associations(trace: Trace, decisions: Decisions, seen: Array) -> Picture:
    """Where the right and the wrong decisions fell, and from where the wrong ones were made."""
    wrong = np.flatnonzero(np.isin(decisions.outcome, (FP, FN)))
    right = np.flatnonzero((decisions.outcome > 0) & ~np.isin(decisions.outcome, (FP, FN)))
    right = right[:: max(1, len(right) // MOST_POINTS)]
    step = step_of_observation(trace.offsets)
    shown = wrong[:MOST_MISTAKES]
    return {
        "right": rounded(seen[right]),
        "wrong": rounded(np.hstack([trace.pose[step[shown], :2], seen[shown]])),
        "mistakes": len(wrong),
    }


def first_mistake(trace: Trace, truth: TruthTable, decisions: Decisions, seen: Array) -> Picture | None:
    """The first scan with a wrong decision: where the robot was, what it saw, what it took it for and what it was."""
    wrong = np.flatnonzero(np.isin(decisions.outcome, (FP, FN)))
    if len(wrong) == 0:
        return None
    first = int(wrong[0])
    step = int(step_of_observation(trace.offsets)[first])
    scan = np.arange(trace.offsets[step], trace.offsets[step + 1])
    return {
        "step": step,
        "t": float(trace.t[step]),
        "pose": rounded(trace.pose[step]),
        "true_pose": rounded(truth.pose[step]),
        "scan": rounded(seen[scan]),
        "outcomes": [NAMES[k] for k in decisions.outcome[scan].tolist()],
        "at": rounded(seen[first]),
        "taken_for": _place_of(trace, int(trace.ids[first])) if trace.paired[first] else None,
        "was": _true_place(truth, int(truth.ids[first])),
        "text": _in_words(trace, truth, decisions, first, step),
    }


def _place_of(trace: Trace, landmark: int) -> list[float] | None:
    found = np.flatnonzero(trace.final.ids == landmark)
    return rounded(trace.final.landmarks[found[0]]) if len(found) else None


def _true_place(truth: TruthTable, identity: int) -> list[float] | None:
    if truth.landmarks is None or not 0 <= identity < len(truth.landmarks):
        return None
    return rounded(truth.landmarks[identity])


def _in_words(trace: Trace, truth: TruthTable, decisions: Decisions, row: int, step: int) -> str:
    was = _named(truth.ids, row)
    head = f"Step {step}, {trace.t[step]:.2f} s, observation {row}: "
    if decisions.outcome[row] == FN:
        return f"{head}{was} was in the map already, and was not recognised."
    taken = _named(truth.ids, int(trace.ids[row])) if 0 <= trace.ids[row] < len(truth.ids) else "something"
    return f"{head}{was} was taken for landmark {int(trace.ids[row])}, which is {taken}."


def _named(ids: Ids, row: int) -> str:
    return f"true landmark {int(ids[row])}" if ids[row] >= 0 else "clutter" if ids[row] == -1 else "something unknown"


def rounded(values: Array, digits: int = DIGITS) -> list[Any]:
    """Plain lists; None where not finite."""
    values = np.asarray(values, float)
    plain = np.round(values, digits).astype(object)
    plain[~np.isfinite(values)] = None
    listed: list[Any] = plain.tolist()
    return listed
