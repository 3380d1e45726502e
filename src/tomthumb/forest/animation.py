"""The tale as an animation (GIF, HTML, MP4) or a still: trail, ways learned, window and wallet."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.forest.frames import Frame
from tomthumb.forest.world import Forest
from tomthumb.kernels.forest import HAT, HOME, MOUNTAIN, OGRE
from tomthumb.tale.window import WINDOW

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".gif", ".html", ".mp4", ".png")
_LIMIT_MB = 60  # of an HTML page, whose frames are all inside it
_CRUMB = (0.90, 0.45, 0.05)
_MOST_CELLS = 512  # on a side, of a forest whose every moment is copied
_PLACES = ((HOME, "H", "tab:cyan"), (OGRE, "O", "tab:red"))


def check_target(path: Path, size: int) -> None:
    """Whether an animation of a forest with `size` cells on a side can be written there, before the tale is told.

    Raises:
        TomThumbError: too large a forest, an unknown ending, a folder that is not there, or MP4 without ffmpeg.
    """
    if size > _MOST_CELLS:
        raise TomThumbError(f"an animation is of forests up to {_MOST_CELLS} cells a side, not {size}")
    if path.suffix.lower() not in FORMATS:
        raise TomThumbError(f"{path}: an animation ends in {', '.join(FORMATS)}")
    if not path.parent.is_dir():
        raise TomThumbError(f"{path}: there is no folder {path.parent}")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise TomThumbError(f"{path}: MP4 needs the program ffmpeg; without it write .gif or .html")


def animate(forest: Forest, told: list[Frame], path: Path, frames_per_second: float = 8.0) -> None:
    """Write the frames as GIF, HTML or MP4 by the ending of `path`, or the last one as PNG.

    Raises:
        TomThumbError: as `check_target`, or no frames.
    """
    check_target(path, max(forest.shape))
    if not told:
        raise TomThumbError(f"{path}: a tale without a single moment cannot be drawn")
    if path.suffix.lower() == ".png":
        still(forest, told[-1]).savefig(path, dpi=90)
        return
    import matplotlib as mpl
    from matplotlib import animation

    figure, axes = _stage()

    def draw(k: int) -> list[Any]:
        paint(axes, forest, told[k])
        return []

    film = animation.FuncAnimation(figure, draw, frames=len(told), interval=1000.0 / frames_per_second)
    suffix = path.suffix.lower()
    if suffix == ".html":
        with mpl.rc_context({"animation.embed_limit": _LIMIT_MB}):
            path.write_text(film.to_jshtml(fps=max(1, round(frames_per_second))), "utf-8")
    else:
        writer: Any = animation.PillowWriter if suffix == ".gif" else animation.FFMpegWriter
        film.save(path, writer=writer(fps=frames_per_second), dpi=72)


def still(forest: Forest, frame: Frame) -> Figure:
    """One moment as a figure."""
    figure, axes = _stage()
    paint(axes, forest, frame)
    return figure


def pixels(forest: Forest, frame: Frame) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """One moment as an RGB picture (height, width, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(still(forest, frame))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _stage() -> tuple[Figure, dict[str, Axes]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 6.6), layout="constrained")
    FigureCanvasAgg(figure)  # drawn into memory, whatever screen there is or is not
    mosaic: Any = [["map", "window"], ["map", "ways"], ["map", "purse"]]
    axes = figure.subplot_mosaic(mosaic, width_ratios=[2.1, 1.0], height_ratios=[1.0, 1.25, 0.75])
    return figure, axes


def paint(axes: dict[str, Axes], forest: Forest, frame: Frame) -> None:
    """Draw one frame on the stage, over whatever was there."""
    for axis in axes.values():
        axis.clear()
        axis.set_xticks([])
        axis.set_yticks([])
    _paint_map(axes["map"], forest, frame)
    _paint_window(axes["window"], frame)
    _paint_ways(axes["ways"], forest, frame)
    _paint_purse(axes["purse"], frame)


