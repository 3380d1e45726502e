"""One scan at a time: who names it rightly, how fast, and how near the search comes to the proven optimum.

    python benchmarks/single_scan.py --count 40 --write docs/single_scan.md
    python benchmarks/single_scan.py --classes wide,lost --sizes 16,32,64 --methods nn,gnn,stt,clique
    python benchmarks/single_scan.py --prefixes 500      # JCBB: how often do prefixes and whole sets differ?

Right: the share of all observations, false ones included, whose partner (or -1) is the true one. Methods see the same
problems; intervals are 95 % bootstrap over problems. Times are CPU time of `associate` alone, on one BLAS thread, after a
warm-up; "cut off": scans on which the search spent its budget of nodes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scan_problems import CLASSES, CLOUD_CLASSES, SECTOR_CLASSES, Scan, scans
from threadpoolctl import threadpool_limits

from tomthumb import registry
from tomthumb.gains import base_gains
from tomthumb.kernels.posterior import value_of
from tomthumb.stats.bootstrap import mean_interval
from tomthumb.stats.profiles import growth
from tomthumb.types import Array, Association, AssociationProblem, Ids

NO_LIMIT = 2**62
GATES = (0.95, 0.99, 0.999, 0.9999)
SECTOR_SIZES, CLOUD_SIZES = (5, 10, 20, 50, 100), (16, 32, 64)
BEGIN, END = "<!-- single_scan: written by benchmarks/single_scan.py -->", "<!-- end of single_scan -->"
FEW = 16  # observations up to which a cell has `--small` problems: one scan more or less right counts for much there
SMALL = 20  # observations of a sector up to which the searches get the larger budget
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
    nodes = nodes or NO_LIMIT
    for name in wanted.split(","):
        if name == "jcbb":
            table.update({f"jcbb {gate:g}": (name, {"gate": gate, "budget": nodes}) for gate in GATES})
        else:
            table[name] = (name, {"budget": nodes} if name in ("map", "ipjc") else {})
    return table


def warm_up(chosen: dict[str, tuple[str, dict[str, float]]]) -> None:
    """Easy and hard scans through all methods, so that nothing is compiled within a timing."""
    for method in chosen.values():
        for kind, size in (("sep", 4), ("mid+sp", 6), ("wide", 8)):
            measure(method, scans(kind, size, 8, 99))


def measure(method: tuple[str, dict[str, float]], cell: list[Scan]) -> Outcome:
    """Every problem once; the first one before that as well, so that caches hold what the method works on."""
    part = registry.build("associator", *method)
    part.associate(cell[0].problem(), np.random.default_rng(0))
    right, seconds, found = [], [], []
    for k, scan in enumerate(cell):
        problem, rng = scan.problem(), np.random.default_rng([7, k])
        begin = time.thread_time()
        answer = part.associate(problem, rng)[0]
        seconds.append(time.thread_time() - begin)
        right.append(float((answer.match == scan.truth).mean()) if len(scan.truth) else 1.0)
        found.append(answer)
    finished = np.array([a.info.get("proof") != "truncated" for a in found])
    return Outcome(np.array(right), np.array(seconds), finished, found)


def value(problem: AssociationProblem, match: Ids) -> float:
    """L of a match on the full covariance: the objective of `map`."""
    own, odds = base_gains(problem, None)
    cov = np.ascontiguousarray(problem.predictions.cov)
    return float(value_of(match, problem.innovation, cov, problem.R, own[:, None] + odds[None])[0])


def optimum_reached(cell: list[Scan], proven: Outcome, changes: Mapping[str, Any]) -> tuple[int, int]:
    """Problems that `map` finished, and where STT's most probable hypothesis has the same L; `changes` of its settings."""
    part = registry.build("associator", "stt", {"decide": "map", **changes})
    finished = same = 0
    for k, (scan, best) in enumerate(zip(cell, proven.found, strict=True)):
        if best.info["proof"] != "optimal":
            continue
        problem = scan.problem()
        answer = part.associate(problem, np.random.default_rng([7, k]))[0]
        finished += 1
        same += value(problem, answer.match) > best.info["objective"] - 1e-6
    return finished, same


# --- tables -----------------------------------------------------------------------------------------------------------

Tables = dict[tuple[str, int], dict[str, Outcome]]


