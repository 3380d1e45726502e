"""The figures of a run: map and trail, errors with their bounds, mistakes and consistency. Drawn without pyplot."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tomthumb.geometry import wrap
from tomthumb.metrics.consistency import chi2_band, nees
from tomthumb.metrics.decisions import FN, FP, decide
from tomthumb.metrics.lifetimes import step_of_observation
from tomthumb.storage import SavedRun, writing
from tomthumb.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUE, MINE, BOUND, MISSED, WRONG = "#c62828", "#1f5fa8", "#9fb8d6", "#e08a00", "#111111"
SIGMA_99 = 2.576  # two-sided 99 % of a normal, as the reference program draws its bounds
CHI_99 = 3.035  # radius of a 99 % ellipse in two dimensions, in sigma
RASTER_FROM = 20_000  # points beyond which an SVG holds them as a picture

Painter = Callable[[SavedRun], "Figure"]


def truth_figure(run: SavedRun) -> Figure:
    """The paper's figure 5: true landmarks and true trajectory, in red."""
    figure = _figure(5.6, 5.6)
    axes = figure.add_subplot()
    _draw_truth(axes, run)
    _finish_map(axes, "ground truth")
    return figure


def map_figure(run: SavedRun) -> Figure:
    """Trail and map over the truth, where it is known; mistakes of association are marked on the trail."""
    figure = _figure(6.4, 6.4)
    axes = figure.add_subplot()
    _draw_map(axes, run)
    _finish_map(axes, "trail and map")
    return figure


def error_figure(run: SavedRun) -> Figure:
    """Error in x, y and heading over time, with 99 % bounds; where truth is not known, the bounds alone."""
    figure = _figure(7.2, 6.0)
    for row, name in enumerate(("x", "y", "heading")):
        _draw_error(figure.add_subplot(3, 1, row + 1), run, row, name)
    figure.axes[-1].set_xlabel("time [s]")
    return figure


def trail_and_error_figure(run: SavedRun, title: str = "trail") -> Figure:
    """The paper's figures 6 and 7: the trail on the left, the errors in x and y with 99 % bounds on the right."""
    figure = _figure(11.0, 5.4)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15))
    trail = figure.add_subplot(grid[:, 0])
    _draw_map(trail, run)
    _finish_map(trail, title)
    for row, name in enumerate(("x", "y")):
        axes = figure.add_subplot(grid[row, 1])
        _draw_error(axes, run, row, name)
    figure.axes[-1].set_xlabel("time [s]")
    return figure


def consistency_figure(run: SavedRun) -> Figure:
    """Mistakes of each scan, NEES of the pose and NIS per degree of freedom, over time."""
    figure = _figure(7.2, 6.0)
    top, middle, bottom = (figure.add_subplot(3, 1, row + 1) for row in range(3))
    _draw_mistakes(top, run)
    _draw_nees(middle, run)
    _draw_nis(bottom, run)
    bottom.set_xlabel("time [s]")
    return figure


RUN_FIGURES: dict[str, Painter] = {
    "map": map_figure,
    "error": error_figure,
    "consistency": consistency_figure,
}


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.png and `stem`.svg. Raises TomThumbError where that cannot be done."""
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in ("png", "svg")]
    for path in paths:
        content = render(figure, path.suffix[1:])
        with writing(path):
            path.write_bytes(content)
    return paths


def render(figure: Figure, kind: str) -> bytes:
    """The figure as "png", "svg" or "pdf", the same bytes each time."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "tomthumb", "svg.fonttype": "path"}):
        figure.savefig(buffer, format=kind, dpi=150, metadata=None if kind == "png" else {_DATE[kind]: None})
    return buffer.getvalue()


_DATE = {"svg": "Date", "pdf": "CreationDate"}


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


# --- map ------------------------------------------------------------------------------------------------------------


def _draw_truth(axes: Axes, run: SavedRun) -> None:
    truth = run.truth
    path = _known_path(run.trace.t, truth.pose[:, :2])
    if len(path):
        axes.plot(*path.T, color=TRUE, lw=1.0, label="true path", rasterized=len(path) > RASTER_FROM)
    if truth.landmarks is not None and len(truth.landmarks):
        axes.plot(*truth.landmarks.T, ".", color=TRUE, ms=5, label="true landmarks", zorder=3)


def _known_path(t: Array, points: Array) -> Array:
    """Points (k, 2) where they are known; truth is often sparser than the steps, so only longer gaps break the line."""
    known = np.flatnonzero(np.isfinite(points).all(1))
    gaps = np.diff(t[known])
    if not len(gaps):
        return points[known]
    return np.insert(points[known], np.flatnonzero(gaps > 10.0 * np.median(gaps)) + 1, np.nan, axis=0)


def _draw_map(axes: Axes, run: SavedRun) -> None:
    _draw_truth(axes, run)
    trace, final = run.trace, run.trace.final
    dense = len(trace.pose) > RASTER_FROM
    axes.plot(trace.pose[:, 0], trace.pose[:, 1], color=MINE, lw=1.2, label="estimated path", rasterized=dense)
    stones, crumbs = final.landmarks[final.stone], final.landmarks[~final.stone]
    axes.plot(*stones.T, "+", color=MINE, ms=6, mew=0.9, label=f"map: {len(stones)} stones", zorder=4)
    if len(crumbs):
        axes.plot(*crumbs.T, ".", color=MISSED, ms=3, label=f"{len(crumbs)} crumbs", zorder=2)
    _draw_ellipses(axes, stones, final.covs[final.stone])
    _draw_places_of_mistakes(axes, run)


