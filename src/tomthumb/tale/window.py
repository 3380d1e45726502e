"""The family's 3 x 3 window (paper, figure 3, assumption B4): nine named cells, and the same shape as a spatial filter.

In the forest the window is what the family senses around its place. In association it is the cell of a hash grid where
an observation would fall and its eight neighbours, with more rings where the gate is wider: all that is looked at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.kernels.window import cell_keys, window_candidates
from tomthumb.types import Array, Ids

# Figure 3, row by row. The paper's numbering is kept: there is no brother 8, and Tom stands in the middle.
WINDOW = (
    ("parents", "brother1", "brother2"),
    ("brother3", "Tom", "brother5"),
    ("brother4", "brother7", "brother6"),
)
PARENTS = (0, 0)
TOM = (1, 1)
# A cell index beyond this would not fit beside another in one key.
_FARTHEST = 2**30 - 1


@dataclass(frozen=True)
class Grid:
    """Points sorted by the key of their cell; built by `grid_of`, read by `candidates`.

    Attributes:
        cell: side of a cell, m.
        keys: sorted keys (n,).
        order: which point each key belongs to (n,).
        rows: least and greatest occupied row (2,).
    """

    cell: float
    keys: Ids
    order: Ids
    rows: Ids

    def __len__(self) -> int:
        return int(self.keys.size)


def grid_of(points: Array, cell: float) -> Grid:
    """The hash grid of `points (n, 2)` m with cells of side `cell` m.

    Raises:
        TomThumbError: the side is not positive, or a point is not finite or too many cells away from the origin.
    """
    if not (math.isfinite(cell) and cell > 0.0):
        raise TomThumbError(f"the side of a window's cell is a length > 0 m, not {cell}")
    places = _checked(points, cell)
    keys = cell_keys(places, cell)
    order = np.argsort(keys, kind="stable")
    rows = np.floor(places[:, 1] / cell).astype(np.int64)
    extent = np.array([rows.min(), rows.max()]) if len(rows) else np.zeros(2, np.int64)
    return Grid(cell, keys[order], order, extent)


def rings_for(reach: Array, cell: float) -> Array:
    """Rings of cells around the middle one that hold everything within `reach (m,)` m; at least one."""
    rings: Array = np.maximum(1.0, np.ceil(np.asarray(reach, dtype=float) / cell * (1.0 + 1e-9)))
    return rings


def candidates(grid: Grid, queries: Array, reach: Array | float = 0.0) -> tuple[Ids, Ids]:
    """Points in the window of each query, in rows: those of query i are `index[start[i]:start[i + 1]]`, ascending.

    Args:
        grid: the points.
        queries: where each observation would fall, (m, 2) m.
        reach: radius of each query's gate, (m,) or one for all, m; beyond one cell more rings are looked at, so every
            point within `reach` is always among the candidates (others may be too).

    Returns:
        `start (m + 1,)` and `index (start[m],)`.

    Raises:
        TomThumbError: a query that is not finite, or a reach that is negative or not a number.
    """
    places = _checked(queries, grid.cell)
    radius = np.broadcast_to(np.asarray(reach, dtype=float), (len(places),))
    if not (radius >= 0.0).all():
        raise TomThumbError("the reach of a window is >= 0 m for every query")
    rings = np.minimum(rings_for(radius, grid.cell), float(_FARTHEST)).astype(np.int64)
    start, index = window_candidates(grid.keys, grid.order, places, grid.cell, rings, grid.rows)
    return start, index


def majority_error(p: float, cells: int = 9) -> float:
    """Chance that the majority of `cells` (odd) errs when each errs with chance p: the window as a filter."""
    return math.fsum(math.comb(cells, k) * p**k * (1.0 - p) ** (cells - k) for k in range(cells // 2 + 1, cells + 1))


def _checked(points: Array, cell: float) -> Array:
    places = np.ascontiguousarray(points, dtype=float).reshape(-1, 2)
    if not (np.abs(places) / cell < _FARTHEST).all():
        raise TomThumbError(f"window points must be finite and less than {_FARTHEST} cells of {cell} m from the origin")
    return places
