"""``tomthumb explain``: why the observations of one scan were named as they were."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tomthumb.cli import common

if TYPE_CHECKING:
    from tomthumb.associators.explain import Explanation
    from tomthumb.types import Ids
    from tomthumb.witness import Case

Step = Annotated[int, typer.Option("--step", "-k", min=0, help="Number of the step, from 0.")]
Which = Annotated[int | None, typer.Option("--observation", "-i", min=0, help="Only this one of the scan, from 0.")]


def explain(
    scenario: common.ScenarioName,
    step: Step,
    observation: Which = None,
    associator: common.AssociatorName = "stt",
    estimator: common.EstimatorName = "iekf",
    seed: common.Seed = 0,
    sets: common.Sets = None,
    config: common.Config = None,
    as_json: common.AsJson = False,
) -> None:
    """Run up to a step and tell for each observation of its scan (or for one) why it was named so.

    Told are the gain, the narrowest gates that let the pairing through, and the runner-up, whoever the associator is.
    Landmarks go by their ids: the serial number of the observation that founded each.

    Example: tomthumb explain cloister -a jcbb --set people=30 --step 40 --observation 2
    """
    from tomthumb.errors import TomThumbError
    from tomthumb.witness import case_at

    job = common.Job(scenario, associator, estimator, seed, common.read_settings(config, sets))
    world = job.load()
    case = case_at(world, step, associator=associator, estimator=estimator, seed=seed, settings=job.parts)
    count = len(case.record.serials)
    if observation is not None and observation >= count:
        raise TomThumbError(f"observation {observation} does not exist in step {step}; valid: 0 to {count - 1}")
    chosen = range(count) if observation is None else [observation]
    truth = world.true_ids()
    rows = [_row(case, _told(case, i), truth) for i in chosen]
    if as_json:
        common.print_json({**job.about(), "step": step, "t_s": case.record.t, "observations": rows})
        return
    for i, row in zip(chosen, rows, strict=True):
        print(f"{_told(case, i)}{_after(row)}")


def _told(case: Case, i: int) -> Explanation:
    """The explanation with landmarks by their ids."""
    from tomthumb.associators.explain import explain as explained

    found, ids = explained(case.problem, case.answer, i), case.problem.predictions.ids
    named = {key: int(ids[column]) if (column := getattr(found, key)) >= 0 else -1 for key in ("landmark", "runner_up")}
    return replace(found, **named)


UNITS = {"gain": "gain_nats", "runner_up_gain": "runner_up_gain_nats", "evidence": "evidence_nats"}


def _row(case: Case, told: Explanation, truth: Ids) -> dict[str, Any]:
    """What is printed as JSON: null where there is nothing to say; true ids where they are known."""
    row: dict[str, Any] = {UNITS.get(key, key): _plain(value) for key, value in asdict(told).items()}
    serial = int(case.record.serials[told.observation])
    row |= {"lead_nats": told.lead, "serial": serial, "z": case.problem.z[told.observation].tolist()}
    return row | {"true_id": _true(truth, serial), "true_id_of_landmark": _true(truth, told.landmark)}


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _true(truth: Ids, serial: int) -> int | None:
    """The true landmark behind a serial number; -1 is clutter, None not known."""
    known = 0 <= serial < len(truth) and truth[serial] >= -1
    return int(truth[serial]) if known else None


def _after(row: Mapping[str, Any]) -> str:
    """What only the truth knows, where it does."""
    mine, theirs = row["true_id"], row["true_id_of_landmark"]
    if mine is None:
        return ""
    if row["landmark"] < 0 or theirs is None:
        return f" [in truth: {'nothing' if mine < 0 else f'landmark {mine} of the world'}]"
    return " [right]" if mine == theirs >= 0 else " [wrong]"
