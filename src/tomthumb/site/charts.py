"""The figures of the report, as SVG. matplotlib is imported when the first one is drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.bench.compare import summary, values
from tomthumb.bench.execute import DONE
from tomthumb.bench.grid import Grid
from tomthumb.bench.measures import Measure, directed, measure
from tomthumb.stats import Ranking, mean_interval, performance_profiles, rank
from tomthumb.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#1f5fa8", "#c62828", "#2e7d32", "#e08a00", "#6a3d9a", "#00838f", "#8d6e63", "#455a64", "#ad1457", "#827717")
MOST_LINES = 10
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure to be drawn: its file's name, its caption and how."""

    name: str
    caption: str
    draw: Callable[[], Figure]

    def save(self, folder: Path) -> str:
        """Draw it into `folder`; the file's name."""
        import matplotlib as mpl

        with mpl.rc_context({"svg.hashsalt": "tomthumb", "font.size": 9.0}):
            self.draw().savefig(folder / f"{self.name}.svg", metadata={"Date": None})
        return f"{self.name}.svg"


def charts(rows: Sequence[Row], grid: Grid) -> list[Chart]:
    """Everything these rows can show."""
    return [*interval_charts(rows, grid), *sweep_charts(rows, grid), *profile_charts(rows), *rank_charts(rows, grid)]


def colour(labels: Sequence[str], label: str) -> str:
    """The same label has the same colour in every figure."""
    return COLOURS[labels.index(label) % len(COLOURS)]


def methods_of(rows: Iterable[Row]) -> list[str]:
    """Labels in the order of the grid."""
    return list(dict.fromkeys(row["method"] for row in rows))


