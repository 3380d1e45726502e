"""What an associator was asked and what it answered, kept for whoever wants to know why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.protocols import Associator, Rng
from tomthumb.runner import prepare
from tomthumb.types import Association, AssociationProblem, Ids, Scenario, StepRecord


@dataclass(slots=True)
class Witness:
    """Hands everything on to `inner`, and keeps each problem with each of its answers until `cases` is emptied."""

    inner: Associator
    cases: list[tuple[AssociationProblem, Association]] = field(default_factory=list)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        answers = self.inner.associate(problem, rng)
        self.cases += [(problem, answer) for answer in answers]
        return answers

    def learn(self, ids: Ids, t: float) -> None:
        """See `protocols.Associator`."""
        self.inner.learn(ids, t)


@dataclass(frozen=True, slots=True)
class Case:
    """One scan of a run: its record, what the associator (or the teacher) was asked, and the answer that was followed."""

    record: StepRecord
    problem: AssociationProblem
    answer: Association


def case_at(scenario: Scenario, step: int, **parts: Any) -> Case:
    """The case of step number `step` of a run; `parts` as for `runner.prepare`.

    Raises TomThumbError where there is no such step, or no scan in it, or the filter has diverged before.
    """
    if step < 0:
        raise TomThumbError(f"step {step}: steps are counted from 0")
    slam = prepare(scenario, **parts)
    pupil = Witness(slam.associator)
    slam.associator = pupil
    heard = [pupil]
    if slam.teacher is not None:
        heard.append(Witness(slam.teacher))
        slam.teacher = heard[1]
    record, cases = None, []
    for now in slam.stream(islice(scenario.steps, step + 1)):
        record, cases = now, [case for witness in heard for case in witness.cases]
        for witness in heard:
            witness.cases.clear()
    if slam.failure is not None:
        raise TomThumbError(f"step {step} is not reached: {slam.failure}")
    if record is None or record.index < step:
        raise TomThumbError(f"step {step} does not exist; the run has {0 if record is None else record.index + 1}")
    if not cases or not len(record.serials):
        raise TomThumbError(f"step {step} has no observations")
    return Case(record, *_followed(record, cases))


def _followed(
    record: StepRecord, cases: Sequence[tuple[AssociationProblem, Association]]
) -> tuple[AssociationProblem, Association]:
    """The problem and answer behind what the record says: with several branches the best one before need not be after."""
    agreed = []
    for problem, answer in cases:
        rows = np.flatnonzero(answer.match >= 0)
        if np.array_equal(problem.predictions.ids[answer.match[rows]], record.ids[rows]):
            agreed.append((len(rows), problem, answer))
    _, problem, answer = max(agreed, key=lambda case: case[0], default=(0, *cases[0]))
    return problem, answer
