"""Where two associators differ on a log: every problem of one's run is put to the other too, and both held against the truth.

    python benchmarks/second_opinion.py LOG [--first stt] [--second jcbb] [--set slam.present=true] [--shaken N [--dropped .03]]

LOG as `tomthumb run` takes it, with labels. A landmark is what most of its sightings so far were of; to leave an observation
unpaired is right where no landmark of the map is that. Then the first one's confidence: of decisions of some confidence, how
many are right. With --shaken the run is also made N times with every sighting moved by a tenth of its noise, and a share of
them --dropped: match rate, IDF1 and ATE of both, mean and standard error.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import tomthumb
from tomthumb.cli.common import read_settings
from tomthumb.errors import TomThumbError
from tomthumb.protocols import Associator, Rng
from tomthumb.runner import Settings, prepare
from tomthumb.types import Array, Association, AssociationProblem, Ids, Mask, Scenario, Step

SHARE = 0.1  # of the noise, by which sightings are moved
LEVELS = (0.5, 0.9, 0.99)


@dataclass(slots=True)
class Witness:
    """Decides as `first` does, and notes what `second` would have: problems, and both answers."""

    first: Associator
    second: Associator
    noted: list[tuple[AssociationProblem, Association, Association]] = field(default_factory=list)

    def associate(self, problem: AssociationProblem, rng: Rng) -> Sequence[Association]:
        """See `protocols.Associator`."""
        answers = self.first.associate(problem, rng)
        self.noted.append((problem, answers[0], self.second.associate(problem, rng)[0]))
        return answers

    def learn(self, ids: Ids, t: float) -> None:
        """See `protocols.Associator`."""
        self.first.learn(ids, t)


def verdicts(
    scenario: Scenario, first: str, second: str, settings: Settings
) -> Iterator[tuple[bool, bool, bool, float]]:
    """Of each decision of the run: whether the first is right, the second, whether the first paired, and its confidence."""
    slam = prepare(scenario, associator=first, settings=settings)
    slam.associator = witness = Witness(slam.associator, prepare(scenario, associator=second).associator)
    truth, seen = scenario.true_ids(), defaultdict[int, Counter[int]](Counter)
    for record in slam.stream(scenario.steps):
        for problem, mine, other in witness.noted[:1]:  # that of the branch that led before the scan
            what = {int(i): seen[int(i)].most_common(1)[0][0] for i in problem.predictions.ids if seen[int(i)]}
            there = set(what.values())
            sure = np.ones(len(mine.match)) if mine.confidence is None else mine.confidence
            for row, serial in enumerate(problem.serials.tolist()):
                true = int(truth[serial])
                if true < -1:
                    continue
                right = []
                for match in (int(mine.match[row]), int(other.match[row])):
                    called = what.get(int(problem.predictions.ids[match]), -2) if match >= 0 else -1
                    right.append(called == true if match >= 0 else true not in there)
                yield right[0], right[1], bool(mine.match[row] >= 0), float(sure[row])
        witness.noted.clear()
        for i, serial in zip(record.ids.tolist(), record.serials.tolist(), strict=True):
            if i >= 0 and truth[serial] >= -1:
                seen[i][int(truth[serial])] += 1


def compared(found: Array, first: str, second: str) -> Iterator[str]:
    """The lines that are told: who was right where they differ, and how sure the first was."""
    one, other, paired, sure = found.T
    better, worse = int((one > other).sum()), int((other > one).sum())
    yield f"{len(found)} decisions: {first} right, {second} wrong: {better}; the other way round: {worse}"
    for name, kind in (("left unpaired", paired == 0), ("paired", paired == 1)):
        for low, high in zip(LEVELS, (*LEVELS[1:], 1.0), strict=True):
            those = kind & (sure >= low) & (sure < high)
            yield f"{name}, {low:.0%} to {high:.0%} sure: {int(one[those].sum())} of {int(those.sum())} right"


def shaken(scenario: Scenario, seed: int, dropped: float = 0.0) -> Scenario:
    """The same log with every sighting moved by a share of its noise, and some of them `dropped`."""
    rng, steps = np.random.default_rng(seed), []
    for step in scenario.steps:
        seen = step.observations
        if seen is not None and len(seen):
            noise = np.linalg.cholesky(seen.R) @ rng.standard_normal((len(seen), 2, 1))
            step = replace(step, observations=replace(seen, z=seen.z + SHARE * noise[..., 0]))
            step = without(step, rng.random(len(seen)) < dropped) if dropped > 0.0 else step
        steps.append(step)
    return replace(scenario, steps=steps)


def without(step: Step, gone: Mask) -> Step:
    """A step without the sightings that are `gone` (m,), and what is known of them."""
    kept, truth = np.flatnonzero(~gone), step.truth
    assert step.observations is not None
    if truth is not None and truth.ids is not None:
        truth = replace(truth, ids=truth.ids[kept])
    return replace(step, observations=step.observations.take(kept), truth=truth)


def repeated(scenario: Scenario, who: str, runs: int, settings: Settings, dropped: float = 0.0) -> str:
    """One line: means and standard errors over shaken runs."""
    worlds = [shaken(scenario, seed, dropped) for seed in range(runs)]
    rows = [tomthumb.evaluate(tomthumb.run(w, associator=who, settings=settings), w) for w in worlds]
    parts: list[str] = []
    for key, scale, unit in (("match_rate", 100.0, "%"), ("idf1", 100.0, "%"), ("ate_m", 1.0, "m")):
        values = scale * np.array([row[key] for row in rows], float)
        error = values.std(ddof=1) / math.sqrt(runs) if runs > 1 else math.nan
        parts.append(f"{key} {values.mean():.2f} +- {error:.2f} {unit}")
    return f"{who}, {runs} times shaken: " + ", ".join(parts)


def told(log: str, first: str, second: str, sets: Sequence[str], runs: int, dropped: float = 0.0) -> Iterator[str]:
    """All lines. Raises TomThumbError for a log without labels, and for what `tomthumb run` would refuse."""
    given = read_settings(None, list(sets))
    settings: Settings = {part: given.get(part, {}) for part in ("associator", "estimator", "slam")}
    scenario = tomthumb.load(log)
    found = list(verdicts(scenario, first, second, settings))
    if not found:
        raise TomThumbError(f"{log}: no sighting has a label to judge by")
    yield from compared(np.array(found, float), first, second)
    if runs:
        yield from (repeated(scenario, who, runs, its, dropped) for who, its in ((first, settings), (second, {})))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("--first", default="stt")
    parser.add_argument("--second", default="jcbb")
    parser.add_argument(
        "--set", dest="sets", action="append", default=[], help="of the first, as `tomthumb run` takes them"
    )
    parser.add_argument("--shaken", type=int, default=0, metavar="N")
    parser.add_argument("--dropped", type=float, default=0.0, metavar="SHARE", help="of the sightings of a shaken run")
    options = parser.parse_args()
    if options.shaken < 0:
        parser.error(f"--shaken {options.shaken}: a number from 0 on")
    if not 0.0 <= options.dropped < 1.0:
        parser.error(f"--dropped {options.dropped}: a share, from 0 to below 1")
    try:
        for line in told(options.log, options.first, options.second, options.sets, options.shaken, options.dropped):
            print(line, flush=True)
    except TomThumbError as error:
        sys.exit(_refused(error))


def _refused(error: TomThumbError) -> int:
    print(f"error: {error}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
