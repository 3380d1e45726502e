"""How near STT is to the best that anybody can decide: the exact posterior of every pairing, on small scans.

    python benchmarks/bayes_limit.py --count 200 --seed 14

All hypotheses within `--slack` nats of the best are listed by branch and bound (`map` with a large pool), with the
density of false observations that STT takes and the true chance of detection. Each weighs by its posterior, the sums
over them are the probabilities of the pairings, and the assignment that maximises the expected number of right decisions
is the Bayes decision: of the methods that know no more than these densities none is better on average. Nothing is left to a search.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from scan_problems import Scan, scans
from single_scan import GATES, Outcome, measure, warm_up
from threadpoolctl import threadpool_limits

from tomthumb import registry
from tomthumb.associators.tom_thumb.decision import most_probable
from tomthumb.stats.bootstrap import mean_interval
from tomthumb.types import Array, Association, AssociationProblem, Ids

CELLS = tuple((kind, size) for kind in ("mid", "mid+sp", "dense+sp") for size in (5, 10))


def bayes(problem: AssociationProblem, slack: float) -> tuple[Ids, bool]:
    """The Bayes decision (m,), and whether every hypothesis within the slack was met."""
    part = registry.build("associator", "map", {"hypotheses": 4000, "slack": slack, "budget": 2_000_000})
    found: list[Association] = list(part.associate(problem, np.random.default_rng(0)))
    m, n = problem.shape
    weights = np.exp(np.array([a.log_weight for a in found]))
    weights /= weights.sum()
    p, none, rows = np.zeros((m, n)), np.zeros(m), np.arange(m)
    for weight, a in zip(weights, found, strict=True):
        paired = a.match >= 0
        p[rows[paired], a.match[paired]] += weight
        none[~paired] += weight
    return most_probable(p, none, 0.0)[0], found[0].info["proof"] == "optimal" and len(found) < 4000


def exact(cell: list[Scan], slack: float) -> tuple[Array, int]:
    """Share right (count,) of the Bayes decision, and on how many scans it is exact."""
    answers = [bayes(scan.problem(), slack) for scan in cell]
    right = [float((match == scan.truth).mean()) for (match, _), scan in zip(answers, cell, strict=True)]
    return np.array(right), sum(whole for _, whole in answers)


def rows(cells: list[tuple[str, int]], count: int, seed: int, slack: float) -> Iterator[str]:
    """One line a cell: the Bayes decision, and the others minus it on the same problems."""
    yield "| class | size | exact on | Bayes % | STT minus Bayes | map minus Bayes | best JCBB minus Bayes | STT minus best JCBB |"
    yield "|---|---|---|---|---|---|---|---|"
    chosen = {"stt": ("stt", {}), "map": ("map", {}), **{f"jcbb {g:g}": ("jcbb", {"gate": g}) for g in GATES}}
    warm_up(chosen)
    for kind, size in cells:
        cell = scans(kind, size, count, seed)
        table: dict[str, Outcome] = {name: measure(method, cell) for name, method in chosen.items()}
        right, whole = exact(cell, slack)
        best = max((name for name in table if name.startswith("jcbb")), key=lambda name: table[name].right.mean())
        gaps = [table[name].right - right for name in ("stt", "map", best)] + [table["stt"].right - table[best].right]
        shown = " | ".join(_points(gap) + (f" ({best[5:]})" if k == 2 else "") for k, gap in enumerate(gaps))
        yield f"| {kind} | {size} | {whole} of {count} | {100.0 * right.mean():.1f} | {shown} |"


def _points(difference: Array) -> str:
    low, high = mean_interval(100.0 * difference, np.random.default_rng(1))
    return f"{100.0 * difference.mean():+.2f} [{low:+.2f}, {high:+.2f}]"


def main() -> None:
    cli = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cli.add_argument("--count", type=int, default=200, help="problems in each cell")
    cli.add_argument("--seed", type=int, default=13)
    cli.add_argument("--slack", type=float, default=10.0, help="nats")
    cli.add_argument("--cells", default=",".join(f"{kind}:{size}" for kind, size in CELLS))
    args = cli.parse_args()
    cells = [(kind, int(size)) for kind, size in (cell.split(":") for cell in args.cells.split(","))]
    with threadpool_limits(1):
        for line in rows(cells, args.count, args.seed, args.slack):
            print(line, flush=True)


if __name__ == "__main__":
    main()
