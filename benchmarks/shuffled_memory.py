"""An associator for `memory.toml`: Simulated Tom Thumb whose lessons are mixed up when the teacher leaves.

Every landmark then holds what was learned about another one. It is the worst that a memory can be, short of malice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tomthumb.associators.tom_thumb import TomThumb
from tomthumb.protocols import Rng
from tomthumb.types import Association, AssociationProblem, Ids, Lessons


@dataclass(slots=True)
class ShuffledMemory:
    """`stt` with its memory on; at time `at` s, and never again, the lessons are given to the wrong landmarks."""

    at: float = 168.0
    seed: int = 0
    inner: TomThumb = field(init=False)
    done: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        self.inner = TomThumb(memory=True)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        if not self.done and problem.t >= self.at:
            known = self.inner.lessons.recall(self.inner.lessons.known())
            self.inner.remind(shuffled(known, np.random.default_rng(self.seed)))
            self.done = True
        return self.inner.associate(problem, rng)

    def learn(self, ids: Ids, t: float) -> None:
        """See `protocols.Associator`."""
        self.inner.learn(ids, t)


def shuffled(lessons: Lessons, rng: Rng) -> Lessons:
    """The same weights, under the names of other landmarks: rows and columns by two different permutations."""
    rows, columns = rng.permutation(len(lessons.ids)), rng.permutation(len(lessons.ids))
    together = lessons.together[np.ix_(rows, columns)]
    return Lessons(lessons.ids, lessons.sightings[rows], together, lessons.lately[columns], lessons.total)
