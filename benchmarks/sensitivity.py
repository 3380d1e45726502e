"""How much each number matters: `plans/sensitivity.toml`, one plot a parameter, match rate and time over its range.

    python benchmarks/sensitivity.py --out bench/sensitivity [--seeds 7000..7019] [--workers 2] [--figures docs/figures]
        [--write docs/parts.md]
    python benchmarks/sensitivity.py --only nodes slam.hits

Points are means over the seeds, bars 95 % bootstrap intervals by run; the dashed line is the default. Rows are kept in
--out and not run again.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from paired import Row, markdown, parser, run, write

from tomthumb.bench.compare import values
from tomthumb.stats import mean_interval

HOME = Path(__file__).parent


def name_of(parameter: Mapping[str, Any]) -> str:
    """As in --set, without "associator."."""
    part = parameter.get("part", "associator")
    return parameter["key"] if part == "associator" else f"{part}.{parameter['key']}"


def label(value: Any) -> str:
    """A value as a method's label."""
    return "/".join(f"{v:.9g}" for v in value) if isinstance(value, list) else f"{value:g}"


def grid(plan: Mapping[str, Any], parameter: Mapping[str, Any]) -> dict[str, Any]:
    """All values of one parameter in all cells: a method a value."""
    part, key = parameter.get("part", "associator"), parameter["key"]
    chosen = {"associator": [{"use": "stt", "label": "stt"}], "estimator": [{"use": "iekf", "label": "iekf"}]}
    uses = {"associator": {"use": "stt"}, "estimator": {"use": "iekf"}, "slam": {}}[part]
    chosen[part] = [
        {**uses, "label": label(v), **parameter.get("beside", {}), key: [v] if isinstance(v, list) else v}
        for v in parameter["values"]
    ]
    return {
        "name": name_of(parameter), "seeds": plan["seeds"], "limits": plan.get("limits", {}),
        "scenario": plan["cell"], "measures": ["match_rate"], **chosen,
    }  # fmt: skip


Curve = dict[str, tuple[list[float], list[float], list[float], list[float]]]  # cell: means, lows, highs, times us


def curves(rows: Sequence[Row], parameter: Mapping[str, Any]) -> Curve:
    """Means, intervals and times of every value, by cell."""
    out: Curve = {}
    for cell in dict.fromkeys(row["scenario"] for row in rows):
        columns: tuple[list[float], ...] = ([], [], [], [])
        for value in parameter["values"]:
            mine = [r for r in rows if r["scenario"] == cell and _is(r["method"], label(value))]
            rate, spent = values(mine, "match_rate"), values(mine, "associate_us_p50")
            rate = rate[np.isfinite(rate)]
            low, high = mean_interval(rate, np.random.default_rng(0))
            for column, number in zip(columns, (rate.mean(), low, high, np.nanmean(spent)), strict=True):
                column.append(float(number))
        out[cell] = columns  # type: ignore[assignment]
    return out


def _is(method: str, wanted: str) -> bool:
    """A value that is itself a list is appended to the label by the grid."""
    return method == wanted or method.startswith(f"{wanted} ")


def draw(parameter: Mapping[str, Any], found: Curve, file: Path) -> None:
    """One figure: match rate on top, time below."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams |= {"svg.hashsalt": "tomthumb", "svg.fonttype": "none"}
    from matplotlib import pyplot

    figure, (top, below) = pyplot.subplots(2, 1, sharex=True, figsize=(4.6, 4.4), height_ratios=[2, 1])
    x = np.arange(len(parameter["values"]))
    for k, (cell, (mean, low, high, spent)) in enumerate(found.items()):
        at, middle = x + 0.06 * (k - 1.5), 100 * np.array(mean)
        bars = np.clip([middle - 100 * np.array(low), 100 * np.array(high) - middle], 0.0, None)
        top.errorbar(at, middle, yerr=bars, marker="o", markersize=3, linewidth=1, capsize=2, label=cell)
        below.plot(x, spent, marker="o", markersize=3, linewidth=1)
    default = [label(v) for v in parameter["values"]].index(label(parameter["default"]))
    for axes in (top, below):
        axes.axvline(default, linestyle="--", linewidth=0.8, color="grey")
        axes.grid(alpha=0.3)
    top.set_ylabel("match rate, %")
    top.legend(fontsize=7)
    below.set_ylabel("association, us")
    below.set_ylim(bottom=0)
    below.set_xticks(x, [label(v).replace("/", "\n") for v in parameter["values"]], fontsize=8)
    below.set_xlabel(name_of(parameter))
    figure.tight_layout()
    figure.savefig(file, metadata={"Date": None})
    pyplot.close(figure)


def line(parameter: Mapping[str, Any], found: Curve) -> list[str]:
    """How far the match rate and the time move over the range, in the cells where they move most; the best value there."""
    name, cell = name_of(parameter), max(found, key=lambda c: max(found[c][0]) - min(found[c][0]))
    rates = found[cell][0]
    best = parameter["values"][int(np.argmax(rates))]
    times = max(max(spent) / max(min(spent), 1e-9) for *_, spent in found.values())
    values = ", ".join(label(v) for v in parameter["values"])
    return [
        f"[`{name}`](figures/sensitivity-{name}.svg)", values, label(parameter["default"]),
        f"{100 * (max(rates) - min(rates)):.2f} ({cell})", label(best), f"{times:.1f}",
    ]  # fmt: skip


HEADS = [
    "parameter",
    "values",
    "default",
    "range of the match rate, points (world)",
    "best there",
    "range of the time, times",
]


def main() -> None:
    cli = parser(__doc__, "bench/sensitivity")
    cli.add_argument("--only", nargs="*", help="names of parameters")
    cli.add_argument("--figures", type=Path)
    options = cli.parse_args()
    plan = tomllib.loads((HOME / "plans" / "sensitivity.toml").read_text("utf-8"))
    plan |= {"seeds": options.seeds} if options.seeds else {}
    folder, lines = options.figures or options.out, []
    folder.mkdir(parents=True, exist_ok=True)
    for parameter in plan["parameter"]:
        name = name_of(parameter)
        if options.only is not None and name not in options.only:
            continue
        found = curves(run(grid(plan, parameter), HOME, options.out / name, options.workers), parameter)
        lines.append(line(parameter, found))
        print(" | ".join(lines[-1]), flush=True)
        draw(parameter, found, folder / f"sensitivity-{name}.svg")
    if options.write:
        write(options.write, "sensitivity", markdown(HEADS, lines))


if __name__ == "__main__":
    main()
