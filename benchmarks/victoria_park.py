"""Victoria Park: which of the 299 labelled trees a map holds, and why our trunk detector finds more than the published.

python benchmarks/victoria_park.py trees [--associator stt] [--purge 0.35] [--data FOLDER]
python benchmarks/victoria_park.py detector [--data FOLDER]
"""

from __future__ import annotations

import argparse
import math
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import tomthumb
from tomthumb.detectors.laser import cluster
from tomthumb.scenarios import load
from tomthumb.scenarios.reading import numbers, read_member
from tomthumb.types import Array, Ids, Scenario, Step, Trace

BEAM = math.radians(0.5)
SAME, AT_TREE = 0.2, 1.0  # m
PASS = 20.0  # s


def trees(folder: Path, associator: str, purge: float) -> None:
    """Labelled trees by sightings, by whether they were ever confirmed, and by whether the final map holds them."""
    scenario = load(str(folder))
    true = scenario.true_ids()
    sightings = np.bincount(true[true >= 0], minlength=299)
    trace = tomthumb.run(scenario, associator=associator, seed=0, settings={"slam": {"purge": purge}})
    held, others = labels_of(trace, true)
    confirmed = np.unique(true[trace.with_stone & (true >= 0)])
    missing = np.setdiff1d(np.flatnonzero(sightings), held)
    print(f"labelled trees: {np.count_nonzero(sightings)}, seen at least {sightings[sightings > 0].min()} times each")
    print(f"{associator}, slam.purge={purge:g}: {len(trace.final.ids)} landmarks in the final map")
    print(f"  {len(set(held))} labelled trees ({len(held) - len(set(held))} twice), {others} things without a label")
    print(f"  {len(confirmed)} labelled trees were confirmed at one time")
    share = sightings[missing].sum() / sightings.sum()
    print(
        f"  the {len(missing)} that are missing at the end were seen {np.median(sightings[missing]):.0f} times (median)"
    )
    print(f"  and carry {100 * share:.1f} % of the labelled sightings")
    for tree in missing.tolist():
        print(f"  {missed(trace, true, tree)}", flush=True)


def missed(trace: Trace, true: Ids, tree: int) -> str:
    """How a tree was seen that the final map does not hold: passes are more than PASS s apart."""
    rows = np.flatnonzero(true == tree)
    t = np.repeat(trace.t, np.diff(trace.offsets))[rows]
    names = trace.ids[rows]
    passes = 1 + np.count_nonzero(np.diff(t) > PASS)
    known = np.count_nonzero(trace.with_stone[rows])
    return (
        f"tree {tree}: {len(rows)} sightings on {passes} passes, under {len(np.unique(names[names >= 0]))} names, "
        f"{np.count_nonzero(names < 0)} left out, {known} while it was confirmed"
    )


def labels_of(trace: Trace, true: Ids) -> tuple[list[int], int]:
    """For each landmark of the final map the tree most of its sightings are of; and how many never saw a labelled one."""
    ids = trace.ids if trace.final_ids is None else trace.final_ids
    found: list[int] = []
    others = 0
    for landmark in trace.final.ids.tolist():
        seen = true[(ids == landmark) & (true >= 0)]
        if len(seen):
            found.append(int(np.bincount(seen).argmax()))
        else:
            others += 1
    return found, others


def detector(folder: Path) -> None:
    """Our detections that are not among the published ones: at mapped trees or not, and which rule would drop them."""
    ours = load(str(folder), detections="raw")
    published = {round(s.t, 2): s for s in scans(load(str(folder)))}
    laser = numbers(read_member(folder / "raw_acfr" / "victoria_park_ascii.zip", "LASER.txt"), "LASER.txt")
    told: Counter[str] = Counter()
    for step, ranges in zip(scans(ours), laser.reshape(-1, 362)[:, 1:], strict=True):
        told["detections"] += len(step.observations or ())
        theirs = published.get(round(step.t, 2))
        if theirs is not None:
            told.update(extras(ours, step, theirs, ranges))
    print(", ".join(f"{name}: {count}" for name, count in told.most_common()))


def scans(scenario: Scenario) -> Iterator[Step]:
    """The steps with a scan."""
    return (step for step in scenario.steps if step.observations is not None)


def points(z: Array) -> Array:
    """Range and bearing as points."""
    return np.column_stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])])


def extras(scenario: Scenario, step: Step, theirs: Step, ranges: Array) -> Iterator[str]:
    """What is to be said of each detection of `step` that has none of `theirs` within SAME."""
    assert step.observations is not None
    assert theirs.observations is not None
    z = step.observations.z
    apart = np.linalg.norm(points(z)[:, None] - points(theirs.observations.z)[None], axis=2).min(1, initial=np.inf)
    angles = BEAM * np.arange(len(ranges)) - math.pi / 2
    groups = cluster(ranges, angles, (ranges >= 1.0) & (ranges <= 75.0), 1.5)
    middle = np.array([(angles[g[0]] + angles[g[-1]]) / 2 for g in groups])
    for row in z[apart >= SAME]:
        yield "not published"
        pose = None if theirs.truth is None else theirs.truth.pose
        if pose is not None and scenario.landmarks is not None:
            place = scenario.sensor.locate(pose, row[None])[0]
            near = np.linalg.norm(scenario.landmarks - place, axis=1).min() < AT_TREE
            yield f"of these within {AT_TREE:g} m of a mapped tree" if near else "of these elsewhere"
        yield from reasons(ranges, angles, groups, int(np.argmin(np.abs(middle - row[1])))) or ["for no such reason"]


def reasons(ranges: Array, angles: Array, groups: list[Ids], i: int) -> list[str]:
    """Stricter rules that the i-th cluster does not keep: isolation, evenness, width, the edge of the scan."""
    first, last = groups[i][0], groups[i][-1]
    spot = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    width = (angles[last] - angles[first] + BEAM) * (ranges[first] + ranges[last]) / 2
    told = []
    beyond = [(first, groups[i + j][-1]) for j in (-3, -2) if i + j >= 0]
    beyond += [(last, groups[i + j][0]) for j in (2, 3) if i + j < len(groups)]
    if any(np.linalg.norm(spot[a] - spot[b]) < 3.0 for a, b in beyond):
        told.append("less than 3 m from the second or third cluster beside it")
    beside = [(first, groups[i - 1][-1])] if i else []
    beside += [(last, groups[i + 1][0])] if i + 1 < len(groups) else []
    if any(abs(angles[a] - angles[b]) < 2.02 * BEAM and ranges[b] < ranges[a] for a, b in beside):
        told.append("less than 1 deg from a nearer cluster")
    if np.linalg.norm(spot[first] - spot[last]) >= 1.0:
        told.append("1 m wide or more")
    if abs(ranges[first] - ranges[last]) >= width / 3:
        told.append("edges differ in range by a third of the width or more")
    if angles[first] < -math.pi / 2 + math.radians(2.94) or angles[last] > math.pi / 2 - math.radians(2.94):
        told.append("at the edge of the scan")
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["trees", "detector"])
    parser.add_argument("--associator", default="stt")
    parser.add_argument("--purge", type=float, default=0.35)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("TOMTHUMB_DATA", "../shared/data")))
    options = parser.parse_args()
    folder = options.data / "victoria_park"
    if options.what == "trees":
        trees(folder, options.associator, options.purge)
    else:
        detector(folder)


if __name__ == "__main__":
    main()
