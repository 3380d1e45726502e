"""One scan at a time: who names it rightly, how fast, and how near the search comes to the proven optimum.

    python benchmarks/single_scan.py --count 50 --write docs/single_scan.md
    python benchmarks/single_scan.py --classes wide,lost --sizes 16,32,64 --methods nn,gnn,stt,clique
    python benchmarks/single_scan.py --prefixes 500      # JCBB: how often do prefixes and whole sets differ?

Right: the share of all observations, false ones included, whose partner (or -1) is the true one. Methods see the same
problems; intervals are 95 % bootstrap over problems. Times are of `associate` alone, on one BLAS thread, after a
warm-up; "cut off": scans on which the search spent its budget of nodes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scan_problems import CLASSES, CLOUD_CLASSES, Scan, scans
from threadpoolctl import threadpool_limits

from tomthumb import registry
from tomthumb.associators.tom_thumb.scene import base_gains
from tomthumb.kernels.posterior import value_of
from tomthumb.stats.bootstrap import mean_interval
from tomthumb.types import Array, Association, AssociationProblem

GATES = (0.95, 0.99, 0.999, 0.9999)
SECTOR_SIZES, CLOUD_SIZES = (5, 10, 20), (16, 32, 64)
BEGIN, END = "<!-- single_scan: written by benchmarks/single_scan.py -->", "<!-- end of single_scan -->"
LEVELS = np.array([0.0, 0.5, 0.85, 0.95, 0.99, 1.0 + 1e-9])  # of confidence


@dataclass(frozen=True)
class Outcome:
    """One method on the problems of one cell: share right, seconds and finished (count,) each; what it answered."""

    right: Array
    seconds: Array
    finished: Array
    found: list[Association]


def methods(wanted: str, nodes: int) -> dict[str, tuple[str, dict[str, float]]]:
    """Column name -> (associator, parameters). "jcbb" stands for all gates."""
    table: dict[str, tuple[str, dict[str, float]]] = {}
    for name in wanted.split(","):
        if name == "jcbb":
            table.update({f"jcbb {gate:g}": (name, {"gate": gate, "budget": nodes}) for gate in GATES})
        else:
            table[name] = (name, {"budget": nodes} if name in ("map", "ipjc") else {})
    return table


def measure(method: tuple[str, dict[str, float]], cell: list[Scan]) -> Outcome:
    """Every problem once; the first one before that as well, so that nothing is compiled or read within a timing."""
    part = registry.build("associator", *method)
    part.associate(cell[0].problem(), np.random.default_rng(0))
    right, seconds, found = [], [], []
    for k, scan in enumerate(cell):
        problem, rng = scan.problem(), np.random.default_rng([7, k])
        begin = time.perf_counter()
        answer = part.associate(problem, rng)[0]
        seconds.append(time.perf_counter() - begin)
        right.append(float((answer.match == scan.truth).mean()) if len(scan.truth) else 1.0)
        found.append(answer)
    finished = np.array([a.info.get("proof") != "truncated" for a in found])
    return Outcome(np.array(right), np.array(seconds), finished, found)


def value(problem: AssociationProblem, match: Array) -> float:
    """L of a match on the full covariance: the objective of `map`."""
    own, odds = base_gains(problem, None)
    cov = np.ascontiguousarray(problem.predictions.cov)
    return float(value_of(match, problem.innovation, cov, problem.R, own[:, None] + odds[None])[0])


def optimum_reached(cell: list[Scan], proven: Outcome) -> tuple[int, int]:
    """Problems that `map` finished, and those of them where STT's most probable hypothesis has the same L."""
    part = registry.build("associator", "stt", {"decide": "map"})
    reached = finished = 0
    for k, (scan, best) in enumerate(zip(cell, proven.found, strict=True)):
        if best.info["proof"] != "optimal":
            continue
        problem = scan.problem()
        match = part.associate(problem, np.random.default_rng([7, k]))[0].match
        finished += 1
        reached += value(problem, match) > best.info["objective"] - 1e-6
    return reached, finished


# --- tables -----------------------------------------------------------------------------------------------------------


def rows(kind: str, size: int, table: dict[str, Outcome]) -> Iterator[str]:
    """One line of Markdown for each method; "-": nothing to compare with, or nothing is ever cut off."""
    rng = np.random.default_rng(1)
    for name, outcome in table.items():
        mean = 100.0 * outcome.right.mean()
        low, high = (100.0 * v for v in mean_interval(outcome.right, rng))
        against = "-"
        if name != "stt" and "stt" in table:
            gap = 100.0 * (table["stt"].right - outcome.right)
            a, b = mean_interval(gap, rng)
            against = f"{gap.mean():+.2f} [{a:+.2f}, {b:+.2f}]"
        median, late = np.quantile(1e3 * outcome.seconds, [0.5, 0.99])
        cut = int((~outcome.finished).sum()) if name.startswith(("jcbb", "map", "ipjc", "clique")) else "-"
        share = f"{mean:.2f} [{low:.2f}, {high:.2f}]"
        yield f"| {kind} | {size} | {name} | {share} | {against} | {median:.2f} | {late:.2f} | {cut} |"


