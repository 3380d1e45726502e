"""`tomthumb.minimize` beside well-kept optimisers on COCO's bbob suite, as data profiles.

    pip install "tomthumb[bench-optimize]"
    python benchmarks/optimisers.py --figure docs/figures/optimisers.png
    python benchmarks/optimisers.py --ablate --instances 11-14 --dimensions 2,5 --out benchmarks/results/ablation.csv

24 functions, dimensions 2 to 20, a budget of evaluations a dimension. A row of the CSV is one run: evaluations needed
to come within each precision of the known optimum, empty where it never did. Everybody gets the same box [-5, 5]^n and
the same budget, and defaults of its library; only CMA-ES is not told the box, as its author advises for this suite.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from collections.abc import Callable
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.optimize import PARTS, minimize

PRECISIONS = [10.0**k for k in (2, 1, 0, -1, -2, -3, -4, -5, -6, -7, -8)]
FUNCTIONS = range(1, 25)
GROUPS = {
    "separable (1-5)": range(1, 6),
    "moderate (6-9)": range(6, 10),
    "ill-conditioned (10-14)": range(10, 15),
    "multi-modal (15-19)": range(15, 20),
    "weak structure (20-24)": range(20, 25),
}


class Enough(Exception):
    """The budget is spent or the finest precision reached; thrown through whatever optimiser is running."""


class Recorder:
    """A function that notes when each precision is first reached, and ends the run when there is nothing to gain."""

    def __init__(self, f: Any, budget: int) -> None:
        self.f, self.optimum, self.budget = f, f.best_value(), budget
        self.evaluations, self.hits = 0, [0] * len(PRECISIONS)

    def __call__(self, x: Any) -> float:
        if self.evaluations >= self.budget:
            raise Enough
        self.evaluations += 1
        value = float(self.f(np.asarray(x, dtype=float)))
        for k, precision in enumerate(PRECISIONS):
            if not self.hits[k] and value - self.optimum <= precision:
                self.hits[k] = self.evaluations
        if self.hits[-1]:
            raise Enough
        return value


def run_tom_thumb(f: Recorder, n: int, seed: int) -> None:
    """Ours."""
    minimize(f, [(-5.0, 5.0)] * n, rng=seed, max_evaluations=f.budget)


def run_cma(f: Recorder, n: int, seed: int) -> None:
    """CMA-ES with BIPOP restarts (cma)."""
    import cma

    start = np.random.default_rng(seed).uniform(-4.0, 4.0, n)
    options = {"verbose": -9, "maxfevals": f.budget, "seed": seed + 1}
    cma.fmin2(f, start, 2.0, options, restarts=9, bipop=True)


def run_evolution(f: Recorder, n: int, seed: int) -> None:
    """Differential evolution (scipy), begun again whenever it has converged."""
    from scipy.optimize import differential_evolution

    while True:
        differential_evolution(f, [(-5.0, 5.0)] * n, rng=seed, maxiter=10**6)
        seed += 1000


def run_annealing(f: Recorder, n: int, seed: int) -> None:
    """Dual annealing (scipy)."""
    from scipy.optimize import dual_annealing

    while True:
        dual_annealing(f, [(-5.0, 5.0)] * n, rng=seed, maxiter=10**6, maxfun=10**9)
        seed += 1000


def run_cuckoo(f: Recorder, n: int, seed: int) -> None:
    """Cuckoo search (niapy)."""
    from niapy.algorithms.basic import CuckooSearch
    from niapy.problems import Problem
    from niapy.task import Task

    class Asked(Problem):
        def _evaluate(self, x: Any) -> float:
            return f(x)

    CuckooSearch(population_size=25, seed=seed).run(Task(Asked(n, -5.0, 5.0), max_evals=f.budget + 1))


def run_random(f: Recorder, n: int, seed: int) -> None:
    """Uniform random places: the floor."""
    rng = np.random.default_rng(seed)
    while True:
        f(rng.uniform(-5.0, 5.0, n))


OURS = "tomthumb.minimize"
Runs = dict[str, Callable[[Recorder, int, int], None]]
OPTIMISERS: Runs = {
    OURS: run_tom_thumb,
    "CMA-ES (cma, BIPOP)": run_cma,
    "differential evolution (scipy)": run_evolution,
    "dual annealing (scipy)": run_annealing,
    "cuckoo search (niapy)": run_cuckoo,
    "random": run_random,
}


def without(part: str) -> Callable[[Recorder, int, int], None]:
    """Ours with a part of the tale left out."""

    def run(f: Recorder, n: int, seed: int) -> None:
        minimize(f, [(-5.0, 5.0)] * n, rng=seed, max_evaluations=f.budget, without=(part,))

    return run


ABLATIONS = {OURS: run_tom_thumb} | {f"without {part}": without(part) for part in PARTS}


def measure(run: Callable[[Recorder, int, int], None], function: int, n: int, instance: int, budget: int) -> list[int]:
    """Evaluations to each precision, 0 for never."""
    import cocoex

    recorder = Recorder(cocoex.BareProblem("bbob", function, n, instance), budget * n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the libraries' own, about budgets and divisions
        with suppress(Enough):  # how every run ends
            run(recorder, n, 100 * function + instance)
    return recorder.hits


def sweep(runs: Runs, dimensions: list[int], instances: range, budget: int, out: Path) -> None:
    """All runs into a CSV, a line at a time; runs already there are not repeated."""
    done = {(r["optimiser"], int(r["function"]), int(r["n"]), int(r["instance"])) for r in read(out)}
    fresh = not out.exists()
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a", newline="") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(["optimiser", "function", "n", "instance", "budget", *(f"{p:g}" for p in PRECISIONS)])
        for n, instance, function, name in product(dimensions, instances, FUNCTIONS, runs):
            if (name, function, n, instance) not in done:
                hits = measure(runs[name], function, n, instance, budget)
                writer.writerow([name, function, n, instance, budget, *(h or "" for h in hits)])
                file.flush()


def read(path: Path) -> list[dict[str, str]]:
    """The rows written so far."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def profile(rows: list[dict[str, str]], at: np.ndarray) -> np.ndarray:
    """Share of (function, instance, precision) reached within `at` evaluations a dimension."""
    costs = [float(r[f"{p:g}"]) / int(r["n"]) if r[f"{p:g}"] else np.inf for r in rows for p in PRECISIONS]
    return np.searchsorted(np.sort(costs), at, side="right") / len(costs)


