"""Points sorted into square cells. Built here for all kernels, and called from Python only.

Whoever looks around in a grid does so in its own file: the few lines of that are what would be called from other
kernels, which must not live elsewhere (`kernels.jit`), and each weighs what it finds in its own way.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

MOST = 1 << 20  # cells, about: 8 MB, however far apart the points lie


@jit
def fill_grid(points: Array, least: float) -> tuple[float, Array, Array, Array, Array]:
    """Cells of points (n, 2): side, origin (2,), shape (2,), start of each cell, index; cells in row-major order.

    The side is `least` m, or more where that would be too many cells. Points of cell (a, b) are
    index[start[a * shape[1] + b]:start[a * shape[1] + b + 1]].
    """
    n = points.shape[0]
    low, high = np.zeros(2), np.zeros(2)
    if n > 0:
        for u in range(2):
            low[u], high[u] = points[:, u].min(), points[:, u].max()
    span = high - low
    cell = max(least, math.sqrt(span[0] * span[1] / MOST), max(span[0], span[1]) / MOST)
    shape = np.array([int(span[0] / cell) + 1, int(span[1] / cell) + 1])
    counts = np.zeros(shape[0] * shape[1] + 1, np.int64)
    home = np.empty(n, np.int64)
    for j in range(n):
        home[j] = int((points[j, 0] - low[0]) / cell) * shape[1] + int((points[j, 1] - low[1]) / cell)
        counts[home[j] + 1] += 1
    start = np.cumsum(counts)
    index, fill = np.empty(n, np.int64), start[:-1].copy()
    for j in range(n):
        index[fill[home[j]]] = j
        fill[home[j]] += 1
    return cell, low, shape, start, index
