"""What the memory changes decision by decision: in the very same scans, with the very same filter, without and with it.

    python benchmarks/memory_decisions.py [--seeds 20] [--write docs/parts.md]

Whole runs with bad odometry drift apart after one other decision, and then tell of luck. Here the run goes on with what
was decided without a memory; the memory is asked beside it, and it and a mixed-up one (`shuffled_memory`) learn the same.
A decision is right if the observation gets a landmark that was founded by the same thing, or none where there is none.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from paired import write
from shuffled_memory import ShuffledMemory

from tomthumb.associators.tom_thumb import TomThumb
from tomthumb.protocols import Rng
from tomthumb.runner import prepare
from tomthumb.scenarios.cloister import cloister
from tomthumb.types import Association, AssociationProblem, Ids, Mask

WORLDS = {
    "odometry x8": {"odometry_noise": 8.0},
    "odometry x8, jittered": {"odometry_noise": 8.0, "jitter": 0.2},
    "sensor x3": {"sensor_noise": 3.0},
    "clutter 5, seen 0.8": {"clutter": 5.0, "detect": 0.8},
}
ROUTES = ("round", "reversed", "shuttle")
METHODS = ("on", "mixed up")


@dataclass(slots=True)
class Beside:
    """`stt` without a memory; those with one are asked as well, and `counts` says what they would have changed.

    Of each method: decisions, those that differ, those that were wrong and would be right, and the other way round.
    """

    truth: Ids
    taught: float
    plain: TomThumb = field(default_factory=TomThumb)
    others: dict[str, TomThumb | ShuffledMemory] = field(init=False)
    counts: dict[str, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        self.others = {"on": TomThumb(memory=True), "mixed up": ShuffledMemory(at=self.taught)}
        self.counts = {method: np.zeros(4) for method in METHODS}

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        state = rng.bit_generator.state
        answers = self.plain.associate(problem, rng)
        after = rng.bit_generator.state
        before = self._right(problem, answers[0].match)
        for method, other in self.others.items():
            rng.bit_generator.state = state
            match = other.associate(problem, rng)[0].match
            now = self._right(problem, match)
            differs = match != answers[0].match
            self.counts[method] += [len(match), differs.sum(), (now & ~before).sum(), (before & ~now).sum()]
        rng.bit_generator.state = after
        return answers

    def learn(self, ids: Ids, t: float) -> None:
        """See `protocols.Associator`."""
        for other in self.others.values():
            other.learn(ids, t)

    def _right(self, problem: AssociationProblem, match: Ids) -> Mask:
        mine, theirs = self.truth[problem.serials], self.truth[problem.predictions.ids]
        known = np.isin(mine, theirs[theirs >= 0]) & (mine >= 0)
        right: Mask = np.where(match >= 0, (theirs[match] == mine) & (mine >= 0), ~known)
        return right


def counted(world: dict[str, float], route: str, seed: int) -> dict[str, np.ndarray]:
    """One lap taught, then one alone."""
    scenario = cloister(np.random.default_rng(seed), laps=2, teach=1, route=route, **world)
    steps = list(scenario.steps)
    who = Beside(scenario.true_ids(), steps[scenario.teach_steps].t)
    slam = prepare(scenario, associator=who, seed=seed)
    for _ in slam.stream(steps):
        pass
    return who.counts


def line(world: str, route: str, seeds: int) -> str:
    """One line of the table: decisions, and of each method what would differ, and the harm with its interval over runs."""
    runs = [counted(WORLDS[world], route, 8000 + seed) for seed in range(seeds)]
    cells = [f"{sum(run['on'][0] for run in runs):.0f}"]
    for method in METHODS:
        total = np.array([run[method] for run in runs])
        harm = 100.0 * (total[:, 3] - total[:, 2]) / total[:, 0]
        draws = np.random.default_rng(0).choice(harm, (4000, seeds)).mean(1)
        low, high = np.percentile(draws, [2.5, 97.5])
        wins, losses = total[:, 2].sum(), total[:, 3].sum()
        cells += [
            f"{total[:, 1].sum():.0f} (+{wins:.0f}, -{losses:.0f})",
            f"{harm.mean():+.4f} [{low:+.4f}, {high:+.4f}]",
        ]
    return f"| {world}, {route} | " + " | ".join(cells) + " |"


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--write", type=Path, help="put the table between its marks in this document")
    args = parser.parse_args()
    lines = [
        "| world, route after the taught lap | decisions | on: changed (for the better, for the worse) | harm, points "
        "| mixed up: changed | harm, points |",
        "|" + "---|" * 6,
    ]
    for world in WORLDS:
        for route in ROUTES:
            lines.append(line(world, route, args.seeds))
            print(lines[-1], flush=True)
    if args.write:
        write(args.write, "memory decisions", "\n".join(lines))


if __name__ == "__main__":
    main()
