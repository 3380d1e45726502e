"""The figures of the main job: match rates in the cloister over seeds, with what they must reach.

usage: python benchmarks/main_job.py [--seeds 20] [--seed 0]

Prints a Markdown table: for STT and JCBB (usual gate) the mean match rate, the worst run, wrong identities, ghosts.
"100 %" stands with its upper bound of error, 3 over the number of runs.
"""

from __future__ import annotations

import argparse

import numpy as np

import tomthumb

WORLDS = {"nominal": {}, "taught a lap, scored on the next": {"laps": 2, "teach": 1}, "30 people": {"people": 30}}


def row(world: dict, associator: str, seeds: range) -> tuple[float, float, int, float]:
    rows = []
    for seed in seeds:
        scenario = tomthumb.load("cloister", seed=seed, **world)
        rows.append(tomthumb.evaluate(tomthumb.run(scenario, associator=associator, seed=seed), scenario))
    rates = np.array([r["match_rate"] for r in rows])
    return rates.mean(), rates.min(), sum(r["wrong_ids"] for r in rows), float(np.mean([r["ghosts"] for r in rows]))


def main() -> None:
    cli = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cli.add_argument("--seeds", type=int, default=20)
    cli.add_argument("--seed", type=int, default=0, help="the first seed")
    args = cli.parse_args()
    print(
        "| world | associator | match % | worst run % | wrong ids (all runs) | ghosts a run |\n|---|---|---:|---:|---:|---:|"
    )
    for name, world in WORLDS.items():
        for associator in ("stt", "jcbb"):
            mean, worst, wrong, ghosts = row(world, associator, range(args.seed, args.seed + args.seeds))
            print(
                f"| {name} | {associator} | {100 * mean:.3f} | {100 * worst:.2f} | {wrong} | {ghosts:.2f} |", flush=True
            )


if __name__ == "__main__":
    main()
