"""Figures say what the run did: checked by what is drawn, not by pixels."""

from __future__ import annotations

import numpy as np
import pytest

from handmade import estimate, trace, truth
from tomthumb.errors import TomThumbError
from tomthumb.report import figures
from tomthumb.storage import SavedRun

ALL = [*figures.RUN_FIGURES.values(), figures.truth_figure, figures.trail_and_error_figure]


@pytest.fixture
def run() -> SavedRun:
    """Two landmarks, the second scan with one wrong and the third with one missed."""
    pose = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [2.0, 5.0, 0.0]])
    made = trace([[0, 1], [0, 0], [0, -1]], estimate([0, 1], points=[[1, 1], [2, 2]]), pose=pose)
    real = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    return SavedRun(made, truth([7, 8] * 3, 3, pose=real, landmarks=np.zeros((9, 2))))


def line(axes, label):
    return next(each for each in axes.get_lines() if each.get_label() == label)


def test_the_trail_and_the_places_of_mistakes(run):
    axes = figures.map_figure(run).axes[0]
    np.testing.assert_allclose(line(axes, "estimated path").get_xydata(), run.trace.pose[:, :2])
    np.testing.assert_allclose(line(axes, "wrong here").get_xydata(), [[1.0, 0.1]])
    np.testing.assert_allclose(line(axes, "missed here").get_xydata(), [[2.0, 5.0]])


def test_errors_and_their_99_percent_bounds(run):
    y = figures.error_figure(run).axes[1]
    np.testing.assert_allclose(line(y, "error").get_ydata(), [0.0, 0.1, 5.0])
    bounds = y.collections[0].get_paths()[0].vertices[:, 1]
    assert bounds.max() == pytest.approx(2.576)
    assert "67 % of the steps" in y.get_title()


def test_the_ellipses_hold_99_percent():
    rng = np.random.default_rng(5)
    cov = np.array([[2.0, 0.9], [0.9, 0.8]])
    made = trace([[0]], estimate([0]))
    made.final.covs[:] = cov
    axes = figures.map_figure(SavedRun(made, truth([0], 1))).axes[0]
    ellipse = axes.collections[0]
    angle, wide, high = ellipse._angles[0], ellipse._widths[0], ellipse._heights[0]  # radians, semi-axes
    x, y = rng.multivariate_normal([0.0, 0.0], cov, 50_000).T
    along, across = np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y
    inside = (along / wide) ** 2 + (across / high) ** 2 <= 1.0
    assert inside.mean() == pytest.approx(0.99, abs=0.002)


@pytest.mark.parametrize("paint", ALL)
@pytest.mark.parametrize("steps", [0, 1, 3])
def test_every_figure_is_drawn_without_any_truth(paint, steps):
    made = trace([[]] * steps, estimate(), failure="lost")
    figures.render(paint(SavedRun(made, truth([], steps, pose=np.full((steps, 3), np.nan)))), "png")


def test_the_same_run_gives_the_same_bytes(run):
    for kind in ("png", "svg", "pdf"):
        assert figures.render(figures.map_figure(run), kind) == figures.render(figures.map_figure(run), kind)


def test_the_taught_part_is_marked(run):
    taught = SavedRun(run.trace, truth([7, 8] * 3, 3, score_from=2))
    assert "not scored" in figures.error_figure(taught).axes[1].get_legend_handles_labels()[1]
    assert "not scored" not in figures.error_figure(run).axes[1].get_legend_handles_labels()[1]


def test_a_place_that_cannot_be_written_is_named(run, tmp_path):
    with pytest.raises(TomThumbError, match="cannot be written"):
        figures.save(figures.map_figure(run), tmp_path / "nowhere" / "map")
