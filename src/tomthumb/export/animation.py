"""A run as a GIF (pillow) or MP4 (ffmpeg)."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.types import Array, Scenario, Trace

FRAMES = 200  # at most; long runs are thinned
FPS = 20


def save_animation(trace: Trace, path: Path, scenario: Scenario | None = None) -> None:
    """Robot, way, observations and map of a run. Raises TomThumbError for an .mp4 where ffmpeg is not installed."""
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter

    film = path.suffix == ".mp4"
    if film and shutil.which("ffmpeg") is None:
        raise TomThumbError(f"{path}: an MP4 needs ffmpeg, which is not installed; a .gif does not")
    frames = np.unique(np.linspace(0, len(trace.t) - 1, min(FRAMES, len(trace.t))).astype(int))
    seen = _seen(trace, scenario, set(frames.tolist()))
    figure, artists = _stage(trace, scenario)
    animation = FuncAnimation(
        figure,
        lambda k: _draw(int(k), trace, seen, artists),
        frames=frames.tolist(),
        blit=False,
        cache_frame_data=False,
    )
    animation.save(str(path), writer=FFMpegWriter(fps=FPS) if film else PillowWriter(fps=FPS), dpi=80)


def _stage(trace: Trace, scenario: Scenario | None) -> tuple[Any, dict[str, Any]]:
    """The figure and what moves in it. Made without pyplot, so that no global state remains."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=trace.scenario)
    if scenario is not None and scenario.landmarks is not None:
        axes.plot(*scenario.landmarks.T, "o", mfc="none", mec="0.6", ms=5, label="true landmarks")
    axes.plot(*trace.final.landmarks.T, "k+", ms=4, label="map at the end")
    (way,) = axes.plot([], [], "-", color="tab:blue", lw=1)
    (robot,) = axes.plot([], [], "o-", color="tab:blue", ms=6, markevery=[0])
    (seen,) = axes.plot([], [], ".", color="tab:red", ms=6, label="observations")
    everything = np.vstack([trace.pose[:, :2], trace.final.landmarks.reshape(-1, 2)])
    low, high = np.nanmin(everything, axis=0) - 1.0, np.nanmax(everything, axis=0) + 1.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.legend(loc="upper right", fontsize=7)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # once is enough: laying out every frame anew costs ten times its drawing
    return figure, {"way": way, "robot": robot, "seen": seen, "length": 0.03 * float(np.max(high - low))}


def _seen(trace: Trace, scenario: Scenario | None, frames: set[int]) -> dict[int, Array]:
    """World points of the observations at the frames to be drawn."""
    if scenario is None:
        return {}
    found = {}
    for k, step in zip(range(len(trace.t)), scenario.steps, strict=False):
        if k in frames and step.observations is not None:
            found[k] = scenario.sensor.locate(trace.pose[k], step.observations.z)[0]
    return found


def _draw(k: int, trace: Trace, seen: dict[int, Array], artists: dict[str, Any]) -> list[Any]:
    x, y, heading = trace.pose[k]
    length = artists["length"]
    artists["way"].set_data(trace.pose[: k + 1, 0], trace.pose[: k + 1, 1])
    artists["robot"].set_data([x, x + length * np.cos(heading)], [y, y + length * np.sin(heading)])
    artists["seen"].set_data(*seen.get(k, np.empty((0, 2))).T)
    return [artists["way"], artists["robot"], artists["seen"]]
