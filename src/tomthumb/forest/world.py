"""The forest: a grid with home, mountains that block, the ogre's house, the king's palace, and features to be seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tomthumb.errors import TomThumbError
from tomthumb.kernels.forest import FREE, HOME, MOUNTAIN, OGRE, PALACE
from tomthumb.types import Array

Cells = npt.NDArray[np.int8]
Cell = tuple[int, int]

LETTERS = {".": FREE, "^": MOUNTAIN, "H": HOME, "O": OGRE, "K": PALACE}
_SIGNS = {code: letter for letter, code in LETTERS.items()}
MOST_FEATURES = 26


@dataclass(frozen=True)
class Forest:
    """Where the tale happens; nobody writes into these arrays.

    Attributes:
        cells: int8 (n, m): FREE, MOUNTAIN, HOME, PALACE (a special mark), OGRE (negative sign).
        features: int8 (n, m): 0 nothing, 1..26 the kind of thing to be seen there.
        home: row and column of the one home.
        awards: what the king of each palace gives, (p,), in the order of `palaces`.
    """

    cells: Cells
    features: Cells
    home: Cell
    awards: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.cells.shape[0], self.cells.shape[1]

    @property
    def palaces(self) -> npt.NDArray[np.int64]:
        """Rows and columns of the palaces (p, 2), row by row."""
        return np.argwhere(self.cells == PALACE)

    @property
    def ogres(self) -> npt.NDArray[np.int64]:
        """Rows and columns of the ogres' houses (o, 2), row by row."""
        return np.argwhere(self.cells == OGRE)


def plant(
    rng: np.random.Generator,
    size: int = 64,
    mountains: float = 0.05,
    ogres: int = 1,
    palaces: int = 1,
    features: float = 0.05,
    award: float = 1.0,
) -> Forest:
    """A random forest (steps 2 and 3), the same for the same generator.

    Args:
        size: cells on a side, at least 4.
        mountains: share of cells that block, in [0, 0.5].
        ogres, palaces: how many of each, on free cells of their own.
        features: share of cells with one of 8 kinds of feature.
        award: what each king gives; `math.inf` is the paper's INFINITY.

    Raises:
        TomThumbError: an argument outside these ranges, or no room.
    """
    if size < 4 or not 0.0 <= mountains <= 0.5 or not 0.0 <= features <= 1.0:
        raise TomThumbError("a forest has a side of at least 4, mountains in [0, 0.5] and features in [0, 1]")
    if min(ogres, palaces) < 0 or 1 + ogres + palaces > size * size // 4:
        raise TomThumbError(f"a forest of {size} x {size} has no room for {ogres} ogres and {palaces} palaces")
    cells, seen = np.zeros((size, size), np.int8), np.zeros((size, size), np.int8)
    for row in range(size):  # row by row: a large forest never needs its random numbers all at once
        cells[row] = MOUNTAIN * (rng.random(size, dtype=np.float32) < mountains)
        seen[row] = (rng.random(size, dtype=np.float32) < features) * rng.integers(1, 9, size, dtype=np.int8)
    places = _distinct(rng, size, 1 + ogres + palaces)
    codes = [HOME] + [OGRE] * ogres + [PALACE] * palaces
    for row, column in places:
        _clear(cells, row, column)
    for (row, column), code in zip(places, codes, strict=True):
        cells[row, column] = code
    return Forest(cells, seen, places[0], np.full(palaces, float(award)))


def bare(
    size: int, home: Cell = (0, 0), ogre: Cell | None = None, king: Cell | None = None, award: float = 1.0
) -> Forest:
    """An empty torus with at most one ogre and one king, as the exact values want it."""
    cells = np.zeros((size, size), np.int8)
    cells[home] = HOME
    if ogre is not None:
        cells[ogre] = OGRE
    if king is not None:
        cells[king] = PALACE
    return Forest(cells, np.zeros_like(cells), home, np.full(0 if king is None else 1, float(award)))


def read_forest(text: str, award: float = 1.0) -> Forest:
    """A forest drawn in letters: `.` free, `^` mountain, `H` home, `O` ogre, `K` king, `a` to `z` features.

    Raises:
        TomThumbError: rows of unequal length, an unknown letter (with its line and column), or not exactly one home.
    """
    rows = [line.strip() for line in text.strip().splitlines()]
    if not rows or len({len(row) for row in rows}) != 1 or not rows[0]:
        raise TomThumbError("a forest needs rows of letters, all of one length")
    cells, features = np.zeros((len(rows), len(rows[0])), np.int8), np.zeros((len(rows), len(rows[0])), np.int8)
    for i, row in enumerate(rows):
        for j, letter in enumerate(row):
            if "a" <= letter <= "z":
                features[i, j] = ord(letter) - ord("a") + 1
            elif letter in LETTERS:
                cells[i, j] = LETTERS[letter]
            else:
                raise TomThumbError(f"line {i + 1}, column {j + 1}: unknown {letter!r}; valid: . ^ H O K and a to z")
    homes = np.argwhere(cells == HOME)
    if len(homes) != 1:
        raise TomThumbError(f"a forest has exactly one home H, not {len(homes)}")
    home = (int(homes[0, 0]), int(homes[0, 1]))
    return Forest(cells, features, home, np.full(int((cells == PALACE).sum()), float(award)))


def show_forest(forest: Forest) -> str:
    """The forest in letters, as `read_forest` reads it (features only where the cell is free)."""
    rows = []
    for cells, features in zip(forest.cells, forest.features, strict=True):
        signs = (
            chr(ord("a") + f - 1) if f and c == FREE else _SIGNS[int(c)]
            for c, f in zip(cells.tolist(), features.tolist(), strict=True)
        )
        rows.append("".join(signs))
    return "\n".join(rows)


def with_awards(forest: Forest, awards: Array) -> Forest:
    """The same forest with other awards (p,), in the order of `forest.palaces`.

    Raises:
        TomThumbError: not one award for each palace, or a negative one.
    """
    values = np.asarray(awards, dtype=float)
    if values.shape != forest.awards.shape or not (values >= 0.0).all():
        raise TomThumbError(f"one award >= 0 for each of the {len(forest.awards)} palaces, not {values.tolist()}")
    return replace(forest, awards=values)


def _distinct(rng: np.random.Generator, size: int, k: int) -> list[Cell]:
    places: list[Cell] = []
    while len(places) < k:
        row, column = (int(v) for v in rng.integers(0, size, 2))
        if (row, column) not in places:
            places.append((row, column))
    return places


def _clear(cells: Cells, row: int, column: int) -> None:
    """No mountain in the window of a place that must be reached."""
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            cells[(row + i) % len(cells), (column + j) % len(cells)] = FREE
