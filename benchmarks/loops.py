"""Loops that scan by scan are missed: every associator without and with the scout (`slam.loops`), and the scout's numbers.

    python benchmarks/loops.py [--seeds 20] [--write docs/lost.md]

Worlds: a ring walked round by a biased odometer (`worlds.ring`), where there is a loop to be found; the periodic way of
120 m (`worlds.loop`) and the cloister with walking people, where none is missed and none must be found; and the DLR log.
Every run is kept in --out and not repeated by the same code.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from paired import write
from worlds import loop, ring

from tomthumb.bench.version import code_version
from tomthumb.metrics.evaluation import evaluate
from tomthumb.runner import collect, prepare
from tomthumb.scenarios.catalogue import load
from tomthumb.scenarios.cloister import cloister
from tomthumb.scout import Scouting
from tomthumb.types import Scenario

DATA = Path(os.environ.get("TOMTHUMB_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
WORLDS: dict[str, Callable[[np.random.Generator], Scenario]] = {
    "ring": ring,
    "periodic way": loop,
    "30 people": lambda rng: cloister(rng, laps=2, people=30),
}
OTHERWISE: dict[str, list[Any]] = {
    "window": [100, 300], "sizes": [1, 2], "every": [10], "sure": [10.0, 30.0], "lead": [5.0, 20.0],
    "drift": [(0.025, 0.0025), (0.1, 0.01)], "tear": [15.0, 100.0, 1e9],
}  # fmt: skip
KEYS = ("match_rate", "match_rate_final", "purity", "idf1", "duplicates", "ate_final_m")


def one(scenario: Scenario, associator: str, scouting: Scouting | None) -> dict[str, Any]:
    """The metrics of a run, the loops it closed, and its CPU time."""
    slam = prepare(scenario, associator=associator)
    slam.court.scouting = scouting if associator != "oracle" else None
    begin = time.process_time()
    records = list(slam.stream(scenario.steps))
    spent = time.process_time() - begin
    row = evaluate(collect(scenario.name, slam, records), scenario)
    loops = [r.index for r in records if r.info.get("king") == "loop"]
    return {key: row[key] for key in KEYS} | {"loops": loops, "s": round(spent, 2)}


def planned(seeds: int) -> Iterator[tuple[str, int, str, dict[str, Any] | None]]:
    """World, seed, associator and what differs from the scout's defaults (None: no scout)."""
    for associator in ("oracle", "nn", "jcbb", "stt"):
        for changes in (None, {}) if associator != "oracle" else (None,):
            yield from ((world, seed, associator, changes) for world in WORLDS for seed in range(seeds))
            if (DATA / "dlr_spatial_cognition").is_dir():
                yield "dlr", 0, associator, changes
    for changes in ({key: value} for key, values in OTHERWISE.items() for value in values):
        yield from (
            (world, seed, "stt", changes) for world in ("ring", "periodic way") for seed in range(min(seeds, 6))
        )
        if (DATA / "dlr_spatial_cognition").is_dir():
            yield "dlr", 0, "stt", changes


def runs(seeds: int, out: Path) -> list[dict[str, Any]]:
    """All planned runs; those that `out` holds of the same code are not repeated."""
    kept = {}
    code = code_version()
    if out.is_file():
        rows = [json.loads(line) for line in out.read_text("utf-8").splitlines()]
        kept = {row["plan"]: row for row in rows if row["code"] == code}
    out.parent.mkdir(parents=True, exist_ok=True)
    found = []
    for world, seed, associator, changes in planned(seeds):
        plan = json.dumps([world, seed, associator, changes])
        if plan not in kept:
            scenario = (
                load(str(DATA / "dlr_spatial_cognition"))
                if world == "dlr"
                else WORLDS[world](np.random.default_rng(seed))
            )
            scouting = None if changes is None else replace(Scouting(), **changes)
            kept[plan] = {"plan": plan, "code": code, **one(scenario, associator, scouting)}
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(kept[plan]) + "\n")
        found.append(kept[plan] | {"case": (world, associator, json.dumps(changes))})
    return found


def table(rows: list[dict[str, Any]]) -> str:
    """Means over the worlds of each case, in Markdown."""
    lines = [
        "| world | names by | scout | runs | IDF1 % | purity % | duplicates | ATE m | runs with a loop closed | CPU s |",
        "|---" * 10 + "|",
    ]
    for case in dict.fromkeys(row["case"] for row in rows):
        mine = [row for row in rows if row["case"] == case]
        world, associator, changes = case
        said = json.loads(changes)
        scout = "–" if said is None else ", ".join(f"{k} {v}" for k, v in said.items()) or "yes"
        mean = {key: float(np.mean([row[key] for row in mine])) for key in (*KEYS, "s")}
        figures = [
            f"{100 * mean['idf1']:.2f}", f"{100 * mean['purity']:.2f}", f"{mean['duplicates']:.1f}",
            f"{mean['ate_final_m']:.3f}", str(sum(bool(row["loops"]) for row in mine)), f"{mean['s']:.1f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join([world, associator, scout, str(len(mine)), *figures]) + " |")
    return "\n".join(lines)


def figure(path: Path, seed: int = 0) -> None:
    """The ring's map without and with the scout."""
    from matplotlib.figure import Figure

    scenario = ring(np.random.default_rng(seed))
    picture = Figure(figsize=(9.0, 4.6), layout="constrained")
    for axes, scouting in zip(picture.subplots(1, 2), (None, Scouting()), strict=True):
        slam = prepare(scenario, associator="stt")
        slam.court.scouting = scouting
        trace = collect(scenario.name, slam, list(slam.stream(scenario.steps)))
        row = evaluate(trace, scenario)
        stones = trace.final.landmarks[trace.final.stone]
        path_now = trace.pose if trace.final_pose is None else trace.final_pose
        axes.plot(*scenario.landmarks.T, "o", mfc="none", mec="0.6", label="true posts")
        axes.plot(*stones.T, "k.", ms=4, label="map")
        axes.plot(*path_now[:, :2].T, color="tab:blue", lw=1, label="path")
        named = "with the scout" if scouting else "scan by scan"
        axes.set(
            title=f"{named}: {row['duplicates']} posts twice, IDF1 {row['idf1']:.1%}",
            xlabel="x m",
            ylabel="y m",
            aspect="equal",
        )
    axes.legend(loc="center", frameon=False)
    picture.savefig(path)


def main() -> None:
    """Runs what is missing, prints the table, writes it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("out/loops.jsonl"))
    parser.add_argument("--write", type=Path, help="put the table between its marks in this document")
    parser.add_argument("--figure", type=Path, help="only draw the ring without and with the scout")
    options = parser.parse_args()
    if options.figure:
        figure(options.figure)
        return
    text = table(runs(options.seeds, options.out))
    print(text)
    if options.write:
        write(options.write, "loops", text)


if __name__ == "__main__":
    main()