def _draw_ellipses(axes: Axes, points: Array, covs: Array) -> None:
    """99 % ellipses of the landmarks."""
    from matplotlib.collections import EllipseCollection

    if not len(points):
        return
    values, vectors = np.linalg.eigh(covs)
    widths = 2.0 * CHI_99 * np.sqrt(np.maximum(values, 0.0))
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    ellipses = EllipseCollection(widths[:, 1], widths[:, 0], angles, units="xy", offsets=points)
    ellipses.set_offset_transform(axes.transData)
    ellipses.set(facecolor="none", edgecolor=MINE, linewidth=0.5, alpha=0.7)
    axes.add_collection(ellipses)


def _draw_places_of_mistakes(axes: Axes, run: SavedRun) -> None:
    step = step_of_observation(run.trace.offsets)
    outcome = decide(run.trace, run.truth).outcome
    for kind, color, name in ((FN, MISSED, "missed here"), (FP, WRONG, "wrong here")):
        where = run.trace.pose[np.unique(step[outcome == kind])]
        if len(where):
            axes.plot(where[:, 0], where[:, 1], "x", color=color, ms=5, mew=1.1, label=name, zorder=5)


def _finish_map(axes: Axes, title: str) -> None:
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title)
    axes.set_adjustable("datalim")
    axes.grid(color="#e6e6e6", lw=0.5)
    axes.set_axisbelow(True)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, fontsize=8, frameon=False)


# --- over time ------------------------------------------------------------------------------------------------------


def _draw_error(axes: Axes, run: SavedRun, row: int, name: str) -> None:
    t, error = run.trace.t, run.trace.pose[:, row] - run.truth.pose[:, row]
    bound = SIGMA_99 * np.sqrt(np.maximum(run.trace.pose_cov[:, row, row], 0.0))
    unit = "m"
    if row == 2:
        error, bound, unit = np.degrees(wrap(error)), np.degrees(bound), "deg"
    dense = len(t) > RASTER_FROM
    axes.fill_between(t, -bound, bound, color=BOUND, alpha=0.45, lw=0, label="99 % bounds", rasterized=dense)
    known = np.isfinite(error)
    if known.any():
        axes.plot(t[known], error[known], color=MINE, lw=1.2, label="error", rasterized=dense)
        inside = float(np.mean(np.abs(error[known]) <= bound[known]))
        axes.set_title(f"error in {name}: {100 * inside:.0f} % of the steps inside the 99 % bounds", fontsize=9)
    axes.set_ylabel(f"{name} [{unit}]")
    _finish_time(axes, run)
    if row == 0:
        axes.legend(loc="upper left", fontsize=8, ncols=2)


def _draw_mistakes(axes: Axes, run: SavedRun) -> None:
    outcome = decide(run.trace, run.truth).outcome
    step = step_of_observation(run.trace.offsets)
    count = np.diff(run.trace.offsets)
    axes.step(run.trace.t, count, where="mid", color="#bbbbbb", lw=0.8, label="observations")
    base = np.zeros(len(count))
    for kind, color, name in ((FN, MISSED, "missed"), (FP, WRONG, "wrong")):
        wrong = np.bincount(step[outcome == kind], minlength=len(count))
        use = wrong > 0
        axes.vlines(
            run.trace.t[use], base[use], base[use] + wrong[use], color=color, lw=1.6, label=f"{name}: {wrong.sum()}"
        )
        base += wrong
    axes.set_ylabel("per scan")
    axes.set_title("observations and mistakes", fontsize=9)
    _finish_time(axes, run)
    axes.legend(loc="upper right", fontsize=8, ncols=4)


def _draw_nees(axes: Axes, run: SavedRun) -> None:
    values = nees(run.trace.pose, run.trace.pose_cov, run.truth.pose)
    low, high = chi2_band(3)
    _draw_band(axes, run, values, low, high, 3.0)
    axes.set(ylabel="NEES")
    mean = f", average {np.nanmean(values):.2f} (3 is right)" if np.isfinite(values).any() else ": no truth"
    axes.set_title(f"NEES of the pose{mean}", fontsize=9)


def _draw_nis(axes: Axes, run: SavedRun) -> None:
    dof = run.trace.dof
    values = np.where(dof > 0, run.trace.nis / np.maximum(dof, 1), np.nan)
    typical = float(np.median(dof[dof > 0])) if (dof > 0).any() else 2.0
    low, high = chi2_band(typical)
    _draw_band(axes, run, values, low / typical, high / typical, 1.0)
    axes.set(ylabel="NIS / dof")
    total = dof.sum()
    mean = f", average {run.trace.nis[dof > 0].sum() / total:.2f} (1 is right)" if total else ": no pairings"
    axes.set_title(f"NIS per degree of freedom{mean}", fontsize=9)


def _draw_band(axes: Axes, run: SavedRun, values: Array, low: float, high: float, right: float) -> None:
    t = run.trace.t
    axes.axhspan(low, high, color=BOUND, alpha=0.45, lw=0, label="95 % of each")
    axes.axhline(right, color=TRUE, lw=0.8)
    known = np.isfinite(values)
    axes.plot(t[known], values[known], ".", color=MINE, ms=2.5, rasterized=len(t) > RASTER_FROM)
    if known.any() and values[known].max() > 20.0 * high:
        axes.set_yscale("log")
    axes.legend(loc="upper right", fontsize=8)
    _finish_time(axes, run)


def _finish_time(axes: Axes, run: SavedRun) -> None:
    t, taught = run.trace.t, min(run.truth.score_from, len(run.trace.t) - 1)
    if taught > 1:
        axes.axvspan(t[0], t[taught], color="#f1ead8", lw=0, zorder=0, label="not scored")
    axes.grid(color="#e6e6e6", lw=0.5)
    axes.set_axisbelow(True)
    if len(t) > 1:
        axes.set_xlim(t[0], t[-1])
