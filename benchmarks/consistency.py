"""Average NEES (3 is right) and position error of the filters, association by the oracle, filter told the true noise.

    python benchmarks/consistency.py --seeds 50 --write docs/estimators.md
    python benchmarks/consistency.py --seeds 50 --filters "the same, crumbs" --associator oracle stt --write docs/estimators.md

The first makes the table of filters, the second that of associators: the share of observations each names rightly, and
the ratio of its NEES to the first one's over the runs in which that share is above 99.8 % (n of them). Every run is kept
in --out under the version of the code, and not made again.

Rows: cloister at 1x to 8x the reference's odometry noise, and a loop of 120 m with landmarks 1.5 m apart at 1x to 4x;
two laps each. Filters: the usual EKF with one iteration, iterated, and the right-invariant one, iterated; landmarks
enter at once, since their names are known. The last has the default life cycle, in which a landmark must be seen five
times before it moves the pose. The spread given is the standard error over seeds (steps of a run are correlated).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from paired import markdown, write
from worlds import loop, true_noise_cloister

from tomthumb import geometry
from tomthumb.bench.version import code_version
from tomthumb.estimators.ekf import EKF, InvariantEKF
from tomthumb.metrics import evaluate
from tomthumb.runner import run

RIGHT = 0.998
AT_ONCE = {"slam": {"hits": 1}}  # association is known: nothing is tentative
FILTERS = {
    "ekf, one iteration": (lambda m, s: EKF(m, s, iterations=1), AT_ONCE),
    "ekf, iterated": (EKF, AT_ONCE),
    "invariant, iterated": (InvariantEKF, AT_ONCE),
    "the same, crumbs": (InvariantEKF, {}),
}
WORLDS = [("cloister", true_noise_cloister, k) for k in (1, 2, 4, 8)] + [("loop 120 m", loop, k) for k in (1, 2, 4)]

Score = dict[str, float]


def score(world: Any, make: Callable[..., Any], settings: Any, seed: int, associator: str) -> Score:
    """NEES over all steps and over the second half, position RMSE m, and share of right names, of one run."""
    trace = run(world, associator=associator, estimator=make(world.motion, world.sensor), seed=seed, settings=settings)
    truth = np.array([s.truth.pose for s in world.steps[: len(trace.t)]])
    error = trace.pose - truth
    error[:, 2] = geometry.wrap(error[:, 2])
    error, cov = error[1:], trace.pose_cov[1:]
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0])
    late = len(nees) // 2
    rmse = float(np.sqrt((error[:, :2] ** 2).sum(1).mean()))
    return {
        "nees": float(nees.mean()),
        "late": float(nees[late:].mean()),
        "rmse": rmse,
        "right": evaluate(trace, world)["match_rate"] or 0.0,
        "failed": trace.failure is not None,
    }


def summary(runs: Sequence[Score], like: Sequence[Score]) -> dict[str, float | None]:
    """What is printed of the runs; `like`: the same worlds with the first associator."""
    nees = np.array([r["nees"] for r in runs])
    good = np.array([r["right"] > RIGHT for r in runs])
    same = np.array([r["nees"] for r in like])[good]
    ratio = round(float(nees[good].sum() / same.sum()), 3) if good.any() else None
    return {
        "nees": float(nees.mean()), "nees_se": float(nees.std(ddof=1) / np.sqrt(len(nees))),
        "nees_second_lap": float(np.mean([r["late"] for r in runs])), "rmse_m": float(np.mean([r["rmse"] for r in runs])),
        "failed": int(sum(r["failed"] for r in runs)), "right": float(np.mean([r["right"] for r in runs])),
        "ratio": ratio, "good": int(good.sum()),
    }  # fmt: skip


class Kept:
    """Scores by what they are of, one JSON line each; a run cut short loses no more than the line it was at."""

    def __init__(self, file: Path) -> None:
        self.file = file
        file.parent.mkdir(parents=True, exist_ok=True)
        lines = file.read_text("utf-8").splitlines() if file.is_file() else []
        pairs = [json.loads(line) for line in lines if line.endswith("}]")]
        self.scores: dict[str, Score] = {json.dumps(key): found for key, found in pairs}

    def get(self, key: Sequence[Any], make: Callable[[], Score]) -> Score:
        """The score that is kept under `key`, else the one made now."""
        name = json.dumps(list(key))
        if name not in self.scores:
            self.scores[name] = make()
            with self.file.open("a", encoding="utf-8") as out:
                out.write(json.dumps([list(key), self.scores[name]]) + "\n")
        return self.scores[name]


def rows_of(seeds: int, filters: Sequence[str], associators: Sequence[str], kept: Kept) -> list[dict[str, Any]]:
    """A row for every world, filter and associator, printed as it comes."""
    rows = []
    for name, make_world, noise in WORLDS:
        worlds = [make_world(np.random.default_rng([seed, 0]), odometry_noise=noise) for seed in range(seeds)]
        for title in filters:
            first: list[Score] = []
            for associator in associators:
                runs = [
                    kept.get(
                        [code_version(), name, noise, title, associator, seed],
                        lambda w=world, k=seed, t=title, a=associator: score(w, *FILTERS[t], k, a),
                    )
                    for seed, world in enumerate(worlds)
                ]
                first = first or runs
                row = {"world": name, "noise": noise, "filter": title, "associator": associator}
                rows.append(row | summary(runs, first))
                print(
                    "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{v}" for k, v in rows[-1].items()),
                    flush=True,
                )
    return rows


def by_column(rows: Sequence[dict[str, Any]], column: str) -> str:
    """NEES with its standard error: a line for each world and noise, a column for each filter or associator."""
    heads = list(dict.fromkeys(row[column] for row in rows))
    lines: dict[str, list[str]] = {}
    for row in rows:
        line = lines.setdefault(f"{row['world']}, {row['noise']}x", [])
        line.append(f"{row['nees']:.2f} ± {row['nees_se']:.2f}")
        if column == "associator" and row["associator"] != heads[0]:
            ratio = "none" if row["ratio"] is None else f"{row['ratio']:.2f} ({row['good']})"
            line += [f"{100 * row['right']:.2f} %", ratio]
    if column == "associator":
        heads = [heads[0], *(text for name in heads[1:] for text in (name, "named rightly", "ratio (n)"))]
    return markdown(["world", *heads], [[world, *line] for world, line in lines.items()])


def main() -> None:
    """Every world with every filter and associator."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--filters", nargs="+", default=list(FILTERS), choices=list(FILTERS))
    parser.add_argument("--associator", nargs="+", default=["oracle"])
    parser.add_argument("--out", type=Path, default=Path("out/consistency.jsonl"))
    parser.add_argument("--write", type=Path, help="put the table between its marks in this document")
    options = parser.parse_args()
    if len(options.associator) > 1 and len(options.filters) > 1:
        parser.error("several associators go with one filter: name it with --filters")
    rows = rows_of(options.seeds, options.filters, options.associator, Kept(options.out))
    column = "associator" if len(options.associator) > 1 else "filter"
    text = f"{options.seeds} seeds.\n\n{by_column(rows, column)}"
    print(text)
    if options.write:
        write(options.write, f"consistency by {column}", text)


if __name__ == "__main__":
    main()