def share(outcome: Outcome, rng: np.random.Generator) -> str:
    """Mean share right and its interval, in percent."""
    low, high = mean_interval(100.0 * outcome.right, rng)
    return f"{100.0 * outcome.right.mean():.1f} [{low:.1f}, {high:.1f}]"


def right_table(tables: Tables, names: list[str]) -> Iterator[str]:
    """Share right, one column for each method."""
    rng = np.random.default_rng(1)
    yield "| class | size | " + " | ".join(names) + " |"
    yield "|---" * (len(names) + 2) + "|"
    for (kind, size), table in tables.items():
        cells = (share(table[name], rng) if name in table else "-" for name in names)
        yield f"| {kind} | {size} | " + " | ".join(cells) + " |"


def paired_table(tables: Tables) -> Iterator[str]:
    """STT minus JCBB at the gate that is best in the cell, and minus the exact maximum, on the same problems."""
    yield "| class | size | best gate of JCBB | STT minus it | STT minus map |"
    yield "|---|---|---|---|---|"
    for (kind, size), table in tables.items():
        gates = [name for name in table if name.startswith("jcbb")]
        if "stt" not in table or not gates:
            continue
        best = max(gates, key=lambda name: table[name].right.mean())
        yield f"| {kind} | {size} | {best[5:]} | {gap(table, best)} | {gap(table, 'map')} |"


def gap(table: dict[str, Outcome], other: str) -> str:
    """STT minus another method, percentage points with their interval."""
    if other not in table:
        return "-"
    difference = 100.0 * (table["stt"].right - table[other].right)
    low, high = mean_interval(difference, np.random.default_rng(1))
    return f"{difference.mean():+.2f} [{low:+.2f}, {high:+.2f}]"


def time_table(tables: Tables, names: list[str]) -> Iterator[str]:
    """Median / 99th percentile in ms, and on how many scans the budget of nodes was spent."""
    yield "| class | size | " + " | ".join(names) + " |"
    yield "|---" * (len(names) + 2) + "|"
    for (kind, size), table in tables.items():
        cells = (times(name, table[name]) if name in table else "-" for name in names)
        yield f"| {kind} | {size} | " + " | ".join(cells) + " |"


def times(name: str, outcome: Outcome) -> str:
    """Milliseconds; for the searches with a budget also the share of scans cut off, where there are any."""
    median, late = np.quantile(1e3 * outcome.seconds, [0.5, 0.99])
    cut = 0.0 if name == "stt" else 100.0 * (~outcome.finished).mean()
    return f"{median:.2f} / {late:.1f}" + (f" ({cut:.0f} % cut)" if cut else "")


def growth_lines(tables: Tables, names: list[str]) -> Iterator[str]:
    """Exponent of the median time's growth with the number of observations, by class."""
    yield "| class | " + " | ".join(names) + " |"
    yield "|---" * (len(names) + 1) + "|"
    for kind in dict.fromkeys(kind for kind, _ in tables):
        sizes = [size for k, size in tables if k == kind]
        cells = []
        for name in names:
            costs = [float(np.median(tables[kind, size][name].seconds)) for size in sizes if name in tables[kind, size]]
            cells.append(
                f"{growth(np.array(sizes, float), np.array(costs)):.2f}" if len(costs) == len(sizes) > 1 else "-"
            )
        yield f"| {kind} | " + " | ".join(cells) + " |"


def calibration(answers: list[tuple[Association, Scan]]) -> Iterator[str]:
    """Pairings by the confidence they were given, and the share of them that is right."""
    chance, right = [], []
    for answer, scan in answers:
        paired = answer.match >= 0
        if answer.confidence is not None:
            chance.append(answer.confidence[paired])
            right.append(answer.match[paired] == scan.truth[paired])
    given, good = np.concatenate(chance), np.concatenate(right)
    yield "| confidence | pairings | mean confidence % | right % |"
    yield "|---|---|---|---|"
    for low, high in pairwise(LEVELS):
        inside = (given >= low) & (given < high)
        if inside.any():
            figures = f"{100 * given[inside].mean():.1f} | {100 * good[inside].mean():.1f}"
            yield f"| {low:.2f} to {min(high, 1.0):.2f} | {int(inside.sum())} | {figures} |"


