"""The tale live in the terminal: the forest around the family, its window, and what it owns."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from tomthumb.forest.frames import Frame
from tomthumb.forest.world import Forest
from tomthumb.kernels.forest import HAT, HOME, MOUNTAIN, OGRE
from tomthumb.tale.window import WINDOW

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table
    from rich.text import Text

_LOOK = {HOME: ("⌂", "bold cyan"), MOUNTAIN: ("▲", "bright_black"), OGRE: ("Ω", "bold red")}
_SIDE = 36  # columns the status panel needs beside the map


def show_live(forest: Forest, told: Iterable[Frame], console: Console, frames_per_second: float) -> Iterator[Frame]:
    """Draw each frame in place as it comes, at this rate (0: as fast as it goes), and hand it on."""
    from rich.live import Live

    pause = 1.0 / frames_per_second if frames_per_second > 0.0 else 0.0
    with Live(console=console, auto_refresh=False, transient=False) as live:
        for frame in told:
            live.update(picture(forest, frame, console.width, console.height), refresh=True)
            yield frame
            time.sleep(pause)


def picture(forest: Forest, frame: Frame, width: int, height: int) -> RenderableType:
    """Map and status side by side, cut to the terminal."""
    from rich.columns import Columns
    from rich.panel import Panel

    shown = _map(forest, frame, max(10, (width - _SIDE - 8) // 2), max(6, height - 5))
    return Columns([Panel(shown, title=f"iteration {frame.iteration}"), Panel(status(frame), width=_SIDE)])


def status(frame: Frame) -> Table:
    """The window of figure 3 with its signs, the wallet, the wear, and the step of figure 4."""
    from rich.table import Table

    family = frame.family
    side = Table.grid(padding=(0, 1))
    side.add_row(f"[bold]step {frame.step}[/] {frame.what}")
    window = Table(show_header=False, padding=(0, 0))
    for names, values in zip(WINDOW, family.window, strict=True):
        window.add_row(
            *(
                f"{name}\n{value:+.0f}" if value else f"[dim]{name}\n0[/]"
                for name, value in zip(names, values, strict=True)
            )
        )
    side.add_row(window)
    side.add_row(f"wear    {'HAT +1' if family.wear == HAT else 'CROWN -1'}")
    side.add_row(f"alpha   {family.alpha:g}")
    side.add_row(f"wallet  {'EMPTY' if family.wallet == 0 else format(family.wallet, 'g')}")
    side.add_row(f"moves   {frame.moves}")
    side.add_row(f"cells   {frame.distance}")
    return side


def _map(forest: Forest, frame: Frame, columns: int, rows: int) -> Text:
    from rich.text import Text

    row, column = frame.family.place
    top = _start(row, rows, forest.shape[0])
    left = _start(column, columns, forest.shape[1])
    palaces = {tuple(p) for p in frame.palaces.tolist()}
    trodden = {tuple(p) for p in frame.path.tolist()}
    text = Text()
    for r in range(top, min(top + rows, forest.shape[0])):
        for c in range(left, min(left + columns, forest.shape[1])):
            sign, style = _cell(forest, frame, r, c, palaces, trodden)
            text.append(sign + " ", style)
        text.append("\n")
    return text


def _cell(
    forest: Forest, frame: Frame, r: int, c: int, palaces: set[tuple[int, ...]], trodden: set[tuple[int, ...]]
) -> tuple[str, str]:
    """The sign of one cell: the family over places over marks over ways over features."""
    apart = np.abs(np.array(frame.family.place) - (r, c))
    apart = np.minimum(apart, np.array(forest.shape) - apart)
    ground = " on grey23" if apart.max() <= 1 else ""
    if not apart.any():
        return "☻", "bold yellow" + ground
    if (r, c) in palaces:
        return "♛", "bold magenta" + ground
    code = int(forest.cells[r, c])
    if code in _LOOK:
        return _LOOK[code][0], _LOOK[code][1] + ground
    if frame.trail[r, c] > 0.05:
        return ("●", "white" + ground) if frame.stones[r, c] else ("∙", "yellow" + ground)
    if (r, c) in trodden:
        return "·", "bright_blue" + ground
    if frame.ways[r, c] > 0.02:
        return "░", "green" + ground
    feature = int(forest.features[r, c])
    return (chr(ord("a") + feature - 1), "dim" + ground) if feature else (" ", ground.strip())


def _start(middle: int, shown: int, size: int) -> int:
    return max(0, min(middle - shown // 2, size - shown))
