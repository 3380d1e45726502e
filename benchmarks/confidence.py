"""Is STT as sure as it ought to be? Confidence against the share that is right, on single scans and within whole runs.

    python benchmarks/confidence.py [--seeds 10] [--count 200] [--write docs/parts.md] [--figure docs/figures/confidence.svg]

Every pairing that was made is put into a bin by the confidence it was given; a bin is honest when as many are right. The
second table leaves pairings below `least` unpaired: precision is the share right of those kept, recall the share of the
observations of known landmarks that are rightly named. Within runs, right means that the landmark was founded by an
observation of the same true one; pairings of a walker with what a walker left are not counted, for nobody knows which
walker it was. What a threshold does to the rest of the run is seen by `sensitivity.py --only least`.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from paired import markdown, write
from scan_problems import scans

import tomthumb
from tomthumb import registry
from tomthumb.kernels.gates import innovations
from tomthumb.protocols import Rng
from tomthumb.runner import prepare
from tomthumb.types import Array, Association, AssociationProblem, Ids, Mask, Predictions
from tomthumb.witness import Witness

SINGLES = (("mid+sp", 20), ("dense+sp", 20), ("wide", 32), ("lost", 32))
WORLDS: Mapping[str, Mapping[str, Any]] = {
    "odometry x8": {"odometry_noise": 8.0},
    "no odometry x2": {"odometry": "none", "odometry_noise": 2.0},
    "sensor x3": {"sensor_noise": 3.0},
    "30 people": {"people": 30},
    "clutter 5, seen .8": {"clutter": 5.0, "detect": 0.8},
}
EDGES = np.array([0.0, 0.5, 0.7, 0.85, 0.95, 0.99, 0.999, 1.0 + 1e-9])
LEAST = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999)


@dataclass(frozen=True)
class Decisions:
    """Pairings made: confidence (k,), right (k,), the run or scan they come from (k,); `possible` could have been made."""

    confidence: Array
    right: Mask
    group: Ids
    possible: int


def on_single_scans(kind: str, size: int, count: int) -> Decisions:
    """Problems with known truth, one group each."""
    part, parts, possible = registry.build("associator", "stt"), [], 0
    for k, scan in enumerate(scans(kind, size, count, 8000)):
        answer = part.associate(scan.problem(), np.random.default_rng([7, k]))[0]
        parts.append(_made(answer, answer.match == scan.truth, k))
        possible += int((scan.truth >= 0).sum())
    return _joined(parts, possible)


def on_a_lattice(count: int) -> Decisions:
    """Landmarks a metre apart, all alike, from a pose uncertain by .6 m and 4 deg: no scan can tell a shift by one."""
    part, parts, possible = registry.build("associator", "stt"), [], 0
    rng = np.random.default_rng(8001)
    for k in range(count):
        problem, truth = lattice(rng)
        answer = part.associate(problem, np.random.default_rng([7, k]))[0]
        parts.append(_made(answer, answer.match == truth, k))
        possible += len(truth)
    return _joined(parts, possible)


def lattice(rng: Rng) -> tuple[AssociationProblem, Ids]:
    """A scan of all landmarks within 2.5 m, and its truth."""
    x = np.arange(-5.0, 5.5)
    points = np.stack(np.meshgrid(x, x), -1).reshape(-1, 2)
    std = np.array([0.6, 0.6, np.radians(4.0)])
    error = std * rng.standard_normal(3)
    c, s = np.cos(error[2]), np.sin(error[2])
    seen = (points - error[:2]) @ np.array([[c, -s], [s, c]])
    truth = rng.permutation(np.flatnonzero(np.hypot(*seen.T) < 2.5))
    z = seen[truth] + 0.05 * rng.standard_normal((len(truth), 2))
    G = np.zeros((len(points), 2, 3))
    G[:, 0, 0] = G[:, 1, 1] = -1.0
    G[:, 0, 2], G[:, 1, 2] = points[:, 1], -points[:, 0]
    G = G.reshape(-1, 3)
    P = np.diag(std**2)
    cov = G @ P @ G.T + 0.02**2 * np.eye(len(G))
    visible = np.full(len(points), 0.95)
    predictions = Predictions(np.arange(len(points)), points, cov, P, G @ P, points, visible=visible)
    nu = innovations(z, points, np.zeros(2, bool))
    R = np.tile(0.05**2 * np.eye(2), (len(z), 1, 1))
    return AssociationProblem(z, R, nu, predictions, np.full(len(z), 0.01), np.arange(len(z))), truth


def within_runs(world: Mapping[str, Any], seeds: int) -> Decisions:
    """All scans of several runs, one group a run."""
    parts, possible = [], 0
    for seed in range(8000, 8000 + seeds):
        scenario = tomthumb.load("cloister", seed=seed, **world)
        slam = prepare(scenario, associator="stt", seed=seed)
        witness = slam.associator = Witness(slam.associator)
        for _ in slam.stream(scenario.steps):
            continue
        truth = scenario.true_ids()
        for problem, answer in witness.cases:
            same, counted, known = _true(problem, answer, truth)
            parts.append(_made(answer, same, seed, counted))
            possible += known
    return _joined(parts, possible)


def _true(problem: AssociationProblem, answer: Association, truth: Ids) -> tuple[Mask, Mask, int]:
    """Which pairings are right, which count, and how many observations show a landmark that is expected."""
    mine, theirs = truth[problem.serials], truth[problem.predictions.ids]
    match = answer.match
    if not len(theirs):
        return np.zeros(len(match), bool), np.zeros(len(match), bool), 0
    partner = theirs[np.maximum(match, 0)]
    return (
        (mine >= 0) & (mine == partner),
        (mine >= 0) | (partner >= 0),
        int((np.isin(mine, theirs) & (mine >= 0)).sum()),
    )


def _made(answer: Association, right: Mask, group: int, counted: Mask | None = None) -> tuple[Array, Mask, Ids]:
    rows = np.flatnonzero((answer.match >= 0) & (True if counted is None else counted))
    assert answer.confidence is not None
    return answer.confidence[rows], right[rows], np.full(len(rows), group, np.int64)


def _joined(parts: list[tuple[Array, Mask, Ids]], possible: int) -> Decisions:
    confidence, right, group = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Decisions(confidence, right, group, possible)


def reliability(d: Decisions) -> list[tuple[int, float, float, float, float]]:
    """By bin: how many, mean confidence, share right and its 95 % interval by bootstrap over groups."""
    out = []
    for low, high in pairwise(EDGES):
        rows = (d.confidence >= low) & (d.confidence < high)
        if not rows.any():
            out.append((0, np.nan, np.nan, np.nan, np.nan))
            continue
        out.append(
            (int(rows.sum()), float(d.confidence[rows].mean()), float(d.right[rows].mean()), *_interval(d, rows))
        )
    return out


def _interval(d: Decisions, rows: Mask) -> tuple[float, float]:
    """Groups are drawn again, not pairings: those of one scan stand and fall together."""
    groups, at = np.unique(d.group[rows], return_inverse=True)
    count, good = np.bincount(at), np.bincount(at, d.right[rows])
    if len(groups) < 2:
        return np.nan, np.nan
    draws = np.random.default_rng(0).integers(0, len(groups), (2000, len(groups)))
    low, high = np.quantile(good[draws].sum(1) / count[draws].sum(1), [0.025, 0.975])
    return float(low), float(high)


def gap(d: Decisions) -> float:
    """Expected calibration error: mean over the pairings of |mean confidence - share right| of their bin."""
    return sum(n * abs(c - r) for n, c, r, *_ in reliability(d) if n) / len(d.right)


def reliability_table(found: Mapping[str, Decisions]) -> str:
    """One line a world, one column a bin."""
    heads = ["", *(f"{a:g} to {min(b, 1.0):g}" for a, b in pairwise(EDGES)), "gap"]
    lines = []
    for name, d in found.items():
        cells = [
            "–" if n < 20 else f"{100 * r:.1f} [{100 * low:.1f}, {100 * high:.1f}] of {n}"
            for n, _, r, low, high in reliability(d)
        ]
        lines.append([name, *cells, f"{100 * gap(d):.2f}"])
    return markdown(heads, lines)


def kept(d: Decisions, least: float) -> tuple[float, float]:
    """Precision and recall when pairings below `least` are left unpaired."""
    rows = d.confidence >= least
    good = float(d.right[rows].sum())
    return (good / rows.sum() if rows.any() else 1.0), good / max(d.possible, 1)


def threshold_table(found: Mapping[str, Decisions]) -> str:
    """Precision / recall in percent by threshold."""
    lines = []
    for name, d in found.items():
        pairs = [kept(d, least) for least in LEAST]
        lines.append([name, *(f"{100 * p:.2f} / {100 * r:.2f}" for p, r in pairs)])
    return markdown(["precision / recall %, `least`", *(f"{least:g}" for least in LEAST)], lines)


def draw(found: Mapping[str, Decisions], file: Path) -> None:
    """Reliability on the left, precision over recall on the right."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams |= {"svg.hashsalt": "tomthumb", "svg.fonttype": "none"}
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(8.4, 3.8))
    left.plot([0, 1], [0, 1], color="grey", linewidth=0.8, linestyle="--")
    for name, d in found.items():
        rows = [(c, r) for n, c, r, *_ in reliability(d) if n >= 20]
        left.plot(*zip(*rows, strict=True), marker="o", markersize=3, linewidth=1, label=name)
        pairs = [(100 * recall, 100 * precision) for precision, recall in (kept(d, v) for v in LEAST) if recall > 0.01]
        right.plot(*zip(*pairs, strict=True), marker="o", markersize=3, linewidth=1)
    left.set(xlabel="confidence", ylabel="share right")
    right.set(xlabel="recall, %", ylabel="precision, %")
    left.legend(fontsize=6.5)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(file, metadata={"Date": None})
    pyplot.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="runs of each world")
    parser.add_argument("--count", type=int, default=200, help="single scans of each class")
    parser.add_argument("--write", type=Path)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    found = {f"{kind} {size}": on_single_scans(kind, size, options.count) for kind, size in SINGLES}
    found["lattice"] = on_a_lattice(options.count)
    found |= {name: within_runs(world, options.seeds) for name, world in WORLDS.items()}
    head = f"{options.count} single scans of a class, {options.seeds} runs of a world."
    text = f"{head}\n\n{reliability_table(found)}\n\n{threshold_table(found)}"
    print(text)
    if options.figure:
        draw(found, options.figure)
    if options.write:
        write(options.write, "confidence", text)


if __name__ == "__main__":
    main()
