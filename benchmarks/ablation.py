"""What each part is worth: `plans/ablation.toml`, every row against the whole, paired over seeds, as one table.

    python benchmarks/ablation.py --out bench/ablation [--seeds 5000..5049] [--workers 2] [--write docs/parts.md]
    python benchmarks/ablation.py --only "without crumbs" "with the king"

Differences of the match rate (of single scans: of the share rightly decided) to "as it is", in percentage points, with
95 % bootstrap intervals by run (by scan); bold where a Wilcoxon test tells it from none after Holm's correction over the
table. The last column is the median time of an association, relative. Rows are kept in --out and not run again.
"""

from __future__ import annotations

import json
import time
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from paired import Row, differences, markdown, mean, parser, points, run, write
from scan_problems import scans

from tomthumb import registry
from tomthumb.bench.version import code_version

HOME = Path(__file__).parent
WHOLE = "as it is"
PARTS = ("associator", "slam", "estimator")


def grids(plan: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """One grid for each life cycle and estimator, with all associators that go with it: by the label of its first row."""
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        beside = {part: row.get(part, {}) for part in PARTS[1:]}
        name = json.dumps(beside, sort_keys=True)
        grid = found.setdefault(
            name,
            {
                "name": row["label"], "seeds": plan["seeds"], "limits": plan.get("limits", {}), "scenario": plan["cell"],
                "measures": ["match_rate"], "associator": [], "slam": [{"label": "slam", **beside["slam"]}],
                "estimator": [{"use": "iekf", "label": "iekf", **beside["estimator"]}],
            },
        )  # fmt: skip
        settings = {key: [v] if isinstance(v, list) else v for key, v in row.get("associator", {}).items()}
        grid["associator"].append({"use": "stt", "label": row["label"], **settings})
    return {grid["name"]: grid for grid in found.values()}


def closed_loop(plan: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], out: Path, workers: int) -> list[Row]:
    """The rows of all worlds, method being the row's label."""
    found: list[Row] = []
    for name, grid in grids(plan, rows).items():
        labels = [part["label"] for part in grid["associator"]]
        lists = {p["label"]: any(isinstance(v, list) for v in p.values()) for p in grid["associator"]}
        mine = run(grid, HOME, out / name.replace(" ", "_"), workers)
        for row in mine:
            label = next(text for text in labels if _is(row["method"], text, lists[text]))
            found.append({**row, "method": label})
    return found


def _is(method: str, label: str, listed: bool) -> bool:
    """A setting that is itself a list is appended to the label by the grid."""
    return method == label or (listed and method.startswith(f"{label} "))


def single_scans(plan: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], out: Path) -> list[Row]:
    """The same rows on single scans, where only settings of the associator matter; kept in singles.json."""
    file = out / "singles.json"
    kept: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {}
    found: list[Row] = []
    for cell in plan.get("single", ()):
        name = f"{cell['kind']} {cell['size']}"
        problems = None
        for row in rows:
            if row.get("slam") or row.get("estimator") or row.get("associator", {}).get("memory"):
                continue
            settings = row.get("associator", {})
            key = json.dumps([code_version(), cell, plan["single_seed"], plan["singles"], settings], sort_keys=True)
            if key not in kept:
                problems = problems or scans(cell["kind"], cell["size"], plan["singles"], plan["single_seed"])
                kept[key] = measured(settings, problems)
                file.write_text(json.dumps(kept))
            found += [{"scenario": name, "method": row["label"], "status": "done", **one} for one in kept[key]]
    return found


def measured(settings: Mapping[str, Any], problems: Sequence[Any]) -> list[dict[str, Any]]:
    """A row for each scan: share rightly decided and time, after a warm-up."""
    part = registry.build("associator", "stt", settings)
    part.associate(problems[0].problem(), np.random.default_rng(0))
    out = []
    for k, scan in enumerate(problems):
        asked, began = scan.problem(), time.perf_counter()
        answer = part.associate(asked, np.random.default_rng([7, k]))[0]
        spent = 1e6 * (time.perf_counter() - began)
        right = float((answer.match == scan.truth).mean()) if len(scan.truth) else 1.0
        out.append({"seed": k, "match_rate": right, "associate_us_p50": spent})
    return out


def table(rows: Sequence[Row], labels: Sequence[str]) -> str:
    """One line a row of the plan, one column a cell."""
    cells = list(dict.fromkeys(row["scenario"] for row in rows))
    found = differences(rows, "match_rate", WHOLE)
    whole = [f"{100 * mean(rows, cell, WHOLE, 'match_rate'):.3f} %" for cell in cells]
    lines = [[WHOLE, *whole, "1"]]
    for label in labels:
        if label != WHOLE:
            lines.append(
                [label, *(points(found.get((cell, label))) for cell in cells), f"{_time(rows, cells, label):.2f}"]
            )
    return markdown(["", *cells, "time"], lines)


def _time(rows: Sequence[Row], cells: Sequence[str], label: str) -> float:
    """Geometric mean over the cells of the median time relative to the whole."""
    pairs = [(mean(rows, c, label, "associate_us_p50"), mean(rows, c, WHOLE, "associate_us_p50")) for c in cells]
    ratios = [mine / whole for mine, whole in pairs if np.isfinite(mine) and np.isfinite(whole)]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else np.nan


def verdicts(rows: Sequence[Row], labels: Sequence[str]) -> str:
    """For each row of the plan, where it is better and where worse than the whole."""
    found = differences(rows, "match_rate", WHOLE)
    lines = []
    for label in labels:
        if label == WHOLE:
            continue
        mine = {cell: d for (cell, name), d in found.items() if name == label}
        told = {word: [cell for cell, d in mine.items() if d.verdict == word] for word in ("better", "worse")}
        words = [f"{word} in {', '.join(cells)}" for word, cells in told.items() if cells]
        if mine and all(d.ties == d.n for d in mine.values()):
            words = ["the same in every single run"]
        lines.append(f"- {label}: {'; '.join(words) or 'no difference that these seeds could tell'}.")
    return "\n".join(lines)


def main() -> None:
    cli = parser(__doc__, "bench/ablation")
    cli.add_argument("--plan", type=Path, default=HOME / "plans" / "ablation.toml")
    cli.add_argument("--only", nargs="*", help="labels of rows")
    options = cli.parse_args()
    plan = tomllib.loads(options.plan.read_text("utf-8"))
    plan |= {"seeds": options.seeds} if options.seeds else {}
    rows = [row for row in plan["row"] if options.only is None or row["label"] in (WHOLE, *options.only)]
    options.out.mkdir(parents=True, exist_ok=True)
    done = [*closed_loop(plan, rows, options.out, options.workers), *single_scans(plan, rows, options.out)]
    labels = [row["label"] for row in rows]
    seeds = len({row["seed"] for row in done if "case" in row})
    head = f"{seeds} seeds a world, {plan['singles']} single scans a class."
    text = f"{head}\n\n{table(done, labels)}\n\n{verdicts(done, labels)}"
    print(text)
    if options.write:
        write(options.write, "ablation", text)


if __name__ == "__main__":
    main()
