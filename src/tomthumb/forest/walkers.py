"""Plain searchers to compare with: the Brownian and the Lévy walker, alone with one target."""

from __future__ import annotations

import numpy as np

from tomthumb.forest.flights import BATCH, displacements
from tomthumb.forest.world import Cell, Forest, bare
from tomthumb.kernels.forest import FREE, HAT, MOUNTAIN, TORUS, wander
from tomthumb.tale.levy import LengthLaw, power_law
from tomthumb.tale.window import TOM
from tomthumb.types import Ids, Mask

BROWNIAN = power_law(1.0, 1)  # unit steps only


def flights_until_seen(law: LengthLaw, n: int, window: bool, repeats: int, rng: np.random.Generator) -> tuple[Ids, Ids]:
    """Flights and distance (repeats,) until home is seen on a bare torus of side n, from uniform starts.

    A start from where the target is seen costs 0 flights, as in the exact values.

    Args:
        window: see through the 3 x 3 window, or only the cell one stands on.
    """
    return search(bare(n), law, rng, starts=rng.integers(0, n, (repeats, 2)), window=window)


def search(
    forest: Forest, law: LengthLaw, rng: np.random.Generator, starts: Ids, window: bool = True, most: int = 10_000_000
) -> tuple[Ids, Ids]:
    """Flights and distance (k,) of a walker without memory from each start (k, 2) until it sees home; torus."""
    flights, distances = np.zeros(len(starts), np.int64), np.zeros(len(starts), np.int64)
    eyes: Mask = np.full((3, 3), window)
    eyes[TOM] = True
    ground = _blank(forest.shape)
    clear = not (forest.cells == MOUNTAIN).any()
    moves, luck, used = displacements(rng, law.draw, "eight", BATCH), np.zeros((BATCH, 2)), 0
    for k, start in enumerate(starts):
        if _sees_home(forest, (int(start[0]), int(start[1])), eyes):
            continue
        place, found = start.copy(), FREE
        while found == FREE and flights[k] < most:
            if used == BATCH:
                moves, used = displacements(rng, law.draw, "eight", BATCH), 0
            made, found, gone = wander(
                forest.cells, ground[0], ground[1], ground[2], place, eyes, moves[used:], luck[used:], HAT, False,
                False, clear, False, TORUS, 0.0, 1.0, 1.0, ground[3],
            )  # fmt: skip
            used, flights[k], distances[k] = used + made, flights[k] + made, distances[k] + gone
    return flights, distances


def _blank(shape: tuple[int, int]) -> tuple[Ids, ...]:
    """What the kernel would write into for a family that learns: never touched by one that does not."""
    way = np.zeros((1, 1, 8), np.float32)
    touched, counts, path = np.zeros((1, 1), np.int32), np.zeros(3, np.int64), np.zeros((BATCH, 2), np.int64)
    return way, touched, counts, path  # type: ignore[return-value]


def _sees_home(forest: Forest, place: Cell, eyes: Mask) -> bool:
    rows, columns = forest.shape
    row = (forest.home[0] - place[0] + 1) % rows
    column = (forest.home[1] - place[1] + 1) % columns
    return row < 3 and column < 3 and bool(eyes[row, column])