def draw(rows: list[dict[str, str]], path: Path) -> None:
    """Data profiles, one panel a dimension."""
    import matplotlib.pyplot as plt

    dimensions = sorted({int(r["n"]) for r in rows})
    budget = max(int(r["budget"]) for r in rows)
    at = np.geomspace(1.0, budget, 200)
    figure, axes = plt.subplots(
        1, len(dimensions), figsize=(3.3 * len(dimensions), 3.6), sharey=True, layout="constrained"
    )
    for axis, n in zip(np.atleast_1d(axes), dimensions, strict=True):
        for name in OPTIMISERS:
            own = [r for r in rows if r["optimiser"] == name and int(r["n"]) == n]
            axis.semilogx(at, profile(own, at), label=name, lw=2.2 if name.startswith("tomthumb") else 1.3)
        axis.set_title(f"n = {n}")
        axis.set_xlabel("evaluations / n")
        axis.grid(alpha=0.3)
    np.atleast_1d(axes)[0].set_ylabel("share of targets reached")
    figure.legend(*np.atleast_1d(axes)[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def table(runs: Runs, rows: list[dict[str, str]]) -> str:
    """Share of targets reached with the whole budget: by dimension and by group of functions, in Markdown."""
    dimensions = sorted({int(r["n"]) for r in rows})
    budget = np.array([max(float(r["budget"]) for r in rows)])
    heads = [*(f"n = {n}" for n in dimensions), *GROUPS]
    lines = ["| optimiser | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for name in runs:
        own = [r for r in rows if r["optimiser"] == name]
        parts = [[r for r in own if int(r["n"]) == n] for n in dimensions]
        parts += [[r for r in own if int(r["function"]) in group] for group in GROUPS.values()]
        lines.append(f"| {name} | " + " | ".join(f"{100 * profile(p, budget)[0]:.1f} %" for p in parts) + " |")
    return "\n".join(lines)


def differences(runs: Runs, rows: list[dict[str, str]]) -> str:
    """Ours minus each other in points of targets reached, with 95 % bootstrap intervals over the functions."""
    shares = {}
    for name in runs:
        own = [[r for r in rows if r["optimiser"] == name and int(r["function"]) == f] for f in FUNCTIONS]
        shares[name] = np.array([np.mean([bool(r[f"{p:g}"]) for r in part for p in PRECISIONS]) for part in own])
    ours, rng, lines = shares.pop(OURS), np.random.default_rng(0), []
    for name, theirs in shares.items():
        gaps = 100 * (ours - theirs)
        low, high = np.quantile(gaps[rng.integers(0, len(gaps), (5000, len(gaps)))].mean(axis=1), (0.025, 0.975))
        lines.append(f"tomthumb.minimize minus {name}: {gaps.mean():+.1f} points [{low:+.1f}, {high:+.1f}]")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then the table on stdout and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dimensions", default="2,5,10,20")
    parser.add_argument("--instances", default="1-3", help="first-last; for tuning others than for the comparison")
    parser.add_argument("--ablate", action="store_true", help="ours with each part left out, instead of the others")
    parser.add_argument("--budget", type=int, default=500, help="evaluations a dimension")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/optimisers.csv"))
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    first, _, last = given.instances.partition("-")
    instances, runs = range(int(first), int(last or first) + 1), ABLATIONS if given.ablate else OPTIMISERS
    sweep(runs, [int(n) for n in given.dimensions.split(",")], instances, given.budget, given.out)
    rows = read(given.out)
    print(table(runs, rows))
    print(differences(runs, rows))
    if given.figure:
        draw(rows, given.figure)


if __name__ == "__main__":
    main()
