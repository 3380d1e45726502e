"""Lost robots: kidnapped to a random place of a mapped world. How many come home, after how many steps, how many to a wrong place?

    python benchmarks/lost.py [--trials 100] [--worlds cloister jittered dlr] [--associator stt] [--seed 0] [--write FILE.md]

A trial maps the world, then goes on from another step of the same scenario as if nothing had happened (odometry says
nothing of it). Whether a place can be told at all is decided without our matcher (`distinguishable.py`): by the true names
of what is seen there. A place is right if what the robot really sees there stands on its map where the accepted pose says.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from distinguishable import Known, needed
from paired import write

import tomthumb
from tomthumb.court import Court
from tomthumb.geometry import compose, inverse, to_world
from tomthumb.king import King
from tomthumb.revision import twin_of
from tomthumb.runner import prepare
from tomthumb.scenarios.cloister import cloister
from tomthumb.types import Array, Estimate, Ids, Scenario, Step

STEPS, RIGHT = 20, 0.5  # steps to come home in; m within which a landmark stands where it should
WARM = 40  # steps that a log goes on with the king before the jump: whoever is out then is out as in any run
WITHIN = (5, 10, 20, 50, 100)
DATA = Path(os.environ.get("TOMTHUMB_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


@dataclass(frozen=True)
class Trial:
    """Steps until the robot was home (None: not within the last of `WITHIN`), whether at the right place, and the steps
    after which the place can be told at all (None: never).
    """

    steps: int | None
    right: bool
    needed: int | None


TryOut = Callable[[Any, Scenario, Sequence[Step]], Trial]


def main() -> None:
    """Make the tables."""
    args = parse()
    first = [
        "| world | trials | distinguishable | home within 20 steps | of the others | wrong place accepted | median steps |"
    ]
    first.append("|" + "---|" * 7)
    second = [
        "| share of trials, % | " + " | ".join(f"{n} steps" for n in WITHIN) + " |",
        "|" + "---|" * (1 + len(WITHIN)),
    ]
    for world in args.worlds:
        trials = WORLDS[world](args.trials, args.associator, args.seed)
        first.append(row(world, trials))
        second += curves(world, trials)
        print(first[-1], *second[-2:], sep="\n", flush=True)
    if args.write:
        write(args.write, "lost", "\n".join([*first, "", *second]))


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=list(WORLDS))
    parser.add_argument("--associator", default="stt")
    parser.add_argument("--seed", type=int, default=0, help="of the first world, and of the places of a log")
    parser.add_argument("--write", type=Path, help="put the tables between their marks in this document")
    return parser.parse_args()


def row(world: str, trials: Sequence[Trial]) -> str:
    """One line of the first table."""
    clear = [t for t in trials if t.needed is not None and t.needed <= STEPS]
    others = [t for t in trials if t.needed is None or t.needed > STEPS]
    wrong = sum(t.steps is not None and not t.right for t in trials)
    home = [t.steps for t in trials if t.steps is not None]
    middle = f"{np.median(home):.0f}" if home else "-"
    return f"| {world} | {len(trials)} | {len(clear)} | {_share(clear)} | {_share(others)} | {wrong} | {middle} |"


def _share(trials: Sequence[Trial]) -> str:
    home = sum(t.right and t.steps is not None and t.steps <= STEPS for t in trials)
    return f"{home} ({100 * home / len(trials):.0f} %)" if trials else "-"


def curves(world: str, trials: Sequence[Trial]) -> list[str]:
    """Two lines of the second table: what can be told within so many steps, and who is home."""
    could = [100 * np.mean([t.needed is not None and t.needed <= n for t in trials]) for n in WITHIN]
    home = [100 * np.mean([t.right and t.steps is not None and t.steps <= n for t in trials]) for n in WITHIN]
    lines = (("distinguishable", could), ("home, at the right place", home))
    return [f"| {world}: {what} | " + " | ".join(f"{v:.0f}" for v in values) + " |" for what, values in lines]


def in_cloister(trials: int, associator: str, seed: int, jitter: float) -> list[Trial]:
    """A world each; the second lap is left for another place of the same or the next lap."""
    out = []
    for k in range(seed, seed + trials):
        rng = np.random.default_rng([k, 1])
        scenario = cloister(np.random.default_rng(k), laps=4, jitter=jitter)
        at = int(rng.integers(190, 240))
        to = at + int(rng.integers(25, 143))
        steps = list(scenario.steps)
        slam = prepare(scenario, associator=associator, seed=k, settings={"slam": {"king": True}})
        for step in steps[: at + 1]:
            slam.step(step.t, step.control, step.observations)
        out.append(carried_away(slam, scenario, steps[to : to + WITHIN[-1]]))
    return out


def on_dlr(trials: int, associator: str, seed: int, try_out: TryOut | None = None) -> list[Trial]:
    """The log up to four moments; from each on a little way with the king, and back to places that were mapped."""
    try_out = try_out or carried_away
    scenario = tomthumb.load(str(DATA / "dlr_spatial_cognition"))
    steps = list(scenario.steps)
    slam = prepare(scenario, associator=associator)
    rng, out = np.random.default_rng(7 + seed), []
    moments = [1301, 1702, 2103, 2504]
    for k, step in enumerate(steps[: moments[-1] + 1]):
        slam.step(step.t, step.control, step.observations)
        if k in moments:
            for _ in range(trials // len(moments)):
                to = int(rng.integers(200, k - 200))
                twin = twin_of(slam)
                twin.court = Court(King())
                for before in steps[k + 1 : k + 1 + WARM]:
                    twin.step(before.t, before.control, before.observations)
                out.append(try_out(twin, scenario, steps[to : to + WITHIN[-1]]))
    return out


def carried_away(slam: Any, scenario: Scenario, after: Sequence[Step]) -> Trial:
    """Go on at another place until the robot is home or the steps are used up."""
    truth, before = scenario.true_ids(), slam.estimate()
    assert scenario.landmarks is not None
    stone = before.only(before.stone)
    known = Known(scenario.landmarks, np.unique(truth[stone.ids][truth[stone.ids] >= 0]))
    steps = needed(known, scenario, after, WITHIN)
    slam.court.watch.since = slam.scan
    for k, step in enumerate(after):
        record = slam.step(slam.t + 1.0, step.control, step.observations)
        if record.info.get("king") in ("home", "loop"):
            return Trial(k + 1, at_home(record.pose, after[: k + 1], stone, truth, scenario.landmarks), steps)
    return Trial(None, False, steps)


def at_home(pose: Array, after: Sequence[Step], stone: Estimate, truth: Ids, landmarks: Array) -> bool:
    """Whether at least half of what was really seen, as far as it is on the map, stands there where `pose` says.

    A landmark that the map has twice may stand at either place.
    """
    assert after[-1].truth is not None
    assert after[-1].truth.pose is not None
    motion = compose(pose, inverse(after[-1].truth.pose))
    named = truth[stone.ids]
    seen = {int(i) for step in after if step.truth and step.truth.ids is not None for i in step.truth.ids}
    gaps = [
        np.hypot(*(stone.landmarks[named == i] - to_world(motion, landmarks[i : i + 1])).T).min()
        for i in seen
        if i >= 0 and (named == i).any()
    ]
    return len(gaps) >= 3 and bool(np.mean(np.array(gaps) < RIGHT) >= 0.5)


WORLDS = {
    "cloister": lambda trials, who, seed: in_cloister(trials, who, seed, 0.0),
    "jittered": lambda trials, who, seed: in_cloister(trials, who, seed, 0.2),
    "dlr": on_dlr,
}

if __name__ == "__main__":
    main()
