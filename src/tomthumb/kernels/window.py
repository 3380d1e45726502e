"""Candidates from the 3 x 3 window of a hash grid, and from as many more rings as a wide gate needs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tomthumb.kernels.jit import jit

Array = Any

STRIDE = 1 << 31  # a cell's key is column * STRIDE + row: the cells of one column stand in one run of sorted keys


@jit
def cell_keys(points: Array, cell: float) -> Array:
    """int64 key (n,) of the cell that holds each point (n, 2)."""
    keys = np.empty(points.shape[0], np.int64)
    for i in range(points.shape[0]):
        keys[i] = np.int64(math.floor(points[i, 0] / cell)) * STRIDE + np.int64(math.floor(points[i, 1] / cell))
    return keys


@jit
def first_not_below(keys: Array, key: int) -> int:
    """First index of the sorted `keys (n,)` whose key is at least `key`; n if none."""
    low, high = 0, keys.shape[0]
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@jit
def window_scan(keys: Array, order: Array, query: Array, cell: float, rings: int, rows: Array, out: Array) -> int:
    """How many points stand within `rings` cells of the one that holds `query (2,)`; listed in `out` as far as it goes.

    `rows (2,)` is the least and the greatest occupied row. Columns that hold nothing are leapt over.
    """
    n, count = keys.shape[0], 0
    column, row = np.int64(math.floor(query[0] / cell)), np.int64(math.floor(query[1] / cell))
    low, high = max(row - rings, rows[0]), min(row + rings, rows[1])
    c = column - rings
    while c <= column + rings:
        k = first_not_below(keys, c * STRIDE + low)
        if k == n:
            break
        occupied = (keys[k] + STRIDE // 2) // STRIDE
        if occupied > c:  # nothing more in column c
            c = occupied
            continue
        while k < n and keys[k] <= c * STRIDE + high:
            if count < out.shape[0]:
                out[count] = order[k]
            count += 1
            k += 1
        c += 1
    return count


@jit
def window_candidates(
    keys: Array, order: Array, queries: Array, cell: float, rings: Array, rows: Array
) -> tuple[Array, Array]:
    """Candidates of each query as rows (start (m + 1,), index (k,)); see `tomthumb.tale.window.candidates`."""
    m = queries.shape[0]
    start = np.zeros(m + 1, np.int64)
    index = np.empty(max(16, 16 * m), np.int64)
    for i in range(m):
        count = window_scan(keys, order, queries[i], cell, rings[i], rows, index[start[i] :])
        start[i + 1] = start[i] + count
        if start[i + 1] > index.shape[0]:  # it did not fit: more room, and again
            grown = np.empty(2 * start[i + 1], np.int64)
            grown[: start[i]] = index[: start[i]]
            index = grown
            window_scan(keys, order, queries[i], cell, rings[i], rows, index[start[i] :])
        index[start[i] : start[i + 1]].sort()
    return start, index[: start[m]].copy()
