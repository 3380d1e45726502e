"""How far may the king's odds be trusted? What the brothers of kidnapped robots would say, right and wrong, at every odds.

    python benchmarks/odds.py [--trials 40] [--seed 5]

The trials on DLR of `lost.py`, 20 steps each. At each step each brother is asked, nobody is carried home: the best place
that is not the believed one, its odds against all else together in nats, and whether it is right. All these robots are
carried, which the king takes for `rare` nats, so more answers are right than their odds say; what counts is how many are wrong.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import lost
import numpy as np

from tomthumb.king import LEAST, King, Question, expected, found_for, holds, pose_home, posed, weights
from tomthumb.lookout import Walker, asked_of
from tomthumb.places import stones
from tomthumb.types import Array, Estimate, Scenario, Step

EDGES = (-np.inf, -15.0, -10.0, -7.0, -4.6, -2.3, 0.0, 2.3, 4.6, 7.0, np.inf)
NEVER = King(lead=1e9)


@dataclass(frozen=True)
class Said:
    """The odds of the best place that a brother knows, nats; whether it is right, and whether the king's other rules hold."""

    trial: int
    odds: float
    right: bool
    holds: bool


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    said: list[Said] = []
    count = iter(range(args.trials))

    def listened(slam: Any, scenario: Scenario, after: Sequence[Step]) -> lost.Trial:
        said.extend(listen(next(count), slam, scenario, after[: lost.STEPS]))
        return lost.Trial(None, False, None)

    lost.on_dlr(args.trials, "stt", args.seed, listened)
    print("| odds, nats | all: answers | right | wrong in trials | the rules hold: answers | right | wrong in trials |")
    print("|" + "---|" * 7)
    for low, high in pairwise(EDGES):
        those = [one for one in said if low <= one.odds < high]
        print(f"| {low} to {high} | {_row(those)} | {_row([one for one in those if one.holds])} |")


def _row(said: Sequence[Said]) -> str:
    share = f"{100 * np.mean([one.right for one in said]):.1f} %" if said else "-"
    return f"{len(said)} | {share} | {len({one.trial for one in said if not one.right})}"


def listen(trial: int, slam: Any, scenario: Scenario, after: Sequence[Step]) -> Iterator[Said]:
    """What all brothers say at each step after the jump."""
    assert scenario.landmarks is not None
    before, truth = slam.estimate(), scenario.true_ids()
    stone = before.only(before.stone)
    slam.court.king, slam.court.watch.since = NEVER, slam.scan
    for k, step in enumerate(after):
        slam.step(slam.t + 1.0, step.control, step.observations)
        whole = slam.estimator.estimate(slam.branches[0].belief)
        for walker in slam.court.lookout.walkers:
            best = best_elsewhere(walker, slam, whole)
            if best is not None:
                odds, pose, good = best
                right = lost.at_home(pose, after[: k + 1], stone, truth, scenario.landmarks)
                yield Said(trial, odds, right, good)


def best_elsewhere(walker: Walker, slam: Any, whole: Estimate) -> tuple[float, Array, bool] | None:
    """Odds, pose, and whether the other rules hold, of the best place that is not the believed one."""
    king = King()
    away, here, guess = asked_of(walker, slam, king, whole)
    if min(len(here.part.ids), len(away.old.ids)) < LEAST or not here.lately.any():
        return None
    old = stones(away.old.landmarks, away.exist)
    asked: Question = posed(away, here, guess, old, slam.sensor, slam.detection)
    found = found_for(asked)
    elsewhere = [k for k, fit in enumerate(found) if not expected(fit, asked)]
    if not elsewhere:
        return None
    weight, other = weights(found, asked)
    best = max(elsewhere, key=lambda k: float(weight[k]))
    odds = float(weight[best] - np.logaddexp.reduce([other, *np.delete(weight, best)]))
    pose = pose_home(found[best], here.part.pose, here.part.pose_cov)[0]
    return odds, pose, holds(king, found, best, asked)


if __name__ == "__main__":
    main()
