"""Lost robots: kidnapped to a random place of a mapped world. How many come home within 20 steps, how many to a wrong place?

    python benchmarks/lost.py [--trials 100] [--worlds cloister jittered dlr] [--associator stt] [--write FILE.md]

A trial maps the world, then goes on from another step of the same scenario as if nothing had happened (odometry says
nothing of it). A place counts as distinguishable where the 20 steps show at least `votes` landmarks that are on the map,
and the world has no symmetry that makes another place look the same: the plain cloister turns into itself by 90 degrees,
so there nobody can come home, and must not.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from paired import write

import tomthumb
from tomthumb.court import Court
from tomthumb.geometry import align, to_world
from tomthumb.king import King
from tomthumb.revision import twin_of
from tomthumb.runner import prepare
from tomthumb.scenarios.cloister import cloister
from tomthumb.types import Array, Scenario, Step

STEPS, RIGHT = 20, 0.5  # steps to come home in; m from the true place, in the map's own frame
DATA = Path(os.environ.get("TOMTHUMB_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


@dataclass(frozen=True)
class Trial:
    """Steps until the robot was home (None: not within 20), its distance from the true place, and whether it could be."""

    steps: int | None
    error: float
    possible: bool


def main() -> None:
    """Make the table."""
    args = parse()
    rows = [
        "| world | trials | distinguishable | home within 20 steps | wrong place accepted | median steps |",
        "|" + "---|" * 6,
    ]
    for world in args.worlds:
        trials = WORLDS[world](args.trials, args.associator)
        rows.append(row(world, trials))
        print(rows[-1], flush=True)
    if args.write:
        write(args.write, "lost", "\n".join(rows))


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=list(WORLDS))
    parser.add_argument("--associator", default="stt")
    parser.add_argument("--write", type=Path, help="put the table between its marks in this document")
    return parser.parse_args()


def row(world: str, trials: list[Trial]) -> str:
    """One line of the table."""
    home = [t for t in trials if t.steps is not None]
    possible = [t for t in trials if t.possible]
    right = sum(t.steps is not None and t.error < RIGHT for t in possible)
    wrong = sum(t.error >= RIGHT for t in home)
    share = f"{right} ({100 * right / len(possible):.0f} %)" if possible else "-"
    middle = f"{np.median([t.steps for t in home]):.0f}" if home else "-"
    return f"| {world} | {len(trials)} | {len(possible)} | {share} | {wrong} | {middle} |"


def in_cloister(trials: int, associator: str, jitter: float) -> list[Trial]:
    """A world each; the second lap is left for another place of the same or the next lap."""
    out = []
    for seed in range(trials):
        rng = np.random.default_rng([seed, 1])
        scenario = cloister(np.random.default_rng(seed), laps=3, jitter=jitter)
        at = int(rng.integers(190, 240))
        to = at + int(rng.integers(25, 143))
        steps = list(scenario.steps)
        slam = prepare(scenario, associator=associator, seed=seed, settings={"slam": {"king": True}})
        for step in steps[: at + 1]:
            slam.step(step.t, step.control, step.observations)
        out.append(carried_away(slam, scenario, at, steps[to : to + STEPS], np.zeros(3), jitter > 0.0))
    return out


def on_dlr(trials: int, associator: str) -> list[Trial]:
    """The log up to four moments; from each, back to places that were mapped."""
    scenario = tomthumb.load(str(DATA / "dlr_spatial_cognition"))
    steps, truth = list(scenario.steps), scenario.true_ids()
    slam = prepare(scenario, associator=associator, settings={"slam": {"king": False}})
    rng, out = np.random.default_rng(7), []
    moments = [1300, 1700, 2100, 2500]
    for k, step in enumerate(steps[: moments[-1] + 1]):
        slam.step(step.t, step.control, step.observations)
        if k in moments:
            for _ in range(trials // len(moments)):
                to = int(rng.integers(200, k - 200))
                out.append(from_dlr(slam, scenario, k, steps[to : to + STEPS], truth))
    return out


def from_dlr(slam: Any, scenario: Scenario, at: int, after: list[Step], truth: Array) -> Trial:
    """One jump; the true place is taken in the map's own frame, by the landmarks that will be seen."""
    twin = twin_of(slam)
    twin.court = Court(King())
    estimate = twin.estimate()
    named = truth[estimate.ids]
    seen = np.unique(np.concatenate([s.truth.ids for s in after if s.truth is not None and s.truth.ids is not None]))
    rows = np.flatnonzero(np.isin(named, seen[seen >= 0]) & estimate.stone)
    if len(rows) < 3 or scenario.landmarks is None:
        return carried_away(twin, scenario, at, after, np.zeros(3), False)
    motion = align(scenario.landmarks[named[rows]], estimate.landmarks[rows])
    return carried_away(twin, scenario, at, after, motion, len(np.unique(named[rows])) >= King().votes)


def carried_away(slam: Any, scenario: Scenario, at: int, after: list[Step], motion: Array, possible: bool) -> Trial:
    """Go on at another place until the robot is home or the steps are used up; `motion` is from truth to the map."""
    slam.court.watch.since = slam.scan
    for k, step in enumerate(after):
        record = slam.step(slam.t + 1.0, step.control, step.observations)
        if record.info.get("king") in ("home", "loop"):
            assert step.truth is not None
            assert step.truth.pose is not None
            where = to_world(motion, step.truth.pose[None, :2])[0]
            return Trial(k + 1, float(np.hypot(*(record.pose[:2] - where))), possible)
    return Trial(None, np.nan, possible)


WORLDS = {
    "cloister": lambda trials, who: in_cloister(trials, who, 0.0),
    "jittered": lambda trials, who: in_cloister(trials, who, 0.2),
    "dlr": on_dlr,
}

if __name__ == "__main__":
    main()
