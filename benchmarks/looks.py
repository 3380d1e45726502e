"""What diameters and classes are worth: simulated posts, confused classes, and the trunks of Victoria Park.

    python benchmarks/looks.py --out bench/looks [--seeds 9000..9049] [--workers 2] [--write docs/parts.md]
    python benchmarks/looks.py --log DATA/victoria_park --steps 20000

Differences of the match rate to the same associator with looks ignored, in percentage points, with 95 % bootstrap
intervals by run; bold where a Wilcoxon test tells it from none after Holm's correction over the table.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from paired import Row, differences, markdown, mean, parser, points, run, write

import tomthumb

HOME = Path(__file__).parent
CONFUSED = {"use": "cloister", "label": "4 classes", "odometry_noise": 8.0, "classes": 4, "confusion": [0.0, 0.02, 0.1]}
LOG_HEADS = ("match_rate", "precision", "recall", "wrong_ids", "duplicates", "idf1", "landmarks", "ate_m")


def by_way(rows: Sequence[Row], ways: Sequence[str]) -> str:
    """One line a world and associator: the match rate the first way, and what the others add."""
    lines = []
    split = [{**row, "who": row["method"].split(" / ")[0], "method": row["method"].split(" / ")[-1]} for row in rows]
    for who in dict.fromkeys(row["who"] for row in split):
        mine = [row for row in split if row["who"] == who]
        found = differences(mine, "match_rate", ways[0])
        for scenario in dict.fromkeys(row["scenario"] for row in mine):
            first = f"{100 * mean(mine, scenario, ways[0], 'match_rate'):.2f}"
            lines.append([scenario, who, first, *(points(found.get((scenario, way))) for way in ways[1:])])
    return markdown(["world", "associator", f"{ways[0]}, match %", *ways[1:]], lines)


def classes(plan: Mapping[str, Any]) -> dict[str, Any]:
    """The grid of confused classes: contradictions excluded, or weighed by the share that is confused."""
    soft = [{"label": "excluded"}, {"label": "weighed", "confusion": 0.1}]
    parts = [{"use": "jcbb", "gate": 0.9999, "label": "jcbb"}, {"use": "stt"}]
    rest = {key: plan[key] for key in ("seeds", "limits", "estimator")}
    return {"name": "classes", "scenario": [CONFUSED], "associator": parts, "slam": soft, **rest}


def on_log(path: str, steps: int) -> str:
    """The first steps of a log whose detections have diameters, by associator and way."""
    world = tomthumb.load(path)
    world = replace(world, steps=list(islice(world.steps, steps)))
    lines = []
    for associator in ("nn", "jcbb", "stt"):
        for way in ("off", "gate", "ratio"):
            trace = tomthumb.run(world, associator=associator, settings={"slam": {"signature": way}})
            row = tomthumb.evaluate(trace, world)
            lines.append([associator, way, *(_cell(row[key]) for key in LOG_HEADS)])
    minutes = (world.steps[-1].t - world.steps[0].t) / 60
    return f"{world.name}, the first {minutes:.1f} minutes:\n\n" + markdown(["", "looks", *LOG_HEADS], lines)


def _cell(value: Any) -> str:
    return "–" if value is None else f"{value:.4f}" if isinstance(value, float) else str(value)


def main() -> None:
    cli = parser(__doc__, "bench/looks")
    cli.add_argument("--log", help="measure on this log instead")
    cli.add_argument("--steps", type=int, default=20_000, help="of the log")
    options = cli.parse_args()
    if options.log:
        name, text = "looks on a log", on_log(options.log, options.steps)
    else:
        plan = tomllib.loads((HOME / "looks.toml").read_text("utf-8"))
        plan |= {"seeds": options.seeds} if options.seeds else {}
        widths = by_way(run(plan, HOME, options.out / "widths", options.workers), ["off", "gate", "ratio"])
        kinds = by_way(run(classes(plan), HOME, options.out / "classes", options.workers), ["excluded", "weighed"])
        name, text = "looks", f"{widths}\n\n{kinds}"
    print(text)
    if options.write:
        write(options.write, name, text)


if __name__ == "__main__":
    main()