def calibration(answers: list[tuple[Association, Scan]]) -> Iterator[str]:
    """Pairings by the confidence they were given, and the share of them that is right."""
    chance, right = [], []
    for answer, scan in answers:
        paired = answer.match >= 0
        if answer.confidence is not None:
            chance.append(answer.confidence[paired])
            right.append(answer.match[paired] == scan.truth[paired])
    given, good = np.concatenate(chance), np.concatenate(right)
    for low, high in pairwise(LEVELS):
        inside = (given >= low) & (given < high)
        if inside.any():
            share = f"{100 * given[inside].mean():.1f} | {100 * good[inside].mean():.1f}"
            yield f"| {low:.2f} to {min(high, 1.0):.2f} | {int(inside.sum())} | {share} |"


def report(args: argparse.Namespace) -> str:
    """The whole page between the markers."""
    chosen = methods(args.methods, args.nodes)
    lines, optimum, answers = [], [], []
    for kind in args.classes.split(","):
        sizes = args.sizes or (CLOUD_SIZES if kind in CLOUD_CLASSES else SECTOR_SIZES)
        for size in sizes:
            cell = scans(kind, size, args.count, args.seed)
            table = {name: measure(m, cell) for name, m in chosen.items() if m[0] not in SLOW.get(kind, ())}
            lines += rows(kind, size, table)
            print("\n".join(lines[-len(table) :]), flush=True)
            if "map" in table:
                reached, finished = optimum_reached(cell, table["map"])
                optimum.append(f"| {kind} | {size} | {finished} of {len(cell)} | {reached} |")
            if "stt" in table:
                answers += zip(table["stt"].found, cell, strict=True)
    parts = [f"Made by `python benchmarks/single_scan.py {args.told}`.", "", HEAD, *lines]
    if optimum:
        parts += ["", OPTIMUM, *optimum]
    if answers:
        parts += ["", CALIBRATION, *calibration(answers)]
    return "\n".join(parts)


# left out: seconds a scan, or no hope of finishing, where each observation has a dozen or a hundred candidates
SLOW = {"wide": ("map", "rjc"), "lost": ("map", "rjc", "scnn", "ipjc", "clique")}
HEAD = """| class | size | method | right % [95 %] | STT minus it [95 %] | median ms | p99 ms | cut off |
|---|---|---|---|---|---|---|---|"""
OPTIMUM = """STT's most probable hypothesis (`decide=map`) against the proven optimum of the joint posterior, full covariance:

| class | size | proven by `map` | the same value found by STT |
|---|---|---|---|"""
CALIBRATION = """STT's pairings by the confidence they were given:

| confidence | pairings | mean confidence % | right % |
|---|---|---|---|"""


def prefixes(count: int, seed: int) -> str:
    """How often JCBB over sets whose every prefix passes differs from JCBB over sets that pass as a whole."""
    lines = ["| class | size | gate | other pairings | more pairings |", "|---|---|---|---|---|"]
    for kind, size in (("mid", 5), ("mid+sp", 10), ("dense+sp", 10)):
        cell = scans(kind, size, count, seed)
        for gate in (0.95, 0.99):
            one, two = (
                measure(("jcbb", {"gate": gate, "complete": complete}), cell).found for complete in (False, True)
            )
            other = sum(not np.array_equal(a.match, b.match) for a, b in zip(one, two, strict=True))
            more = sum((b.match >= 0).sum() > (a.match >= 0).sum() for a, b in zip(one, two, strict=True))
            lines.append(f"| {kind} | {size} | {gate} | {100 * other / count:.1f} % | {100 * more / count:.1f} % |")
    return "\n".join(lines)


def write(path: Path, text: str) -> None:
    """Replaces what stands between the markers."""
    page = path.read_text("utf-8")
    before, after = page.index(BEGIN) + len(BEGIN), page.index(END)
    path.write_text(page[:before] + "\n\n" + text + "\n\n" + page[after:], "utf-8")


def main() -> None:
    cli = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cli.add_argument("--count", type=int, default=50, help="problems in each cell")
    cli.add_argument("--seed", type=int, default=1)
    cli.add_argument("--classes", default=",".join(CLASSES))
    cli.add_argument("--sizes", type=lambda text: [int(v) for v in text.split(",")])
    cli.add_argument("--methods", default="nn,gnn,singles,scnn,rjc,clique,jcbb,ipjc,map,stt")
    cli.add_argument("--nodes", type=int, default=100_000, help="budget of jcbb, ipjc and map (0 in map: none)")
    cli.add_argument("--prefixes", type=int, help="only this, with so many problems")
    cli.add_argument("--write", type=Path, help="page with the markers that the tables stand between")
    args = cli.parse_args()
    given = {key: getattr(args, key) for key in ("count", "seed", "classes", "sizes", "methods", "nodes")}
    told = {k: ",".join(map(str, v)) if isinstance(v, list) else v for k, v in given.items() if v != cli.get_default(k)}
    args.told = " ".join(f"--{k} {v}" for k, v in {"count": args.count, **told}.items())
    with threadpool_limits(1):
        text = prefixes(args.prefixes, args.seed) if args.prefixes else report(args)
    if args.write:
        write(args.write, text)
    elif args.prefixes:
        print(text)


if __name__ == "__main__":
    main()