def _blank(width: float, height: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def interval_charts(rows: Sequence[Row], grid: Grid) -> list[Chart]:
    """One for each measure: mean and interval of every method in every scenario."""
    return [
        Chart(f"mean-{key}", f"{measure(key).title}: mean and 95 % interval", partial(_intervals, rows, key))
        for key in grid.measures
        if np.isfinite(values(rows, key)).any()
    ]


def _intervals(rows: Sequence[Row], key: str) -> Figure:
    m, labels = measure(key), methods_of(rows)
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    figure, axes = _blank(7.5, 1.2 + 0.16 * len(scenarios) * (len(labels) + 1.5))
    for cell in summary(rows, [key]):
        mean, low, high = (m.scale * v for v in cell.means[key])
        y = scenarios.index(cell.scenario) + (labels.index(cell.method) + 1) / (len(labels) + 1.5)
        axes.plot([low, high], [y, y], color=colour(labels, cell.method), lw=1.5)
        axes.plot(mean, y, "o", ms=4, color=colour(labels, cell.method))
    axes.set_yticks(np.arange(len(scenarios)) + 0.5, scenarios)
    axes.set_ylim(len(scenarios), 0)
    axes.grid(axis="x", alpha=0.3)
    axes.set_xlabel(m.title + (f" [{m.unit.strip()}]" if m.unit else ""))
    _legend(axes, labels)
    return figure


def _legend(axes: Axes, labels: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour(labels, label), marker="o", ms=4, label=label) for label in labels]
    axes.figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=8)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One parameter that takes several values while all else stays: `lines` holds, by label, rows by value."""

    parameter: str
    lines: Mapping[str, Mapping[float, list[Row]]]


def sweeps(rows: Sequence[Row]) -> list[Sweep]:
    """Every numeric parameter that was swept."""
    names = dict.fromkeys(key for row in rows for key in row if _is_parameter(key))
    found = []
    for name in names:
        lines: dict[str, dict[float, list[Row]]] = {}
        for row in rows:
            value = row.get(name)
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                lines.setdefault(_rest(row, name), {}).setdefault(float(value), []).append(row)
        several = {label: line for label, line in lines.items() if len(line) > 1}
        if several:
            found.append(Sweep(name, several))
    return found


def _is_parameter(key: str) -> bool:
    return key.split(".")[0] in ("scenario", "associator", "estimator", "slam") and "." in key


def _rest(row: Row, name: str) -> str:
    """The label of a row without what it says of parameter `name`."""
    tail = f" {name.partition('.')[2]}="
    words = [str(row["scenario"]), str(row["method"])]
    return ": ".join(" / ".join(_without(part, tail) for part in word.split(" / ")) for word in words)


def _without(label: str, tail: str) -> str:
    before, found, after = (label + " ").partition(tail)
    return f"{before} {after.partition(' ')[2]}".strip() if found else label


def sweep_charts(rows: Sequence[Row], grid: Grid) -> list[Chart]:
    """How each measure goes with each parameter that was swept; the scaling plots."""
    keys = [*dict.fromkeys((*grid.measures, "step_ms_p50", "associate_us_p50"))]
    return [
        Chart(
            f"sweep-{sweep.parameter}-{key}".replace(".", "-"),
            f"{measure(key).title} by {sweep.parameter}",
            partial(_sweep, sweep, key),
        )
        for sweep in sweeps(rows)
        for key in keys
        if np.isfinite(values(rows, key)).any()
    ]


def _sweep(sweep: Sweep, key: str) -> Figure:
    m, labels = measure(key), list(sweep.lines)[:MOST_LINES]
    figure, axes = _blank(7.0, 4.0)
    for label in labels:
        line = sorted(sweep.lines[label].items())
        stats = np.array([_mean(m, group) for _, group in line])
        x = [value for value, _ in line]
        axes.errorbar(
            x,
            stats[:, 0],
            np.abs(stats[:, 1:] - stats[:, :1]).T,
            color=colour(labels, label),
            capsize=2,
            lw=1.2,
            marker="o",
            ms=3,
        )
    axes.set_xlabel(sweep.parameter)
    axes.set_ylabel(m.title + (f" [{m.unit.strip()}]" if m.unit else ""))
    axes.grid(alpha=0.3)
    _legend(axes, labels)
    return figure


def _mean(m: Measure, group: Sequence[Row]) -> tuple[float, float, float]:
    column = values(group, m.key)
    column = m.scale * column[np.isfinite(column)]
    low, high = mean_interval(column, np.random.default_rng(0), resamples=1000)
    return (float(column.mean()) if len(column) else np.nan), low, high


def worlds(rows: Sequence[Row], key: str) -> tuple[tuple[str, ...], Array]:
    """One measure as a table (worlds, methods), a world being a scenario with a seed; NaN where there is no result."""
    names = methods_of(rows)
    index = {world: i for i, world in enumerate(dict.fromkeys((row["scenario"], row["seed"]) for row in rows))}
    found = np.full((len(index), len(names)), np.nan)
    for row, value in zip(rows, values(rows, key), strict=True):
        found[index[row["scenario"], row["seed"]], names.index(row["method"])] = value
    return tuple(names), found


def profile_charts(rows: Sequence[Row]) -> list[Chart]:
    """Performance profiles of error and of time, where there are methods to compare."""
    if len(methods_of(rows)) < 2:
        return []
    return [
        Chart(f"profile-{key}", f"performance profile: {measure(key).title}", partial(_profile, rows, key))
        for key in ("ate_m", "step_ms_p50")
        if np.isfinite(values(rows, key)).any()
    ]


def _profile(rows: Sequence[Row], key: str) -> Figure:
    names, costs = worlds(rows, key)
    figure, axes = _blank(7.0, 4.0)
    for profile in performance_profiles(names, costs):
        ratio, share = np.append(profile.ratio, 1e3), np.append(profile.share, profile.share[-1:])
        axes.step(ratio[: len(share)], share, where="post", color=colour(names, profile.name), lw=1.4)
    axes.set(xscale="log", xlim=(1, 1e2), ylim=(0, 1.02))
    axes.set_xlabel(f"{measure(key).title}, times the best method's")
    axes.set_ylabel("share of worlds")
    axes.grid(alpha=0.3)
    _legend(axes, names)
    return figure


def rank_charts(rows: Sequence[Row], grid: Grid) -> list[Chart]:
    """Critical-difference diagrams, from three methods on."""
    done = [row for row in rows if row["status"] == DONE]
    charts = []
    for m in directed(grid.measures):
        names, table = worlds(done, m.key)
        ranking = rank(names, table, larger_is_better=bool(m.larger), level=grid.level)
        if len(names) > 2 and ranking.worlds > 1:
            text = f"average ranks by {m.title}, {ranking.worlds} worlds, Friedman p = {ranking.p:.2g}"
            charts.append(Chart(f"ranks-{m.key}", f"{text}; a bar joins what cannot be told apart",
                                partial(_ranks, ranking)))  # fmt: skip
    return charts


def _ranks(ranking: Ranking) -> Figure:
    order = np.argsort(ranking.ranks)
    k = len(order)
    figure, axes = _blank(7.5, 1.0 + 0.28 * k)
    for place, j in enumerate(order):
        axes.plot([ranking.ranks[j]] * 2, [0, place + 1], color="#999999", lw=0.8)
        axes.plot([ranking.ranks[j], k + 0.3], [place + 1] * 2, color="#999999", lw=0.8)
        axes.text(k + 0.35, place + 1, f"{ranking.names[j]}  {ranking.ranks[j]:.2f}", va="center")
    for bar, (first, last) in enumerate(ranking.groups()):
        axes.plot(ranking.ranks[order[[first, last]]], [0.25 + 0.2 * bar] * 2, color="#111111", lw=3)
    axes.set(xlim=(1, k + 0.3), ylim=(k + 0.6, -0.5), yticks=[])
    axes.set_xlabel(f"average rank (1 is best); critical difference {ranking.critical:.2f}")
    axes.spines["left"].set_visible(False)
    return figure