def _paint_map(axis: Axes, forest: Forest, frame: Frame) -> None:
    ground = np.ones((*forest.shape, 3)) * (0.93, 0.96, 0.90)
    ground[forest.features > 0] = (0.80, 0.88, 0.76)
    ground[forest.cells == MOUNTAIN] = (0.45, 0.40, 0.36)
    axis.imshow(ground, interpolation="nearest")
    size = 2200.0 / max(forest.shape)
    crumbs = np.argwhere((frame.trail > 0.02) & ~frame.stones)
    stones = np.argwhere(frame.stones)
    faded = np.tile((*_CRUMB, 1.0), (len(crumbs), 1))
    faded[:, 3] = frame.trail[crumbs[:, 0], crumbs[:, 1]]
    axis.scatter(stones[:, 1], stones[:, 0], s=size * 0.5, c="0.45", marker="o", label="stones")
    axis.scatter(crumbs[:, 1], crumbs[:, 0], s=size * 0.4, color=faded)
    axis.scatter([], [], s=size * 0.4, color=_CRUMB, label="crumbs")
    if len(frame.path):
        axis.plot(*_unwrapped(frame.path, forest.shape), color="tab:blue", lw=1.0, alpha=0.7, label="just now")
    for code, letter, colour in _PLACES:
        for row, column in np.argwhere(forest.cells == code):
            _badge(axis, int(row), int(column), letter, colour)
    for row, column in frame.palaces:
        _badge(axis, int(row), int(column), "K", "tab:purple")
    _paint_family(axis, frame)
    axis.set_title(f"iteration {frame.iteration} · step {frame.step}: {frame.what}", fontsize=10)
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=3, fontsize=8, frameon=False)
    axis.set_xlim(-0.5, forest.shape[1] - 0.5)
    axis.set_ylim(forest.shape[0] - 0.5, -0.5)


def _paint_family(axis: Axes, frame: Frame) -> None:
    """The 3 x 3 window as a square in the colour of the wear, Tom in the middle."""
    from matplotlib.patches import Rectangle

    row, column = frame.family.place
    colour = "tab:green" if frame.family.wear == HAT else "gold"
    axis.add_patch(Rectangle((column - 1.5, row - 1.5), 3, 3, fill=False, ec=colour, lw=2.0))
    axis.plot(column, row, "o", color=colour, ms=5, mec="black", mew=0.6)


def _paint_window(axis: Axes, frame: Frame) -> None:
    window = frame.family.window
    axis.imshow(window, cmap="PiYG", vmin=-1.6, vmax=1.6)
    for i, names in enumerate(WINDOW):
        for j, name in enumerate(names):
            axis.text(
                j,
                i,
                f"{name}\n{window[i, j]:+.0f}" if window[i, j] else f"{name}\n0",
                ha="center",
                va="center",
                fontsize=8,
            )
    axis.set_title(f"the window: {'hats' if frame.family.wear == HAT else 'crowns'}", fontsize=9)


def _paint_ways(axis: Axes, forest: Forest, frame: Frame) -> None:
    axis.imshow(frame.ways, cmap="Greens", vmin=0.0, vmax=max(0.2, float(frame.ways.max())), interpolation="nearest")
    axis.plot(forest.home[1], forest.home[0], "s", color="tab:cyan", ms=4)
    axis.set_title(f"ways learned (largest weight {frame.ways.max():.2f})", fontsize=9)


def _paint_purse(axis: Axes, frame: Frame) -> None:
    family = frame.family
    wallet = "EMPTY" if family.wallet == 0 else f"{family.wallet:g}"
    lines = (f"wallet  {wallet}", f"alpha   {family.alpha:g}", f"moves   {frame.moves}", f"cells   {frame.distance}")
    axis.text(0.05, 0.5, "\n".join(lines), va="center", family="monospace", fontsize=11, transform=axis.transAxes)


def _badge(axis: Axes, row: int, column: int, letter: str, colour: str) -> None:
    box = {"boxstyle": "circle,pad=0.2", "fc": colour, "ec": "black", "lw": 0.6}
    axis.text(column, row, letter, color="white", weight="bold", fontsize=9, ha="center", va="center", bbox=box)


def _unwrapped(path: np.ndarray[Any, np.dtype[np.int64]], shape: tuple[int, int]) -> tuple[Any, Any]:
    """Columns and rows of a path, broken (NaN) where it goes round the torus, so that no line crosses the map."""
    jump = np.abs(np.diff(path, axis=0)) > np.array(shape) / 2
    places = np.flatnonzero(jump.any(axis=1)) + 1
    broken = np.insert(path.astype(float), places, np.nan, axis=0)
    return broken[:, 1], broken[:, 0]