def report(args: argparse.Namespace) -> str:
    """The whole page between the markers."""
    warm_up(methods(args.methods, 1000))
    tables: Tables = {}
    optimum, answers = ["| class | size | proven by `map` | same L |", "|---|---|---|---|"], []
    for kind in args.classes.split(","):
        for size in args.sizes or (CLOUD_SIZES if kind in CLOUD_CLASSES else SECTOR_SIZES):
            cell = scans(kind, size, args.small if size <= FEW else args.count, args.seed)
            chosen = methods(args.methods, args.exact if kind in SECTOR_CLASSES and size <= SMALL else args.nodes)
            table = {name: measure(m, cell) for name, m in chosen.items() if m[0] not in SLOW.get(kind, ())}
            tables[kind, size] = table
            print(
                kind,
                size,
                {name: round(100 * float(outcome.right.mean()), 1) for name, outcome in table.items()},
                flush=True,
            )
            if "map" in table and "stt" in table:
                finished, same = optimum_reached(cell, table["map"], args.stt)
                optimum.append(f"| {kind} | {size} | {finished} of {len(cell)} | {same} |")
            if "stt" in table:
                answers += zip(table["stt"].found, cell, strict=True)
    return "\n".join(page(args, tables, list(methods(args.methods, 0)), optimum, answers))


def page(
    args: argparse.Namespace,
    tables: Tables,
    names: list[str],
    optimum: list[str],
    answers: list[tuple[Association, Scan]],
) -> Iterator[str]:
    """All tables, each with its heading."""
    yield f"Made by `python benchmarks/single_scan.py {args.told}`: {args.count} problems a cell, {args.small} in those of up to"
    yield f"{FEW} observations, seed {args.seed}."
    yield from ("", "## Right decisions, % [95 % interval]", "", *right_table(tables, names))
    yield from (
        "",
        "## STT against JCBB at its best gate and against the exact maximum, points",
        "",
        *paired_table(tables),
    )
    yield from ("", "## Time of one scan, median / 99th percentile, ms", "", *time_table(tables, names))
    yield from ("", "## Growth of the median time: exponent of the size", "", *growth_lines(tables, names))
    if len(optimum) > 2:
        yield from ("", "## The optimum", "", *OPTIMUM.splitlines(), "", *optimum)
    if answers:
        yield from ("", "## Is the confidence honest?", "", *calibration(answers))


# left out: seconds a scan, or no hope of finishing, where each observation has a dozen or a hundred candidates
SLOW = {"wide": ("map", "rjc"), "lost": ("map", "rjc", "scnn", "ipjc", "clique")}
OPTIMUM = """STT's most probable hypothesis (`decide=map`) on the problems that `map` could finish: whether its L, the joint
posterior on the full covariance, is that of the proven optimum."""


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


def changed(text: str) -> dict[str, float]:
    """Numbers by name; those without a fraction are counts."""
    pairs = (part.split("=") for part in text.split(","))
    return {name: float(value) if "." in value else int(value) for name, value in pairs}


def main() -> None:
    cli = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cli.add_argument("--count", type=int, default=50, help="problems in each cell")
    cli.add_argument("--small", type=int, default=200, help=f"the same in cells of up to {FEW} observations")
    cli.add_argument("--seed", type=int, default=1)
    cli.add_argument("--classes", default=",".join(CLASSES))
    cli.add_argument("--sizes", type=lambda text: [int(v) for v in text.split(",")])
    cli.add_argument("--methods", default="nn,gnn,singles,scnn,rjc,clique,jcbb,ipjc,map,stt")
    cli.add_argument("--nodes", type=int, default=20_000, help="budget of jcbb, ipjc and map (0: none)")
    cli.add_argument("--exact", type=int, default=1_000_000, help="the same for sectors of up to 20 observations")
    cli.add_argument("--stt", type=changed, default={}, help="settings of the most probable set: flights=0,patience=15")
    cli.add_argument("--prefixes", type=int, help="only this, with so many problems")
    cli.add_argument("--write", type=Path, help="page with the markers that the tables stand between")
    args = cli.parse_args()
    given = {
        key: getattr(args, key) for key in ("count", "small", "seed", "classes", "sizes", "methods", "nodes", "exact")
    }
    told = {k: ",".join(map(str, v)) if isinstance(v, list) else v for k, v in given.items() if v != cli.get_default(k)}
    args.told = " ".join(f"--{k} {v}" for k, v in {"count": args.count, **told}.items())
    with threadpool_limits(1):
        text = prefixes(args.prefixes, args.seed) if args.prefixes else report(args)
    if args.write:
        write(args.write, text)
    else:
        print(text)


if __name__ == "__main__":
    main()
