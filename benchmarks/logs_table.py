"""Every log with every associator: the table of docs/logs.md.

    python benchmarks/logs_table.py --keep rows.json --write docs/logs.md
        [--data FOLDER] [--only NAME ...] [--associators oracle,nn,...] [--limit SECONDS]

Rows that ``--keep FILE.json`` has from the same code are not run again, so that an interrupted table goes on where it
stopped; each row is kept as soon as it is there, and ended after --limit s. With --write the table replaces what stands
between the marks in the document. ATE after rigid alignment, without scale; "GPS" is the RMS distance of the estimated
laser point to the nearest GPS fix in time (0.1 s), aligned as well; the real-time factor is the log's duration over the
CPU time of the run.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import tomthumb
from tomthumb.bench.version import code_version
from tomthumb.geometry import align, to_world
from tomthumb.runner import Settings
from tomthumb.scenarios import load
from tomthumb.types import Scenario, Trace

LOGS = {
    "lost_in_the_woods": "{}/utias_lost_in_the_woods",
    "lost_in_the_woods, 5 m": "lost_in_the_woods:{}/utias_lost_in_the_woods?r_max=5",
    "lost_in_the_woods, 3 m": "lost_in_the_woods:{}/utias_lost_in_the_woods?r_max=3",
    "lost_in_the_woods, 2 m": "lost_in_the_woods:{}/utias_lost_in_the_woods?r_max=2",
    "lost_in_the_woods, 1 m": "lost_in_the_woods:{}/utias_lost_in_the_woods?r_max=1",
    "car_park": "{}/car_park",
    "car_park, our detector": "{}/car_park?detections=raw",
    "victoria_park": "{}/victoria_park",
    "victoria_park, our detector": "{}/victoria_park?detections=raw",
    "mrclam 7, robot 1": "mrclam:{}/utias_mrclam?robot=1",
    "mrclam 7, robot 2": "mrclam:{}/utias_mrclam?robot=2",
    "mrclam 7, robot 3": "mrclam:{}/utias_mrclam?robot=3",
    "mrclam 7, robot 4": "mrclam:{}/utias_mrclam?robot=4",
    "mrclam 7, robot 5": "mrclam:{}/utias_mrclam?robot=5",
    "dlr": "{}/dlr_spatial_cognition",
    "dlr, with the scout": "{}/dlr_spatial_cognition",
    "city_trees": "{}/city_trees_10000",
    "slsjf 535": "{}/slsjf_simulated",
    "freiburg": "{}/freiburg_slam_course",
    "cones Testing4_9": "{}/fs_driverless_prom_ntua?log=Testing4_9",
}
AMBIGUOUS = ["lost_in_the_woods, 2 m", "lost_in_the_woods, 1 m", *(f"mrclam 7, robot {k}" for k in range(1, 6))]
BROTHERS = {f"{name}, eight brothers": name for name in AMBIGUOUS}  # of STT alone: the others have one answer
LOGS |= {row: LOGS[name] for row, name in BROTHERS.items()}
SETTINGS: dict[str, Settings] = {"dlr, with the scout": {"slam": {"loops": True}}}
SETTINGS |= {row: {"associator": {"brothers": 8}, "slam": {"width": 8, "present": True}} for row in BROTHERS}
BEGIN, END = "<!-- table: benchmarks/logs_table.py -->", "<!-- end of table -->"
HEAD = "| log | associator | match rate % | IDF1 % | purity % | duplicates | landmarks | ATE m | GPS m | x real time | failure |"


def measure(scenario: Scenario, associator: str, seed: int, settings: Settings) -> dict[str, Any]:
    """One run: what the table tells of it."""
    start = time.process_time()
    trace = tomthumb.run(scenario, associator=associator, seed=seed, settings=settings)
    cpu = time.process_time() - start
    found = tomthumb.evaluate(trace, scenario)
    keys = ("match_rate", "idf1", "purity", "duplicates", "landmarks", "ate_m", "failure")
    row = {key: found.get(key) for key in keys}
    row["gps_m"] = gps_error(trace, scenario)
    row["real_time"] = float(trace.t[-1] - trace.t[0]) / cpu if len(trace.t) else None
    return row | {"cpu_s": cpu}


def bounded(scenario: Scenario, associator: str, seed: int, settings: Settings, limit: int) -> dict[str, Any]:
    """`measure`, ended after `limit` s of processor time: then the row says so. (One that diverges says so itself.)"""
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return measure(scenario, associator, seed, settings)
    except TooLong:
        return {"failure": f"not finished after {limit} s", "cpu_s": float(limit), "limit_s": limit}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


class TooLong(BaseException):
    """The time of a row is over: no Exception, so that nobody on the way catches it."""


def _too_long(number: int, frame: Any) -> None:
    raise TooLong


def gps_error(trace: Trace, scenario: Scenario) -> float | None:
    """RMS distance to GPS after alignment, where the log has fixes; those off by more than 10 m are jumps, left out."""
    gps = scenario.info.get("gps")
    if gps is None or len(trace.t) < 2:
        return None
    at = np.clip(np.searchsorted(trace.t, gps[:, 0]), 0, len(trace.t) - 1)
    near = np.abs(trace.t[at] - gps[:, 0]) < 0.1
    mine = np.array([scenario.sensor.frame(pose)[:2] for pose in trace.pose[at[near]]])
    theirs = gps[near, 1:]
    good = np.ones(len(mine), bool)
    for _ in range(3):
        error = np.linalg.norm(to_world(align(mine[good], theirs[good]), mine) - theirs, axis=1)
        good = error < max(10.0, 2 * float(np.median(error)))
    return float(np.sqrt(np.mean(error[good] ** 2)))


def line(name: str, associator: str, row: Mapping[str, Any]) -> str:
    """One row of the table."""

    def number(key: str, form: str, scale: float = 1.0) -> str:
        value = row.get(key)
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return "–"
        return format(value if form == "d" else value * scale, form)

    cells = [
        name, associator, number("match_rate", ".2f", 100.0), number("idf1", ".2f", 100.0),
        number("purity", ".2f", 100.0), number("duplicates", "d"), number("landmarks", "d"), number("ate_m", ".3f"),
        number("gps_m", ".2f"), number("real_time", ".1f"), str(row.get("failure") or ""),
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TOMTHUMB_DATA", "../shared/data"))
    parser.add_argument("--only", nargs="*", choices=list(LOGS))
    parser.add_argument("--associators", default="oracle,nn,gnn,jcbb,stt")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--limit", type=int, default=900, help="seconds of processor time for one row")
    options = parser.parse_args()
    kept = json.loads(options.keep.read_text()) if options.keep and options.keep.exists() else {}
    code, limit = code_version(), options.limit
    for name in options.only or LOGS:
        have = {a: kept.get(f"{name}|{a}", {}) for a in options.associators.split(",")}
        wanted = [a for a, row in have.items() if row.get("code") != code or row.get("limit_s", limit) < limit]
        if not wanted:
            continue
        scenario = load(LOGS[name].format(options.data))
        labelled = bool((scenario.true_ids() >= 0).any())
        for associator in wanted:
            if associator == "oracle" and (not labelled or name in SETTINGS):  # an oracle misses no loop
                continue
            if associator != "stt" and name in BROTHERS:
                continue
            row = bounded(scenario, associator, options.seed, SETTINGS.get(name, {}), limit) | {"code": code}
            kept[f"{name}|{associator}"] = row
            print(line(name, associator, row), f"{row['cpu_s']:.0f} s", flush=True)
            if options.keep:
                keep(options.keep, kept)
            if options.write:
                write(options.write, kept)
    fresh = [row for row in kept.values() if row.get("code") == code]
    print(f"{len(fresh)} rows of this code, {sum(row['cpu_s'] for row in fresh) / 60:.0f} minutes; {len(kept)} in all")
    if options.write:
        write(options.write, kept)


def keep(path: Path, kept: Mapping[str, Any]) -> None:
    """Write the rows so that a kill at any moment leaves the old file or the new one."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(kept, indent=1))
    part.replace(path)


def write(document: Path, kept: Mapping[str, Mapping[str, Any]]) -> None:
    """Put the rows between the marks of a document, in the order of LOGS."""
    order = sorted(kept, key=lambda key: list(LOGS).index(key.split("|")[0]))
    rows = [line(*key.split("|"), kept[key]) for key in order]
    text = document.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    table = "\n".join([BEGIN, "", HEAD, "|" + "---|" * 11, *rows, "", END])
    document.write_text(before + table + after, encoding="utf-8")


if __name__ == "__main__":
    main()
