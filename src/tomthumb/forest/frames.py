"""Moments of a tale, copied so that they can be drawn later: the terminal and the animation draw the same frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from tomthumb.forest.family import Family, trail_strengths
from tomthumb.forest.figure4 import Event
from tomthumb.types import Array, Ids, Mask

# Steps worth a moment of their own however short the animation must be.
MILESTONES = {5, 10, 15, 19, 21, 26, 27}


@dataclass(frozen=True)
class Frame:
    """One moment.

    Attributes:
        step, what, iteration: of the event.
        moves, distance: since the tale began.
        family: place, window, wear, alpha, wallet.
        trail: strength of the mark on each cell (n, m); stones: where it is a stone.
        ways: the strongest learned way into each cell (n, m), in [0, 1].
        path: cells of this event (k, 2).
        palaces: (p, 2).
    """

    step: int
    what: str
    iteration: int
    moves: int
    distance: int
    family: Family
    trail: Array
    stones: Mask
    ways: Array
    path: Ids
    palaces: Ids


def frames(events: Iterable[Event], tau: float) -> Iterator[Frame]:
    """A frame for every event that shows something: all that move, and the milestones."""
    moves = distance = 0
    for event in events:
        moves, distance = moves + event.moves, distance + event.distance
        if event.moves or event.step in MILESTONES:
            yield _frame(event, moves, distance, tau)


def thin(taken: list[Frame], most: int) -> list[Frame]:
    """At most about `most` frames: every k-th, and the milestones as far as there is room."""
    if len(taken) <= most:
        return taken
    marked = [i for i, frame in enumerate(taken) if frame.step in MILESTONES]
    even = np.linspace(0, len(taken) - 1, most).astype(int).tolist()
    kept = set(even) if len(marked) > most // 2 else set(even) | set(marked)
    return [taken[i] for i in sorted(kept | {0, len(taken) - 1})]


def gather(told: Iterable[Frame], most: int) -> list[Frame]:
    """About `most` frames from a tale of any length, without ever holding more than a few times as many."""
    taken: list[Frame] = []
    for frame in told:
        taken.append(frame)
        if len(taken) > 4 * most:
            taken = thin(taken, 2 * most)
    return thin(taken, most)


def _frame(event: Event, moves: int, distance: int, tau: float) -> Frame:
    ground = event.ground
    return Frame(
        step=event.step,
        what=event.what,
        iteration=event.iteration,
        moves=moves,
        distance=distance,
        family=event.family,
        trail=trail_strengths(ground, tau).astype(np.float32),
        stones=ground.laid < 0,
        ways=ground.way.max(axis=2),
        path=event.path.copy(),
        palaces=event.palaces.copy(),
    )
