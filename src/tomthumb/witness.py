"""What an associator was asked and what it answered, kept for whoever wants to know why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from tomthumb.errors import TomThumbError
from tomthumb.protocols import Associator, Rng
from tomthumb.runner import prepare
from tomthumb.types import Association, AssociationProblem, Ids, Scenario, StepRecord


@dataclass(slots=True)
class Witness:
    """Hands everything on to `inner`, and keeps each problem with the best answer until `cases` is emptied."""

    inner: Associator
    cases: list[tuple[AssociationProblem, Association]] = field(default_factory=list)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        answers = self.inner.associate(problem, rng)
        self.cases.append((problem, answers[0]))
        return answers

    def learn(self, ids: Ids, t: float) -> None:
        """See `protocols.Associator`."""
        self.inner.learn(ids, t)


@dataclass(frozen=True, slots=True)
class Case:
    """One scan of a run: its record, what the best branch's associator (or the teacher) was asked, and the answer."""

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
    return Case(record, *cases[0])
